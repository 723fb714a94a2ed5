"""Controllers without a model or with one of changes, and those that hold others, in C: as in Python."""

from dataclasses import dataclass, replace
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
    SPSA,
    Cascade,
    Decentralised,
    Group,
    Idle,
    OffsetFree,
    Scaled,
    StateSpace,
)
from ddpc_cosim import Bounds, ConfigError, Controller, FloatArray, Loop, Sample

from .compiled import Beside
from .loops import COUPLED, PENDULUM, Bench, ask_at_random, limited_loop

LAG = StateSpace(a=[[0.8]], b=[[0.2]], c=[[1.0]])
ALL = {
    "pid": PID(proportional=0.5, integral=0.3, derivative=0.05, filter_time=0.05, setpoint_share=0.3),
    "pid-clamping": PID(proportional=3.0, integral=[2.0], anti_windup="clamping"),
    "pid-tracking": PID(proportional=3.0, integral=2.0, tracking_time=0.5, derivative=0.4),
    "pid-step-test": PID(tuning="step-test"),
    "pid-virtual-reference": PID(tuning="virtual-reference"),
    "mfapc": MFAPC(limits="clip"),
    "mfapc-qp": MFAPC(lambda_u=0.02, horizon=8, control_horizon=3, scaling="range"),
    "mfapc-pfdl": MFAPC(
        form="pfdl", rate_bounds=0.3, assume_sign=False, forecast_order=2, forecast_limit=0.5
    ),
    "mfapc-ffdl": MFAPC(form="ffdl", rate_bounds=0.3, lambda_u=0.01, output_length=2, initial_gradient=0.01),
    "mfac": MFAC(form="ffdl", step_factor=0.6, rate_bounds=0.5),
    "gpc": GPC(rate_bounds=1.5, horizon=6),
    "gpc-gradient": GPC(
        initial_model="gradient", observer_pole=0.0, control_horizon=3, output_length=1, scaling="range"
    ),
    "ipid": IPID(alpha=5.0, kp=2.0),
    "ipid-second-order": IPID(order=2, alpha=5.0, kp=9.0, kd=4.0, ki=3.0, window=6),
}
COUPLED_ONES = {
    "mfapc": MFAPC(form="ffdl", initial_gradient=[[0.5, 0.1], [0.0, 0.4]], rate_bounds=[0.3, 0.5]),
    "mfapc-diagonal": MFAPC(form="pfdl", structure="diagonal", horizon=6, rate_bounds=[0.7, 0.4]),
    "mfapc-diagonal-ffdl": MFAPC(form="ffdl", structure="diagonal", output_length=3, control_horizon=2),
    "mfac": MFAC(form="pfdl", lambda_u=0.01),
    "gpc": GPC(output_weight=[1.0, 3.0], change_weight=[0.1, 0.4], rate_bounds=[0.3, 0.5]),
    "gpc-gradient": GPC(initial_model="gradient", initial_gradient=[[0.5, 0.1], [0.0, 0.4]], input_length=1),
    "pid": PID(proportional=[0.1, 0.2], integral=[0.3, 0.1], derivative=0.01, pairing=[1, 0]),
    "ipid": IPID(alpha=[[5.0, 0.3], [0.0, 4.0]], kp=1.0, ki=0.5),
    "ipid-coupled": IPID(order=2, alpha=[[50.0, 3.0], [2.0, 40.0]], kp=2.0, kd=3.0, window=5),
    "decentralised": Decentralised(
        groups=[
            Group(inputs=["u1"], outputs=["x0"], controller=PID(proportional=0.5, integral=0.3)),
            Group(inputs=["u0"], outputs=["x1"], measurements=["x2", "x1"], controller=IPID(alpha=4.0)),
        ]
    ),
    "scaled-decentralised": Scaled(
        controller=Decentralised(
            groups=[
                Group(
                    inputs=["u0", "u1"], outputs=["x0", "x1"], controller=PID(proportional=2.0, integral=1.0)
                )
            ]
        )
    ),
}
CASCADES = {
    "mfapc-outer": Cascade(
        inner=PID(proportional=2.0), outer=MFAPC(form="ffdl", scaling="range"), outer_period=2
    ),
    "ipid-in-pid": Cascade(inner=IPID(order=2, alpha=5.0, kp=9.0, kd=6.0), outer=PID(proportional=0.2)),
    "slow-outer": Cascade(inner=PID(proportional=2.0), outer=IPID(alpha=2.0, window=2), outer_period=3),
    "scaled-outer": Cascade(
        inner=PID(proportional=2.0, integral=1.0),
        outer=Scaled(controller=PID(proportional=0.3, integral=0.2), scale_by="nominal"),
        outer_period=2,
    ),
    "of-a-measurement": Cascade(
        inner=PID(proportional=2.0), outer=PID(proportional=2.0), inner_outputs=["x1"], outer_period=2
    ),
    "gpc-outer": Cascade(inner=PID(proportional=2.0), outer=GPC(initial_model="gradient"), outer_period=2),
    "mpc-outer": Cascade(
        inner=PID(proportional=2.0, integral=1.0), outer=MPC(model=LAG, horizon=6, rate_bounds=0.1)
    ),
    "offset-free-outer": Cascade(
        inner=PID(proportional=2.0), outer=OffsetFree(controller=LQR(model=LAG)), outer_period=2
    ),
    "idle-outer": Cascade(inner=PID(proportional=2.0), outer=Idle()),
    "in-a-cascade": Cascade(
        inner=PID(proportional=2.0),
        outer=Cascade(inner=PID(integral=0.3), outer=PID(integral=0.1), outer_period=2),
    ),
}
CASES = [
    *((PENDULUM, name, controller) for name, controller in (ALL | CASCADES).items()),
    *((COUPLED, name, controller) for name, controller in COUPLED_ONES.items()),
]


