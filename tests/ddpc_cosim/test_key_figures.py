"""Key figures of buildings: laws that their definitions imply, and values that can be written down."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import (
    Band,
    Bounds,
    Constant,
    FloatArray,
    MetricSettings,
    Outcome,
    Plant,
    Trace,
    Variable,
    cosimulate,
)
from ddpc_cosim.description import KeyFigureTags
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.key_figures import (
    ELECTRIC,
    SOURCES,
    KeyFigures,
    TaggedSignal,
    factor_of,
    is_source,
)

H = 300.0
TAGS = KeyFigureTags(
    50.0, {ELECTRIC: ["p", "q"], "AirZoneTemperature[a]": ["t"], "OperativeZoneTemperature[b]": ["s"]}
)
NUMBERS = st.floats(-1e4, 1e4).map(lambda x: round(x, 3))
COURSES = st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), min_size=7, max_size=40).map(np.array)


def figures(course: FloatArray, tags: KeyFigureTags = TAGS, h: float = H) -> KeyFigures:
    """Return key figures of powers p and q, of which q is held, and of temperatures t and s in bands."""
    n = len(course)
    price = np.linspace(0.1, 0.3, n) / 3.6e6
    band = np.stack([np.linspace(-50.0, 0.0, n), np.linspace(20.0, 60.0, n)], axis=1)
    p, q, t, s = course.T
    signals = {
        "p": TaggedSignal(p, h, price=price, emission=2 * price),
        "q": TaggedSignal(q, h, is_held=True, price=price, emission=2 * price),
        "t": TaggedSignal(t, h, limits=band),
        "s": TaggedSignal(s, h, limits=band),
    }
    actuators = [TaggedSignal(p, h, is_held=True), TaggedSignal(q, h, is_held=True)]
    return KeyFigures(tags, "EUR", True, h, signals, actuators, is_complete=True)


def integrals(of: KeyFigures) -> FloatArray:
    return np.array([of.thermal_discomfort(), of.energy(), of.cost(), of.emissions()])


@given(COURSES, st.integers(2, 5))
def test_integrals_add_up_over_time(course: FloatArray, cut: int) -> None:
    """The sample at which a run is cut in two belongs to both parts."""
    whole = figures(course)

    def part(rows: slice) -> KeyFigures:
        signals = {
            name: replace(
                signal,
                values=signal.values[rows],
                **{
                    key: None if (table := getattr(signal, key)) is None else table[rows]
                    for key in ("limits", "price", "emission")
                },
            )
            for name, signal in whole.signals.items()
        }
        return replace(whole, signals=signals)

    parts = integrals(part(slice(0, cut + 1))) + integrals(part(slice(cut, None)))
    np.testing.assert_allclose(parts, integrals(whole), rtol=1e-9, atol=1e-9)


@given(COURSES, st.floats(0.1, 100.0))
def test_all_but_discomfort_and_travel_are_per_area(course: FloatArray, times: float) -> None:
    one, other = figures(course), figures(course, KeyFigureTags(times * TAGS.area, TAGS.sources))
    np.testing.assert_allclose(times * integrals(other)[1:], integrals(one)[1:], rtol=1e-9, atol=1e-9)
    assert times * other.peak(ELECTRIC) == pytest.approx(one.peak(ELECTRIC), rel=1e-9, abs=1e-9)
    assert (one.thermal_discomfort(), one.travel()) == (other.thermal_discomfort(), other.travel())


@given(COURSES)
def test_discomfort_is_the_mean_over_the_zones_and_not_negative(course: FloatArray) -> None:
    zones = [
        figures(course, KeyFigureTags(1.0, {source: TAGS.sources[source]})).thermal_discomfort()
        for source in TAGS.sources
        if source != ELECTRIC
    ]
    assert min(zones) >= 0.0
    assert figures(course).thermal_discomfort() == pytest.approx(sum(zones) / 2)


@given(phase=st.floats(0.0, 6.0), amplitude=st.floats(1.0, 5.0))
def test_samples_twice_as_dense_change_smooth_signals_figures_by_less_than_a_percent(
    phase: float, amplitude: float
) -> None:
    """Over a day, in quarters of an hour and half of that."""

    def course(h: float) -> FloatArray:
        angle = 2 * math.pi * np.arange(round(86400 / h) + 1) * h / 86400 + phase
        power = 3000 + 1000 * np.sin(angle)
        return np.column_stack([power, np.zeros_like(power), 60 + amplitude * 20 * np.sin(angle), 0 * angle])

    coarse, fine = (figures(course(h), h=h) for h in (900.0, 450.0))
    np.testing.assert_allclose(integrals(coarse), integrals(fine), rtol=0.01)
    assert coarse.peak(ELECTRIC) == pytest.approx(fine.peak(ELECTRIC), rel=0.01)


def test_a_run_that_did_not_complete_and_a_signal_that_was_not_kept_have_no_figures() -> None:
    complete = figures(np.ones((9, 4)))
    assert np.isfinite([*integrals(complete), complete.peak(ELECTRIC), complete.travel()]).all()
    ended = replace(complete, is_complete=False)
    assert np.isnan([*integrals(ended), ended.peak(ELECTRIC), ended.travel()]).all()
    kept = {name: signal for name, signal in complete.signals.items() if name not in ("q", "s")}
    lost = replace(complete, signals=kept)
    assert np.isnan([*integrals(lost), lost.peak(ELECTRIC)]).all()


def test_quarters_of_an_hour_begin_at_the_first_sample() -> None:
    """Three samples of five minutes each, of powers that are held: 0, 3, 6 kW, then 3, 0, 0."""
    tags = KeyFigureTags(100.0, {ELECTRIC: ["p"]})
    power = TaggedSignal(np.array([0.0, 3e3, 6e3, 3e3, 0.0, 0.0, 9e9]), H, is_held=True)
    of = KeyFigures(tags, sampling_time=H, signals={"p": power}, is_complete=True)
    assert of.peak(ELECTRIC) == pytest.approx(3.0 / 100.0)


def test_sources_are_those_of_boptest_and_their_units_are_converted() -> None:
    assert all(map(is_source, SOURCES))
    wrong = ("ElectricPower[1]", "AirZoneTemperature", "Electricpower", "CO2Concentration")
    assert not any(map(is_source, wrong))
    assert factor_of(ELECTRIC, "kW") == 1e3
    assert factor_of("AirZoneTemperature[1]", "degC") == factor_of(ELECTRIC, "") == 1.0
    assert factor_of("CO2Concentration[1]", "1") == pytest.approx(1e6)
    assert factor_of("ActuatorTravel[fan]", "rpm") == 1.0
    with pytest.raises(ValueError, match="different quantities"):
        factor_of(ELECTRIC, "K")


class Hut(Plant):
    """Its control heats to 20 degC unless it is overridden, and tells what it applies."""

    inputs = (Variable("oveHea_u", "W", 0.0, 4e3),)
    outputs = (Variable("room", "K"), Variable("oveHea_y", "W"), Variable("power", "W"))

    def reset(self, parameters: object = None, t0: float = 0.0) -> FloatArray:
        self.room, self.heat = 290.0, 0.0
        return np.array([self.room, 0.0, 0.0])

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.heat = 200.0 * (293.15 - self.room)
        self.room += h / 1e5 * (self.heat - 20.0 * (self.room - 280.0))
        return np.array([self.room, self.heat, self.heat / 3.0])


def hut(monitors: dict[str, Band | None]) -> Trace:
    return cosimulate(
        Hut(),
        None,
        sampling_time=H,
        duration=20 * H,
        reference={},
        measurements=["room"],
        monitors=monitors,
    )


def test_what_is_monitored_is_kept_as_it_is_with_its_band() -> None:
    trace = hut({"power": None, "room": Band(19.0, 21.0, "degC")})
    assert trace.monitors == (Hut.outputs[2], Hut.outputs[0])
    np.testing.assert_array_equal(trace.monitored[:, 1], trace.measured[:, 0])
    np.testing.assert_allclose(trace.monitored_band[:, 0], np.tile([292.15, 294.15], (21, 1)))
    table = trace.columns()
    assert {"monitored power [W]", "monitored lower room [K]", "monitored upper room [K]"} <= table.keys()
    settings = MetricSettings(
        key_figures=KeyFigureTags(10.0, {ELECTRIC: ["power"], "AirZoneTemperature[1]": ["room"]})
    )
    metrics = trace.metrics(settings)
    hours = trace.time / 3600
    away = np.maximum(292.15 - table["monitored room [K]"], 0.0)
    assert metrics["tdis_tot [K.h]"] == pytest.approx(np.trapezoid(away, hours))
    energy = np.trapezoid(table["monitored power [W]"], hours) / 1e4
    assert metrics["ener_tot [kWh/m2]"] == pytest.approx(energy)
    assert "cost_tot" not in str(metrics), "nothing is paid for"
    ended = replace(trace, outcome=Outcome.FMU_ERROR).metrics(settings)
    assert math.isnan(ended["ener_tot [kWh/m2]"])


def test_the_travel_of_an_input_that_is_left_to_the_plant_is_that_of_what_it_tells() -> None:
    trace = hut({"oveHea_y": None, "power": None})
    ends = (np.array([end]) for end in (0.0, 4e3))
    bounds = Bounds(*ends, trace.bounds.y_min, trace.bounds.y_max)
    commanded = np.full((21, 1), np.nan)
    left = replace(trace, inputs=Hut.inputs, u=commanded, changed_inputs=(), bounds=bounds)
    settings = MetricSettings(key_figures=KeyFigureTags(10.0, {ELECTRIC: ["power"]}))
    told = np.abs(np.diff(trace.columns()["monitored oveHea_y [W]"])).sum()
    assert left.metrics(settings)["atvl_tot [1]"] == pytest.approx(told)


def test_monitors_that_are_not_outputs_and_bands_that_are_none_are_refused() -> None:
    with pytest.raises(ConfigError, match="powr"):
        hut({"powr": None})
    with pytest.raises(ConfigError, match="needed: a Band or None"):
        hut({"room": Constant(1.0)})  # type: ignore[dict-item]
    with pytest.raises(ConfigError, match="lower 295 is above upper 294"):
        hut({"room": Band(295.0, 294.0)})
