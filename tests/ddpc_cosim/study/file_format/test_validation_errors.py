"""Errors of study files: all of them at once, each with line, key and what to do, and none that follows."""

import copy
import math
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from click.testing import CliRunner
from hypothesis import HealthCheck, example, given, settings, strategies as st

from ddpc_cosim import ConfigError
from ddpc_cosim.cli.main import main
from ddpc_cosim.files.durations import EXPECTED
from ddpc_cosim.studies import paper
from ddpc_cosim.study.file_format.study_files import key_lines
from ddpc_cosim.study.reading import read_study

PAPER: dict[str, Any] = tomllib.loads(paper.read_text(encoding="utf-8"))


def errors_of(content: dict[str, Any] | str, folder: Path) -> list[str]:
    """Return the errors of a study, without the file name and line that each of them must begin with."""
    path = folder / "study.toml"
    path.write_text(content if isinstance(content, str) else tomli_w.dumps(content), encoding="utf-8")
    faults: tuple[str, ...] = ()
    try:
        read_study(str(path))
    except ConfigError as error:
        faults = error.faults
    matches = [re.fullmatch(r"study\.toml(?::(\d+))?: (.*)", error, re.DOTALL) for error in faults]
    lines = [int(match[1] or 0) for match in matches if match]
    assert len(lines) == len(faults)
    assert lines == sorted(lines)
    return [match[2] for match in matches if match]


def changed(**changes: Any) -> dict[str, Any]:
    """Return the paper's study with changes: ``plant__name="x"`` is ``plant.name = "x"``; None deletes."""
    study = copy.deepcopy(PAPER)
    for key, value in changes.items():
        *sections, last = key.split("__")
        table = study
        for section in sections:
            table = table[section]
        if value is None:
            del table[last]
        else:
            table[last] = value
    return study


FULL_OF_FAULTS = """
summry = "x"
seeds = ["5:2", 3, -1]
[plant]
name = "pendulum"
inputs = ["torqe"]
outputs = ["angle"]
parameters = { mass = -1.0, colour = 2.0 }
[loop]
sampling_time = -0.1
duration = "long"
start = "recording"
[reference.angle]
kind = "steps"
times = [0.0, 0.0]
values = [1.0, 2.0, 3.0]
unit = "grad"
[bounds]
torque = { min = 3.0, max = 1.0 }
angle = { min = 0.0, max = 1.0, unit = "m" }
[recording]
samples = 5
excitation.torque = { kind = "uniform", low = 1.0, high = -1.0 }
[controllers.a]
type = "deep"
[controllers.b]
type = "deepc"
settings = { horizon = 0, output_weight = -1.0, lamda_g = 3.0 }
[controllers.c]
type = "wkpc"
label = 3
settings = { dictionary = { cout = 3 } }
bounds.angel = { min = 0.0 }
[controllers."d d"]
type = "mfapc"
[controllers.e]
type = "deepc"
[scenarios.s]
noise = { angle = -1.0, speed = 1.0 }
events = [{ time = "x", parameters = { mass = 2.0 } }, { time = 1.0, parameters = { gravity = 3.0 } }]
[report]
scenario = "t"
[[report.panels]]
titel = "x"
controllers = ["z", "b"]
"""

