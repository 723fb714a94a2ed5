"""Every part of DeePC's problem, switched on and off, against the full problem over all entries of g."""

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import piqp
import pytest
from scipy.optimize import linprog

from ddpc_controllers import DeePC
from ddpc_cosim import Action, Bounds, ConfigError, Controller, FloatArray, Loop, Recording, Sample
from ddpc_cosim.study.controller_plugins import make_controller

from .full_problem import FullDeePC
from .loops import (
    ANGLE,
    DEGREE,
    REGULATION,
    LinearPlant,
    Run,
    before,
    close_loop,
    experiment,
    make_loop,
    paper_reference,
    pendulum_experiment,
    pendulum_loop,
    printed_deepc,
    quick_pendulum,
)

OPTIONS: dict[str, dict[str, Any]] = {
    "no terminal equality": {"terminal_equality": False},
    "regulation": {**REGULATION, "output_weight": 1e3, "input_weight": 0.1},
    "no slack": {"slack": False, "affine_sum": "all"},
    "projection": {"regulariser": "projection", "lambda_g": 1e3},
    "projection, affine": {"regulariser": "projection", "affine_sum": "all", **REGULATION},
    "equilibrium": {"regulariser": "equilibrium", "setpoint_weight": 30.0},
    "equilibrium, affine": {"regulariser": "equilibrium", "affine_sum": "all", "lambda_g": 5.0},
    "slack on all outputs": {"future_slack": True, "lambda_sigma": 1e3},
    "slack on all outputs, regulation": {"future_slack": True, "lambda_sigma": 1e3, **REGULATION},
    "slack on all outputs, soft": {"future_slack": True, "lambda_sigma": 1e3, "soft_output_bounds": 1e4},
    "soft outputs": {"soft_output_bounds": 1e4},
    "soft outputs, regulation": {"soft_output_bounds": 1e4, **REGULATION, "output_weight": 1e3},
    "rate bounds": {"rate_bounds": 0.4},
    "rate bounds, regulation": {"rate_bounds": [0.4], **REGULATION, "output_weight": 1e3},
    "three inputs a plan": {"apply_steps": 3},
    "current output": {"use_current_output": True},
    "current output, equilibrium": {"use_current_output": True, "regulariser": "equilibrium"},
    "all of it": {
        "use_current_output": True,
        "apply_steps": 2,
        "rate_bounds": 0.5,
        "soft_output_bounds": 1e3,
        "regulariser": "equilibrium",
        "future_slack": True,
        "lambda_sigma": 1e4,
        "affine_sum": "all",
        "horizon": 8,
    },
}


def compare(controller: DeePC, recording: Recording, run: Run, bounds: Bounds) -> float:
    """Return the largest difference in u from the full problem."""
    full = FullDeePC(controller, recording, bounds)
    steps, worst = controller.apply_steps, 0.0
    for k in range(0, len(run.samples), steps):
        u_ini = before(run.u, np.zeros(run.u.shape[1]), k, controller.initial_length)
        now = int(controller.use_current_output)
        y_ini = before(run.y, run.y[0], k + now, controller.initial_length + now)
        solution = full.solve(u_ini, y_ini, run.samples[k].reference)
        assert solution.solved, solution.failure
        applied = run.u[k : k + steps]
        worst = max(worst, float(np.abs(solution.u[: len(applied)] - applied).max()))
    assert set(run.status) == {"ok"}
    return worst


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_on_the_pendulum(paper_recording: Recording, options: dict[str, Any]) -> None:
    controller = printed_deepc(**options)
    # Soft output bounds are tight enough to be exceeded, input bounds to be active.
    loop = pendulum_loop(paper_recording, 2.5, 15.0 if controller.soft_output_bounds else 70.0)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), steps=60)
    assert compare(controller, paper_recording, run, loop.bounds) < 1e-6


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_on_two_inputs_and_two_outputs(options: dict[str, Any]) -> None:
    rng = np.random.default_rng(8)
    plant = LinearPlant.random(rng, 3, 2, 2)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (120, 2)), 3, plant.c)
    noisy = Recording(
        recording.u, recording.y + 1e-2 * rng.standard_normal((120, 2)), recording.measured, 0.1
    )
    rates = {"rate_bounds": [0.3, 0.5]} if "rate_bounds" in options else {}
    controller = printed_deepc(
        **{"output_weight": [2.0, 1.0], "input_weight": 0.1, "lambda_g": 1.0, "lambda_sigma": 1e4}
        | options
        | rates
    )
    soft = controller.soft_output_bounds > 0.0
    loop = make_loop(noisy, 0.6 * np.ones(2), np.full(2, 1.0 if soft else np.inf))
    reference = np.repeat(2.0 * rng.uniform(-1.0, 1.0, (6, 2)), 10, axis=0)
    run = close_loop(controller, loop, plant.advance, plant.c, reference, steps=30)
    assert compare(controller, noisy, run, loop.bounds) < 1e-6


