"""What goes wrong in a loop: before the first sample it is an error, after that an outcome."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from ddpc_cosim import (
    Action,
    ConfigError,
    Constant,
    Controller,
    ControllerError,
    DataError,
    FloatArray,
    GaussianNoise,
    Loop,
    Outcome,
    ParameterChange,
    Plant,
    Price,
    Recording,
    Reference,
    Sample,
    SignalFromFile,
    Sum,
    Trace,
    UniformRandom,
    Variable,
    cosimulate,
    record,
)

Arrays = tuple[FloatArray, FloatArray, FloatArray]


class Doubler(Plant):
    """Two signals that double at every step; infinite after about 1000 of them."""

    inputs = (Variable("push", min=-1.0, max=1.0),)
    outputs = (Variable("a"), Variable("b"))

    def reset(self, parameters: Mapping[str, float] | None = None, t0: float = 0.0) -> FloatArray:
        self.y = np.array([1.0, 1e300])
        return self.y.copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        with np.errstate(over="ignore"):
            self.y = self.y * 2.0
        return self.y.copy()


@dataclass(kw_only=True)
class Answering(Controller):
    """Answers with what it is given; the third answer may be another one."""

    third: Any = 0.5

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> FloatArray:
        answer = self.third if sample.k == 2 else np.array([0.5])
        if isinstance(answer, BaseException):
            raise answer
        return answer


class Strange(Reference):
    """Answers with what it is given."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def at(self, time: FloatArray) -> FloatArray:
        answer: FloatArray = self.answer + np.zeros(1)
        return answer


A_RECORDING = Recording(np.ones((3, 1)), np.ones((3, 1)), np.ones((3, 1)), 0.5)


def close_loop(controller: Controller, **settings: Any) -> Trace:
    arguments: dict[str, Any] = {
        "sampling_time": 0.5,
        "duration": 2.0,
        "reference": Constant(0.0),
        "outputs": ["a"],
        "measurements": ["a"],
    }
    return cosimulate(Doubler(), controller, **(arguments | settings))


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (ZeroDivisionError("by zero"), "Answering.step raised ZeroDivisionError: by zero"),
        (np.array([np.nan]), "Answering.step returned [nan], shape (1,); needed: finite values, shape (1,)"),
        (np.array([np.inf]), "returned [inf], shape (1,)"),
        (np.zeros(2), "returned [0.0, 0.0], shape (2,)"),
        (0.5, "returned 0.5, shape ()"),
        (None, "returned None, shape ()"),
        ("much", "returned 'much', shape ()"),
        (["0.5"], "returned ['0.5'], shape (1,)"),
        (np.array([0.5 + 1j]), "returned [(0.5+1j)], shape (1,)"),
        (np.zeros(1000), "returned [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, ...], shape (1000,)"),
        ([[0.5], [0.5, 0.5]], "Answering.step raised ValueError"),
        (SystemExit("enough"), "Answering.step raised SystemExit: enough"),
        (RecursionError("too deep"), "Answering.step raised RecursionError: too deep"),
        (MemoryError(), "Answering.step raised MemoryError"),
    ],
)
def test_a_controller_that_fails_ends_the_run_and_its_samples_are_kept(answer: Any, words: str) -> None:
    trace = close_loop(Answering(third=answer))
    assert trace.outcome is Outcome.CONTROLLER_ERROR
    assert words in trace.reason
    assert trace.reason.endswith(" at t = 1 s")
    assert np.array_equal(trace.y[:, 0], [1.0, 2.0, 4.0])
    assert np.array_equal(trace.u[:, 0], [0.5, 0.5, np.nan], equal_nan=True)
    assert trace.status == ("ok", "ok", "error")
    assert trace.held == 2
    assert trace.failures == 0, "it returned no substitute either"


def test_a_plant_that_diverges_ends_the_run(recwarn: pytest.WarningsRecorder) -> None:
    """Signals that are not measured count too: the plant is not where its equations say it is."""
    trace = close_loop(Answering(third=np.array([0.5])), duration=100.0)
    assert trace.outcome is Outcome.DIVERGED
    assert trace.reason == "output b is inf at t = 14 s"
    assert len(trace) == 28
    assert trace.time[-1] == 13.5
    assert np.isfinite(trace.y).all()


@dataclass(kw_only=True)
class Failing(Controller):
    """Fails at the start."""

    error: Any = None

    def start(self, loop: Loop) -> None:
        raise self.error

    def step(self, sample: Sample) -> FloatArray:
        raise AssertionError


def test_an_error_of_the_start_is_raised() -> None:
    with pytest.raises(ControllerError, match=r"Failing\.start raised KeyError: 'x'"):
        close_loop(Failing(error=KeyError("x")))
    with pytest.raises(DataError, match="too short"):
        close_loop(Failing(error=DataError("too short")))


