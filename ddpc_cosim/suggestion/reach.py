"""How far outputs really go: inputs that setpoints would need, held in open loop before they are proposed."""

import numpy as np

from ddpc_cosim.plant import Plant
from ddpc_cosim.suggestion.choice import Choice
from ddpc_cosim.suggestion.design import Range, Reach, reachable
from ddpc_cosim.suggestion.response_types import ResponseType
from ddpc_cosim.suggestion.step_test import Resting, StepTest, Timing, runs_with

_TRUSTED = 0.5  # of what a step has moved an output by
_ENDS = {ResponseType.SETTLED, ResponseType.INSENSITIVE}


def tried_reach(
    plant: Plant, resting: Resting, tested: StepTest, choice: Choice, working: Range, timing: Timing
) -> Reach:
    """Hold the inputs at what setpoints need, one run for each, and return how far the outputs go.

    Outputs that settle count where they end, others where they are after the time scale, less what they do by
    themselves. What the step test itself has reached counts where a run says less.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset for every run.
    resting : Resting
        The inputs at rest.
    tested : StepTest
        What is known of the plant.
    choice : Choice
        The signals.
    working : Range
        Of the chosen inputs.
    timing : Timing
        How steps are, and for how long this may take.
    """
    reach = Reach.unknown(len(choice.outputs))
    if tested.stopped or any(response.is_unstable for row in tested.responses for response in row):
        return reach
    inverse, chosen = np.linalg.pinv(choice.gains), list(choice.inputs)
    ways = zip((1.0, -1.0), reachable(choice.gains, working), (reach.up, reach.down), strict=True)
    tries = [(row, sign, way[row], side) for sign, way, side in ways for row in range(len(way))]
    held = np.tile(resting.u, (len(tries), 1))
    for u, (row, sign, way, _) in zip(held, tries, strict=True):
        u[chosen] += sign * way * inverse[:, row]
    for y, (row, sign, _, side) in zip(runs_with(plant, resting, tested, held, timing), tries, strict=True):
        if y is None:
            continue
        j = choice.outputs[row]
        responses = [tested.responses[j][i] for i in chosen]
        settles = all(response.type in _ENDS for response in responses)
        end = -1 if settles else min(int(np.searchsorted(tested.time, choice.time_scale)), len(y) - 1)
        change = sign * (y[end, j] - tested.rest[end, j]) if len(y) == len(tested.rest) else 0.0
        shown = [_TRUSTED * sign * response.effect for response in responses if settles]
        side[row] = max(change, *shown, 0.0)
    return reach
