"""Scenarios compared, published with reproduced values, and claims checked, derived here from the cases."""

import html
import math
import re
from dataclasses import replace
from statistics import median
from typing import Any

import pytest
from rich.console import Console

from ddpc_cosim import StudyResults, Trace
from ddpc_cosim.cli.summary import summary_table
from ddpc_cosim.files.tables import Row, Table
from ddpc_cosim.metrics import METRICS, Metric
from ddpc_cosim.responses import Response
from ddpc_reports.comparison import conditions
from ddpc_reports.tables.cases import cases_table
from ddpc_reports.tables.controllers import (
    RESPONSE,
    claims_table,
    reproduction_statements,
    reproduction_table,
)
from ddpc_reports.verdict import across_statements

from ..synthetic import MakeResults, make_trace, ranked

COST = "sum_abs_error.angle [deg]"


SCENARIOS = {"calm": {}, "noisy": {"label": "Noisy", "noise": {"angle": 0.01}}}


def plain(text: object) -> str:
    return re.sub("<[^>]*>", "", str(text))


def median_cost(results: StudyResults, controller: str, scenario: str) -> float:
    (case,) = (c for c in results.cases if (c.controller, c.scenario) == (controller, scenario))
    return case.metrics["mean_abs_error.angle [deg]"]


def test_different_winners_are_named_with_their_scenarios(make_results: MakeResults) -> None:
    results = make_results(scenarios=SCENARIOS)
    other = {"quick": "slow", "slow": "quick"}
    swapped = tuple(
        replace(case, controller=other[case.controller], label=other[case.controller])
        if case.scenario == "noisy"
        else case
        for case in results.cases
    )
    (statement,) = across_statements(conditions(replace(results, cases=swapped)))
    assert plain(statement.text) == "quick has the smallest mean absolute error in calm; slow in Noisy."


SEEDS = [7, 0, 1, 2]


def lags(key: str, seed: int) -> Trace:
    return make_trace({"printed": 0.3, "code": 0.5}[key] + 0.1 * SEEDS.index(seed), noise_seed=seed)


def study_with(make_results: MakeResults, published: float, **method: Any) -> StudyResults:
    methods = [{"label": "Method", "printed": "printed", "values": {COST: published}, **method}]
    reproduction = {"source": "Table 9", "metrics": {COST: "Absolute error"}, "methods": methods}
    controllers = {"printed": {"type": "a"}, "code": {"type": "a"}}
    return make_results(lags, controllers, seeds=SEEDS, report={"reproduction": reproduction})


def test_a_new_metric_needs_its_entry_in_the_registry_alone(
    make_results: MakeResults, monkeypatch: pytest.MonkeyPatch
) -> None:
    peak = Metric(
        Response,
        "Highest value",
        "highest value - in full",
        lambda response: float(response.variable.shown_in.from_unit(response.values).max()),
        "value",
        better="high",
    )
    monkeypatch.setitem(METRICS, "peak", peak)
    results = make_results(seeds=[7, 0, 1, 2, 3, 4], scenarios=SCENARIOS)
    assert all("peak.angle [deg]" in case.metrics for case in results.cases)
    seen = conditions(results)
    assert marked(ranked(seen[0]), "highest value (°)") == ["quick"]
    assert "highest value of angle (°)" in [
        heading.words for heading in cases_table(results, seen, "x-").headings
    ]
    console = Console(width=200)
    with console.capture() as capture:
        console.print(summary_table(results, console))
    assert "highest value" in capture.get()


def test_every_figure_of_the_step_response_that_reports_show_stands_in_its_table() -> None:
    figures = {name for name, metric in METRICS.items() if metric.if_held and "report" in metric.shown}
    assert figures | {"rmse"} == set(RESPONSE)


@pytest.mark.parametrize(("better", "names"), [("low", ["quick"]), ("high", ["slow"]), ("", [])])
def test_the_best_of_a_column_follows_from_the_direction_of_its_metric(
    make_results: MakeResults, monkeypatch: pytest.MonkeyPatch, better: Any, names: list[str]
) -> None:
    monkeypatch.setitem(METRICS, "settled_error", replace(METRICS["settled_error"], better=better))
    table = ranked(conditions(make_results())[0])
    assert marked(table, "settled error (°)") == names