def check(beside: Beside, bound: float = 1e-11, fallbacks: int = 4) -> None:
    assert beside.difference < bound
    assert not beside.disagreements
    assert beside.fallbacks >= fallbacks


@pytest.mark.parametrize("continues", [False, True], ids=["from rest", "continues"])
@pytest.mark.parametrize(("bench", "name", "controller"), CASES, ids=[name for _, name, _ in CASES])
def test_the_code_is_the_controller(bench: Bench, name: str, controller: Controller, continues: bool) -> None:
    if name in ("pid-step-test", "pid-virtual-reference"):  # the rules are for monotonic plants
        bench = Bench(bench.advance, bench.nominal, bench.limits / 50.0, 1, bench.rest)
    check(bench.close(controller, continues_recording=continues))


def test_a_weight_below_the_rounding_of_the_gradients_leaves_the_least_change() -> None:
    loop, _ = COUPLED.loop(recording=None)
    loop = replace(loop, outputs=loop.outputs[:1])
    beside = Beside(controller=MFAPC(horizon=1, initial_gradient=[[3e8, 4e8]], scaling="none"))
    beside.start(loop)
    beside.step(Sample(0, 0.0, np.zeros(1), np.zeros(3), np.full((1, 1), 1e7), np.zeros(1)))
    assert beside.difference < 1e-12


def test_limits_that_no_change_can_keep_are_told_and_clipped() -> None:
    loop, _ = PENDULUM.loop(continues_recording=True)
    high = float(loop.recording.u[-1, 0]) - 1.0  # the recording ended a volt beyond, the rate is a tenth
    free = np.full(1, np.inf)
    loop = replace(loop, bounds=Bounds(np.array([high - 5.0]), np.array([high]), -free, free))
    beside = Beside(controller=MFAPC(rate_bounds=0.1, scaling="none"))
    beside.start(loop)
    for k in range(3):
        y = np.array([0.1 * k])
        beside.step(Sample(k, 0.1 * k, y, np.append(0.0, y), np.full((5, 1), 1e3), np.zeros(1)))
        assert beside.c.status == (8 if k == 0 else 0)
    assert beside.difference < 1e-12
    assert not beside.disagreements


@pytest.mark.parametrize("seed", range(8))
def test_random_settings_and_samples_of_which_most_have_active_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, horizon = int(rng.integers(1, 4)), int(rng.integers(2, 7))
    loop = limited_loop(rng, m, horizon)
    controller = MFAPC(
        form=("cfdl", "pfdl", "ffdl")[seed % 3],
        horizon=horizon,
        control_horizon=int(rng.integers(0, horizon + 1)),
        rate_bounds=rng.uniform(0.1, 1.0, m).tolist() if seed % 2 else (),
        initial_gradient=rng.normal(size=(2, m)).tolist(),
        lambda_u=float(10.0 ** rng.uniform(-2.0, 1.0)),
        forecast_order=int(rng.integers(1, 5)),
        assume_sign=seed < 4,
        scaling="none",
    )
    beside, active = Beside(controller=controller), 0
    for limited in ask_at_random(beside, loop, rng):
        check(beside, bound=1e-9, fallbacks=0)
        active += limited
    assert active > 40


@pytest.mark.parametrize("preview", [0, 1, 3])
def test_an_outer_controller_sees_as_much_of_the_future_as_in_python(preview: int) -> None:
    @dataclass(kw_only=True)
    class Ahead(Idle):
        """Asks for what it sees ahead."""

        horizon: int = 4

        def step(self, sample: Sample) -> FloatArray:
            return np.asarray(sample.reference[-1])

        def c_step(self, code: Any, loop: Loop) -> str:
            return code.step(f"memcpy(u, sample->reference + {self.horizon - 1}, sizeof(double));")

    cascade = Cascade(inner=PID(proportional=2.0), outer=Ahead(), outer_period=2)
    check(PENDULUM.close(cascade, preview=preview, unknown=(), lost=(3, 8, 20, 31)))


def test_what_cannot_run_in_c_says_why() -> None:
    @dataclass(kw_only=True)
    class Crooked(Idle):
        def start(self, loop: Loop) -> None:
            super().start(loop)
            self._u = np.square(self._u)

        def c_step(self, code: Any, loop: Loop) -> str:
            return super().c_step(code, loop)

    @dataclass(kw_only=True)
    class Mine(Controller):
        def start(self, loop: Loop) -> None: ...

        def step(self, sample: Sample) -> FloatArray:
            return np.zeros(1)

    refused: dict[str, Controller] = {
        "SPSA cannot be exported: it draws random perturbations": SPSA(),
        "Cascade: Crooked cannot be exported as the outer controller": Cascade(inner=PID(), outer=Crooked()),
        "Mine cannot be exported within another controller": Cascade(inner=Mine(), outer=PID()),
        "Mine cannot be": Decentralised(groups=[Group(inputs=["u0"], outputs=["x0"], controller=Mine())]),
    }
    loop, _ = PENDULUM.loop()
    for reason, controller in refused.items():
        controller.start(loop)
        with pytest.raises(ConfigError, match=reason):
            controller.c_code(loop)
