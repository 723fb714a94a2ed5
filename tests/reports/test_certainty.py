"""What the page says of how sure it is follows from the cases, recomputed here."""

import math
import re
from statistics import median

import numpy as np
import pytest
from scipy.stats import bootstrap, permutation_test

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.files.tables import Row, Table
from ddpc_reports.certainty import certainty_tables
from ddpc_reports.comparison import conditions
from ddpc_reports.numbers import MISSING
from ddpc_reports.page import render_page
from ddpc_reports.verdict import across_statements

from .synthetic import FORCE, SPEED, MakeResults, findings_of, make_trace

THREE = {key: {"type": key} for key in ("quick", "alike", "slow")}
COST = "mean_abs_error.angle [deg]"
GROUP = "mean absolute error of angle / °"
SEEDS = list(range(12))


def trace_of(key: str, seed: int) -> Trace:
    """Let two controllers differ by chance, and one be slower than both on every seed."""
    chance = np.random.default_rng([seed, list(THREE).index(key)]).uniform(-0.1, 0.1)
    return make_trace({"quick": 0.5, "alike": 0.505, "slow": 1.0}[key] + chance, noise_seed=seed)


@pytest.fixture
def results(make_results: MakeResults) -> StudyResults:
    return make_results(trace_of, THREE, seeds=SEEDS)


def values(results: StudyResults, key: str) -> np.ndarray:
    return np.array([case.metrics[COST] for case in results.cases if case.controller == key])


def table_of(results: StudyResults) -> Table:
    return certainty_tables(conditions(results)[0], "")[0]


def rows(table: Table, group: str = GROUP) -> dict[str, Row]:
    return {row.header: row for row in table.groups[group]}


def plain(statements: list) -> dict[str, str]:  # type: ignore[type-arg]
    return {topic: re.sub("<[^>]*>", "", str(text)) for topic, text in statements}


def test_the_figures_of_the_table_are_those_of_the_cases(results: StudyResults) -> None:
    shown = rows(table_of(results))
    first, second, last = shown
    assert {first, second} == {"quick", "alike"}
    assert last == "slow"
    slow, best = values(results, "slow"), values(results, first)
    runs, middle, interval, difference, _, p, ahead, letters = shown["slow"].cells
    assert (runs.text, middle.raw, difference.raw) == ("12 of 12", median(slow), median(slow - best))
    low, high = map(float, str(interval.raw).split(" … "))
    drawn = bootstrap(
        (slow,), np.median, method="percentile", n_resamples=20000, rng=np.random.default_rng(0)
    )
    step = np.diff(np.sort(slow)).max()
    assert abs(low - drawn.confidence_interval.low) <= step / 2
    assert abs(high - drawn.confidence_interval.high) <= step / 2
    # Of the 4096 ways to give twelve differences signs, only these and their opposites are as extreme.
    assert p.raw == 2 / 4096
    assert (ahead.text, ahead.raw, letters.text) == ("0 of 12", 0.0, "b")
    assert [shown[key].cells[7].text for key in (first, second)] == ["a", "a"]
    alone = permutation_test((values(results, second) - best,), np.mean, permutation_type="samples")
    assert shown[second].cells[5].raw == pytest.approx(alone.pvalue)


def test_who_is_not_told_apart_is_not_crowned(results: StudyResults) -> None:
    condition = conditions(results)[0]
    first, second, _ = rows(table_of(results))
    spread = next(str(text) for topic, text in findings_of(condition) if topic == "Spread")
    assert f"Over 12 seeds, <i>{first}</i> has the smallest median" in spread
    assert f"The seeds do not tell it apart from <i>{second}</i> (median difference " in spread
    assert "<b>" not in spread


def test_who_is_told_apart_from_all_others_is_said_to_be(make_results: MakeResults) -> None:
    two = {key: THREE[key] for key in ("quick", "slow")}
    results = make_results(trace_of, two, seeds=SEEDS)
    condition = conditions(results)[0]
    spread = next(str(text) for topic, text in findings_of(condition) if topic == "Spread")
    assert "Over 12 seeds, <b>quick</b> has" in spread
    assert "The seeds tell it apart from every other controller (corrected p &lt; 0.001)." in spread


def test_one_seed_says_nothing_of_how_sure_it_is(make_results: MakeResults) -> None:
    results = make_results(trace_of, THREE)
    condition = conditions(results)[0]
    assert certainty_tables(condition, "") == []
    assert "How sure" not in render_page([results])


def test_a_controller_that_lost_a_run_is_last_and_not_tested(make_results: MakeResults) -> None:
    def failing(key: str, seed: int) -> Trace:
        if (key, seed) == ("quick", 3):
            return make_trace(0.1, outcome=Outcome.DIVERGED, reason="angle is NaN at 3 s")
        return trace_of(key, seed)

    results = make_results(failing, THREE, seeds=SEEDS)
    shown = rows(table_of(results))
    assert list(shown) == ["alike", "slow", "quick"]
    runs, *_, p, ahead, letters = shown["quick"].cells
    assert (runs.text, p.text, letters.text) == ("11 of 12", MISSING, MISSING)
    assert ahead.text.endswith(" of 11")


