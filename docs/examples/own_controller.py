"""
A control law of one's own
==========================

How a control law becomes a class, is watched in one loop, and is compared with what there is already.
"""

# %%
# A controller is a class with settings and two methods. This one is a PI controller for each pair of signals,
# whose integral waits while its input is at a limit. What it says in ``info`` becomes a column of the trace.

from dataclasses import dataclass

import numpy as np

from ddpc_controllers import MPC, PID
from ddpc_cosim import (
    Action,
    Controller,
    FMUPlant,
    Loop,
    Problem,
    Sample,
    Steps,
    Study,
    UniformRandom,
    cosimulate,
    setting,
)
from fmu_plants import export_fmu
from fmu_plants.quadruple_tank import MODEL


@dataclass(kw_only=True)
class ProportionalIntegral(Controller):
    """A PI controller for each pair of signals."""

    gain: float = setting(0.5, above=0.0, doc="proportional gain")
    integral_time: float = setting(60.0, above=0.0, unit="s", doc="gain over integral gain")

    def start(self, loop: Loop) -> None:
        """Begin where the inputs rest."""
        self.bounds, self.h = loop.bounds, loop.sampling_time
        self.integral = np.array([variable.start for variable in loop.inputs])

    def step(self, sample: Sample) -> Action:
        """Return the inputs, within their limits."""
        error = sample.setpoint - sample.y
        wanted = self.integral + self.gain * error
        u = np.clip(wanted, self.bounds.u_min, self.bounds.u_max)
        step = self.gain * self.h / self.integral_time * error
        self.integral = self.integral + np.where(u == wanted, step, 0.0)
        return Action(u, info={f"integral_{i}": value for i, value in enumerate(self.integral.tolist(), 1)})


# %%
# One loop on a plant that is an FMU: the four tanks of Johansson, two pumps, two levels.

signals = {"inputs": ["pump_1", "pump_2"], "outputs": ["level_1", "level_2"]}
reference = {"level_1": Steps([0, 600], [13.4, 12.4]), "level_2": Steps([0, 300], [13.4, 12.6])}
bounds = {"pump_1": (2.0, 4.0), "pump_2": (2.0, 4.0)}

with FMUPlant(export_fmu(MODEL, "quadruple_tank.fmu"), **signals) as plant:
    trace = cosimulate(
        plant, ProportionalIntegral(), reference=reference, bounds=bounds, sampling_time=5.0, duration=900.0
    )
trace.plot()

# %%
# Its numbers are those that studies and reports judge by.

for name, value in trace.metrics().items():
    if name.startswith(("rmse", "settling_time", "overshoot")):
        print(f"{name}: {value:.3f}")

# %%
# Is it any good? A study compares it with what there is: PID with tuned gains, and linear MPC, both from an
# experiment of 300 samples. The class defined here runs in the workers as it is.

tanks = Problem(
    plant="quadruple_tank.fmu",
    reference=reference,
    bounds=bounds,
    sampling_time=5.0,
    duration=900.0,
    excitation=UniformRandom(2.6, 3.4, samples=300),
    **signals,
)
controllers = {
    "PI": ProportionalIntegral(),
    "PI-fast": ProportionalIntegral(gain=2.0),
    "PID": PID(tuning="step-test"),
    "MPC": MPC(horizon=20),
}
results = Study({"tanks": tanks}, controllers, name="tanks", seeds=range(8)).run(
    "runs/tanks", jobs=2, progress=False
)
results.compare("rmse.level_1", baseline="PID")[["controller", "median", "lower", "upper", "told_apart"]]

# %%
# The best of them, over time:

results.trace("MPC", seed=0).plot()
