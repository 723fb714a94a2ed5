"""Disturbances, inputs that no controller drives, actuators and sensors, against a simulation in NumPy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_cosim import (
    Action,
    Conditions,
    ConditionSetup,
    ConfigError,
    Constant,
    Controller,
    FloatArray,
    GaussianNoise,
    Loop,
    Plant,
    Ramp,
    Reference,
    Sample,
    Sine,
    Steps,
    Trace,
    UniformRandom,
    Variable,
    WhiteNoise,
    cosimulate,
    record,
)
from ddpc_cosim.codec import read, write
from ddpc_cosim.conditions import all_conditions, may_have
from ddpc_cosim.study.file_format.sections import ScenarioSection
from ddpc_reports.tables.settings import scenario_effects

H = 0.5
STEPS = 40
TIME = H * np.arange(STEPS + 1)
A = np.array([[0.7, 0.2], [-0.1, 0.8]])
B = np.array([[0.5, 0.1, 0.0], [0.0, 0.4, 0.2]])
REST = np.array([0.5, -0.2, 0.3])


class Linear(Plant):
    """x+ = A x + B u from zero, y = x; inputs a, b, ambient rest at 0.5, -0.2, 0.3."""

    def __init__(self) -> None:
        self.inputs = tuple(
            Variable(name, min=-2.0, max=2.0, start=start)
            for name, start in zip(("a", "b", "ambient"), REST, strict=True)
        )
        self.outputs = (Variable("x"), Variable("z"))

    def reset(self, parameters: Mapping[str, object] | None = None, t0: float = 0.0) -> FloatArray:
        self.state = np.zeros(2)
        return self.state.copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.state = A @ self.state + B @ u
        return self.state.copy()


def response(applied: FloatArray) -> FloatArray:
    """Return the outputs of the plant at all samples for what it is given, shape (K, 3)."""
    y = np.zeros((len(applied), 2))
    for k in range(len(applied) - 1):
        y[k + 1] = A @ y[k] + B @ applied[k]
    return y


@dataclass(kw_only=True)
class Script(Controller):
    """Commands what it is told and keeps what it sees."""

    script: FloatArray
    horizon: int = 0
    accepts_missing: ClassVar[bool] = True
    seen: list[Sample] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        """Nothing to check."""

    def start(self, loop: Loop) -> None:
        self.loop = loop
        self.seen.clear()

    def step(self, sample: Sample) -> FloatArray | Action:
        self.seen.append(sample)
        u: FloatArray = self.script[sample.k]
        missing = np.isnan(sample.measured).any()
        return Action(u, "without a measurement") if missing else u


class Strict(Script):
    """One that needs all measurements."""

    accepts_missing: ClassVar[bool] = False


def commands(inputs: int = 3, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(-1.9, 1.9, (STEPS + 1, inputs))


def run(conditions: Conditions | None, controller: Script | None = None, **changes: Any) -> Trace:
    inputs = 3 - len(conditions.inputs) if conditions else 3
    arguments: dict[str, Any] = {
        "sampling_time": H,
        "duration": STEPS * H,
        "reference": {"x": Constant(0.0), "z": Constant(0.0)},
    }
    return cosimulate(
        Linear(),
        controller or Script(script=commands(inputs)),
        conditions=conditions,
        **(arguments | changes),
    )


def names(variables: Sequence[Variable]) -> list[str]:
    return [variable.name for variable in variables]


def test_without_conditions_the_plant_is_given_what_is_commanded() -> None:
    trace = run(None)
    assert np.allclose(trace.y, response(commands()), atol=1e-12)
    assert trace.applied.shape == (STEPS + 1, 0)
    assert trace.changed_inputs == ()
    assert run(Conditions()).y.tobytes() == trace.y.tobytes()


@pytest.mark.parametrize(
    ("signal", "values"),
    [
        (Constant(0.3), np.full(STEPS + 1, 0.3)),
        (Steps([5.0, 10.0], [0.4, -0.1]), np.select([TIME < 5.0, TIME < 10.0], [0.0, 0.4], -0.1)),
        (Ramp(0.0, 1.0, 5.0, 10.0), np.clip((TIME - 5.0) / 5.0, 0.0, 1.0)),
        (Sine(0.2, 0.1), 0.2 * np.sin(0.2 * np.pi * TIME)),
        ([Constant(0.3), Sine(0.2, 0.1)], 0.3 + 0.2 * np.sin(0.2 * np.pi * TIME)),
    ],
)
def test_disturbances_are_added_to_inputs_and_outputs(signal: Any, values: FloatArray) -> None:
    """Steps are zero before the first one, unlike those of a reference."""
    at_input = run(Conditions(disturbances={"b": signal}))
    applied = commands()
    applied[:, 1] += values
    assert np.allclose(at_input.y, response(applied), atol=1e-12)
    assert np.allclose(at_input.u, commands())
    assert names(at_input.changed_inputs) == ["b"]
    assert np.allclose(at_input.applied[:, 0], applied[:, 1])

    at_output = run(Conditions(disturbances={"x": signal}))
    expected = response(commands())
    expected[:, 0] += values
    assert np.allclose(at_output.y, expected, atol=1e-12)
    assert np.array_equal(at_output.measured, at_output.y)
    assert at_output.changed_inputs == ()


def test_an_input_disturbance_is_not_limited_by_the_bounds_of_the_actuator() -> None:
    trace = run(Conditions(disturbances={"a": Constant(5.0)}), bounds={"a": (-1.0, 1.0)})
    assert trace.u[:, 0].max() == 1.0
    assert np.allclose(trace.applied[:, 0], trace.u[:, 0] + 5.0)


def test_metrics_are_those_of_the_disturbed_output_without_the_sensor_s_faults() -> None:
    conditions = Conditions(disturbances={"x": Constant(0.3)}, quantum={"x": 10.0}, loss={"x": 0.5})
    trace = run(conditions, noise=GaussianNoise({"x": 1.0}))
    expected = response(commands())[:-1, 0] + 0.3
    assert trace.metrics()["sum_abs_error.x [1]"] == pytest.approx(np.abs(expected).sum())


def test_an_input_with_a_signal_is_not_the_controller_s() -> None:
    controller = Script(script=commands(2))
    weather = Sine(0.2, 0.1, offset=-1.0)
    trace = run(Conditions(inputs={"ambient": weather}), controller)
    applied = np.column_stack([commands(2), weather.at(TIME)])
    assert np.allclose(trace.y, response(applied), atol=1e-12)
    assert names(trace.inputs) == names(controller.loop.inputs) == ["a", "b"]
    assert names(trace.changed_inputs) == ["ambient"]
    assert np.array_equal(trace.applied[:, 0], weather.at(TIME))
    assert np.array_equal(trace.frame()["applied ambient [1]"], weather.at(TIME))


def test_any_input_can_be_the_one_with_a_signal() -> None:
    trace = run(Conditions(inputs={"a": Constant(1.5)}, disturbances={"ambient": Constant(0.1)}))
    applied = np.column_stack([np.full(STEPS + 1, 1.5), commands(2)[:, 0], commands(2)[:, 1] + 0.1])
    assert np.allclose(trace.y, response(applied), atol=1e-12)
    assert names(trace.inputs) == ["b", "ambient"]
    assert names(trace.changed_inputs) == ["a", "ambient"]
    assert np.allclose(trace.applied, applied[:, [0, 2]])


@given(st.integers(0, STEPS - 1), st.integers(0, STEPS - 1))
@settings(max_examples=25)
def test_a_delay_shifts_by_its_samples_exactly(actuator: int, sensor: int) -> None:
    """Before them the input is at rest and the measurement as at the first sample."""
    conditions = Conditions(delay={"a": actuator * H, "x": sensor * H}, disturbances={"x": Constant(0.25)})
    controller = Script(script=commands())
    trace = run(conditions, controller)
    applied = commands()
    applied[:, 0] = np.concatenate([np.full(actuator, REST[0]), commands()[: STEPS + 1 - actuator, 0]])
    assert np.allclose(trace.y, response(applied) + np.array([0.25, 0.0]), atol=1e-12)
    assert trace.applied.tobytes() == (applied[:, :1] if actuator else applied[:, :0]).tobytes()
    late = np.concatenate([np.full(sensor, trace.y[0, 0]), trace.y[: STEPS + 1 - sensor, 0]])
    assert np.array_equal(trace.measured, np.column_stack([late, trace.y[:, 1]]))
    assert np.array_equal([sample.y for sample in controller.seen], trace.measured)


@given(st.floats(1e-3, 1e2), st.integers(0, 100))
@settings(max_examples=50)
def test_a_rate_limit_is_never_exceeded_and_does_nothing_within_it(rate: float, seed: int) -> None:
    script = commands(seed=seed)
    trace = run(Conditions(rate_limit={"b": rate}), Script(script=script))
    moves = np.diff(trace.applied[:, 0], prepend=REST[1])
    assert np.abs(moves).max() <= rate * H * (1 + 1e-12)
    position = REST[1]
    for k, asked in enumerate(script[:, 1]):
        wanted = asked - position
        position = asked if abs(wanted) <= rate * H else position + np.sign(wanted) * rate * H
        assert trace.applied[k, 0] == pytest.approx(position, abs=1e-12)
    assert np.array_equal(trace.u, script)
    assert trace.failures == 0


def test_the_order_is_clip_rate_limit_delay_disturbance() -> None:
    script = np.full((STEPS + 1, 3), 9.0)
    conditions = Conditions(
        rate_limit={"a": 0.4}, delay={"a": 2 * H}, disturbances={"a": Steps([3.0], [10.0])}
    )
    trace = run(conditions, Script(script=script), bounds={"a": (0.0, 1.0)})
    assert trace.u[:, 0].tolist() == [1.0] * (STEPS + 1)
    expected = [0.5, 0.5, 0.7, 0.9, 1.0, 1.0, 11.0, 11.0]
    assert trace.applied[:8, 0] == pytest.approx(expected)


def test_the_order_of_a_sensor_is_delay_noise_quantisation_loss() -> None:
    noise, seed = GaussianNoise({"x": 0.3}), 5
    plain = run(None, noise=noise, seed=seed)
    drawn = plain.measured[:, 0] - plain.y[:, 0]
    conditions = Conditions(delay={"x": H}, quantum={"x": 0.25}, loss={"x": 0.3})
    trace = run(conditions, noise=noise, seed=seed)
    late = np.concatenate([trace.y[:1, 0], trace.y[:-1, 0]])
    arrived = ~np.isnan(trace.measured[:, 0])
    expected = 0.25 * np.round((late + drawn) / 0.25)
    assert np.array_equal(trace.measured[arrived, 0], expected[arrived])
    assert 5 < np.count_nonzero(~arrived) < 20
    assert np.array_equal(trace.measured[:, 1], trace.y[:, 1])


@given(st.floats(0, 1), st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_as_many_samples_are_lost_as_the_probability_says(probability: float, seed: int) -> None:
    controller = Script(script=np.zeros((1001, 3)))
    trace = run(Conditions(loss={"z": probability}), controller, duration=1000 * H, seed=seed)
    lost = np.isnan(trace.measured[:, 1])
    assert not lost[0]
    # Six standard deviations of a binomial distribution, and two samples.
    spread = 6 * np.sqrt(1000 * probability * (1 - probability)) + 2
    assert abs(np.count_nonzero(lost) - 1000 * probability) <= spread
    assert not np.isnan(trace.measured[:, 0]).any()
    assert [status != "ok" for status in trace.status] == lost.tolist()
    assert np.array_equal([sample.y for sample in controller.seen], trace.measured, equal_nan=True)


def test_a_controller_that_needs_all_measurements_is_handed_the_last_one_and_that_is_counted() -> None:
    lost = np.isnan(run(Conditions(loss={"x": 0.4})).measured[:, 0])
    controller = Strict(script=commands())
    trace = run(Conditions(loss={"x": 0.4}), controller)
    for k in range(STEPS + 1):
        assert trace.measured[k, 0] == (trace.measured[k - 1, 0] if lost[k] else trace.y[k, 0])
        assert (trace.status[k] == "ok") == (not lost[k])
    assert trace.failures == np.count_nonzero(lost) > 5
    assert "missing" in trace.status[int(np.flatnonzero(lost)[0])]
    assert np.array_equal([sample.y for sample in controller.seen], trace.measured)


@given(st.integers(0, 2**64))
@settings(max_examples=10)
def test_a_seed_decides_all_and_no_condition_changes_what_another_draws(seed: int) -> None:
    noise = GaussianNoise({"x": 0.1})
    gusts, loss = {"a": WhiteNoise(0.2)}, {"z": 0.4}
    everything = Conditions(
        disturbances={**gusts, "b": [WhiteNoise(1.0)] * 2, "z": WhiteNoise(0.3)}, loss=loss
    )
    alone = run(Conditions(disturbances=gusts), seed=seed)
    first, second = (run(everything, noise=noise, seed=seed) for _ in range(2))
    assert first.measured.tobytes() == second.measured.tobytes()
    assert first.applied[:, 0].tobytes() == alone.applied[:, 0].tobytes()
    only_lost = run(Conditions(loss=loss), seed=seed)
    assert np.array_equal(np.isnan(first.measured), np.isnan(only_lost.measured))
    only_noise = run(None, noise=noise, seed=seed)
    drawn = [trace.measured[:, 0] - trace.y[:, 0] for trace in (first, only_noise)]
    assert np.allclose(*drawn, atol=1e-12)
    other = run(everything, noise=noise, seed=seed + 1)
    assert not np.array_equal(other.applied, first.applied)
    b = first.applied[:, 1] - first.u[:, 1]
    a = first.applied[:, 0] - first.u[:, 0]
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.7
    # Two signals of a sum are not the same one twice: that would double the deviation.
    assert 0.6 < b.std() / np.sqrt(2) < 1.5


def test_noise_as_a_disturbance_has_its_mean_and_deviation() -> None:
    values = WhiteNoise(0.3, mean=2.0, seed=4).at(np.arange(20_000.0))
    assert values.mean() == pytest.approx(2.0, abs=0.01)
    assert values.std() == pytest.approx(0.3, rel=0.02)


EXCITATION = UniformRandom([-1.9, -1.9], [1.9, 1.9], samples=STEPS + 1, seed=3)
IN_EXPERIMENT = Conditions(
    inputs={"ambient": Sine(0.2, 0.1)}, delay={"a": H, "x": H}, rate_limit={"b": 0.5}, quantum={"z": 0.1}
)


def experiment(excitation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what the plant is given in an experiment under IN_EXPERIMENT, and its outputs."""
    applied = np.column_stack([excitation, Sine(0.2, 0.1).at(TIME)])
    applied[:, 0] = np.concatenate([REST[:1], excitation[:-1, 0]])
    position = REST[1]
    for k, asked in enumerate(excitation[:, 1]):
        position += np.clip(asked - position, -0.25, 0.25)
        applied[k, 1] = position
    return applied, response(applied)


