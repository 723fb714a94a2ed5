"""The data model (14) in its three forms, learned sample by sample.

Every form reads ``dy_k+1 = Phi_k H_k``, where

    H_k = (dy_k, ..., dy_k-Ly+1, du_k, ..., du_k-Lu+1)

holds the latest changes of the p outputs and m inputs: the compact form (CFDL) has Ly = 0 and Lu = 1, the
partial form (PFDL) Ly = 0, the full form (FFDL) Ly >= 1. With H = H_k-1 it is estimated by

    Phi_k = Phi_k-1 + eta (dy_k - Phi_k-1 H) H' / (mu + |H|^2)                                     (16)
    Phi_k = Phi_1 where |H| <= epsilon, |Phi_k| < epsilon or sign(Phi_k) != sign(Phi_1)            (17)

Z. Hou and S. Jin, Model Free Adaptive Control: Theory and Applications, CRC Press, 2013, chapters 3 and 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, sqrt
from operator import mul, sub

import numpy as np

from ddpc_cosim import ConfigError, FloatArray, Recording, Weight


@dataclass(frozen=True, slots=True)
class Regressor:
    """What one output's change is explained by: its part of H.

    Parameters
    ----------
    outputs, inputs : tuple of int
        Which outputs and inputs take part.
    output_length, input_length : int
        Ly and Lu: how many changes of each.
    """

    outputs: tuple[int, ...]
    inputs: tuple[int, ...]
    output_length: int
    input_length: int

    @property
    def output_terms(self) -> int:
        """Number of coefficients of output changes; those of input changes follow."""
        return len(self.outputs) * self.output_length

    def pairs(self) -> tuple[slice, ...]:
        """Return where the coefficients of each input stand, that of its latest change first."""
        first, step = self.output_terms, len(self.inputs)
        return tuple(slice(first + j, None, step) for j in range(step))


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimation:
    """Constants of the estimation, in the paper's names.

    Parameters
    ----------
    eta, mu : float
        Step factor and damping of the projection (16).
    epsilon : float
        Shortest change H and shortest gradient that are trusted (17).
    assume_sign : bool
        The direction of control is known and does not change (Remark 1).
    """

    eta: float
    mu: float
    epsilon: float
    assume_sign: bool = True


class PseudoGradient:
    """One row of the pseudo-Jacobian: how one output follows the changes in H.

    Plain numbers, not arrays: a handful of operations on short vectors.

    Parameters
    ----------
    initial : sequence of float
        Phi_1, in the order of H. Where the coefficient of an input's latest change is 0, its direction of
        control is unknown, and no sign or size is held against it.
    regressor : Regressor
        What the coefficients multiply.
    constants : Estimation
        See there.

    Attributes
    ----------
    value : list of float
        The estimate Phi_k.
    initial : list of float
        Phi_1.
    """

    def __init__(self, initial: Sequence[float], regressor: Regressor, constants: Estimation) -> None:
        self.value = list(initial)
        self.initial = list(initial)
        self._eta, self._mu = constants.eta, constants.mu
        self._epsilon, self._assume_sign = constants.epsilon, constants.assume_sign
        self._output_terms = regressor.output_terms
        # Inputs of known direction: where their coefficients stand, and the one that tells the direction.
        self._known = [
            (pair, pair.start, initial[pair.start])
            for pair in regressor.pairs()
            if initial[pair.start] != 0.0
        ]

    def update(self, dy: float, h: Sequence[float]) -> None:
        """Learn from the change of the output and from H one sample before it (16)-(17)."""
        phi, squared = self.value, dot(h, h)
        if sqrt(squared) > self._epsilon:
            step = self._eta / (self._mu + squared) * (dy - dot(phi, h))  # (16)
            self.value = self.plausible([old + step * change for old, change in zip(phi, h, strict=True)])
        elif self._assume_sign:
            self.value = self.initial.copy()  # without the assumption it may point the wrong way by now

    def plausible(self, phi: list[float]) -> list[float]:
        """Reset what is too short or has changed its sign (17); ``phi`` may be changed.

        Each input is judged by the length of its coefficients and the sign of the first. It is reset without
        the other inputs, but with the coefficients of the outputs' changes, which cannot be told apart.
        """
        epsilon, assume_sign = self._epsilon, self._assume_sign
        for pair, first, direct in self._known:
            now = phi[first]
            right_sign = now * direct > 0.0 or not assume_sign
            if right_sign and (abs(now) >= epsilon or dot(phi[pair], phi[pair]) >= epsilon**2):
                continue
            sign = 1.0 if assume_sign else copysign(1.0, now * direct)
            phi[pair] = [sign * coefficient for coefficient in self.initial[pair]]
            phi[: self._output_terms] = self.initial[: self._output_terms]
        return phi

    def all_plausible(self, paths: Sequence[Sequence[float]]) -> bool:
        """Whether nothing is to be reset, judged by the latest changes of the inputs alone.

        Parameters
        ----------
        paths : sequence of sequence of float
            The values of each coefficient over time.
        """
        for _, first, direct in self._known:
            smallest, largest = min(paths[first]), max(paths[first])
            positive = smallest >= self._epsilon and (direct > 0.0 or not self._assume_sign)
            negative = largest <= -self._epsilon and (direct < 0.0 or not self._assume_sign)
            if not (positive or negative):
                return False
        return True


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the inner product over the shorter of two sequences."""
    product: float = sum(map(mul, a, b))
    return product


