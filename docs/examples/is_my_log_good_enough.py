"""
Is my log good enough?
======================

What two logs of the same heater are worth: one in which a controller was at work, one in which the power was
switched at random.
"""

# %%
# The heater gets warmer by 0.4 K for each percent of its power, with a time constant of 10 min and a dead
# time of 2 min. Every 30 s its temperature is logged, which draughts disturb, beside the power that is held
# until the next row.

from pathlib import Path

import numpy as np

from ddpc_cosim import Recording, Variable

SAMPLING_TIME, ROWS, DEAD_TIME, GAIN, TIME_CONSTANT = 30.0, 1500, 4, 0.4, 600.0


def write_log(path, closed, seed=0):
    """Write a log of 12.5 hours; in closed loop the setpoint is moved, and a controller moves the power."""
    rng = np.random.default_rng(seed)
    decay = np.exp(-SAMPLING_TIME / TIME_CONSTANT)
    moves = np.repeat(rng.uniform(-1.0, 1.0, ROWS // 25), 25)  # of setpoint or power, every 12.5 min
    power, temperature = np.zeros(ROWS), np.zeros(ROWS)
    for k in range(ROWS):
        before = power[k - DEAD_TIME] if k >= DEAD_TIME else 0.0
        warmth = temperature[k - 1] - 20.0 if k else 0.0
        temperature[k] = 20.0 + decay * warmth + GAIN * (1.0 - decay) * before + rng.normal(0.0, 0.1)
        error = 27.0 + moves[k] - temperature[k]
        power[k] = np.clip(20.0 + 12.0 * error if closed else 50.0 + 30.0 * moves[k], 0.0, 100.0)
    lines = ["time [s],power [%],temperature [degC]"]
    lines += [f"{SAMPLING_TIME * k:.0f},{power[k]:.2f},{temperature[k]:.3f}" for k in range(ROWS)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


write_log("heater-open.csv", closed=False)
write_log("heater-closed.csv", closed=True)

# %%
# The same as ``ddpc-cosim inspect heater-open.csv``, in Python:

signals = {"inputs": [Variable("power", unit="%")], "outputs": [Variable("temperature", unit="degC")]}
recording = Recording.read_csv("heater-open.csv", sampling_time=SAMPLING_TIME, **signals)
recording.summary(**signals)

# %%
# And of the log in which the controller was at work:

recording = Recording.read_csv("heater-closed.csv", sampling_time=SAMPLING_TIME, **signals)
recording.summary(**signals)
