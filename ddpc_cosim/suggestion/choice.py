"""Which inputs to drive and which outputs to control, from the responses to steps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ddpc_cosim.suggestion.response_types import Response, ResponseType
from ddpc_cosim.suggestion.step_test import StepTest
from ddpc_cosim.variables import FloatArray

MOST_INPUTS, MOST_OUTPUTS = 6, 4
_INDEPENDENT = 0.05
_NEARLY_BEST = 0.5
_LASTS = 0.2  # of its peak: what an oscillation about something else has on average
# How many doublings, rises and lags make a time scale like that of a response that settles.
_DOUBLINGS, _RISES, _LAGS = 7.0, 20.0, 10.0


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen signals by their positions among the candidates.

    Parameters
    ----------
    inputs, outputs : tuple of int
        What is driven and what is controlled.
    gains : array, shape (p, m)
        Lasting effect of one unit of each chosen input on each chosen output after ``time_scale``, in the
        output's unit.
    time_scale : float
        How long the plant takes to get where it goes [s].
    guessed : bool
        Whether the responses do not tell that, so that ``time_scale`` is the one that was given.
    """

    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    gains: FloatArray
    time_scale: float
    guessed: bool


def choose(tested: StepTest, room: FloatArray, fallback: float, *, all_outputs: bool) -> Choice:
    """Choose inputs that do something, and outputs that they can hold independently of each other.

    Parameters
    ----------
    tested : StepTest
        The responses.
    room : array, shape (m,)
        How far each input can go.
    fallback : float
        Time scale where the responses have none: pure integrators, static plants [s].
    all_outputs : bool
        Whether the user has chosen the outputs: then all of them are kept.
    """
    every = Choice((*range(len(room)),), (*range(len(tested.responses)),), np.zeros((0, 0)), np.inf, True)
    first = _chosen(tested, room, _scale(tested, every, fallback), all_outputs)
    if not first.inputs:
        return first
    # What is not chosen may be faster or slower by any factor.
    second = _chosen(tested, room, _scale(tested, first, fallback), all_outputs)
    return second if second.inputs else first


def _scale(tested: StepTest, choice: Choice, fallback: float) -> tuple[float, bool]:
    """Return the time scale of some signals, and whether it is a guess."""
    shown = np.inf if tested.static else _time_scale(tested, choice)
    return (shown, False) if np.isfinite(shown) else (fallback, True)


def _chosen(tested: StepTest, room: FloatArray, scale: tuple[float, bool], all_outputs: bool) -> Choice:
    """Return the choice where the plant has such a time scale, which may be a guess."""
    time_scale, guessed = scale
    gains = lasting_gains(tested, time_scale)
    if all_outputs:  # where nothing lasts, peaks are the only measure
        gains = np.where(gains.any(axis=1, keepdims=True), gains, _peaks(tested))
    else:
        gains[list(tested.rates)] = 0.0
        gains = _not_adrift(_urgent(gains, tested.responses), tested, room)
    reach = np.abs(gains) * np.abs(room)
    lively = [i for i in range(len(room)) if np.any(reach[:, i] > 0.0)]
    lively = sorted(sorted(lively, key=lambda i: -_relative_reach(reach)[i])[:MOST_INPUTS])
    if not lively:
        return Choice((), (), np.zeros((0, 0)), time_scale, guessed)
    if all_outputs:
        chosen = list(range(len(tested.responses)))
    else:
        order = sorted(range(len(gains)), key=lambda j: any(map(_is_rough, tested.responses[j])))
        reach = gains[np.ix_(order, lively)] * np.abs(room[lively])
        chosen = sorted(order[k] for k in _independent(reach, min(len(lively), MOST_OUTPUTS)))
        lively = [i for i in lively if any(_moves(tested.responses[j][i]) for j in chosen)]
    return Choice(tuple(lively), tuple(chosen), gains[np.ix_(chosen, lively)], time_scale, guessed)


def lasting_gains(tested: StepTest, time_scale: float) -> FloatArray:
    """Return what one unit of each input changes in each output for good, shape (p, m).

    Where nothing lasts, the largest magnitudes have to do.
    """
    gains = np.zeros((len(tested.responses), len(tested.steps)))
    for j, row in enumerate(tested.responses):
        for i, response in enumerate(row):
            if response.type is ResponseType.ACCELERATING and not response.is_unstable:
                # Several integrators, most probably two: a parabola.
                share = time_scale / float(tested.time[-1])
                gains[j, i] = response.effect * share**2 / tested.steps[i]
            elif response.type is ResponseType.INTEGRATING:
                gains[j, i] = response.slope * time_scale / tested.steps[i]
            elif response.type is not ResponseType.INSENSITIVE and not returns(response):
                gains[j, i] = response.effect / tested.steps[i]
    if not gains.any():
        return _peaks(tested)
    return gains


