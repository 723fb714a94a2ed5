"""The answer of a study in a few sentences: who is ahead, how sure that is, what others offer, who fails."""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.metrics import metric_name, metric_of
from ddpc_cosim.study.verdicts.findings import Findings, Lead
from ddpc_cosim.study.verdicts.standings import Standing, Standings
from ddpc_cosim.study.verdicts.statistics import Difference, compare, describe
from ddpc_cosim.texts import clipped
from ddpc_reports.comparison import Condition, ControllerResults, metric_signal, metric_unit
from ddpc_reports.fairness import told_of_plant
from ddpc_reports.numbers import MINUS, apart, significant, with_unit
from ddpc_reports.verdict import counted, formatter, join_words, names, p_words, some_of

_NAMED = 3
"""Controllers that are named with their values where more share the first rank."""
_LONGEST_TOLD = 100
_MUCH_LESS = 0.5
"""From this part of a leader's on, a value of another is worth a word."""


def answer(results: StudyResults, seen: Sequence[Condition], told: Findings) -> Markup:
    """Return who is ahead in a problem and how sure that is, from intervals and not adjectives.

    Parameters
    ----------
    results : StudyResults
        The results of one problem.
    seen : sequence of Condition
        Its scenarios.
    told : Findings
        What they show, over all scenarios that count.
    """
    found = told.standings
    who = {one.key: one for condition in seen for one in condition.controllers}
    if told.lead is Lead.NOBODY:
        return Markup("") if found.left_out else Markup("No controller competes here, so nothing is ranked.")
    counting = [one for one in seen if one.scenario not in found.left_out]
    labels = [Markup("<i>{}</i>").format(one.label) for one in seen if one.scenario in found.left_out]
    offers = _offers(told, who, counting)
    parts = [
        _lead(told, who, counting, offers),
        _uneven(found),
        _elsewhere(found, who, counting) if told.leaders else "",
        _offered(found, who, offers),
        _failing(told, who),
        Markup("Not counted, as every controller fails there: {}.").format(some_of(labels)) if labels else "",
    ]
    return Markup(" ").join(part for part in parts if part)


def _over(found: Standings, counting: Sequence[Condition]) -> str:
    """Say over what the medians are: ``over 6 scenarios and 10 seeds``."""
    scenarios = f"{len(counting)} scenarios" if len(counting) > 1 else ""
    if found.seeds > 1:
        return "over " + " and ".join(filter(None, (scenarios, f"{found.seeds} seeds")))
    return f"over {scenarios}, on one seed" if scenarios else "on the one seed that was run"


def _lead(
    told: Findings,
    who: dict[str, ControllerResults],
    counting: Sequence[Condition],
    offers: Mapping[str, Sequence[str]],
) -> Markup:
    """Say who is ahead; where scenarios disagree, who leads where."""
    found, over = told.standings, _over(told.standings, counting)
    if told.lead is Lead.BY_SCENARIO:
        return _by_scenario(found, who, counting)
    if told.lead is Lead.ALL_FAIL:
        return _all_fail_some(found, who)
    leaders = [who[name] for name in told.leaders]
    best = leaders[0]
    if told.lead is Lead.ONLY_ONE:
        text = Markup("There is nothing to compare <i>{}</i> with: {} {}.")
        return text.format(best.label, _values(found, best.key), over)
    if told.lead in (Lead.LEVEL, Lead.ALIKE):
        return _level(told, leaders, over) + _unsure(found)
    if told.lead is Lead.ONLY_SOUND:
        text = Markup("<b>{}</b> alone has no failed run, {}: {}.")
        return text.format(best.label, over, _values(found, best.key))
    name = Markup("<b>{}</b>" if told.is_sure else "<i>{}</i>").format(best.label)
    medians = "has the best median" if len(found.keys) == 1 else "has the best medians"
    verb = "is ahead" if told.lead is Lead.AHEAD else medians
    text = Markup("{} {} {}: {}").format(name, verb, over, _values(found, best.key))
    if told.following and told.following not in offers:
        label, behind = who[told.following].label, _behind(found, best.key, told.following)
        text += Markup("; the next, <i>{}</i>, {}").format(label, behind)
    return text + "." + _unsure(found)


