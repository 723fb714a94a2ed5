"""Over all problems of a study: average ranks, performance profiles, and whom they tell apart."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Table
from ddpc_cosim.files.texts import clipped
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.findings import OverallFindings, overall_findings
from ddpc_cosim.study.verdicts.ranks import AverageRanks
from ddpc_cosim.study.verdicts.sentences import (
    best_rank_clause,
    failed_runs,
    italic,
    join_words,
    knowing_clause,
    not_counted_sentence,
    ranks_differ_clause,
    sentence,
)
from ddpc_cosim.study.verdicts.statistics import LEVEL, letters
from ddpc_reports.against import OverallBaselines
from ddpc_reports.comparison import ControllerResults, conditions
from ddpc_reports.distances import Distances, distance_columns, distance_statements, distances
from ddpc_reports.figures.charts import profile_chart, rank_chart
from ddpc_reports.figures.figure import Figure, entry, one_chart
from ddpc_reports.figures.samples import column_name
from ddpc_reports.numbers import MISSING, significant
from ddpc_reports.shares import SHARE_NOTE, interval_words, share_words
from ddpc_reports.tables.ranking import RANK
from ddpc_reports.tables.settings import value_text
from ddpc_reports.tables.table import Column, controller_table, number_cells
from ddpc_reports.verdict import Statement, names, p_words

_FACTOR, _WIDEST = 2.0, 20.0
"""The ratio that the table shows, and the largest that is drawn."""
_POINTS = 300
_NAMED = 3
RANKS_NOTE = (
    "Ranks by mean absolute error or the problem's own cost: first comes the controller with fewer runs "
    "that failed, of equal ones that with the better average rank over scenarios and signals. Group: "
    "controllers that share a letter are not told apart by Nemenyi's test at 5\u00a0%."
)


@dataclass(frozen=True)
class Overall:
    """What a study of several problems says of its controllers over all of them.

    Parameters
    ----------
    findings : OverallFindings
        Average ranks, performance profile, and the runs that failed.
    left_out : list of str
        Problems, and scenarios of others, in which every controller fails: nothing is ranked.
    controllers : dict of str to ControllerResults
        The controllers that ran in every problem, as they are in the first, the best rank first.
    labels : dict of str to str
        Of all controllers, those too that are not ranked.
    distances : Distances or None
        How far the controllers come between the reference points; None where there are none.
    chosen : dict of str to str
        By controller, which kinds tuning chose, and in how many problems; numbers are left out.
    worth : list of Markup
        Of each problem where it is known, what knowing the disturbances is worth.
    """

    findings: OverallFindings
    left_out: list[str]
    controllers: dict[str, ControllerResults]
    labels: dict[str, str]
    distances: Distances | None
    chosen: dict[str, str]
    worth: list[Markup]


def overall(problems: Sequence[StudyResults]) -> Overall | None:
    """Compare the controllers over all problems; None where fewer than two of either can be compared."""
    findings = overall_findings((results.study, results.cases) for results in problems)
    if findings is None:
        return None
    members: dict[str, ControllerResults] = {}
    left_out, worth = [], list[Markup]()
    for results, ranking, known in zip(problems, findings.standings, findings.knowing, strict=True):
        everywhere = conditions(results)
        for member in (member for condition in everywhere for member in condition.controllers):
            members.setdefault(member.key, member)
        of_problem = {c.key: c.label for condition in everywhere for c in condition.controllers}
        scenarios = {condition.scenario: condition.label for condition in everywhere}
        if said := knowing_clause(known, of_problem, scenarios):
            worth.append(Markup("{}: {}.").format(results.study.title or results.study.name, said))
        unseen = [condition for condition in everywhere if condition.scenario in ranking.left_out]
        of_scenarios = [f"{results.study.name}: {condition.label}" for condition in unseen]
        left_out += (
            of_scenarios if len(unseen) < len(everywhere) else [results.study.title or results.study.name]
        )
    shown = {key: members[key] for key in findings.ranks.ranks}
    others = [member for member in members.values() if member.key not in shown]
    far = distances(problems, [*shown.values(), *sorted(others, key=lambda controller: controller.is_point)])
    labels = {key: member.label for key, member in members.items()}
    chosen = chosen_kinds([results.study for results in problems])
    return Overall(findings, left_out, shown, labels, far, chosen, worth)


def chosen_kinds(problems: Iterable[Study]) -> dict[str, str]:
    """Return by controller which kinds tuning chose, the most frequent first, with the number of problems.

    A kind is a word, a truth, or a plug-in by the name of its class: what a method is then, where a number
    says how much of it.
    """
    counts: dict[str, dict[str, Counter[str]]] = {}
    for study in problems:
        for key, section in study.controllers.items():
            for name in (section.tuned.settings or ()) if section.tuned else ():
                value = section.settings.get(name)
                if isinstance(value, Mapping) and isinstance(value.get("type"), str):
                    value = value["type"].rpartition(":")[2]
                if isinstance(value, str | bool):
                    counts.setdefault(key, {}).setdefault(name, Counter())[value_text(value)] += 1
    return {
        key: "; ".join(
            f"{name}: {', '.join(f'{kind} {times}' for kind, times in kinds.most_common())}"
            for name, kinds in settings.items()
        )
        for key, settings in counts.items()
    }


def overall_answer(comparison: Overall) -> Markup:
    """Return who has the best average rank, from whom it is told apart, and of whom the most runs failed."""
    ranks, failed = comparison.findings.ranks, comparison.findings.failed
    order = [*comparison.controllers.values()]
    first = order[0]
    text = _best_rank(ranks, comparison.labels)
    if ranks.p <= LEVEL:
        text += f"; {ranks_differ_clause(ranks, lambda rank: significant(rank, 2))}"
    text += "."
    if comparison.distances and (share := comparison.distances.overall.get(first.key)):
        points = names([controller for controller in comparison.distances.controllers if controller.is_point])
        # A share of several metrics is of none of them.
        metrics = comparison.distances.metrics
        together = f", {join_words(metrics)} taken together" if metrics[1:] else ""
        text += Markup(" It comes {}{} of the way between {}{}.").format(
            share_words(share), interval_words(share), join_words(points), together
        )
    some_failed = (controller for controller in order if failed[controller.key][0])
    failing = sorted(some_failed, key=lambda controller: -failed[controller.key][0])
    if failing:
        most = [failed_runs(controller.label, *failed[controller.key]) for controller in failing[:_NAMED]]
        text += Markup(" Failed{}: {}.").format(" most" if failing[_NAMED:] else "", join_words(most))
    if comparison.left_out:
        text += " " + not_counted_sentence(comparison.left_out)
    # In every problem it is what the study asks; in some of many it is what else there is to say.
    is_asked = len(comparison.worth) == ranks.problems
    return Markup(" ").join([*comparison.worth, text] if is_asked else [text, *comparison.worth])


def _best_rank(ranks: AverageRanks, labels: Mapping[str, str]) -> Markup:
    return sentence(best_rank_clause(ranks, labels, significant(min(ranks.ranks.values()), 3)))


def first_columns(comparison: Overall, baselines: OverallBaselines) -> list[Column]:
    """Return average ranks, what is told against a baseline, and failed runs: for the first screen."""
    ranks, order = comparison.findings.ranks.ranks, baselines.order
    cells = number_cells([ranks.get(controller.key, math.nan) for controller in order], digits=3)
    return [
        (Heading("average rank"), [replace(cell, tone=RANK) for cell in cells]),
        *baselines.columns(),
        (Heading("failed", "runs"), _failed_cells(comparison, order)),
    ]


def _failed_cells(comparison: Overall, controllers: Iterable[ControllerResults]) -> list[Cell]:
    counts = [comparison.findings.failed.get(controller.key, (0, 0)) for controller in controllers]
    return [
        Cell(f"{failed} of {runs}", failed, failed=failed > 0) if runs else Cell(MISSING)
        for failed, runs in counts
    ]


def overall_statements(comparison: Overall) -> list[Statement]:
    """Say who has the best average rank, from whom it is told apart, and who is left out."""
    ranks = comparison.findings.ranks
    text = _best_rank(ranks, comparison.labels)
    if math.isnan(ranks.p):
        test = Markup(" It takes three controllers for a test.")
    else:
        differ = ranks_differ_clause(ranks, lambda rank: significant(rank, 3))
        test = Markup(" Friedman's test: p {}; {}.").format(p_words(ranks.p, "= "), differ)
    statements = [Statement("Ranks", text + "." + test)]
    if comparison.distances:
        together = [next(iter(ranks.ranks)), *ranks.level_with_first]
        statements += distance_statements(comparison.distances, together)
    if comparison.left_out:
        where = join_words([italic(name) for name in comparison.left_out])
        nothing = Markup("In {} every controller fails: nothing is ranked there.").format(where)
        statements.append(Statement("Left out", nothing))
    if ranks.left_out:
        who = join_words([italic(comparison.labels[name]) for name in ranks.left_out])
        some = Markup("{}: not in every problem, so not ranked over all.").format(who)
        statements.append(Statement("Not ranked", some))
    return statements


def overall_table(comparison: Overall, prefix: str) -> Table:
    """Return average ranks, shares of the runs near the best, and the failed runs."""
    profile, order = comparison.findings.profile, [*comparison.controllers]
    far = comparison.distances
    everyone = far.controllers if far else [*comparison.controllers.values()]
    blank = [Cell(MISSING)] * (len(everyone) - len(order))
    reached = {
        factor: [
            100 * float(profile.shares[key][np.searchsorted(profile.ratios, factor, side="right") - 1])
            for key in order
        ]
        for factor in (1.0, _FACTOR)
    }
    groups = letters(comparison.findings.ranks.groups)
    ranks = number_cells([comparison.findings.ranks.ranks[key] for key in order], digits=3)
    columns = [
        (Heading("average rank"), [*ranks, *blank]),
        (Heading("group"), [*(Cell(groups[key]) for key in order), *blank]),
        *(distance_columns(far, everyone) if far else []),
        (Heading("best", "%", group="share of runs"), [*number_cells(reached[1.0], digits=3), *blank]),
        (
            Heading("within twice", "%", group="share of runs"),
            [*number_cells(reached[_FACTOR], digits=3), *blank],
        ),
        (Heading("failed", "runs"), _failed_cells(comparison, everyone)),
    ]
    if comparison.chosen:
        kinds = [Cell(comparison.chosen.get(controller.key, MISSING)) for controller in everyone]
        columns.append((Heading("chosen by tuning", "problems of each kind", numeric=False), kinds))
    notes: tuple[str, ...] = (
        RANKS_NOTE,
        "Shares of runs: the best of the same problem, scenario and seed, or within twice its value, each "
        "problem with the same weight; a run that failed is not.",
    )
    if far:
        notes += (
            "Share: median, 95\u00a0% bootstrap interval, least and most of the problems' medians. Needs: "
            "medians over the problems; total variation in pairs of the same scenario and seed.",
            SHARE_NOTE,
        )
    caption = f"Controllers over {comparison.findings.ranks.problems} problems"
    return controller_table(f"{prefix}overall", caption, everyone, columns, notes, "ranks.csv")


def overall_figures(comparison: Overall, prefix: str) -> list[Figure]:
    """Return the critical-difference display of the ranks, and the performance profile."""
    return [_rank_figure(comparison, f"{prefix}ranks"), _profile_figure(comparison, f"{prefix}profile")]


def _rank_figure(comparison: Overall, identifier: str) -> Figure:
    ranks = comparison.findings.ranks
    half = ranks.critical_difference / 2
    rows = [
        {
            "label": clipped(controller.label),
            "key": column_name(controller),
            "value": rank,
            "low": rank - half,
            "high": rank + half,
            "text": f"{controller.label}: average rank {significant(rank, 3)}",
        }
        for controller, rank in zip(comparison.controllers.values(), ranks.ranks.values(), strict=True)
    ]
    caption = (
        f"Average ranks over {ranks.problems} problems, 1 being the best. Bars are as long as the "
        "critical difference of Nemenyi's test at 5 %: controllers whose bars do not overlap are told apart"
    )
    none = (
        "; of two controllers none is, as it takes three"
        if math.isnan(ranks.p)
        else ""
        if ranks.p <= LEVEL
        else "; as Friedman's test finds none to differ, here none is"
    )
    return one_chart(identifier, "Average ranks", f"{caption}{none}.", rank_chart(rows))


def _profile_figure(comparison: Overall, identifier: str) -> Figure:
    profile, controllers = comparison.findings.profile, [*comparison.controllers.values()]
    columns = [column_name(controller) for controller in controllers]
    steps = np.searchsorted(profile.ratios, np.geomspace(1.0, _WIDEST, _POINTS), side="right") - 1
    drawn = np.unique(steps)  # of many thousand steps what can be seen
    rows = [
        {"key": column, "ratio": float(f"{ratio:.6g}"), "share": float(f"{share:.6g}")}
        for column, controller in zip(columns, controllers, strict=True)
        for ratio, share in [
            *zip(profile.ratios[drawn], profile.shares[controller.key][drawn], strict=True),
            (_WIDEST, profile.shares[controller.key][drawn][-1]),
        ]
    ]
    caption = (
        "Performance profile: share of the runs that come within a factor of the best of the same problem, "
        f"scenario and seed, each problem with the same weight. Logarithmic axis, up to {_WIDEST:g}."
    )
    legend = tuple(entry(controller, of_first=False) for controller in controllers)
    chart = profile_chart(rows, columns, _WIDEST)
    (view,) = one_chart(identifier, "", caption, chart).views
    return Figure(identifier, "Performance profile", caption, (replace(view, names=tuple(columns)),), legend)
