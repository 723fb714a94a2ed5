"""Controllers in C against themselves in Python, and how long a step takes at the worst.

The least of several repetitions of a step is taken, in Python as in C: what else the machine does in between
is not the code's time.
"""

import ctypes
import subprocess
import tempfile
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter_ns
from typing import Any, NamedTuple

import fmpy
import numpy as np

from benchmarks.pendulum import PRINTED, SAMPLING_TIME, STEPS, Pendulum, experiment, loop
from benchmarks.step import Row, print_header, print_rows
from ddpc_controllers import (
    GPC,
    IPID,
    LQR,
    MFAC,
    MFAPC,
    MPC,
    PID,
    SPC,
    WKPC,
    DeePC,
    GammaDDPC,
    Identified,
    KoopmanMPC,
    Polynomials,
    ThinPlate,
)
from ddpc_cosim import Action, Controller, FloatArray, Loop, export_controller

REPETITIONS = 5
RANDOM_PROBLEMS = 12_500
"""Of each method: 10^5 of all eight."""
TIGHT = 1.8
"""Torque limit [N m] of the random problems."""

_DRIVER = Path(__file__).with_name("stepping.c")
_FASTER, _WORST = 5.0, 20.0
_LARGEST_FMU = 100.0  # kB

METHODS: dict[str, Controller] = {
    "PID": PID(proportional=1.0, integral=3.0, derivative=0.2, filter_time=0.1),
    "i-PID": IPID(order=2, alpha=5.0, kp=4.0, kd=4.0),
    "MFAC": MFAC(),
    "MFAPC-CFDL": MFAPC(limits="clip"),
    "MFAPC-PFDL": MFAPC(form="pfdl"),
    "MFAPC-FFDL": MFAPC(form="ffdl"),
    "GPC": GPC(),
    "LQR": LQR(model=Identified(lags=2)),
    "MPC": MPC(model=Identified(lags=2), horizon=5),
    "Koopman MPC": KoopmanMPC(state="delays", dictionary=Polynomials()),
    "DeePC": DeePC(**PRINTED),
    "SPC": SPC(),
    "gamma-DDPC": GammaDDPC(),
    "WKPC": WKPC(regulariser="ridge", dictionary=ThinPlate(), initial_length=2),
}
"""The methods on the paper's problem; DeePC, WKPC and MFAPC-CFDL as it prints them."""

LIMITED: dict[str, Controller] = {
    "MFAPC-CFDL, N = 20": MFAPC(horizon=20, rate_bounds=0.5),
    "MPC, N = 20": MPC(model=Identified(lags=2), horizon=20, rate_bounds=0.5),
    "Koopman MPC, N = 20": KoopmanMPC(state="delays", dictionary=Polynomials(), horizon=20),
    "DeePC": DeePC(**PRINTED),
    "DeePC, N = 20": DeePC(**PRINTED, horizon=20),
    "SPC, N = 20": SPC(horizon=20),
    "gamma-DDPC, N = 20": GammaDDPC(horizon=20),
    "WKPC, N = 20": WKPC(regulariser="ridge", dictionary=ThinPlate(), initial_length=2, horizon=20),
}
"""Those that solve a QP where a bound is active."""


class Samples(NamedTuple):
    """What a controller saw: y of shape (samples, p), r of (samples, 1 + preview, p), as C takes them."""

    y: FloatArray
    r: FloatArray


@dataclass
class Times:
    """One entry for each sample; times in microseconds."""

    u: FloatArray
    times: FloatArray
    status: Any
    iterations: Any
    active: Any


def started(controller: Controller, limit: float) -> Loop:
    """Start a controller on the paper's loop, and return that."""
    started_loop = replace(loop(experiment(200), limit), preview=controller.horizon)
    controller.start(started_loop)
    return started_loop


def in_python(controller: Controller, limit: float) -> tuple[Samples, FloatArray, FloatArray]:
    """Close the loop of the paper's problem; return its samples, inputs, and the least time of each step."""
    times = np.full(STEPS, np.inf)
    for _ in range(REPETITIONS):
        started(controller, limit)
        plant, u = Pendulum(controller.horizon), np.empty((STEPS, 1))
        y, r = np.empty((STEPS, 1)), np.empty((STEPS, 1 + controller.horizon, 1))
        for k in range(STEPS):
            sample = plant.sample()
            y[k], r[k] = sample.y, np.vstack([sample.setpoint, sample.reference])
            start = perf_counter_ns()
            answer = controller.step(sample)
            times[k] = min(times[k], (perf_counter_ns() - start) / 1e3)
            u[k] = answer.u if isinstance(answer, Action) else answer
            plant.apply(u[k])
    return Samples(y, r), u, times


def random_samples(horizon: int) -> Samples:
    """Return samples that follow no plant: every step is a problem of its own, many with active bounds."""
    rng = np.random.default_rng(1)
    y = rng.uniform(-1.0, 1.0, (RANDOM_PROBLEMS, 1))
    levels = rng.uniform(-1.0, 1.0, (RANDOM_PROBLEMS, 2))
    changes = rng.integers(0, horizon + 1, RANDOM_PROBLEMS)
    later = np.arange(horizon + 1) > changes[:, np.newaxis]
    return Samples(y, np.where(later, levels[:, 1:], levels[:, :1])[:, :, np.newaxis])


def library_of(controller: Controller, started_loop: Loop, folder: Path) -> ctypes.CDLL:
    """Compile a started controller with what times it."""
    code = controller.c_code(started_loop)
    for name, text in code.sources.items():
        (folder / name).write_text(text, encoding="utf-8")
    sources = [name for name in code.sources if name.endswith(".c")]
    command = [
        "cc",
        "-std=c99",
        "-O2",
        "-fPIC",
        "-shared",
        "-I.",
        *sources,
        str(_DRIVER),
        "-o",
        "it.so",
        "-lm",
    ]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "it.so"))


