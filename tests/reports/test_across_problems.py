"""What the page says over several problems follows from their cases."""

import math
import re
from dataclasses import replace

import pytest
from markupsafe import Markup
from scipy.stats import friedmanchisquare

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_reports.across_problems import (
    Overall,
    overall,
    overall_answer,
    overall_figures,
    overall_statements,
    overall_table,
)
from ddpc_reports.numbers import MISSING

from .synthetic import FORCE, SPEED, MakeResults, make_trace

THREE = {key: {"type": key, "label": key.capitalize()} for key in ("quick", "middle", "slow")}
LAGS = {"quick": 0.3, "middle": 0.5, "slow": 1.0}


def found_in(results: list[StudyResults]) -> Overall:
    comparison = overall(results)
    assert comparison
    return comparison


def said(comparison: Overall) -> dict[str, str]:
    return {topic: re.sub("<[^>]*>", "", str(text)) for topic, text in overall_statements(comparison)}


@pytest.fixture
def alike(make_results: MakeResults) -> list[StudyResults]:
    """Return eight problems in which the controllers have the same order."""
    return [
        make_results(lambda key, seed, n=n: make_trace(LAGS[key] * (1 + n / 10), noise_seed=seed), THREE)
        for n in range(8)
    ]


def test_the_same_order_in_every_problem(alike: list[StudyResults]) -> None:
    """Of three that differ by two ranks, the outer ones are further apart than 2.343 sqrt(3 4 / (6 8))."""
    comparison = found_in(alike)
    assert comparison.findings.ranks.ranks == {"quick": 1.0, "middle": 2.0, "slow": 3.0}
    assert comparison.findings.ranks.critical_difference == pytest.approx(2.343 * 0.5, abs=1e-3)
    assert comparison.findings.ranks.statistic == pytest.approx(
        friedmanchisquare([1] * 8, [2] * 8, [3] * 8).statistic
    )
    table = overall_table(comparison, "")
    assert [[cell.text.strip() for cell in row.cells] for row in table.rows] == [
        ["1", "a", "100", "100", "0 of 8"],
        ["2", "a b", "0", "100", "0 of 8"],
        ["3", "b", "0", "0", "0 of 8"],
    ]
    assert said(comparison) == {
        "Ranks": "Over 8 problems, Quick has the best average rank, 1.00; the problems do not tell it apart "
        "from Middle. Friedman's test: p &lt; 0.001; ranks that are 1.17 or more apart differ."
    }


def test_what_knowing_is_worth_leads_where_every_problem_asks_for_it(alike: list[StudyResults]) -> None:
    """Of some of many problems it is what else there is to say."""
    comparison = found_in(alike)
    ahead, worth = overall_answer(comparison), [Markup("House {}: worth it.").format(n) for n in range(8)]
    assert ahead.startswith("Over 8 problems, <i>Quick</i> has the best average rank")
    asked, beside = (replace(comparison, worth=worth[:n]) for n in (8, 2))
    assert overall_answer(asked) == Markup(" ").join([*worth, ahead])
    assert overall_answer(beside) == Markup(" ").join([ahead, *worth[:2]])


def test_the_kinds_that_tuning_chose_are_counted_and_numbers_are_not(make_results: MakeResults) -> None:
    kinds = ["mine:Flat", "mine:Flat", "mine:Curved"]
    tuned = {"settings": ["dictionary", "horizon", "integral"], "source": "tune"}
    problems = []
    for kind in kinds:
        settings = {"dictionary": {"type": kind, "n": 3}, "horizon": 5, "integral": True, "form": "cfdl"}
        controllers = THREE | {"quick": THREE["quick"] | {"settings": settings, "tuned": tuned}}
        problems.append(make_results(lambda key, seed: make_trace(LAGS[key]), controllers))
    comparison = found_in(problems)
    assert comparison.chosen == {"quick": "dictionary: Flat 2, Curved 1; integral: yes 3"}
    table = overall_table(comparison, "")
    assert [row.cells[-1].text for row in table.rows] == [comparison.chosen["quick"], MISSING, MISSING]


def test_the_figures_draw_what_the_table_says(alike: list[StudyResults]) -> None:
    ranks, profile = overall_figures(found_in(alike), "")
    (bars,) = ranks.views
    assert [row["value"] for row in bars.spec["data"]["values"]] == [1.0, 2.0, 3.0]
    assert all(
        row["high"] - row["low"] == pytest.approx(1.1715, abs=1e-3) for row in bars.spec["data"]["values"]
    )
    (lines,) = profile.views
    assert lines.names == ("c0", "c1", "c2")
    rows = lines.spec["data"]["values"]
    assert (1.0, 1.0) in [(row["ratio"], row["share"]) for row in rows if row["key"] == "c0"]
    slow = [(row["ratio"], row["share"]) for row in rows if row["key"] == "c2"]
    assert slow == sorted(slow)
    assert slow[0] == (1.0, 0.0)
    assert slow[-1] == (20.0, 1.0)
    assert "bars do not overlap are told apart." in ranks.caption


def test_failed_runs_problems_in_which_all_fail_and_absent_controllers_are_told(
    make_results: MakeResults,
) -> None:
    def fallen(key: str, seed: int) -> Trace:
        falls = (key, seed) == ("quick", 0)
        return make_trace(0.1, outcome=Outcome.DIVERGED, reason="NaN") if falls else make_trace(LAGS[key])

    def stuck(key: str, seed: int) -> Trace:
        return make_trace(40.0)

    two = {key: THREE[key] for key in ("quick", "slow")}
    results = [
        make_results(fallen, THREE, seeds=[7, 0]),
        make_results(lambda key, seed: make_trace(LAGS[key], outputs=(SPEED, FORCE)), two, seeds=[7]),
        make_results(stuck, THREE, title="Out of reach"),
    ]
    comparison = found_in(results)
    assert comparison.findings.ranks.problems == 2
    assert comparison.findings.ranks.ranks == {"quick": 1.5, "slow": 1.5}
    assert comparison.findings.failed == {"quick": (1, 3), "middle": (0, 2), "slow": (0, 3)}
    assert math.isnan(comparison.findings.ranks.p)
    statements = said(comparison)
    assert statements["Left out"] == "In Out of reach every controller fails: nothing is ranked there."
    assert statements["Not ranked"] == "Middle: not in every problem, so not ranked over all."
    assert "It takes three controllers for a test." in statements["Ranks"]
    assert overall_figures(comparison, "")[0].caption.endswith(
        "; of two controllers none is, as it takes three."
    )


def test_one_problem_is_none_to_compare_over(make_results: MakeResults) -> None:
    assert overall([make_results(lambda key, seed: make_trace(0.5))]) is None


def test_a_scenario_in_which_all_fail_is_named(alike: list[StudyResults], make_results: MakeResults) -> None:
    both = make_results(
        lambda key, seed: make_trace(LAGS[key]),
        THREE,
        name="one",
        scenarios={"a": {}, "b": {"label": "Hard"}},
    )
    cases = [
        replace(case, failed=True, failure="out of reach") if case.scenario == "b" else case
        for case in both.cases
    ]
    statements = said(found_in([*alike, replace(both, cases=tuple(cases))]))
    assert statements["Left out"] == "In one: Hard every controller fails: nothing is ranked there."
