"""Parts that are one ordinary differential equation: their states stacked, their connections inside it.

    x' = f(t, x, u)

Each part gives the derivatives of its own states; its inputs are what the connections say at the same
instant, algebraic loops solved. An event in one part is one of all: discrete states are updated until no
input of any part changes any more. What integrates it is what integrates a single FMU.
"""

import ctypes
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import inf, nan
from typing import Any, TypeVar, TypeVarTuple

import numpy as np

from ddpc_cosim.coupling.exchange import Exchange
from ddpc_cosim.coupling.parts import Part
from ddpc_cosim.coupling.wiring import Wiring
from ddpc_cosim.errors import ConfigError, CosimError, FMUStepError, StepStatus
from ddpc_cosim.files.durations import shown
from ddpc_cosim.fmu.driven import DrivenRun
from ddpc_cosim.fmu.instance import DoubleArray, EventInfo
from ddpc_cosim.fmu.model_exchange import ModelExchangeRun
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.fmu.status import CallError, termination
from ddpc_cosim.plant import Plant
from ddpc_cosim.variables import FloatArray

T = TypeVar("T")
Arguments = TypeVarTuple("Arguments")
_MOST_ROUNDS = 100
_SAME_INPUT = 1e-9  # relative: what is left of algebraic loops is not a change
_ONE_INSTANT = 1e-6  # of a step

NOT_AS_BYTES = (
    'the state of plants coupled with algorithm = "monolithic" cannot be saved as bytes; '
    'choose "sequential" or "parallel"'
)


