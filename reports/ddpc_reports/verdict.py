"""The verdict in words and the known limitations: computed, claiming no more than the results carry."""

import math
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from markupsafe import Markup

from ddpc_cosim import CaseResult
from ddpc_cosim.loop.data_quality import CANNOT_FOLLOW, references_beyond_limits
from ddpc_cosim.metrics import metric_of, split_key
from ddpc_cosim.study.verdicts.sentences import (
    ahead_in_pairs_clause,
    bold,
    italic,
    join_words,
    level_clause,
    sentence,
    some_of,
    too_few_seeds_clause,
)
from ddpc_cosim.study.verdicts.statistics import Difference
from ddpc_reports.comparison import (
    Condition,
    ControllerResults,
    Spread,
    metric_keys,
    metric_signal,
    metric_unit,
    ranked,
)
from ddpc_reports.identified import limitations_of_plant
from ddpc_reports.numbers import apart, duration, given_duration, integer, significant, with_unit

_POOR = 3.0
"""From this many times the best error on, a small total variation is not a merit."""


RANKED_BY = ("settled_error", "total_variation")
"""The metrics besides those of the ranking by which the verdict names a first."""

_SMALLEST_P = 0.001


class Statement(NamedTuple):
    """One finding: what it is about, and the sentences."""

    topic: str
    text: Markup


Part = Literal["failures", "distribution", "response", "limits", "time"]
"""A section of the page that findings belong to."""


def findings(condition: Condition, part: Part) -> list[Statement]:
    """Return the findings of one condition that belong to a section of the page."""
    failures = part == "failures"
    statements = [Statement("Completed", _completeness(condition))] if failures else []
    if not any(controller.completed for controller in condition.controllers):
        return statements
    if failures:
        return [*statements, Statement("Fallbacks", _fallbacks(condition))]
    if part == "time":
        return [Statement("Step time", _times(condition))]
    bounds = [Statement("Bounds", _violations(condition))] if part == "limits" else []
    if condition.all_failed:
        nothing = bold(condition.all_failed) + ", so nothing is ranked."
        return [Statement("Reference", nothing)] if part == "distribution" else bounds
    if part == "distribution":
        return tracking(condition)
    if part == "response":
        return least(condition, "settled_error", "Settling", "settles closest to the reference")
    return [*least_travel(condition), *bounds]


def _completeness(condition: Condition) -> Markup:
    early = [controller for controller in condition.controllers if not controller.completed_all]
    total = len(condition.cases)
    if not early:
        return _all_completed(condition) + _completed_and_failed(condition)
    done = sum(len(controller.completed) for controller in condition.controllers)
    who = join_words([_ended_early(controller) for controller in early])
    head = f"{done} of {total} cases completed" if done else "No case completed, so nothing is ranked"
    text = Markup("{}; not completed: {}.").format(head, who)
    compared = " Values of cases that did not complete are not compared with those that did." if done else ""
    return text + compared + _completed_and_failed(condition)


def _all_completed(condition: Condition) -> Markup:
    total = len(condition.cases)
    whose = " of the controllers with their own settings" if condition.variants else ""
    if total > 1:
        return Markup("All {} cases{} completed.").format(total, whose)
    return Markup("The case{} completed.").format(whose.replace("controllers", "controller"))


def _completed_and_failed(condition: Condition) -> Markup:
    """Name the controllers of which runs completed and failed; nothing without any."""
    counts = [
        (len(controller.completed) - len(controller.succeeded), controller)
        for controller in condition.contenders
    ]
    who = [bold(controller.label) + f" {n} of {len(controller.cases)}" for n, controller in counts if n]
    if not who:
        return Markup("")
    return Markup(
        " <b>Completed, but failed</b>: {}. An output ends further than half of its task away, or the run "
        "is worse than doing nothing. Such a controller is never the best, and comes last."
    ).format(join_words(who))


def _ended_early(controller: ControllerResults) -> Markup:
    cases = [case for case in controller.cases if case not in controller.completed]
    outcomes = ", ".join(dict.fromkeys(str(case.outcome) for case in cases))
    return bold(controller.label) + f" {len(cases)} of {len(controller.cases)} ({outcomes})"


