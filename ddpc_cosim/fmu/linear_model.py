"""What a linearisation of an FMU leaves behind."""

from dataclasses import dataclass
from typing import Literal, get_args

from ddpc_cosim.variables import FloatArray

Derivatives = Literal["auto", "directional", "differences"]
DERIVATIVES: tuple[str, ...] = get_args(Derivatives)


@dataclass(frozen=True, slots=True)
class LinearModel:
    """A linear model of an FMU about an operating point: dx' = A dx + B du, dy = C dx + D du.

    Parameters
    ----------
    a, b, c, d : array, shapes (n, n), (n, m), (p, n) and (p, m)
        The matrices, in the units of the FMU's variables, and seconds.
    x_0, u_0, y_0 : array, shapes (n,), (m,) and (p,)
        The operating point.
    rate : array, shape (n,)
        Derivatives of the states there [per s]; zero at an equilibrium.
    states : tuple of str
        Names of the states; empty where the FMU does not tell.
    derivatives : str
        Where A and B come from: ``"directional"`` derivatives of the FMU, or ``"differences"``.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    x_0: FloatArray
    u_0: FloatArray
    y_0: FloatArray
    rate: FloatArray
    states: tuple[str, ...]
    derivatives: str