def test_rate_bounds_hold_exactly(paper_recording: Recording) -> None:
    controller = printed_deepc(rate_bounds=0.25, apply_steps=2)
    run = close_loop(
        controller, pendulum_loop(paper_recording, 1.5), quick_pendulum, ANGLE, paper_reference(), 120
    )
    changes = np.abs(np.diff(np.concatenate([[0.0], run.u[:, 0]])))
    assert changes.max() <= 0.25 + 1e-15
    assert changes.max() > 0.249
    assert np.abs(run.u).max() <= 1.5


LAG = LinearPlant(np.array([[0.95, 0.1], [0.0, 0.9]]), np.array([[0.0], [0.1]]), np.array([[1.0, 0.0]]))


def statuses_far_outside(controller: DeePC, steps: int = 6) -> tuple[list[str], FloatArray]:
    """Start a slow plant at seven times its output limit; return what is said, and the inputs."""
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (100, 1))
    loop = make_loop(experiment(LAG.advance, u, 2, LAG.c), np.array([1.0]), np.array([0.3]))
    # At rest at 2 the plant cannot have been: only its own past, from the second sample on, is.
    reference = np.zeros((steps + controller.horizon + 1, 1))
    closed = close_loop(controller, loop, LAG.advance, LAG.c, reference, steps, np.array([2.0, 0.0]))
    return closed.status, closed.u


def test_bounds_that_contradict_each_other_are_named() -> None:
    said, u = statuses_far_outside(printed_deepc(slack=False, **REGULATION))
    for status in said[3:]:
        assert "no way to meet" in status
        assert "y at its upper bound" in status
        assert "output bounds softened" in status
    assert np.abs(u).max() <= 1.0


@pytest.mark.parametrize("setpoint", [REGULATION, {"terminal_equality": False}])
def test_soft_output_bounds_are_feasible_where_hard_ones_are_not(setpoint: dict[str, Any]) -> None:
    said, _ = statuses_far_outside(printed_deepc(slack=False, soft_output_bounds=1e3, **setpoint), steps=8)
    assert set(said[3:]) == {"ok"}


def test_a_plan_is_applied_to_its_end(paper_recording: Recording) -> None:
    controller = printed_deepc(apply_steps=5)
    run = close_loop(controller, pendulum_loop(paper_recording), quick_pendulum, ANGLE, paper_reference(), 10)
    first = FullDeePC(controller, paper_recording, pendulum_loop(paper_recording).bounds)
    plan = first.solve(np.zeros((3, 1)), np.zeros((3, 1)), paper_reference()[1:6])
    assert run.u[:5] == pytest.approx(plan.u, abs=1e-7)


def test_inputs_are_weighed_from_where_they_rest(paper_recording: Recording) -> None:
    controller = printed_deepc(**REGULATION)
    loop = pendulum_loop(paper_recording)
    loop = replace(loop, inputs=(replace(loop.inputs[0], start=0.5),))
    controller.start(loop)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, np.zeros((20, 1)), 1)
    full = FullDeePC(controller, paper_recording, loop.bounds, rest=np.array([0.5]))
    expected = full.solve(np.full((3, 1), 0.5), np.zeros((3, 1)), np.zeros((5, 1)))
    assert run.u[0] == pytest.approx(expected.u[0], abs=1e-7)


