"""Disturbances with forecasts, bands, limits that move and prices in every predictive method from data."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest

from ddpc_controllers import MPC, SPC, WKPC, DeePC, GammaDDPC, Identified, KoopmanMPC, StateSpace
from ddpc_controllers.data.dictionaries import Identity, ThinPlate
from ddpc_controllers.deepc import BehavioralTracking
from ddpc_cosim import (
    Action,
    Bounds,
    Charge,
    ConfigError,
    Controller,
    DataError,
    FloatArray,
    Loop,
    Recording,
    Sample,
    Variable,
)

from .loops import SAMPLING_TIME, Advance, LinearPlant, quick_pendulum
from .whole_problem import Ahead, Answer, solve

Method = BehavioralTracking | WKPC


class Case(NamedTuple):
    """A plant whose last columns of what moves it are disturbances; its last measurement is a power."""

    advance: Advance
    output: FloatArray
    inputs: int
    disturbances: int
    limit: float


def linear(seed: int, order: int, inputs: int, outputs: int, disturbances: int) -> Case:
    plant = LinearPlant.random(np.random.default_rng(seed), order, inputs + disturbances, outputs)
    return Case(plant.advance, plant.c, inputs, disturbances, 0.6)


def pushed_pendulum(state: FloatArray, torques: FloatArray) -> FloatArray:
    return quick_pendulum(state, torques[:1] + 0.5 * torques[1:])


PLANTS = {
    "one input": linear(1, 2, 1, 1, 1),
    "two inputs, two outputs": linear(2, 3, 2, 2, 2),
    "pendulum": Case(pushed_pendulum, np.array([[1.0, 0.0]]), 1, 1, 2.0),
}
NOMINAL = {"u": 2.0, "y": 0.5, "d": 4.0, "power": 3.0}


def power(u: FloatArray, y: FloatArray) -> float:
    """What the plant takes, of the inputs held until now."""
    return float(0.7 * u.sum() + 0.2 * y.sum())


def make(case: Case, samples: int, seed: int = 0) -> Loop:
    """Record a plant under random inputs and disturbances; return a loop with all there is."""
    rng = np.random.default_rng(seed)
    m, n_d, p = case.inputs, case.disturbances, len(case.output)
    u = case.limit * rng.uniform(-1.0, 1.0, (samples, m))
    d = rng.uniform(-0.5, 1.0, (samples, n_d))
    state = np.zeros(case.output.shape[1])
    y, measured = np.zeros((samples, p)), np.zeros((samples, len(state) + 1))
    for k in range(samples):
        y[k] = case.output @ state
        last = u[k - 1] if k else np.zeros(m)
        measured[k] = [*state, power(last, y[k])]
        state = case.advance(state, np.concatenate([u[k], d[k]]))
    # Noise, so that the data have full rank and every direction of g counts.
    y += 1e-2 * rng.standard_normal(y.shape)
    measured += 1e-2 * rng.standard_normal(measured.shape)

    def variables(name: str, count: int, nominal: float) -> tuple[Variable, ...]:
        return tuple(Variable(f"{name}{i}", nominal=nominal) for i in range(count))

    outputs = variables("y", p, NOMINAL["y"])
    states = tuple(Variable(f"x{i}") for i in range(measured.shape[1] - 1))
    loop = Loop(
        sampling_time=SAMPLING_TIME,
        inputs=variables("u", m, NOMINAL["u"]),
        outputs=outputs,
        measurements=(*states, Variable("power", nominal=NOMINAL["power"])),
        bounds=Bounds(
            *(sign * np.full(m, case.limit) for sign in (-1, 1)), np.full(p, -np.inf), np.full(p, 9.0)
        ),
        recording=Recording(u, y, measured, SAMPLING_TIME, d=d),
        rng=np.random.default_rng(0),
        preview=50,
        disturbances=variables("d", n_d, NOMINAL["d"]),
        bands=("y0",),
        moving_limits=("u0", "y0"),
        charges=(
            Charge("heat", "u0", 0.8, "EUR", True),
            Charge("electricity", "power", 1.5, "EUR", True),
        ),
    )
    return loop


def sample_of(
    loop: Loop, k: int, y: FloatArray, measured: FloatArray, d: FloatArray, n: int, rng: np.random.Generator
) -> Sample:
    """Return a sample whose future is random."""
    m, p, n_d = len(loop.inputs), len(y), len(d)
    lower = rng.uniform(-0.4, 0.2, (n + 1, p))
    width = np.where(rng.random((n + 1, p)) < 0.3, 0.0, rng.uniform(0.0, 0.3, (n + 1, p)))
    reference = rng.uniform(-0.4, 0.4, (n + 1, p))
    band = np.stack([lower, lower + width], axis=-1)
    band[:, 1:] = reference[:, 1:, np.newaxis]
    reference[:, 0] = np.clip(y[0], *band[:, 0].T)
    u_limits = np.empty((n + 1, m, 2))
    u_limits[:] = np.stack([loop.bounds.u_min, loop.bounds.u_max], axis=-1)
    u_limits[:, 0] *= rng.uniform(0.3, 1.0, (n + 1, 1))
    y_limits = np.empty((n, p, 2))
    y_limits[:] = np.stack([loop.bounds.y_min, loop.bounds.y_max], axis=-1)
    y_limits[:, 0, 1] = rng.uniform(1.0, 9.0, n)
    return Sample(
        k,
        k * loop.sampling_time,
        y,
        measured,
        reference[1:],
        reference[0],
        disturbance=d,
        forecast=rng.uniform(-0.5, 1.0, (n, n_d)),
        band_now=band[0],
        band=band[1:],
        price=rng.uniform(-0.5, 2.0, (n + 1, len(loop.charges))),
        input_limits=u_limits,
        output_limits=y_limits,
    )


def worst_difference(
    case: Case, method: Method, samples: int = 90, steps: int = 12
) -> tuple[float, float, int]:
    """Return how far u and cost are from the whole problem's, and how often bounds are active."""
    loop = make(case, samples)
    method.start(loop)
    n, rng = method.horizon, np.random.default_rng(7)
    state = np.zeros(case.output.shape[1])
    u = np.zeros(case.inputs)
    rows: list[tuple[FloatArray, ...]] = []
    worst_u = worst_cost = 0.0
    active = 0
    for k in range(steps):
        y = case.output @ state
        measured = np.array([*state, power(u, y)])
        sample = sample_of(loop, k, y, measured, rng.uniform(-0.5, 1.0, case.disturbances), n, rng)
        if not rows:
            rows = [(u, y, sample.disturbance, measured)] * 20
        whole = of_whole_problem(method, loop, rows, sample)
        answer = method.step(sample)
        assert isinstance(answer, Action)
        assert answer.status == "ok"
        u = answer.u
        worst_u = max(worst_u, float(np.abs(u - whole.u[0] * NOMINAL["u"]).max()))
        if "cost" in answer.info:
            worst_cost = max(worst_cost, abs(answer.info["cost"] - whole.cost) / (1.0 + abs(whole.cost)))
        active += whole.active > 0
        rows.append((u, y, sample.disturbance, measured))
        state = case.advance(state, np.concatenate([u, sample.disturbance]))
    return worst_u, worst_cost, active


