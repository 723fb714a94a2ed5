"""A controller that is an FMU, in closed loop: it behaves as the controller that it was exported from."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.blocks import block_files
from studies import cases_in, study_text, write

from ddpc_controllers import LQR, DeePC, FMUController, Idle
from ddpc_cosim import (
    Bounds,
    Conditions,
    ConfigError,
    Controller,
    ControllerError,
    FMUPlant,
    GaussianNoise,
    Loop,
    Outcome,
    Sample,
    Steps,
    Trace,
    UniformRandom,
    Variable,
    cosimulate,
    export_controller,
)
from fmu_plants import Variable as ScalarVariable
from fmu_plants.export import export_block
from fmu_plants.export.sampled_block import SampledBlock

DEGREE = math.pi / 180.0
LIMITS = Bounds(*(np.array([limit]) for limit in (-1e6, 1e6, -np.inf, np.inf)))
ANGLE, VELOCITY, TORQUE = (
    Variable("angle", "rad"),
    Variable("angular_velocity", "rad/s"),
    Variable("torque", "N.m"),
)

STEP = """
state->memory[0] += 1.0;
state->iterations = 7;
state->status = y[0] > 100.0 ? 5u : 0u;
u[0] = y[0] > 1000.0 ? INFINITY : r[0] - 0.5 * y[0] + 10.0 * y[1] + 100.0 * state->memory[0];
"""


def foreign(folder: Path, sampling_time: float = 0.1) -> Path:
    """An FMU with names and units of its own: u = r - y / 2 + 10 gain + 100 (steps so far)."""
    block = SampledBlock(
        "foreign",
        "A controller of another tool",
        sampling_time,
        (ScalarVariable("phi", "deg"), ScalarVariable("gain")),
        (ScalarVariable("phi_ref", "deg"),),
        (ScalarVariable("M", "kN.m"),),
        block_files(STEP),
    )
    return export_block(block, folder / "foreign.fmu")


NAMES = {"phi": "angle", "phi_ref": "setpoint.angle", "M": "torque", "gain": 3.0}


@pytest.fixture(scope="module")
def foreign_fmu(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return foreign(tmp_path_factory.mktemp("foreign"))


def a_loop(**changes: Any) -> Loop:
    loop = Loop(0.1, (TORQUE,), (ANGLE,), (ANGLE, VELOCITY), LIMITS, None, np.random.default_rng(0), 2)
    return replace(loop, **changes)


def a_sample(angle: float, setpoint: float = 0.0, k: int = 0, time: float = 0.0, horizon: int = 0) -> Sample:
    reference = np.zeros((horizon, 1))
    return Sample(k, time, np.array([angle]), np.array([angle, 0.0]), reference, np.array([setpoint]))


@dataclass(kw_only=True)
class Exported(Controller):
    """A controller that is exported when it is started, and stands aside for its FMU."""

    controller: Controller
    path: Path
    fmi_version: str
    fmu: FMUController | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.horizon = self.controller.horizon

    @property
    def uses_recording(self) -> bool:
        return self.controller.uses_recording

    @property
    def accepts_missing(self) -> bool:
        return self.controller.accepts_missing

    def start(self, loop: Loop) -> None:
        self.controller.start(loop)
        export_controller(self.controller, loop, self.path, self.fmi_version)
        self.fmu = FMUController(file=str(self.path))
        assert self.fmu.accepts_missing
        assert self.fmu.horizon == min(loop.preview, self.horizon)
        self.fmu.start(loop)

    def step(self, sample: Sample) -> Any:
        assert self.fmu is not None
        return self.fmu.step(sample._replace(reference=sample.reference[: self.fmu.horizon]))


@pytest.mark.parametrize(
    ("make", "fmi_version"), [(LQR, "2.0"), (DeePC, "3.0")], ids=["lqr, FMI 2.0", "deepc, FMI 3.0"]
)
def test_the_closed_loop_is_that_of_the_controller_in_python(
    make: Callable[[], Controller], fmi_version: str, pendulum_fmu: Path, tmp_path: Path
) -> None:
    """With noise, missing measurements, a limited preview, active bounds, and from the recording's end on."""

    def run(controller: Controller) -> Trace:
        with FMUPlant(pendulum_fmu, inputs=["torque"], outputs=["angle", "angular_velocity"]) as plant:
            return cosimulate(
                plant,
                controller,
                sampling_time=0.1,
                duration=8.0,
                reference=Steps(times=[0.0, 4.0], values=[70 * DEGREE, -40 * DEGREE]),
                excitation=UniformRandom(low=-3.5, high=3.5, samples=200, seed=3),
                bounds={"torque": (-3.5, 3.5)},
                outputs=["angle"],
                noise=GaussianNoise({"angle": 1e-3}),
                conditions=Conditions(loss={"angle": 0.1}),
                preview=3,
                seed=1,
                continue_recording=True,
            )

    python, fmu = (
        run(make()),
        run(Exported(controller=make(), path=tmp_path / "c.fmu", fmi_version=fmi_version)),
    )
    assert (python.outcome, fmu.outcome) == (Outcome.COMPLETED, Outcome.COMPLETED), fmu.reason
    assert np.abs(python.u).max() == pytest.approx(3.5)
    np.testing.assert_allclose(fmu.u, python.u, atol=3.5e-8)
    assert [status == "ok" for status in fmu.status] == [status == "ok" for status in python.status]
    assert any(status != "ok" for status in fmu.status)


