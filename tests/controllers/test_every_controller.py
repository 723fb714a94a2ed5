"""What holds for all controllers: settings checked at once, runs repeatable, nothing shared."""

from copy import deepcopy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from ddpc_controllers import (
    GPC,
    IPID,
    LQR,
    MFAC,
    MFAPC,
    MPC,
    PID,
    SPC,
    SPSA,
    WKPC,
    BandEdge,
    Cascade,
    Decentralised,
    DeePC,
    Delays,
    GammaDDPC,
    Group,
    KoopmanMPC,
    OffsetFree,
    Scaled,
    SelectDPC,
)
from ddpc_controllers.optimisation.qp import StepInfo
from ddpc_controllers.published import PublishedDeePC, PublishedWKPC
from ddpc_cosim import Action, ConfigError, Controller, DataError, Loop, Recording, Sample, declared_settings
from ddpc_cosim.testing import ControllerConformance

from .loops import ANGLE, close_loop, make_loop, paper_reference, pendulum_loop, quick_pendulum

VARIANTS: list[Any] = [
    DeePC(),
    PublishedDeePC(),
    DeePC(regulariser="equilibrium", apply_steps=2, rate_bounds=0.5, soft_output_bounds=1e3),
    DeePC(online_data="sliding-window", dither=0.2, use_current_output=True),
    SPC(),
    SPC(predictor="causal", uncertainty=True),
    SelectDPC(),
    GammaDDPC(),
    WKPC(),
    PublishedWKPC(),
    MFAPC(),
    MFAPC(form="pfdl", limits="clip"),
    MFAPC(form="ffdl", rate_bounds=0.5, assume_sign=False),
    MFAC(form="ffdl"),
    GPC(),
    GPC(initial_model="gradient", rate_bounds=0.5, observer_pole=0.0, dead_zone=1e-4, control_horizon=3),
    IPID(order=2, alpha=5.0, kp=4.0, kd=4.0),
    Cascade(inner=IPID(order=2, alpha=5.0, kp=4.0, kd=4.0), outer_period=2),
    SPSA(kp=2.0, kd=0.2),
]
IDS = [
    "deepc",
    "deepc-published-code",
    "deepc-options",
    "deepc-online",
    "spc",
    "spc-causal",
    "select-dpc",
    "gamma-ddpc",
    "wkpc",
    "wkpc-published-code",
    "mfapc",
    "mfapc-pfdl",
    "mfapc-ffdl",
    "mfac",
    "gpc",
    "gpc-gradient",
    "ipid",
    "cascade",
    "spsa",
]


@pytest.fixture
def loop(state_recording: Recording) -> Loop:
    """The paper's loop with a torque limit that is often reached."""
    return pendulum_loop(state_recording, torque=2.5, degrees=170.0)


def inputs(answer: Any) -> np.ndarray:
    """Return the inputs of an answer in either form."""
    return answer.u if isinstance(answer, Action) else answer


MODEL_BASED: dict[str, Controller] = {
    "mpc": MPC(),
    "lqr": LQR(),
    "pid-step-test": PID(tuning="step-test"),
    "pid-virtual-reference": PID(tuning="virtual-reference"),
    "koopman": KoopmanMPC(),
    "koopman-delays": KoopmanMPC(state="delays", dictionary=Delays(samples=2)),
    "scaled-koopman": Scaled(controller=KoopmanMPC()),
    "offset-free-deepc": OffsetFree(controller=DeePC()),
    "offset-free-mpc": OffsetFree(controller=MPC(disturbance="none")),
    "band-edge-spc": BandEdge(controller=SPC()),
}
SET_UP = dict(zip(IDS, VARIANTS, strict=True)) | MODEL_BASED
DEFAULTS = {"deepc", "spc", "gamma-ddpc", "wkpc", "mfapc", "gpc", "mpc", "lqr", "koopman"}
"""Those of the default settings, with which test_conformance.py asks the same."""


