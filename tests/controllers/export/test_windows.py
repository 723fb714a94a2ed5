"""DeePC, SPC and gamma-DDPC in C: whole closed loops with noise and missing measurements, as in Python."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.export.compiled import Beside
from controllers.loops import LinearPlant, experiment, make_loop, pendulum_experiment
from ddpc_controllers import SPC, DeePC, GammaDDPC
from ddpc_controllers.deepc import BehavioralTracking
from ddpc_controllers.optimisation.limits import HELD, PREDICTED
from ddpc_controllers.published import PublishedDeePC
from ddpc_cosim import ConfigError, FloatArray, Loop, Sample

PENDULUM = pendulum_experiment(3)
LAG = LinearPlant(
    np.array([[0.9, 0.1, 0.0], [0.0, 0.8, 0.2], [0.1, 0.0, 0.7]]),
    np.array([[0.3, 0.0], [0.1, 0.2], [0.0, 0.4]]),
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
)
TWO_BY_TWO = experiment(LAG.advance, np.random.default_rng(0).uniform(-1.0, 1.0, (200, 2)), 3, LAG.c)


def noisy(recording: Any, deviation: float) -> Any:
    rng = np.random.default_rng(9)
    y = recording.y + deviation * rng.standard_normal(recording.y.shape)
    return replace(recording, y=y, excitation=recording.u)


def side_by_side(
    controller: BehavioralTracking,
    loop: Loop,
    advance: Callable[[FloatArray, FloatArray], FloatArray],
    output: FloatArray,
    noise: float,
    start: FloatArray | None = None,
    steps: int = 150,
) -> tuple[Beside, set[str]]:
    """Close the loop, a tenth of the outputs missing, and steps of the reference; return what was said."""
    rng = np.random.default_rng(1)
    beside = Beside(controller=controller, drives=True)
    beside.start(loop)
    p, state = len(output), np.zeros(output.shape[1]) if start is None else start
    reference = np.repeat(rng.uniform(-1.5, 1.5, (steps // 10 + 10, p)), 10, axis=0)
    said = set()
    for k in range(steps):
        y = output @ state + noise * rng.standard_normal(p)
        y[rng.random(p) < 0.1] = np.nan
        future = reference[k + 1 : k + 1 + controller.horizon].copy()
        future[loop.preview :] = future[min(loop.preview, len(future)) - 1]
        if k in (77, 78, 79):
            future[...] = np.nan
        action = beside.step(Sample(k, 0.1 * k, y, state, future, reference[k]))
        said.add(action.status)
        state = advance(state, np.clip(action.u, loop.bounds.u_min, loop.bounds.u_max))
    return beside, said


SETTINGS: dict[str, Callable[[], BehavioralTracking]] = {
    "DeePC": DeePC,
    "DeePC as printed": lambda: DeePC(regulariser="ridge", terminal_equality=True),
    "DeePC, past met": lambda: DeePC(slack=False, affine_sum="all", artificial_setpoint=False),
    "DeePC, robust": lambda: DeePC(future_slack=True, soft_output_bounds=1e3, setpoint_margin=0.8),
    "DeePC, equilibrium": lambda: DeePC(regulariser="equilibrium", affine_sum="all", horizon=8),
    "DeePC, free response": lambda: DeePC(regulariser="free-response", affine_sum="all", horizon=8),
    "DeePC, plans": lambda: DeePC(apply_steps=3, rate_bounds=0.3, use_current_output=True, initial_length=4),
    "DeePC, terminal": lambda: DeePC(terminal_equality=True, slack=False, horizon=6, scaling="range"),
    "published": PublishedDeePC,
    "SPC": SPC,
    "SPC, plans": lambda: SPC(apply_steps=2, rate_bounds=0.5, use_current_output=False, horizon=8),
    "gamma-DDPC": lambda: GammaDDPC(beta_2=1e-3, horizon=10),
    "DeePC, closed loop": lambda: DeePC(instruments="closed-loop", regulariser="ridge"),
    "SPC, closed loop": lambda: SPC(instruments="closed-loop"),
    "SPC, excitation": lambda: SPC(instruments="excitation"),
    "SPC, transient": lambda: SPC(predictor="transient", uncertainty=True),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_closed_loops_are_those_of_python(name: str) -> None:
    continues = list(SETTINGS).index(name) % 2 == 0
    limits = np.full(2, 0.6), np.full(2, 0.9)
    loop = make_loop(noisy(TWO_BY_TWO, 0.01), *limits, preview=4, continues_recording=continues)
    beside, said = side_by_side(SETTINGS[name](), loop, LAG.advance, LAG.c, 0.02)
    assert beside.difference <= 1e-9
    assert not beside.disagreements
    assert 0 < beside.fallbacks < beside.steps
    assert {HELD, PREDICTED} <= said


BEYOND: dict[str, tuple[Callable[[], BehavioralTracking], str]] = {
    "terminal": (
        lambda: DeePC(regulariser="ridge", terminal_equality=True, slack=False),
        "terminal condition",
    ),
    "outputs": (lambda: DeePC(slack=False, horizon=6, artificial_setpoint=False), "output bounds softened"),
    "past": (SPC, "no combination of the recorded windows"),
    "rates": (lambda: GammaDDPC(rate_bounds=0.02, terminal_equality=True), "output bounds softened"),
}


@pytest.mark.parametrize("name", BEYOND)
def test_bounds_and_pasts_out_of_reach_fall_back_as_in_python(name: str) -> None:
    make, fallback = BEYOND[name]
    recording = experiment(LAG.advance, np.random.default_rng(0).uniform(-1.0, 1.0, (200, 2)), 3, LAG.c)
    loop = make_loop(recording, np.full(2, 0.2), np.full(2, 0.3), preview=9)
    noise = 0.02 if name == "past" else 0.0
    beside, said = side_by_side(make(), loop, LAG.advance, LAG.c, noise, start=np.full(3, 1.5))
    assert beside.difference <= 1e-8
    assert not beside.disagreements
    assert any(fallback in status for status in said)


@pytest.mark.parametrize("make", [DeePC, lambda: SPC(apply_steps=2, rate_bounds=0.1)])
def test_a_loop_without_bounds(make: Callable[[], BehavioralTracking]) -> None:
    loop = make_loop(TWO_BY_TWO, np.full(2, np.inf), np.full(2, np.inf), preview=9)
    beside, _ = side_by_side(make(), loop, LAG.advance, LAG.c, 0.0, steps=40)
    assert beside.difference <= 1e-9
    assert not beside.disagreements


def test_what_cannot_be_exported_says_why_and_what_can() -> None:
    loop = make_loop(PENDULUM, np.array([1.5]), np.array([0.4]))
    for settings, reason in (
        ({"regulariser": "l1"}, "regulariser = 'l1' cannot be exported: .* use another regulariser"),
        ({"online_data": "sliding-window"}, "online_data cannot be exported: .* use online_data = 'frozen'"),
        ({"online_data": "forgetting"}, "online_data cannot be exported: .* use online_data = 'frozen'"),
    ):
        controller = DeePC(**settings)  # type: ignore[arg-type]
        controller.start(loop)
        with pytest.raises(ConfigError, match=reason):
            controller.c_code(loop)
