"""The loop, seen by a plant and a controller that write down what is done to them."""

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from ddpc_cosim import (
    Action,
    Conditions,
    ConfigError,
    Constant,
    Controller,
    ControllerError,
    FloatArray,
    GaussianNoise,
    Loop,
    ParameterChange,
    Plant,
    Ramp,
    Recording,
    Sample,
    Steps,
    Trace,
    UniformRandom,
    Variable,
    cosimulate,
    record,
)

Call = tuple[object, ...]
CLIPPED = "input beyond its bounds, clipped"


class Integrators(Plant):
    """One integrator per input, x' = gain * u, and the time as a last output; calls go to a diary."""

    def __init__(self, size: int = 1, diary: list[Call] | None = None, start: float = 0.0) -> None:
        self.inputs = tuple(Variable(f"u{i}", min=-2.0, max=2.0, start=start) for i in range(size))
        self.outputs = (*(Variable(f"x{i}") for i in range(size)), Variable("clock", unit="s"))
        self.diary: list[Call] = [] if diary is None else diary

    def reset(self, parameters: Mapping[str, float] | None = None, t0: float = 0.0) -> FloatArray:
        self.diary.append(("reset", dict(parameters or {}), t0))
        self.x, self.t, self.gain = np.zeros(len(self.inputs)), t0, (parameters or {}).get("gain", 1.0)
        return np.array([*self.x, self.t])

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.diary.append(("step", *u.tolist(), h))
        self.x, self.t = self.x + self.gain * u * h, self.t + h
        return np.array([*self.x, self.t])

    def set_parameters(self, parameters: Mapping[str, float]) -> None:
        self.diary.append(("set", dict(parameters)))
        self.gain = parameters["gain"]


@dataclass(kw_only=True)
class Scripted(Controller):
    """Plays inputs from a list, the last one for ever, and keeps what it sees."""

    script: list[list[float]] = field(default_factory=lambda: [[1.0]])
    horizon: int = 2
    diary: list[Call] = field(default_factory=list)

    def start(self, loop: Loop) -> None:
        self.loop, self.samples = loop, []  # type: ignore[var-annotated]
        self.diary.append(("start",))

    def step(self, sample: Sample) -> FloatArray:
        self.samples.append(sample)
        self.diary.append(("decide", sample.k))
        return np.array(self.script[min(sample.k, len(self.script) - 1)])


def close_loop(plant: Plant, controller: Controller, **settings: object) -> Trace:
    arguments: dict[str, object] = {
        "sampling_time": 0.5,
        "duration": 2.0,
        "reference": Constant(0.0),
        "outputs": ["x0"],
    }
    return cosimulate(plant, controller, **(arguments | settings))  # type: ignore[arg-type]


def test_plant_and_controller_are_called_in_the_order_of_the_contract() -> None:
    diary: list[Call] = []
    trace = close_loop(
        Integrators(diary=diary),
        Scripted(diary=diary, script=[[1.0], [2.0], [-1.0]]),
        duration=1.0,
        parameters={"gain": 3.0},
        start_time=7.0,
    )
    assert diary == [
        ("reset", {"gain": 3.0}, 7.0),
        ("start",),
        ("decide", 0),
        ("step", 1.0, 0.5),
        ("decide", 1),
        ("step", 2.0, 0.5),
        ("decide", 2),
    ]
    assert np.array_equal(trace.u[:, 0], [1.0, 2.0, -1.0])
    assert np.array_equal(trace.y[:, 0], [0.0, 1.5, 4.5])


@example(3000, 0.1, -1e3)
@given(st.integers(1, 300), st.sampled_from([0.1, 0.3, 1e-3, 7.0]), st.floats(-1e3, 1e3))
def test_n_steps_give_n_plus_one_rows_at_computed_times(n: int, h: float, t0: float) -> None:
    @dataclass(kw_only=True)
    class Silent(Controller):
        def start(self, loop: Loop) -> None:
            pass

        def step(self, sample: Sample) -> FloatArray:
            return np.zeros(1)

    trace = close_loop(Integrators(), Silent(), sampling_time=h, duration=n * h, start_time=t0)
    assert trace.completed
    assert len(trace) == trace.planned_samples == n + 1
    assert np.array_equal(trace.time, t0 + np.arange(n + 1) * h)


