"""Calls of plants and controllers: whatever theirs raise or return becomes one of this project's errors.

Plants fail with an ``FMUStepError``, controllers with a ``ControllerError``; errors of this project that the
contract lets them raise themselves pass unchanged.
"""

import math
import reprlib
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from queue import Empty, SimpleQueue
from time import perf_counter
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import OK, Action, Controller, ControllerCode, Loop, Sample
from ddpc_cosim.errors import ConfigError, ControllerError, CosimError, FMUStepError, StepStatus
from ddpc_cosim.files.durations import shown
from ddpc_cosim.files.texts import recorded
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.settings import to_plain
from ddpc_cosim.variables import FloatArray

CLIPPED = "input beyond its bounds, clipped"
"""Status of a sample at which a controller asked for more than its bounds allow."""

# A plug-in can fail in any way, exit() included; an interrupt is the user's.
_ANY_FAULT = (Exception, SystemExit)
_REAL_KINDS = "fiub"
_REAL_NUMBERS = (float, int, np.number, np.bool_)
_LONGEST_INFO_NAME = 100
_NO_INFO: Mapping[str, float] = MappingProxyType({})
# An input may exceed its bounds by a rounding error, relative to the largest finite bound.
_ROUNDING = 1e-9
_FLOAT64 = np.dtype(np.float64)

DEFAULT_STEP_TIMEOUT = 60.0
"""Longest time for any call of a plant or a controller [s], where nothing else is said."""


class Decision(NamedTuple):
    """What a controller decided: inputs, shape (m,); ``"ok"`` or why not; wall time [s]; values by name."""

    u: NDArray[Any]
    status: str
    seconds: float
    info: Mapping[str, float] = _NO_INFO

    def with_status(self, status: str) -> "Decision":
        """Return the decision with one more reason why it is a fallback; itself for an empty one."""
        if not status:
            return self
        return self._replace(status=status if self.status == OK else f"{self.status}; {status}")


class NotFiniteError(Exception):
    """The plant returned a value that is not finite."""


T = TypeVar("T")


class Announce(Protocol):
    """Called when a call begins: of the ``"plant"`` or ``"controller"``, the method, the time of the run [s].

    And when it has returned, with empty names. ``is_within``: it is within another one, whose time counts on.
    """

    def __call__(self, who: str, name: str, time: float, *, is_within: bool = False) -> None:
        """Announce a call."""


def _announce_to_no_one(who: str, name: str, time: float, *, is_within: bool = False) -> None:
    """Do nothing."""


_announce: Announce = _announce_to_no_one


def announce_calls(announce: Announce = _announce_to_no_one) -> None:
    """Have all calls of this process announced: a process that watches it sees which one does not return.

    By default no one is told any more.
    """
    global _announce
    _announce = announce


def calls_are_watched() -> bool:
    """Whether calls of this process are announced."""
    return _announce is not _announce_to_no_one


def announce_call_of_plant(call: str, time: float, *, is_within: bool = False) -> None:
    """Announce what a plant is in at a time of the run [s], where its call consists of several.

    Each may take as long as any call, unless it is within one that may not take longer as a whole.
    """
    _announce("plant", call, time, is_within=is_within)


def make_plant(make: Callable[[], Plant]) -> Plant:
    """Make a plant, which may raise any CosimError itself."""
    with _PlantCall(None, getattr(make, "__name__", repr(make)) + "()", allowed=CosimError):
        return make()


def close_plant(plant: Plant) -> None:
    """Close a plant."""
    with _PlantCall(plant, "close"):
        plant.close()


def reset_plant(plant: Plant, parameters: Mapping[str, ParameterValue] | None, t0: float) -> FloatArray:
    """Reset a plant, which may raise any CosimError itself, and return its outputs, shape (p,)."""
    with _PlantCall(plant, "reset", t0, allowed=CosimError):
        y = np.asarray(plant.reset(parameters, t0))
        return plant_outputs(plant, "reset", y, t0)