@pytest.mark.parametrize(
    ("settings", "faults"),
    [
        ({"outputs": ["c"], "measurements": ["d"]}, ['no signal "c"', 'no signal "d"']),
        ({"sampling_time": 0.0}, ["sampling_time = 0.0 is not possible; allowed: a number > 0"]),
        ({"sampling_time": np.nan}, ["sampling_time = nan"]),
        ({"duration": 0.7}, ["duration = 0.7 must be a whole multiple of sampling_time = 0.5"]),
        ({"duration": np.inf}, ["duration = inf"]),
        ({"duration": 0.0}, ["duration = 0"]),
        (
            {"bounds": {"push": (1.0, 1.0), "a": (2.0, -2.0)}},
            ["bounds of push: min (1) must be below max (1)", "bounds of a: min (2) must be below max (-2)"],
        ),
        ({"bounds": {"pull": (0, 1)}}, ['bounds: no signal "pull"; there are: a, push']),
        ({"noise": GaussianNoise({"b": 1.0})}, ['noise: no signal "b"; there are: a']),
        ({"reference": {"b": Constant(1.0)}}, ['reference: no signal "b"']),
        ({"reference": {}}, ["reference: none for a"]),
        ({"outputs": ["a", "b"]}, ["reference: give one for each output: a, b"]),
        ({"continue_recording": True}, ["continue_recording needs an excitation"]),
        ({"events": [ParameterChange(0.0, {"gain": 1.0})]}, ["Doubler: no tunable parameters (gain)"]),
        (
            {"events": [ParameterChange(time, {"gain": 1.0}) for time in (2.0, 99.0, np.nan)]},
            [
                "events: at t = 2 s it would not happen: the run ends at t = 2 s; choose an earlier",
                "events: at t = 99 s it would not happen",
                "events: at t = nan s it would not happen",
            ],
        ),
        ({"duration": 1e300}, ["duration / sampling_time = 2e+300 samples; allowed: 1 to 1e+08"]),
        ({"sampling_time": "0.5"}, ["sampling_time = 0.5 is not possible"]),
        ({"start_time": np.nan}, ["start_time = nan is not possible; allowed: a finite number"]),
        ({"start_time": 1e17}, ["start_time = 1e+17 is too large: samples 0.5 s apart coincide there"]),
        ({"seed": -1}, ["seed = -1 is not possible; allowed: an integer >= 0"]),
        ({"seed": 0.5}, ["seed = 0.5 is not possible"]),
        ({"outputs": "a"}, ["outputs = 'a' is not possible; needed: a list of names"]),
        ({"outputs": [1]}, ["outputs = [1] is not possible; needed: a list of names"]),
        ({"outputs": ["a", "a"]}, ['outputs: "a" is listed more than once']),
        ({"measurements": ["a", "b", "a"]}, ['measurements: "a" is listed more than once']),
        (
            {"bounds": {"push": 1.0, "a": (0.0, 1.0, 2.0)}},
            ["bounds of push: needed: two numbers, got 1.0", "bounds of a: needed: two numbers, got (0.0,"],
        ),
        ({"reference": Constant(np.nan)}, ["reference of a: nan at t = 0 s; needed: finite"]),
        ({"reference": Strange(np.zeros(1))}, ["reference of a: has shape (1,); needed: (6,)"]),
        ({"reference": Strange(None)}, ["reference of a: TypeError: "]),
        (
            {"recording": A_RECORDING, "excitation": UniformRandom(-1.0, 1.0, 9)},
            ["give an excitation or a recording, not both"],
        ),
        (
            {"excitation": UniformRandom((-1, -1), 1, 9)},
            ["uniform excitation: low = (-1, -1); needed: a num"],
        ),
    ],
)
def test_what_does_not_fit_is_refused(settings: dict[str, Any], faults: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        close_loop(Answering(), **settings)
    assert len(caught.value.faults) == len(faults)
    for fault, expected in zip(caught.value.faults, faults, strict=True):
        assert expected in fault


def test_a_controller_that_learns_from_a_recording_needs_one() -> None:
    class Learner(Answering):
        uses_recording: ClassVar[bool] = True

    with pytest.raises(DataError, match="Learner learns from a recording; give an excitation or a recording"):
        close_loop(Learner())


@pytest.mark.parametrize(
    ("settings", "fault"),
    [({"seed": -1}, "seed = -1 is not possible"), ({"sampling_time": 0.0}, "sampling_time = 0.0 is not pos")],
)
def test_an_experiment_is_checked_too(settings: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        record(Doubler(), UniformRandom(-1.0, 1.0, 9), **({"sampling_time": 0.5} | settings))


def test_a_recording_of_another_loop_is_refused() -> None:
    other = Recording(np.ones((3, 2)), np.ones((3, 1)), np.ones((3, 4)), 0.1)
    with pytest.raises(DataError) as caught:
        close_loop(Answering(), recording=other)
    assert str(caught.value) == (
        "recording: it does not fit the loop: it has 2 inputs, the loop 1; 4 measurements, the loop 1; "
        "sampling time 0.1 s, the loop 0.5 s"
    )


def test_a_status_that_no_file_can_hold_is_kept_as_far_as_one_can() -> None:
    trace = close_loop(Answering(third=Action(np.array([0.5]), "odd \ud800")))
    assert trace.completed
    assert trace.status == ("ok", "ok", "odd ?", "ok", "ok")


@pytest.mark.parametrize("horizon", [-1, 2.5, "5", None, True])
def test_a_horizon_is_a_number_of_samples(horizon: Any) -> None:
    class Strange(Answering):
        pass

    Strange.horizon = horizon
    with pytest.raises(
        ControllerError, match=r"Strange\.horizon = .* is not possible; allowed: an integer >= 0"
    ):
        close_loop(Strange())


@pytest.mark.parametrize(
    ("info", "words"),
    [
        ({"cost": "low"}, "Answering.step: info['cost'] = 'low' is not a number; allowed: finite ones, NaN"),
        ({"cost": None}, "info['cost'] = None is not a number"),
        ({"cost": np.inf}, "info['cost'] = inf is not a number"),
        ({"cost": 10**400}, "is not a number"),
        ({"cost": 1j}, "info['cost'] = 1j is not a number"),
        ({"cost": np.ones(1)}, "info['cost'] = array([1.]) is not a number"),
        ({"": 1.0}, "info[''] needs another name: 1 to 100 printable characters"),
        ({"a\nb": 1.0}, "needs another name"),
        ({3: 1.0}, "info[3] needs another name"),
        ({f"n{i}": 1.0 for i in range(65)}, 'info: "n64" is one name too many; allowed: 64 in a run'),
        ([1.0], "Answering.step raised AttributeError"),
    ],
)
def test_what_a_controller_says_of_a_step_is_in_numbers(info: Any, words: str) -> None:
    trace = close_loop(Answering(third=Action(np.array([0.5]), info=info)))
    assert trace.outcome is Outcome.CONTROLLER_ERROR
    assert words in trace.reason
    assert trace.reason.endswith("at t = 1 s")
    assert len(trace) == 3


def test_what_a_controller_says_of_its_steps_is_kept() -> None:
    said = {"cost": np.float32(0.25), "on": True, "count": 3, "unknown": np.nan}
    trace = close_loop(Answering(third=Action(np.array([0.5]), info=said)))
    assert trace.completed
    expected = {"cost": 0.25, "on": 1.0, "count": 3.0, "unknown": np.nan}
    nothing = np.nan
    for name, value in expected.items():
        np.testing.assert_array_equal(trace.info[name], [nothing, nothing, value, nothing, nothing])
        np.testing.assert_array_equal(trace.columns()[f"info.{name}"], trace.info[name])


def test_a_horizon_stays_when_the_controller_is_started() -> None:
    class Late(Answering):
        def start(self, loop: Loop) -> None:
            super().start(loop)
            self.horizon = 8

    with pytest.raises(ControllerError, match=r"Late\.start changed horizon from 1 to 8; set it before"):
        close_loop(Late())


@pytest.mark.parametrize(
    ("diagnostics", "words"),
    [
        ({"rank": "full"}, "Talkative.diagnostics raised ValueError: could not convert string to float"),
        ({"rank": None}, "Talkative.diagnostics raised TypeError"),
        (None, "Talkative.diagnostics raised AttributeError"),
    ],
)
def test_diagnostics_that_are_none_cost_no_samples(diagnostics: Any, words: str) -> None:
    class Talkative(Answering):
        def diagnostics(self) -> Any:
            return diagnostics

    trace = close_loop(Talkative(third=np.array([0.5])))
    assert trace.outcome is Outcome.CONTROLLER_ERROR
    assert trace.reason.startswith(f"after the last sample: {words}")
    assert len(trace) == 5


def test_settings_that_cannot_be_told_are_an_error() -> None:
    class Silent(Answering):
        def settings(self) -> Any:
            raise KeyError("x")

    with pytest.raises(ControllerError, match=r"Silent\.settings raised KeyError: 'x'"):
        close_loop(Silent())


def test_a_plant_that_diverges_during_the_experiment_gives_no_recording() -> None:
    with pytest.raises(DataError, match=r"diverged during the open-loop experiment, at t = 14 s"):
        close_loop(Answering(), excitation=UniformRandom(-1.0, 1.0, 200))


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ((np.ones(3), np.ones((3, 1)), np.ones((3, 1))), "need shapes"),
        ((np.ones((3, 1)), np.ones((4, 1)), np.ones((3, 1))), "need shapes"),
        ((np.ones((3, 1)), np.full((3, 1), np.nan), np.ones((3, 1))), r"y\[0, 0\] is not finite"),
    ],
)
def test_a_recording_that_cannot_be_used_is_refused(arrays: Arrays, words: str) -> None:
    with pytest.raises(DataError, match=words):
        Recording(*arrays, 0.1)