def test_actuators_sensors_and_other_inputs_are_the_same_in_the_experiment() -> None:
    """And disturbances and losses are not there: a recording is complete."""
    conditions = Conditions(
        inputs=IN_EXPERIMENT.inputs,
        delay=IN_EXPERIMENT.delay,
        rate_limit=IN_EXPERIMENT.rate_limit,
        quantum=IN_EXPERIMENT.quantum,
        disturbances={"x": Constant(1.0), "b": WhiteNoise(1.0)},
        loss={"x": 0.9},
    )
    recording = record(Linear(), EXCITATION, sampling_time=H, conditions=conditions)
    _, y = experiment(EXCITATION.draw(2))
    assert np.array_equal(recording.u, EXCITATION.draw(2))
    assert np.allclose(recording.y[:, 0], np.concatenate([y[:1, 0], y[:-1, 0]]), atol=1e-12)
    assert np.allclose(recording.y[:, 1], 0.1 * np.round(y[:, 1] / 0.1), atol=1e-9)
    assert np.array_equal(recording.measured, recording.y)


def test_an_input_may_have_another_signal_in_the_experiment() -> None:
    """On the experiment's own clock; the loop has its own."""
    loop, recorded = Steps((0.0, 3.0), (1.0, -1.0)), Ramp(0.0, 2.0, 0.0, 5.0)
    conditions = Conditions(inputs={"ambient": loop}, recorded_inputs={"ambient": recorded})
    same = Conditions(inputs={"ambient": recorded})
    recordings = [
        record(Linear(), EXCITATION, sampling_time=H, conditions=recorded_in)
        for recorded_in in (conditions, same)
    ]
    assert np.array_equal(recordings[0].y, recordings[1].y)
    trace = run(conditions, excitation=EXCITATION)
    assert np.array_equal(trace.applied[:, 0], loop.at(TIME))
    with pytest.raises(ConfigError, match="recorded_inputs of ambient: it has no signal in inputs"):
        Conditions(recorded_inputs={"ambient": recorded})


