"""Recordings made once per session."""

import numpy as np
import pytest

from ddpc_cosim import Recording

from .loops import DATA, SAMPLING_TIME, pendulum, pendulum_experiment


@pytest.fixture(scope="session")
def paper_recording() -> Recording:
    """The experiment on which the recorded trajectories rest: torque and angle."""
    table = np.loadtxt(DATA / "excitation_seed5489.csv", delimiter=",", skiprows=1)
    return Recording(table[:, :1], table[:, 1:], table[:, 1:], SAMPLING_TIME)


@pytest.fixture(scope="session")
def state_recording() -> Recording:
    """The same experiment with the velocity measured too."""
    return pendulum_experiment(5489, pendulum)