def step_plant(plant: Plant, u: FloatArray, h: float, time: float) -> FloatArray:
    """Step a plant by h [s] from ``time`` [s] on and return its outputs, shape (p,)."""
    with _PlantCall(plant, "step", time):
        return plant_outputs(plant, "step", np.asarray(plant.step(u, h)), time + h)


def outputs_of_plant_at(plant: Plant, u: FloatArray, time: float) -> FloatArray:
    """Return the outputs of a plant, shape (p,), at other inputs at ``time`` [s], which does not pass."""
    with _PlantCall(plant, "outputs_at", time, allowed=(ConfigError, FMUStepError)):
        y = np.asarray(plant.outputs_at(u))
        return plant_outputs(plant, "outputs_at", y, time)


def feedthrough_of_plant(plant: Plant, u: FloatArray, time: float) -> FloatArray | None:
    """Return the derivatives of a plant's outputs by its inputs, shape (p, m); None: not known."""
    with _PlantCall(plant, "feedthrough", time):
        derivatives = plant.feedthrough(u)
        matrix = None if derivatives is None else np.asarray(derivatives, dtype=np.float64)
    shape = (len(plant.outputs), len(plant.inputs))
    if matrix is not None and matrix.shape != shape:
        message = f"{type(plant).__name__}.feedthrough {_returned(matrix)}; needed: shape {shape}"
        raise FMUStepError(f"{message} at t = {shown(time)}", StepStatus.CRASHED, time)
    return matrix


def set_plant_parameters(plant: Plant, parameters: Mapping[str, ParameterValue], time: float) -> None:
    """Change tunable parameters at ``time`` [s]; a plant that refuses them raises ConfigError."""
    with _PlantCall(plant, "set_parameters", time, allowed=(ConfigError, FMUStepError)):
        plant.set_parameters(parameters)


def serialise_plant(plant: Plant, time: float) -> bytes:
    """Return the state of a plant at ``time`` [s] as bytes; one that cannot raises ConfigError."""
    with _PlantCall(plant, "serialise_state", time, allowed=(ConfigError, FMUStepError)):
        return bytes(plant.serialise_state())


def resume_plant(plant: Plant, content: bytes, time: float) -> FloatArray:
    """Have a plant go on from a state at ``time`` [s] and return its outputs there, shape (p,)."""
    with _PlantCall(plant, "deserialise_state", time, allowed=(ConfigError, FMUStepError)):
        y = np.asarray(plant.deserialise_state(content))
        return plant_outputs(plant, "deserialise_state", y, time)


def plant_provenance(plant: Plant) -> dict[str, str]:
    """Return the identifiers of a plant; a failure to tell them does not prevent the run."""
    try:
        with _PlantCall(None, "provenance", allowed=_ANY_FAULT):
            return {recorded(name): recorded(value) for name, value in plant.provenance().items()}
    except _ANY_FAULT as error:
        return {"class": type(plant).__qualname__, "provenance": _raised(error)}


def _are_finite(values: NDArray[Any]) -> bool:
    """Whether all of a few numbers are finite: their sum says so in less time than NumPy takes."""
    return math.isfinite(sum(values.tolist())) or bool(np.isfinite(values).all())


def require_finite(y_plant: FloatArray, plant: Plant) -> None:
    """Raise NotFiniteError if an output is not finite."""
    if not _are_finite(y_plant):
        bad = int(np.flatnonzero(~np.isfinite(y_plant))[0])
        raise NotFiniteError(f"output {plant.outputs[bad].name} is {y_plant[bad]}")


def make_controller(make: Callable[[], Controller], name: str) -> Controller:
    """Make a controller, which may raise any CosimError itself."""
    with _ControllerCall(name, "constructor", allowed=CosimError):
        return make()


