"""Planes of a run: the points are samples of it, in display units, the rate that of a formula."""

import itertools
from dataclasses import replace

import numpy as np

from ddpc_cosim import Outcome, Trace
from ddpc_reports.comparison import conditions
from ddpc_reports.figures.planes import plane_figure

from ..synthetic import ANGLE, SAMPLING_TIME, SPEED, MakeResults, make_trace


def points(spec: dict, key: str) -> np.ndarray:
    """Return the points of a controller, shape (N, 2)."""
    rows = [row for row in spec["data"]["values"] if row["key"] == key]
    assert [row.get("begins", False) for row in rows] == [True] + [False] * (len(rows) - 1)
    return np.array([[row["x"], row["y"]] for row in rows])


def test_an_output_its_rate_and_the_input(make_results: MakeResults) -> None:
    results = make_results(lambda key, seed: make_trace(0.3, noise_seed=seed))
    (condition,) = conditions(results)
    figure = plane_figure(condition, "p-")
    assert figure is not None
    rate, control = figure.views
    trace = results.trace("quick")
    angle = np.degrees(trace.y[:, 0])
    central = (angle[2:] - angle[:-2]) / (2 * SAMPLING_TIME)
    inner = np.column_stack([angle[1:-1], central])
    drawn = points(rate.spec, "c0")
    nearest = [np.abs(inner - point).max(axis=1).min() for point in drawn[1:-1]]
    assert max(nearest) < 1e-2, "each is a sample"
    np.testing.assert_allclose(points(control.spec, "c0")[0], [angle[0], trace.u[0, 0]], rtol=1e-3)
    assert [view.spec["layer"][0]["encoding"]["y"]["title"] for view in figure.views] == [
        "rate of angle / °/s",
        "torque / N·m",
    ]
    assert figure.folded


def test_two_outputs_are_over_each_other(make_results: MakeResults) -> None:
    results = make_results(
        lambda key, seed: make_trace(0.3, outputs=(ANGLE, SPEED)),
        plant={"name": "pendulum", "inputs": ["torque"], "outputs": ["angle", "speed"]},
        reference={
            "angle": {"kind": "constant", "value": 20.0, "unit": "deg"},
            "speed": {"kind": "constant", "value": 0.3},
        },
    )
    (condition,) = conditions(results)
    figure = plane_figure(condition, "p-")
    assert figure is not None
    assert figure.views[0].spec["layer"][0]["encoding"]["y"]["title"] == "speed / m/s"
    assert "A rate is" not in figure.caption


def test_of_a_long_run_the_points_are_even_along_its_line(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.3)
        time = np.linspace(0.0, 100.0, 20_001)
        column = time[:, None]
        return replace(
            trace,
            time=time,
            y=np.sin(column),
            measured=np.sin(column),
            u=np.cos(column),
            reference=np.zeros_like(column),
            status=("ok",) * len(time),
            solve_time=np.full(len(time), 1e-5),
            sampling_time=0.005,
            planned_samples=len(time),
        )

    (condition,) = conditions(make_results(trace_of))
    figure = plane_figure(condition, "p-")
    assert figure is not None
    drawn = points(figure.views[1].spec, "c0") / [np.degrees(2), 2]
    steps = [float(np.hypot(*(b - a))) for a, b in itertools.pairwise(drawn)]
    assert len(drawn) == 200
    assert max(steps) < 2 * min(steps)


def test_nothing_is_drawn_of_runs_without_samples(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.3, outcome=Outcome.CRASHED, reason="gone")
        arrays = ("time", "reference", "y", "measured", "u", "solve_time")
        return replace(trace, **{name: getattr(trace, name)[:1] for name in arrays}, status=("ok",))

    (condition,) = conditions(make_results(trace_of))
    assert plane_figure(condition, "p-") is None
