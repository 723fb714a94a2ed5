"""Changes of the inputs within their limits: the box QP in dU, or the first change clipped."""

from collections.abc import Sequence
from itertools import accumulate
from math import isfinite
from typing import Any

import numpy as np
import piqp

from ddpc_controllers.backends import PIQP_TOLERANCE
from ddpc_controllers.validation import per_signal
from ddpc_cosim import Bounds, FloatArray, Weight

NOT_FINITE = "a measurement or a reference is not finite: inputs held"


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
        Find the best changes that keep all limits over the control horizon, by PIQP. Otherwise only the first
        change is clipped, which the plan after it does not know.
    """

    def __init__(self, bounds: Bounds, rates: FloatArray, steps: int, optimise: bool) -> None:
        self._u_min, self._u_max = bounds.u_min, bounds.u_max
        self._rates, self._steps = rates, steps
        self._optimise = optimise
        self._channels = list(zip(bounds.u_min.tolist(), bounds.u_max.tolist(), rates.tolist(), strict=True))
        self._piqp: Any = None

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
        plan, fault = changes.tolist(), ""
        if not isfinite(sum(plan)):
            return list(u), NOT_FINITE
        if self._optimise:
            admitted = self._admit(u, plan)
            if admitted:
                return admitted, ""
            plan, fault = self._constrained(u, plan, hessian, slope)
        return [
            min(max(old + min(max(change, -rate), rate), low), high)
            for old, change, (low, high, rate) in zip(u, plan, self._channels, strict=False)
        ], fault

    def _admit(self, u: Sequence[float], plan: list[float]) -> list[float]:
        """Return the next inputs if the whole plan keeps the limits, nothing otherwise."""
        admitted = []
        for j, (low, high, rate) in enumerate(self._channels):
            own = plan[j :: len(u)]
            levels = list(accumulate(own, initial=u[j]))[1:]
            if min(levels) < low or max(levels) > high or min(own) < -rate or max(own) > rate:
                return []
            admitted.append(levels[0])
        return admitted

    def _constrained(
        self, u: Sequence[float], plan: list[float], hessian: FloatArray, slope: FloatArray
    ) -> tuple[list[float], str]:
        # Nothing depends on the unit of the cost, and the solver's tolerances are absolute.
        unit = float(np.abs(hessian).max())
        hessian, slope = np.asfortranarray(hessian / unit), slope / unit
        room_below = np.tile(self._u_min - u, self._steps)
        room_above = np.tile(self._u_max - u, self._steps)
        if self._piqp is None:
            self._piqp = self._set_up(hessian, slope, room_below, room_above)
        else:
            self._piqp.update(P=hessian, c=-slope, h_l=room_below, h_u=room_above)
        status = self._piqp.solve()
        if status != piqp.PIQP_SOLVED:
            return plan, f"no changes keep all limits ({status.name}): unconstrained optimum, clipped"
        optimum: list[float] = self._piqp.result.x.tolist()
        return optimum, ""

    def _set_up(self, hessian: FloatArray, slope: FloatArray, below: FloatArray, above: FloatArray) -> Any:
        solver = piqp.DenseSolver()
        for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
            setattr(solver.settings, name, PIQP_TOLERANCE)
        sums = np.kron(np.tri(self._steps), np.eye(len(self._rates)))
        rates = np.tile(self._rates, self._steps)
        solver.setup(hessian, -slope, G=np.asfortranarray(sums), h_l=below, h_u=above, x_l=-rates, x_u=rates)
        return solver

    def __getstate__(self) -> dict[str, Any]:
        """Leave PIQP's workspace behind: it is set up again when it is needed."""
        return {**self.__dict__, "_piqp": None}