class CallsInTime:
    """Makes calls of plug-ins in this process, each of which has to return within so many seconds.

    They are made in a thread. A call that is late is ended if it computes; one that waits is left behind, and
    ends with this process.

    Parameters
    ----------
    seconds : float
        The limit [s].
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = min(seconds, threading.TIMEOUT_MAX)
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._thread is not None:
            self._calls.put(None)

    def __call__(self, call: Callable[[], T]) -> T:
        """Return what the call returns, or raise what it raises; TimeoutError: it is late."""
        if self._thread is None:
            self._calls: SimpleQueue[Callable[[], Any] | None] = SimpleQueue()
            self._answers: SimpleQueue[tuple[Any, BaseException | None]] = SimpleQueue()
            self._thread = threading.Thread(target=_serve, args=(self._calls, self._answers), daemon=True)
            self._thread.start()
        self._calls.put(call)
        try:
            result, error = self._answers.get(timeout=self.seconds)
        except Empty:
            import ctypes  # seldom needed

            identifier = ctypes.c_ulong(self._thread.ident or 0)
            ctypes.pythonapi.PyThreadState_SetAsyncExc(identifier, ctypes.py_object(SystemExit))
            self._thread = None
            raise TimeoutError from None
        if error is not None:
            raise error
        return cast("T", result)


def _serve(calls: "SimpleQueue[Callable[[], Any] | None]", answers: "SimpleQueue[Any]") -> None:
    while (call := calls.get()) is not None:
        try:
            answers.put((call(), None))
        except BaseException as error:
            answers.put((None, error))
            if type(error) is SystemExit:  # that of a call that was late: no other one follows
                return


def learns_from_recording(controller: Controller) -> bool:
    """Return whether a controller uses a recording."""
    with _ControllerCall(controller, "uses_recording"):
        return bool(controller.uses_recording)


def recording_length(
    controller: Controller, inputs: int, outputs: int, measurements: int, disturbances: int = 0
) -> int:
    """Return the fewest samples of a recording that a controller can start with, for so many signals."""
    with _ControllerCall(controller, "recording_length"):
        return int(controller.recording_length(inputs, outputs, measurements, disturbances))


def settings_of_other(
    controller: Controller, other: type[Controller], inputs: int, outputs: int, samples: int
) -> dict[str, Any]:
    """Return with which settings another class decides as a controller does; empty if with none."""
    with _ControllerCall(controller, "settings_as"):
        settings = controller.settings_as(other, inputs, outputs, samples) or {}
        return {str(name): to_plain(value) for name, value in settings.items()}


def start_controller(controller: Controller, loop: Loop) -> None:
    """Start a controller, which may raise any CosimError itself, and whose horizon has to stay."""
    horizon = horizon_of(controller)
    with _ControllerCall(controller, "start", allowed=CosimError):
        controller.start(loop)
    if (after := horizon_of(controller)) != horizon:
        who = f"{type(controller).__name__}.start"
        raise ControllerError(f"{who} changed horizon from {horizon} to {after}; set it before")


def restart_controller(controller: Controller, loop: Loop) -> None:
    """Have a started controller begin anew with another past, which may raise any CosimError itself."""
    with _ControllerCall(controller, "restart", allowed=CosimError):
        controller.restart(loop)


def past_length_of(controller: Controller) -> int:
    """Return how many samples of a running plant's past a started controller needs, an integer >= 0."""
    with _ControllerCall(controller, "past_length", allowed=CosimError):
        length = controller.past_length
        if not isinstance(length, int | np.integer) or isinstance(length, bool) or length < 0:
            what = f"{type(controller).__name__}.past_length = {length!r}"
            raise ControllerError(f"{what} is not possible; allowed: an integer >= 0")
        return int(length)


def horizon_of(controller: Controller) -> int:
    """Return how many future references a controller wants, an integer >= 0."""
    with _ControllerCall(controller, "horizon", allowed=CosimError):
        horizon = controller.horizon
        if not isinstance(horizon, int | np.integer) or isinstance(horizon, bool) or horizon < 0:
            what = f"{type(controller).__name__}.horizon = {horizon!r}"
            raise ControllerError(f"{what} is not possible; allowed: an integer >= 0")
        return int(horizon)


def does_accept_missing(controller: Controller) -> bool:
    """Return whether a controller answers missing measurements itself."""
    with _ControllerCall(controller, "accepts_missing"):
        return bool(controller.accepts_missing)