ENTRIES_OF_OTHER_KINDS: list[tuple[dict[str, Any], str]] = [
    (
        {"disturbances": {"push": "perfect"}},
        "disturbances: push = 'perfect'; needed: a KnownDisturbance, such as "
        'KnownDisturbance(known="perfect")',
    ),
    (
        {"disturbances": {"push": Constant(1.0)}},
        "disturbances: push = Constant(value=1.0); needed: a KnownDisturbance, such as "
        "KnownDisturbance(signal=...)",
    ),
    ({"disturbances": ["push"]}, "disturbances = ['push']; needed: for each name a KnownDisturbance"),
    (
        {"recorded_disturbances": {"push": 2.0}},
        "recorded_disturbances: push = 2.0; needed: a signal of time, such as Constant(2)",
    ),
    (
        {"prices": {"e": 3.0}},
        'prices: e = 3.0; needed: a Price, such as Price(signal="...", price=3, unit="EUR/kWh")',
    ),
    (
        {"forecast_horizon": -1},
        "forecast_horizon = -1 is not possible; allowed: an integer >= 0, or None: that of the controller",
    ),
    (
        {"recording_start": float("nan")},
        "recording_start = nan is not possible; allowed: a finite number, or None: where the default "
        "begins it",
    ),
    ({"warm_up": -0.5}, "warm_up = -0.5 is not possible; allowed: a number >= 0"),
    (
        {"reference": {"a": 1.0}},
        "reference: a = 1.0; needed: a signal of time or a Band, such as Constant(1)",
    ),
    ({"noise": {"a": 0.1}}, "noise = {'a': 0.1}; needed: a GaussianNoise"),
    ({"conditions": {}}, "conditions = {}; needed: Conditions"),
    ({"excitation": 1.0}, "excitation = 1.0; needed: an Excitation"),
    ({"events": [1.0]}, "events: 1.0; needed: a ParameterChange"),
]


