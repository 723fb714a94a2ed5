"""Standings: who is ahead is what the seeds tell, and whose runs failed comes last."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from reports.synthetic import make_results_in, make_study, make_trace

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.study.verdicts.standings import Relevant, Standings, standings, summed

SEEDS = [*range(12)]


def of(errors: dict[str, list[float]], **more: dict[str, list[float]]) -> Standings:
    """Return standings by one key, or by several, with a value for each seed."""
    keys = {"mean_abs_error.angle [deg]": errors} | {
        f"mean_abs_error.{name} [1]": values for name, values in more.items()
    }
    runs = {
        key: {name: {("nominal", i): value for i, value in enumerate(v)} for name, v in of_key.items()}
        for key, of_key in keys.items()
    }
    return Standings(tuple(keys), runs, ())


def ranks(ranking: Standings) -> dict[str, int]:
    return {standing.controller: standing.rank for standing in ranking.order}


def noisy(level: float, seed: int) -> list[float]:
    return (level + 0.01 * np.random.default_rng(seed).standard_normal(len(SEEDS))).tolist()


def test_those_that_the_seeds_do_not_tell_apart_share_a_rank() -> None:
    ranking = of({"worst": noisy(3.0, 0), "a": noisy(1.0, 1), "b": noisy(1.0, 2), "next": noisy(2.0, 3)})
    assert ranking.tested
    assert ranks(ranking) == {"a": 1, "b": 1, "next": 3, "worst": 4}
    assert set(ranking.leaders) == {"a", "b"}


def test_where_the_seeds_are_too_few_the_medians_decide() -> None:
    ranking = of({"b": [2.0, 2.1], "a": [1.0, 1.1], "same": [1.0, 1.1]})
    assert not ranking.tested
    assert ranks(ranking) == {"a": 1, "same": 1, "b": 3}


def test_who_has_a_failed_run_comes_after_all_without_and_after_those_with_fewer() -> None:
    nan = float("nan")
    ranking = of(
        {"two": [nan, nan, 0.1], "none": [5.0, 5.0, 5.0], "one": [0.1, nan, 0.1], "too": [nan, 1, 1]}
    )
    assert ranks(ranking) == {"none": 1, "one": 2, "too": 2, "two": 4}
    assert [standing.failed for standing in ranking.order] == [0, 1, 1, 2]
    assert ranking.leaders == ("none",)


def test_where_all_have_failed_runs_there_is_no_leader() -> None:
    ranking = of({"a": [float("nan"), 1.0], "b": [float("nan"), float("nan")]})
    assert ranks(ranking) == {"a": 1, "b": 2}
    assert ranking.leaders == ()


def test_where_nothing_is_ranked_there_are_no_ranks() -> None:
    """One alone, or all runs of all failed; where any did not, they are ranked by how many did."""
    nan = float("nan")
    alone, failed = of({"a": [1.0, 2.0]}), of({"a": [nan, nan], "b": [nan, nan]})
    assert not alone.is_ranked
    assert texts(alone) == {"a": ""}
    assert not failed.is_ranked
    assert texts(failed) == {"a": "", "b": ""}
    one_run_left = of({"a": [nan, 1.0], "b": [nan, nan]})
    assert one_run_left.is_ranked
    assert texts(one_run_left) == {"a": "1", "b": "2"}


def test_of_two_outputs_one_is_better_that_is_so_in_one_and_not_worse_in_the_other() -> None:
    a, b, c = noisy(1.0, 1), noisy(2.0, 2), noisy(3.0, 3)
    ranking = of({"both": a, "mixed": b, "last": c}, level={"both": a, "mixed": c, "last": b})
    assert ranks(ranking) == {"both": 1, "mixed": 2, "last": 2}


@given(st.lists(st.lists(st.floats(0.1, 10), min_size=12, max_size=12), min_size=2, max_size=4))
def test_no_controller_is_significantly_better_than_a_leader(values: list[list[float]]) -> None:
    ranking = of({f"c{i}": errors for i, errors in enumerate(values)})
    (compared,) = ranking.compared.values()
    for (a, b), difference in compared.differences.items():
        if ranking.tested and difference.told_apart:
            worse, better = (a, b) if difference.told_worse else (b, a)
            assert worse not in ranking.leaders
            assert ranks(ranking)[worse] > 1
            assert ranks(ranking)[better] >= 1


def texts(ranking: Standings) -> dict[str, str]:
    return {standing.controller: standing.text.replace("\N{EN DASH}", "-") for standing in ranking.order}


def test_ranks_are_the_range_that_the_data_allow() -> None:
    """What varies much is told from those at either end and not from its neighbour; failed runs come last."""
    nan = float("nan")
    wide = [1.0, 2.2] * 6
    ranking = of(
        {
            "a": noisy(1.0, 1),
            "b": noisy(1.0, 2),
            "wide": [value + 0.45 for value in wide],
            "c": noisy(2.0, 3),
            "last": noisy(9.0, 4),
            "fails": [nan, *[0.1] * 11],
            "fails too": [nan, *[0.1] * 11],
        }
    )
    assert texts(ranking) == {
        "a": "1-2", "b": "1-2", "wide": "3-4", "c": "3-4", "last": "5", "fails": "6-7", "fails too": "6-7",
    }  # fmt: skip


def test_a_single_controller_has_no_rank() -> None:
    assert texts(of({"a": noisy(1.0, 1)})) == {"a": ""}


def test_a_difference_that_does_not_matter_shares_a_rank() -> None:
    """All are told apart: a and b by 0.5 % of the best, c by 5 %."""
    base = noisy(1.0, 1)
    errors = {"a": base, "b": [value + 0.005 for value in base], "c": [value + 0.05 for value in base]}
    ranking = of(errors)
    (compared,) = ranking.compared.values()
    assert all(difference.told_apart for difference in compared.differences.values())
    assert ranks(ranking) == {"a": 1, "b": 1, "c": 3}
    assert ranking.is_surely_small("a", "b")
    assert not ranking.is_surely_small("b", "c")
    assert ranks(of_relevant(errors, Relevant(absolute=0.0))) == {"a": 1, "b": 2, "c": 3}
    assert ranks(of_relevant(errors, Relevant(absolute=0.06))) == {"a": 1, "b": 1, "c": 1}
    assert ranks(of_relevant(errors, Relevant(percent=6.0))) == {"a": 1, "b": 1, "c": 1}
    assert ranks(of_relevant(errors, Relevant(absolute={"angle": 0.06}))) == {"a": 1, "b": 1, "c": 1}
    assert ranks(of_relevant(errors, Relevant(), 10.0)) == {"a": 1, "b": 1, "c": 1}, "1 % of the task"


def of_relevant(errors: dict[str, list[float]], relevant: Relevant, task: float = float("nan")) -> Standings:
    ranking = of(errors)
    return replace(ranking, relevant=relevant, tasks={"": dict.fromkeys(ranking.keys, task)})


def test_where_the_medians_decide_a_difference_has_to_matter_too() -> None:
    ranking = of({"a": [1.0, 1.0], "b": [1.004, 1.004], "c": [1.2, 1.2]})
    assert not ranking.tested or ranking.seeds == 2
    assert ranks(ranking) == {"a": 1, "b": 1, "c": 3}


def test_equal_in_the_printed_digits_is_equal_in_rank() -> None:
    base = [1.0 + 1e-4 * n for n in range(12)]
    errors = {"best": base, "a": [500 + v for v in base], "b": [500.1 + v for v in base]}
    assert ranks(of_relevant(errors, Relevant(absolute=0.0))) == {"best": 1, "a": 2, "b": 2}


def test_the_smallest_relevant_difference_is_the_larger_of_what_is_given() -> None:
    key = "mean_abs_error.level [m]"
    assert Relevant().difference(key, 2.0) == 0.02
    assert Relevant().difference(key, 2.0, 30.0) == pytest.approx(0.3)
    assert Relevant(absolute=0.1).difference(key, 2.0, 30.0) == 0.1
    assert Relevant(absolute=0.1, percent=10).difference(key, 2.0, 0.5) == pytest.approx(0.2)
    assert Relevant(absolute={"level": 0.5}).difference(key, 2.0) == 0.5
    assert Relevant(absolute={"other": 0.5}).difference(key, 2.0) == 0.02
    assert Relevant().difference(key, float("nan")) == 0.0


def in_scenarios(**levels: dict[str, float]) -> Standings:
    """Return standings of controllers at a level in each scenario, with noise of 0.01."""
    runs = {
        name: {
            (scenario, seed): value
            for place, (scenario, level) in enumerate(of_scenario.items())
            for seed, value in enumerate(noisy(level, 10 * place + ord(name[0])))
        }
        for name, of_scenario in levels.items()
    }
    return Standings(("mean_abs_error.angle [deg]",), {"mean_abs_error.angle [deg]": runs}, ())


def test_where_scenarios_disagree_there_is_no_overall_rank() -> None:
    ranking = in_scenarios(a={"x": 1.0, "y": 2.0}, b={"x": 2.0, "y": 1.0}, c={"x": 4.0, "y": 4.0})
    assert [(disagreement.pair, disagreement.conditions) for disagreement in ranking.disagreements] == [
        (("a", "b"), ("x", "y"))
    ]
    assert ranking.leaders == ()
    assert ranking.leaders_by_scenario == {"x": ("a",), "y": ("b",)}
    assert set(texts(ranking).values()) == {""}


def test_who_leads_in_one_scenario_and_not_in_the_other_does_not_lead_overall() -> None:
    ranking = in_scenarios(a={"x": 1.0, "y": 1.0}, b={"x": 2.0, "y": 1.0})
    assert ranking.leaders_by_scenario == {"x": ("a",), "y": ("a", "b")}
    assert ranking.disagreements


def test_a_lead_that_only_changes_its_size_is_a_lead() -> None:
    ranking = in_scenarios(a={"x": 1.0, "y": 1.0}, b={"x": 1.5, "y": 3.0}, c={"x": 3.0, "y": 1.5})
    assert ranking.disagreements == (), "b and c disagree, and lead nowhere"
    assert ranking.leaders == ("a",)


def test_scenarios_that_differ_by_chance_do_not_disagree() -> None:
    ranking = in_scenarios(a={"x": 1.0, "y": 2.0}, b={"x": 1.0, "y": 2.0})
    assert ranking.disagreements == ()
    assert set(ranking.leaders) == {"a", "b"}


def test_a_controller_that_ran_in_one_scenario_alone_disagrees_with_none() -> None:
    ranking = in_scenarios(a={"x": 1.0, "y": 1.0}, b={"x": 2.0}, c={"x": 2.0, "y": 3.0})
    assert ranking.disagreements == ()
    assert ranking.leaders == ("a",)


@pytest.fixture
def results(tmp_path: Path) -> StudyResults:
    def trace_of(key: str, seed: int) -> Trace:
        if key == "falling" and seed == 3:
            return make_trace(0.3, outcome=Outcome.DIVERGED, reason="angle is NaN")
        return make_trace({"quick": 0.3, "falling": 0.2, "idle": 0.6}.get(key, 1.0), noise_seed=seed)

    controllers = {name: {"type": "a"} for name in ("slow", "quick", "falling", "idle")}
    return make_results_in(
        tmp_path,
        trace_of,
        controllers,
        seeds=SEEDS,
        report={"reference_points": {"zero": "idle", "full": "slow"}},
    )


def test_of_a_study_reference_points_do_not_compete(results: StudyResults) -> None:
    ranking = standings(results.study, results.cases)
    assert [
        (standing.controller, standing.rank, standing.failed, standing.runs) for standing in ranking.order
    ] == [
        ("quick", 1, 0, 12),
        ("falling", 2, 1, 12),
    ]


def test_without_cases_there_are_none() -> None:
    ranking = standings(make_study({"a": {"type": "a"}}), [])
    assert ranking.order == ()
    assert ranking.leaders == ()


def test_those_that_beat_each_other_in_a_circle_share_the_first_rank() -> None:
    """Of three outputs each tells one pair apart, and in each the third controller is anywhere."""
    low, high, wide = noisy(1.0, 1), noisy(2.0, 2), [0.0, 3.1] * 6
    ranking = of(
        {"a": low, "b": high, "c": wide, "d": noisy(9.0, 3)},
        second={"a": wide, "b": low, "c": high, "d": noisy(9.0, 3)},
        third={"a": high, "b": wide, "c": low, "d": noisy(9.0, 3)},
    )
    assert ranking.tested
    assert ranks(ranking) == {"a": 1, "b": 1, "c": 1, "d": 4}
    assert set(ranking.leaders) == {"a", "b", "c"}


def test_what_is_ranked_by_is_summed_up_over_the_runs_that_are_left(tmp_path: Path) -> None:
    """One run completes far from its reference: its step times count, its error where no other is left."""
    lags = [0.3, 0.5, 0.4, 50.0]
    results = make_results_in(
        tmp_path,
        lambda key, seed: make_trace(lags[seed], step_time=1e-5 * (seed + 1)),
        {"a": {"type": "a"}},
        seeds=[*range(4)],
    )
    error, step = "mean_abs_error.angle [deg]", "solve_time_max [s]"
    *left, failed = results.cases
    assert [case.failed for case in results.cases] == [False, False, False, True]
    assert summed(results.cases, error) == left[2].metrics[error]
    assert summed([failed], error) == failed.metrics[error] > 2 * left[1].metrics[error]
    assert summed(results.cases, step) == pytest.approx(12e-5)
