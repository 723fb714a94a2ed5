"""``ddpc-cosim export-controller`` and ``export_controller``: what they write, and what they refuse."""

import json
import tomllib
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner, Result
from fmpy.validation import validate_fmu
from fmus.blocks import block_files
from studies import PENDULUM, study_text, write

from ddpc_cosim import (
    ConfigError,
    Controller,
    ControllerCode,
    ControllerError,
    FloatArray,
    Loop,
    Sample,
    export_controller,
    setting,
)
from ddpc_cosim.cli.main import main
from ddpc_cosim.study import cases
from ddpc_cosim.study.case_runs import started
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.reading import read_study

_STEP = """
const double wanted = {gain!r} * (r[0] - y[0]) - y[1] + 0.5 * (r[2] - r[1]) + {bias!r};
state->memory[0] += 1.0;
state->status = wanted > 3.5 || wanted < -3.5 ? 2u : 0u;
u[0] = wanted > 3.5 ? 3.5 : wanted < -3.5 ? -3.5 : wanted;
"""


@dataclass(kw_only=True)
class Proportional(Controller):
    """A controller that has learned one number."""

    gain: float = setting(4.0, low=0.0, doc="gain")
    fails: bool = setting(False, doc="its code cannot be had")
    horizon = 2
    uses_recording = True

    def start(self, loop: Loop) -> None:
        assert loop.recording is not None
        self._bias = float(np.mean(loop.recording.u))

    def step(self, sample: Sample) -> FloatArray:
        ahead = sample.reference[:, 0]
        error = sample.setpoint[0] - sample.y[0]
        return np.array([self.gain * error - sample.measured[1] + 0.5 * (ahead[1] - ahead[0]) + self._bias])

    def c_code(self, loop: Loop) -> ControllerCode:
        if self.fails:
            raise ZeroDivisionError("of anyone's")
        step = _STEP.format(gain=self.gain, bias=self._bias)
        return ControllerCode(block_files(step), {2: "clipped"})


@dataclass(kw_only=True)
class Mine(Controller):
    """A controller without C code."""

    def start(self, loop: Loop) -> None: ...

    def step(self, sample: Sample) -> FloatArray:
        return np.zeros(1)


