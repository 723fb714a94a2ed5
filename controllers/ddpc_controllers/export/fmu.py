"""A controller that is an FMU: one that was exported from here, or one of Simulink, Modelica or another tool.

At sample k its inputs are set to what is measured and wanted then, it does one step of the sampling time, and
what its outputs are after that is the control signal u_k.
"""

import json
import re
import warnings
import zipfile
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from math import isfinite, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ddpc_controllers.checks import prior_info
from ddpc_cosim import (
    OK,
    Action,
    ConfigError,
    Controller,
    ControllerError,
    CosimWarning,
    FloatArray,
    FMUImportError,
    FMUStepError,
    Loop,
    Recording,
    Sample,
    Variable,
    check_settings,
    further_arguments,
    further_signals,
    setting,
)
from ddpc_cosim.files.texts import printable

if TYPE_CHECKING:  # what runs FMUs is imported where there is one
    from ddpc_cosim import FMUPlant

_RESOURCE = "resources/controller.json"
_AHEAD = re.compile(
    r"(?P<kind>reference|forecast|lower|upper|price|min|max)\.(?P<name>.+)\[(?P<k>[1-9]\d*)\]"
)
_WHOLE = 1e-6
_NONE = 1e30
"""How far off an edge or a limit is that there is not, for an FMU."""
_ROUNDING = 1e-9
_CLIPPED = "an input beyond the bounds of this loop, clipped"


