"""Which outputs of an unstable plant are rates of others: whoever holds a rate holds nothing upright."""

import math
from dataclasses import replace

import numpy as np

from ddpc_cosim.errors import CosimError
from ddpc_cosim.plant import Plant
from ddpc_cosim.suggestion.response_types import Response, ResponseType
from ddpc_cosim.suggestion.step_test import Resting, StepTest
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.units import parse_unit

_STEPS_PER_DOUBLING, _STEPS = 20, 100
_SMALL = 1e-3  # of the steps of the test: nonlinear plants are still where they begin
_OFF, _SCALE = 0.02, 0.1  # how far an integral may be from the output that it is to be


def with_rates(plant: Plant, resting: Resting, tested: StepTest, fixed_step: float | None) -> StepTest:
    """Return the test with unstable outputs that are the derivative of another one, which is as unstable.

    What the other one does far away from its equilibrium says nothing of that: a rod that has fallen over
    turns on and on, and looks like an integrator.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset for every run.
    resting, tested
        Its operating point, and the step test.
    fixed_step : float, optional
        The size of all steps [s].
    """
    doubling = {
        j: min(r.rise_time for r in row if r.is_unstable)
        for j, row in enumerate(tested.responses)
        if any(r.is_unstable for r in row)
    }
    if not doubling or len(plant.outputs) < 2:
        return tested
    step = min(doubling.values()) / _STEPS_PER_DOUBLING
    step = step if fixed_step is None else max(1, round(step / fixed_step)) * fixed_step
    substeps = 1 if fixed_step is None else round(step / fixed_step)
    runs: list[FloatArray] = []
    try:
        for u in (resting.u, resting.u + _SMALL * tested.steps):
            plant.plan(step / substeps, _STEPS * step)
            rows = [plant.reset(resting.parameters)]
            for _ in range(_STEPS):
                for _ in range(substeps):
                    y = plant.step(u, step / substeps)
                rows.append(y)
            runs.append(np.array(rows))
    except CosimError:
        return tested
    deviation = runs[1] - runs[0]
    pairs = ((j, k) for j in doubling for k in range(len(plant.outputs)) if j != k)
    scales = {(j, k): _scale_of_rate(deviation, step, plant.outputs, j, k) for j, k in pairs}
    rates = {(j, k): scale for (j, k), scale in scales.items() if scale and not scales.get((k, j))}
    responses = list(tested.responses)
    for (j, k), scale in rates.items():
        pairs_of_inputs = zip(tested.responses[j], responses[k], strict=True)
        responses[k] = tuple(_as_unstable(rate, other, scale) for rate, other in pairs_of_inputs)
    return replace(tested, responses=tuple(responses), rates=frozenset(j for j, _ in rates))


def _as_unstable(rate: Response, other: Response, scale: float) -> Response:
    """Return the response of an output whose rate runs away: an exponential, as its rate is one."""
    if other.is_unstable or not rate.is_unstable:
        return other
    time_constant = rate.rise_time / math.log(2.0)
    effect, peak = scale * rate.effect * time_constant, abs(scale * rate.peak * time_constant)
    return Response(ResponseType.ACCELERATING, effect, 0.0, rate.rise_time, np.inf, peak)


def _scale_of_rate(
    deviation: FloatArray, step: float, outputs: tuple[Variable, ...], j: int, k: int
) -> float:
    """Return what part of the integral of output j output k is, in units that fit or the same; 0 for none."""
    rate, wanted = deviation[:, j], deviation[:, k] - deviation[0, k]
    integral = np.concatenate(([0.0], np.cumsum((rate[1:] + rate[:-1]) / 2) * step))
    length = float(integral @ integral)
    if not np.isfinite(length) or not length > 0.0:
        return 0.0
    scale = float(integral @ wanted) / length
    off = float(np.linalg.norm(scale * integral - wanted) / np.linalg.norm(wanted)) if wanted.any() else 1.0
    fits = abs(scale - 1.0) < _SCALE or _per_second(outputs[j].unit, outputs[k].unit)
    return scale if off < _OFF and fits else 0.0


def _per_second(unit: str, other: str) -> bool:
    """Return whether a unit is another one per second, but for a factor."""
    if not unit or not other:
        return False
    try:
        rate, value = (dict(parse_unit(text).exponents) for text in (unit, other))
    except ValueError:
        return False
    return value | {"s": value.get("s", 0) - 1} == rate
