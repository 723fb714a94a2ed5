"""The verdict in words, computed from the figures and claiming no more than they carry."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from markupsafe import Markup

from ddpc_cosim import CaseResult
from ddpc_cosim.metrics import split_key
from ddpc_reports.comparison import (
    TRACKING,
    Competitor,
    Condition,
    Spread,
    metric_label,
    metric_signal,
    metric_unit,
    ranked,
)
from ddpc_reports.numbers import duration, integer, significant, with_unit

_Figure = Callable[[Competitor], float]


class Statement(NamedTuple):
    """One finding: what it is about, and the sentences."""

    topic: str
    text: Markup


def verdict(condition: Condition) -> list[Statement]:
    """Return the findings of one condition, the completeness of the cases first."""
    statements = [Statement("Completed", _completeness(condition))]
    if not any(one.completed for one in condition.competitors):
        return statements
    for key in condition.keys(TRACKING):
        name = _about("Tracking", condition, key)
        statements.append(Statement(name, _first_seed(condition, key)))
        if len(condition.seeds) > 1:
            statements.append(Statement(_about("Spread", condition, key), _over_seeds(condition, key)))
    statements += _least(condition, "settled_error", "Settling", "settles closest to the reference")
    statements += _least(condition, "total_variation", "Actuator", "moves the actuator least")
    statements.append(Statement("Bounds", _violations(condition)))
    statements.append(Statement("Step time", _times(condition)))
    statements.append(Statement("Fallbacks", _fallbacks(condition)))
    return statements


def listed(parts: Sequence[str | Markup]) -> Markup:
    """Join parts as in a sentence: ``a, b and c``."""
    *head, last = parts
    return Markup("{} and {}").format(Markup(", ").join(head), last) if head else Markup("{}").format(last)


def _names(competitors: Sequence[Competitor]) -> list[Markup]:
    """Set names in italics: a label may itself hold commas."""
    return [Markup("<i>{}</i>").format(one.label) for one in competitors]


def _completeness(condition: Condition) -> Markup:
    lost = [one for one in condition.competitors if not one.completed_all]
    total = len(condition.cases)
    if not lost:
        return Markup("All {} cases completed.").format(total) if total > 1 else Markup("The case completed.")
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


def _first_seed(condition: Condition, key: str) -> Markup:
    order = ranked(condition.competitors, [one.at_first(key) for one in condition.competitors])
    seed = condition.seeds[0]
    if not order:
        return Markup("No controller completed the case of seed {}.").format(seed)
    show = _shower(key)
    what = metric_label(key).lower()
    if len(order) == 1:
        return Markup(
            "On seed {}, <b>{}</b> reaches an {} of {}; no other completed case to compare with."
        ).format(seed, order[0][1].label, what, show(order[0][0]))
    (best, winner), (second, next_one), (worst, last) = order[0], order[1], order[-1]
    if show(best) == show(worst):
        return Markup("On seed {} all controllers track alike: {} {}.").format(seed, what, show(best))
    text = Markup("On seed {}, <b>{}</b> tracks best: {} {}, then <i>{}</i> with {}").format(
        seed, winner.label, what, show(best), next_one.label, show(second)
    )
    return text + (
        Markup("; last is <i>{}</i> with {}.").format(last.label, show(worst))
        if len(order) > 2
        else Markup(".")
    )


def _over_seeds(condition: Condition, key: str) -> Markup:
    complete = [one for one in condition.competitors if one.completed_all]
    order = ranked(complete, [one.over_seeds(key).median for one in complete])
    if not order:
        return Markup("No controller completed every seed, so medians over the seeds are not compared.")
    winner, rest = order[0][1], [one for _, one in order[1:]]
    figure = _median_and_range(winner.over_seeds(key), key)
    if not rest:
        return Markup("Only <b>{}</b> completed every seed: median {}; nothing to compare with.").format(
            winner.label, figure
        )
    text = Markup("Over {} seeds, <b>{}</b> has the smallest median: {}.").format(
        len(condition.seeds), winner.label, figure
    )
    return text + _duel(winner, rest[0], key) + _overlap(winner, rest, key) + _constant([winner, *rest], key)


def _duel(winner: Competitor, rival: Competitor, key: str) -> Markup:
    mine, theirs = winner.by_seed(key), rival.by_seed(key)
    shared = mine.keys() & theirs.keys()
    wins = sum(mine[seed] < theirs[seed] for seed in shared)
    return Markup(" Seed by seed it is ahead of the next, <i>{}</i> ({}), on {} of {}.").format(
        rival.label, _median_and_range(rival.over_seeds(key), key), wins, len(shared)
    )


def _overlap(winner: Competitor, others: Sequence[Competitor], key: str) -> Markup:
    reach = winner.over_seeds(key).high
    inside = [one for one in others if one.over_seeds(key).low <= reach]
    if not inside:
        return Markup(" Its range lies below that of every other controller.")
    return Markup(" The ranges of {} overlap with its own, so the seed decides who is ahead there.").format(
        listed(_names(inside)) if len(inside) < 4 else f"{len(inside)} controllers"
    )


def _constant(order: Sequence[Competitor], key: str) -> Markup:
    same = [one for one in order if not one.over_seeds(key).varies]
    if not same or len(same) == len(order):
        return Markup(" The seed changes nothing here.") if same else Markup("")
    return Markup(" The seed changes nothing for {}.").format(listed(_names(same)))


def _least(condition: Condition, name: str, topic: str, claim: str) -> list[Statement]:
    """State for each signal who has the smallest median of a metric, and by how much."""
    statements = []
    for key in condition.keys(name):
        complete = [one for one in condition.competitors if one.completed_all]
        order = ranked(complete, [one.over_seeds(key).median for one in complete])
        if len(order) > 1:
            text = _leader(order, key, claim, len(condition.seeds))
            statements.append(Statement(_about(topic, condition, key), text))
    return statements


def _leader(order: Sequence[tuple[float, Competitor]], key: str, claim: str, seeds: int) -> Markup:
    show = _shower(key, 3)
    (best, winner), (second, next_one) = order[0], order[1]
    what = metric_label(key).lower() + (" (median of the seeds)" if seeds > 1 else "")
    if show(best) == show(second):
        alike = [one for value, one in order if show(value) == show(best)]
        return Markup("{} share the smallest {}: {}.").format(listed(_names(alike)), what, show(best))
    return (
        Markup("<b>{}</b> {}: {} {}, against {} of <i>{}</i> and {} of <i>{}</i>.").format(
            winner.label,
            claim,
            what,
            show(best),
            show(second),
            next_one.label,
            show(order[-1][0]),
            order[-1][1].label,
        )
        if len(order) > 2
        else Markup("<b>{}</b> {}: {} {}, against {} of <i>{}</i>.").format(
            winner.label, claim, what, show(best), show(second), next_one.label
        )
    )


def _violations(condition: Condition) -> Markup:
    offenders = []
    for key in condition.keys("bound_violation_max"):
        for one in condition.competitors:
            worst = one.over_seeds(key).high
            if worst > 0:
                offenders.append(
                    Markup("<i>{}</i> by up to {} ({})").format(
                        one.label, _shower(key, 3)(worst), metric_signal(key)
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
        Markup("<i>{}</i> ({})").format(label, _counted(count, "step")) for count, label in late if count
    ]
    if missed:
        return Markup("Steps longer than the sampling time of {}: {}.").format(
            duration(sampling_time), listed(missed)
        )
    longest = max(_longest_steps(condition.cases), default=math.nan)
    if math.isnan(longest):
        return Markup("No step was timed.")
    return Markup("No step was longer than the sampling time of {}; the longest took {}, {} % of it.").format(
        duration(sampling_time), duration(longest), significant(100 * longest / sampling_time, 2)
    )


def _counted(count: float, noun: str) -> str:
    return f"{integer(count)} {noun}" if count == 1 else f"{integer(count)} {noun}s"


def _longest_steps(cases: Sequence[CaseResult]) -> list[float]:
    values = (case.metrics.get("solve_time_max [s]", math.nan) for case in cases)
    return [value for value in values if not math.isnan(value)]


def _fallbacks(condition: Condition) -> Markup:
    counts = [(one.total("failures [1]"), one) for one in condition.competitors]
    who = [
        Markup("<i>{}</i> at {}").format(one.label, _counted(count, "sample"))
        for count, one in counts
        if count
    ]
    if not who:
        return Markup("No controller reported a fallback.")
    return Markup("Controllers fell back on a substitute: {}.").format(listed(who))


def _median_and_range(figure: Spread, key: str) -> str:
    show = _shower(key)
    if not figure.varies:
        return show(figure.median)
    return f"{show(figure.median)} [{significant(figure.low)} … {significant(figure.high)}]"


def _shower(key: str, digits: int = 4) -> Callable[[float], str]:
    """Return the function that writes a value of this metric with its unit."""
    return lambda value: with_unit(significant(value, digits), metric_unit(key))


def _about(topic: str, condition: Condition, key: str) -> str:
    several = len(condition.keys(split_key(key)[0])) > 1
    return f"{topic}, {metric_signal(key)}" if several else topic
