"""An autoregressive model of changes with known inputs, learned sample by sample.

    dy_k+1 = theta' phi_k + e_k+1 - c e_k,
    phi_k = (dy_k, ..., dy_k-Ly+1, du_k, ..., du_k-Lu+1, dd_k+1, ..., dd_k-Lu+1)

is the CARIMA model ``A(q) dy = B(q) du + T(q) e`` with the observer polynomial ``T = 1 - c/q`` (D. W.
Clarke, C. Mohtadi, P. S. Tuffs, Generalized predictive control, parts I and II, Automatica 23(2), 1987,
doi:10.1016/0005-1098(87)90087-2 and 90088-4). A known disturbance d acts like an input, and may show at once.
As T is known, theta follows from signals filtered by 1/T by least squares.

With P the covariance of theta per unit of noise variance, recursive least squares with forgetting lambda are

    K = P phi / (lambda + phi' P phi),   theta <- theta + K (dy - theta' phi)',
    P <- (P - K phi' P) / lambda,

here on a square root S of ``P = S S'``, so that no rounding makes P indefinite (Potter's algorithm; G. J.
Bierman, Factorization Methods for Discrete Sequential Estimation, 1977).

A loop at rest says nothing, and forgetting all the same makes P grow until noise decides: estimator windup
(K. J. Astrom, B. Wittenmark, Adaptive Control, 2nd ed., 1995, chapter 11). Two of the remedies known
are taken: nothing is learned, nor forgotten, where every prediction is off by no more than a dead zone; and a
sample with which the trace of P would exceed a limit is learned without forgetting. So the trace never
exceeds that limit, or what it began with.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ddpc_cosim import FloatArray, Recording


class RecursiveLeastSquares:
    """Coefficients that are the same linear combination of a regressor for several targets.

    Parameters
    ----------
    coefficients : array, shape (n, p)
        theta to begin with.
    root : array, shape (n, n)
        S to begin with.
    forgetting : float
        Forgetting factor lambda.
    largest_trace : float
        Limit of the trace of P while it forgets.
    dead_zone : float
        Errors of this size teach nothing.

    Attributes
    ----------
    coefficients : array, shape (n, p)
        theta.
    root : array, shape (n, n)
        S.
    """

    def __init__(
        self,
        coefficients: FloatArray,
        root: FloatArray,
        forgetting: float,
        largest_trace: float,
        dead_zone: float = 0.0,
    ) -> None:
        self.coefficients, self.root = coefficients, root
        self._forgetting, self._largest_trace, self._dead_zone = forgetting, largest_trace, dead_zone

    def update(self, regressor: FloatArray, target: FloatArray) -> float:
        """Learn from a sample, shapes (n,) and (p,); return the weight left to those before: lambda or 1."""
        error = target - regressor @ self.coefficients
        if np.abs(error).max() <= self._dead_zone:
            return 1.0
        seen = regressor @ self.root
        kept = self._forgetting
        root, gain = self._learned(seen, kept)
        if np.vdot(root, root) > self._largest_trace:
            kept = 1.0
            root, gain = self._learned(seen, kept)
        self.root = root
        self.coefficients = self.coefficients + np.outer(gain, error)
        return kept

    def _learned(self, seen: FloatArray, kept: float) -> tuple[FloatArray, FloatArray]:
        """Return the new S, and K, given ``S' phi`` and the weight of what came before."""
        size = kept + float(seen @ seen)
        gain = self.root @ seen / size
        share = 1.0 / (1.0 + np.sqrt(kept / size))
        return (self.root - np.outer(share * gain, seen)) / np.sqrt(kept), gain


class Lengths(NamedTuple):
    """What explains a change, and how much of it.

    Parameters
    ----------
    outputs, inputs, disturbances : int
        p, m and n_d.
    output_length, input_length : int
        Ly and Lu.
    """

    outputs: int
    inputs: int
    disturbances: int
    output_length: int
    input_length: int

    @property
    def model_terms(self) -> int:
        """Number of coefficients of the changes of outputs and inputs; those of disturbances follow."""
        return self.outputs * self.output_length + self.inputs * self.input_length

    @property
    def terms(self) -> int:
        """Number n of coefficients for each output."""
        return self.model_terms + self.disturbances * (self.input_length + 1)


