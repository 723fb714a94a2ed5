"""The QP solvers: of ``minimise |t|^2 subject to excess + gain t <= 0``, and of large sparse problems.

The former are asked for the active set first: its exact law has more digits than any solver's answer. Where
none can find an optimum, :func:`contradiction` finds what contradicts what.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np
import piqp
import scipy  # whose parts are imported when they are first used

from ddpc_cosim import FloatArray, MissingLibraryError

BackendName = Literal["piqp", "daqp"]
BACKENDS: tuple[str, ...] = get_args(BackendName)

ActiveSet = tuple[int, ...]
"""Numbers of the bounds that hold with equality."""

_PIQP_TOLERANCE = 1e-12
"""Tolerances of PIQP, all of them: its defaults leave errors of 3e-4 in the input."""

_DAQP_TOLERANCE = 1e-10
_SPARSE_TOLERANCE = 1e-13
_DAQP_INFEASIBLE = -1
_EXCEEDED = 1e-8
_CONTRADICTION = 1e-6
_INSIGNIFICANT = 1e-9
_ROUNDED = 1e-14
_DEPENDENT = 1e-20
_ITERATIONS = 10


class Answer(NamedTuple):
    """What a solver found.

    Parameters
    ----------
    t : array, shape (k,)
        The optimum, or where the solver stopped.
    active : tuple of int
        Which bounds it holds to be active.
    failure : str
        The solver's word for why ``t`` is not the optimum; empty if it is.
    """

    t: FloatArray
    active: ActiveSet
    failure: str


class Backend(Protocol):
    """A solver for one gain and many excesses."""

    def load(self, gain: FloatArray) -> None:
        """Take the gain of the problems to come, shape (n, k)."""

    def solve(self, excess: FloatArray) -> Answer:
        """Solve for one excess, shape (n,)."""


class _ScaledProblems:
    """Bounds in units of their own gain, t in units of the excess: solvers have absolute tolerances."""

    def __init__(self, gain: FloatArray) -> None:
        norms = np.linalg.norm(gain, axis=1)
        largest = float(norms.max()) or 1.0
        # What hardly depends on t is rounding: it stays small.
        norms[norms <= _INSIGNIFICANT * largest] = largest
        self.gain, self.norms = gain / norms[:, np.newaxis], norms

    def scale(self, excess: FloatArray) -> tuple[FloatArray, float]:
        """Return the excess in these units, and the unit of t."""
        distance = excess / self.norms
        unit = float(distance.max())
        unit = unit if unit > 0.0 else 1.0
        return distance / unit, unit


class _DenseBackend(ABC):
    """What the dense solvers share: they are set up anew for a new gain, and after they were pickled."""

    def __init__(self) -> None:
        self._solver: Any = None

    def load(self, gain: FloatArray) -> None:
        """See :class:`Backend`."""
        self._problems = _ScaledProblems(gain)
        self._solver = self._set_up(self._problems.gain)

    def solve(self, excess: FloatArray) -> Answer:
        """See :class:`Backend`."""
        if self._solver is None:
            self._solver = self._set_up(self._problems.gain)
        scaled, unit = self._problems.scale(excess)
        t, active, failure = self._answer(scaled)
        return Answer(unit * t, tuple(np.flatnonzero(active).tolist()), failure)

    @abstractmethod
    def _set_up(self, gain: FloatArray) -> Any:
        """Return the solver, set up for a gain."""

    @abstractmethod
    def _answer(self, excess: FloatArray) -> tuple[FloatArray, FloatArray, str]:
        """Return t, which bounds are active, and why t is not the optimum, if so."""

    def __getstate__(self) -> dict[str, Any]:
        """Leave the solver's workspace behind."""
        return {**self.__dict__, "_solver": None}


class PIQPBackend(_DenseBackend):
    """PIQP's dense interior-point method."""

    def _set_up(self, gain: FloatArray) -> Any:
        """Set the solver up over the independent directions of t."""
        _, values, right = np.linalg.svd(gain, full_matrices=False)
        self._directions = right[values > np.finfo(float).eps * len(right) * values[0]].T
        bounds, size = len(gain), self._directions.shape[1]
        solver = piqp.DenseSolver()
        _ask_for(solver, _PIQP_TOLERANCE)
        gain = np.asfortranarray(gain @ self._directions)
        solver.setup(np.eye(size), np.zeros(size), G=gain, h_u=np.zeros(bounds))
        return solver

    def _answer(self, excess: FloatArray) -> tuple[FloatArray, FloatArray, str]:
        self._solver.update(h_u=-excess)
        status, result = self._solver.solve(), self._solver.result
        failure = "" if status == piqp.PIQP_SOLVED else status.name
        return self._directions @ result.x, result.z_u > result.s_u, failure


