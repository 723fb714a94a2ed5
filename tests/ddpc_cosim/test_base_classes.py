"""Base classes tell their life: which hook is called when, and how often. That is what happens."""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from studies import write

from ddpc_controllers import SPC
from ddpc_controllers.deepc import BehavioralTracking
from ddpc_cosim import (
    Bounds,
    ConfigError,
    Controller,
    FloatArray,
    Loop,
    ParameterChange,
    Plant,
    PluginError,
    Recording,
    Sample,
    Variable,
    cosimulate,
    setting,
)
from ddpc_cosim.loop.safe_calls import recording_length
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.reading import read_study

STEPS, EXPERIMENT = 5, 20
STUDY = f"""
plant = {{ name = "{__name__}:Lag" }}
loop = {{ sampling_time = 0.1, duration = {STEPS / 10} }}
reference.x = {{ kind = "constant", value = 1.0 }}
recording = {{ samples = {EXPERIMENT}, excitation.u = {{ kind = "uniform", low = -1.0, high = 1.0 }} }}
controllers.p = {{ type = "{__name__}:Proportional" }}
scenarios.nominal.loss.x = 0.5
"""


def hooks_of(kind: type[Any]) -> list[str]:
    """Return the hooks of a base class in the order in which its docstring tells them."""
    return re.findall(r"^ +\d+\. ``(\w+)``, ", kind.__doc__ or "", re.MULTILINE)


class Told:
    """Notes each time that a hook of its base class is asked for."""

    calls: ClassVar[list[str]] = []
    base: ClassVar[type[Any]]
    also: ClassVar[tuple[str, ...]] = ()

    def __getattribute__(self, name: str) -> Any:
        kind = type(self)
        if name in (*hooks_of(kind.base), *kind.also):
            kind.calls.append(name)
        return super().__getattribute__(name)


class Lag(Told, Plant):
    calls, base = [], Plant
    inputs, outputs = (Variable("u"),), (Variable("x"),)

    def reset(self, parameters: Any = None, t0: float = 0.0) -> FloatArray:
        self.x = np.zeros(1)
        return self.x.copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.x = self.x + h * (u - self.x)
        return self.x.copy()

    def set_parameters(self, parameters: Any) -> None: ...


@dataclass(kw_only=True)
class Proportional(Told, Controller):
    calls, base, also = [], Controller, ("recording_length",)
    uses_recording: ClassVar[bool] = True
    accepts_missing: ClassVar[bool] = True

    gain: float = setting(1.0, doc="gain")

    def start(self, loop: Loop) -> None: ...

    def step(self, sample: Sample) -> FloatArray:
        return np.nan_to_num(self.gain * (sample.setpoint - sample.y))


@dataclass(kw_only=True)
class Windows(Told, SPC):
    calls, base = [], BehavioralTracking


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    yield
    for kind in (Lag, Proportional, Windows):
        kind.calls.clear()


def test_a_controller_and_a_plant_in_a_study(tmp_path: Path) -> None:
    resolved = read_study(str(write(tmp_path, STUDY))).problem
    assert set(Proportional.calls) == {"settings", "uses_recording", "horizon", "recording_length"}
    (case,) = cases_of(resolved, resolved.plant.built())
    Proportional.calls.clear()
    Lag.calls.clear()
    assert run_case(case).outcome == "completed"
    assert list(dict.fromkeys(Proportional.calls)) == hooks_of(Controller)
    count = Counter(Proportional.calls)
    assert count.pop("horizon") > 1
    assert count.pop("step") == STEPS + 1
    assert count == dict.fromkeys(count, 1)
    experiment, run = ["plan", "reset", *EXPERIMENT * ["step"]], ["plan", "reset", *STEPS * ["step"]]
    assert Lag.calls == [*experiment, *run, "provenance", "close"]


def test_a_plant_whose_parameters_change() -> None:
    plant = Lag()
    changes = [ParameterChange(0.0, {"gain": 1.0}), ParameterChange(0.2, {"gain": 2.0})]
    cosimulate(plant, None, sampling_time=0.1, duration=0.3, reference={}, events=changes)
    plant.close()
    assert list(dict.fromkeys(Lag.calls)) == hooks_of(Plant)
    begin, step = ["plan", "reset", "set_parameters"], ["step"]
    assert Lag.calls == [*begin, *step, *step, "set_parameters", *step, "provenance", "close"]