def test_signals_are_mapped_by_name_and_units_converted(foreign_fmu: Path) -> None:
    controller = FMUController(file=str(foreign_fmu), signals=NAMES)
    assert controller.horizon == 0
    controller.start(a_loop())
    for k, (angle, setpoint) in enumerate([(0.2, 0.5), (-0.3, 0.0)]):
        action = controller.step(a_sample(angle, setpoint, k))
        expected = (setpoint / DEGREE - 0.5 * angle / DEGREE + 30.0 + 100.0 * (k + 1)) * 1000.0
        assert action.u == pytest.approx([expected], rel=1e-12)
        assert action.status == "ok"
        assert action.info == {"iterations": 7.0, "active_bounds": 0.0}
    controller.start(a_loop())  # forgets what it has counted
    assert controller.step(a_sample(0.0)).u == pytest.approx([130e3])


def test_what_an_fmu_says_of_its_state_is_a_status(foreign_fmu: Path) -> None:
    """One that is not exported from here does not say what it means, and may not mean that at all."""
    controller = FMUController(file=str(foreign_fmu), signals=NAMES)
    assert not controller.accepts_missing
    controller.start(a_loop())
    assert controller.step(a_sample(200 * DEGREE)).status == "status 5"
    other = FMUController(file=str(foreign_fmu), signals=NAMES, status="")
    other.start(a_loop())
    action = other.step(a_sample(200 * DEGREE))
    assert (action.status, action.info["status"]) == ("ok", 5.0)


def test_references_ahead_make_its_horizon(tmp_path: Path) -> None:
    idle = Idle()
    loop = a_loop(preview=3)
    idle.horizon = 3
    idle.start(loop)
    path = export_controller(idle, loop, tmp_path / "idle.fmu")
    controller = FMUController(file=str(path))
    assert controller.horizon == 3
    controller.start(loop)
    np.testing.assert_array_equal(controller.step(a_sample(0.1, horizon=3)).u, [0.0])
    facts = controller.knowledge(loop)
    assert facts["measures"] == "angle, angular_velocity"
    assert "ddpc-cosim" in facts["plant"]