def test_the_loop_starts_from_rest_after_an_experiment_or_goes_on() -> None:
    script = commands(2)
    after = [
        run(IN_EXPERIMENT, Script(script=script), excitation=EXCITATION, continue_recording=goes_on)
        for goes_on in (False, True)
    ]
    assert after[0].y.tobytes() == run(IN_EXPERIMENT, Script(script=script)).y.tobytes()
    applied, y = experiment(EXCITATION.draw(2))
    assert after[1].applied[0, 0] == EXCITATION.draw(2)[-1, 0]
    assert after[1].applied[0, 1] == pytest.approx(
        applied[-1, 1] + np.clip(script[0, 1] - applied[-1, 1], -0.25, 0.25)
    )
    assert after[1].measured[0, 0] == pytest.approx(y[-1, 0])
    assert np.allclose(after[1].y[0], A @ y[-1] + B @ applied[-1])


def test_random_signals_of_an_experiment_and_its_loop_differ() -> None:
    seen = []

    class Diary(Linear):
        def step(self, u: FloatArray, h: float) -> FloatArray:
            seen.append(u[2])
            return super().step(u, h)

    cosimulate(
        Diary(),
        Script(script=commands(2)),
        conditions=Conditions(inputs={"ambient": WhiteNoise(1.0)}),
        excitation=EXCITATION,
        sampling_time=H,
        duration=STEPS * H,
        reference={"x": Constant(0.0), "z": Constant(0.0)},
    )
    in_experiment, in_loop = np.array(seen[: STEPS + 1]), np.array(seen[STEPS + 1 :])
    assert abs(np.corrcoef(in_experiment[:STEPS], in_loop)[0, 1]) < 0.7