class TestL1:
    """|g|_1 has no condensed form; its optimum is recognised by multipliers that a linear program finds."""

    settings: ClassVar[dict[str, Any]] = {
        "regulariser": "l1",
        "lambda_g": 5.0,
        "lambda_sigma": 1e4,
        **REGULATION,
    }

    def short(self) -> Recording:
        recording = pendulum_experiment(7)
        return Recording(*(a[:60] for a in (recording.u, recording.y, recording.measured)), 0.1)

    def test_the_optimum_has_its_multipliers(self) -> None:
        recording = self.short()
        controller = printed_deepc(**self.settings)
        loop = pendulum_loop(recording, torque=50.0, degrees=1e4)
        run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 12)
        full = FullDeePC(controller, recording, loop.bounds, tolerance=1e-11)
        windows = np.vstack([full._data[name][:, :53] for name in ("u_ini", "y_ini", "u", "y")])
        for k in (1, 6, 11):
            u_ini, y_ini = before(run.u, np.zeros(1), k, 3), before(run.y, run.y[0], k, 3)
            reference = run.samples[k].reference
            u, y, g, _ = full.solve(u_ini, y_ini, reference)
            assert run.u[k] == pytest.approx(u[0], abs=1e-5)
            misfit = windows[3:6] @ g - y_ini[:, 0]
            gradient = np.concatenate([2e4 * misfit, 20.0 * u[:, 0], 200.0 * (y - reference)[:, 0]])
            # With M' nu = -(subgradient of lambda |g|_1), nu free for the past inputs, which are fixed:
            fixed = windows[3:].T @ gradient
            used = np.abs(g) > 1e-6
            sign, tolerance = np.sign(g), 1e-3
            upper = np.where(used, -5.0 * sign, 5.0) - fixed + tolerance
            lower = np.where(used, -5.0 * sign, -5.0) - fixed - tolerance
            past = windows[:3].T
            optimum = linprog(
                np.zeros(3), np.vstack([past, -past]), np.concatenate([upper, -lower]), bounds=(None, None)
            )
            assert optimum.status == 0

    def test_few_windows_are_used(self) -> None:
        recording = self.short()
        loop = pendulum_loop(recording)
        full = FullDeePC(printed_deepc(**self.settings), recording, loop.bounds, tolerance=1e-11)
        g = full.solve(np.zeros((3, 1)), np.zeros((3, 1)), np.full((5, 1), 0.2)).g
        assert 0 < np.count_nonzero(np.abs(g) > 1e-6) < len(g) / 2

    def test_bounds_hold_and_the_loop_tracks(self) -> None:
        recording = self.short()
        controller = printed_deepc(**self.settings | {"input_weight": 0.01, "output_weight": 1e3})
        run = close_loop(
            controller, pendulum_loop(recording, 3.4), quick_pendulum, ANGLE, paper_reference(), 60
        )
        assert set(run.status) == {"ok"}
        assert np.abs(run.u).max() <= 3.4
        assert abs(run.y[-1, 0] / DEGREE - 20.0) < 3.0

    @pytest.mark.parametrize("limits", [(0.0, 100.0), (-1e5, 1e5)])
    def test_operating_points_and_limits_far_from_zero_are_solved(self, limits: tuple[float, float]) -> None:
        rng = np.random.default_rng(0)
        u, y = 50.0 + rng.uniform(-20.0, 20.0, (200, 1)), np.full((201, 1), 50.0)
        for k in range(200):
            y[k + 1] = 0.9 * y[k] + 0.1 * u[k]
        low, high = np.full(1, limits[0]), np.full(1, limits[1])
        loop = replace(
            make_loop(Recording(u, y[:-1], y[:-1], 0.1), high, high),
            bounds=Bounds(low, high, low, high),
            continues_recording=True,
        )
        controller = printed_deepc(regulariser="l1", affine_sum="all", lambda_g=1e-3)
        controller.start(loop)
        state = y[-1]
        for k in range(60):
            reference = np.full((5, 1), 50.0 if k < 20 else 60.0)
            answer = controller.step(Sample(k, 0.1 * k, state, state, reference, reference[0]))
            assert isinstance(answer, Action)
            assert answer.status == "ok"
            state = 0.9 * state + 0.1 * answer.u
        assert state == pytest.approx([60.0], abs=1e-2)

    def test_the_solver_stands_when_the_loop_starts(
        self, paper_recording: Recording, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        controller = printed_deepc(regulariser="l1")
        controller.start(pendulum_loop(paper_recording))
        monkeypatch.delattr("piqp.SparseSolver")
        answer = controller.step(
            Sample(0, 0.0, np.zeros(1), np.zeros(1), np.full((5, 1), 0.1), np.full(1, 0.1))
        )
        assert isinstance(answer, Action)
        assert answer.status == "ok"
        assert list(answer.info) == ["predicted_end.y0"]

    def test_where_no_problem_has_a_solution_the_last_input_is_held(self) -> None:
        # The recording's last input is below the bounds [4, 5], and no more than 0.1 per sample is allowed.
        recording = self.short()
        loop = replace(pendulum_loop(recording), continues_recording=True)
        loop = replace(loop, bounds=replace(loop.bounds, u_min=np.array([4.0]), u_max=np.array([5.0])))
        controller = printed_deepc(**self.settings, rate_bounds=0.1)
        controller.start(loop)
        y = recording.y[-1]
        answer = controller.step(Sample(0, 0.0, y, y, np.zeros((5, 1)), np.zeros(1)))
        assert isinstance(answer, Action)
        assert "change of u at its upper bound" in answer.status
        assert "the last input is held" in answer.status
        assert answer.u == pytest.approx(recording.u[-1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"artificial_setpoint": False},
            "terminal_equality ties the horizon's end to the artificial setpoint",
        ),
        ({"apply_steps": 6}, "apply_steps = 6 is more than horizon = 5"),
        ({"rate_bounds": [1.0, -1.0]}, r"rate_bounds = \[1.0, -1.0\] is not possible"),
        ({"rate_bounds": "fast"}, "rate_bounds = 'fast' is not possible"),
        ({"regulariser": "l1", "online_data": "forgetting"}, "has no condensed form to update"),
        ({"online_data": "forgetting", "forgetting_factor": 1.0}, "forgets nothing"),
        ({"dither": 0.1}, "excites for online_data, which is 'frozen'"),
    ],
)
def test_settings_that_do_not_fit_each_other_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        printed_deepc(**options)


