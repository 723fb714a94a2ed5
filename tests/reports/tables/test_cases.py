"""The table of the cases."""

from dataclasses import replace

from ddpc_cosim import Outcome
from ddpc_reports.comparison import conditions
from ddpc_reports.tables.cases import cases_table

from ..synthetic import MakeResults, make_trace


def test_of_thousands_of_cases_those_that_failed_and_the_first_seeds_are_listed(
    make_results: MakeResults,
) -> None:
    results = make_results()
    cases = [
        replace(case, id=f"{case.id}{seed}", seed=seed, failed=seed % 5 == 0)
        for case in results.cases
        for seed in range(1000)
    ]
    many = replace(results, cases=tuple(cases))
    table = cases_table(many, conditions(many), "x-")
    assert table.caption == "1500 of 2000 cases"
    shown = {(row.header, int(row.cells[0].text)) for row in table.rows}
    assert {(case.label, case.seed) for case in cases if case.failed} < shown
    assert {(case.label, case.seed) for case in cases if case.seed < 600} < shown
    few = cases_table(results, conditions(results), "x-")
    assert (few.caption, len(few.rows)) == ("Every case (2)", 2)


def test_why_a_case_ended_stands_with_its_outcome(make_results: MakeResults) -> None:
    reason = f"no file /home/jo/own.csv {'x' * 200}"
    results = make_results(lambda key, seed: make_trace(0.5, outcome=Outcome.CRASHED, reason=reason))
    cell = cases_table(results, conditions(results), "x-").rows[0].cells[1]
    assert (cell.text, cell.failed) == ("crashed", True)
    assert cell.detail.startswith("no file own.csv xxx")
    assert len(cell.detail) == 80
    results = make_results(lambda key, seed: make_trace(30.0))
    cell = cases_table(results, conditions(results), "x-").rows[0].cells[1]
    assert (cell.text, cell.failed) == ("completed, failed", True)
    assert cell.detail == results.cases[0].failure
    assert cell.detail.endswith(" % of its task away from its reference")