def of_whole_problem(
    method: Method, loop: Loop, rows: list[tuple[FloatArray, ...]], sample: Sample
) -> Answer:
    """Return the optimum of the whole problem, in scaled signals."""
    recording = loop.recording
    assert recording is not None
    n, past, m = method.horizon, method.initial_length, len(loop.inputs)
    p = len(loop.outputs) + 1
    unit = np.array([NOMINAL["y"]] * (p - 1) + [NOMINAL["power"]])
    current = getattr(method, "use_current_output", False)
    u, y, d, measured = (np.array([row[i] for row in rows]) for i in range(4))
    y = np.hstack([y, measured[:, -1:]])
    if current:
        y = np.vstack([y, [*sample.y, sample.measured[-1]]])
    limits, band = np.full((n, p, 2), [-np.inf, np.inf]), np.zeros((n, p, 2))
    if current:
        limits[:, :-1], band[:, :-1] = sample.output_limits, sample.band
    else:
        limits[:, :-1] = np.vstack([sample.output_limits[:1], sample.output_limits[:-1]])
        band[:, :-1] = np.vstack([sample.band_now[np.newaxis], sample.band[:-1]])
    money = method.price_weight * loop.sampling_time
    u_price, y_price = np.zeros((n, m)), np.zeros((n, p))
    u_price[:, 0] = money * 0.8 * NOMINAL["u"] * sample.price[:n, 0]
    y_price[:, -1] = money * 1.5 * NOMINAL["power"] * sample.price[current : n + current, 1]
    future = sample.forecast[: n - 1] if method.use_forecast else np.tile(sample.disturbance, (n - 1, 1))
    recorded = {
        "u": recording.u / NOMINAL["u"],
        "y": np.hstack([recording.y, recording.measured[:, -1:]]) / unit,
        "d": recording.d / NOMINAL["d"],
    }
    z_ini = None
    if isinstance(method, WKPC):
        scale = np.array([1.0] * (measured.shape[1] - 1) + [NOMINAL["power"]])
        recorded["z"] = method._lift(recording.measured / scale)
        z_ini = method._lift(measured[-past:] / scale)
    end = sample.input_limits[n - 1] / NOMINAL["u"]
    middle, half = end.mean(axis=1), (end[:, 1] - end[:, 0]) / 2 * method.setpoint_margin
    ahead = Ahead(
        u[-past:] / NOMINAL["u"],
        y[-past - current :] / unit,
        np.hstack([sample.reference, np.zeros((n, 1))]) / unit,
        np.vstack([d[-past:], sample.disturbance, future]) / NOMINAL["d"],
        band / unit[:, np.newaxis],
        sample.input_limits[:n] / NOMINAL["u"],
        limits / unit[:, np.newaxis],
        u_price,
        y_price,
        np.zeros(m),
        np.full(m, rates if np.size(rates := getattr(method, "rate_bounds", ())) else np.inf) / NOMINAL["u"],
        z_ini,
    )
    return solve(method, recorded, [0], ahead, np.stack([middle - half, middle + half], axis=1))