class Monolith:
    """Parts as one model with states and events, and its runs.

    Parameters
    ----------
    parts : mapping of Part to FMUPlant
        The parts in the order in which they follow each other, and the FMUs that they are, which are driven.
    exchange : Exchange
        What they exchange.
    nominal : array
        Nominal magnitudes of all that is exchanged.
    tolerance : float
        Relative tolerance of the integration; the absolute one is this times the states' nominal values.
    """

    def __init__(
        self, parts: Mapping[Part, FMUPlant], exchange: Exchange, nominal: FloatArray, tolerance: float
    ) -> None:
        self._plants, self._exchange, self._tolerance = parts, exchange, tolerance
        self._nominal = {part: nominal[part.sources] for part in parts}
        self._run: ModelExchangeRun | None = None
        self._time = 0.0
        self._x = self._dx = self._z = np.empty(0)
        self._states, self._indicators = dict[Part, slice](), dict[Part, slice]()
        self._counting: list[Part] = []
        self._clocks: list[tuple[Part, int]] = []
        self._due: dict[Part, list[int]] = {}
        self._eventful: tuple[float, Sequence[Part]] = nan, ()
        # Whether the parts have time and states, and whether what they exchange follows from these.
        self._is_placed = self._is_current = True

    # Runs

    def start(self, t0: float) -> None:
        """Begin a run at a time [s] with parts that have been reset, after :meth:`end`: they settle together.

        Raises
        ------
        FMUStepError
            They do not, or one of them fails.
        """
        self._time, self._is_placed, self._is_current, self._due = t0, True, False, {}
        sizes = {part: self._vector(part, 3, DrivenRun.sizes).astype(int).tolist() for part in self._plants}
        self._states = _stacked({part: size[0] for part, size in sizes.items()})
        self._indicators = _stacked({part: size[1] for part, size in sizes.items()})
        self._counting = [part for part, size in sizes.items() if size[2]]
        self._x, self._dx = (np.zeros(sum(size[0] for size in sizes.values())) for _ in range(2))
        self._z = np.zeros(sum(size[1] for size in sizes.values()))
        clocks = [(part, clock) for part, plant in self._plants.items() for clock in plant.clocks]
        self._clocks = [(part, clock.reference) for part, clock in clocks]
        self._run = self._told(
            lambda: ModelExchangeRun(
                self,
                self,
                self,
                t0,
                tolerance=self._tolerance,
                needs_completed_step=bool(self._counting),
                has_discrete_inputs=any(plant.discrete_inputs for plant in self._plants.values()),
                clocks=[replace(clock, reference=i) for i, (_, clock) in enumerate(clocks)],
            )
        )
        # An integration without an end consists of short calls.
        self._let_calls_count(within=True)

    def step(self, u: FloatArray, h: float) -> FMUStepError | None:
        """Hold the system's inputs u, shape (m,), over h [s]; return what a part says that ends there."""
        run = self._running()
        try:
            run.step(u, h)
        except CallError as error:
            fault = self._fault(error)
            if error.reached is None or error.reached < run.end_of_sample - _ONE_INSTANT * h:
                raise fault from error
            self._exchange.refresh(self._time, self._plants)
            return fault
        return None

    def outputs_at(self, u: FloatArray) -> None:
        """Exchange what follows from other inputs u, shape (m,), of the system now."""
        run = self._running()
        self._told(lambda: run.at_inputs(u, run.outputs))

    def change(self, set_values: Callable[[], None]) -> None:
        """Set parameters or inputs that rest: an event."""
        run = self._running()
        self._told(lambda: run.change(lambda _: set_values()))

    def saved_run(self) -> object:
        """Return a copy of the state of the run."""
        return self._running().save_state()

    def restore_run(self, state: object) -> None:
        """Go back to a state of this run."""
        self._running().restore_state(state)

    def end(self) -> None:
        """Free the integrator, and all saved states."""
        if self._run is not None:
            self._run.end()
            self._run = None
        self._let_calls_count(within=False)

    def _let_calls_count(self, *, within: bool) -> None:
        for part in self._plants:
            part.is_within = within

    def _running(self) -> ModelExchangeRun:
        if self._run is None:
            raise ConfigError("step before reset")
        return self._run

    def _told(self, call: Callable[[], T]) -> T:
        """Return what a call returns; what is wrong with all parts as one is an error of the contract."""
        try:
            return call()
        except CallError as error:
            raise self._fault(error) from error

    def _fault(self, error: CallError) -> FMUStepError:
        when, eventful = self._eventful
        whose = _named(eventful if when == self._time else self._plants) + ": "
        if error.asks_to_terminate:  # which says whose
            whose = ""
        return FMUStepError(f"{whose}{error} at t = {shown(self._time)}", error.status, self._time)

    # What the system is given, and what it gives

    def write(self, u: FloatArray) -> None:
        """Write the inputs of the system, shape (m,)."""
        self._exchange.hold(u)
        self._is_current = False

    def read(self) -> FloatArray:
        """Return all that is exchanged, brought up to date."""
        self._follow()
        return self._exchange.values.copy()

    # The model: what is asked for by the run and by the integrator

    def sizes(self) -> tuple[int, int]:
        """Return the numbers of continuous states and of event indicators."""
        return len(self._x), len(self._z)

    def set_time(self, time: float) -> None:
        """Set the time [s]."""
        self._time, self._is_placed = time, False

    def set_states(self, x: DoubleArray, n: int) -> None:
        """Write the states."""
        ctypes.memmove(self._x.ctypes.data, x, self._x.nbytes)
        self._is_placed = False

    def get_states(self, x: DoubleArray, n: int) -> None:
        """Read the states, which events of parts have changed perhaps."""
        self._follow()
        self._gather(self._x, self._states, lambda part, size: self._vector(part, size, DrivenRun.states))
        ctypes.memmove(x, self._x.ctypes.data, self._x.nbytes)

    def get_nominals(self, x: DoubleArray, n: int) -> None:
        """Read the nominal values of the states; zeros where they are not known."""
        nominals = np.zeros(len(self._x))
        self._gather(nominals, self._states, lambda part, size: self._vector(part, size, DrivenRun.nominals))
        ctypes.memmove(x, nominals.ctypes.data, nominals.nbytes)

    def get_derivatives(self, dx: DoubleArray, n: int) -> None:
        """Read the derivatives of the states."""
        self._follow()
        self._gather(self._dx, self._states, self._derivatives)
        ctypes.memmove(dx, self._dx.ctypes.data, self._dx.nbytes)

    def get_event_indicators(self, z: DoubleArray, n: int) -> None:
        """Read the event indicators."""
        self._follow()
        self._gather(
            self._z,
            self._indicators,
            lambda part, size: self._vector(part, size, DrivenRun.event_indicators, self._inputs(part)),
        )
        ctypes.memmove(z, self._z.ctypes.data, self._z.nbytes)

    def completed_integrator_step(self) -> tuple[bool, bool]:
        """Tell the end of an integrator step; return whether a part wants an event, and to terminate."""
        self._follow()
        eventful = []
        for part in self._counting:
            wants, ends = self._vector(part, 2, DrivenRun.complete_step, self._inputs(part))
            if ends:
                raise termination(f"{_named([part])}: a completed integrator step", self._time)
            if wants:
                eventful.append(part)
        self._note_events(eventful)
        return bool(eventful), False

    def enter_event_mode(self) -> None:
        """Let all parts enter event mode."""
        self._follow()
        for part in self._plants:
            self._call(part, DrivenRun.begin_event)

    def activate_clocks(self, references: Sequence[int]) -> None:
        """Let clocks tick: with the next update, for which their parts have the inputs of then."""
        for reference in references:
            part, clock = self._clocks[reference]
            self._due.setdefault(part, []).append(clock)

    def update_discrete_states(self) -> EventInfo:
        """Update the discrete states of all parts, and of those whose inputs change by it again."""
        self._exchange.refresh(self._time, self._plants)
        self._is_current = True
        taken, infos = dict[Part, FloatArray](), dict[Part, FloatArray]()
        for _ in range(_MOST_ROUNDS):
            changed = [part for part in self._plants if self._differs(part, taken.get(part))]
            if not changed:
                self._note_events([part for part, info in infos.items() if info[3] <= self._time])
                _, nominals, states, _ = np.max(list(infos.values()), axis=0)
                next_event = min(float(info[3]) for info in infos.values())
                return EventInfo(
                    False, bool(nominals), bool(states), None if next_event == inf else next_event
                )
            for part in changed:
                taken[part] = self._exchange.values[part.sources]
                infos[part] = self._updated(part, infos.get(part))
                self._exchange.refresh(self._time, [part])
        raise FMUStepError(
            f"{_named(changed)}: events change the inputs of each other more than {_MOST_ROUNDS} times at "
            f"t = {shown(self._time)}",
            StepStatus.ERROR,
            self._time,
        )

    def enter_continuous_time_mode(self) -> None:
        """Let all parts go on to continuous time."""
        for part in self._plants:
            self._call(part, DrivenRun.end_event)

    def save_state(self) -> Any:
        """Return a copy of the states of all parts, and of what they exchange."""
        self._follow()
        saved = [part.call("save_state", self._time) for part in self._plants]
        return saved, self._exchange.memory.copy(), self._time

    def restore_state(self, state: Any) -> None:
        """Go back to a state."""
        saved, self._exchange.memory[:], self._time = state
        for part, one in zip(self._plants, saved, strict=True):
            part.call("restore_state", self._time, one)
        self._is_placed = self._is_current = True

    def free_state(self, state: Any) -> None:
        """Do nothing: the states of the parts are freed with the object."""

    def serialise(self, state: Any) -> bytes:
        """Raise ConfigError: states of a whole are not saved as bytes."""
        raise ConfigError(NOT_AS_BYTES)

    def deserialise(self, content: bytes) -> Any:
        """Raise ConfigError: states of a whole are not saved as bytes."""
        raise ConfigError(NOT_AS_BYTES)

    # Parts

    def _follow(self) -> None:
        """Give the parts time and states, and exchange what follows from them."""
        if not self._is_placed:
            for part, rows in self._states.items():
                y = self._vector(part, part.size, DrivenRun.place, self._time, self._x[rows])
                self._exchange.values[part.output_slice] = y
            self._is_placed, self._is_current = True, False
        if not self._is_current:
            self._exchange.refresh(self._time)
            self._is_current = True

    def _inputs(self, part: Part) -> FloatArray:
        return part.inputs_from(self._exchange.values[part.sources])

    def _differs(self, part: Part, taken: FloatArray | None) -> bool:
        """Whether a part would take other inputs now than it has taken."""
        if taken is None or part in self._due:
            return True
        now = self._exchange.values[part.sources]
        return bool((np.abs(now - taken) > _SAME_INPUT * np.maximum(self._nominal[part], np.abs(now))).any())

    def _updated(self, part: Part, before: FloatArray | None) -> FloatArray:
        """Update the discrete states of a part; return what that left behind, with what was before."""
        info = self._vector(part, 4, DrivenRun.update, self._inputs(part), self._due.pop(part, []))
        if info[0]:
            raise termination(f"{_named([part])}: an event", self._time)
        if before is not None:
            info[1:3] = np.maximum(info[1:3], before[1:3])
        return info

    def _derivatives(self, part: Part, size: int) -> FloatArray:
        """Return the derivatives of a part's states; what is not finite may be with a smaller step."""
        dx = self._vector(part, size, DrivenRun.derivatives, self._inputs(part))
        if not np.isfinite(dx).all():
            place = int(np.argmin(np.isfinite(dx)))
            states = self._plants[part].description.state_order
            name = states[place] if len(states) == size else f"state {place + 1}"
            raise FMUStepError(
                f"{_named([part])}: the derivative of {name} is {dx[place]:g} at t = {shown(self._time)}",
                StepStatus.DISCARD,
                self._time,
            )
        return dx

    def _note_events(self, parts: Sequence[Part]) -> None:
        """Remember which parts have asked for an event, or for another one at once."""
        if parts:
            self._eventful = self._time, parts

    def _gather(
        self, into: FloatArray, rows: Mapping[Part, slice], of: Callable[[Part, int], FloatArray]
    ) -> None:
        """Fill a stacked vector with what the parts have to say, those that have anything."""
        for part, place in rows.items():
            if place.stop > place.start:
                into[place] = of(part, place.stop - place.start)

    def _vector(
        self,
        part: Part,
        size: int,
        method: Callable[[DrivenRun, *Arguments], FloatArray],
        *arguments: *Arguments,
    ) -> FloatArray:
        """Return a vector of a part, of the size that it must have: one number would be taken for all."""
        vector = self._call(part, method, *arguments)
        if len(vector) != size:
            message = f"{_named([part])}: {method.__name__} returned {len(vector)} numbers, not {size}"
            raise FMUStepError(message, StepStatus.CRASHED, self._time)
        return vector

    def _call(self, part: Part, method: Callable[[DrivenRun, *Arguments], T], *arguments: *Arguments) -> T:
        result: T = part.call("drive", self._time, method, *arguments)
        return result


