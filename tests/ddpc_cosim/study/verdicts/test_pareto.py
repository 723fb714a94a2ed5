"""By money and discomfort both, ranks are Pareto fronts; what is said of them is who is cheapest at what."""

import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import CaseResult
from ddpc_cosim.responses import Tracking
from ddpc_cosim.study.verdicts.findings import Findings, Lead, findings_of
from ddpc_cosim.study.verdicts.ranks import problems_frame
from ddpc_cosim.study.verdicts.sentences import lead_clause
from ddpc_cosim.study.verdicts.standings import Relevant, Standings, pareto_fronts

from .test_findings import runs as runs_of_errors

MONEY, DISCOMFORT = "money [EUR]", "band_violation.room [degC.h]"
SEEDS = 12
LABELS = {name: name.upper() for name in "abcd"}
Points = dict[str, tuple[float, float]]


def both(points: Points, jitter: float = 0.01, **more: Any) -> Standings:
    """Return standings of controllers about whose money and discomfort the seeds scatter."""
    rng = np.random.default_rng(3)
    runs = {
        key: {
            name: {("nominal", seed): point[i] + jitter * rng.standard_normal() for seed in range(SEEDS)}
            for name, point in points.items()
        }
        for i, key in enumerate((MONEY, DISCOMFORT))
    }
    return Standings((MONEY, DISCOMFORT), runs, (), **more)


def cases_of(
    points: Points | dict[str, dict[str, tuple[float, float]]], ranking: str = "", seeds: int = SEEDS
) -> tuple[Any, list[CaseResult]]:
    """Return a study and its runs; by scenario where there are several."""
    rng = np.random.default_rng(4)
    by_scenario = {
        name: point if isinstance(point, dict) else {"nominal": point} for name, point in points.items()
    }
    levels: dict[str, Any] = {name: dict.fromkeys(of, 0.0) for name, of in by_scenario.items()}
    metrics = {"metrics": {"ranking": ranking}} if ranking else {}
    study, cases = runs_of_errors(levels, seeds=seeds, **metrics)

    def priced(case: CaseResult) -> CaseResult:
        money, violation = by_scenario[case.controller][case.scenario]
        more = {
            MONEY: money + 0.01 * rng.standard_normal(),
            DISCOMFORT: violation + 0.01 * rng.random() * (violation > 0),
        }
        return replace(case, metrics={"mean_abs_error.room [degC]": violation / 10} | more)

    return study, [priced(case) for case in cases]


def found(
    points: Points | dict[str, dict[str, tuple[float, float]]], ranking: str = "", seeds: int = SEEDS
) -> Findings:
    return findings_of(*cases_of(points, ranking, seeds))


@given(
    st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6), st.integers(0, 3)), min_size=1, max_size=12),
)
def test_no_member_of_a_front_dominates_another_and_those_behind_are_dominated(
    points: list[tuple[int, int, int]],
) -> None:
    names = [str(i) for i in range(len(points))]

    def dominates(a: str, b: str) -> bool:
        first, other = points[int(a)], points[int(b)]
        return first != other and all(x <= y for x, y in zip(first, other, strict=True))

    fronts = pareto_fronts(names, dominates)
    assert sorted(name for front in fronts for name in front) == sorted(names)
    for front in fronts:
        assert not any(dominates(a, b) for a in front for b in front)
    for ahead, behind in pairwise(fronts):
        assert all(any(dominates(a, b) for a in ahead) for b in behind)


@given(
    st.dictionaries(
        st.sampled_from("abcdef"), st.tuples(st.integers(1, 4), st.integers(0, 4)), min_size=2, max_size=6
    )
)
def test_fronts_of_controllers_that_the_seeds_tell_apart_are_those_of_their_points(
    points: dict[str, tuple[int, int]],
) -> None:
    ranking = both({name: (float(x), float(y)) for name, (x, y) in points.items()}, relevant=Relevant(0.5))

    def dominated(name: str) -> bool:
        x, y = points[name]
        return any((u, v) != (x, y) and u <= x and v <= y for u, v in points.values())

    assert {*ranking.leaders} == {name for name in points if not dominated(name)}
    ranks = {standing.controller: standing.rank for standing in ranking.order}
    assert all(name in ranking.fronts[rank - 1] for name, rank in ranks.items())
    assert all(standing.worst == standing.rank for standing in ranking.order)


def test_those_that_dominate_each_other_in_a_circle_share_a_front() -> None:
    beats = {"a": "b", "b": "c", "c": "a"}
    assert pareto_fronts("abcd", lambda one, other: beats.get(one) == other or other == "d") == (
        ("a", "b", "c"),
        ("d",),
    )