@given(st.integers(1, 6), st.integers(1, 8))
def test_the_controller_sees_the_references_of_the_samples_to_come(horizon: int, steps: int) -> None:
    controller = Scripted(horizon=horizon)
    close_loop(
        Integrators(),
        controller,
        duration=0.5 * steps,
        reference=Ramp(0.0, 100.0, 0.0, 100.0),
        start_time=1.0,
    )
    for sample in controller.samples:
        expected = 1.0 + 0.5 * (sample.k + 1 + np.arange(horizon))
        assert np.allclose(sample.reference, expected[:, np.newaxis])


@given(st.integers(0, 6), st.none() | st.integers(0, 9), st.integers(1, 8))
def test_beyond_the_preview_the_last_reference_that_is_known_is_held(
    horizon: int, preview: int | None, steps: int
) -> None:
    controller = Scripted(horizon=horizon)
    ramp = Ramp(0.0, 100.0, 0.0, 100.0)
    trace = close_loop(Integrators(), controller, duration=0.5 * steps, reference=ramp, preview=preview)
    seen = horizon if preview is None else min(horizon, preview)
    assert controller.loop.preview == trace.preview == seen
    for sample in controller.samples:
        ahead = [min(i, seen) for i in range(1, horizon + 1)]
        assert np.allclose(sample.setpoint, [0.5 * sample.k])
        assert sample.reference.shape == (horizon, 1)
        assert np.allclose(sample.reference[:, 0], [0.5 * (sample.k + i) for i in ahead])


@pytest.mark.parametrize("learns", [False, True])
def test_what_a_controller_goes_by_is_kept(learns: bool) -> None:
    @dataclass(kw_only=True)
    class Telling(Scripted):
        @property
        def uses_recording(self) -> bool:
            asked.append(learns)
            return learns

        def knowledge(self, loop: Loop) -> Mapping[str, str]:
            assert loop is self.loop
            return {"measures": loop.outputs[0].name, "plant": "a \ud800 of it"}

    asked: list[bool] = []
    trace = close_loop(Integrators(), Telling(), excitation=UniformRandom((-1.0,), (1.0,), 7))
    assert asked == [learns]
    assert trace.knowledge == {"measures": "x0", "plant": "a ? of it"}
    assert trace.recorded_samples == (7 if learns else 0)
    assert close_loop(Integrators(), Scripted()).knowledge == {}


@pytest.mark.parametrize("preview", [0, 1, 2, None])
def test_a_stabilising_controller_sees_no_further_either(preview: int | None) -> None:
    stabiliser = Scripted(horizon=3)
    record(
        Integrators(),
        UniformRandom(-1.0, 1.0, 4),
        sampling_time=0.5,
        stabiliser=stabiliser,
        reference=Ramp(0.0, 100.0, 0.0, 100.0),
        outputs=["x0"],
        preview=preview,
    )
    seen = 3 if preview is None else preview
    assert stabiliser.loop.preview == seen
    for sample in stabiliser.samples:
        assert sample.reference[:, 0].tolist() == [0.5 * (sample.k + min(i, seen)) for i in (1, 2, 3)]


@pytest.mark.parametrize("preview", [-1, 1.5, "horizon", True])
def test_a_preview_is_a_number_of_samples(preview: Any) -> None:
    with pytest.raises(ConfigError, match=r"preview = .* is not possible; allowed: an integer >= 0, or None"):
        close_loop(Integrators(), Scripted(), preview=preview)


