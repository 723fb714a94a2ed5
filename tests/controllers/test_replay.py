"""A log that stands in for a plant: what controllers say at its samples, by their own loops and starts."""

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from controllers.export.compiled import CompiledController
from ddpc_controllers import (
    GPC,
    IPID,
    LQR,
    MFAC,
    MFAPC,
    MPC,
    PID,
    SPC,
    WKPC,
    DeePC,
    GammaDDPC,
    KoopmanMPC,
    Scaled,
)
from ddpc_controllers.data.dictionaries import Delays, ThinPlate
from ddpc_cosim import (
    Controller,
    FloatArray,
    Loop,
    ParameterValue,
    Plant,
    Recording,
    Sample,
    Steps,
    Trace,
    UniformRandom,
    Variable,
    cosimulate,
    record,
)
from ddpc_cosim.loop.logged import WITHOUT_PAST, LoggedPlant, LoggedSignals, TakingOver

H, SAMPLES = 0.1, 40
TORQUE = Variable("torque", "N.m", min=-3.0, max=3.0, nominal=3.0)
ANGLE = Variable("angle", "rad", nominal=0.5)


class Mass(Plant):
    """Two first-order lags in a row, sampled: y+ = 0.8 y + 0.2 v, v+ = 0.7 v + 0.3 u."""

    inputs, outputs = (TORQUE,), (ANGLE,)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        self._v = self._y = 0.0
        return np.array([self._y])

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self._v, self._y = 0.7 * self._v + 0.3 * u[0], 0.8 * self._y + 0.2 * self._v
        return np.array([self._y])


WANTED = Steps([0.0, 1.5, 2.5], [0.0, 0.6, 0.2])
METHODS: dict[str, Callable[[], Controller]] = {
    "DeePC": lambda: DeePC(horizon=8),
    "DeePC, current output": lambda: DeePC(horizon=8, use_current_output=True),
    "SPC": lambda: SPC(horizon=8),
    "gamma-DDPC": lambda: GammaDDPC(horizon=8),
    "WKPC": lambda: WKPC(horizon=8, dictionary=Delays(samples=1, dictionary=ThinPlate(count=3))),
    "Koopman MPC": lambda: KoopmanMPC(horizon=8, dictionary=ThinPlate(count=3)),
    "MPC": lambda: MPC(horizon=8),
    "LQR": LQR,
    "adaptive GPC": GPC,
    "MFAC": MFAC,
    "MFAPC": MFAPC,
    "intelligent P": lambda: IPID(alpha=2.0),
    "PI": lambda: PID(proportional=1.5, integral=1.0),
    "scaled PI": lambda: Scaled(controller=PID(proportional=1.5, integral=1.0)),
}
"""Those whose answer follows from the samples before: none has a state that a log does not tell."""


@pytest.fixture(scope="module")
def experiment() -> Recording:
    return record(Mass(), UniformRandom(low=[-2.0], high=[2.0], samples=150, seed=1), sampling_time=H)


def close(controller: Controller, recording: Recording, plant: Plant | None = None, first: int = 0) -> Trace:
    steps = SAMPLES - 1 - first
    return cosimulate(
        plant or Mass(),
        controller,
        sampling_time=H,
        duration=steps * H,
        start_time=first * H,
        reference=WANTED,
        recording=recording,
    )


def logged(trace: Trace) -> LoggedSignals:
    recording = Recording(trace.u, trace.y, trace.measured, trace.sampling_time)
    return LoggedSignals(recording, (ANGLE,), trace.y)


def replayed(signals: LoggedSignals, controller: Controller, recording: Recording) -> tuple[Trace, int]:
    first = max(controller.past_length, 1)
    trace = close(
        TakingOver(controller, signals, first), recording, LoggedPlant(signals, (TORQUE,), first), first
    )
    assert trace.completed, trace.reason
    return trace, first


@pytest.mark.parametrize("name", METHODS)
def test_a_log_of_its_own_loop_is_replayed_as_it_was(name: str, experiment: Recording) -> None:
    own = close(METHODS[name](), experiment)
    trace, first = replayed(logged(own), METHODS[name](), experiment)
    assert np.abs(trace.u - own.u[first:]).max() <= 1e-9
    np.testing.assert_array_equal(trace.y, own.y[first:])


