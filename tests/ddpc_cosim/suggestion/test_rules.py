"""What `init` goes by, rule by rule: a plant that the rule was made for, and one that it must not catch.

The second one is near the first: whoever widens a rule meets it here.
"""

import sys
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import Plant, Variable
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.signals.signals import Steps
from ddpc_cosim.suggestion import suggest_study, write_study
from ddpc_cosim.suggestion.periods import found_at_rest
from ddpc_cosim.suggestion.response_types import ResponseType
from ddpc_cosim.suggestion.step_test import Resting, StepTest, Timing, step_test
from ddpc_cosim.suggestion.trial import tried_out
from ddpc_cosim.variables import FloatArray
from fmu_plants import Equations, Parameter, PlantModel, build_fmu

pytestmark = pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")

HOUR, DAY = 3600.0, 86400.0


def plant(
    state: Variable, inputs: tuple[Variable, ...], rate: Callable[[Any], Any], **more: Any
) -> PlantModel:
    """Return a plant with one state, which is its output."""
    return PlantModel(
        name=more.pop("name", "plant"),
        equations=lambda v: Equations({state.name: rate(v)}),
        states=(state,),
        inputs=inputs,
        outputs=(state,),
        **{"stop_time": HOUR, **more},
    )


@dataclass(frozen=True)
class Proposed:
    """What is proposed for an FMU."""

    study: Mapping[str, Any]
    text: str

    @property
    def disturbances(self) -> set[str]:
        return set(self.study.get("disturbances", {}))

    @property
    def starts(self) -> Mapping[str, float]:
        levels: Mapping[str, float] = self.study["plant"].get("start", {})
        return levels


@dataclass(frozen=True)
class Rule:
    """A rule, the plant that it was made for, the one that it must not catch, and how it shows."""

    made_for: PlantModel
    not_for: PlantModel
    shows: Callable[[Proposed], bool]


TEMPERATURE = Variable("T", "K", start=290.0)
LIMITED = Variable("QHea", "W", min=0.0, max=5e3, start=1e3)


def heated(*around: Variable, heater: Variable = LIMITED) -> PlantModel:
    """Return a body that heater and what is around it hold at its start, each of them with 100 W/K."""
    offset = TEMPERATURE.start - heater.start / 100 - sum(a.start for a in around)
    return plant(
        TEMPERATURE,
        (*around, heater),
        lambda v: (offset + v[heater.name] / 100 + sum(v[a.name] for a in around) - v.T) / 900,
    )


def forced(force: Variable, *, gain: float = 1.0, state: Variable | None = None) -> PlantModel:
    """Return a lag of 5 s behind one input."""
    y = state or Variable("y", "m")
    return plant(y, (force,), lambda v: (y.start + gain * (v[force.name] - force.start) - v[y.name]) / 5)


def opening(least: float) -> PlantModel:
    """Return a valve that opens from a signal on that declares nothing: the first guess is +-1."""
    from sympy import Max

    flow = Variable("flow", "m3/s")
    return plant(flow, (Variable("signal"),), lambda v: Max(v.signal - least, 0) - v.flow)


def warmed(state: Variable, heater: Variable) -> PlantModel:
    """Return what moves by 0.1 per kilowatt."""
    return plant(state, (heater,), lambda v: (state.start + 1e-4 * v[heater.name] - v[state.name]) / 900)


def room(around: Callable[[Any], Any]) -> PlantModel:
    """Return a room of 2 h in a temperature that depends on time."""
    state = Variable("TAir", "K", start=291.0)
    heater = Variable("QHea", "W", min=0.0, max=3e3, start=1e3)
    return plant(
        state, (heater,), lambda v: (281 + around(v.time) + v.QHea / 100 - v.TAir) / 7200, stop_time=5 * DAY
    )


def _daily(time: Any) -> Any:
    from sympy import pi, sin

    return 6 * sin(2 * pi * time / DAY)


