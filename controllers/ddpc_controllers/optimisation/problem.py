"""Quadratic problems written down in named variables as the papers print them, and their parameters."""

from collections.abc import Iterator, Mapping
from copy import copy
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from ddpc_cosim import FloatArray

Blocks = Mapping[str, FloatArray]
"""Coefficient blocks by the name of the variable or parameter that they multiply."""

BAND_OF_Y = "band of y"
"""What the edges of bands are called, as bounds."""


class _Equality(NamedTuple):
    """Rows over x and over p that are equal, and the weight of their difference where they give way."""

    left: FloatArray
    right: FloatArray
    relaxed: float


class Limits(NamedTuple):
    """Rows over x, the limits of each of them over p, and how far these are apart.

    Parameters
    ----------
    rows : array, shape (b, variables)
        What is limited.
    lower, upper : arrays, shape (b, parameters)
        Its limits as functions of p. Where there is none the last entry, that of the 1, is infinite.
    span : array, shape (b,)
        Upper less lower limit, of those that move the outermost; infinite where there is none.
    """

    rows: FloatArray
    lower: FloatArray
    upper: FloatArray
    span: FloatArray


class _Bound(NamedTuple):
    """What a limited quantity is called, its rows and limits, and the weight of an excess."""

    name: str
    limits: Limits
    relaxed: float


