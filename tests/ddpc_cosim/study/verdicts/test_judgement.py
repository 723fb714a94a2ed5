"""What is said of runs that failed and of those that do not settle, and nothing where there are none."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.codec import read
from ddpc_cosim.responses import EndWindow, Tracking
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.judgement import (
    WHY,
    Remark,
    all_failed,
    judged,
    none_settles,
    scenario_remarks,
    unsettled,
)

FAR = "y ends 90 % of its task away from its reference"


def case(
    controller: str,
    left: float = math.inf,
    *,
    outcome: Outcome = Outcome.COMPLETED,
    failure: str = "",
    scenario: str = "nominal",
    at_limits: float = 0.0,
    warnings: tuple[str, ...] = (),
) -> CaseResult:
    """Return a case that leaves so much of a step [%], with its input at its limits so long [s] of 10 s."""
    head = ("id", controller, controller, scenario, 0, outcome, "", ())
    return CaseResult(
        *head,
        {"time_at_bounds.u [s]": at_limits},
        {},
        {},
        warnings,
        Path(),
        failed=bool(failure) or outcome is not Outcome.COMPLETED,
        failure=failure,
        settles=None if math.isnan(left) else left <= 5.0,
        left=left,
    )


CRASHED = case("a", outcome=Outcome.CRASHED)


@pytest.mark.parametrize(
    ("cases", "sentence"),
    [
        ([case("a", 5.0), case("b", 60.0, failure=FAR)], ""),
        (
            [case("a", 42.0), case("b", 60.0)],
            "No controller settles within 5 %: the best leaves 42 % of a step",
        ),
        ([case("a", 7.25)], "No controller settles within 5 %: the best leaves 7.2 % of a step"),
        ([case("a", math.nan)], ""),  # a reference that always moves: nothing to size an error by
        # Over the seeds it is the median.
        ([case("a", 3.0), case("a", 90.0), case("a", 4.0)], ""),
        (
            [case("a", 3.0), case("a", 90.0), case("a", 80.0)],
            "No controller settles within 5 %: the best leaves 80 % of a step",
        ),
        # A run that ends early leaves more than any number.
        (
            [case("a", 3.0), CRASHED, CRASHED, case("b", 30.0)],
            "No controller settles within 5 %: the best leaves 30 % of a step",
        ),
        (
            [case("a", 3.0), CRASHED, CRASHED],
            "No controller settles in most of its runs: at least half of the runs of each fail",
        ),
        ([CRASHED, CRASHED, case("a", math.nan)], ""),
        ([], ""),
    ],
)
def test_that_none_settles_is_said_where_it_is_true(cases: list[CaseResult], sentence: str) -> None:
    assert none_settles(cases) == sentence


@pytest.mark.parametrize(
    ("cases", "sentence"),
    [
        ([CRASHED, case("b", 60.0)], ""),
        ([CRASHED, case("b", outcome=Outcome.DIVERGED)], "Every controller fails: none completes a run"),
        (
            [CRASHED, case("b", 95.0, failure="far"), case("b", 90.0, failure=FAR)],
            f"Every controller fails; in the best run, {FAR}",
        ),
        ([], ""),
    ],
)
def test_that_all_failed_is_said_where_it_is_true(cases: list[CaseResult], sentence: str) -> None:
    assert all_failed(cases) == sentence


def study_of_three(limitations: list[str], **changes: Any) -> Study:
    return read(
        Study,
        {
            "name": "s",
            "seeds": [0],
            "plant": {"name": "pendulum"},
            "loop": {"sampling_time": 0.1, "duration": 10.0},
            "reference": {"angle": {"kind": "constant", "value": 1.0}},
            "controllers": {name: {"type": "pid"} for name in ("a", "b", "rest", "full")},
            "report": {"limitations": limitations, **changes},
            "scenarios": {"calm": {}, "storm": {"label": "in a storm"}, "blind": {}},
        },
    )


def test_scenarios_are_told_apart_and_a_likely_reason_is_named() -> None:
    study = study_of_three(["One seed only."])
    cases = [case("a", 1.0, scenario="calm"), case("a", 30.0, scenario="storm", at_limits=8.0)]
    cases.append(case("a", 90.0, scenario="blind", failure=FAR, warnings=("the recording is poor", "too")))
    assert scenario_remarks(study, cases) == [
        Remark(
            "in a storm: No controller settles within 5 %: the best leaves 30 % of a step; "
            "at its limits: u 80 % of the time",
            is_failure=False,
        ),
        Remark(
            f"blind: Every controller fails; in the best run, {FAR}; the recording is poor", is_failure=True
        ),
    ]


def test_a_warning_of_one_controller_is_not_the_reason_for_all() -> None:
    cases = [case("a", 30.0, warnings=("the recording is poor",)), case("b", 40.0)]
    (remark,) = scenario_remarks(study_of_three([]), cases)
    assert remark.text.endswith("the best leaves 30 % of a step")


def test_the_reason_that_the_study_gives_comes_before_what_was_warned_of() -> None:
    study = study_of_three([f"{WHY}y does not go above 12"])
    cases = [case("a", 30.0, scenario="blind", warnings=("the recording is poor",))]
    (remark,) = scenario_remarks(study, cases)
    assert remark.text == (
        "No controller settles within 5 %: the best leaves 30 % of a step; y does not go above 12"
    )
    assert scenario_remarks(study, [case("a", 3.0, scenario="blind")]) == []


def test_whose_runs_do_not_settle_is_counted_without_those_that_failed_and_the_reference_points() -> None:
    study = study_of_three([], reference_points={"zero": "rest", "full": "full"})
    cases = [case("rest", 99.0), case("a", 3.0), case("a", 30.0), case("a", 90.0, failure=FAR), CRASHED]
    cases += [case("b", 6.0, scenario=name) for name in study.scenarios] + [case("full", math.nan)]
    assert unsettled(study, cases) == "Does not settle within 5 %: a in 1 of 4 runs, b in 3 of 3 runs"
    assert unsettled(study, [case("a", 3.0), case("b", math.nan), CRASHED]) == ""


def tracking(end: float, error: float, step: float = 0.0, *, deviation: float = 0.0) -> Tracking:
    """Return what an output says that ends off its reference, and is off it on average; its task is 2."""
    window = EndWindow(10, end, end, step, settling=True)
    return Tracking("y", 2.0, math.inf, 1.0, deviation, 0.0, error, ends=(window,))


def concluded(followed: Tracking, nothing: Tracking | None = None) -> CaseResult:
    run = replace(case("a"), tracking=(followed,))
    resting = {("", "nominal", 0): replace(run, tracking=(nothing,))} if nothing else {}
    (result,) = judged({}, [run], resting)
    return result


@pytest.mark.parametrize(("end", "failed"), [(0.99, False), (1.01, True)])
def test_a_run_fails_that_ends_further_than_half_of_its_task_away(end: float, failed: bool) -> None:
    result = concluded(tracking(end, 0.1))
    assert (result.failed, bool(result.failure)) == (failed, failed)
    early = replace(case("a", outcome=Outcome.TIMED_OUT), tracking=(tracking(0.0, 0.0),))
    (early,) = judged({}, [early], {})
    assert (early.failed, early.settles, early.left) == (True, False, math.inf)


@pytest.mark.parametrize(("error", "failed"), [(0.519, False), (0.521, True)])
def test_a_run_fails_that_is_worse_than_doing_nothing_by_more_than_a_hundredth(
    error: float, failed: bool
) -> None:
    assert not concluded(tracking(0.0, error)).failed
    result = concluded(tracking(0.0, error), tracking(0.9, 0.5))
    assert result.failed == failed
    assert result.failure == failed * (
        "y is worse than doing nothing: mean error 26 % of the task, doing nothing 25 % of it"
    )


def test_what_is_out_of_all_proportion_has_no_number() -> None:
    far_off = concluded(tracking(1e9, 1e9))
    assert far_off.failure == "y ends more than 100 times its task away from its reference"


def test_a_task_is_as_large_as_what_happens_while_nothing_is_done() -> None:
    assert concluded(tracking(1.5, 0.1)).failed
    assert not concluded(tracking(1.5, 0.1), tracking(0.0, 4.0, deviation=4.0)).failed


@pytest.mark.parametrize(("step", "settles"), [(0.0, False), (2.0, False), (4.0, True)])
def test_what_is_left_is_in_parts_of_a_step_or_of_the_task(step: float, settles: bool) -> None:
    result = concluded(tracking(0.15, 0.1, step))
    assert result.settles == settles
    assert result.left == pytest.approx(15.0 / (step or 2.0))


def within_band(
    end: float,
    error: float = 0.0,
    *,
    width: float = 4.0,
    travel: float = 0.0,
    gone: float = 0.0,
) -> Tracking:
    """Return what an output says that ends so far from its band, and gets so far from it."""
    window = EndWindow(10, end, end, width, settling=True)
    return Tracking("y", travel, math.inf, 20.0, gone, 0.0, error, ends=(window,), width=width)


def test_a_run_that_stays_in_its_band_neither_fails_nor_does_not_settle() -> None:
    """Doing nothing stays there too, or not."""
    for gone in (0.0, 16.0):
        stays = concluded(within_band(0.0), within_band(gone, gone, gone=gone))
        assert (stays.failed, stays.settles, stays.left) == (False, True, 0.0)


@pytest.mark.parametrize(
    ("width", "travel", "gone", "size"),
    [
        (4.0, 0.0, 0.0, 4.0),
        (4.0, 6.0, 0.0, 6.0),
        (4.0, 6.0, 10.0, 10.0),
        (4.0, 0.0, 1e6, 12.0),  # a plant that is left alone may run away as far as it likes
    ],
)
def test_the_task_of_a_band_is_its_width_its_travel_or_what_doing_nothing_leaves(
    width: float, travel: float, gone: float, size: float
) -> None:
    nothing = within_band(gone, 2.0 * size, gone=gone)
    assert concluded(within_band(0.0, width=width, travel=travel), nothing).tasks == {"y": size}
    for share, failed in ((0.49, False), (0.51, True)):
        far = concluded(within_band(share * size, width=width, travel=travel), nothing)
        assert far.failed is failed
        assert not failed or far.failure == "y ends 51 % of its task away from its band"


@pytest.mark.parametrize(("end", "settles"), [(0.19, True), (0.21, False)])
def test_a_run_settles_that_leaves_five_percent_of_its_band(end: float, settles: bool) -> None:
    run = concluded(within_band(end, end), within_band(16.0, 16.0, gone=16.0))
    assert (run.failed, run.settles) == (False, settles)
    assert none_settles([run]) == (
        "" if settles else "No controller settles within 5 %: the best leaves 5.2 % of a band"
    )


def test_who_leaves_its_band_more_than_doing_nothing_fails() -> None:
    run = concluded(within_band(0.1, 0.6), within_band(0.0, 0.1, gone=0.5))
    assert (
        run.failure == "y is worse than doing nothing: mean error 15 % of the task, doing nothing 2.5 % of it"
    )


def test_while_a_declared_disturbance_moves_nothing_is_to_settle() -> None:
    """What doing nothing lets go by is the task, and half of it a failure, whether it settles or not."""
    moving = EndWindow(20, 0.4, 0.4, settling=True, disturbed=True)
    follows = Tracking("y", 0.0, math.inf, 1.0, 1.0, 0.0, 0.4, ends=(moving,))
    nothing = replace(follows, deviation=2.0, mean_abs_error=1.5)
    run = concluded(follows, nothing)
    assert (run.failed, run.settles, run.tasks) == (False, None, {"y": 2.0})
    assert math.isnan(run.left)
    far = replace(follows, ends=(replace(moving, error=0.0, magnitude=1.1),))
    assert concluded(far, nothing).failure == "y ends 55 % of its task away from its reference"


def test_declared_disturbances_make_their_scatter_unavoidable() -> None:
    for is_disturbed, settles in ((False, False), (True, True)):
        noisy = replace(within_band(0.4, 0.4), scatter=0.5, is_disturbed=is_disturbed)
        assert concluded(noisy).settles is settles
