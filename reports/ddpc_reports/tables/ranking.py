"""The tables of the first screen: controllers ranked, and a matrix where there are scenarios or problems."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from markupsafe import Markup

from ddpc_cosim.files.tables import Cell, Heading, Table
from ddpc_cosim.metrics import metric_of, split_key
from ddpc_cosim.study.verdicts.standings import Standings
from ddpc_reports.against import Baselines, baselines_of
from ddpc_reports.comparison import (
    Condition,
    ControllerResults,
    metric_signal,
    metric_unit,
    outcome_words,
    response_metrics,
)
from ddpc_reports.numbers import MISSING
from ddpc_reports.shares import SHARE_NOTE, share_columns
from ddpc_reports.tables.controllers import KEY_FIGURES, LIMITS, RESPONSE, meanings, metric_column
from ddpc_reports.tables.pictures import ratio_to, ratios_in_row, responses_in_rows, with_bars
from ddpc_reports.tables.table import Column, controller_table, interval_texts, number_cells

RANK = "rank"
"""The class of ranks in the page: beside them stand differences from a baseline."""
_RATIOS = (1.1, 1.25, 1.5, 2.0)
"""Ratios to the best of a column at which the tint of a cell changes."""
_MORE = ("settled_error", "overshoot", "total_variation", "solve_time_median")
"""What stands beside what is ranked by."""
_RANK_NOTE = (
    "Rank: the ranks that the data allow, from one more than the number of controllers that are better to "
    "the number of all less those that are worse. One is better if the pairs of the same scenario and seed "
    "tell so at 5\u00a0% (one step-down sign-flip max-T test of all pairs) and the difference matters; of "
    "several outputs in one of them, and worse in none."
)
_FRONT_NOTE = (
    "Rank: the Pareto front by money and discomfort. Of the first are those that no other dominates, of the "
    "second those that only these dominate. One dominates another if the pairs of the same scenario and seed "
    "tell at 5\u00a0% (one step-down sign-flip max-T test of all pairs) that it is better in one of the two "
    "figures by enough to matter, and in none that it is worse."
)
_MEDIANS_NOTE = "Rank: by the medians, as the seeds are too few for a test."
_FAILED_NOTE = (
    "A failed run did not complete, ends further than half of its task away, or is worse than doing nothing: "
    "a controller with one comes after all without, and medians are of the other runs."
)


def ranking_table(condition: Condition, ranking: Standings, prefix: str) -> Table:
    """Return the controllers of one scenario in the order of their ranks, with what else decides.

    Parameters
    ----------
    condition : Condition
        The scenario.
    ranking : Standings
        Its standings.
    prefix : str
        What the table's name in the page begins with.
    """
    order = in_order(condition.controllers, ranking)
    baseline = condition.results.study.report.baseline
    baselines = baselines_of(ranking, condition.cases, order, baseline)
    ranked = replace(condition, controllers=tuple(order))
    keys = condition.headline
    ranked_columns = [column for key in keys for column in _headline_columns(ranked, ranking, key)]
    more = [
        metric_column(ranked, key)
        for name in (*_MORE, *_others(keys))
        for key in condition.keys(name)
        if len(keys) == 1 or (ranking.is_pareto and len(keys) == 2) or name == "solve_time_median"
    ]
    columns = [
        _rank_column(ranking, order),
        *baselines.columns(),
        *ranked_columns,
        *share_columns(ranked),
        *more,
        *_terms_columns(ranked, order),
        *_failed_columns(ranking, order),
    ]
    what = " and ".join(filter(None, (condition.name_of(keys[0]) if keys else "", _of_signals(keys))))
    if ranking.is_of_money:
        what = " and ".join(["money", *["discomfort"] * ranking.is_pareto])
    return controller_table(
        f"{prefix}ranking",
        f"Ranked by {what}" if keys and ranking.is_ranked else "Controllers",
        order,
        columns,
        (*_notes(condition, ranking), *baselines.notes()),
        "ranking.csv",
        pictures=responses_in_rows(condition, order),
        kind="ranking",
        sortable=True,
        drawn="response",
    )


def _others(ranked_by: Sequence[str]) -> list[str]:
    """Return what no section has of its own: metrics of third parties, and mean errors beside a cost."""
    shown = {*_MORE, *RESPONSE, *LIMITS, *KEY_FIGURES, *(split_key(key)[0] for key in ranked_by)}
    return [name for name in response_metrics() if name not in shown]


def _of_signals(keys: Sequence[str]) -> str:
    return f"by each of {len(keys)} outputs" if len(keys) > 1 else ""


def in_order(controllers: Sequence[ControllerResults], ranking: Standings) -> list[ControllerResults]:
    """Return controllers in the order of their standings, those that do not compete last."""
    place = {standing.controller: i for i, standing in enumerate(ranking.order)}
    return sorted(controllers, key=lambda controller: place.get(controller.key, math.inf))


def _rank_column(ranking: Standings, order: Sequence[ControllerResults]) -> Column:
    ranks = {standing.controller: standing for standing in ranking.order}
    of_others = Cell(MISSING if ranking.is_ranked else "", tone=RANK)
    cells = [
        Cell(rank.text, rank.rank if rank.shown else "", tone=RANK)
        if (rank := ranks.get(controller.key))
        else of_others
        for controller in order
    ]
    return Heading("rank"), cells


def _headline_columns(ranked: Condition, ranking: Standings, key: str) -> list[Column]:
    """Return the medians of what is ranked by and, of one output, their 95 % intervals."""
    heading, cells = metric_column(ranked, key)
    cells = with_bars(cells, ranked.controllers)
    if len(ranked.headline) > 1 or len(ranked.seeds) < 2:
        return [(heading, cells)]
    samples = [ranking.samples.get(key, {}).get(controller.key) for controller in ranked.controllers]
    ends = [
        (sample.low, sample.high) if sample and sample.low != sample.high else (math.nan, math.nan)
        for sample in samples
    ]
    intervals = [Cell(text) for text in interval_texts(ends)]
    return [(heading, cells), (Heading("interval", "95\u00a0%"), intervals)]


def _terms_columns(ranked: Condition, order: Sequence[ControllerResults]) -> list[Column]:
    """Return how much of the future each sees, and from how much it learns."""
    traces = ranked.first_traces
    of_order = [traces.get(controller.key) for controller in order]
    ahead = [math.nan if trace is None else float(trace.preview) for trace in of_order]
    samples = ([case.recorded_samples for case in controller.cases] for controller in order)
    recorded = [float(max(of_cases, default=0)) for of_cases in samples]
    return [
        (Heading("preview", "samples"), number_cells(ahead, better="")),
        (Heading("needs data", "samples"), number_cells(recorded, better="")),
    ]


def _failed_columns(ranking: Standings, order: Sequence[ControllerResults]) -> list[Column]:
    """Return how many runs of each failed, where any did."""
    by_key = {standing.controller: standing for standing in ranking.order}
    if not any(standing.failed for standing in ranking.order):
        return []
    cells = [
        Cell(f"{standing.failed} of {standing.runs}", standing.failed, failed=standing.failed > 0)
        if (standing := by_key.get(controller.key))
        else Cell(MISSING)
        for controller in order
    ]
    return [(Heading("failed", "runs"), cells)]


def _notes(condition: Condition, ranking: Standings) -> tuple[str, ...]:
    several = len(condition.seeds) > 1
    best = "Bold and tinted: the best of a column"
    best += ", with those that the seeds do not tell apart from it" if several else ""
    best += "; where that is most of them, none is marked."
    notes = [best]
    if ranking.is_ranked:
        notes.append(_rank_note(ranking))
    if any(standing.failed for standing in ranking.order):
        notes.append(_FAILED_NOTE)
    if several:
        notes.append(
            f"Medians over {len(condition.seeds)} seeds; 95\u00a0% bootstrap interval of the median, where "
            "the seed changes anything."
        )
    notes.append("Preview: of the reference. Needs data: a recording, which the controller is handed.")
    if others := [name for name in _others(condition.headline) if condition.keys(name)]:
        notes.append(meanings(others, condition.every_key))
    return (*notes, *((SHARE_NOTE,) if condition.points else ()))


def _rank_note(ranking: Standings) -> str:
    note = _FRONT_NOTE if ranking.is_pareto else _RANK_NOTE
    if ranking.tested:
        return note
    return f"{_FRONT_NOTE} {_MEDIANS_NOTE}" if ranking.is_pareto else _MEDIANS_NOTE


@dataclass(frozen=True)
class Place:
    """A scenario of a problem in the matrix, and where the page has its figures."""

    problem: str
    condition: Condition
    href: str


def matrix_table(
    places: Sequence[Place],
    order: Sequence[ControllerResults],
    first: Sequence[Column],
    notes: Sequence[str],
    prefix: str,
) -> Table:
    """Return a row per controller and a column per problem and scenario: medians, ranges, and who fails.

    Parameters
    ----------
    places : sequence of Place
        The scenarios, problem by problem.
    order : sequence of ControllerResults
        The controllers, the best first.
    first : sequence of (Heading, list of Cell)
        Columns before the matrix: ranks.
    notes : sequence of str
        What the ranks are.
    prefix : str
        What the table's name in the page begins with.
    """
    problems = {place.problem for place in places}
    columns = [
        _place_column(place, key, order, several=len(problems) > 1)
        for place in places
        for key in place.condition.headline
    ]
    keys = dict.fromkeys(place.condition.name_of(key) for place in places for key in place.condition.headline)
    caption = f"{' or '.join(keys)}: medians over the seeds, and ranges"
    said = (
        *notes,
        "Tint: ratio to the best of the column without a failed run, up to "
        + ", ".join(f"{ratio:g}" for ratio in _RATIOS)
        + ", and more. Bold: the best, with those that the seeds do not tell apart from it. "
        "Each number leads to its figures.",
        _FAILED_NOTE,
    )
    return controller_table(
        f"{prefix}matrix",
        caption[0].upper() + caption[1:],
        order,
        [*first, *columns],
        said,
        "matrix.csv",
        pictures=ratios_in_rows(places, order),
        kind="ranking matrix",
        sortable=True,
        drawn="to the best",
    )


def ratios_in_rows(places: Sequence[Place], order: Sequence[ControllerResults]) -> list[Markup]:
    """Return for each controller a picture of how many times the best it comes to, place by place."""
    of_rows = [list[float]() for _ in order]
    for place in places:
        for key in place.condition.headline:
            members = [place.condition.by_key.get(controller.key) for controller in order]
            values = [
                member.over_seeds(key).median if member and member.failed < len(member.cases) else math.nan
                for member in members
            ]
            able = [
                value
                for member, value in zip(members, values, strict=True)
                if member and place.condition.may_win(member) and not math.isnan(value)
            ]
            best = min(able, default=math.nan)
            for row, value in zip(of_rows, values, strict=True):
                row.append(ratio_to(best, value))
    return [ratios_in_row(controller, ratios) for controller, ratios in zip(order, of_rows, strict=True)]


def _place_column(place: Place, key: str, order: Sequence[ControllerResults], *, several: bool) -> Column:
    condition = place.condition
    members = [condition.by_key.get(controller.key) for controller in order]
    marked = [bool(member and condition.may_win(member)) for member in members]
    medians = [member.over_seeds(key).median if member else math.nan for member in members]
    cells = number_cells(
        medians, eligible=marked, better=metric_of(key).better, alike=condition.alike(key, members)
    )
    able = [value for value, able in zip(medians, marked, strict=True) if able and not math.isnan(value)]
    best = min(able, default=math.nan)
    # Money is of the whole run: it has no signal.
    signal = metric_signal(key) or condition.name_of(key) if len(condition.headline) > 1 else ""
    detail = " / ".join(filter(None, (signal, metric_unit(key))))
    title = condition.label if condition.label != condition.scenario or not several else condition.scenario
    heading = Heading(title, detail, group=place.problem if several else "", href=place.href)
    ends = [_ends_of(member, key) for member in members]
    return heading, [
        _place_cell(
            replace(cell, detail="" if text == MISSING else text), member, best, place.href, ranked=able
        )
        for cell, text, member, able in zip(cells, interval_texts(ends, 3), members, marked, strict=True)
    ]


def _ends_of(controller: ControllerResults | None, key: str) -> tuple[float, float]:
    """Return the range of a metric over the seeds; NaN where they do not differ."""
    spread = controller.over_seeds(key) if controller else None
    return (spread.low, spread.high) if spread and spread.varies else (math.nan, math.nan)


def _place_cell(
    cell: Cell, controller: ControllerResults | None, best: float, href: str, *, ranked: bool
) -> Cell:
    if controller is None:
        return Cell("")
    if controller.failed == len(controller.cases):
        words = ((outcome_words(case), case.failure) for case in controller.cases)
        reasons = dict.fromkeys(": ".join(filter(None, pair)) for pair in words)
        return Cell("failed", math.nan, failed=True, tone="share-0", href=href, title="; ".join(reasons))
    failures = f"{controller.failed} failed" if controller.failed and not controller.is_point else ""
    tone = "share-0" if failures else _tone(float(cell.raw), best) if ranked else ""
    return replace(cell, href=href, failures=failures, tone=tone)


def _tone(value: float, best: float) -> str:
    """Return the tint of a value: the stronger, the nearer it is to the best of its column."""
    if not best >= 0 or math.isnan(value):
        return ""
    ratio = ratio_to(best, value)
    return f"share-{5 - sum(ratio > limit for limit in _RATIOS)}"


def rank_columns(ranking: Standings, baselines: Baselines) -> list[Column]:
    """Return the ranks over all scenarios of a problem, what differs from a baseline, and failed runs."""
    order = baselines.order
    rank = _rank_column(ranking, order)
    ranks = [rank] if any(cell.text for cell in rank[1]) else []
    return [*ranks, *baselines.columns(), *_failed_columns(ranking, order)]


def rank_notes(ranking: Standings, left_out: Mapping[str, str]) -> list[str]:
    """Say what the ranks over all scenarios of a problem are."""
    notes = [_rank_note(ranking)]
    notes.append(
        "Of each seed the median of its scenarios counts, so that scenarios do not multiply the seeds."
    )
    names = [left_out[name] for name in ranking.left_out]
    return [*notes, f"Not counted, as every controller fails there: {', '.join(names)}."] if names else notes