class Problem:
    """A quadratic problem in named variables x, affine in named parameters p.

    Parameters
    ----------
    rows : mapping of str to int
        Sizes of the data rows ``h = M g`` (pasts, u, y), stacked in this order in M: the first part of x.
    free : mapping of str to int
        Sizes of the other variables (artificial setpoints); the combination g itself goes without saying.
    parameters : mapping of str to int
        Sizes of what changes from sample to sample, stacked in this order in p; the last is the constant 1.

    Attributes
    ----------
    weights : tuple of (int, float)
        What g costs, block by block of the data rows from the top: number of rows and weight. One block
        weighs ``|g|^2``; see :func:`~ddpc_controllers.optimisation.condensing.factorise` for more.
    origin : (array, array), shapes (rows, variables) and (rows, parameters)
        The data rows that g is drawn to, as functions of x and p: those of its smallest combination. Zero
        where ``|g|`` itself is weighed.
    origin_weights : tuple of float
        What that smallest combination costs itself, block by block as in ``weights``.
    paid : array, shape (parameters, variables)
        K of what the cost has beside squares, ``p' K x``: see :meth:`charge`.
    labels : tuple of str
        What the finite limits are called: the upper ones, and then the lower ones.
    given_up : tuple of str
        What :meth:`relaxed` has made of a problem that cannot be solved as it was written down.
    softened : bool
        Whether bounds that can give way at a cost do so.
    advice : str
        What keeps the optimum determined, for the error where it is not.
    """

    def __init__(
        self, rows: Mapping[str, int], free: Mapping[str, int], parameters: Mapping[str, int]
    ) -> None:
        self.rows, self.free = dict(rows), dict(free)
        self._variables, self._parameters = _places({**rows, **free}), _places(parameters)
        self._width, self._columns = sum(rows.values()) + sum(free.values()), sum(parameters.values())
        self._costs: list[tuple[FloatArray, FloatArray]] = []
        self._equalities: list[_Equality] = []
        self._bounds: list[_Bound] = []
        self.paid = np.zeros((self._columns, self._width))
        self.given_up: tuple[str, ...] = ()
        self.softened = False
        self.advice = ""
        self._wanted: list[FloatArray] = []
        self.weights: tuple[tuple[int, float], ...] = ((self.row_count, 0.0),)
        self.origin = np.zeros((self.row_count, self._width)), np.zeros((self.row_count, self._columns))
        self.origin_weights: tuple[float, ...] = (0.0,)

    @property
    def row_count(self) -> int:
        """Number of data rows."""
        return sum(self.rows.values())

    def regularise(self, weight: float | Mapping[str, float]) -> None:
        """Add ``weight |g|^2`` to the cost, or weights of what the last blocks of rows add to those above."""
        last = weight if isinstance(weight, Mapping) else {}
        above = self.row_count - sum(self.rows[name] for name in last)
        first = 0.0 if isinstance(weight, Mapping) else weight
        self.weights = ((above, first), *((self.rows[name], size) for name, size in last.items()))

    def regularise_about(self, rows: Mapping[str, Blocks], weight: float, about: Mapping[str, float]) -> None:
        """Add ``weight |g - g_s|^2`` to the cost, g_s being the smallest combination with given data rows.

        ``rows`` has coefficients of parameters or, where there is none of a name, variables for each block of
        data rows; ``about`` has weights of what the last blocks of rows add to g_s.
        """
        above = self.row_count - sum(self.rows[name] for name in about)
        self.weights = ((above, weight), *((self.rows[name], weight) for name in about))
        self.origin_weights = (0.0, *about.values())
        of_x, of_p = self.origin
        for row, blocks in rows.items():
            for name, block in blocks.items():
                part, place = (
                    (of_p, self._parameters) if name in self._parameters else (of_x, self._variables)
                )
                part[self._variables[row], place[name]] = block

    def penalise(self, weight: FloatArray, variables: Blocks, target: Blocks) -> None:
        """Add ``|sum variables - sum target|^2`` to the cost, each sample weighted by ``weight``."""
        root, sides = _square_root(weight), self._assembled(variables, target)
        # Sample by sample: the product with a matrix of all samples would be zeros for the most part.
        of_samples = (side.reshape(-1, len(root), side.shape[1]) for side in sides)
        left, right = (root @ samples for samples in of_samples)
        self._costs.append((left.reshape(sides[0].shape), right.reshape(sides[1].shape)))

    def charge(self, prices: str, variable: str, amounts: FloatArray) -> None:
        """Add ``prices' amounts variable`` to the cost: parameters that are prices of amounts.

        It has no curvature: the squares of the cost have to keep it bounded.
        """
        self.paid[self._parameters[prices], self._variables[variable]] += amounts

    def equate(self, variables: Blocks, target: Blocks, relaxed: float = 0.0) -> None:
        """Require ``sum variables = sum target``; ``relaxed`` weighs misses where that gives way."""
        self._equalities.append(_Equality(*self._assembled(variables, target), relaxed))

    def bound(
        self,
        variable: str,
        lower: FloatArray,
        upper: FloatArray,
        less: Blocks | None = None,
        name: str = "",
        relaxed: float = 0.0,
        moving: tuple[Blocks, Blocks] | None = None,
        rows: FloatArray | None = None,
    ) -> None:
        """Keep every sample of a variable within limits; infinite where there is none.

        With ``less`` it is the variable minus these others; ``name`` is what messages call it; ``relaxed`` is
        the weight of an excess where the limits give way. With ``moving`` the limits, lower and upper, are
        these combinations of parameters; ``lower`` and ``upper`` are the outermost then, and infinite where
        there is none. ``rows`` are what of the variable is limited; default: all of it.
        """
        blocks = {variable: np.eye({**self.rows, **self.free}[variable]) if rows is None else rows}
        for other, block in (less or {}).items():
            blocks[other] = blocks.get(other, 0.0) - block
        bounded, _ = self._assembled(blocks, {})
        samples = len(bounded) // len(lower)
        outermost = [np.concatenate([limits] * samples) for limits in (lower, upper)]
        sides = list[FloatArray]()
        for limit, blocks_of_p in zip(outermost, moving or ({}, {}), strict=True):
            _, side = self._assembled({variable: blocks[variable]}, blocks_of_p)
            side[:, -1] = limit if moving is None else np.where(np.isfinite(limit), side[:, -1], limit)
            sides.append(side)
        limits = Limits(bounded, sides[0], sides[1], outermost[1] - outermost[0])
        self._bounds.append(_Bound(name or variable, limits, relaxed))

    def relaxed(self) -> "Problem | None":
        """Return the next easier problem, None if there is none.

        First what equalities there are to give way (the terminal condition) become costs, then bounds (of
        outputs) too.
        """
        easier = copy(self)
        if any(equality.relaxed for equality in self._equalities):
            costs = [
                (weight**0.5 * left, weight**0.5 * right)
                for left, right, weight in self._equalities
                if weight
            ]
            easier._costs = [*self._costs, *costs]
            easier._equalities = [equality for equality in self._equalities if not equality.relaxed]
            easier.given_up = (*self.given_up, "terminal condition relaxed")
            return easier
        if self.softened or not any(bound.relaxed for bound in self._bounds):
            return None
        easier.softened, easier.given_up = True, (*self.given_up, "output bounds softened")
        return easier

    def ask(self, **counts: int) -> None:
        """Ask for the first entries of variables, or for the last with a negative count."""
        for name, count in counts.items():
            chosen = slice(count) if count >= 0 else slice(count, None)
            self._wanted.append(np.eye(self._width)[self._variables[name]][chosen])

    @property
    def cost(self) -> tuple[FloatArray, FloatArray]:
        """R and T of the cost ``|R x - T p|^2``, shapes (r, variables) and (r, parameters)."""
        return _stacked(self._costs)

    @property
    def equality(self) -> tuple[FloatArray, FloatArray]:
        """E and E_p of ``E x = E_p p``, shapes (e, variables) and (e, parameters)."""
        return _stacked([(left, right) for left, right, _ in self._equalities])

    @property
    def bounded(self) -> Limits:
        """C and the limits of C x."""
        rows, lower, upper, span = zip(*(bound.limits for bound in self._bounds), strict=True)
        return Limits(*map(np.concatenate, (rows, lower, upper, span)))

    @property
    def excess_weights(self) -> FloatArray:
        """Weights of the squares of what the rows C x may be beyond their limits, 0 where they may not."""
        weights = [bound.relaxed for bound in self._bounds]
        return np.repeat(weights, [len(bound.limits.rows) for bound in self._bounds])

    @property
    def labels(self) -> tuple[str, ...]:
        """What the finite limits are called: the upper ones, and then the lower ones."""
        return (*self._labels("upper"), *self._labels("lower"))

    @property
    def wanted(self) -> FloatArray:
        """Rows that select from x what a solution is asked for, shape (n, variables)."""
        return np.concatenate(self._wanted)

    def _assembled(self, variables: Blocks, parameters: Blocks) -> tuple[FloatArray, FloatArray]:
        """Write blocks side by side, zero elsewhere: those of x, and those of p."""
        rows = len(next(iter(variables.values())))
        left, right = np.zeros((rows, self._width)), np.zeros((rows, self._columns))
        for name, block in variables.items():
            left[:, self._variables[name]] += block
        for name, block in parameters.items():
            right[:, self._parameters[name]] += block
        return left, right

    def _labels(self, side: str) -> Iterator[str]:
        for name, limits, _ in self._bounds:
            count = np.isfinite((limits.upper if side == "upper" else limits.lower)[:, -1]).sum()
            yield from [f"{name} at its {side} bound"] * int(count)


