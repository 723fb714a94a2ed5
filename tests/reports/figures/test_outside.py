"""What is drawn besides the controllers' lines: bands, limits, weather with forecasts, prices, times."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import Charge, DisplayUnit, StudyResults, Trace, Variable
from ddpc_reports.comparison import conditions
from ddpc_reports.figures.clock import clock_for
from ddpc_reports.figures.figure import Figure
from ddpc_reports.figures.outside import charged_signals, disturbance_signals, price_signals
from ddpc_reports.figures.over_time import time_figures
from ddpc_reports.figures.samples import seen
from ddpc_reports.figures.trade import trade_figure, trade_rows

from ..synthetic import MakeResults, make_trace

HOUR = 3600.0
OUTDOORS = Variable("outdoors", "K", display_unit=DisplayUnit("degC", 1.0, -273.15))
STATION = Variable("station", "degC")
POWER = Variable("power", "kW")
CHARGE = Charge("electricity", "power", 1 / HOUR, "EUR", True, "kWh")
CHANGES: dict[str, Any] = {
    "disturbances": {
        "outdoors": {"signal": {"kind": "constant", "value": 280.0}, "known": "medium"},
        "station": {"known": "measured"},
        "wind": {"signal": {"kind": "constant", "value": 1.0}, "known": "unknown"},
    },
    "prices": {"electricity": {"signal": "power", "price": 0.25, "unit": "EUR/kWh"}},
    "loop": {"sampling_time": 900.0, "duration": 54000.0, "start_time": 7200.0},
    "seeds": [7, 8],
}


def trace_of(key: str, seed: int) -> Trace:
    """Return a run with a band, a limit that changes, three disturbances, two of them known, and a price."""
    trace = make_trace(0.3 if key == "quick" else 1.0, noise_seed=seed)
    count = len(trace)
    steps = np.arange(count)
    level = np.full((count, 1), 0.3)
    upper = np.where(steps < 30, 0.4, 0.5)[:, np.newaxis]
    forecast = np.full((count, 2), np.nan)
    looks = 10 if key == "quick" else 5
    for k in (0, 13, 26):
        forecast[k + 1 : k + 1 + looks] = np.column_stack([280.0 + steps[:looks], steps[:looks]])
    limits = np.tile([-3.5, 3.5], (count, 1, 1))
    limits[30:, 0, 1] = 2.5
    acts = 280.0 + np.sin(steps / 5)
    wind = np.full(count, 1.0)
    return replace(
        trace,
        time=7200.0 + 900.0 * steps,
        sampling_time=900.0,
        bands=("angle",),
        band=np.stack([level, upper], axis=-1),
        reference=np.clip(trace.y, level, upper),
        moving_limits=("torque",),
        input_limits=limits,
        output_limits=np.tile([-1.2, 1.2], (count, 1, 1)),
        changed_inputs=(OUTDOORS, Variable("wind", "m/s")),
        applied=np.column_stack([acts, wind]),
        disturbances=(OUTDOORS, STATION),
        d=np.column_stack([acts + 0.1 * (steps % 2), 10.0 + steps]),
        forecast=forecast,
        charges=(CHARGE,),
        price=np.where(steps < 20, 0.2, 0.4)[:, np.newaxis],
        emission=np.zeros((count, 1)),
        charged=(2.0 if key == "quick" else 3.0) + trace.u,
        measurements=(*trace.outputs, POWER),
        measured=np.column_stack([trace.y, trace.u]),
    )


@pytest.fixture
def results(make_results: MakeResults) -> StudyResults:
    return make_results(trace_of, **CHANGES)


def column(values: list[float | None]) -> np.ndarray[Any, Any]:
    return np.array([np.nan if value is None else value for value in values])


def test_figures_of_a_band_and_of_limits_have_the_samples(results: StudyResults) -> None:
    (condition,) = conditions(results)
    trace = trace_of("quick", 7)
    drawn = seen(condition, "x-")
    (output,), (control,), (error,) = drawn.outputs, drawn.inputs, drawn.errors
    for name, edge in (("lower", 0), ("upper", 1)):
        degrees = np.degrees(trace.band[:, 0, edge])
        np.testing.assert_allclose(column(output.columns[name]), degrees, rtol=1e-5)
    assert not output.has_reference
    assert "r" not in output.columns
    low, high = output.extent(["c0", "c1"])
    assert low < np.degrees(0.3)
    assert high > np.degrees(0.5)
    (given_limit,) = control.given
    np.testing.assert_allclose(column(control.columns[given_limit.columns[0]]), trace.input_limits[:, 0, 1])
    assert control.unreached_limits == (-3.5,)
    assert error.title == "distance of angle to its band / °"
    distance = np.degrees(trace.reference - trace.y)[:, 0]
    np.testing.assert_allclose(column(error.columns["c0"]), distance, rtol=1e-5, atol=1e-6)


def test_disturbances_are_drawn_as_they_act_as_measured_and_as_expected(results: StudyResults) -> None:
    (condition,) = conditions(results)
    trace = trace_of("quick", 7)
    outdoors, station, wind = disturbance_signals(condition, "x-")
    celsius = trace.applied[:, 0] - 273.15
    np.testing.assert_allclose(column(outdoors.columns["x"]), celsius, atol=1e-3)
    np.testing.assert_allclose(column(outdoors.columns["m"]), trace.d[:, 0] - 273.15, atol=1e-3)
    np.testing.assert_allclose(column(outdoors.columns["t"]), 2.0 + 0.25 * np.arange(len(trace)))
    assert outdoors.clock.unit == "h"
    lines = [column(outdoors.columns[name]) for name in ("f0", "f1", "f2")]
    assert "f3" not in outdoors.columns
    for k, line in zip((0, 13, 26), lines, strict=True):
        there = np.flatnonzero(np.isfinite(line))
        np.testing.assert_array_equal(there, np.arange(k, k + 11))  # the controller that looks ahead farthest
        assert line[k] == pytest.approx(trace.d[k, 0] - 273.15, abs=1e-3)
        np.testing.assert_allclose(line[there[1:]], 6.85 + np.arange(10), atol=1e-3)
    assert "x" not in station.columns
    np.testing.assert_allclose(column(station.columns["m"]), trace.d[:, 1])
    assert {*wind.columns} == {"t", "x"}


def test_prices_and_what_is_paid_for_are_drawn(results: StudyResults) -> None:
    (condition,) = conditions(results)
    trace = trace_of("slow", 7)
    (price,) = price_signals(condition, "x-")
    assert price.title == "price of electricity / EUR/kWh"
    np.testing.assert_allclose(column(price.columns["x"]), trace.price[:, 0])
    (power,) = charged_signals(condition, "x-")
    np.testing.assert_allclose(column(power.columns["c1"]), trace.charged[:, 0], rtol=1e-5, atol=1e-6)
    figures = time_figures(condition, "x-").figures["responses"]
    assert [figure.title for figure in figures if isinstance(figure, Figure)] == [
        "Responses",
        "Disturbances",
        "Prices",
        "Paid for",
    ]
    responses, disturbances, *_ = figures
    assert isinstance(responses, Figure)
    assert isinstance(disturbances, Figure)
    assert "the band in which it is wanted (grey)" in responses.caption
    assert "outdoors: measured, and forecasts with medium errors" in disturbances.caption
    assert "2 to 17 h" in responses.views[0].description
    assert "+ '\u202fh'" in json.dumps(responses.views[0].spec, ensure_ascii=False)


def test_a_run_without_any_of_it_has_none_of_it(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results())
    assert disturbance_signals(condition, "x-") == price_signals(condition, "x-") == []
    assert charged_signals(condition, "x-") == []
    assert trade_figure([condition], "x-") is None
    (figure,) = time_figures(condition, "x-").figures["responses"]
    assert isinstance(figure, Figure)
    assert figure.keys == ()


def test_comfort_is_drawn_against_money(results: StudyResults) -> None:
    (condition,) = conditions(results)
    (money,) = condition.keys("money")
    (left,) = condition.keys("band_violation")
    rows = trade_rows(condition, money, left)
    medians = [row for row in rows if row["median"]]
    values = {case.controller: [] for case in results.cases}  # type: dict[str, list[tuple[float, float]]]
    for case in results.cases:
        values[case.controller].append((case.metrics[money], case.metrics[left]))
    for row in medians:
        expected = np.median(values[row["label"]], axis=0)
        np.testing.assert_allclose([row["x"], row["y"]], expected, rtol=1e-5)
    assert len(rows) == len(medians) + len(results.cases)
    for row in medians:
        beaten = any(o["x"] <= row["x"] and o["y"] <= row["y"] and o is not row for o in medians)
        assert row["front"] is not beaten
    figure = trade_figure([condition], "x-")
    assert figure is not None
    assert [key.label for key in figure.keys][:2] == ["median over the seeds", "one seed"]
    assert "dot" not in figure.caption
    assert "EUR" in figure.views[0].description


@given(st.floats(1e-3, 1e9), st.floats(0, 3e7))
def test_an_axis_of_time_has_few_units_but_not_less_than_one(length: float, start: float) -> None:
    clock = clock_for(start, length)
    assert clock.unit == "s" or length / clock.seconds >= 1
    assert clock.unit == "d" or length / clock.seconds <= 600


@pytest.mark.parametrize(
    ("start", "length", "unit"),
    [
        (0.0, 40.0, "s"),
        (0.0, 600.0, "s"),
        (0.0, 3600.0, "min"),
        (0.0, 86400.0, "h"),
        (0.0, 14 * 86400.0, "d"),
        (22 * 86400.0, 2 * 86400.0, "d"),
        (22 * 86400.0, 3600.0, "h"),
    ],
)
def test_the_unit_of_time_suits_the_length_of_a_run(start: float, length: float, unit: str) -> None:
    assert clock_for(start, length).unit == unit
