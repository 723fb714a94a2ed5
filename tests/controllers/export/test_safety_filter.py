"""The safety filter in C: every end of a plan, what gives way, inputs that are left alone to the last bit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ddpc_controllers import IPID, LQR, PID, SPC, SPSA, OffsetFree, SafetyFilter, Scaled
from ddpc_cosim import Action, Bounds, ConfigError, Controller, Loop, Sample

from .compiled import Beside, CompiledController
from .loops import COUPLED, PENDULUM, Bench

RELAXED, EXPECTED = 4, 2
EAGER = {1: PID(proportional=3.0, integral=2.0), 2: PID(proportional=0.5, integral=0.3)}
"""Controllers that leave the limits, by the number of outputs."""
LIMIT = {1: 0.3, 2: 0.5}
"""In parts of the outputs' nominal values."""


def closed(controller: Controller, bench: Bench, size: float, **changes: Any) -> Beside:
    """Close a loop whose outputs are limited to a part of their nominal values."""
    limit = size * bench.nominal[: bench.outputs]
    loop, _ = bench.loop()
    bounds = replace(loop.bounds, y_min=-limit, y_max=limit)
    return bench.close(controller, steps=80, bounds=bounds, **changes)


def intervened(beside: Beside) -> float:
    return beside.controller.diagnostics()["intervention_rate"]


@pytest.mark.parametrize("terminal", ["held", "rest", "none"])
@pytest.mark.parametrize("bench", [PENDULUM, COUPLED], ids=["pendulum", "coupled"])
def test_the_code_is_the_filter(bench: Bench, terminal: str) -> None:
    controller = SafetyFilter(controller=EAGER[bench.outputs], terminal=terminal, satisfaction=0.9)
    beside = closed(controller, bench, LIMIT[bench.outputs])
    assert beside.difference < 1e-9
    assert not beside.disagreements
    assert beside.active > 0
    assert 0.0 < intervened(beside) < 1.0
    assert beside.statuses & EXPECTED  # some samples lose measurements


@pytest.mark.parametrize(
    "controller",
    [
        SafetyFilter(controller=EAGER[1], scaling="none", initial_length=2, steps_ahead=8),
        SafetyFilter(controller=SPC(horizon=5), scaling="nominal", terminal="rest", initial_length=1),
        SafetyFilter(controller=Scaled(controller=IPID(alpha=2.0))),
        Scaled(controller=SafetyFilter(controller=EAGER[1]), scale_by="nominal"),
        OffsetFree(controller=SafetyFilter(controller=LQR())),
    ],
    ids=["units", "predictive", "scaled inside", "scaled outside", "offset-free"],
)
def test_whatever_is_inside_and_outside(controller: Controller) -> None:
    beside = closed(controller, PENDULUM, 0.3)
    assert beside.difference < 1e-9
    assert not beside.disagreements
    assert beside.active > 0


def sample_at(k: int, y: float) -> Sample:
    value = np.array([y])
    return Sample(k, 0.1 * k, value, np.array([0.0, y]), np.full((1, 1), 10.0), np.full(1, 10.0))


def limited(upper: float, lower: float = -np.inf) -> Loop:
    """Return a loop of the pendulum whose angle is limited."""
    loop, _ = PENDULUM.loop()
    bounds = Bounds(loop.bounds.u_min, loop.bounds.u_max, np.array([lower]), np.array([upper]))
    return replace(loop, bounds=bounds)


@pytest.mark.parametrize(
    ("terminal", "course", "instead"),
    [
        ("held", [0.0, 0.29, 0.31, 0.32], "terminal condition relaxed, output bounds softened"),
        ("rest", [0.0, 0.29, 0.31, 0.32], "terminal condition relaxed, output bounds softened"),
        ("none", [0.0, 0.29, 0.31, 0.32], "output bounds softened"),
    ],
)
def test_what_cannot_be_kept_gives_way_as_in_python(terminal: str, course: list[float], instead: str) -> None:
    controller, loop = SafetyFilter(controller=EAGER[1], terminal=terminal), limited(0.3)
    controller.start(loop)
    c, given_up = CompiledController(controller, loop), set[str]()
    for k, y in enumerate(course):
        action = controller.step(sample_at(k, y))
        assert isinstance(action, Action)
        np.testing.assert_allclose(c.step(sample_at(k, y)), action.u, rtol=0.0, atol=1e-9 * 3.5)
        given_up.add(action.status.partition(": ")[2])
        assert c.status == (0 if action.status == "ok" else RELAXED)
    assert instead in given_up


def test_far_beyond_the_limits_the_least_excess_is_found_and_nothing_is_clipped() -> None:
    limit = 0.3 * COUPLED.nominal[:2]
    loop, _ = COUPLED.loop()
    loop = replace(loop, bounds=replace(loop.bounds, y_min=-limit, y_max=limit))
    controller = SafetyFilter(controller=EAGER[2], terminal="none")
    controller.start(loop)
    c, rng, y, given_up = CompiledController(controller, loop), np.random.default_rng(1), np.zeros(2), 0
    for k in range(150):
        y = 0.9 * y + 0.5 * COUPLED.nominal[:2] * rng.standard_normal(2)
        there = np.concatenate([np.zeros(len(loop.measurements) - 2), y])
        sample = Sample(k, 0.1 * k, y, there, 10.0 * limit[np.newaxis], 10.0 * limit)
        action = controller.step(sample)
        assert isinstance(action, Action)
        assert "clipped" not in action.status
        given_up += "softened" in action.status
        np.testing.assert_allclose(c.step(sample), action.u, rtol=0.0, atol=1e-9 * np.ptp(COUPLED.limits))
    assert given_up > 50


def test_inputs_that_keep_the_limits_are_those_of_the_controller_to_the_last_bit() -> None:
    loop, bare = limited(30.0, -30.0), PID(proportional=0.1, integral=0.02)
    around = SafetyFilter(controller=PID(proportional=0.1, integral=0.02))
    rng, codes = np.random.default_rng(2), list[CompiledController]()
    for controller in (bare, around):
        controller.start(loop)
        codes.append(CompiledController(controller, loop))
    for k in range(30):
        sample = sample_at(k, 0.1 * rng.standard_normal())
        inputs = [code.step(sample) for code in codes]
        np.testing.assert_array_equal(*inputs)
        assert 0.0 < abs(inputs[0][0]) < 3.5


def test_before_anything_is_measured_inputs_are_not_filtered() -> None:
    controller, loop = SafetyFilter(controller=EAGER[1]), limited(0.3)
    controller.start(loop)
    c = CompiledController(controller, loop)
    for k, y in enumerate([np.nan, np.nan, 0.0, np.nan, 0.1]):
        action = controller.step(sample_at(k, y))
        assert isinstance(action, Action)
        wanted = np.clip(action.u, loop.bounds.u_min, loop.bounds.u_max)
        np.testing.assert_allclose(c.step(sample_at(k, y)), wanted, rtol=0.0, atol=1e-9 * 3.5)
        assert (c.status != 0) == np.isnan(y)


def test_what_cannot_be_exported_inside_is_refused_with_its_reason() -> None:
    controller, loop = SafetyFilter(controller=SPSA()), limited(0.3)
    controller.start(loop)
    with pytest.raises(ConfigError, match="SPSA cannot be exported"):
        controller.c_code(loop)