def sample_by_sample(samples: FloatArray, block: FloatArray) -> FloatArray:
    """Return the Kronecker product: a block for one sample, at samples of the horizon, the rows of I_N."""
    product = samples[:, np.newaxis, :, np.newaxis] * block[:, np.newaxis, :]
    return np.asarray(product.reshape(-1, samples.shape[1] * block.shape[1]))


class ParameterVector:
    """The parameters of a problem: named windows of signals in one array, then a constant 1.

    Parameters
    ----------
    windows : mapping of str to (int, int)
        Length and width of each window.
    array : array, shape (parameters,), optional
        Values to begin with.

    Attributes
    ----------
    array : array, shape (parameters,)
        All windows and the 1; changed in place.
    sizes : dict of str to int
        Number of entries by name, in the order of the array.
    """

    def __init__(self, windows: Mapping[str, tuple[int, int]], array: FloatArray | None = None) -> None:
        self._shapes = dict(windows)
        self.sizes = {name: length * width for name, (length, width) in windows.items()} | {"one": 1}
        self.array = np.zeros(sum(self.sizes.values())) if array is None else array
        self.array[-1] = 1.0
        self._windows: dict[str, FloatArray] = {}
        self._moves: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {}
        for name, place in _places(self.sizes).items():
            if name in windows:
                window = self._windows[name] = self.array[place].reshape(windows[name])
                self._moves[name] = window[:-1], window[1:], window[-1]

    def fill(self, name: str, values: FloatArray) -> None:
        """Set a window, shape (length, width), time along axis 0; a single sample fills all of it."""
        self._windows[name][...] = values

    def window(self, name: str) -> FloatArray:
        """Return a window, shape (length, width), time along axis 0: a view of the array."""
        return self._windows[name]

    def append(self, name: str, sample: FloatArray) -> None:
        """Forget a window's oldest sample and append one, shape (width,)."""
        older, newer, newest = self._moves[name]
        older[...] = newer
        newest[...] = sample

    def shift(self, name: str) -> None:
        """Forget a window's oldest sample; the newest stands there twice until it is set."""
        older, newer, _ = self._moves[name]
        older[...] = newer

    def __reduce__(self) -> tuple[type["ParameterVector"], tuple[Mapping[str, tuple[int, int]], FloatArray]]:
        """Copy the array once: its windows are views, which copies would part from it."""
        return type(self), (self._shapes, self.array)


def _places(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return where each named block stands in the stacked vector."""
    ends = accumulate(sizes.values())
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def _stacked(parts: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    left, right = zip(*parts, strict=True)
    return np.concatenate(left), np.concatenate(right)


def _square_root(weight: FloatArray) -> FloatArray:
    """Return F with F'F = W."""
    if weight.size == 1:
        return np.sqrt(np.maximum(weight, 0.0))
    values, vectors = np.linalg.eigh(weight)
    root: FloatArray = np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T
    return root