class DAQPBackend(_DenseBackend):
    """DAQP's dual active-set method, an optional dependency.

    Raises
    ------
    MissingLibraryError
        It is not installed.
    """

    def __init__(self) -> None:
        super().__init__()
        try:
            import_module("daqp")
        except ImportError as error:
            needed = MissingLibraryError.of("backend = 'daqp'", "DAQP", "daqp")
            raise MissingLibraryError(f"{needed}; or use backend = 'piqp'") from error

    def _set_up(self, gain: FloatArray) -> Any:
        """Set the solver up at no excess: it refuses to be set up with bounds that no t meets."""
        bounds, size = gain.shape
        solver = import_module("daqp").Model()
        solver.settings = {"primal_tol": _DAQP_TOLERANCE}
        solver.setup(np.eye(size), np.zeros(size), np.ascontiguousarray(gain), np.zeros(bounds))
        return solver

    def _answer(self, excess: FloatArray) -> tuple[FloatArray, FloatArray, str]:
        self._solver.update(bupper=-excess)
        t, _, flag, info = self._solver.solve()
        # It passes over bounds that no t moves.
        if flag > 0 and not (excess + self._problems.gain @ t).max() <= _EXCEEDED:
            flag = _DAQP_INFEASIBLE
        return t, info["lam"] > 0.0, "" if flag > 0 else f"DAQP_EXIT_{flag}"


def _ask_for(solver: Any, tolerance: float) -> None:
    for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
        setattr(solver.settings, name, tolerance)


def make_backend(name: str) -> Backend:
    """Return a solver by name.

    Raises
    ------
    MissingLibraryError
        The solver is not installed.
    """
    return DAQPBackend() if name == "daqp" else PIQPBackend()


def require_backend(name: str) -> None:
    """Raise MissingLibraryError if a solver is not installed; PIQP, which always is, is not imported."""
    if name != "piqp":
        make_backend(name)


SparseBlocks = Mapping[str, Any]
"""Coefficient blocks, dense or sparse, by the name of the variable that they multiply."""


class SparseQP:
    """Minimise ``x' H x + c' x`` subject to ``A x = b`` and limits of x.

    Parameters
    ----------
    sizes : mapping of str to int
        Sizes of the variables, in their order in x.
    half_hessian : mapping of (str, str) to array
        Blocks of H.
    equalities : mapping of str to blocks
        Rows of A by the name of their right-hand side, in order.
    limits : mapping of str to (array, array)
        Limits of the variables that have any.
    tolerance : float
        Tolerance of PIQP, absolute and relative, on residuals and duality gap.
    relaxed : float, optional
        Tolerance of a second attempt where the first fails; default: there is none.

    Attributes
    ----------
    linear, right : dict of str to array
        Blocks of c and b, zero at first: views, to be changed in place.
    lower, upper : dict of str to array
        Blocks of the limits: views, to be changed in place where there are limits at all.
    """

    def __init__(
        self,
        sizes: Mapping[str, int],
        half_hessian: Mapping[tuple[str, str], Any],
        equalities: Mapping[str, SparseBlocks],
        limits: Mapping[str, tuple[FloatArray, FloatArray]],
        tolerance: float = _SPARSE_TOLERANCE,
        relaxed: float | None = None,
    ) -> None:
        import scipy.sparse as sp  # takes long, and no other problem needs it

        def matrix(blocks: Mapping[tuple[str, str], Any], heights: Mapping[str, int]) -> Any:
            # Zeros where there is no block: every row and column needs a size.
            rows = [
                [
                    sp.csc_array(blocks.get((i, j), sp.csc_array((height, width))))
                    for j, width in sizes.items()
                ]
                for i, height in heights.items()
            ]
            return sp.csc_matrix(sp.block_array(rows))

        heights = {name: next(iter(blocks.values())).shape[0] for name, blocks in equalities.items()}
        quadratic = matrix(half_hessian, sizes)
        equations = matrix({(i, j): b for i, row in equalities.items() for j, b in row.items()}, heights)
        self._c, self.linear = _vector(sizes)
        self._b, self.right = _vector(heights)
        self._x, self._parts = _vector(sizes)
        free = {name: (np.full(size, -np.inf), np.full(size, np.inf)) for name, size in sizes.items()}
        (self._low, self.lower), (self._high, self.upper) = _vector(sizes), _vector(sizes)
        for name, (lower, upper) in {**free, **limits}.items():
            self.lower[name][:], self.upper[name][:] = lower, upper
        self._tolerance, self._relaxed = tolerance, relaxed
        self._solver = piqp.SparseSolver()
        # Rows of size 1 need no other scaling, and shorter steps get through degenerate problems.
        self._solver.settings.preconditioner_iter = 0
        self._solver.settings.tau = 0.9
        # PIQP's tolerances are absolute too: costs and rows of about size 1, whatever the units and weights.
        curvatures = quadratic.diagonal()
        self._cost = float(np.exp(-np.log(curvatures[curvatures > 0.0]).mean()))
        self._row_sizes = np.sqrt(np.asarray(equations.power(2).sum(axis=1)).ravel())
        self._row_sizes[self._row_sizes == 0.0] = 1.0
        equations = sp.csc_matrix(sp.diags_array(1.0 / self._row_sizes) @ equations)
        sides = {"x_l": self._low, "x_u": self._high}
        self._solver.setup(2.0 * self._cost * quadratic, self._c, equations, self._b, **sides)

    def move_limits(self) -> None:
        """Have the next solutions meet the limits as they are now."""
        self._solver.update(x_l=self._low, x_u=self._high)

    def solve(self) -> tuple[dict[str, FloatArray], str]:
        """Return the variables by name, and the solver's word for why they are not optimal, if so."""
        self._solver.update(c=self._cost * self._c, b=self._b / self._row_sizes)
        status = self._attempt(self._tolerance)
        if status != piqp.PIQP_SOLVED and self._relaxed is not None:
            status = self._attempt(self._relaxed)
        self._x[...] = self._solver.result.x
        solution = {name: part.copy() for name, part in self._parts.items()}
        return solution, "" if status == piqp.PIQP_SOLVED else str(status.name)

    def _attempt(self, tolerance: float) -> Any:
        _ask_for(self._solver, tolerance)
        return self._solver.solve()


