"""The answer of a study in a few sentences: who is ahead, how sure that is, what others offer, who fails."""

import math
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.texts import clipped
from ddpc_cosim.metrics import metric_name, metric_of
from ddpc_cosim.study.verdicts.findings import Findings, Lead, Offer, offers_of
from ddpc_cosim.study.verdicts.sentences import (
    elsewhere_sentence,
    failed_runs,
    italic,
    join_words,
    knowing_clause,
    lead_clause,
    not_counted_sentence,
    over_words,
    sentence,
    untested_sentence,
)
from ddpc_cosim.study.verdicts.standings import Standing, Standings
from ddpc_cosim.study.verdicts.statistics import Difference
from ddpc_reports.comparison import Condition, ControllerResults, metric_signal, metric_unit
from ddpc_reports.fairness import knowledge_of_plant
from ddpc_reports.identified import certainty_of_plant
from ddpc_reports.numbers import MINUS, apart, significant, with_unit
from ddpc_reports.verdict import formatter, p_words

_NAMED = 3
"""Controllers that are named with their values where more share the first rank."""
_LONGEST_KNOWLEDGE = 100


def answer(results: StudyResults, seen: Sequence[Condition], findings: Findings) -> Markup:
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
    ranking = findings.standings
    who = {controller.key: controller for condition in seen for controller in condition.controllers}
    if findings.lead is Lead.NOBODY and ranking.left_out:
        return Markup("")
    labels = {key: controller.label for key, controller in who.items()}
    scenarios = {condition.scenario: condition.label for condition in seen}
    clause = lead_clause(findings, labels, scenarios, lambda key, value: formatter(key, 3)(value))
    counting = [condition for condition in seen if condition.scenario not in ranking.left_out]
    unseen = [condition.label for condition in seen if condition.scenario in ranking.left_out]
    offers = {
        offer.controller: _offer_words(offer, who, findings.leaders, counting)
        for offer in offers_of(results.study, results.cases, findings)
    }
    worth = knowing_clause(findings.knowing, labels, scenarios)
    parts = [
        sentence(worth) + "." if worth else "",
        sentence(clause) + _details(findings, who, offers) + ".",
        certainty_of_plant(results, findings, who),
        untested_sentence(findings),
        "Not all ran in the same scenarios on the same seeds: differences are of what two share."
        if ranking.is_uneven
        else "",
        elsewhere_sentence(findings, labels),
        _offered(ranking, who, offers),
        _failing(findings, who),
        not_counted_sentence(unseen),
    ]
    return Markup(" ").join(part for part in parts if part)


def _details(
    findings: Findings, who: dict[str, ControllerResults], offers: Mapping[str, Sequence[str]]
) -> Markup:
    """Go on from who is ahead with values: of those that lead, and of the next."""
    ranking = findings.standings
    if not findings.leaders:
        return Markup("")
    if findings.lead is Lead.FRONT:
        return Markup("")
    if ranking.is_of_money and findings.following:
        return ": " + _both(ranking, who, findings.leaders[0], findings.following)
    if findings.lead in (Lead.LEVEL, Lead.ALIKE):
        return ": " + _of_leaders(findings, [who[name] for name in findings.leaders[:_NAMED]])
    first = findings.leaders[0]
    text = ": " + _values(ranking, who[first])
    if findings.lead is Lead.ONLY_ONE:
        return text + f" {over_words(ranking)}"
    if findings.following and findings.following not in offers and findings.lead is not Lead.ONLY_SOUND:
        label, behind = who[findings.following].label, _behind(ranking, first, findings.following)
        text += Markup("; the next, <i>{}</i>, {}").format(label, behind)
    return text


def _both(ranking: Standings, who: dict[str, ControllerResults], first: str, other: str) -> Markup:
    """Write money and discomfort of the first and of the one that it is compared with."""
    return Markup("{}, against {} of <i>{}</i>").format(
        _values(ranking, who[first]), _values(ranking, who[other], brief=True), who[other].label
    )


def _of_leaders(findings: Findings, shown: Sequence[ControllerResults]) -> Markup:
    """Write the values of those that share the first rank, and how far they are apart."""
    ranking = findings.standings
    if len(ranking.keys) > 1 or len(findings.leaders) == 1:
        values = [
            italic(controller.label) + " " + _values(ranking, controller, brief=True) for controller in shown
        ]
        return Markup("; ").join(values)
    key = ranking.keys[0]
    show = formatter(key, 3)
    medians = join_words([show(ranking.samples[key][controller.key].median) for controller in shown])
    text = Markup("{} {}").format(metric_name(key, shown[0].cases[0].metrics), medians)
    if not ranking.tested:
        return text
    if findings.lead is Lead.ALIKE:
        least = with_unit(significant(ranking.relevant_differences[key], 2), metric_unit(key))
        return text + f", in pairs less than {least} apart"
    differences = [ranking.above(key, shown[0].key, controller.key) for controller in shown[1:]]
    noun = "differences" if len(differences) > 1 else "difference"
    words = join_words([_interval(difference, key) + _why_alike(difference) for difference in differences])
    return text + Markup(", paired {} from the first {}").format(noun, words)