@pytest.mark.parametrize(
    ("settings", "loop", "words"),
    [
        ({"signals": {}}, {}, ['input "phi": the loop has no signal "phi"', 'no output is called "torque"']),
        (
            {"signals": NAMES | {"phi": "angel"}},
            {},
            ['input "phi"', '"angel"', "it has: angle, angular_velocity"],
        ),
        ({"signals": NAMES | {"phi_ref": "setpoint.angular_velocity"}}, {}, ['input "phi_ref"']),
        ({}, {"sampling_time": 0.05}, ["step is fixed at 0.1 s", "sampling time is 0.05 s"]),
        ({"several_steps": True}, {"sampling_time": 0.25}, ["step is fixed at 0.1 s", "0.25 s"]),
        ({}, {"outputs": (replace(ANGLE, unit="kg"),)}, ["phi", 'no conversion from "deg" to "kg"']),
    ],
)
def test_what_does_not_fit_the_loop_is_refused(
    foreign_fmu: Path, settings: dict[str, Any], loop: dict[str, Any], words: list[str]
) -> None:
    controller = FMUController(file=str(foreign_fmu), **{"signals": NAMES, **settings})
    with pytest.raises(ConfigError) as error:
        controller.start(a_loop(**loop))
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"file": "nowhere.fmu"}, "nowhere.fmu: no such file"),
        ({"file": __file__}, "test_fmu.py"),
        (
            {"signals": {"psi": "angle", "M": 2.0}},
            'signals: the FMU has no "psi"; it has: phi, gain, phi_ref, M',
        ),
        ({"signals": {"M": 2.0}}, 'signals: "M" is an output, which is not a constant'),
        ({"several_steps": 2}, "several_steps"),
    ],
)
def test_impossible_settings_are_refused(foreign_fmu: Path, settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as error:
        FMUController(**{"file": str(foreign_fmu), **settings})
    assert words in str(error.value)


def test_a_shorter_step_can_be_done_several_times(foreign_fmu: Path) -> None:
    controller = FMUController(file=str(foreign_fmu), signals=NAMES, several_steps=True)
    controller.start(a_loop(sampling_time=0.3))
    assert controller.step(a_sample(0.0)).u == pytest.approx([330e3])


def test_what_is_beyond_the_loop_s_bounds_is_clipped_and_told(foreign_fmu: Path) -> None:
    controller = FMUController(file=str(foreign_fmu), signals=NAMES)
    narrow = replace(LIMITS, u_max=np.array([3.5]))
    controller.start(a_loop(bounds=narrow))
    action = controller.step(a_sample(0.0))
    assert action.u == pytest.approx([3.5])
    assert action.status == "an input beyond the bounds of this loop, clipped"


def test_time_starts_with_the_loop(foreign_fmu: Path) -> None:
    controller = FMUController(file=str(foreign_fmu), signals=NAMES)
    controller.start(a_loop())
    for k in range(3):
        assert controller.step(a_sample(0.0, k=k, time=50.0 + 0.1 * k)).u == pytest.approx([130e3 + 1e5 * k])


def test_a_fault_of_the_fmu_is_an_error_of_the_controller(foreign_fmu: Path) -> None:
    controller = FMUController(file=str(foreign_fmu), signals=NAMES)
    controller.start(a_loop())
    controller.step(a_sample(0.0))
    with pytest.raises(ControllerError, match=r"foreign\.fmu: .* M is not finite at time 0\.1"):
        controller.step(a_sample(2000 * DEGREE, k=1))


@pytest.mark.parametrize("isolated", [False, True])
def test_it_is_a_controller_of_study_files(foreign_fmu: Path, tmp_path: Path, isolated: bool) -> None:
    """Its file lies beside the study, and its content is part of what decides a result."""
    signals = {"phi": "angle", "phi_ref": "reference.angle[2]", "M": "torque", "gain": 0}
    settings = {"file": "mine.fmu", "isolated": isolated, "signals": signals}
    study = write(tmp_path, study_text(controllers={"other": {"type": "fmu", "settings": settings}}))
    mine = tmp_path / "mine.fmu"

    def case_id() -> str:
        return cases_in(study)[0].id

    mine.write_bytes(foreign_fmu.read_bytes())
    first = case_id()
    assert case_id() == first
    mine.write_bytes(foreign(tmp_path, 0.05).read_bytes())
    assert case_id() != first
