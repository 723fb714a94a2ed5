"""Linear models for the model-based controllers, and where they come from.

A source of models is a setting: :class:`~ddpc_controllers.models.identification.Identified` (from the
recording), :class:`~ddpc_controllers.models.from_fmu.FMUModel` (from an FMU about an operating point),
:class:`StateSpace` (numbers) or :class:`ModelFunction` (a function of the user's own, which may linearise any
plant with :mod:`ddpc_controllers.models.from_fmu`). A controller sees the loop only, never the plant.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from ddpc_controllers.models.control_api import discretise
from ddpc_cosim import ConfigError, FloatArray, Loop, check_settings, setting
from ddpc_cosim.plugins import load_target

if TYPE_CHECKING:
    from ddpc_cosim import LinearModel  # which comes with all that runs FMUs

Matrix = Sequence[Sequence[float]]
_NO_DISTURBANCES: FloatArray = np.empty((1, 0))


@dataclass(frozen=True, slots=True)
class SampledModel:
    """A linear model at the loop's sampling time.

    ``x+ = A x + B (u - u_0) + E (d - d_0)``, ``y = C x + F (d - d_0) + y_0``, with d the known disturbances.

    Parameters
    ----------
    a, b, c : array, shapes (n, n), (n, m), (p, n)
        The matrices.
    u_0, y_0 : array, shapes (m,) and (p,)
        The operating point.
    samples : int
        Samples that it rests on: a pole nearer to 1 than ``1 / samples`` may be an integrator's.
    fit : dict of str to float
        Quality of its identification, by name.
    warnings : tuple of str
        What speaks against it.
    e, f, d_0 : array, shapes (n, n_d), (p, n_d), (n_d,), optional
        How known disturbances act, and what they are at the operating point; default: there are none.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    u_0: FloatArray
    y_0: FloatArray
    samples: int = 1000
    fit: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    e: FloatArray = field(default_factory=lambda: _NO_DISTURBANCES)
    f: FloatArray = field(default_factory=lambda: _NO_DISTURBANCES)
    d_0: FloatArray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        for name, rows in (("e", len(self.a)), ("f", len(self.c))):
            if getattr(self, name) is _NO_DISTURBANCES:
                object.__setattr__(self, name, np.zeros((rows, len(self.d_0))))


@runtime_checkable
class ModelSource(Protocol):
    """Where a controller's linear model comes from; a subclass needs no recording unless it says so."""

    @property
    def uses_recording(self) -> bool:
        """Whether the loop needs a recording."""
        return False

    def recording_length(self, inputs: int, outputs: int) -> int:
        """Return the fewest samples of a recording that it can work with; disturbances count as inputs."""
        return 0

    @abstractmethod
    def model(self, loop: Loop) -> SampledModel:
        """Return the model for a loop.

        Raises
        ------
        ConfigError
            The model does not fit the loop.
        DataError
            The recording cannot serve.
        """


