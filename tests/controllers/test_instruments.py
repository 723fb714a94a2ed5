"""Instrumental variables against the problems as printed, and what is consistent in closed loop."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import piqp
import pytest

from ddpc_controllers import SPC, DeePC, GammaDDPC, hankel_matrix
from ddpc_controllers.data.hankel import ONE, WindowLayout
from ddpc_controllers.data.instruments import predict_all_at_once, predict_from_head, predict_one_by_one
from ddpc_cosim import ConfigError, DataError, FloatArray, Recording
from ddpc_cosim.settings import declared_settings

from .loops import LinearPlant, Run, before, close_loop, experiment, make_loop

PAST, HORIZON, Q, R = 4, 6, 10.0, 0.5
REGULATION: dict[str, Any] = {
    "artificial_setpoint": False,
    "initial_length": PAST,
    "horizon": HORIZON,
    "output_weight": Q,
    "input_weight": R,
}
PLANT = LinearPlant(np.array([[1.1, 0.3], [-0.4, 0.6]]), np.array([[0.5], [1.0]]), np.array([[1.0, 0.2]]))
PLANTS = {1: PLANT, 2: LinearPlant(PLANT.a, np.array([[0.5, 0.1], [1.0, -0.6]]), np.eye(2) + 0.1)}
"""By the number of inputs, and of outputs."""


def recorded_in_closed_loop(
    samples: int,
    seed: int = 0,
    noise: float = 0.3,
    plant: LinearPlant = PLANT,
    gain: float = 0.4,
    dither: float = 0.5,
) -> Recording:
    """Record a plant around a feedback of its noisy outputs, an excitation added to it."""
    rng = np.random.default_rng(seed)
    (p, order), m = plant.c.shape, plant.b.shape[1]
    x, u, y, w = np.zeros(order), np.zeros((samples, m)), np.zeros((samples, p)), np.zeros((samples, m))
    for k in range(samples):
        y[k] = plant.c @ x + noise * rng.standard_normal(p)
        w[k] = dither * rng.uniform(-1.0, 1.0, m)
        u[k] = -gain * np.resize(y[k], m) + w[k]
        x = plant.advance(x, u[k])
    return Recording(u, y, y, 0.1, excitation=w)


def regulated(
    method: type[DeePC | SPC],
    instruments: str,
    plant: LinearPlant,
    recording: Recording,
    current: bool,
    limit: float,
) -> Run:
    """Close the loop of a method that meets its past exactly, on steps of all outputs."""
    (p, _), m = plant.c.shape, plant.b.shape[1]
    settings: dict[str, Any] = REGULATION | {"use_current_output": current, "instruments": instruments}
    if method is DeePC:
        settings["slack"] = False
    reference = np.repeat([[0.0, 0.2], [1.0, -0.3]], 12, axis=0)[:, :p]
    loop = make_loop(recording, np.full(m, limit), np.full(p, np.inf))
    return close_loop(method(**settings), loop, plant.advance, plant.c, reference, 18)


def quadratic_optimum(
    cost: FloatArray, target: FloatArray, equal: FloatArray, to: FloatArray, boxed: FloatArray, limit: float
) -> FloatArray:
    """Minimise ``|cost x - target|^2`` subject to ``equal x = to`` and ``|boxed x| <= limit``."""
    solver = piqp.DenseSolver()
    for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
        setattr(solver.settings, name, 1e-12)
    size = np.full(len(boxed), limit)
    solver.setup(2.0 * cost.T @ cost, -2.0 * cost.T @ target, equal, to, boxed, -size, size)
    assert solver.solve() == piqp.PIQP_SOLVED
    return np.asarray(solver.result.x)


@pytest.mark.parametrize("limit", [0.3, 50.0])
@pytest.mark.parametrize("current", [True, False])
def test_open_loop_instruments_are_the_printed_problem(current: bool, limit: float) -> None:
    """Van Wingerden et al.: ``(U_p; Y_p; U_f; Y_f) Z' g`` with Z = (U_p; Y_p; U_f)."""
    recording, known = recorded_in_closed_loop(200), PAST + current
    u = hankel_matrix(recording.u[: 200 - current], PAST + HORIZON)
    y = hankel_matrix(recording.y, known + HORIZON)
    z = np.vstack([u[:PAST], y[:known], u[PAST:]])
    z_of_g, y_of_g = z @ z.T / z.shape[1], y[known:] @ z.T / z.shape[1]
    past_of_g, u_of_g = z_of_g[: PAST + known], z_of_g[PAST + known :]
    cost = np.vstack([Q**0.5 * y_of_g, R**0.5 * u_of_g])
    settings = REGULATION | {"use_current_output": current, "instruments": "open-loop"}
    reference = np.repeat([0.0, 1.0, -0.5], 20)[:, np.newaxis]
    loop = make_loop(recording, np.array([limit]), np.array([np.inf]))
    run = close_loop(DeePC(slack=False, **settings), loop, PLANT.advance, PLANT.c, reference, 45)
    for k, sample in enumerate(run.samples):
        past = np.concatenate(
            [
                before(run.u, np.zeros(1), k, PAST)[:, 0],
                before(run.y, run.y[0], k + current, known)[:, 0],
            ]
        )
        target = np.concatenate([Q**0.5 * sample.reference[:, 0], np.zeros(HORIZON)])
        g = quadratic_optimum(cost, target, past_of_g, past, u_of_g, limit)
        assert run.u[k, 0] == pytest.approx(u_of_g[0] @ g, abs=1e-6)
    spc = SPC(**settings | {"instruments": "none"})  # the direct equivalence
    assert np.abs(run.u - close_loop(spc, loop, PLANT.advance, PLANT.c, reference, 45).u).max() < 1e-8
    assert (np.abs(run.u).max() > limit - 1e-9) == (limit < 1.0)