def _peaks(tested: StepTest) -> FloatArray:
    """Return by how much one unit of each input moves each output at most, shape (p, m)."""
    peaks = np.array([[response.peak for response in row] for row in tested.responses])
    moved: FloatArray = peaks.reshape(len(tested.responses), len(tested.steps)) / tested.steps
    return moved


def returns(response: Response) -> bool:
    """Whether an output goes back to where it was, if only on average: nothing that an input could hold."""
    swings = response.type is ResponseType.OSCILLATING
    return response.is_transient or (swings and abs(response.effect) <= _LASTS * response.peak)


def _urgent(gains: FloatArray, responses: Sequence[Sequence[Response]]) -> FloatArray:
    """Return the gains without those of stable outputs if there are unstable ones: they come first."""
    unstable = np.array([any(response.is_unstable for response in row) for row in responses])
    return np.where(unstable[:, np.newaxis], gains, 0.0) if unstable.any() else gains


def _not_adrift(gains: FloatArray, tested: StepTest, room: FloatArray) -> FloatArray:
    """Return the gains without those of outputs that drift by more than inputs can, if others are left.

    An energy that is used up, a distance covered: no input holds what only ever goes on.
    """
    kept = np.array(
        [tested.authority(j, range(len(room)), room) >= tested.drift(j) for j in range(len(gains))]
    )
    held = np.where(kept[:, np.newaxis], gains, 0.0)
    return held if held.any() else gains


def _is_rough(response: Response) -> bool:
    """Whether a response does not come to rest, or goes in jumps: there may be a better output."""
    return response.type is ResponseType.OSCILLATING or response.held > 0.0


def _time_scale(tested: StepTest, choice: Choice) -> float:
    """Return the longest settling time; where nothing settles, what else tells how fast the plant is."""
    pairs = (tested.responses[j][i] for j in choice.outputs for i in choice.inputs)
    every = [response for response in pairs if not tested.is_immediate(response)]
    doubling = [_DOUBLINGS * r.rise_time for r in every if r.is_unstable]
    if doubling:
        return min(doubling)
    settling = [r.settling_time for r in every if r.type is ResponseType.SETTLED and not r.is_transient]
    if settling:
        return max(settling)
    seen = float(tested.time[-1])  # a test that is cut short leaves all that was slower unsettled
    oscillating = [min(_RISES * r.rise_time, seen) for r in every if r.type is ResponseType.OSCILLATING]
    lagging = [_LAGS * r.rise_time for r in every if r.type is ResponseType.INTEGRATING and r.rise_time > 0.0]
    transient = [r.settling_time for r in every if r.type is ResponseType.SETTLED]
    for times in (oscillating, transient, lagging):
        if np.isfinite(times).any():
            return float(max(time for time in times if np.isfinite(time)))
    return np.inf


def _moves(response: Response) -> bool:
    return response.type is not ResponseType.INSENSITIVE


def _relative_reach(reach: FloatArray) -> FloatArray:
    """Return, for each input, the largest share that it has in what all inputs do to an output."""
    largest = np.max(reach, axis=1, keepdims=True)
    share = np.divide(reach, largest, out=np.zeros_like(reach), where=largest > 0.0)
    best: FloatArray = np.max(share, axis=0)
    return best


def _independent(reach: FloatArray, most: int) -> list[int]:
    """Return outputs that the inputs move in different directions, the earlier ones preferred.

    Gram-Schmidt on the rows of the reach, scaled to length one: an output is taken if what the outputs before
    it do not already settle is nearly the largest there is.
    """
    length = np.linalg.norm(reach, axis=1, keepdims=True)
    rest = np.divide(reach, length, out=np.zeros_like(reach), where=length > 0.0)
    chosen: list[int] = []
    while len(chosen) < most:
        left = np.linalg.norm(rest, axis=1)
        left[chosen] = 0.0
        if left.max(initial=0.0) <= _INDEPENDENT:
            break
        j = int(np.argmax(left >= _NEARLY_BEST * left.max()))
        direction = rest[j] / np.linalg.norm(rest[j])
        rest = rest - np.outer(rest @ direction, direction)
        chosen.append(j)
    return chosen
