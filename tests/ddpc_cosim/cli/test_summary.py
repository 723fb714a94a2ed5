"""The table that `run` prints is short after a sweep, and fits the window."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from ddpc_cosim import CaseResult, Outcome, StudyResults
from ddpc_cosim.cli.results import show_results
from ddpc_cosim.cli.summary import overall_table, summary_table
from ddpc_cosim.codec import read
from ddpc_cosim.metrics import METRICS
from ddpc_cosim.study.file_format.sections import ReferencePoints, RelevantSection, ReportSection, Study
from ddpc_cosim.study.problems import WholeStudy

COST = "mean_abs_error.angle [deg]"
VALUES = {COST: 0.0, "settled_error.angle [deg]": 0.1, "max_abs_input.torque [N.m]": 3.0}


def study(variants: int) -> Study:
    varied = {
        f"deepc-horizon-{n}": {"type": "deepc", "variant_of": "deepc", "varied": ["horizon"]}
        for n in range(variants)
    }
    return read(
        Study,
        {
            "name": "s",
            "title": "A study",
            "seeds": [1, 2],
            "plant": {"name": "pendulum"},
            "loop": {"sampling_time": 0.1, "duration": 1.0},
            "reference": {"angle": {"kind": "constant", "value": 1.0}},
            "controllers": {"deepc": {"type": "deepc", "label": "DeePC"}, **varied, "pid": {"type": "pid"}},
        },
    )


def results(variants: int, failing: str = "") -> StudyResults:
    """Return results in which the last variant is the best, and all cases of one controller failed."""
    declared = study(variants)
    cases = []
    for place, key in enumerate(declared.controllers):
        varied = declared.controllers[key].variant_of
        label = f"DeePC, horizon = {place - 1}" if varied else declared.controllers[key].label or key
        for seed in declared.seeds:
            figures = VALUES | {COST: 100.0 - place + 0.5 * seed, "solve_time_median [s]": 2e-5}
            outcome = Outcome.DIVERGED if key == failing else Outcome.COMPLETED
            head = (f"{key}_{seed}", key, label, "nominal", seed, outcome, "", ())
            cases.append(CaseResult(*head, figures, {}, {}, (), Path(), problem="s", failed=key == failing))
    return StudyResults(Path("out"), WholeStudy.of(declared), tuple(cases), {})


def printed(some: StudyResults, width: int = 1000) -> list[str]:
    console = Console(width=width)
    with console.capture() as capture:
        console.print(summary_table(some, console), crop=False)
    return capture.get().splitlines()


def ranked(lines: list[str]) -> list[tuple[str, str]]:
    """Return rank and name of each row."""
    first = next(i for i, line in enumerate(lines) if "───" in line) + 1
    rows = lines[first : next(i for i, line in enumerate(lines) if i >= first and not line.strip())]
    cells = [re.split(r" {2,}", row.strip()) for row in rows]
    return [(row[0], row[1]) if re.fullmatch(r"\d+(-\d+)?|-", row[0]) else ("", row[0]) for row in cells]


def test_of_a_sweep_the_two_best_settings_are_listed_and_the_others_counted() -> None:
    lines = printed(results(40))
    assert ranked(lines) == [
        ("1", "pid"),
        ("2", "DeePC"),
        ("-", "horizon = 39"),
        ("-", "horizon = 38"),
        ("", "and 38 settings more"),
    ]
    assert any("every setting: out/metrics.csv" in line.replace("\\", "/") for line in lines)


def test_without_a_sweep_every_controller_has_its_row() -> None:
    lines = printed(results(0))
    assert len(ranked(lines)) == 2
    assert not any("metrics.csv" in line for line in lines)


def test_a_setting_with_failed_cases_is_not_among_the_best() -> None:
    names = [name for _, name in ranked(printed(results(4, failing="deepc-horizon-3")))]
    assert "horizon = 2" in names
    assert "horizon = 3" not in names


def test_who_has_failed_runs_comes_last_with_their_count_in_red() -> None:
    some = results(0, failing="pid")
    assert ranked(printed(some)) == [("1", "DeePC"), ("2", "pid")]
    console = Console(width=80, force_terminal=True, color_system="standard")
    with console.capture() as capture:
        console.print(summary_table(some, console))
    (pid,) = (line for line in capture.get().splitlines() if "pid" in line)
    assert "\x1b[31m   2/2\x1b[0m" in pid


@pytest.mark.parametrize(("width", "count"), [(40, 4), (60, 3), (80, 1), (100, 0)])
def test_a_narrow_window_loses_columns_and_tells_which(width: int, count: int) -> None:
    """The first to go is what says least; no line is too long, and no word is broken."""
    lines = printed(results(4), width)
    assert all(len(line) <= width for line in lines)
    text = " ".join(" ".join(lines).replace("\\", "/").split())
    assert "mean absolute error of angle [deg]: medians; ranked by" in text
    columns = ["range", "settled error of angle", "peak input of torque", "median step time"]
    not_shown = re.search("not shown: (.*?): out/metrics.csv", text)
    assert (not_shown[1].split("; ") if not_shown else []) == columns[len(columns) - count :]
    heads = " ".join(lines[: next(i for i, line in enumerate(lines) if "───" in line)]).split()
    assert [name.split()[0] in heads for name in columns] == [True] * (4 - count) + [False] * count


def test_long_names_are_clipped_with_an_ellipsis() -> None:
    some = results(0)
    long = tuple(replace(case, label=f"{case.label} {'very ' * 40}long") for case in some.cases)
    lines = printed(replace(some, cases=long), 80)
    assert max(map(len, lines)) <= 80
    assert [name[:8] + name[-1] for _, name in ranked(lines)] == ["pid very…", "DeePC ve…"]


def test_titles_and_labels_of_any_length_leave_a_table_to_read() -> None:
    some, long = results(0), "x" * 10_000
    scenario = replace(some.study.scenarios["nominal"], label=long)
    study = replace(some.study, title=long, scenarios={"calm": scenario, "windy": scenario})
    cases = tuple(
        replace(case, scenario=name, label=long) for case in some.cases for name in ("calm", "windy")
    )
    lines = printed(replace(some, whole=WholeStudy.of(study), cases=cases), 80)
    assert len(lines) < 15
    assert max(map(len, lines[1:])) <= 80


def test_of_several_scenarios_each_has_a_column() -> None:
    some = results(0)
    windy = [replace(case, scenario="windy") for case in some.cases]
    diverged = replace(windy[0], outcome=Outcome.DIVERGED, failed=True)
    calm = [replace(case, scenario="calm") for case in some.cases]
    study = replace(
        some.study,
        scenarios={"calm": some.study.scenarios["nominal"], "windy": some.study.scenarios["nominal"]},
    )
    seen = replace(some, whole=WholeStudy.of(study), cases=(*calm, diverged, *windy[1:]))
    lines = printed(seen, 80)
    assert ranked(lines) == [("1", "pid"), ("2", "DeePC")]
    heads = next(line for line in lines if "controller" in line)
    assert heads.split() == ["rank", "controller", "runs", "calm", "windy"]
    (deepc,) = (line.split() for line in lines if " DeePC " in line)
    assert deepc[2] == "1/4"
    assert deepc[4].endswith("*")
    text = " ".join(" ".join(lines).split())
    assert "not shown: range; settled error; peak input; median step time: " in text


def test_one_seed_needs_no_range() -> None:
    some = results(0)
    first = replace(some, cases=tuple(case for case in some.cases if case.seed == 1))
    assert "range" in "".join(printed(some))
    assert "range" not in "".join(printed(first))
    assert "(seed 1)" in printed(first)[0]


def seeded(seeds: int, worse: float) -> StudyResults:
    """Return results of two controllers that differ by a constant and by chance."""
    noise = np.random.default_rng(5).normal(size=(2, seeds))
    cases = []
    for place, key in enumerate(("deepc", "pid")):
        for seed in range(seeds):
            figures = VALUES | {COST: 10.0 + place * worse + noise[place, seed]}
            head = (f"{key}_{seed}", key, key, "nominal", seed, Outcome.COMPLETED, "", ())
            cases.append(CaseResult(*head, figures, {}, {}, (), Path(), problem="s"))
    return replace(results(0), cases=tuple(cases))


def test_what_the_seeds_do_not_tell_apart_has_the_same_ranks() -> None:
    assert ranked(printed(seeded(12, worse=9.0))) == [("1", "deepc"), ("2", "pid")]
    assert [rank for rank, _ in ranked(printed(seeded(12, worse=0.0)))] == ["1-2", "1-2"]


def test_where_scenarios_disagree_there_is_no_rank_and_a_line_says_who_leads_where() -> None:
    calm = seeded(12, worse=9.0)
    other = {"deepc": "pid", "pid": "deepc"}
    windy = [
        replace(case, controller=other[case.controller], label=other[case.controller], scenario="windy")
        for case in calm.cases
    ]
    lines = printed(replace(calm, cases=(*calm.cases, *windy)))
    assert [rank for rank, _ in ranked(lines)] == ["", ""]
    said = "the scenarios disagree, so there is no overall rank: deepc leads in nominal; pid leads in windy"
    assert said in [line.strip() for line in lines]


def test_reference_points_are_marked_and_have_no_rank() -> None:
    seen = seeded(12, worse=9.0)
    points = ReferencePoints(zero="deepc", full="pid")
    with_points = replace(seen.study, report=ReportSection(reference_points=points))
    lines = printed(replace(seen, whole=WholeStudy.of(with_points)))
    assert [name for _, name in ranked(lines)] == ["deepc (0\u00a0%)", "pid (100\u00a0%)"]
    assert "rank" not in "".join(lines).split()


@pytest.mark.parametrize(
    ("seeds", "words"),
    [
        (12, "pid and deepc lead over 12 seeds and are not told apart"),
        (5, "5 seeds are too few to test 2 controllers against each other: it takes 6"),
    ],
)
def test_where_the_seeds_tell_none_apart_a_line_says_so(seeds: int, words: str) -> None:
    assert words in [line.strip() for line in printed(seeded(seeds, worse=0.0))]


@pytest.mark.parametrize(
    ("absolute", "line"),
    [
        (20.0, "deepc and pid lead over 12 seeds, and no difference between them matters"),
        (
            9.1,
            "deepc and pid lead over 12 seeds and none of them is significantly better by enough to matter",
        ),
    ],
)
def test_where_no_difference_matters_a_line_says_so(absolute: float, line: str) -> None:
    some = seeded(12, worse=9.0)
    metrics = replace(some.study.metrics, relevant=RelevantSection(absolute=absolute))
    whole = WholeStudy.of(replace(some.study, metrics=metrics))
    assert line in [printed_line.strip() for printed_line in printed(replace(some, whole=whole))]


def test_the_best_settings_of_a_sweep_follow_from_the_direction_of_the_metric(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(METRICS, "mean_abs_error", replace(METRICS["mean_abs_error"], better="high"))
    rows = [name for _, name in ranked(printed(results(4))) if "horizon" in name]
    assert rows == ["horizon = 0", "horizon = 1"]


def test_a_step_below_a_microsecond_is_not_zero_and_one_of_a_failed_case_is_not_shown() -> None:
    some = results(0, failing="pid")
    quick = {"solve_time_median [s]": 2e-7}
    cases = tuple(replace(case, metrics=case.metrics | quick) for case in some.cases)
    deepc, pid = (line for line in printed(replace(some, cases=cases)) if "/2" in line)
    assert "0.20 us" in deepc
    assert " us" not in pid


def test_one_controller_alone_has_no_rank_and_is_not_bold() -> None:
    some = results(0)
    alone = replace(some, cases=tuple(case for case in some.cases if case.controller == "pid"))
    console = Console(width=200, force_terminal=True, color_system="standard")
    with console.capture() as capture:
        console.print(summary_table(alone, console))
    (pid,) = (line for line in capture.get().splitlines() if " pid " in line)
    assert pid.split()[0] == "pid"
    assert "\x1b[1m" not in pid


@pytest.mark.parametrize(("seeds", "bold"), [(1, []), (5, []), (12, ["deepc"])])
def test_who_leads_is_bold_only_where_the_seeds_tell_it(seeds: int, bold: list[str]) -> None:
    console = Console(width=200, force_terminal=True, color_system="standard")
    with console.capture() as capture:
        console.print(summary_table(seeded(seeds, worse=9.0), console))
    assert re.findall("\x1b\\[1m *(deepc|pid)", capture.get()) == bold


def test_several_problems_are_summed_up_by_average_rank() -> None:
    """Where two agree and one does not, the average is (1 + 1 + 2) / 3 against (2 + 2 + 1) / 3."""
    problems = [
        replace(seen, whole=WholeStudy.of(replace(seen.study, name=f"p{number}")))
        for number, seen in enumerate((seeded(12, 9.0), seeded(12, 9.0), seeded(12, -9.0)))
    ]
    console = Console(width=80)
    with console.capture() as capture:
        console.print(overall_table(problems, console))
    rows = [line.split() for line in capture.get().splitlines()]
    assert ["controller", "average", "rank", "p0", "p1", "p2"] in rows
    assert ["deepc", "1.33", "1", "1", "2"] in rows
    assert ["pid", "1.67", "2", "2", "1"] in rows
    assert overall_table(problems[:1], console) is None


def test_where_every_run_failed_nothing_is_ranked_and_the_metric_has_its_name() -> None:
    some = results(0, failing="pid")
    cases = tuple(replace(case, failed=True, failure="far off") for case in some.cases)
    problems = [
        replace(some, cases=cases, whole=WholeStudy.of(replace(some.study, name=name)))
        for name in ("one", "two")
    ]
    lines = printed(problems[0])
    assert [line.split()[0] for line in lines if "2/2" in line] == ["DeePC", "pid"]
    assert lines[-1].strip() == "mean absolute error of angle [deg]: medians"
    assert overall_table(problems, Console(width=80)) is None


def test_runs_that_completed_and_failed_are_one_line_per_reason_and_no_error(
    capsys: pytest.CaptureFixture[str],
) -> None:
    some = results(0)
    cases = tuple(
        replace(case, failed=True, failure=f"angle ends {60 + case.seed} % of its task away", settles=False)
        if case.controller == "pid"
        else replace(case, settles=case.seed > 1)
        for case in some.cases
    )
    assert show_results(replace(some, cases=cases), report=False) == 0
    output = capsys.readouterr()
    assert output.err.splitlines() == [
        "pid_1 and 1 more: completed, failed: angle ends 61 % of its task away"
    ]
    assert "Does not settle within 5 %: DeePC in 1 of 2 runs." in output.out.splitlines()
    early = replace(cases[0], failed=True, outcome=Outcome.DIVERGED, reason="angle is NaN")
    assert show_results(replace(some, cases=(early, *cases[1:])), report=False) == 1
    assert "deepc_1: diverged: angle is NaN" in capsys.readouterr().err.splitlines()