def test_the_trace_holds_the_reference_of_its_own_rows() -> None:
    trace = close_loop(Integrators(), Scripted(), reference=Steps([0.0, 1.0], [5.0, 6.0]))
    assert np.array_equal(trace.reference[:, 0], [5.0, 5.0, 6.0, 6.0, 6.0])


def test_controllers_cannot_change_the_reference() -> None:
    class Vandal(Scripted):
        def step(self, sample: Sample) -> FloatArray:
            sample.reference[:] = 0.0
            return np.ones(1)

    trace = close_loop(Integrators(), Vandal())
    assert "read-only" in trace.reason


def test_inputs_are_clipped_at_the_bounds_and_the_trace_says_so() -> None:
    script = [[9.0], [-9.0], [1.5], [-1.0], [0.5]]
    trace = close_loop(Integrators(), Scripted(script=script), bounds={"u0": (-1.0, 1.5)})
    assert np.array_equal(trace.u[:, 0], [1.5, -1.0, 1.5, -1.0, 0.5])
    assert trace.status == (CLIPPED, CLIPPED, "ok", "ok", "ok")
    assert trace.failures == 2


@pytest.mark.parametrize(
    ("bounds", "asked", "counts"),
    [
        ((-1.0, 1e3), 1e3 * (1 + 1e-10), False),
        ((-1.0, 1e3), 1e3 * (1 + 1e-8), True),
        ((0.0, 1e3), -1e-7, False),  # beside a limit of zero the other limit says what is small
        ((0.0, 1e3), -1e-5, True),
        ((-np.inf, 2.0), 2.0 + 1e-12, False),
        ((0.0, np.inf), -1e-300, True),
    ],
)
def test_a_rounding_error_beyond_a_bound_is_clipped_and_not_counted(
    bounds: tuple[float, float], asked: float, counts: bool
) -> None:
    trace = close_loop(Integrators(), Scripted(script=[[asked]]), bounds={"u0": bounds})
    assert bounds[0] <= trace.u[0, 0] <= bounds[1]
    assert trace.status[0] == (CLIPPED if counts else "ok")


def test_a_fallback_beyond_the_bounds_keeps_its_reason() -> None:
    class Failing(Scripted):
        def step(self, sample: Sample) -> Action:  # type: ignore[override]
            return Action(np.full(1, 9.0), "infeasible")

    trace = close_loop(Integrators(), Failing())
    assert trace.status[0] == f"infeasible; {CLIPPED}"
    assert trace.failures == len(trace)


def test_without_bounds_the_plant_s_own_hold() -> None:
    controller = Scripted(script=[[9.0]])
    assert close_loop(Integrators(), controller).u[0, 0] == 2.0
    assert controller.loop.bounds.u_max.tolist() == [2.0]
    assert controller.loop.bounds.y_max.tolist() == [np.inf]


@pytest.mark.parametrize(
    ("time", "before"),
    [(0.0, ("start",)), (0.5, ("step", 1.0, 0.5)), (0.6, ("decide", 1)), (-3.0, ("start",))],
)
def test_an_event_is_due_at_the_first_sample_at_or_after_its_time(time: float, before: Call) -> None:
    diary: list[Call] = []
    close_loop(Integrators(diary=diary), Scripted(diary=diary), events=[ParameterChange(time, {"gain": 2.0})])
    at = diary.index(("set", {"gain": 2.0}))
    first_decision = diary.index(("decide", 1 if time == 0.5 else 2 if time == 0.6 else 0))
    assert at == first_decision - 1, diary
    assert before in diary[:at]


@pytest.mark.parametrize("time", [1e6, 12345678.3])
def test_an_event_is_on_time_after_any_number_of_samples(time: float) -> None:
    """The rounding error of k * sampling_time grows with k."""
    diary: list[Call] = []
    close_loop(
        Integrators(diary=diary),
        Scripted(diary=diary),
        sampling_time=0.1,
        start_time=time - 0.5,
        duration=1.0,
        events=[ParameterChange(time, {"gain": 2.0})],
    )
    assert diary[diary.index(("set", {"gain": 2.0})) + 1] == ("decide", 5)


