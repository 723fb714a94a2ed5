"""The verdict says what the figures carry, and nothing else."""

import re
from dataclasses import replace
from statistics import median

import numpy as np
import pytest

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.files.tables import Table
from ddpc_cosim.metrics import MetricSettings
from ddpc_cosim.study.verdicts.sentences import join_words
from ddpc_reports.comparison import Condition, conditions
from ddpc_reports.page import render_page
from ddpc_reports.tables.cases import cases_table
from ddpc_reports.tables.controllers import limits_table, response_table
from ddpc_reports.verdict import across_statements, limitations

from .synthetic import ANGLE, FORCE, SPEED, TORQUE, MakeResults, findings_of, make_trace, ranked

SEEDS = [7, 0, 1]


COST = "mean_abs_error.angle [deg]"


def statements(results: StudyResults) -> dict[str, str]:
    """Return the verdict on the first condition as plain text, by topic."""
    return {topic: re.sub("<[^>]*>", "", str(text)) for topic, text in findings_of(only(results))}


def only(results: StudyResults) -> Condition:
    return conditions(results)[0]


def best(table: Table) -> dict[str, list[str]]:
    """Return who is marked in each column."""
    marks = {}
    for number, heading in enumerate(table.headings[1:]):
        marks[heading.words] = [row.header for row in table.rows if row.cells[number].best]
    return marks


def lag_by_seed(key: str, seed: int) -> Trace:
    """Make the controller `steady` the best by the median and `lucky` the best at the first seed only."""
    lags = {"steady": {7: 0.5, 0: 0.5, 1: 0.5}, "lucky": {7: 0.2, 0: 1.2, 1: 1.3}}
    return make_trace(lags[key][seed], noise_seed=seed, step_time=1e-5 if key == "steady" else 1e-3)


TWO = {"steady": {"type": "a"}, "lucky": {"type": "b"}}


def test_first_seed_and_median_may_name_different_winners(make_results: MakeResults) -> None:
    said = statements(make_results(lag_by_seed, TWO, seeds=SEEDS))
    assert said["Tracking"].startswith("On seed 7, lucky tracks best")
    assert said["Spread"].startswith("Over 3 seeds, steady has the smallest median")
    assert "ahead of the next, lucky" in said["Spread"]
    assert "on 2 of 3" in said["Spread"]
    assert re.search(
        "To the next: median difference [0-9.]+°\\. 3 seeds are too few to test 2", said["Spread"]
    )
    assert said["Spread"].endswith("controllers against each other: it takes 6.")


def test_the_numbers_in_the_words_are_those_of_the_cases(make_results: MakeResults) -> None:
    results = make_results(lag_by_seed, TWO, seeds=SEEDS)
    costs = [case.metrics[COST] for case in results.cases if case.controller == "steady"]
    said = statements(results)["Spread"]
    assert f"{median(costs):.3f}°" in said
    assert f"(range {min(costs):.3f} to {max(costs):.3f})" in said


def test_where_none_settles_a_note_says_so_and_they_are_ranked(make_results: MakeResults) -> None:
    """Lags of 3 and 4 s leave about a fifth and a quarter of a reference of 6 s."""
    results = make_results(lambda key, seed: make_trace(3.0 if key == "quick" else 4.0, noise_seed=seed))
    left = min(case.metrics["settled_share.angle [%]"] for case in results.cases)
    page = render_page([results])
    notes = re.findall('<p class="remark">(.*?)</p>', page[: page.index("<table")])
    assert notes == [
        f"No controller settles within 5 %: the best leaves {left:.0f} % of a step.",
        "Does not settle within 5 %: quick in 1 of 1 runs, slow in 1 of 1 runs.",
    ]
    assert statements(results)["Tracking"].startswith("On seed 7, quick tracks best")