@pytest.mark.parametrize("limit", [0.3, 50.0])
@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 2)])
@pytest.mark.parametrize("method", [DeePC, SPC])
def test_closed_loop_instruments_are_the_printed_problem(
    method: type[DeePC | SPC], inputs: int, outputs: int, current: bool, limit: float
) -> None:
    """Dinkla et al.: a column of G for every predicted sample, each with the windows of one sample.

    Predicted outputs stand on both sides: ``(U; Y_p; Y_1) Z' G`` is a Hankel matrix of past and future, and
    nothing is applied one after the other.
    """
    m, p = inputs, outputs
    plant, recording, known = PLANTS[m], recorded_in_closed_loop(300, plant=PLANTS[m]), PAST + current
    u, y = hankel_matrix(recording.u[:-1], known), hankel_matrix(recording.y, known + 1)
    z = np.vstack([u, y[: known * p]])
    of_g = np.vstack([z, y[known * p :]]) @ z.T / z.shape[1]
    columns, rows = len(z), len(of_g)
    # The unknowns: G, column by column, then the inputs and the outputs of the horizon.
    u_at, y_at = HORIZON * columns, HORIZON * (columns + m)
    size = HORIZON * (columns + m + p)
    equal = np.zeros((HORIZON * rows, size))
    given: list[tuple[int, str, int, int]] = []  # row, signal, sample of the past, channel
    for column in range(HORIZON):
        top = column * rows
        equal[top : top + rows, column * columns : (column + 1) * columns] = of_g
        for i in range(known):
            for channel in range(m):
                row, future = top + i * m + channel, column + i - PAST
                if future >= 0:
                    equal[row, u_at + future * m + channel] = -1.0
                else:
                    given.append((row, "u", column + i, channel))
        for i in range(known + 1):
            for channel in range(p):
                row, future = top + known * m + i * p + channel, column + i - known
                if future >= 0:
                    equal[row, y_at + future * p + channel] = -1.0
                else:
                    given.append((row, "y", column + i, channel))
    select = np.eye(size)
    cost = np.vstack([Q**0.5 * select[y_at:], R**0.5 * select[u_at:y_at]])
    run = regulated(method, "closed-loop", plant, recording, current, limit)
    for k, sample in enumerate(run.samples):
        past = {
            "u": before(run.u, np.zeros(m), k, PAST),
            "y": before(run.y, run.y[0], k + current, known),
        }
        to = np.zeros(len(equal))
        for row, signal, i, channel in given:
            to[row] = past[signal][i, channel]
        target = np.concatenate([Q**0.5 * sample.reference.ravel(), np.zeros(HORIZON * m)])
        x = quadratic_optimum(cost, target, equal, to, select[u_at:y_at], limit)
        assert run.u[k] == pytest.approx(x[u_at : u_at + m], abs=1e-6)


