"""Dictionaries: the observables that lift a measured state, equation (5).

A state comes as its newest sample, followed by as many past ones as the dictionary's ``memory`` says:
``(x_k, x_k-1, ...)``. Observables are what is added to ``x_k``; the state itself is always kept.
"""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import comb
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np

from ddpc_controllers.data.hankel import window_starts
from ddpc_controllers.export.code import Code
from ddpc_cosim import ConfigError, DataError, FloatArray, Monomials, check_settings, setting
from ddpc_cosim.plugins import load_target

Centres = Literal["box", "data", "k-means"]
CENTRES = ("box", "data", "k-means")

_ROUNDS = 50


def place_centres(
    rule: Centres,
    count: int,
    states: FloatArray,
    box: tuple[float, float],
    rng: np.random.Generator,
) -> FloatArray:
    """Return centres of radial functions.

    Parameters
    ----------
    rule : {"box", "data", "k-means"}
        Uniformly drawn from a box, drawn from the recorded states without repetition, or the means of their
        clusters (Lloyd's algorithm from k-means++ seeds).
    count : int
        Number of centres n_p.
    states : array, shape (T, q)
        The recorded states.
    box : (float, float)
        Ends of every coordinate, for "box".
    rng : numpy.random.Generator
        What decides draws and seeds.

    Returns
    -------
    centres : array, shape (count, q)

    Raises
    ------
    DataError
        Fewer different states were recorded than there are centres to place.
    """
    if rule == "box":
        return rng.uniform(*box, (count, states.shape[1]))
    different = np.unique(states, axis=0)
    if len(different) < count:
        raise DataError(
            f'centres = "{rule}": {count} centres need as many different states; the recording has '
            f"{len(different)}: lower count, or record longer"
        )
    if rule == "data":
        return np.asarray(rng.choice(different, count, replace=False))
    from scipy.cluster.vq import kmeans2  # most dictionaries do without its import

    with warnings.catch_warnings():
        # A cluster that loses all its states keeps its last centre: as good a centre as any.
        warnings.simplefilter("ignore", UserWarning)
        centres, _ = kmeans2(different, count, iter=_ROUNDS, minit="++", seed=int(rng.integers(2**31)))
    return np.asarray(centres, dtype=np.float64)


Lift = Callable[[FloatArray], FloatArray]
"""From states, shape (..., (memory + 1) q), to observables, shape (..., n_p)."""


