"""Disturbances with forecasts, bands, limits that move and prices in C: as in Python."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from controllers.export.compiled import Beside
from controllers.test_foresight import PLANTS, Case, make, power, sample_of
from ddpc_controllers import LQR, MPC, PID, SPC, WKPC, DeePC, GammaDDPC, KoopmanMPC
from ddpc_controllers.data.dictionaries import Identity, ThinPlate
from ddpc_cosim import Controller, Loop, Sample

STEPS = 60


def a_case(case: Case, preview: int) -> Loop:
    """Return a loop with all there is: two prices, a band, limits that move, disturbances."""
    return replace(make(case, 160), preview=preview)


def known_so_far(sample: Sample, preview: int) -> Sample:
    """Return a sample whose rows beyond the preview repeat the last one that is known."""

    def held(now: np.ndarray, rows: np.ndarray) -> np.ndarray:
        every = np.concatenate([now[np.newaxis], rows])
        return every[np.minimum(np.arange(1, len(every)), preview)]

    limits = sample.input_limits
    y_limits = sample.output_limits
    return sample._replace(
        reference=held(sample.setpoint, sample.reference),
        band=held(sample.band_now, sample.band),
        input_limits=limits[np.minimum(np.arange(len(limits)), preview)],
        output_limits=y_limits[np.minimum(np.arange(len(y_limits)), max(preview - 1, 0))],
    )


def side_by_side(controller: Controller, case: Case, preview: int, missing: float = 0.05) -> Beside:
    """Close a loop whose future is random at every sample."""
    loop = a_case(case, preview)
    beside, rng = Beside(controller=controller), np.random.default_rng(3)
    beside.start(loop)
    state, u = np.zeros(case.output.shape[1]), np.zeros(case.inputs)
    for k in range(STEPS):
        y = case.output @ state + 1e-3 * rng.standard_normal(len(case.output))
        d = rng.uniform(-0.5, 1.0, case.disturbances)
        measured = np.array([*state, power(u, y)])
        sample = sample_of(loop, k, y, measured, d, controller.horizon, rng)
        if rng.random() < missing:
            sample.y[...] = np.nan
        u = np.clip(beside.step(known_so_far(sample, preview)).u, loop.bounds.u_min, loop.bounds.u_max)
        state = case.advance(state, np.concatenate([u, d]))
    return beside


METHODS: dict[str, Callable[[], Controller]] = {
    "DeePC": lambda: DeePC(horizon=6),
    "DeePC, ridge": lambda: DeePC(regulariser="ridge", horizon=4, artificial_setpoint=False),
    "DeePC, equilibrium": lambda: DeePC(regulariser="equilibrium", horizon=6, scaling="none"),
    "DeePC, plans": lambda: DeePC(apply_steps=3, rate_bounds=0.3, use_current_output=True),
    "SPC": lambda: SPC(horizon=6),
    "SPC, measured only": lambda: SPC(horizon=5, use_forecast=False),
    "gamma-DDPC": lambda: GammaDDPC(beta_2=1e-3, horizon=6, scaling="range"),
    "MPC": lambda: MPC(horizon=6),
    "MPC, outputs": lambda: MPC(
        horizon=5, setpoint="none", soft_output_bounds=1e3, rate_bounds=0.4, scaling="range"
    ),
    "LQR": lambda: LQR(horizon=4),
    "Koopman MPC": lambda: KoopmanMPC(horizon=6, dictionary=ThinPlate(count=3)),
    "Koopman MPC, delays": lambda: KoopmanMPC(horizon=6, state="delays", delays=2, dictionary=Identity()),
    "PID": lambda: PID(proportional=4.0, integral=0.5, derivative=0.05, feedforward=True),
    "WKPC": lambda: WKPC(dictionary=ThinPlate(count=4)),
}


ON_THE_PENDULUM = ("DeePC", "DeePC, plans", "SPC", "gamma-DDPC", "WKPC", "MPC, outputs", "LQR", "PID")


@pytest.mark.parametrize("name", METHODS)
def test_all_of_it_is_decided_as_in_python(name: str) -> None:
    plant, preview = ("pendulum", 2) if name in ON_THE_PENDULUM else ("two inputs, two outputs", 50)
    beside = side_by_side(METHODS[name](), PLANTS[plant], preview)
    assert beside.difference <= 1e-8
    assert not beside.disagreements
    assert beside.limited > 0
    assert beside.active > 0 or name in ("LQR", "PID")  # which have no optimisation