class Broken(Reference):
    def at(self, time: FloatArray) -> FloatArray:
        return np.where(time < 3.0, 0.0, np.nan)


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ({"disturbances": {"w": Constant(1.0)}}, 'disturbances: no signal "w"'),
        ({"inputs": {"ambiant": Constant(1.0)}}, 'inputs: no signal "ambiant"; did you mean "ambient"'),
        ({"inputs": {name: Constant(1.0) for name in ("a", "b", "ambient")}}, "leave one to the controller"),
        ({"rate_limit": {"x": 1.0}}, 'rate_limit: no signal "x"'),
        ({"quantum": {"a": 1.0}}, 'quantum: no signal "a"'),
        ({"loss": {"a": 0.1}}, 'loss: no signal "a"'),
        ({"delay": {"y": 0.5}}, 'delay: no signal "y"'),
        (
            {"delay": {"x": 0.6}},
            "delay of x: 0.6 s is not an integer multiple of the sampling time of 0.5 s; nearest: 0.5 or 1",
        ),
        ({"delay": {"x": 20.0}}, "delay of x: 20 s is too long: the run ends after 20 s"),
        ({"disturbances": {"a": Broken()}}, "disturbances of a: nan at t = 3 s; needed: finite"),
        ({"inputs": {"ambient": Broken()}}, "inputs of ambient: nan at t = 3 s; needed: finite"),
    ],
)
def test_conditions_that_do_not_fit_the_loop_are_refused(conditions: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message.replace(".", r"\.")):
        run(Conditions(**conditions))


