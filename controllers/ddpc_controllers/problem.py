"""Data-driven tracking problems, written down in named variables as the papers print them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from ddpc_controllers.condensing import Condenser
from ddpc_controllers.regularisation import Regularisation
from ddpc_cosim import FloatArray

Blocks = Mapping[str, FloatArray]
"""Coefficient blocks by the name of the variable or parameter that they multiply."""


class _Bounded(NamedTuple):
    """A bounded quantity: its name, its coefficients and its limits, one for each row."""

    name: str
    blocks: Blocks
    lower: FloatArray
    upper: FloatArray


@dataclass
class Problem:
    """A quadratic problem in named variables, affine in named parameters.

    Parameters
    ----------
    rows : mapping of str to int
        Sizes of the data rows ``h = M g`` (pasts, u, y), stacked in this order in M.
    free : mapping of str to int
        Sizes of the other variables (artificial setpoints); the combination g itself goes without saying.
    parameters : mapping of str to int
        Sizes of what changes from sample to sample, stacked in this order in p; the last is the constant 1.
    """

    rows: Mapping[str, int]
    free: Mapping[str, int]
    parameters: Mapping[str, int]
    _costs: list[tuple[FloatArray, Blocks, Blocks]] = field(default_factory=list, init=False, repr=False)
    _equalities: list[tuple[Blocks, Blocks]] = field(default_factory=list, init=False, repr=False)
    _bounds: list[_Bounded] = field(default_factory=list, init=False, repr=False)
    _regularisation: Regularisation | None = field(default=None, init=False, repr=False)
    _about: str = field(default="", init=False, repr=False)

    def regularise(self, weight: float | Regularisation, about: str = "") -> None:
        """Add ``weight |g|^2`` to the cost, or what a regularisation makes of it.

        ``about`` names a parameter that holds data rows: their combination takes the place of g = 0.
        """
        if not isinstance(weight, Regularisation):
            weight = Regularisation((sum(self.rows.values()),), (weight,))
        self._regularisation, self._about = weight, about

    def penalise(self, weight: FloatArray, variables: Blocks, target: Blocks) -> None:
        """Add ``|sum variables - sum target|^2`` to the cost, each sample weighted by ``weight``."""
        samples = _row_count(variables) // len(weight)
        roots: FloatArray = np.kron(np.eye(samples, dtype=np.float64), _square_root(weight)).astype(
            np.float64
        )
        self._costs.append((roots, variables, target))

    def equate(self, variables: Blocks, target: Blocks) -> None:
        """Require ``sum variables = sum target``."""
        self._equalities.append((variables, target))

    def bound(
        self, variable: str, lower: FloatArray, upper: FloatArray, less: Blocks | None = None, name: str = ""
    ) -> None:
        """Keep every sample of a variable within limits; infinite where there is none.

        With ``less`` it is the variable minus these others; ``name`` is what messages call it.
        """
        size = {**self.rows, **self.free}[variable]
        blocks = {variable: np.eye(size)}
        for other, block in (less or {}).items():
            blocks[other] = blocks.get(other, 0.0) - block
        samples = size // len(lower)
        self._bounds.append(
            _Bounded(name or variable, blocks, np.tile(lower, samples), np.tile(upper, samples))
        )

    def prepare(self, move: str, inputs: int, outputs: int = 0) -> Condenser:
        """Assemble what does not depend on the data.

        The first ``inputs`` entries of ``move`` are applied. After them the first ``outputs`` entries of y
        are asked for, and, where the regularisation is about earlier data rows, all new ones.
        """
        variables = _places({**self.rows, **self.free})
        parameters = _places(self.parameters)
        row_count = sum(self.rows.values())
        origin = np.zeros((row_count, sum(self.parameters.values())))
        wanted = np.vstack([_selection(move, variables)[:inputs], _selection("y", variables)[:outputs]])
        if self._about:
            origin[:, parameters[self._about]] = np.eye(row_count)
            wanted = np.vstack([wanted, np.eye(row_count, wanted.shape[1])])

        def assembled(left: Blocks, right: Blocks) -> tuple[FloatArray, FloatArray]:
            rows = _row_count(left)
            return _assemble(left, variables, rows), _assemble(right, parameters, rows)

        costs = [(root, *assembled(left, right)) for root, left, right in self._costs]
        equalities = [assembled(left, right) for left, right in self._equalities]
        return Condenser(
            row_count=row_count,
            regularisation=self._regularisation or Regularisation((row_count,), (0.0,)),
            origin=origin,
            residual=np.vstack([root @ left for root, left, _ in costs]),
            target=np.vstack([root @ right for root, _, right in costs]),
            equality=np.vstack([left for left, _ in equalities]),
            equality_target=np.vstack([right for _, right in equalities]),
            bounded=np.vstack([_assemble(b.blocks, variables, len(b.lower)) for b in self._bounds]),
            lower=np.concatenate([b.lower for b in self._bounds]),
            upper=np.concatenate([b.upper for b in self._bounds]),
            labels=(*self._labels("upper"), *self._labels("lower")),
            move=wanted,
        )

    def _labels(self, side: Literal["lower", "upper"]) -> Iterator[str]:
        """Name the finite limits on one side."""
        for bounded in self._bounds:
            limits: FloatArray = getattr(bounded, side)
            yield from [f"{bounded.name} at its {side} bound"] * int(np.isfinite(limits).sum())


def _square_root(weight: FloatArray) -> FloatArray:
    """Return F with F'F = W."""
    values, vectors = np.linalg.eigh(weight)
    root: FloatArray = np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T
    return root


def _places(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return where each named block stands in the stacked vector."""
    places = {}
    start = 0
    for name, size in sizes.items():
        places[name] = slice(start, start + size)
        start += size
    return places


def _row_count(blocks: Blocks) -> int:
    return len(next(iter(blocks.values())))


def _assemble(blocks: Blocks, places: Mapping[str, slice], rows: int) -> FloatArray:
    """Write named blocks side by side, zero elsewhere."""
    matrix = np.zeros((rows, max(place.stop for place in places.values())))
    for name, block in blocks.items():
        matrix[:, places[name]] += block
    return matrix


def _selection(name: str, places: Mapping[str, slice]) -> FloatArray:
    """Return the rows that select one variable from the stacked vector."""
    size = places[name].stop - places[name].start
    return _assemble({name: np.eye(size)}, places, size)