@pytest.mark.parametrize("name", [name for name in SET_UP if name not in DEFAULTS])
class TestVariants(ControllerConformance):
    """The contract holds with other settings than the defaults too."""

    steps = 40

    @pytest.fixture
    def make_controller(self, name: str) -> Any:
        return partial(deepcopy, SET_UP[name])


@pytest.mark.parametrize("name", SET_UP)
def test_the_input_limits_hold_exactly_and_an_answer_is_the_callers_to_keep(name: str, loop: Loop) -> None:
    controller, kept = deepcopy(SET_UP[name]), deepcopy(SET_UP[name])
    reference = paper_reference()
    u = close_loop(controller, loop, quick_pendulum, ANGLE, reference, 60).u
    assert np.abs(u).max() <= 2.5
    kept.start(loop)
    state = np.zeros(2)
    for k, expected in enumerate(u):
        future = reference[k + 1 : k + 1 + kept.horizon]
        answer = inputs(kept.step(Sample(k, 0.1 * k, state[:1], state, future, future[0])))
        assert np.array_equal(answer, expected)
        state = quick_pendulum(state, answer)
        answer[:] = 99.0


@pytest.mark.parametrize("name", SET_UP)
def test_what_a_controller_says_that_it_uses_is_what_moves_it(name: str, loop: Loop) -> None:
    """Another velocity beside the same angle changes the inputs of those alone who say that they use it."""
    controller, misled = deepcopy(SET_UP[name]), deepcopy(SET_UP[name])
    controller.start(loop)
    misled.start(replace(loop, rng=np.random.default_rng(0)))
    facts = controller.knowledge(loop)
    assert facts.keys() == {"measures", "plant"}
    assert all(facts.values())
    state, moved = np.zeros(2), []
    for k in range(8):
        future = np.full((controller.horizon, 1), 0.2)
        wrong = state + np.array([0.0, 0.3])
        u = inputs(controller.step(Sample(k, 0.1 * k, state[:1], state, future, future[0])))
        other = inputs(misled.step(Sample(k, 0.1 * k, state[:1], wrong, future, future[0])))
        moved.append(not np.array_equal(u, other))
        state = quick_pendulum(state, u)
    assert any(moved) == ("x1" in facts["measures"])


@pytest.mark.parametrize(
    "controller",
    [*SET_UP.values(), Decentralised(groups=[Group(inputs=["u0"], outputs=["y0"], controller=MPC())])],
    ids=[*SET_UP, "decentralised"],
)
def test_what_a_controller_says_of_a_step_is_worked_out_after_it(
    controller: Controller, loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_too_early(_: StepInfo) -> None:
        raise AssertionError("read while the step is timed")

    controller = deepcopy(controller)
    controller.start(loop)
    state, future = np.zeros(2), np.full((controller.horizon, 1), 0.2)
    with monkeypatch.context() as patch:
        patch.setattr(StepInfo, "_read", read_too_early)
        answers = [controller.step(Sample(k, 0.1 * k, state[:1], state, future, future[0])) for k in range(3)]
    assert all(
        np.isfinite(list(answer.info.values())).all() for answer in answers if isinstance(answer, Action)
    )


@pytest.mark.parametrize("name", SET_UP)
def test_every_setting_says_what_it_is(name: str) -> None:
    controller = SET_UP[name]
    declared = declared_settings(type(controller))
    assert set(declared) == set(controller.settings())
    assert all(info.doc for info in declared.values())


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        (SPC, {"initial_length": 0, "apply_steps": 0, "backend": "other", "use_current_output": 1}),
        (GammaDDPC, {"beta_2": -1.0, "beta_3": 0.0}),
        (DeePC, {"horizon": 0, "lambda_g": -1.0, "affine_sum": "some", "setpoint_margin": 2.0}),
        (WKPC, {"initial_length": 1.5, "input_weight": 0.0, "online_data": "yes"}),
        (MFAPC, {"eta": 2.5, "forecast_order": 0, "lambda_u": float("nan")}),
        (GPC, {"horizon": 0, "forgetting_factor": 1.5, "change_weight": 0.0, "initial_model": "zero"}),
        (MFAC, {"form": "xfdl", "step_factor": 0.0, "rate_bounds": -1.0}),
        (IPID, {"order": 3, "window": 0, "kp": -1.0}),
        (SPSA, {"window": 1, "perturbation": 0.0}),
    ],
)
def test_every_impossible_setting_is_named_at_once(kind: Any, settings: dict[str, Any]) -> None:
    with pytest.raises(ConfigError) as caught:
        kind(**settings)
    assert len(caught.value.faults) == len(settings)
    for name in settings:
        assert any(name in fault for fault in caught.value.faults)


