"""The answer says who is ahead, how sure that is, what others offer and who fails: no more, and no less."""

import html
import math
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from statistics import median

import numpy as np
import pytest

from ddpc_cosim import CaseResult, Outcome, StudyResults, Trace
from ddpc_cosim.study.verdicts.findings import findings_of
from ddpc_reports.answer import answer
from ddpc_reports.comparison import conditions

from .synthetic import ANGLE, SPEED, MakeResults, make_trace

SEEDS = [*range(12)]
KEY = "mean_abs_error.angle [deg]"
ALL_MATTERS = {"relevant": {"absolute": 1e-9}}
"""Of the study's metrics: no difference is too small to matter."""
Make = Callable[[str, int], Trace]


def said(results: StudyResults) -> str:
    """Return the answer as plain text."""
    findings = findings_of(results.study, results.cases)
    text = re.sub("<[^>]*>", "", str(answer(results, conditions(results), findings)))
    return html.unescape(text).translate({0xA0: " ", 0x202F: " ", 0x2212: "-"})


def lag(of: dict[str, float], jitter: float = 0.02) -> Make:
    def trace_of(key: str, seed: int) -> Trace:
        deviation = np.random.default_rng([seed, len(key), ord(key[0])]).standard_normal()
        return make_trace(of[key] * (1 + jitter * deviation), noise_seed=seed)

    return trace_of


def study(make_results: MakeResults, trace_of: Make, *names: str, **more: object) -> StudyResults:
    return make_results(trace_of, {name: {"type": "a"} for name in names}, **{"seeds": SEEDS, **more})


def values(results: StudyResults, key: str) -> dict[int, float]:
    return {case.seed: case.metrics[KEY] for case in results.cases if case.controller == key}


def test_one_that_is_told_apart_from_all_is_ahead_by_the_difference_of_the_pairs(
    make_results: MakeResults,
) -> None:
    results = study(make_results, lag({"a": 0.3, "b": 0.5, "c": 0.9}), "c", "b", "a")
    a, b = values(results, "a"), values(results, "b")
    difference = median(b[seed] - a[seed] for seed in SEEDS)
    percent = 100 * difference / median(a.values())
    text = said(results)
    assert text.startswith(f"a is ahead over 12 seeds: mean absolute error {median(a.values()):.3g}° [")
    assert re.search(rf"; the next, b, differs by \+{difference:.3g}° \[\d", text)
    assert f"], +{percent:.2g} %." in text
    assert "c" not in re.findall(r"\b[abc]\b", text)


def having(results: StudyResults, of: dict[str, Callable[[str, int], float]]) -> StudyResults:
    """Return results with errors of one's own, by scenario and seed; NaN is a failed run."""

    def changed(case: CaseResult) -> CaseResult:
        value = of[case.controller](case.scenario, case.seed)
        if math.isnan(value):
            return replace(case, failed=True)
        return replace(case, metrics=case.metrics | {KEY: value})

    return replace(results, cases=tuple(map(changed, results.cases)))


def test_the_percentage_is_that_of_the_difference_beside_it_not_that_of_the_medians(
    make_results: MakeResults,
) -> None:
    """Medians of the scenarios are 5 and 5.9, and that of the pairs' differences is +0.5."""
    a, b = {"x": 1.0, "y": 5.0, "z": 9.0}, {"x": 1.4, "y": 5.9, "z": 9.5}
    results = study(make_results, lag({"a": 0.3, "b": 0.5}), "a", "b", scenarios={name: {} for name in a})
    shaken = having(results, {"a": lambda s, n: a[s] + n / 1e4, "b": lambda s, n: b[s] + n / 1e4})
    assert re.match(
        r"a is ahead .*; the next, b, differs by \+0\.500° \[the same on every seed\], \+10 %\.", said(shaken)
    )


def test_an_interval_without_0_has_the_p_by_which_two_are_not_told_apart(make_results: MakeResults) -> None:
    apart = [*(0.01 * n for n in range(1, 11)), -0.5, -0.6]
    results = study(make_results, lag({"a": 0.3, "b": 0.5, "c": 0.9}), "a", "b", "c", metrics=ALL_MATTERS)
    text = said(
        having(
            results,
            {
                "a": lambda s, n: 1 + n / 100,
                "b": lambda s, n: 1 + n / 100 + apart[n],
                "c": lambda s, n: 3 + n,
            },
        )
    )
    # The other two pairs are told apart and gone before: of this one alone, over the signs of all seeds.
    sums = abs(np.array([*product([1, -1], repeat=12)]) @ apart)
    p = float((sums >= abs(sum(apart)) - 1e-9).mean())
    low, high = map(float, re.findall(r"\+[\d.]+° \[(\S+) … (\S+)\]", text)[0])
    assert 0 < low < high
    assert "a and b lead over 12 seeds and are not told apart" in text
    assert f"] (corrected p {p:.2f})." in text


