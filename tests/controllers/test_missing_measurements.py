"""A missing measurement: what the plan predicted stands in for it, and nothing is learned from it."""

from collections.abc import Callable

import numpy as np
import pytest

from ddpc_controllers import IPID, MFAC, MFAPC, MPC, PID, SPC, SPSA, Identity, KoopmanMPC
from ddpc_controllers.deepc import BehavioralTracking
from ddpc_controllers.optimisation.limits import PREDICTED
from ddpc_controllers.published import PublishedWKPC
from ddpc_cosim import Action, Bounds, Controller, FloatArray, Loop, Recording, Sample, Variable

from .loops import printed_deepc, printed_wkpc

A = np.array([[0.8, 0.1], [-0.1, 0.7]])
B = np.array([[0.5, 0.1], [0.0, 0.4]])
REST = np.full(2, 50.0)

CONTROLLERS: dict[str, Callable[[], Controller]] = {
    "DeePC": lambda: printed_deepc(affine_sum="all", lambda_g=1e-6),
    "DeePC, current output": lambda: printed_deepc(affine_sum="all", lambda_g=1e-6, use_current_output=True),
    "DeePC, three inputs a plan": lambda: printed_deepc(affine_sum="all", lambda_g=1e-6, apply_steps=3),
    "DeePC, three, current output": lambda: printed_deepc(
        affine_sum="all", lambda_g=1e-6, apply_steps=3, use_current_output=True
    ),
    "DeePC, rates": lambda: printed_deepc(affine_sum="all", lambda_g=1e-6, rate_bounds=5.0),
    # A smaller weight leaves a minimum so flat that solutions within the solver's tolerance differ by 4e-3.
    "DeePC, L1": lambda: printed_deepc(affine_sum="all", lambda_g=1e-2, regulariser="l1"),
    "DeePC, equilibrium": lambda: printed_deepc(affine_sum="all", lambda_g=1e-6, regulariser="equilibrium"),
    "DeePC, online": lambda: printed_deepc(affine_sum="all", lambda_g=1e-6, online_data="sliding-window"),
    "SPC": SPC,
    "WKPC": lambda: printed_wkpc(dictionary=Identity(), lambda_g=1e-6),
}


def affine_loop(continues: bool, extra: int = 0) -> tuple[Loop, FloatArray]:
    """Return a loop about an operating point far from zero, and the state after its recording.

    ``extra`` measurements beside the outputs show the first input of the sample before.
    """
    rng = np.random.default_rng(0)
    u = REST + rng.uniform(-20.0, 20.0, (200, 2))
    states = np.tile(REST, (201, 1))
    for k in range(200):
        states[k + 1] = advance(states[k], u[k])
    y = states[:-1]
    measured = np.hstack([y, np.tile(np.vstack([REST[:1], u[:-1, :1]]), extra)])
    loop = Loop(
        sampling_time=0.1,
        inputs=tuple(Variable(f"u{i}", start=50.0) for i in range(2)),
        outputs=tuple(Variable(f"y{i}") for i in range(2)),
        measurements=tuple(Variable(f"x{i}") for i in range(2 + extra)),
        bounds=Bounds(np.zeros(2), np.full(2, 100.0), np.zeros(2), np.full(2, 100.0)),
        recording=Recording(u, y, measured, 0.1),
        rng=np.random.default_rng(0),
        continues_recording=continues,
    )
    return loop, states[-1]


def advance(state: FloatArray, u: FloatArray) -> FloatArray:
    """Return the next state of a linear plant about REST."""
    return np.asarray(REST + A @ (state - REST) + B @ (u - REST))


def run(
    controller: Controller, missing: dict[int, FloatArray], continues: bool = True
) -> tuple[FloatArray, list[str]]:
    """Close the loop for 30 samples; ``missing`` is added to the measurements of some."""
    loop, state = affine_loop(continues)
    controller.start(loop)
    state = state if continues else REST
    applied, said = [], []
    for k in range(30):
        y = state + missing.get(k, 0.0)
        reference = np.full((controller.horizon, 2), 52.0 if k < 15 else 48.0)
        answer = controller.step(Sample(k, 0.1 * k, y, y, reference, reference[0]))
        action = answer if isinstance(answer, Action) else Action(answer)
        applied.append(action.u.copy())
        said.append(action.status)
        state = advance(state, action.u)
    return np.array(applied), said


@pytest.mark.parametrize("make", CONTROLLERS.values(), ids=CONTROLLERS)
@pytest.mark.parametrize("missing", [np.full(2, np.nan), np.array([0.0, np.nan]), np.array([np.inf, 0.0])])
def test_what_was_predicted_stands_in_channel_by_channel(
    make: Callable[[], Controller], missing: FloatArray
) -> None:
    undisturbed, said = run(make(), {})
    assert set(said) == {"ok"}
    u, said = run(make(), {7: missing, 17: missing, 18: missing})
    # Without noise the prediction is what would have been measured.
    assert u == pytest.approx(undisturbed, abs=1e-3)
    assert {k for k, status in enumerate(said) if status != "ok"} == {7, 17, 18}
    assert {said[k] for k in (7, 17, 18)} == {PREDICTED}


