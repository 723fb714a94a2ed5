"""The JSON Schema of study files: what studies say is in it, and it refuses what is not possible there."""

import copy
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

import ddpc_cosim.studies
from ddpc_cosim.cli.main import main
from ddpc_cosim.conditions import all_conditions
from ddpc_cosim.study.file_format.schema import study_schema

SCHEMA = study_schema()
VALIDATOR = Draft202012Validator(SCHEMA)
ROOT = Path(__file__).parents[4]
BUILT_IN = sorted(Path(ddpc_cosim.studies.__file__).parent.glob("*.toml"))


def documented() -> list[Any]:
    """Return the whole studies that the docs show."""
    examples = []
    for page in sorted((ROOT / "docs").rglob("*.md")):
        for number, text in enumerate(re.findall(r"```toml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)):
            if all(re.search(header, text, re.M) for header in (r"^\[(plant|problems\.)", r"^\[controllers")):
                examples.append(pytest.param(text, id=f"{page.stem}-{number}"))
    return examples


def faults_of(content: dict[str, Any]) -> dict[str, str]:
    """Return what the schema says of a study, by path."""
    return {
        ".".join(map(str, error.absolute_path)): error.message for error in VALIDATOR.iter_errors(content)
    }


def test_it_is_a_schema() -> None:
    Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("path", BUILT_IN, ids=lambda path: path.stem)
def test_built_in_studies_are_in_it(path: Path) -> None:
    assert faults_of(tomllib.loads(path.read_text("utf-8"))) == {}


@pytest.mark.parametrize("text", documented())
def test_documented_studies_are_in_it(text: str) -> None:
    assert faults_of(tomllib.loads(text)) == {}


STUDY = tomllib.loads("""
seeds = ["0:3", 7]
[plant]
name = "pendulum"
inputs = ["torque"]
parameters = { mass = 1.0 }
[loop]
sampling_time = 0.1
duration = 10.0
preview = 3
[reference]
angle = { kind = "steps", times = [0.0, 5.0], values = [20.0, -10.0], unit = "deg" }
[bounds]
torque = { min = -3.5, max = 3.5 }
[recording]
samples = 200
excitation.torque = { kind = "prbs", low = -3.5, high = 3.5, clock_period = 2 }
[controllers.deepc]
type = "deepc"
settings = { horizon = 10, lambda_g = 1.0 }
sweep = { horizon = [5, 6] }
[controllers.other]
type = "own:Class"
settings = { whatever = [1, 2] }
[scenarios.windy]
noise = { angle = 0.1 }
rate_limit = { torque = 1.0 }
loss = { angle = 0.1 }
events = [{ time = 1.0, parameters = { mass = 2.0 } }]
drifts = [{ parameter = "mass", from_value = 1.0, to_value = 2.0, from_time = 0.0, to_time = 5.0 }]
disturbances.torque = { kind = "noise", standard_deviation = 0.1 }
disturbances.angle = [{ kind = "sine", amplitude = 0.1, frequency = 1.0 }]
[metrics.cost]
outputs = { angle = 1.0 }
[[report.panels]]
title = "All"
controllers = ["deepc"]
""")

# Where, what takes its place (None: it is left out), and the path that the schema tells.
MUTATIONS: list[tuple[str, Any, str]] = [
    ("seeds", "all", "seeds"),
    ("seeds", -1, "seeds"),
    ("seeds.0", "3:x", "seeds.0"),
    ("seeds.1", 1.5, "seeds.1"),
    ("seeds", [], "seeds"),
    ("title", 3, "title"),
    ("name", "../up", "name"),
    ("name", "x" * 99, "name"),
    ("plant", None, ""),
    ("plant", 3, "plant"),
    ("plant.nam", "pendulum", "plant"),
    ("plant.inputs", "torque", "plant.inputs"),
    ("plant.inputs.0", 3, "plant.inputs.0"),
    ("plant.isolated", "no", "plant.isolated"),
    ("plant.fmi_type", "cs", "plant.fmi_type"),
    ("plant.parameters.mass", [1.0], "plant.parameters.mass"),
    ("plant.nominal", {"angle": 0.0}, "plant.nominal.angle"),
    ("loop", None, ""),
    ("loop.sampling_time", None, "loop"),
    ("loop.sampling_time", 0.0, "loop.sampling_time"),
    ("loop.duration", "long", "loop.duration"),
    ("loop.start", "recording", "loop.start"),
    ("loop.preview", -1, "loop.preview"),
    ("loop.preview", "all", "loop.preview"),
    ("loop.memory_limit", 0, "loop.memory_limit"),
    ("reference", {}, "reference"),
    ("reference.angle", 3.0, "reference.angle"),
    ("reference.angle.kind", None, "reference.angle"),
    ("reference.angle.kind", "stairs", "reference.angle.kind"),
    ("reference.angle.times", None, "reference.angle"),
    ("reference.angle.values", [], "reference.angle.values"),
    ("reference.angle.values.0", "x", "reference.angle.values.0"),
    ("reference.angle.value", 3.0, "reference.angle"),
    ("bounds.torque.min", "low", "bounds.torque.min"),
    ("bounds.torque.low", 1.0, "bounds.torque"),
    ("recording.samples", 0, "recording.samples"),
    ("recording.samples", 1.5, "recording.samples"),
    ("recording.excitation.torque.low", None, "recording.excitation.torque"),
    ("recording.excitation.torque.clock_period", 0, "recording.excitation.torque.clock_period"),
    ("recording.excitation.torque.kind", "sweep", "recording.excitation.torque.kind"),
    ("recording.time_tolerance", 0.5, "recording.time_tolerance"),
    ("controllers.deepc.settings.horizon", 0, "controllers.deepc.settings.horizon"),
    ("controllers.deepc.settings.horizon", 2.5, "controllers.deepc.settings.horizon"),
    ("controllers.deepc.settings.lamda_g", 1.0, "controllers.deepc.settings"),
    ("controllers.deepc.label", 3, "controllers.deepc.label"),
    ("controllers.deepc.horizon", 3, "controllers.deepc"),
    ("controllers.deepc.sweep", 3, "controllers.deepc.sweep"),
    ("scenarios.windy.noise.angle", -1.0, "scenarios.windy.noise.angle"),
    ("scenarios.windy.rate_limit.torque", 0.0, "scenarios.windy.rate_limit.torque"),
    ("scenarios.windy.loss.angle", 1.01, "scenarios.windy.loss.angle"),
    ("scenarios.windy.quantun", {}, "scenarios.windy"),
    ("scenarios.windy.events.0.time", "x", "scenarios.windy.events.0.time"),
    ("scenarios.windy.events.0.parameters", None, "scenarios.windy.events.0"),
    ("scenarios.windy.drifts.0.parameter", None, "scenarios.windy.drifts.0"),
    (
        "scenarios.windy.disturbances.torque.standard_deviation",
        -1,
        "scenarios.windy.disturbances.torque.standard_deviation",
    ),
    ("scenarios.windy.disturbances.angle.0.frequency", 0, "scenarios.windy.disturbances.angle.0.frequency"),
    ("metrics.cost.outputs.angle", -1.0, "metrics.cost.outputs.angle"),
    ("report.panels.0.titel", "x", "report.panels.0"),
]  # fmt: skip


def mutated(path: str, value: Any) -> dict[str, Any]:
    study = copy.deepcopy(STUDY)
    *above, last = [int(key) if key.isdecimal() else key for key in path.split(".")]
    table: Any = study
    for key in above:
        table = table.setdefault(key, {}) if isinstance(table, dict) else table[key]
    if value is None:
        del table[last]
    else:
        table[last] = value
    return study


def test_the_study_of_these_tests_is_in_it() -> None:
    assert faults_of(STUDY) == {}


@pytest.mark.parametrize(
    ("path", "value", "fault"), MUTATIONS, ids=[f"{p}={v}"[:60] for p, v, _ in MUTATIONS]
)
def test_what_is_not_possible_is_refused_where_it_stands(path: str, value: Any, fault: str) -> None:
    assert list(faults_of(mutated(path, value))) == [fault]


def test_a_study_that_extends_another_may_say_a_part_and_leave_out_another() -> None:
    changes = {"extends": "paper", "loop": {"duration": 3.0}, "controllers": {"deepc": False}}
    assert faults_of(changes) == {}
    assert list(faults_of(changes | {"loop": {"duration": "x"}})) == ["loop.duration"]


def test_every_installed_condition_is_in_it() -> None:
    properties = SCHEMA["$defs"]["ScenarioSection"]["properties"]
    assert properties.keys() >= all_conditions().keys()


def test_the_command_prints_it() -> None:
    result = CliRunner().invoke(main, ["schema"])
    assert result.exit_code == 0
    assert json.loads(result.stdout) == SCHEMA
