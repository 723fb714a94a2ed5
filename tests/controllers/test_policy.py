"""Policies in ONNX files: a linear law's inputs in a run, and files that cannot be one."""

import pickle
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto, helper
from onnx_files import write_linear_law, write_onnx
from studies import cases_in, run_file, study_text, write

from ddpc_controllers import Policy, Training
from ddpc_cosim import (
    Conditions,
    ConfigError,
    Controller,
    FloatArray,
    FMUPlant,
    Loop,
    Outcome,
    Sample,
    Steps,
    Trace,
    cosimulate,
)
from ddpc_cosim.gymnasium import make
from ddpc_cosim.study.case_runs import run_case

HORIZON = 2
GAIN = np.array([[-4.0, -0.5, 1.0, 2.0, 1.5]])
"""Of angle, angular velocity, and the references now, at the next sample and that after it."""


@dataclass(kw_only=True)
class Law(Controller):
    """The same law in NumPy, of what stands in the sample."""

    horizon: int = HORIZON

    def start(self, loop: Loop) -> None:
        self.bounds = loop.bounds

    def step(self, sample: Sample) -> FloatArray:
        x = np.array([*sample.measured, *sample.setpoint, *sample.reference.ravel()])
        return np.clip(GAIN @ x, self.bounds.u_min, self.bounds.u_max)


@pytest.fixture
def run(pendulum_fmu: Path) -> Callable[..., Trace]:
    def run(controller: Controller, **how: Any) -> Trace:
        given: dict[str, Any] = {
            "sampling_time": 0.1,
            "duration": 3.0,
            "reference": Steps([0, 1], [0.2, -0.3]),
            "bounds": {"torque": (-1.0, 1.0)},
        }
        signals = {"inputs": ["torque"], "outputs": ["angle", "angular_velocity"]}
        with FMUPlant(pendulum_fmu, **signals) as plant:
            return cosimulate(plant, controller, outputs=["angle"], **given | how)

    return run


@pytest.mark.parametrize(("batch", "bits", "error"), [(False, 64, 0.0), (True, 64, 0.0), (True, 32, 1e-6)])
def test_a_linear_law_is_what_it_is_in_numpy(
    run: Callable[..., Trace], tmp_path: Path, batch: bool, bits: int, error: float
) -> None:
    file = write_linear_law(tmp_path / "law.onnx", GAIN, batch=batch, bits=bits)
    policy, law = run(Policy(file=str(file), horizon=HORIZON)), run(Law())
    assert policy.outcome is Outcome.COMPLETED
    assert np.abs(law.u).max() == 1.0  # a limit is met
    np.testing.assert_allclose(policy.u, law.u, rtol=0, atol=max(error, 1e-12))
    assert set(policy.status) == {"ok"}


def test_it_sees_what_the_environment_shows(tmp_path: Path) -> None:
    """Of a study with a band, moving limits and little preview: one layout, and the same inputs."""
    band: dict[str, Any] = {"lower": {"kind": "steps", "times": [0.0, 0.5], "values": [-0.1, 0.2]}}
    band["upper"] = {"kind": "constant", "value": 0.4}
    ramp = {"kind": "ramp", "from_value": 1.0, "to_value": 2.0, "from_time": 0.0, "to_time": 1.0}
    tables: dict[str, Any] = {
        "reference": {"angle": {"band": band}},
        "bounds": {"torque": {"min": -1.0, "max": ramp}},
        "loop": {"preview": 3},
    }
    env = make(write(tmp_path, study_text(controllers={"nothing": "idle"}, **tables)), horizon=5)
    n = len(env.observation_names)
    gain = np.random.default_rng(0).normal(size=(1, n))
    write_linear_law(tmp_path / "law.onnx", gain)
    learned = {"type": "policy", "settings": {"file": "law.onnx", "horizon": 5}}
    (case,) = cases_in(write(tmp_path, study_text(controllers={"learned": learned}, **tables)))
    trace = run_case(case)
    assert trace.outcome is Outcome.COMPLETED, trace.reason
    observation, _ = env.reset(seed=case.seed)
    for k in range(10):
        applied = np.clip(gain @ observation, trace.input_limits[k, :, 0], trace.input_limits[k, :, 1])
        np.testing.assert_allclose(applied, trace.u[k], rtol=1e-12)
        observation, *_ = env.step(applied)
    assert {f"lower.angle[{k}]" for k in (1, 2, 3)} <= {*env.observation_names}
    assert "max.torque[3]" in env.observation_names
    # The lower limit does not move, but stands beside one that does; the angle has none.
    limits = [f"{side}.torque" + (f"[{k}]" if k else "") for k in range(4) for side in ("min", "max")]
    assert [name for name in env.observation_names if name[:4] in ("min.", "max.")] == limits
    env.close()


