"""MFAC and MFAPC (14)-(21) in three forms against the book's laws, the authors' program and the formulas."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import nnls

from benchmarks.mfapc_transcription import FullFormTranscription, Transcription
from ddpc_controllers.mfac import MFAC, MFAPC
from ddpc_cosim import Action, ConfigError, Controller, FloatArray, Loop, Sample

from .loops import (
    ANGLE,
    DATA,
    DEGREE,
    LinearPlant,
    close_loop,
    make_loop,
    paper_reference,
    pendulum,
    pendulum_loop,
    quick_pendulum,
    together_and_alone,
)

FREE = np.array([np.inf, np.inf])


def inputs_of(controller: Controller, sample: Sample) -> FloatArray:
    """Return the inputs that a controller answers to a sample."""
    answer = controller.step(sample)
    return answer.u if isinstance(answer, Action) else answer


@pytest.mark.parametrize("form", ["cfdl", "pfdl", "ffdl"])
@pytest.mark.parametrize("make", [MFAPC, partial(MFAC, lambda_u=0.1, step_factor=1.0)], ids=["mfapc", "mfac"])
def test_every_form_ends_at_its_reference(make: Callable[..., Controller], form: str) -> None:
    # Table 2, with three changes of the torque in the longer forms. The last sample before MFAPC sees the
    # next step is 95 of 100.
    run = close_loop(make(form=form), pendulum_loop(None), quick_pendulum, ANGLE, paper_reference())
    error = np.abs(run.y - run.reference[: len(run.y)])[[95, 195, 295, 399], 0] / DEGREE
    assert error.max() < 0.1


@pytest.mark.parametrize(
    "make", [partial(MFAPC, horizon=1), partial(MFAC, step_factor=1.0)], ids=["mfapc", "mfac"]
)
def test_a_gradient_that_drowns_the_weight_of_the_inputs_still_gives_the_least_change(
    make: Callable[..., Controller],
) -> None:
    # lambda_u is below the rounding of |Phi|^2: as for lambda_u = 0, with the smallest of the optima.
    controller = make(initial_gradient=[[3e8, 4e8]])
    controller.start(make_loop(None, FREE, FREE[:1]))
    u = inputs_of(controller, Sample(0, 0.0, np.zeros(1), np.zeros(1), np.ones((1, 1)), np.ones(1)))
    assert u == pytest.approx([3e8 / 25e16, 4e8 / 25e16], rel=1e-7)


@pytest.mark.parametrize("form", ["cfdl", "pfdl", "ffdl"])
@pytest.mark.parametrize(
    ("make", "limit", "tolerance"),
    [(partial(MFAPC, limits="clip"), 0.6, 1e-9), (MFAPC, 0.6, 1e-9), (MFAC, 1.0, 1e-12)],
    ids=["mfapc-clip", "mfapc-qp", "mfac"],
)
def test_a_diagonal_structure_is_one_loop_for_each_pair(
    make: Callable[..., Controller], limit: float, tolerance: float, form: str
) -> None:
    gains, plants = np.array([0.2, -0.5]), [LinearPlant.lag(0.9, 0.2), LinearPlant.lag(0.6, -0.5)]
    reference = np.repeat([[1.0, -0.5], [0.3, 0.8]], [40, 45], axis=0)
    settings = {"form": form, "structure": "diagonal", "rate_bounds": 0.3}
    both, alone = together_and_alone(
        lambda chosen: make(initial_gradient=gains[chosen].tolist(), **settings), plants, limit, reference, 80
    )
    assert np.abs(both - alone).max() < tolerance


class BookLaw:
    """Hou and Jin's law for one input and one output, all step factors equal; estimation (16)-(17)."""

    def __init__(self, ly: int, lu: int, rho: float, lambda_u: float) -> None:
        self.ly, self.lu, self.rho, self.lambda_u = ly, lu, rho, lambda_u
        self.phi_1 = np.zeros(ly + lu)
        self.phi_1[ly] = 0.1
        self.phi = self.phi_1
        self.y = self.u = 0.0
        self.dy, self.du = [0.0] * 9, [0.0] * 9  # newest last

    def step(self, y: float, target: float) -> float:
        h = np.array(self.dy[: -self.ly - 1 : -1] + self.du[: -self.lu - 1 : -1])
        change = y - self.y
        phi = self.phi + h / (1.0 + h @ h) * (change - self.phi @ h)
        direct = phi[self.ly]
        short = np.linalg.norm(phi[self.ly :]) < 1e-5
        self.phi = self.phi_1 if np.linalg.norm(h) <= 1e-5 or direct <= 0.0 or short else phi
        self.y = y
        self.dy.append(change)
        direct = self.phi[self.ly]
        outputs = sum(self.phi[i] * self.dy[-1 - i] for i in range(self.ly))
        inputs = sum(self.phi[self.ly + i] * self.du[-i] for i in range(1, self.lu))
        du = self.rho * direct * (target - y - outputs - inputs) / (self.lambda_u + direct**2)
        self.du.append(du)
        self.u += du
        return float(self.u)