def in_c(library: ctypes.CDLL, samples: Samples) -> Times:
    """Step the code through samples."""
    n = len(samples.y)
    counts = [np.zeros(n, dtype=np.uint32) for _ in range(3)]
    result = Times(np.zeros((n, 1)), np.zeros(n), *counts)
    library.time_code(
        _pointer(samples.y),
        _pointer(samples.r),
        ctypes.c_size_t(n),
        REPETITIONS,
        *map(_pointer, (result.u, result.times, *counts)),
    )
    return result


def as_fmu(library: ctypes.CDLL, path: Path, samples: Samples, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Step the FMU through samples, several times; return its inputs and the least time of each step."""
    fmpy.extract(str(path), str(folder))
    description = fmpy.read_model_description(str(path), validate=False)
    references = {
        causality: [v.valueReference for v in description.modelVariables if v.causality == causality]
        for causality in ("input", "output")
    }
    n = len(samples.y)
    values = np.hstack([samples.y, samples.r.reshape(n, -1)])
    # What follows is of controllers that are not active, which this one is from its start on.
    set_ones = references["input"][: values.shape[1]]
    inputs, outputs = (ctypes.c_uint * len(set_ones))(*set_ones), (ctypes.c_uint * 1)(references["output"][0])
    times, u = np.full(n, np.inf), np.zeros((n, 1))
    for _ in range(REPETITIONS):
        fmu = fmpy.fmi2.FMU2Slave(
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=str(folder),
            instanceName="timed",
        )
        fmu.instantiate()
        fmu.setupExperiment()
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        fmu_times = np.zeros(n)
        calls = [fmu._functions[f"fmi2{name}"] for name in ("SetReal", "DoStep", "GetReal")]
        failed = library.time_fmu(
            ctypes.c_void_p(fmu.component),
            *(ctypes.cast(call, ctypes.c_void_p) for call in calls),
            inputs,
            ctypes.c_size_t(len(inputs)),
            outputs,
            ctypes.c_size_t(1),
            ctypes.c_double(SAMPLING_TIME),
            _pointer(values),
            ctypes.c_size_t(n),
            _pointer(u),
            _pointer(fmu_times),
        )
        assert not failed
        times = np.minimum(times, fmu_times)
        fmu.terminate()
        fmu.freeInstance()
    return u, times


def against_python(name: str, controller: Controller) -> list[Row]:
    """Measure a method's step on the paper's problem in Python over that in C, and that of its FMU."""
    samples, u, python = in_python(controller, 3.5)
    started_loop = started(controller, 3.5)
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        library = library_of(controller, started_loop, folder)
        code = in_c(library, samples)
        path = export_controller(controller, started_loop, folder / "controller.fmu")
        (folder / "unzipped").mkdir()
        fmu_u, fmu = as_fmu(library, path, samples, folder / "unzipped")
    assert max(np.abs(code.u - u).max(), np.abs(fmu_u - u).max()) <= 1e-8 * 3.5, name
    reference = float(np.median(python))
    return [
        Row(f"{name}: Python / {kind}", seconds, reference, reference / seconds, _FASTER)
        for kind, seconds in (("C", float(np.median(code.times))), ("FMU 2.0", float(np.median(fmu))))
    ]


def worst_case(name: str, controller: Controller) -> Row:
    """Measure the longest step over the median one, of random problems with active bounds."""
    started_loop = started(controller, TIGHT)
    with tempfile.TemporaryDirectory() as text:
        library = library_of(controller, started_loop, Path(text))
        steps = in_c(library, random_samples(controller.horizon))
    limited = steps.active > 0
    worst, median = float(steps.times[limited].max()), float(np.median(steps.times[limited]))
    most, usual = steps.iterations[limited].max(), np.median(steps.iterations[limited])
    what = f"{name}: worst / median of {limited.sum()} random problems, iterations {most} / {usual:g}"
    return Row(what, worst, median, worst / median, _WORST, at_most=True)


def size(name: str, controller: Controller) -> bool:
    """Print how large a method's FMU for all platforms is, with its C code, and an instance in memory."""
    started_loop = started(controller, 3.5)
    with tempfile.TemporaryDirectory() as text:
        path = export_controller(controller, started_loop, Path(text) / "controller.fmu", platforms="all")
        fmu = path.stat().st_size / 1e3
        with zipfile.ZipFile(path) as archive:
            sources = sum(
                member.compress_size
                for member in archive.infolist()
                if member.filename.startswith("sources/")
            )
    footprint = controller.c_code(started_loop).footprint
    assert footprint
    signals = 5 + len(started_loop.measurements) + (1 + controller.horizon) * len(started_loop.outputs)
    # The committed state and the one that is tried, and the values of all variables.
    memory = (2 * footprint.state + 8 * signals) / 1e3
    verdict = "held" if fmu <= _LARGEST_FMU else "MISSED"
    print(
        f"{name}: FMU for five platforms {fmu:.1f} kB (<= {_LARGEST_FMU:g} {verdict}), of which its C code "
        f"{sources / 1e3:.1f} kB; memory of an instance {memory:.1f} kB"
    )
    return fmu <= _LARGEST_FMU


def main() -> bool:
    """Print the tables; return whether every bound was held."""
    print_header()
    rows = [row for name, controller in METHODS.items() for row in against_python(name, controller)]
    rows += [worst_case(name, controller) for name, controller in LIMITED.items()]
    held = print_rows(rows)
    return all([held, *(size(name, METHODS[name]) for name in ("MFAPC-CFDL", "DeePC", "WKPC"))])


def _pointer(values: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)