def _named(parts: Iterable[Part]) -> str:
    quoted = [f'"{part.name}"' for part in parts]
    return f"{'part' if len(quoted) == 1 else 'parts'} {', '.join(quoted)}"


def _stacked(sizes: Mapping[Part, int]) -> dict[Part, slice]:
    """Return where the numbers of each part are among those of all."""
    places, begin = dict[Part, slice](), 0
    for part, size in sizes.items():
        places[part] = slice(begin, begin + size)
        begin += size
    return places


def driven_plants(parts: Mapping[str, Plant], wiring: Wiring) -> dict[str, FMUPlant]:
    """Return the parts, FMUs that are driven from now on.

    Raises
    ------
    ConfigError
        Not all parts can be: which ones, and why.
    """
    driven, faults = dict[str, FMUPlant](), list[str]()
    for name, plant in parts.items():
        try:
            if not isinstance(plant, FMUPlant):
                raise ConfigError("it is not an FMU")
            plant.become_driven()
            driven[name] = plant
        except CosimError as error:
            faults.append(f'part "{name}": {error}')
    if faults:
        remedy = 'choose "sequential" or "parallel" with a communication_step, or FMUs for Model Exchange'
        raise ConfigError([f'algorithm = "monolithic": {fault}; {remedy}' for fault in faults])
    for name, plant in driven.items():
        sources = (wiring.values[place] for place in wiring.input_maps[name].sources)
        for variable, source in zip(plant.inputs, sources, strict=True):
            whose, _, output = source.partition(".")
            signal = driven[whose].description.signal(output) if whose in driven else None
            moves = signal is not None and signal.source.variability == "continuous"
            if moves and variable.name in plant.discrete_inputs and not plant.clocks:
                faults.append(
                    f'algorithm = "monolithic": "{name}.{variable.name}" changes at events only, and follows '
                    f'"{source}", which changes all the time; choose "sequential" or "parallel"'
                )
    if faults:
        raise ConfigError(faults)
    return driven