def test_too_few_seeds_are_said_to_be_and_nothing_is_tested(make_results: MakeResults) -> None:
    """Ahead on each of n seeds, p is 2^(1-n): of five more than 5 %, of six less, of however many."""
    condition = conditions(make_results(trace_of, THREE, seeds=SEEDS[:5]))[0]
    few = "5 seeds are too few to test 3 controllers against each other: it takes 6."
    spread = next(str(text) for topic, text in findings_of(condition) if topic == "Spread")
    assert few in spread
    assert "<b>" not in spread
    assert "apart" not in spread
    enough = conditions(make_results(trace_of, THREE, seeds=SEEDS[:6]))[0]
    assert all("too few" not in str(text) for _, text in findings_of(enough))


def test_the_best_median_is_not_crowned_where_the_pairs_tell_another_to_be_better(
    make_results: MakeResults,
) -> None:
    """The medians are 5 and 5.05, and all pairs but one the other way round."""
    other = [0.5, 1.5, 2.5, 3.5, 5.05, 5.1, 5.1, 5.1, 5.1]
    lags = {"quick": [*map(float, range(1, 10))], "slow": other}
    two = {key: THREE[key] for key in ("quick", "slow")}
    results = make_results(lambda key, seed: make_trace(0.4 + 0.02 * lags[key][seed]), two, seeds=[*range(9)])
    condition = conditions(results)[0]
    spread = next(str(text) for topic, text in findings_of(condition) if topic == "Spread")
    assert "Over 9 seeds, <i>quick</i> has the smallest median" in spread
    assert "it is ahead of the next, <i>slow</i>" in spread
    assert "on 1 of 9." in spread
    assert "(corrected p at most 0.0078); in pairs of the same seed <i>slow</i> is ahead of it." in spread
    mark = condition.alike(COST, condition.controllers)
    assert mark
    assert mark(0) == [0, 1]


def test_an_interval_of_one_point_is_not_exact_where_the_seed_changes_something(
    make_results: MakeResults,
) -> None:
    two = {key: THREE[key] for key in ("quick", "slow")}
    results = make_results(
        lambda key, seed: make_trace(0.6 if (key, seed) == ("slow", 0) else 0.5), two, seeds=[*range(8)]
    )
    shown = rows(table_of(results))
    assert shown["quick"].cells[2].text == "the same on every seed"
    assert "the same on every seed" not in [cell.text for cell in shown["slow"].cells]
    assert shown["slow"].cells[4].raw == "0.0 … 0.0"


def test_what_the_seed_does_not_change_is_exact(make_results: MakeResults) -> None:
    results = make_results(lambda key, seed: make_trace(0.5 if key == "quick" else 1.0), seeds=[0, 1])
    slow = rows(table_of(results))["slow"]
    assert [cell.text for cell in slow.cells[5:]] == ["the same on every seed", "0 of 2", "b"]
    spread = next(str(text) for topic, text in findings_of(conditions(results)[0]) if topic == "Spread")
    assert "<b>quick</b> has the smallest median" in spread
    assert "The seeds tell it apart from every other controller." in spread


def test_where_none_stays_near_its_reference_there_are_no_differences(make_results: MakeResults) -> None:
    def fallen(key: str, seed: int) -> Trace:
        return make_trace(0.1, outcome=Outcome.DIVERGED, reason="angle is NaN at 3 s")

    table = table_of(make_results(fallen, THREE, seeds=SEEDS))
    for row in rows(table).values():
        assert [cell.text for cell in row.cells] == ["0 of 12", *[MISSING] * 7]
        assert math.isnan(float(row.cells[1].raw))


def test_each_of_several_signals_and_scenarios_says_how_sure_it_is(make_results: MakeResults) -> None:
    def of_two(key: str, seed: int) -> Trace:
        chance = np.random.default_rng([seed, len(key)]).uniform(-0.1, 0.1)
        return make_trace(0.5 + chance, outputs=(SPEED, FORCE), noise_seed=seed)

    results = make_results(of_two, seeds=SEEDS, scenarios={"calm": {}, "windy": {}})
    said = plain(findings_of(conditions(results)[0]))["Tracking"]
    assert len(re.findall("not told apart from (?:quick|slow)", said)) == 2
    ((_, across),) = across_statements(conditions(results))
    assert "The seeds do not tell the first apart in" in across
    assert {row.group for row in table_of(results).rows} >= {"mean absolute error of force / N"}


def test_how_many_seeds_are_ahead_is_a_whole_number(make_results: MakeResults) -> None:
    """One of eleven, whose share times eleven is not exactly one."""

    def ahead_once(key: str, seed: int) -> Trace:
        return make_trace(0.5 if key == "quick" or seed == 3 else 0.8, noise_seed=seed + 50 * (key == "slow"))

    results = make_results(ahead_once, {"quick": {"type": "x"}, "slow": {"type": "x"}}, seeds=[*range(11)])
    texts = [row.cells[6].text for row in table_of(results).rows]
    assert all(re.fullmatch(r"\d+(\.5)? of 11|\N{EN DASH}", text) for text in texts)
