"""Steps as long as the error allows: each is done once as a whole and once in halves.

Where a method is of order p, the halves are wrong by their difference from the whole over 2^p - 1 (L. F.
Richardson, Phil. Trans. Royal Society A 210 (1911) 307-357).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.coupling.exchange import Exchange
from ddpc_cosim.coupling.parts import Part
from ddpc_cosim.errors import FMUStepError, StepStatus
from ddpc_cosim.variables import FloatArray

_MOST_HALVINGS = 30
_CAUTION = 0.5  # a longer step must promise at most this part of the error that is allowed


class ErrorControl:
    """Divides communication intervals in halves, their halves and so on, as exactness needs it.

    Parameters
    ----------
    parts : sequence of Part
        The parts, which can save their states.
    exchange : Exchange
        What they exchange, arranged for single intervals.
    order : int
        Order of the exchange.
    tolerance : float
        Estimated error that one sample may add to a value, relative to the larger of nominal and value.
    watched : array of int
        The values that count.
    nominal : array
        Their nominal magnitudes.

    Attributes
    ----------
    halvings : int
        How often the last interval was halved.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        exchange: Exchange,
        order: int,
        tolerance: float,
        watched: NDArray[np.intp],
        nominal: FloatArray,
    ) -> None:
        self._parts, self._exchange, self._order, self._tolerance = parts, exchange, order, tolerance
        self._watched, self._nominal = watched, nominal
        self.halvings = 0

    def advance(self, intervals: int, h: float, time: float) -> FMUStepError | None:
        """Advance by so many intervals of h [s] from a time [s] on; return what :class:`Exchange` does.

        Raises
        ------
        FMUStepError
            The shortest steps are too long, or a part fails.
        """
        end_error = None
        for i in range(intervals):
            done = 0.0  # a sum of halves of halves, which is exact
            while done < 1.0:
                if end_error is not None:
                    raise end_error
                length = 0.5**self.halvings
                now, allowed = time + (i + done) * h, self._tolerance * length / intervals
                error, end_error = self._try(length * h, now)
                if error <= allowed:
                    done += length
                    is_easy = error <= _CAUTION * allowed / 2.0**self._order
                    if is_easy and self.halvings and done / length % 2.0 == 0.0:
                        self.halvings -= 1
                elif self.halvings < _MOST_HALVINGS:
                    self._restore(now)
                    self.halvings += 1
                else:
                    raise FMUStepError(
                        f"steps of {length * h:.3g} s are too long for an error_tolerance of "
                        f"{self._tolerance:g} at t = {now:g} s: a value that is exchanged jumps, or the "
                        "tolerance is too small",
                        StepStatus.ERROR,
                        now,
                    )
            if end_error is not None and i + 1 < intervals:
                raise end_error
        return end_error

    def _try(self, h: float, now: float) -> tuple[float, FMUStepError | None]:
        """Do a step in halves; return its estimated error, and what a part says that has come to its end.

        A part may discard a step that is too long for it: then the error is infinite.
        """
        self._saved = [part.call("save_state", now) for part in self._parts]
        self._memory = self._exchange.memory.copy()
        try:
            self._exchange.advance(h, now)
            whole = self._exchange.values[self._watched]
            self._restore(now)
            end_error = self._exchange.advance(h / 2.0, now)
            if end_error is not None:
                raise end_error
            end_error = self._exchange.advance(h / 2.0, now + h / 2.0)
        except FMUStepError as error:
            if error.status is not StepStatus.DISCARD:
                raise
            return np.inf, None
        halves = self._exchange.values[self._watched]
        if not np.isfinite(halves).all():  # the run has diverged
            return 0.0, end_error
        difference = np.abs(halves - whole) / np.maximum(self._nominal, np.abs(halves))
        return float(np.max(difference, initial=0.0)) / (2.0**self._order - 1.0), end_error

    def _restore(self, now: float) -> None:
        for part, state in zip(self._parts, self._saved, strict=True):
            part.call("restore_state", now, state)
        self._exchange.memory[:] = self._memory