@settings(deadline=None)
@given(
    st.sampled_from([("cfdl", 0, 1), ("pfdl", 0, 3), ("ffdl", 2, 3)]),
    st.floats(0.1, 1.0),
    st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)), min_size=1, max_size=12),
)
def test_every_step_of_mfac_is_that_of_the_book(
    form: tuple[str, int, int], rho: float, samples: list[tuple[float, float]]
) -> None:
    name, ly, lu = form
    controller = MFAC(form=name, output_length=2, input_length=3, step_factor=rho, lambda_u=0.37)
    controller.start(make_loop(None, FREE[:1], FREE[:1]))
    law = BookLaw(ly, lu, rho, 0.37)
    # A first sample of 0: whatever comes before it was at rest.
    for k, (y, target) in enumerate([(0.0, 0.0), *samples]):
        measured = np.array([y])
        u = inputs_of(
            controller, Sample(k, 0.1 * k, measured, measured, np.array([[target]]), np.array([target]))
        )
        assert u == pytest.approx([law.step(y, target)], rel=1e-9, abs=1e-9)


def test_two_inputs_of_mfac_minimise_the_cost_of_the_next_sample() -> None:
    gradient: FloatArray = np.array([[0.5, 0.2], [-0.1, 0.4]])
    controller = MFAC(initial_gradient=gradient.tolist(), lambda_u=0.3, step_factor=1.0)
    controller.start(make_loop(None, FREE, FREE))
    error = np.array([1.0, -0.7])
    u = inputs_of(controller, Sample(0, 0.0, np.zeros(2), np.zeros(2), error[np.newaxis], error))
    weights = np.vstack([gradient, np.sqrt(0.3) * np.eye(2)])
    assert u == pytest.approx(np.linalg.lstsq(weights, np.append(error, [0.0, 0.0]))[0])


def test_mfac_keeps_the_limits_of_input_and_rate() -> None:
    controller = MFAC(lambda_u=0.01, step_factor=1.0, rate_bounds=0.2)
    run = close_loop(controller, pendulum_loop(None, 1.0), quick_pendulum, ANGLE, paper_reference())
    assert np.abs(run.u).max() == 1.0
    assert np.abs(np.diff(run.u, axis=0)).max() <= 0.2 + 1e-15


def test_the_published_program_is_reproduced_row_by_row() -> None:
    published = np.loadtxt(DATA / "mfapc_published_code.csv", delimiter=",", skiprows=1)
    here = close_loop(
        MFAPC(lambda_u=0.37, limits="clip"), pendulum_loop(None), pendulum, ANGLE, paper_reference()
    )
    # Row j of the file is sample j - 1: it has one rest sample more at its start.
    rows = len(published) - 1
    assert np.abs(here.y[:rows, 0] / DEGREE - published[1:, 2]).max() < 1e-5
    assert np.abs(here.u[:rows, 0] - published[1:, 3]).max() < 1e-5
    assert np.abs(here.u).max() == pytest.approx(3.3594, abs=0.0005)


