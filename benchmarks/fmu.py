"""FMUs behind the plant contract against what they replace: a bare loop over the FMU, and FMPy's simulation.

Everything is measured in turns in one process, so that a machine that slows down slows all of them.
"""

import ctypes
import platform
import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from time import perf_counter_ns

import fmpy
import numpy as np

from benchmarks.step import Row
from ddpc_cosim import FloatArray, FMUPlant
from fmu_plants import export_fmu
from fmu_plants.pendulum import MODEL

STEPS = 1000
TURNS = 61
_H = 0.01
_TORQUE = 0.5


def bare_loop(path: Path) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return a loop that calls the library itself: set one input, step, read two outputs, check each status.

    The second callable frees the FMU.
    """
    folder = tempfile.TemporaryDirectory()
    fmpy.extract(str(path), folder.name)
    description = fmpy.read_model_description(str(path), validate=False)
    references = {v.name: v.valueReference for v in description.modelVariables}
    fmu = fmpy.fmi2.FMU2Slave(
        guid=description.guid,
        modelIdentifier=description.coSimulation.modelIdentifier,
        unzipDirectory=folder.name,
        instanceName="bare",
    )
    fmu.instantiate()
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    c = fmu.component
    set_real, do_step, get_real = (fmu._functions[f"fmi2{name}"] for name in ("SetReal", "DoStep", "GetReal"))
    inputs, u = (ctypes.c_uint * 1)(references["torque"]), (ctypes.c_double * 1)()
    outputs, y = (
        (ctypes.c_uint * 2)(references["angle"], references["angular_velocity"]),
        (ctypes.c_double * 2)(),
    )
    time = 0.0

    def loop() -> None:
        nonlocal time
        for k in range(STEPS):
            u[0] = _TORQUE
            if set_real(c, inputs, 1, u) > 1:
                raise RuntimeError("fmi2SetReal")
            if do_step(c, time + k * _H, _H, 1) > 1:
                raise RuntimeError("fmi2DoStep")
            if get_real(c, outputs, 2, y) > 1:
                raise RuntimeError("fmi2GetReal")
        time += STEPS * _H

    def free() -> None:
        fmu.terminate()
        fmu.freeInstance()
        folder.cleanup()

    return loop, free


def plant_loop(plant: FMUPlant) -> Callable[[], None]:
    """Return the same loop over the plant."""
    plant.reset()
    u = np.array([_TORQUE])

    def loop() -> None:
        for _ in range(STEPS):
            plant.step(u, _H)

    return loop


def fmpy_loop(path: Path) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return FMPy's simulation of the same steps with an instance that is there already.

    The second callable frees the FMU.
    """
    folder = fmpy.extract(str(path))
    description = fmpy.read_model_description(str(path), validate=False)
    instance = fmpy.instantiate_fmu(folder, description, "CoSimulation")
    time = np.array([0.0, STEPS * _H])
    table = np.array([(t, _TORQUE) for t in time], dtype=[("time", float), ("torque", float)])

    def loop() -> None:
        fmpy.simulate_fmu(
            folder,
            model_description=description,
            fmu_instance=instance,
            fmi_type="CoSimulation",
            validate=False,
            input=table,
            output=["angle", "angular_velocity"],
            stop_time=STEPS * _H,
            output_interval=_H,
        )
        instance.reset()

    return loop, instance.freeInstance


def measure(loops: dict[str, Callable[[], None]]) -> dict[str, FloatArray]:
    """Return the time of a step of every loop in every turn [us], shape (TURNS,)."""
    times = {name: np.empty(TURNS) for name in loops}
    for turn in range(TURNS):
        for name, loop in loops.items():
            start = perf_counter_ns()
            loop()
            times[name][turn] = (perf_counter_ns() - start) / 1e3 / STEPS
    return times


def ratio(what: str, above: FloatArray, below: FloatArray, limit: float, *, at_most: bool = False) -> Row:
    """Return the median over all turns of a ratio within one turn."""
    times, against = (below, above) if not at_most else (above, below)
    value = float(np.median(above / below))
    return Row(what, float(np.median(times)), float(np.median(against)), value, limit, at_most)


def main() -> bool:
    """Print the table; return whether every bound was held."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "fmpy"))
    print(f"{platform.platform()}, {platform.machine()}, Python {platform.python_version()}, {packages}")
    print(f"{'medians in microseconds per step':<58}{'step':>9} {'against':>11} {'ratio':>8}   bound")
    with tempfile.TemporaryDirectory() as scratch:
        # Coarse tolerances: the FMU itself is to cost little, so that what is around it shows.
        path = export_fmu(
            MODEL, Path(scratch) / "pendulum.fmu", relative_tolerance=1e-3, absolute_tolerance=1e-3
        )
        bare, free_bare = bare_loop(path)
        simulate, free_simulation = fmpy_loop(path)
        with FMUPlant(path, inputs=["torque"], outputs=["angle", "angular_velocity"]) as plant:
            times = measure({"bare": bare, "plant": plant_loop(plant), "fmpy": simulate})
        free_bare()
        free_simulation()
    rows = [
        ratio("FMUPlant.step / bare loop", times["plant"], times["bare"], 1.5, at_most=True),
        ratio("fmpy.simulate_fmu / FMUPlant.step", times["fmpy"], times["plant"], 3.0),
    ]
    for row in rows:
        print(row)
    return all(row.held for row in rows)
