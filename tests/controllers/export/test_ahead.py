"""Disturbances with forecasts, bands, limits that move and prices in C: as in Python."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from controllers.export.compiled import Beside
from controllers.test_foresight import PLANTS, Case, make, power, sample_of
from ddpc_controllers import (
    GPC,
    IPID,
    LQR,
    MFAC,
    MFAPC,
    MPC,
    PID,
    SPC,
    WKPC,
    BandEdge,
    DeePC,
    GammaDDPC,
    KoopmanMPC,
    SafetyFilter,
    Scaled,
)
from ddpc_controllers.data.dictionaries import Identity, ThinPlate
from ddpc_cosim import Action, Controller, Loop, Sample, export_controller, further_arguments, further_signals
from ddpc_cosim.variables import names

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


def side_by_side(
    controller: Controller, case: Case, preview: int, missing: float = 0.05, **changes: Any
) -> Beside:
    """Close a loop whose future is random at every sample."""
    loop = replace(a_case(case, preview), **changes)
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
    "DeePC, free response": lambda: DeePC(regulariser="free-response", horizon=6, affine_sum="all"),
    "SPC, causal": lambda: SPC(predictor="causal", uncertainty=True, horizon=6),
    "DeePC, plans": lambda: DeePC(apply_steps=3, rate_bounds=0.3, use_current_output=True),
    "SPC": lambda: SPC(horizon=6),
    "SPC, measured only": lambda: SPC(horizon=5, use_forecast=False),
    "SPC, identified": lambda: SPC(horizon=5, use_forecast="identified"),
    "gamma-DDPC": lambda: GammaDDPC(beta_2=1e-3, horizon=6, scaling="range"),
    "MPC": lambda: MPC(horizon=6),
    "MPC, cheap inputs": lambda: MPC(horizon=16, input_weight=1e-3),
    "MPC, identified": lambda: MPC(horizon=6, use_forecast="identified"),
    "MPC, outputs": lambda: MPC(
        horizon=5, setpoint="none", soft_output_bounds=1e3, rate_bounds=0.4, scaling="range"
    ),
    "LQR": lambda: LQR(horizon=4),
    "Koopman MPC": lambda: KoopmanMPC(horizon=6, dictionary=ThinPlate(count=3)),
    "Koopman MPC, delays": lambda: KoopmanMPC(horizon=6, state="delays", delays=2, dictionary=Identity()),
    "PID": lambda: PID(proportional=4.0, integral=0.5, derivative=0.05, feedforward=True),
    "WKPC": lambda: WKPC(dictionary=ThinPlate(count=4)),
    "GPC": lambda: GPC(horizon=6, control_horizon=3, rate_bounds=0.5),
    "intelligent PID": lambda: IPID(alpha=2.0, ki=0.2),
    "MFAC": lambda: MFAC(form="ffdl", lambda_u=0.1),
    "MFAPC": lambda: MFAPC(horizon=5, control_horizon=2, lambda_u=0.1, rate_bounds=0.5),
    "PID, lower edge": lambda: Scaled(
        controller=BandEdge(margin=0.1, controller=PID(proportional=4.0, integral=0.5, setpoint_share=0.6))
    ),
    "LQR, upper edge": lambda: BandEdge(edge="upper", margin=0.05, controller=LQR(horizon=4)),
    "SPC, lower edge": lambda: BandEdge(margin=[0.05, 9.0], controller=SPC(horizon=6)),
    "DeePC, upper edge": lambda: BandEdge(edge="upper", controller=DeePC(horizon=6)),
    "DeePC, both edges": lambda: BandEdge(edge="both", margin=[0.05, 9.0], controller=DeePC(horizon=6)),
    "MPC, both edges": lambda: Scaled(
        controller=BandEdge(
            edge="both", margin=0.05, controller=Scaled(controller=MPC(horizon=6), scale_by="nominal")
        )
    ),
    "MPC, an edge within both": lambda: BandEdge(
        edge="both", margin=0.05, controller=BandEdge(margin=0.03, controller=MPC(horizon=6))
    ),
    "safety filter": lambda: SafetyFilter(controller=LQR(horizon=4), steps_ahead=6),
}
WITHOUT_OPTIMISATION = ("LQR", "PID", "intelligent PID", "PID, lower edge", "LQR, upper edge")


def fmu_rows(loop: Loop, samples: list[Sample], horizon: int, *, ahead: bool) -> np.ndarray:
    """Return the inputs of an exported FMU over time, without what is ahead if so asked."""
    further = further_arguments(loop, horizon)
    outputs, preview = names(loop.outputs), min(loop.preview, horizon)
    others = [i for i, v in enumerate(loop.measurements) if v.name not in outputs]
    heads = [*outputs, *(loop.measurements[i].name for i in others), *(f"setpoint.{n}" for n in outputs)]
    heads += [f"reference.{n}[{k}]" for k in range(1, preview + 1) for n in outputs]
    heads += [signal.name for signal in further_signals(loop, horizon)]
    rows = []
    for sample in samples:
        fields = [getattr(sample, name)[: shape[0]].ravel() for name, shape in further.items()]
        parts = (sample.y, sample.measured[others], sample.setpoint, sample.reference[:preview].ravel())
        rows.append((sample.time, *np.clip(np.concatenate([*parts, *fields]), -1e30, 1e30)))
    table = np.array(rows, dtype=[(name, float) for name in ("time", *heads)])
    kept = [n for n in heads if ahead or "[" not in n or n.startswith(("reference", "max.y", "min.y"))]
    return table[["time", *kept]]


def lasting(sample: Sample) -> Sample:
    """Return a sample of which what is ahead is as it is now."""
    return sample._replace(
        forecast=np.broadcast_to(sample.disturbance, sample.forecast.shape),
        band=np.broadcast_to(sample.band_now, sample.band.shape),
        price=np.broadcast_to(sample.price[0], sample.price.shape),
        input_limits=np.broadcast_to(sample.input_limits[0], sample.input_limits.shape),
    )


@pytest.mark.parametrize("ahead", [True, False], ids=["connected", "not connected ahead"])
def test_the_fmu_has_inputs_for_all_of_it(ahead: bool, tmp_path: Path) -> None:
    case, controller = PLANTS["two inputs, two outputs"], DeePC(horizon=5)
    loop, rng, samples = replace(make(case, 160), preview=3), np.random.default_rng(2), list[Sample]()
    controller.start(loop)
    path = export_controller(controller, loop, tmp_path / "all.fmu")
    assert validate_fmu(str(path)) == []
    described = {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables}
    assert described["price.heat[5]"].unit == "EUR/1"
    assert {"forecast.d0[5]", "lower.y0[3]", "upper.y0", "max.u0[3]", "max.y0[3]"} <= set(described)
    assert not {"lower.y0[4]", "max.u0[4]", "max.y0", "forecast.d0[6]"} & set(described)
    expected, state, u = [], np.zeros(case.output.shape[1]), np.zeros(case.inputs)
    for k in range(20):
        y, d = case.output @ state, rng.uniform(-0.5, 1.0, case.disturbances)
        measured = np.array([*state, power(u, y)])
        sample = known_so_far(sample_of(loop, k, y, measured, d, 5, rng), 3)
        samples.append(sample)
        answer = controller.step(sample if ahead else lasting(sample))
        u = np.clip(answer.u if isinstance(answer, Action) else answer, *sample.input_limits[0].T)
        expected.append(u)
        state = case.advance(state, np.concatenate([u, d]))
    h = loop.sampling_time
    result = fmpy.simulate_fmu(
        str(path),
        input=fmu_rows(loop, samples, 5, ahead=ahead),
        stop_time=20 * h,
        step_size=h,
        output=["u0", "u1"],
    )
    answers = np.array([result["u0"][1:], result["u1"][1:]]).T
    np.testing.assert_allclose(answers, expected, atol=1e-8 * case.limit)


ON_THE_PENDULUM = ("DeePC", "DeePC, plans", "SPC", "gamma-DDPC", "WKPC", "MPC, outputs", "LQR", "PID")
ON_BOTH = (
    "MPC",
    "MPC, cheap inputs",
    "Koopman MPC",
    "Koopman MPC, delays",
    "PID, lower edge",
    "MPC, both edges",
)


@pytest.mark.parametrize(
    ("name", "plant"),
    [
        *((name, "pendulum") for name in (*ON_THE_PENDULUM, *ON_BOTH)),
        *((name, "two inputs, two outputs") for name in METHODS if name not in ON_THE_PENDULUM),
    ],
)
def test_all_of_it_is_decided_as_in_python(name: str, plant: str) -> None:
    preview = 2 if plant == "pendulum" else 50
    beside = side_by_side(METHODS[name](), PLANTS[plant], preview)
    assert beside.difference <= 1e-8
    assert not beside.disagreements
    assert beside.limited > 0
    assert beside.active > 0 or name in WITHOUT_OPTIMISATION