def _by_scenario(
    found: Standings, who: dict[str, ControllerResults], counting: Sequence[Condition]
) -> Markup:
    """Say who leads in which scenario, as no rank over all of them would be fair."""
    where: dict[tuple[str, ...], list[Markup]] = {}
    names_of = {one.scenario: Markup("<i>{}</i>").format(one.label) for one in counting}
    for scenario, leaders in found.leaders_by_scenario.items():
        where.setdefault(leaders, []).append(names_of[scenario])
    parts = []
    for leaders, scenarios in where.items():
        bold = [Markup("<b>{}</b>").format(who[name].label) for name in leaders]
        lead = "leads" if len(bold) == 1 else "lead together"
        if not bold:
            bold, lead = [Markup("no controller")], "is without a failed run"
        parts.append(Markup("{} {} in {}").format(some_of(bold), lead, some_of(scenarios)))
    text = "The scenarios disagree, so there is no overall rank: {}."
    return Markup(text).format(Markup("; ").join(parts))


def _uneven(found: Standings) -> Markup:
    """Say that not all have the same runs; nothing where they have."""
    own = next(iter(found.runs.values()), {})
    if len({frozenset(runs) for runs in own.values()}) < 2:
        return Markup("")
    return Markup("Not all ran in the same scenarios on the same seeds: differences are of what two share.")


def _elsewhere(found: Standings, who: dict[str, ControllerResults], counting: Sequence[Condition]) -> Markup:
    """Say in how many scenarios others are ahead of the leaders, and who; nothing where none is."""
    others: dict[str, int] = {}
    led = 0
    for here in found.leaders_by_scenario.values():
        led += bool({*here} & {*found.leaders})
        for name in here if not {*here} & {*found.leaders} else ():
            others[name] = others.get(name, 0) + 1
    if not others:
        return Markup("")
    most = sorted(others, key=lambda name: -others[name])
    named = [Markup("<i>{}</i> ({})").format(who[name].label, others[name]) for name in most]
    it = "it leads" if len(found.leaders) == 1 else "one of them leads"
    do = "does" if len(named) == 1 else "do"
    together = ", some together" if sum(others.values()) > len(counting) - led else ""
    text = "Scenario by scenario {} in {} of {}; in the others {} {}{}."
    return Markup(text).format(it, led or "none", len(counting), some_of(named), do, together)


def _level(told: Findings, leaders: Sequence[ControllerResults], over: str) -> Markup:
    """Say that several share the first rank, with their values and how far they are apart."""
    found, shown = told.standings, leaders[:_NAMED]
    more = len(leaders) - len(shown)
    bold = [Markup("<b>{}</b>").format(one.label) for one in shown]
    who = join_words([*bold, *([f"{more} more"] if more else [])])
    if not found.tested:
        return Markup("{} share the best medians {}: {}.").format(who, over, _values(found, shown[0].key))
    if len(found.keys) > 1 or len(leaders) == 1:
        values = [
            Markup("<i>{}</i> {}").format(one.label, _values(found, one.key, brief=True)) for one in shown
        ]
        return Markup("No controller is significantly better than {} {}: {}.").format(
            who, over, Markup("; ").join(values)
        )
    key = found.keys[0]
    show = formatter(key, 3)
    medians = join_words([show(found.samples[key][one.key].median) for one in shown])
    if told.lead is Lead.ALIKE:
        text = Markup(
            "{} lead {}, and no difference between them matters: {} {}, in pairs less than {} apart."
        )
        least = with_unit(significant(found.relevant_differences[key], 2), metric_unit(key))
        return text.format(who, over, metric_name(key), medians, least)
    apart = [_difference(found, key, shown[0].key, one.key) for one in shown[1:]]
    told_apart = any(
        one is not None and one.told_apart
        for one in (found.difference(key, *pair) for pair in combinations(told.leaders, 2))
    )
    how = "none of them is told to be better by enough to matter" if told_apart else "are not told apart"
    text = Markup("{} lead {} and {}: {} {}").format(who, over, how, metric_name(key), medians)
    words = join_words([_interval(one, key) + _why_alike(one) for one in apart])
    return text + Markup(", paired {} from the first {}.").format(
        "differences" if len(apart) > 1 else "difference", words
    )


