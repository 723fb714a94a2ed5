"""What a run, a plant and a class show of themselves in a notebook."""

import importlib.metadata
from dataclasses import dataclass, replace

import numpy as np
import pytest

import ddpc_cosim
from ddpc_controllers import MFAPC, DeePC
from ddpc_cosim import (
    Charge,
    ConfigError,
    Controller,
    DisplayUnit,
    FMUPlant,
    Loop,
    Outcome,
    Plant,
    Sample,
    Steps,
    Trace,
    Variable,
    cosimulate,
    setting,
)

DEGREES = DisplayUnit("deg", 180 / np.pi)


class Integrator(Plant):
    inputs = (Variable("u", "V", min=-2.0, max=2.0),)
    outputs = (Variable("angle", "rad", display_unit=DEGREES),)

    def reset(self, parameters: object = None, t0: float = 0.0) -> np.ndarray:
        self.x = np.zeros(1)
        return self.x.copy()

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        self.x = self.x + h * u
        return self.x.copy()


@dataclass(kw_only=True)
class Proportional(Controller):
    gain: float = setting(1.0, doc="of the error")

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> np.ndarray:
        return self.gain * (sample.setpoint - sample.y)


@pytest.fixture
def trace() -> Trace:
    reference = Steps([0.0, 0.5], [1.0, -1.0])
    return cosimulate(Integrator(), Proportional(), sampling_time=0.1, duration=1.0, reference=reference)


def rows_of(chart: dict) -> list[dict]:
    """Return the samples of a chart."""
    return next(iter(chart["datasets"].values()))


def columns_of(chart: dict, *names: str) -> list[list[float]]:
    return [[row[name] for row in rows_of(chart)] for name in names]


def test_a_run_as_a_picture(trace: Trace) -> None:
    """Every sample is there in display units, with what is wanted, and limits that it comes near."""
    picture = trace.plot()
    output, control = picture.charts
    reference, response = columns_of(output, "r", "c0")
    np.testing.assert_allclose(reference, np.degrees(trace.reference[:, 0]), rtol=1e-5)
    np.testing.assert_allclose(response, np.degrees(trace.y[:, 0]), rtol=1e-5)
    np.testing.assert_allclose(columns_of(control, "c0")[0], trace.u[:, 0], rtol=1e-5)
    assert picture.title == "angle over time"
    assert "angle / \N{DEGREE SIGN}" in picture.svg
    failed = replace(trace, outcome=Outcome.CRASHED, reason="gone\x1b[2J")
    assert failed.plot().title == "crashed: gone\\x1b[2J"


def test_a_run_without_samples_is_a_picture_too(trace: Trace) -> None:
    arrays = ("time", "reference", "y", "measured", "u", "solve_time")
    empty = replace(trace, **{name: getattr(trace, name)[:0] for name in arrays}, status=())
    empty = replace(empty, outcome=Outcome.CRASHED, reason="at once")
    assert (empty.plot().title, empty.plot().charts) == ("crashed: at once", ())
    both = trace.plot(empty, labels=["a", "b"])
    assert len(both.charts) == 2
    assert "b: crashed: at once" in both.svg


def test_runs_of_other_loops_are_not_drawn_over_each_other(trace: Trace) -> None:
    other = replace(trace, inputs=(Variable("force"),))
    with pytest.raises(ConfigError, match="run 2: other signals: force -> angle; needed: u -> angle"):
        trace.plot(other)


def test_short_texts(trace: Trace, pendulum_fmu) -> None:
    assert repr(trace) == "Trace(completed, 11 of 11 samples, 0.1 s apart, u -> angle)"
    assert (
        f"<td>rmse.angle [deg]</td><td>{trace.metrics()['rmse.angle [deg]']:.4g}</td>" in trace._repr_html_()
    )
    with FMUPlant(pendulum_fmu, inputs=["torque"], outputs=["angle"]) as plant:
        assert repr(plant) == f"FMUPlant({pendulum_fmu.name}, FMI 2.0 Co-Simulation, 1 inputs, 1 outputs)"
        assert "<td>torque</td><td>N.m</td>" in plant._repr_html_()
    hostile = replace(trace, outputs=(Variable("<script>alert(1)</script>"),))
    assert "<script>" not in hostile._repr_html_()
    assert ddpc_cosim.__version__ == importlib.metadata.version("ddpc-cosim")


def test_an_unknown_keyword_of_a_controller_is_told_with_the_one_that_is_meant() -> None:
    with pytest.raises(ConfigError, match='unknown setting of Proportional; did you mean "gain"'):
        Proportional(gian=1.0)  # type: ignore[call-arg]
    with pytest.raises(ConfigError) as caught:
        DeePC(lambda_gg=1.0, horizont=3)  # type: ignore[call-arg]
    assert len(caught.value.faults) == 2
    assert MFAPC(horizon=4).horizon == 4


def test_bands_limits_that_move_disturbances_and_prices_have_their_charts(trace: Trace) -> None:
    """All of it over three days, in days; in display units."""
    n = len(trace)
    edges = np.stack([np.full((n, 1), -0.1), np.full((n, 1), 0.1)], axis=-1)
    limits = np.stack([np.zeros((n, 1)), np.arange(n, dtype=float)[:, None]], axis=-1)
    more = replace(
        trace,
        time=trace.time * 3 * 86400,
        bands=("angle",),
        band=edges,
        moving_limits=("u",),
        input_limits=limits,
        disturbances=(Variable("wind", "m/s"),),
        d=np.arange(n, dtype=float)[:, None],
        charges=(Charge("power", "u", 1.0, "EUR", known=True, amount="kWh"),),
        price=np.full((n, 1), 0.2),
        emission=np.zeros((n, 1)),
        charged=trace.u,
    )
    output, control, wind, price = more.plot().charts
    lower, upper, response = columns_of(output, "lower", "upper", "c0")
    np.testing.assert_allclose(lower, np.degrees(edges[:, 0, 0]), rtol=1e-5)
    np.testing.assert_allclose(upper, np.degrees(edges[:, 0, 1]), rtol=1e-5)
    np.testing.assert_allclose(response, np.degrees(trace.y[:, 0]), rtol=1e-5)
    np.testing.assert_allclose(columns_of(output, "t")[0], np.linspace(0, 3, n), atol=1e-9)
    np.testing.assert_allclose(columns_of(control, "limit0")[0], limits[:, 0, 1])
    assert columns_of(wind, "m")[0] == np.arange(n).tolist()
    assert columns_of(price, "x")[0] == [0.2] * n
    svg = more.plot().svg
    for title in ("wind / m/s", "price of power / EUR/kWh"):
        assert title in svg