def test_conditions_are_given_by_name() -> None:
    with pytest.raises(ConfigError) as error:
        Conditions(delay=None, inputs="load")  # type: ignore[arg-type]
    assert error.value.faults == (
        "inputs: needed: a mapping from names of signals, got 'load'",
        "delay: needed: a mapping from names of signals, got None",
    )
    with pytest.raises(ConfigError) as error:
        Conditions(disturbances={"a": "abc"}, inputs={"ambient": [Constant(1.0)]})  # type: ignore[dict-item]
    needed = "needed: a signal of time, of a class derived from Reference"
    assert error.value.faults == (
        f"disturbances of a: {needed}, got 'abc'",
        f"inputs of ambient: {needed}, got [Constant(value=1.0)]",
    )


def test_all_impossible_values_are_told_at_once() -> None:
    with pytest.raises(ConfigError) as error:
        Conditions(
            rate_limit={"a": 0.0},
            delay={"a": -0.5, "x": float("inf")},
            quantum={"x": float("nan")},
            loss={"x": 1.5, "z": "often"},  # type: ignore[dict-item]
            disturbances={"a": 3.0},  # type: ignore[dict-item]
        )
    assert len(error.value.faults) == 7
    assert error.value.faults[0] == "rate_limit of a = 0.0 is not possible; allowed: a finite number > 0"
    assert "loss of x = 1.5 is not possible; allowed: a probability from 0 to 1" in error.value.faults


