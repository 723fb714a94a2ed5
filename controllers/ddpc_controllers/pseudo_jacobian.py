"""The pseudo-Jacobian of compact-form dynamic linearisation (14): estimated (16)-(17), forecast (18)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from operator import mul


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimation:
    """Constants of estimation and forecast, in the paper's names.

    Parameters
    ----------
    eta, mu : float
        Step factor and damping of the projection (16).
    epsilon : float
        Smallest input change and smallest gradient that are believed (17).
    delta : float
        Damping of the forecast coefficients' projection (18).
    theta_0 : float
        Initial value of every forecast coefficient.
    n_m : int
        Order of the forecast.
    theta_limit : float
        M: a coefficient vector this long is reset.
    """

    eta: float
    mu: float
    epsilon: float
    delta: float
    theta_0: float
    n_m: int
    theta_limit: float


class PseudoPartialDerivative:
    """One entry of the pseudo-Jacobian: its estimate, its history and its forecast.

    Plain numbers, not arrays: a handful of operations on vectors of length four.

    Parameters
    ----------
    initial : float
        phi_1. Where it is 0 the direction of control is unknown, and no sign or size is held against it.
    constants : Estimation
        See there.
    """

    def __init__(self, initial: float, constants: Estimation) -> None:
        self._initial = initial
        self._constants = constants
        self._theta = [constants.theta_0] * constants.n_m
        self._newest_first = [initial] * (constants.n_m + 1)

    @property
    def value(self) -> float:
        """The estimate phi_k."""
        return self._newest_first[0]

    def update(self, correction: float, excited: bool) -> None:
        """Take the projection's correction, reset where (17) says so, and adapt the forecast (18)."""
        constants, theta, past = self._constants, self._theta, self._newest_first[:-1]
        phi = self._believable(past[0] + correction) if excited else self._initial
        self._newest_first = [phi, *past]

        step = (phi - _dot(theta, past)) / (constants.delta + _dot(past, past))
        theta = [t + step * old for t, old in zip(theta, past, strict=True)]  # (18)
        if _dot(theta, theta) >= constants.theta_limit**2:
            theta = [constants.theta_0] * constants.n_m
        self._theta = theta

    def forecast(self, steps: int) -> list[float]:
        """Return phi_k, ..., phi_k+steps-1."""
        theta, newest_first = self._theta, self._newest_first.copy()
        for _ in range(steps - 1):
            newest_first.insert(0, self._believable(_dot(theta, newest_first)))
        return newest_first[steps - 1 :: -1]

    def _believable(self, phi: float) -> float:
        """Reset a gradient that is too small or has changed its sign (17)."""
        initial = self._initial
        if initial == 0.0 or (phi * initial > 0.0 and abs(phi) >= self._constants.epsilon):
            return phi
        return initial


class PseudoJacobian:
    """The p x m pseudo-Jacobian Phi of dy_k+1 = Phi_k du_k (14).

    Parameters
    ----------
    initial : sequence of sequence of float, shape (p, m)
        Phi_1.
    constants : Estimation
        See there.
    """

    def __init__(self, initial: Sequence[Sequence[float]], constants: Estimation) -> None:
        self._constants = constants
        self._entries = [[PseudoPartialDerivative(phi, constants) for phi in row] for row in initial]

    def update(self, dy: Sequence[float], du: Sequence[float]) -> None:
        """Learn from the last change of the outputs and the change of the inputs before it (16)-(17)."""
        constants = self._constants
        squared = _dot(du, du)
        excited = sqrt(squared) > constants.epsilon
        gain = constants.eta / (constants.mu + squared)
        for change, row in zip(dy, self._entries, strict=True):
            error = gain * (change - _dot([entry.value for entry in row], du))
            for entry, d in zip(row, du, strict=True):
                entry.update(error * d, excited)  # (16)

    def forecast(self, steps: int) -> list[list[list[float]]]:
        """Return phi_k, ..., phi_k+steps-1 of every entry; lists of shape (p, m, steps)."""
        return [[entry.forecast(steps) for entry in row] for row in self._entries]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the inner product over the shorter of two sequences."""
    return float(sum(map(mul, a, b)))