def test_where_every_run_failed_nobody_wins(make_results: MakeResults) -> None:
    """Lags of 30 and 40 s leave nearly all of a reference of 6 s."""
    results = make_results(lambda key, seed: make_trace(30.0 if key == "quick" else 40.0, noise_seed=seed))
    best_run = min(results.cases, key=lambda case: case.left)
    sentence = f"Every controller fails; in the best run, {best_run.failure}"
    assert re.fullmatch("angle ends 8. % of its task away from its reference", best_run.failure)
    texts = {topic: str(text) for topic, text in findings_of(only(results))}
    assert texts["Reference"] == f"<b>{sentence}</b>, so nothing is ranked."
    assert {"Tracking", "Settling", "Actuator"} & statements(results).keys() == set()
    assert not any(filter(None, best(ranked(only(results))).values()))
    page = render_page([results])
    assert f"<strong>{sentence}.</strong>" in page[: page.index("<table")]


def test_who_is_fastest_and_how_near_the_deadline(make_results: MakeResults) -> None:
    said = statements(make_results(lag_by_seed, TWO, seeds=SEEDS))["Step time"]
    assert said.startswith(
        "steady is fastest: median step time 20.0\u00a0µs; slowest is lucky with 2.00\u00a0ms."
    )
    assert "the longest took 3.00\u00a0ms, 3.0 % of it" in said


def test_late_steps_are_named(make_results: MakeResults) -> None:
    said = statements(make_results(lambda key, seed: make_trace(0.5, step_time=0.06)))["Step time"]
    assert "Steps longer than the sampling time of 100\u00a0ms: quick" in said


def test_fallbacks_are_counted(make_results: MakeResults) -> None:
    results = make_results(lambda key, seed: make_trace(0.5, fallbacks=4 if key == "slow" else 0))
    assert statements(results)["Fallbacks"] == "Controllers fell back on a substitute: slow at 4 samples."


def failing(key: str, seed: int) -> Trace:
    """Let the best tracker fail on one of its seeds."""
    if key == "quick" and seed == 0:
        return make_trace(0.1, outcome=Outcome.DIVERGED, reason="angle is NaN at 3 s")
    return make_trace(0.1 if key == "quick" else 1.0, noise_seed=seed)


def test_a_controller_with_failed_cases_is_named_and_not_ranked_over_the_seeds(
    make_results: MakeResults,
) -> None:
    results = make_results(failing, seeds=SEEDS)
    said = statements(results)
    assert "5 of 6 cases completed; not completed: quick 1 of 3 (diverged)." in said["Completed"]
    assert said["Tracking"].startswith("On seed 7, quick tracks best")
    assert said["Spread"].startswith("Only slow has no failed run")
    assert "smallest" not in said["Spread"]
    marks = best(ranked(only(results)))
    assert marks["mean absolute error (°)"] == []


def losing(key: str, seed: int) -> Trace:
    """Let `quick` settle at a third of the step on one seed, quickly and without moving the input."""
    trace = make_trace(0.3 if key == "quick" else 1.0, noise_seed=seed)
    if key != "quick" or seed != 0:
        return trace
    return replace(trace, y=trace.y / 3, u=trace.u * 0, solve_time=trace.solve_time / 10)


def test_a_run_that_failed_is_told_and_ranked_last(make_results: MakeResults) -> None:
    results = make_results(losing, seeds=[0, 7, 8])
    said = statements(results)
    assert said["Completed"].startswith("All 6 cases completed. Completed, but failed: quick 1 of 3.")
    assert said["Tracking"].startswith("On seed 0, slow reaches a mean absolute error of ")
    assert said["Spread"].startswith("Only slow has no failed run")
    assert not {"Settling", "Actuator"} & said.keys()
    assert "is fastest" not in said["Step time"]
    table = ranked(only(results))
    marked = {who for names in best(table).values() for who in names}
    assert marked <= {"slow"}
    ends = [(row.header, row.cells[0].text, row.cells[-1].text) for row in table.rows]
    assert ends == [("slow", "1", "0 of 3"), ("quick", "2", "1 of 3")]


def test_who_is_first_among_those_without_a_failed_run_is_not_said_to_be_first_of_all(
    make_results: MakeResults,
) -> None:
    """`quick` neither moves the input nor takes long, but failed."""
    controllers = {key: {"type": "x"} for key in ("quick", "slow", "other")}

    def trace_of(key: str, seed: int) -> Trace:
        return losing("quick", 0) if key == "quick" else make_trace(0.3 if key == "slow" else 0.6)

    said = statements(make_results(trace_of, controllers))
    for topic in ("Settling", "Actuator", "Step time"):
        assert said[topic].startswith("Of those without a failed run, "), topic
    many = make_results(trace_of, controllers, seeds=SEEDS, scenarios={"calm": {}, "windy": {}})
    assert "has the smallest median of those without a failed run: " in statements(many)["Spread"]
    ((_, across),) = across_statements(conditions(many))
    assert across.endswith(", of those without a failed run there.")