def tank(*, two_point: bool) -> PlantModel:
    """Return a tank that runs over at 2 m; a valve empties it from 1.5 m to 0.5 m, or stays shut."""
    from sympy import Max, tanh

    level, valve = Variable("level", "m", min=0.0, start=0.2), Variable("opening")

    def equations(v: Any) -> Equations:
        # What is open stays so until the level has fallen by 1 m.
        wanted = float(two_point) * (1 + tanh(20 * (v.level - 1.5 + v.opening))) / 2
        rates = {
            "level": v.inflow - 0.04 * v.opening - Max(v.level - 2, 0),
            "opening": (wanted - v.opening) / 2,
        }
        return Equations(rates)

    return PlantModel(
        name="tank",
        equations=equations,
        states=(level, valve),
        inputs=(Variable("inflow", "m3/s", min=0.0, max=0.04, start=0.02),),
        outputs=(level,),
        stop_time=HOUR,
    )


def side_by_side() -> PlantModel:
    """Return two lags with an input each, neither of which has limits."""
    states = Variable("y1", "m"), Variable("y2", "m")
    return PlantModel(
        name="two",
        equations=lambda v: Equations({"y1": v.x1 - v.y1, "y2": (v.x2 - v.y2) / 2}),
        states=states,
        inputs=(Variable("x1", "N"), Variable("x2", "N")),
        outputs=states,
        stop_time=60.0,
    )


def acting(*names: str) -> Callable[[Proposed], bool]:
    """Return whether exactly these are proposed as disturbances."""
    return lambda proposed: proposed.disturbances == {*names}


def said(words: str) -> Callable[[Proposed], bool]:
    """Return whether a study says so in a comment."""
    return lambda proposed: words in proposed.text


def lifted(name: str) -> Callable[[Proposed], bool]:
    """Return whether an input starts elsewhere than at 0."""
    return lambda proposed: proposed.starts.get(name, 0.0) > 0.0


SWITCH = Variable("enable", min=0.0, max=1.0)
COMMAND = Variable("u", "V", min=-1.0, max=1.0)
WATTS = Variable("Q", "W")

