"""Study files that are in order, and what becomes of them."""

import math
import sys
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, strategies as st
from studies import write

from ddpc_cosim import (
    PRBS,
    Band,
    Conditions,
    ConfigError,
    Constant,
    Controller,
    FloatArray,
    KnownDisturbance,
    Loop,
    ParameterChange,
    Price,
    Ramp,
    Recording,
    Sample,
    Sine,
    Steps,
    setting,
)
from ddpc_cosim.loop.master import Resumption
from ddpc_cosim.metrics import MetricSettings
from ddpc_cosim.study.cases import Case, _hash_of, cases_of, doing_nothing
from ddpc_cosim.study.file_format.sections import expand_seeds
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.variables import DisplayUnit, Variable, converter, names

TARGET = PlantSpec(name="", fmu="pendulum.fmu", content="0")

SMALL = """
[plant]
name = "pendulum"
outputs = ["angle"]
[loop]
sampling_time = 0.1
duration = 1.0
[reference]
angle = { kind = "constant", value = 10.0, unit = "deg" }
[controllers.mfapc]
type = "mfapc"
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write(tmp_path, SMALL, "my study.toml")


def cases(text: str, folder: Path) -> list[Case]:
    return cases_of(read_study(str(write(folder, text))).problem, TARGET)


def test_a_scenario_s_preview_stands_in_place_of_the_loop_s(tmp_path: Path) -> None:
    scenarios = "[scenarios.plain]\n[scenarios.blind]\npreview = 0\n[scenarios.far]\npreview = 'horizon'\n"
    for loop, plain in (("", None), ("preview = 2", 2), ('preview = "horizon"', None)):
        cases_here = cases(SMALL.replace("duration = 1.0", f"duration = 1.0\n{loop}") + scenarios, tmp_path)
        assert {case.scenario: case.preview for case in cases_here} == {
            "plain": plain,
            "blind": 0,
            "far": None,
        }
        assert len({case.id.rpartition("_")[2] for case in cases_here}) == 3


def test_the_study_of_the_paper_is_in_order() -> None:
    resolved = read_study("paper").problem
    assert resolved.study.name == "paper"
    assert resolved.study.seeds == [5489, *range(30)]
    for name in ("paper", "claims"):
        controllers = read_study(name).problem.study.controllers.values()
        sources = [
            section.tuned.source if section.tuned else "" for section in controllers if not section.variant_of
        ]
        assert all("of the paper" in source for source in sources)
    assert (names(resolved.inputs), names(resolved.outputs)) == (("torque",), ("angle",))
    assert names(resolved.measurements) == ("angle", "angular_velocity")
    assert len(cases_of(resolved, TARGET)) == 7 * 31


def test_the_paper_s_values_arrive_in_the_plant_s_units() -> None:
    deepc = next(case for case in cases_of(read_study("paper").problem, TARGET) if case.controller == "deepc")
    reference = deepc.reference["angle"].at(np.array([0.0, 10.0, 20.0, 30.0, 40.0]))
    assert np.allclose(reference, np.radians([20, -10, 10, -20, -20]), rtol=1e-15)
    assert deepc.bounds["angle"] == pytest.approx((-math.radians(70), math.radians(70)), rel=1e-15)
    assert deepc.bounds["torque"] == (-3.5, 3.5)
    assert deepc.excitation is not None
    assert (deepc.excitation.samples, deepc.seed) == (200, 5489)


def test_a_controller_may_have_limits_of_its_own() -> None:
    wkpc = next(case for case in cases_of(read_study("paper").problem, TARGET) if case.controller == "wkpc")
    assert wkpc.bounds["angle"][1] == pytest.approx(math.radians(170))
    assert wkpc.bounds["torque"] == (-3.5, 3.5)


def test_what_is_left_out_has_defaults(small: Path) -> None:
    resolved = read_study(str(small)).problem
    assert resolved.study.name == "my-study"
    assert names(resolved.inputs) == ("torque",)
    assert names(resolved.measurements) == names(resolved.outputs) == ("angle",)
    (case,) = cases_of(resolved, TARGET)
    assert (case.seed, case.scenario, case.label) == (0, "nominal", "mfapc")
    assert case.bounds["torque"] == (-math.inf, math.inf)
    assert case.section["settings"]["lambda_u"] == 0.37


def test_a_byte_order_mark_does_no_harm(small: Path) -> None:
    small.write_bytes(b"\xef\xbb\xbf" + small.read_bytes())
    assert read_study(str(small)).problem.study.controllers


def test_scenarios_give_parameters_noise_and_events(tmp_path: Path) -> None:
    text = (
        SMALL.replace("[loop]", "parameters = { mass = 1.1, damping = 0.3 }\n[loop]")
        + """
    [scenarios.nominal]
    [scenarios.windy]
    parameters = { mass = 2.0 }
    noise = { angle = 0.01 }
    events = [{ time = 0.5, parameters = { torque_gain = -1.0 } }]
    """
    )
    nominal, windy = cases(text, tmp_path)
    assert nominal.parameters == {"mass": 1.1, "damping": 0.3}
    assert windy.parameters == {"mass": 2.0, "damping": 0.3}
    assert windy.noise == {"angle": 0.01}
    assert [(event.time, event.parameters) for event in windy.events] == [(0.5, {"torque_gain": -1.0})]
    assert (nominal.name, windy.name) == ("mfapc_seed0", "mfapc_windy_seed0")


@pytest.mark.parametrize(
    ("section", "signal"),
    [
        ('{ kind = "steps", times = [0.0, 1.0], values = [1.0, 2.0] }', Steps((0.0, 1.0), (1.0, 2.0))),
        (
            '{ kind = "ramp", from_value = 0.0, to_value = 180.0, from_time = 1.0, to_time = 2.0, '
            'unit = "deg" }',
            Ramp(0.0, math.pi, 1.0, 2.0),
        ),
        (
            '{ kind = "sine", amplitude = 90.0, offset = 180.0, frequency = 2.0, phase = 1.0, unit = "deg" }',
            Sine(math.pi / 2, 2.0, math.pi, 1.0),
        ),
    ],
)
def test_references_of_every_kind(tmp_path: Path, section: str, signal: Steps) -> None:
    text = SMALL.replace('{ kind = "constant", value = 10.0, unit = "deg" }', section)
    time = np.linspace(0, 3, 31)
    assert np.allclose(cases(text, tmp_path)[0].reference["angle"].at(time), signal.at(time), atol=1e-14)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_conversion_from_a_display_unit_undoes_the_one_of_fmi(
    value: float, factor: float, offset: float
) -> None:
    unit = DisplayUnit("shown", factor, offset)
    variable = Variable("x", "own", display_unit=unit)
    converted = converter(variable, "shown")(value)
    assert factor * converted + offset == pytest.approx(value, rel=1e-9, abs=1e-6)
    assert converter(variable, "")(value) == converter(variable, "own")(value) == value


@pytest.mark.parametrize(
    ("given", "seeds"),
    [("0:3", [0, 1, 2]), (7, [7]), ([5489, "0:2", 1], [5489, 0, 1]), (["7"], [7]), (["2:4", 3], [2, 3])],
)
def test_seeds_may_be_ranges(given: object, seeds: list[int]) -> None:
    assert expand_seeds(given) == seeds


@pytest.mark.parametrize(
    "given", ["3:1", "1:1", "a:3", "1:b", "-1:3", "0:9999999999", "x", "", -1, 2**32, True, 1.0]
)
def test_what_is_neither_a_seed_nor_a_range_is_refused(given: object) -> None:
    with pytest.raises(ValueError, match=r"is not a seed; allowed: integers from 0 .* e\.g\. 0:30"):
        expand_seeds(given)


def test_only_some_cases_can_be_chosen() -> None:
    resolved = read_study("paper").problem
    assert {case.controller for case in cases_of(resolved, TARGET, [1], "deepc*")} == {
        "deepc",
        "deepc-published-code",
    }
    assert [case.name for case in cases_of(resolved, TARGET, [1, 2], "wkpc_seed2")] == ["wkpc_seed2"]
    with pytest.raises(ConfigError, match=r"--only lqr: no case matches; there are: DeePC, "):
        cases_of(resolved, TARGET, [1], "lqr")


def test_a_case_is_named_after_what_decides_its_result(tmp_path: Path) -> None:
    """A change of anything that decides the result gives another name, a change of a label does not."""
    (original,) = cases(SMALL, tmp_path)
    assert original.id.startswith("mfapc_seed0_")
    changes = [
        ("value = 10.0", "value = 11.0"),
        ("duration = 1.0", "duration = 1.1"),
        ('type = "mfapc"', 'type = "mfapc"\nsettings = { mu = 2.0 }'),
        ("[plant]", "seeds = [1]\n[plant]"),
        ("[loop]", "parameters = { mass = 2.0 }\n[loop]"),
        ("[controllers", "[bounds]\ntorque = { max = 1.0 }\n[controllers"),
        ("[loop]", 'measurements = ["angle", "angular_velocity"]\n[loop]'),
    ]
    ids = {case.id for old, new in changes for case in cases(SMALL.replace(old, new), tmp_path)}
    assert len(ids) == len(changes)
    assert original.id not in ids

    (labelled,) = cases(SMALL + 'label = "ours"\nsettings = { lambda_u = 0.37 }', tmp_path)
    assert labelled.id == original.id
    resolved = read_study(str(tmp_path / "study.toml")).problem
    (other_plant,) = cases_of(resolved, PlantSpec("", "p", content="1"))
    assert other_plant.id != original.id


RELEVANT = "\n[metrics]\nrelevant = {}"
TWO = """
plant = { name = "quadruple-tank", inputs = ["pump_1", "pump_2"], outputs = ["level_1", "level_2"] }
loop = { sampling_time = 5.0, duration = 100.0 }
reference.level_1 = { kind = "constant", value = 13.0 }
reference.level_2 = { kind = "constant", value = 13.0 }
controllers.mfac = { type = "mfac" }
"""


PRICE = """
[prices.wear]
signal = "torque"
price = 1.0
unit = "EUR/N.m.s"
"""


@pytest.mark.parametrize(
    "relevant",
    [
        "{ absolute = 0.1 }",
        "{ percent = 2 }",
        "{ absolute = 0, percent = 0 }",
        "{ absolute = { angle = 0.1 } }",
    ],
)
def test_what_difference_is_relevant_changes_no_case(relevant: str, tmp_path: Path) -> None:
    (original,) = cases(SMALL, tmp_path)
    (case,) = cases(SMALL + RELEVANT.format(relevant), tmp_path)
    assert case.id == original.id


@pytest.mark.parametrize(
    ("text", "relevant", "fault"),
    [
        (SMALL, "{}", "metrics.relevant: needs absolute or percent"),
        (SMALL, "{ percent = 101 }", "metrics.relevant.percent"),
        (SMALL, "{ absolute = -1 }", "metrics.relevant.absolute"),
        (SMALL, "{ absolute = { angel = 1 } }", 'no controlled output "angel"; did you mean "angle"'),
        (
            TWO,
            "{ absolute = 0.5 }",
            "one number for 2 controlled outputs; needed: one for each, e.g. { level_1 = 0.5 }",
        ),
        (
            TWO,
            "{ absolute = { level_1 = 0.5 } }\ncost = { outputs = { level_1 = 1 } }",
            "must be a number, as controllers are ranked by metrics.cost",
        ),
        (
            SMALL + PRICE,
            "{ absolute = 0.5 }",
            "one number for money and discomfort; needed: one for each, e.g. { money = 0.5, angle = 0.5 }",
        ),
        (
            SMALL + PRICE,
            "{ absolute = { mony = 1 } }",
            'no controlled output, or money, "mony"; did you mean "money"',
        ),
    ],
)
def test_what_cannot_be_relevant_is_refused(text: str, relevant: str, fault: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        cases(text + RELEVANT.format(relevant), tmp_path)
    assert any(fault in message for message in caught.value.faults), caught.value.faults


OTHER: dict[str, Any] = {
    "controller": "other",
    "scenario": "other",
    "section": {"type": "mfapc", "settings": {"mu": 2.0}},
    "plant": PlantSpec("", "pendulum.fmu", content="1"),
    "inputs": (Variable("other"),),
    "outputs": (Variable("other"),),
    "measurements": (Variable("other"),),
    "sampling_time": 0.2,
    "duration": 2.0,
    "start_time": 1.0,
    "continue_recording": True,
    "reference": {"angle": Steps((0.0,), (0.3,))},
    "bounds": {"angle": (-1.0, 1.0), "torque": (-1.0, 1.0)},
    "excitation": PRBS(-1.0, 1.0, 40),
    "recording": Recording(np.ones((3, 1)), np.ones((3, 1)), np.ones((3, 1)), 0.1),
    "stabiliser": {"type": "pid", "settings": {}},
    "parameters": {"mass": 2.0},
    "noise": {"angle": 0.1},
    "events": (ParameterChange(0.5, {"friction": 0.2}),),
    "preview": 3,
    "conditions": Conditions(delay={"torque": 0.1}),
    "undriven": (Variable("other"),),
    "disturbances": {"wind": KnownDisturbance(known="perfect")},
    "recorded_disturbances": {"wind": Constant(1.0)},
    "recording_start": 0.0,
    "prices": {"power": Price(signal="torque", price=1.0, unit="EUR/kWh")},
    "monitors": {"angle": Band(-1.0, 1.0), "speed": None},
    "read": (Variable("other output"),),
    "forecast_horizon": 3,
    "communication_step": 0.05,
    "warm_up": 0.5,
    "warm_up_controller": {"type": "pid", "settings": {}},
    "resumed": Resumption(b"state", 0.0),
    "replayed": "a log and the case that its controller learns in",
    "spread": (Variable("mass"),),
    "noise_mixture": ((1, 1.0),),
}
"""Another value of every field of a case that decides its result."""

SAME: dict[str, Any] = {
    "label": "other",
    "shared_bounds": {"torque": (-0.5, 0.5)},
    "id": "other",
    "problem": "other",
    "metrics": MetricSettings(preview=7),
    "step_timeout": 1.0,
    "case_timeout": 1.0,
    "memory_limit": 1.0,
    "late": "other",
    "sandbox": "other",
    "storage": "parquet",
    "keeps_state": True,
    "engine": "compiled",
}
"""Another value of every field that does not, whatever it is."""


def case_hash(case: Case) -> str:
    return _hash_of(case, {"recording": case.recording and case.recording.digest}).hexdigest()


def test_every_field_of_a_case_is_known_to_decide_its_result_or_not_to(tmp_path: Path) -> None:
    """The seed, which decides it, too, comes in the end."""
    assert {field.name for field in fields(Case)} == {*OTHER, *SAME, "seed"}
    (case,) = cases(SMALL, tmp_path)
    original = case_hash(case)
    hashes = {name: case_hash(replace(case, **{name: value})) for name, value in OTHER.items()}
    assert original not in hashes.values()
    assert len(set(hashes.values())) == len(hashes)
    assert {case_hash(replace(case, **{name: value})) for name, value in SAME.items()} == {original}
    seeds = cases(f"seeds = [0, 1]\n{SMALL}", tmp_path)
    assert seeds[0].id == case.id
    assert seeds[1].id.rpartition("_")[2] != case.id.rpartition("_")[2]


def test_doing_nothing_is_the_same_whoever_runs_beside_it(tmp_path: Path) -> None:
    """A controller's own limits, that keep it from resting, are not those of doing nothing."""
    ids = set()
    for limits in ("", "[controllers.mfapc.bounds]\ntorque = { min = 1.0, max = 2.0 }\n"):
        head = f"[bounds]\ntorque = {{ min = -3.0, max = 3.0 }}\n{SMALL}"
        text = f"{head}{limits}[controllers.pid]\ntype = 'pid'\n"
        driven = cases(text, tmp_path)
        for some in (driven, driven[1:]):
            (resting,) = doing_nothing(some)
            ids.add(resting.id)
            assert resting.bounds["torque"] == (-3.0, 3.0)
    assert len(ids) == 1