def _why_alike(found: Difference) -> str:
    """Say the p of two that share a rank though the interval of their difference leaves 0 out."""
    return f" (corrected p {p_words(found.corrected)})" if found.low * found.high > 0 else ""


def _values(found: Standings, name: str, *, brief: bool = False) -> Markup:
    """Write the medians of a controller by which it is ranked, with intervals unless brief."""
    parts = []
    for key in found.keys:
        sample = found.samples[key][name]
        interval = "" if brief else _ends(sample.low, sample.high, key)
        of = f" of {metric_signal(key)}" if len(found.keys) > 1 else ""
        parts.append(f"{with_unit(significant(sample.median, 3), metric_unit(key))}{interval}{of}")
    what = "" if brief else f"{metric_name(found.keys[0])} "
    return Markup("{}{}").format(what, join_words(parts))


def _ends(low: float, high: float, key: str) -> str:
    """Write a 95 % interval in brackets; nothing without one, and words where both ends are the same."""
    if math.isnan(low):
        return ""
    if math.isclose(low, high, rel_tol=1e-9, abs_tol=0.0):
        return " [the same on every seed]"
    return f" [{' … '.join(apart(low, high))}]"


def _difference(found: Standings, key: str, first: str, other: str) -> Difference:
    """Return by how much another is above the first, in pairs of the same scenario and seed."""
    runs, tested = found.runs[key], found.compared[key].differences
    pair = tested.get((first, other)) or tested.get((other, first))
    own = compare(runs[other], runs[first], metric_of(key).better)
    return own._replace(corrected=pair.corrected) if pair else own


def _interval(found: Difference, key: str) -> str:
    if not found.pairs:
        return "unknown, without a run of the same seed"
    sign = "+" if found.median > 0 else ""
    value = with_unit(significant(found.median, 3), metric_unit(key))
    return f"{sign}{value}{_ends(found.low, found.high, key)}"


def _behind(found: Standings, first: str, other: str) -> Markup:
    """Say how far a controller is behind the first: difference, interval, and that as a ratio."""
    ratios = {key: _ratio(found, key, first, other) for key in found.keys}
    if len(ratios) > 1 and not any(map(math.isnan, ratios.values())):
        parts = [
            f"{_ratio_words(ratio, 'a factor of {}')} in {metric_signal(key)}"
            for key, ratio in ratios.items()
        ]
        return Markup("differs by {}").format(join_words(parts))
    parts = []
    for key, ratio in ratios.items():
        times = "" if math.isnan(ratio) else f", {_ratio_words(ratio, 'a factor of {}')}"
        of = f" in {metric_signal(key)}" if len(found.keys) > 1 else ""
        parts.append(f"{_interval(_difference(found, key, first, other), key)}{times}{of}")
    return Markup("differs by {}").format(join_words(parts))


def _ratio(found: Standings, key: str, first: str, other: str) -> float:
    """Return one plus the difference of the pairs over the first's median; NaN if that is not above 0."""
    runs = found.runs[key]
    best = describe({run: value for run, value in runs[first].items() if run in runs[other]}).median
    ratio = 1 + _difference(found, key, first, other).median / best if best > 0 else math.nan
    return ratio if ratio >= 0 else math.nan


def _ratio_words(ratio: float, factor: str) -> str:
    """Write by how much two differ: in percent near one, else in words in which ``{}`` is the factor."""
    percent = 100 * (ratio - 1)
    if abs(percent) < 99.5:
        sign = "+" if percent >= 0 else MINUS
        return f"{sign}{significant(abs(percent), 2)}\u00a0%"
    return factor.format(significant(ratio, 2))


def _unsure(found: Standings) -> Markup:
    """Say why nothing could be tested; nothing where it was."""
    if found.tested or len(found.order) < 2:
        return Markup("")
    if found.seeds < 2:
        return Markup(" How much that depends on the seed is not known.")
    tested = max(len(one.order) for one in found.compared.values())
    return Markup(" {} seeds are too few to test {} controllers against each other: it takes {}.").format(
        found.seeds_compared, tested, found.seeds_needed
    )