@pytest.mark.parametrize("make", CONTROLLERS.values(), ids=CONTROLLERS)
def test_before_the_first_measurement_the_inputs_rest(make: Callable[[], Controller]) -> None:
    u, said = run(make(), {0: np.full(2, np.nan), 1: np.full(2, np.nan)}, continues=False)
    later, _ = run(make(), {}, continues=False)
    assert np.array_equal(u[:2], np.tile(REST, (2, 1)))
    assert said[:3] == [PREDICTED, PREDICTED, "ok"]
    assert u[2] == pytest.approx(later[0], abs=1e-6)


@pytest.mark.parametrize("make", CONTROLLERS.values(), ids=CONTROLLERS)
def test_a_reference_that_is_not_finite_holds_the_inputs(make: Callable[[], Controller]) -> None:
    controller = make()
    loop, state = affine_loop(continues=False)
    controller.start(loop)
    steps = controller.apply_steps if isinstance(controller, BehavioralTracking) else 1
    for k in range(steps):
        answer = controller.step(
            Sample(k, 0.0, state, state, np.full((controller.horizon, 2), 55.0), np.full(2, 55.0))
        )
        last = answer.u if isinstance(answer, Action) else answer
    held = controller.step(
        Sample(steps, 0.0, state, state, np.full((controller.horizon, 2), np.nan), np.full(2, np.nan))
    )
    assert isinstance(held, Action)
    assert "inputs held" in held.status
    assert held.u == pytest.approx(last, abs=1e-12)


@pytest.mark.parametrize("online_data", ["sliding-window", "forgetting"])
@pytest.mark.parametrize("signal", [0, 2])
def test_wkpc_learns_no_window_with_a_stand_in(online_data: str, signal: int) -> None:
    controller = printed_wkpc(dictionary=Identity(), online_data=online_data, excitation_floor=0.0)
    loop, state = affine_loop(continues=True, extra=1)
    controller.start(loop)
    refused = []
    u = REST
    for k in range(25):
        measured = np.append(state, u[0])
        if k == 10:
            measured[signal] = np.nan
        answer = controller.step(
            Sample(k, 0.1 * k, measured[:2], measured, np.full((5, 2), 52.0), np.full(2, 52.0))
        )
        u = answer.u if isinstance(answer, Action) else answer
        refused.append(controller.diagnostics()["online_windows_refused"])
        state = advance(state, u)
    # A window is seven samples long.
    assert refused == [0.0] * 10 + [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0] + [7.0] * 8


@pytest.mark.parametrize("missing", [0, 3])
def test_the_published_program_survives(missing: int) -> None:
    controller = PublishedWKPC()
    loop, state = affine_loop(continues=False)
    controller.start(loop)
    for k in range(12):
        y = state + (np.nan if k == missing else 0.0)
        answer = controller.step(Sample(k, 0.1 * k, y, y, np.full((5, 2), 51.0), np.full(2, 51.0)))
        u = answer.u if isinstance(answer, Action) else answer
        assert np.isfinite(u).all()
        if k == missing:
            assert isinstance(answer, Action)
            assert answer.status == PREDICTED
        state = advance(state, u)


HOLDING: dict[str, tuple[Callable[[], Controller], str]] = {
    "PID": (lambda: PID(proportional=0.5, integral=0.1), "either"),
    "MFAC": (MFAC, "either"),
    "MFAPC": (MFAPC, "either"),
    "SPSA": (SPSA, "either"),
    "i-PID": (IPID, "reference"),
    "MPC": (MPC, "reference"),
    "Koopman MPC": (lambda: KoopmanMPC(dictionary=Identity()), "reference"),
}
"""Controllers that hold their inputs where either, or the reference alone, is missing."""


@pytest.mark.parametrize(
    ("make", "missing"),
    [
        pytest.param(make, missing, id=f"{name}, {missing}")
        for name, (make, held) in HOLDING.items()
        for missing in (["measurement", "reference"] if held == "either" else [held])
    ],
)
def test_without_a_measurement_or_a_reference_the_last_inputs_are_held(
    make: Callable[[], Controller], missing: str
) -> None:
    controller = make()
    loop, state = affine_loop(continues=False)
    controller.start(loop)
    nothing, reference = np.full(2, np.nan), np.full((controller.horizon, 2), 51.0)
    answers = []
    for k in range(4):
        y = nothing if k == 2 and missing == "measurement" else state
        asked = reference + (np.nan if k == 2 and missing == "reference" else 0.0)
        answer = controller.step(Sample(k, 0.1 * k, y, y, asked, asked[0]))
        answers.append(answer if isinstance(answer, Action) else Action(answer))
        state = advance(state, answers[-1].u)
    held = answers[2]
    assert "not finite: inputs held" in held.status
    assert np.array_equal(held.u, answers[1].u)
    assert np.abs(held.u - REST).max() > 0.0
    assert (answers[3].status, np.isfinite(answers[3].u).all()) == ("ok", True)
