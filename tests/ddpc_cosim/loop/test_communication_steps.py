"""A plant that is read between samples: the same run, with figures of what happened in between."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import trapezoid

from ddpc_cosim import (
    Band,
    ConfigError,
    Constant,
    Controller,
    FloatArray,
    Loop,
    MetricSettings,
    Outcome,
    Plant,
    Price,
    Problem,
    Sample,
    Steps,
    Study,
    Trace,
    Variable,
    cosimulate,
)
from ddpc_cosim.conditions import Conditions
from ddpc_cosim.description import KeyFigureTags
from ddpc_cosim.metrics import split_key

H, C = 3600.0, 300.0
SAMPLES = 6
TARIFF = Steps([0.0, 2 * H, 5 * H], [0.2, 0.4, 0.1])
NIGHT = Band(Steps([0.0, 3 * H], [16.0, 20.0]), 24.0)
COURSE = [500.0, 900.0, 100.0, 700.0, 0.0, 300.0]
TAGS = KeyFigureTags(100.0, {"ElectricPower": ["power"], "AirZoneTemperature[a]": ["room"]})


class Room(Plant):
    """A room whose heater a thermostat of its own interrupts every other time that it is asked, every 5 min.

    The temperature is that of a first-order lag of 2 h, exact at each step.
    """

    inputs = (Variable("heat", "W", start=0.0),)
    outputs = (Variable("room", "degC"), Variable("power", "W"))

    def __init__(self, fails_after: float = math.inf) -> None:
        self._fails_after = fails_after

    def reset(self, parameters: Mapping[str, object] | None = None, t0: float = 0.0) -> FloatArray:
        self._time, self._room = t0, 18.0
        return np.array([self._room, 0.0])

    def step(self, u: FloatArray, h: float) -> FloatArray:
        power = 0.0
        for _ in range(round(h / C)):
            power = u[0] * (round(self._time / C) % 2)
            decay = math.exp(-C / 7200.0)
            self._room = decay * self._room + (1.0 - decay) * (10.0 + power / 50.0)
            self._time += C
        return np.array([self._room if self._time < self._fails_after else math.nan, power])


class Heating(Controller):
    """Applies a course of inputs, each for some samples."""

    def __init__(self, course: Sequence[float] = COURSE, times: int = 1) -> None:
        self.course, self.times = course, times

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> FloatArray:
        return np.array([self.course[min(sample.k // self.times, len(self.course) - 1)]])


COURSES = st.lists(st.floats(0.0, 2000.0), min_size=SAMPLES, max_size=SAMPLES)


def run(
    course: list[float] = COURSE,
    *,
    sampling_time: float = H,
    communication_step: float | None = C,
    plant: Plant | None = None,
    conditions: Conditions | None = None,
) -> Trace:
    return cosimulate(
        plant or Room(),
        Heating(course=course, times=round(H / sampling_time)),
        sampling_time=sampling_time,
        communication_step=communication_step,
        duration=SAMPLES * H,
        reference={"room": NIGHT},
        outputs=["room"],
        prices={"electricity": Price(signal="power", price=TARIFF, unit="EUR/kWh", emissions=0.3)},
        conditions=conditions,
    )


def figures(trace: Trace) -> dict[str, float]:
    """Return what is paid and the key figures, by the names of the metrics."""
    metrics = trace.metrics(MetricSettings(key_figures=TAGS))
    return {split_key(key)[0]: value for key, value in metrics.items()}


@given(COURSES)
def test_the_samples_are_those_of_a_plant_that_is_not_read_in_between(course: list[float]) -> None:
    fine, plain = run(course), run(course, communication_step=None)
    for name in ("time", "y", "measured", "u", "charged", "price"):
        assert np.array_equal(getattr(fine, name), getattr(plain, name))
    assert fine.columns().keys() > plain.columns().keys()


@given(COURSES)
def test_what_is_paid_is_that_of_a_run_that_is_sampled_as_often(course: list[float]) -> None:
    """A controller that holds its inputs there does the same."""
    fine, often = figures(run(course)), figures(run(course, sampling_time=C, communication_step=None))
    for name in ("money", "energy", "emissions", "peak", "ener_tot", "emis_tot", "pele_tot"):
        assert fine[name] == pytest.approx(often[name], rel=1e-12, abs=1e-12)


def test_figures_are_integrals_by_the_trapezoidal_rule_over_limits_and_prices_that_are_held() -> None:
    trace = run()
    room, power, steps = 18.0, [0.0], round(H / C)
    rooms = [room]
    for k in range(SAMPLES * steps):
        power.append(COURSE[k // steps] * (k % 2))
        room = room + (1.0 - math.exp(-C / 7200.0)) * (10.0 + power[-1] / 50.0 - room)
        rooms.append(room)
    money, discomfort = 0.0, 0.0
    for k in range(SAMPLES):
        each = slice(k * steps, (k + 1) * steps + 1)
        time = C * np.arange(steps + 1)
        money += float(TARIFF.at(np.array([k * H]))[0]) * trapezoid(power[each], time) / 3.6e6
        low = 16.0 if k < 3 else 20.0
        away = np.maximum(low - np.array(rooms[each]), 0.0) + np.maximum(np.array(rooms[each]) - 24.0, 0.0)
        discomfort += trapezoid(away, time) / 3600.0
    of = figures(trace)
    assert of["money"] == pytest.approx(money, rel=1e-12)
    assert of["cost_tot"] == pytest.approx(money / 100.0, rel=1e-12)
    assert of["tdis_tot"] == pytest.approx(discomfort, rel=1e-12)
    assert figures(run(communication_step=None))["money"] != pytest.approx(money, rel=0.05)


def test_a_disturbance_of_an_output_acts_between_samples_too() -> None:
    warmer = run(conditions=Conditions(disturbances={"power": Constant(100.0)}))
    hours = SAMPLES * H / 3600.0
    assert figures(warmer)["energy"] == pytest.approx(figures(run())["energy"] + 0.1 * hours, rel=1e-12)


def test_a_run_that_ends_between_samples_is_paid_for_with_what_is_known_last() -> None:
    trace = run([600.0] * SAMPLES, plant=Room(fails_after=2 * H + 5.5 * C))
    assert trace.outcome is Outcome.DIVERGED
    assert len(trace) == 3
    known, steps = np.arange(round(2 * H / C) + 6), round(3 * H / C) + 1
    power = np.where((known % 2 == 0) & (known > 0), 600.0, 0.0)  # after the second step and every other
    power = np.append(power, np.full(steps - len(power), power[-1]))
    assert figures(trace)["energy"] == pytest.approx(trapezoid(power, dx=C) / 3.6e6, rel=1e-12)


def test_columns_name_how_long_after_a_row_they_are_and_come_back_from_files(tmp_path: Path) -> None:
    problem = Problem(
        plant=Room,
        sampling_time=H,
        duration=SAMPLES * H,
        reference={"room": NIGHT},
        outputs=["room"],
        measurements=["room", "power"],
        communication_step="5 min",
        prices={"electricity": Price(signal="power", price=TARIFF, unit="EUR/kWh")},
    )
    results = Study(problem, {"heating": Heating()}, name="room").run(tmp_path, progress=False)
    (case,) = results.cases
    trace = case.trace()
    table = trace.columns()
    assert [key for key in table if key.startswith("after 300 s ")] == [
        "after 300 s room [degC]",
        "after 300 s power [W]",
    ]
    assert list(table)[-1] == "after 3300 s power [W]"
    expected = run()
    assert np.array_equal(trace.intersample, expected.intersample, equal_nan=True)
    assert trace.communication_step == C
    assert case.metrics["money [EUR]"] == pytest.approx(figures(expected)["money"], rel=1e-12)
    assert "communication_step = 300.0" in (tmp_path / "study.toml").read_text()
    other = replace(problem, communication_step=None)
    plain = Study(other, {"heating": Heating()}, name="room").run(tmp_path / "plain", progress=False)
    assert plain.cases[0].id != case.id


@pytest.mark.parametrize(
    ("step", "said"),
    [
        (1000.0, "sampling_time, 1 h, must be an integer multiple of it"),
        (7200.0, "must be an integer multiple of it"),
        (0.0, "allowed: a number > 0"),
        (math.nan, "allowed: a number > 0"),
        (1e-9, "must be an integer multiple of it"),
    ],
)
def test_steps_that_do_not_make_up_a_sampling_interval_are_refused(step: float, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        run(communication_step=step)
