"""Monomials of a state: the observables that lift it, for models of plants and for controllers alike."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.variables import FloatArray


@dataclass(frozen=True)
class Monomials:
    """Products of a state's coordinates.

    Parameters
    ----------
    factors : sequence of sequence of int
        The numbers of the coordinates that each is the product of; none: it is 1.
    """

    factors: Sequence[Sequence[int]]

    @classmethod
    def between(cls, size: int, lowest: int, highest: int) -> Self:
        """Return all monomials of ``size`` variables of these total degrees, those of lower degree first."""
        return cls(
            [
                list(factors)
                for degree in range(lowest, highest + 1)
                for factors in combinations_with_replacement(range(size), degree)
            ]
        )

    @cached_property
    def _table(self) -> NDArray[np.intp]:
        """The factors, shape (monomials, highest degree), where there are fewer with a 1 behind the state."""
        table = np.full((len(self.factors), max(map(len, self.factors), default=0)), -1, dtype=np.intp)
        for row, chosen in zip(table, self.factors, strict=True):
            row[: len(chosen)] = chosen
        return table

    def __call__(self, states: FloatArray) -> FloatArray:
        """Return the products, shape (..., monomials), of states of shape (..., size)."""
        extended = np.concatenate([states, np.ones((*states.shape[:-1], 1))], axis=-1)
        values = np.ones((*states.shape[:-1], len(self.factors)))
        for chosen in self._table.T:
            values *= extended[..., chosen]
        return values