@dataclass(kw_only=True)
class FMUController(Controller):
    """A controller that is an FMU.

    Its inputs get the loop's signals: controlled outputs and measurements by name, ``setpoint.NAME`` (the
    reference now), ``reference.NAME[k]`` (that in k samples), and as :func:`ddpc_cosim.further_signals` names
    them disturbances, forecasts, edges of bands, prices and limits that move, where the loop has such. Its
    outputs called as the plant's inputs are the control signal, those beside them are recorded as
    information. Units are converted where both sides
    have one. An FMU that was exported from here is told missing measurements as NaN, says in words why its
    answer is a fallback, and follows the past of a plant that it takes over; another one starts from rest.
    """

    file: str = setting(file=True, doc="path of the FMU")
    signals: Mapping[str, str | float] = setting(
        default_factory=dict,
        doc="of its variables, by name: the signal in the loop, or for an input a constant; others: alike",
    )
    parameters: Mapping[str, Any] = setting(default_factory=dict, doc="parameters of the FMU, by name")
    status: str = setting("status", doc="its output that is 0 where all is well, if it has it")
    several_steps: bool = setting(
        False, doc="an FMU of a fixed, shorter step does several in a sample, inputs held"
    )
    isolated: bool = setting(False, doc="open the FMU in a process of its own")

    def __post_init__(self) -> None:
        check_settings(self)
        if not Path(self.file).is_file():
            raise ConfigError(f"{self.file}: no such file")
        with _errors_as(ConfigError), self._open() as plant:
            description = plant.description
            interface = description.preferred
            self._tool = description.generation_tool
            self._step = interface.fixed_step if interface is not None else None
            if interface is not None and not interface.variable_step:
                self._step = self._step or description.default_experiment.step_size
            inputs, self._outputs = (
                {signal.variable.name: signal.variable for signal in description.signals(kind)}
                for kind in ("input", "output")
            )
            # Each needs a signal but those that are not real numbers, such as switches.
            needed = {variable.name for variable in plant.inputs} | set(self.signals)
        self._inputs = {name: variable for name, variable in inputs.items() if name in needed}
        self._resource = _resource_of(self.file)
        # Of an FMU from here: what tells it that it is not active, and what drives the plant then.
        self._hand_over: Sequence[str] = self._resource.get("hand_over", ())
        known = [*inputs, *self._outputs]
        faults = [f'the FMU has no "{n}"; it has: {", ".join(known)}' for n in self.signals if n not in known]
        constant = [n for n in self._outputs if not isinstance(self.signals.get(n, n), str)]
        faults += [f'"{name}" is an output, which is not a constant' for name in constant]
        if faults:
            raise ConfigError([f"signals: {fault}" for fault in faults])

    @property
    def horizon(self) -> int:  # type: ignore[override]  # the FMU has it
        """How many future references its inputs ask for."""
        ahead = (_AHEAD.fullmatch(str(self._signal_of(name))) for name in self._inputs)
        return max((int(match["k"]) for match in ahead if match), default=0)

    @property
    def accepts_missing(self) -> bool:
        """Whether it was exported from here, and so takes NaN for a missing measurement."""
        return bool(self._resource)

    def start(self, loop: Loop) -> None:
        """Connect its variables with the loop's signals and initialise it.

        Raises
        ------
        ConfigError
            Inputs or outputs without a signal, units that do not fit, or another sampling time, by name.
        ControllerError
            The FMU cannot be loaded or initialised.
        """
        self._check_step(loop.sampling_time)
        controlled = [variable.name for variable in loop.outputs]
        self._others = [i for i, v in enumerate(loop.measurements) if v.name not in controlled]
        measured = [*loop.outputs, *(loop.measurements[i] for i in self._others)]
        # The loop's signals side by side: what is measured, then the references of one sample after another.
        whole = replace(loop, preview=self.horizon)
        self._further = further_arguments(whole, self.horizon)
        further = further_signals(whole, self.horizon)
        first = len(measured) + (1 + self.horizon) * len(controlled)
        of_further = {variable.name: first + i for i, variable in enumerate(further)}
        signals = [*measured, *(1 + self.horizon) * loop.outputs, *further]
        wanted, faults = dict[str, Variable](), list[str]()
        places, self._constants = list[int](), list[float]()
        for name in self._inputs:
            signal = self._signal_of(name)
            if name in self._hand_over and name not in self.signals:
                places.append(len(signals) + len(self._constants))
                self._constants.append(self._inputs[name].start)
            elif not isinstance(signal, str):
                places.append(len(signals) + len(self._constants))
                self._constants.append(float(signal))
            elif (place := of_further.get(signal, _place(signal, measured, controlled))) is not None:
                places.append(place)
                wanted[name] = signals[place]
            else:
                has = ", ".join(variable.name for variable in measured)
                faults.append(
                    f'input "{name}": the loop has no signal "{signal}"; it has: {has}; '
                    "setpoint.NAME and reference.NAME[k] of controlled outputs; map it in `signals`"
                )
        driving = {str(self._signal_of(name)): name for name in self._outputs}
        for variable in loop.inputs:
            if variable.name in driving:
                wanted[driving[variable.name]] = variable
            else:
                has = ", ".join(self._outputs) or "none"
                faults.append(f'no output is called "{variable.name}"; there are: {has}; map it in `signals`')
        if faults:
            raise ConfigError([f"{Path(self.file).name}: {fault}" for fault in faults])
        controls = [driving[variable.name] for variable in loop.inputs]
        self._others_out = [name for name in self._outputs if name not in controls]
        described = {**self._inputs, **self._outputs}
        units = {n: v.unit for n, v in wanted.items() if v.unit and described[n].unit not in ("", v.unit)}
        self._how = {
            "inputs": list(self._inputs),
            "outputs": [*controls, *self._others_out],
            "display_units": units,
        }
        with _errors_as(ControllerError):
            self._plant = self._open(**self._how)
            self._reset(0.0)
        self._to, self._from = (
            _scales(variables, units)
            for variables in (self._plant.inputs, self._plant.outputs[: len(controls)])
        )
        self._converts = bool(units)
        self._places, self._sampling_time = np.array(places, dtype=np.intp), loop.sampling_time
        self._low, self._high = loop.bounds.u_min, loop.bounds.u_max
        # What it was exported with is not of a loop that goes on where an experiment ended.
        past = None if loop.continues_recording else loop.past
        self._past = self._rows_before(past)
        self._ignored = past is not None and not self._hand_over

    def step(self, sample: Sample) -> Action:
        """Return the FMU's outputs after a step with this sample's inputs, shape (m,)."""
        parts = [sample.y, sample.measured[self._others], sample.setpoint, sample.reference.ravel()]
        for name, shape in self._further.items():
            parts.append(np.clip(getattr(sample, name)[: shape[0]].ravel(), -_NONE, _NONE))
        inputs = np.concatenate((*parts, self._constants))[self._places]
        if self._converts:
            inputs = (inputs - self._to[1]) / self._to[0]
        try:
            if sample.k == 0 and (sample.time or len(self._past)):
                self._reset(sample.time - len(self._past) * self._sampling_time)
                for before in self._past:
                    self._do_step(before)
            outputs = self._do_step(inputs)
        except FMUStepError as error:
            raise ControllerError(str(error)) from error
        m = len(self._low)
        u, others = outputs[:m], dict(zip(self._others_out, outputs[m:].tolist(), strict=True))
        if self._converts:
            u = u * self._from[0] + self._from[1]
        status = self._status_words(others.pop(self.status, 0.0))
        held = np.minimum(np.maximum(u, self._low), self._high)
        if (held != u).any():
            if not np.isfinite(u).all():
                raise ControllerError(f"{Path(self.file).name}: the control signal is {u.tolist()}")
            if np.abs(u - held).max() > _ROUNDING * np.abs(held).max() and status == OK:
                status = _CLIPPED
        return Action(held, status, {name: value for name, value in others.items() if isfinite(value)})

    def warnings(self) -> Sequence[str]:
        """Return that it does not follow the past of a plant that it takes over."""
        if not self._ignored:
            return []
        return [
            f"{Path(self.file).name}: cannot follow a running plant before it takes over: it starts from rest"
        ]

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals that it gets; only an FMU exported from here says what else it knows."""
        named = {self._signal_of(name) for name in self._inputs}
        used = [v for v in (*loop.outputs, *loop.measurements) if v.name in named]
        made = f"what its FMU was made with ({printable(self._tool)})"
        if recording := self._resource.get("recording"):
            made = (
                f"what the recording was made on that it had learned from, of {recording['samples']} samples"
            )
        return prior_info(made, used)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the FMU: what it has been given leads to where it is."""
        return {name: value for name, value in vars(self).items() if name != "_plant"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if "_how" not in state:
            return
        given = np.frombuffer(self._given).reshape(-1, len(self._inputs))
        with _errors_as(ControllerError):
            self._plant = self._open(**self._how)
            self._reset(self._began)
            for inputs in given:
                self._plant.step(inputs, self._sampling_time)
        self._given.frombytes(given.tobytes())

    def _do_step(self, inputs: FloatArray) -> FloatArray:
        """Return the outputs, and note what was given."""
        outputs = self._plant.step(inputs, self._sampling_time)
        self._given.frombytes(inputs.tobytes())
        return outputs

    def _rows_before(self, past: Recording | None) -> FloatArray:
        """Return its inputs at the samples of a running plant's past, one row each, not active."""
        if past is None or not self._hand_over:
            return np.empty((0, len(self._places)))
        n, references = len(past), np.tile(past.y, 1 + self.horizon)
        further = [np.full((n, prod(shape)), np.nan) for shape in self._further.values()]
        for name, columns in zip(self._further, further, strict=True):
            if name == "disturbance":
                columns[...] = past.d
        constants = np.tile(self._constants, (n, 1))
        rows = np.hstack([past.y, past.measured[:, self._others], references, *further, constants])[
            :, self._places
        ]
        names = list(self._inputs)
        rows[:, names.index(self._hand_over[0])] = 0.0
        if self._converts:
            rows = (rows - self._to[1]) / self._to[0]
        scales = zip(
            past.u.T, self._from.T if self._converts else [(1.0, 0.0)] * past.u.shape[1], strict=True
        )
        for name, (u, (factor, offset)) in zip(self._hand_over[1:], scales, strict=True):
            rows[:, names.index(name)] = (u - offset) / factor
        return np.asarray(rows)

    def _reset(self, time: float) -> None:
        """Initialise the FMU at a time [s]; nothing has been given to it yet."""
        self._plant.reset(self.parameters, time)
        self._began, self._given = time, array("d")

    def _open(self, **how: Any) -> "FMUPlant":
        from ddpc_cosim import FMUPlant

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CosimWarning)  # `inspect` shows them
            return FMUPlant(self.file, isolated=self.isolated, **how)

    def _signal_of(self, name: str) -> str | float:
        return self.signals.get(name, name)

    def _check_step(self, sampling_time: float) -> None:
        """Raise ConfigError where the FMU is made for another sampling time."""
        if self._step is None:
            return
        steps = sampling_time / self._step
        allowed = max(round(steps), 1) if self.several_steps else 1
        if abs(steps - allowed) > _WHOLE:
            raise ConfigError(
                f"{Path(self.file).name}: the FMU's step is fixed at {self._step:g} s, the loop's sampling "
                f"time is {sampling_time:g} s; choose this sampling time, or export the FMU for the loop's; "
                "where its step is a part of the loop's, several_steps = true has it do several in a sample"
            )

    def _status_words(self, value: float) -> str:
        """Return a status in words: of a sum of bits, where the FMU explains them."""
        if value == 0.0:
            return OK
        bits = int(value) if value.is_integer() and value > 0 else 0
        explained = self._resource.get("status", {}).items()
        said = [str(text) for bit, text in explained if bits & int(bit)]
        return "; ".join(said) or f"status {value:g}"


