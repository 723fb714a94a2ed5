"""Studies of several problems: what each becomes, how it is written, and every fault with its line."""

import csv
import shutil
from pathlib import Path

import pytest
import tomli_w
from studies import run_file, write

from ddpc_cosim import ConfigError
from ddpc_cosim.study.cases import Case, cases_of_problems
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.results import load_results

TWO = """
name = "both"
title = "Two plants"
seeds = [1, 2]

[problems.pendulum]
title = "The pendulum"
plant = { name = "pendulum", inputs = ["torque"], outputs = ["angle"] }
loop = { sampling_time = 0.1, duration = 1.0 }
reference.angle = { kind = "constant", value = 0.1 }
bounds.torque = { min = -3.0, max = 3.0 }

[problems.oscillator]
plant = { name = "van-der-pol", inputs = ["force"], outputs = ["position"] }
loop = { sampling_time = 0.05, duration = 1.0 }
reference.position = { kind = "constant", value = 0.5 }
scenarios.nominal = {}
scenarios.noisy = { noise = { position = 0.01 }, label = "with noise" }

[controllers.mfapc]
type = "mfapc"
settings = { horizon = 4, lambda_u = 0.5 }
problems.oscillator = { settings = { lambda_u = 2.0 }, note = "slower here" }

[controllers.pid]
type = "pid"
label = "PID"
settings = { proportional = 1.0 }
problems.pendulum = false
"""
FLAT = """
plant = { name = "pendulum", inputs = ["torque"], outputs = ["angle"] }
loop = { sampling_time = 0.1, duration = 1.0 }
reference.angle = { kind = "constant", value = 0.1 }
bounds.torque = { min = -3.0, max = 3.0 }
scenarios.windy = { disturbances.torque = { kind = "file", file = "wind.csv" } }
controllers.mfapc.type = "mfapc"
"""


def read(folder: Path, text: str, name: str = "study.toml") -> ResolvedProblems:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return read_study(str(path))


