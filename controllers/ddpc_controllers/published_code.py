"""What the paper's published WKPC program does differently from equations (10)-(12)."""

from dataclasses import dataclass

import numpy as np

from ddpc_controllers.behavioral import hankel_matrix
from ddpc_controllers.dictionaries import Lift, ThinPlate, thin_plate
from ddpc_cosim import FloatArray


@dataclass(frozen=True, kw_only=True)
class PublishedThinPlate:
    """Thin-plate functions with the published program's two departures from (12).

    Parameters
    ----------
    printed : ThinPlate
        Number of functions and box of the centres.
    redraw_centre : bool
        Draw one centre at every evaluation and use it for all functions, which makes them equal.
    squared_distance : bool
        Multiply the logarithm by the square of the distance.
    """

    printed: ThinPlate
    redraw_centre: bool
    squared_distance: bool

    def draw(self, size: int, rng: np.random.Generator) -> Lift:
        """Return the functions; see :class:`~ddpc_controllers.dictionaries.Dictionary`."""
        box, power = self.printed, 2 if self.squared_distance else 1
        centres = None if self.redraw_centre else rng.uniform(box.low, box.high, (box.count, size))

        def lift(states: FloatArray) -> FloatArray:
            if centres is not None:
                return thin_plate(np.linalg.norm(states[..., np.newaxis, :] - centres, axis=-1), power)
            centre = rng.uniform(box.low, box.high, states.shape)
            values = thin_plate(np.linalg.norm(states - centre, axis=-1), power)
            return np.repeat(values[..., np.newaxis], box.count, axis=-1)

        return lift


class DoubleShift:
    """A lifted memory that grows by two samples a step, while the input and output data stay.

    It starts as the lifted recording. At every sample the last state and the new one are appended, each
    lifted anew, and the lifted Hankel matrix is rebuilt from the last T samples but the last N.

    Parameters
    ----------
    recorded : array, shape (T, n_z)
        The lifted recording, time along axis 0.
    initial_length, horizon : int
        Tini and N.
    """

    def __init__(self, recorded: FloatArray, initial_length: int, horizon: int) -> None:
        self._memory = recorded.copy()
        self._initial_length, self._horizon = initial_length, horizon

    def append(self, last: FloatArray, new: FloatArray) -> None:
        """Append the last state and the new one, lifted, shapes (n_z,)."""
        self._memory[:-2] = self._memory[2:]
        self._memory[-2], self._memory[-1] = last, new

    @property
    def past(self) -> FloatArray:
        """The last Tini lifted samples, shape (Tini, n_z): z_ini as the program takes it."""
        return self._memory[-self._initial_length :]

    @property
    def hankel(self) -> FloatArray:
        """The lifted Hankel matrix, shape (Tini * n_z, T - N - Tini + 1)."""
        return hankel_matrix(self._memory[: -self._horizon], self._initial_length)
