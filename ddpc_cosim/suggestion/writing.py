"""A suggested study as a commented file."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import tomli_w

from ddpc_cosim.codec import write_in_short
from ddpc_cosim.errors import CosimError, Place
from ddpc_cosim.files.durations import in_words
from ddpc_cosim.files.texts import printable
from ddpc_cosim.inspection.words import listed
from ddpc_cosim.signals.signals import Steps
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.suggestion.choice import Choice, returns
from ddpc_cosim.suggestion.design import WHY_SETTINGS, drifting
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.response_types import Response, ResponseType
from ddpc_cosim.suggestion.step_test import SHARE, StepTest
from ddpc_cosim.variables import FloatArray, Variable

_WIDTH = 110


@dataclass(frozen=True)
class Proposal:
    """A suggested study, and what is to be said of it.

    Parameters
    ----------
    study : Study
        What is suggested, with the plant's file by its absolute path.
    inputs, outputs, measurements : tuple of Variable
        What is driven, controlled and measured.
    origins : mapping of str to str
        Where the limits of the inputs come from, by input.
    comments : mapping of str to tuple of str
        What to know, by section of the study, ``head`` for its beginning: findings, guesses and warnings.
    hints : tuple of str
        What may keep any controller from settling.
    gains : array, shape (p, m)
        Lasting change of the outputs per unit of the inputs; NaN of an output that does not settle.
    rest : array, shape (p,)
        Where the outputs rest.
    asked : Request
        What the user wants to have kept.
    reasons : tuple of str
        Why each connection of a coupled plant is proposed.
    """

    study: Study
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    origins: Mapping[str, str] = field(default_factory=dict)
    comments: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    hints: tuple[str, ...] = ()
    gains: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    rest: FloatArray = field(default_factory=lambda: np.zeros(0))
    asked: Request = field(default_factory=Request)
    reasons: tuple[str, ...] = ()

    def changed(self, **sections: Any) -> Self:
        """Return the proposal with other sections of the study, by their names."""
        return replace(self, study=replace(self.study, **sections))

    @property
    def setpoints(self) -> dict[str, Steps]:
        """The references, which are steps, by output."""
        return {
            name: signal for name, signal in (self.study.reference or {}).items() if isinstance(signal, Steps)
        }

    @property
    def sampling_time(self) -> float:
        """Time between samples [s]."""
        return self.study.loop.sampling_time


_OF_TABLES: dict[Place, str] = {
    ("plant", "coupling"): "how the parts exchange values, times in s",
    ("plant", "parameters"): "the operating point",
    ("plant", "start"): "where inputs start and rest",
    ("plant", "nominal"): "how far each signal goes: what controllers scale it by",
}


def study_text(proposal: Proposal, *fmus: str) -> str:
    """Return the study file.

    Parameters
    ----------
    proposal : Proposal
        What to write.
    *fmus : str
        Path of the FMU, or of each part's, as the file is to say it.

    Raises
    ------
    CosimError
        A number is not finite.
    """
    study = proposal.study
    if study.plant.parts:
        parts = [replace(part, fmu=fmu) for part, fmu in zip(study.plant.parts, fmus, strict=True)]
        plant = replace(study.plant, parts=parts)
    elif study.plant.identified:
        plant = replace(study.plant, identified=replace(study.plant.identified, file=[*fmus]))
        study = replace(study, recording=study.recording and replace(study.recording, file=[*fmus]))
    else:
        (fmu,) = fmus
        plant = replace(study.plant, fmu=fmu) if study.plant.fmu else replace(study.plant, ssp=fmu)
    said = {"title": study.title, "seeds": study.seeds}
    tables = said | write_in_short(replace(study, plant=plant))
    if unknown := [*_not_finite(tables)]:
        raise CosimError(
            f"{study.plant.label}: {', '.join(unknown)} could not be identified and would not be a number; "
            "raise --budget, or choose other signals with --input and --output"
        )
    above: dict[Place, Sequence[str]] = {(key,): texts for key, texts in proposal.comments.items()}
    above[()] = above.pop(("head",), ())
    above |= {place: (text,) for place, text in _OF_TABLES.items()}
    above |= {
        ("controllers", key): (WHY_SETTINGS[section.type],)
        for key, section in study.controllers.items()
        if section.type in WHY_SETTINGS
    }
    return commented_toml(tables, above, _remarks(proposal))


def _not_finite(value: Any, place: str = "") -> Iterator[str]:
    """Yield the places of what is not a finite number."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _not_finite(item, f"{place}.{key}" if place else str(key))
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for i, item in enumerate(value):
            yield from _not_finite(item, f"{place}[{i}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield place


def _remarks(proposal: Proposal) -> dict[Place, str]:
    """Return what stands beside values, by their places: units, descriptions, and where limits come from."""
    remarks: dict[Place, str] = {("loop", "sampling_time"): "s", ("loop", "duration"): "s"}
    loop = proposal.study.loop
    remarks |= {
        ("loop", key): f"s, {in_words(getattr(loop, key))}"
        for key in ("start_time", "warm_up", "communication_step")
        if getattr(loop, key) is not None
    }
    for key in ("inputs", "outputs", "measurements"):
        signals: Sequence[Variable] = getattr(proposal, key)
        remarks |= {("plant", key, i): f"{_unit(v)} {v.description}" for i, v in enumerate(signals)}
    remarks |= {("plant", "connections", i): why for i, why in enumerate(proposal.reasons)}
    remarks |= {("plant", "parts", i): "" for i in range(len(proposal.study.plant.parts))}
    remarks |= {("reference", name, "times"): "s" for name in proposal.study.reference or {}}
    remarks |= {("bounds", name): origin for name, origin in proposal.origins.items()}
    return remarks | {("recording", "excitation", v.name): _unit(v) for v in proposal.inputs}


def _unit(variable: Variable) -> str:
    return f"[{variable.unit}]" if variable.unit else ""


def commented_toml(
    tables: Mapping[str, Any], above: Mapping[Place, Sequence[str]], beside: Mapping[Place, str]
) -> str:
    """Return a TOML file with comments.

    Parameters
    ----------
    tables : mapping
        What the file says.
    above : mapping of Place to sequence of str
        Comments above tables.
    beside : mapping of Place to str
        Comments beside values, each of which stands on one line: tables, and the entries of a list.
    """

    def lines(table: Mapping[str, Any], place: Place, before: Sequence[str]) -> Iterator[str]:
        """Yield a table; what is said of one that holds tables alone stands above the first of them."""
        comment_above = [*_comment_lines(above.get(place, ()))]
        head = [*before, *([""] if before and comment_above else []), *comment_above]
        below = {key: v for key, v in table.items() if isinstance(v, dict) and (*place, key) not in beside}
        if len(below) < len(table) or not table:
            yield from ["", *head, f"[{'.'.join(map(_key, map(str, place)))}]"] if place else head
            head = []
        for key, value in table.items():
            at = (*place, key)
            if (*at, 0) in beside:
                entries = (f"    {_value(item)},{remark((*at, i))}" for i, item in enumerate(value))
                yield from (f"{_key(key)} = [", *entries, "]")
            elif key not in below:
                yield f"{_key(key)} = {_value(value)}{remark(at)}"
        for key, value in below.items():
            yield from lines(value, (*place, key), head)
            head = []

    def remark(place: Place) -> str:
        text = _one_line(beside.get(place, ""))
        return f"  # {text}" if text else ""

    return "\n".join([*lines(tables, (), []), ""])


def _value(value: Any) -> str:
    """Return a value in TOML, on one line."""
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{_key(key)} = {_value(item)}' for key, item in value.items())} }}"
    return _line("x", value).partition(" = ")[2]


def _key(name: str) -> str:
    """Return a key in TOML, quoted where that is needed."""
    return _line(name, 0).rpartition(" = ")[0]


def _line(key: str, value: Any) -> str:
    """Return a line of TOML; what cannot be seen stands in texts only, where it can be written out."""
    line = tomli_w.dumps({key: value}).rstrip("\n")
    return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in line)


