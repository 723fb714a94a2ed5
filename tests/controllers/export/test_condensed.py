"""The condensed law in C: its optima satisfy the optimality conditions, and it decides as Python does."""

import ctypes
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from controllers.export.compiled import CompiledController, compiled
from ddpc_controllers.export.code import Code, Exportable
from ddpc_controllers.export.law import add_law
from ddpc_controllers.optimisation.condensing import CondensedProblem
from ddpc_controllers.optimisation.limits import InputLimits
from ddpc_controllers.optimisation.qp import ParametricQP
from ddpc_cosim import Action, Bounds, FloatArray, Loop, Sample, Variable

BATCH = """
#include "controller.h"
void batch(ControllerState *state, int count, const double y[], double u[], unsigned told[]);
void batch(ControllerState *state, int count, const double y[], double u[], unsigned told[])
{
    for (int i = 0; i < count; ++i) {
        const double *r = y;
        controller_step(state, y + i * CONTROLLER_MEASUREMENTS, r, u + i * CONTROLLER_INPUTS);
        told[3 * i] = state->status;
        told[3 * i + 1] = state->iterations;
        told[3 * i + 2] = state->active_bounds;
    }
}
"""


@dataclass(kw_only=True)
class Posed(Exportable):
    """A law that is shown its parameters, and answers with what it was asked for."""

    law: ParametricQP
    answers: int
    horizon: int = field(default=1, init=False)

    def start(self, loop: Loop) -> None: ...

    def step(self, sample: Sample) -> Action:
        u, fault = self.law.solve(sample.y)
        return Action(np.zeros(self.answers), fault) if u is None else Action(u, fault or "ok")

    def c_step(self, code: Code, loop: Loop) -> str:
        law = add_law(code, self.law, self.answers)
        memory = code.memory(np.zeros(law.memory))
        return code.step(f"if (!solve_law({law.pointer}, sample->y, {memory}, u, told)) u[0] = 0.0;")


def posed(problem: CondensedProblem, inputs: InputLimits) -> tuple[Posed, Loop]:
    """Return a law as a controller, and the loop that it is in."""
    answers, parameters = problem.move_law.shape
    none = np.full(parameters, np.inf)
    u = np.full(answers, np.inf)
    loop = Loop(
        1.0,
        tuple(Variable(f"u{i}") for i in range(answers)),
        tuple(Variable(f"p{i}") for i in range(parameters)),
        (),
        Bounds(-u, u, -none, none),
        None,
        np.random.default_rng(0),
    )
    return Posed(law=ParametricQP(problem, inputs), answers=answers), loop


def solve_all(controller: Posed, loop: Loop, p: FloatArray) -> tuple[FloatArray, Any]:
    """Return the answers to many parameter vectors, one after another, and what is told of each."""
    code = controller.c_code(loop)
    library = compiled(replace(code, sources={**code.sources, "batch.c": BATCH}))
    single = CompiledController(controller, loop)
    u, info = np.zeros((len(p), controller.answers)), np.zeros((len(p), 3), dtype=np.uint32)
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (np.ascontiguousarray(p), u, info)]
    library.batch(ctypes.byref(single.state), len(p), *pointers)
    return u, info


def box(rows: FloatArray, low: FloatArray, high: FloatArray) -> CondensedProblem:
    """Return ``low <= rows (t + p_1) + p_2 <= high``; t = -p_1 is a solution for p_2 within the limits.

    Asked for is t itself. Rows are in parts of the range, as condensed ones are.
    """
    n, k = rows.shape
    span = np.where(high > low, high - low, 1.0)[:, np.newaxis]
    law = np.hstack([rows, np.eye(n)]) / span
    margins = np.concatenate([-high, low])[:, np.newaxis] / np.vstack([span, span])
    return CondensedProblem(
        excess_law=np.hstack([np.vstack([law, -law]), margins]),
        excess_gain=np.vstack([rows, -rows]) / np.vstack([span, span]),
        move_law=np.zeros((k, n + k + 1)),
        move_gain=np.eye(k),
        conflict_law=np.zeros((0, n + k + 1)),
    )