FAULTS = """
summry: unknown key; did you mean "summary"?
seeds: '5:2', -1 are not seeds; allowed: integers from 0 to 4294967295, or ranges as first:last
loop.sampling_time: must be greater than 0, got -0.1
loop.duration: must be a number of seconds, or a duration such as "15 min"
loop.start: must be one of 'rest' or 'recording-end', got 'recording'
reference.angle: steps: times (2) and values (3) must have the same length
reference.angle: steps: times must increase
reference.angle.unit: unit "grad" does not fit angle; allowed: rad, deg
bounds.torque: min (3) must be below max (1)
bounds.angle.unit: unit "m" does not fit angle; allowed: rad, deg
recording.excitation.torque: uniform excitation: low (1.0) must be below high (-1.0)
recording.samples: 5 is too short for e, which needs
plant.inputs: no input "torqe"; did you mean "torque"?
plant.parameters.mass: -1 is outside [0.001, inf]
plant.parameters: no parameter "colour"; there are: damping, gravity, mass, radius, torque_gain
controllers.a.type: no controller "deep"; did you mean "deepc"?
controllers.b.settings.lamda_g: unknown setting of deepc; did you mean "lambda_g"?
controllers.b.settings.horizon: 0 is not possible; allowed: an integer, >= 1
controllers.b.settings.output_weight: -1.0 is not possible; allowed: a number, list
controllers.c.label: must be a string, got 3
controllers.c.settings.dictionary.cout: unknown setting of ThinPlate; did you mean "count"?
controllers.c.bounds: no input or controlled output "angel"; did you mean "angle"?
controllers.d d: must be letters, digits, dots, hyphens and underscores, the first one
scenarios.s.noise.angle: must be greater than or equal to 0, got -1.0
scenarios.s.noise: no measurement "speed"; there are: angle
scenarios.s.events[0].time: must be a number of seconds, or a duration such as "15 min"
scenarios.s.events[1].parameters: no tunable parameter "gravity"; there are: damping, mass
report.scenario: no scenario "t"; there are: s
report.panels[0].titel: unknown key; did you mean "title"?
report.panels[0].controllers: no controller "z"; there are:
"""


def test_all_faults_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    """Each fault is there, and nothing else: no fault is told twice or follows from another one."""
    expected = FAULTS.strip().splitlines()
    faults = errors_of(FULL_OF_FAULTS, tmp_path)
    for line in expected:
        assert sum(fault.startswith(line) for fault in faults) == 1, line
    assert len(faults) == len(expected), [f for f in faults if not f.startswith(tuple(expected))]


def test_the_command_says_so_and_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    faults = errors_of(FULL_OF_FAULTS, tmp_path)
    result = CliRunner().invoke(main, ["run", "study.toml"])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert [re.sub(r"^error: study.toml(:\d+)?: ", "", line) for line in result.stderr.splitlines()] == faults
    assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]


NO_TOML = {
    "a number of 5000 digits": "seeds = 1" + 5000 * "0",
    "10000 lists": "seeds = " + 10000 * "[",
    "a key twice": "title = 'a'\ntitle = 'b'",
    "not UTF-8": b"title = '\xff'",
    "nothing": "\0",
}


@pytest.mark.parametrize("content", NO_TOML.values(), ids=NO_TOML)
def test_a_file_that_is_no_toml_is_named(content: str | bytes, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ConfigError, match=r"study\.toml: not a TOML file: ") as caught:
        read_study(str(path))
    assert len(str(caught.value)) < 300


def test_a_long_value_is_cut_in_the_message(tmp_path: Path) -> None:
    (error,) = errors_of(changed(loop__duration="a" * 5000), tmp_path)
    assert error == f"loop.duration: must be {EXPECTED}, got '{'a' * 99}..."


DRIFT = {"parameter": "mass", "from_value": 1.0, "to_value": 2.0}

