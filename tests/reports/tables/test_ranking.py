"""The tables of the first screen, derived here once more from the cases."""

import math
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np
import pytest
from markupsafe import Markup

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.files.tables import Cell, Table
from ddpc_cosim.study.verdicts.standings import standings
from ddpc_reports.comparison import conditions
from ddpc_reports.embedding import Drawing
from ddpc_reports.figures import figure, over_time
from ddpc_reports.page import render_page
from ddpc_reports.sections import gather

from ..synthetic import MakeResults, make_trace, ranked

SEEDS = [*range(12)]
KEY = "mean_abs_error.angle [deg]"
LAGS = {"slow": 0.9, "quick": 0.3, "falling": 0.2}
NAMES = {name: {"type": "a"} for name in LAGS}


@pytest.fixture(autouse=True)
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes most of the time and what no table follows from."""
    monkeypatch.setattr(figure, "drawing", lambda *chart: Drawing(Markup("")))
    monkeypatch.setattr(over_time, "brought_to_life", lambda *chart: Drawing(Markup("")))


def run_of(key: str, seed: int) -> Trace:
    """Let one controller be the best of all but for one run."""
    if key == "falling" and seed == 3:
        return make_trace(0.2, outcome=Outcome.DIVERGED, reason="angle is NaN")
    jitter = 1 + 0.02 * np.random.default_rng([seed, len(key)]).standard_normal()
    trace = make_trace(LAGS[key] * jitter, noise_seed=seed)
    return replace(trace, preview=5, recorded_samples=100 if key == "quick" else 0)


def column(table: Table, words: str) -> dict[str, Cell]:
    """Return the cells of a column by controller."""
    number = [heading.words for heading in table.headings[1:]].index(words)
    return {row.key: row.cells[number] for row in table.rows}


def of(results: StudyResults, key: str, scenario: str = "nominal") -> list[float]:
    return [
        case.metrics[KEY]
        for case in results.cases
        if (case.controller, case.scenario) == (key, scenario) and not case.failed
    ]


def test_the_ranked_table_has_ranks_medians_terms_and_failed_runs(make_results: MakeResults) -> None:
    results = make_results(run_of, NAMES, seeds=SEEDS)
    table = ranked(conditions(results)[0])
    assert [row.key for row in table.rows] == ["quick", "slow", "falling"]
    assert table.sortable
    assert {key: cell.raw for key, cell in column(table, "rank").items()} == {
        "quick": 1,
        "slow": 2,
        "falling": 3,
    }
    errors = column(table, "mean absolute error (°)")
    assert {key: cell.raw for key, cell in errors.items()} == {
        key: pytest.approx(median(of(results, key))) for key in LAGS
    }
    assert [key for key, cell in errors.items() if cell.best] == ["quick"]
    failed = column(table, "failed (runs)")
    assert {key: (cell.text, cell.failed) for key, cell in failed.items()} == {
        "quick": ("0 of 12", False),
        "slow": ("0 of 12", False),
        "falling": ("1 of 12", True),
    }
    assert {key: cell.raw for key, cell in column(table, "preview (samples)").items()} == dict.fromkeys(
        LAGS, 5.0
    )
    assert column(table, "needs data (samples)")["quick"].raw == 100.0


def test_where_no_run_failed_nothing_is_said_of_it(make_results: MakeResults) -> None:
    results = make_results(run_of, {"quick": {"type": "a"}, "slow": {"type": "a"}}, seeds=SEEDS)
    table = ranked(conditions(results)[0])
    assert "failed (runs)" not in [heading.words for heading in table.headings]


def matrix(results: StudyResults) -> Table:
    """Return the matrix of a page's first part."""
    part = gather([results]).parts[0]
    return next(content for kind, content in part.first if kind == "table")


SCENARIOS: dict[str, Any] = {"calm": {}, "noisy": {"label": "Noisy", "noise": {"angle": 0.01}}}


def test_the_matrix_has_a_cell_for_each_scenario_that_leads_to_its_figures(make_results: MakeResults) -> None:
    results = make_results(run_of, NAMES, seeds=SEEDS, scenarios=SCENARIOS)
    table = matrix(results)
    ranking = standings(results.study, results.cases)
    assert [row.key for row in table.rows] == [standing.controller for standing in ranking.order]
    page = render_page([results])
    for scenario, words in (("calm", "calm (°)"), ("noisy", "Noisy (°)")):
        cells = column(table, words)
        for key, cell in cells.items():
            values = of(results, key, scenario)
            assert cell.raw == pytest.approx(median(values))
            low, high = (float(end) for end in cell.detail.split(" … "))
            assert (low, high) == (pytest.approx(min(values), rel=5e-3), pytest.approx(max(values), rel=5e-3))
            assert f'id="{cell.href.removeprefix("#")}"' in page
        assert [key for key, cell in cells.items() if cell.best] == ["quick"]
        assert cells["falling"].failures == "1 failed"
        assert (cells["quick"].tone, cells["slow"].tone, cells["falling"].tone) == (
            "share-5",
            "share-1",
            "share-0",
        )


