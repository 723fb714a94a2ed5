"""A controller against the baseline: the paired difference, in percent of what is not next to nothing."""

import math
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.baselines import Verdict, against, with_baseline
from ddpc_cosim.study.verdicts.standings import Standings, standings
from ddpc_cosim.study.verdicts.statistics import compare

KEY = "mean_abs_error.y [K]"
TABLES: dict[str, Any] = {
    "plant": {"name": "p"},
    "loop": {"sampling_time": 0.1, "duration": 1.0},
    "reference": {"y": {"kind": "constant", "value": 1.0}},
    "controllers": {name: {"type": name} for name in ("old", "new", "idle", "best")},
}
POINTS = {"reference_points": {"zero": "idle", "full": "best"}}


def cases_of(values: dict[str, list[float]], failed: tuple[str, int] = ("", 0)) -> list[CaseResult]:
    return [
        CaseResult(
            *(f"{name}{seed}", name, name, "nominal", seed, Outcome.COMPLETED, "", ()),
            *({KEY: value}, {}, {}, (), Path()),
            failed=(name, seed) == failed,
        )
        for name, of_seeds in values.items()
        for seed, value in enumerate(of_seeds)
    ]


def ranked(values: dict[str, list[float]], failed: tuple[str, int] = ("", 0), **changes: Any) -> Standings:
    return standings(read(Study, TABLES | changes), cases_of(values, failed))


@given(st.lists(st.tuples(st.floats(1, 10), st.floats(1, 10)), min_size=1, max_size=9))
def test_the_percentage_is_the_median_difference_over_the_median_of_the_baseline(
    pairs: list[tuple[float, float]],
) -> None:
    old, new = (list(values) for values in zip(*pairs, strict=True))
    ranking = ranked({"old": old, "new": new})
    told = against(ranking, KEY, "old", "new")
    assert told is not None
    difference = median(b - a if not math.isclose(a, b, rel_tol=1e-9) else 0.0 for a, b in pairs)
    assert told.percent == pytest.approx(100 * difference / median(old))
    back = against(ranking, KEY, "new", "old")
    assert back is not None
    assert back.difference.median == pytest.approx(-told.difference.median)
    assert {told.verdict, back.verdict} in (
        {Verdict.BETTER, Verdict.WORSE},
        {Verdict.LEVEL},
        {Verdict.SMALL},
    )


@given(st.lists(st.tuples(st.floats(0, 10), st.floats(0, 10)), min_size=6, max_size=9))
def test_a_difference_that_is_turned_is_that_of_the_pair_the_other_way_round(
    pairs: list[tuple[float, float]],
) -> None:
    runs = [{("", seed): pair[i] for seed, pair in enumerate(pairs)} for i in (0, 1)]
    there, back = compare(runs[0], runs[1]), compare(runs[1], runs[0])
    for name, value in there.turned._asdict().items():
        assert value == pytest.approx(getattr(back, name), nan_ok=True), name


def test_of_next_to_nothing_there_is_no_percentage() -> None:
    old, new = [0.0] * 6, [1.0, 1.1, 1.2, 1.3, 1.4, 1.5]
    told = against(ranked({"old": old, "new": new}), KEY, "old", "new")
    assert told is not None
    assert math.isnan(told.percent)
    assert (told.difference.median, told.verdict) == (1.25, Verdict.WORSE)
    # Below what matters, which is said here, is next to nothing too; so are thousands of percent.
    matters = {"metrics": {"relevant": {"absolute": 0.5}}}
    small = against(ranked({"old": [0.4] * 6, "new": new}, **matters), KEY, "old", "new")
    assert small is not None
    assert math.isnan(small.percent)
    many = against(ranked({"old": [0.05] * 6, "new": new}), KEY, "old", "new")
    assert many is not None
    assert math.isnan(many.percent)


@pytest.mark.parametrize(
    ("new", "verdict", "tested"),
    [
        ([1.0, 1.1, 1.0, 1.2, 0.9, 1.0], Verdict.BETTER, True),
        ([3.0, 3.1, 3.0, 3.2, 2.9, 3.0], Verdict.WORSE, True),
        ([1.0, 3.1, 1.0, 3.2, 0.9, 3.0], Verdict.LEVEL, True),
        ([2.001, 2.002, 2.001, 2.003, 2.001, 2.002], Verdict.SMALL, True),
        ([1.0, 1.1], Verdict.BETTER, False),
    ],
)
def test_verdicts_are_those_of_the_ranking(new: list[float], verdict: Verdict, tested: bool) -> None:
    told = against(ranked({"old": [2.0] * len(new), "new": new}), KEY, "old", "new")
    assert told is not None
    assert (told.verdict, told.tested) == (verdict, tested)


def test_where_runs_failed_the_others_are_compared_and_nothing_is_told() -> None:
    values = {"old": [2.0] * 6, "new": [1.0, 1.1, 1.2, 1.0, 1.1, 9.0]}
    told = against(ranked(values, ("new", 5)), KEY, "old", "new")
    assert told is not None
    assert told.difference.pairs == 5
    assert told.percent == pytest.approx(-45.0)
    assert told.verdict is Verdict.FAILED
    none = against(ranked({"old": [2.0], "new": [1.0]}, ("new", 0)), KEY, "old", "new")
    assert none is not None
    assert none.verdict is Verdict.UNKNOWN


def test_a_reference_point_may_be_the_baseline_and_changes_no_rank() -> None:
    values = {"idle": [4.0] * 6, "best": [0.1] * 6, "old": [2.0] * 6, "new": [1.0, 1.1, 1.2, 1.0, 1.1, 1.3]}
    ranking = ranked(values, report=POINTS)
    assert against(ranking, KEY, "idle", "new") is None
    extended = with_baseline(ranking, cases_of(values), "idle")
    told = against(extended, KEY, "idle", "new")
    assert told is not None
    assert (told.percent, told.verdict) == (pytest.approx(-72.5), Verdict.BETTER)
    assert [standing.controller for standing in ranking.order] == ["new", "old"]
    assert with_baseline(ranking, cases_of(values), "old") is ranking
