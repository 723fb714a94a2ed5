"""Figures of bands and of what is paid for, by formulas written out by hand and by scipy's integrals."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import trapezoid

from ddpc_cosim import (
    Band,
    Bounds,
    Controller,
    FloatArray,
    KnownDisturbance,
    Loop,
    Outcome,
    Plant,
    Price,
    Sample,
    Sine,
    Steps,
    Trace,
    Variable,
    cosimulate,
)
from ddpc_cosim.controller import Charge
from ddpc_cosim.metrics import discomfort, headline, split_key
from ddpc_cosim.responses import Charged, Tracking
from fmu_plants.units import display_unit

H = 600.0
ROOM = Variable("room", "K", display_unit=display_unit("K", "degC"))
OFFICE = Variable("office", "K")
HEATER = Variable("heater", "W", display_unit=display_unit("W", "kW"))
POWER = Variable("power", "kW")
OPEN = (-math.inf, math.inf)
STEP_FIGURES = {"settled_error", "settled_share", "overshoot", "rise_time", "settling_time", "anticipation"}


def banded(y: Any, lower: Any, upper: Any, u: Any = 0.0, **changes: Any) -> Trace:
    """Return a run of a room [degC] that is wanted within a band; its last row was not held."""
    y = np.asarray(y, dtype=float)
    n = len(y)
    band = np.stack([np.broadcast_to(lower, n), np.broadcast_to(upper, n)], axis=-1) + 273.15
    y = (y + 273.15).reshape(n, 1)
    inputs = np.broadcast_to(np.asarray(u, dtype=float), n).reshape(n, 1).copy()
    trace = Trace(
        time=np.arange(n) * H,
        reference=np.clip(y, band[:, :1], band[:, 1:]),
        y=y,
        measured=y,
        u=inputs,
        status=("ok",) * n,
        solve_time=np.full(n, 1e-3),
        inputs=(HEATER,),
        outputs=(ROOM,),
        measurements=(ROOM,),
        bounds=Bounds(*(np.array([limit]) for limit in (*OPEN, *OPEN))),
        sampling_time=H,
        planned_samples=n,
        bands=("room",),
        band=band.reshape(n, 1, 2),
    )
    return replace(trace, **changes)


def charged(
    trace: Trace, signal: Variable, values: Any, price: Any, *, rate: float, amount: str = "kWh", **more: Any
) -> Trace:
    """Return the run with a price of a signal."""
    n = len(trace)
    column = [np.broadcast_to(np.asarray(x, dtype=float), n).reshape(n, 1) for x in (values, price)]
    emission = np.broadcast_to(np.asarray(more.get("emission", 0.0)), n).reshape(n, 1)
    charge = Charge("electricity", signal.name, rate, "EUR", known=True, amount=amount)
    return replace(trace, charges=(charge,), charged=column[0], price=column[1], emission=emission)


def of(trace: Trace, name: str) -> float:
    (value,) = (value for key, value in trace.metrics().items() if split_key(key)[0] == name)
    return value


def test_errors_of_a_band_are_distances_to_it() -> None:
    trace = banded([19.0, 20.5, 24.0, 27.0, 99.0], 20.0, 24.0)
    metrics = trace.metrics()
    distance = [1.0, 0.0, 0.0, 3.0]
    assert metrics["mean_abs_error.room [degC]"] == pytest.approx(1.0)
    assert metrics["rmse.room [degC]"] == pytest.approx(math.sqrt(10 / 4))
    assert metrics["iae.room [degC.s]"] == pytest.approx(4.0 * H)
    assert metrics["max_abs_error.room [degC]"] == pytest.approx(3.0)
    assert metrics["band_violation.room [degC.h]"] == pytest.approx(sum(distance) * H / 3600)
    assert metrics["band_violation_time.room [h]"] == pytest.approx(2 * H / 3600)
    assert metrics["band_violation_max.room [degC]"] == pytest.approx(3.0)


def test_an_output_with_a_band_has_no_figures_of_steps_and_one_with_a_reference_none_of_bands() -> None:
    trace = banded([19.0] * 30, 20.0, 24.0)
    with_band = {split_key(key)[0] for key in trace.metrics()}
    with_reference = {split_key(key)[0] for key in replace(trace, bands=()).metrics()}
    bands = {"band_violation", "band_violation_time", "band_violation_max"}
    assert with_reference - with_band == STEP_FIGURES
    assert with_band - with_reference == bands


def test_moving_limits_are_those_of_each_sample() -> None:
    limits = np.array([[[20.0, 22.0]], [[20.0, 22.0]], [[18.0, 21.0]], [[18.0, 21.0]]]) + 273.15
    trace = replace(
        banded([23.0, 21.0, 21.5, 99.0], 0.0, 50.0), moving_limits=("room",), output_limits=limits
    )
    assert of(trace, "bound_violation_max") == pytest.approx(1.0)
    assert of(trace, "bound_violation_time") == 2 * H
    inputs = np.array([[[0.0, 5.0]], [[0.0, 3.0]], [[1.0, 3.0]], [[0.0, 9.0]]])
    held = replace(
        banded([21.0] * 4, 0.0, 50.0, [5.0, 2.0, 1.0, 0.0]), moving_limits=("heater",), input_limits=inputs
    )
    assert of(held, "time_at_bounds") == 2 * H
    assert of(held, "total_variation") == pytest.approx((5.0 + 3.0 + 1.0) / 1000)


def test_an_input_costs_what_it_is_held_at() -> None:
    """Ten minutes each of 6, 3 and 12 kW at 0.2, 0.4 and 0.1 EUR/kWh; the last row is not held."""
    run = banded([21.0] * 4, 20.0, 24.0)
    trace = charged(
        run,
        HEATER,
        [6e3, 3e3, 12e3, 1e9],
        [0.2, 0.4, 0.1, 1e9],
        rate=1 / 3.6e6,
        emission=[0.1, 0.2, 0.3, 0],
    )
    metrics = trace.metrics()
    assert metrics["money [EUR]"] == pytest.approx((6 * 0.2 + 3 * 0.4 + 12 * 0.1) / 6)
    assert metrics["energy [kWh]"] == pytest.approx(21 / 6)
    assert metrics["emissions [kg]"] == pytest.approx((0.6 + 0.6 + 3.6) / 6)
    assert metrics["peak [kW]"] == pytest.approx((3 * 5 + 12 * 10) / 15), "in the second quarter"


def test_a_measured_signal_is_a_line_from_sample_to_sample() -> None:
    power = [6.0, 3.0, 12.0, 0.0]
    trace = charged(banded([21.0] * 4, 20.0, 24.0), POWER, power, 0.25, rate=1 / 3600)
    assert of(trace, "energy") == pytest.approx(trapezoid(power, dx=H / 3600))
    assert of(trace, "money") == pytest.approx(0.25 * trapezoid(power, dx=H / 3600))
    ended = replace(trace, outcome=Outcome.FMU_ERROR)
    assert of(ended, "energy") == pytest.approx(trapezoid(power, dx=H / 3600)), (
        "and no more is known of its end"
    )


def test_energy_that_two_prices_are_paid_for_is_used_once() -> None:
    """A tariff and a tax, in EUR/kWh and EUR/MWh; heat, of which a third is paid for, is another energy."""
    charges = [
        Charge("tariff", "power", 1 / 3.6e6, "EUR", known=True, amount="kWh"),
        Charge("tax", "power", 1 / 3.6e9, "EUR", known=True, amount="MWh"),
        Charge("heat", "power", 1 / 3 / 3.6e6, "EUR", known=True, amount="kWh"),
    ]
    watts, prices = np.full((4, 3), 6000.0), np.tile([0.2, 50.0, 0.3], (4, 1))
    what = Charged.of(charges, watts, {"power"}, prices, np.zeros((4, 3)), 900.0)
    assert what.total_energy() == pytest.approx(6.0 + 2.0)
    assert what.peak() == pytest.approx(6.0 + 2.0)
    assert what.total(what.price) == pytest.approx(6.0 * 0.2 + 6e-3 * 50.0 + 2.0 * 0.3)


def test_there_are_figures_of_what_is_paid_for_where_there_are_prices_and_what_they_are_of() -> None:
    run = banded([21.0] * 4, 20.0, 24.0)
    figures = {"money", "energy", "emissions", "peak"}
    assert not figures & {split_key(key)[0] for key in run.metrics()}
    water = charged(run, HEATER, 1.0, 2.0, rate=1 / 3600, amount="m3")
    assert figures & {split_key(key)[0] for key in water.metrics()} == {"money"}
    electricity = charged(run, HEATER, 1.0, 2.0, rate=1 / 3600)
    assert figures & {split_key(key)[0] for key in electricity.metrics()} == figures - {"emissions"}


@given(
    power=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=40),
    sampling_time=st.sampled_from([10.0, 60.0, 450.0, 700.0, 900.0, 1800.0, 5400.0]),
)
def test_integrals_of_constants_are_those_of_fine_grids(power: list[float], sampling_time: float) -> None:
    """A tenth of a second is fine enough: every sampling time is a multiple of it."""
    n, fine = len(power), 10
    amounts = np.array(power).reshape(n, 1)
    charge = Charge("p", "u", 1 / 3.6e3, "EUR", known=True, amount="kWh")
    prices = np.linspace(0.1, 0.5, n).reshape(n, 1)
    what = Charged.of([charge], amounts, {"u"}, prices, prices, sampling_time)
    per_interval = round(sampling_time / fine)
    signal = np.repeat(amounts[:, 0], per_interval)
    expected = float(signal.sum()) * fine / 3600
    assert what.total_energy() == pytest.approx(expected, abs=1e-9)
    paid = np.repeat(prices[:, 0], per_interval) * signal
    assert what.total(what.price) == pytest.approx(float(paid.sum()) * fine / 3600, abs=1e-9)
    quarter = 900 // fine
    quarters = signal[: len(signal) // quarter * quarter].reshape(-1, quarter).mean(axis=1)
    peak = quarters.max() if len(quarters) else signal.mean()
    assert what.peak() == pytest.approx(float(peak), abs=1e-9)


def test_controllers_are_ranked_by_money_and_discomfort_where_there_are_prices() -> None:
    keys = [
        "mean_abs_error.room [K]",
        "band_violation.room [K.h]",
        "mean_abs_error.level [m]",
        "cost [1]",
        "money [EUR]",
    ]
    unpaid, uncosted = keys[:-1], [key for key in keys if key != "cost [1]"]
    assert discomfort(keys) == ("band_violation.room [K.h]", "mean_abs_error.level [m]")
    assert headline(uncosted) == headline(keys, "pareto") == ("money [EUR]", *discomfort(keys))
    assert headline(keys, "money") == ("money [EUR]",)
    assert headline(keys, "error") == headline(unpaid) == headline(unpaid, "money") == ("cost [1]",)
    assert headline(keys) == ("cost [1]",), "the study's own"


def tracking(trace: Trace) -> Tracking:
    (output,) = trace.tracking()
    return output


def test_a_band_is_judged_by_its_width_its_moves_and_how_far_the_output_gets_away() -> None:
    lower = np.where(np.arange(41) < 20, 16.0, 21.0)
    y = np.where(np.arange(41) < 20, 15.0, 22.0)
    output = tracking(banded(y, lower, lower + 2.0))
    assert output.width == pytest.approx(2.0)
    assert output.travel == pytest.approx(21.0 - 15.0), "from where it begins to the highest lower edge"
    assert output.deviation == pytest.approx(1.0)
    assert [end.step for end in output.ends] == pytest.approx([2.0, 3.0]), "its width, then from 18 up to 21"
    assert [end.magnitude for end in output.ends] == pytest.approx([1.0, 0.0])
    assert all(end.settling for end in output.ends)
    inside = tracking(banded([17.0] * 41, 16.0, 18.0))
    assert (inside.travel, inside.deviation, inside.mean_abs_error) == (0.0, 0.0, 0.0)


def test_what_a_band_adds_is_written_where_there_is_one() -> None:
    trace = banded([19.0] * 41, 20.0, 24.0)
    for run, has_band in ((trace, True), (replace(trace, bands=()), False)):
        table = tracking(run).written()
        assert ("width" in table) is has_band
        assert all("disturbed" not in end for end in table["ends"])
        assert Tracking.read(table) == tracking(run)


def test_where_a_declared_disturbance_moves_there_is_nothing_to_settle_to() -> None:
    sun = Variable("sun", "W/m2")
    still = replace(banded([19.0] * 41, 20.0, 24.0), bands=(), disturbances=(sun,), acting=("sun",))

    def moving(d: FloatArray) -> list[bool]:
        output = tracking(replace(still, d=d.reshape(41, 1)))
        assert Tracking.read(output.written()) == output
        return [end.disturbed for end in output.ends]

    early = np.where(np.arange(41) < 10, 0.0, 100.0)
    assert moving(np.zeros(41)) == moving(early) == [False]
    assert moving(np.arange(41.0)) == [True]


class Room(Plant):
    """It loses a tenth of what it is warmer than 10 degC at each sample, and gains a kelvin per kW."""

    inputs = (replace(HEATER, min=0.0, max=8e3, start=1e3), Variable("outdoors", "K", start=283.15))
    outputs = (ROOM, POWER)

    def reset(self, parameters: Any = None, t0: float = 0.0) -> FloatArray:
        self.t = 293.15
        return np.array([self.t, 1.0])

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.t += 0.1 * (u[1] - self.t) + u[0] / 1e3
        return np.array([self.t, u[0] / 1e3])


class Thermostat(Controller):
    """It heats by the distance to what it is asked for."""

    horizon = 1

    def start(self, loop: Loop) -> None:
        assert loop.bands == ("room",)

    def step(self, sample: Sample) -> FloatArray:
        return 500.0 + 2e3 * (sample.setpoint - sample.y)


def test_a_loop_with_bands_disturbances_and_prices_has_all_of_it() -> None:
    """Everything derived again from what signals.csv holds."""
    trace = cosimulate(
        Room(),
        Thermostat(),
        sampling_time=H,
        duration=30 * H,
        outputs=["room"],
        measurements=["room", "power"],
        reference={"room": Band(Steps((0.0, 6000.0), (16.0, 20.0)), 24.0, "degC")},
        disturbances={"outdoors": KnownDisturbance(signal=Sine(10.0, 20000.0, offset=275.0))},
        prices={
            "bought": Price(signal="heater", price=Steps((0.0, 9000.0), (0.1, 0.4)), unit="EUR/kWh"),
            "metered": Price(
                signal="power", price=0.01, unit="EUR/kWh", emissions=200, emissions_unit="g/kWh"
            ),
        },
    )
    table = trace.columns()
    metrics = trace.metrics()
    y, low, high = (table[f"{name}room [K]"][:-1] for name in ("", "lower ", "upper "))
    distance = np.maximum(low - y, 0) + np.maximum(y - high, 0)
    assert distance.any()
    assert metrics["band_violation.room [degC.h]"] == pytest.approx(distance.sum() / 6)
    assert metrics["mean_abs_error.room [degC]"] == pytest.approx(distance.mean())
    kw, metered = table["heater [W]"][:-1] / 1e3, table["power [kW]"]
    bought = np.where(table["time [s]"][:-1] < 9000, 0.1, 0.4) @ kw / 6
    read = trapezoid(metered, dx=1 / 6)
    assert metrics["money [EUR]"] == pytest.approx(bought + 0.01 * read)
    assert metrics["energy [kWh]"] == pytest.approx(kw.sum() / 6 + read)
    assert metrics["emissions [kg]"] == pytest.approx(0.2 * read)
    (output,) = trace.tracking()
    assert output.is_disturbed
    assert output.width == pytest.approx(float((high - low).mean()))