def test_of_three_the_one_that_failed_is_last(make_results: MakeResults) -> None:
    results = make_results(losing, {key: {"type": "x"} for key in ("quick", "slow", "other")}, seeds=[0, 7])
    said = statements(results)["Tracking"]
    assert said.startswith("On seed 0, slow and other track best")
    assert said.endswith("; last is quick, with failed runs.")


def test_the_notes_say_how_times_that_are_not_reached_are_summed_up(make_results: MakeResults) -> None:
    table = response_table(only(make_results(seeds=SEEDS)), "")
    assert table is not None
    assert "a time that is not reached counts as longer than any" in " ".join(table.notes)


def test_figures_of_the_step_response_are_those_of_runs_that_did_not_fail(make_results: MakeResults) -> None:
    """With one seed, the one that failed has dashes, in this table and in that of all cases."""
    results = make_results(losing, seeds=[0])
    table = response_table(only(results), "")
    assert table is not None
    slow, quick = table.rows
    held = [head.title != "RMSE" for head in table.headings[1:]]
    assert {cell.text for cell, counts in zip(quick.cells, held, strict=True) if counts} == {"\N{EN DASH}"}
    (case,) = (case for case in results.cases if case.controller == "slow")
    rise = next(value for key, value in case.metrics.items() if key.startswith("rise_time."))
    assert [
        cell.raw for cell, head in zip(slow.cells, table.headings[1:], strict=True) if "rise" in head.words
    ] == [pytest.approx(rise)]
    every = cases_table(results, conditions(results), "")
    (row,) = (row for row in every.rows if row.key == "quick")
    texts = dict(
        zip([head.title for head in every.headings[1:]], [cell.text for cell in row.cells], strict=True)
    )
    assert texts["outcome"] == "completed, failed"
    assert texts["overshoot of angle"] == texts["settled error of angle"] == "\N{EN DASH}"
    assert texts["mean absolute error of angle"] != "\N{EN DASH}"


def test_a_time_that_most_seeds_do_not_reach_has_no_median(make_results: MakeResults) -> None:
    """A lag of 3 s does not settle in 6 s: on two of three seeds there is no settling time."""
    results = make_results(
        lambda key, seed: make_trace(3.0 if (key, seed) in (("quick", 7), ("quick", 8)) else 0.3),
        seeds=[0, 7, 8],
    )
    table = response_table(only(results), "")
    assert table is not None
    place = next(i for i, head in enumerate(table.headings[1:]) if head.title == "settling time")
    cells = {row.key: row.cells[place] for row in table.rows}
    assert cells["quick"].text == "\N{EN DASH}"
    assert float(cells["slow"].raw) > 0


def test_what_one_seed_of_three_reaches_does_not_speak_for_all(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.3, noise_seed=seed)
        return trace if key == "slow" or seed == 0 else replace(trace, y=trace.y / 3)

    table = ranked(only(make_results(trace_of, seeds=[0, 7, 8])))
    place = next(i for i, head in enumerate(table.headings[1:]) if head.title == "settled error")
    assert {row.key: row.cells[place].text == "\N{EN DASH}" for row in table.rows} == {
        "quick": True,
        "slow": False,
    }


def test_a_study_with_weights_is_ranked_by_its_cost(make_results: MakeResults) -> None:
    """The cost is of the whole run: one ranking, whatever the number of outputs."""

    def trace_of(key: str, seed: int) -> Trace:
        return make_trace(0.3 if key == "quick" else 1.0, outputs=(ANGLE, SPEED), inputs=(TORQUE, FORCE))

    settings = MetricSettings(cost={"outputs": {"angle": 1.0, "speed": 2.0}})
    said = statements(make_results(trace_of, settings=settings))
    assert said["Cost"].startswith("On seed 7, quick costs least: cost ")
    assert "Tracking" not in said