def test_what_is_missing_is_as_it_was(run: Callable[..., Trace], tmp_path: Path) -> None:
    file = write_linear_law(tmp_path / "law.onnx", GAIN)
    trace = run(Policy(file=str(file), horizon=HORIZON), conditions=Conditions(loss={"angle": 0.4}))
    lost = np.isnan(trace.measured[:, 0])
    assert lost.any()
    assert [status != "ok" for status in trace.status] == lost.tolist()
    last = np.where(lost, 0, np.arange(len(trace)))
    angle = trace.measured[np.maximum.accumulate(last), 0]
    ahead = np.minimum(np.arange(len(trace))[:, np.newaxis] + np.arange(HORIZON + 1), len(trace) - 1)
    x = np.column_stack([angle, trace.measured[:, 1], trace.reference[:, 0][ahead]])
    np.testing.assert_allclose(trace.u[:-2, 0], np.clip(x @ GAIN[0], -1, 1)[:-2], rtol=1e-9)


def test_another_number_of_signals_is_said_by_name(run: Callable[..., Trace], tmp_path: Path) -> None:
    file = str(write_linear_law(tmp_path / "law.onnx", np.ones((2, 4))))
    with pytest.raises(ConfigError) as error:
        run(Policy(file=file, horizon=0))
    takes, returns = error.value.faults
    assert takes.startswith(
        "law.onnx: it takes 4 numbers; the loop has 3: angle [rad], angular_velocity [rad/s], setpoint.angle"
    )
    assert "it returns 2 numbers; the loop has 1: torque [N.m]" in returns


def value(name: str, kind: int, shape: list[Any]) -> Any:
    return helper.make_tensor_value_info(name, kind, shape)


def test_files_that_are_no_policy(tmp_path: Path) -> None:
    def said(file: Path) -> str:
        with pytest.raises(ConfigError) as error:
            Policy(file=str(file))
        return str(error.value)

    assert "no.onnx: cannot be read: No such file" in said(tmp_path / "no.onnx")
    (tmp_path / "text.onnx").write_text("this is not a graph\x1b[31m", encoding="utf-8")
    reason = said(tmp_path / "text.onnx")
    assert reason.startswith("text.onnx: ONNX Runtime cannot load it: ")
    assert "\x1b" not in reason
    add = [helper.make_node("Add", ["x", "z"], ["u"])]
    kinds = [value("x", TensorProto.INT64, [1, 2, 3]), value("z", TensorProto.INT64, [1, 2, 3])]
    odd = write_onnx(tmp_path / "odd.onnx", add, kinds, [value("u", TensorProto.INT64, [1, 2, 3])], {})
    faults = said(odd).splitlines()
    assert faults[0] == "odd.onnx: it has 2 inputs; needed: one, the observation"
    assert "odd.onnx: input x is a tensor(int64); needed: float or double" in faults
    assert "odd.onnx: output u: shape (1, 2, 3); needed: (n,) or (1, n)" in faults
    assert len(faults) == 7


def test_a_file_leads_to_no_other_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights beside it would be part of no case's id."""
    import onnx

    file = write_linear_law(tmp_path / "law.onnx", np.ones((1, 400)))
    onnx.save_model(
        onnx.load(file), file, save_as_external_data=True, location="weights.bin", size_threshold=0
    )
    assert (tmp_path / "weights.bin").stat().st_size == 3200
    for folder in (Path(__file__).parent, tmp_path):  # in the files' own folder, too
        monkeypatch.chdir(folder)
        with pytest.raises(ConfigError, match=r"law\.onnx: .* in another file; needed: one file"):
            Policy(file=str(file))


