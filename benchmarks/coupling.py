"""What coupling costs, and how exact it is.

A step of two FMUs as one plant against the steps of both alone; and the error of parts that exchange values
in steps against that of the same FMUs as one differential equation, each with its cost.
"""

import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from scipy.linalg import expm

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
# Both together: x1, v1, x2, v2.
_WHOLE = np.array(
    [[0.0, 1.0, 0.0, 0.0], [-3.0, -0.1, 2.0, 0.0], [0.0, 0.0, 0.0, 1.0], [2.0, 0.0, -3.0, -0.1]]
)
_SAMPLES, _EXACT = 200, 1e-6
_EXCHANGES: dict[str, dict[str, Any]] = {
    "hold, every 10 ms": {"communication_step": 0.01},
    "hold, every 1 ms": {"communication_step": 0.001},
    "linear, every 1 ms": {"communication_step": 0.001, "extrapolation": "linear"},
    "monolithic": {"algorithm": "monolithic"},
}
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
        errors = _print_errors(path)
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
    return all(row.held for row in rows) and errors["monolithic"] <= _EXACT


def _print_errors(path: Path) -> dict[str, float]:
    """Print, for each way to exchange, its cost and its largest error; return the errors."""
    exact = np.array([expm(k * _H * _WHOLE) @ [1.0, 0.0, -0.5, 0.0] for k in range(_SAMPLES + 1)])
    what = "two FMUs over 20 s, sampled every 0.1 s"
    print(f"{what:<45}{'CPU ms per sample':>18} {'largest error':>15}   bound")
    errors = {}
    for name, options in _EXCHANGES.items():
        parts = {part: FMUPlant(path) for part in ("first", "second")}
        signals = [f"{part}.{state}" for part in parts for state in ("x", "v")]
        with CoupledPlant(parts, _LINKS, outputs=signals, **options) as plant:
            rows, begin = [plant.reset({"second.x": -0.5})], process_time()
            rows += [plant.step(np.zeros(2), _H) for _ in range(_SAMPLES)]
            cost = 1e3 * (process_time() - begin) / _SAMPLES
        errors[name] = float(np.abs(rows - exact).max())
        bound = f"<= {_EXACT:g}" if name == "monolithic" else ""
        print(f"{name:<45}{cost:>18.2f} {errors[name]:>15.1e}   {bound}")
    return errors
