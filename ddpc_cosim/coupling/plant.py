"""Several plants that are one."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, get_args

import numpy as np

from ddpc_cosim.coupling.error_control import ErrorControl
from ddpc_cosim.coupling.exchange import Exchange
from ddpc_cosim.coupling.graph import Graph
from ddpc_cosim.coupling.monolith import NOT_AS_BYTES, Monolith, driven_plants
from ddpc_cosim.coupling.parts import Part
from ddpc_cosim.coupling.ssp import read_ssp
from ddpc_cosim.coupling.wiring import Connection, Wiring
from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.files.plain_data import from_bytes, to_bytes, understood
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.loop.safe_calls import plant_provenance
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.variables import FloatArray, Variable, names
from fmu_plants.spelling import did_you_mean

Algorithm = Literal["sequential", "parallel", "monolithic"]
Extrapolation = Literal["hold", "linear"]
_WHOLE = 1e-6
# So much of coupled FMUs is exact that it does not tell into which parts they were cut.
_TOLERANCE = 1e-10


class _SavedState(NamedTuple):
    """The states of all parts, what they exchange, and when."""

    parts: Sequence[object]
    memory: FloatArray
    time: tuple[float, int, float]
    halvings: int
    end_error: CosimError | None


class CoupledPlant(Plant):
    """Several plants and their connections behind the contract of one.

    Parameters
    ----------
    parts : mapping of str to Plant
        The plants by name, without dots; from now on theirs is the coupled plant that closes them.
    connections : sequence of Connection
        What they exchange.
    inputs, outputs : sequence of str, optional
        Signals of the whole, ``"part.variable"`` or names of connectors; default: its connectors, then all
        inputs that no connection feeds, and all outputs. An input that no connection feeds and that is not
        named rests at its start value.
    algorithm : str
        ``"sequential"``: a part has the newest values of those before it (Gauss-Seidel); ``"parallel"``:
        all have the values at the beginning of the step (Jacobi); ``"monolithic"``: the parts, FMUs that are
        all for Model Exchange, are one differential equation, which is integrated as that of one FMU is:
        nothing is exchanged in steps.
    communication_step : float, optional
        Time between two exchanges [s], of which the sampling time is a multiple; default: the sampling time.
    steps : mapping of str to float, optional
        Steps of parts that differ from it [s]: multiples, or parts of it.
    extrapolation : str
        ``"hold"``: values are held over a step; ``"linear"``: they are continued on a line, which is exact to
        second order.
    loop_tolerance : float
        How exactly algebraic loops are solved, relative to nominal or present values.
    error_tolerance : float, optional
        Error that one sample may add to a value, relative to nominal or present values, as it is estimated:
        communication steps are repeated in halves, and halves of them, until it is kept (Richardson). All
        parts must be able to save their states. If monolithic: the relative tolerance of the integration
        (1e-12 to 1e-2), 1e-10 by default.
    connectors : sequence of Variable
        Names, units and start values of the system's own connectors.
    parameters : mapping of str to float, int, bool or str, optional
        Values that differ from the parts' own in every run, ``"part.name"``; :meth:`reset` may give others.

    Attributes
    ----------
    order : tuple of str
        The parts in the order in which they are stepped.
    loops : tuple of tuple of str
        The algebraic loops, as ``"part.variable"``.

    Raises
    ------
    ConfigError
        Names, units, sizes or steps do not fit; all faults at once.

    Examples
    --------
    >>> parts = {"first": FMUPlant(pendulum_fmu), "second": FMUPlant(pendulum_fmu)}
    >>> plant = CoupledPlant(parts, [Connection("first.angle", "second.torque", convert_units=False)])
    >>> [variable.name for variable in plant.inputs]
    ['first.torque']
    >>> plant.order
    ('first', 'second')
    >>> plant.close()
    """

    def __init__(
        self,
        parts: Mapping[str, Plant],
        connections: Sequence[Connection],
        *,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        algorithm: Algorithm = "sequential",
        communication_step: float | None = None,
        steps: Mapping[str, float] | None = None,
        extrapolation: Extrapolation = "hold",
        loop_tolerance: float = 1e-9,
        error_tolerance: float | None = None,
        connectors: Sequence[Variable] = (),
        parameters: Mapping[str, ParameterValue] | None = None,
    ) -> None:
        steps = steps or {}
        faults = [
            f'{name} = "{value}" is not possible; allowed: {", ".join(allowed)}'
            for name, value, allowed in (
                ("algorithm", algorithm, get_args(Algorithm)),
                ("extrapolation", extrapolation, get_args(Extrapolation)),
            )
            if value not in allowed
        ]
        numbers = {
            "communication_step": communication_step,
            "loop_tolerance": loop_tolerance,
            "error_tolerance": error_tolerance,
            **{f'steps["{part}"]': step for part, step in steps.items()},
        }
        faults += [
            f"{name} = {value!r} is not possible; allowed: a finite number > 0"
            for name, value in numbers.items()
            if value is not None and not 0.0 < value < np.inf
        ]
        faults += [
            f'steps: no part "{name}"; {did_you_mean(name, parts)}' for name in steps if name not in parts
        ]
        is_monolithic = algorithm == "monolithic"
        if is_monolithic:
            needless = {
                "communication_step": communication_step is not None,
                "steps": bool(steps),
                "extrapolation": extrapolation == "linear",
            }
            faults += [
                f'{name}: leave it out, as with algorithm = "monolithic" nothing is exchanged in steps'
                for name, is_given in needless.items()
                if is_given
            ]
        elif error_tolerance is not None:
            faults += [
                f'error_tolerance: a step cannot be repeated, as part "{name}" cannot save its state'
                for name, plant in parts.items()
                if not plant.can_save_state
            ]
            if steps:
                faults.append("error_tolerance: it chooses the steps, of all parts alike; leave out steps")
        if faults:
            raise ConfigError(faults)
        wiring = Wiring(parts, connections, inputs, outputs, connectors)
        graph = Graph(parts, wiring)
        faults = [
            f'algebraic loop of {", ".join(loop)}: part "{name}" cannot give its outputs without a step (it '
            "has no outputs_at); without a declared dependency they are taken one communication step late"
            for loop in graph.loops
            for name in dict.fromkeys(text.partition(".")[0] for text in loop)
            if not parts[name].can_give_outputs
        ]
        if faults:
            raise ConfigError(faults)
        driven = driven_plants(parts, wiring) if is_monolithic else {}
        self.inputs, self.outputs = wiring.inputs, wiring.outputs
        self.order, self.loops = graph.order, graph.loops
        self.dependencies = graph.dependencies()
        self._wiring = wiring
        self._read = None if wiring.output_map.is_scaled else wiring.output_map.sources
        self._parts = {n: Part(n, parts[n], wiring.input_maps[n], wiring.slices[n]) for n in graph.order}
        self._communication_step, self._steps = communication_step, steps
        self._how = algorithm if is_monolithic else f"{algorithm}, {extrapolation}"
        self._exchange = Exchange(
            tuple(self._parts.values()),
            wiring,
            graph,
            sequential=algorithm != "parallel",
            linear=extrapolation == "linear",
            loop_tolerance=loop_tolerance,
        )
        self._parameters = dict(parameters or {})
        self._monolith: Monolith | None = None
        self._control: ErrorControl | None = None
        if is_monolithic:
            self._monolith = Monolith(
                {part: driven[name] for name, part in self._parts.items()},
                self._exchange,
                wiring.scale,
                error_tolerance or _TOLERANCE,
            )
        elif error_tolerance is not None:
            order = 2 if extrapolation == "linear" else 1
            taken = [input_map.sources for input_map in (*wiring.input_maps.values(), wiring.output_map)]
            watched = np.unique(np.concatenate(taken))
            self._control = ErrorControl(
                tuple(self._parts.values()),
                self._exchange,
                order,
                error_tolerance,
                watched,
                wiring.scale[watched],
            )
        self._base_time, self._samples, self._h, self._interval = 0.0, 0, 0.0, 0.0
        self._end_error: CosimError | None = ConfigError("step before reset")

    @classmethod
    def from_ssp(cls, path: str | Path, *, isolated: bool = False, **options: Any) -> Self:
        """Return the system of an SSP archive as one plant.

        Parameters
        ----------
        path : str or Path
            The archive, of SSP 1.0 or 2.0.
        isolated : bool
            Whether each FMU lives in a process of its own.
        **options : Any
            Further arguments of :class:`CoupledPlant`; ``inputs`` and ``outputs`` are by default the
            connectors of the system, of one without any those of its parts.

        Raises
        ------
        ConfigError
            What is wrong with the archive; all faults at once.
        FMUImportError
            An FMU cannot be loaded.
        """
        system = read_ssp(Path(path))
        is_monolithic = options.get("algorithm") == "monolithic"
        for key, exposed in (("inputs", system.inputs), ("outputs", system.outputs)):
            options.setdefault(key, names(exposed) or None)
        values = {f"{p.name}.{key}": value for p in system.parts for key, value in p.parameters.items()}
        with ExitStack() as opened:
            parts = dict[str, Plant]()
            for part in system.parts:
                parts[part.name] = opened.enter_context(
                    FMUPlant(
                        part.fmu,
                        inputs=part.inputs,
                        outputs=part.outputs,
                        fmi_type="auto" if is_monolithic else part.fmi_type,
                        start=part.start,
                        isolated=isolated,
                    )
                )
            connections = [connection.connection for connection in system.connections]
            connectors = (*system.inputs, *system.outputs)
            values |= options.pop("parameters", None) or {}
            plant = cls(parts, connections, connectors=connectors, parameters=values, **options)
            opened.pop_all()
        return plant

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._base_time + self._samples * self._h

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Tell all parts their steps and the stop time."""
        self._schedule_steps(sampling_time)
        for part in self._parts.values():
            step = self._interval * part.every / part.substeps
            part.call("plan", self.time, step, stop_time)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Reset all parts and return the outputs, shape (p,), with everything exchanged at ``t0``.

        Parameters are named ``"part.name"``; an input that rests can be given too.
        """
        by_part, resting = self._by_part({**self._parameters, **(parameters or {})})
        self._base_time, self._samples = t0, 0
        if self._control is not None:
            self._control.halvings = 0
        if self._monolith is not None:
            self._monolith.end()
        exchange = self._exchange
        exchange.reset(t0)
        for place, value in resting.items():
            exchange.values[place] = value
        for name, part in self._parts.items():
            exchange.values[part.output_slice] = part.reset(by_part.get(name, {}), t0)
        if self._monolith is not None:
            self._monolith.start(t0)
        else:
            exchange.refresh(t0)
        self._end_error = None
        return self._current_outputs()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        if h != self._h or self._end_error is not None:
            self._get_ready(h)
        if self._monolith is not None:
            self._end_error = self._monolith.step(u, h)
        else:
            time = self._base_time + self._samples * h
            self._exchange.set_inputs(u, time)
            self._end_error = self._advance(self._interval, time)
        self._samples += 1
        return self._exchange.values[self._read] if self._read is not None else self._current_outputs()

    def _get_ready(self, h: float) -> None:
        """Go over to another sampling time [s], or raise what keeps the plant from going on."""
        if self._end_error is not None:
            raise self._end_error
        self._base_time, self._samples = self.time, 0
        self._schedule_steps(h)

    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Change tunable parameters, ``"part.name"``, and inputs that rest, from the next step on."""
        by_part, resting = self._by_part(parameters)

        def set_values() -> None:
            for place, value in resting.items():
                self._exchange.values[place] = value
            for name, chosen in by_part.items():
                self._parts[name].call("set_parameters", self.time, chosen)

        if self._monolith is not None:
            self._monolith.change(set_values)
            return
        set_values()
        self._exchange.refresh(self.time, map(self._parts.__getitem__, by_part))

    def outputs_at(self, u: FloatArray) -> FloatArray:
        """Return the outputs now, shape (p,), at other inputs u, shape (m,)."""
        if self._monolith is not None:
            self._monolith.outputs_at(u)
        else:
            self._exchange.values[: len(self.inputs)] = u
            self._exchange.refresh(self.time)
        return self._current_outputs()

    @property
    def can_save_state(self) -> bool:
        """Whether the states of all parts can be saved."""
        return all(part.plant.can_save_state for part in self._parts.values())

    def save_state(self) -> object:
        """Return a copy of the states of all parts and of what they exchange."""
        halvings = 0 if self._control is None else self._control.halvings
        return _SavedState(
            [part.call("save_state", self.time) for part in self._parts.values()]
            if self._monolith is None
            else [self._monolith.saved_run()],
            self._exchange.memory.copy(),
            (self._base_time, self._samples, self._h),
            halvings,
            self._end_error,
        )

    def restore_state(self, state: object) -> None:
        """Go back to a saved state."""
        whole, parts = self._monolith, self._parts.values()
        if not isinstance(state, _SavedState) or len(state.parts) != (len(parts) if whole is None else 1):
            raise ConfigError("the state to restore is not one of this coupled plant")
        if whole is not None:
            whole.restore_run(state.parts[0])
        else:
            for part, saved in zip(parts, state.parts, strict=True):
                part.call("restore_state", self.time, saved)
        self._exchange.memory[:] = state.memory
        self._base_time, self._samples, h = state.time
        if h != self._h:
            self._schedule_steps(h)
        if self._control is not None:
            self._control.halvings = state.halvings
        self._end_error = state.end_error

    @property
    def can_serialise_state(self) -> bool:
        """Whether the states of all parts can be saved as bytes."""
        parts = self._parts.values()
        return self._monolith is None and all(part.plant.can_serialise_state for part in parts)

    def serialise_state(self) -> bytes:
        """Return the states of all parts and what they exchange as bytes."""
        if self._monolith is not None:
            raise ConfigError(NOT_AS_BYTES)
        states, faults = dict[str, bytes](), list[str]()
        for name, part in self._parts.items():
            try:
                states[name] = part.call("serialise_state", self.time)
            except ConfigError as error:
                faults += error.faults
        if faults:
            raise ConfigError(faults)
        if self._end_error is not None:
            raise self._end_error
        return to_bytes(
            {
                "parts": states,
                "values": list(self._wiring.values),
                "memory": self._exchange.memory,
                "clock": (self._base_time, self._samples, self._h),
                "halvings": 0 if self._control is None else self._control.halvings,
            }
        )

    def deserialise_state(self, content: bytes) -> FloatArray:
        """Go on from the state of another run of the same parts; return the outputs there, shape (p,)."""
        if self._monolith is not None:
            raise ConfigError(NOT_AS_BYTES)
        exchange = self._exchange
        with understood("the state of the coupled plant"):
            saved = from_bytes(content)
            base_time, samples, h = map(float, saved["clock"])
            time = base_time + samples * h
            exchange.reset(time)
            for name, part in self._parts.items():
                y = part.call("deserialise_state", time, saved["parts"][name])
                exchange.values[part.output_slice] = y
            place = {name: i for i, name in enumerate(saved["values"])}
            for i, name in enumerate(self._wiring.values):
                if name in place:  # the whole may have other inputs and outputs by now
                    exchange.memory[:, i] = saved["memory"][:, place[name]]
            if self._control is not None:
                self._control.halvings = int(saved["halvings"])
        self._base_time, self._samples = base_time, int(samples)
        if h and h != self._h:
            self._schedule_steps(h)
        return self._current_outputs()

    def close(self) -> None:
        """Close all parts, also if some cannot."""
        self._end_error = ConfigError("step after close")
        first: Exception | None = None
        if self._monolith is not None:
            self._monolith.end()
        for part in self._parts.values():
            try:
                part.call("close", self.time)
            except Exception as error:
                if first is None:
                    first = error
                else:
                    first.add_note(str(error))
        if first is not None:
            raise first

    def provenance(self) -> Mapping[str, str]:
        """Return how the parts are coupled, and the identifiers of each, ``"part.name"``."""
        identifiers = {"class": "CoupledPlant", "coupling": self._how, "parts": ", ".join(self._parts)}
        for name, part in self._parts.items():
            identifiers |= {f"{name}.{key}": value for key, value in plant_provenance(part.plant).items()}
        return identifiers

    def _current_outputs(self) -> FloatArray:
        sources, factor, offset = self._wiring.output_map
        return factor * self._exchange.values[sources] + offset

    def _schedule_steps(self, h: float) -> None:
        """Divide a sample of h [s] into communication intervals, and these among the parts."""
        wanted, faults = self._communication_step, []
        intervals = 1 if wanted is None else _whole(h, wanted)
        if intervals is None:
            raise ConfigError(
                f"communication_step = {wanted:g} s does not divide the sampling time of {h:g} s"
            )
        interval = h / intervals
        for name, step in self._steps.items():
            part = self._parts[name]
            part.every, part.substeps = _whole(step, interval) or 1, _whole(interval, step) or 1
            fits = _whole(step, interval) is not None or _whole(interval, step) is not None
            if not fits or intervals % part.every:
                faults.append(
                    f'steps["{name}"] = {step:g} s fits neither the communication step of {interval:g} s nor '
                    f"the sampling time of {h:g} s: one must divide the other"
                )
        if faults:
            raise ConfigError(faults)
        self._h, self._interval = h, interval
        self._exchange.schedule(intervals if self._control is None else 1)
        self._advance = self._exchange.advance_once if intervals == 1 else self._exchange.advance
        if self._control is not None:
            self._advance = partial(self._control.advance, intervals)

    def _by_part(
        self, parameters: Mapping[str, ParameterValue]
    ) -> tuple[dict[str, dict[str, ParameterValue]], dict[int, float]]:
        """Return parameters by part, and the values of inputs that rest by their place."""
        by_part: dict[str, dict[str, ParameterValue]] = {}
        resting: dict[int, float] = {}
        faults = []
        for full, value in parameters.items():
            part, _, name = full.partition(".")
            if full in self._wiring.resting:
                resting[self._wiring.resting[full]] = float(value)
            elif part in self._parts and name:
                by_part.setdefault(part, {})[name] = value
            else:
                faults.append(f'no parameter "{full}": its part must be one of {", ".join(self._parts)}')
        if faults:
            raise ConfigError(faults)
        return by_part, resting


def _whole(long: float, short: float) -> int | None:
    """Return how many short times make a long one, None if the ratio is not an integer."""
    ratio = long / short
    number = round(ratio)
    return number if number >= 1 and abs(ratio - number) <= _WHOLE * number else None