def faults(folder: Path, text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(folder, text)
    return list(caught.value.faults)


def test_each_problem_is_a_study_with_what_differs_there(tmp_path: Path) -> None:
    resolved = read(tmp_path, TWO)
    pendulum, oscillator = (problem.study for problem in resolved.problems.values())
    assert (resolved.head.name, resolved.head.title, pendulum.title) == ("both", "Two plants", "The pendulum")
    assert (pendulum.name, oscillator.name) == ("pendulum", "oscillator")
    assert list(pendulum.controllers) == ["mfapc"]
    assert list(oscillator.controllers) == ["mfapc", "pid"]
    settings = [study.controllers["mfapc"].settings for study in (pendulum, oscillator)]
    assert [values["lambda_u"] for values in settings] == [0.5, 2.0]
    assert {values["horizon"] for values in settings} == {4}
    assert oscillator.controllers["mfapc"].note == "slower here"
    assert pendulum.seeds == oscillator.seeds == [1, 2]
    with pytest.raises(ValueError, match="too many"):
        _ = resolved.problem


def test_what_is_written_is_the_same_study(tmp_path: Path) -> None:
    whole = read(tmp_path, TWO).whole
    tables = whole.tables()
    assert tables["controllers"]["mfapc"]["problems"] == {
        "pendulum": {"note": "", "settings": {"lambda_u": 0.5}},
        "oscillator": {"note": "slower here", "settings": {"lambda_u": 2.0}},
    }
    assert tables["controllers"]["pid"]["problems"] == {"pendulum": False}
    assert WholeStudy.of_tables(tables) == whole
    assert read(tmp_path, tomli_w.dumps(tables), "again.toml").whole == whole


def test_a_problem_takes_the_tables_of_another_file_and_replaces_keys_of_them(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "wind.csv").write_text("time,torque\n0,0\n1,1\n", encoding="utf-8")
    (tmp_path / "below" / "flat.toml").write_text(FLAT, encoding="utf-8")
    text = """
    controllers.mfapc.type = "mfapc"
    problems.as-it-is.study = "below/flat.toml"
    [problems.longer]
    study = "below/flat.toml"
    loop.duration = 3.0
    plant.parameters = { mass = 0.5 }
    [problems.other]
    study = "below/flat.toml"
    plant = { name = "van-der-pol", inputs = ["force"], outputs = ["position"] }
    reference.position = { kind = "constant", value = 0.5 }
    """
    two, _, _ = text.partition("[problems.other]")
    (fault,) = faults(tmp_path, two.replace("{ mass = 0.5 }", "{ weight = 0.5 }"))
    assert 'study.toml:7: problems.longer.plant.parameters: no parameter "weight"' in fault
    as_it_is, longer = (problem.study for problem in read(tmp_path, two).problems.values())
    (windy,) = as_it_is.scenarios["windy"].disturbances["torque"]
    assert Path(windy.file) == tmp_path / "below" / "wind.csv"  # type: ignore[union-attr]
    assert (longer.loop.duration, longer.loop.sampling_time) == (3.0, 0.1)
    assert (longer.plant.name, longer.plant.parameters) == ("pendulum", {"mass": 0.5})
    # Another plant is another table: nothing of the pendulum's is left in it; what names its signals is told.
    messages = "\n".join(faults(tmp_path, text))
    assert 'study.toml:11: problems.other.reference: no controlled output "angle"' in messages
    assert "problems.other.plant" not in messages


def test_every_fault_of_every_problem_has_its_place_and_shared_ones_are_told_once(tmp_path: Path) -> None:
    text = TWO + "[loop]\nduration = 2.0\n[problem]\n"
    for right, wrong in {
        "torque = {": "torqe = {",
        "horizon = 4": "horizon = -4",
        'kind = "constant", value = 0.5': 'kind = "constant", valeu = 0.5',
        "pendulum = false": "pendulm = false",
        "proportional = 1.0": "proportinal = 1.0",
        "lambda_u = 2.0": "lambda_u = -2.0",
    }.items():
        text = text.replace(right, wrong)
    messages = [fault.removeprefix("study.toml:") for fault in faults(tmp_path, text)]
    starts = [
        "11: problems.pendulum.bounds: ",
        "16: problems.oscillator.reference.position.valeu: ",
        "22: controllers.mfapc.settings.horizon: ",
        "23: controllers.mfapc.problems.oscillator.settings.lambda_u: ",
        "28: controllers.pid.settings.proportinal: ",
        "29: controllers.pid.problems: ",
        "30: loop: each problem has its own: problems.NAME.loop",
        "32: problem: unknown key; ",
    ]
    assert [next((s for s in starts if message.startswith(s)), message) for message in messages] == starts


@pytest.mark.parametrize(
    ("replaced", "by", "expected"),
    [
        ("[problems.pendulum]", "[problems.pendulum]\nseeds = [3]", "problems.pendulum.seeds: belongs to"),
        ("problems.pendulum = false", "problems.pendulum = true", "pid.problems.pendulum: must be a table"),
        ("problems.pendulum = false", "problems = false", "controllers.pid.problems: must be a table"),
        (TWO, "problems = 3\ncontrollers.a.type = 'pid'", "problems: must be a table of problems"),
        (TWO, "problems = {}\ncontrollers.a.type = 'pid'", "problems: must be a table of problems"),
        ("[problems.pendulum]", "problems.a = 3\n[problems.pendulum]", "problems.a: must be a table"),
        ("[problems.pendulum]", "[problems.'a b']", "problems.a b: must be letters"),
        ('name = "both"', 'name = "bo th"', "name: must be letters"),
        ("[problems.pendulum]", "[problems.pendulum]\nstudy = 3", "pendulum.study: must be a study file"),
        ("[problems.pendulum]", "[problems.pendulum]\nstudy = 'no.toml'", "pendulum.study: no.toml: no such"),
        (
            "[problems.pendulum]",
            "[problems.pendulum]\nstudy = 'study.toml'",
            "problems.pendulum.study: takes from itself: study.toml -> study.toml",
        ),
        ("problems.pendulum = false", "problems = { pendulum = false, oscillator = false }", ""),
    ],
)
def test_what_is_wrong_with_how_problems_are_put_together(
    tmp_path: Path, replaced: str, by: str, expected: str
) -> None:
    assert replaced in TWO
    text = TWO.replace(replaced, by)
    if not expected:
        read(tmp_path, text)
        return
    assert any(expected in fault for fault in faults(tmp_path, text))


@pytest.mark.parametrize("path", ["\\u0000", "a" * 5000], ids=["null", "long"])
def test_what_no_file_can_be_called_is_told(tmp_path: Path, path: str) -> None:
    flat = FLAT.replace("wind.csv", path).replace('name = "pendulum"', f'fmu = "{path}"')
    assert [message for message in faults(tmp_path, flat) if "study.toml:2: plant.fmu: " in message]
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "flat.toml").write_text(flat, encoding="utf-8")
    (fault,) = faults(tmp_path, f'extends = "{path}"')
    assert fault.startswith("study.toml:1: extends: no study ")
    messages = faults(tmp_path, 'extends = "below/flat.toml"')
    assert [message for message in messages if "below/flat.toml:2: plant.fmu: " in message]


