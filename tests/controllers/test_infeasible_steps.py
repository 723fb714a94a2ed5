"""Steps that no inputs solve: first the terminal condition gives way, then output bounds, and inputs last."""

import copy
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers import MPC
from ddpc_controllers.models.linear import StateSpace
from ddpc_controllers.optimisation.qp import ParametricQP
from ddpc_cosim import Action, Controller, FloatArray, Loop, Sample

from .loops import REGULATION, LinearPlant, close_loop, experiment, make_loop, printed_deepc

LAG = LinearPlant(np.array([[0.95, 0.1], [0.0, 0.9]]), np.array([[0.0], [0.1]]), np.array([[1.0, 0.0]]))
RECORDING = experiment(LAG.advance, np.random.default_rng(0).uniform(-1.0, 1.0, (100, 1)), 2, LAG.c)
TERMINAL = "no way to meet .*: terminal condition relaxed$"
OUTPUTS = "no way to meet .*y at its upper bound.*: .*output bounds softened$"


def lag_loop(u_max: float, y_max: float) -> Loop:
    return make_loop(RECORDING, np.array([u_max]), np.array([y_max]))


def run(
    controller: Controller, loop: Loop, state: FloatArray, steps: int, plant: LinearPlant = LAG
) -> tuple[list[str], FloatArray, FloatArray]:
    """Close the loop with a reference of zero; return what is said, the inputs and the outputs."""
    reference = np.zeros((steps + controller.horizon + 1, 1))
    closed = close_loop(controller, loop, plant.advance, plant.c, reference, steps, state)
    return closed.status, closed.u, closed.y


ONLINE: dict[str, dict[str, Any]] = {
    "frozen": {},
    "sliding window": {"online_data": "sliding-window"},
}


@pytest.mark.parametrize("online", ONLINE.values(), ids=ONLINE)
def test_a_terminal_condition_out_of_reach_is_relaxed(online: dict[str, Any]) -> None:
    # In motion at full speed, five samples do not bring the plant to rest.
    controller = printed_deepc(slack=False, **online)
    said, u, y = run(controller, lag_loop(0.2, np.inf), np.array([0.0, 1.0]), 150)
    assert any(np.char.find(said, "terminal condition relaxed") >= 0)
    for status in said[3:]:  # the first pasts, at rest, are not the plant's
        assert status == "ok" or (
            "at its" in status
            and "clipped" not in status
            and "softened" not in status
            and "PIQP" not in status
        )
    assert np.abs(u).max() <= 0.2
    assert said[-1] == "ok"
    assert abs(y[-1, 0]) < 0.05


@pytest.mark.parametrize("online", ONLINE.values(), ids=ONLINE)
def test_outputs_that_begin_outside_their_bounds_are_brought_back(online: dict[str, Any]) -> None:
    controller = printed_deepc(slack=False, horizon=6, input_weight=0.01, **REGULATION, **online)
    said, u, y = run(controller, lag_loop(3.0, 0.3), np.array([2.0, 0.0]), 60)
    assert all("y at its upper bound: output bounds softened" in status for status in said[3:8])
    assert np.abs(u).max() <= 3.0
    assert said[-1] == "ok"
    assert np.abs(y[-20:]).max() <= 0.3


def test_softened_output_bounds_weigh_ten_thousand_times_the_largest_weight() -> None:
    hard, soft = (
        printed_deepc(slack=False, horizon=6, soft_output_bounds=weight, **REGULATION)
        for weight in (0.0, 300.0 * 1e4)
    )
    loop, start = lag_loop(1.0, 0.3), np.array([2.0, 0.0])
    (said, u, _), (others, expected, _) = (run(controller, loop, start, 8) for controller in (hard, soft))
    assert set(others[3:]) == {"ok"}
    assert "softened" in said[3]
    assert u == pytest.approx(expected, abs=1e-6)