def _offers(
    told: Findings, who: dict[str, ControllerResults], counting: Sequence[Condition]
) -> dict[str, list[str]]:
    """Return what the best of those behind offer that the leaders do not."""
    found = told.standings
    leaders = [who[name] for name in told.leaders]
    rest = [who[one.controller] for one in found.order if not one.failed and one.rank > 1]
    if not leaders or not rest or len(found.keys) > 1:
        return {}
    offers: dict[str, list[str]] = {}
    if all(_recorded(one) for one in leaders):
        for one in [one for one in rest if not _recorded(one)][:1]:
            offers.setdefault(one.key, []).append(f"learns from no recording{_but_told(counting, one)}")
    if len(counting) == 1 and (settled := _settles_closest(counting[0], leaders, rest)):
        offers.setdefault(settled[0], []).append(settled[1])
    return offers


def _offered(
    found: Standings, who: dict[str, ControllerResults], offers: Mapping[str, Sequence[str]]
) -> Markup:
    """Say what those behind offer; nothing where they offer nothing."""
    parts = []
    for name, words in offers.items():
        ratio = _ratio(found, found.keys[0], found.leaders[0], name)
        behind = "" if math.isnan(ratio) else f" ({_ratio_words(ratio, '{} times')})"
        parts.append(Markup("<i>{}</i>{} {}").format(who[name].label, behind, join_words(words)))
    return Markup("Behind, {}.").format(Markup("; ").join(parts)) if parts else Markup("")


def _but_told(counting: Sequence[Condition], one: ControllerResults) -> str:
    """Say what a controller was told of the plant; nothing where that is nothing, or not known."""
    trace = counting[0].first_traces.get(one.key)
    told = told_of_plant(counting[0].results, one, trace)
    return (
        f", but was told of the plant: {clipped(told, _LONGEST_TOLD)}" if told not in ("", "nothing") else ""
    )


def _recorded(one: ControllerResults) -> bool:
    return any(case.recorded_samples for case in one.cases)


def _settles_closest(
    condition: Condition, leaders: Sequence[ControllerResults], rest: Sequence[ControllerResults]
) -> tuple[str, str] | None:
    """Return who of the rest is told to settle closer than each leader, at half of its error or less."""
    keys = condition.keys("settled_error")
    if len(keys) != 1:
        return None
    here = {one.key: one for one in condition.controllers}
    values = {one.key: here[one.key].over_seeds(keys[0]).median for one in (*leaders, *rest)}
    known = [one.key for one in rest if not math.isnan(values[one.key])]
    if not known:
        return None
    name = min(known, key=values.__getitem__)
    least = min((values[one.key] for one in leaders), default=math.nan)
    differences = condition.compared(keys[0]).differences
    sure = all((name, one.key) in differences and differences[name, one.key].told_apart for one in leaders)
    if not sure or not values[name] <= _MUCH_LESS * least:
        return None
    show = formatter(keys[0], 2)
    more = " or more" if len(leaders) > 1 else ""
    return name, f"settles to {show(values[name])} in place of {show(least)}{more}"


def _failing(told: Findings, who: dict[str, ControllerResults]) -> Markup:
    """Say of whom runs failed, of each how many, and who of them is ahead in those that did not."""
    if not told.failing or told.lead is Lead.ALL_FAIL:
        return Markup("")
    return Markup("Failed: {}.").format(
        join_words([_failed_words(told.standings, who, one) for one in told.failing])
    )


def _failed_words(found: Standings, who: dict[str, ControllerResults], one: Standing) -> Markup:
    text = Markup("<b>{}</b> {} of {} runs").format(who[one.controller].label, one.failed, one.runs)
    if len(found.keys) == 1 and found.leaders:
        key, first = found.keys[0], found.leaders[0]
        gain = compare(found.runs[key][first], found.runs[key][one.controller], metric_of(key).better)
        if metric_of(key).better == "low" and gain.low > 0:
            ahead = Markup(" (in the others ahead of <i>{}</i> by {}{})")
            show = with_unit(significant(gain.median, 3), metric_unit(key))
            text += ahead.format(who[first].label, show, _ends(gain.low, gain.high, key))
    return text


def _all_fail_some(found: Standings, who: dict[str, ControllerResults]) -> Markup:
    fewest = [one for one in found.order if one.rank == 1]
    which = some_of(names([who[one.controller] for one in fewest]))
    return Markup("No controller is without a failed run. Fewest failed: {} {} of {}.").format(
        which, fewest[0].failed, counted(fewest[0].runs, "run")
    )
