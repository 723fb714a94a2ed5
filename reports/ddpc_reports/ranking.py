"""The part of the verdict that ranks: who tracks, settles and moves the actuator best, and by how much."""

from collections.abc import Sequence

from markupsafe import Markup

from ddpc_reports.comparison import (
    TRACKING,
    Competitor,
    Condition,
    metric_label,
    metric_signal,
    ranked,
)
from ddpc_reports.words import Statement, by_signal, listed, median_and_range, names, shower

_POOR = 3.0
"""From this many times the best tracking error on, little actuator travel is no merit."""


def tracking(condition: Condition) -> list[Statement]:
    """Return who tracks best: at the first seed and over all; of several outputs one line for each."""
    keys = condition.keys(TRACKING)
    if len(keys) > 1:
        return [_each_signal(condition, keys, "Tracking")]
    statements = []
    for key in keys:
        statements.append(Statement("Tracking", _first_seed(condition, key)))
        if len(condition.seeds) > 1:
            statements.append(Statement("Spread", _over_seeds(condition, key)))
    return statements


def _each_signal(condition: Condition, keys: Sequence[str], topic: str) -> Statement:
    """State in short who is first, next and last for each of several signals."""
    seeds = len(condition.seeds)
    over = f", medians over {seeds} seeds and ranges" if seeds > 1 else ""
    lines = [(metric_signal(key), _in_short(condition, key)) for key in keys]
    return Statement(topic, Markup("{}{}:").format(metric_label(keys[0]), over) + by_signal(lines))


def _in_short(condition: Condition, key: str) -> Markup:
    order = _by_median(condition, key)
    if not order:
        return Markup("no controller completed every case.")
    show = shower(key)
    winner = order[0][1]
    text = Markup("<b>{}</b> {}").format(winner.label, median_and_range(winner.over_seeds(key), key))
    if len(order) > 1:
        text += Markup(", then <i>{}</i> {}").format(order[1][1].label, show(order[1][0]))
    if len(order) > 2:
        text += Markup("; last is <i>{}</i> with {}").format(order[-1][1].label, show(order[-1][0]))
    return text + "."


def least(condition: Condition, name: str, topic: str, claim: str) -> list[Statement]:
    """State who has the smallest median of a metric, and by how much, for each signal that has it."""
    known = [(key, order) for key in condition.keys(name) if len(order := _by_median(condition, key)) > 1]
    if len(known) > 1:
        return [_each_signal(condition, [key for key, _ in known], topic)]
    return [Statement(topic, _leader(order, key, claim, len(condition.seeds))) for key, order in known]


def least_travel(condition: Condition) -> list[Statement]:
    """State who moves the actuators least and, of one that hardly tracks, that too."""
    statements = least(condition, "total_variation", "Actuator", "moves the actuator least")
    travels, costs = condition.keys("total_variation"), condition.keys(TRACKING)
    if not statements or len(travels) > 1 or len(costs) > 1:
        return statements
    tracks = _by_median(condition, costs[0])
    winner = _by_median(condition, travels[0])[0][1]
    own = winner.over_seeds(costs[0]).median
    if not tracks or not own > _POOR * tracks[0][0]:
        return statements
    show = shower(costs[0], 3)
    text = Markup(" Its tracking error is far from the best, though: {} against {}.").format(
        show(own), show(tracks[0][0])
    )
    return [Statement(topic, sentence + text) for topic, sentence in statements]


def _by_median(condition: Condition, key: str) -> list[tuple[float, Competitor]]:
    complete = [one for one in condition.competitors if one.completed_all]
    return ranked(complete, [one.over_seeds(key).median for one in complete])


def _first_seed(condition: Condition, key: str) -> Markup:
    order = ranked(condition.competitors, [one.at_first(key) for one in condition.competitors])
    seed = condition.seeds[0]
    if not order:
        return Markup("No controller completed the case of seed {}.").format(seed)
    show = shower(key)
    what = metric_label(key).lower()
    if len(order) == 1:
        return Markup(
            "On seed {}, <b>{}</b> reaches an {} of {}; no other completed case to compare with."
        ).format(seed, order[0][1].label, what, show(order[0][0]))
    (best, winner), (second, next_one), (worst, last) = order[0], order[1], order[-1]
    if show(best) == show(worst):
        return Markup("On seed {} all controllers track alike: {} {}.").format(seed, what, show(best))
    if show(best) == show(second):
        text = Markup("On seed {}, {} track best: {} {}").format(
            seed, listed(names([one for value, one in order if show(value) == show(best)])), what, show(best)
        )
    else:
        text = Markup("On seed {}, <b>{}</b> tracks best: {} {}, then <i>{}</i> with {}").format(
            seed, winner.label, what, show(best), next_one.label, show(second)
        )
    return text + (
        Markup("; last is <i>{}</i> with {}.").format(last.label, show(worst))
        if len(order) > 2
        else Markup(".")
    )


def _over_seeds(condition: Condition, key: str) -> Markup:
    order = _by_median(condition, key)
    if not order:
        return Markup("No controller completed every seed, so medians over the seeds are not compared.")
    winner, rest = order[0][1], [one for _, one in order[1:]]
    figure = median_and_range(winner.over_seeds(key), key)
    if not rest:
        return Markup("Only <b>{}</b> completed every seed: median {}; nothing to compare with.").format(
            winner.label, figure
        )
    alike = [one for value, one in order if shower(key)(value) == shower(key)(order[0][0])]
    if len(alike) > 1:
        return Markup("Over {} seeds, {} share the smallest median: {}.").format(
            len(condition.seeds), listed(names(alike)), shower(key)(order[0][0])
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
        rival.label, median_and_range(rival.over_seeds(key), key), wins, len(shared)
    )


def _overlap(winner: Competitor, others: Sequence[Competitor], key: str) -> Markup:
    reach = winner.over_seeds(key).high
    inside = [one for one in others if one.over_seeds(key).low <= reach]
    if not inside:
        return Markup(" Its range lies below that of every other controller.")
    return Markup(" The ranges of {} overlap with its own, so the seed decides who is ahead there.").format(
        listed(names(inside)) if len(inside) < 4 else f"{len(inside)} controllers"
    )


def _constant(order: Sequence[Competitor], key: str) -> Markup:
    same = [one for one in order if not one.over_seeds(key).varies]
    if not same or len(same) == len(order):
        return Markup(" The seed changes nothing here.") if same else Markup("")
    return Markup(" The seed changes nothing for {}.").format(listed(names(same)))


def _leader(order: Sequence[tuple[float, Competitor]], key: str, claim: str, seeds: int) -> Markup:
    show = shower(key, 3)
    (best, winner), (second, next_one) = order[0], order[1]
    what = metric_label(key).lower() + (" (median of the seeds)" if seeds > 1 else "")
    if show(best) == show(second):
        alike = [one for value, one in order if show(value) == show(best)]
        return Markup("{} share the smallest {}: {}.").format(listed(names(alike)), what, show(best))
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