WELL_POSED: dict[str, Any] = {"horizon": 4, "initial_length": 2, "input_weight": 0.5, "output_weight": 5.0}
METHODS: dict[str, Callable[[], Method]] = {
    "ridge": lambda: DeePC(**WELL_POSED, regulariser="ridge", lambda_g=2.0, lambda_sigma=1e4),
    "equilibrium": lambda: DeePC(**WELL_POSED, regulariser="equilibrium", lambda_g=2.0, lambda_sigma=1e4),
    "projection": lambda: DeePC(**WELL_POSED, lambda_g=20.0, lambda_sigma=1e4),
    "regulation": lambda: DeePC(**WELL_POSED, artificial_setpoint=False, slack=False, price_weight=0.3),
    "spc": lambda: SPC(**WELL_POSED, use_forecast=False, rate_bounds=0.8),
    "gamma-ddpc": lambda: GammaDDPC(**WELL_POSED, beta_2=0.3, artificial_setpoint=False),
    "l1": lambda: DeePC(**WELL_POSED, regulariser="l1", lambda_g=0.5, lambda_sigma=1e4),
    "wkpc": lambda: WKPC(**WELL_POSED),
}


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("method", METHODS)
def test_the_optimum_with_all_that_is_known_is_that_of_the_whole_problem(plant: str, method: str) -> None:
    worst_u, worst_cost, active = worst_difference(PLANTS[plant], METHODS[method](), 160)
    assert worst_u <= 1e-8
    assert worst_cost <= 1e-8
    assert active > 5


@pytest.mark.parametrize("method", ["projection", "regulation"])
@pytest.mark.parametrize("lambda_sigma", [1e2, 1e6])
def test_data_that_follow_the_plant_know_the_same(method: str, lambda_sigma: float) -> None:
    """Until a first window is complete these are the recorded ones."""
    controller = replace(
        METHODS[method](), online_data="sliding-window", slack=True, lambda_sigma=lambda_sigma
    )
    worst_u, worst_cost, active = worst_difference(
        PLANTS["two inputs, two outputs"], controller, 160, steps=5
    )
    assert worst_u <= 1e-8
    assert worst_cost <= 1e-8
    assert active > 2


def started(method: Method, loop: Loop) -> Method:
    method.start(loop)
    return method


