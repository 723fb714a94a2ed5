"""The table that `run` prints is short after a sweep, and fits the window."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from ddpc_cosim import CaseResult, Outcome, StudyResults
from ddpc_cosim.cli.summary import summary_table
from ddpc_cosim.metrics import METRICS
from ddpc_cosim.study.file_format.sections import ReferencePoints, ReportSection, Study
from ddpc_cosim.study.problems import WholeStudy

COST = "mean_abs_error.angle [deg]"
VALUES = {COST: 0.0, "settled_error.angle [deg]": 0.1, "max_abs_input.torque [N.m]": 3.0}


def study(variants: int) -> Study:
    varied = {
        f"deepc-horizon-{n}": {"type": "deepc", "variant_of": "deepc", "varied": ["horizon"]}
        for n in range(variants)
    }
    return Study.model_validate(
        {
            "name": "s",
            "title": "A study",
            "seeds": [1, 2],
            "plant": {"name": "pendulum"},
            "loop": {"sampling_time": 0.1, "duration": 1.0},
            "reference": {"angle": {"kind": "constant", "value": 1.0}},
            "controllers": {"deepc": {"type": "deepc", "label": "DeePC"}, **varied, "pid": {"type": "pid"}},
        }
    )


def results(variants: int, lost: str = "") -> StudyResults:
    """Return results in which the last variant is the best, and all cases of one controller are lost."""
    told = study(variants)
    cases = []
    for place, key in enumerate(told.controllers):
        varied = told.controllers[key].variant_of
        label = f"DeePC, horizon = {place - 1}" if varied else told.controllers[key].label or key
        for seed in told.seeds:
            figures = VALUES | {COST: 100.0 - place + 0.5 * seed, "solve_time_median [s]": 2e-5}
            outcome = Outcome.DIVERGED if key == lost else Outcome.COMPLETED
            head = (f"{key}_{seed}", key, label, "nominal", seed, outcome, "", key != lost)
            cases.append(CaseResult(*head, figures, {}, {}, (), Path(), problem="s"))
    return StudyResults(Path("out"), WholeStudy.of(told), tuple(cases), {})


def printed(some: StudyResults, width: int = 1000) -> list[str]:
    console = Console(width=width)
    with console.capture() as capture:
        console.print(summary_table(some, console))
    return capture.get().splitlines()


def test_of_a_sweep_the_two_best_settings_are_listed_and_the_others_counted() -> None:
    lines = printed(results(40))
    rows = [line for line in lines if "/2" in line or "more" in line]
    assert [row.strip().split("  ")[0] for row in rows] == [
        "DeePC",
        "horizon = 39",
        "horizon = 38",
        "and 38 settings more",
        "pid",
    ]
    assert any("out/metrics.csv" in line.replace("\\", "/") for line in lines)


def test_without_a_sweep_every_controller_has_its_row() -> None:
    lines = printed(results(0))
    assert len([line for line in lines if "/2" in line]) == 2
    assert not any("metrics.csv" in line for line in lines)


def test_a_setting_that_lost_cases_is_not_among_the_best() -> None:
    lines = printed(results(4, lost="deepc-horizon-3"))
    assert any("horizon = 2 " in line for line in lines)
    assert not any("horizon = 3 " in line for line in lines)


@pytest.mark.parametrize("width", [60, 80, 100])
def test_a_narrow_window_loses_columns_and_no_figures(width: int) -> None:
    lines = printed(results(4), width)
    assert all(len(line) <= width for line in lines)
    assert not any("…" in line for line in lines)
    assert any("mean abs error" in line for line in lines)


def test_one_seed_needs_no_range() -> None:
    some = results(0)
    first = replace(some, cases=tuple(case for case in some.cases if case.seed == 1))
    assert "over the seeds" in "".join(printed(some))
    assert "over the seeds" not in "".join(printed(first))


def seeded(seeds: int, worse: float) -> StudyResults:
    """Return results of two controllers that differ by a constant and by chance."""
    noise = np.random.default_rng(5).normal(size=(2, seeds))
    cases = []
    for place, key in enumerate(("deepc", "pid")):
        for seed in range(seeds):
            figures = VALUES | {COST: 10.0 + place * worse + noise[place, seed]}
            head = (f"{key}_{seed}", key, key, "nominal", seed, Outcome.COMPLETED, "", True)
            cases.append(CaseResult(*head, figures, {}, {}, (), Path(), problem="s"))
    return replace(results(0), cases=tuple(cases))


def test_what_the_seeds_tell_apart_has_letters_of_its_own() -> None:
    lines = printed(seeded(12, worse=9.0))
    heads = next(i for i, line in enumerate(lines) if "same letter:" in line)
    place = lines[heads].index("same letter:")
    letters = {line.split()[0]: line[place:].split()[0] for line in lines if "12/12" in line}
    assert letters == {"deepc": "a", "pid": "b"}


def test_reference_points_are_marked_and_have_no_letters() -> None:
    seen = seeded(12, worse=9.0)
    points = ReferencePoints(zero="deepc", full="pid")
    told = seen.study.model_copy(update={"report": ReportSection(reference_points=points)})
    lines = printed(replace(seen, whole=WholeStudy.of(told)))
    assert [line.strip().split("  ")[0] for line in lines if "12/12" in line] == [
        "deepc (0\u00a0%)",
        "pid (100\u00a0%)",
    ]
    assert not any("same letter" in line for line in lines)


@pytest.mark.parametrize(
    ("seeds", "words"),
    [
        (12, "12 seeds tell no two controllers apart"),
        (5, "5 seeds are too few to test so many controllers against each other: it takes 6"),
    ],
)
def test_where_the_seeds_tell_none_apart_a_line_says_so(seeds: int, words: str) -> None:
    lines = printed(seeded(seeds, worse=0.0))
    assert words in [line.strip() for line in lines]
    assert not any("same letter" in line for line in lines)


def test_the_best_settings_of_a_sweep_follow_from_the_direction_of_the_metric(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(METRICS, "mean_abs_error", replace(METRICS["mean_abs_error"], better="high"))
    rows = [line.strip().split("  ")[0] for line in printed(results(4)) if "horizon" in line]
    assert rows == ["horizon = 0", "horizon = 1"]


def test_a_step_below_a_microsecond_is_not_zero_and_one_of_a_lost_case_is_not_shown() -> None:
    some = results(0, lost="pid")
    quick = {"solve_time_median [s]": 2e-7}
    cases = tuple(replace(case, metrics=case.metrics | quick) for case in some.cases)
    deepc, pid = (line for line in printed(replace(some, cases=cases)) if "/2" in line)
    assert "0.20 us" in deepc
    assert " us" not in pid