@pytest.mark.parametrize("limit", [0.3, 50.0])
@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 2)])
@pytest.mark.parametrize("method", [DeePC, SPC])
def test_excitation_instruments_are_two_stage_least_squares_and_a_recursion(
    method: type[DeePC | SPC], inputs: int, outputs: int, current: bool, limit: float
) -> None:
    """Both stages written out with projections; the recursion is solved with the plan, not beforehand."""
    m, p = inputs, outputs
    plant, recording, known = PLANTS[m], recorded_in_closed_loop(300, plant=PLANTS[m]), PAST + current
    back = 2 * known * (m + p) // m
    rows = range(back, len(recording))
    z = np.array([[*recording.excitation[k - back : k].ravel(), 1.0] for k in rows])
    x = np.array([[*recording.u[k - known : k].ravel(), *recording.y[k - known : k].ravel()] for k in rows])
    x_of_z = z @ np.linalg.solve(z.T @ z, z.T @ x)
    theta = np.linalg.solve(x_of_z.T @ x_of_z, x_of_z.T @ recording.y[rows]).T
    of_u, of_y = theta[:, : known * m], theta[:, known * m :]
    size, y_at = HORIZON * (m + p), HORIZON * m
    select = np.eye(size)
    cost = np.vstack([Q**0.5 * select[y_at:], R**0.5 * select[:y_at]])
    run = regulated(method, "excitation", plant, recording, current, limit)
    for k, sample in enumerate(run.samples):
        u_ini, y_ini = before(run.u, np.zeros(m), k, PAST), before(run.y, run.y[0], k + current, known)
        equal, to = np.zeros((HORIZON * p, size)), np.zeros(HORIZON * p)
        for i in range(HORIZON):
            at = slice(i * p, (i + 1) * p)
            equal[at, y_at + i * p : y_at + (i + 1) * p] = np.eye(p)
            for j in range(known):
                u_part, y_part = of_u[:, j * m : (j + 1) * m], of_y[:, j * p : (j + 1) * p]
                if (sample_of_u := i + j - PAST) >= 0:
                    equal[at, sample_of_u * m : (sample_of_u + 1) * m] -= u_part
                else:
                    to[at] += u_part @ u_ini[sample_of_u]
                if (sample_of_y := i + j - known) >= 0:
                    equal[at, y_at + sample_of_y * p : y_at + (sample_of_y + 1) * p] -= y_part
                else:
                    to[at] += y_part @ y_ini[sample_of_y]
        target = np.concatenate([Q**0.5 * sample.reference.ravel(), np.zeros(HORIZON * m)])
        optimum = quadratic_optimum(cost, target, equal, to, select[:y_at], limit)
        assert run.u[k] == pytest.approx(optimum[:m], abs=1e-6)
    assert (np.abs(run.u).max() > limit - 1e-9) == (limit < 1.0)


@pytest.mark.parametrize("length", [PAST, PAST + 1])
@pytest.mark.parametrize("affine", [True, False])
@pytest.mark.parametrize("disturbances", [0, 2])
@pytest.mark.parametrize("seams", [(), (70, 160)])
def test_the_predictor_is_a_recursion_of_least_squares(
    length: int, affine: bool, disturbances: int, seams: Sequence[int]
) -> None:
    rng = np.random.default_rng(3)
    m, p, n_d = 2, 2, disturbances
    u, y, d = (rng.standard_normal((240, width)) for width in (m, p, n_d))
    layout = WindowLayout(
        ("u", 0, PAST),
        ("y", 0, length),
        *([(ONE, 0, 1)] if affine else []),
        ("d", 0, PAST + HORIZON),
        ("u", PAST, HORIZON),
        ("y", length, HORIZON),
    )
    predictor = predict_one_by_one({"u": u, "y": y, "d": d}, seams, layout, length)

    def regressor(u: FloatArray, y: FloatArray, d: FloatArray, k: int, ahead: bool) -> FloatArray:
        recent = slice(k - length, k)
        parts = [u[recent].ravel(), y[recent].ravel(), d[k - length : k + ahead].ravel()]
        return np.concatenate([*parts, np.ones(int(affine))])

    ends = (0, *seams, 240)
    known = [k for a, b in pairwise(ends) for k in range(a + length, b)]
    coefficients = {
        ahead: np.linalg.lstsq(np.array([regressor(u, y, d, k, ahead) for k in known]), y[known])[0]
        for ahead in (True, False)
    }
    # A window that is nowhere recorded.
    depth = PAST + HORIZON
    u, d, y = (rng.standard_normal((size, width)) for size, width in ((depth, m), (depth, n_d), (length, p)))
    window = [u[:PAST].ravel(), y.ravel(), np.ones(int(affine)), d.ravel(), u[PAST:].ravel()]
    for k in range(length, length + HORIZON):
        ahead = k < depth
        y = np.vstack([y, regressor(u, y, d, k, ahead) @ coefficients[ahead]])
    assert predictor @ np.concatenate(window) == pytest.approx(y[length:].ravel(), abs=1e-8)