def plain_sample(loop: Loop, method: Method, **more: Any) -> Sample:
    """Return a sample at rest in the origin, with what is given."""
    p, n = len(loop.outputs), method.horizon
    zeros = np.zeros((n, p))
    return Sample(0, 0.0, np.zeros(p), np.zeros(len(loop.measurements)), zeros, zeros[0])._replace(**more)


NOTHING: dict[str, Any] = {"bands": (), "moving_limits": (), "charges": ()}


def test_a_band_that_is_a_line_is_a_reference() -> None:
    loop = make(PLANTS["two inputs, two outputs"], 160)
    settings: dict[str, Any] = WELL_POSED | {"use_current_output": True, "artificial_setpoint": False}
    d = {"disturbance": np.array([0.2, -0.1]), "forecast": np.full((4, 2), 0.3)}
    follows = started(DeePC(**settings), replace(loop, **NOTHING))
    reference = np.array([[0.3, -0.2]]) * np.arange(1, 5)[:, np.newaxis] / 4.0
    expected = follows.step(plain_sample(loop, follows, reference=reference, **d))
    in_band = started(DeePC(**settings), replace(loop, **{**NOTHING, "bands": ("y0", "y1")}))
    band = np.stack([reference, reference], axis=-1)
    answer = in_band.step(plain_sample(loop, in_band, band=band, band_now=band[0], **d))
    assert isinstance(answer, Action)
    assert isinstance(expected, Action)
    assert answer.u == pytest.approx(expected.u, rel=1e-9)
    assert answer.info["cost"] == pytest.approx(expected.info["cost"], rel=1e-9)


def test_a_forecast_is_used_unless_it_is_switched_off() -> None:
    loop = replace(make(PLANTS["one input"], 160), **NOTHING)

    def u(method: Method, later: float) -> FloatArray:
        started(method, loop)
        sample = plain_sample(loop, method, disturbance=np.zeros(1), forecast=np.full((4, 1), later))
        answer = method.step(sample)
        assert isinstance(answer, Action)
        return answer.u

    for make_method in (DeePC, SPC, GammaDDPC, WKPC):
        settings = WELL_POSED if make_method is WKPC else WELL_POSED | {"artificial_setpoint": False}
        assert not np.allclose(u(make_method(**settings), 0.0), u(make_method(**settings), 1.0), atol=1e-3)
        held = {**settings, "use_forecast": False}
        assert np.array_equal(u(make_method(**held), 0.0), u(make_method(**held), 1.0))


@pytest.mark.parametrize("method", [DeePC, SPC, MPC])
def test_a_forecast_whose_rows_are_shuffled_is_worse(method: type[Controller]) -> None:
    """By the mean absolute error over ten seeds, in the exact one-sided test of flipped signs."""
    case, lost, n = PLANTS["one input"], list[float](), 8
    loop = replace(make(case, 160), **NOTHING)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        d = np.repeat(rng.uniform(-0.5, 0.5, (12, 1)), 8, axis=0)
        errors = []
        for shuffled in (True, False):
            controller = method(horizon=n, input_weight=1e-3, use_forecast=True)
            controller.start(loop)
            state, total = np.zeros(case.output.shape[1]), 0.0
            for k in range(80):
                y, ahead = case.output @ state, d[k + 1 : k + 1 + n]
                shown = rng.permutation(ahead) if shuffled else ahead
                none = np.zeros((n, 1))
                sample = Sample(k, k * SAMPLING_TIME, y, np.append(state, 0.0), none, none[0], d[k], shown)
                answer = controller.step(sample)
                u = answer.u if isinstance(answer, Action) else answer
                state, total = case.advance(state, np.concatenate([u, d[k]])), total + float(np.abs(y).sum())
            errors.append(total / 80)
        lost.append(errors[0] - errors[1])
    flipped = [np.dot(signs, lost) for signs in product((-1.0, 1.0), repeat=10)]
    assert np.mean(np.array(flipped) >= sum(lost) - 1e-12) <= 0.01


