"""The pseudo-Jacobian of a dynamic linearisation: its regressor, estimation (16) and reset (17).

Every form of the data model (14) reads ``dy_k+1 = Phi_k H_k``, where

    H_k = (dy_k, ..., dy_k-Ly+1, du_k, ..., du_k-Lu+1)

holds the latest changes of the p outputs and m inputs: the compact form (CFDL) has Ly = 0 and Lu = 1, the
partial form (PFDL) Ly = 0, the full form (FFDL) Ly >= 1. Z. Hou and S. Jin, Model Free Adaptive Control:
Theory and Applications, CRC Press, 2013, chapters 3 and 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, sqrt
from operator import mul


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
        Shortest change H and shortest gradient that are believed (17).
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
    """

    def __init__(self, initial: Sequence[float], regressor: Regressor, constants: Estimation) -> None:
        self.value = list(initial)
        self._initial = list(initial)
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
            step = self._eta / (self._mu + squared) * (dy - dot(phi, h))
            self.value = self.believable([old + step * change for old, change in zip(phi, h, strict=True)])
        elif self._assume_sign:
            self.value = self._initial.copy()  # without the assumption it may point the wrong way by now

    def believable(self, phi: list[float]) -> list[float]:
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
            phi[pair] = [sign * coefficient for coefficient in self._initial[pair]]
            phi[: self._output_terms] = self._initial[: self._output_terms]
        return phi

    def believes(self, paths: Sequence[Sequence[float]]) -> bool:
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