def test_all_signals_that_are_not_there_are_told_at_once() -> None:
    with pytest.raises(ConfigError) as error:
        run(Conditions(rate_limit={"p": 1.0}, delay={"q": 1.0, "x": 0.1}, loss={"r": 0.5}))
    assert len(error.value.faults) == 4


def test_a_sensor_s_fault_needs_a_measurement() -> None:
    with pytest.raises(ConfigError, match='loss: no signal "x"'):
        run(Conditions(loss={"x": 0.5}), measurements=["z"])


@given(
    st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=30),
    st.floats(0.0, 3.0),
    st.floats(-1.0, 1.0),
)
def test_backlash_is_the_play_operator(u: list[float], width: float, rest: float) -> None:
    """Its formula, sample by sample; and the plant is never further from the input than half the width."""
    kind = all_conditions()["backlash"]
    effect = kind(ConditionSetup("actuator", ("a",), np.array([width]), H, 0))
    effect.start(H * np.arange(len(u)), np.array([rest]))
    expected, v = [], rest
    for value in u:
        v = min(max(v, value - width / 2), value + width / 2)
        expected.append(v)
    played = [float(effect.apply(k, np.array([value]))[0]) for k, value in enumerate(u)]
    assert played == expected
    assert np.all(np.abs(np.array(played) - u) <= width / 2 + 1e-12)


def test_the_plant_gets_an_input_after_its_backlash() -> None:
    width, script = 0.8, commands()
    trace = run(Conditions(backlash={"a": width}), Script(script=script))
    expected, v = script.copy(), REST[0]
    for k in range(STEPS + 1):
        v = min(max(v, script[k, 0] - width / 2), script[k, 0] + width / 2)
        expected[k, 0] = v
    assert np.array_equal(trace.applied[:, 0], expected[:, 0])
    assert np.allclose(trace.y, response(expected), atol=1e-12)


def test_backlash_comes_after_the_delay_and_before_the_disturbance() -> None:
    script, width = commands(), 0.6
    conditions = Conditions(
        delay={"a": H}, backlash={"a": width}, disturbances={"a": Constant(0.25)}, rate_limit={"a": 1.0}
    )
    trace = run(conditions, Script(script=script))
    limited, late, v, expected = REST[0], REST[0], REST[0], []
    for k in range(STEPS + 1):
        before = limited
        limited = np.clip(script[k, 0], limited - 1.0 * H, limited + 1.0 * H)
        late = before
        v = min(max(v, late - width / 2), late + width / 2)
        expected.append(v + 0.25)
    assert np.allclose(trace.applied[:, 0], expected, atol=1e-12)


# A value of each kind that cannot go unnoticed.
EXAMPLES = {"rate_limit": 0.1, "delay": 2 * H, "backlash": 0.7, "quantum": 0.5, "loss": 0.6}
BUILT_IN = [name for name, kind in all_conditions().items() if kind.__module__.startswith("ddpc_cosim.")]


def test_every_built_in_condition_has_an_example_and_a_row_in_the_docs() -> None:
    page = (Path(__file__).parents[2] / "docs" / "studies.md").read_text(encoding="utf-8")
    assert EXAMPLES.keys() == set(BUILT_IN)
    assert [name for name in BUILT_IN if f"\n| `{name}` | " not in page] == []


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_condition_is_applied_said_in_a_file_and_in_python_and_told(name: str) -> None:
    """What one of them knows and another does not is found here."""
    kind, value = all_conditions()[name], EXAMPLES[name]
    signal = "a" if "actuator" in kind.places else "x"
    without, having = run(Conditions()), run(Conditions(**{name: {signal: value}}))
    changed = not np.array_equal(without.y, having.y) or not np.array_equal(
        without.measured, having.measured, equal_nan=True
    )
    assert changed, "read and not applied"
    scenario = read(ScenarioSection, {name: {signal: value}})
    assert Conditions(**scenario.effects).effects == {name: {signal: value}}
    assert write(scenario)[name] == {signal: value}
    (effect,) = scenario_effects(scenario, {})
    assert signal in effect.text
    assert f"{value:g}" in effect.text.replace(",", ".")
    words, signals = may_have(["a"], [], ["x"], ["a", "b"])[name]
    assert signal in signals
    assert words


def test_a_condition_that_is_not_installed_is_refused_with_a_hint() -> None:
    with pytest.raises(ConfigError, match=r'there is no condition backlas; did you mean "backlash"'):
        Conditions(backlas={"a": 1.0})
