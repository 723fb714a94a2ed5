"""Two halves of an oscillator, as FMUs, become the whole one with the order that theory promises.

Values that are held over a step are wrong by O(h) in it, those on a line by O(h^2): so are the results (M.
Arnold, C. Clauss, T. Schierz, Error analysis and error estimates for co-simulation in FMI for Model Exchange
and Co-Simulation V2.0, Archive of Mechanical Engineering 60 (2013) 75-94).
"""

import math
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import CoupledPlant, FMUPlant
from ddpc_cosim.variables import FloatArray

from .conftest import Exported
from .oscillator import CUTS, OUTPUTS, exact

SAMPLING_TIME = 0.1
FORCES = [math.sin(k) for k in range(10)]


def coupled(
    exported: Exported, cut: str, version: str = "2.0", fmi_type: Any = "auto", **options: Any
) -> CoupledPlant:
    models, connections = CUTS[cut]
    parts = {
        name: FMUPlant(exported(model, version), fmi_type=fmi_type, tolerance=1e-9)
        for name, model in zip(("front", "back"), models, strict=True)
    }
    return CoupledPlant(parts, connections, inputs=["front.force"], outputs=OUTPUTS, **options)


def run(plant: CoupledPlant) -> FloatArray:
    with plant:
        rows = [plant.reset()]
        rows += [plant.step(np.array([force]), SAMPLING_TIME) for force in FORCES]
    return np.array(rows)


@pytest.mark.parametrize(("extrapolation", "order"), [("hold", 1), ("linear", 2)])
@pytest.mark.parametrize("algorithm", ["sequential", "parallel"])
@pytest.mark.parametrize("cut", CUTS)
def test_the_order_is_that_of_theory(
    exported: Exported, cut: str, algorithm: str, extrapolation: str, order: int
) -> None:
    errors = []
    for intervals in (16, 32, 64):
        plant = coupled(
            exported,
            cut,
            algorithm=algorithm,
            extrapolation=extrapolation,
            communication_step=SAMPLING_TIME / intervals,
        )
        errors.append(np.abs(run(plant) - exact(FORCES, SAMPLING_TIME)).max())
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    assert observed == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("algorithm", ["sequential", "parallel"])
@pytest.mark.parametrize(
    ("version", "fmi_type"), [("2.0", "model-exchange"), ("3.0", "co-simulation"), ("3.0", "model-exchange")]
)
def test_how_the_halves_are_run_makes_no_difference(
    exported: Exported, version: str, fmi_type: str, algorithm: str
) -> None:
    options = {"algorithm": algorithm, "extrapolation": "linear", "communication_step": SAMPLING_TIME / 4}
    first = run(coupled(exported, "forces", **options))
    other = run(coupled(exported, "forces", version, fmi_type, **options))
    assert other == pytest.approx(first, abs=1e-6)