def test_events_happen_in_the_order_of_their_times() -> None:
    diary: list[Call] = []
    events = [ParameterChange(1.0, {"gain": 3.0}), ParameterChange(0.5, {"gain": 2.0})]
    trace = close_loop(Integrators(diary=diary), Scripted(), events=events)
    assert [call[1] for call in diary if call[0] == "set"] == [{"gain": 2.0}, {"gain": 3.0}]
    assert np.array_equal(trace.y[:, 0], [0.0, 0.5, 1.5, 3.0, 4.5])


def test_an_event_after_a_rounding_error_is_not_late() -> None:
    """3 * 0.1 is a little more than 0.3, and 0.3 / 0.1 a little less than 3."""
    diary: list[Call] = []
    close_loop(
        Integrators(diary=diary),
        Scripted(diary=diary),
        sampling_time=0.1,
        duration=1.0,
        events=[ParameterChange(0.1 + 0.2, {"gain": 2.0})],
    )
    assert diary[diary.index(("set", {"gain": 2.0})) + 1] == ("decide", 3)


def test_noise_is_on_the_measurements_and_not_on_the_outputs() -> None:
    controller = Scripted()
    trace = close_loop(
        Integrators(),
        controller,
        measurements=["x0", "clock"],
        noise=GaussianNoise({"x0": 0.1}),
        seed=3,
    )
    assert np.array_equal(trace.y[:, 0], [0.0, 0.5, 1.0, 1.5, 2.0])
    assert np.array_equal(trace.measured[:, 1], [0.0, 0.5, 1.0, 1.5, 2.0])
    deviation = trace.measured[:, 0] - trace.y[:, 0]
    assert np.all(deviation != 0.0)
    assert np.abs(deviation).max() < 0.5
    for row, sample in enumerate(controller.samples):
        assert np.array_equal(sample.measured, trace.measured[row])
        assert sample.y[0] == trace.measured[row, 0]


def test_noise_has_the_standard_deviation_it_is_given() -> None:
    trace = close_loop(
        Integrators(), Scripted(script=[[0.0]]), duration=2000.0, noise=GaussianNoise({"x0": 0.2})
    )
    noise = trace.measured[:, trace.measurements.index(Variable("x0"))]
    assert noise.std() == pytest.approx(0.2, rel=0.05)
    assert noise.mean() == pytest.approx(0.0, abs=0.02)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.0, abs=0.05)


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_a_run_is_determined_by_its_seed(seed: int, deviation: float) -> None:
    @dataclass(kw_only=True)
    class Random(Controller):
        def start(self, loop: Loop) -> None:
            self.rng = loop.rng

        def step(self, sample: Sample) -> FloatArray:
            return np.asarray(self.rng.uniform(-1.0, 1.0, 1) + sample.measured[0])

    first, second = (
        close_loop(Integrators(), Random(), seed=seed, noise=GaussianNoise({"x0": deviation}))
        for _ in range(2)
    )
    assert np.array_equal(first.u, second.u)
    assert np.array_equal(first.measured, second.measured)


def test_several_inputs_and_outputs_in_the_order_of_the_study() -> None:
    controller = Scripted(script=[[1.0, 2.0]])
    trace = close_loop(
        Integrators(2),
        controller,
        outputs=["x1", "x0"],
        measurements=["clock", "x1"],
        reference={"x0": Constant(7.0), "x1": Constant(8.0)},
    )
    assert [v.name for v in trace.outputs] == ["x1", "x0"]
    assert np.array_equal(trace.y[1], [1.0, 0.5])
    assert np.array_equal(trace.measured[1], [0.5, 1.0])
    assert np.array_equal(trace.reference[0], [8.0, 7.0])
    assert controller.samples[0].reference.shape == (2, 2)
    assert np.array_equal(trace.u[0], [1.0, 2.0])


