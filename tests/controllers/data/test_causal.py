"""Causal predictors against least squares by hand, and how uncertain they are against many experiments."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from controllers.loops import LinearPlant, experiment
from ddpc_controllers.data.causal import predict_causally, uncertainty_cost
from ddpc_controllers.data.hankel import WindowLayout, window_starts
from ddpc_controllers.data.instruments import predict_all_at_once
from ddpc_cosim import FloatArray, Recording

PAST, HORIZON = 2, 4


class Windows(NamedTuple):
    """Stacked windows and how they are stacked."""

    data: FloatArray
    layout: WindowLayout
    widths: dict[str, int]
    starts: NDArray[np.intp]

    @property
    def known(self) -> FloatArray:
        return self.data[: -HORIZON * self.widths["y"]]

    @property
    def outputs(self) -> FloatArray:
        return self.data[-HORIZON * self.widths["y"] :]

    def predictor(self, name: str) -> FloatArray:
        if name == "least-squares":
            return predict_all_at_once(self.data, len(self.outputs))
        return predict_causally(self.data, self.layout, self.widths, transient=name == "transient")


def stacked(recording: Recording, current: bool) -> Windows:
    """Return the windows of SPC, known disturbances among them."""
    known = PAST + current
    layout = WindowLayout(
        ("u", 0, PAST), ("y", 0, known), ("d", 0, PAST + HORIZON), ("u", PAST, HORIZON), ("y", known, HORIZON)
    )
    signals = {"u": recording.u, "y": recording.y, "d": recording.d}
    widths = {name: values.shape[1] for name, values in signals.items()}
    starts = window_starts(len(recording), layout.depth, recording.seams)
    return Windows(layout.stack(signals, recording.seams), layout, widths, starts)


def noisy(samples: int, inputs: int, outputs: int, disturbances: int, seed: int = 0) -> Recording:
    """Return a recording of nothing but noise, in two pieces: every coefficient shows."""
    rng = np.random.default_rng(seed)
    u, y, d = (rng.standard_normal((samples, width)) for width in (inputs, outputs, disturbances))
    return Recording(u, y, y, 0.1, (samples // 3,), d)


def rows_before(windows: Windows, current: bool, step: int) -> list[int]:
    """Return which known rows come before an output: past, disturbances and inputs, counted by hand."""
    m, p, n_d = windows.widths["u"], windows.widths["y"], windows.widths["d"]
    past = PAST * m + (PAST + current) * p
    disturbances = past + (PAST + HORIZON) * n_d
    acting = past + min(PAST + current + step + 1, PAST + HORIZON) * n_d
    return [*range(acting), *range(disturbances, disturbances + (step + current) * m)]


@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize(("inputs", "outputs", "disturbances"), [(1, 1, 0), (2, 2, 1), (1, 2, 2)])
def test_no_output_depends_on_a_later_input(
    inputs: int, outputs: int, disturbances: int, current: bool
) -> None:
    windows = stacked(noisy(160, inputs, outputs, disturbances), current)
    predictor = windows.predictor("causal")
    for step in range(HORIZON):
        given, output = rows_before(windows, current, step), slice(step * outputs, (step + 1) * outputs)
        fitted = np.linalg.lstsq(windows.known[given].T, windows.outputs[output].T)[0].T
        assert predictor[output, given] == pytest.approx(fitted, abs=1e-9)
        assert not np.delete(predictor[output], given, axis=1).any()


def test_the_causal_predictor_is_the_lower_triangle_of_l_32() -> None:
    """The matrix of Sader et al., all inputs acting on the outputs of their own sample."""
    windows = stacked(noisy(120, 2, 2, 0), True)
    lower = np.linalg.qr(windows.data.T, mode="r").T
    rows, past = len(windows.known), len(windows.known) - 2 * HORIZON
    of_inputs = lower[rows:, past:rows].reshape(HORIZON, 2, HORIZON, 2)
    of_inputs *= np.tri(HORIZON)[:, np.newaxis, :, np.newaxis]
    expected = np.hstack([lower[rows:, :past], of_inputs.reshape(2 * HORIZON, 2 * HORIZON)])
    expected = expected @ np.linalg.inv(lower[:rows, :rows])
    assert windows.predictor("causal") == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize(("inputs", "outputs", "disturbances"), [(1, 1, 0), (2, 2, 1)])
def test_the_transient_predictor_goes_on_from_its_own_outputs(
    inputs: int, outputs: int, disturbances: int, current: bool
) -> None:
    windows = stacked(noisy(200, inputs, outputs, disturbances), current)
    z = np.random.default_rng(1).standard_normal(len(windows.known))
    predicted = np.zeros(0)
    for step in range(HORIZON):
        given, output = rows_before(windows, current, step), slice(step * outputs, (step + 1) * outputs)
        regressors = np.vstack([windows.known[given], windows.outputs[: step * outputs]])
        fitted = np.linalg.lstsq(regressors.T, windows.outputs[output].T)[0].T
        predicted = np.append(predicted, fitted @ np.concatenate([z[given], predicted]))
    assert windows.predictor("transient") @ z == pytest.approx(predicted, abs=1e-9)


@given(
    seed=st.integers(0, 2**32 - 1), inputs=st.integers(1, 2), outputs=st.integers(1, 2), current=st.booleans()
)
@settings(max_examples=8, deadline=None)
def test_without_noise_all_predictors_are_the_plant(
    seed: int, inputs: int, outputs: int, current: bool
) -> None:
    rng = np.random.default_rng(seed)
    plant = LinearPlant.random(rng, 2, inputs, outputs)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (80, inputs)), 2, plant.c)
    windows = stacked(recording, current)
    another = experiment(plant.advance, rng.uniform(-1.0, 1.0, (PAST + HORIZON + 1, inputs)), 2, plant.c)
    column = stacked(another, current)
    for name in ("least-squares", "causal", "transient"):
        predictor = windows.predictor(name)
        assert predictor @ column.known == pytest.approx(column.outputs, abs=1e-6)
        added = uncertainty_cost(
            windows.data,
            predictor,
            np.eye(outputs),
            windows.layout,
            windows.widths,
            windows.starts,
            causal=False,
        )
        assert np.abs(added @ column.known).max() < 1e-6


@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize("causal", [True, False])
def test_the_uncertainty_is_that_of_windows_that_share_noise(causal: bool, current: bool) -> None:
    """The covariance of all windows' errors, written down entry by entry."""
    windows, weight = stacked(noisy(90, 2, 2, 1), current), np.array([[2.0, 0.3], [0.3, 1.0]])
    predictor = windows.predictor("causal" if causal else "least-squares")
    errors = windows.outputs - predictor @ windows.known
    l_33 = np.linalg.cholesky(errors @ errors.T / (errors.shape[1] - len(windows.known)))
    z = np.random.default_rng(2).standard_normal(len(windows.known))
    expected = 0.0
    for step in range(HORIZON):
        given = rows_before(windows, current, step) if causal else list(range(len(z)))
        w = np.linalg.pinv(windows.known[given]) @ z[given]
        noise = [l_33[2 * step : 2 * step + 2, 2 * i : 2 * i + 2] for i in range(step + 1)]
        for j, start in enumerate(windows.starts):
            for k, other in enumerate(windows.starts):
                lag = int(other - start)  # what is new at sample i of one is new at i - lag of the other
                shared = [
                    np.trace(weight @ noise[i] @ noise[i - lag].T)
                    for i in range(step + 1)
                    if 0 <= i - lag <= step
                ]
                expected += w[j] * w[k] * sum(shared)
    added = uncertainty_cost(
        windows.data, predictor, weight, windows.layout, windows.widths, windows.starts, causal=causal
    )
    assert np.sum(np.square(added @ z)) == pytest.approx(expected, rel=1e-8)


def test_the_uncertainty_is_the_spread_of_predictions_over_experiments() -> None:
    experiments, rng = 80, np.random.default_rng(0)
    z = np.array([0.5, -1.0, 0.2, 0.8, -0.4, 1.0, 0.7, -1.0, 0.3])
    u, state = rng.uniform(-1.0, 1.0, (80, 1)), np.zeros(experiments)
    y = np.zeros((experiments, 80, 1))
    for k in range(80):  # innovations: what is new of an output moves the state too
        new = 0.3 * rng.standard_normal(experiments)
        y[:, k, 0] = state + new
        state = 0.7 * state + u[k] + 0.6 * new
    for name in ("least-squares", "causal"):
        predictions, expected = list[FloatArray](), list[float]()
        for outputs in y:
            data, layout, widths, starts = windows = stacked(Recording(u, outputs, outputs, 0.1), True)
            predictor = windows.predictor(name)
            predictions.append(predictor @ z)
            causal = name == "causal"
            added = uncertainty_cost(data, predictor, np.eye(1), layout, widths, starts, causal=causal)
            expected.append(float(np.sum(np.square(added @ z))))
        assert np.mean(expected) == pytest.approx(np.var(predictions, axis=0).sum(), rel=0.25)
