"""What changed from one run to another: the medians, the differences in pairs, and what the studies say."""

from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import CaseResult, Outcome, StudyResults
from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.verdicts.baselines import Verdict
from ddpc_cosim.study.verdicts.changes import Change, changes_between

KEY = "mean_abs_error.y [K]"
TABLES: dict[str, Any] = {
    "plant": {"name": "p"},
    "loop": {"sampling_time": 0.1, "duration": 1.0},
    "reference": {"y": {"kind": "constant", "value": 1.0}},
    "controllers": {name: {"type": name} for name in ("a", "b")},
}


def results(
    values: dict[str, list[float]], failed: tuple[str, int] = ("", 0), key: str = KEY, **changes: Any
) -> StudyResults:
    study = read(Study, {"name": "s"} | TABLES | changes)
    cases = tuple(
        CaseResult(
            *(f"{name}{seed}", name, name, "nominal", seed, Outcome.COMPLETED, "", ()),
            *({key: value, "solve_time_mean [s]": seed + 1.0}, {}, {}, (), Path()),
            problem=study.name,
            failed=(name, seed) == failed,
        )
        for name, of_seeds in values.items()
        for seed, value in enumerate(of_seeds)
    )
    return StudyResults(Path(), WholeStudy.of(study), cases, {"date": "now", "numpy version": "2"})


def changed(before: StudyResults, after: StudyResults) -> dict[str, Change]:
    return {change.controller: change for change in changes_between(before, after).ranked}


@given(st.lists(st.tuples(st.floats(1, 10), st.floats(1, 10)), min_size=1, max_size=9))
def test_a_change_is_after_less_before_in_pairs_of_a_seed(pairs: list[tuple[float, float]]) -> None:
    old, new = (list(values) for values in zip(*pairs, strict=True))
    change = changed(results({"a": old}), results({"a": new}))["a"]
    assert change.before.median == pytest.approx(median(old))
    assert change.after.median == pytest.approx(median(new))
    assert change.difference.median == pytest.approx(median(b - a for a, b in pairs), abs=1e-8)
    assert change.percent == pytest.approx(100 * change.difference.median / median(old))
    assert (change.verdict is Verdict.SAME) == (old == new)


STEADY = [2.0, 2.1, 2.2, 2.3, 2.4, 2.5]


@pytest.mark.parametrize(
    ("new", "verdict", "tested"),
    [
        ([1.0, 1.1, 1.0, 1.2, 0.9, 1.0], Verdict.BETTER, True),
        ([3.0, 3.1, 3.0, 3.2, 2.9, 3.0], Verdict.WORSE, True),
        ([1.0, 3.1, 1.0, 3.2, 0.9, 3.4], Verdict.LEVEL, True),
        ([2.001, 2.101, 2.202, 2.302, 2.401, 2.502], Verdict.SMALL, True),
        (STEADY, Verdict.SAME, True),
        ([1.0, 1.1], Verdict.BETTER, False),
    ],
)
def test_verdicts_are_told_by_the_seeds_and_by_what_matters(
    new: list[float], verdict: Verdict, tested: bool
) -> None:
    change = changed(results({"a": STEADY[: len(new)]}), results({"a": new}))["a"]
    assert (change.verdict, change.tested) == (verdict, tested)


def test_runs_that_failed_are_counted_and_nothing_is_told_of_the_others() -> None:
    change = changed(results({"a": STEADY}), results({"a": [1.0] * 6}, ("a", 5)))["a"]
    assert (change.failed, change.verdict, change.difference.pairs) == ((0, 1), Verdict.FAILED, 5)
    assert change.before.median == median(STEADY[:5])
    failing = results({"a": STEADY}, ("a", 5))
    assert changed(failing, failing)["a"].verdict is Verdict.SAME


def test_of_next_to_nothing_there_is_no_percentage() -> None:
    change = changed(results({"a": [0.0] * 6}), results({"a": STEADY}))["a"]
    assert change.percent != change.percent
    assert change.difference.median == pytest.approx(2.25)


def test_what_the_studies_say_differently_is_told_by_its_path() -> None:
    controllers = {"a": {"type": "a", "settings": {"gain": 2.0}}, "c": {"type": "c"}}
    before = results({"a": STEADY, "b": STEADY})
    after = results({"a": STEADY, "c": [1.0]}, name="t", controllers=controllers)
    after = replace(after, provenance={"date": "later", "numpy version": "3", "new": "x"})
    changes = changes_between(before, after)
    assert changes.settings["controllers.a.settings.gain"] == (None, "2.0")
    assert changes.settings["name"] == ("s", "t")
    assert changes.settings["controllers.b.type"] == ("b", None)
    assert changes.settings["controllers.c.type"] == (None, "c")
    assert "loop.duration" not in changes.settings
    assert changes.provenance == {"numpy version": ("2", "3"), "new": (None, "x")}
    assert changes.only_before == tuple(f"b{seed}" for seed in range(6))
    assert changes.only_after == ("c0",)
    assert [change.controller for change in changes.changes] == ["a"]


def test_times_of_computation_are_never_the_same_twice_and_left_out() -> None:
    keys = {change.key for change in changes_between(results({"a": STEADY}), results({"a": STEADY})).changes}
    assert keys == {KEY}