def test_a_larger_lambda_is_smoother() -> None:
    def restlessness(lambda_u: float) -> float:
        run = close_loop(MFAPC(lambda_u=lambda_u), pendulum_loop(None), pendulum, ANGLE, paper_reference())
        return float(np.abs(np.diff(run.u, axis=0)).sum())

    assert restlessness(0.25) > restlessness(0.37) > restlessness(0.7)


@pytest.mark.parametrize("form", ["cfdl", "pfdl", "ffdl"])
def test_every_step_of_mfapc_is_that_of_the_formulas_line_by_line(form: str) -> None:
    lengths = {"pfdl": (0, 3), "ffdl": (2, 3)}
    transcription = (
        FullFormTranscription(400, 3.5, *lengths[form]) if form in lengths else Transcription(400, 3.5)
    )
    controller = MFAPC(form=form, output_length=2, limits="clip")
    run = close_loop(controller, pendulum_loop(None), quick_pendulum, ANGLE, paper_reference())
    expected = np.array([transcription.step(sample.y, sample.reference) for sample in run.samples])
    assert np.abs(run.u - expected).max() < 1e-12


def test_at_the_papers_limits_the_whole_plan_never_meets_one() -> None:
    clipped, planned = (
        close_loop(MFAPC(limits=limits), pendulum_loop(None), quick_pendulum, ANGLE, paper_reference())
        for limits in ("clip", "qp")
    )
    assert np.array_equal(clipped.u, planned.u)


@pytest.mark.parametrize("form", ["cfdl", "ffdl"])
def test_active_limits_are_solved_for_as_the_full_qp_is(form: str) -> None:
    class Watched(MFAPC):
        """MFAPC that keeps every problem."""

        def _start(self, loop: Loop) -> None:
            super()._start(loop)
            self.problems: list[tuple[Any, ...]] = []
            apply = self._limits.apply

            def watched(*problem: Any) -> tuple[list[float], str]:
                answer = apply(*problem)
                self.problems.append((*problem, answer))
                return answer

            self._limits.apply = watched  # type: ignore[method-assign]

    controller = Watched(form=form, rate_bounds=0.3)
    run = close_loop(controller, pendulum_loop(None, 2.0), quick_pendulum, ANGLE, paper_reference())
    sums, active = np.tri(5), 0
    for u, changes, hessian, slope, (applied, fault) in controller.problems:
        best = optimum_by_duality(
            hessian,
            slope,
            np.vstack([sums, -sums, np.eye(5), -np.eye(5)]),
            [2.0 - u[0], 2.0 + u[0], 0.3, 0.3],
        )
        active += not np.allclose(best, changes)
        assert fault == ""
        assert applied[0] - u[0] == pytest.approx(best[0], abs=1e-6)
    assert active > 100
    assert np.abs(run.u).max() <= 2.0
    assert np.abs(np.diff(run.u, axis=0)).max() <= 0.3 + 1e-15


def optimum_by_duality(
    hessian: FloatArray, slope: FloatArray, rows: FloatArray, room: list[float]
) -> FloatArray:
    """Return the optimum of the QP from its dual, which is a problem of non-negative least squares."""
    limits = np.repeat(room, 5)
    root = np.linalg.cholesky(hessian)
    free = np.linalg.solve(hessian, slope)
    gain = np.linalg.solve(root, rows.T)
    # min |gain mu|^2 / 2 + (limits - rows free)' mu, mu >= 0, as the distance to a cone.
    stacked = np.vstack([gain, (rows @ free - limits)[np.newaxis]])
    target = np.append(np.zeros(5), 1.0)
    solution, _ = nnls(stacked, target)
    residual = target - stacked @ solution
    return free - np.linalg.solve(root.T, gain @ solution) / residual[-1]


