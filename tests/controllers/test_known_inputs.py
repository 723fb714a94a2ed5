"""Known disturbances in the methods on a model: against problems and formulas written by hand."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.signal import cont2discrete

from ddpc_controllers import (
    GPC,
    IPID,
    LQR,
    MFAC,
    MFAPC,
    MPC,
    PID,
    SPSA,
    Cascade,
    Decentralised,
    Group,
    Idle,
    KoopmanMPC,
    OffsetFree,
)
from ddpc_controllers.data.dictionaries import Identity
from ddpc_controllers.models.identification import Identified, fit_arx
from ddpc_controllers.models.linear import StateSpace
from ddpc_cosim import (
    Action,
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
from fmu_plants import PlantModel, building, distillation_column, two_mass_drive
from fmu_plants.linear import linearise

from .loops import SAMPLING_TIME, LinearPlant, close_loop, make_loop

HORIZON = 6


class Plant:
    """x+ = A x + B u + E d, y = C x: of order three, stable, with two disturbances."""

    def __init__(self, seed: int, inputs: int = 1, outputs: int = 1) -> None:
        rng = np.random.default_rng(seed)
        a = rng.standard_normal((3, 3))
        self.a = 0.85 * a / np.abs(np.linalg.eigvals(a)).max()
        self.b, self.c = rng.standard_normal((3, inputs)), rng.standard_normal((outputs, 3))
        self.e = rng.standard_normal((3, 2))

    def record(self, u: FloatArray, d: FloatArray, late: int = 0) -> Recording:
        """Record it from rest; of disturbances what they were so many samples ago is measured."""
        x, rows = np.zeros(3), []
        for applied, acting in zip(u, d, strict=True):
            rows.append(self.c @ x)
            x = self.a @ x + self.b @ applied + self.e @ acting
        y, known = np.array(rows), np.vstack([d[:1], d])[: len(d)] if late else d
        return Recording(u, y, y, SAMPLING_TIME, d=known)

    def model(self) -> StateSpace:
        """The plant itself as a controller's model, the disturbances after the inputs."""
        b = np.hstack([self.b, self.e]).tolist()
        return StateSpace(a=self.a.tolist(), b=b, c=self.c.tolist(), sampling_time=SAMPLING_TIME)

    def forced(self, columns: FloatArray, horizon: int) -> FloatArray:
        """What columns over the horizon add to y_1 ... y_N: shape (N p, N columns)."""
        power, zero = np.linalg.matrix_power, np.zeros((len(self.c), columns.shape[1]))
        rows = [
            [self.c @ power(self.a, k - i) @ columns if i <= k else zero for i in range(horizon)]
            for k in range(horizon)
        ]
        return np.block(rows)

    def free(self, horizon: int) -> FloatArray:
        """What the state does to y_1 ... y_N."""
        return np.vstack([self.c @ np.linalg.matrix_power(self.a, k) for k in range(1, horizon + 1)])


PLANTS = [(Plant(1), 0.6), (Plant(2, 2, 2), 3.0), (Plant(7, 2, 1), 1.0)]


def disturbed_loop(plant: Plant, limit: float, recording: Recording | None = None, **changes: Any) -> Loop:
    m, p = plant.b.shape[1], len(plant.c)
    known = Variable("sun"), Variable("wind")
    return make_loop(recording, np.full(m, limit), np.full(p, np.inf), disturbances=known, **changes)


def course(seed: int, samples: int) -> FloatArray:
    """Two disturbances that wander."""
    steps = np.random.default_rng(seed).standard_normal((samples, 2))
    return np.cumsum(0.2 * steps, axis=0) * 0.9 ** np.arange(2) + 0.5


def excited(plant: Plant, samples: int = 200, late: int = 0) -> Recording:
    rng = np.random.default_rng(3)
    u = rng.uniform(-1.0, 1.0, (samples, plant.b.shape[1]))
    return plant.record(u, 3.0 + course(9, samples), late)


def answer_of(controller: Controller, sample: Sample) -> FloatArray:
    answer = controller.step(sample)
    return answer.u if isinstance(answer, Action) else answer


def sample_at(
    k: int, y: FloatArray, reference: FloatArray, d: FloatArray, horizon: int, shuffled: bool = False
) -> Sample:
    forecast = d[k + 1 : k + 1 + horizon]
    if shuffled:
        forecast = np.random.default_rng(k).permutation(forecast)
    return Sample(
        k, SAMPLING_TIME * k, y, y, reference[k + 1 : k + 1 + horizon], reference[k],
        disturbance=d[k], forecast=forecast,
    )  # fmt: skip