STUDY = study_text(
    name="small",
    seeds=[3, 4],
    plant=PENDULUM | {"measurements": ["angle", "angular_velocity"]},
    reference={"angle": {"kind": "steps", "times": [0.0, 1.0], "values": [10.0, -20.0], "unit": "deg"}},
    loop={"duration": 3.0},
    bounds={"torque": {"min": -3.5, "max": 3.5}},
    recording={"samples": 30, "excitation": {"torque": {"kind": "uniform", "low": -1.0, "high": 3.0}}},
    scenarios={"noisy": {"noise": {"angle": 0.01}}},
    controllers={
        "p": {
            "type": "tests.ddpc_cosim.exporting.test_export_controller:Proportional",
            "settings": {"gain": 6.0},
        },
        "idle": "idle",
        "mine": "tests.ddpc_cosim.exporting.test_export_controller:Mine",
        "broken": {
            "type": "tests.ddpc_cosim.exporting.test_export_controller:Proportional",
            "settings": {"fails": True},
        },
    },
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to be in, with a study."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path, STUDY, "small.toml")
    return tmp_path


def export(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["export-controller", "small.toml", "--controller", *arguments])


def facts_of(fmu: Path) -> dict[str, Any]:
    with zipfile.ZipFile(fmu) as archive:
        content: dict[str, Any] = json.loads(archive.read("resources/controller.json"))
    return content


def test_the_fmu_has_the_signals_of_the_loop_and_what_it_was_made_from(folder: Path) -> None:
    result = export("p", "--fmi", "3.0", "--out", "winner.fmu")
    assert (result.exit_code, result.stdout) == (0, "winner.fmu\n"), result.stderr
    assert validate_fmu("winner.fmu") == []
    description = fmpy.read_model_description("winner.fmu")
    assert (description.fmiVersion, description.modelName) == ("3.0", "winner")
    inputs = [v for v in description.modelVariables if v.causality == "input"]
    assert [v.name for v in inputs] == [
        "angle",
        "angular_velocity",
        "setpoint.angle",
        "reference.angle[1]",
        "reference.angle[2]",
    ]
    assert [v.unit for v in inputs] == ["rad", "rad/s", "rad", "rad", "rad"]
    assert {inputs[0].displayUnit, inputs[4].displayUnit} == {"deg"}
    torque = next(v for v in description.modelVariables if v.name == "torque")
    assert (torque.unit, float(torque.min), float(torque.max)) == ("N.m", -3.5, 3.5)
    facts = facts_of(Path("winner.fmu"))
    assert facts["settings"] == {"gain": 6.0, "fails": False}
    assert facts["status"] == {"2": "clipped"}
    assert facts["bytes"] is None  # a class of somebody else, whose code does not say
    assert (facts["controller"], facts["study"], facts["seed"]) == ("p", "small", 3)
    assert facts["sampling_time"] == 0.1
    assert "ddpc-cosim version" in facts["versions"]
    with zipfile.ZipFile("winner.fmu") as archive:
        study = tomllib.loads(archive.read("resources/study.toml").decode())
        sources = {name for name in archive.namelist() if name.startswith("sources/")}
    assert study["controllers"]["p"]["settings"]["gain"] == 6.0
    assert {"sources/controller.h", "sources/controller.c", "sources/sampled_block.c"} <= sources
    assert "study small" in description.description
    assert facts["recording"]["sha256"][:16] in description.description
    first = Path("winner.fmu").read_bytes()
    assert export("p", "--fmi", "3.0", "--out", "winner.fmu").exit_code == 0
    assert Path("winner.fmu").read_bytes() == first


def test_one_case_is_made_which_is_that_of_a_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def hashed(case: Case, content: Mapping[str, Any]) -> Any:
        made.append((case.controller, case.scenario))
        return hash_of(case, content)

    hash_of = cases._hash_of
    monkeypatch.setattr(cases, "_hash_of", hashed)
    result = export("idle", "--scenario", "noisy", "--seed", "4")
    assert result.exit_code == 0, result.output
    assert made == [("idle", "noisy")]
    resolved = read_study("small.toml").problem
    (case,) = cases_of(resolved, resolved.plant.built(), [4], "idle_noisy_seed4")
    facts = facts_of(Path("idle.fmu"))
    assert facts["case"] == case.id
    with zipfile.ZipFile("idle.fmu") as archive:
        header = archive.read("sources/controller.h").decode()
    assert (
        "constants take {constants} bytes, each ControllerState {state},".format(**facts["bytes"]) in header
    )


def test_it_computes_what_the_controller_of_the_case_computes(folder: Path) -> None:
    """FMPy's simulation holds what it was told at each instant, for one of each case's seeds."""
    names = ("angle", "angular_velocity", "setpoint.angle", "reference.angle[1]", "reference.angle[2]")
    rows = [(0.1, -0.2, 0.3, 0.4, 0.6), (0.2, 0.1, 0.3, 0.3, 0.1), (9.0, 0.0, 0.0, 0.0, 0.0)]
    samples = [Sample(0, 0.0, row[:1], row[:2], row[3:, None], row[2:3]) for row in np.array(rows)]
    signals = np.array(
        [(0.1 * k, *row) for k, row in enumerate(rows)], dtype=[(name, float) for name in ("time", *names)]
    )
    resolved = read_study("small.toml").problem
    biases = set()
    for seed in (3, 4):
        assert export("p", "--seed", str(seed), "--scenario", "noisy").exit_code == 0
        cases = cases_of(resolved, resolved.plant.built(), [seed], "p")
        case = next(case for case in cases if case.scenario == "noisy")
        controller, loop = started(case)
        result = fmpy.simulate_fmu(
            "p.fmu", input=signals, stop_time=0.3, output=["torque", "status"], step_size=0.1
        )
        expected = [np.clip(controller.step(sample), -3.5, 3.5) for sample in samples]
        np.testing.assert_allclose(result["torque"][1:, None], expected, atol=1e-12)
        assert result["status"][-1] == 2
        facts = facts_of(Path("p.fmu"))
        assert loop.recording is not None
        assert facts["recording"] == {"sha256": loop.recording.digest, "samples": 30}
        assert (facts["seed"], facts["scenario"], facts["case"]) == (seed, "noisy", case.id)
        biases.add(facts["recording"]["sha256"])
    assert len(biases) == 2


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["q"], 2, 'no controller "q"; there are: broken, idle, mine, p'),
        (["idel"], 2, 'did you mean "idle"?'),
        (["mine"], 2, "Mine cannot be exported: its class has no c_code()"),
        (["broken"], 1, "Proportional.c_code raised ZeroDivisionError: of anyone's"),
        (["p", "--scenario", "nosy"], 2, 'no scenario "nosy"; did you mean "noisy"?'),
        (["p", "--problem", "other"], 2, 'no problem "other"; there are: small'),
        (["p", "--platforms", "amiga"], 2, 'no platform "amiga"'),
        (
            ["p", "--out", "nowhere/p.fmu"],
            2,
            "cannot be written to nowhere/p.fmu: there is no folder nowhere",
        ),
        (["p", "--seed", "-1"], 2, "--seed"),
    ],
)
def test_what_is_refused(folder: Path, arguments: list[str], code: int, words: str) -> None:
    result = export(*arguments)
    assert result.exit_code == code, result.output
    assert words in result.stderr
    assert list(Path().glob("*.fmu")) == []


def test_of_several_problems_one_is_chosen(folder: Path) -> None:
    several = """name = "several"
[problems.one]
study = "small.toml"
[problems.other]
study = "small.toml"
loop.sampling_time = 0.05
[controllers.idle]
type = "idle"
"""
    Path("several.toml").write_text(several, encoding="utf-8")
    command = ["export-controller", "several.toml", "--controller", "idle"]
    refused = CliRunner().invoke(main, command)
    assert refused.exit_code == 2
    assert "several problems: choose one by problem, --problem of a command: one, other" in refused.stderr
    result = CliRunner().invoke(main, [*command, "--problem", "other"])
    assert result.exit_code == 0, result.output
    assert facts_of(Path("idle.fmu"))["problem"] == "other"
    assert float(fmpy.read_model_description("idle.fmu").defaultExperiment.stepSize) == 0.05


def test_a_controller_that_a_script_has_started(folder: Path) -> None:
    resolved = read_study("small.toml").problem
    controller, loop = started(cases_of(resolved, resolved.plant.built(), [3], "p")[0])
    path = export_controller(controller, loop, folder / "own.fmu", facts={"note": "of a script"})
    assert validate_fmu(str(path)) == []
    assert facts_of(path)["note"] == "of a script"
    shown = CliRunner().invoke(main, ["inspect", str(path)]).output.splitlines()
    assert shown[-1].startswith('a controller in a study: type = "fmu", settings.file = ')
    with pytest.raises(ConfigError, match=r"cannot be exported; available: 2\.0, 3\.0"):
        export_controller(controller, loop, folder / "own.fmu", "1.0")
    broken, loop = started(cases_of(resolved, resolved.plant.built(), [3], "broken")[0])
    with pytest.raises(ControllerError, match="of anyone's"):
        export_controller(broken, loop, folder / "own.fmu")