def _why_alike(difference: Difference) -> str:
    """Say the p of two that share a rank though the interval of their difference leaves 0 out."""
    return f" (corrected p {p_words(difference.corrected)})" if difference.low * difference.high > 0 else ""


def _values(ranking: Standings, controller: ControllerResults, *, brief: bool = False) -> Markup:
    """Write the medians of a controller by which it is ranked, with intervals unless brief."""
    parts, several = [], len(ranking.discomforts or ranking.keys) > 1
    for key in dict.fromkeys((*ranking.keys, *ranking.discomforts)):
        sample = ranking.samples[key][controller.key]
        interval = "" if brief else _ends(sample.low, sample.high, key)
        signal = metric_signal(key) if several else ""
        of = f" of {signal}" if signal else ""
        parts.append(f"{with_unit(significant(sample.median, 3), metric_unit(key))}{interval}{of}")
    what = "" if brief else f"{metric_name(ranking.keys[0], controller.cases[0].metrics)} "
    return Markup("{}{}").format(what, join_words(parts))


def _ends(low: float, high: float, key: str) -> str:
    """Write a 95 % interval in brackets; nothing without one, and words where both ends are the same."""
    if math.isnan(low):
        return ""
    if math.isclose(low, high, rel_tol=1e-9, abs_tol=0.0):
        return " [the same on every seed]"
    return f" [{' … '.join(apart(low, high))}]"


def _interval(difference: Difference, key: str) -> str:
    if not difference.pairs:
        return "unknown, without a run of the same seed"
    sign = "+" if difference.median > 0 else ""
    value = with_unit(significant(difference.median, 3), metric_unit(key))
    return f"{sign}{value}{_ends(difference.low, difference.high, key)}"


def _behind(ranking: Standings, first: str, other: str) -> Markup:
    """Say how far a controller is behind the first: difference, interval, and that as a ratio."""
    ratios = {key: ranking.ratio(key, first, other) for key in ranking.keys}
    if len(ratios) > 1 and not any(map(math.isnan, ratios.values())):
        parts = [
            f"{_ratio_words(ratio, 'a factor of {}')} in {metric_signal(key)}"
            for key, ratio in ratios.items()
        ]
        return Markup("differs by {}").format(join_words(parts))
    parts = []
    for key, ratio in ratios.items():
        times = "" if math.isnan(ratio) else f", {_ratio_words(ratio, 'a factor of {}')}"
        of = f" in {metric_signal(key)}" if len(ranking.keys) > 1 else ""
        parts.append(f"{_interval(ranking.above(key, first, other), key)}{times}{of}")
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
        words.append(f"learns from no recording{_knowledge_clause(counting, who[offer.controller])}")
    if offer.key:
        show, more = formatter(offer.key, 2), " or more" if len(leaders) > 1 else ""
        words.append(f"settles to {show(offer.left)} in place of {show(offer.least)}{more}")
    return words


def _offered(
    ranking: Standings, who: dict[str, ControllerResults], offers: Mapping[str, Sequence[str]]
) -> Markup:
    """Say what those behind offer; nothing where they offer nothing."""
    parts = []
    for name, words in offers.items():
        ratio = ranking.ratio(ranking.keys[0], ranking.leaders[0], name)
        behind = "" if math.isnan(ratio) else f" ({_ratio_words(ratio, '{} times')})"
        parts.append(italic(who[name].label) + f"{behind} " + join_words(words))
    return Markup("Behind, {}.").format(Markup("; ").join(parts)) if parts else Markup("")


def _knowledge_clause(counting: Sequence[Condition], controller: ControllerResults) -> str:
    """Say what a controller was told of the plant; nothing where that is nothing, or not known."""
    trace = counting[0].first_traces.get(controller.key)
    knowledge = knowledge_of_plant(counting[0].results, controller, trace)
    return (
        f", but was told of the plant: {clipped(knowledge, _LONGEST_KNOWLEDGE)}"
        if knowledge not in ("", "nothing")
        else ""
    )


def _failing(findings: Findings, who: dict[str, ControllerResults]) -> Markup:
    """Say of whom runs failed, of each how many, and who of them is ahead in those that did not."""
    if not findings.failing or findings.lead is Lead.ALL_FAIL:
        return Markup("")
    return Markup("Failed: {}.").format(
        join_words([_failed_words(findings.standings, who, standing) for standing in findings.failing])
    )


def _failed_words(ranking: Standings, who: dict[str, ControllerResults], standing: Standing) -> Markup:
    text = failed_runs(who[standing.controller].label, standing.failed, standing.runs)
    if len(ranking.keys) == 1 and ranking.leaders:
        key, first = ranking.keys[0], ranking.leaders[0]
        gain = ranking.above(key, standing.controller, first)
        if metric_of(key).better == "low" and gain.low > 0:
            ahead = Markup(" (in the others ahead of <i>{}</i> by {}{})")
            show = with_unit(significant(gain.median, 3), metric_unit(key))
            text += ahead.format(who[first].label, show, _ends(gain.low, gain.high, key))
    return text