def test_more_samples_than_can_be_recorded_are_an_error(tmp_path: Path) -> None:
    calm = FLAT.replace('{ disturbances.torque = { kind = "file", file = "wind.csv" } }', "{}")
    experiment = "[recording]\nsamples = 9223372036854775807\nexcitation.torque = { low = -1.0, high = 1.0 }"
    (fault,) = faults(tmp_path, calm + experiment)
    assert fault == (
        "study.toml:9: recording.samples: must be less than or equal to 100000000, got 9223372036854775807"
    )


def test_a_problem_without_controllers_and_a_shared_fault_name_the_problem(tmp_path: Path) -> None:
    text = TWO.replace('problems.oscillator = { settings = { lambda_u = 2.0 }, note = "slower here" }', "")
    without = text + "[controllers.mfapc.problems]\npendulum = false\n"
    (fault,) = faults(tmp_path, without)
    assert "controllers: must not be empty (problem pendulum)" in fault
    text += "[controllers.deepc]\ntype = 'deepc'\n"
    text += "[problems.oscillator.recording]\nsamples = 99\nexcitation.force = { low = -1.0, high = 1.0 }\n"
    (fault,) = faults(tmp_path, text)
    assert "controllers.deepc: learns from a recording" in fault
    assert fault.endswith("(problem pendulum)")


def test_reference_points_are_two_controllers_of_every_problem_that_leaves_out_neither(
    tmp_path: Path,
) -> None:
    points = "[report]\nreference_points = {{ zero = {!r}, full = {!r} }}\n"
    whole = read(tmp_path, TWO.replace("problems.pendulum = false", "") + points.format("pid", "mfapc")).whole
    assert all(study.report.reference_points.zero == "pid" for study in whole.problems.values())  # type: ignore[union-attr]
    assert WholeStudy.of_tables(whole.tables()) == whole
    without = read(tmp_path, TWO + points.format("pid", "mfapc")).whole.problems
    assert without["pendulum"].report.reference_points is None
    assert without["oscillator"].report.reference_points is not None
    (fault,) = faults(tmp_path, TWO + points.format("pid", "mfap"))
    assert fault.endswith(
        'reference_points.full: no controller "mfap"; did you mean "mfapc"? (problem oscillator)'
    )
    (twice,) = faults(tmp_path, TWO + points.format("mfapc", "mfapc"))
    assert twice.endswith('reference_points.full: "mfapc" is also at 0 %; needed: two different controllers')


def test_a_reference_point_may_be_run_with_the_first_seed_alone(tmp_path: Path) -> None:
    points = '[report]\nreference_points = { zero = "mfapc", full = "pid" }\n'
    once = TWO.replace("problems.pendulum = false", 'seeds = "first"')

    def cases(text: str, *seeds: int) -> list[Case]:
        problems = read(tmp_path, text).problems.items()
        return cases_of_problems({name: (problem, problem.plant) for name, problem in problems}, seeds)

    def seeds_of(cases: list[Case], controller: str) -> set[int]:
        return {case.seed for case in cases if case.controller == controller}

    assert seeds_of(cases(once + points), "mfapc") == {1, 2}
    assert seeds_of(cases(once + points), "pid") == {1}
    assert seeds_of(cases(once + points, 7, 8), "pid") == {7}
    # Its run is the same one as if it were run with all seeds.
    everyone = cases(once.replace('"first"', '"all"') + points)
    assert {case.id for case in cases(once + points)} < {case.id for case in everyone}
    whole = read(tmp_path, once + points).whole
    assert WholeStudy.of_tables(whole.tables()) == whole
    for fault in faults(tmp_path, once):
        assert (
            'controllers.pid.seeds: "first" is for a reference point, with which no other is compared in '
            "pairs of seeds; leave it out, or name the controller in report.reference_points"
        ) in fault


