"""A study's sweep: anything in it by its path, ranges, values taken together, and what can be wrong."""

import csv
import math
import re
from pathlib import Path

import pytest
from studies import run_file, write

from ddpc_cosim import ConfigError
from ddpc_cosim.study.file_format.sweeps import combinations, swept_values
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.results import load_results
from ddpc_reports.page import render_page

FLAT = """
name = "swing"
plant = { name = "pendulum", inputs = ["torque"], outputs = ["angle"] }
loop = { sampling_time = 0.1, duration = 2.0 }
reference.angle = { kind = "constant", value = 0.1 }
controllers.mfapc.type = "mfapc"
controllers.pid = { type = "pid", settings = { proportional = 1.0 } }
[scenarios.nominal]
[[scenarios.nominal.events]]
time = 1.0
parameters = { damping = 0.2 }
"""
SWEEP = """
[[sweep]]
"loop.sampling_time" = [0.1, 0.2]
"plant.parameters.mass" = [0.3, 0.4]
[[sweep]]
zip = true
"loop.duration" = [1.0, 3.0]
"scenarios.nominal.events[0].time" = { linear = [0.5, 1.0, 2] }
[[sweep]]
"controllers.pid.settings.proportional" = { log = [1, 100, 3] }
"""
TWO = """
name = "both"
controllers.mfapc.type = "mfapc"
problems.a.study = "flat.toml"
problems.b.study = "flat.toml"
[sweep]
"problems.b.loop.duration" = [1.5]
"""


def read(folder: Path, text: str) -> ResolvedProblems:
    (folder / "flat.toml").write_text(FLAT, encoding="utf-8")
    return read_study(str(write(folder, text)))


def faults(folder: Path, sweep: str, text: str = FLAT) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(folder, f"{text}[[sweep]]\n{sweep}\n")
    return [fault.removeprefix("study.toml:") for fault in caught.value.faults]


def test_paths_are_set_crossed_within_a_table_together_with_zip_and_tables_follow(tmp_path: Path) -> None:
    studies = {name: problem.study for name, problem in read(tmp_path, FLAT + SWEEP).problems.items()}
    unvaried, *variants = studies.values()
    assert (unvaried.varied, unvaried.variant_of, unvaried.loop.sampling_time) == ({}, "", 0.1)
    assert [(variant.loop.sampling_time, variant.plant.parameters["mass"]) for variant in variants[:4]] == [
        (0.1, 0.3),
        (0.1, 0.4),
        (0.2, 0.3),
        (0.2, 0.4),
    ]
    together = [
        (variant.loop.duration, variant.scenarios["nominal"].events[0].time) for variant in variants[4:6]
    ]
    assert together == [(1.0, 0.5), (3.0, 1.0)]
    # Only what differs is run again.
    gains = [
        {key: section.settings.get("proportional") for key, section in v.controllers.items()}
        for v in variants[6:]
    ]
    assert gains == [{"pid": 1}, {"pid": 10}, {"pid": 100}]
    assert {variant.variant_of for variant in variants} == {"swing"}
    assert list(studies)[1] == "swing-loop.sampling_time-0.1-plant.parameters.mass-0.3"
    assert variants[0].title == "swing, loop.sampling_time = 0.1, plant.parameters.mass = 0.3"


def test_a_problem_may_be_varied_alone_and_the_written_study_is_the_same(tmp_path: Path) -> None:
    resolved = read(tmp_path, TWO)
    assert list(resolved.problems) == ["a", "b", "b-problems.b.loop.duration-1.5"]
    assert resolved.problems["b-problems.b.loop.duration-1.5"].study.loop.duration == 1.5
    assert WholeStudy.of_tables(resolved.whole.tables()) == resolved.whole


def test_variants_are_run_beside_the_study_whose_own_cases_are_kept(tmp_path: Path) -> None:
    def run(text: str) -> list[dict[str, str]]:
        results = run_file(write(tmp_path, text))
        assert load_results(tmp_path / "out").whole == results.whole
        with (tmp_path / "out" / "metrics.csv").open(newline="") as file:
            return list(csv.DictReader(file))

    assert "variant" not in run(FLAT)[0]
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out" / "cases").iterdir()}
    rows = run(FLAT + '[[sweep]]\n"loop.sampling_time" = [0.2]\n')
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out" / "cases").iterdir()}
    assert {name: after[name] for name in before} == before
    assert [(row["problem"], row["variant"], row["controller"]) for row in rows] == [
        ("swing", "", "mfapc"),
        ("swing", "", "pid"),
        ("swing", "loop.sampling_time = 0.2", "mfapc"),
        ("swing", "loop.sampling_time = 0.2", "pid"),
    ]
    variants = [name.rpartition("_")[0] for name in sorted(after.keys() - before.keys())]
    assert variants == [
        f"swing-loop.sampling_time-0.2_{name}_seed0" for name in ("doing-nothing", "mfapc", "pid")
    ]


def test_the_report_of_a_variant_names_only_the_controllers_that_it_has(tmp_path: Path) -> None:
    report = """
    [report]
    panels = [{ title = "Both", controllers = ["mfapc", "pid"] }, { title = "One", controllers = ["mfapc"] }]
    reference_points = { zero = "mfapc", full = "pid" }
    """
    swept = '[[sweep]]\n"controllers.pid.settings.proportional" = [2.0]\n'
    unvaried, variant = (
        problem.study.report for problem in read(tmp_path, FLAT + swept + report).problems.values()
    )
    assert (len(unvaried.panels), unvaried.reference_points is None) == (2, False)
    assert ([panel.controllers for panel in variant.panels], variant.reference_points) == ([["pid"]], None)