def test_one_that_failed_may_cost_less_and_is_not_denied_it(make_results: MakeResults) -> None:
    """Inputs weigh here: the run that never moves costs nothing, and fails."""

    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.3 if key == "quick" else 1.0)
        return replace(trace, y=trace.y * 0, u=trace.u * 0) if key == "still" else trace

    controllers = {key: {"type": "x"} for key in ("quick", "slow", "still")}
    weights = MetricSettings(cost={"inputs": {"torque": 1.0}})
    said = statements(make_results(trace_of, controllers, settings=weights))["Cost"]
    assert said.startswith("On seed 7, of the runs that did not fail, quick costs least: ")
    assert said.endswith("; last is still, with failed runs.")


def test_what_cannot_be_judged_is_a_limitation(make_results: MakeResults) -> None:
    said = limitations(conditions(make_results(settings=MetricSettings(56))))
    assert any(text.startswith("Whether angle settles cannot be judged: ") for text in said)
    assert not any("cannot be judged" in text for text in limitations(conditions(make_results())))


def test_a_reference_without_steps_sizes_no_error(make_results: MakeResults) -> None:
    """Regulation: what is left is in parts of what the output does."""

    def at_rest(key: str, seed: int) -> Trace:
        trace = make_trace(0.5)
        return replace(trace, reference=np.zeros_like(trace.reference), y=0.2 * (trace.time > 2.0)[:, None])

    said = limitations(conditions(make_results(at_rest)))
    assert any(text.startswith("The reference of angle has no steps to size an error by: ") for text in said)
    assert not any("settles cannot be judged" in text for text in said)
    assert not any("has no steps" in text for text in limitations(conditions(make_results())))