@dataclass(frozen=True, kw_only=True)
class StateSpace(ModelSource):
    """A linear model in numbers, continuous or sampled.

    A sampled output is measured before the input of its sample is applied, so a direct feedthrough D shows
    the input of the sample before. Known disturbances of the loop are further inputs, after the m: where B
    has no columns for them, it is not known what they do.
    """

    a: Matrix = setting(doc="A, n rows of n numbers")
    b: Matrix = setting(doc="B, n rows of m numbers, and those of known disturbances after them")
    c: Matrix = setting(doc="C, p rows of n numbers")
    d: Matrix = setting((), doc="D, p rows of as many numbers as those of B; empty: zero")
    sampling_time: float = setting(
        0.0, low=0.0, unit="s", doc="sampling time of the matrices; 0: they are continuous"
    )
    u_0: Sequence[float] = setting((), doc="inputs at the operating point; empty: zero")
    y_0: Sequence[float] = setting((), doc="outputs at the operating point; empty: zero")

    def __post_init__(self) -> None:
        check_settings(self)
        a, b, c, d = self._matrices()
        states, inputs, outputs = len(a), b.shape[-1], len(c)
        wanted = {
            "a": (a, (states, states)),
            "b": (b, (states, inputs)),
            "c": (c, (outputs, states)),
            "d": (d, (outputs, inputs)),
            "u_0": (_vector(self.u_0, inputs), (inputs,)),
            "y_0": (_vector(self.y_0, outputs), (outputs,)),
        }
        faults = [
            f"StateSpace: {name} has shape {array.shape}; needed: {shape}"
            for name, (array, shape) in wanted.items()
            if array.shape != shape
        ]
        faults += [
            f"StateSpace: {name} holds a number that is not finite"
            for name, (array, _) in wanted.items()
            if not np.isfinite(array).all()
        ]
        if faults:
            raise ConfigError(faults)

    @classmethod
    def about(
        cls,
        model: "LinearModel | tuple[FloatArray, FloatArray, FloatArray, FloatArray]",
        u_0: Sequence[float] = (),
        y_0: Sequence[float] = (),
    ) -> "StateSpace":
        """Return the continuous model about an operating point.

        Parameters
        ----------
        model : LinearModel or tuple of array
            From :meth:`ddpc_cosim.FMUPlant.linearise`, with its operating point; or (A, B, C, D), as
            ``fmu_plants.linear.linearise`` gives them for a plant's equations.
        u_0, y_0 : sequence of float
            Inputs and outputs at the operating point; empty: the model's own, or zero.
        """
        if not isinstance(model, Sequence):
            u_0 = u_0 if len(u_0) else model.u_0.tolist()
            y_0 = y_0 if len(y_0) else model.y_0.tolist()
            model = model.a, model.b, model.c, model.d
        a, b, c, d = (np.asarray(matrix, dtype=np.float64).tolist() for matrix in model)
        return cls(a=a, b=b, c=c, d=d, u_0=tuple(u_0), y_0=tuple(y_0))

    def model(self, loop: Loop) -> SampledModel:
        """Return the model at the loop's sampling time; see :class:`ModelSource`."""
        a, b, c, d = self._matrices()
        wanted = len(loop.outputs), len(loop.inputs)
        m, known = len(loop.inputs), [variable.name for variable in loop.disturbances]
        with_known = wanted[0], m + len(known)
        if d.shape not in (wanted, with_known):
            beside = f", or {with_known} with its known disturbances" if known else ""
            raise ConfigError(
                f"StateSpace: the model has (outputs, inputs) = {d.shape}, the loop has {wanted}{beside}"
            )
        if self.sampling_time == 0.0:
            a, b = discretise(a, b, loop.sampling_time)
        elif not np.isclose(self.sampling_time, loop.sampling_time, rtol=1e-9):
            raise ConfigError(
                f"StateSpace: the model is sampled every {self.sampling_time:g} s, the loop every "
                f"{loop.sampling_time:g} s: give the continuous matrices with sampling_time = 0"
            )
        if d.any():
            a, b, c = _with_last_input(a, b, c, d)
        u_0, y_0 = _vector(self.u_0, b.shape[1]), _vector(self.y_0, wanted[0])
        if b.shape[1] == m:
            unknown = (f"the model does not say what {', '.join(known)} does to the plant",) if known else ()
            nothing = np.zeros(len(known))
            return SampledModel(a, b, c, u_0, y_0, warnings=unknown, d_0=nothing)
        return SampledModel(a, b[:, :m], c, u_0[:m], y_0, e=b[:, m:], d_0=u_0[m:])

    def _matrices(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        a, b, c = (_matrix(name, getattr(self, name)) for name in "abc")
        d = _matrix("d", self.d) if len(self.d) else np.zeros((len(c), b.shape[-1]))
        return a, b, c, d


@dataclass(frozen=True, kw_only=True)
class ModelFunction(ModelSource):
    """A function of the user's own that makes the model."""

    function: str = setting(doc="module:function; called with the Loop, returns a StateSpace")

    def __post_init__(self) -> None:
        check_settings(self)
        load_target(self.function, "function")

    def model(self, loop: Loop) -> SampledModel:
        """Call the function and return its model at the loop's sampling time; see :class:`ModelSource`."""
        made: Any = load_target(self.function, "function")(loop)
        if not isinstance(made, StateSpace):
            raise ConfigError(
                f"ModelFunction: {self.function} returned {type(made).__name__}; needed: StateSpace"
            )
        return made.model(loop)


def _matrix(name: str, value: Any) -> FloatArray:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"StateSpace: {name} = {value!r} is not a matrix of numbers") from error
    if matrix.ndim != 2 or not matrix.size:
        raise ConfigError(f"StateSpace: {name} has shape {matrix.shape}; needed: rows of numbers")
    return matrix


def _vector(values: Sequence[float], size: int) -> FloatArray:
    return np.array(values, dtype=np.float64) if len(values) else np.zeros(size)


def _with_last_input(
    a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``y_k = C x_k + D u_k-1`` as a model without feedthrough, the last input a part of its state."""
    n, m = b.shape
    a = np.block([[a, np.zeros((n, m))], [np.zeros((m, n + m))]])
    return a, np.vstack([b, np.eye(m)]), np.hstack([c, d])