def test_numbers_beside_failed_runs_are_of_the_other_runs(make_results: MakeResults) -> None:
    """Those that complete far from their reference are in neither the matrix nor the ranked table."""

    def trace_of(key: str, seed: int) -> Trace:
        return make_trace(50.0) if key == "falling" and seed in (3, 4, 5) else run_of(key, seed)

    both = make_results(trace_of, NAMES, seeds=SEEDS, scenarios=SCENARIOS)
    cell = column(matrix(both), "calm (°)")["falling"]
    values = of(both, "falling", "calm")
    assert (cell.failures, cell.raw) == ("3 failed", pytest.approx(median(values)))
    assert float(cell.detail.split(" … ")[1]) == pytest.approx(max(values), rel=5e-3)
    table = ranked(conditions(make_results(trace_of, NAMES, seeds=SEEDS))[0])
    assert column(table, "mean absolute error (°)")["falling"].raw == pytest.approx(median(values))


def test_a_best_of_zero_is_tinted_and_all_others_are_far_from_it(make_results: MakeResults) -> None:
    """One without a value spoils no column."""
    results = make_results(run_of, NAMES, seeds=SEEDS[:3], scenarios=SCENARIOS)
    values = {"quick": 0.0, "slow": 1.0, "falling": math.nan}
    cases = [
        replace(case, failed=False, metrics=case.metrics | {KEY: values[case.controller]})
        for case in results.cases
    ]
    cells = column(matrix(replace(results, cases=tuple(cases))), "calm (°)")
    assert {key: cell.tone for key, cell in cells.items()} == {
        "quick": "share-5",
        "slow": "share-1",
        "falling": "",
    }


def test_one_that_fails_in_every_run_of_a_scenario_has_no_value_there(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        return run_of(key, seed) if key != "falling" else make_trace(0.2, outcome=Outcome.DIVERGED)

    cell = column(matrix(make_results(trace_of, NAMES, seeds=[0], scenarios=SCENARIOS)), "calm (°)")[
        "falling"
    ]
    assert (cell.text, cell.failed, cell.title) == ("failed", True, "diverged")


def test_where_nothing_is_ranked_no_rank_is_shown_and_nobody_is_bold(make_results: MakeResults) -> None:
    """Every run failed, or there is one controller; a reference point that did not fail ranks nobody."""
    every = make_results(lambda key, seed: make_trace(40.0), NAMES, seeds=SEEDS)
    alone = make_results(run_of, {"quick": {"type": "a"}}, seeds=SEEDS)
    points = {"reference_points": {"zero": "slow", "full": "quick"}}
    far_off = {"quick": 0.3, "slow": 0.9}
    pointed = make_results(
        lambda key, seed: make_trace(far_off.get(key, 40.0)),
        {name: {"type": "a"} for name in ("quick", "slow", "one", "other")},
        seeds=SEEDS,
        report=points,
    )
    for results in (every, alone, pointed):
        table = ranked(conditions(results)[0])
        assert {cell.text for cell in column(table, "rank").values()} == {""}
        assert not any(cell.best for row in table.rows for cell in row.cells)


def test_what_tuning_is_worth_is_the_best_of_the_grid_against_the_own_settings(
    make_results: MakeResults,
) -> None:
    lags = {"a": 0.5, "a1": 0.9, "a2": 0.4, "a3": 0.3, "b": 0.4}
    weights = {"a": 2.0, "a1": 1.0, "a2": 3.0, "a3": 4.0}
    controllers: dict[str, dict[str, Any]] = {
        name: {"type": "a", "label": f"A, {name}", "settings": {"weight": weights.get(name, 1.0)}}
        for name in lags
    }
    for name in ("a1", "a2", "a3"):
        controllers[name] |= {"variant_of": "a", "varied": ["weight"]}
    results = make_results(lambda key, seed: make_trace(lags[key], noise_seed=seed), controllers)
    part = gather([results]).parts[0]
    table = next(c for kind, c in part.first if kind == "table" and c.id.endswith("worth"))
    (row,) = table.rows
    value = {name: of(results, name)[0] for name in lags}
    base, best, worst, change, settings, edge, failed = row.cells
    assert (base.raw, best.raw, worst.raw) == (value["a"], value["a3"], value["a1"])
    assert change.raw == pytest.approx(100 * (value["a3"] / value["a"] - 1))
    assert best.best
    assert (settings.text, edge.text, failed.text) == ("weight = 4", "weight: largest", "0 of 3")


@pytest.mark.parametrize(
    ("given", "tried", "edge"),
    [
        (2.0, {1.0: 0.3, 3.0: 0.6}, "weight: smallest"),
        (2.0, {1.0: 0.6, 3.0: 0.3}, "weight: largest"),
        (0.5, {1.0: 0.3, 3.0: 0.6}, "no"),
        (2.0, {1.0: 0.6, 2.5: 0.3, 3.0: 0.5}, "no"),
        (2.0, {1.0: 0.3}, "weight: smallest"),
    ],
)
def test_the_best_is_at_the_edge_where_nothing_beyond_it_was_tried(
    make_results: MakeResults, given: float, tried: dict[float, float], edge: str
) -> None:
    """The own value is one of those tried, wherever it lies."""
    lags = {"a": 0.5} | {f"a-{weight:g}": lag for weight, lag in tried.items()}
    controllers: dict[str, dict[str, Any]] = {"a": {"type": "a", "settings": {"weight": given}}}
    for weight in tried:
        varied = {"type": "a", "variant_of": "a", "varied": ["weight"]}
        controllers[f"a-{weight:g}"] = varied | {"settings": {"weight": weight}}
    part = gather([make_results(lambda key, seed: make_trace(lags[key]), controllers)]).parts[0]
    table = next(c for kind, c in part.first if kind == "table" and c.id.endswith("worth"))
    assert table.rows[0].cells[5].text == edge