IDENTIFYING: dict[str, Callable[..., Controller]] = {
    "equilibrium": partial(DeePC, **WELL_POSED, regulariser="equilibrium", lambda_g=2.0),
    "gamma-ddpc": partial(GammaDDPC, **WELL_POSED),
    "koopman-mpc": partial(KoopmanMPC, horizon=4),
    "mpc": partial(MPC, horizon=4),
    "spc": partial(SPC, **WELL_POSED, use_current_output=True),
    "wkpc": partial(WKPC, **WELL_POSED),
}


@pytest.mark.parametrize("method", IDENTIFYING)
def test_without_forecasts_disturbances_go_on_as_they_did_in_the_recording(method: str) -> None:
    """As with a forecast d_k+i = m + r^i (d_k - m); r from pairs of rows on the same side of a seam."""
    loop = replace(make(PLANTS["two inputs, two outputs"], 160), **NOTHING)
    recording, rng = loop.recording, np.random.default_rng(3)
    assert recording is not None
    d = rng.standard_normal((160, 2)) + np.array([20.0, -1.0])
    for row in range(1, 160):
        d[row, 0] += 0.8 * (d[row - 1, 0] - 20.0)
    d[70:, 0] += 4.0
    loop = replace(loop, recording=replace(recording, d=d, seams=(70,)))
    mean, ratios = d.mean(axis=0), []
    for column, middle in zip(d.T, mean, strict=True):
        pairs = [(column[t] - middle) * (column[t + 1] - middle) for t in range(159) if t != 69]
        ratios.append(sum(pairs) / sum((value - middle) ** 2 for value in column))
    identified = IDENTIFYING[method](use_forecast="identified")
    given = IDENTIFYING[method]()
    identified.start(loop)
    given.start(loop)
    for k in range(3):
        y, now = 0.1 * rng.standard_normal(2), np.array([25.0, 0.5]) + rng.standard_normal(2)
        forecast = np.array([mean + np.array(ratios) ** i * (now - mean) for i in range(1, 5)])
        sample = Sample(k, k * SAMPLING_TIME, y, np.append(y, [0.0] * 2), np.zeros((4, 2)), np.zeros(2), now)
        answers = [
            controller.step(sample._replace(forecast=ahead))
            for controller, ahead in ((given, forecast), (identified, rng.standard_normal((4, 2))))
        ]
        expected, actual = (np.asarray(getattr(answer, "u", answer)) for answer in answers)
        assert actual == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("recorded", [True, False])
def test_how_disturbances_go_on_is_identified_from_a_recording_of_them(recorded: bool) -> None:
    loop = make(PLANTS["one input"], 160)
    recording = loop.recording
    assert recording is not None
    model = StateSpace(a=[[0.9]], b=[[1.0, 1.0]], c=[[1.0]], sampling_time=SAMPLING_TIME)
    controller = MPC(model=model, use_forecast="identified", horizon=4)
    without = replace(recording, d=np.empty((len(recording), 0)))
    with pytest.raises(
        ConfigError, match='use_forecast = "identified" needs a recording of the disturbances'
    ):
        controller.start(replace(loop, **NOTHING, recording=without if recorded else None))


@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC, WKPC])
def test_a_loop_that_takes_over_starts_from_its_past(method: type[Method]) -> None:
    """As a loop that continues its recording does, where that ends with the same samples."""
    loop = replace(make(PLANTS["two inputs, two outputs"], 160), **NOTHING)
    recording = loop.recording
    assert recording is not None
    tail = Recording(
        *(table[-20:] for table in (recording.u, recording.y, recording.measured)),
        SAMPLING_TIME,
        d=recording.d[-20:],
    )
    settings: dict[str, Any] = {"horizon": 4, "initial_length": 3}
    d = {"disturbance": np.array([0.2, -0.1]), "forecast": np.full((4, 2), 0.3)}
    answers = []
    for changes in (
        {"continues_recording": True},
        {"past": tail},
        {"past": tail, "continues_recording": True},
    ):
        controller = started(method(**settings), replace(loop, **changes))
        answer = controller.step(plain_sample(loop, controller, **d))
        assert isinstance(answer, Action)
        answers.append(answer.u)
    assert np.array_equal(answers[0], answers[2])
    assert answers[1] == pytest.approx(answers[0], rel=1e-12)


