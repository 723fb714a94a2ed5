"""Limits promised and kept, as a figure and a table of the report."""

import math
from dataclasses import replace

import pytest

from ddpc_cosim import Trace
from ddpc_reports.comparison import conditions
from ddpc_reports.figures.promises import promise_figures, promise_table

from ..synthetic import MakeResults, make_trace

NAMES = {"bare": {"type": "a"}, "kept": {"type": "a"}}


def run_of(key: str, seed: int, diagnostics: dict[str, float]) -> Trace:
    """Return a run that goes beyond its limit of 15 deg late, or one of 70 deg never."""
    trace = make_trace(0.5, noise_seed=seed, diagnostics=diagnostics)
    low = math.radians(15.0)
    y_max = trace.bounds.y_max * 0 + low if key == "bare" else trace.bounds.y_max
    return replace(trace, bounds=replace(trace.bounds, y_max=y_max))


def promising(key: str, seed: int) -> Trace:
    return run_of(key, seed, {"inner.promised_satisfaction": 0.95} if key == "kept" else {})


def test_the_figure_has_what_was_promised_beside_every_seed(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results(promising, NAMES, seeds=[0, 1, 2]))
    (figure,) = promise_figures(condition, "x-")
    rows = figure.views[0].spec["data"]["values"]
    promises = [row for row in rows if row["promise"]]
    assert [(row["label"], row["value"]) for row in promises] == [("kept", 95.0)]
    assert promises[0]["text"] == "kept: 95.0 % promised, 100 % kept"
    measured = {row["label"]: row["value"] for row in rows if not row["promise"]}
    assert measured["kept"] == 100.0
    trace = run_of("bare", 2, {})
    within = (trace.y[:-1] <= trace.bounds.y_max).mean()
    assert measured["bare"] == pytest.approx(100.0 * within)
    assert 10.0 < measured["bare"] < 90.0
    assert len(rows) == 7


def test_the_table_has_promise_shares_and_errors(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results(promising, NAMES, seeds=[0, 1, 2]))
    table = promise_table(condition, "x-")
    assert table is not None
    heads = [(heading.group, heading.title) for heading in table.headings]
    group = "Limits of angle kept"
    assert heads[1:4] == [("", "Promised"), (group, "all seeds"), (group, "worst seed")]
    bare, kept = ([cell.value for cell in row.cells] for row in table.rows)
    assert kept[:3] == [95.0, 100.0, 100.0]
    assert math.isnan(bare[0])
    assert bare[1] >= bare[2] > 0.0


def test_without_a_promise_there_is_neither(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results(lambda key, seed: run_of(key, seed, {}), NAMES, seeds=[0, 1]))
    assert promise_figures(condition, "x-") == []
    assert promise_table(condition, "x-") is None