def random_log(seed: int) -> LoggedSignals:
    """Return samples that are those of no loop."""
    rng = np.random.default_rng(seed)
    u = np.clip(np.cumsum(rng.normal(size=(SAMPLES, 1)), axis=0) / 3.0, -3.0, 3.0)
    y = np.cumsum(rng.normal(size=(SAMPLES, 1)), axis=0) / 10.0
    return LoggedSignals(Recording(u, y, y, H), (ANGLE,), y)


class Noted(Controller):
    """Notes the loop and the samples of another controller."""

    def __init__(self, controller: Controller) -> None:
        self._controller, self.horizon = controller, controller.horizon
        self.samples = list[Sample]()

    @property
    def uses_recording(self) -> bool:
        return self._controller.uses_recording

    def start(self, loop: Loop) -> None:
        self.loop = loop
        self._controller.start(replace(loop, rng=deepcopy(loop.rng)))

    def step(self, sample: Sample) -> FloatArray:
        self.samples.append(sample)
        return np.zeros(1)


def noted(signals: LoggedSignals, controller: Controller, recording: Recording, first: int) -> Noted:
    """Return the loop, and the samples from a row of the log on."""
    noted = Noted(controller)
    close(noted, recording, LoggedPlant(signals, (TORQUE,), first), first)
    return noted


def within(loop: Loop, answer: object) -> FloatArray:
    u = np.asarray(getattr(answer, "u", answer), dtype=float)
    return np.clip(u, loop.bounds.u_min, loop.bounds.u_max)


@pytest.mark.parametrize("name", [*METHODS, "DeePC, plans", "MPC, scaled"])
def test_each_answer_is_that_of_a_controller_that_is_started_there(name: str, experiment: Recording) -> None:
    more: dict[str, Callable[[], Controller]] = {
        "DeePC, plans": lambda: DeePC(horizon=8, apply_steps=3, rate_bounds=0.5),
        "MPC, scaled": lambda: Scaled(controller=MPC(horizon=8)),
    }
    new = (METHODS | more)[name]
    signals = random_log(2)
    trace, first = replayed(signals, new(), experiment)
    seen = noted(signals, new(), experiment, first)
    for k in (0, 1, 7, 20, len(trace) - 1):
        fresh = new()
        past = signals.before(first + k)
        fresh.start(replace(seen.loop, past=past, rng=np.random.default_rng([0, 0])))
        answer = fresh.step(seen.samples[k]._replace(k=0))
        assert np.abs(trace.u[k] - within(seen.loop, answer)).max() <= 1e-9, k


@pytest.mark.parametrize("name", ["DeePC", "LQR", "MFAPC", "PI"])
def test_code_in_c_that_follows_the_log_answers_alike(name: str, experiment: Recording) -> None:
    signals, controller = random_log(3), METHODS[name]()
    trace, first = replayed(signals, METHODS[name](), experiment)
    seen = noted(signals, controller, experiment, first)
    code = CompiledController(controller, seen.loop)
    row = seen.samples[0]
    for k in (0, 5, len(trace) - 1):
        past = signals.before(first + k)
        for u, y in zip(past.u, past.y, strict=True):
            code.follow(row._replace(y=y, measured=y), u.copy())
        assert np.abs(code.step(seen.samples[k]) - trace.u[k]).max() <= 1e-8


def test_the_log_of_another_controller_differs(experiment: Recording) -> None:
    own = close(METHODS["PI"](), experiment)
    trace, first = replayed(logged(own), METHODS["DeePC"](), experiment)
    assert np.abs(trace.u - own.u[first:]).max() > 0.01
    assert trace.diagnostics[WITHOUT_PAST] == 0.0


def test_who_has_no_past_is_told(experiment: Recording) -> None:
    class Proportional(Controller):
        def start(self, loop: Loop) -> None:
            pass

        def step(self, sample: Sample) -> FloatArray:
            return 2.0 * (sample.setpoint - sample.y)

    signals = random_log(4)
    trace, first = replayed(signals, Proportional(), experiment)
    assert trace.diagnostics[WITHOUT_PAST] == 1.0
    reference = WANTED.at(trace.time)[:, np.newaxis]
    np.testing.assert_allclose(trace.u, np.clip(2.0 * (reference - signals.values[first:]), -3.0, 3.0))