class Changes:
    """The changes that phi is made of, as the samples come in, and those filtered by 1/T.

    Parameters
    ----------
    lengths : Lengths
        What phi has.
    filtered : float
        c of ``T = 1 - c/q``.

    Attributes
    ----------
    du, dd : array, shapes (Lu m,), (Lu n_d,)
        The latest changes of inputs and disturbances, newest first.
    dy : array, shape (Ly p,)
        Those of the outputs.
    residual : array, shape (p,)
        e of the newest sample.
    """

    def __init__(self, lengths: Lengths, filtered: float) -> None:
        self._lengths, self._filtered = lengths, filtered
        self.forget()
        self._missing = 0

    def forget(self) -> None:
        """Forget the signals: what comes next teaches nothing until phi is known again."""
        lengths = self._lengths
        self._y: FloatArray | None = None
        self._d = np.zeros(lengths.disturbances)
        self.dy = np.zeros(lengths.outputs * lengths.output_length)
        self.du = np.zeros(lengths.inputs * lengths.input_length)
        self.dd = np.zeros(lengths.disturbances * lengths.input_length)
        self.residual = np.zeros(lengths.outputs)
        self._regressor, self._target = np.zeros(lengths.terms), np.zeros(lengths.outputs)
        self._missing = max(lengths.output_length, lengths.input_length) + 1

    def observe(self, y: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Take outputs and disturbances of a new sample; return what there is to learn, filtered by 1/T.

        Returns
        -------
        pair : (array, array) or None
            phi one sample before, shape (n,), and the change of the outputs since, shape (p,); None where
            some of it is not known.
        """
        if self._y is None:
            self._y, self._d = y.copy(), d.copy()
            return None
        dy, dd = y - self._y, d - self._d
        self._y, self._d = y.copy(), d.copy()
        regressor = np.concatenate([self.dy, self.du, dd, self.dd])
        self.dy = np.concatenate([dy, self.dy])[: len(self.dy)]
        self.dd = np.concatenate([dd, self.dd])[: len(self.dd)]
        self._missing -= self._missing > 0
        if self._missing:
            return None
        self._regressor = regressor + self._filtered * self._regressor
        self._target = dy + self._filtered * self._target
        return self._regressor, self._target

    def judge(self, coefficients: FloatArray) -> None:
        """Note what coefficients, shape (n, p), leave unexplained of the newest sample."""
        self.residual = self._target - self._regressor @ coefficients

    def apply(self, du: FloatArray) -> None:
        """Take the change of the inputs at this sample, shape (m,)."""
        self.du = np.concatenate([du, self.du])[: len(self.du)]

    @property
    def signals(self) -> tuple[FloatArray | float, ...]:
        """What it remembers, for code in C.

        Whether there is a sample before the next one, and how many to come teach nothing; outputs and
        disturbances; their changes and those of the inputs, with room for the next change of disturbances;
        phi and target, filtered; the residual.
        """
        y = np.zeros(self._lengths.outputs) if self._y is None else self._y
        known, dd = float(self._y is not None), np.append(self.dd, np.zeros(len(self._d)))
        changes = np.append(self.dy, self.du)
        return known, self._missing, y, self._d, changes, dd, self._regressor, self._target, self.residual


def recorded_changes(changes: Changes, pieces: Sequence[Recording]) -> tuple[FloatArray, FloatArray]:
    """Return all that pieces of a recording teach: phi, shape (N, n), and targets, shape (N, p).

    ``changes`` goes on from the last sample of the last piece.
    """
    regressors, targets = [], []
    for piece in pieces:
        changes.forget()
        last = piece.u[0]
        for u, y, d in zip(piece.u, piece.y, piece.d, strict=True):
            if pair := changes.observe(y, d):
                regressors.append(pair[0])
                targets.append(pair[1])
            changes.apply(u - last)
            last = u
    return np.array(regressors), np.array(targets)
