"""Sweeps in the report: a map of the error for each, and nothing of them among the controllers."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_reports.comparison import conditions
from ddpc_reports.numbers import MISSING, significant
from ddpc_reports.page import render_page
from ddpc_reports.sensitivity import effects_table, sensitivity_figures, sweep_statements

from .synthetic import make_results_in, make_trace

LAGS = {"slow": 1.0, "slow-a-1-b-1": 0.3, "slow-a-1-b-2": 0.6, "slow-a-2-b-1": 0.9, "slow-a-2-b-2": 1.2}


def sections() -> dict[str, dict[str, Any]]:
    """Return a controller and a sweep of two settings, as a resolved study lists them."""
    varied = {
        f"slow-a-{a}-b-{b}": {
            "type": "slow",
            "settings": {"a": a, "b": b},
            "variant_of": "slow",
            "varied": ["a", "b"],
        }
        for a in (1, 2)
        for b in (1, 2)
    }
    objects = {
        f"slow-c-{n}": {
            "type": "slow",
            "settings": {"c": {"type": "module:C", "count": n, "low": 0.0}},
            "variant_of": "slow",
            "varied": ["c"],
        }
        for n in (3, 5)
    }
    settings = {"a": 1, "b": 2, "c": {"type": "module:C", "count": 5, "low": 0.0}}
    return {"slow": {"type": "slow", "label": "Slow", "settings": settings}} | varied | objects


def trace_of(key: str, seed: int) -> Trace:
    if key == "slow-a-2-b-2":
        return make_trace(1.0, outcome=Outcome.DIVERGED, reason="angle is infinite")
    return make_trace(LAGS.get(key, 1.0), noise_seed=seed)


@pytest.fixture
def results(tmp_path: Path) -> StudyResults:
    return make_results_in(tmp_path, trace_of, sections(), seeds=[7, 8, 9])


def rows_of(results: StudyResults, number: int) -> list[dict[str, Any]]:
    spec = sensitivity_figures(conditions(results)[0], "x-")[number].views[0].spec
    rows: list[dict[str, Any]] = spec["data"]["values"]
    return rows


def test_variants_are_no_competitors(results: StudyResults) -> None:
    (condition,) = conditions(results)
    assert [controller.key for controller in condition.controllers] == ["slow"]
    assert len(condition.variants) == 6


def test_controllers_beside_a_sweep_have_colours_of_their_own(tmp_path: Path) -> None:
    controllers = sections() | {"other": {"type": "x"}}
    results = make_results_in(tmp_path, lambda key, seed: make_trace(0.5), controllers)
    (condition,) = conditions(results)
    assert {controller.key: controller.index for controller in condition.controllers} == {
        "slow": 0,
        "other": 1,
    }
    assert {variant.index for variant in condition.variants} == {0}


def test_the_verdict_names_best_and_worst_settings_and_those_that_failed(results: StudyResults) -> None:
    (statement,) = sweep_statements(conditions(results)[0])
    text = re.sub("<[^>]*>", "", str(statement.text))
    assert text.startswith("6 settings of Slow: best ")
    assert "with a = 1, b = 1, worst of those without a failed run " in text
    assert text.endswith("With failed runs: 1 of 6: a = 2, b = 2.")


def test_variants_alone_give_a_report(results: StudyResults) -> None:
    variants = tuple(case for case in results.cases if case.controller != "slow")
    page = render_page([replace(results, cases=variants)])
    assert "6 settings in sweeps" in page
    assert 'id="s1-sensitivity"' in page


def test_a_cell_with_a_failed_case_is_starred(tmp_path: Path) -> None:
    def one_fails(key: str, seed: int) -> Trace:
        if (key, seed) == ("slow-a-1-b-1", 7):
            return make_trace(1.0, outcome=Outcome.DIVERGED, reason="angle is infinite")
        return make_trace(0.5)

    results = make_results_in(tmp_path, one_fails, sections(), seeds=[7, 8])
    cells = {(row["y"], row["x"]): row for row in rows_of(results, 0)}
    assert cells["1", "1"]["shown"].endswith(" *")
    assert cells["1", "1"]["text"].endswith("; 1 of 2 cases failed")
    assert not cells["1", "2"]["shown"].endswith("*")
    assert "Starred" in sensitivity_figures(conditions(results)[0], "x-")[0].caption


def test_each_cell_is_the_median_over_the_seeds(results: StudyResults) -> None:
    cells = {(row["y"], row["x"]): row for row in rows_of(results, 0)}
    assert list(cells) == [("1", "1"), ("1", "2"), ("2", "1"), ("2", "2")]
    for (a, b), row in cells.items():
        values = sorted(
            case.metrics["mean_abs_error.angle [deg]"]
            for case in results.cases
            if case.controller == f"slow-a-{a}-b-{b}" and case.outcome is Outcome.COMPLETED
        )
        if (a, b) == ("2", "2"):
            assert (row["value"], row["shown"], values) == (None, "failed", [])
        else:
            assert row["value"] == values[1]
            assert f"a = {a}, b = {b}" in row["text"]


def test_the_controllers_own_settings_are_framed(results: StudyResults) -> None:
    assert [(row["y"], row["x"]) for row in rows_of(results, 0) if row["own"]] == [("1", "2")]
    assert [row["x"] for row in rows_of(results, 1) if row["own"]] == ["count 5"]


def test_one_setting_makes_a_strip_and_an_object_is_told_by_what_differs(results: StudyResults) -> None:
    assert [(row["y"], row["x"]) for row in rows_of(results, 1)] == [("", "count 3"), ("", "count 5")]


def test_the_page_has_the_section_only_with_sweeps(results: StudyResults, tmp_path: Path) -> None:
    page = render_page([results])
    assert 'id="s1-sensitivity"' in page
    assert "Slow: mean absolute error of angle in ° over a and b" in page
    assert "Median over 3 seeds" in page
    assert 'id="s1-sensitivity"' not in render_page([make_results_in(tmp_path / "plain")])


def test_three_settings_are_drawn_over_two(tmp_path: Path) -> None:
    varied = {
        f"slow-{a}{b}{c}": {
            "type": "slow",
            "settings": {"a": a, "b": b, "c": c},
            "variant_of": "slow",
            "varied": ["a", "b", "c"],
        }
        for a in (1, 2)
        for b in (1, 2)
        for c in (1, 2)
    }
    results = make_results_in(tmp_path, trace_of, {"slow": {"type": "slow"}} | varied)
    (figure,) = sensitivity_figures(conditions(results)[0], "x-")
    assert len(rows_of(results, 0)) == 4
    assert "Median over the values of c." in figure.caption
    assert all(math.isfinite(row["value"]) for row in rows_of(results, 0))


def test_which_settings_matter_is_computed_of_all_runs(results: StudyResults) -> None:
    """Lags of 0.3 and 0.6 (a = 1) rank 1 to 6, of 0.9 (a = 2) 7 to 9; three failed runs share 10 to 12."""
    table = effects_table(conditions(results)[0], "")
    assert table
    rows = {row.header: [cell.text for cell in row.cells] for row in table.rows}
    assert list(rows) == ["Slow: a", "Slow: b", "Slow: c"]
    ranks = [1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 11, 11]
    correlation = np.corrcoef([1] * 6 + [2] * 6, ranks)[0, 1]
    share = 1 - (1 - correlation**2) * 11 / 10
    assert rows["Slow: a"] == ["2", "3 of 12", significant(correlation, 2), significant(100 * share, 2)]
    assert rows["Slow: c"][2] == MISSING
    assert effects_table(replace(conditions(results)[0], variants=()), "") is None
