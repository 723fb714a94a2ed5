"""The answer of a study in a few sentences: who is ahead, how sure that is, what others offer, who fails."""

import math
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.metrics import metric_name, metric_of
from ddpc_cosim.study.verdicts.findings import Findings, Lead, Offer, offers_of
from ddpc_cosim.study.verdicts.sentences import (
    elsewhere_sentence,
    failed_runs,
    italic,
    join_words,
    lead_clause,
    not_counted_sentence,
    over_words,
    sentence,
    untested_sentence,
)
from ddpc_cosim.study.verdicts.standings import Standing, Standings
from ddpc_cosim.study.verdicts.statistics import Difference
from ddpc_cosim.texts import clipped
from ddpc_reports.comparison import Condition, ControllerResults, metric_signal, metric_unit
from ddpc_reports.fairness import told_of_plant
from ddpc_reports.numbers import MINUS, apart, significant, with_unit
from ddpc_reports.verdict import formatter, p_words

_NAMED = 3
"""Controllers that are named with their values where more share the first rank."""
_LONGEST_TOLD = 100


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
    ranking = told.standings
    who = {one.key: one for condition in seen for one in condition.controllers}
    if told.lead is Lead.NOBODY and ranking.left_out:
        return Markup("")
    labels = {key: one.label for key, one in who.items()}
    clause = lead_clause(told, labels, {one.scenario: one.label for one in seen})
    counting = [one for one in seen if one.scenario not in ranking.left_out]
    unseen = [one.label for one in seen if one.scenario in ranking.left_out]
    offers = {
        offer.controller: _offer_words(offer, who, told.leaders, counting)
        for offer in offers_of(results.study, results.cases, told)
    }
    parts = [
        sentence(clause) + _details(told, who, offers) + ".",
        untested_sentence(told),
        "Not all ran in the same scenarios on the same seeds: differences are of what two share."
        if ranking.is_uneven
        else "",
        elsewhere_sentence(told, labels),
        _offered(ranking, who, offers),
        _failing(told, who),
        not_counted_sentence(unseen),
    ]
    return Markup(" ").join(part for part in parts if part)


def _details(
    told: Findings, who: dict[str, ControllerResults], offers: Mapping[str, Sequence[str]]
) -> Markup:
    """Go on from who is ahead with values: of those that lead, and of the next."""
    ranking = told.standings
    if not told.leaders:
        return Markup("")
    if told.lead in (Lead.LEVEL, Lead.ALIKE):
        return ": " + _of_leaders(told, [who[name] for name in told.leaders[:_NAMED]])
    first = told.leaders[0]
    text = ": " + _values(ranking, first)
    if told.lead is Lead.ONLY_ONE:
        return text + f" {over_words(ranking)}"
    if told.following and told.following not in offers and told.lead is not Lead.ONLY_SOUND:
        label, behind = who[told.following].label, _behind(ranking, first, told.following)
        text += Markup("; the next, <i>{}</i>, {}").format(label, behind)
    return text


def _of_leaders(told: Findings, shown: Sequence[ControllerResults]) -> Markup:
    """Write the values of those that share the first rank, and how far they are apart."""
    ranking = told.standings
    if len(ranking.keys) > 1 or len(told.leaders) == 1:
        values = [italic(one.label) + " " + _values(ranking, one.key, brief=True) for one in shown]
        return Markup("; ").join(values)
    key = ranking.keys[0]
    show = formatter(key, 3)
    medians = join_words([show(ranking.samples[key][one.key].median) for one in shown])
    text = Markup("{} {}").format(metric_name(key), medians)
    if not ranking.tested:
        return text
    if told.lead is Lead.ALIKE:
        least = with_unit(significant(ranking.relevant_differences[key], 2), metric_unit(key))
        return text + f", in pairs less than {least} apart"
    differences = [ranking.above(key, shown[0].key, one.key) for one in shown[1:]]
    noun = "differences" if len(differences) > 1 else "difference"
    words = join_words([_interval(one, key) + _why_alike(one) for one in differences])
    return text + Markup(", paired {} from the first {}").format(noun, words)


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


def _interval(found: Difference, key: str) -> str:
    if not found.pairs:
        return "unknown, without a run of the same seed"
    sign = "+" if found.median > 0 else ""
    value = with_unit(significant(found.median, 3), metric_unit(key))
    return f"{sign}{value}{_ends(found.low, found.high, key)}"


def _behind(found: Standings, first: str, other: str) -> Markup:
    """Say how far a controller is behind the first: difference, interval, and that as a ratio."""
    ratios = {key: found.ratio(key, first, other) for key in found.keys}
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
        parts.append(f"{_interval(found.above(key, first, other), key)}{times}{of}")
    return Markup("differs by {}").format(join_words(parts))


def _ratio_words(ratio: float, factor: str) -> str:
    """Write by how much two differ: in percent near one, else in words in which ``{}`` is the factor."""
    percent = 100 * (ratio - 1)
    if abs(percent) < 99.5:
        sign = "+" if percent >= 0 else MINUS
        return f"{sign}{significant(abs(percent), 2)}\u00a0%"
    return factor.format(significant(ratio, 2))


def _offer_words(
    offer: Offer, who: dict[str, ControllerResults], leaders: Sequence[str], counting: Sequence[Condition]
) -> list[str]:
    words = []
    if offer.needs_no_recording:
        words.append(f"learns from no recording{_but_told(counting, who[offer.controller])}")
    if offer.key:
        show, more = formatter(offer.key, 2), " or more" if len(leaders) > 1 else ""
        words.append(f"settles to {show(offer.left)} in place of {show(offer.least)}{more}")
    return words


def _offered(
    found: Standings, who: dict[str, ControllerResults], offers: Mapping[str, Sequence[str]]
) -> Markup:
    """Say what those behind offer; nothing where they offer nothing."""
    parts = []
    for name, words in offers.items():
        ratio = found.ratio(found.keys[0], found.leaders[0], name)
        behind = "" if math.isnan(ratio) else f" ({_ratio_words(ratio, '{} times')})"
        parts.append(italic(who[name].label) + f"{behind} " + join_words(words))
    return Markup("Behind, {}.").format(Markup("; ").join(parts)) if parts else Markup("")


def _but_told(counting: Sequence[Condition], one: ControllerResults) -> str:
    """Say what a controller was told of the plant; nothing where that is nothing, or not known."""
    trace = counting[0].first_traces.get(one.key)
    told = told_of_plant(counting[0].results, one, trace)
    return (
        f", but was told of the plant: {clipped(told, _LONGEST_TOLD)}" if told not in ("", "nothing") else ""
    )


def _failing(told: Findings, who: dict[str, ControllerResults]) -> Markup:
    """Say of whom runs failed, of each how many, and who of them is ahead in those that did not."""
    if not told.failing or told.lead is Lead.ALL_FAIL:
        return Markup("")
    return Markup("Failed: {}.").format(
        join_words([_failed_words(told.standings, who, one) for one in told.failing])
    )


def _failed_words(found: Standings, who: dict[str, ControllerResults], one: Standing) -> Markup:
    text = failed_runs(who[one.controller].label, one.failed, one.runs)
    if len(found.keys) == 1 and found.leaders:
        key, first = found.keys[0], found.leaders[0]
        gain = found.above(key, one.controller, first)
        if metric_of(key).better == "low" and gain.low > 0:
            ahead = Markup(" (in the others ahead of <i>{}</i> by {}{})")
            show = with_unit(significant(gain.median, 3), metric_unit(key))
            text += ahead.format(who[first].label, show, _ends(gain.low, gain.high, key))
    return text
