"""What an FMU's inputs are for, by the evidence that there is: driven, acting from outside, switching on."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ddpc_cosim.description import Declarations, PlantSignal, applied_output, default_signals, switches_of
from ddpc_cosim.inspection.words import (
    CERTAIN,
    DEVICES,
    LIKELY,
    Wording,
    command,
    control_error,
    enables,
    is_comparison,
    is_named_controller,
    listed,
    measurement,
    rank_of_output,
    setpoint,
    stops,
)
from ddpc_cosim.suggestion.response_types import Response, ResponseType
from ddpc_cosim.suggestion.step_test import StepTest
from ddpc_cosim.variables import FloatArray, Variable

Evidence = tuple[int, tuple[str, ...]]

MOST_SUSPECTS = 6
_LISTED = 3
_BRIGHT = 800.0  # W/m2: the sun on a clear day
_MIRRORED = 0.02  # of the larger one: how far responses to setpoint and measurement may be from opposite


@dataclass(frozen=True, slots=True)
class Roles:
    """What the inputs of an FMU are for.

    Parameters
    ----------
    driven : tuple of str
        What may be driven, what is called an actuator first.
    disturbances : mapping of str to str
        What looks like a disturbance, and why, by name.
    doubtful : frozenset of str
        Those of them that a word alone speaks of that also stands for what is driven.
    enabling : mapping of str to float
        Inputs that are 0 or 1, start at 0 and may have to be 1 for anything to happen: the 1, by name.
    perhaps_enabling : frozenset of str
        Those among the driven ones that go from 0 to 1, start at 0, and are called nothing that says more.
    fixed : frozenset of str
        Those of them that have turned out to be switches.
    """

    driven: tuple[str, ...]
    disturbances: Mapping[str, str] = field(default_factory=dict)
    doubtful: frozenset[str] = frozenset()
    enabling: Mapping[str, float] = field(default_factory=dict)
    perhaps_enabling: frozenset[str] = frozenset()
    fixed: frozenset[str] = frozenset()


def roles_of(description: Declarations) -> Roles:
    """Return what the inputs that take part if none are named are for, and those that switch something on.

    Words and units make a suspect. A suspect is driven all the same where nothing else is left to drive, and
    one of which less is known where nothing else looks like an actuator and inputs do not outnumber outputs.
    """
    overrides = switches_of(description)
    usual = [s for s in default_signals(description, "input") if s.variable.name not in overrides.values()]
    outputs = len(default_signals(description, "output"))
    binary = [
        signal
        for signal in description.signals("input")
        if _is_binary(signal)
        and signal.variable.name not in overrides.values()
        and not signal.source.alias_of
    ]
    wordings = {signal.variable.name: Wording(signal.variable) for signal in (*usual, *binary)}
    switching = [s for s in binary if s in usual and enables(wordings[s.variable.name])]
    usual = [s for s in usual if s not in switching] or usual
    names = [signal.variable.name for signal in usual]
    evidence = {name: wordings[name].disturbance() for name in names if name not in overrides}
    if any(wordings[name].words == ("u",) for name in names):
        # Control theory's own names: u1, u2 and d or w.
        symbols = {n: "".join(wordings[n].words) for n in evidence if not evidence[n][0]}
        evidence |= {
            name: (LIKELY, (f'it is called "{symbol}" beside "u"',))
            for name, symbol in symbols.items()
            if symbol in ("d", "w")
        }
    evidence |= dict.fromkeys(_pardoned(wordings, evidence), (0, ()))
    evidence = {**evidence, **_unlimited_beside_limited(names, wordings, evidence)}
    certain = [name for name in evidence if evidence[name][0] >= CERTAIN]
    likely = [name for name in evidence if LIKELY <= evidence[name][0] < CERTAIN]
    others = [name for name in names if name not in certain and name not in likely]
    warm = _temperatures_beside(others, wordings)
    if certain and not (others or likely):  # a burner that is on or off is what heats the room
        others = [s.variable.name for s in binary if s not in usual and not stops(wordings[s.variable.name])]
    looks_driven = any(name in overrides or wordings[name].looks_driven for name in others)
    if others and (looks_driven or len(names) > outputs):
        suspects = [*certain, *likely, *warm]
    else:
        suspects = certain if others or likely else []
    driven = [name for name in (*names, *others) if name not in suspects]
    reasons = {name: " and ".join(evidence[name][1]) for name in names if name in suspects}
    there = listed([name for name in names if name not in suspects], _LISTED, "inputs")
    reasons |= {name: f"{reasons[name]}, and there is {there} to drive" for name in warm if name in reasons}
    enabling = {
        signal.variable.name: 1.0
        for signal in binary
        if signal.variable.start == 0.0
        and signal.variable.name not in driven
        and signal.variable.name not in suspects
        and not stops(wordings[signal.variable.name])
    }
    by_word = (name for name in suspects if name in likely and not wordings[name].is_of_a_stream)
    every = tuple(dict.fromkeys(driven))
    return Roles(
        every, reasons, frozenset(by_word), enabling, _perhaps_enabling(every, description, wordings)
    )


def _perhaps_enabling(
    driven: Sequence[str], description: Declarations, wordings: Mapping[str, Wording]
) -> frozenset[str]:
    """Return what goes from 0 to 1 from 0 on, has no unit and no telling name, beside others that do not."""
    signals = (description.signal(name) for name in driven)
    shares = {
        signal.variable.name
        for signal in signals
        if signal is not None
        and (signal.variable.min, signal.variable.max, signal.variable.start) == (0.0, 1.0, 0.0)
        and signal.variable.unit in ("", "1")
    }
    are_all = len(shares) == len(driven)
    return frozenset(
        n for n in shares if not (are_all or wordings[n].says_driven or wordings[n].all & DEVICES)
    )


def _pardoned(wordings: Mapping[str, Wording], evidence: Mapping[str, Evidence]) -> list[str]:
    """Return what is called a feed or so and is driven: with limits where others have none, or as a rate."""
    likely = [name for name in evidence if evidence[name][0] == LIKELY]
    all_limited = all(wordings[name].is_limited for name in evidence)
    devices = any(wordings[name].all & DEVICES for name in evidence)
    return [
        name
        for name in likely
        if (wordings[name].is_limited and not all_limited) or (wordings[name].is_rate and not devices)
    ]


def _unlimited_beside_limited(
    names: Sequence[str], wordings: Mapping[str, Wording], evidence: Mapping[str, Evidence]
) -> dict[str, Evidence]:
    """Return more evidence of inputs without limits beside others that have both: an actuator has them.

    Of several without limits of which nothing else is known it says nothing.
    """
    limited = [
        name for name in names if wordings[name].is_limited and evidence.get(name, (0, ()))[0] < LIKELY
    ]
    if not limited:
        return {}
    free = [n for n in evidence if not (wordings[n].is_limited or wordings[n].says_driven)]
    unknown = [name for name in free if not evidence[name][0]]
    have = f"{listed(limited, _LISTED, 'inputs')} {'has' if len(limited) == 1 else 'have'}"
    return {
        name: (points + LIKELY, (*reasons, f"it has no limits, as {have}"))
        for name, (points, reasons) in ((name, evidence[name]) for name in free)
        if points < CERTAIN and (points or len(unknown) == 1)
    }


def _temperatures_beside(names: Sequence[str], wordings: Mapping[str, Wording]) -> list[str]:
    """Return inlet temperatures: those beside which there is a flow, a power or a valve to drive."""
    warm = [name for name in names if wordings[name].disturbance()[0] == 1 and not wordings[name].is_limited]
    rest = [name for name in names if name not in warm]
    return warm if any(wordings[name].looks_driven for name in rest) else []


def _is_binary(signal: PlantSignal) -> bool:
    """Whether an input is 0 or 1: by its type, or a number by its limits and its name."""
    variable, values = signal.variable, signal.source.values
    is_within = (variable.min, variable.max) == (0.0, 1.0)
    return values == "boolean" or (is_within and (values == "integer" or enables(Wording(variable))))


def order_of_inputs(names: Sequence[str], variables: Mapping[str, Variable]) -> list[str]:
    """Return inputs in the order in which they are tried: what looks like an actuator first."""
    return sorted(names, key=lambda name: not Wording(variables[name]).looks_driven)


def order_of_outputs(variables: Sequence[Variable], overridden: Sequence[str]) -> list[str]:
    """Return outputs in the order in which they are tried as ones to control.

    Readings come first, then what is not known, then what is spent, and what goes on inside last; with it
    what only tells what an override is.
    """
    echoes = {applied_output(name) for name in overridden}
    return [v.name for v in sorted(variables, key=lambda v: 3 if v.name in echoes else rank_of_output(v))]


def usual_range(variable: Variable) -> tuple[float, float] | None:
    """Return between what values a disturbance lies that starts at 0 and says nothing; None: not known."""
    if not Wording(variable).is_irradiance or variable.start or math.isfinite(variable.max):
        return None
    return max(0.0, variable.min), _BRIGHT


def without(
    tested: StepTest, room: FloatArray, columns: Sequence[int]
) -> tuple[tuple[tuple[Response, ...], ...], FloatArray]:
    """Return the responses and the room as if some inputs did nothing, for what is chosen to be driven."""
    still = Response(ResponseType.INSENSITIVE)
    responses = tuple(
        tuple(still if i in columns else r for i, r in enumerate(row)) for row in tested.responses
    )
    return responses, np.where(np.isin(np.arange(len(room)), columns), 0.0, room)


def controller_words(
    title: str, inputs: Sequence[Variable], outputs: Sequence[Variable], tested: StepTest
) -> Iterator[str]:
    """Yield that the FMU looks like a controller, if it does.

    One that compares answers to what is wanted and to what is measured in opposite ways, by as much; a word
    has to say so too, as two flows into a tank do the same. One that gets the difference is known by words,
    any by the name of its model.
    """
    if said := _compares(inputs, outputs, tested) or (title if is_named_controller(title) else ""):
        yield (
            f"This looks like a controller ({said}), not like a plant: to try it on one, give both, "
            "`ddpc-cosim init plant.fmu controller.fmu`"
        )


def _compares(inputs: Sequence[Variable], outputs: Sequence[Variable], tested: StepTest) -> str:
    """Return what is compared and what comes of it; empty where nothing is compared."""
    words = {variable.name: Wording(variable) for variable in (*inputs, *outputs)}
    for j, output in enumerate(outputs):
        row = tested.responses[j]
        for i, wanted in enumerate(inputs):
            is_error = len(inputs) == 1 and control_error(words[wanted.name])
            if is_error and command(words[output.name]) and _responds(row[i]):
                return f"{wanted.name} -> {output.name}"
            if not setpoint(words[wanted.name]):
                continue
            for k, other in enumerate(inputs):
                if k != i and is_comparison(words[wanted.name], words[other.name], words[output.name]):
                    return f"{wanted.name}, {other.name} -> {output.name}"
                is_called_so = measurement(words[other.name]) or command(words[output.name])
                if (
                    k != i
                    and is_called_so
                    and _are_opposite(row[i], row[k], tested.steps[i], tested.steps[k])
                ):
                    return f"{wanted.name}, {other.name} -> {output.name}"
    return ""


def _responds(response: Response) -> bool:
    return response.type is not ResponseType.INSENSITIVE


def _are_opposite(one: Response, other: Response, height: float, other_height: float) -> bool:
    """Whether two responses per unit of their inputs are each other's opposite."""
    if not (_responds(one) and _responds(other)) or one.type is not other.type:
        return False
    a, b = (
        (r.slope if r.type is ResponseType.INTEGRATING else r.effect) / step
        for r, step in ((one, height), (other, other_height))
    )
    return abs(a + b) <= _MIRRORED * max(abs(a), abs(b)) and a != 0.0