ONE_FAULT: list[tuple[dict[str, Any], str]] = [
    ({"plant__name": "pendulm"}, 'plant.name: no plant "pendulm"; did you mean "pendulum"?'),
    ({"plant__name": "math:nothing"}, 'plant.name: plant "math:nothing" cannot be loaded: AttributeError'),
    ({"plant__name": "math:pi"}, 'plant.name: plant "math:pi" is neither a PlantModel nor a Plant class'),
    ({"plant__fmu": "x.fmu"}, "plant: needs exactly one of the keys name, fmu, ssp, parts and identified"),
    ({"plant__name": None}, "plant: needs exactly one of the keys name, fmu, ssp, parts and identified"),
    ({"plant": None}, "plant: required key is missing"),
    ({"plant": 3}, "plant: must be a table, got 3"),
    ({"plant__outputs": ["angel"]}, 'plant.outputs: no output "angel"; did you mean "angle"?'),
    ({"plant__outputs": "angle"}, "plant.outputs: must be a list, got 'angle'"),
    ({"plant__outputs": ["angle", "angle"]}, 'plant.outputs: "angle" is listed more than once'),
    ({"plant__measurements": ["speed"]}, 'plant.measurements: no output "speed"'),
    ({"plant__output": []}, 'plant.output: unknown key; did you mean "outputs"?'),
    ({"loop": None}, "loop: required key is missing"),
    ({"loop__duration": None}, "loop.duration: required key is missing"),
    ({"loop__duration": 40.05}, "loop: duration = 40.05 must be a whole multiple of sampling_time = 0.1"),
    ({"loop__duration": float("inf")}, "loop.duration: must be a finite number, got inf"),
    ({"loop__duration": True}, f"loop.duration: must be {EXPECTED}, got True"),
    ({"loop__duration": 1e300}, "loop: duration / sampling_time = 1e+301 samples; allowed"),
    ({"loop__sampling_time": 1e-300}, "loop: duration / sampling_time = 4e+301 samples; allowed"),
    ({"plant__step_timeout": 5.0}, "plant.step_timeout: unknown key; use loop.step_timeout"),
    ({"loop__preview": -1}, "loop.preview: must be greater than or equal to 0, got -1"),
    ({"loop__preview": 1.5}, "loop.preview: must be an integer or 'horizon', got 1.5"),
    ({"loop__preview": True}, "loop.preview: must be an integer or 'horizon', got True"),
    (
        {"scenarios": {"nominal": {"preview": "all"}}},
        "scenarios.nominal.preview: must be an integer or 'horizon', got 'all'",
    ),
    ({"reference": None}, "reference: required key is missing"),
    ({"reference": {}}, "reference: must not be empty"),
    ({"reference__angle": None}, "reference: must not be empty"),
    ({"reference__angle__kind": None}, 'reference.angle: required key "kind" is missing'),
    ({"reference__angle": 3.0}, "reference.angle: must be a table, got 3.0"),
    (
        {"reference__angle__kind": "stairs"},
        "reference.angle: must be one of 'constant', 'steps', 'interpolated'",
    ),
    ({"reference__angle__times": None}, "reference.angle.times: required key is missing"),
    ({"reference__angle__values": []}, "reference.angle.values: must not be empty"),
    ({"reference__angle__value": 3}, 'reference.angle.value: unknown key; did you mean "values"?'),
    ({"reference": {"angel": {"kind": "constant", "value": 1.0}}}, 'reference: no controlled output "angel"'),
    (
        {"bounds__angle": {"min": 1e9, "unit": "rad"}, "plant__name": "scratch:BOUNDED"},
        "plant.name: plant",
    ),
    ({"bounds__angle__min": "low"}, "bounds.angle.min: must be a number or a table, got 'low'"),
    ({"recording__samples": None}, "recording.samples: required key is missing"),
    ({"recording__samples": 1.5}, "recording.samples: must be an integer, got 1.5"),
    ({"recording__excitation": {}}, "recording.excitation: none for the input torque"),
    ({"seeds": []}, "seeds: must not be empty"),
    ({"seeds": [2**32]}, "seeds: 4294967296 is not a seed; allowed: integers from 0 to 4294967295"),
    ({"seeds": "all"}, "seeds: 'all' is not a seed; allowed"),
    ({"seeds": "0:20000000"}, "seeds: 20000000 seeds are too many; allowed: up to 1000000"),
    ({"seeds": ["0:600000", "1000000:1600000"]}, "seeds: 1200000 seeds are too many"),
    ({"seeds": "0:" + "9" * 5000}, "seeds: '0:9999999999...9999999999999' is not a seed; allowed"),
    ({"seeds": [-1, 2, "x"]}, "seeds: -1, 'x' are not seeds; allowed: integers from 0 to 4294967295"),
    ({"seeds": [1, True]}, "seeds: True is not a seed; allowed"),
    ({"name": "../up"}, "name: must be letters, digits, dots"),
    ({"name": "x" * 99}, "name: must have at most 60 characters"),
    ({"controllers": None}, "controllers: required key is missing"),
    ({"controllers": []}, "controllers: must be a table, got []"),
    ({"controllers__mfapc__type": None}, "controllers.mfapc.type: required key is missing"),
    (
        {"controllers__mfapc__typ": "mfapc", "controllers__mfapc__type": None},
        "controllers.mfapc.typ: unknown key",
    ),
    (
        {"controllers__mfapc__horizon": 5},
        "controllers.mfapc.horizon: unknown key; there are: bounds, first_trials, label, note, search, "
        "seeds, settings, sweep, tuned, type, variant_of, varied; if it is a setting of the controller, "
        "write settings.horizon",
    ),
    (
        {"controllers__mfapc": {"type": "scaled"}},
        "controllers.mfapc.settings.controller: required setting is missing",
    ),
    ({"controllers__mfapc__type": "math:pi"}, 'controllers.mfapc.type: controller "math:pi" is not a class'),
    ({"controllers__mfapc__settings": 3}, "controllers.mfapc.settings: must be a table, got 3"),
    (
        {"controllers__mfapc__settings__mu": "1"},
        "controllers.mfapc.settings.mu: '1' is not possible",
    ),
    (
        {"controllers__mfapc__settings__horizon": 10**400},
        "controllers.mfapc.settings.horizon: 1000",
    ),
    (
        {"controllers__deepc__settings__output_weight": "100"},
        "controllers.deepc.settings.output_weight: '100' is not possible",
    ),
    (
        {"controllers__wkpc__settings__dictionary": {"type": "math:nothing"}},
        'controllers.wkpc.settings.dictionary.type: class "math:nothing" cannot be loaded',
    ),
    (
        {"controllers__wkpc__settings__dictionary": {"count": 0}},
        "controllers.wkpc.settings.dictionary.count: 0 is not possible",
    ),
    ({"plant__parameters": {"mass": math.inf}}, "plant.parameters.mass: must be a finite number, got inf"),
    (
        {"controllers__deepc__sweep": {"horizon": [3, 5], "initial_length": [3]}},
        "controllers.deepc.sweep[0]: DeePC: horizon = 3 is not longer than initial_length = 3",
    ),
    ({"scenarios": {"s": {"parameters": {"mas": 1.0}}}}, 'scenarios.s.parameters: no parameter "mas"; did'),
    (
        {"scenarios": {"s": {"parameters": {"mass": 0.0}}}},
        "scenarios.s.parameters.mass: 0 is outside [0.001, inf]",
    ),
    ({"scenarios": {}}, "scenarios: must not be empty"),
    (
        {"scenarios": {"s": {"events": [{"time": 1.0, "parameters": {"mass": -1.0}}]}}},
        "scenarios.s.events[0].parameters.mass: -1 is outside",
    ),
    (
        {"scenarios": {"s": {"events": [{"time": 40.0, "parameters": {"mass": 1.0}}]}}},
        "scenarios.s.events[0].time: at t = 40 s it would not happen: the run ends at t = 40 s",
    ),
    ({"loop__start_time": 1e17}, "loop: start_time = 1e+17 is too large: samples 0.1 s apart coincide there"),
    (
        {"loop__start_time": 7.0, "scenarios": {"s": {"events": [{"time": 99, "parameters": {}}]}}},
        "scenarios.s.events[0].time: at t = 99 s it would not happen: the run ends at t = 47 s",
    ),
    (
        {"scenarios": {"s": {"drifts": [DRIFT | {"from_time": 41.0, "to_time": 50.0}]}}},
        "scenarios.s.drifts[0].from_time: at t = 41 s it would not happen: the run ends at t = 40 s",
    ),
    (
        {"scenarios": {"s": {"drifts": [DRIFT | {"from_time": -2.0, "to_time": 0.0}]}}},
        "scenarios.s.drifts[0].to_time: it would be over when the run starts at t = 0 s; use the scenario's",
    ),
    (
        {"metrics": {"cost": {"outputs": {"angel": 1.0}}}},
        'metrics.cost.outputs: no controlled output "angel"; did you mean "angle"?',
    ),
    (
        {"metrics": {"cost": {"changes": {"angle": 1.0}}}},
        'metrics.cost.changes: no input "angle"; there are: torque',
    ),
    (
        {"metrics": {"cost": {"inputs": {"torque": -1.0}}}},
        "metrics.cost.inputs.torque: must be greater than or equal to 0, got -1.0",
    ),
    (
        {"metrics": {"cost": {"inputs": {"torque": 0.0}}}},
        "metrics.cost: needs a weight above 0 in outputs, inputs or changes",
    ),
    ({"metrics": {"costs": {}}}, 'metrics.costs: unknown key; did you mean "cost"?'),
]


