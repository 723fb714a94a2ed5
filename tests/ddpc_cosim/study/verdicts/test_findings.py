"""What results show is data: in which way controllers lead, how sure that is, who failed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.findings import (
    Findings,
    Lead,
    ScenarioFindings,
    findings_of,
    offers_of,
    overall_findings,
)

KEY, LEFT = "mean_abs_error.y [K]", "settled_error.y [%]"


def runs(
    levels: dict[str, float | dict[str, float]],
    *,
    seeds: int = 8,
    failed: dict[str, int] | None = None,
    jitter: float = 0.01,
    **changes: Any,
) -> tuple[Study, list[CaseResult]]:
    """Return runs of controllers about whose level of error, by scenario, the seeds scatter."""
    rng = np.random.default_rng(5)
    table = {name: of if isinstance(of, dict) else {"nominal": of} for name, of in levels.items()}
    scenarios = {scenario: {} for scenario in dict.fromkeys(s for of in table.values() for s in of)}
    study = read(
        Study,
        {
            "plant": {"name": "p"},
            "loop": {"sampling_time": 0.1, "duration": 1.0},
            "reference": {"y": {"kind": "constant", "value": 1.0}},
            "controllers": {name: {"type": name} for name in levels},
            "scenarios": scenarios,
            **changes,
        },
    )
    cases = [
        CaseResult(
            f"{name}{scenario}{seed}",
            name,
            name.upper(),
            scenario,
            seed,
            Outcome.COMPLETED,
            "",
            (),
            {KEY: level + jitter * float(rng.standard_normal())},
            {},
            {},
            (),
            Path(),
            failed=seed < (failed or {}).get(name, 0),
            settles=True,
            left=1.0,
        )
        for name, of in table.items()
        for scenario, level in of.items()
        for seed in range(seeds)
    ]
    return study, cases


def findings_at(levels: dict[str, float | dict[str, float]], **how: Any) -> Findings:
    return findings_of(*runs(levels, **how))


def test_one_that_is_told_from_all_is_ahead_and_sure() -> None:
    findings = findings_at({"a": 1.0, "b": 2.0, "c": 3.0})
    assert (findings.lead, findings.leaders, findings.following, findings.is_sure) == (
        Lead.AHEAD,
        ("a",),
        "b",
        True,
    )


def test_of_few_seeds_the_best_median_is_not_sure() -> None:
    findings = findings_at({"a": 1.0, "b": 2.0}, seeds=4)
    assert (findings.lead, findings.leaders, findings.is_sure) == (Lead.BEST_MEDIAN, ("a",), False)


def test_those_that_are_not_told_apart_lead_together() -> None:
    findings = findings_at({"a": 1.0, "b": 1.05, "c": 9.0}, jitter=0.3)
    assert findings.lead is Lead.LEVEL
    assert {*findings.leaders} == {"a", "b"}


def test_a_difference_that_does_not_matter_is_none() -> None:
    findings = findings_at({"a": 1.0, "b": 1.002}, jitter=0.0001)
    assert (findings.lead, {*findings.leaders}) == (Lead.ALIKE, {"a", "b"})
    finer = findings_at({"a": 1.0, "b": 1.02}, jitter=0.0001, metrics={"relevant": {"absolute": 0.001}})
    assert (finer.lead, finer.leaders) == (Lead.AHEAD, ("a",))


@pytest.mark.parametrize(
    ("levels", "failed", "lead", "leaders", "sure"),
    [
        ({"a": 1.0}, {}, Lead.ONLY_ONE, ("a",), False),
        ({"a": 1.0, "b": 2.0}, {"a": 1}, Lead.ONLY_SOUND, ("b",), True),
        ({"a": 1.0, "b": 2.0}, {"a": 1, "b": 2}, Lead.ALL_FAIL, (), False),
        ({"a": 1.0, "b": 2.0}, {"a": 8, "b": 8}, Lead.NOBODY, (), False),
    ],
)
def test_failed_runs_decide_who_may_lead(
    levels: dict[str, float | dict[str, float]],
    failed: dict[str, int],
    lead: Lead,
    leaders: tuple[str, ...],
    sure: bool,
) -> None:
    findings = findings_at(levels, failed=failed)
    assert (findings.lead, findings.leaders, findings.is_sure) == (lead, leaders, sure)
    assert {standing.controller: standing.failed for standing in findings.failing} == (
        {} if lead is Lead.NOBODY else failed
    )


def test_where_scenarios_disagree_nobody_leads_over_all() -> None:
    findings = findings_at({"a": {"x": 1.0, "y": 2.0}, "b": {"x": 2.0, "y": 1.0}})
    assert (findings.lead, findings.leaders) == (Lead.BY_SCENARIO, ())
    assert findings.standings.leaders_by_scenario == {"x": ("a",), "y": ("b",)}
    assert not findings.standings.is_ranked


def test_where_every_run_fails_a_remark_says_so() -> None:
    (remark,) = findings_at({"a": 1.0}, failed={"a": 8}).remarks
    assert remark.is_failure
    assert remark.text.startswith("Every controller fails")


def test_in_a_scenario_only_those_without_a_failed_run_are_compared() -> None:
    seen = ScenarioFindings(*runs({"c": 3.0, "a": 1.0, "b": 2.0}, failed={"b": 1}))
    assert [*seen.medians(KEY)] == ["a", "c"]
    assert seen.medians(KEY)["a"] == pytest.approx(1.0, abs=0.1)
    assert seen.compared(KEY) is seen.standings.compared[KEY]
    other = replace(seen, cases=[replace(case, metrics={LEFT: 1.0}) for case in seen.cases])
    assert other.compared(LEFT).order == ("c", "a")


def test_who_is_behind_may_need_no_recording_and_leave_less_of_a_step() -> None:
    study, cases = runs({"a": 1.0, "b": 2.0, "c": 3.0})
    learned = [replace(case, recorded_samples=9 * (case.controller == "a")) for case in cases]
    (offer,) = offers_of(study, learned, findings_of(study, learned))
    assert (offer.controller, offer.needs_no_recording, offer.key) == ("b", True, "")
    left = {"a": 1.0, "b": 0.9, "c": 0.4}
    settling = [
        replace(case, metrics=case.metrics | {LEFT: left[case.controller] * (1 + case.seed / 100)})
        for case in cases
    ]
    (offer,) = offers_of(study, settling, findings_of(study, settling))
    assert (offer.controller, offer.needs_no_recording, offer.key) == ("c", False, LEFT)
    assert (offer.left, offer.least) == pytest.approx((0.4 * 1.035, 1.035))
    assert offers_of(study, cases, findings_of(study, cases)) == []


def test_over_several_problems_ranks_are_averaged_and_failed_runs_summed_up() -> None:
    problems = [runs({"a": 1.0, "b": 2.0}), runs({"a": 1.0, "b": 2.0}), runs({"a": 2.0, "b": 1.0})]
    failing = runs({"a": 1.0, "b": 2.0}, failed={"b": 1})
    all_fail = runs({"a": 1.0, "b": 2.0}, failed={"a": 8, "b": 8})
    over = overall_findings([*problems, failing, all_fail])
    assert over
    assert over.ranks.ranks == {"a": 1.25, "b": 1.75}
    assert over.failed == {"a": (0, 32), "b": (1, 32)}
    assert [*over.profile.shares] == ["a", "b"]
    assert overall_findings(problems[:1]) is None
    assert overall_findings([runs({"a": 1.0}), runs({"a": 1.0})]) is None