@runtime_checkable
class Dictionary(Protocol):
    """Observables to lift a state of any size with.

    A dictionary that looks back has an attribute ``memory``: the number of past samples that it needs.
    """

    def functions(self, size: int) -> int:
        """Return the number of observables n_p for states of one size q."""

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Return the observables for states like the recorded ones.

        Parameters
        ----------
        states : array, shape (T - memory, (memory + 1) q)
            The recorded states, time along axis 0.
        rng : numpy.random.Generator
            Where random parameters come from.
        """


class _Observables(ABC):
    """Observables that can be exported: what they are follows from numbers."""

    @abstractmethod
    def __call__(self, states: FloatArray) -> FloatArray: ...

    @abstractmethod
    def terms(self, code: Code) -> list[str]:
        """Add them to code in C; return the names of the constants of type ``Term``."""


def _terms(code: Code, lift: Lift) -> list[str]:
    if not isinstance(lift, _Observables):
        name = getattr(lift, "__qualname__", type(lift).__name__)
        raise ConfigError(
            f"observables that are a Python function ({name}) cannot be exported to C: say the same with "
            "Polynomials, ThinPlate, Gaussian, Delays and Combined"
        )
    return lift.terms(code)


def _products(code: Code, factors: Sequence[Sequence[int]]) -> str:
    size = len(factors[0])
    table = code.sizes([i for factor in factors for i in factor] or [0])
    return code.constant("Term", kind="MONOMIALS", count=len(factors), size=size, factors=table)


def _radial(code: Code, kind: str, centres: FloatArray, **more: float) -> str:
    count, size = centres.shape
    return code.constant("Term", kind=kind, count=count, size=size, centres=code.doubles(centres), **more)


def c_lift(code: Code, lift: Lift, size: int) -> dict[str, object]:
    """Add ``z = (x, psi(x))`` to code in C; return the members of a structure that refer to it.

    Parameters
    ----------
    code : Code
        Where to.
    lift : Lift
        The observables psi.
    size : int
        Number of signals of x, the newest sample of the state.

    Raises
    ------
    ConfigError
        They are a function in Python.
    """
    code.kernel("lift")
    terms = [_products(code, [[i] for i in range(size)]), *_terms(code, lift)]
    return {"terms": code.table("Term *const", [f"&{term}" for term in terms]), "term_count": len(terms)}


def memory_of(dictionary: Dictionary) -> int:
    """Return how many past samples a dictionary needs besides the newest."""
    return int(getattr(dictionary, "memory", 0))


def require_dictionary(value: Any, what: str) -> None:
    """Check that a setting is a dictionary.

    Raises
    ------
    ConfigError
        What it lacks.
    """
    if not isinstance(value, Dictionary):
        raise ConfigError(
            f"{what} = {value!r} lacks draw(states, rng) or functions(size); an example is ThinPlate()"
        )


def embed(samples: FloatArray, memory: int, seams: Sequence[int] = ()) -> FloatArray:
    """Return samples, shape (T, q), with their past next to them: shape (T - memory, (memory + 1) q).

    Samples whose past would cross a seam are left out.
    """
    rows = len(samples) - memory
    if rows < 1:
        raise DataError(
            f"a memory of {memory} samples needs a longer recording than {len(samples)} samples: "
            "record longer, or look back less"
        )
    states = np.hstack([samples[memory - back : memory - back + rows] for back in range(memory + 1)])
    return states[window_starts(len(samples), memory + 1, seams)] if seams else states


class _Radial(ABC):
    """What radial functions share besides their shape: where their centres come from.

    The settings are declared by each kind, in an order of its own.
    """

    count: int
    low: float
    high: float
    centres: Centres

    def __post_init__(self) -> None:
        check_settings(self)
        if self.low > self.high:
            raise ConfigError(f"{type(self).__name__}: low = {self.low:g} is above high = {self.high:g}")

    def functions(self, size: int) -> int:
        """Return n_p: it does not depend on the state's size."""
        return self.count

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Place the centres and return the functions; see :class:`Dictionary`."""
        return self._about(place_centres(self.centres, self.count, states, (self.low, self.high), rng))

    @abstractmethod
    def _about(self, centres: FloatArray) -> Lift:
        """Return the functions about given centres, shape (n_p, q)."""


@dataclass(frozen=True, kw_only=True)
class ThinPlate(_Radial):
    """Thin-plate radial functions, equation (12): ``psi_i(x) = |x - c_i| log10 |x - c_i|``.

    The centres c_i are placed once per run, by default drawn uniformly from a box.
    """

    former_settings: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("redraw_centre", "squared_distance"), "that is what wkpc-published does"
    )

    count: int = setting(10, low=1, doc="number of functions, n_p")
    low: float = setting(0.0, doc="lower end of every coordinate of a centre in the box")
    high: float = setting(1.0, doc="upper end of every coordinate of a centre in the box")
    centres: Centres = setting("box", choices=CENTRES, doc="where centres come from")

    def _about(self, centres: FloatArray) -> Lift:
        return _ThinPlates(centres)


@dataclass(frozen=True, slots=True)
class _ThinPlates(_Observables):
    centres: FloatArray

    def __call__(self, states: FloatArray) -> FloatArray:
        distance = np.sqrt(np.square(states[..., np.newaxis, :] - self.centres).sum(axis=-1))
        logarithm = np.log10(distance, out=np.zeros_like(distance), where=distance > 0.0)  # 0 at the centres
        values: FloatArray = distance * logarithm
        return values

    def terms(self, code: Code) -> list[str]:
        return [_radial(code, "THIN_PLATES", self.centres)]


@dataclass(frozen=True, kw_only=True)
class Gaussian(_Radial):
    """Gaussian radial functions: ``psi_i(x) = exp(-|x - c_i|^2 / (2 width^2))``."""

    count: int = setting(10, low=1, doc="number of functions, n_p")
    width: float = setting(1.0, above=0.0, doc="distance from the centre to the turning point")
    low: float = setting(0.0, doc="lower end of every coordinate of a centre in the box")
    high: float = setting(1.0, doc="upper end of every coordinate of a centre in the box")
    centres: Centres = setting("box", choices=CENTRES, doc="where centres come from")

    def _about(self, centres: FloatArray) -> Lift:
        return _Gaussians(centres, self.width)


@dataclass(frozen=True, slots=True)
class _Gaussians(_Observables):
    centres: FloatArray
    width: float

    def __call__(self, states: FloatArray) -> FloatArray:
        squares = np.square(states[..., np.newaxis, :] - self.centres).sum(axis=-1)
        values: FloatArray = np.exp(-squares / (2.0 * self.width**2))
        return values

    def terms(self, code: Code) -> list[str]:
        return [_radial(code, "GAUSSIANS", self.centres, spread=2.0 * self.width**2)]


@dataclass(frozen=True, kw_only=True)
class Polynomials:
    """All monomials of a state from degree two up to a total degree; the state itself is degree one."""

    degree: int = setting(2, low=2, doc="highest total degree")

    def __post_init__(self) -> None:
        check_settings(self)

    def functions(self, size: int) -> int:
        """Return the number of monomials of ``size`` variables."""
        return comb(size + self.degree, size) - size - 1

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Return the monomials; see :class:`Dictionary`."""
        return _Monomials(Monomials.between(states.shape[-1], 2, self.degree).factors)


