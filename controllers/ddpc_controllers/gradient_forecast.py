"""The hierarchical forecast of a pseudo-gradient, equation (18)."""

from dataclasses import dataclass
from itertools import chain
from operator import mul

from ddpc_controllers.pseudo_jacobian import PseudoGradient, dot


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecast:
    """Constants of the forecast, in the paper's names.

    Parameters
    ----------
    delta : float
        Damping of the projection (18).
    theta_0 : float
        Initial value of every forecast coefficient.
    n_m : int
        Order of the forecast.
    theta_limit : float
        M: a coefficient vector this long is reset.
    """

    delta: float
    theta_0: float
    n_m: int
    theta_limit: float


class GradientForecast:
    """The forecast of one row of the pseudo-Jacobian, each coefficient by its own past.

    Parameters
    ----------
    gradient : PseudoGradient
        The row, before its first update.
    constants : Forecast
        See there.
    """

    def __init__(self, gradient: PseudoGradient, constants: Forecast) -> None:
        self._gradient = gradient
        self._constants = constants
        self._theta = [[constants.theta_0] * constants.n_m for _ in gradient.value]
        self._newest_first = [[phi] * (constants.n_m + 1) for phi in gradient.value]

    def update(self) -> None:
        """Adapt the coefficients to the latest estimate (18)."""
        constants = self._constants
        for i, phi in enumerate(self._gradient.value):
            theta, past = self._theta[i], self._newest_first[i][:-1]
            self._newest_first[i] = [phi, *past]
            step = (phi - dot(theta, past)) / (constants.delta + dot(past, past))
            theta = [t + step * old for t, old in zip(theta, past, strict=True)]  # (18)
            if dot(theta, theta) >= constants.theta_limit**2:
                theta = [constants.theta_0] * constants.n_m
            self._theta[i] = theta

    def ahead(self, steps: int) -> list[float]:
        """Return Phi_k, ..., Phi_k+steps-1, one after another."""
        paths = [past.copy() for past in self._newest_first]
        for theta, path in zip(self._theta, paths, strict=True):
            for _ in range(steps - 1):
                path.insert(0, sum(map(mul, theta, path)))
        # Newest first, one coefficient after another: back to the order of time.
        ahead = [path[steps - 1 :: -1] for path in paths]
        if not self._gradient.believes(ahead):
            return self._ahead_with_resets(steps)
        return ahead[0] if len(ahead) == 1 else list(chain.from_iterable(zip(*ahead, strict=True)))

    def _ahead_with_resets(self, steps: int) -> list[float]:
        """Return the same where a forecast is reset, and what follows rests on it."""
        paths = [past.copy() for past in self._newest_first]
        phis = self._gradient.value.copy()
        for _ in range(steps - 1):
            predicted = [dot(theta, path) for theta, path in zip(self._theta, paths, strict=True)]
            phi = self._gradient.believable(predicted)
            for path, value in zip(paths, phi, strict=True):
                path.insert(0, value)
            phis += phi
        return phis