@pytest.mark.parametrize(
    ("given", "fault"),
    ENTRIES_OF_OTHER_KINDS,
    ids=lambda given: "" if isinstance(given, str) else str(*given),
)
def test_what_is_not_of_its_kind_is_named_with_what_is_needed(given: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        close_loop(Answering(), **given)
    assert caught.value.faults == (fault,)


def test_all_that_is_not_of_its_kind_is_named_at_once() -> None:
    together: dict[str, Any] = {}
    for given, _ in ENTRIES_OF_OTHER_KINDS:
        together |= given
    with pytest.raises(ConfigError) as caught:
        close_loop(Answering(), **together)
    assert len(caught.value.faults) == len(together)


def test_of_a_recording_too() -> None:
    wrong: Any = {"disturbances": {"push": 1.0}, "recording_start": float("inf"), "noise": 0.1}
    with pytest.raises(ConfigError) as caught:
        record(Doubler(), UniformRandom(-1.0, 1.0, 5), sampling_time=0.5, **wrong)
    assert len(caught.value.faults) == 3


@pytest.mark.parametrize("level", ["high", float("nan")])
def test_a_price_is_a_number_or_a_signal(level: Any) -> None:
    with pytest.raises(ConfigError, match=r"price e = .*; needed: a finite number or a signal of time"):
        close_loop(Answering(), prices={"e": Price(signal="push", price=level, unit="EUR/s")})


def test_without_a_reference_it_is_said_for_which_output() -> None:
    nothing: Any = None
    with pytest.raises(ConfigError, match="reference: none for a"):
        close_loop(Answering(), reference=nothing)


@pytest.mark.parametrize("is_part", [False, True])
def test_bounds_from_a_file_have_to_reach_over_the_run(is_part: bool, tmp_path: Path) -> None:
    """A value of the file is held as long as that of the row before it; the run ends at t = 2 s."""
    path = tmp_path / "limits.csv"
    path.write_text("time [s],push\n0,0.5\n0.5,0.7\n1,0.6\n")
    limit: Any = SignalFromFile(str(path))
    within = {"push": (-1.0, Sum((limit, Constant(0.2))) if is_part else limit)}
    with pytest.raises(
        ConfigError, match=r"bounds of push: .*csv tells it from t = 0 s to 1\.5 s; needed: from"
    ):
        close_loop(Answering(), bounds=within)
    path.write_text(path.read_text() + "1.5,0.7\n")
    assert len(close_loop(Answering(third=np.array([0.5])), bounds=within)) == 5