@pytest.mark.parametrize(
    ("limits", "u_max", "rate", "at_limits"),
    [("qp", 9.0, 9.0, 0), ("qp", 2.0, 0.9, 5), ("clip", 2.0, 0.9, 1), ("clip", 0.9, 9.0, 1)],
)
def test_a_step_says_what_its_plan_costs_its_active_bounds_and_where_it_ends(
    limits: str, u_max: float, rate: float, at_limits: int
) -> None:
    # Four coefficients of 1/4 forecast that the initial gradient of 0.1 stays.
    controller = MFAPC(initial_forecast=0.25, limits=limits, rate_bounds=rate, lambda_u=0.05)
    controller.start(make_loop(None, np.array([u_max]), FREE[:1]))
    y, reference = np.array([1.0]), np.full((5, 1), 1.75)
    answer = controller.step(Sample(0, 0.0, y, y, reference, reference[0]))
    a, error = np.tril(np.full((5, 5), 0.1)), np.full(5, 0.75)
    hessian, slope, sums = a.T @ a + 0.05 * np.eye(5), a.T @ error, np.tri(5)
    rows = np.vstack([sums, -sums, np.eye(5), -np.eye(5)])
    if limits == "qp":
        plan = optimum_by_duality(hessian, slope, rows, [u_max, u_max, rate, rate])
        assert np.isclose(rows @ plan, np.repeat([u_max, u_max, rate, rate], 5), atol=1e-7).sum() == at_limits
    else:
        plan = np.linalg.solve(hessian, slope)
        assert plan[0] > 0.9
        plan[0] = 0.9
    assert isinstance(answer, Action)
    assert answer.u == pytest.approx(plan[:1])
    assert {**answer.info} == pytest.approx(
        {
            "cost": ((1.75 - 1.0 - a @ plan) ** 2).sum() + 0.05 * (plan**2).sum(),
            "active_bounds": at_limits,
            "predicted_end.y0": 1.0 + 0.1 * plan.sum(),
        },
        rel=1e-7,
    )


def test_a_shorter_control_horizon_is_the_plan_whose_later_changes_are_zero() -> None:
    rng = np.random.default_rng(5)
    short, long = (MFAPC(control_horizon=steps, initial_forecast=0.25) for steps in (2, 0))
    loop = make_loop(None, np.array([np.inf]), FREE[:1])
    for controller in (short, long):
        controller.start(loop)
    y, reference = rng.standard_normal(1), rng.standard_normal((5, 1))
    a = np.tril(np.full((5, 5), 0.1))[:, :2]
    expected = np.linalg.solve(a.T @ a + 0.37 * np.eye(2), a.T @ (reference - y).ravel())[0]
    # Four coefficients of 1/4 forecast that the initial gradient stays.
    assert inputs_of(short, Sample(0, 0.0, y, y, reference, reference[0])) == pytest.approx(
        [expected], abs=1e-12
    )
    assert inputs_of(long, Sample(0, 0.0, y, y, reference, reference[0])) != pytest.approx(
        [expected], abs=1e-6
    )


def test_a_control_horizon_beyond_the_prediction_is_refused() -> None:
    with pytest.raises(ConfigError, match="control_horizon = 6 is longer than horizon = 5"):
        MFAPC(control_horizon=6)