def far_off(rng: np.random.Generator, count: int, k: int, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return parameters whose unconstrained optima are beyond their bounds, and which have a solution."""
    start, inside = 4.0 * rng.standard_normal((count, k)), rng.uniform(low, high, (count, len(low)))
    return np.hstack([start, inside, np.ones((count, 1))])


def unlimited(k: int) -> InputLimits:
    return InputLimits(np.full(k, -1e9), np.full(k, 1e9))


def distance_to_optimum(problem: CondensedProblem, p: FloatArray, t: FloatArray) -> tuple[float, FloatArray]:
    """Return how far solutions are from the laws of their active bounds, once these are proved optimal.

    With ``mu`` from ``S mu = e_0`` on the active bounds, ``t = -G' mu`` is the optimum if no bound is
    exceeded there and no multiplier is negative. The upper sides of bounds stand before the lower ones.
    """
    upper, lower = np.split(p @ problem.excess_law.T, 2, axis=1)
    gain = np.split(problem.excess_gain, 2)[0]
    change = t @ gain.T
    side = 1.0 * (np.abs(upper + change) < 1e-9) - (np.abs(lower - change) < 1e-9)
    excess = np.where(side > 0.0, upper, lower) * np.abs(side)
    curvature = (gain @ gain.T) * side[:, :, np.newaxis] * side[:, np.newaxis, :]
    curvature += np.eye(len(gain)) * (side == 0.0)[:, np.newaxis, :]
    mu = np.linalg.solve(curvature, excess[..., np.newaxis])[..., 0]
    optimum = -(mu * side) @ gain
    change = optimum @ gain.T
    assert mu.min() >= -1e-9 * np.abs(mu).max()
    assert max((upper + change).max(), (lower - change).max()) <= 1e-9
    return float(np.abs(t - optimum).max()), np.count_nonzero(side, axis=1)


@pytest.mark.parametrize(("n", "k"), [(4, 4), (6, 3), (10, 6), (16, 8), (24, 12)])
def test_a_hundred_thousand_optima_with_active_bounds_are_exact(n: int, k: int) -> None:
    rng, count = np.random.default_rng(n), 20_000
    low, high = -rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, n)
    problem = box(rng.standard_normal((n, k)), low, high)
    controller, loop = posed(problem, unlimited(k))
    p = far_off(rng, 2 * count, k, low, high)
    p = p[(p @ problem.excess_law.T).max(axis=1) > 0.0][:count]
    assert len(p) == count
    t, info = solve_all(controller, loop, p)
    assert not info[:, 0].any()
    error, active = distance_to_optimum(problem, p, t)
    assert error <= 1e-10
    assert active.min() >= 1
    np.testing.assert_array_equal(info[:, 2], active)
    assert info[:, 1].max() <= 4 * (n + k)


def as_python_does(problem: CondensedProblem, limits: InputLimits, p: FloatArray) -> tuple[FloatArray, int]:
    """Compare answers and faults with those of the law in Python; return answers and number of faults."""
    controller, loop = posed(problem, limits)
    u, info = solve_all(controller, loop, p)
    moves = [controller.law.solve(parameters) for parameters in p]
    np.testing.assert_array_equal(info[:, 0] != 0, [move.fault != "" for move in moves])
    np.testing.assert_allclose(u, [move.u for move in moves], rtol=1e-9, atol=1e-9)
    return u, int((info[:, 0] != 0).sum())


@pytest.mark.parametrize("repeated", ["rows", "nearly rows", "opposite rows", "combinations", "nothing"])
def test_dependent_bounds_and_bounds_without_an_interior(repeated: str) -> None:
    rng, n, k = np.random.default_rng(7), 9, 4
    rows = rng.integers(-2, 3, (n, k)).astype(float)
    low, high = -rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, n)
    if repeated == "rows":
        rows[5:] = rows[:4]
    elif repeated == "nearly rows":
        rows[5:] = rows[:4] + 1e-7 * rng.standard_normal((4, k))
    elif repeated == "opposite rows":
        rows[5:] = -2.0 * rows[:4]
    elif repeated == "combinations":
        rows[:, 3] = rows[:, 0] - rows[:, 1]  # of less rank than variables
    low[4] = high[4]
    p = far_off(rng, 500, k, low, high)
    u, faults = as_python_does(box(rows, low, high), unlimited(k), p)
    assert faults == 0
    assert np.linalg.norm(u, axis=1).min() > 0.0


def test_what_has_no_solution_is_clipped_where_python_clips_it() -> None:
    rng, n, k = np.random.default_rng(8), 10, 4
    low, high = -rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, n)
    problem = box(rng.standard_normal((n, k)), low, high)
    p = far_off(rng, 500, k, low, high)
    p[:, k : k + n] += rng.standard_normal((500, n))
    problem.move_law[:, :k] = -0.5 * np.eye(k)
    _, faults = as_python_does(problem, InputLimits(np.full(k, -1.0), np.full(k, 1.0)), p)
    assert 100 < faults < 400
    p[3:5, 0], p[7, -3] = np.nan, np.inf
    controller, loop = posed(problem, unlimited(k))
    _, info = solve_all(controller, loop, p)
    assert [row for row in range(500) if info[row, 0] == 1] == [3, 4, 7]
