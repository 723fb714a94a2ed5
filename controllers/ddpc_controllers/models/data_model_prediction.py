"""N steps of the data model ``dy_k+1 = Phi_k H_k`` at once: ``Y = E y_k + f + A dU``.

Written down for the samples k ... k+N-1, the model is one banded system in known changes (the past),
decided ones (dU) and those to come (dY):

    dY = W_known known + W_decided dU + W_coming dY.

W_coming is strictly lower triangular, so that forward substitution runs the recursion; the sums of dY over
time are Y - E y_k. For the compact form nothing but A remains, as printed before (19).

The pseudo-gradients of the coming samples are forecast from their own past, coefficient by coefficient,

    phi_k+j = theta_1 phi_k+j-1 + ... + theta_nm phi_k+j-nm,   reset as in (17)
    theta <- theta + past (phi_k - past' theta) / (delta + |past|^2),  past = (phi_k-1, ..., phi_k-nm)    (18)

where theta is reset to its initial value when its length reaches M.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from operator import mul

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.typing import NDArray

from ddpc_controllers.export.code import Code
from ddpc_controllers.models.data_model import PseudoGradient, Regressor, dot
from ddpc_cosim import FloatArray


class LinearisedPrediction:
    """The banded system of one data model.

    Parameters
    ----------
    regressors : sequence of Regressor, one for each of the p outputs
        What explains the change of each output; Ly and Lu are the same for all.
    inputs : int
        Number m of inputs.
    horizon, control_horizon : int
        N and Nu <= N: the inputs change at the first Nu samples.
    """

    def __init__(
        self, regressors: Sequence[Regressor], inputs: int, horizon: int, control_horizon: int
    ) -> None:
        self._arguments = regressors, inputs, horizon, control_horizon
        layout = _Layout.of(regressors, inputs, horizon)
        p, decided = len(regressors), control_horizon * inputs
        feeds_back = regressors[0].output_length > 0
        system = np.zeros((horizon * p, layout.coming + feeds_back * horizon * p))
        self._flat = system.reshape(-1)
        self._entries = _entries(layout, tuple(regressors), horizon, system.shape[1])
        self._known = system[:, : layout.decided] if layout.decided else None
        self._decided = system[:, layout.decided : layout.decided + decided]
        self._coming = system[:, layout.coming :] if feeds_back else None
        # The last column is what the known changes do.
        self._changes = np.zeros((horizon * p, decided + (layout.decided > 0)))
        self._by_sample = horizon, p, self._changes.shape[1]
        self._no_known = np.zeros(horizon * p)

    def __call__(
        self, gradients: Sequence[float], known: Sequence[float], acting: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return A and f of ``Y = E y_k + f + A dU``.

        Parameters
        ----------
        gradients : sequence of float
            For each output its row of Phi_k, ..., Phi_k+N-1, one after another.
        known : sequence of float
            dy_k, dy_k-1, ... (Ly of them), then du_k-1, du_k-2, ... (Lu - 1 of them).
        acting : array, shape (N p,), optional
            What else changes the outputs at each sample, where there are known changes; default: nothing.

        Returns
        -------
        a : array, shape (N p, Nu m)
            How the outputs follow the changes of the inputs, samples along both axes.
        f : array, shape (N p,)
            How far past changes still move the outputs.
        """
        self._flat[self._entries] = gradients
        if self._known is None:
            return self._summed(self._decided), self._no_known
        changes = self._changes
        changes[:, :-1] = self._decided
        changes[:, -1] = self._known @ known
        if acting is not None:
            changes[:, -1] += acting
        if self._coming is not None:
            # The diagonal counts as 1.
            changes = scipy.linalg.blas.dtrsm(1.0, -self._coming, changes, lower=1, diag=1)
        sums = self._summed(changes)
        return sums[:, :-1], sums[:, -1]

    def in_c(self, code: Code) -> tuple[str, str]:
        """Add the sizes to code in C; return their name, and the initialiser of what they need in memory."""
        regressors, inputs, horizon, control_horizon = self._arguments
        first, p, n = regressors[0], len(regressors), control_horizon * inputs
        prediction = code.constant(
            "LinearisedPrediction",
            p=p,
            m=inputs,
            output_length=first.output_length,
            input_length=first.input_length,
            diagonal=len(first.inputs) < inputs,
            horizon=horizon,
            control_horizon=control_horizon,
        )
        terms, rows = first.output_terms + len(first.inputs) * first.input_length, horizon * p
        sizes = (rows * terms, rows * (n + 1), rows, n * n, n * n, n, n, (rows + n) * n)
        return prediction, f"{{{', '.join(code.scratch(*sizes))}}}"

    def _summed(self, changes: FloatArray) -> FloatArray:
        """Return the sums of the rows over time."""
        sums: FloatArray = np.add.accumulate(changes.reshape(self._by_sample))
        return sums.reshape(changes.shape)

    def __reduce__(self) -> tuple[type["LinearisedPrediction"], tuple[Sequence[Regressor], int, int, int]]:
        """Copy what it is made from: its blocks are views, which copies would part from the system."""
        return type(self), self._arguments


