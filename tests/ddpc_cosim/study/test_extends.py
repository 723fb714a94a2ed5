"""A study file that extends another: what it takes, what it says itself, and where each error stands."""

import io
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from studies import run_file

from ddpc_cosim import ConfigError, Study
from ddpc_cosim.cli.progress import LineProgress
from ddpc_cosim.studies import __file__ as built_in
from ddpc_cosim.study.file_format.study_files import absolute_paths
from ddpc_cosim.study.reading import read_file, read_study
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.runner import Selection, selected_cases
from ddpc_cosim.study.running.dry_run import expected

BASE = """
title = "Of the base"
source = "a paper"
seeds = [1, 2]

[problems.pendulum]
title = "The pendulum"
plant = { name = "pendulum", inputs = ["torque"], outputs = ["angle"] }
loop = { sampling_time = 0.1, duration = 1.0 }
reference.angle = { kind = "constant", value = 0.1 }
bounds.torque = { min = -3.0, max = 3.0 }
scenarios.nominal = {}
scenarios.windy = { disturbances.torque = { kind = "file", file = "wind.csv" } }

[problems.oscillator]
plant = { name = "van-der-pol", inputs = ["force"], outputs = ["position"] }
loop = { sampling_time = 0.05, duration = 1.0 }
reference.position = { kind = "constant", value = 0.5 }

[controllers.mfapc]
type = "mfapc"
settings = { horizon = 4 }
tuned = { settings = ["lambda_u"], trials = 9, seeds = [100], by = "rmse" }
problems.pendulum = { settings = { lambda_u = 0.5 } }
problems.oscillator = { settings = { lambda_u = 2.0 } }

[controllers.pid]
type = "pid"
label = "PID"
settings = { proportional = 1.0 }

[report]
limitations = ["short"]
panels = [{ title = "Both", controllers = ["mfapc", "pid"] }, { title = "One", controllers = ["pid"] }]
reference_points = { zero = "pid", full = "mfapc" }
"""
MINE = """
extends = "below/base.toml"
[controllers.mine]
type = "pid"
label = "Mine"
settings = { proportional = 3.0 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    below = tmp_path / "below"
    below.mkdir()
    (below / "base.toml").write_text(BASE, encoding="utf-8")
    (below / "wind.csv").write_text("time,torque\n0,0\n1,1\n", encoding="utf-8")
    return tmp_path


def read(folder: Path, text: str, name: str = "mine.toml") -> ResolvedProblems:
    (folder / name).write_text(text, encoding="utf-8")
    return read_study(str(folder / name))


def faults(folder: Path, text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(folder, text)
    return list(caught.value.faults)


def ids(resolved: ResolvedProblems) -> list[str]:
    _, cases = selected_cases(resolved, Selection(), LineProgress(io.StringIO()))
    return [case.id for case in cases]


def test_all_is_taken_and_one_table_joins(folder: Path) -> None:
    base, resolved = read_study(str(folder / "below" / "base.toml")), read(folder, MINE)
    head = resolved.head
    assert (head.name, head.title, head.source, head.seeds) == ("mine", "", "a paper", [1, 2])
    assert head.based_on == ["base"]
    assert list(resolved.problems) == list(base.problems)
    for problem, extending in resolved.problems.items():
        study, theirs = extending.study, base.problems[problem].study
        assert list(study.controllers) == ["mfapc", "pid", "mine"]
        assert {key: study.controllers[key] for key in theirs.controllers} == theirs.controllers
        same = {"controllers": theirs.controllers, "report": theirs.report}
        assert replace(study, **same) == theirs
        assert study.report.limitations == ["short"]
        shown = {panel.title: panel.controllers for panel in study.report.panels}
        assert shown == {"Both": ["mfapc", "pid"], "One": ["pid"], "Mine": ["mine"]}
    assert [case_id for case_id in ids(resolved) if "_mine_" not in case_id] == ids(base)


def test_cases_of_the_base_are_reused_even_under_the_name_of_a_problem(folder: Path) -> None:
    out = folder / "out"
    run_file(folder / "below" / "base.toml", out, seeds=[1])
    before = {path.name: path.stat().st_mtime_ns for path in (out / "cases").iterdir()}
    resolved = read(folder, MINE, "pendulum.toml")
    assert expected(resolved, out, Selection(seeds=[1]), LineProgress(io.StringIO())).startswith(
        "9 cases and 3 runs of doing nothing: 3 to run, 9 already there"
    )
    results = run_file(folder / "pendulum.toml", out, seeds=[1])
    after = {path.name: path.stat().st_mtime_ns for path in (out / "cases").iterdir()}
    assert {name: after[name] for name in before} == before
    assert (len(results.cases), len(after)) == (9, 12)
    for text, name in (
        (BASE, "below/base.toml"),
        (MINE, "other.toml"),
        ('extends = "pendulum.toml"', "a.toml"),
    ):
        (folder / name).write_text(text, encoding="utf-8")
        assert len(run_file(folder / name, out, seeds=[1]).cases) in (6, 9)
    (folder / "below" / "alone.toml").write_text(BASE, encoding="utf-8")
    with pytest.raises(ConfigError, match=r'another study .*this one has name = "alone"'):
        run_file(folder / "below" / "alone.toml", out, seeds=[1])


@pytest.mark.parametrize("path", sorted(Path(built_in).parent.glob("*.toml")), ids=lambda path: path.stem)
def test_a_file_that_says_nothing_is_the_built_in_study(tmp_path: Path, path: Path) -> None:
    (tmp_path / "same.toml").write_text(f'extends = "{path.stem}"', encoding="utf-8")
    tables = read_file(str(tmp_path / "same.toml")).tables
    theirs = absolute_paths(tomllib.loads(path.read_text("utf-8")), path.parent)
    for key in ("name", "title", "summary"):
        theirs.pop(key, None)
    theirs.get("report", {}).pop("reproduction", None)
    assert tables == theirs | {"name": "same", "based_on": [path.stem]}


def test_what_the_file_says_counts(folder: Path) -> None:
    text = """
    extends = "below/base.toml"
    seeds = ["5:7"]
    problems.oscillator = false
    problems.pendulum.loop.duration = 2.0
    problems.pendulum.scenarios.windy = false
    problems.pendulum.scenarios.noisy = { noise = { angle = 0.01 } }
    controllers.pid = false
    controllers.mfapc.problems.pendulum.settings.lambda_u = 0.7
    [report]
    limitations = []
    """
    study = read(folder, text).problem.study
    assert (study.seeds, study.loop.duration, study.loop.sampling_time) == ([5, 6], 2.0, 0.1)
    assert list(study.scenarios) == ["nominal", "noisy"]
    section = study.controllers["mfapc"]
    assert (section.settings["lambda_u"], section.settings["horizon"], section.tuned) == (0.7, 4, None)
    assert list(study.controllers) == ["mfapc"]
    assert ([panel.controllers for panel in study.report.panels], study.report.limitations) == (
        [["mfapc"]],
        [],
    )
    assert study.report.reference_points is None


def test_settings_of_a_file_count_in_all_problems_and_are_not_said_to_be_tuned(folder: Path) -> None:
    base = read(folder, 'extends = "below/base.toml"')
    changed = read(folder, 'extends = "below/base.toml"\ncontrollers.mfapc.settings.lambda_u = 0.9')
    in_one_problem = read(
        folder, 'extends = "below/base.toml"\ncontrollers.mfapc.problems.pendulum.settings.horizon = 6'
    )

    def settings_of(resolved: ResolvedProblems) -> dict[str, Any]:
        sections = {name: of.study.controllers["mfapc"] for name, of in resolved.problems.items()}
        keys = ("lambda_u", "horizon")
        return {
            name: (*(section.settings[key] for key in keys), section.tuned is not None)
            for name, section in sections.items()
        }

    assert settings_of(base) == {"pendulum": (0.5, 4, True), "oscillator": (2.0, 4, True)}
    assert settings_of(changed) == {"pendulum": (0.9, 4, False), "oscillator": (0.9, 4, False)}
    assert settings_of(in_one_problem) == {"pendulum": (0.5, 6, False), "oscillator": (2.0, 4, True)}


def test_another_type_drops_what_was_said_of_the_first(folder: Path) -> None:
    resolved = read(folder, 'extends = "below/base.toml"\ncontrollers.mfapc = { type = "pid" }')
    for problem in resolved.problems.values():
        section = problem.study.controllers["mfapc"]
        assert (section.type, section.tuned) == ("pid", None)
        assert "lambda_u" not in section.settings


def test_chains_and_problems_of_other_files(folder: Path) -> None:
    flat = """
    plant = { name = "pendulum", inputs = ["torque"], outputs = ["angle"] }
    loop = { sampling_time = 0.1, duration = 1.0 }
    reference.angle = { kind = "file", file = "wind.csv", column = "torque" }
    controllers.mfapc.type = "mfapc"
    """
    (folder / "below" / "flat.toml").write_text(flat, encoding="utf-8")
    (folder / "longer.toml").write_text('extends = "below/flat.toml"\nloop.duration = 3.0', encoding="utf-8")
    (folder / "middle.toml").write_text(
        MINE + '[problems.third]\nstudy = "longer.toml"\nbounds.torque = { max = 3.0 }', encoding="utf-8"
    )
    resolved = read(folder, 'extends = "middle.toml"\nproblems.third.bounds.torque = { max = 2.0 }')
    assert list(resolved.problems) == ["pendulum", "oscillator", "third"]
    assert resolved.head.based_on == ["middle", "base"]
    study = resolved.problems["third"].study
    assert (study.loop.duration, study.bounds["torque"].max) == (3.0, 2.0)
    assert Path(study.reference["angle"].file) == folder / "below" / "wind.csv"  # type: ignore[union-attr]
    # One that is taken from elsewhere begins anew.
    again = 'extends = "middle.toml"\nproblems.pendulum.study = "longer.toml"\nseeds = [7]'
    assert list(read(folder, again).problems["pendulum"].study.scenarios) == ["nominal"]
    # And of one whose base cannot be read nothing is known.
    (folder / "longer.toml").write_text('extends = "below/flatt.toml"', encoding="utf-8")
    assert faults(folder, again) == ["longer.toml:1: extends: below/flatt.toml: no such study file"]
    assert faults(folder, 'extends = "longer.toml"') == [
        "longer.toml:1: extends: below/flatt.toml: no such study file"
    ]


def test_a_flat_study_is_extended_and_another_plant_replaces_the_first(tmp_path: Path) -> None:
    text = 'extends = "paper"\nseeds = [1]\nplant = { parameters = { mass = 1.1 } }\nloop.duration = 20.0'
    study = read(tmp_path, text).problem.study
    assert (study.name, study.plant.name, study.loop.duration) == ("mine", "pendulum", 20.0)
    assert study.plant.parameters == {"mass": 1.1}
    assert study.report.reproduction is None
    assert study.report.panels
    messages = faults(tmp_path, 'extends = "paper"\nplant = { fmu = "no.fmu" }')
    assert [fault for fault in messages if "no.fmu" in fault] == [
        f"mine.toml:2: plant.fmu: {tmp_path / 'no.fmu'}: no such file"
    ]
    assert faults(tmp_path, 'extends = "paper"\nproblems.a.study = "mimo"') == [
        "mine.toml:2: problems: paper is a study of one problem; "
        "to have it among several: problems.NAME.study"
    ]


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ('extends = "papre"', 'mine.toml:1: extends: no study "papre"; did you mean "paper"?'),
        ("extends = 3", "mine.toml:1: extends: must be a study file or the name of a built-in study, got 3"),
        ('extends = "mine.toml"', "mine.toml:1: extends: takes from itself: mine.toml -> mine.toml"),
        ('extends = "bad.toml"', "mine.toml:1: extends: bad.toml: not a TOML file: "),
        (
            'extends = "a.toml"',
            "b.toml:1: extends: takes from itself: mine.toml -> a.toml -> b.toml -> a.toml",
        ),
        ('extend = "paper"', "mine.toml:1: extend: unknown key; use extends"),
        (
            'extends = "deep.toml"',
            "mine.toml:1: extends: deep.toml: tables within tables; allowed: 100 levels",
        ),
    ],
)
def test_what_cannot_be_extended(tmp_path: Path, said: str, expected: str) -> None:
    files = {"a": 'extends = "b.toml"', "b": 'extends = "a.toml"', "bad": "=", "deep": f"{'a.' * 900}b = 1"}
    for name, text in files.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    assert [fault for fault in faults(tmp_path, said) if fault.startswith(expected)]


def test_every_fault_has_the_line_of_the_file_that_says_it(folder: Path) -> None:
    base = BASE.replace("proportional = 1.0", "proportinal = 1.0").replace("max = 3.0", "maxx = 3.0")
    (folder / "below" / "base.toml").write_text(base, encoding="utf-8")
    text = """extends = "below/base.toml"
    controllers.pdi = false
    controllers.mine.settings.gain = 1.0
    problems.oscilator.loop.duration = 2.0
    controllers.mfapc.settings.horizon = -1
    [problems.oscillator.reference]
    position = { kind = "constant" }
    """
    starts = [
        'mine.toml:2: controllers.pdi: no controller "pdi" in below/base.toml; did you mean "pid"?',
        'mine.toml:3: controllers.mine: no controller "mine" in below/base.toml; there are: mfapc, pid; ',
        'mine.toml:4: problems.oscilator: no problem "oscilator" in below/base.toml; did you mean "oscill',
        "mine.toml:5: controllers.mfapc.settings.horizon: ",
        "mine.toml:7: problems.oscillator.reference.position.value: required key is missing",
        "below/base.toml:11: problems.pendulum.bounds.torque.maxx: unknown key",
        "below/base.toml:30: controllers.pid.settings.proportinal: unknown setting",
    ]
    messages = faults(folder, text)
    assert [next((s for s in starts if message.startswith(s)), message) for message in messages] == starts


def test_in_python_and_written_out(folder: Path) -> None:
    (folder / "mine.toml").write_text(MINE, encoding="utf-8")
    study = Study.read(folder / "mine.toml")
    assert (study.name, study.problems) == ("mine", ("pendulum", "oscillator"))
    assert study.controllers == ("mfapc", "pid", "mine")
    assert repr(study) == "Study(mine: 2 problems, 3 controllers, 2 seeds)"
    resolved = read_study(str(folder / "mine.toml"))
    for written in (study.write(folder / "written.toml"), study.write(folder / "far" / "written.toml")):
        assert "extends" not in tomllib.loads(written.read_text(encoding="utf-8"))
        again = read_study(str(written))
        assert replace(again, head=resolved.head) == resolved
        assert ids(again) == ids(resolved)
    (folder / "mine.toml").write_text(MINE + "[problems]\nno = false", encoding="utf-8")
    with pytest.raises(ConfigError, match=r'mine\.toml:8: problems\.no: no problem "no" in below/base\.toml'):
        Study.read(folder / "mine.toml")


def test_files_that_a_sweep_names_are_the_bases(folder: Path) -> None:
    below = folder / "below"
    (below / "gusts.csv").write_text("time,torque\n0,0\n1,2\n", encoding="utf-8")
    swept = """
    [[sweep]]
    "problems.pendulum.scenarios.windy.disturbances.torque[0].file" = ["gusts.csv"]
    [[sweep]]
    "controllers.pid.settings.proportional" = [2.0]
    "controllers.mfapc.settings.horizon" = [5]
    """
    listed = BASE.replace('{ kind = "file", file = "wind.csv" }', '[{ kind = "file", file = "wind.csv" }]')
    (below / "base.toml").write_text(listed + swept, encoding="utf-8")
    resolved = read(
        folder, 'extends = "below/base.toml"\ncontrollers.pid = false\nproblems.oscillator = false'
    )
    first, gusts, longer = (problem.study for problem in resolved.problems.values())
    (wind,) = gusts.scenarios["windy"].disturbances["torque"]
    assert Path(wind.file) == below / "gusts.csv"  # type: ignore[union-attr]
    assert (first.name, longer.varied) == ("pendulum", {"controllers.mfapc.settings.horizon": 5})