def test_rate_bounds_need_one_number_per_input(paper_recording: Recording) -> None:
    with pytest.raises(ConfigError, match=r"rate_bounds has shape \(2,\); needed: a number or 1 numbers"):
        printed_deepc(rate_bounds=[1.0, 2.0]).start(pendulum_loop(paper_recording))


def test_weights_that_leave_the_optimum_open_are_refused(paper_recording: Recording) -> None:
    controller = printed_deepc(regulariser="projection", input_weight=0.0, **REGULATION, output_weight=0.0)
    with pytest.raises(ConfigError, match="leave the optimum undetermined"):
        controller.start(pendulum_loop(paper_recording))


@pytest.mark.parametrize(
    ("kind", "settings", "instead"),
    [
        ("deepc", {"regulariser": "shifted-ridge"}, "regulariser: 'shifted-ridge' .* use \"equilibrium\""),
        ("deepc", {"zero_padding": True}, "zero_padding: unknown .* what deepc-published does"),
        ("deepc", {"affine_sum": "first-horizon"}, "affine_sum: .* what deepc-published does"),
        ("wkpc", {"double_shift": True}, "double_shift: .* what wkpc-published does"),
        (
            "wkpc",
            {"dictionary": {"squared_distance": True, "redraw_centre": False}},
            r"dictionary\.squared_distance: .* what wkpc-published does",
        ),
    ],
)
def test_settings_of_earlier_versions_are_refused_with_what_to_use_instead(
    kind: str, settings: dict[str, Any], instead: str
) -> None:
    with pytest.raises(ConfigError, match=instead):
        make_controller(kind, settings)


@pytest.mark.parametrize("torque", [3.5, 1.5])
def test_a_step_says_its_cost_its_active_bounds_and_where_it_is_going(
    paper_recording: Recording, torque: float
) -> None:
    """Against the full problem in the regulation form, whose cost is a sum of four squares."""
    controller = DeePC(**REGULATION, regulariser="ridge", output_weight=1e3)
    loop = pendulum_loop(paper_recording, torque=torque)
    witness = Told(controller)
    run = close_loop(witness, loop, quick_pendulum, ANGLE, paper_reference(), steps=140)
    full = FullDeePC(controller, paper_recording, loop.bounds)
    past_y = full._windows(paper_recording)["y_ini"]
    for k in (5, 40, 98, 100, 103, 120):
        u_ini, y_ini = (before(table, np.zeros(1), k, 3) for table in (run.u, run.y))
        reference = run.samples[k].reference
        plan = full.solve(u_ini, y_ini, reference)
        slack = past_y @ plan.g - y_ini.ravel()
        cost = (
            controller.output_weight * ((plan.y - reference) ** 2).sum()
            + controller.input_weight * (plan.u**2).sum()
            + controller.lambda_g * (plan.g**2).sum()
            + controller.lambda_sigma * (slack**2).sum()
        )
        info = witness.infos[k]
        assert list(info) == ["cost", "active_bounds", "predicted_end.y0"]
        assert info["cost"] == pytest.approx(cost, rel=1e-6, abs=1e-9)
        assert info["predicted_end.y0"] == pytest.approx(plan.y[-1, 0], abs=1e-6)
        at_limit = np.isclose(np.abs(plan.u), torque, rtol=1e-6).sum()
        assert info["active_bounds"] == at_limit
    assert (torque > 3.0) or any(info["active_bounds"] for info in witness.infos)