def test_both_give_way_where_one_is_not_enough() -> None:
    said, u, y = run(printed_deepc(slack=False), lag_loop(0.5, 0.3), np.array([2.0, 0.0]), 120)
    both = "y at its upper bound: terminal condition relaxed, output bounds softened"
    assert sum(both in status for status in said) > 3
    assert np.abs(u).max() <= 0.5
    assert said[-1] == "ok"
    assert abs(y[-1, 0]) < 0.3


def test_the_l1_regulariser_gives_way_alike() -> None:
    controller = printed_deepc(regulariser="l1", lambda_g=1e-3, slack=False, horizon=6, **REGULATION)
    said, u, _ = run(controller, lag_loop(1.0, 0.3), np.array([2.0, 0.0]), 8)
    assert all("y at its upper bound: output bounds softened" in status for status in said[3:])
    assert np.abs(u).max() <= 1.0


def test_model_predictive_control_gives_way_alike() -> None:
    model = StateSpace(a=LAG.a.tolist(), b=LAG.b.tolist(), c=LAG.c.tolist())
    controller = MPC(model=model, setpoint="input-output", terminal_length=2, horizon=5)
    said, u, _ = run(controller, replace(lag_loop(0.2, 0.3), recording=None), np.array([2.0, 0.0]), 20)
    assert any("terminal condition relaxed, output bounds softened" in status for status in said)
    assert np.abs(u).max() <= 0.2


def test_inputs_that_cannot_get_within_their_bounds_are_clipped_last() -> None:
    # The last input is below 1, the bounds are [1, 2], and no more than 0.1 per sample is allowed.
    loop = replace(lag_loop(1.0, 0.3), continues_recording=True)
    loop = replace(loop, bounds=replace(loop.bounds, u_min=np.array([1.0]), u_max=np.array([2.0])))
    assert RECORDING.u[-1, 0] < 0.9
    said, u, _ = run(printed_deepc(rate_bounds=0.1), loop, np.zeros(2), 1)
    assert "change of u at its upper bound" in said[0]
    assert "clipped at the input limits" in said[0]
    assert u[0] >= 1.0


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([{}, REGULATION, {"slack": False}, {"rate_bounds": 0.4}, {"regulariser": "equilibrium"}]),
    st.floats(0.05, 2.0),
    st.floats(0.05, 2.0),
    st.integers(0, 2**32 - 1),
)
def test_inputs_stay_within_bounds_and_feasible_steps_are_what_they_were(
    options: dict[str, Any], u_max: float, y_max: float, seed: int
) -> None:
    rng, controller = np.random.default_rng(seed), printed_deepc(**options)
    controller.start(lag_loop(u_max, y_max))
    law = controller._law
    assert isinstance(law, ParametricQP)
    alone = copy.deepcopy(law)
    alone._relaxation = None
    for _ in range(5):
        parameters = controller._parameters.array.copy()
        parameters[:-1] = rng.normal(scale=rng.choice([0.1, 1.0, 10.0]), size=len(parameters) - 1)
        move, before = law.solve(parameters), alone.solve(parameters)
        assert move.u is not None
        assert before.u is not None
        assert np.abs(move.u[0]) <= u_max
        if "clipped" not in before.fault:
            assert move.u.tobytes() == before.u.tobytes()
            assert move.fault == before.fault
        else:
            assert "clipped" not in move.fault or options.keys() & {"rate_bounds"}


def test_a_law_that_has_given_way_can_be_copied_and_goes_on() -> None:
    controller = printed_deepc(slack=False, horizon=6, **REGULATION)
    run(controller, lag_loop(1.0, 0.3), np.array([2.0, 0.0]), 5)
    copy = pickle.loads(pickle.dumps(controller))
    sample = Sample(5, 0.5, np.array([1.5]), np.array([1.5]), np.zeros((6, 1)), np.zeros(1))
    original, other = controller.step(sample), copy.step(sample)
    assert isinstance(original, Action)
    assert isinstance(other, Action)
    assert original.status == other.status
    assert original.u == pytest.approx(other.u, abs=1e-9)
