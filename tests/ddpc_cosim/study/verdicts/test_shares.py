"""Shares of the way between two reference points: their formula, their laws, and where there are none."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import CaseResult, ConfigError, Outcome, StudyResults
from ddpc_cosim.codec import read, write
from ddpc_cosim.study.file_format.sections import ReferencePoints, Study, StudyHead
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.verdicts.shares import describe_shares, share_runs, shares_of

POINTS = ReferencePoints(zero="rest", full="possible")
KEY = "mean_abs_error.angle [deg]"
Values = Mapping[str, float]


def case(
    controller: str,
    value: float,
    *,
    seed: int = 0,
    outcome: Outcome = Outcome.COMPLETED,
    failed: bool = False,
    key: str = KEY,
    problem: str = "one",
) -> CaseResult:
    metrics = {key: value, "rmse.angle [deg]": 2 * value, "time_at_bounds.torque [s]": 1.0}
    who = (f"{problem}_{controller}_{seed}", controller, controller.title(), "nominal", seed)
    head = (*who, outcome, "", ())
    return CaseResult(*head, metrics, {}, {}, (), Path(), problem=problem, failed=failed)


def share(value: float, zero: float, full: float) -> float:
    cases = [case("rest", zero, failed=True), case("possible", full), case("own", value)]
    (row,) = share_runs(cases, POINTS, [KEY])
    return row.share


def study(name: str, points: ReferencePoints | None = POINTS) -> Study:
    types = {"type": "idle"}
    return read(
        Study,
        {
            "name": name,
            "plant": {"name": "pendulum"},
            "loop": {"sampling_time": 0.1, "duration": 1.0},
            "reference": {"angle": {"kind": "constant", "value": 0.0}},
            "controllers": {"rest": types, "possible": types, "own": types, "other": types},
            "report": {"reference_points": write(points) if points else None},
        },
    )


def results(cases: list[CaseResult], points: ReferencePoints | None = POINTS) -> StudyResults:
    problems = {name: study(name, points) for name in dict.fromkeys(run.problem for run in cases)}
    return StudyResults(Path("runs"), WholeStudy(StudyHead(name="both"), problems), tuple(cases), {})


sizes = st.floats(0.01, 100.0)


@given(sizes, st.floats(0.0, 0.9), st.floats(0.01, 3.0), sizes, st.floats(-0.5, 0.5))
def test_shares_stay_as_they_are_where_a_metric_is_scaled_and_shifted(
    zero: float, possible: float, error: float, factor: float, shift: float
) -> None:
    full, value = zero * possible, zero * error
    expected = share(value, zero, full)
    moved = [factor * (level + shift * zero) for level in (value, zero, full)]
    assert share(*moved) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert share(zero, zero, full) == 0.0
    assert share(full, zero, full) == pytest.approx(1.0)
    # The better of two values has the larger share.
    assert share(value * 1.01, zero, full) < expected


def test_the_frame_has_what_the_formula_says_in_each_pair(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    cases = [
        case(name, size * float(random.lognormal(0, 0.2)), seed=seed, problem=problem, failed=name == "rest")
        for problem, scale in {"one": 1.0, "two": 300.0}.items()
        for name, size in {
            "own": 3.0 * scale,
            "possible": scale,
            "rest": 9.0 * scale,
            "other": 12 * scale,
        }.items()
        for seed in range(4)
    ]
    both = results(cases)
    for metric in ("", "rmse"):
        frame = both.frame()
        key = "rmse.angle [deg]" if metric else KEY
        wide = frame.pivot(index=["problem", "seed"], columns="controller", values=key)
        expected = (wide["rest"] - wide["own"]) / (wide["rest"] - wide["possible"])
        table = both.shares(metric)
        assert set(table["controller"]) == {"own", "other"}
        got = table[table["controller"] == "own"].set_index(["problem", "seed"])["share"]
        assert np.allclose(got, expected[got.index])
        assert (table[table["controller"] == "other"]["share"] < 0).any()


@pytest.mark.parametrize(
    ("zero", "full"),
    [
        (case("rest", 1.0, failed=True), case("possible", 1.5)),  # the way would be backwards
        (case("rest", 1.0), case("possible", 0.995)),  # next to nothing
        (case("rest", 1.0, outcome=Outcome.DIVERGED, failed=True), case("possible", 0.1)),
        (case("rest", 1.0), case("possible", 0.1, failed=True)),
        (case("rest", math.nan), case("possible", 0.1)),
        (case("rest", 1.0), case("possible", 0.1, seed=1)),
    ],
)
def test_without_a_way_there_are_no_shares(zero: CaseResult, full: CaseResult) -> None:
    (row,) = share_runs([zero, full, case("own", 0.5)], POINTS, [KEY])
    assert math.isnan(row.share)
    assert shares_of([zero, full, case("own", 0.5)], POINTS, [KEY]) == {}


def test_a_reference_point_that_is_run_once_is_set_beside_the_runs_of_all_seeds() -> None:
    full = case("possible", 1.0, seed=2)
    rest = [case("rest", 5.0 + seed, seed=seed) for seed in (2, 3, 4)]
    own = [case("own", 2.0 + seed, seed=seed) for seed in (2, 3, 4)]
    expected = {("nominal", KEY, seed): 3.0 / (4.0 + seed) for seed in (2, 3, 4)}
    once = shares_of([full, *rest, *own], POINTS, [KEY], {"possible"})["own"]
    assert {(*condition, seed): share for (condition, seed), share in once.items()} == pytest.approx(expected)
    # Said of none, seeds without it have no share.
    assert [seed for _, seed in shares_of([full, *rest, *own], POINTS, [KEY])["own"]] == [2]


def test_a_run_that_failed_has_no_share_and_is_not_averaged_away() -> None:
    ends = [
        case(name, value, seed=seed)
        for name, value in {"rest": 5.0, "possible": 1.0}.items()
        for seed in range(3)
    ]
    runs_of_own = [
        case("own", 1.0, seed=0),
        case("own", 0.9, seed=1, failed=True),
        case("own", 900.0, seed=2),
    ]
    runs = shares_of([*ends, *runs_of_own], POINTS, [KEY])["own"]
    assert [math.isnan(value) for value in runs.values()] == [False, True, False]
    summed = describe_shares(runs)
    # Of a perfect run, one that failed and one that is a hundred times worse than nothing: -100 %.
    assert (summed.runs, summed.known, summed.median) == (3, 2, -1.0)


def test_what_there_are_no_shares_of(tmp_path: Path) -> None:
    cases = [case("rest", 5.0), case("possible", 1.0), case("own", 2.0)]
    with pytest.raises(ConfigError, match=r"no reference points; needed: in \[report\]"):
        results(cases, None).shares()
    with pytest.raises(ConfigError, match='did you mean "rmse'):
        results(cases).shares("rsme")
    with pytest.raises(ConfigError, match="no value of it is better"):
        results(cases).shares("time_at_bounds")