@pytest.mark.parametrize("horizon", [2, 3])
def test_a_horizon_that_the_terminal_condition_fills_is_refused(horizon: int) -> None:
    with pytest.raises(ConfigError, match=f"horizon = {horizon} is not longer than initial_length = 3"):
        DeePC(horizon=horizon, terminal_equality=True)


@pytest.mark.parametrize(
    ("kind", "settings"),
    [(DeePC, {"terminal_equality": False}), (SPC, {"use_current_output": False}), (WKPC, {})],
)
def test_a_horizon_that_no_input_reaches_is_refused(kind: Any, settings: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="horizon = 1 predicts the present output alone"):
        kind(horizon=1, **settings)
    kind(horizon=2, **settings)


def test_a_dictionary_that_cannot_draw_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"dictionary = 7 lacks draw"):
        WKPC(dictionary=7)


def test_the_published_lift_is_of_thin_plates() -> None:
    class Other:
        def functions(self, size: int) -> int:
            return size

        def draw(self, size: int, rng: np.random.Generator) -> Any:
            return np.square

    with pytest.raises(ConfigError, match="is not a ThinPlate"):
        PublishedWKPC(dictionary=Other())


@pytest.mark.parametrize("kind", [DeePC, WKPC])
def test_a_missing_recording_is_an_error_that_says_what_to_give(kind: Any) -> None:
    with pytest.raises(DataError, match="give the loop an excitation or a recording"):
        kind().start(make_loop(None, np.ones(1), np.ones(1)))


@pytest.mark.parametrize("kind", [DeePC, WKPC])
def test_a_recording_of_other_signals_is_refused(kind: Any, loop: Loop) -> None:
    other = Recording(np.zeros((200, 2)), np.zeros((200, 1)), np.zeros((200, 2)), 0.1)
    with pytest.raises(DataError, match=r"\(2, 1, 2\), the loop has \(1, 1, 2\)"):
        kind().start(replace(loop, recording=other))


@pytest.mark.parametrize("kind", [DeePC, WKPC])
def test_a_recording_at_another_sampling_time_is_refused(kind: Any, loop: Loop) -> None:
    with pytest.raises(DataError, match=r"sampled every 0.1 s, the loop runs every 0.2 s"):
        kind().start(replace(loop, sampling_time=0.2))


@pytest.mark.parametrize("kind", [DeePC, WKPC])
def test_every_weight_of_the_wrong_size_is_named_at_once(kind: Any, loop: Loop) -> None:
    with pytest.raises(ConfigError) as caught:
        kind(output_weight=[1.0, 2.0, 3.0], input_weight=[[1.0, 0.0], [0.0, 1.0]]).start(loop)
    assert [fault.split()[0] for fault in caught.value.faults] == ["output_weight", "input_weight"]


@pytest.mark.parametrize("controller", [DeePC(), DeePC(horizon=9, assumed_order=4), WKPC()])
def test_the_length_it_asks_for_is_the_shortest_it_starts_with(controller: Any) -> None:
    needed = controller.recording_length(1, 1, 2)
    rng = np.random.default_rng(3)
    u, x = rng.uniform(-1.0, 1.0, (needed, 1)), rng.standard_normal((needed, 2))
    whole = Recording(u, x[:, :1], x, 0.1)
    controller.start(pendulum_loop(whole))
    short = Recording(u[:-1], x[:-1, :1], x[:-1], 0.1)
    with pytest.raises(DataError, match=f"at least {needed}"):
        controller.start(pendulum_loop(short))
