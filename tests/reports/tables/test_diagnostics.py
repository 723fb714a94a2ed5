"""The tables of what controllers learned from: a row each, worst values, and the judgement of all runs."""

import json
from dataclasses import replace
from typing import Any

from ddpc_cosim import StudyResults, Trace
from ddpc_cosim.files.tables import Table
from ddpc_reports.comparison import conditions
from ddpc_reports.numbers import TIMES
from ddpc_reports.tables.diagnostics import diagnostics_tables

from ..synthetic import MakeResults, make_trace

GOOD = {"pe_order": 100.0, "pe_order_needed": 11.0, "data_rank": 15.0, "data_rows": 16.0, "condition": 1e3}
GOOD |= {"prediction_error": 0.04, "prediction_error_fitted": 0.03}


def tables_of(results: StudyResults) -> list[Table]:
    return diagnostics_tables(conditions(results), "x-")


def rows_of(table: Table) -> dict[str, dict[str, str]]:
    """Return the texts by row and column."""
    titles = [heading.words for heading in table.headings[1:]]
    return {
        f"{row.group}/{row.header}": dict(zip(titles, [cell.text.strip() for cell in row.cells], strict=True))
        for row in table.rows
    }


def with_diagnostics(diagnostics: dict[str, Any]) -> Trace:
    return replace(make_trace(0.5, diagnostics=diagnostics), recorded_samples=200)


def test_the_worst_of_all_seeds_is_shown_and_judged(make_results: MakeResults) -> None:
    """Oracle: the extremes of what the files of the cases say."""

    def trace_of(key: str, seed: int) -> Trace:
        error = seed / 10
        changed = {"prediction_error": error, "prediction_error_fitted": 0.04, "condition": 10.0**seed}
        return with_diagnostics(GOOD | changed | {"pe_order": 100.0 - seed})

    results = make_results(trace_of, {"only": {"type": "x"}}, seeds=[1, 3, 6])
    (table,) = tables_of(results)
    by_seed = [
        json.loads((case.folder / "run.json").read_text(encoding="utf-8"))["diagnostics"]
        for case in results.cases
    ]
    row = rows_of(table)["/only"]
    assert float(row["PE order reached"]) == min(diagnostics["pe_order"] for diagnostics in by_seed)
    assert row["PE order needed"] == "11"
    assert row["samples"] == "200"
    assert row["data matrix rank"] == "15 of 16"
    assert row["data matrix condition"] == f"1.00\u202f{TIMES}\u202f10⁶"
    assert float(row["prediction error held out (worst)"]) == max(
        diagnostics["prediction_error"] for diagnostics in by_seed
    )
    assert float(row["prediction error held out (median)"]) == 0.3
    assert float(row["prediction error fitted (median)"]) == 0.04
    assert row["judgement"].startswith("poor in 1 of 3 runs: what it was fitted to is predicted far better")


def test_good_data_are_called_good_and_inputs_that_excite_too_little_poor(make_results: MakeResults) -> None:
    little = GOOD | {"pe_order": 8.0}
    results = make_results(lambda key, seed: with_diagnostics(GOOD if key == "slow" else little))
    (table,) = tables_of(results)
    said = {name: row["judgement"] for name, row in rows_of(table).items()}
    assert said == {
        "/slow": "good",
        "/quick": "poor: the inputs excite 8 orders of the 11 that are needed",
    }


def test_where_no_prediction_was_tested_nothing_is_judged(make_results: MakeResults) -> None:
    untested = {"pe_order": 12.0, "pe_order_needed": 11.0}
    (table,) = tables_of(make_results(lambda key, seed: with_diagnostics(untested)))
    assert {row["judgement"] for row in rows_of(table).values()} == {"not judged: prediction not tested"}
    assert "prediction error held out" not in [heading.words for heading in table.headings]


def test_scenarios_with_the_same_data_are_one_and_parts_are_named(make_results: MakeResults) -> None:
    results = make_results(
        lambda key, seed: with_diagnostics({f"level.{name}": value for name, value in GOOD.items()}),
        {"only": {"type": "x"}},
        scenarios={"calm": {}, "windy": {}, "short": {}},
    )
    cases = [
        replace(case, recorded_samples=50) if case.scenario == "short" else case for case in results.cases
    ]
    (alike,) = tables_of(results)
    assert [*rows_of(alike)] == ["/only: level"]
    (table,) = tables_of(replace(results, cases=tuple(cases)))
    assert {name: row["samples"] for name, row in rows_of(table).items()} == {
        "calm; windy/only: level": "200",
        "short/only: level": "50",
    }


def test_what_else_controllers_say_is_one_row_each_with_ranges(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        return make_trace(0.5, diagnostics={"gain[0]": 2.0, "gain[1]": 0.5 * seed, "model_order": 4.0})

    (table,) = tables_of(make_results(trace_of, {"only": {"type": "x"}}, seeds=[1, 2, 3]))
    assert rows_of(table) == {"/only": {"values": "gain 2, 1 (0.500 … 1.50); model order 4"}}


def test_controllers_that_say_nothing_have_no_tables(make_results: MakeResults) -> None:
    assert tables_of(make_results()) == []