def test_one_that_completed_nothing_has_no_medians_of_easier_cases(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        falls = key == "quick" or seed == 0
        return make_trace(1.0, outcome=Outcome.DIVERGED if falls else Outcome.COMPLETED)

    said = limitations(conditions(make_results(trace_of, seeds=[7, 0])))
    assert "quick: none of its cases completed, so there are no values of it to compare." in said
    assert any(text.startswith("slow: 1 case did not complete; its medians") for text in said)


def test_where_nothing_completed_nothing_is_ranked(make_results: MakeResults) -> None:
    results = make_results(lambda key, seed: make_trace(0.5, outcome=Outcome.CONTROLLER_ERROR, reason="boom"))
    said = statements(results)
    assert list(said) == ["Completed"]
    assert said["Completed"].startswith("No case completed, so nothing is ranked")
    assert not any(best(ranked(only(results))).values())


def test_one_controller_alone_is_not_called_best(make_results: MakeResults) -> None:
    results = make_results(controllers={"quick": {"type": "a"}})
    said = statements(results)
    assert "tracks best" not in said["Tracking"]
    assert said["Tracking"].endswith("; there is no other controller to compare with.")
    assert not any(best(ranked(only(results))).values())


def test_equal_controllers_share_no_prize(make_results: MakeResults) -> None:
    results = make_results(lambda key, seed: make_trace(0.5))
    assert "all controllers track alike" in statements(results)["Tracking"]
    assert best(ranked(only(results)))["mean absolute error (°)"] == []


def test_the_table_marks_no_median_that_the_seeds_do_not_tell_apart(make_results: MakeResults) -> None:
    results = make_results(lag_by_seed, TWO, seeds=SEEDS)
    marks = best(ranked(only(results)))
    assert marks["mean absolute error (°)"] == []
    assert marks["median step time (ms)"] == ["steady"]  # which the seed does not change

    def quick_ones(key: str, seed: int) -> Trace:
        lags = {"a": 0.3, "b": 0.3 + 0.01 * (-1) ** seed, "c": 0.9, "d": 1.0}
        return make_trace(lags[key], noise_seed=seed, step_time=1e-5 if key == "a" else 1e-3)

    results = make_results(quick_ones, {key: {"type": "a"} for key in "abcd"}, seeds=[*range(8)])
    marks = best(ranked(only(results)))
    assert sorted(marks["mean absolute error (°)"]) == ["a", "b"]
    assert marks["median step time (ms)"] == ["a"]


@pytest.mark.parametrize(
    ("parts", "text"), [(["a"], "a"), (["a", "b"], "a and b"), (["a", "b", "<c>"], "a, b and &lt;c&gt;")]
)
def test_lists_read_as_sentences(parts: list[str], text: str) -> None:
    assert str(join_words(parts)) == text


def test_several_outputs_are_told_in_one_statement_each(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        lag = 0.3 if key == "quick" else 1.0
        return make_trace(lag, outputs=(ANGLE, SPEED), inputs=(TORQUE, FORCE), noise_seed=seed)

    results = make_results(trace_of, seeds=[7, 8, 9])
    texts = statements(results)
    assert texts["Tracking"].startswith(
        "In mean absolute error, medians over 3 seeds and ranges: angle: quick"
    )
    assert "speed: quick" in texts["Tracking"]
    assert "Spread" not in texts
    heads = [heading.words for heading in ranked(only(results)).headings]
    errors = [f"mean absolute error {signal}" for signal in ("angle (°)", "speed (m/s)")]
    assert heads[:4] == ["Controller", "rank", *errors]
    limits = limits_table(only(results), "")
    assert limits is not None
    assert {"total variation torque (N·m)", "total variation force (N)"} <= {
        heading.words for heading in limits.headings
    }
    assert not any("beyond bounds" in head for head in heads)


def test_outputs_without_limits_are_not_said_to_have_kept_them(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5)
        trace.bounds.y_min[:], trace.bounds.y_max[:] = -float("inf"), float("inf")
        return trace

    assert statements(make_results(trace_of))["Bounds"] == "The outputs have no limits here."


def test_little_travel_is_no_merit_where_nothing_is_tracked(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.3 if key == "quick" else 5.0)
        return replace(trace, u=trace.u * (1.0 if key == "quick" else 0.1))

    texts = statements(make_results(trace_of))
    assert texts["Actuator"].startswith("slow moves the actuator least")
    assert "Its mean absolute error is far from the best, though" in texts["Actuator"]


def test_twins_share_the_first_place(make_results: MakeResults) -> None:
    lags = {"a": 0.3, "twin": 0.3, "slow": 1.0}
    results = make_results(
        lambda key, seed: make_trace(lags[key], noise_seed=seed),
        {key: {"type": "x"} for key in lags},
        seeds=[7, 8],
    )
    texts = statements(results)
    assert texts["Tracking"].startswith("On seed 7, a and twin track best")
    assert texts["Spread"].startswith("Over 2 seeds, a and twin share the smallest median")


def test_twins_share_the_first_place_of_each_output_and_scenario(make_results: MakeResults) -> None:
    lags = {"a": 0.3, "twin": 0.3, "slow": 1.0}
    results = make_results(
        lambda key, seed: make_trace(lags[key], outputs=(ANGLE, SPEED), inputs=(TORQUE, FORCE)),
        {key: {"type": "x"} for key in lags},
        scenarios={"calm": {}, "windy": {}},
    )
    assert "angle: a and twin share " in statements(results)["Tracking"]
    ((topic, across),) = across_statements(conditions(results))
    assert topic == "Tracking"
    assert (
        "<b>a</b> and <b>twin</b> share the smallest mean absolute error in <i>calm</i> and <i>windy</i>"
        in across
    )


def test_who_shares_the_best_value_is_not_told_apart_once_more(make_results: MakeResults) -> None:
    """Two of three are the same law: beside their value only the third is not told apart."""

    def trace_of(key: str, seed: int) -> Trace:
        lag = 0.5 + 0.002 * np.random.default_rng([seed, key == "other"]).standard_normal()
        return make_trace(lag, outputs=(ANGLE, SPEED), inputs=(TORQUE, FORCE), noise_seed=seed)

    controllers = {key: {"type": "a"} for key in ("one", "twin", "other")}
    said = str(statements(make_results(trace_of, controllers, seeds=["0:8"]))["Tracking"])
    (sharing,) = re.findall("angle: (.*?)[.] ", said)
    assert sharing.count("twin") == sharing.count("one") == 1