def turning(sign: Callable[[int], float]) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return the pendulum with a torque gain of its own at every sample."""
    count = iter(range(10_000))
    return lambda state, torque: quick_pendulum(state, sign(next(count)) * torque)


@pytest.mark.parametrize("assume_sign", [True, False])
def test_a_control_direction_that_turns_needs_the_assumption_off(assume_sign: bool) -> None:
    # Remark 1: the torque gain turns to -1 at 20 s. A damping mu = 0.1 lets two samples outweigh the past.
    controller = MFAPC(form="pfdl", mu=0.1, assume_sign=assume_sign)
    plant = turning(lambda k: 1.0 if k < 200 else -1.0)
    run = close_loop(controller, pendulum_loop(None), plant, ANGLE, paper_reference())
    error = np.abs(run.y - run.reference[: len(run.y)]) / DEGREE
    assert error[100:195].mean() < 3.0
    assert (error[200:295].mean() < 3.0) is not assume_sign
    assert (error[-1, 0] < 0.1) is not assume_sign


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_the_channels_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gradient = np.array([[0.5, 0.1], [-0.2, 0.4]])
    measurements, reference = rng.standard_normal((8, 2)), rng.standard_normal((5, 2))
    there, swapped = MFAPC(initial_gradient=gradient), MFAPC(initial_gradient=gradient[::-1, ::-1])
    there.start(make_loop(None, 3.0 * np.ones(2), FREE))
    swapped.start(make_loop(None, 3.0 * np.ones(2), FREE))
    for k, y in enumerate(measurements):
        u = inputs_of(there, Sample(k, 0.1 * k, y, y, reference, reference[0]))
        other = inputs_of(
            swapped, Sample(k, 0.1 * k, y[::-1], y[::-1], reference[:, ::-1], (reference[:, ::-1])[0])
        )
        assert other[::-1] == pytest.approx(u, abs=1e-9)


def test_a_channel_at_rest_leaves_the_other_as_if_it_were_alone() -> None:
    rng = np.random.default_rng(7)
    alone, together = MFAPC(), MFAPC()
    alone.start(make_loop(None, np.array([3.0]), FREE[:1]))
    together.start(make_loop(None, np.array([3.0, 3.0]), FREE))
    for k, y in enumerate(rng.standard_normal(30)):
        u = inputs_of(alone, Sample(k, 0.1 * k, np.array([y]), np.array([y]), np.ones((5, 1)), np.ones(1)))
        both = np.array([y, 0.0])
        u_both = inputs_of(
            together, Sample(k, 0.1 * k, both, both, np.tile([1.0, 0.0], (5, 1)), np.array([1.0, 0.0]))
        )
        assert u_both == pytest.approx([u[0], 0.0], abs=1e-9)


def test_two_outputs_follow_their_references_without_offset() -> None:
    plant = LinearPlant(
        np.array([[0.6, 0.1], [0.0, 0.5]]),
        np.array([[0.5, 0.1], [-0.1, 0.6]]),
        np.array([[1.0, 0.0], [0.0, 1.0]]),
    )
    reference = np.tile([1.0, -0.5], (220, 1))
    loop = make_loop(None, 5.0 * np.ones(2), FREE)
    run = close_loop(MFAPC(initial_gradient=0.5), loop, plant.advance, plant.c, reference, steps=200)
    assert run.y[-1] == pytest.approx(reference[0], abs=1e-4)


def test_more_outputs_than_inputs_are_controlled_in_the_least_squares_sense() -> None:
    controller = MFAPC(initial_gradient=[[0.5], [0.5]])
    controller.start(make_loop(None, np.array([5.0]), FREE))
    y = np.zeros(2)
    assert inputs_of(
        controller, Sample(0, 0.0, y, y, np.tile([1.0, -1.0], (5, 1)), np.array([1.0, -1.0]))
    ) == pytest.approx([0.0])


@pytest.mark.parametrize("form", ["cfdl", "pfdl", "ffdl"])
def test_a_missing_measurement_does_not_cost_what_was_learned(form: str) -> None:
    controller, y, learned = MFAPC(form=form), np.zeros(1), []
    controller.start(make_loop(None, np.array([50.0]), FREE[:1]))
    for k in range(40):
        target = np.full((5, 1), 1.0 if k // 6 % 2 else -1.0)
        seen = np.array([np.nan]) if k == 25 else y
        answer = controller.step(Sample(k, 0.1 * k, seen, seen, target, target[0]))
        learned.append(controller._model.gradients[0].value)
        y = 0.5 * y + 2.0 * (answer.u if isinstance(answer, Action) else answer)
    assert learned[24] == learned[25] == learned[26] != learned[27]


@pytest.mark.parametrize("form", ["cfdl", "pfdl", "ffdl"])
def test_mfac_with_whole_steps_is_mfapc_one_sample_ahead(form: str) -> None:
    controller = MFAC(form=form, lambda_u=0.3, mu=0.2, eta=0.7)
    settings = controller.settings_as(MFAPC, 1, 1, 0)
    assert settings is not None
    runs = [
        close_loop(method, pendulum_loop(None, 3.5), quick_pendulum, ANGLE, paper_reference())
        for method in (controller, MFAPC(**settings))
    ]
    assert runs[1].u == pytest.approx(runs[0].u, abs=1e-9)
    assert np.ptp(runs[0].u) > 1.0
    assert MFAC(step_factor=0.9).settings_as(MFAPC, 1, 1, 0) is None