def test_a_difference_below_the_smallest_relevant_dominates_nobody() -> None:
    points = {"a": (10.0, 1.0), "b": (10.4, 1.0)}
    assert both(points).leaders == ("a",)
    assert both(points, relevant=Relevant({"money": 0.5})).leaders == ("a", "b")


def test_of_a_band_a_tenth_of_its_width_over_the_run_is_what_percents_are_of() -> None:
    """One percent of a tenth of 4 K over 50 h is 0.2 K.h."""
    study, cases = cases_of({"a": (10.0, 0.0), "b": (10.0, 0.15), "c": (10.0, 0.3)})
    room = Tracking("room", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, width=4.0)
    cases = [replace(case, tracking=(room,), simulated_time=50 * 3600.0) for case in cases]
    ranking = findings_of(study, cases).standings
    assert ranking.relevant_differences[DISCOMFORT] == pytest.approx(0.2)
    assert (ranking.fronts, ranking.keys) == ((("a", "b"), ("c",)), (MONEY, DISCOMFORT))


def test_who_has_a_failed_run_comes_after_all_fronts() -> None:
    study, cases = cases_of({"a": (1.0, 1.0), "b": (2.0, 2.0), "c": (0.5, 0.5), "d": (3.0, 3.0)})
    cases = [replace(case, failed=case.controller == "c" and case.seed == 0) for case in cases]
    order = findings_of(study, cases).standings.order
    assert [(standing.controller, standing.text) for standing in order] == [
        ("a", "1"),
        ("b", "2"),
        ("d", "3"),
        ("c", "4"),
    ]


@pytest.mark.parametrize(
    ("points", "lead", "clause"),
    [
        (
            {"a": (88.0, 3.0), "b": (100.0, 3.0)},
            Lead.AHEAD,
            "<b>A</b> costs 12 % less than <i>B</i> at no more discomfort over 12 seeds",
        ),
        (
            {"a": (88.0, 3.0), "b": (100.0, 6.0)},
            Lead.AHEAD,
            "<b>A</b> costs 12 % less than <i>B</i> with 50 % less discomfort over 12 seeds",
        ),
        (
            {"a": (100.0, 3.0), "b": (100.0, 6.0)},
            Lead.AHEAD,
            "<b>A</b> costs no more than <i>B</i> with 50 % less discomfort over 12 seeds",
        ),
        (
            {"a": (88.0, 0.0), "b": (88.5, 6.0)},
            Lead.AHEAD,
            "<b>A</b> costs no more than <i>B</i> with 100 % less discomfort over 12 seeds",
        ),
        (
            {"a": (55.0, 1.0), "b": (41.0, 12.0), "c": (60.0, 13.0), "d": (47.0, 5.0)},
            Lead.FRONT,
            "<b>B</b>, <b>D</b> and <b>A</b> are not dominated over 12 seeds: <i>B</i> is cheapest "
            "(41 EUR, 12 K.h), <i>A</i> is the most comfortable (55 EUR, 1 K.h); against <i>C</i>, the "
            "cheapest of the next front (60 EUR, 13 K.h), in pairs of the same seed <i>B</i> costs 32 % less "
            "with 7.7 % less discomfort and <i>A</i> costs 8.3 % less with 92 % less discomfort",
        ),
        (
            {"a": (55.0, 1.0), "b": (41.0, 12.0)},
            Lead.FRONT,
            "<b>B</b> and <b>A</b> are not dominated over 12 seeds: <i>B</i> is cheapest "
            "(41 EUR, 12 K.h), <i>A</i> is the most comfortable (55 EUR, 1 K.h)",
        ),
        (
            {"a": (41.003, 12.0), "b": (41.0, 12.003)},
            Lead.FRONT,
            "<b>A</b> and <b>B</b> are not dominated over 12 seeds, and differ by too little to matter "
            "(41 EUR, 12 K.h)",
        ),
        (
            {"a": (55.0, 12.0), "b": (41.0, 12.003), "c": (48.0, 12.002)},
            Lead.AHEAD,
            "<b>B</b> costs 15 % less than <i>C</i> at no more discomfort over 12 seeds",
        ),
    ],
)
def test_what_is_said_of_money_and_discomfort(points: Points, lead: Lead, clause: str) -> None:
    findings = found(points)
    assert findings.lead is lead
    assert lead_clause(findings, LABELS, {}) == clause