def marked(table: Table, heading: str) -> list[str]:
    """Return who is marked in a column."""
    column = [column_heading.words for column_heading in table.headings[1:]].index(heading)
    return [row.header for row in table.rows if row.cells[column].best]


def only_row(results: StudyResults) -> Row:
    reproduction = results.study.report.reproduction
    assert reproduction is not None
    (row,) = reproduction_table(conditions(results)[0], reproduction, "").rows
    return row


def costs(results: StudyResults, key: str) -> list[float]:
    return [case.metrics[COST] for case in results.cases if case.controller == key]


def test_a_row_compares_with_the_published_code_where_there_is_one(make_results: MakeResults) -> None:
    results = study_with(make_results, 150.0, published_code="code")
    _, published, code, printed, middle, _, within, deviation = only_row(results).cells
    assert published.raw == 150.0
    assert code.raw == pytest.approx(costs(results, "code")[0])
    assert printed.raw == pytest.approx(costs(results, "printed")[0])
    assert middle.raw == pytest.approx(median(costs(results, "code")))
    low, high = min(costs(results, "code")), max(costs(results, "code"))
    assert within.text == ("yes" if low <= 150.0 <= high else "no")
    assert deviation.raw == pytest.approx(costs(results, "code")[0] / 150.0 - 1)


def test_without_published_code_the_printed_method_stands_in(make_results: MakeResults) -> None:
    results = study_with(make_results, 150.0)
    _, _, code, _, middle, _, _, deviation = only_row(results).cells
    assert code.text == "\N{EN DASH}"
    assert middle.raw == pytest.approx(median(costs(results, "printed")))
    assert deviation.raw == pytest.approx(costs(results, "printed")[0] / 150.0 - 1)


@pytest.mark.parametrize(("published", "word"), [(1.0, "no"), (1e5, "no")])
def test_a_published_value_outside_the_range_is_called_so(
    make_results: MakeResults, published: float, word: str
) -> None:
    assert only_row(study_with(make_results, published)).cells[6].text == word


def test_a_published_value_inside_the_range_is_called_so(make_results: MakeResults) -> None:
    inside = median(costs(study_with(make_results, 1.0), "printed"))
    assert only_row(study_with(make_results, inside)).cells[6].text == "yes"


def test_samples_at_rest_that_the_publication_counts_have_a_row_of_their_own(
    make_results: MakeResults,
) -> None:
    results = study_with(make_results, 150.0, rest_samples=2)
    reproduction = results.study.report.reproduction
    assert reproduction is not None
    uncounted, counted = reproduction_table(conditions(results)[0], reproduction, "").rows
    assert uncounted.header == "sum of absolute errors (Absolute error), from the first decision on"
    at_rest = "2 samples at rest counted too, as published"
    assert counted.header == f"sum of absolute errors (Absolute error), {at_rest}"
    assert [cell.text for cell in (uncounted.cells[1], uncounted.cells[6], uncounted.cells[7])] == [
        "\N{EN DASH}"
    ] * 3
    assert uncounted.cells[3].raw == pytest.approx(costs(results, "printed")[0])
    (first, *_) = (case.trace() for case in results.cases if case.controller == "printed")
    error = abs(math.degrees(first.reference[0, 0] - first.y[0, 0]))
    assert error > 19.0
    assert counted.cells[1].raw == 150.0
    assert counted.cells[3].raw == pytest.approx(costs(results, "printed")[0] + 2 * error, rel=1e-12)
    assert counted.cells[7].raw == pytest.approx(counted.cells[3].raw / 150.0 - 1)


TIME = "solve_time_mean [s]"


def timed(make_results: MakeResults, fast: float, slow: float) -> StudyResults:
    """Return a study whose steps took so long, of which 1 us and 2 us are published."""
    methods = [
        {"label": "A <1>", "printed": "a", "values": {TIME: 1e-6}},
        {"label": "B", "printed": "b", "values": {TIME: 2e-6}},
    ]
    reproduction = {"source": "Table 9", "metrics": {TIME: "Step time"}, "methods": methods}
    times = {"a": fast, "b": slow}
    return make_results(
        lambda key, seed: make_trace(0.3, step_time=times[key]),
        {"a": {"type": "a"}, "b": {"type": "b"}},
        seeds=SEEDS,
        report={"reproduction": reproduction},
    )