@pytest.mark.parametrize("method", [DeePC, SPC, WKPC])
@pytest.mark.parametrize("length", [0, 1])
def test_a_past_that_is_too_short_is_that_of_a_plant_at_rest(method: type[Method], length: int) -> None:
    loop = replace(make(PLANTS["one input"], 160), **NOTHING)
    q = len(loop.measurements)
    past = Recording(
        np.zeros((length, 1)),
        np.zeros((length, 1)),
        np.zeros((length, q)),
        SAMPLING_TIME,
        d=np.zeros((length, 1)),
    )
    d = {"disturbance": np.zeros(1), "forecast": np.zeros((4, 1)), "reference": np.full((4, 1), 0.2)}
    answers = []
    for changes in ({}, {"past": past}):
        controller = started(method(horizon=4), replace(loop, **changes))
        answers.append(controller.step(plain_sample(loop, controller, **d)))
    assert answers[0].u == pytest.approx(answers[1].u, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC, WKPC])
def test_a_disturbance_that_never_moved_is_left_out_and_said(method: type[Method]) -> None:
    loop = replace(make(PLANTS["two inputs, two outputs"], 160), **NOTHING)
    recording = loop.recording
    assert recording is not None
    still = recording.d.copy()
    still[:, 0] = 7.0
    still_loop = replace(loop, recording=replace(recording, d=still))
    without = replace(loop, recording=replace(recording, d=still[:, 1:]), disturbances=loop.disturbances[1:])
    d, later = np.array([1.0, 0.3]), np.tile([1.0, 0.4], (4, 1))
    controller = started(method(horizon=4), still_loop)
    said = [
        text
        for text in controller.warnings()
        if text.startswith("d0 never moved in the recording (it was 7)")
    ]
    assert len(said) == 1
    assert controller.knowledge(still_loop)["forecast"] == "d1"
    answer = controller.step(plain_sample(loop, controller, disturbance=d, forecast=later))
    other = started(method(horizon=4), without)
    expected = other.step(plain_sample(loop, other, disturbance=d[1:], forecast=later[:, 1:]))
    assert np.array_equal(answer.u, expected.u)


def test_a_method_says_which_forecasts_and_prices_it_uses() -> None:
    loop = make(PLANTS["two inputs, two outputs"], 160)
    facts = started(DeePC(**WELL_POSED), loop).knowledge(loop)
    assert facts["forecast"] == "d0, d1"
    assert facts["prices"] == "heat, electricity"
    assert facts["measures"] == "y0, y1, power"
    facts = started(SPC(**WELL_POSED, use_forecast=False, price_weight=0.0), loop).knowledge(loop)
    assert facts == {"measures": "y0, y1", "plant": "nothing", "forecast": "measured only"}
    bare = replace(loop, **NOTHING, disturbances=(), recording=replace(loop.recording, d=np.empty((160, 0))))
    assert started(WKPC(), bare).knowledge(bare).keys() == {"measures", "plant"}


@pytest.mark.parametrize("method", [DeePC, WKPC])
def test_disturbances_have_to_excite_too(method: type[Method]) -> None:
    loop = replace(make(PLANTS["one input"], 160), **NOTHING)
    wave = np.sin(0.3 * np.arange(160.0))[:, np.newaxis]
    smooth = replace(loop, recording=replace(loop.recording, d=wave))
    with pytest.raises(DataError, match="input and disturbances together are persistently exciting of order"):
        method(horizon=4).start(smooth)
    with pytest.raises(DataError, match="2 known disturbance\\(s\\), the loop has 1 \\(d0\\)"):
        method(horizon=4).start(replace(loop, recording=replace(loop.recording, d=np.hstack([wave, wave]))))


LEARNING: dict[str, tuple[Controller, Callable[[int, int], int]]] = {
    "DeePC": (DeePC(horizon=4, initial_length=3), lambda m, p: (m + 1) * (3 + 4 + 3 * p) - 1),
    "SPC": (SPC(horizon=2, initial_length=2, assumed_order=3), lambda m, p: (m + 1) * (2 + 2 + 3) - 1),
    "WKPC": (WKPC(horizon=2, initial_length=3, dictionary=Identity()), lambda m, p: (m + 1) * 8 - 1),
    "Koopman MPC": (KoopmanMPC(state="measured", dictionary=Identity()), lambda m, p: 3 + m + 1),
    "MPC": (MPC(model=Identified(lags=2)), lambda m, p: 2 + 2 * (m + p) + 1),
}  # fmt: skip


