"""What the paper's published WKPC program does differently from equations (10)-(12)."""

from dataclasses import dataclass

import numpy as np

from ddpc_controllers.data.dictionaries import Lift, ThinPlate, ThinPlateFunctions, place_centres, thin_plate
from ddpc_controllers.data.hankel import hankel_matrix
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

    def functions(self, size: int) -> int:
        """Return n_p."""
        return self.printed.functions(size)

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Return the functions; see :class:`~ddpc_controllers.data.dictionaries.Dictionary`."""
        power = 2 if self.squared_distance else 1
        if self.redraw_centre:
            return _RedrawnFunctions(self.printed, power, rng)
        printed = self.printed
        box = (printed.low, printed.high)
        return ThinPlateFunctions(place_centres(printed.centres, printed.count, states, box, rng), power)


@dataclass(frozen=True, eq=False)
class _RedrawnFunctions:
    """One centre for all functions, drawn anew for every state: not a function of the state at all."""

    printed: ThinPlate
    power: int
    rng: np.random.Generator

    def __call__(self, states: FloatArray) -> FloatArray:
        """Return the equal values of all functions for states of shape (..., q)."""
        centres = self.rng.uniform(self.printed.low, self.printed.high, states.shape)
        values = thin_plate(states - centres, self.power)
        return np.repeat(values[..., np.newaxis], self.printed.count, axis=-1)


class DoubleShift:
    """A lifted memory that grows by two samples a step, while the input and output data stay.

    It starts as the lifted recording. At every sample the last state and the new one are appended, each
    lifted anew, and the lifted Hankel matrix is rebuilt from the last T samples but the last N.

    Parameters
    ----------
    lift : callable
        From states to lifted states z.
    recorded : array, shape (T, n_z)
        The lifted recording, time along axis 0.
    initial_length, horizon : int
        Tini and N.
    """

    def __init__(self, lift: Lift, recorded: FloatArray, initial_length: int, horizon: int) -> None:
        self._lift = lift
        self._memory = recorded.copy()
        self._initial_length, self._horizon = initial_length, horizon
        self._last_state: FloatArray | None = None

    @property
    def past(self) -> FloatArray:
        """The last samples of the memory, which the program takes for z_ini; shape (Tini, n_z)."""
        return self._memory[-self._initial_length :]

    def move(self, state: FloatArray) -> FloatArray | None:
        """Take a new state, shape (q,); return the lifted Hankel matrix if it changed."""
        last, self._last_state = self._last_state, state.copy()
        if last is None:
            return None
        self._memory[:-2] = self._memory[2:]
        self._memory[-2], self._memory[-1] = self._lift(last), self._lift(state)
        return hankel_matrix(self._memory[: -self._horizon], self._initial_length)