def test_a_change_of_the_code_gives_another_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (before,) = cases(SMALL, tmp_path)
    monkeypatch.setattr("ddpc_cosim.study.cases.code_version", lambda controller: f"another {controller}")
    (after,) = cases(SMALL, tmp_path)
    assert after.id != before.id


@dataclass(kw_only=True)
class Counted(Controller):
    """Counts how often it is built."""

    gain: float = setting(1.0, doc="gain")
    built: ClassVar[int] = 0

    def __post_init__(self) -> None:
        Counted.built += 1

    def start(self, loop: Loop) -> None:
        raise AssertionError

    def step(self, sample: Sample) -> FloatArray:
        raise AssertionError


def test_a_controller_is_built_once_before_it_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each section, each variant of a sweep, and the stabilising controller."""
    monkeypatch.setattr(Counted, "built", 0)
    monkeypatch.setitem(sys.modules, "counted", sys.modules[__name__])
    text = SMALL.replace('type = "mfapc"', 'type = "counted:Counted"')
    text += """sweep = { gain = [2.0, 3.0] }
    [recording]
    samples = 9
    excitation.torque = { low = -1.0, high = 1.0 }
    controller = { type = "counted:Counted" }
    """
    both_seeds = cases(text.replace("[plant]", "seeds = [0, 1]\n[plant]"), tmp_path)
    assert len(both_seeds) == 6
    assert Counted.built == 4


def test_scenarios_change_the_experiment_in_the_plant_s_units(tmp_path: Path) -> None:
    text = (
        SMALL.replace('outputs = ["angle"]', 'inputs = ["torque"]\noutputs = ["angle"]')
        + """
[recording]
samples = 50
excitation.torque = { low = -2.0, high = 2.0 }
[scenarios.all]
[scenarios.short]
recording.samples = 20
[scenarios.weak]
recording.excitation.torque = { low = -500.0, high = 500.0, unit = "mN.m" }
"""
    )
    drawn = {}
    for case in cases(text, tmp_path):
        assert case.excitation is not None
        drawn[case.scenario] = case.excitation.draw(1)
    assert {name: table.shape for name, table in drawn.items()} == {
        "all": (50, 1),
        "short": (20, 1),
        "weak": (50, 1),
    }
    assert np.allclose(drawn["weak"], drawn["all"] / 4.0)
    assert np.array_equal(drawn["short"], drawn["all"][:20])
    assert len({case.id for case in cases(text, tmp_path)}) == 3


def test_the_name_of_the_runs_that_the_tool_makes_itself_is_reserved(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'controllers\.doing-nothing: "doing-nothing" is what .* give '):
        cases(SMALL.replace("controllers.mfapc", "controllers.doing-nothing"), tmp_path)
