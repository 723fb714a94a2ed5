"""Pictures in the rows of the ranking: as long and as high as the figures say, and said in words."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from lxml import html

from ddpc_cosim import Trace
from ddpc_cosim.files.tables import Cell
from ddpc_reports.comparison import conditions
from ddpc_reports.page import render_page
from ddpc_reports.sections import gather
from ddpc_reports.tables.pictures import ratio_to, ratios_in_row, with_bars

from ..synthetic import MakeResults, make_trace, ranked

LAGS = {"slow": 0.9, "quick": 0.3, "middle": 0.5}
NAMES = {name: {"type": "a", "label": f"{name} one"} for name in LAGS}
LAGS_RISING = ["quick", "middle", "slow"]
BEST_FIRST = [f"{name} one" for name in LAGS_RISING]
KEY = "mean_abs_error.angle [deg]"


def run_of(key: str, seed: int) -> Trace:
    return make_trace(LAGS[key], noise_seed=seed)


def test_a_bar_is_as_long_as_the_figure_beside_the_longest(make_results: MakeResults) -> None:
    table = ranked(conditions(make_results(run_of, NAMES))[0])
    number = next(i for i, heading in enumerate(table.headings[1:]) if "mean absolute" in heading.words)
    cells = [row.cells[number] for row in table.rows]
    largest = max(float(cell.raw) for cell in cells)
    for cell in cells:
        (_, length) = re.findall(r'<rect width="([\d.]+)"', cell.drawing)
        assert float(length) == pytest.approx(100 * float(cell.raw) / largest, rel=1e-3)


def test_one_that_is_far_off_does_not_take_the_length_from_the_others(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results(run_of, NAMES))
    cells = with_bars([Cell("1", 1.0), Cell("2", 2.0), Cell("900", 900.0)], condition.controllers)
    lengths = [float(re.findall(r'<rect width="([\d.]+)"', cell.drawing)[1]) for cell in cells]
    assert lengths == [10.0, 20.0, 100.0]  # of five times the median
    assert "longer than there is room for" in cells[2].drawing
    nothing = [Cell("-", math.nan), Cell("-1", -1.0), Cell("2", 2.0)]
    assert with_bars(nothing, condition.controllers) == nothing


def test_the_line_in_a_row_is_that_of_its_run_and_says_its_ends(make_results: MakeResults) -> None:
    results = make_results(run_of, NAMES)
    table = ranked(conditions(results)[0])
    assert table.drawn == "response"
    for row in table.rows:
        trace = next(case for case in results.cases if case.controller == row.key).trace()
        ends = [np.degrees(value) for value in (trace.y.max(), trace.y[-1, 0])]
        said = re.search(
            r'aria-label="(.*?) one: angle / °, from .+ to (\S+), at the end (\S+)"', row.drawing
        )
        assert said is not None
        assert said[1] == row.key
        numbers = [float(number.replace("\N{MINUS SIGN}", "-")) for number in said.groups()[1:]]
        assert numbers == pytest.approx(ends, rel=6e-3)


def test_a_matrix_has_a_bar_for_each_place(make_results: MakeResults) -> None:
    def run(key: str, seed: int) -> Trace:
        return make_trace(LAGS[key], noise_seed=seed)

    results = make_results(run, NAMES, scenarios={"calm": {}, "hard": {}})
    ((_, table),) = [block for block in gather([results]).parts[0].first if block[0] == "table"]
    assert [row.header for row in table.rows] == BEST_FIRST
    columns = [re.findall(r"M[\d.]+,22L[\d.]+,([\d.]+)", row.drawing) for row in table.rows]
    assert [len(tops) for tops in columns] == [2, 2, 2]
    errors = {case.controller: case.metrics[KEY] for case in results.cases}
    heights = [22 - float(tops[0]) for tops in columns]
    expected = [22 * min(errors[row.key] / errors["quick"] / 3, 1.0) for row in table.rows]
    assert heights == pytest.approx(expected, abs=0.06)


def test_a_ratio_is_not_known_without_a_best() -> None:
    assert ratio_to(2.0, 3.0) == 1.5
    assert ratio_to(0.0, 0.0) == 1.0
    assert ratio_to(0.0, 1.0) == math.inf
    assert math.isnan(ratio_to(math.nan, 1.0))


def test_a_place_where_all_runs_failed_is_said(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results(run_of, NAMES))
    drawn = ratios_in_row(condition.controllers[0], [1.0, math.nan, math.inf])
    assert 'aria-label="quick one: 1.0 to ∞ times the best of a place, none in 1 of 3"' in drawn
    assert ratios_in_row(condition.controllers[0], [math.nan]) == ""


def test_every_table_has_the_order_of_the_ranking_and_says_whose_each_row_is(
    make_results: MakeResults,
) -> None:
    """The study declares them in another order; keys look alike wherever a controller is named."""
    results = make_results(
        lambda key, seed: replace(run_of(key, seed), diagnostics={"data_rank": 9.0, "pe_order": 3.0}),
        NAMES,
        seeds=[0, 1, 2],
    )
    page = html.document_fromstring(render_page([results]))
    tables = page.xpath("//table[.//tr[@data-controller]]")
    assert len(tables) > 8
    looks: dict[str, set[tuple[str, str]]] = {}
    for table in tables:
        for body in table.xpath("./tbody"):
            rows = body.xpath("./tr[@data-controller]")
            order = list(dict.fromkeys(row.get("data-controller") for row in rows))
            assert order == [key for key in LAGS_RISING if key in order], table.get("id")
            for row in rows:
                (key,) = row.xpath("./th/i")
                looks.setdefault(row.get("data-controller"), set()).add((key.get("class"), key.get("style")))
    assert [len(looks[key]) for key in LAGS_RISING] == [1, 1, 1]
    assert len(set.union(*looks.values())) == 3