@pytest.mark.parametrize(("changes", "fault"), ONE_FAULT, ids=[fault[:50] for _, fault in ONE_FAULT])
def test_one_fault_is_told_once_and_nothing_that_follows_from_it(
    changes: dict[str, Any], fault: str, tmp_path: Path
) -> None:
    (message,) = errors_of(changed(**changes), tmp_path)
    assert message.startswith(fault)


def test_a_study_without_recording_cannot_teach(tmp_path: Path) -> None:
    faults = errors_of(changed(recording=None, loop__start="recording-end"), tmp_path)
    lacking = "learns from a recording, and the study has no recording section"
    assert 'loop.start: "recording-end" needs a recording section' in faults
    assert f"controllers.deepc: {lacking}" in faults
    assert not any("mfapc" in fault for fault in faults)


def test_a_misspelt_recording_is_not_missed_too(tmp_path: Path) -> None:
    study = changed(recordin=PAPER["recording"], recording=None)
    assert errors_of(study, tmp_path) == ['recordin: unknown key; did you mean "recording"?']


def test_a_recording_that_is_too_short_is_told_for_each_controller(tmp_path: Path) -> None:
    faults = errors_of(changed(recording__samples=10), tmp_path)
    assert len(faults) == 4
    assert all(fault.startswith("recording.samples: 10 is too short for ") for fault in faults)