RULES = {
    "ambient": Rule(
        heated(Variable("T_amb", "K", start=280.0)),
        # The heater of an oven has limits, and is all that there is to drive.
        forced(Variable("T_ambient_oven", "K", min=280.0, max=300.0, start=290.0)),
        acting("T_amb"),
    ),
    "load": Rule(
        plant(
            Variable("omega", "rad/s"),
            (Variable("u_a", "V", min=-9.0, max=9.0), Variable("tau_load", "N.m")),
            lambda v: 4 * v.u_a - 2 * v.tau_load - 2 * v.omega,
        ),
        forced(Variable("load", "N.m", min=0.0, max=4.0, start=2.0)),
        acting("tau_load"),
    ),
    "feed": Rule(
        heated(Variable("T_feed", "K", start=280.0)),
        forced(Variable("feed", "kg/s", min=0.0, max=4.0, start=2.0)),
        acting("T_feed"),
    ),
    "sun": Rule(
        heated(Variable("GHor", "W/m2")),
        heated(Variable("lamp", "W", min=0.0, max=300.0)),
        acting("GHor"),
    ),
    "more inputs than outputs": Rule(
        plant(
            TEMPERATURE,
            (Variable("x1", "K", start=290.0), LIMITED),
            lambda v: (v.x1 + v.QHea / 100 - 10 - v.T) / 900,
        ),
        side_by_side(),
        acting("x1"),
    ),
    "switched on": Rule(
        plant(Variable("y"), (COMMAND, SWITCH), lambda v: v.u * v.enable - v.y, stop_time=10.0),
        plant(Variable("y"), (COMMAND, SWITCH), lambda v: v.u * (1 + v.enable) - v.y, stop_time=10.0),
        lifted("enable"),
    ),
    "0 K": Rule(
        heated(Variable("T_amb", "K")),
        heated(Variable("dT_amb", "K", description="Temperature difference to the garden")),
        lifted("T_amb"),
    ),
    "0 Pa": Rule(
        plant(
            Variable("flow", "m3/s"),
            (Variable("valve", min=0.0, max=1.0, start=0.5), Variable("p_in", "Pa")),
            lambda v: (v.valve + 1e-6 * v.p_in - v.flow) / 5,
        ),
        plant(
            Variable("flow", "m3/s"),
            (
                Variable("valve", min=0.0, max=1.0, start=0.5),
                Variable("p_in", "Pa", description="Pressure relative to the air"),
            ),
            lambda v: (v.valve + 1e-6 * v.p_in - v.flow) / 5,
        ),
        lifted("p_in"),
    ),
    "a temperature from 250 K to 400 K": Rule(
        plant(TEMPERATURE, (LIMITED,), lambda v: (190 + v.QHea / 10 - v.T) / 900),
        plant(Variable("T", "K", start=1200.0), (LIMITED,), lambda v: (1100 + v.QHea / 10 - v.T) / 900),
        said("are plausible of a temperature"),
    ),
    "a range a thousand times its guess": Rule(
        opening(400.0), opening(40.0), said("that is not plausible, a thousand times the first guess")
    ),
    "a watt heats no house": Rule(
        warmed(TEMPERATURE, WATTS),
        warmed(TEMPERATURE, Variable("Q", "W", min=-1e3, max=1e3)),  # as little, and it is declared
        said("Within the ranges that were guessed first the inputs do too little: tried Q"),
    ),
    "of temperatures alone": Rule(
        warmed(TEMPERATURE, WATTS),
        warmed(Variable("x", "m", start=1.0), WATTS),
        said("Within the ranges that were guessed first the inputs do too little: tried Q"),
    ),
    "a day": Rule(room(_daily), room(lambda time: 6 * time / DAY), said("repeats every 24 h")),
    "a day on a slope": Rule(
        room(_daily), room(lambda time: _daily(time) + 12 * time / DAY), said("repeats every")
    ),
    "a tank with a two-point valve": Rule(tank(two_point=True), tank(two_point=False), said("repeats every")),
}


def proposed_for(model: PlantModel, folder: Path) -> Proposed:
    """Return what is proposed for the FMU of a plant."""
    fmu = build_fmu(model)
    path = write_study(suggest_study(fmu, trial=False, budget=600.0), fmu, folder / "study.toml")
    text = path.read_text(encoding="utf-8")
    return Proposed(tomllib.loads(text), text.replace("\n# ", " "))


@pytest.mark.parametrize("name", RULES)
def test_a_rule_catches_the_plant_that_it_was_made_for(
    name: str, own_cache_folder: None, tmp_path: Path
) -> None:
    rule = RULES[name]
    proposed = proposed_for(rule.made_for, tmp_path)
    assert rule.shows(proposed), proposed.text


@pytest.mark.parametrize("name", RULES)
def test_a_rule_does_not_catch_the_plant_beside_it(name: str, own_cache_folder: None, tmp_path: Path) -> None:
    rule = RULES[name]
    proposed = proposed_for(rule.not_for, tmp_path)
    assert not rule.shows(proposed), proposed.text


