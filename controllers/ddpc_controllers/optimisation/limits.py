"""Inputs within their limits, and their changes: the box QP in dU, or the first change clipped."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import accumulate
from math import isfinite

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.typing import NDArray

from ddpc_controllers.checks import per_signal
from ddpc_controllers.export.code import Code, qp_memory
from ddpc_controllers.optimisation.backends import PIQPBackend, contradiction
from ddpc_cosim import Bounds, FloatArray, Weight

_CORRECTIONS = 5
_ROUNDING = 1e-12
_AT_LIMIT = 1e-9

HELD = "a measurement or a reference is not finite: inputs held"
HELD_WITHOUT_MEASUREMENT = "a measurement is not finite: inputs held"
HELD_WITHOUT_REFERENCE = "a reference is not finite: inputs held"
SUM_HELD = "a reference is not finite: the sum of its error is held"
PREDICTED = "a measurement is not finite: the model's prediction stands in for it"
EXPECTED = "a measurement is not finite: replaced by what the model expects"
AT_REST = "no finite measurement yet: inputs at rest"


def past_not_recorded(distance: float) -> str:
    """Say how far a past is from what the recorded windows can combine to."""
    return (
        f"no combination of the recorded windows has this past (off by {distance:.1e}); the nearest is used"
    )


CLIPPED = "unconstrained optimum, clipped at the input limits"
LAST_HELD = "the last input is held"


def bounds_not_met(unmet: str, *instead: str) -> str:
    """Say which bounds could not be met together, and what was done instead."""
    return f"no way to meet {unmet}: {', '.join(instead)}"


def unmet_bounds(gain: FloatArray, excess: FloatArray, labels: Sequence[str]) -> str:
    """Name bounds ``excess + gain t <= 0`` that contradict each other; where none do, those exceeded."""
    rows = contradiction(gain, excess) or np.flatnonzero(excess > 0.0).tolist()
    return ", ".join(sorted({labels[row] for row in rows})) if labels else "all bounds"


def rate_limits(rate_bounds: Weight, inputs: int) -> FloatArray:
    """Return the largest change of each input in one sample, shape (m,); infinite where none is given.

    Raises
    ------
    ConfigError
        Neither one number nor one for each input.
    """
    if np.size(rate_bounds) == 0:
        return np.full(inputs, np.inf)
    return per_signal("rate_bounds", rate_bounds, inputs)


class InputLimits:
    """The limits of the inputs, which stand first in a move, and of their changes.

    Parameters
    ----------
    u_min, u_max : array, shape (m,)
        The limits.
    rates : array, shape (m,), optional
        Largest change of each input in one sample; default: any.
    steps : int
        For how many samples a move holds inputs.

    Attributes
    ----------
    endless : bool
        Whether an input has none on a side.
    near : array, shape (m,)
        How far from a limit an input still is at it.
    """

    def __init__(
        self, u_min: FloatArray, u_max: FloatArray, rates: FloatArray | None = None, steps: int = 1
    ) -> None:
        self._steps, self._inputs = steps, steps * len(u_min)
        self._rates = np.full(len(u_min), np.inf) if rates is None else rates
        self.endless = not (np.isfinite(u_min).all() and np.isfinite(u_max).all())
        span = np.zeros(len(u_min))
        np.subtract(u_max, u_min, out=span, where=np.isfinite(u_min) & np.isfinite(u_max))
        self.near = _AT_LIMIT * span
        self._near = self.near.tolist() * steps
        self.move(np.array([[u_min, u_max]] * steps).transpose(0, 2, 1))

    def move(self, limits: FloatArray) -> None:
        """Take new limits, shape (steps, m, 2) or more of them, from this sample on."""
        self._limits = limits
        values = limits[: self._steps].ravel().tolist()
        self._low, self._high = values[::2], values[1::2]
        self._near_low = [low + near for low, near in zip(self._low, self._near, strict=True)]
        self._near_high = [high - near for high, near in zip(self._high, self._near, strict=True)]

    def reach(self, u: FloatArray) -> None:
        """Put inputs that are at a limit but for rounding exactly there, in place."""
        for i, value in enumerate(u[: self._inputs].tolist()):
            if value <= self._near_low[i]:
                u[i] = self._low[i]
            elif value >= self._near_high[i]:
                u[i] = self._high[i]

    def tables(self) -> dict[str, list[float]]:
        """Return the limits of the inputs and what counts as at them, for code in C."""
        return {
            "low": self._low,
            "high": self._high,
            "near_low": self._near_low,
            "near_high": self._near_high,
        }

    def hold(self, u: FloatArray) -> None:
        """Keep the inputs exactly within their limits, in place."""
        inputs = u[: self._inputs]
        for low, value, high in zip(self._low, inputs.tolist(), self._high, strict=True):
            if not low <= value <= high:  # seldom: comparing a few numbers takes less time than a clip
                np.clip(inputs, self._low, self._high, out=inputs)
                return

    def hold_changes(self, plan: FloatArray, last: FloatArray) -> None:
        """Keep inputs, shape (samples, m), and their changes from ``last`` on within limits, in place."""
        for u, limits in zip(plan, self._limits, strict=False):
            np.clip(u, last - self._rates, last + self._rates, out=u)
            np.clip(u, *limits.T, out=u)
            last = u


def least_changes(
    a: FloatArray, error: FloatArray, hessian: FloatArray, slope: FloatArray, ridge: float | FloatArray
) -> FloatArray:
    """Return the changes that minimise ``|error - A dU|^2 + dU' diag(ridge) dU``, limits aside.

    Their normal equations ``hessian dU = slope`` are the fast way. Where the ridge is lost in the rounding of
    A'A the factorisation fails, and the least squares that they come from are solved instead.
    """
    _, changes, failed = scipy.linalg.lapack.dposv(hessian, slope)
    if failed and isfinite(hessian.sum() + slope.sum()):
        n = len(slope)
        stacked = np.vstack([a, np.sqrt(ridge) * np.eye(n)])
        changes = np.linalg.lstsq(stacked, np.append(error, np.zeros(n)))[0]
    answer: FloatArray = changes
    return answer


class ChangeLimits:
    """Limits of the inputs and of their changes over a control horizon.

    Parameters
    ----------
    bounds : Bounds
        Input limits, held exactly.
    rates : array, shape (m,)
        Largest change of each input in one sample.
    steps : int
        Control horizon Nu.
    optimise : bool
        Find the best changes that keep all limits over the control horizon, by a QP. Otherwise only the first
        change is clipped, which the plan after it does not know.

    Attributes
    ----------
    plan : list of float
        The changes over the control horizon that were found last; of the first one what is applied tells.
    """

    def __init__(self, bounds: Bounds, rates: FloatArray, steps: int, optimise: bool) -> None:
        self._u_min, self._u_max = bounds.u_min, bounds.u_max
        self._rates, self._steps = rates, steps
        self._optimise = optimise
        self._spans = _spans(bounds.u_max - bounds.u_min, rates)
        self._scales = np.tile(self._spans, steps)
        self._limited = _limited(steps, len(rates))
        self._largest = np.tile(rates / self._spans, steps)
        self._channels = list(zip(bounds.u_min.tolist(), bounds.u_max.tolist(), rates.tolist(), strict=True))
        self._backend = PIQPBackend()
        self.plan: list[float] = []

    def move(self, limits: FloatArray) -> None:
        """Take new limits of the inputs, shape (m, 2), for all of the plan from now on."""
        self._u_min, self._u_max = limits.T
        rates = [rate for _, _, rate in self._channels]
        self._channels = list(zip(self._u_min.tolist(), self._u_max.tolist(), rates, strict=True))

    def apply(
        self, u: Sequence[float], changes: FloatArray, hessian: FloatArray, slope: FloatArray
    ) -> tuple[list[float], str]:
        """Return the next inputs and why they are not the optimum, empty if they are.

        Parameters
        ----------
        u : sequence of float
            The last inputs.
        changes : array, shape (Nu m,)
            The changes that minimise ``dU' hessian dU / 2 - slope' dU`` without limits.
        hessian : array, shape (Nu m, Nu m)
            Positive definite.
        slope : array, shape (Nu m,)
            See above.
        """
        plan = self.plan = changes.tolist()
        fault = ""
        if not isfinite(sum(plan)):
            return list(u), HELD
        if self._optimise:
            admitted = self._admit(u, plan)
            if admitted:
                return admitted, ""
            plan, fault = self._constrained(u, plan, hessian, slope)
            self.plan = plan
        return [
            min(max(old + min(max(change, -rate), rate), low), high)
            for old, change, (low, high, rate) in zip(u, plan, self._channels, strict=False)
        ], fault

    def in_c(self, code: Code, *, moving: bool) -> tuple[str, str, str]:
        """Add the limits to code in C.

        Returns
        -------
        limits : str
            Their name.
        held : str
            The initialiser of what they need in memory.
        look : str
            Statements that take those of the inputs at a sample, where they move.
        """
        m, n = len(self._rates), len(self._scales) if self._optimise else 0
        rated = bool(np.isfinite(self._rates).any())
        limits = code.constant(
            "ChangeLimits",
            m=m,
            steps=self._steps,
            optimise=self._optimise,
            rated=rated,
            rates=code.doubles(self._rates),
            spans=code.doubles(self._spans),
        )
        limited = (1 + rated) * n
        sizes = (n * n, limited * n, limited, limited, limited, limited, n, qp_memory(n))
        bounds, places = code.memory([self._u_min, self._u_max]), code.scratch(*sizes)
        look = code.ahead.limits(code, 1, bounds) if moving and code.ahead else ""
        return limits, f"{{{', '.join([bounds, *places])}}}", look

    def reached(self, u: Sequence[float], changes: FloatArray) -> int:
        """Return at how many limits changes, shape (Nu, m), from ``u`` on are, as far as they keep them."""
        kept = changes if self._optimise else changes[:1]
        levels, near = u + np.cumsum(kept, axis=0), _AT_LIMIT * self._spans
        sides = levels <= self._u_min + near, levels >= self._u_max - near, abs(kept) >= self._rates - near
        return sum(int(np.count_nonzero(side)) for side in sides)

    def _admit(self, u: Sequence[float], plan: list[float]) -> list[float]:
        """Return the next inputs if the whole plan keeps the limits, nothing otherwise."""
        admitted = []
        for j, (low, high, rate) in enumerate(self._channels):
            changes = plan[j :: len(u)]
            levels = list(accumulate(changes, initial=u[j]))[1:]
            if min(levels) < low or max(levels) > high or min(changes) < -rate or max(changes) > rate:
                return []
            admitted.append(levels[0])
        return admitted

    def _constrained(
        self, u: Sequence[float], plan: list[float], hessian: FloatArray, slope: FloatArray
    ) -> tuple[list[float], str]:
        # Solvers have absolute tolerances: changes in parts of their span, and a cost of size one.
        scales = self._scales
        hessian, slope = hessian * np.outer(scales, scales), slope * scales
        unit = float(np.abs(hessian).max())
        hessian, slope = hessian / unit, slope / unit
        low = np.append(np.tile((self._u_min - u) / self._spans, self._steps), -self._largest)
        high = np.append(np.tile((self._u_max - u) / self._spans, self._steps), self._largest)
        free = plan / scales
        levels = self._limited @ free
        optimum = self._exact(hessian, slope, low, high, levels < low, levels > high)
        if optimum is None:
            # hessian = root root' but for rounding, and t = root' (dU - free).
            root = np.linalg.cholesky(hessian + _ROUNDING * np.eye(len(slope)))
            sides = np.append(low > -np.inf, high < np.inf)
            gain = np.linalg.solve(root, np.vstack([-self._limited, self._limited])[sides].T).T
            self._backend.load(gain)
            excess = np.append(low - levels, levels - high)[sides]
            t, active_rows, failure = self._backend.solve(excess)
            active = np.zeros(len(sides), dtype=bool)
            active[np.flatnonzero(sides)[list(active_rows)]] = True
            # Whatever the solver reports: a point that satisfies the optimality conditions is the optimum.
            optimum = self._exact(hessian, slope, low, high, *np.split(active, 2))
            if optimum is None and failure:
                kinds = [
                    f"{kind} at its {side} bound"
                    for side in ("lower", "upper")
                    for kind in ("u", "change of u")
                ]
                labels = np.repeat(kinds, len(slope))[sides].tolist()
                return plan, bounds_not_met(unmet_bounds(gain, excess, labels), CLIPPED)
            if optimum is None:
                t = _at_corner(gain, excess, list(active_rows), t)
                optimum = free + np.linalg.solve(root.T, t)
        changes: list[float] = (optimum * scales).tolist()
        return changes, ""

    def _exact(
        self,
        hessian: FloatArray,
        slope: FloatArray,
        low: FloatArray,
        high: FloatArray,
        at_low: NDArray[np.bool_],
        at_high: NDArray[np.bool_],
    ) -> FloatArray | None:
        """Return the optimum by an active-set method from a guess; None if a few corrections do not find it.

        Its digits do not depend on a solver: a limit that is only just active costs an interior-point method
        half of them.
        """
        n = len(slope)
        for _ in range(_CORRECTIONS):
            active = at_low | at_high
            rows, values = self._limited[active], np.where(at_high, high, low)[active]
            system = np.block([[hessian, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
            try:
                solution = np.linalg.solve(system, np.append(slope, values))
            except np.linalg.LinAlgError:  # limits that coincide
                return None
            reached, force = self._limited @ solution[:n], np.zeros(len(low))
            force[active] = solution[n:]
            beyond_low, beyond_high = reached < low - _ROUNDING, reached > high + _ROUNDING
            weak = _ROUNDING * np.abs(force).max(initial=0.0)
            released = active & np.where(at_high, force < -weak, force > weak) & (low < high)
            if not (beyond_low | beyond_high | released).any():
                return np.asarray(solution[:n])
            at_low, at_high = (at_low & ~released) | beyond_low, (at_high & ~released) | beyond_high
        return None


@lru_cache(maxsize=16)  # those who control many plants of one kind ask again
def _limited(steps: int, inputs: int) -> FloatArray:
    """Return what has limits, in parts of the spans: levels of the inputs in a plan, then their changes."""
    limited = np.vstack([np.kron(np.tri(steps), np.eye(inputs)), np.eye(steps * inputs)])
    limited.flags.writeable = False
    return limited


def _at_corner(gain: FloatArray, excess: FloatArray, active: list[int], t: FloatArray) -> FloatArray:
    """Return the shortest t at the active limits; the one given if that is not the optimum.

    Limits that depend on each other have no multipliers of their own, and an interior-point method leaves
    half of the digits there. Any that are not negative prove the optimum.
    """
    corner = np.asarray(np.linalg.lstsq(gain[active], -excess[active])[0], dtype=np.float64)
    _, missed = scipy.optimize.nnls(gain[active].T, -corner)
    beyond = (excess + gain @ corner).max()
    return corner if max(missed, beyond) <= _AT_LIMIT * np.linalg.norm(corner) else t


def _spans(ranges: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the scale of a change of each input: its range, else its rate, else its unit."""
    of_rates = np.where(np.isfinite(rates), rates, 1.0)
    return np.where(np.isfinite(ranges) & (ranges > 0.0), ranges, of_rates)
