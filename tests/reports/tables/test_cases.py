"""The tables of fallbacks, of warnings before the loop, and of what is known of the data."""

from dataclasses import replace

import numpy as np
import pytest

from ddpc_cosim import Outcome, Trace
from ddpc_reports.comparison import conditions
from ddpc_reports.page import render_page
from ddpc_reports.tables.cases import (
    cases_table,
    diagnostics_table,
    failures_table,
    fallbacks_table,
    warnings_table,
)

from ..synthetic import MakeResults, make_trace


def test_reasons_for_fallbacks_are_told_with_their_first_time(make_results: MakeResults) -> None:
    results = make_results(
        lambda key, seed: make_trace(0.5, fallbacks=4 if key == "slow" else 0, noise_seed=seed), seeds=[7, 8]
    )
    table = fallbacks_table(conditions(results), "x-")
    assert table is not None
    (row,) = table.rows
    assert (row.header, [cell.text for cell in row.cells]) == (
        "slow",
        ["infeasible", "8", "2", "5.7\u00a0s (seed 7)"],
    )
    assert "infeasible" in render_page([results])


def test_reasons_that_differ_in_a_number_are_one_with_its_range(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5)
        said = [f"off by {k}.0e-02; held" for k in (3, 1, 2)]
        return replace(trace, status=("ok", *said, *trace.status[4:]))

    table = fallbacks_table(conditions(make_results(trace_of, {"only": {"type": "x"}})), "x-")
    assert table is not None
    (row,) = table.rows
    assert [cell.text for cell in row.cells][:2] == ["off by 1.0e-02 … 3.0e-02; held", "3"]


@pytest.mark.parametrize("outcome", [Outcome.CONTROLLER_ERROR, Outcome.TIMED_OUT, Outcome.CRASHED])
def test_the_fault_that_ends_a_case_is_no_fallback(outcome: Outcome, make_results: MakeResults) -> None:
    """A controller that raises, or never returns, leaves a row without inputs."""

    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5, outcome=outcome, reason="boom")
        u = np.vstack([trace.u[:-1], np.full_like(trace.u[-1:], np.nan)])
        return replace(trace, u=u, status=(*trace.status[:-1], "error"))

    (condition,) = conditions(make_results(trace_of))
    assert fallbacks_table([condition], "x-") is None
    assert [one.total("failures [1]") for one in condition.controllers] == [0, 0]


def test_warnings_before_the_loop_have_a_table_with_their_cases(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        said = (f"a dead time of {seed} samples",) if key == "slow" else ()
        return replace(make_trace(0.5, noise_seed=seed), warnings=said)

    results = make_results(trace_of, seeds=[7, 8])
    table = warnings_table(results, "x-")
    assert table is not None
    (row,) = table.rows
    assert (row.header, [cell.text for cell in row.cells]) == ("slow", ["a dead time of 7 samples", "2", "7"])
    assert "a dead time of 7 samples" in render_page([results])


def test_there_is_no_table_of_warnings_without_any(make_results: MakeResults) -> None:
    assert warnings_table(make_results(lambda key, seed: make_trace(0.5)), "x-") is None


def test_predictions_on_what_was_held_out_are_judged(make_results: MakeResults) -> None:
    found = {"level.prediction_error": 0.04, "level.prediction_error_fitted": 0.03}
    poor = {"prediction_error": 0.9, "prediction_error_fitted": 0.1}
    results = make_results(lambda key, seed: make_trace(0.5, diagnostics=found if key == "slow" else poor))
    (condition,) = conditions(results)
    table = diagnostics_table(condition, "x-")
    assert table is not None
    texts = {row.header: row.cells[0].text for row in table.rows}
    assert texts["level prediction error, held out"] == "0.04000: good"
    assert texts["level prediction error, fitted"] == "0.03000"
    assert texts["prediction error, held out"].startswith("0.9000: poor: what it was fitted to")


def test_of_thousands_of_cases_that_failed_the_first_are_listed_and_the_others_counted(
    make_results: MakeResults,
) -> None:
    results = make_results(lambda key, seed: make_trace(0.5, outcome=Outcome.CRASHED, reason="boom"))
    cases = tuple(replace(case, seed=seed) for case in results.cases for seed in range(500))
    table = failures_table(replace(results, cases=cases), "x-")
    assert table is not None
    assert table.caption == "Cases that did not complete (1000)"
    assert len(table.rows) == 50
    assert table.notes == ("And 950 more: their outcomes are in metrics.csv, their reasons in run.json.",)


def test_of_thousands_of_cases_the_lost_ones_and_the_first_seeds_are_listed(
    make_results: MakeResults,
) -> None:
    results = make_results()
    cases = [
        replace(case, id=f"{case.id}{seed}", seed=seed, holds=seed % 5 > 0)
        for case in results.cases
        for seed in range(1000)
    ]
    many = replace(results, cases=tuple(cases))
    table = cases_table(many, conditions(many), "x-")
    assert table.caption == "1500 of 2000 cases"
    shown = {(row.header, int(row.cells[0].text)) for row in table.rows}
    assert {(case.label, case.seed) for case in cases if not case.holds} < shown
    assert {(case.label, case.seed) for case in cases if case.seed < 600} < shown
    few = cases_table(results, conditions(results), "x-")
    assert (few.caption, len(few.rows)) == ("Every case (2)", 2)