@dataclass(frozen=True, slots=True)
class Form:
    """Size and structure of a data model.

    Parameters
    ----------
    outputs, inputs : int
        p and m.
    output_length, input_length : int
        Ly and Lu: 0 and 1 in the compact form, Ly = 0 in the partial form.
    diagonal : bool
        Each output follows its own input and its own past only; p = m.
    """

    outputs: int
    inputs: int
    output_length: int
    input_length: int
    diagonal: bool = False

    def __post_init__(self) -> None:
        if self.diagonal and self.outputs != self.inputs:
            raise ConfigError(
                f'structure = "diagonal" pairs each output with an input; there are {self.outputs} outputs '
                f"and {self.inputs} inputs"
            )

    @property
    def terms(self) -> int:
        """Number of changes in H."""
        return self.outputs * self.output_length + self.inputs * self.input_length

    def regressors(self) -> tuple[Regressor, ...]:
        """Return what explains the change of each output."""
        lengths = self.output_length, self.input_length
        if self.diagonal:
            return tuple(Regressor((i,), (i,), *lengths) for i in range(self.outputs))
        every = Regressor(tuple(range(self.outputs)), tuple(range(self.inputs)), *lengths)
        return (every,) * self.outputs

    def places(self, regressor: Regressor) -> list[int]:
        """Return where the changes of a regressor stand in H."""
        first_input = self.outputs * self.output_length
        return [
            lag * self.outputs + output for lag in range(self.output_length) for output in regressor.outputs
        ] + [
            first_input + lag * self.inputs + channel
            for lag in range(self.input_length)
            for channel in regressor.inputs
        ]

    def initial_gradients(self, given: Weight) -> FloatArray:
        """Return Phi_1, shape (p, terms).

        Parameters
        ----------
        given : number, list or matrix
            The diagonal of the coefficients of the latest input changes, all of these (p x m), or
            everything in the order of H (p x terms). Coefficients that are not given are 0.

        Raises
        ------
        ConfigError
            It has another shape.
        """
        p, m, paired = self.outputs, self.inputs, min(self.outputs, self.inputs)
        values = np.asarray(given, dtype=float)
        if values.shape == (p, self.terms):
            return values
        direct = values
        if values.ndim == 0 or values.shape == (paired,):
            direct = np.zeros((p, m))
            np.fill_diagonal(direct, values)
        if direct.shape != (p, m):
            raise ConfigError(
                f"initial_gradient has shape {values.shape}; needed: a number, {paired} numbers, "
                f"{p} x {m} (outputs x inputs), or {p} x {self.terms} (outputs x changes)"
            )
        gradients = np.zeros((p, self.terms))
        first = p * self.output_length
        gradients[:, first : first + m] = direct
        return gradients


class DataModel:
    """The data model of a loop: what it remembers of the signals, and the estimates.

    Parameters
    ----------
    form : Form
        See there.
    initial : array, shape (p, terms)
        Phi_1.
    constants : Estimation
        Of the estimation (16)-(17).

    Attributes
    ----------
    form : Form
        Its size and structure.
    gradients : list of PseudoGradient
        One row for each output.
    """

    def __init__(self, form: Form, initial: FloatArray, constants: Estimation) -> None:
        self.form = form
        regressors = form.regressors()
        # None: the whole of H.
        self._places = [form.places(regressor) for regressor in regressors] if form.diagonal else None
        rows = (row[form.places(regressor)] for row, regressor in zip(initial, regressors, strict=True))
        self.gradients = [
            PseudoGradient(row.tolist(), regressor, constants)
            for row, regressor in zip(rows, regressors, strict=True)
        ]
        self._y: list[float] | None = None
        self._newest_dy = [0.0] * (form.outputs * form.output_length)
        self._newest_du = [0.0] * (form.inputs * form.input_length)

    def resume(self, recording: Recording) -> None:
        """Go on where a recording ended."""
        form = self.form
        self._y = recording.y[-1].tolist()
        self._newest_dy = _newest_changes(recording.y, form.output_length)
        self._newest_du = _newest_changes(recording.u, form.input_length)

    def observe(self, y: list[float]) -> None:
        """Learn from the outputs of a new sample, if there is one before it."""
        if self._y is None:
            self._y = y
            return
        dy = list(map(sub, y, self._y))
        h = self._newest_dy + self._newest_du
        for i, gradient in enumerate(self.gradients):
            gradient.update(dy[i], h if self._places is None else [h[place] for place in self._places[i]])
        self._y = y
        if self._newest_dy:
            self._newest_dy = (dy + self._newest_dy)[: len(self._newest_dy)]

    def apply(self, du: list[float]) -> None:
        """Take note of the change of the inputs at this sample."""
        self._newest_du = (du + self._newest_du)[: len(self._newest_du)]

    def pause(self) -> None:
        """Forget the signals, not the estimates."""
        self._y = None
        self._newest_dy = [0.0] * len(self._newest_dy)
        self._newest_du = [0.0] * len(self._newest_du)

    @property
    def signals(self) -> tuple[bool, list[float], list[float]]:
        """Whether there is a sample before the next one, its outputs, and the changes up to it."""
        y = [0.0] * self.form.outputs if self._y is None else self._y
        return self._y is not None, y, self._newest_dy + self._newest_du

    @property
    def known(self) -> list[float]:
        """The changes that H_k holds before du_k is decided, newest first: outputs, then inputs."""
        return self._newest_dy + self._newest_du[: len(self._newest_du) - self.form.inputs]


def _newest_changes(signal: FloatArray, length: int) -> list[float]:
    """Return the last changes of a signal, newest first; those before its beginning are 0."""
    changes = np.diff(signal, axis=0)[::-1][:length]
    missing = np.zeros((length - len(changes), signal.shape[1]))
    newest: list[float] = np.concatenate([changes, missing]).ravel().tolist()
    return newest