def _comment_lines(texts: Iterable[str]) -> Iterator[str]:
    from textwrap import wrap

    return (
        f"# {line}" for text in texts for line in wrap(_one_line(text), _WIDTH - 2, break_on_hyphens=False)
    )


def _one_line(text: str) -> str:
    """Return a text that cannot leave the comment that it stands in."""
    return printable(" ".join(text.split()))


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
    acting : frozenset of str
        Inputs that are taken for disturbances.
    """

    inputs: Sequence[Variable]
    outputs: Sequence[Variable]
    tested: StepTest
    choice: Choice
    sample: float
    unstable: bool
    acting: frozenset[str] = frozenset()


def comments(
    about: Circumstances, left_out: tuple[Sequence[str], Sequence[str]], warnings: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the comments by section of the study file.

    Parameters
    ----------
    about : Circumstances
        The step test and the choice.
    left_out : pair of sequences of str
        Inputs and outputs that were not tried.
    warnings : sequence of str
        What is wrong with the FMU but does not keep it from running.
    """
    on_plant = (*_on_responses(about), *_on_what_is_left_out(about, left_out))
    by_section = {
        "plant": (*on_plant, *(f"Warning: {warning}" for warning in warnings)),
        "loop": tuple(_on_timing(about)),
        "reference": tuple(_on_setpoints(about)),
        "bounds": ("Limits of the inputs; outputs have those that the FMU declares.",),
        "recording": (),
        "controllers": (
            "`ddpc-cosim list controllers` shows what else can compete, `docs/methods/` what it does.",
        ),
    }
    there = "controllers" if about.unstable else "recording"  # without a recording the next section says why
    return by_section | {there: (*_on_recording(about), *by_section[there])}


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


