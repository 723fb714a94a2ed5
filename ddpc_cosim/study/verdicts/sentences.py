"""What the findings say, in clauses: the one place of words on who is ahead.

The terminal prints a clause as it is, without its marks; the page goes on with values and intervals. A
clause begins with a small letter and has no full stop. Names are set in bold where the results are sure of
them, else in italics: a label may itself hold commas.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import fmean

from markupsafe import Markup

from ddpc_cosim.metrics import metric_name, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.verdicts.findings import Findings, Lead
from ddpc_cosim.study.verdicts.knowing import Knowing
from ddpc_cosim.study.verdicts.ranks import AverageRanks
from ddpc_cosim.study.verdicts.reliability import FailureRate
from ddpc_cosim.study.verdicts.standings import Standings
from ddpc_cosim.study.verdicts.statistics import LEVEL, Comparisons

_NAMED = 3
"""Controllers that are named where there are more."""
_MATTERS = 0.01
"""From which share of its samples on a run outside the log is said."""
_MOST = 1000.0
"""From so many percent on, and of nothing, a difference is said in its unit."""

Labels = Mapping[str, str]
"""Of controllers or scenarios by name, what they are called in print."""
Show = Callable[[str, float], str]
"""Writes a value of a metric, given by its key, with its unit."""


def plain_value(key: str, value: float) -> str:
    """Write a value as every terminal can show it."""
    return f"{value:.3g} {_unit(key)}"


def _unit(key: str) -> str:
    """Return the unit of a metric in which a difference of temperatures is in K."""
    return split_key(key)[2].replace("degC", "K")


def join_words(parts: Sequence[str | Markup]) -> Markup:
    """Join parts as in a sentence: ``a, b and c``."""
    *head, last = parts
    return Markup("{} and {}").format(Markup(", ").join(head), last) if head else Markup("{}").format(last)


def some_of(parts: Sequence[Markup]) -> Markup:
    """Join the first of some parts as in a sentence, and say how many more there are."""
    more = len(parts) - _NAMED
    return join_words([*parts[:_NAMED], *([f"{more} more"] if more > 0 else [])])


def italic(label: str) -> Markup:
    """Set a name that is only mentioned."""
    return Markup("<i>{}</i>").format(label)


def bold(label: str) -> Markup:
    """Set a name of which the results are sure."""
    return Markup("<b>{}</b>").format(label)


def sentence(clause: Markup) -> Markup:
    """Return a clause as it begins a sentence; a name at its beginning stays as it is."""
    return clause[:1].upper() + clause[1:]


def lead_clause(
    findings: Findings, controllers: Labels, scenarios: Labels, show: Show = plain_value
) -> Markup:
    """Say who is ahead, and in which way; of scenarios that disagree, who leads where."""
    ranking = findings.standings
    if findings.lead is Lead.NOBODY:
        return Markup("no controller competes here, so nothing is ranked")
    if findings.lead is Lead.ALL_FAIL:
        return _fewest_failed(ranking, controllers)
    if findings.lead is Lead.BY_SCENARIO:
        return _by_scenario(ranking, controllers, scenarios)
    over, (first, *_) = over_words(ranking), findings.leaders
    if findings.lead is Lead.ONLY_ONE:
        return Markup("there is nothing to compare {} with").format(italic(controllers[first]))
    if findings.lead is Lead.ONLY_SOUND:
        return Markup("{} alone has no failed run, {}").format(bold(controllers[first]), over)
    if findings.lead in (Lead.LEVEL, Lead.ALIKE):
        return _level(findings, controllers, over)
    if findings.lead is Lead.FRONT:
        return _front(findings, controllers, over, show)
    if ranking.is_of_money and findings.following:
        return _cheaper(findings, controllers, over, show)
    name = (bold if findings.is_sure else italic)(controllers[first])
    medians = "has the best median" if len(ranking.keys) == 1 else "has the best medians"
    return Markup("{} {} {}").format(name, "is ahead" if findings.lead is Lead.AHEAD else medians, over)


def beyond_log_clause(cases: Iterable[CaseResult]) -> Markup:
    """Say who leaves what the logs recorded that the plant is identified from; nothing where none does."""
    shares: dict[str, list[dict[str, float]]] = {}
    for case in cases:
        shares.setdefault(case.label, []).append(case.beyond_log)
    means = {
        label: {name: fmean(share.get(name, 0.0) for share in of_label) for name in set().union(*of_label)}
        for label, of_label in shares.items()
    }
    leaving = {
        label: (name, share)
        for label, by_name in means.items()
        for share, name in [max(((share, name) for name, share in by_name.items()), default=(0.0, ""))]
        if share >= _MATTERS
    }
    if not leaving:
        return Markup("")
    parts = [
        Markup("{} ({} in {:.2g} % of the samples)").format(italic(label), name, 100.0 * share)
        for label, (name, share) in sorted(leaving.items(), key=lambda item: -item[1][1])
    ]
    return Markup("beyond what the log recorded, where a model from it says nothing, went {}").format(
        some_of(parts)
    )


def over_words(ranking: Standings) -> str:
    """Say over what the medians are: ``over 6 scenarios and 10 seeds``."""
    count = len(ranking.by_scenario)
    scenarios = f"{count} scenarios" if count else ""
    if ranking.seeds > 1:
        return "over " + " and ".join(filter(None, (scenarios, f"{ranking.seeds} seeds")))
    return f"over {scenarios}, on one seed" if scenarios else "on the one seed that was run"


def _level(findings: Findings, controllers: Labels, over: str) -> Markup:
    """Say that several share the first rank, and why."""
    who = some_of([bold(controllers[name]) for name in findings.leaders])
    has_several_outputs = len(findings.standings.keys) > 1
    if not findings.standings.tested:
        if has_several_outputs:  # one may be better in an output, and worse in another
            return Markup("{} share the best medians {}").format(who, over)
        return Markup("{} have the best medians {}, which differ by too little to matter").format(who, over)
    if has_several_outputs or len(findings.leaders) == 1:
        if findings.lead is Lead.ALIKE or findings.tells_leaders_apart:
            return Markup("no controller is better than {} {} by enough to matter").format(who, over)
        return Markup("no controller is significantly better than {} {}").format(who, over)
    how = " and are not told apart"
    if findings.lead is Lead.ALIKE:
        how = ", and no difference between them matters"
    elif findings.tells_leaders_apart:
        how = " and none of them is significantly better by enough to matter"
    return Markup("{} lead {}{}").format(who, over, how)


def _front(findings: Findings, controllers: Labels, over: str, show: Show) -> Markup:
    """Say who is not dominated, who of them is cheapest, and who the most comfortable."""
    ranking, name = findings.standings, bold if findings.is_sure else italic
    who = some_of([name(controllers[key]) for key in findings.leaders])
    first, *others = findings.leaders
    praise: dict[str, list[str]] = {first: ["cheapest"]}
    for key in ranking.discomforts:
        samples = ranking.samples[key]
        best = min(findings.leaders, key=lambda leader: samples[leader].median)
        if best != first and ranking.is_too_small(key, first, best):
            best = first
        of = f" in {split_key(key)[1]}" if len(ranking.discomforts) > 1 else ""
        praise.setdefault(best, []).append(f"the most comfortable{of}")
    keys = dict.fromkeys((*ranking.keys, *ranking.discomforts))
    text = Markup("{} are not dominated {}").format(who, over)
    if all(ranking.is_too_small(key, first, other) for key in keys for other in others):
        text += f", and differ by too little to matter ({_figures(findings, first, show)})"
    else:
        parts = [
            Markup("{} is {} ({})").format(
                italic(controllers[leader]), join_words(words), _figures(findings, leader, show)
            )
            for leader, words in praise.items()
        ]
        text += Markup(": {}").format(Markup(", ").join(parts))
    if not (other := findings.following):
        return text
    gains = []
    for leader in praise:
        costs, comfort = _differences(ranking, leader, other, show)
        gains.append(Markup("{} costs {} {}").format(italic(controllers[leader]), costs, comfort))
    against = Markup("; against {}, the cheapest of the next front ({}), in pairs of the same seed {}")
    return text + against.format(
        italic(controllers[other]), _figures(findings, other, show), join_words(gains)
    )


def _figures(findings: Findings, name: str, show: Show) -> str:
    """Write the medians of money and discomfort."""
    ranking = findings.standings
    keys = dict.fromkeys((*ranking.keys, *ranking.discomforts))
    return ", ".join(show(key, ranking.samples[key][name].median) for key in keys)


def _cheaper(findings: Findings, controllers: Labels, over: str, show: Show) -> Markup:
    """Say how much less than the next one costs, and at how much more or less discomfort."""
    ranking, (first, *_), other = findings.standings, findings.leaders, findings.following
    name = (bold if findings.is_sure else italic)(controllers[first])
    costs, comfort = _differences(ranking, first, other, show)
    return Markup("{} costs {} than {} {} {}").format(name, costs, italic(controllers[other]), comfort, over)


def _differences(ranking: Standings, first: str, other: str, show: Show) -> tuple[str, str]:
    """Write by how much less than another the first costs, and at how much more or less discomfort."""
    comfort = [_discomfort(ranking, key, first, other, show) for key in ranking.discomforts]
    none_is_more = [text for text in comfort if text.startswith("at no more ")]
    if len(none_is_more) == len(comfort) > 1:
        comfort = ["at no more discomfort"]
    costs = _against(ranking, ranking.keys[0], first, other, show)
    return costs or "no more", join_words(comfort)


def _discomfort(ranking: Standings, key: str, first: str, other: str, show: Show) -> str:
    name, signal, _ = split_key(key)
    noun = "discomfort" if name == "band_violation" else metric_name(name)
    of = f" of {signal}" if len(ranking.discomforts) > 1 else ""
    more = _against(ranking, key, first, other, show)
    if not more:
        return f"at no more {noun}{of}"
    return f"with {more} {noun}{of}" if "%" in more else f"with {more}{of}"


def _against(ranking: Standings, key: str, first: str, other: str, show: Show) -> str:
    """Write by how much the first differs from another, as ``12 % less``; nothing where neither is worse."""
    worse = ranking.worse_in(key, first, other)
    if not worse:
        return ""
    share, difference = ranking.ratio(key, other, first) - 1.0, ranking.above(key, other, first).median
    percent = abs(100.0 * share)
    size = f"{percent:.{1 if percent < 9.95 else 0}f} %" if percent < _MOST else show(key, abs(difference))
    return f"{size} {'less' if worse == other else 'more'}"


def _by_scenario(ranking: Standings, controllers: Labels, scenarios: Labels) -> Markup:
    """Say who leads in which scenario, as no rank over all of them would be fair."""
    where: dict[tuple[str, ...], list[Markup]] = {}
    for scenario, leaders in ranking.leaders_by_scenario.items():
        where.setdefault(leaders, []).append(italic(scenarios[scenario]))
    parts = []
    for leaders, places in where.items():
        who = [bold(controllers[name]) for name in leaders]
        lead = "leads" if len(who) == 1 else "lead together"
        if not who:
            who, lead = [Markup("no controller")], "is without a failed run"
        parts.append(Markup("{} {} in {}").format(some_of(who), lead, some_of(places)))
    return Markup("the scenarios disagree, so there is no overall rank: {}").format(Markup("; ").join(parts))


def _fewest_failed(ranking: Standings, controllers: Labels) -> Markup:
    fewest = [standing for standing in ranking.order if standing.rank == 1]
    who, runs = some_of([italic(controllers[standing.controller]) for standing in fewest]), fewest[0].runs
    return Markup("no controller is without a failed run. Fewest failed: {} {} of {} {}").format(
        who, fewest[0].failed, runs, "run" if runs == 1 else "runs"
    )


def knowing_clause(found: Knowing | None, controllers: Labels, scenarios: Labels) -> Markup:
    """Say what knowing the disturbances is worth; empty where nothing tells."""
    if found is None:
        return Markup("")
    what = join_words([metric_name(name) for name in dict.fromkeys(split_key(key)[0] for key in found.keys)])
    left: dict[str, list[str]] = {}
    for scenario in found.more:
        left.setdefault(_part(found.typical(scenario)), []).append(scenarios[scenario])
    parts = [f"{part} ({join_words(labels)})" for part, labels in left.items()]
    first, count = found.gaining[0], len(found.gaining)
    whose = "the controller that gains" if count == 1 else f"the {count} controllers that gain (median)"
    text = Markup("knowing the disturbances leaves {} {} of their {} without ({})").format(
        whose, join_words(parts), what, scenarios[found.least]
    )
    if count > 1:
        most = italic(controllers[first.controller]), _part(first.most)
        text += Markup("; {} gains most ({})").format(*most)
    if found.others:
        text += Markup("; {} {} nothing").format(
            some_of([italic(controllers[name]) for name in found.others]),
            "gains" if len(found.others) == 1 else "gain",
        )
    return text


def _part(part: float) -> str:
    """Write what is left, in percent, and what is more than before as a multiple."""
    return f"{100 * part:.2g}\u00a0%" if part < 0.995 else f"{part:.2g} times"


def elsewhere_sentence(findings: Findings, controllers: Labels) -> Markup:
    """Say in how many scenarios others are ahead of the leaders, and who; nothing where none is."""
    others, led = findings.leads_elsewhere, findings.scenarios_led
    scenarios = len(findings.standings.by_scenario)
    if not findings.leaders or not others:
        return Markup("")
    named = [italic(controllers[name]) + f" ({count})" for name, count in others.items()]
    it = "it leads" if len(findings.leaders) == 1 else "one of them leads"
    do = "does" if len(named) == 1 else "do"
    together = ", some together" if sum(others.values()) > scenarios - led else ""
    text = "Scenario by scenario {} in {} of {}; in the others {} {}{}."
    return Markup(text).format(it, led or "none", scenarios, some_of(named), do, together)


def untested_sentence(findings: Findings) -> str:
    """Say why nothing could be tested; nothing where it was, or there is nothing to test."""
    ranking = findings.standings
    if ranking.tested or len(ranking.order) < 2 or findings.lead in (Lead.ALL_FAIL, Lead.ONLY_SOUND):
        return ""
    if ranking.seeds < 2:
        return "How much that depends on the seed is not known."
    return f"{too_few_seeds_clause(ranking.compared.values())}."


def failed_runs(label: str, failed: int, runs: int) -> Markup:
    """Say how many runs of a controller failed, after its name."""
    return bold(label) + f" {failed} of {runs} runs"


def rate_words(rate: FailureRate) -> str:
    """Say on how many seeds a controller fails, and what that tells of all seeds."""
    low, high = (f"{100 * end:.2g}" for end in (rate.low, rate.high))
    if not rate.failed:
        return f"none of {rate.seeds} seeds (up to {high}\u00a0%)"
    if rate.failed == rate.seeds:
        return f"each of {rate.seeds} seeds (from {low}\u00a0% on)"
    return f"{rate.failed} of {rate.seeds} seeds ({100 * rate.share:.2g}\u00a0%, from {low} to {high}\u00a0%)"


def not_counted_sentence(names: Sequence[str]) -> Markup:
    """Name the problems or scenarios in which every controller fails; nothing without any."""
    text = Markup("Not counted, as every controller fails there: {}.")
    return text.format(some_of([italic(name) for name in names])) if names else Markup("")


def level_clause(names: Sequence[Markup], by: str = "the seeds") -> Markup:
    """Say who may be as good as the first of a ranking, and by what."""
    return Markup("{} do not tell it apart from {}").format(by, some_of(names))


def ahead_in_pairs_clause(names: Sequence[Markup]) -> Markup:
    """Say who is ahead of the first of a ranking seed by seed, despite its median."""
    be = "is" if len(names) == 1 else "are"
    return Markup("in pairs of the same seed {} {} ahead of it").format(some_of(names), be)


def too_few_seeds_clause(comparisons: Iterable[Comparisons]) -> str:
    """Say that the seeds are too few to test so many controllers, and how many it takes; empty if not."""
    few = [comparison for comparison in comparisons if comparison.too_few_seeds]
    if not few:
        return ""
    seeds = max(comparison.seeds for comparison in few)
    controllers = max(len(comparison.order) for comparison in few)
    needed = max(comparison.seeds_needed for comparison in few)
    few_words = f"{seeds} seeds are too few to test {controllers} controllers against each other"
    return f"{few_words}: it takes {needed}"


def best_rank_clause(ranks: AverageRanks, controllers: Labels, rank: str = "") -> Markup:
    """Say who has the best average rank, with that rank if given, and who is not told apart from it."""
    first, level = next(iter(ranks.ranks)), ranks.level_with_first
    name = (italic if level else bold)(controllers[first])
    text = Markup("over {} problems, {} has the best average rank").format(ranks.problems, name)
    text += f", {rank}" if rank else ""
    if level:
        others = [italic(controllers[other]) for other in level]
        text += "; " + level_clause(others, by="the problems")
    return text


def ranks_differ_clause(ranks: AverageRanks, value: Callable[[float], str]) -> str:
    """Say how far apart average ranks have to be to differ, or that none is found to."""
    if ranks.p <= LEVEL:
        return f"ranks that are {value(ranks.critical_difference)} or more apart differ"
    return "none is found to differ"