class Told(Controller):
    """A controller, and what it says of its steps."""

    def __init__(self, controller: DeePC) -> None:
        self.controller, self.horizon = controller, controller.horizon

    def start(self, loop: Loop) -> None:
        self.infos: list[dict[str, float]] = []
        self.controller.start(loop)

    def step(self, sample: Sample) -> FloatArray | Action:
        answer = self.controller.step(sample)
        assert isinstance(answer, Action)
        self.infos.append(dict(answer.info))
        return answer


@pytest.mark.parametrize("limit", [1.2, 50.0])
@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize("slack", [True, False])
def test_free_and_forced_response_apart(slack: bool, current: bool, limit: float) -> None:
    """The problem of Lazar and Verheijen, every entry of its g: the plan is the baseline and ``U_f g``.

    The baseline output is predicted by least squares, what is added to it by the Hankel matrix, whose past
    inputs are zero and whose past outputs are sigma.
    """
    rng, past, n, q, r, lambda_g, lambda_sigma = np.random.default_rng(4), 3, 5, 50.0, 0.1, 2.0, 30.0
    plain = pendulum_experiment(2)
    noisy = plain.y[:90] + 0.02 * rng.standard_normal((90, 1))
    recording, known = Recording(plain.u[:90], noisy, noisy, 0.1), past + current
    controller = DeePC(
        regulariser="free-response",
        slack=slack,
        use_current_output=current,
        lambda_g=lambda_g,
        lambda_sigma=lambda_sigma,
        output_weight=q,
        input_weight=r,
        **REGULATION,
    )
    loop = make_loop(recording, np.array([limit]), np.array([np.inf]))
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 40)
    u, y = (
        np.array([signal[j + first : j + first + length, 0] for j in range(90 - known - n + 1)]).T
        for signal, first, length in ((recording.u, 0, past + n), (recording.y, 0, known + n))
    )
    u_p, u_f, y_p, y_f = u[:past], u[past:], y[:known], y[known:]
    predictor = y_f @ np.linalg.pinv(np.vstack([u_p, y_p, u_f]))
    fixed = u_p if slack else np.vstack([u_p, y_p])
    free = np.linalg.svd(fixed)[2][len(fixed) :].T  # g = free v
    rows = np.vstack([q**0.5 * y_f, r**0.5 * u_f, lambda_g**0.5 * np.eye(len(free)), lambda_sigma**0.5 * y_p])
    for k, sample in enumerate(run.samples):
        u_ini = before(run.u, np.zeros(1), k, past)[:, 0]
        y_ini = before(run.y, run.y[0], k + current, known)[:, 0]
        u_b = np.repeat(u_ini[-1], n)
        y_b = predictor @ np.concatenate([u_ini, y_ini, u_b])
        target = np.zeros(len(rows))
        target[: 2 * n] = np.concatenate([q**0.5 * (sample.reference[:, 0] - y_b), -(r**0.5) * u_b])
        solver = piqp.DenseSolver()
        for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
            setattr(solver.settings, name, 1e-11)
        cost, box = rows @ free, np.full(n, limit)
        solver.setup(cost.T @ cost, -cost.T @ target, G=u_f @ free, h_l=-box - u_b, h_u=box - u_b)
        assert solver.solve() == piqp.PIQP_SOLVED
        planned = u_b + u_f @ free @ np.asarray(solver.result.x)
        assert run.u[k, 0] == pytest.approx(planned[0], abs=1e-5)
    assert (np.abs(run.u).max() > limit - 1e-9) == (limit < 2.0)


def test_about_the_free_response_a_ridge_leaves_no_error_without_noise() -> None:
    """A plan that only goes on costs nothing, wherever the plant rests; the ridge pulls it away."""
    plant = LinearPlant(np.array([[0.8]]), np.array([[0.2]]), np.eye(1))
    recording = experiment(plant.advance, np.random.default_rng(0).uniform(-1.0, 1.0, (60, 1)), 1, plant.c)
    loop = make_loop(recording, np.array([3.0]), np.array([np.inf]))
    left = {}
    for regulariser in ("ridge", "free-response"):
        controller = DeePC(regulariser=regulariser, lambda_g=20.0)  # type: ignore[arg-type]
        run = close_loop(controller, loop, plant.advance, plant.c, np.full((140, 1), 0.5), 120)
        left[regulariser] = abs(float(run.y[-1, 0]) - 0.5)
    assert left["free-response"] < 1e-3 < 0.02 < left["ridge"]


def test_a_free_response_is_that_of_the_recording() -> None:
    with pytest.raises(ConfigError, match=r"regulariser = 'free-response' .* online_data = 'frozen'"):
        DeePC(regulariser="free-response", online_data="sliding-window")