def test_how_it_was_trained_is_said_in_full(tmp_path: Path) -> None:
    file = str(write_linear_law(tmp_path / "law.onnx", GAIN))
    with pytest.raises(ConfigError, match="training = 3 is not possible; needed: a Training"):
        Policy(file=file, training=3)  # type: ignore[arg-type]
    settings = f"settings.file = {file!r}\nsettings.training = {{ steps = 3 }}"
    path = write(
        tmp_path, f"{study_text(controllers=[])}\n[controllers.learned]\ntype = 'policy'\n{settings}"
    )
    with pytest.raises(ConfigError, match=r"training: a Training needs seeds, by too"):
        cases_in(path)


def test_a_file_of_any_size_says_what_it_was_given(run: Callable[..., Trace], tmp_path: Path) -> None:
    nodes = [helper.make_node("MatMul", ["x", "gain"], ["u"])]
    inputs, outputs = [value("x", TensorProto.DOUBLE, ["n"])], [value("u", TensorProto.DOUBLE, ["m"])]
    file = write_onnx(tmp_path / "any.onnx", nodes, inputs, outputs, {"gain": np.ones((7, 1))})
    trace = run(Policy(file=str(file), horizon=0))
    assert trace.outcome is Outcome.CONTROLLER_ERROR
    names = "angle [rad], angular_velocity [rad/s], setpoint.angle [rad]"
    assert f"it was given 3 numbers: {names}" in trace.reason


def test_what_is_no_number_ends_the_run(run: Callable[..., Trace], tmp_path: Path) -> None:
    nodes = [helper.make_node("Sqrt", ["x"], ["y"]), helper.make_node("MatMul", ["y", "gain"], ["u"])]
    inputs, outputs = [value("x", TensorProto.DOUBLE, [3])], [value("u", TensorProto.DOUBLE, [1])]
    file = write_onnx(tmp_path / "root.onnx", nodes, inputs, outputs, {"gain": np.ones((3, 1))})
    trace = run(Policy(file=str(file), horizon=0), reference=Steps([0, 1], [0.2, -1.0]))
    assert trace.outcome is Outcome.CONTROLLER_ERROR
    assert "root.onnx: the policy returned [nan]; needed: 1 finite numbers" in trace.reason


def test_its_content_is_part_of_the_id_and_its_training_of_the_report(tmp_path: Path) -> None:
    training = {"steps": 200_000, "seeds": "100:132", "by": "PPO"}
    learned = {"type": "policy", "settings": {"file": "law.onnx", "horizon": 0, "training": training}}
    text = study_text(controllers={"learned": learned, "nothing": "idle"})
    write_linear_law(tmp_path / "law.onnx", np.array([[-1.0, 1.0]]))
    study = write(tmp_path, text)
    results = run_file(study)
    before = next(case.id for case in cases_in(study) if case.controller == "learned")
    page = results.report().read_text(encoding="utf-8")
    assert "what its file was trained with: 200 000 steps on seeds 100:132, by PPO" in page
    write_linear_law(tmp_path / "law.onnx", np.array([[-2.0, 1.0]]))
    assert next(case.id for case in cases_in(study) if case.controller == "learned") != before
    training["steps"] = 0
    with pytest.raises(ConfigError, match=r"training\.steps.*: 0 is not possible; allowed: an integer, >= 1"):
        run_file(write(tmp_path, study_text(controllers={"learned": learned})))


def test_it_can_be_sent_to_another_process(tmp_path: Path) -> None:
    policy = Policy(file=str(write_linear_law(tmp_path / "law.onnx", GAIN)), horizon=HORIZON)
    assert pickle.loads(pickle.dumps(policy)) == policy
    assert policy.settings() == {"file": policy.file, "horizon": HORIZON, "training": None}
    trained = replace(policy, training=Training(steps=10, seeds="1", by="hand"))
    assert trained.settings()["training"].items() >= {"steps": 10, "seeds": "1", "by": "hand"}.items()


def test_without_onnx_runtime_it_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match=r"Policy needs ONNX Runtime: .*gym"):
        Policy(file=str(tmp_path / "law.onnx"))