def loop_of(samples: int) -> Loop:
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (samples, 1))
    y = np.zeros_like(u)
    for k in range(1, samples):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    inputs, outputs = (Variable("u", min=-2.0, max=2.0),), (Variable("y"),)
    limits = Bounds(*(np.array([value]) for value in (-2.0, 2.0, -np.inf, np.inf)))
    recording = Recording(u, y, y, 0.1)
    return Loop(0.1, inputs, outputs, outputs, limits, recording, np.random.default_rng(0), 5)


def test_a_method_on_recorded_windows() -> None:
    controller, loop = Windows(), loop_of(60)
    assert Windows.calls == ["_faults_between_settings"]
    controller.start(loop)
    assert list(dict.fromkeys(Windows.calls)) == hooks_of(BehavioralTracking)
    assert len(hooks_of(BehavioralTracking)) == 7
    count = Counter(Windows.calls)
    assert {hook for hook, times in count.items() if times > 1} == {"_sums_g"}
    Windows.calls.clear()
    y, reference = np.zeros(1), np.ones((5, 1))
    for k in range(3):
        controller.step(Sample(k, 0.1 * k, y, y, reference, reference[0]))
    assert Windows.calls == []
    controller.start(loop)
    assert Counter(Windows.calls) == count - Counter(["_faults_between_settings"])


class Fixed(Proportional):
    recording_length = np.int64(40)  # type: ignore[assignment]


class Counted(Proportional):
    """It was written before there were known disturbances."""

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> Any:
        return np.array([7, 9]).max() * inputs


class Disturbed(Counted):
    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> Any:
        return super().recording_length(inputs, outputs, measurements, disturbances) + 5 * disturbances


class Static(Proportional):
    @staticmethod
    def recording_length(inputs: int, outputs: int, measurements: int) -> int:  # type: ignore[override]
        return 9 * inputs


class OfClass(Proportional):
    @classmethod
    def recording_length(cls, inputs: int, outputs: int, measurements: int) -> int:  # type: ignore[override]
        return 9 * inputs


class Lengths:
    """A mixin, which knows nothing of controllers."""

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        return 9 * inputs


class Mixed(Lengths, Proportional):
    pass


class Derived(Fixed):
    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        return 2 * super().recording_length(inputs, outputs, measurements)


@pytest.mark.parametrize(("kind", "samples"), [(Fixed, 40), (Counted, 18), (Derived, 80), (Proportional, 0)])
def test_a_recording_length_is_any_integer_or_declared_as_one(kind: type[Controller], samples: int) -> None:
    """Whoever holds the controller calls it all the same."""
    needed = recording_length(kind(), 2, 1, 1)
    assert (needed, type(needed)) == (samples, int)
    assert kind().recording_length(2, 1, 1) == samples


@pytest.mark.parametrize(
    ("kind", "samples"),
    [
        (Fixed, 40),
        (Counted, 18),
        (Derived, 80),
        (Proportional, 0),
        (Disturbed, 33),
        (Static, 18),
        (OfClass, 18),
        (Mixed, 18),
    ],
)
def test_who_does_not_ask_for_disturbances_needs_no_more_for_them(
    kind: type[Controller], samples: int
) -> None:
    assert recording_length(kind(), 2, 1, 1, 3) == samples


def test_a_study_is_told_of_a_recording_that_is_too_short_for_an_integer(tmp_path: Path) -> None:
    path = tmp_path / "life.toml"
    path.write_text(STUDY.replace(":Proportional", ":Fixed"), encoding="utf-8")
    with pytest.raises(ConfigError, match="20 is too short for p, which needs 40"):
        read_study(str(path))


@pytest.mark.parametrize(
    ("keyword", "hint"),
    [
        ("at_least", 'did you mean "low"?'),
        ("maximum", 'did you mean "high"?'),
        ("one_of", 'did you mean "choices"?'),
        ("units", 'did you mean "unit"?'),
        ("zzz", "there are: above, below, choices, default"),
    ],
)
def test_an_unknown_keyword_of_a_setting_is_told_with_the_one_that_may_be_meant(
    keyword: str, hint: str
) -> None:
    with pytest.raises(TypeError, match=re.escape(f"setting() has no keyword {keyword}; {hint}")):
        setting(1, doc="a number", **{keyword: 1})


def test_the_words_reach_whoever_loads_the_plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "from ddpc_cosim import Controller, setting\nclass Mine(Controller):\n"
    (tmp_path / "mine_at_least.py").write_text(f"{text}    gain = setting(1, at_least=1, doc='')\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PluginError, match='no keyword at_least; did you mean "low"'):
        load_plugin("controllers", "mine_at_least:Mine")
