"""Which outputs of an unstable plant are rates of others: whoever holds a rate holds nothing upright."""

import numpy as np

from ddpc_cosim.errors import CosimError
from ddpc_cosim.plant import Plant
from ddpc_cosim.suggestion.step_test import Resting, StepTest
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.units import parse_unit

_STEPS_PER_DOUBLING, _STEPS = 20, 100
_SMALL = 1e-3  # of the steps of the test: nonlinear plants are still where they begin
_OFF, _SCALE = 0.02, 0.1  # how far an integral may be from the output that it is to be


def rates_among(plant: Plant, resting: Resting, tested: StepTest, fixed_step: float | None) -> frozenset[int]:
    """Return unstable outputs that are the derivative of another unstable one, by position.

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
    if len(doubling) < 2:
        return frozenset()
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
        return frozenset()
    deviation = runs[1] - runs[0]
    pairs = ((j, k) for j in doubling for k in doubling if j != k)
    found = {(j, k) for j, k in pairs if _is_rate(deviation, step, plant.outputs, j, k)}
    return frozenset(j for j, k in found if (k, j) not in found)


def _is_rate(deviation: FloatArray, step: float, outputs: tuple[Variable, ...], j: int, k: int) -> bool:
    """Return whether output j is the derivative of output k, in units that fit or in the same ones."""
    rate, wanted = deviation[:, j], deviation[:, k] - deviation[0, k]
    integral = np.concatenate(([0.0], np.cumsum((rate[1:] + rate[:-1]) / 2) * step))
    length = float(integral @ integral)
    if not np.isfinite(length) or not length > 0.0:
        return False
    scale = float(integral @ wanted) / length
    off = float(np.linalg.norm(scale * integral - wanted) / np.linalg.norm(wanted)) if wanted.any() else 1.0
    return off < _OFF and (abs(scale - 1.0) < _SCALE or _per_second(outputs[j].unit, outputs[k].unit))


def _per_second(unit: str, other: str) -> bool:
    """Return whether a unit is another one per second, but for a factor."""
    if not unit or not other:
        return False
    try:
        rate, value = (dict(parse_unit(text).exponents) for text in (unit, other))
    except ValueError:
        return False
    return value | {"s": value.get("s", 0) - 1} == rate
