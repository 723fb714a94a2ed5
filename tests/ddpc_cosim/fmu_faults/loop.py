"""The closed loop in which an FMU misbehaves."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fmus.builder import Fault

from ddpc_cosim import Constant, Controller, FloatArray, FMUPlant, Loop, Sample, Trace, cosimulate

H = 0.1
FAULT_SAMPLE = 5
FAULT_TIME = FAULT_SAMPLE * H
SHORT = 0.5
"""Time limit for FMUs that hang [s]."""


@dataclass(kw_only=True)
class One(Controller):
    """Always 1."""

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> FloatArray:
        return np.ones(1)


def close_loop(plant: FMUPlant, fault: Fault = Fault.NO_FAULT, duration: float = 1.0) -> Trace:
    """Run one second of an integrator whose input is 1, with a fault at t = 0.5 s."""
    return cosimulate(
        plant,
        One(),
        sampling_time=H,
        duration=duration,
        reference=Constant(0.0),
        parameters={"fault": int(fault), "fault_time": FAULT_TIME},
    )


def open_plant(path: Path, isolated: bool, step_timeout: float = 20.0) -> FMUPlant:
    """Open the misbehaving FMU."""
    return FMUPlant(path, isolated=isolated, step_timeout=step_timeout)