def test_one_bad_controller_is_not_missed_in_the_report(tmp_path: Path) -> None:
    """The panels and the reproduction name it too."""
    assert len(errors_of(changed(controllers__deepc="none"), tmp_path)) == 1


def test_limits_that_leave_no_room_beside_the_plant_s_own(tmp_path: Path, make_fmu: Any) -> None:
    make_fmu()
    text = """
    [plant]
    fmu = "no_fault.fmu"
    outputs = ["y"]
    [loop]
    sampling_time = 0.1
    duration = 1.0
    [reference]
    y = { kind = "constant", value = 1.0 }
    [bounds]
    u = { min = 20.0 }
    [controllers.mfapc]
    type = "mfapc"
    """
    assert errors_of(text, tmp_path) == ["bounds.u: leaves no room: [20, 10] with the plant's own limits"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a = ", "study.toml: not a TOML file: Invalid value"),
        (b"\xff\xfe", "study.toml: not a TOML file: 'utf-8' codec can't decode"),
        (b"", "study.toml: plant: required key is missing"),
    ],
)
def test_a_file_that_is_no_study(content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        read_study(str(path))
    assert caught.value.faults[0].startswith(words)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere.toml", "nowhere.toml: no such study file"),
        ("some/where", "no such study file"),
        ("papr", 'no study "papr"; did you mean "paper"?; or give the path of a study file'),
    ],
)
def test_a_study_that_is_not_there(name: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_study(name)
    assert words in str(caught.value)


LINES = """
seeds = [
    1,  # a value that goes on
    2,
]
"quoted key".a.b = 1
summary = '''
[plant]
name = "in a text"
'''
[plant]  # a comment = 1
name = "pendulum"
parameters = { mass = 1.0, "x = y" = 2.0 }
[controllers.a.settings]
horizon = 5
[[scenarios.s.events]]
time = 1.0
[scenarios.s.events.parameters]
mass = 1.0
[[scenarios.s.events]]
time = 2.0
"""


def test_every_key_of_a_file_has_its_line() -> None:
    assert key_lines(LINES) == {
        ("seeds",): 2,
        ("seeds", 0): 2,
        ("seeds", 1): 2,
        ("quoted key",): 6,
        ("quoted key", "a"): 6,
        ("quoted key", "a", "b"): 6,
        ("summary",): 7,
        ("plant",): 11,
        ("plant", "name"): 12,
        ("plant", "parameters"): 13,
        ("plant", "parameters", "mass"): 13,
        ("plant", "parameters", "x = y"): 13,
        ("controllers",): 14,
        ("controllers", "a"): 14,
        ("controllers", "a", "settings"): 14,
        ("controllers", "a", "settings", "horizon"): 15,
        ("scenarios",): 16,
        ("scenarios", "s"): 16,
        ("scenarios", "s", "events"): 16,
        ("scenarios", "s", "events", 0): 16,
        ("scenarios", "s", "events", 0, "time"): 17,
        ("scenarios", "s", "events", 0, "parameters"): 18,
        ("scenarios", "s", "events", 0, "parameters", "mass"): 19,
        ("scenarios", "s", "events", 1): 20,
        ("scenarios", "s", "events", 1, "time"): 21,
    }


@pytest.mark.parametrize("separator", ["\x85", "\u2028", "\u2029"])
def test_only_newlines_are_counted_as_lines(separator: str) -> None:
    assert key_lines(f"# a{separator}b [\nx = 1\ny = 'a{separator}b'\nz = 1") == {
        ("x",): 2,
        ("y",): 3,
        ("z",): 4,
    }


def test_a_value_of_many_lines_is_parsed_few_times(monkeypatch: pytest.MonkeyPatch) -> None:
    parsed = []
    loads = tomllib.loads

    def counted(text: str) -> dict[str, Any]:
        parsed.append(text)
        return loads(text)

    monkeypatch.setattr("ddpc_cosim.study.file_format.study_files.tomllib.loads", counted)
    assert key_lines("times = [\n" + "1.0,\n" * 1000 + "]\nlast = 1")[("last",)] == 1003
    assert len(parsed) == 3


def test_a_line_of_a_built_in_study_shows_the_key_that_it_is_named_for() -> None:
    for path in paper.parent.glob("*.toml"):
        text = path.read_text(encoding="utf-8")
        for place, line in key_lines(text).items():
            shown = text.splitlines()[line - 1]
            goes_on = shown.endswith("[")  # below the key of a list that takes several lines
            assert goes_on or [key for key in place if isinstance(key, str)][-1] in shown


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        (
            "horizon = 5, lambda_u",
            "horizon = 0, lambda_u",
            ":40: controllers.mfapc.settings.horizon: 0",
        ),
        ("duration = 40.0", "durations = 40.0", ':19: loop.durations: unknown key; did you mean "duration"?'),
        ("duration = 40.0", "", ":17: loop.duration: required key is missing"),
        ("[loop]", "[lop]", ':17: lop: unknown key; did you mean "loop"?'),
        ("[reference.angle]", "[reference.angel]", ':22: reference: no controlled output "angel"'),
        ("samples = 200", "samples = 1", ":33: recording.samples: 1 is too short for deepc"),
    ],
)
def test_an_error_names_the_line_of_its_key(old: str, new: str, error: str, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(paper.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_study(str(path))
    assert caught.value.faults[0].startswith(f"study.toml{error}")


HIDING = """
seeds = "x"
[plant]
name = "pendulum"
outputs = ["angle"]
step_timeout = 5.0
[loop]
sampling_time = 0.1
duration = 1
step_timeout = 0
start = 3
[reference.angle]
kind = "constant"
unit = "m"
[controllers.a]
settings = { horizon = 0 }
bounds.angel = { min = 0.0 }
[controllers.b]
type = "mfapc"
label = 3
settings = { horizon = 0 }
[[controllers.b.sweep]]
form = ["none"]
[scenarios.s]
noise = { angle = -1.0, speed = 1.0 }
[[scenarios.s.events]]
time = 2.0
[[report.panels]]
controllers = ["z"]
"""


def test_an_error_of_a_field_hides_no_error_that_does_not_depend_on_it(tmp_path: Path) -> None:
    assert [error.partition(": ")[0] for error in errors_of(HIDING, tmp_path)] == [
        "seeds",
        "plant.step_timeout",
        "loop.step_timeout",
        "loop.start",
        "reference.angle.value",
        "reference.angle.unit",
        "controllers.a.type",
        "controllers.a.bounds",
        "controllers.b.label",
        "controllers.b.settings.horizon",
        "controllers.b.sweep[0].form",
        "scenarios.s.noise.angle",
        "scenarios.s.noise",
        "scenarios.s.events[0].parameters",
        "scenarios.s.events[0].time",
        "report.panels[0].title",
        "report.panels[0].controllers",
    ]


def places(table: Any, place: tuple[int | str, ...] = ()) -> list[tuple[int | str, ...]]:
    """Return the places of all values of a study."""
    all_places = [place] if place else []
    if isinstance(table, dict | list):
        for key, item in table.items() if isinstance(table, dict) else enumerate(table):
            all_places.extend(places(item, (*place, key)))
    return all_places


VALUES: st.SearchStrategy[Any] = st.sampled_from(
    [None, 0, -1, 3, 1.5, -2.5, 1e300, float("nan"), True, "", "x", "angle", [], [1.0], {}]
)
MUTATIONS = st.lists(
    st.tuples(st.sampled_from(places(PAPER)), st.sampled_from(["delete", "rename", "replace"]), VALUES),
    min_size=1,
    max_size=4,
)


def has(table: Any, key: int | str) -> bool:
    if isinstance(table, list):
        return isinstance(key, int) and key < len(table)
    return isinstance(table, dict) and key in table


def mutate(study: dict[str, Any], place: tuple[int | str, ...], kind: str, value: Any) -> None:
    """Change one value of a study, if an earlier change has left it there."""
    table: Any = study
    for key in place[:-1]:
        if not has(table, key):
            return
        table = table[key]
    last = place[-1]
    if not has(table, last):
        return
    if kind == "rename" and isinstance(table, dict):
        table[f"{last}x"] = table.pop(last)
    elif kind == "replace" and value is not None:
        table[last] = copy.deepcopy(value)
    else:
        del table[last]


@pytest.mark.filterwarnings("ignore:the reference of")
@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(MUTATIONS)
@example([(("seeds", 1), "replace", "")])
@example([(("report", "panels", 1), "replace", 3), (("report", "panels", 2), "delete", None)])
def test_a_study_with_any_mistakes_is_a_config_error_or_runs(
    tmp_path: Path, mutations: list[tuple[tuple[int | str, ...], str, Any]]
) -> None:
    """Nothing but ConfigError, and no key both wrong and missing."""
    study = copy.deepcopy(PAPER)
    for place, kind, value in mutations:
        mutate(study, place, kind, value)
    faults = errors_of(study, tmp_path)
    assert len(faults) == len(set(faults))
    keys = [fault.partition(": ") for fault in faults]
    missing = {key for key, _, what in keys if what == "required key is missing"}
    assert not missing & {key for key, _, what in keys if what != "required key is missing"}


def tuned(**changes: Any) -> dict[str, Any]:
    """Return the paper's study with DeePC tuned, as other studies say it, and changes of that."""
    table = {"settings": ["lambda_g"], "trials": 20, "seeds": ["100:103"], "by": "median rmse"}
    return changed(controllers__deepc__tuned=table | changes)


def test_how_settings_were_found_can_be_said(tmp_path: Path) -> None:
    assert errors_of(tuned(source="benchmarks/tuning/paper.toml"), tmp_path) == []
    study = changed(
        controllers__wkpc__tuned=tuned(settings=["dictionary.count"])["controllers"]["deepc"]["tuned"]
    )
    assert errors_of(study, tmp_path) == []
    elsewhere = changed(controllers__deepc__tuned={"source": "Table 1 of a paper"})
    assert errors_of(elsewhere, tmp_path) == []
    (error,) = errors_of(changed(controllers__deepc__tuned={}), tmp_path)
    assert error.startswith("controllers.deepc.tuned.source: required key is missing; or give settings, ")


@pytest.mark.parametrize(
    ("change", "place", "words"),
    [
        ({"settings": ["lambda_q"]}, "settings", 'no setting "lambda_q"; did you mean "lambda_g"'),
        ({"settings": []}, "settings", "must not be empty"),
        ({"trials": 0}, "trials", "0"),
        (
            {"seeds": ["29:33"]},
            "seeds",
            "29: a seed of the study; needed: seeds on which no",
        ),
        ({"seeds": ["0:30"]}, "seeds", "0, 1, 2, 3, 4, 5, 6, 7, ...: a seed of the study"),
        ({"seeds": []}, "seeds", "must not be empty"),
        ({"by": None}, "by", "missing"),
    ],
)
def test_a_wrong_account_of_tuning_is_refused(
    change: dict[str, Any], place: str, words: str, tmp_path: Path
) -> None:
    study = tuned(**change)
    if change.get("by", "") is None:
        del study["controllers"]["deepc"]["tuned"]["by"]
    (error,) = errors_of(study, tmp_path)
    assert error.startswith(f"controllers.deepc.tuned.{place}: ")
    assert words in error


def test_variants_of_a_sweep_were_not_tuned(tmp_path: Path) -> None:
    study = tuned()
    study["controllers"]["deepc"]["sweep"] = {"lambda_g": [5.0]}
    path = tmp_path / "study.toml"
    path.write_text(tomli_w.dumps(study), encoding="utf-8")
    controllers = read_study(str(path)).problem.study.controllers
    assert controllers["deepc"].tuned is not None
    assert controllers["deepc-lambda_g-5"].tuned is None


@pytest.mark.parametrize(
    ("change", "place", "words"),
    [
        ({"samples": 36}, "samples", "36 is too short for wkpc, which needs 37"),
        ({"samples": 0}, "samples", "must be greater than or equal to 1, got 0"),
        (
            {"excitation": {"torqe": {"low": -1.0, "high": 1.0}}},
            "excitation",
            'no input "torqe"; did you mean',
        ),
        (
            {"excitation": {"torque": {"low": -1.0, "high": 1.0, "unit": "deg"}}},
            "excitation.torque.unit",
            'unit "deg" does not fit torque',
        ),
        (
            {"excitation": {"torque": {"low": 1.0, "high": -1.0}}},
            "excitation.torque",
            "uniform excitation: low (1.0) must be below high (-1.0)",
        ),
    ],
)
def test_a_scenario_s_experiment_is_checked_as_the_study_s(
    change: dict[str, Any], place: str, words: str, tmp_path: Path
) -> None:
    study = changed(scenarios={"s": {"recording": change}, "as-it-is": {}})
    del study["controllers"]["wkpc-published-code"], study["report"]
    (error,) = errors_of(study, tmp_path)
    assert error.startswith(f"scenarios.s.recording.{place}: ")
    assert words in error


def test_the_experiments_of_all_scenarios_are_checked_whatever_else_is_wrong(tmp_path: Path) -> None:
    upside_down = {"excitation": {"torque": {"low": 1.0, "high": -1.0}}}
    missing = {"excitation": {"torque": {"kind": "recorded", "file": "missing.csv"}}}
    study = changed(scenarios={"a": {"recording": missing}, "b": {"recording": upside_down}}, report=None)
    places = ["scenarios.a.recording.excitation.torque.file", "scenarios.b.recording.excitation.torque"]
    assert [error.partition(": ")[0] for error in errors_of(study, tmp_path)] == places
    study["recording"]["excitation"]["torque"] = upside_down["excitation"]["torque"]
    faulty_places = [error.partition(": ")[0] for error in errors_of(study, tmp_path)]
    assert faulty_places == ["recording.excitation.torque", *places]


def test_a_scenario_without_an_experiment_to_change_is_refused(tmp_path: Path) -> None:
    study = changed(scenarios={"s": {"recording": {"samples": 50}}}, recording=None, report=None)
    study["controllers"] = {"mfapc": study["controllers"]["mfapc"]}
    assert errors_of(study, tmp_path) == [
        "scenarios.s.recording: changes an experiment, and the study has no recording section with one"
    ]