def _vector(sizes: Mapping[str, int]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return a vector of zeros, and views of its named parts."""
    vector = np.zeros(sum(sizes.values()))
    ends = np.cumsum(list(sizes.values()))[:-1]
    return vector, dict(zip(sizes, np.split(vector, ends), strict=True))


def contradiction(gain: FloatArray, excess: FloatArray) -> ActiveSet:
    """Return bounds that no t meets together; empty if there are none.

    By Farkas' lemma they are those with a positive multiplier in ``gain' y = 0, excess' y = 1, y >= 0``.
    """
    multipliers, distance = _multipliers(gain, excess)
    if distance > _CONTRADICTION:
        return ()
    return tuple(np.flatnonzero(multipliers > _CONTRADICTION * multipliers.max()).tolist())


def least_distance(gain: FloatArray, excess: FloatArray) -> ActiveSet:
    """Return the active bounds of the optimum; empty if there is none.

    Slower than the solvers, but for limits that leave next to no room, such as a terminal condition's, right
    where these see none (C. L. Lawson, R. J. Hanson, *Solving least squares problems*, chapter 23).
    """
    multipliers, distance = _multipliers(gain, excess)
    return tuple(np.flatnonzero(multipliers).tolist()) if distance > _CONTRADICTION else ()


def nearest_feasible(gain: FloatArray, excess: FloatArray, tolerance: float) -> ActiveSet:
    """Return the active bounds of the optimum, to rounding; empty if there is none.

    Slower than the solvers, whose tolerances are parts of the largest excess: prices can put the optimum
    without bounds so far away that they leave no digits. The dual active-set method (D. Goldfarb, A. Idnani,
    Math. Program. 27, 1983, doi:10.1007/BF02591962) takes up one bound after another, and frees others.
    """
    problems = _ScaledProblems(gain)
    gain, (excess, unit) = problems.gain, problems.scale(excess)
    allowed = np.maximum(tolerance / (unit * problems.norms), _ROUNDED)
    t, active, multipliers = np.zeros(gain.shape[1]), list[int](), np.empty(0)
    for _ in range(_ITERATIONS * len(gain)):
        beyond = excess + gain @ t - allowed
        beyond[active] = -np.inf
        new = int(beyond.argmax())
        if beyond[new] <= 0.0:
            return tuple(sorted(active))
        multiplier = 0.0
        while True:
            directions, triangular = np.linalg.qr(gain[active].T)
            along = directions.T @ gain[new]
            across = gain[new] - directions @ along
            across -= directions @ (directions.T @ across)
            change = scipy.linalg.solve_triangular(triangular, along)
            in_the_way = np.flatnonzero(change > 0.0)
            steps = multipliers[in_the_way] / change[in_the_way]
            length = float(across @ across)
            whole = (excess[new] + gain[new] @ t) / length if length > _DEPENDENT else np.inf
            step = min(whole, steps.min(initial=np.inf))
            if not np.isfinite(step):
                return ()
            multipliers, multiplier = multipliers - step * change, multiplier + step
            t = -(multipliers @ gain[active]) - multiplier * gain[new]
            if step == whole:
                active, multipliers = [*active, new], np.append(multipliers, multiplier)
                break
            freed = int(in_the_way[steps.argmin()])
            del active[freed]
            multipliers = np.delete(multipliers, freed)
    return ()


def _multipliers(gain: FloatArray, excess: FloatArray) -> tuple[FloatArray, float]:
    """Return y >= 0 that comes closest to ``gain' y = 0, excess' y = 1``, and how close."""
    from scipy.optimize import nnls

    system = np.vstack([gain.T / (np.abs(gain).max(initial=0.0) or 1.0), excess])
    system /= np.maximum(np.linalg.norm(system, axis=0), np.finfo(float).tiny)
    multipliers, distance = nnls(system, np.append(np.zeros(gain.shape[1]), 1.0))
    return multipliers, float(distance)