def _violations(condition: Condition) -> Markup:
    bounds = [trace.bounds for trace in condition.first_traces.values()]
    if bounds and not any(np.isfinite([limits.y_min, limits.y_max]).any() for limits in bounds):
        return Markup("The outputs have no limits here.")
    offenders = [
        italic(controller.label) + f" by up to {formatter(key, 3)(worst)} ({metric_signal(key)})"
        for key in condition.keys("bound_violation_max")
        for controller in condition.controllers
        if (worst := controller.over_seeds(key).high) > 0
    ]
    if not offenders:
        return Markup("No output went beyond its limits in a completed case.")
    return Markup("Outputs went beyond their limits with {}.").format(join_words(offenders))


def _times(condition: Condition) -> Markup:
    key = "solve_time_median [s]"
    order = condition.ranking(key)
    text = Markup("")
    if len(order) > 1:
        (best, winner), (worst, last) = order[0], order[-1]
        text = Markup("{}{} is fastest: {} {}{}; slowest is <i>{}</i> with {}. ").format(
            _among(condition),
            _first(condition, key, winner),
            condition.name_of(key),
            duration(best),
            _unsure_words(condition, key),
            last.label,
            duration(worst),
        )
    return text + _deadlines(condition)


def _unsure_words(condition: Condition, key: str) -> Markup:
    """Name those from which the seeds do not tell the first apart; nothing if there are none."""
    unsure = condition.level_with_first(key)
    return ("; " + level_clause(names(unsure)) if unsure else Markup("")) + _in_pairs(condition, key)


def _in_pairs(condition: Condition, key: str) -> Markup:
    """Name those that are ahead of the first seed by seed, despite its median; nothing without any."""
    ahead = names(condition.ahead_in_pairs(key))
    return "; " + ahead_in_pairs_clause(ahead) if ahead else Markup("")


def _among(condition: Condition) -> str:
    """Say that only those without a failed run are compared, where there are others."""
    return "Of those without a failed run, " if condition.not_ranked else ""