def ask_controller(controller: Controller, sample: Sample, inputs: int) -> Decision:
    """Let a controller decide on its inputs, shape (inputs,), which have to be finite."""
    with _ControllerCall(controller, "step", allowed=ControllerError):
        started = perf_counter()
        answer = controller.step(sample)
        return decision_of(controller, answer, perf_counter() - started, inputs)


def decision_of(controller: Controller, answer: object, seconds: float, inputs: int) -> Decision:
    """Return what a controller has answered if it can be its inputs, shape (inputs,), which are finite."""
    status, info = OK, _NO_INFO
    if isinstance(answer, Action):
        info = {name: _info_value(controller, name, value) for name, value in answer.info.items()}
        status, answer = recorded(answer.status), answer.u
    u = np.asarray(answer)
    if u.shape != (inputs,) or u.dtype.kind not in _REAL_KINDS or not _are_finite(u):
        needed = f"needed: finite values, shape ({inputs},)"
        raise ControllerError(f"{type(controller).__name__}.step {_returned(u)}; {needed}")
    return Decision(u, status, seconds, info)


def _info_value(controller: Controller, name: Any, value: Any) -> float:
    """Return a value of ``Action.info`` as it is recorded: a finite number, or NaN for none."""
    if not (isinstance(name, str) and name.isprintable() and 0 < len(name) <= _LONGEST_INFO_NAME):
        needed = f"needs another name: 1 to {_LONGEST_INFO_NAME} printable characters"
        raise ControllerError(f"{_info_words(controller, name)} {needed}")
    if isinstance(value, _REAL_NUMBERS) and not isinstance(value, np.complexfloating):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isinf(number):
            return number
    what = f"{_info_words(controller, name)} = {reprlib.repr(value)}"
    raise ControllerError(f"{what} is not a number; allowed: finite ones, NaN for none")


def _info_words(controller: Controller, name: Any) -> str:
    return f"{type(controller).__name__}.step: info[{reprlib.repr(name)}]"


def clip_inputs(decision: Decision, u_min: FloatArray, u_max: FloatArray) -> Decision:
    """Return a decision within the limits; one that was beyond them is a fallback, and its status says so."""
    u = decision.u
    if u.dtype is _FLOAT64:  # within all of them, as most are, is seen in less time than NumPy takes
        for value, low, high in zip(u.tolist(), u_min.tolist(), u_max.tolist(), strict=True):
            if not low < value < high:
                break
        else:
            return decision
    held = np.minimum(np.maximum(u, u_min), u_max)
    if held.tolist() != u.tolist():
        limits = np.abs(np.stack((u_min, u_max)))
        largest = np.where(np.isfinite(limits), limits, 0.0).max(axis=0)
        if (np.abs(u - held) > _ROUNDING * largest).any():
            decision = decision.with_status(CLIPPED)
    return Decision(held, decision.status, decision.seconds, decision.info)


def controller_settings(controller: Controller) -> dict[str, Any]:
    """Return the settings of a controller."""
    with _ControllerCall(controller, "settings"):
        return dict(controller.settings())


def controller_knowledge(controller: Controller, loop: Loop) -> dict[str, str]:
    """Return what a controller says it goes by, in words."""
    with _ControllerCall(controller, "knowledge"):
        return {recorded(name): recorded(text) for name, text in controller.knowledge(loop).items()}


def controller_code(controller: Controller, loop: Loop) -> ControllerCode:
    """Return a started controller as C code; one that cannot be exported raises ConfigError."""
    with _ControllerCall(controller, "c_code", allowed=CosimError):
        return controller.c_code(loop)


def loadable_controller_code(controller: Controller, loop: Loop) -> ControllerCode:
    """Return the same with its numbers apart."""
    with _ControllerCall(controller, "loadable_c_code", allowed=CosimError):
        return controller.loadable_c_code(loop)


def controller_diagnostics(controller: Controller) -> dict[str, float]:
    """Return what a controller says about its data or model, in numbers."""
    with _ControllerCall(controller, "diagnostics"):
        return {recorded(name): float(value) for name, value in controller.diagnostics().items()}