def test_the_cases_of_all_problems_are_run_told_apart_and_kept(tmp_path: Path) -> None:
    results = run_file(write(tmp_path, TWO))
    names = [case.id.rpartition("_")[0] for case in results.cases]
    assert names == [
        *(f"pendulum_mfapc_seed{seed}" for seed in (1, 2)),
        *(
            f"oscillator_{name}{scenario}_seed{seed}"
            for name in ("mfapc", "pid")
            for scenario in ("", "_noisy")
            for seed in (1, 2)
        ),
    ]
    with (tmp_path / "out" / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["study"], row["problem"], row["plant"]) for row in rows] == [
        *[("both", "pendulum", "pendulum")] * 2,
        *[("both", "oscillator", "van-der-pol")] * 8,
    ]
    pendulum, oscillator = load_results(tmp_path / "out").problems()
    assert (pendulum.study.name, len(pendulum.cases), len(oscillator.cases)) == ("pendulum", 2, 8)
    assert pendulum.provenance["plant content"] != oscillator.provenance["plant content"]
    assert pendulum.provenance["date"] == oscillator.provenance["date"]
    with pytest.raises(ConfigError, match="several problems: pendulum, oscillator"):
        _ = results.study
    times = [case.folder.stat().st_mtime_ns for case in results.cases]
    shutil.rmtree(results.cases[3].folder)
    again = load_results(tmp_path / "out").problems()
    assert [len(loaded.damaged) for loaded in again] == [0, 1]
    rerun = run_file(write(tmp_path, TWO))
    changed = [old != case.folder.stat().st_mtime_ns for old, case in zip(times, rerun.cases, strict=True)]
    assert [i for i, is_new in enumerate(changed) if is_new] == [3]


@pytest.mark.parametrize(
    ("only", "count"),
    [
        ("pendulum", 2),
        ("The pend*", 2),
        ("PID", 4),
        ("with noise", 4),
        ("noisy", 4),
        ("*_seed2", 5),
        ("no", 0),
    ],
)
def test_a_pattern_chooses_by_names_and_labels(tmp_path: Path, only: str, count: int) -> None:
    study = write(tmp_path, TWO)
    if count:
        assert len(run_file(study, only=only).cases) == count
    else:
        with pytest.raises(ConfigError, match="--only no: no case matches; "):
            run_file(study, only=only)


@pytest.mark.parametrize(
    ("only", "plants"),
    [
        ("pendulum", ["pendulum"]),
        ("PID", ["van-der-pol"]),
        ("noisy", ["van-der-pol"]),
        ("*_seed2", ["pendulum", "van-der-pol"]),
    ],
)
def test_a_plant_of_which_no_case_is_left_is_not_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, only: str, plants: list[str]
) -> None:
    built, build = list[str](), PlantSpec.built

    def noted(plant: PlantSpec) -> PlantSpec:
        built.append(plant.name)
        return build(plant)

    monkeypatch.setattr(PlantSpec, "built", noted)
    results = run_file(write(tmp_path, TWO), only=only)
    assert built == plants
    assert {case.problem for case in results.cases} == {
        {"pendulum": "pendulum", "van-der-pol": "oscillator"}[plant] for plant in plants
    }


def test_a_flat_file_is_a_study_of_one_problem_that_has_its_name(tmp_path: Path) -> None:
    (tmp_path / "wind.csv").write_text("time,torque\n0,0\n1,1\n", encoding="utf-8")
    results = run_file(write(tmp_path, FLAT))
    assert results.problems() == (results,)
    assert [(case.problem, case.id.rpartition("_")[0]) for case in results.cases] == [
        ("study", "mfapc_windy_seed0")
    ]
    assert "problems" not in (tmp_path / "out" / "study.toml").read_text(encoding="utf-8")


def test_a_logo_is_a_picture(tmp_path: Path) -> None:
    (fault,) = faults(tmp_path, f'{TWO}\n[report]\nlogo = "a.bmp"\n')
    assert fault.endswith('report.logo: "a.bmp" must end in .svg, .png, .jpg, .jpeg')
