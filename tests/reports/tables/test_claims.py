"""The table of claims says what is claimed, by what it is checked, and in how many runs it is so."""

from typing import Any

import pytest

from ddpc_cosim import StudyResults
from ddpc_cosim.tables import Row, Table
from ddpc_reports.tables.claims import claims_table

from ..synthetic import MakeResults, make_trace

ERROR = "mean_abs_error.angle"
LAGS = {"quick": 0.3, "slow": 1.0, "slow-1": 1.01}
CONTROLLERS: dict[str, dict[str, Any]] = {
    "quick": {"type": "a", "label": "Quick"},
    "slow": {"type": "b", "label": "Slow"},
    "slow-1": {"type": "b", "label": "Slow, weight = 1", "variant_of": "slow", "varied": ["weight"]},
}


def claiming(make_results: MakeResults, *claims: dict[str, Any], **more: Any) -> StudyResults:
    report = {"claims": [{"text": "So it is", "metric": ERROR, **claim} for claim in claims]}
    return make_results(
        lambda key, seed: make_trace(LAGS[key], noise_seed=seed),
        CONTROLLERS,
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