def close(
    controller: Controller, plant: Plant, loop: Loop, d: FloatArray, steps: int, shuffled: bool = False
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Close a loop from rest; return states, inputs and references."""
    p = len(plant.c)
    reference = np.repeat(np.random.default_rng(5).uniform(-1.0, 1.0, (20, p)), 20, axis=0)
    controller.start(loop)
    x, states, inputs = np.zeros(3), [], []
    for k in range(steps):
        u = answer_of(controller, sample_at(k, plant.c @ x, reference, d, controller.horizon, shuffled))
        states.append(x)
        inputs.append(u.copy())
        x = plant.a @ x + plant.b @ u + plant.e @ d[k]
    return np.array(states), np.array(inputs), reference


def make_mpc(**settings: Any) -> MPC:
    weights: dict[str, Any] = {"horizon": HORIZON, "setpoint": "none", "disturbance": "none"}
    return MPC(**weights | {"output_weight": 2.0, "input_weight": 0.05} | settings)


@pytest.mark.parametrize(("plant", "limit"), PLANTS)
def test_mpc_finds_the_inputs_of_bounded_least_squares_with_the_disturbances(
    plant: Plant, limit: float
) -> None:
    d = course(4, 150)
    d[0] = 0.0  # at rest
    controller = make_mpc(model=plant.model())
    states, inputs, reference = close(controller, plant, disturbed_loop(plant, limit), d, 100)
    m = plant.b.shape[1]
    forced, pushed = plant.forced(plant.b, HORIZON), plant.forced(plant.e, HORIZON)
    system = np.vstack([np.sqrt(2.0) * forced, np.sqrt(0.05) * np.eye(HORIZON * m)])
    bounded = 0
    for k, (x, u) in enumerate(zip(states, inputs, strict=True)):
        expected = plant.free(HORIZON) @ x + pushed @ d[k : k + HORIZON].ravel()
        wanted = np.sqrt(2.0) * (reference[k + 1 : k + 1 + HORIZON].ravel() - expected)
        target = np.append(wanted, np.zeros(HORIZON * m))
        best = lsq_linear(system, target, (-limit, limit), method="bvls", tol=1e-15, max_iter=500).x[:m]
        assert np.abs(best - u).max() <= 1e-8
        bounded += np.abs(u).max() >= limit
    assert 5 < bounded < 95


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize(("plant", "limit"), PLANTS)
def test_an_identified_model_is_the_plant_with_what_acts_on_it(plant: Plant, limit: float, late: int) -> None:
    model = fit_arx(excited(plant, late=late), 3)
    fresh = plant.record(
        np.random.default_rng(8).uniform(-1.0, 1.0, (60, plant.b.shape[1])), course(2, 60), late
    )
    first = 20
    start = _state_after(model, fresh, first)
    for k in range(first, len(fresh)):
        shown = model.c @ start + model.f @ (fresh.d[k] - model.d_0) + model.y_0
        assert np.abs(shown - fresh.y[k]).max() < 1e-6
        start = model.a @ start + model.b @ (fresh.u[k] - model.u_0) + model.e @ (fresh.d[k] - model.d_0)
    assert (np.abs(model.f).max() > 1e-3) == bool(late)


def _state_after(model: Any, recording: Recording, samples: int) -> FloatArray:
    """The state at a sample by least squares from all outputs before it."""
    n = len(model.a)
    free, forced, rows, target = np.eye(n), np.zeros(n), [], []
    for k in range(samples):
        off_d = recording.d[k] - model.d_0
        rows.append(model.c @ free)
        target.append(recording.y[k] - model.y_0 - model.f @ off_d - model.c @ forced)
        free = model.a @ free
        forced = model.a @ forced + model.b @ (recording.u[k] - model.u_0) + model.e @ off_d
    first = np.linalg.lstsq(np.vstack(rows), np.concatenate(target))[0]
    return np.asarray(free @ first + forced)


@pytest.mark.parametrize(("plant", "limit"), PLANTS)
@pytest.mark.parametrize("horizon", [1, 8])
def test_lqr_feeds_forward_what_the_quadratic_cost_asks_for(plant: Plant, limit: float, horizon: int) -> None:
    m, p, long = plant.b.shape[1], len(plant.c), 1500
    controller = LQR(model=plant.model(), horizon=horizon, input_weight=0.3, integral_weight=0.5)
    controller.start(disturbed_loop(plant, np.inf))
    d = course(6, horizon + 1)
    whole = np.vstack([d, np.repeat(d[-1:], long - len(d), axis=0)])
    answer = controller._without_sums(d[0], d[1:])

    # Against the finite problem with the disturbance's future, solved backwards from far away.
    a = np.block([[plant.a, np.zeros((3, p))], [plant.c, np.eye(p)]])
    b, e = np.vstack([plant.b, np.zeros((p, m))]), np.vstack([plant.e, np.zeros((p, 2))])
    q, r = np.zeros((3 + p, 3 + p)), 0.3 * np.eye(m)
    q[:3, :3], q[3:, 3:] = plant.c.T @ plant.c, 0.5 * np.eye(p)
    value, slope, gain = q.copy(), np.zeros(3 + p), np.zeros(m)
    for acting in whole[::-1]:
        curvature = r + b.T @ value @ b
        gain = -np.linalg.solve(curvature, b.T @ (value @ e @ acting + slope))
        feedback = np.linalg.solve(curvature, b.T @ value @ a)
        slope = (a - b @ feedback).T @ (value @ e @ acting + slope)
        value = q + a.T @ value @ (a - b @ feedback)
    assert np.abs(answer - gain).max() <= 1e-8


def test_a_forecast_out_of_order_gives_other_inputs() -> None:
    plant, limit = PLANTS[0]
    d, loop = course(4, 150), disturbed_loop(plant, limit)
    for controller in (make_mpc(model=plant.model()), LQR(model=plant.model(), horizon=5)):
        _, inputs, _ = close(controller, plant, loop, d, 60)
        _, others, _ = close(controller, plant, loop, d, 60, shuffled=True)
        assert np.abs(inputs - others).max() > 1e-3


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize(("plant", "limit"), PLANTS)
def test_a_lifted_model_without_observables_is_the_plant(plant: Plant, limit: float, late: int) -> None:
    recording = excited(plant, late=late)
    settings: dict[str, Any] = {"dictionary": Identity(), "delays": 3, "ridge": 0.0, "scaling": "none"}
    koopman = KoopmanMPC(**settings, disturbance_gain=0.5)
    koopman.start(disturbed_loop(plant, limit, recording))
    fresh = plant.record(0.3 * recording.u[::-1], 0.5 + course(2, len(recording)), late)
    # Followed along another run, it finds nothing that it did not expect.
    koopman._take_over(fresh)
    constant = koopman._model.constant
    assert np.abs(koopman._disturbance - constant).max() < 1e-6


def test_the_lifted_model_decides_as_the_identified_one_does() -> None:
    plant, limit = PLANTS[0]
    recording, d = excited(plant), course(4, 150)
    loop = disturbed_loop(plant, limit, recording)
    weights: dict[str, Any] = {"horizon": HORIZON, "setpoint": "none", "output_weight": 2.0}
    koopman = KoopmanMPC(dictionary=Identity(), delays=3, ridge=0.0, disturbance_gain=0.0, **weights)
    mpc = make_mpc(model=Identified(lags=3), input_weight=0.1)
    _, ours, _ = close(koopman, plant, loop, d, 100)
    _, theirs, _ = close(mpc, plant, loop, d, 100)
    assert np.abs(ours - theirs)[60:].max() <= 1e-8
    assert (np.abs(ours) == limit).any()


@pytest.mark.parametrize("controller", [make_mpc(), LQR(), KoopmanMPC(dictionary=Identity())])
def test_a_disturbance_that_never_moved_is_told_and_counts_for_nothing(controller: Controller) -> None:
    plant, limit = PLANTS[0]
    recording = plant.record(
        np.random.default_rng(3).uniform(-1.0, 1.0, (200, 1)), course(9, 200) * np.array([0.0, 1.0]) + 280.0
    )
    controller.start(disturbed_loop(plant, limit, recording))
    assert any("sun never moved in the recording" in text for text in controller.warnings())
    assert not any("wind never moved" in text for text in controller.warnings())
    assert isinstance(controller, MPC | LQR | KoopmanMPC)
    acts = controller._model.e
    assert np.abs(acts[:, -1]).max() > 1e-9 >= np.abs(acts[:, :-1]).max(initial=0.0)


def test_a_recording_without_the_disturbances_is_refused() -> None:
    plant, limit = PLANTS[0]
    bare = replace(excited(plant), d=np.empty((200, 0)))
    with pytest.raises(DataError, match=r"the recording has 0 known disturbance.*sun, wind"):
        make_mpc().start(disturbed_loop(plant, limit, bare))


def test_a_model_without_columns_for_disturbances_says_so() -> None:
    plant, limit = PLANTS[0]
    model = StateSpace(
        a=plant.a.tolist(), b=plant.b.tolist(), c=plant.c.tolist(), sampling_time=SAMPLING_TIME
    )
    controller = make_mpc(model=model)
    controller.start(disturbed_loop(plant, limit))
    assert any("does not say what sun, wind does" in text for text in controller.warnings())
    wide = replace(model, b=np.hstack([plant.b, plant.e, plant.e]).tolist())
    with pytest.raises(ConfigError, match=r"or \(1, 3\) with its known disturbances"):
        make_mpc(model=wide).start(disturbed_loop(plant, limit))


Make = Callable[[], Controller]
TAKING_OVER: list[Make] = [
    lambda: make_mpc(),
    lambda: MPC(disturbance="output", horizon=HORIZON),
    lambda: LQR(input_weight=1.0),
    lambda: PID(proportional=0.2, integral=0.1, derivative=0.02, filter_time=0.05, setpoint_share=0.7),
    lambda: KoopmanMPC(dictionary=Identity(), delays=3),
]


@pytest.mark.parametrize("make", TAKING_OVER)
def test_switched_on_where_it_runs_already_it_changes_nothing(make: Make) -> None:
    plant, limit = PLANTS[0]
    loop, d = disturbed_loop(plant, limit, excited(plant)), course(4, 420)
    controller, steps, switched = make(), 300, 200
    states, inputs, reference = close(controller, plant, loop, d, steps)
    y = states @ plant.c.T
    past = Recording(inputs[:switched], y[:switched], y[:switched], SAMPLING_TIME, d=d[:switched])
    other = make()
    other.start(replace(loop, past=past))
    for k in range(switched, steps):
        u = answer_of(other, sample_at(k, y[k], reference, d, other.horizon))
        assert np.abs(u - inputs[k]).max() < 1e-9


def slow_plant() -> Plant:
    """One input whose effect the disturbance's lags behind."""
    plant = Plant(1)
    plant.a, plant.b = np.diag([0.9, 0.97, 0.8]), np.array([[0.1], [0.0], [0.0]])
    plant.e, plant.c = np.array([[0.0, 0.05], [0.03, 0.0], [0.0, 0.1]]), np.array([[1.0, 1.0, 0.5]])
    return plant


def test_pid_without_limits_is_its_formula_plus_what_it_feeds_forward() -> None:
    plant = slow_plant()
    loop, d = disturbed_loop(plant, np.inf, excited(plant, 400)), course(4, 150)
    gains: dict[str, Any] = {"proportional": 2.0, "integral": 3.0, "derivative": 0.1, "filter_time": 0.2}
    controller = PID(**gains, feedforward=True)
    states, inputs, reference = close(controller, plant, loop, d, 120)
    bare = PID(**gains)
    bare.start(loop)
    assert controller._forward is not None
    amounts = controller._forward.gains[0]
    added = np.zeros(120)
    for j, samples in enumerate((0.0, 3.0, 10.0, 30.0, 100.0)):
        pole = np.exp(-1.0 / samples) if samples else 0.0
        for i in range(2):
            lagged = 0.0
            for k in range(120):
                lagged = pole * lagged + (1.0 - pole) * (d[k, i] - d[0, i])
                added[k] += amounts[j, i] * lagged
    for k, (x, u) in enumerate(zip(states, inputs, strict=True)):
        expected = answer_of(bare, sample_at(k, plant.c @ x, reference, d, 1)) + added[k]
        assert np.abs(u - expected).max() <= 1e-8


def test_what_pid_feeds_forward_is_what_the_closed_loop_wants() -> None:
    """Less than half of what disturbs this plant is left."""
    plant = slow_plant()
    recording = excited(plant, 400)
    loop = disturbed_loop(plant, np.inf, recording)

    def left(feedforward: bool, seed: int) -> float:
        d, rest = course(seed, 320), 0.0
        controller = PID(proportional=2.0, integral=3.0, feedforward=feedforward)
        controller.start(loop)
        x = np.linalg.solve(np.eye(3) - plant.a, plant.e @ d[0])
        controller._u = np.zeros(1)
        for k in range(300):
            y = plant.c @ x
            u = answer_of(controller, sample_at(k, y, np.tile(plant.c @ x * 0.0, (320, 1)), d, 1))
            x = plant.a @ x + plant.b @ u + plant.e @ d[k]
            rest += float(np.abs(y).sum()) if k > 100 else 0.0
        return rest

    assert all(left(True, seed) < 0.5 * left(False, seed) for seed in range(3))


def test_pid_needs_a_recording_only_to_feed_forward() -> None:
    assert not PID().uses_recording
    assert PID(feedforward=True).uses_recording
    plant, limit = PLANTS[0]
    loop = disturbed_loop(plant, limit, excited(plant))
    controller = PID(feedforward=True)
    controller.start(loop)
    assert controller.knowledge(loop)["forecast"] == "not used"
    assert "sun" in controller.knowledge(loop)["measures"]
    bare = replace(loop, disturbances=(), recording=None)
    PID(feedforward=True).start(bare)


def test_pid_with_a_gain_that_does_not_stabilise_the_model_feeds_nothing_forward() -> None:
    plant, limit = PLANTS[0]
    controller = PID(proportional=-500.0, feedforward=True)
    controller.start(disturbed_loop(plant, limit, excited(plant)))
    assert any("no disturbance is fed forward" in text for text in controller.warnings())


def test_pid_keeps_limits_that_move_and_does_not_wind_up_at_them() -> None:
    plant, _ = PLANTS[0]
    loop = replace(disturbed_loop(plant, 5.0), moving_limits=("u0",))
    controller, still = PID(proportional=0.1, integral=2.0), PID(proportional=0.1, integral=2.0)
    controller.start(loop)
    still.start(replace(loop, moving_limits=(), bounds=replace(loop.bounds, u_max=np.full(1, 0.25))))

    def asked(k: int, high: float) -> Sample:
        zero, one = np.zeros(1), np.ones((1, 1))
        limits = np.tile([-5.0, high], (2, 1, 1))
        return Sample(k, 0.1 * k, zero, zero, one, one[0], input_limits=limits)

    for k in range(20):
        assert answer_of(controller, asked(k, 0.25)) == answer_of(still, asked(k, 0.25))
    freed = answer_of(controller, asked(20, 5.0))[0]
    assert 0.25 < freed <= 0.25 + 0.1 * 2.0 + 1e-12


class Everything:
    """A loop with all of it: two disturbances, outputs in bands, limits that move, two prices.

    The first input is paid for, and a measurement, which shows all states and is not controlled.
    """

    def __init__(self, plant: Plant, limit: float, seed: int = 5, samples: int = 200) -> None:
        rng = np.random.default_rng(seed)
        self.plant, (self.m, self.p) = plant, (plant.b.shape[1], len(plant.c))
        self.d, self.limit = course(4, samples), limit
        self.d[0] = 0.0
        middle = np.repeat(rng.uniform(-1.0, 1.0, (samples // 20, self.p)), 20, axis=0)
        width = np.repeat(rng.uniform(0.0, 0.4, (samples // 10, self.p)), 10, axis=0)
        width[::3] = 0.0  # a band can be a line
        self.band = np.stack([middle - width, middle + width], axis=-1)
        high = limit * np.repeat(rng.uniform(0.4, 1.0, (samples // 5, self.m)), 5, axis=0)
        self.limits = np.stack([np.full_like(high, -limit), high], axis=-1)
        self.price = np.repeat(rng.uniform(0.0, 3.0, (samples // 8, 2)), 8, axis=0)
        self.power = np.array([[0.5, -0.2, 0.3]])
        self.charges = (Charge("tariff", "u0", 2.0, "EUR", True), Charge("heat", "power", 0.5, "EUR", True))

    def loop(self, recording: Recording | None = None) -> Loop:
        loop = disturbed_loop(self.plant, self.limit, recording)
        names = tuple(v.name for v in loop.outputs)
        moving = {"moving_limits": tuple(v.name for v in loop.inputs), "bands": names}
        measurements = (*loop.outputs, Variable("power"))
        return replace(loop, measurements=measurements, charges=self.charges, **moving)  # type: ignore[arg-type]

    def record(self, samples: int = 200) -> Recording:
        rng, plant = np.random.default_rng(3), self.plant
        u, d, x = rng.uniform(-1.0, 1.0, (samples, self.m)), 3.0 + course(9, samples), np.zeros(3)
        rows = []
        for applied, acting in zip(u, d, strict=True):
            rows.append(np.append(plant.c, self.power, axis=0) @ x)
            x = plant.a @ x + plant.b @ applied + plant.e @ acting
        every = np.array(rows)
        return Recording(u, every[:, : self.p], every, SAMPLING_TIME, d=d)

    def model(self) -> StateSpace:
        whole = self.plant.model()
        return replace(whole, c=np.append(self.plant.c, self.power, axis=0).tolist())

    def sample(self, k: int, x: FloatArray) -> Sample:
        n, y = HORIZON, self.plant.c @ x
        band_now, band = self.band[k], self.band[k + 1 : k + 1 + n]
        return Sample(
            k, SAMPLING_TIME * k, y, np.append(y, self.power @ x),
            np.clip(y, band[..., 0], band[..., 1]), np.clip(y, band_now[:, 0], band_now[:, 1]),
            disturbance=self.d[k], forecast=self.d[k + 1 : k + 1 + n],
            band_now=band_now, band=band, price=self.price[k : k + 1 + n],
            input_limits=self.limits[k : k + 1 + n],
            output_limits=np.tile([-np.inf, np.inf], (n, self.p, 1)),
        )  # fmt: skip

    def best(self, k: int, x: FloatArray, q: float, r: float, weight: float) -> FloatArray:
        """The first inputs of the problem in inputs and, in place of excesses, what is nearest in the band.

        max(0, y - h)^2 + max(0, l - y)^2 is the least of (y - v)^2 over l <= v <= h, and so all of it is
        bounded least squares; what is paid completes the squares of the inputs.
        """
        n, m, p, plant = HORIZON, self.m, self.p, self.plant
        expected = plant.free(n) @ x + plant.forced(plant.e, n) @ self.d[k : k + n].ravel()
        forced = plant.forced(plant.b, n)
        shown = Plant(1)
        shown.a, shown.c = plant.a, self.power
        cost = np.zeros((n, m))
        cost[:, 0] = weight * SAMPLING_TIME * 2.0 * self.price[k : k + n, 0]
        for_power = weight * SAMPLING_TIME * 0.5 * self.price[k + 1 : k + 1 + n, 1]
        slope = cost.ravel() + shown.forced(plant.b, n).T @ for_power
        system = np.block(
            [
                [np.sqrt(q) * forced, -np.sqrt(q) * np.eye(n * p)],
                [np.sqrt(r) * np.eye(n * m), np.zeros((n * m, n * p))],
            ]
        )
        target = np.append(-np.sqrt(q) * expected, -slope / (2.0 * np.sqrt(r)))
        low = np.append(self.limits[k : k + n, :, 0], self.band[k + 1 : k + 1 + n, :, 0])
        high = np.append(self.limits[k : k + n, :, 1], self.band[k + 1 : k + 1 + n, :, 1])
        # A band that is a line leaves its values no room, which the solver does not like.
        fixed = high - low < 1e-12
        x_best = np.where(fixed, low, 0.0)
        rest = target - system @ x_best
        free = lsq_linear(
            system[:, ~fixed], rest, (low[~fixed], high[~fixed]), method="bvls", tol=1e-15, max_iter=500
        )
        x_best[~fixed] = free.x
        return np.asarray(x_best[:m])


@pytest.mark.parametrize(("plant", "limit"), PLANTS)
@pytest.mark.parametrize("kind", ["mpc", "koopman"])
def test_with_bands_prices_and_moving_limits_the_inputs_are_those_of_the_whole_problem(
    plant: Plant, limit: float, kind: str
) -> None:
    everything, weight = Everything(plant, limit), 0.3
    shared: dict[str, Any] = {"price_weight": weight, "scaling": "none"}
    if kind == "mpc":
        controller: Controller = make_mpc(model=everything.model(), **shared)
        loop = everything.loop()
    else:
        shared |= {"horizon": HORIZON, "setpoint": "none", "output_weight": 2.0, "input_weight": 0.05}
        controller = KoopmanMPC(dictionary=Identity(), delays=3, ridge=0.0, disturbance_gain=0.0, **shared)
        loop = everything.loop(everything.record())
    controller.start(loop)
    x, bounded, outside, first = np.zeros(3), 0, 0, 3 if kind == "koopman" else 0
    for k in range(120):
        u = answer_of(controller, everything.sample(k, x))
        if k >= first:
            assert np.abs(u - everything.best(k, x, 2.0, 0.05, weight)).max() <= 1e-8
        low, high = everything.limits[k].T
        bounded += bool((u == low).any() or (u == high).any())
        y = plant.c @ x
        outside += bool(((y < everything.band[k, :, 0]) | (y > everything.band[k, :, 1])).any())
        x = plant.a @ x + plant.b @ u + plant.e @ everything.d[k]
    assert 5 < bounded < 115
    assert outside > 5


class Keeping(Controller):
    """Remembers what it is told, and does nothing."""

    def __init__(self, *, horizon: int = 1) -> None:
        self.horizon, self.samples = horizon, list[Sample]()

    def start(self, loop: Loop) -> None:
        self.loop = loop

    def step(self, sample: Sample) -> FloatArray:
        self.samples.append(sample)
        return np.zeros(len(self.loop.inputs))


def test_a_group_is_told_its_part_of_everything() -> None:
    plant = PLANTS[1][0]
    everything = Everything(plant, 3.0)
    whole = everything.sample(3, np.ones(3))
    loop = replace(everything.loop(everything.record()), past=everything.record(20))
    groups = [
        Group(inputs=[f"u{i}"], outputs=[f"y{1 - i}"], controller=Keeping(horizon=2 + i)) for i in range(2)
    ]
    controller = Decentralised(groups=groups)
    controller.start(loop)
    controller.step(whole)
    for i, inner in enumerate(controller._running):
        kept, n = inner.controller, 2 + i
        assert isinstance(kept, Keeping)
        (seen,) = kept.samples
        assert kept.loop.disturbances == loop.disturbances
        assert (kept.loop.bands, kept.loop.moving_limits) == ((f"y{1 - i}",), (f"u{i}",))
        assert kept.loop.past is not None
        assert loop.past is not None
        assert (kept.loop.past.u == loop.past.u[:, [i]]).all()
        assert (kept.loop.past.y == loop.past.y[:, [1 - i]]).all()
        assert (seen.disturbance == whole.disturbance).all()
        assert (seen.forecast == whole.forecast[:n]).all()
        assert (seen.band_now == whole.band_now[[1 - i]]).all()
        assert (seen.band == whole.band[:n, [1 - i]]).all()
        assert (seen.input_limits == whole.input_limits[: n + 1, [i]]).all()
        assert (seen.output_limits == whole.output_limits[:n, [1 - i]]).all()
        assert (seen.price == whole.price[: n + 1]).all()


def test_a_cascade_tells_bands_outside_and_limits_and_prices_inside() -> None:
    plant = PLANTS[1][0]
    everything = Everything(plant, 3.0)
    whole = everything.sample(4, np.ones(3))
    loop = replace(everything.loop(), past=everything.record(20))
    controller = Cascade(inner=Keeping(horizon=9), outer=Keeping(horizon=3), outer_period=2)
    controller.start(loop)
    controller.step(whole)
    inner, outer = controller._inner.controller, controller._outer.controller
    assert isinstance(inner, Keeping)
    assert isinstance(outer, Keeping)
    assert (inner.loop.bands, inner.loop.moving_limits, inner.loop.charges) == (
        (),
        ("u0", "u1"),
        loop.charges,
    )
    assert (outer.loop.bands, outer.loop.moving_limits, outer.loop.charges) == (loop.bands, (), ())
    assert (inner.loop.past, outer.loop.past) == (loop.past, None)
    (within,), (slow,) = inner.samples, outer.samples
    assert (slow.forecast == whole.forecast[1::2]).all()
    assert (slow.band == whole.band[1::2]).all()
    assert within.forecast.shape == (9, 2)
    assert (within.forecast[6:] == whole.forecast[-1]).all()
    assert within.price.shape == (10, 2)
    assert (within.input_limits[:7] == whole.input_limits).all()
    assert (within.band.size, slow.price.size) == (0, 0)


def test_an_offset_free_controller_moves_the_band_with_the_reference() -> None:
    everything = Everything(*PLANTS[0])
    controller = OffsetFree(controller=Keeping(horizon=HORIZON))
    controller.start(everything.loop())
    for k in range(5):
        controller.step(everything.sample(k, np.ones(3) * k))
    kept = controller._inner.controller
    assert isinstance(kept, Keeping)
    shift = everything.band[4] - kept.samples[-1].band_now
    assert np.abs(shift).max() > 1e-3
    assert np.abs(shift - controller._disturbance[:, np.newaxis]).max() < 1e-12


UNAWARE: list[Make] = [MFAC, MFAPC, IPID, lambda: SPSA(kp=5.0), lambda: PID(proportional=5.0), Idle]


@pytest.mark.parametrize("make", UNAWARE)
def test_who_uses_no_forecast_says_so_and_keeps_limits_that_move(make: Make) -> None:
    plant = PLANTS[0][0]
    loop = replace(disturbed_loop(plant, 5.0), moving_limits=("u0",))
    controller = make()
    controller.start(loop)
    assert controller.knowledge(loop)["forecast"] == "not used"
    assert "forecast" not in controller.knowledge(replace(loop, disturbances=()))
    reference, n = np.full((60, 1), 20.0), controller.horizon
    met = 0
    for k in range(40):
        high = 0.5 if k % 20 < 10 else 1.5
        limits = np.tile([-5.0, high], (n + 1, 1, 1))
        sample = sample_at(k, np.zeros(1), reference, np.zeros((60, 2)), n)._replace(input_limits=limits)
        u = answer_of(controller, sample)
        assert u[0] <= high
        met += u[0] == high
    assert isinstance(controller, Idle) or met > 3


@pytest.mark.parametrize(
    "make",
    [
        MFAC,
        MFAPC,
        lambda: GPC(initial_model="gradient"),
        lambda: IPID(ki=0.5, kp=0.2),
        lambda: IPID(order=2, alpha=30.0, kp=2.0, ki=0.1, kd=2.0),
    ],
)
def test_a_method_without_a_model_goes_on_where_it_ran(make: Make) -> None:
    plant = LinearPlant(np.array([[0.8]]), np.array([[0.3]]), np.eye(1))
    loop, switched = make_loop(None, np.full(1, 5.0), np.full(1, np.inf)), 40
    reference = np.concatenate([np.zeros(3), np.repeat([0.5, -0.3, 0.4, 0.1], 20)])[:, np.newaxis]
    run = close_loop(make(), loop, plant.advance, plant.c, reference, 60)
    past = Recording(run.u[:switched], run.y[:switched], run.y[:switched], SAMPLING_TIME)
    other = make()
    other.start(replace(loop, past=past))
    for k in range(switched, 60):
        sample = run.samples[k]
        assert np.abs(answer_of(other, sample) - run.u[k]).max() < 1e-9


def weather(rng: np.random.Generator, samples: int) -> FloatArray:
    """Outdoor temperature, and a sun with clouds."""
    hours = np.arange(samples) / 4.0
    clouds = np.clip(0.6 + 0.4 * np.repeat(rng.standard_normal(samples // 4 + 1), 4)[:samples], 0.0, 1.0)
    sun = np.maximum(0.0, 320.0 * np.sin(2 * np.pi * (hours / 24 - 0.25))) * clouds
    drift = np.cumsum(0.05 * rng.standard_normal(samples))
    return np.column_stack([4.0 * np.sin(2 * np.pi * (hours / 24 - 0.4)) + drift, sun])


def held_levels(amplitude: float) -> Callable[[np.random.Generator, int], FloatArray]:
    """Levels that last for five samples."""
    return lambda rng, n: amplitude * rng.uniform(-1.0, 1.0, (n // 5 + 1, 1)).repeat(5, axis=0)[:n]


class Case(NamedTuple):
    """A plant about its operating point, how it is recorded, PID's settings, and what is left at most."""

    model: PlantModel
    inputs: int
    outputs: list[int]
    sampling_time: float
    samples: int
    excitation: float
    noise: float
    settings: dict[str, Any]
    course: Callable[[np.random.Generator, int], FloatArray]
    left: float


CASES = {
    "building": Case(
        building.MODEL, 1, [0], 900.0, 288, 2250.0, 0.05,
        {"proportional": 3970.0, "integral": 2.98}, weather, 0.85,
    ),
    "distillation-column": Case(
        distillation_column.MODEL, 2, [0, 1], 120.0, 150, 0.1, 0.01,
        {"tuning": "step-test", "closed_loop_time": 127.0}, held_levels(0.2), 0.5,
    ),
    "two-mass-drive": Case(
        two_mass_drive.MODEL, 1, [0], 0.02, 120, 2.0, 0.05,
        {"tuning": "step-test", "closed_loop_time": 0.16}, held_levels(0.5), 0.7,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_what_pid_feeds_forward_helps_on_plants(name: str) -> None:
    """Recorded with noise while disturbances move; constant reference; four seeds."""
    case = CASES[name]
    linear = linearise(case.model)
    h, m, p = case.sampling_time, case.inputs, len(case.outputs)
    a, b, c, _, _ = cont2discrete((linear.A, linear.B, linear.C[case.outputs], linear.D[case.outputs]), h)

    def respond(x: FloatArray, u: FloatArray, d: FloatArray) -> FloatArray:
        return np.asarray(a @ x + b @ np.append(u, d))

    def recorded(rng: np.random.Generator) -> Recording:
        u = case.excitation * rng.uniform(-1.0, 1.0, (case.samples, m))
        d, x, rows = case.course(rng, case.samples), np.zeros(len(a)), []
        for applied, acting in zip(u, d, strict=True):
            rows.append(c @ x + case.noise * rng.standard_normal(p))
            x = respond(x, applied, acting - d[0])
        return Recording(u, np.array(rows), np.array(rows), h, d=d)

    def error(feedforward: bool, seed: int) -> float:
        rng = np.random.default_rng(seed)
        recording, d = recorded(rng), case.course(rng, case.samples)
        known = tuple(Variable(v.name) for v in case.model.inputs[m:])
        endless = np.full(m, np.inf), np.full(p, np.inf)
        loop = make_loop(recording, *endless, disturbances=known, sampling_time=h)
        controller = PID(**case.settings, feedforward=feedforward)
        controller.start(loop)
        x, errors = np.zeros(len(a)), []
        for k in range(case.samples - 1):
            errors.append(np.abs(c @ x).mean())
            y = c @ x + case.noise * rng.standard_normal(p)
            x = respond(
                x, answer_of(controller, sample_at(k, y, np.zeros((case.samples, p)), d, 1)), d[k] - d[0]
            )
        return float(np.mean(errors[20:]))

    ratios = [error(True, seed) / error(False, seed) for seed in range(4)]
    assert np.median(ratios) < case.left
