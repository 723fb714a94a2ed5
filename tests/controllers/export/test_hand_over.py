"""A controller in C that follows a running plant before it is active: as one in Python that has that past."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from controllers.export.compiled import CompiledController
from controllers.export.loops import COUPLED, PENDULUM, Bench
from controllers.test_foresight import PLANTS, make, power, sample_of
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
    BandEdge,
    Cascade,
    Decentralised,
    DeePC,
    FMUController,
    GammaDDPC,
    Group,
    Idle,
    KoopmanMPC,
    OffsetFree,
    SafetyFilter,
    Scaled,
)
from ddpc_controllers.data.dictionaries import Combined, Delays, Identity, ThinPlate
from ddpc_cosim import (
    Action,
    Controller,
    FloatArray,
    Loop,
    Recording,
    Sample,
    export_controller,
    further_arguments,
    further_signals,
)

FOLLOWED, STEPS = 30, 25
Make = Callable[[], Controller]

METHODS: dict[str, Make] = {
    "DeePC": lambda: DeePC(horizon=6),
    "DeePC, plans": lambda: DeePC(apply_steps=3, rate_bounds=0.3, use_current_output=True),
    "SPC": lambda: SPC(horizon=6),
    "gamma-DDPC": lambda: GammaDDPC(beta_2=1e-3, horizon=6, scaling="range"),
    "MPC": lambda: MPC(horizon=6),
    "LQR": lambda: LQR(horizon=4),
    "LQR, measured only": lambda: LQR(horizon=2, use_forecast=False),
    "Koopman MPC": lambda: KoopmanMPC(horizon=6, dictionary=ThinPlate(count=3)),
    "Koopman MPC, delays": lambda: KoopmanMPC(horizon=6, state="delays", delays=2, dictionary=Identity()),
    "PID": lambda: PID(
        proportional=4.0, integral=0.5, derivative=0.05, feedforward=True, setpoint_share=0.6, filter_time=0.1
    ),
    "WKPC": lambda: WKPC(dictionary=ThinPlate(count=4)),
    "scaled PID": lambda: Scaled(controller=PID(proportional=4.0, integral=0.5)),
    "PID, lower edge": lambda: BandEdge(margin=0.05, controller=PID(proportional=4.0, integral=0.5)),
    "LQR, upper edge": lambda: BandEdge(edge="upper", controller=LQR(horizon=4)),
    "DeePC, both edges": lambda: BandEdge(edge="both", margin=0.05, controller=DeePC(horizon=6)),
    "safety filter": lambda: SafetyFilter(controller=PID(proportional=4.0), steps_ahead=6),
    "idle": Idle,
}
"""Those that are exported with disturbances, bands, prices and limits that move."""
PAIRS = [
    Group(inputs=["u0"], outputs=["x0"], controller=MFAC(form="pfdl")),
    Group(inputs=["u1"], outputs=["x1"], controller=PID(proportional=0.2, integral=0.1)),
]
PLAIN: dict[str, tuple[Bench, Make]] = {
    "MFAC": (PENDULUM, lambda: MFAC(form="ffdl", output_length=2)),
    "MFAC, two": (COUPLED, lambda: MFAC(form="pfdl", structure="diagonal")),
    "MFAPC": (PENDULUM, lambda: MFAPC(form="ffdl", rate_bounds=0.3)),
    "MFAPC, two": (COUPLED, lambda: MFAPC(assume_sign=False)),
    "GPC": (PENDULUM, lambda: GPC(initial_model="gradient", rate_bounds=0.3)),
    "GPC, two": (COUPLED, lambda: GPC(forgetting_factor=0.9)),
    "intelligent P": (COUPLED, lambda: IPID(alpha=[4.0, 3.0])),
    "intelligent PI": (COUPLED, lambda: IPID(alpha=[4.0, 3.0], ki=0.2)),
    "intelligent PID": (PENDULUM, lambda: IPID(order=2, alpha=2.0, kp=2.0, ki=0.5, kd=2.0)),
    "PID": (PENDULUM, lambda: PID(tuning="step-test", derivative=0.1)),
    "DeePC": (COUPLED, lambda: DeePC()),
    "DeePC, ridge": (PENDULUM, lambda: DeePC(regulariser="ridge", initial_length=8)),
    "MPC": (COUPLED, lambda: MPC()),
    "LQR": (COUPLED, lambda: LQR()),
    "Koopman MPC": (PENDULUM, lambda: KoopmanMPC(state="measured")),
    "Koopman MPC, delays": (
        COUPLED,
        lambda: KoopmanMPC(dictionary=Combined(dictionaries=[Delays(samples=2), ThinPlate(count=3)])),
    ),
    "WKPC": (PENDULUM, lambda: WKPC(dictionary=Delays(samples=2, dictionary=ThinPlate(count=3)))),
    "offset-free": (COUPLED, lambda: OffsetFree(controller=SPC())),
    "cascade": (
        PENDULUM,
        lambda: Cascade(inner=PID(proportional=2.0), outer=IPID(alpha=2.0), outer_period=3),
    ),
    "cascade with an inner output": (
        PENDULUM,
        lambda: Cascade(
            inner=PID(proportional=1.0, integral=2.0, derivative=0.02),
            outer=PID(proportional=2.0, integral=0.5),
            inner_outputs=["x1"],
        ),
    ),
    "decentralised": (COUPLED, lambda: Scaled(controller=Decentralised(groups=PAIRS))),
}


def regulated(preview: int = 6) -> Loop:
    """Return a loop with two disturbances, a band, limits that move and two prices."""
    return replace(make(PLANTS["two inputs, two outputs"], 160), preview=preview)


def limited() -> Loop:
    """Return a loop whose outputs have limits."""
    loop, _ = COUPLED.loop()
    limit = COUPLED.nominal[: COUPLED.outputs]
    return replace(loop, bounds=replace(loop.bounds, y_min=-limit, y_max=limit))


def answer_of(controller: Controller, sample: Sample, loop: Loop) -> FloatArray:
    """Return what a controller in Python has the master apply."""
    answer = controller.step(sample)
    u = answer.u if isinstance(answer, Action) else answer
    low, high = loop.bounds.u_min, loop.bounds.u_max
    if loop.moving_limits:
        low, high = sample.input_limits[0].T
    return np.clip(u, low, high)


class Course:
    """Random samples of a loop, and inputs that somebody else applies at them.

    Parameters
    ----------
    loop : Loop
        The loop.
    horizon : int
        The controller's.
    seed : int
        Of the random numbers.
    """

    def __init__(self, loop: Loop, horizon: int, seed: int) -> None:
        self.loop, self._horizon, self._rng = loop, horizon, np.random.default_rng(seed)
        self._level = self._rng.normal(size=len(loop.measurements))

    def sample(self, k: int) -> Sample:
        """Return a sample; the measurements drift."""
        loop, rng, horizon = self.loop, self._rng, self._horizon
        nominal = np.array([variable.nominal for variable in loop.measurements])
        self._level = 0.9 * self._level + 0.3 * rng.normal(size=len(nominal))
        measured = nominal * self._level
        if loop.disturbances:
            case = PLANTS["two inputs, two outputs"]
            y = case.output @ measured[: case.output.shape[1]]
            measured[-1] = power(np.zeros(case.inputs), y)
            d = rng.uniform(-0.5, 1.0, len(loop.disturbances))
            return sample_of(replace(loop, preview=horizon), k, y, measured, d, horizon, rng)
        names = [variable.name for variable in loop.measurements]
        y = measured[[names.index(variable.name) for variable in loop.outputs]]
        sizes = np.array([variable.nominal for variable in loop.outputs])
        reference = sizes * rng.normal(size=(1 + horizon, len(sizes)))
        reference[1 + loop.preview :] = reference[min(loop.preview, horizon)]
        return Sample(k, k * loop.sampling_time, y, measured, reference[1:], reference[0])

    def applied(self) -> FloatArray:
        """Return inputs of somebody else."""
        sizes = np.array([variable.nominal for variable in self.loop.inputs])
        return sizes * self._rng.uniform(-0.9, 0.9, len(sizes))

    def past(self, samples: int) -> tuple[Recording, list[Sample]]:
        """Return samples with the inputs that somebody else applied."""
        seen = [self.sample(k) for k in range(samples)]
        u = np.array([self.applied() for _ in seen])
        y, measured = (np.array([getattr(sample, name) for sample in seen]) for name in ("y", "measured"))
        d = np.array([sample.disturbance for sample in seen]).reshape(samples, -1)
        return Recording(u, y, measured, self.loop.sampling_time, d=d), seen


def follow(c: CompiledController, samples: list[Sample], u: FloatArray) -> None:
    """Let code follow; it answers with what is applied, within the bounds."""
    for sample, applied in zip(samples, u, strict=True):
        np.testing.assert_array_equal(
            c.follow(sample, applied.copy()), np.clip(applied, *c.limits_at(sample))
        )


def agree(c: CompiledController, controller: Controller, course: Course, first: int = 0) -> None:
    """Compare the inputs of both, step by step."""
    loop = course.loop
    bounds = loop.bounds
    span = np.where(np.isfinite(bounds.u_max - bounds.u_min), bounds.u_max - bounds.u_min, 2.0) / 2.0
    for k in range(first, first + STEPS):
        sample = course.sample(k)
        difference = np.abs(c.step(sample) - answer_of(controller, sample, loop)) / span
        assert difference.max() <= 1e-8, k


def started(new: Make, loop: Loop, past: Recording | None) -> Controller:
    controller = new()
    rng = np.random.default_rng(1)
    controller.start(replace(loop, past=past, rng=rng))
    return controller


EVERY: dict[str, tuple[Callable[[], Loop], Make]] = {
    **{f"regulated: {name}": (regulated, new) for name, new in METHODS.items()},
    **{name: (lambda bench=bench: bench.loop()[0], new) for name, (bench, new) in PLAIN.items()},  # type: ignore[misc]
    "safety filter": (limited, lambda: SafetyFilter(controller=PID(proportional=0.5, integral=0.3))),
    "GPC, known disturbances": (regulated, lambda: GPC(horizon=6)),
}


@pytest.mark.parametrize("name", EVERY)
def test_code_that_followed_goes_on_as_python_with_that_past(name: str) -> None:
    build, new = EVERY[name]
    loop = replace(build(), rng=np.random.default_rng(1))
    controller = started(new, loop, None)
    c, course = CompiledController(controller, loop), Course(loop, controller.horizon, 3)
    assert c.code.follows
    for samples in (
        FOLLOWED,
        1,
        4,
    ):  # and switched off and on again, also for a past that is shorter than its own
        past, seen = course.past(samples)
        follow(c, seen, past.u)
        agree(c, started(new, loop, past), course)


@pytest.mark.parametrize("name", EVERY)
def test_code_of_a_controller_that_takes_over_does_so(name: str) -> None:
    build, new = EVERY[name]
    loop = replace(build(), rng=np.random.default_rng(1))
    course = Course(loop, new().horizon, 4)
    past, _ = course.past(FOLLOWED)
    controller = started(new, loop, past)
    c = CompiledController(controller, replace(loop, past=past))
    agree(c, controller, course)
    other, seen = course.past(FOLLOWED)  # which forgets the past that it was exported with
    follow(c, seen, other.u)
    agree(c, started(new, loop, other), course)


def test_what_is_missing_while_it_follows_is_as_it_was_last() -> None:
    loop, controller = COUPLED.loop()[0], MPC()
    controller.start(loop)
    c, course = CompiledController(controller, loop), Course(loop, controller.horizon, 5)
    past, seen = course.past(8)
    lost = [sample._replace(y=sample.y.copy(), measured=sample.measured.copy()) for sample in seen]
    y, measured, u = past.y.copy(), past.measured.copy(), past.u.copy()
    applied = u.copy()
    lost[4].y[0] = lost[4].measured[-1] = np.nan  # the same signal
    y[4, 0], measured[4, -1] = y[3, 0], measured[3, -1]
    applied[6, 1], u[6] = np.nan, [u[6, 0], u[5, 1]]
    statuses = []
    for sample, given in zip(lost, applied, strict=True):
        c.follow(sample, given)
        statuses.append(c.status)
    assert statuses == [0, 0, 0, 0, 128, 0, 1, 0]
    agree(c, started(MPC, loop, replace(past, y=y, measured=measured, u=u)), course)


def test_a_past_begins_with_the_first_sample_that_has_all_measurements() -> None:
    loop, controller = COUPLED.loop()[0], DeePC()
    controller.start(loop)
    c, course = CompiledController(controller, loop), Course(loop, controller.horizon, 6)
    past, seen = course.past(5)
    nothing = seen[0]._replace(y=np.full(2, np.nan), measured=np.full(3, np.nan))
    for _ in range(3):
        np.testing.assert_array_equal(c.follow(nothing, np.array([1.0, 2.0])), [1.0, 2.0])
        assert c.status == 128
    follow(c, seen, past.u)
    agree(c, started(DeePC, loop, past), course)


def test_who_does_not_say_that_it_follows_has_code_that_steps_only(tmp_path: Path) -> None:
    class Mine(Idle):
        def c_step(self, code: Any, loop: Loop) -> str:
            return super().c_step(code, loop)

    loop, controller = PENDULUM.loop()[0], Scaled(controller=Mine())
    controller.start(loop)
    code = controller.c_code(loop)
    assert not code.follows
    assert "controller_follow" not in "".join(code.sources.values())
    path = export_controller(controller, loop, tmp_path / "mine.fmu")
    assert "active" not in {v.name for v in fmpy.read_model_description(str(path)).modelVariables}
    past, _ = Course(loop, 1, 1).past(5)
    fmu = FMUController(file=str(path))
    fmu.start(replace(loop, past=past))
    assert fmu.warnings() == [
        "mine.fmu: cannot follow a running plant before it takes over: it starts from rest"
    ]


def rows_of(loop: Loop, samples: list[Sample], horizon: int, active: list[float], u: FloatArray) -> Any:
    """Return the inputs of an exported FMU over time."""
    further, outputs = further_arguments(loop, horizon), [variable.name for variable in loop.outputs]
    others = [i for i, v in enumerate(loop.measurements) if v.name not in outputs]
    preview = min(loop.preview, horizon)
    heads = [*outputs, *(loop.measurements[i].name for i in others), *(f"setpoint.{n}" for n in outputs)]
    heads += [f"reference.{n}[{k}]" for k in range(1, preview + 1) for n in outputs]
    heads += [signal.name for signal in further_signals(loop, horizon)]
    heads += ["active", *(f"applied.{variable.name}" for variable in loop.inputs)]
    rows = []
    for sample, on, applied in zip(samples, active, u, strict=True):
        fields = [getattr(sample, name)[: shape[0]].ravel() for name, shape in further.items()]
        parts = (sample.y, sample.measured[others], sample.setpoint, sample.reference[:preview].ravel())
        rows.append((sample.time, *np.clip(np.concatenate([*parts, *fields]), -1e30, 1e30), on, *applied))
    return np.array(rows, dtype=[(name, float) for name in ("time", *heads)])


FMUS: dict[str, tuple[Callable[[], Loop], Make, str]] = {
    "regulated: DeePC": (regulated, METHODS["DeePC"], "2.0"),
    "regulated: LQR": (regulated, METHODS["LQR"], "3.0"),
    "regulated: DeePC, both edges": (regulated, METHODS["DeePC, both edges"], "3.0"),
    "PID": (*EVERY["PID"], "2.0"),
    "MFAPC": (*EVERY["MFAPC"], "3.0"),
    "GPC": (*EVERY["GPC, two"], "2.0"),
}


@pytest.mark.parametrize("name", FMUS)
def test_the_fmu_follows_where_it_is_not_active(name: str, tmp_path: Path) -> None:
    build, new, version = FMUS[name]
    loop = replace(build(), rng=np.random.default_rng(1))
    controller = started(new, loop, None)
    path = export_controller(controller, loop, tmp_path / "follows.fmu", version)
    assert validate_fmu(str(path)) == []
    described = {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables}
    assert float(described["active"].start) == 1.0
    course, n = Course(loop, controller.horizon, 7), 12
    samples, active, given, expected = list[Sample](), list[float](), list[FloatArray](), list[FloatArray]()
    for _ in range(2):  # switched off, on, off and on again
        past, seen = course.past(n)
        python = started(new, loop, past)
        for k in range(2 * n):
            sample = seen[k] if k < n else course.sample(k)
            time = len(samples) * loop.sampling_time
            samples.append(sample._replace(time=time))
            active.append(float(k >= n))
            given.append(past.u[min(k, n - 1)])
            limits = loop.bounds.u_min, loop.bounds.u_max
            if loop.moving_limits:
                limits = sample.input_limits[0, :, 0], sample.input_limits[0, :, 1]
            expected.append(np.clip(past.u[k], *limits) if k < n else answer_of(python, sample, loop))
    h, inputs = loop.sampling_time, [variable.name for variable in loop.inputs]
    result = fmpy.simulate_fmu(
        str(path),
        input=rows_of(loop, samples, controller.horizon, active, np.array(given)),
        stop_time=len(samples) * h,
        step_size=h,
        output=inputs,
    )
    answers = np.array([result[name][1:] for name in inputs]).T
    size = np.array([(loop.bounds.u_max - loop.bounds.u_min) / 2.0])
    assert np.abs((answers - expected) / np.where(np.isfinite(size), size, 1.0)).max() <= 1e-8


@pytest.mark.parametrize("name", ["regulated: DeePC", "PID"])
def test_an_fmu_takes_over_in_a_loop_as_the_controller_does(name: str, tmp_path: Path) -> None:
    build, new, _ = FMUS[name]
    loop = replace(build(), rng=np.random.default_rng(1))
    path = export_controller(started(new, loop, None), loop, tmp_path / "taking_over.fmu")
    fmu = FMUController(file=str(path))
    course = Course(loop, fmu.horizon, 8)
    past, _ = course.past(10)
    python = started(new, loop, past)
    fmu.start(replace(loop, past=past))
    assert fmu.warnings() == []
    for k in range(15):
        sample = course.sample(k)
        np.testing.assert_allclose(
            answer_of(fmu, sample, loop), answer_of(python, sample, loop), rtol=0.0, atol=1e-8
        )
