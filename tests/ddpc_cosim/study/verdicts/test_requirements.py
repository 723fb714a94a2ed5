"""Who meets a requirement, against the rule written out: on enough seeds, in each scenario."""

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.requirements import RequirementFindings, requirement_findings

KEY = "overshoot.y [%]"
TABLES: dict[str, Any] = {
    "plant": {"name": "p"},
    "loop": {"sampling_time": 0.1, "duration": 1.0},
    "reference": {"y": {"kind": "constant", "value": 1.0}},
    "controllers": {"a": {"type": "a"}, "b": {"type": "b"}, "b-1": {"type": "b", "variant_of": "b"}},
}


def case_of(
    controller: str, scenario: str, seed: int, value: float, *, failed: bool = False, key: str = KEY
) -> CaseResult:
    id = f"{controller}{scenario}{seed}"
    case = (id, controller, controller, scenario, seed, Outcome.COMPLETED, "", (), {key: value}, {}, {})
    return CaseResult(*case, (), Path(), failed=failed)


def judged(
    requirements: dict[str, Any], cases: list[CaseResult], scenarios: tuple[str, ...] = ("calm",)
) -> RequirementFindings:
    more = {"requirements": requirements, "scenarios": {name: {} for name in scenarios}}
    findings = requirement_findings(read(Study, TABLES | more), cases)
    assert findings is not None
    return findings


def of_values(*values: float, controller: str = "a", scenario: str = "calm") -> list[CaseResult]:
    return [case_of(controller, scenario, seed, value) for seed, value in enumerate(values)]


@given(
    st.lists(st.sampled_from([1.0, 5.0, 5.5, math.nan, "failed"]), min_size=1, max_size=40),
    st.integers(0, 100),
)
def test_one_is_met_if_no_more_runs_miss_it_than_the_share_allows(
    runs: list[float | str], percent: int
) -> None:
    """The rule in fractions: decimal shares, such as 0.9 of 10, round to no other number of seeds."""
    cases = [
        case_of("a", "calm", seed, 0.0 if run == "failed" else float(run), failed=run == "failed")
        for seed, run in enumerate(runs)
    ]
    findings = judged({"share": percent / 100, "overshoot": {"y": {"max": 5.0}}}, cases)
    (tally,) = findings.of("a")
    met = sum(run in (1.0, 5.0) for run in runs)
    assert (tally.runs, tally.met) == (len(runs), met)
    assert tally.failed == runs.count("failed")
    assert tally.unknown == sum(isinstance(run, float) and math.isnan(run) for run in runs)
    assert tally.is_met == (len(runs) - met <= (1 - Fraction(percent, 100)) * len(runs))
    assert findings.passed == tally.is_met
    assert bool(tally.why) == (met < len(runs))


@pytest.mark.parametrize(
    ("limits", "value", "is_met"),
    [
        ({"max": 5.0}, 5.0, True),
        ({"max": 5.0}, 5.0000001, False),
        ({"min": 5.0}, 5.0, True),
        ({"min": 5.0}, 4.9, False),
        ({"min": -1.0, "max": 1.0}, 0.0, True),
        ({"max": 0.05, "unit": "1"}, 5.0, True),
        ({"max": 0.05, "unit": "1"}, 5.1, False),
    ],
)
def test_limits_count_themselves_in_their_unit(limits: dict[str, Any], value: float, is_met: bool) -> None:
    assert judged({"overshoot": {"y": limits}}, of_values(value)).passed == is_met


def test_it_is_required_in_each_scenario_or_in_those_that_are_named() -> None:
    cases = [*of_values(1.0, 1.0), *of_values(1.0, 9.0, scenario="wild")]
    limit = {"max": 5.0}
    assert not judged({"overshoot": {"y": limit}}, cases, ("calm", "wild")).passed
    in_calm = limit | {"scenarios": ["calm"]}
    assert judged({"overshoot": {"y": in_calm}}, cases, ("calm", "wild")).passed
    findings = judged({"overshoot": {"y": limit | {"share": 0.5}}}, cases, ("calm", "wild"))
    assert findings.passed
    (missed,) = judged({"overshoot": {"y": limit}}, cases, ("calm", "wild")).missed("a")
    assert missed == "overshoot of y at most 5 %: in wild 1 of 2 runs (1 beyond, as far as 9 %)"


def test_those_that_are_named_have_to_meet_all_of_it_and_else_one_of_those_that_compete() -> None:
    cases = [*of_values(9.0), *of_values(1.0, controller="b"), *of_values(1.0, controller="b-1")]
    limits = {"overshoot": {"y": {"max": 5.0}}}
    findings = judged(limits, cases)
    assert findings.controllers == ("a", "b")  # a setting of a sweep does not compete
    assert (findings.passed, findings.meeting) == (True, ("b",))
    assert judged(limits | {"controllers": ["b"]}, cases).passed
    of_both = judged(limits | {"controllers": ["a", "b"]}, cases)
    assert not of_both.passed
    assert of_both.verdict == "Requirements: not passed, as a must meet all of them"
    assert judged(limits | {"controllers": ["b-1"]}, cases).passed
    assert not judged(limits, cases[::2]).passed  # of the sweep's setting alone nothing is shown


def test_who_was_not_run_has_not_shown_that_it_meets_anything() -> None:
    limits = {"controllers": ["b"], "overshoot": {"y": {"max": 5.0}}}
    findings = judged(limits, of_values(1.0))
    assert not findings.passed
    assert findings.of("b")[0].why == "no run"


def test_a_metric_that_no_run_has_is_met_by_none() -> None:
    findings = judged({"rmse": {"y": {"max": 5.0}}}, of_values(1.0))
    assert not findings.passed
    assert findings.of("a")[0].why == "1 without a value"


def test_differences_of_temperatures_convert_without_an_offset() -> None:
    cases = [case_of("a", "calm", 0, 2.0, key="mean_abs_error.y [degC]")]
    assert judged({"mean_abs_error": {"y": {"max": 2.0, "unit": "K"}}}, cases).passed
    level = [case_of("a", "calm", 0, 20.0, key="max_abs_input.u [degC]")]
    assert judged({"max_abs_input": {"u": {"max": 293.2, "unit": "K"}}}, level).passed
    assert not judged({"max_abs_input": {"u": {"max": 293.1, "unit": "K"}}}, level).passed


def test_lines_name_those_that_have_to_meet_it_whatever_else_is_left_out() -> None:
    names = [f"c{number}" for number in range(9)]
    tables = TABLES | {"controllers": {name: {"type": "a"} for name in names}}
    requirements = {"controllers": ["c8"], "overshoot": {"y": {"max": 5.0}}}
    cases = [case for name in names for case in of_values(9.0, controller=name)]
    findings = requirement_findings(read(Study, tables | {"requirements": requirements}), cases)
    assert findings is not None
    verdict, *lines = findings.lines
    assert verdict == "Requirements: not passed, as c8 must meet all of them"
    assert lines[0].startswith("missed by c8: overshoot of y at most 5 %: 0 of 1 runs")
    assert lines[-1] == "missed by 6 more"