def test_who_alone_has_no_failed_run_is_not_told_to_be_ahead(make_results: MakeResults) -> None:
    results = study(make_results, lag({"a": 0.9, "b": 0.3}), "a", "b")
    text = said(having(results, {"a": lambda s, n: 5.0, "b": lambda s, n: math.nan if n == 3 else 1.0}))
    assert text == (
        "a alone has no failed run, over 12 seeds: mean absolute error 5.00° [the same on every seed]. "
        "Failed: b 1 of 12 runs (in the others ahead of a by 4.00° [the same on every seed])."
    )


def test_runs_of_other_seeds_have_no_difference(make_results: MakeResults) -> None:
    results = study(make_results, lag({"a": 0.3, "b": 0.5}), "a", "b")
    cases = tuple(case for case in results.cases if (case.seed < 6) == (case.controller == "a"))
    text = said(replace(results, cases=cases))
    assert "unknown, without a run of the same seed" in text
    assert "Not all ran in the same scenarios on the same seeds: differences are of what two share." in text


def test_what_two_share_is_what_differences_and_percentages_are_of(make_results: MakeResults) -> None:
    """Only `a` ran in the hard scenario; on the other, three seeds are those of both."""
    results = study(make_results, lag({"a": 0.3, "b": 0.5}), "a", "b", scenarios={"x": {}, "hard": {}})
    both = having(results, {"a": lambda s, n: (1.0 if s == "x" else 9.0) + n / 1e4, "b": lambda s, n: 1.5})
    cases = tuple(
        case for case in both.cases if case.controller == "a" or (case.scenario == "x" and case.seed < 3)
    )
    text = said(replace(both, cases=cases))
    assert "differs by +0.500°, +50 %." in text
    assert "3 seeds are too few to test 2 controllers against each other: it takes 6." in text


def test_of_many_that_lead_three_are_named(make_results: MakeResults) -> None:
    names = "abcde"
    results = study(make_results, lag(dict.fromkeys(names, 0.5)), *names)
    same = having(results, dict.fromkeys(names, lambda s, n: 1.0))
    assert said(same) == (
        "a, b, c and 2 more lead over 12 seeds, and no difference between them matters: mean absolute error "
        "1.00°, 1.00° and 1.00°, in pairs less than 0.20° apart."
    )


def test_those_that_are_not_told_apart_lead_together(make_results: MakeResults) -> None:
    lags = lag({"a": 0.5, "b": 0.5, "c": 0.9}, 0.1)
    results = study(make_results, lags, "c", "b", "a", metrics=ALL_MATTERS)
    text = said(results)
    assert re.match(r"[ab] and [ab] lead over 12 seeds and are not told apart: mean absolute error ", text)
    low, high = re.findall(r"\[([-\d.]+) … ([-\d.]+)\]", text)[0]
    assert float(low) < 0 < float(high)


def test_too_few_seeds_make_nobody_sure(make_results: MakeResults) -> None:
    results = study(make_results, lag({"a": 0.3, "b": 0.5}), "a", "b", seeds=[0, 1, 2])
    assert "a has the best median over 3 seeds" in said(results)
    assert said(results).endswith("3 seeds are too few to test 2 controllers against each other: it takes 6.")
    alone = study(make_results, lag({"a": 0.3, "b": 0.5}), "a", "b", seeds=[4])
    assert said(alone).startswith("a is ahead on the one seed that was run: mean absolute error ")
    assert said(alone).endswith("How much that depends on the seed is not known.")


