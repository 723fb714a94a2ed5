"""What results show is data: in which way controllers lead, how sure that is, who failed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.findings import Findings, Lead, findings_of

KEY = "mean_abs_error.y [K]"


def found(
    levels: dict[str, float | dict[str, float]],
    *,
    seeds: int = 8,
    failed: dict[str, int] | None = None,
    jitter: float = 0.01,
    **changes: Any,
) -> Findings:
    """Return findings of controllers about whose level of error, by scenario, the seeds scatter."""
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
    return findings_of(study, cases)


def test_one_that_is_told_from_all_is_ahead_and_sure() -> None:
    told = found({"a": 1.0, "b": 2.0, "c": 3.0})
    assert (told.lead, told.leaders, told.following, told.is_sure) == (Lead.AHEAD, ("a",), "b", True)


def test_of_few_seeds_the_best_median_is_not_sure() -> None:
    told = found({"a": 1.0, "b": 2.0}, seeds=4)
    assert (told.lead, told.leaders, told.is_sure) == (Lead.BEST_MEDIAN, ("a",), False)


def test_those_that_are_not_told_apart_lead_together() -> None:
    told = found({"a": 1.0, "b": 1.05, "c": 9.0}, jitter=0.3)
    assert told.lead is Lead.LEVEL
    assert {*told.leaders} == {"a", "b"}


def test_a_difference_that_does_not_matter_is_none() -> None:
    told = found({"a": 1.0, "b": 1.002}, jitter=0.0001)
    assert (told.lead, {*told.leaders}) == (Lead.ALIKE, {"a", "b"})
    finer = found({"a": 1.0, "b": 1.02}, jitter=0.0001, metrics={"relevant": {"absolute": 0.001}})
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
    told = found(levels, failed=failed)
    assert (told.lead, told.leaders, told.is_sure) == (lead, leaders, sure)
    assert {one.controller: one.failed for one in told.failing} == ({} if lead is Lead.NOBODY else failed)


def test_where_scenarios_disagree_nobody_leads_over_all() -> None:
    told = found({"a": {"x": 1.0, "y": 2.0}, "b": {"x": 2.0, "y": 1.0}})
    assert (told.lead, told.leaders) == (Lead.BY_SCENARIO, ())
    assert told.standings.leaders_by_scenario == {"x": ("a",), "y": ("b",)}
    assert not told.standings.is_ranked


def test_where_every_run_fails_a_remark_says_so() -> None:
    (remark,) = found({"a": 1.0}, failed={"a": 8}).remarks
    assert remark.is_failure
    assert remark.text.startswith("Every controller fails")
