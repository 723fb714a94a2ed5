"""Scenarios beside each other, several outputs in short, and the reasons for fallbacks."""

import re
from dataclasses import replace

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_reports.across import across_statements, across_table
from ddpc_reports.comparison import conditions
from ddpc_reports.fallbacks import fallbacks_table
from ddpc_reports.page import render_page
from ddpc_reports.verdict import verdict
from ddpc_reports.verdict_table import verdict_table

from .synthetic import ANGLE, FORCE, SPEED, TORQUE, MakeResults, make_trace

SCENARIOS = {"calm": {}, "noisy": {"label": "Noisy", "noise": {"angle": 0.01}}}
COST = "sum_abs_error.angle [deg]"


def plain(text: object) -> str:
    return re.sub("<[^>]*>", "", str(text))


def median_cost(results: StudyResults, controller: str, scenario: str) -> float:
    (case,) = (c for c in results.cases if (c.controller, c.scenario) == (controller, scenario))
    return case.metrics[COST]


def test_scenarios_stand_beside_each_other(make_results: MakeResults) -> None:
    results = make_results(scenarios=SCENARIOS)
    table = across_table(conditions(results), "x-")
    assert table is not None
    assert [heading.title for heading in table.headings] == ["Controller", "calm", "Noisy"]
    row = next(row for row in table.rows if row.group == "tracking cost of angle / °" and row.key == "quick")
    assert [cell.raw for cell in row.cells] == [median_cost(results, "quick", name) for name in SCENARIOS]
    assert [cell.best for cell in row.cells] == [True, True]
    (statement,) = across_statements(conditions(results))
    assert plain(statement.text) == "quick has the smallest tracking cost in calm and Noisy."


def test_one_scenario_has_nothing_beside_it(make_results: MakeResults) -> None:
    results = make_results()
    assert across_table(conditions(results), "x-") is None
    assert across_statements(conditions(results)) == []
    assert "Scenarios beside each other" not in render_page([results])


def test_several_outputs_are_told_in_one_statement_each(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        lag = 0.3 if key == "quick" else 1.0
        return make_trace(lag, outputs=(ANGLE, SPEED), inputs=(TORQUE, FORCE), noise_seed=seed)

    (condition,) = conditions(make_results(trace_of, seeds=[7, 8, 9]))
    told = {topic: plain(text) for topic, text in verdict(condition)}
    assert told["Tracking"].startswith(
        "Absolute integral error, medians over 3 seeds and ranges:angle: quick"
    )
    assert "speed: quick" in told["Tracking"]
    assert "Spread" not in told
    heads = [heading.words for heading in verdict_table(condition, "").headings]
    assert heads[1:5] == [
        "tracking cost angle (°)",
        "tracking cost speed (m/s)",
        "settled error angle (°)",
        "settled error speed (m/s)",
    ]
    assert not any("beyond bounds" in head for head in heads)


def test_outputs_without_limits_are_not_said_to_have_kept_them(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5)
        trace.bounds.y_min[:], trace.bounds.y_max[:] = -float("inf"), float("inf")
        return trace

    (condition,) = conditions(make_results(trace_of))
    assert ("Bounds", "The outputs have no limits here.") in verdict(condition)


def test_reasons_for_fallbacks_are_told_with_their_first_time(make_results: MakeResults) -> None:
    results = make_results(
        lambda key, seed: make_trace(0.5, fallbacks=4 if key == "slow" else 0, noise_seed=seed), seeds=[7, 8]
    )
    table = fallbacks_table(conditions(results), "x-")
    assert table is not None
    (row,) = table.rows
    assert (row.header, [cell.text for cell in row.cells]) == (
        "slow",
        ["infeasible", "8", "2", "5.7\u00a0s (seed 7)"],
    )
    assert "infeasible" in render_page([results])


def test_reasons_that_differ_in_a_number_are_one_with_its_range(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5)
        said = [f"off by {k}.0e-02; held" for k in (3, 1, 2)]
        fields = {name: getattr(trace, name) for name in trace.__dataclass_fields__}
        return Trace(**fields | {"status": ("ok", *said, *trace.status[4:])})

    table = fallbacks_table(conditions(make_results(trace_of, {"only": {"type": "x"}})), "x-")
    assert table is not None
    (row,) = table.rows
    assert [cell.text for cell in row.cells][:2] == ["off by 1.0e-02 … 3.0e-02; held", "3"]


def test_different_winners_are_named_with_their_scenarios(make_results: MakeResults) -> None:
    results = make_results(scenarios=SCENARIOS)
    other = {"quick": "slow", "slow": "quick"}
    swapped = tuple(
        replace(case, controller=other[case.controller], label=other[case.controller])
        if case.scenario == "noisy"
        else case
        for case in results.cases
    )
    (statement,) = across_statements(conditions(replace(results, cases=swapped)))
    assert plain(statement.text) == "quick has the smallest tracking cost in calm; slow in Noisy."


def test_the_fault_that_ends_a_case_is_no_fallback(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.5, outcome=Outcome.CONTROLLER_ERROR, reason="boom")
        fields = {name: getattr(trace, name) for name in trace.__dataclass_fields__}
        return Trace(**fields | {"status": (*trace.status[:-1], "error")})

    (condition,) = conditions(make_results(trace_of))
    assert fallbacks_table([condition], "x-") is None
    assert [one.fallbacks for one in condition.competitors] == [0, 0]


def test_little_travel_is_no_merit_where_nothing_is_tracked(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.3 if key == "quick" else 50.0)
        fields = {name: getattr(trace, name) for name in trace.__dataclass_fields__}
        return Trace(**fields | {"u": trace.u * (1.0 if key == "quick" else 0.1)})

    (condition,) = conditions(make_results(trace_of))
    told = {topic: plain(text) for topic, text in verdict(condition)}
    assert told["Actuator"].startswith("slow moves the actuator least")
    assert "Its tracking error is far from the best, though" in told["Actuator"]


def test_twins_share_the_first_place(make_results: MakeResults) -> None:
    lags = {"a": 0.3, "twin": 0.3, "slow": 1.0}
    results = make_results(
        lambda key, seed: make_trace(lags[key], noise_seed=seed),
        {key: {"type": "x"} for key in lags},
        seeds=[7, 8],
    )
    told = {topic: plain(text) for topic, text in verdict(conditions(results)[0])}
    assert told["Tracking"].startswith("On seed 7, a and twin track best")
    assert told["Spread"].startswith("Over 2 seeds, a and twin share the smallest median")
