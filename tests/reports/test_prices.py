"""A study with a band and a price: what page, files and terminal say of money and discomfort."""

import html
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from ddpc_cosim import DisplayUnit, StudyResults, Trace, Variable
from ddpc_cosim.cli.summary import summary_table
from ddpc_cosim.controller import Charge
from ddpc_cosim.study.verdicts.findings import Lead
from ddpc_reports.comparison import conditions
from ddpc_reports.numbers import difference_symbol
from ddpc_reports.tables.controllers import response_table

from .synthetic import MakeResults, make_trace, ranked
from .test_answer import said

ROOM = Variable("room", "K", display_unit=DisplayUnit("degC", 1.0, -273.15))
HEATER = Variable("heater", "W", display_unit=DisplayUnit("kW", 1e-3))
SEEDS = [*range(8)]


def priced(below: float, power: float, seed: int) -> Trace:
    """Return a run that is so far below its band [K] and pays for so much power [W]."""
    jitter = 1 + 0.001 * np.random.default_rng(seed).standard_normal()
    trace = make_trace(0.3, outputs=(ROOM,), inputs=(HEATER,))
    n = len(trace)
    band = np.broadcast_to(np.array([293.15, 297.15]), (n, 1, 2))
    y = np.full((n, 1), 293.15 - below * jitter)
    charge = Charge("electricity", "heater", 1 / 3.6e6, "EUR", known=True, amount="kWh")
    return replace(
        trace,
        y=y,
        measured=y,
        u=np.full((n, 1), power * jitter),
        reference=np.full((n, 1), 293.15) if below > 0 else y,
        bounds=replace(trace.bounds, y_min=np.array([250.0]), y_max=np.array([320.0])),
        bands=("room",),
        band=band,
        charges=(charge,),
        price=np.full((n, 1), 0.25),
        emission=np.full((n, 1), 0.2),
        charged=np.full((n, 1), power * jitter),
    )


@pytest.fixture
def two(make_results: MakeResults) -> StudyResults:
    """One that pays more and is in its band, and one that pays less."""

    def trace_of(key: str, seed: int) -> Trace:
        return priced(0.0, 2e6, seed) if key == "warm" else priced(0.4, 1.5e6, seed)

    return make_results(trace_of, {"warm": {"type": "a"}, "thrifty": {"type": "b"}}, seeds=SEEDS)


def test_the_answer_begins_with_who_is_not_dominated(two: StudyResults) -> None:
    """Six seconds at 1.5 MW are 2.5 kWh, at a quarter of a euro; at 0.4 K too cold 0.000667 K.h."""
    (findings,) = two.findings().values()
    assert findings.lead is Lead.FRONT
    assert said(two).startswith(
        "thrifty and warm are not dominated over 8 seeds: thrifty is cheapest (0.625 EUR, "
    )
    assert "warm is the most comfortable (0.833 EUR, 0 K·h)" in said(two)


def test_one_that_is_cheaper_at_no_more_discomfort_is_said_to_be(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        return priced(0.4, 1.5e6 if key == "thrifty" else 2e6, seed)

    results = make_results(trace_of, {"a": {"type": "a"}, "thrifty": {"type": "b"}}, seeds=SEEDS)
    assert re.match(
        r"thrifty costs 25 % less than a at no more discomfort over 8 seeds: money 0\.62\d EUR \[\S+ … \S+\] "
        r"and 6\.6\d . 10⁻⁴ K·h \[.*\], against 0\.83\d EUR and 6\.6\d . 10⁻⁴ K·h of a\.",
        said(results),
    )


def test_the_ranked_table_has_both_figures_and_what_they_are_made_of(two: StudyResults) -> None:
    (condition,) = conditions(two)
    table = ranked(condition)
    assert table.caption == "Ranked by money and discomfort"
    titles = [heading.title for heading in table.headings]
    for title in ("money", "discomfort", "energy", "emissions", "peak power", "mean distance to the band"):
        assert title in titles
    assert not {"overshoot", "settled error"} & {*titles}
    assert [row.cells[0].text for row in table.rows] == ["1", "1"]
    assert response_table(condition, "") is None


def test_the_page_and_the_terminal_say_the_same(two: StudyResults) -> None:
    page = html.unescape(two.report().read_text())
    assert "are not dominated over 8 seeds" in page
    assert "Pareto front" in page
    console = Console(width=160, record=True, file=None)
    with console.capture() as capture:
        console.print(summary_table(two, console))
    text = capture.get()
    assert "thrifty and warm are not dominated over 8 seeds: thrifty is cheapest (0.625 EUR" in text
    assert "money" in text
    assert "discomfort" in text


def test_differences_of_temperatures_over_time_are_in_kelvin() -> None:
    assert difference_symbol("degC.h") == "K·h"
    assert difference_symbol("m.h") == "m·h"