def _deadlines(condition: Condition) -> Markup:
    sampling_time = condition.results.study.loop.sampling_time
    missed = [
        italic(controller.label) + f" ({counted(count, 'step')})"
        for controller in condition.controllers
        if (count := controller.total("deadline_misses [1]"))
    ]
    if missed:
        return Markup("Steps longer than the sampling time of {}: {}.").format(
            given_duration(sampling_time), join_words(missed)
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
    who = [
        italic(controller.label) + f" at {counted(count, 'sample')}"
        for controller in condition.controllers
        if (count := controller.total("failures [1]"))
    ]
    if not who:
        return Markup("No controller reported a fallback.")
    return Markup("Controllers fell back on a substitute: {}.").format(join_words(who))


def tracking(condition: Condition) -> list[Statement]:
    """Return who is ahead: at the first seed and over all; of several outputs one line for each."""
    keys = condition.headline
    if len(keys) > 1:
        return [_each_signal(condition, keys, _topic(keys[0]))]
    statements = []
    for key in keys:
        statements.append(Statement(_topic(key), _first_seed(condition, key)))
        if len(condition.seeds) > 1:
            statements.append(Statement("Spread", _over_seeds(condition, key)))
    return statements


def _is_cost(key: str) -> bool:
    """Whether controllers are ranked by a cost: it may weigh inputs too, and is not a tracking error."""
    return split_key(key)[0] in ("cost", "money")


def _topic(key: str) -> str:
    return metric_of(key).label if _is_cost(key) else "Tracking"


def _signal(condition: Condition, key: str, keys: Sequence[str]) -> str:
    """Return the signal of one of several figures; where they are not of the same kind, what it is of it."""
    if len({split_key(other)[0] for other in keys}) == 1:
        return metric_signal(key)
    return " of ".join(filter(None, (condition.name_of(key), metric_signal(key))))


def _each_signal(condition: Condition, keys: Sequence[str], topic: str) -> Statement:
    """State in short who is first, next and last for each of several signals."""
    seeds = len(condition.seeds)
    over = f", medians over {seeds} seeds and ranges" if seeds > 1 else ""
    lines = [(_signal(condition, key, keys), _in_short(condition, key)) for key in keys]
    what = " and ".join(dict.fromkeys(condition.name_of(key) for key in keys))
    text = Markup("In {}{}: ").format(what, over) + by_signal(lines)
    return Statement(topic, text + _too_few_seeds([condition], keys))


def _in_short(condition: Condition, key: str) -> Markup:
    order = condition.ranking(key)
    if not order:
        return Markup("no controller is without a failed run.")
    show = formatter(key)
    alike = _alike(order, show)
    if len(alike) > 1:
        text = Markup("{} share {}").format(join_words(names(alike)), show(order[0][0]))
    else:
        first = _first(condition, key, alike[0])
        text = Markup("{} {}").format(first, median_and_range(alike[0].over_seeds(key), key))
    shared = {controller.key for controller in alike}
    unsure = [member for member in condition.level_with_first(key) if member.key not in shared]
    if unsure:
        values = {controller.key: show(value) for value, controller in order}
        named = [italic(controller.label) + f" {values[controller.key]}" for controller in unsure]
        text += Markup(", not told apart from {}").format(some_of(named))
    elif len(order) > len(alike):
        value, next_one = order[len(alike)]
        text += Markup(", then <i>{}</i> {}").format(next_one.label, show(value))
    return text + _in_pairs(condition, key) + _last(order, condition.not_ranked, show) + "."


def _alike(
    order: Sequence[tuple[float, ControllerResults]], show: Callable[[float], str]
) -> list[ControllerResults]:
    """Return the first of a ranking, and those whose value reads the same."""
    return [controller for value, controller in order if show(value) == show(order[0][0])]


def _last(
    order: Sequence[tuple[float, ControllerResults]],
    not_ranked: Sequence[ControllerResults],
    show: Callable[[float], str],
) -> Markup:
    """Say who comes last: those with failed runs, else the last of three or more."""
    if not_ranked:
        be = "is" if len(not_ranked) == 1 else "are"
        return Markup("; last {} {}, with failed runs").format(be, join_words(names(not_ranked)))
    if len(order) < 3:
        return Markup("")
    return Markup("; last is <i>{}</i> with {}").format(order[-1][1].label, show(order[-1][0]))


def least(condition: Condition, name: str, topic: str, claim: str) -> list[Statement]:
    """State who has the smallest median of a metric, and by how much, for each signal that has it."""
    known = [(key, order) for key in condition.keys(name) if len(order := condition.ranking(key)) > 1]
    if len(known) > 1:
        return [_each_signal(condition, [key for key, _ in known], topic)]
    return [
        Statement(topic, _among(condition) + _leader(condition, order, key, claim)) for key, order in known
    ]


def least_travel(condition: Condition) -> list[Statement]:
    """State who moves the actuators least and, of one that hardly tracks, that too."""
    statements = least(condition, "total_variation", "Actuator", "moves the actuator least")
    travels, costs = condition.keys("total_variation"), condition.headline
    if not statements or len(travels) > 1 or len(costs) > 1:
        return statements
    tracks = condition.ranking(costs[0])
    winner = condition.ranking(travels[0])[0][1]
    cost = winner.over_seeds(costs[0]).median
    if not tracks or not cost > _POOR * tracks[0][0]:
        return statements
    show = formatter(costs[0], 3)
    text = Markup(" Its {} is far from the best, though: {} against {}.").format(
        condition.name_of(costs[0]), show(cost), show(tracks[0][0])
    )
    return [Statement(topic, travel + text) for topic, travel in statements]


def _first_seed(condition: Condition, key: str) -> Markup:
    eligible = [controller for controller in condition.contenders if controller.succeeded_first]
    order = ranked(key, eligible, [controller.at_first(key) for controller in eligible])
    others = [controller for controller in condition.contenders if controller not in eligible]
    seed = condition.seeds[0]
    if not order:
        return Markup("Every run on seed {} failed.").format(seed)
    show = formatter(key)
    what = condition.name_of(key)
    if len(order) == 1:
        alone = "every other run failed: there is nothing to" if others else "there is no other controller to"
        return Markup("On seed {}, <b>{}</b> reaches a {} of {}; {} compare with.").format(
            seed, order[0][1].label, what, show(order[0][0]), alone
        )
    one_is, several = ("costs least", "cost") if _is_cost(key) else ("tracks best", "track")
    (best, winner), (second, next_one), (worst, _) = order[0], order[1], order[-1]
    # A run that failed can have the smaller figure, a cost above all.
    metrics_of_others = [controller.first_case.metrics for controller in others if controller.first_case]
    beaten = any(metrics.get(key, math.nan) < best for metrics in metrics_of_others)
    where = f"On seed {seed}, of the runs that did not fail," if beaten else f"On seed {seed},"
    if show(best) == show(worst) and not others:
        return Markup("On seed {} all controllers {} alike: {} {}.").format(seed, several, what, show(best))
    if show(best) == show(second):
        text = Markup("{} {} {} {}: {} {}").format(
            where,
            join_words(names(_alike(order, show))),
            several,
            one_is.partition(" ")[2],
            what,
            show(best),
        )
    else:
        text = Markup("{} <b>{}</b> {}: {} {}, then <i>{}</i> with {}").format(
            where, winner.label, one_is, what, show(best), next_one.label, show(second)
        )
    return text + _last(order, others, show) + "."


def _over_seeds(condition: Condition, key: str) -> Markup:
    order = condition.ranking(key)
    if not order:
        return Markup("No controller is without a failed run, so medians are not compared.")
    winner, rest = order[0][1], [controller for _, controller in order[1:]]
    shown = median_and_range(winner.over_seeds(key), key)
    if not rest:
        only = "Only " if condition.not_ranked else ""
        return Markup("{}<b>{}</b> has no failed run: median {}; nothing to compare with.").format(
            only, winner.label, shown
        )
    alike = _alike(order, formatter(key))
    among = " of those without a failed run" if condition.not_ranked else ""
    if len(alike) > 1:
        return Markup("Over {} seeds, {} share the smallest median{}: {}.").format(
            len(condition.seeds), join_words(names(alike)), among, formatter(key)(order[0][0])
        )
    text = Markup("Over {} seeds, {} has the smallest median{}: {}.").format(
        len(condition.seeds), _first(condition, key, winner), among, shown
    )
    return (
        text
        + _seed_by_seed(winner, rest[0], key)
        + _significance(condition, key)
        + _constant([winner, *rest], key)
    )


def _seed_by_seed(winner: ControllerResults, second: ControllerResults, key: str) -> Markup:
    mine, theirs = winner.by_seed(key), second.by_seed(key)
    shared = mine.keys() & theirs.keys()
    wins = sum(mine[seed] < theirs[seed] for seed in shared)
    return Markup(" Seed by seed it is ahead of the next, <i>{}</i> ({}), on {} of {}.").format(
        second.label, median_and_range(second.over_seeds(key), key), wins, len(shared)
    )


def _first(condition: Condition, key: str, controller: ControllerResults) -> Markup:
    """Set the name of the first of a ranking: in bold only if the seeds tell it apart from all others."""
    unsure = len(condition.seeds) > 1 and not condition.compared(key).tells_first
    return (italic if unsure else bold)(controller.label)


def _significance(condition: Condition, key: str) -> Markup:
    """Say from which others the seeds tell the first of a ranking apart, and how sure that is."""
    compared, unsure = condition.compared(key), condition.level_with_first(key)
    others = {b: difference for (a, b), difference in compared.differences.items() if a == compared.order[0]}
    if compared.too_few_seeds:
        words = _difference(next(iter(others.values())), key)
        return Markup(" To the next: {}.").format(words) + _too_few_seeds([condition], [key])
    if not unsure:
        tested = [difference.corrected for difference in others.values() if not difference.constant]
        sure = f" (corrected p {p_words(max(tested), 'at most ')})" if tested else ""
        among = " without a failed run" if condition.not_ranked else ""
        return Markup(" The seeds tell it apart from every other controller{}{}{}.").format(
            among, sure, _in_pairs(condition, key)
        )
    differences = [(italic(controller.label), others[controller.key]) for controller in unsure]
    named = [
        name + f" ({_difference(difference, key)}, corrected p {p_words(difference.corrected, '= ')})"
        for name, difference in differences
    ]
    return " " + sentence(level_clause(named)) + _in_pairs(condition, key) + "."


def _difference(difference: Difference, key: str) -> str:
    """Write the median difference of another to the first of a ranking, with its interval."""
    show = formatter(key, 3)
    interval = f", 95\u00a0% interval {show(-difference.high)} … {show(-difference.low)}"
    return f"median difference {show(-difference.median)}" + ("" if math.isnan(difference.low) else interval)


def p_words(p: float, sign: str = "") -> str:
    """Write a p-value, after a sign unless it is very small."""
    return "< 0.001" if p < _SMALLEST_P else sign + significant(p, 2)


def _too_few_seeds(conditions: Sequence[Condition], keys: Sequence[str]) -> Markup:
    """Say that the seeds are too few to test so many controllers; empty if not, or of one seed."""
    if all(len(condition.seeds) < 2 for condition in conditions):
        return Markup("")
    clause = too_few_seeds_clause(condition.compared(key) for condition in conditions for key in keys)
    return Markup(" {}.").format(clause) if clause else Markup("")


def _constant(order: Sequence[ControllerResults], key: str) -> Markup:
    same = [controller for controller in order if not controller.over_seeds(key).varies]
    if not same or len(same) == len(order):
        return Markup(" The seed changes nothing here.") if same else Markup("")
    return Markup(" The seed changes nothing for {}.").format(join_words(names(same)))


def _leader(
    condition: Condition, order: Sequence[tuple[float, ControllerResults]], key: str, claim: str
) -> Markup:
    show = formatter(key, 3)
    (best, winner), (second, next_one), (worst, last) = order[0], order[1], order[-1]
    what = condition.name_of(key) + (" (median of the seeds)" if len(condition.seeds) > 1 else "")
    if show(best) == show(second):
        alike = _alike(order, show)
        return Markup("{} share the smallest {}: {}.").format(join_words(names(alike)), what, show(best))
    text = Markup("{} {}: {} {}, against {} of <i>{}</i>").format(
        _first(condition, key, winner), claim, what, show(best), show(second), next_one.label
    )
    if len(order) > 2:
        text += Markup(" and {} of <i>{}</i>").format(show(worst), last.label)
    return text + _unsure_words(condition, key) + "."


def names(controllers: Sequence[ControllerResults]) -> list[Markup]:
    """Set names that are mentioned."""
    return [italic(controller.label) for controller in controllers]


def by_signal(lines: Sequence[tuple[str, Markup]]) -> Markup:
    """Set one line for each signal; the line alone where there is one signal."""
    if len(lines) == 1:
        return lines[0][1]
    entry = Markup("<li><span class='signal'>{}:</span> {}</li>")
    return Markup("<ul class='signals'>{}</ul>").format(
        Markup(" ").join(entry.format(*line) for line in lines)
    )


def counted(count: float, noun: str) -> str:
    """Write a count and its noun: ``1 step``, ``2 steps``."""
    return f"{integer(count)} {noun}" if count == 1 else f"{integer(count)} {noun}s"


def median_and_range(values: Spread, key: str) -> str:
    """Write a median and, where the cases differ, from where to where they are."""
    show = formatter(key)
    if not values.varies:
        return show(values.median)
    return f"{show(values.median)} (range {' to '.join(apart(values.low, values.high, 4))})"


def formatter(key: str, digits: int = 4) -> Callable[[float], str]:
    """Return the function that writes a value of this metric with its unit."""
    return lambda value: with_unit(significant(value, digits), metric_unit(key))


def across_statements(conditions: Sequence[Condition]) -> list[Statement]:
    """Return who tracks best in which scenario; nothing for a single one."""
    if len(conditions) < 2:
        return []
    keys = [*dict.fromkeys(key for condition in conditions for key in condition.headline)]
    lines = [(_signal(conditions[0], key, keys), _winners(conditions, key)) for key in keys]
    return [Statement(_topic(keys[0]), by_signal(lines))] if lines else []


def _winners(conditions: Sequence[Condition], key: str) -> Markup:
    """Say in which scenarios each winner has the smallest median."""
    won: dict[tuple[str, ...], list[Markup]] = {}
    some_failed = any(condition.not_ranked for condition in conditions)
    for condition in conditions:
        order = condition.ranking(key)
        alike = _alike(order, formatter(key))
        if len(order) > 1 and len(alike) < len(order):
            winners = tuple(controller.label for controller in alike)
            won.setdefault(winners, []).append(italic(condition.label))
    if not won:
        return Markup("There is no scenario in which two controllers without a failed run differ.")
    parts: list[Markup] = []
    for winners, where in won.items():
        verb = "share" if len(winners) > 1 else "has"
        claim = "" if parts else f" {verb} the smallest {conditions[0].name_of(key)}"
        who = join_words([bold(label) for label in winners])
        parts.append(Markup("{}{} in {}").format(who, claim, join_words(where)))
    among = ", of those without a failed run there" if some_failed else ""
    return Markup("{}{}.").format(Markup("; ").join(parts), among) + _unsure(conditions, key)


def _unsure(conditions: Sequence[Condition], key: str) -> Markup:
    """Name the scenarios in which the seeds do not tell the first apart from others."""
    where = [
        italic(condition.label) + " (from " + some_of(names(unsure)) + ")"
        for condition in conditions
        if (unsure := condition.level_with_first(key))
    ]
    text = Markup(" The seeds do not tell the first apart in {}.").format(join_words(where)) if where else ""
    behind = [
        italic(condition.label) + " (" + some_of(names(ahead)) + ")"
        for condition in conditions
        if (ahead := condition.ahead_in_pairs(key))
    ]
    if behind:
        text += Markup(" In pairs of the same seed others are ahead of it in {}.").format(join_words(behind))
    return text + _too_few_seeds(conditions, [key])


def limitations(conditions: Sequence[Condition]) -> list[str]:
    """Return the study's own limitations, then those that its results show."""
    sentences = [*conditions[0].results.study.report.limitations] if conditions else []
    sentences += limitations_of_plant(conditions)
    sentences += (
        _of_references(conditions) + _of_cases(conditions) + _of_windows(conditions) + _of_seeds(conditions)
    )
    if conditions:
        sentences.append(
            "Step times are wall-clock times of one machine under the load it had; they rank "
            "implementations, not methods."
        )
    return sentences


def _of_references(conditions: Sequence[Condition]) -> list[str]:
    """Name the references that go beyond the limits of their own outputs, and for whom, where not for all."""
    labels_by_text: dict[str, list[str]] = {}
    everyone = {controller.label for condition in conditions for controller in condition.controllers}
    for condition in conditions:
        for controller in condition.controllers:
            if (trace := condition.first_traces.get(controller.key)) is None:
                continue
            limits = trace.bounds.y_min, trace.bounds.y_max
            for text in references_beyond_limits(trace.outputs, trace.reference, *limits):
                labels_by_text.setdefault(text, []).append(controller.label)
    return [
        f"{text[:1].upper()}{text[1:]}"
        + ("" if set(labels) == everyone else f" ({', '.join(dict.fromkeys(labels))})")
        + f": {CANNOT_FOLLOW}."
        for text, labels in labels_by_text.items()
    ]


def _of_cases(conditions: Sequence[Condition]) -> list[str]:
    of_label: dict[str, list[CaseResult]] = {}
    done: dict[str, int] = {}
    for condition in conditions:
        for controller in condition.controllers:
            of_label.setdefault(controller.label, []).extend(controller.cases)
            done[controller.label] = done.get(controller.label, 0) + len(controller.completed)
    return [
        f"{label}: none of its cases completed, so there are no values of it to compare."
        if not done[label]
        else f"{label}: {counted(len(cases) - done[label], 'case')} did not complete; its medians and ranges "
        "are those of the others, which may be the easier ones."
        for label, cases in of_label.items()
        if done[label] < len(cases)
    ]


def _of_windows(conditions: Sequence[Condition]) -> list[str]:
    """Name the outputs of which no run has a settled error, and those whose reference has no steps."""

    def unknown(name: str) -> list[str]:
        controllers = (controller for condition in conditions for controller in condition.controllers)
        cases = [case for controller in controllers for case in controller.completed]
        return [
            metric_signal(key)
            for key in metric_keys(conditions, name)
            if cases and all(math.isnan(case.metrics.get(key, math.nan)) for case in cases)
        ]

    unsettled, stepless = unknown("settled_error"), unknown("overshoot")
    return [
        f"Whether {signal} settles cannot be judged: its reference moves all the time, its steps follow each "
        f"other within five samples of the largest preview, or the run is as short."
        for signal in unsettled
    ] + [
        f"The reference of {signal} has no steps to size an error by: what is left is in parts of its task."
        for signal in stepless
        if signal not in unsettled
    ]


def _of_seeds(conditions: Sequence[Condition]) -> list[str]:
    if any(len(condition.seeds) > 1 for condition in conditions):
        return ["Lines over time are of the first seed; bands and the distribution show the others."]
    return ["One seed only: how much the results depend on it is not known."] if conditions else []