@pytest.mark.parametrize("instruments", ["open-loop", "closed-loop", "excitation"])
@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC])
@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 2), (2, 1)])
def test_without_noise_instruments_change_nothing(
    method: type[DeePC | SPC], inputs: int, outputs: int, instruments: Any
) -> None:
    rng = np.random.default_rng(10 * inputs + outputs)
    plant = LinearPlant.random(rng, 3, inputs, outputs)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (150, inputs)), 3, plant.c)
    recording = replace(recording, excitation=recording.u)
    loop = make_loop(recording, np.full(inputs, 0.4), np.full(outputs, np.inf))
    reference = np.repeat(rng.uniform(-1.0, 1.0, (3, outputs)), 20, axis=0)

    def u(which: Any) -> FloatArray:
        return close_loop(method(instruments=which), loop, plant.advance, plant.c, reference, 40).u

    assert np.abs(u(instruments) - u("none")).max() < 1e-6


def test_in_closed_loop_only_one_sample_at_a_time_is_consistent() -> None:
    """Errors of the inputs' coefficients against the true Markov parameters C A^i B."""
    past = 7  # what it leaves out fades with A^8, as noise that is only measured has a Kalman gain of 0
    plant = LinearPlant(np.diag([0.4, -0.3]), np.array([[1.0], [1.0]]), np.array([[1.0, 0.5]]))
    markov = [(plant.c @ np.linalg.matrix_power(plant.a, i) @ plant.b)[0, 0] for i in range(HORIZON)]
    true = np.array([[markov[i - j] if i >= j else 0.0 for j in range(HORIZON)] for i in range(HORIZON)])
    layout = WindowLayout(("u", 0, past), ("y", 0, past + 1), ("u", past, HORIZON), ("y", past + 1, HORIZON))
    errors: dict[str, list[float]] = {"one by one": [], "at once": []}
    for samples in (400, 4_000, 20_000):
        recording = recorded_in_closed_loop(samples, plant=plant)
        signals = {"u": recording.u, "y": recording.y, "d": recording.d}
        predictors = {
            "one by one": predict_one_by_one(signals, (), layout, past + 1),
            "at once": predict_all_at_once(layout.stack(signals), HORIZON),
        }
        for how, predictor in predictors.items():
            errors[how].append(float(np.abs(predictor[:, -HORIZON:] - true).max()))
    assert errors["one by one"][0] > 1.5 * errors["one by one"][1] > 2.25 * errors["one by one"][2]
    assert errors["one by one"][2] < 0.02
    assert min(errors["at once"]) > 0.2


def test_with_a_short_past_only_excitation_is_consistent() -> None:
    """A pole at 0.9 and a past of the plant's order: what it leaves out biases the others."""
    plant = LinearPlant(np.diag([0.9, -0.3]), np.array([[1.0], [1.0]]), np.array([[1.0, 0.5]]))
    markov = [(plant.c @ np.linalg.matrix_power(plant.a, i) @ plant.b)[0, 0] for i in range(HORIZON)]
    true = np.array([[markov[i - j] if i >= j else 0.0 for j in range(HORIZON)] for i in range(HORIZON)])
    layout = WindowLayout(("u", 0, 2), ("y", 0, 3), ("u", 2, HORIZON), ("y", 3, HORIZON))
    errors: dict[bool, list[float]] = {True: [], False: []}
    for samples in (400, 4_000, 20_000):
        recording = recorded_in_closed_loop(samples, plant=plant, gain=0.2)
        for by_excitation, of_length in errors.items():
            predictor = predict_from_head(recording, layout, 3, "test", by_excitation=by_excitation)
            of_length.append(float(np.abs(predictor[:, -HORIZON:] - true).max()))
    assert errors[True][0] > 1.5 * errors[True][1] > 2.25 * errors[True][2]
    assert errors[True][2] < 0.02
    assert min(errors[False]) > 0.15