class _Monomials(Monomials, _Observables):
    """Products of coordinates, which C knows too."""

    def terms(self, code: Code) -> list[str]:
        return [_products(code, list(alike)) for _, alike in groupby(self.factors, len)]


@dataclass(frozen=True, kw_only=True)
class Identity:
    """No observables: the lifted state is the state itself."""

    def functions(self, size: int) -> int:
        """Return 0."""
        return 0

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Return the empty function; see :class:`Dictionary`."""
        return _Monomials([])


@dataclass(frozen=True, kw_only=True)
class Constant:
    """The function 1, which makes a lifted model affine."""

    def functions(self, size: int) -> int:
        """Return 1."""
        return 1

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Return the function; see :class:`Dictionary`."""
        return _Monomials([[]])


@dataclass(frozen=True, kw_only=True)
class OwnFunction:
    """A function of the user's own, which returns all its observables at once."""

    function: str = setting(doc="module:function; from states, shape (..., q), to shape (..., n_p)")

    def __post_init__(self) -> None:
        check_settings(self)
        self._load()

    def functions(self, size: int) -> int:
        """Return the number of observables that the function returns."""
        with np.errstate(all="ignore"):
            return int(np.shape(self._load()(np.zeros((1, size))))[-1])

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Return the function; see :class:`Dictionary`."""
        function = self._load()
        shape = np.shape(function(states))
        if len(shape) != 2 or shape[0] != len(states):
            raise ConfigError(
                f"OwnFunction: {self.function} returned shape {shape} for {len(states)} states; "
                f"needed: ({len(states)}, n_p)"
            )
        return function

    def _load(self) -> Lift:
        function: Lift = load_target(self.function, "function")
        return function


@dataclass(frozen=True, kw_only=True)
class Delays:
    """Past samples of the state, and what another dictionary makes of the state with its past.

    By Takens' argument a few past samples of the outputs stand for the states that are not measured.
    """

    samples: int = setting(1, low=1, doc="number of past samples")
    dictionary: Dictionary = setting(
        default_factory=Identity, doc="dictionary that lifts the state with its past"
    )

    def __post_init__(self) -> None:
        check_settings(self)
        require_dictionary(self.dictionary, "Delays: dictionary")
        if memory_of(self.dictionary):
            raise ConfigError("Delays: dictionary looks back itself; set samples to the sum instead")

    @property
    def memory(self) -> int:
        """Number of past samples needed."""
        return self.samples

    def functions(self, size: int) -> int:
        """Return the number of past values and of observables of all of them."""
        return self.samples * size + self.dictionary.functions((self.samples + 1) * size)

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Draw the inner dictionary; see :class:`Dictionary`."""
        width = states.shape[-1]
        return _Delayed(width // (self.samples + 1), width, self.dictionary.draw(states, rng))


@dataclass(frozen=True, slots=True)
class _Delayed(_Observables):
    size: int
    width: int
    inner: Lift

    def __call__(self, states: FloatArray) -> FloatArray:
        return np.concatenate([states[..., self.size :], self.inner(states)], axis=-1)

    def terms(self, code: Code) -> list[str]:
        return [_products(code, [[i] for i in range(self.size, self.width)]), *_terms(code, self.inner)]


@dataclass(frozen=True, kw_only=True)
class Combined:
    """Several dictionaries side by side."""

    dictionaries: Sequence[Dictionary] = setting(doc="the dictionaries, in the order of their observables")

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.dictionaries:
            raise ConfigError("Combined: dictionaries is empty")
        for i, dictionary in enumerate(self.dictionaries):
            require_dictionary(dictionary, f"Combined: dictionaries[{i}]")

    @property
    def memory(self) -> int:
        """Number of past samples needed: the most that one of them needs."""
        return max(map(memory_of, self.dictionaries))

    def functions(self, size: int) -> int:
        """Return the number of all observables."""
        return sum(dictionary.functions(size) for dictionary in self.dictionaries)

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Draw one after another; see :class:`Dictionary`."""
        size = states.shape[-1] // (self.memory + 1)
        widths = [(memory_of(dictionary) + 1) * size for dictionary in self.dictionaries]
        lifts = [d.draw(states[:, :width], rng) for d, width in zip(self.dictionaries, widths, strict=True)]
        return _SideBySide(lifts, widths)


@dataclass(frozen=True, slots=True)
class _SideBySide(_Observables):
    lifts: list[Lift]
    widths: list[int]

    def __call__(self, states: FloatArray) -> FloatArray:
        parts = [lift(states[..., :width]) for lift, width in zip(self.lifts, self.widths, strict=True)]
        return np.concatenate(parts, axis=-1)

    def terms(self, code: Code) -> list[str]:
        return [term for lift in self.lifts for term in _terms(code, lift)]