@pytest.mark.parametrize("name", LEARNING)
def test_a_recording_excites_disturbances_as_it_does_inputs(name: str) -> None:
    """Together (m + n_d + 1) order - 1 samples; for models, as many equations as unknowns."""
    controller, formula = LEARNING[name]
    assert [controller.recording_length(m, 2, 3) for m in (1, 2)] == [formula(m, 2) for m in (1, 2)]
    again = 2 if name == "Koopman MPC" else 0  # d at the next sample is an unknown too
    assert controller.recording_length(2, 1, 3, 2) == formula(4, 1) + again


@pytest.mark.parametrize(
    "make_controller",
    [
        lambda: DeePC(horizon=3, initial_length=2),
        lambda: WKPC(horizon=2, initial_length=2, dictionary=Identity()),
        lambda: KoopmanMPC(state="delays", delays=2, dictionary=Identity()),
        lambda: KoopmanMPC(state="measured", dictionary=Identity()),
    ],
)
def test_what_it_asks_for_with_disturbances_is_the_shortest_it_starts_with(
    make_controller: Callable[[], Controller],
) -> None:
    loop = replace(make(PLANTS["two inputs, two outputs"], 160), **NOTHING)
    needed = make_controller().recording_length(2, 2, len(loop.measurements), 2)
    whole = loop.recording
    assert whole is not None
    long, short = (
        replace(loop, recording=Recording(
            whole.u[:n], whole.y[:n], whole.measured[:n], SAMPLING_TIME, d=whole.d[:n]
        ))
        for n in (needed, needed - 1)
    )  # fmt: skip
    make_controller().start(long)
    with pytest.raises(DataError, match="record longer"):
        make_controller().start(short)


def test_a_recording_too_short_for_its_disturbances_says_so() -> None:
    loop = replace(make(PLANTS["one input"], 160), **NOTHING)
    controller = DeePC(horizon=4)
    enough = controller.recording_length(1, 1, 1)
    recording = loop.recording
    assert recording is not None
    short = Recording(
        *(table[:enough] for table in (recording.u, recording.y, recording.measured)),
        SAMPLING_TIME,
        d=recording.d[:enough],
    )
    with pytest.raises(DataError, match="with 1 input\\(s\\) and 1 known disturbance\\(s\\) takes at least"):
        controller.start(replace(loop, recording=short))


@pytest.mark.parametrize("artificial_setpoint", [True, False])
def test_a_price_without_anything_that_weighs_inputs_is_refused(artificial_setpoint: bool) -> None:
    loop = make(PLANTS["one input"], 160)
    controller = SPC(horizon=4, input_weight=0.0, artificial_setpoint=artificial_setpoint)
    with pytest.raises(ConfigError, match="make input_weight positive"):
        controller.start(loop)


def test_a_dear_input_is_used_less_and_later() -> None:
    loop = replace(
        make(PLANTS["one input"], 160), moving_limits=(), charges=make(PLANTS["one input"], 160).charges[:1]
    )
    d = {"disturbance": np.zeros(1), "forecast": np.zeros((4, 1))}
    band = np.tile([-5.0, 5.0], (4, 1, 1))

    def u(price: float) -> float:
        controller = started(SPC(**WELL_POSED, artificial_setpoint=False), loop)
        sample = plain_sample(
            loop, controller, band=band, band_now=band[0], price=np.full((5, 1), price), **d
        )
        answer = controller.step(sample)
        assert isinstance(answer, Action)
        return float(answer.u[0])

    # Within the band the optimum is that of price a u + R u^2, of the scaled input.
    scaled = -0.1 * 0.8 * NOMINAL["u"] / (2.0 * WELL_POSED["input_weight"])
    assert u(0.0) == pytest.approx(0.0, abs=1e-12)
    assert u(1.0) == pytest.approx(scaled * NOMINAL["u"], rel=1e-9)