def test_the_experiment_comes_first_and_the_loop_starts_from_rest() -> None:
    plant, controller = Integrators(), Scripted()
    excitation = UniformRandom(-1.0, 1.0, samples=6, seed=4)
    trace = close_loop(plant, controller, excitation=excitation, start_time=3.0)
    recording = controller.loop.recording
    assert recording is not None
    assert np.array_equal(recording.u, excitation.draw(1))
    assert np.allclose(recording.y[:, 0], np.concatenate([[0.0], 0.5 * np.cumsum(recording.u[:-1, 0])]))
    assert recording.measured.shape == (6, 2)
    assert recording.sampling_time == 0.5
    assert [call for call in plant.diary if call[0] == "reset"] == [("reset", {}, 0.0), ("reset", {}, 3.0)]
    assert trace.y[0, 0] == 0.0
    assert not controller.loop.continues_recording


def test_the_loop_can_go_on_where_the_experiment_ended() -> None:
    plant, controller = Integrators(), Scripted()
    excitation = UniformRandom(0.5, 1.0, samples=6)
    trace = close_loop(plant, controller, excitation=excitation, continue_recording=True)
    assert trace.y[0, 0] == pytest.approx(0.5 * excitation.draw(1).sum())
    assert controller.loop.continues_recording
    assert len([call for call in plant.diary if call[0] == "reset"]) == 1


def test_record_makes_the_experiment_of_a_loop_with_the_same_seed() -> None:
    settings = {"outputs": ["x0"], "noise": GaussianNoise({"x0": 0.1}), "seed": 9}
    excitation = UniformRandom(-1.0, 1.0, samples=5)
    alone = record(Integrators(), excitation, sampling_time=0.5, **settings)  # type: ignore[arg-type]
    controller = Scripted()
    close_loop(Integrators(), controller, excitation=excitation, **settings)
    assert controller.loop.recording is not None
    assert np.array_equal(alone.y, controller.loop.recording.y)


def test_a_recording_made_before_is_handed_on() -> None:
    recording = Recording(np.ones((4, 1)), np.ones((4, 1)), np.ones((4, 2)), 0.5)
    controller = Scripted()
    close_loop(Integrators(), controller, recording=recording)
    handed = controller.loop.recording
    assert handed is not None
    for name in ("u", "y", "measured"):
        assert np.shares_memory(getattr(handed, name), getattr(recording, name))


@pytest.mark.parametrize("name", ["u", "y", "measured"])
def test_a_controller_cannot_change_what_others_learn_from(name: str) -> None:
    class Careless(Scripted):
        def start(self, loop: Loop) -> None:
            getattr(loop.recording, name)[:] = 7.0

    recording = Recording(np.ones((4, 1)), np.ones((4, 1)), np.ones((4, 2)), 0.5)
    with pytest.raises(ControllerError, match="read-only"):
        close_loop(Integrators(), Careless(), recording=recording)
    assert np.all(getattr(recording, name) == 1.0)
    getattr(recording, name)[:] = 2.0  # it stays its owner's


def test_a_controller_can_do_with_its_sample_what_it_likes() -> None:
    class Careless(Scripted):
        def step(self, sample: Sample) -> FloatArray:
            sample.y[:] = sample.measured[:] = 7.0
            return super().step(sample)

    careful, careless = (close_loop(Integrators(), kind()) for kind in (Scripted, Careless))
    assert careless.y.tobytes() == careful.y.tobytes()
    assert careless.measured.tobytes() == careful.measured.tobytes()


def test_a_controller_cannot_move_its_limits() -> None:
    class Greedy(Scripted):
        def start(self, loop: Loop) -> None:
            loop.bounds.u_max[:] = 1e9

    with pytest.raises(ControllerError, match="read-only"):
        close_loop(Integrators(), Greedy())