@pytest.mark.parametrize(("seed", "dearer"), [(0, 1.03), (1, 1.2), (2, 1.6)])
def test_what_the_front_saves_is_the_median_of_differences_over_the_median_of_the_other(
    seed: int, dearer: float
) -> None:
    """Of each seed the median of its scenarios counts; seeds differ by more than controllers do."""
    rng = np.random.default_rng(seed)
    weather = 10 * rng.random(SEEDS)  # a cold week is dear for everyone
    dear = {"calm": 0.0, "cold": 5.0, "windy": 7.0}
    level = {"a": (55.0, 20.0), "b": (41.0, 32.0), "c": (55.0 * dearer, 33.0)}
    study, cases = cases_of({name: dict.fromkeys(dear, point) for name, point in level.items()})

    def in_weather(case: CaseResult) -> CaseResult:
        of_all = weather[case.seed] + dear[case.scenario]
        figures = (value + of_all + 0.1 * rng.random() for value in level[case.controller])
        return replace(case, metrics={**case.metrics, **dict(zip((MONEY, DISCOMFORT), figures, strict=True))})

    cases = [in_weather(case) for case in cases]
    findings = findings_of(study, cases)
    assert (findings.leaders, findings.following) == (("b", "a"), "c")
    values = {
        (name, key): np.array(
            [
                [case.metrics[key] for case in cases if (case.controller, case.seed) == (name, number)]
                for number in range(SEEDS)
            ]
        )
        for name in level
        for key in (MONEY, DISCOMFORT)
    }

    def less(name: str, key: str) -> float:
        other = values["c", key]
        difference = np.median(np.median(other - values[name, key], axis=1))
        return float(100 * difference / np.median(np.median(other, axis=1)))

    clause = lead_clause(findings, LABELS, {}).partition("next front")[2]
    printed = re.findall(r"<i>(\w)</i> costs (\S+) % less with (\S+) % less discomfort", clause)
    assert [name for name, *_ in printed] == ["B", "A"]
    for name, *percents in printed:
        for key, percent in zip((MONEY, DISCOMFORT), percents, strict=True):
            digits = 1 if "." in percent else 0
            assert float(percent) == pytest.approx(less(name.lower(), key), abs=0.5001 * 10**-digits)


def test_by_money_alone_discomfort_stands_beside_it() -> None:
    findings = found({"a": (88.0, 6.0), "b": (100.0, 3.0)}, "money")
    assert findings.standings.keys == (MONEY,)
    assert findings.leaders == ("a",)
    assert lead_clause(findings, LABELS, {}) == (
        "<b>A</b> costs 12 % less than <i>B</i> with 100 % more discomfort over 12 seeds"
    )
    never = found({"a": (88.0, 6.0), "b": (100.0, 0.0)}, "money")
    assert "with 6 K.h more over 12 seeds" in lead_clause(never, LABELS, {})


def test_by_errors_prices_change_nothing() -> None:
    findings = found({"a": (88.0, 6.0), "b": (100.0, 3.0)}, "error")
    assert findings.standings.keys == ("mean_abs_error.room [degC]",)
    assert lead_clause(findings, LABELS, {}) == "<b>B</b> is ahead over 12 seeds"


def test_on_one_seed_the_values_decide() -> None:
    findings = found({"a": (88.0, 3.0), "b": (100.0, 3.5)}, seeds=1)
    assert (findings.lead, findings.leaders) == (Lead.AHEAD, ("a",))
    assert "on the one seed that was run" in lead_clause(findings, LABELS, {})


def test_scenarios_disagree_where_who_is_dominated_in_one_is_not_in_the_other() -> None:
    """In one A is better in both; in the other B is the more comfortable."""
    points = {"a": {"x": (1.0, 1.0), "y": (1.0, 3.0)}, "b": {"x": (2.0, 2.0), "y": (2.0, 2.0)}}
    assert found(points).lead is Lead.BY_SCENARIO
    further = {"a": {"x": (1.0, 3.0), "y": (1.0, 9.0)}, "b": {"x": (2.0, 2.0), "y": (5.0, 2.0)}}
    assert found(further).lead is Lead.FRONT, "both are on the front in both, however far apart"


def test_over_problems_it_is_ranks_that_count() -> None:
    rankings = [found({"a": (1.0, 1.0), "b": (2.0, 2.0)}).standings for _ in range(2)]
    frame = problems_frame(rankings)
    assert frame is not None
    by_controller = frame.groupby("controller")["mean_abs_error"].unique()
    assert by_controller.map(list).to_dict() == {"a": [1.0], "b": [2.0]}