def test_ranges() -> None:
    assert swept_values({"linear": [0.1, 0.5, 5]}) == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert swept_values({"linear": [4, 8, 3]}) == [4, 6, 8]
    assert all(type(value) is int for value in swept_values({"linear": [4, 8, 3]}))
    assert swept_values({"log": [1e-3, 10.0, 5]}) == [0.001, 0.01, 0.1, 1.0, 10.0]
    values = swept_values({"log": [2.0, 3.0, 4]})
    assert values == pytest.approx([2.0 * math.pow(1.5, i / 3) for i in range(4)], rel=1e-11)
    assert list(combinations({"a": [1, 2], "b": [3, 4], "zip": True})) == [{"a": 1, "b": 3}, {"a": 2, "b": 4}]


@pytest.mark.parametrize(
    ("sweep", "expected"),
    [
        ('"loop.sampling_tim" = [0.2]', "13: sweep[0].loop.sampling_tim: unknown key; did you mean"),
        ('"loop.sampling_time" = [0.2, -1.0]', "13: sweep[0].loop.sampling_time: must be greater than 0"),
        ('"loop.sampling_time" = [0.3]', "13: sweep[0].loop.sampling_time: duration = 2 must be a whole"),
        ('"seeds" = [[1]]', "13: sweep[0].seeds: not a setting of a problem or of a controller"),
        ('"controllers.no.settings.x" = [1]', "13: sweep[0].controllers.no.settings.x: must name a key of a"),
        (
            '"controllers.pid.settings.propor" = [1]',
            "controllers.pid.settings.propor: unknown setting",
        ),
        ('"loop..x" = [1]', "13: sweep[0].loop..x: not a path; needed: keys with dots between them"),
        ('"loop.duration" = 3.0', "13: sweep[0].loop.duration: must be a list of values, { linear"),
        ('"loop.duration" = { log = [0.0, 1.0, 3] }', "sweep[0].loop.duration: first and last of log must"),
        ('"loop.duration" = { log = [1.0, 3] }', "13: sweep[0].loop.duration: must be a list of values"),
        ('"loop.duration" = []', "13: sweep[0].loop.duration: no values"),
        ('"loop.duration" = [1.0, 1.0]', "12: sweep[0]: two variants are called"),
        ('"loop.duration" = { linear = [1.0, 2.0, 2000] }', "2000 values are too many; allowed: 1000"),
        (
            'zip = true\n"loop.duration" = [1.0]\n"plant.parameters.mass" = [0.1, 0.2]',
            "zip needs as many",
        ),
        ('zip = 1\n"loop.duration" = [1.0]', "13: sweep[0].zip: must be"),
        ('"scenarios.nominal.events[3].time" = [1.0]', "12: sweep[0]: a path leads into a list"),
    ],
)
def test_what_is_wrong_with_a_sweep_has_its_line(tmp_path: Path, sweep: str, expected: str) -> None:
    assert any(expected in fault for fault in faults(tmp_path, sweep))


def test_a_fault_of_the_study_is_told_once_however_many_variants_have_it(tmp_path: Path) -> None:
    text = FLAT.replace("proportional", "proportinal")
    messages = faults(tmp_path, '"loop.duration" = { linear = [2, 21, 20] }', text)
    assert len(messages) == 1
    assert messages[0].startswith("7: controllers.pid.settings.proportinal: unknown setting")


def test_a_controller_s_sweep_has_ranges_and_values_together_too(tmp_path: Path) -> None:
    sweep = "sweep = { zip = true, proportional = { log = [1, 100, 3] }, integral = [0.1, 0.2, 0.3] } }"
    text = FLAT.replace("{ proportional = 1.0 } }", "{ proportional = 1.0 }, " + sweep)
    settings = [
        section.settings
        for section in read(tmp_path, text).problem.study.controllers.values()
        if section.varied
    ]
    assert [(values["proportional"], values["integral"]) for values in settings] == [
        (1, 0.1),
        (10, 0.2),
        (100, 0.3),
    ]


def test_the_report_has_a_row_for_each_variant_and_a_part_for_the_study_itself(tmp_path: Path) -> None:
    results = run_file(write(tmp_path, FLAT + '[[sweep]]\n"plant.parameters.mass" = [0.3, 0.4]\n'))
    (unvaried,) = results.problems()
    assert (unvaried.study.name, {case.problem for case in unvaried.cases}) == ("swing", {"swing"})
    assert [variant.study.plant.parameters for variant in results.variants("swing")] == [
        {"mass": 0.3},
        {"mass": 0.4},
    ]
    page = render_page([results])
    assert page.count('<article class="study') == 1
    assert re.findall(r"<th[^>]*>((?:as it is|plant\.par)[^<]*)</th>", page) == [
        "as it is",
        "plant.parameters.mass = 0.3",
        "plant.parameters.mass = 0.4",
    ]
    frame = results.frame()
    assert list(frame["problem"].unique()) == ["swing"]
    assert list(frame["variant"].unique()) == [
        "",
        "plant.parameters.mass = 0.3",
        "plant.parameters.mass = 0.4",
    ]
