"""N steps of the data model ``dy_k+1 = Phi_k H_k`` at once: ``Y = E y_k + f + A dU``.

Written down for the samples k ... k+N-1, the model is one banded system in known changes (the past),
decided ones (dU) and those to come (dY):

    dY = W_known known + W_decided dU + W_coming dY.

W_coming is strictly lower triangular, so that forward substitution runs the recursion; the sums of dY over
time are Y - E y_k. For the compact form nothing but A remains, as printed before (19).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtrsm

from ddpc_controllers.pseudo_jacobian import Regressor
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
        self._entries = np.array(
            [
                (j * p + output) * system.shape[1] + column
                for output, regressor in enumerate(regressors)
                for j in range(horizon)
                for column in layout.columns(regressor, j)
            ]
        )
        self._known = system[:, : layout.decided] if layout.decided else None
        self._decided = system[:, layout.decided : layout.decided + decided]
        self._coming = system[:, layout.coming :] if feeds_back else None
        # The last column is what the known changes do.
        self._changes = np.zeros((horizon * p, decided + (layout.decided > 0)))
        self._by_sample = horizon, p, self._changes.shape[1]
        self._no_known = np.zeros(horizon * p)

    def __call__(self, gradients: Sequence[float], known: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Return A and f of ``Y = E y_k + f + A dU``.

        Parameters
        ----------
        gradients : sequence of float
            For each output its row of Phi_k, ..., Phi_k+N-1, one after another.
        known : sequence of float
            dy_k, dy_k-1, ... (Ly of them), then du_k-1, du_k-2, ... (Lu - 1 of them).

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
        if self._coming is not None:
            changes = dtrsm(1.0, -self._coming, changes, lower=1, diag=1)  # the diagonal counts as 1
        sums = self._summed(changes)
        return sums[:, :-1], sums[:, -1]

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