@dataclass(frozen=True, slots=True)
class _Layout:
    """The columns of the system: known changes, then decided ones, then those to come.

    Parameters
    ----------
    outputs, inputs, output_length : int
        p, m and Ly.
    decided, coming : int
        First column of the decided changes and of those to come.
    """

    outputs: int
    inputs: int
    output_length: int
    decided: int
    coming: int

    @classmethod
    def of(cls, regressors: Sequence[Regressor], inputs: int, horizon: int) -> "_Layout":
        p, lengths = len(regressors), regressors[0]
        known = lengths.output_length * p + (lengths.input_length - 1) * inputs
        return cls(p, inputs, lengths.output_length, known, known + horizon * inputs)

    def columns(self, regressor: Regressor, j: int) -> list[int]:
        """Return the columns of H_k+j, in its order."""
        return [
            self._output_column(j - lag, output)
            for lag in range(regressor.output_length)
            for output in regressor.outputs
        ] + [
            self._input_column(j - lag, channel)
            for lag in range(regressor.input_length)
            for channel in regressor.inputs
        ]

    def _output_column(self, later: int, output: int) -> int:
        """Return the column of dy_k+later."""
        if later > 0:
            return self.coming + (later - 1) * self.outputs + output
        return -later * self.outputs + output

    def _input_column(self, later: int, channel: int) -> int:
        """Return the column of du_k+later."""
        if later >= 0:
            return self.decided + later * self.inputs + channel
        return self.output_length * self.outputs + (-later - 1) * self.inputs + channel


@lru_cache(maxsize=16)  # those who control many plants of one kind ask again
def _entries(
    layout: _Layout, regressors: tuple[Regressor, ...], horizon: int, width: int
) -> NDArray[np.intp]:
    """Return where the rows of Phi_k, ..., Phi_k+N-1 stand in the system, for each output after another."""
    entries = np.array(
        [
            (j * len(regressors) + output) * width + column
            for output, regressor in enumerate(regressors)
            for j in range(horizon)
            for column in layout.columns(regressor, j)
        ]
    )
    entries.flags.writeable = False
    return entries


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

    Attributes
    ----------
    theta, newest_first : list of list of float
        The coefficients of the forecast of each one of the row, and its latest values.
    """

    def __init__(self, gradient: PseudoGradient, constants: Forecast) -> None:
        self._gradient = gradient
        self._constants = constants
        self.theta = [[constants.theta_0] * constants.n_m for _ in gradient.value]
        self.newest_first = [[phi] * (constants.n_m + 1) for phi in gradient.value]

    def update(self) -> None:
        """Adapt the coefficients to the latest estimate (18)."""
        constants = self._constants
        for i, phi in enumerate(self._gradient.value):
            theta, past = self.theta[i], self.newest_first[i][:-1]
            self.newest_first[i] = [phi, *past]
            step = (phi - dot(theta, past)) / (constants.delta + dot(past, past))
            theta = [t + step * old for t, old in zip(theta, past, strict=True)]  # (18)
            if dot(theta, theta) >= constants.theta_limit**2:
                theta = [constants.theta_0] * constants.n_m
            self.theta[i] = theta

    def ahead(self, steps: int) -> list[float]:
        """Return Phi_k, ..., Phi_k+steps-1, one after another."""
        paths = [past.copy() for past in self.newest_first]
        for theta, path in zip(self.theta, paths, strict=True):
            for _ in range(steps - 1):
                path.insert(0, sum(map(mul, theta, path)))
        # Newest first, one coefficient after another: back to the order of time.
        ahead = [path[steps - 1 :: -1] for path in paths]
        if not self._gradient.all_plausible(ahead):
            return self._ahead_with_resets(steps)
        return ahead[0] if len(ahead) == 1 else list(chain.from_iterable(zip(*ahead, strict=True)))

    def _ahead_with_resets(self, steps: int) -> list[float]:
        """Return the same where a forecast is reset, and what follows rests on it."""
        paths = [past.copy() for past in self.newest_first]
        phis = self._gradient.value.copy()
        for _ in range(steps - 1):
            predicted = [dot(theta, path) for theta, path in zip(self.theta, paths, strict=True)]
            phi = self._gradient.plausible(predicted)
            for path, value in zip(paths, phi, strict=True):
                path.insert(0, value)
            phis += phi
        return phis