def test_whose_runs_failed_is_told_and_that_it_is_ahead_in_the_others(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        if key == "swift" and seed == 3:
            return make_trace(0.2, outcome=Outcome.DIVERGED, reason="angle is NaN")
        return lag({"swift": 0.2, "a": 0.5, "b": 0.8})(key, seed)

    results = study(make_results, trace_of, "swift", "a", "b")
    swift, a = values(results, "swift"), values(results, "a")
    gain = median(a[seed] - swift[seed] for seed in SEEDS if seed != 3)
    text = said(results)
    assert text.startswith("a is ahead over 12 seeds")
    assert f"Failed: swift 1 of 12 runs (in the others ahead of a by {gain:.3g}° [" in text


def test_where_every_controller_has_failed_runs_none_is_ahead(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        falls = seed < (1 if key == "a" else 2)
        return make_trace(0.5, outcome=Outcome.DIVERGED if falls else Outcome.COMPLETED)

    text = said(study(make_results, trace_of, "a", "b"))
    assert text == "No controller is without a failed run. Fewest failed: a 1 of 12 runs."


def test_where_every_run_failed_nothing_is_ranked(make_results: MakeResults) -> None:
    results = study(make_results, lambda key, seed: make_trace(40.0), "a", "b", "rest")
    points = {"reference_points": {"zero": "rest", "full": "b"}}
    assert said(results) == ""
    beaten = study(make_results, lag({"a": 0.5, "b": 0.5, "rest": 0.5}), "a", "b", "rest", report=points)
    cases = tuple(
        replace(case, failed=case.controller == "a", failure="a is far off") for case in beaten.cases
    )
    assert said(replace(beaten, cases=cases)) == ""
    for every in (results, replace(beaten, cases=cases)):
        (remark,) = (remark for remark in findings_of(every.study, every.cases).remarks if remark.is_failure)
        assert re.match("Every controller fails; in the best run, (angle ends|a is far off)", remark.text)


@pytest.mark.parametrize(
    ("known", "but"), [("nothing", ""), ("a <rough> gain", ", but was told of the plant: a <rough> gain")]
)
def test_who_learns_from_no_recording_is_told_with_how_far_it_is_behind(
    make_results: MakeResults, known: str, but: str
) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = lag({"a": 0.3, "b": 0.9, "c": 1.1})(key, seed)
        knowledge = {"plant": known if key == "b" else "nothing"}
        return replace(trace, recorded_samples=200 if key == "a" else 0, knowledge=knowledge)

    results = study(make_results, trace_of, "a", "b", "c")
    a, b = values(results, "a"), values(results, "b")
    ratio = 1 + median(b[seed] - a[seed] for seed in SEEDS) / median(a.values())
    assert f"Behind, b ({ratio:.2g} times) learns from no recording{but}." in said(results)


def test_scenarios_count_together_but_for_those_in_which_all_fail(make_results: MakeResults) -> None:
    scenarios = {"calm": {}, "wild": {}, "dead": {"label": "No power"}}
    results = study(make_results, lag({"a": 0.3, "b": 0.9}), "a", "b", scenarios=scenarios)
    cases = tuple(
        replace(case, failed=True, failure="far off") if case.scenario == "dead" else case
        for case in results.cases
    )
    text = said(replace(results, cases=cases))
    assert text.startswith("a is ahead over 2 scenarios and 12 seeds")
    assert text.endswith("Not counted, as every controller fails there: No power.")


def test_where_scenarios_disagree_it_is_told_who_leads_where(make_results: MakeResults) -> None:
    """`a` is ahead in two of three scenarios, and `b` in the one in which their runs are exchanged."""
    results = study(
        make_results, lag({"a": 0.3, "b": 0.5}), "a", "b", scenarios={"one": {}, "two": {}, "turned": {}}
    )
    other = {"a": "b", "b": "a"}
    cases = tuple(
        replace(case, controller=other[case.controller], label=other[case.controller])
        if case.scenario == "turned"
        else case
        for case in results.cases
    )
    text = said(replace(results, cases=cases))
    assert text.startswith(
        "The scenarios disagree, so there is no overall rank: a leads in one and two; b leads in turned."
    )
    assert said(results).startswith("a is ahead over 3 scenarios")


def test_of_scenarios_that_disagree_one_may_have_several_that_lead_and_one_nobody(
    make_results: MakeResults,
) -> None:
    scenarios = {"calm": {}, "turned": {}, "alike": {}, "wild": {"label": "Wild"}}
    results = study(make_results, lag({"a": 0.3, "b": 0.5, "c": 0.9}), "a", "b", "c", scenarios=scenarios)

    errors = {
        "a": {"calm": 1.0, "turned": 5.0, "alike": 2.0},
        "b": {"calm": 5.0, "turned": 1.0, "alike": 2.0},
    }
    figures = having(
        results,
        {name: lambda s, n, of=of: of.get(s, 0.0) for name, of in errors.items()}
        | {"c": lambda s, n: math.nan if n == 3 else 9.0},
    )
    cases = tuple(case for case in figures.cases if (case.controller == "c") == (case.scenario == "wild"))
    assert said(replace(figures, cases=cases)).startswith(
        "The scenarios disagree, so there is no overall rank: a leads in calm; b leads in turned; "
        "a and b lead together in alike; no controller is without a failed run in Wild."
    )


def test_leaders_that_are_told_apart_by_too_little_are_told_to_be_no_better_by_enough(
    make_results: MakeResults,
) -> None:
    results = study(
        make_results, lag({"a": 0.3, "b": 0.5}), "a", "b", metrics={"relevant": {"absolute": 0.5}}
    )
    text = said(having(results, {"a": lambda s, n: 2.0, "b": lambda s, n: 2.1 + 0.05 * n}))
    assert text.startswith(
        "a and b lead over 12 seeds and none of them is significantly better by enough to matter: "
        "mean absolute error 2.00° and 2.38°, paired difference from the first +0.375° ["
    )


def test_a_leader_that_shares_no_seed_with_one_behind_is_not_told_to_be_ahead_of_all(
    make_results: MakeResults,
) -> None:
    """`a` is better than `c`, and `c` than `b`; `a` and `b` have no seed in common."""
    results = study(make_results, lag({"a": 0.3, "b": 0.5, "c": 0.4}), "a", "b", "c", seeds=[*range(24)])
    figures = having(
        results, {"a": lambda s, n: 1 + n / 100, "b": lambda s, n: 9 + n / 100, "c": lambda s, n: 5 + n / 100}
    )
    cases = tuple(
        case
        for case in figures.cases
        if case.controller == "c" or (case.controller == "a") == (case.seed < 12)
    )
    text = said(replace(figures, cases=cases))
    assert text.startswith("No controller is significantly better than a over 24 seeds: a 1.06°.")


def test_what_differences_matter_is_that_of_the_scenario_alone(make_results: MakeResults) -> None:
    results = study(make_results, lag({"a": 0.3, "b": 0.5}), "a", "b", scenarios={"one": {}, "two": {}})
    for condition in conditions(results):
        alone = findings_of(
            results.study, [case for case in results.cases if case.scenario == condition.scenario]
        )
        assert condition.standings.relevant_differences == alone.standings.relevant_differences
        assert set(alone.standings.relevant_differences) == {KEY}


def test_of_several_outputs_each_has_its_value(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        return make_trace(0.3 if key == "a" else 0.9, outputs=(ANGLE, SPEED), noise_seed=seed)

    text = said(study(make_results, trace_of, "a", "b"))
    assert re.match(
        r"a is ahead over 12 seeds: mean absolute error [\d.]+° \[[\d. …]+\] of angle and [\d.]+ m/s", text
    )
    assert re.search(
        r"the next, b, differs by a factor of [\d.]+ in angle and a factor of [\d.]+ in speed\.", text
    )


def test_a_difference_that_is_sure_and_too_small_is_not_called_insignificant(
    make_results: MakeResults,
) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        return make_trace(0.3 if key == "a" else 0.3003, outputs=(ANGLE, SPEED), noise_seed=seed)

    results = study(make_results, trace_of, "a", "b")
    assert findings_of(results.study, results.cases).tells_leaders_apart
    told = said(results)
    assert told.startswith("No controller is better than a and b over 12 seeds by enough to matter: a ")


def test_medians_that_differ_by_too_little_are_both_given(make_results: MakeResults) -> None:
    results = study(make_results, lag({"a": 0.3, "b": 0.5}), "a", "b", seeds=[0])
    figures = having(results, {"a": lambda s, n: 2.001, "b": lambda s, n: 2.009})
    assert said(figures).startswith(
        "a and b have the best medians on the one seed that was run, which differ by too little to matter: "
        "mean absolute error 2.00° and 2.01°."
    )


@pytest.mark.parametrize("name", ["<b>x</b>", 'a "quoted" & more'])
def test_names_are_text(make_results: MakeResults, name: str) -> None:
    results = make_results(
        lag({"a": 0.3, "b": 0.9}), {"a": {"type": "a", "label": name}, "b": {"type": "a"}}, seeds=SEEDS
    )
    text = str(answer(results, conditions(results), findings_of(results.study, results.cases)))
    assert html.escape(name, quote=True).replace("&quot;", "&#34;") in text.replace("&quot;", "&#34;")


def test_alone_nobody_is_ahead(make_results: MakeResults) -> None:
    text = said(study(make_results, lag({"a": 0.3}), "a"))
    assert text.startswith("There is nothing to compare a with: mean absolute error ")


@pytest.mark.parametrize("flips", [True, False])
def test_where_the_models_of_an_estimated_plant_disagree_it_is_said_on_how_many(
    make_results: MakeResults, flips: bool
) -> None:
    """Also of two that share the first rank because of it."""

    def trace_of(key: str, seed: int) -> Trace:
        winner = "b" if flips and seed % 3 == 0 else "a"
        return make_trace((0.5 if key == winner else 0.7) + 0.01 * seed, noise_seed=seed)

    plant = {
        "identified": {"file": ["log.csv"], "members": 12},
        "inputs": ["torque"],
        "outputs": ["angle"],
    }
    text = said(study(make_results, trace_of, "a", "b", plant=plant))
    allowed = "The plant is an estimate, and each seed plays another model of it: intervals allow for that."
    assert ("not told apart" in text) is flips
    said_then = "They disagree: a is ahead of b on 8 of 12." if flips else "a is ahead of b on all of them."
    assert f"{allowed} {said_then}" in text