def _on_what_is_left_out(
    about: Circumstances, left_out: tuple[Sequence[str], Sequence[str]]
) -> Iterator[str]:
    chosen = about.choice.inputs
    idle = [v.name for i, v in enumerate(about.inputs) if i not in chosen and v.name not in about.acting]
    if idle:
        yield f"Inputs left out, as they rest or do little: {listed(idle, _LISTED, 'inputs')}."
    others = [v.name for j, v in enumerate(about.outputs) if j not in about.choice.outputs]
    if others:
        yield f"Outputs not controlled: {listed(others, _LISTED, 'outputs')}."
    for names, tried, what in zip(
        left_out, (about.inputs, about.outputs), ("inputs", "outputs"), strict=True
    ):
        if names:
            count = f"{len(tried)} of {len(tried) + len(names)} {what}"
            yield f"Tried are {count}; not tried, as there are so many: {listed(names, _LISTED, what)}."
    if about.tested.fault:
        yield f"A run of the step test ended early: {about.tested.fault}"


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
    period = about.tested.period
    if period.means:
        names = listed([about.outputs[j].name for j in period.means], _LISTED, "outputs")
        yield (
            f"{names} repeats every {period.words} while the inputs rest: the setpoints are around its mean; "
            "they are held, and the experiment lasts, for whole periods, where these are not too long."
        )
    moving = [about.outputs[j].name for j in about.choice.outputs if drifting(about.tested)[j]]
    if moving:
        which = listed(moving, _LISTED, "outputs")
        yield f"{which}: drifts even while the inputs rest; the setpoints are around its start."


def _on_recording(about: Circumstances) -> Iterator[str]:
    if about.unstable:
        rows = zip(about.outputs, about.tested.responses, strict=True)
        unsettled = [output.name for output, row in rows if any(response.is_unstable for response in row)]
        which = listed(unsettled, _LISTED, "outputs")
        yield (
            "No recording and no controller that learns from one: the plant leaves its equilibrium by "
            f"itself ({which}), so an open-loop experiment is of no use. It has to be "
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
