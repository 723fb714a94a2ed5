"""The verdict in words, computed from the figures and claiming no more than they carry."""

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from ddpc_cosim import CaseResult
from ddpc_reports.comparison import Competitor, Condition, metric_signal, ranked
from ddpc_reports.numbers import duration, given_duration, significant
from ddpc_reports.ranking import least, least_travel, tracking
from ddpc_reports.words import Statement, counted, listed, shower


def verdict(condition: Condition) -> list[Statement]:
    """Return the findings of one condition, the completeness of the cases first."""
    statements = [Statement("Completed", _completeness(condition))]
    if not any(one.completed for one in condition.competitors):
        return statements
    statements += tracking(condition)
    statements += least(condition, "settled_error", "Settling", "settles closest to the reference")
    statements += least_travel(condition)
    statements.append(Statement("Bounds", _violations(condition)))
    statements.append(Statement("Step time", _times(condition)))
    statements.append(Statement("Fallbacks", _fallbacks(condition)))
    return statements


def _completeness(condition: Condition) -> Markup:
    lost = [one for one in condition.competitors if not one.completed_all]
    total = len(condition.cases)
    if not lost:
        own = " of the controllers with their own settings" if condition.variants else ""
        return (
            Markup("All {} cases{} completed.").format(total, own)
            if total > 1
            else Markup("The case{} completed.").format(own.replace("controllers", "controller"))
        )
    done = sum(len(one.completed) for one in condition.competitors)
    who = listed([_lost_cases(one) for one in lost])
    head = f"{done} of {total} cases completed" if done else "No case completed, so nothing is ranked"
    text = Markup("{}; not completed: {}.").format(head, who)
    return (
        text + " Figures of cases that did not complete are not compared with those that did."
        if done
        else text
    )


def _lost_cases(one: Competitor) -> Markup:
    lost = [case for case in one.cases if case not in one.completed]
    outcomes = ", ".join(dict.fromkeys(str(case.outcome) for case in lost))
    return Markup("<b>{}</b> {} of {} ({})").format(one.label, len(lost), len(one.cases), outcomes)


def _violations(condition: Condition) -> Markup:
    bounds = [trace.bounds for trace in condition.first_traces.values()]
    if bounds and not any(np.isfinite([one.y_min, one.y_max]).any() for one in bounds):
        return Markup("The outputs have no limits here.")
    offenders = []
    for key in condition.keys("bound_violation_max"):
        for one in condition.competitors:
            worst = one.over_seeds(key).high
            if worst > 0:
                offenders.append(
                    Markup("<i>{}</i> by up to {} ({})").format(
                        one.label, shower(key, 3)(worst), metric_signal(key)
                    )
                )
    if not offenders:
        return Markup("No output went beyond its limits in a completed case.")
    return Markup("Outputs went beyond their limits with {}.").format(listed(offenders))


def _times(condition: Condition) -> Markup:
    complete = [one for one in condition.competitors if one.completed_all]
    order = ranked(complete, [one.over_seeds("solve_time_median [s]").median for one in complete])
    text = Markup("")
    if len(order) > 1:
        (best, winner), (worst, last) = order[0], order[-1]
        text = Markup("<b>{}</b> is fastest: median step {}; slowest is <i>{}</i> with {}. ").format(
            winner.label, duration(best), last.label, duration(worst)
        )
    return text + _deadlines(condition)


def _deadlines(condition: Condition) -> Markup:
    sampling_time = condition.results.study.loop.sampling_time
    late = [(one.total("deadline_misses [1]"), one.label) for one in condition.competitors]
    missed = [
        Markup("<i>{}</i> ({})").format(label, counted(count, "step")) for count, label in late if count
    ]
    if missed:
        return Markup("Steps longer than the sampling time of {}: {}.").format(
            given_duration(sampling_time), listed(missed)
        )
    longest = max(_longest_steps(condition.cases), default=math.nan)
    if math.isnan(longest):
        return Markup("No step was timed.")
    return Markup("No step was longer than the sampling time of {}; the longest took {}, {} % of it.").format(
        given_duration(sampling_time), duration(longest), significant(100 * longest / sampling_time, 2)
    )


def _longest_steps(cases: Sequence[CaseResult]) -> list[float]:
    values = (case.metrics.get("solve_time_max [s]", math.nan) for case in cases)
    return [value for value in values if not math.isnan(value)]


def _fallbacks(condition: Condition) -> Markup:
    counts = [(one.fallbacks, one) for one in condition.competitors]
    who = [
        Markup("<i>{}</i> at {}").format(one.label, counted(count, "sample"))
        for count, one in counts
        if count
    ]
    if not who:
        return Markup("No controller reported a fallback.")
    return Markup("Controllers fell back on a substitute: {}.").format(listed(who))