def controller_warnings(controller: Controller) -> tuple[str, ...]:
    """Return what a controller says against its data or model."""
    with _ControllerCall(controller, "warnings"):
        return tuple(map(recorded, controller.warnings()))


_ErrorTypes = type[BaseException] | tuple[type[BaseException], ...]


class _Calling(threading.local):
    """Whether this thread is in a call."""

    now = False


_calling = _Calling()


class _Call(ABC):
    """A call that is announced; what it raises, except the ``allowed`` errors, becomes one of this project.

    A class and not a generator: a step of the loop makes two. Within another call, as those of a coupled
    plant's parts are, it is not announced: the outer one says what the run is in.
    """

    __slots__ = ("_allowed", "_is_told", "_name", "_time", "_whose")
    _who: ClassVar[str]
    _always_allowed: ClassVar[_ErrorTypes]

    def __init__(
        self, whose: Any, name: str, time: float = math.nan, allowed: _ErrorTypes | None = None
    ) -> None:
        self._whose, self._name, self._time = whose, name, time
        self._allowed = self._always_allowed if allowed is None else allowed

    def __enter__(self) -> None:
        if _announce is _announce_to_no_one:  # there is nothing to be said at its end either
            self._is_told = False
            return
        self._is_told, _calling.now = not _calling.now, True
        if self._is_told:
            _announce(self._who, self._name, self._time)

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if error is None:
            if self._is_told:
                self._end()
            return
        fault = None
        try:  # the words of an error are theirs too, and so belong to the call
            if isinstance(error, _ANY_FAULT) and not isinstance(error, self._allowed):
                fault = self._fault(error)
            else:
                recorded(error)
        finally:
            if self._is_told:
                self._end()
        if fault is not None:
            raise fault from error

    def _end(self) -> None:
        _calling.now = False
        _announce("", "", math.nan)

    @abstractmethod
    def _fault(self, error: BaseException) -> CosimError:
        """Return the error that stands for what the call raised."""


class _PlantCall(_Call):
    """A call of a plant, or, of None, of what is called by a name alone; it fails with an FMUStepError."""

    __slots__ = ()
    _who, _always_allowed = "plant", FMUStepError

    def _fault(self, error: BaseException) -> CosimError:
        words = self._name if self._whose is None else f"{type(self._whose).__name__}.{self._name}"
        return plant_fault(words, error, self._time)


class _ControllerCall(_Call):
    """A call of a controller, or of what is to be one, by name; it fails with a ControllerError."""

    __slots__ = ()
    _who, _always_allowed = "controller", ()

    def _fault(self, error: BaseException) -> CosimError:
        whose = self._whose if isinstance(self._whose, str) else type(self._whose).__name__
        return ControllerError(f"{whose}.{self._name} {_raised(error)}")


def plant_fault(words: str, error: BaseException, time: float) -> FMUStepError:
    """Return the error for what a call of a plant, named by words, raised."""
    when = "" if math.isnan(time) else f" at t = {shown(time)}"
    return FMUStepError(f"{words} {_raised(error)}{when}", StepStatus.CRASHED, time)


def plant_outputs(plant: Plant, call: str, y: NDArray[Any], time: float) -> FloatArray:
    """Return a plant's answer if it can be its outputs; whether they are finite, the loop checks."""
    size = len(plant.outputs)
    if y.shape == (size,):
        if y.dtype is _FLOAT64:
            return y
        if y.dtype.kind in _REAL_KINDS:
            return np.asarray(y, dtype=np.float64)
    needed = f"needed: real numbers, shape ({size},)"
    message = f"{type(plant).__name__}.{call} {_returned(y)}; {needed} at t = {shown(time)}"
    raise FMUStepError(message, StepStatus.CRASHED, time)


def _returned(answer: NDArray[Any]) -> str:
    return f"returned {reprlib.repr(answer.tolist())}, shape {answer.shape}"


def _raised(error: BaseException) -> str:
    return f"raised {type(error).__name__}: {recorded(error)}".removesuffix(": ")
