"""Quadratic problems written down in named variables as the papers print them, and their parameters."""

from collections.abc import Iterator, Mapping

import numpy as np

from ddpc_cosim import FloatArray

Blocks = Mapping[str, FloatArray]
"""Coefficient blocks by the name of the variable or parameter that they multiply."""


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
    origin : array, shape (rows, parameters)
        ``origin @ p`` are the data rows that g is drawn to; zero where ``|g|`` itself is weighed.
    labels : tuple of str
        What the finite limits are called: the upper ones, and then the lower ones.
    """

    def __init__(
        self, rows: Mapping[str, int], free: Mapping[str, int], parameters: Mapping[str, int]
    ) -> None:
        self.rows, self.free = dict(rows), dict(free)
        self._variables, self._parameters = _places({**rows, **free}), _places(parameters)
        self._width, self._columns = sum(rows.values()) + sum(free.values()), sum(parameters.values())
        self._costs: list[tuple[FloatArray, FloatArray]] = []
        self._equalities: list[tuple[FloatArray, FloatArray]] = []
        self._bounds: list[tuple[str, FloatArray, FloatArray, FloatArray]] = []
        self._wanted: list[FloatArray] = []
        self.weights: tuple[tuple[int, float], ...] = ((self.row_count, 0.0),)
        self.origin = np.zeros((self.row_count, self._columns))

    @property
    def row_count(self) -> int:
        """Number of data rows."""
        return sum(self.rows.values())

    def regularise(self, weight: float | Mapping[str, float], about: str = "") -> None:
        """Add ``weight |g|^2`` to the cost, or weights for what the last blocks of rows add to those above.

        ``about`` names a parameter that holds data rows: their combination takes the place of g = 0.
        """
        last = weight if isinstance(weight, Mapping) else {}
        above = self.row_count - sum(self.rows[name] for name in last)
        first = 0.0 if isinstance(weight, Mapping) else weight
        self.weights = ((above, first), *((self.rows[name], size) for name, size in last.items()))
        if about:
            self.origin[:, self._parameters[about]] = np.eye(self.row_count)

    def penalise(self, weight: FloatArray, variables: Blocks, target: Blocks) -> None:
        """Add ``|sum variables - sum target|^2`` to the cost, each sample weighted by ``weight``."""
        left, right = self._assembled(variables, target)
        root = np.kron(np.eye(len(left) // len(weight)), _square_root(weight))
        self._costs.append((root @ left, root @ right))

    def equate(self, variables: Blocks, target: Blocks) -> None:
        """Require ``sum variables = sum target``."""
        self._equalities.append(self._assembled(variables, target))

    def bound(
        self, variable: str, lower: FloatArray, upper: FloatArray, less: Blocks | None = None, name: str = ""
    ) -> None:
        """Keep every sample of a variable within limits; infinite where there is none.

        With ``less`` it is the variable minus these others; ``name`` is what messages call it.
        """
        blocks = {variable: np.eye({**self.rows, **self.free}[variable])}
        for other, block in (less or {}).items():
            blocks[other] = blocks.get(other, 0.0) - block
        bounded, _ = self._assembled(blocks, {})
        samples = len(bounded) // len(lower)
        limits = np.tile(lower, samples), np.tile(upper, samples)
        self._bounds.append((name or variable, bounded, *limits))

    def ask(self, **counts: int) -> None:
        """Ask for the first entries of variables; where g is drawn to earlier rows, for all new ones too."""
        for name, count in counts.items():
            self._wanted.append(np.eye(self._width)[self._variables[name]][:count])
        if self.origin.any():
            self._wanted.append(np.eye(self.row_count, self._width))

    @property
    def cost(self) -> tuple[FloatArray, FloatArray]:
        """R and T of the cost ``|R x - T p|^2``, shapes (r, variables) and (r, parameters)."""
        return _stacked(self._costs)

    @property
    def equality(self) -> tuple[FloatArray, FloatArray]:
        """E and E_p of ``E x = E_p p``, shapes (e, variables) and (e, parameters)."""
        return _stacked(self._equalities)

    @property
    def bounded(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """C and the limits of C x, shapes (b, variables), (b,) and (b,); infinite where there is none."""
        _, rows, lower, upper = zip(*self._bounds, strict=True)
        return np.vstack(rows), np.concatenate(lower), np.concatenate(upper)

    @property
    def labels(self) -> tuple[str, ...]:
        """What the finite limits are called: the upper ones, and then the lower ones."""
        return (*self._labels("upper"), *self._labels("lower"))

    @property
    def wanted(self) -> FloatArray:
        """Rows that select from x what a solution is asked for, shape (n, variables)."""
        return np.vstack(self._wanted)

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
        for name, _, lower, upper in self._bounds:
            count = np.isfinite(upper if side == "upper" else lower).sum()
            yield from [f"{name} at its {side} bound"] * int(count)


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

    def __reduce__(self) -> tuple[type["ParameterVector"], tuple[Mapping[str, tuple[int, int]], FloatArray]]:
        """Copy the array once: its windows are views, which copies would part from it."""
        return type(self), (self._shapes, self.array)


def _places(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return where each named block stands in the stacked vector."""
    ends = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def _stacked(parts: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    left, right = zip(*parts, strict=True)
    return np.vstack(left), np.vstack(right)


def _square_root(weight: FloatArray) -> FloatArray:
    """Return F with F'F = W."""
    values, vectors = np.linalg.eigh(weight)
    root: FloatArray = np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T
    return root