def test_disturbances_and_seams_go_with_excitation() -> None:
    """A known disturbance is an instrument itself; without noise the coefficients are the plant's."""
    rng = np.random.default_rng(0)
    u, d, y = rng.standard_normal((300, 1)), rng.standard_normal((300, 1)), np.zeros((300, 1))
    for first, end in ((0, 140), (140, 300)):
        for k in range(first + 1, end):
            y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1] + 0.3 * d[k - 1] + 2.0
    recording = Recording(u, y, y, 0.1, (140,), d, excitation=u)
    layout = WindowLayout(("u", 0, 1), ("y", 0, 2), (ONE, 0, 1), ("d", 0, 4), ("u", 1, 3), ("y", 2, 3))
    predictor = predict_from_head(recording, layout, 2, "test", by_excitation=True)
    windows = layout.stack({"u": u, "y": y, "d": d}, (140,))
    assert predictor @ windows[:-3] == pytest.approx(windows[-3:], abs=1e-8)


@pytest.mark.parametrize(
    ("recording", "fault"),
    [
        (
            replace(recorded_in_closed_loop(300), excitation=np.empty((300, 0))),
            "the recording knows none: ",
        ),
        (
            replace(recorded_in_closed_loop(300), excitation=np.random.default_rng(9).normal(size=(300, 1))),
            "input 1 of the recording does not follow what is said to have moved it",
        ),
        (
            replace(recorded_in_closed_loop(300), excitation=np.ones((300, 1))),
            "does not follow what is said to have moved it",
        ),
        (recorded_in_closed_loop(40), "take more than 32 windows; the recording of 40 samples has 25"),
    ],
)
@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC])
def test_excitation_that_says_nothing_is_refused(
    method: type[DeePC | SPC], recording: Recording, fault: str
) -> None:
    controller = method(
        instruments="excitation", initial_length=PAST, horizon=HORIZON, use_current_output=False
    )
    with pytest.raises(DataError, match=fault) as raised:
        controller.start(make_loop(recording, np.array([5.0]), np.array([np.inf])))
    assert "or use instruments = 'closed-loop'" in str(raised.value)


def test_the_prediction_that_is_tested_is_that_of_the_instruments() -> None:
    recording, known = recorded_in_closed_loop(400), PAST + 1
    loop = make_loop(recording, np.array([5.0]), np.array([np.inf]))
    controller = SPC(initial_length=PAST, horizon=HORIZON, instruments="closed-loop")
    controller.start(loop)
    layout = WindowLayout(("u", 0, PAST), ("y", 0, known), ("u", PAST, HORIZON), ("y", known, HORIZON))
    signals = {"u": recording.u, "y": recording.y, "d": recording.d}
    data = layout.stack(signals)
    tail = data.shape[1] - round(0.25 * data.shape[1])
    head = {name: values[:tail] for name, values in signals.items()}  # no window of the tail begins before
    errors = data[-1] - (predict_one_by_one(head, (), layout, known) @ data[:-HORIZON])[-1]
    expected = np.sqrt(np.mean(errors[tail:] ** 2)) / data[-1].std()
    assert controller.diagnostics()["prediction_error"] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC])
def test_a_feedback_without_excitation_says_nothing_of_the_inputs(method: type[DeePC | SPC]) -> None:
    loop = make_loop(recorded_in_closed_loop(300, dither=0.0), np.array([5.0]), np.array([np.inf]))
    method().start(loop)
    with pytest.raises(DataError, match="add an excitation to the controller's"):
        method(instruments="closed-loop").start(loop)


def test_data_that_follow_the_plant_have_no_instruments() -> None:
    with pytest.raises(ConfigError, match=r"instruments = 'closed-loop' .* online_data = 'frozen'"):
        DeePC(instruments="closed-loop", online_data="sliding-window")


@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC])
def test_tuning_does_not_choose_instruments(method: type[DeePC | SPC]) -> None:
    """How the data were recorded decides, and is known."""
    assert declared_settings(method)["instruments"].search is None
