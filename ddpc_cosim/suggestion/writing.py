"""A suggested study as a commented file."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import tomli_w

from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.suggestion.choice import Choice, returns
from ddpc_cosim.suggestion.design import Bounds, Setpoints, SuggestedController, drifting
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.response_types import Response, ResponseType
from ddpc_cosim.suggestion.step_test import SHARE, StepTest
from ddpc_cosim.texts import printable
from ddpc_cosim.variables import FloatArray, Variable

_WIDTH = 110


@dataclass(frozen=True)
class Proposal:
    """A suggested study.

    Parameters
    ----------
    plant : str
        Name of the plant, for the title.
    inputs, outputs, measurements : tuple of Variable
        What is driven, controlled and measured.
    parameters : mapping of str to number or str
        Parameters and start values that differ from the plant's defaults.
    start : mapping of str to float
        Where inputs start and rest, as far as the plant declares something else.
    nominal : mapping of str to float
        Sizes of inputs and controlled outputs, in their units: what controllers scale them by.
    bounds : mapping of str to Bounds
        By input.
    setpoints : mapping of str to Setpoints
        By output.
    sampling_time, duration : float
        In s.
    excitation : mapping of str to (float, float)
        Range of the recording's random inputs; empty for no recording.
    samples : int
        Length of the recording.
    controllers : mapping of str to SuggestedController
        The controllers by key.
    comments : mapping of str to tuple of str
        What to know, by section of the study, ``head`` for its beginning: findings, guesses and warnings.
    hints : tuple of str
        What may keep any controller from settling.
    gains : array, shape (p, m)
        Lasting change of the outputs per unit of the inputs; NaN of an output that does not settle.
    rest : array, shape (p,)
        Where the outputs rest.
    limitations : tuple of str
        What the report is to say of the study.
    asked : Request
        What the user wants to have kept.
    coupling : mapping of str to float or str
        Options of the coupling of a system of several FMUs.
    """

    plant: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    parameters: Mapping[str, ParameterValue]
    start: Mapping[str, float]
    nominal: Mapping[str, float]
    bounds: Mapping[str, Bounds]
    setpoints: Mapping[str, Setpoints]
    sampling_time: float
    duration: float
    excitation: Mapping[str, tuple[float, float]]
    samples: int
    controllers: Mapping[str, SuggestedController]
    comments: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    hints: tuple[str, ...] = ()
    gains: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    rest: FloatArray = field(default_factory=lambda: np.zeros(0))
    limitations: tuple[str, ...] = ()
    asked: Request = field(default_factory=Request)
    coupling: Mapping[str, float | str] = field(default_factory=dict)


def study_text(proposal: Proposal, fmu: str) -> str:
    """Return the study file.

    Parameters
    ----------
    proposal : Proposal
        What to write.
    fmu : str
        Path of the FMU as the file is to say it.
    """
    sections = (
        _head(proposal),
        _plant(proposal, fmu),
        _loop(proposal),
        _references(proposal),
        _bounds(proposal),
        _recording(proposal),
        _controllers(proposal),
        ["[report]", f"limitations = {_value([*proposal.limitations])}"] if proposal.limitations else [],
    )
    return "\n".join("\n".join(lines) + "\n" for lines in sections if lines)


def _head(proposal: Proposal) -> list[str]:
    return [
        *_comments(proposal, "head"),
        f"title = {_value(f'Control of {proposal.plant}')}",
        "seeds = [0]",
    ]


def _plant(proposal: Proposal, fmu: str) -> list[str]:
    return [
        *_comments(proposal, "plant"),
        "[plant]",
        f"{'ssp' if fmu.lower().endswith('.ssp') else 'fmu'} = {_value(fmu)}",
        *_names("inputs", proposal.inputs),
        *_names("outputs", proposal.outputs),
        *_names("measurements", proposal.measurements),
        *_subtable("plant.parameters", "the operating point", proposal.parameters),
        *_subtable("plant.start", "where inputs start and rest", proposal.start),
        *_subtable("plant.coupling", "how the parts exchange values, times in s", proposal.coupling),
        *_subtable(
            "plant.nominal", "how far each signal goes: what controllers scale it by", proposal.nominal
        ),
    ]


def _subtable(name: str, what: str, values: Mapping[str, Any]) -> list[str]:
    rows = [f"{_key(key)} = {_value(value)}" for key, value in values.items()]
    return [f"# {what}", f"[{name}]", *rows] if rows else []


def _names(key: str, variables: Iterable[Variable]) -> list[str]:
    return [f"{key} = [", *(f"    {_value(v.name)},{_about(v)}" for v in variables), "]"]


def _about(variable: Variable) -> str:
    unit = f"[{variable.unit}]" if variable.unit else ""
    text = _one_line(f"{unit} {variable.description}")
    return f"  # {text}" if text else ""


def _loop(proposal: Proposal) -> list[str]:
    return [
        *_comments(proposal, "loop"),
        "[loop]",
        f"sampling_time = {_value(proposal.sampling_time)}  # s",
        f"duration = {_value(proposal.duration)}  # s",
    ]


def _references(proposal: Proposal) -> list[str]:
    lines = _comments(proposal, "reference")
    for name, setpoints in proposal.setpoints.items():
        lines += [
            f"[reference.{_key(name)}]",
            'kind = "steps"',
            f"times = {_value(list(setpoints.times))}  # s",
            f"values = {_value(list(setpoints.values))}",
        ]
    return lines


def _bounds(proposal: Proposal) -> list[str]:
    return [
        *_comments(proposal, "bounds"),
        "[bounds]",
        *(
            f"{_key(name)} = {{ min = {_value(b.low)}, max = {_value(b.high)} }}  # {b.origin}"
            for name, b in proposal.bounds.items()
        ),
    ]


def _recording(proposal: Proposal) -> list[str]:
    lines = _comments(proposal, "recording")
    if not proposal.excitation:
        return lines
    return [
        *lines,
        "[recording]",
        f"samples = {proposal.samples}",
        *(
            f"excitation.{_key(name)} = {{ low = {_value(low)}, high = {_value(high)} }}"
            for name, (low, high) in proposal.excitation.items()
        ),
    ]


def _controllers(proposal: Proposal) -> list[str]:
    lines = _comments(proposal, "controllers")
    for key, controller in proposal.controllers.items():
        lines += [*([""] if lines else []), *_controller(key, controller)]
    return lines


def _controller(key: str, controller: SuggestedController) -> Iterator[str]:
    yield from _comment(controller.comment)
    yield f"[controllers.{_key(key)}]"
    yield f"type = {_value(controller.type)}"
    yield f"label = {_value(controller.label)}"
    yield f"[controllers.{_key(key)}.settings]"
    for name, value in controller.settings.items():
        yield f"{_key(name)} = {_value(value)}"


def _comments(proposal: Proposal, section: str) -> list[str]:
    return [line for comment in proposal.comments.get(section, ()) for line in _comment(comment)]


def _comment(text: str) -> Iterator[str]:
    from textwrap import wrap

    return (f"# {line}" for line in wrap(_one_line(text), _WIDTH - 2))


def _one_line(text: str) -> str:
    """Return a text that cannot leave the comment that it stands in."""
    return printable(" ".join(text.split()))


def _value(value: Any) -> str:
    """Return a value in TOML, on one line."""
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in value)}]"
    text = _table({"x": value})
    return text.partition(" = ")[2].strip()


def _key(name: str) -> str:
    """Return a key in TOML, quoted where that is needed."""
    return _table({name: 0}).rpartition(" = ")[0]


def _table(content: Mapping[str, Any]) -> str:
    """Return a table in TOML; what cannot be seen stands in texts only, where it can be written out."""
    toml = tomli_w.dumps(dict(content))
    return "".join(c if c.isprintable() or c == "\n" else f"\\U{ord(c):08x}" for c in toml)


_LISTED = 8
_NEGLIGIBLE = 1e-3  # of an output's level


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What the comments are about.

    Parameters
    ----------
    inputs, outputs : sequence of Variable
        The candidates of the step test.
    tested : StepTest
        Its result.
    choice : Choice
        What was chosen.
    sample : float
        The sampling time [s].
    unstable : bool
        Whether the plant is taken for unstable.
    """

    inputs: Sequence[Variable]
    outputs: Sequence[Variable]
    tested: StepTest
    choice: Choice
    sample: float
    unstable: bool


