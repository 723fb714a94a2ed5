"""Data-driven tracking problems, written down in named variables as the papers print them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ddpc_controllers.condensing import Condenser
from ddpc_cosim import FloatArray

Blocks = Mapping[str, FloatArray]
"""Coefficient blocks by the name of the variable or parameter that they multiply."""


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
    _bounds: list[tuple[str, FloatArray, FloatArray]] = field(default_factory=list, init=False, repr=False)
    _regularisation: float = field(default=0.0, init=False, repr=False)

    def regularise(self, weight: float) -> None:
        """Add ``weight |g|^2`` to the cost."""
        self._regularisation += weight

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

    def bound(self, variable: str, lower: FloatArray, upper: FloatArray) -> None:
        """Keep every sample of a variable within limits; infinite where there is none."""
        samples = {**self.rows, **self.free}[variable] // len(lower)
        self._bounds.append((variable, np.tile(lower, samples), np.tile(upper, samples)))

    def prepare(self, move: str, inputs: int) -> Condenser:
        """Assemble what does not depend on the data; the first ``inputs`` entries of ``move`` are applied."""
        variables = _places({**self.rows, **self.free})
        parameters = _places(self.parameters)

        def assembled(left: Blocks, right: Blocks) -> tuple[FloatArray, FloatArray]:
            rows = _row_count(left)
            return _assemble(left, variables, rows), _assemble(right, parameters, rows)

        costs = [(root, *assembled(left, right)) for root, left, right in self._costs]
        equalities = [assembled(left, right) for left, right in self._equalities]
        return Condenser(
            row_count=sum(self.rows.values()),
            regularisation=self._regularisation,
            residual=np.vstack([root @ left for root, left, _ in costs]),
            target=np.vstack([root @ right for root, _, right in costs]),
            equality=np.vstack([left for left, _ in equalities]),
            equality_target=np.vstack([right for _, right in equalities]),
            bounded=np.vstack([_selection(name, variables) for name, _, _ in self._bounds]),
            lower=np.concatenate([lower for _, lower, _ in self._bounds]),
            upper=np.concatenate([upper for _, _, upper in self._bounds]),
            move=_selection(move, variables)[:inputs],
        )


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
