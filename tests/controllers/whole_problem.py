"""Predictive control problems over every entry of g, written down term by term and solved to rounding.

Slow, and nothing is condensed: the reference for disturbances, bands, limits that move and prices.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import piqp

from ddpc_controllers import SPC, WKPC, DeePC, GammaDDPC
from ddpc_controllers.deepc import BehavioralTracking
from ddpc_cosim import FloatArray

Blocks = Mapping[str, FloatArray]

_FEASIBLE = 1e-8


class Ahead(NamedTuple):
    """What is known at one sample, of signals in parts of their nominal values, time along axis 0.

    Disturbances are those of the past window and of the horizon; prices are per sample and unit of money for
    one unit of u or y over one sample.
    """

    u_ini: FloatArray
    y_ini: FloatArray
    reference: FloatArray
    d: FloatArray
    band: FloatArray
    u_limits: FloatArray
    y_limits: FloatArray
    u_price: FloatArray
    y_price: FloatArray
    rest: FloatArray
    rates: FloatArray
    z_ini: FloatArray | None = None


class Answer(NamedTuple):
    """Inputs over the horizon, the cost, and how many bounds are active."""

    u: FloatArray
    cost: float
    active: int


class Terms:
    """A quadratic program in named variables."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        ends = np.cumsum(list(sizes.values()))
        self.places = {name: slice(end - sizes[name], end) for name, end in zip(sizes, ends, strict=True)}
        self.size = int(ends[-1])
        self._squares: list[tuple[FloatArray, FloatArray]] = []
        self._equal: list[tuple[FloatArray, FloatArray]] = []
        self._below: list[tuple[FloatArray, FloatArray]] = []
        self.slope = np.zeros(self.size)

    def rows(self, blocks: Blocks) -> FloatArray:
        """Return rows over all variables."""
        rows = np.zeros((len(next(iter(blocks.values()))), self.size))
        for name, block in blocks.items():
            rows[:, self.places[name]] += block
            if name == "g" and "minus" in self.places:  # the other part of g, for its 1-norm
                rows[:, self.places["minus"]] -= block
        return rows

    def square(self, weight: float, blocks: Blocks, target: FloatArray | float = 0.0) -> None:
        """Add ``weight |sum blocks - target|^2``."""
        rows, root = self.rows(blocks), np.sqrt(weight)
        self._squares.append((root * rows, root * np.broadcast_to(target, len(rows))))

    def equal(self, blocks: Blocks, target: FloatArray | float = 0.0) -> None:
        """Require ``sum blocks = target``."""
        rows = self.rows(blocks)
        self._equal.append((rows, np.broadcast_to(target, len(rows))))

    def below(self, blocks: Blocks, limit: FloatArray) -> None:
        """Require ``sum blocks <= limit`` where it is finite."""
        rows, there = self.rows(blocks), np.isfinite(limit)
        self._below.append((rows[there], limit[there]))

    def keep_positive(self, name: str) -> None:
        """Require that a variable is nowhere negative."""
        place = self.places[name]
        rows = np.eye(self.size)[place]
        self._below.append((-rows, np.zeros(len(rows))))

    def solve(self) -> tuple[FloatArray, float, int]:
        """Return the optimum, its cost, and the number of active bounds."""
        (c, c_0), (a, b), (g, h) = (
            tuple(map(np.concatenate, zip(*terms, strict=True)))
            for terms in (self._squares, self._equal, self._below)
        )
        # The equalities are eliminated: x = x_0 + N v.
        left, values, right = np.linalg.svd(a)
        rank = int((values > 1e-11 * values[0]).sum())
        x_0 = right[:rank].T @ ((left.T @ b)[:rank] / values[:rank])
        null = right[rank:].T
        c, c_0, slope, g, h = c @ null, c_0 - c @ x_0, self.slope @ null, g @ null, h - g @ x_0
        # What costs nothing moves nothing that matters: the shortest solution.
        _, values, right = np.linalg.svd(np.vstack([c, g]), full_matrices=False)
        seen = right[values > 1e-11 * values[0]].T
        c, slope, g, null = c @ seen, slope @ seen, g @ seen, null @ seen
        hessian, linear = 2.0 * c.T @ c, slope - 2.0 * c.T @ c_0
        solver = piqp.DenseSolver()
        for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
            setattr(solver.settings, name, 1e-11)
        solver.setup(hessian, linear, G=np.asfortranarray(g), h_u=h)
        solver.solve()
        v, active = self._exact(hessian, linear, g, h, solver.result.z_u > solver.result.s_u)
        x = x_0 + null @ v
        squares = np.concatenate([rows @ x - target for rows, target in self._squares])
        return x, float(squares @ squares + self.slope @ x), active

    @staticmethod
    def _exact(
        hessian: FloatArray, linear: FloatArray, g: FloatArray, h: FloatArray, active: FloatArray
    ) -> tuple[FloatArray, int]:
        """Return the point that satisfies the optimality conditions, from a guess of the active bounds."""
        n = len(linear)
        for _ in range(50):
            rows = g[active]
            system = np.block([[hessian, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
            solution = np.linalg.solve(system, np.concatenate([-linear, h[active]]))
            v, force = solution[:n], np.zeros(len(h))
            force[active] = solution[n:]
            beyond = g @ v - h > _FEASIBLE
            pulling = force < -_FEASIBLE * np.abs(force).max(initial=1.0)
            if not (beyond | pulling).any():
                return v, len(rows)
            active = (active | beyond) & ~pulling
        raise AssertionError("no active set satisfies the optimality conditions")


def windows(signal: FloatArray, first: int, length: int, columns: int) -> FloatArray:
    """Return a block of M: column j has the samples j + first ... j + first + length - 1."""
    return np.array([signal[j + first : j + first + length].ravel() for j in range(columns)]).T


def solve(
    method: BehavioralTracking | WKPC,
    recorded: Mapping[str, FloatArray],
    bands: list[int],
    ahead: Ahead,
    u_s_limits: FloatArray,
) -> Answer:
    """Return the optimum of a method's problem.

    The outputs in ``bands`` are wanted between two edges, and the last one is not controlled.
    """
    past, n = method.initial_length, method.horizon
    u, y, d = (recorded[name] for name in "uyd")
    m, p = u.shape[1], y.shape[1]
    known = past + getattr(method, "use_current_output", False)
    columns = len(u) - known - n + 1
    data = {
        "u_ini": windows(u, 0, past, columns),
        "y_ini": windows(y, 0, known, columns),
        "d": windows(d, 0, past + n, columns),
        "u": windows(u, past, n, columns),
        "y": windows(y, known, n, columns),
    }
    fixed = {"u_ini": ahead.u_ini, "d": ahead.d}
    if ahead.z_ini is not None:
        data = {"z_ini": windows(recorded["z"], 0, past, columns), **data}
        fixed["z_ini"] = ahead.z_ini
    y_s = not isinstance(method, WKPC) and method.artificial_setpoint
    u_s = y_s or isinstance(method, WKPC)
    sizes = {"g": columns, "above": n * len(bands), "below": n * len(bands)}
    one_norm = isinstance(method, DeePC) and method.regulariser == "l1"
    sizes |= {"minus": columns} if one_norm else {}
    sizes |= ({"u_s": m} if u_s else {}) | ({"y_s": p} if y_s else {})
    terms = Terms(sizes)
    for name, values in fixed.items():
        terms.equal({"g": data[name]}, values.ravel())
    if isinstance(method, DeePC) and method.slack:
        terms.square(method.lambda_sigma, {"g": data["y_ini"]}, ahead.y_ini.ravel())
    else:
        terms.equal({"g": data["y_ini"]}, ahead.y_ini.ravel())
    if one_norm:
        for part in ("g", "minus"):
            terms.slope[terms.places[part]] += method.lambda_g
            terms.keep_positive(part)
    else:
        _weigh_g(terms, method, data, ahead.d[-1])
    every_u = np.tile(np.eye(m), (n, 1))
    if u_s:
        terms.square(method.input_weight, {"g": data["u"], "u_s": -every_u})
        if len(bands):
            terms.square(1e-3 * method.input_weight, {"u_s": np.eye(m)}, ahead.rest)
    else:
        terms.square(method.input_weight, {"g": data["u"]}, np.tile(ahead.rest, n))
    rows_of = {i: data["y"][i::p] for i in range(p)}
    one = np.ones((n, 1))
    for i in range(p):
        if i in bands:
            pick = np.kron(np.eye(n), np.eye(len(bands))[[bands.index(i)]])
            terms.square(method.output_weight, {"above": pick})
            terms.square(method.output_weight, {"below": pick})
            terms.below({"g": rows_of[i], "above": -pick}, ahead.band[:, i, 1])
            terms.below({"g": -rows_of[i], "below": -pick}, -ahead.band[:, i, 0])
        if i in bands or i == p - 1:
            if y_s:
                terms.equal({"g": rows_of[i][-1:], "y_s": -np.eye(p)[[i]]})
        elif y_s:
            terms.square(method.output_weight, {"g": rows_of[i], "y_s": -one * np.eye(p)[i]})
            terms.square(method.setpoint_weight, {"y_s": one * np.eye(p)[i]}, ahead.reference[:, i])
        else:
            terms.square(method.output_weight, {"g": rows_of[i]}, ahead.reference[:, i])
    for sign, side in ((1.0, 1), (-1.0, 0)):
        terms.below({"g": sign * data["u"]}, sign * ahead.u_limits[..., side].ravel())
        terms.below({"g": sign * data["y"]}, sign * ahead.y_limits[..., side].ravel())
        if u_s:
            terms.below({"u_s": sign * np.eye(m)}, sign * u_s_limits[:, side])
        if y_s:
            low, high = ahead.y_limits[-1].T
            with np.errstate(invalid="ignore"):
                drawn = (low + high) / 2 + method.setpoint_margin * (high - low) / 2 * sign
            bounded = np.isfinite(low) & np.isfinite(high)
            terms.below(
                {"y_s": sign * np.eye(p)}, sign * np.where(bounded, drawn, ahead.y_limits[-1, :, side])
            )
        before = np.vstack([np.zeros((m, columns)), data["u"][:-m]])
        last = np.concatenate([ahead.u_ini[-1], np.zeros((n - 1) * m)])
        terms.below({"g": sign * (data["u"] - before)}, np.tile(ahead.rates, n) + sign * last)
    terms.slope += ahead.u_price.ravel() @ terms.rows({"g": data["u"]})
    terms.slope += ahead.y_price.ravel() @ terms.rows({"g": data["y"]})
    x, cost, active = terms.solve()
    return Answer((terms.rows({"g": data["u"]}) @ x).reshape(n, m), cost, active)


def _weigh_g(terms: Terms, method: BehavioralTracking | WKPC, data: Blocks, d_end: FloatArray) -> None:
    """Add what g costs."""
    columns = data["u"].shape[1]
    from_what = np.vstack([rows for name, rows in data.items() if name != "y"])
    explained = np.linalg.pinv(from_what, rcond=1e-12) @ from_what
    rest = np.eye(columns) - explained
    if isinstance(method, GammaDDPC):
        factor = np.linalg.qr(np.vstack(list(data.values())).T)[0].T
        first, last = len(data["u_ini"]) + len(data["y_ini"]) + len(data["d"]), len(from_what)
        terms.square(columns * method.beta_2, {"g": factor[first:last]})
        terms.square(columns * method.beta_3, {"g": factor[last:]})
    elif isinstance(method, SPC):
        terms.equal({"g": rest})
    elif isinstance(method, WKPC):
        terms.square(method.lambda_g, {"g": rest})
        terms.square(1e-3 * method.lambda_g, {"g": explained})
    elif method.regulariser == "projection":
        terms.square(method.lambda_g, {"g": rest})
    elif method.regulariser == "ridge":
        terms.square(method.lambda_g, {"g": np.eye(columns)})
    else:
        _weigh_equilibrium(terms, method, data, rest, d_end)


def _weigh_equilibrium(
    terms: Terms, method: DeePC, data: Blocks, rest: FloatArray, d_end: FloatArray
) -> None:
    """Add ``|g - g_s|^2 + 0.3 |(I - Pi) g_s|^2``, the disturbances at rest as at the end of the horizon."""
    inverse = np.linalg.pinv(np.vstack(list(data.values())), rcond=1e-12)
    held, constant = {}, list[FloatArray]()
    for name, rows in (("u_s", ("u_ini", "u")), ("y_s", ("y_ini", "y"))):
        width = terms.places[name].stop - terms.places[name].start
        held[name] = inverse @ np.vstack(
            [
                (name_of_rows in rows) * np.tile(np.eye(width), (-(-len(block) // width), 1))[: len(block)]
                for name_of_rows, block in data.items()
            ]
        )
    for name_of_rows, block in data.items():
        here = name_of_rows == "d"
        constant.append(np.tile(d_end, len(block) // len(d_end)) if here else np.zeros(len(block)))
    g_d = inverse @ np.concatenate(constant)
    away = {"g": np.eye(len(g_d)), **{name: -block for name, block in held.items()}}
    terms.square(method.lambda_g, away, g_d)
    terms.square(0.3 * method.lambda_g, {name: rest @ block for name, block in held.items()}, -rest @ g_d)