def _place(signal: str, measured: Sequence[Variable], controlled: Sequence[str]) -> int | None:
    """Return where a signal stands among what is measured and the references; None if there is none."""
    names = [variable.name for variable in measured]
    if signal in names:
        return names.index(signal)
    ahead = _AHEAD.fullmatch(signal)
    if ahead and ahead["kind"] != "reference":
        return None
    name, k = (ahead["name"], int(ahead["k"])) if ahead else (signal.removeprefix("setpoint."), 0)
    if name not in controlled or name == signal:
        return None
    return len(names) + k * len(controlled) + controlled.index(name)


def _scales(variables: Sequence[Variable], units: Mapping[str, str]) -> Any:
    """Return factors and offsets from the FMU's units to the loop's, shape (2, n)."""
    shown = [(v.shown_in.factor, v.shown_in.offset) if v.name in units else (1.0, 0.0) for v in variables]
    return np.array(shown, dtype=np.float64).reshape(-1, 2).T


def _resource_of(file: str) -> dict[str, Any]:
    """Return the metadata of an FMU that was exported from here; nothing of another one."""
    with suppress(KeyError, ValueError), zipfile.ZipFile(file) as archive:
        content = json.loads(archive.read(_RESOURCE))
        return content if isinstance(content, dict) else {}
    return {}


@contextmanager
def _errors_as(kind: type[ConfigError | ControllerError]) -> Iterator[None]:
    """Turn faults of the FMU into errors of a controller: those of an FMU are the plant's."""
    try:
        yield
    except (FMUImportError, FMUStepError) as error:
        raise kind(str(error)) from error
