"""What can be known before the loop is closed: whether recording and limits can serve for this reference."""

from collections.abc import Sequence
from itertools import chain

import numpy as np

from ddpc_cosim.controller import Loop
from ddpc_cosim.errors import DataError
from ddpc_cosim.variables import FloatArray, Variable

# Relative to the largest value: what changes by less has not changed.
_STANDSTILL = 1e-12
# The farthest reference, in root mean squares of the recorded output about its mean: excited up to the
# limits, a plant is seldom asked for more than 3; what was learned from a hundredth of the way is noise.
_FAR = 10.0
_BEYOND = 3.0
# Root mean square of a recorded input about its mean, in parts of half its range; 0.58 fills the range.
_FAINT = 0.01

# In parts of the limit: what goes beyond it by less was rounded, such as by a conversion of units.
_ROUNDED = 1e-9

CANNOT_FOLLOW = "a controller that keeps to the limit cannot follow the reference there"


def recording_warnings(loop: Loop, reference: FloatArray) -> tuple[str, ...]:
    """Return why a loop's recording hardly tells what the reference asks for.

    Parameters
    ----------
    loop : Loop
        The loop, with a recording.
    reference : array, shape (K, p)
        All references of the run, in the outputs' units, time along axis 0.

    Raises
    ------
    DataError
        An input stands still or an output never moves: there is nothing to learn of it.
    """
    recording = loop.recording
    if recording is None:
        return ()
    still = [f'the input "{v.name}" stands still' for v in _still(loop.inputs, recording.u)]
    still += [f'the output "{v.name}" never moves' for v in _still(loop.outputs, recording.y)]
    if still:
        raise DataError(
            f"the recording of {len(recording)} samples cannot serve: {'; '.join(still)}; excite every input "
            "so that every controlled output answers"
        )
    center, size = recording.y.mean(axis=0), recording.y.std(axis=0)
    way = np.abs(reference - center).max(axis=0, initial=0.0) / size
    return tuple(chain(_far_references(loop, way, size), _faint_inputs(loop, recording.u, way)))


def references_beyond_limits(
    outputs: Sequence[Variable], reference: FloatArray, y_min: FloatArray, y_max: FloatArray
) -> list[str]:
    """Return which references go beyond the limits of their own outputs, and how far, in display units.

    Parameters
    ----------
    outputs : sequence of Variable
        The controlled outputs.
    reference : array, shape (K, p)
        Their references, in their units, time along axis 0.
    y_min, y_max : array, shape (p,) or (K, p)
        Their limits, in their units; time along axis 0 where they move.
    """
    warnings = []
    lower, upper = (np.broadcast_to(limits, reference.shape) for limits in (y_min, y_max))
    for i, variable in enumerate(outputs if len(reference) else ()):
        for way, which, limits in (("down", "lower", lower[:, i]), ("up", "upper", upper[:, i])):
            excess = reference[:, i] - limits if way == "up" else limits - reference[:, i]
            worst = int(np.argmax(excess))
            extreme, limit = float(reference[worst, i]), float(limits[worst])
            if excess[worst] > _ROUNDED * max(abs(limit), abs(extreme)):
                shown = variable.shown_in.from_unit(np.array([extreme, limit]))
                far, near = (f"{value:.6g} {variable.shown_in.name}".strip() for value in shown)
                warnings.append(
                    f"the reference of {variable.name} goes {way} to {far}, its {which} limit is {near}"
                )
    return warnings


def _still(variables: tuple[Variable, ...], values: FloatArray) -> list[Variable]:
    ends = zip(values.min(axis=0).tolist(), values.max(axis=0).tolist(), strict=True)
    moving = (high - low > _STANDSTILL * max(-low, high) for low, high in ends)
    return [variable for variable, moves in zip(variables, moving, strict=True) if not moves]


def _far_references(loop: Loop, way: FloatArray, size: FloatArray) -> list[str]:
    return [
        f'the reference of "{variable.name}" goes {times:.0f} times as far as the recording, which moves '
        f"it by {_shown(variable, rms)} (root mean square about its mean): record with a larger excitation"
        for variable, times, rms in zip(loop.outputs, way, size, strict=True)
        if times > _FAR
    ]


def _faint_inputs(loop: Loop, u: FloatArray, way: FloatArray) -> list[str]:
    """Faint against its limits is an input only where the outputs did not get to the reference with it."""
    if not (way > _BEYOND).any():
        return []
    bounds = loop.bounds
    half = bounds.u_max / 2 - bounds.u_min / 2
    size = u.std(axis=0)
    return [
        f'the recorded input "{variable.name}" moves by {_shown(variable, rms)} (root mean square about its '
        f"mean), {100 * rms / room:.2g} % of half its range: record with a larger excitation"
        for variable, rms, room in zip(loop.inputs, size, half, strict=True)
        if np.isfinite(room) and rms < _FAINT * room
    ]


def _shown(variable: Variable, value: float) -> str:
    return f"{value:.3g} {variable.unit}".strip()