def test_a_plant_can_do_with_its_inputs_what_it_likes() -> None:
    class Careless(Integrators):
        def step(self, u: FloatArray, h: float) -> FloatArray:
            y = super().step(u, h)
            u[:] = 7.0
            return y

    excitation = UniformRandom(-1.0, 1.0, 20)
    for plant in (Integrators(), Careless()):
        controller = Scripted()
        trace = close_loop(plant, controller, excitation=excitation)
        assert np.array_equal(trace.u[:, 0], np.ones(5))
        assert controller.loop.recording is not None
        assert np.array_equal(controller.loop.recording.u, excitation.draw(1))


def test_status_and_time_of_each_step_are_kept() -> None:
    class Unsure(Scripted):
        def step(self, sample: Sample) -> Action:  # type: ignore[override]
            return Action(np.ones(1), "infeasible" if sample.k == 2 else "ok")

    trace = close_loop(Integrators(), Unsure())
    assert trace.status == ("ok", "ok", "infeasible", "ok", "ok")
    assert trace.failures == 1
    assert np.all(trace.solve_time > 0.0)


def test_the_frame_has_a_column_per_signal_with_its_unit() -> None:
    frame = close_loop(Integrators(), Scripted(), measurements=["x0", "clock"]).frame()
    assert list(frame.columns) == [
        "time [s]",
        "reference x0 [1]",
        "x0 [1]",
        "clock [s]",
        "u0 [1]",
        "solve_time [s]",
        "status",
    ]
    assert len(frame) == 5


def test_an_open_loop_applies_the_signals_of_inputs_and_measures_every_output() -> None:
    diary: list[Call] = []
    plant = Integrators(2, diary, start=0.5)
    conditions = Conditions(inputs={"u1": Ramp(0.0, 1.0, 0.0, 1.0)})
    trace = cosimulate(plant, None, sampling_time=0.25, duration=1.0, reference={}, conditions=conditions)
    assert diary == [("reset", {}, 0.0)] + [("step", 0.5, 0.25 * k, 0.25) for k in range(4)]
    assert trace.completed
    assert trace.inputs == trace.outputs == ()
    assert trace.measured[:, 0].tolist() == [0.0, 0.125, 0.25, 0.375, 0.5]
    assert trace.measured[:, 1].tolist() == pytest.approx([0.0, 0.0, 0.0625, 0.1875, 0.375])
    assert trace.applied.tolist() == [[0.5, 0.25 * k] for k in range(5)]


def test_an_open_loop_needs_neither_inputs_nor_outputs() -> None:
    plant = Integrators(0)
    trace = cosimulate(plant, None, sampling_time=0.5, duration=1.0, reference={})
    assert trace.measured.tolist() == [[0.0], [0.5], [1.0]]
    plant.outputs = ()
    plant.reset = lambda *_: np.empty(0)  # type: ignore[method-assign, assignment]
    plant.step = lambda *_: np.empty(0)  # type: ignore[method-assign, assignment]
    assert len(cosimulate(plant, None, sampling_time=0.5, duration=1.0, reference={})) == 3


THREADS = """
import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits
from ddpc_cosim import Constant, Controller, Plant, UniformRandom, Variable, cosimulate, record

def threads():
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

class Lag(Plant):
    inputs, outputs = (Variable("u", min=-1.0, max=1.0),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        seen.append(threads())
        return np.zeros(1)
    def step(self, u, h):
        return np.zeros(1)

class Sees(Controller):
    def start(self, loop):
        seen.append(threads())
    def step(self, sample):
        seen.append(threads())
        if sample.k == 3:
            raise ValueError
        return np.zeros(1)

seen = []
with threadpool_limits(2, "blas"):
    before = threads()
    cosimulate(Lag(), Sees(), sampling_time=0.1, duration=1.0, reference=Constant(0.0))
    record(Lag(), UniformRandom(low=-1.0, high=1.0, samples=5), sampling_time=0.1)
    assert threads() == before, (threads(), before)
assert seen == [{1}] * 7, seen
"""


def test_linear_algebra_has_one_thread_during_a_run_as_in_a_worker() -> None:
    """And as many as before afterwards, also where the run has failed: the process is the caller's."""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
