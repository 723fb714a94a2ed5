"""What coupling costs: a step of two FMUs as one plant against the steps of both alone."""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.fmu import STEPS, measure, ratio
from ddpc_cosim import Connection, CoupledPlant, FMUPlant
from fmu_plants import Equations, PlantModel, Variable, export_fmu

_H = 0.1
# One of two masses on springs, with another spring between them.
_X, _V = Variable("x", "m", start=1.0), Variable("v", "m/s")
_HALF = PlantModel(
    name="half",
    states=(_X, _V),
    inputs=(Variable("force", "N"), Variable("other_x", "m")),
    outputs=(_X, _V),
    equations=lambda s: Equations({"x": s.v, "v": s.force - s.x - 2 * (s.x - s.other_x) - 0.1 * s.v}),
)
_LINKS = (Connection("first.x", "second.other_x"), Connection("second.x", "first.other_x"))


def main() -> bool:
    """Print the table; return whether every bound was held."""
    print(f"{'medians in microseconds per step':<80}{'step':>9} {'against':>11} {'ratio':>8}   bound")
    u, alone_u = np.array([0.1, 0.1]), np.array([0.1, 0.0])
    with tempfile.TemporaryDirectory() as scratch:
        path = export_fmu(_HALF, Path(scratch) / "half.fmu")
        first, second = FMUPlant(path), FMUPlant(path)
        ways = {
            "sequential": CoupledPlant({n: FMUPlant(path) for n in ("first", "second")}, _LINKS),
            "parallel": CoupledPlant(
                {n: FMUPlant(path) for n in ("first", "second")}, _LINKS, algorithm="parallel"
            ),
        }
        for plant in (first, second, *ways.values()):
            plant.reset()

        def alone() -> None:
            for _ in range(STEPS):
                first.step(alone_u, _H)
                second.step(alone_u, _H)

        def coupled(plant: CoupledPlant) -> None:
            for _ in range(STEPS):
                plant.step(u, _H)

        loops = {name: (lambda plant=plant: coupled(plant)) for name, plant in ways.items()}
        times = measure({"alone": alone, **loops})
        for plant in (first, second, *ways.values()):
            plant.close()
    rows = [
        ratio(
            f"CoupledPlant.step of two FMUs, {name} / two FMUPlant.step",
            times[name],
            times["alone"],
            1.3,
            at_most=True,
        )
        for name in ways
    ]
    for row in rows:
        print(row)
    return all(row.held for row in rows)