@pytest.mark.parametrize(("y_max", "is_cut"), [(12.0, True), (40.0, False)])
def test_a_setpoint_that_a_trial_was_told_is_beyond_a_limit_is_cut(
    y_max: float, is_cut: bool, own_cache_folder: None, tmp_path: Path
) -> None:
    """2 % of a step beyond where y stops: it counts as settled, and y does not go there."""
    from sympy import Max, Min

    model = PlantModel(
        name="stops",
        equations=lambda v: Equations({"x": 10 * v.push - v.x}, {"y": Max(-v.y_max, Min(v.y_max, v.x))}),
        states=(Variable("x", "m"),),
        inputs=(Variable("push", "N", min=-10.0, max=10.0),),
        outputs=(Variable("y", "m"),),
        parameters=(Parameter("y_max", "m", start=y_max),),
    )
    fmu = build_fmu(model)
    proposal = suggest_study(fmu, trial=False)
    loop = proposal.study.loop
    steps = Steps((0.0, loop.duration / 2), (-10.0, 12.4))
    proposal = proposal.changed(
        reference={"y": steps}, controllers={"pid": proposal.study.controllers["pid"]}
    )
    tried = tried_out(proposal, monotonic() + 1000.0, lambda _: None)
    text = write_study(tried, fmu, tmp_path / "study.toml").read_text(encoding="utf-8")
    assert ("y: cut to what a trial reached" in text.replace("\n# ", " ")) == is_cut
    assert (max(tried.setpoints["y"].values) < 12.0) == is_cut


class House(Plant):
    """40 000 s, in an experiment of one second; how long a step takes to compute is on a clock of its own."""

    inputs, outputs = (Variable("u"),), (Variable("y"),)

    def __init__(self, seconds_per_second: float) -> None:
        self.pace, self.clock, self.y = seconds_per_second, 0.0, 0.0

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        self.y = 0.0
        return np.zeros(1)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.clock += 1e-6 + self.pace * h
        self.y = float(u[0]) + (self.y - float(u[0])) * np.exp(-h / 4e4)
        return np.array([self.y])


@pytest.mark.parametrize(("seconds_per_second", "is_looked_at"), [(0.0, True), (1e-3, False)])
def test_what_integrates_is_looked_at_for_days_where_long_steps_take_no_longer(
    seconds_per_second: float, is_looked_at: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A solver that chooses its steps, and one that takes a thousandth of the time itself: 17 minutes."""
    house = House(seconds_per_second)
    monkeypatch.setattr(sys.modules[step_test.__module__], "monotonic", lambda: house.clock)
    timing = Timing(1e-5, longest=10.0, guess=0.06, beyond=1e6)
    tested: StepTest = step_test(house, Resting(np.zeros(1), np.ones(1)), timing)
    assert (tested.responses[0][0].type is ResponseType.SETTLED) == is_looked_at
    assert house.clock < timing.budget


class Buckets(Plant):
    """A level that fills by u each second and falls to 0 at once when it is at 1; or runs over there."""

    inputs, outputs = (Variable("u"),), (Variable("level"),)

    def __init__(self, tips: bool) -> None:
        self.tips, self.level = tips, 0.0

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        self.level = 0.0
        return np.zeros(1)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        level = self.level + float(u[0]) * h
        self.level = level % 1.0 if self.tips else min(level, 1.0)
        return np.array([self.level])


@pytest.mark.parametrize(
    ("rate", "tips", "fixed_step", "seconds"),
    [
        (0.02, True, None, 50.0),
        (0.05, True, None, 20.0),
        (0.05, True, 0.25, 20.0),
        (1e-9, True, None, 1e9),
        (1e-9, True, 0.25, 0.0),  # nobody waits for that
        (0.0, True, None, 0.0),
        (0.02, False, None, 0.0),
        (0.05, False, 0.25, 0.0),
        (1e-9, False, None, 0.0),
    ],
)
def test_what_tips_over_has_a_period_and_what_runs_over_has_none(
    rate: float, tips: bool, fixed_step: float | None, seconds: float
) -> None:
    """However slowly it fills: a ramp is much like itself a while later."""
    swing = {0: 0.1 / rate if rate else 1.0}
    period = found_at_rest(Buckets(tips), np.array([rate]), {}, swing, fixed_step, 60.0)
    assert period.seconds == pytest.approx(seconds, rel=0.02)
    assert period.means == ({0: pytest.approx(0.5, abs=0.1)} if seconds else {})
