"""Algebraic loops: values that follow from each other without delay, found by iteration at one instant."""

from collections.abc import Callable, Sequence

import numpy as np

from ddpc_cosim.coupling.parts import Part
from ddpc_cosim.errors import FMUStepError, StepStatus
from ddpc_cosim.variables import FloatArray

_MOST_SWEEPS, _MOST_NEWTON_STEPS, _MOST_HALVINGS = 20, 25, 12
_CONTRACTS = 0.5  # by which part the change of a sweep must shrink for the next one to be worth its cost
_DIFFERENCE = float(np.sqrt(np.finfo(float).eps))


class AlgebraicLoop:
    """Outputs of parts that depend on each other in a circle.

    Sweeps over the parts, each with the newest values (fixed point), are enough where the loop contracts;
    else Newton's method with halved steps follows, with the derivatives that the parts tell, or differences.

    Parameters
    ----------
    parts : sequence of Part
        The parts in the loop.
    members : sequence of int
        The outputs that follow from each other, among all values.
    values : array
        All values; changed in place.
    scale : array
        Nominal magnitudes of all values.
    tolerance : float
        Largest change that is left, relative to the larger of nominal and value.
    texts : sequence of str
        Full names of all values.
    taken : callable
        Returns what a part takes at a time [s], shape (m,), from all values as they are.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        members: Sequence[int],
        values: FloatArray,
        scale: FloatArray,
        tolerance: float,
        texts: Sequence[str],
        taken: Callable[[Part, float], FloatArray],
    ) -> None:
        self._parts, self._values, self._tolerance, self._taken = parts, values, tolerance, taken
        self._members = np.array(members, dtype=np.intp)
        self._nominal, self._all_nominal = scale[self._members], scale
        self._names = [texts[place] for place in members]
        self._row = {place: row for row, place in enumerate(members)}

    def solve(self, time: float) -> None:
        """Find values that fit each other at a time [s].

        Values that are not finite are left so: the run has diverged.

        Raises
        ------
        FMUStepError
            The iteration does not converge, or a part fails.
        """
        start = self._values[self._members]
        change = np.inf
        for _ in range(_MOST_SWEEPS):
            last, before = change, self._values[self._members]
            self._sweep(time)
            change = self._largest(self._values[self._members] - before)
            if change <= self._tolerance or not np.isfinite(start).all():
                return
            if not change <= _CONTRACTS * last:
                break
        residual = np.inf
        for exact in (True, False):
            self._values[self._members] = start
            residual = self._newton(time, exact)
            if residual <= self._tolerance:
                return
        raise FMUStepError(self._does_not_converge(time), StepStatus.ERROR, time)

    def _sweep(self, time: float) -> None:
        for part in self._parts:
            self._values[part.output_slice] = part.outputs_at(self._taken(part, time), time)

    def _newton(self, time: float, exact: bool) -> float:
        """Take Newton steps; return the last one, relative to the values: small, if they have converged."""
        values, members = self._values, self._members
        outputs, error = self._outputs(time)
        for _ in range(_MOST_NEWTON_STEPS):
            z = values[members]
            matrix = self._jacobian(time, outputs, exact)
            self._residual = error
            if matrix is None or not np.isfinite(matrix).all() or not np.isfinite(error).all():
                return np.inf
            try:
                step = np.asarray(np.linalg.solve(np.eye(len(z)) - matrix, error), dtype=np.float64)
            except np.linalg.LinAlgError:
                return np.inf
            size, norm = self._largest(step), self._largest(error)
            for _ in range(_MOST_HALVINGS):
                values[members] = z + step
                outputs, error = self._outputs(time)
                if self._largest(error) < norm or size <= self._tolerance:
                    break
                step *= 0.5
            else:
                values[members] = z
                return np.inf
            if size <= self._tolerance:
                for part, y in zip(self._parts, outputs, strict=True):
                    values[part.output_slice] = y
                return size
        return np.inf

    def _outputs(self, time: float) -> tuple[list[FloatArray], FloatArray]:
        """Return the outputs of all parts at the values as they are, and by how much the values differ."""
        outputs = [part.outputs_at(self._taken(part, time), time) for part in self._parts]
        values = self._values.copy()
        for part, y in zip(self._parts, outputs, strict=True):
            values[part.output_slice] = y
        return outputs, values[self._members] - self._values[self._members]

    def _jacobian(self, time: float, outputs: Sequence[FloatArray], exact: bool) -> FloatArray | None:
        """Return the derivatives of the loop's values by themselves; None where no part knows its own."""
        size, known = len(self._members), not exact
        matrix = np.zeros((size, size))
        for part, y in zip(self._parts, outputs, strict=True):
            taken = self._taken(part, time)
            derivatives = part.derivatives(taken, time) if exact else None
            known = known or derivatives is not None
            rows = [(row, p - part.output_slice.start) for p, row in self._row.items() if p in part.places]
            for i, source in enumerate(part.sources.tolist()):
                if source in self._row:
                    slope = self._slope(part, taken, i, y, time) if derivatives is None else derivatives[:, i]
                    for row, place in rows:
                        matrix[row, self._row[source]] += slope[place]
        return matrix if known else None

    def _slope(self, part: Part, taken: FloatArray, i: int, y: FloatArray, time: float) -> FloatArray:
        """Return the derivatives of a part's outputs by one of the values that it takes, by a difference."""
        beside = taken.copy()
        step = _DIFFERENCE * max(abs(taken[i]), self._all_nominal[part.sources[i]])
        beside[i] += step
        if not part.may_take(beside):
            beside[i] = taken[i] - step
        slope: FloatArray = (part.outputs_at(beside, time) - y) / (beside[i] - taken[i])
        return slope

    def _largest(self, difference: FloatArray) -> float:
        """Return the largest difference, relative to nominal or value; infinite if one is not finite."""
        with np.errstate(invalid="ignore", over="ignore"):
            ratio = np.abs(difference) / np.maximum(self._nominal, np.abs(self._values[self._members]))
        return float(ratio.max()) if np.isfinite(ratio).all() else np.inf

    def _does_not_converge(self, time: float) -> str:
        worst = int(np.argmax(np.abs(self._residual) / self._nominal))
        return (
            f"the algebraic loop of {', '.join(self._names)} does not converge at t = {time:g} s: "
            f"{self._names[worst]} is off by {self._residual[worst]:.3g}; let a part of it delay its output, "
            "or start it nearer to a solution"
        )
