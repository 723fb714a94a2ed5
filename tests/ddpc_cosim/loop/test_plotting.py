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


def test_a_run_as_a_chart(trace: Trace) -> None:
    """Every sample is there in display units, what is held as steps, limits as rules."""
    spec = trace.plot().to_dict()
    output, control = spec["vconcat"]
    data = spec.get("datasets", {})

    def values(layer: dict) -> list[float]:
        rows = data[layer["data"]["name"]] if "name" in layer["data"] else layer["data"]["values"]
        return [row["value"] for row in rows]

    reference, response = output["layer"]
    np.testing.assert_allclose(values(reference), np.degrees(trace.reference[:, 0]))
    np.testing.assert_allclose(values(response), np.degrees(trace.y[:, 0]))
    assert reference["mark"]["interpolate"] == "step-after"
    assert "interpolate" not in response["mark"]
    signal, limits = control["layer"]
    np.testing.assert_array_equal(values(signal), trace.u[:, 0])
    assert values(limits) == [-2.0, 2.0]
    assert output["encoding"]["y"]["title"] == "angle [deg]"
    assert "title" not in spec
    failed = replace(trace, outcome=Outcome.CRASHED, reason="gone\x1b[2J")
    assert failed.plot().to_dict()["title"] == "crashed: gone\\x1b[2J"


def test_a_run_without_samples_is_a_chart_too(trace: Trace) -> None:
    arrays = ("time", "reference", "y", "measured", "u", "solve_time")
    empty = replace(trace, **{name: getattr(trace, name)[:0] for name in arrays}, status=())
    assert len(empty.plot().to_dict()["vconcat"]) == 2


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


def test_bands_are_shaded_limits_move_as_steps_and_disturbances_and_prices_have_panels(trace: Trace) -> None:
    """All of it over three days, in hours; in display units."""
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
    spec = more.plot().to_dict()
    data = spec.get("datasets", {})

    def rows(layer: dict) -> list[dict]:
        return data[layer["data"]["name"]] if "name" in layer["data"] else layer["data"]["values"]

    output, control, wind, price = spec["vconcat"]
    band, response = output["layer"]
    assert band["mark"]["type"] == "area"
    np.testing.assert_allclose([row["upper"] for row in rows(band)], np.degrees(edges[:, 0, 1]))
    np.testing.assert_allclose([row["value"] for row in rows(response)], np.degrees(trace.y[:, 0]))
    assert [row["time"] for row in rows(response)] == pytest.approx(np.linspace(0, 72, n).tolist())
    signal, least, most = control["layer"]
    assert [layer["mark"]["interpolate"] for layer in (signal, least, most)] == ["step-after"] * 3
    np.testing.assert_allclose([row["value"] for row in rows(most)], limits[:, 0, 1])
    assert [panel["encoding"]["y"]["title"] for panel in (wind, price)] == ["wind [m/s]", "power [EUR/kWh]"]
    assert price["encoding"]["x"]["title"] == "time [h]"