@pytest.mark.parametrize(
    ("fast", "slow", "words"),
    [
        (1e-5, 3e-5, "the same order: A <1>, B (about 3.0 times as long)"),
        (4e-5, 1e-5, "reversed order: B, A <1> (about 4.0 times as long)"),
    ],
)
def test_of_times_on_another_machine_the_order_alone_is_compared(
    make_results: MakeResults, fast: float, slow: float, words: str
) -> None:
    results = timed(make_results, fast, slow)
    reproduction = results.study.report.reproduction
    assert reproduction is not None
    table = reproduction_table(conditions(results)[0], reproduction, "")
    assert {cell.text for row in table.rows for cell in row.cells[6:]} == {"\N{EN DASH}"}
    (statement,) = reproduction_statements(conditions(results)[0], reproduction)
    assert "A &lt;1&gt;" in statement.text
    sentence = html.unescape(plain(statement.text))
    assert sentence == f"Published, shortest first: A <1>, B (about 2.0 times as long). In this run, {words}."


CLAIMED = "mean_abs_error.angle"
LAGS = {"quick": 0.3, "slow": 1.0, "slow-1": 1.01}
CLAIMING: dict[str, dict[str, Any]] = {
    "quick": {"type": "a", "label": "Quick"},
    "slow": {"type": "b", "label": "Slow"},
    "slow-1": {"type": "b", "label": "Slow, weight = 1", "variant_of": "slow", "varied": ["weight"]},
}


def claiming(make_results: MakeResults, *claims: dict[str, Any], **more: Any) -> StudyResults:
    report = {"claims": [{"text": "So it is", "metric": CLAIMED, **claim} for claim in claims]}
    return make_results(
        lambda key, seed: make_trace(LAGS[key], noise_seed=seed),
        CLAIMING,
        **{"seeds": [7, 8], "report": report, **more},
    )


def table_of(results: StudyResults) -> Table:
    table = claims_table(results, "")
    assert table is not None
    return table


def texts(row: Row) -> list[str]:
    return [cell.text for cell in row.cells]


@pytest.mark.parametrize(
    ("claim", "checked_by", "verdict", "runs"),
    [
        ({"lowest": "quick"}, "lowest with Quick", "holds", "2 of 2"),
        ({"highest": "quick"}, "highest with Quick", "does not hold", "0 of 2"),
        ({"order": ["quick", "slow"]}, "Quick < Slow", "holds", "2 of 2"),
        (
            {"alike": "slow", "within": 2.5},
            "no more than 2.5 % apart over the sweep of Slow",
            "holds",
            "2 of 2",
        ),
        (
            {"alike": "slow", "within": 0.1},
            "no more than 0.1 % apart over the sweep of Slow",
            "does not hold",
            "0 of 2",
        ),
    ],
)
def test_a_claim_stands_with_what_it_is_checked_by_and_its_runs(
    claim: dict[str, Any], checked_by: str, verdict: str, runs: str, make_results: MakeResults
) -> None:
    table = table_of(claiming(make_results, claim, source="A book"))
    assert table.caption == "What is claimed in A book"
    assert [heading.words for heading in table.headings] == ["Claim", "here it", "checked by", "runs"]
    (row,) = table.rows
    assert row.header == "So it is"
    assert texts(row) == [verdict, f"mean absolute error of angle: {checked_by}", runs]
    assert row.cells[0].failed == (verdict == "does not hold")


def test_scenarios_have_a_column_each(make_results: MakeResults) -> None:
    scenarios = {"calm": {}, "windy": {"label": "Windy"}}
    table = table_of(claiming(make_results, {"lowest": "quick"}, {"lowest": "slow"}, scenarios=scenarios))
    assert [heading.words for heading in table.headings[3:]] == ["calm (runs)", "Windy (runs)"]
    assert [texts(row)[2:] for row in table.rows] == [["2 of 2", "2 of 2"], ["0 of 2", "0 of 2"]]


def test_what_no_run_can_tell_is_not_called_wrong(make_results: MakeResults) -> None:
    (row,) = table_of(claiming(make_results, {"lowest": "quick", "metric": "mean_abs_error.speed"})).rows
    assert texts(row)[::2] == ["cannot be judged", "\N{EN DASH}"]
    assert not row.cells[0].failed


def test_a_study_without_claims_has_no_table(make_results: MakeResults) -> None:
    assert claims_table(claiming(make_results), "") is None
