"""What the file of a suggested study says about how it came about."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ddpc_cosim.diagnosis.choice import Choice, runs_away
from ddpc_cosim.diagnosis.design import drifting
from ddpc_cosim.diagnosis.responses import Nature, Response
from ddpc_cosim.diagnosis.step_test import StepTest
from ddpc_cosim.variables import Variable

_LISTED = 8


@dataclass(frozen=True, slots=True)
class Circumstances:
    """What the remarks are about.

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


def remarks(
    about: Circumstances, left_out: Sequence[str], warnings: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the remarks by section of the study file.

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
    match response.nature:
        case Nature.INSENSITIVE:
            return "does not respond"
        case Nature.SETTLED if response.is_transient:
            return f"moves by up to {response.peak:.3g} and returns"
        case Nature.SETTLED:
            return f"changes by {response.effect:+.3g} within {response.settling_time:.3g} s"
        case Nature.INTEGRATING:
            return f"goes on changing by {response.slope:+.3g} per second (it integrates)"
        case Nature.ACCELERATING if runs_away(response):
            return f"runs away, doubling every {response.rise_time:.3g} s (unstable)"
        case Nature.ACCELERATING:
            return "goes on changing faster and faster (several integrators)"
        case Nature.OSCILLATING:
            return f"oscillates by up to {response.peak:.3g} and does not settle"


def _on_what_is_left_out(about: Circumstances, left_out: Sequence[str]) -> Iterator[str]:
    idle = [v.name for i, v in enumerate(about.inputs) if i not in about.choice.inputs]
    if idle:
        yield f"Inputs left out, as they rest or do little: {_listed(idle)}."
    others = [v.name for j, v in enumerate(about.outputs) if j not in about.choice.outputs]
    if others:
        yield f"Outputs not controlled: {_listed(others)}."
    if left_out:
        yield f"Not tried, there being so many: {_listed(left_out)}."
    if about.tested.fault:
        yield f"A run of the step test ended early: {about.tested.fault}"


def _listed(of: Sequence[str]) -> str:
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
        yield "To stay where it begins: an unstable plant has to be stabilised before it is moved."
        return
    yield "Changes that the inputs can hold with about a third of their ranges, from where the plant rests."
    moving = [about.outputs[j].name for j in about.choice.outputs if drifting(about.tested)[j]]
    if moving:
        yield f"{_listed(moving)}: drifts even while the inputs rest; the setpoints are around its start."


def _on_recording(about: Circumstances) -> Iterator[str]:
    if about.unstable:
        rows = zip(about.outputs, about.tested.responses, strict=True)
        unsettled = [output.name for output, row in rows if any(map(runs_away, row))]
        yield (
            "No recording and no controller that learns from one: the plant leaves its equilibrium by "
            f"itself ({_listed(unsettled)}), so an open-loop experiment is of no use. It has to be "
            "stabilised first, and the settings below may not do that."
        )
        return
    yield "The experiment that data-driven controllers learn from: random inputs around rest."
    if _integrates(about):
        yield "An output that integrates wanders during the experiment; if too far, make the range smaller."


def _integrates(about: Circumstances) -> bool:
    return any(
        about.tested.responses[j][i].nature is Nature.INTEGRATING
        for j in about.choice.outputs
        for i in about.choice.inputs
    )