def comments(
    about: Circumstances, left_out: Sequence[str], warnings: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the comments by section of the study file.

    Parameters
    ----------
    about : Circumstances
        The step test and the choice.
    left_out : sequence of str
        Signals that were not tried.
    warnings : sequence of str
        What is wrong with the FMU but does not keep it from running.
    """
    on_plant = (*_on_responses(about), *_on_what_is_left_out(about, left_out))
    return {
        "plant": (*on_plant, *(f"Warning: {warning}" for warning in warnings)),
        "loop": tuple(_on_timing(about)),
        "reference": tuple(_on_setpoints(about)),
        "bounds": ("Limits of the inputs; outputs have those that the FMU declares.",),
        "recording": tuple(_on_recording(about)),
        "controllers": (
            "`ddpc-cosim list controllers` shows what else can compete, `docs/methods.md` what it does.",
        ),
    }


def _on_responses(about: Circumstances) -> Iterator[str]:
    yield f"Step test up to {about.tested.time[-1]:.3g} s, each input by itself from its start value:"
    for j in about.choice.outputs:
        for i in about.choice.inputs:
            response = about.tested.responses[j][i]
            height = about.tested.steps[i]
            yield f"{about.inputs[i].name} by {height:+.3g}: {about.outputs[j].name} {_in_words(response)}"


def _in_words(response: Response) -> str:
    match response.type:
        case ResponseType.INSENSITIVE:
            return "does not respond"
        case ResponseType.SETTLED if response.is_transient:
            return f"moves by up to {response.peak:.3g} and returns"
        case ResponseType.SETTLED:
            return f"changes by {response.effect:+.3g} within {response.settling_time:.3g} s"
        case ResponseType.INTEGRATING:
            return f"goes on changing by {response.slope:+.3g} per second (it integrates)"
        case ResponseType.ACCELERATING if response.is_unstable:
            return f"runs away, doubling every {response.rise_time:.3g} s (unstable)"
        case ResponseType.ACCELERATING:
            return "goes on changing faster and faster (several integrators)"
        case ResponseType.OSCILLATING:
            return f"oscillates by up to {response.peak:.3g} and does not settle"


def _on_what_is_left_out(about: Circumstances, left_out: Sequence[str]) -> Iterator[str]:
    idle = [v.name for i, v in enumerate(about.inputs) if i not in about.choice.inputs]
    if idle:
        yield f"Inputs left out, as they rest or do little: {_join_words(idle)}."
    others = [v.name for j, v in enumerate(about.outputs) if j not in about.choice.outputs]
    if others:
        yield f"Outputs not controlled: {_join_words(others)}."
    if left_out:
        yield f"Not tried, as there are so many: {_join_words(left_out)}."
    if about.tested.fault:
        yield f"A run of the step test ended early: {about.tested.fault}"


def _join_words(of: Sequence[str]) -> str:
    more = len(of) - _LISTED
    return ", ".join(of[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _on_timing(about: Circumstances) -> Iterator[str]:
    scale = about.choice.time_scale
    if not about.choice.guessed:
        samples = round(scale / about.sample)
        yield f"The plant takes about {scale:.3g} s to settle or to show where it goes: {samples} samples."
    else:
        yield (
            "The responses have no time scale of their own (pure integrators, or no delay at all): "
            "the sampling time is a guess. Choose it from how fast the loop shall be."
        )
    if about.tested.stopped:
        yield "The step test was cut short, as the FMU is slow: slower responses may have been missed."


def _on_setpoints(about: Circumstances) -> Iterator[str]:
    if about.unstable:
        yield "To stay where it begins, then a small step: an unstable plant has to be stabilised first."
        return
    yield "Changes that the inputs can hold with about a third of their ranges, from where the plant rests."
    moving = [about.outputs[j].name for j in about.choice.outputs if drifting(about.tested)[j]]
    if moving:
        yield f"{_join_words(moving)}: drifts even while the inputs rest; the setpoints are around its start."


def _on_recording(about: Circumstances) -> Iterator[str]:
    if about.unstable:
        rows = zip(about.outputs, about.tested.responses, strict=True)
        unsettled = [output.name for output, row in rows if any(response.is_unstable for response in row)]
        yield (
            "No recording and no controller that learns from one: the plant leaves its equilibrium by "
            f"itself ({_join_words(unsettled)}), so an open-loop experiment is of no use. It has to be "
            "stabilised first, and the settings below may not do that."
        )
        return
    yield "The experiment that data-driven controllers learn from: random inputs around rest."
    if _integrates(about):
        yield "An output that integrates wanders during the experiment; if too far, make the range smaller."


def _integrates(about: Circumstances) -> bool:
    return any(
        about.tested.responses[j][i].type is ResponseType.INTEGRATING
        for j in about.choice.outputs
        for i in about.choice.inputs
    )


def hints(about: Circumstances, room: FloatArray) -> Iterator[str]:
    """Return what the step test says of why no controller may settle.

    Parameters
    ----------
    about : Circumstances
        The step test and the choice.
    room : array, shape (m,)
        How far each candidate among the inputs can go, signed.
    """
    tested, inputs = about.tested, about.choice.inputs
    if tested.fails_at_rest:
        yield f"with constant inputs the plant itself fails after {tested.time[-1]:.3g} s: {tested.fault}"
    for i in inputs:
        name, first = about.inputs[i].name, SHARE * room[i]
        if any((j, i) in tested.switched for j in about.choice.outputs) and not about.unstable:
            yield f"{name} acts like a switch: a thousandth of the step does as much"
        elif abs(tested.steps[i]) > abs(first):
            enough = tested.steps[i]
            yield f"{name} has a threshold: a step of {first:.3g} does nothing, one of {enough:.3g} does"
    for j in about.choice.outputs:
        name, row = about.outputs[j].name, tested.responses[j]
        if any(response.is_unstable for response in row):
            yield f"{name} leaves its equilibrium by itself"
            continue
        if all(returns(row[i]) or row[i].type is ResponseType.INSENSITIVE for i in inputs):
            yield f"{name} goes back to where it was whatever the inputs are: none can hold it elsewhere"
            continue
        if math.isfinite(limit := tested.own_limit(j)):
            yield f"{name} integrates until it stops at {limit:.3g}, a limit of its own"
        moved, drift = tested.authority(j, inputs, room), tested.drift(j)
        if moved < drift:
            yield (
                f"{name}: the inputs move it by {moved:.3g} within their limits, and it moves by {drift:.3g} "
                f"while they rest (--range {about.inputs[inputs[0]].name}=LO:HI if it may go further)"
            )
        elif moved < _NEGLIGIBLE * abs(float(tested.rest[-1, j])):
            yield f"{name}: the inputs hardly matter at this operating point, they move it by {moved:.3g}"
