"""The table of what went wrong: failed runs, fallbacks and warnings, a row per reason."""

from dataclasses import replace

import numpy as np
import pytest

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_reports.comparison import conditions
from ddpc_reports.page import render_page
from ddpc_reports.tables.failures import failures_table

from ..synthetic import SAMPLING_TIME, MakeResults, make_trace

Said = list[tuple[str, str, list[str]]]


def said(results: StudyResults) -> Said:
    """Return what the table says: the kind, the reason, and controllers, cases, samples, first case, time."""
    table = failures_table(results, "x-")
    return [(row.group, row.header, [cell.text for cell in row.cells]) for row in table.rows] if table else []


def test_reasons_for_fallbacks_are_told_with_their_first_time(make_results: MakeResults) -> None:
    results = make_results(
        lambda key, seed: make_trace(0.5, fallbacks=4 if key == "slow" else 0, noise_seed=seed), seeds=[7, 8]
    )
    cells = ["slow", "2", "8", "slow, seed 7", "5.7\u00a0s"]
    assert said(results) == [("Fallbacks of controllers", "infeasible", cells)]
    assert "infeasible" in render_page([results])


def test_the_same_reason_of_several_controllers_is_one(make_results: MakeResults) -> None:
    """The one that begins 3 samples earlier is the first."""
    results = make_results(lambda key, seed: make_trace(0.5, fallbacks=4 if key == "slow" else 1))
    ((_, reason, cells),) = said(results)
    assert (reason, cells) == ("infeasible", ["quick, slow", "2", "5", "slow, seed 7", "5.7\u00a0s"])


def test_reasons_that_differ_in_a_number_are_one_with_its_range(make_results: MakeResults) -> None:
    """A number in a name is none: level_1 and level_2 are different outputs."""

    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5)
        texts = [f"level_{1 + (k == 2)} off by {k}.0e-02; held" for k in (3, 1, 2)]
        return replace(trace, status=("ok", *texts, *trace.status[4:]))

    results = make_results(trace_of, {"only": {"type": "x"}})
    assert [(reason, cells[2]) for _, reason, cells in said(results)] == [
        ("level_1 off by 1.0e-02 … 3.0e-02; held", "2"),
        ("level_2 off by 2.0e-02; held", "1"),
    ]


@pytest.mark.parametrize("outcome", [Outcome.CONTROLLER_ERROR, Outcome.TIMED_OUT, Outcome.CRASHED])
def test_the_fault_that_ends_a_case_is_no_fallback(outcome: Outcome, make_results: MakeResults) -> None:
    """A controller that raises, or never returns, leaves a row without inputs."""

    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5, outcome=outcome, reason="boom in /home/jo/own.py")
        u = np.vstack([trace.u[:-1], np.full_like(trace.u[-1:], np.nan)])
        return replace(trace, u=u, status=(*trace.status[:-1], "error"))

    results = make_results(trace_of)
    last = results.cases[0].trace().time[-1]
    assert said(results) == [
        (
            "Runs that did not complete: 2 of 2",
            f"{outcome}: boom in own.py",
            ["quick, slow", "2", "\N{EN DASH}", "quick, seed 7", f"{last:.3g}\u00a0s"],
        )
    ]
    (condition,) = conditions(results)
    assert [controller.total("failures [1]") for controller in condition.controllers] == [0, 0]


def test_runs_that_completed_and_failed_are_told_by_reason(make_results: MakeResults) -> None:
    """Lags of 30 and 40 s leave most of a step of 6 s: one reason, with both numbers."""
    lags = {7: 30.0, 8: 40.0}
    results = make_results(lambda key, seed: make_trace(lags[seed] if key == "slow" else 0.3), seeds=[7, 8])
    low, high = sorted(case.failure.split()[2] for case in results.cases if case.failed)
    (reason,) = said(results)
    assert reason == (
        "Runs that completed and failed: 2 of 4",
        f"angle ends {low} … {high} % of its task away from its reference",
        ["slow", "2", "\N{EN DASH}", "slow, seed 7", "\N{EN DASH}"],
    )


def test_a_run_without_a_sample_has_no_time(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5, outcome=Outcome.CONTROLLER_ERROR, reason="before the first sample")
        none = {name: getattr(trace, name)[:0] for name in ("time", "reference", "y", "measured", "u")}
        return replace(trace, **none, status=(), solve_time=trace.solve_time[:0])

    ((_, _, cells),) = said(make_results(trace_of))
    assert cells[-1] == "\N{EN DASH}"


def test_a_run_that_starts_late_tells_its_own_time(make_results: MakeResults) -> None:
    loop = {"sampling_time": SAMPLING_TIME, "duration": 6.0, "start_time": 100.0}
    results = make_results(lambda key, seed: make_trace(0.5, outcome=Outcome.CRASHED), loop=loop)
    ((_, reason, cells),) = said(results)
    rows = len(results.cases[0].trace())
    assert (reason, cells[-1]) == ("crashed", f"{100 + SAMPLING_TIME * (rows - 1):.4g}\u00a0s")


def test_a_late_moment_is_told_as_people_say_it(make_results: MakeResults) -> None:
    """A week and an hour after the start of its year."""
    loop = {"sampling_time": SAMPLING_TIME, "duration": 6.0, "start_time": 7 * 86400.0 + 3594.3}
    results = make_results(
        lambda key, seed: replace(
            trace := make_trace(0.5, fallbacks=4), time=trace.time + loop["start_time"]
        ),
        loop=loop,
    )
    ((*_, cells),) = said(results)
    assert cells[-1] == "7\u00a0d\u00a01\u00a0h"


def test_warnings_before_the_loop_are_told_with_their_cases(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        warned = (f"a dead time of {seed} samples",) if key == "slow" else ()
        return replace(make_trace(0.5, noise_seed=seed), warnings=warned)

    results = make_results(trace_of, seeds=[7, 8], scenarios={"calm": {"label": "Calm"}, "noisy": {}})
    cells = ["slow", "4", "\N{EN DASH}", "slow, Calm, seed 7", "\N{EN DASH}"]
    assert said(results) == [("Warnings before the loop", "a dead time of 7 … 8 samples", cells)]


def test_there_is_no_table_where_nothing_went_wrong(make_results: MakeResults) -> None:
    assert failures_table(make_results(lambda key, seed: make_trace(0.5)), "x-") is None


def test_a_thousand_cases_that_fail_alike_are_one_line(make_results: MakeResults) -> None:
    results = make_results(
        lambda key, seed: make_trace(0.5, outcome=Outcome.CRASHED, reason=f"at step {seed}")
    )
    cases = tuple(replace(case, id=f"{case.id}{n}", seed=n) for case in results.cases for n in range(500))
    ((kind, reason, cells),) = said(replace(results, cases=cases))
    assert (kind, reason) == ("Runs that did not complete: 1000 of 1000", "crashed: at step 7")
    assert cells[:2] == ["quick, slow", "1\u202f000"]


def test_of_very_many_reasons_the_most_frequent_are_listed(make_results: MakeResults) -> None:
    letters = [chr(ord("a") + n) for n in range(25)]

    def trace_of(key: str, seed: int) -> Trace:
        return replace(make_trace(0.5), warnings=tuple(f"of kind {letter}" for letter in letters))

    rows = said(make_results(trace_of))
    assert len(rows) == 21
    assert rows[-1][1:] == ("5 other reasons", ["quick, slow", "2", *["\N{EN DASH}"] * 3])