@pytest.mark.parametrize("method", [DeePC, partial(WKPC, dictionary=ThinPlate())])
def test_data_that_follow_the_plant_take_its_disturbances_too(method: Callable[..., Method]) -> None:
    """After a while they are those of a recording that ends later."""
    case = PLANTS["two inputs, two outputs"]
    loop = replace(make(case, 160), **NOTHING, continues_recording=True)
    settings: dict[str, Any] = {"horizon": 4, "initial_length": 2, "input_weight": 0.5}
    follows = method(**settings, online_data="sliding-window", excitation_floor=0.0, dither=0.5)
    follows.start(loop)
    recording = loop.recording
    assert recording is not None
    rng, state = np.random.default_rng(3), np.zeros(case.output.shape[1])
    for _ in range(25):
        u, y, d = recording.u[-1:], (case.output @ state)[np.newaxis], rng.uniform(-0.5, 1.0, (1, 2))
        measured = np.array([[*state, power(u[0], y[0])]])
        known = {"disturbance": d[0], "forecast": np.tile(d, (4, 1)), "measured": measured[0]}
        sample = plain_sample(loop, follows, **known)._replace(y=y[0])
        answer = follows.step(sample)
        assert isinstance(answer, Action)
        later = replace(loop, recording=recording)
        recording = Recording(
            *(
                np.vstack([rows[1:], row])
                for rows, row in (
                    (recording.u, answer.u[np.newaxis]),
                    (recording.y, y),
                    (recording.measured, measured),
                )
            ),
            SAMPLING_TIME,
            d=np.vstack([recording.d[1:], d]),
        )
        state = case.advance(state, np.concatenate([answer.u, d[0]]))
    assert follows.diagnostics()["online_windows_taken"] == 25
    expected = started(method(**settings), later).step(sample)
    assert isinstance(expected, Action)
    assert answer.info["cost"] == pytest.approx(expected.info["cost"], rel=1e-6)


def test_a_band_may_have_one_edge() -> None:
    loop = replace(make(PLANTS["one input"], 160), moving_limits=(), charges=())
    d = {"disturbance": np.zeros(1), "forecast": np.zeros((4, 1))}
    answers = []
    for upper in (np.inf, 50.0):
        controller = started(SPC(**WELL_POSED), loop)
        band = np.tile([0.2, upper], (4, 1, 1))
        answers.append(controller.step(plain_sample(loop, controller, band=band, band_now=band[0], **d)))
    assert answers[0].status == "ok"
    assert answers[0].u == pytest.approx(answers[1].u, rel=1e-9)
    assert not np.allclose(answers[0].u, 0.0, atol=1e-3)


def test_a_limit_that_moves_to_where_nothing_leads_gives_way_and_is_named() -> None:
    loop = make(PLANTS["one input"], 160)
    controller = started(SPC(**WELL_POSED), loop)
    sample = sample_of(loop, 0, np.zeros(1), np.zeros(4), np.zeros(1), 4, np.random.default_rng(0))
    limits = sample.output_limits.copy()
    limits[:, 0, 1] = -5.0
    copied = deepcopy(controller)
    answer = controller.step(sample._replace(output_limits=limits, measured=sample.measured[:3]))
    assert isinstance(answer, Action)
    assert answer.status.startswith("no way to meet")
    assert answer.status.endswith("y at its upper bound: output bounds softened")
    low, high = sample.input_limits[0].T
    assert (low <= answer.u).all()
    assert (answer.u <= high).all()
    again = copied.step(sample._replace(output_limits=limits, measured=sample.measured[:3]))
    assert isinstance(again, Action)
    assert np.array_equal(again.u, answer.u)


@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC, WKPC])
def test_inputs_are_within_the_limits_of_now_exactly(method: type[Method]) -> None:
    loop = replace(make(PLANTS["pendulum"], 160), bands=(), charges=())
    controller = started(method(horizon=4), loop)
    rng = np.random.default_rng(0)
    for k in range(8):
        y, measured = np.zeros(1), np.zeros(3)
        sample = sample_of(loop, k, y, measured, np.zeros(1), 4, rng)._replace(reference=np.full((4, 1), 3.0))
        answer = controller.step(sample)
        assert isinstance(answer, Action)
        assert answer.u == sample.input_limits[0, 0, 1]
