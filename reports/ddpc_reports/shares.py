"""Shares of the way between a study's reference points, as the page says and tints them."""

import math
from collections.abc import Sequence

from markupsafe import Markup

from ddpc_cosim.files.tables import Cell, Heading
from ddpc_cosim.metrics import metric_name
from ddpc_cosim.study.verdicts.sentences import italic, join_words
from ddpc_cosim.study.verdicts.shares import FLOOR, NEGLIGIBLE, run_once
from ddpc_cosim.study.verdicts.statistics import Sample
from ddpc_reports.comparison import Condition, ControllerResults, metric_signal
from ddpc_reports.numbers import MINUS, MISSING, fixed
from ddpc_reports.tables.table import Column
from ddpc_reports.verdict import Statement, by_signal, names

SHARE = "share of the way"
SHARE_NOTE = (
    f"Share of the way: (m at 0\u00a0% {MINUS} m) / (m at 0\u00a0% {MINUS} m at 100\u00a0%) in pairs of "
    "the same scenario and seed, and the median over the seeds. Below 0 is worse than at 0\u00a0%. "
    f"A run that failed counts as {MINUS}100\u00a0%, as do shares below that; failed: at least half "
    "of the runs."
)
_HIGHEST = 2.0
"""Above this share, how much above says nothing."""
_TONES = (0.0, 0.25, 0.5, 0.75, 0.9)
"""Where the tints of shares change."""
_NAMED = 3


def share_percent(share: float) -> str:
    """Write a share in %, without the unit; a dash where there is none, and no more than can be meant."""
    if math.isnan(share):
        return MISSING
    if share <= FLOOR:
        return f"< {MINUS}100"
    return "> 200" if share > _HIGHEST else fixed(100 * share, 0)


def failed_mostly(sample: Sample) -> bool:
    """Whether at least half of what is summed up failed."""
    return 2 * sample.known <= sample.runs


def share_words(sample: Sample) -> str:
    """Write the median of shares, or that at least half of the runs failed."""
    return "failed" if failed_mostly(sample) else f"{share_percent(sample.median)}\u00a0%"


def interval_words(sample: Sample) -> str:
    """Write the 95 % interval of the median in brackets; nothing without one."""
    known = not (math.isnan(sample.low) or sample.low == sample.high)
    return f" [{share_percent(sample.low)} … {share_percent(sample.high)}]" if known else ""


def share_cell(sample: Sample | None, best: bool = False, *, star: bool = False) -> Cell:
    """Return the median of shares as a cell, tinted by how large it is; a star says that some failed."""
    if sample is None or math.isnan(sample.median):
        return Cell(MISSING)
    text = (
        "failed"
        if failed_mostly(sample)
        else share_percent(sample.median) + "*" * (star and sample.known < sample.runs)
    )
    tone = 0 if failed_mostly(sample) else sum(sample.median >= limit for limit in _TONES)
    return Cell(text, sample.median, best=best, tone=f"share-{tone}")


def share_interval(sample: Sample | None) -> Cell:
    """Return the 95 % interval of the median of shares as a cell."""
    if sample is None or math.isnan(sample.low):
        return Cell(MISSING)
    low, high = share_percent(sample.low), share_percent(sample.high)
    return Cell(low if low == high else f"{low} … {high}", f"{sample.low!r} … {sample.high!r}")


def point_cell(controller: ControllerResults) -> Cell | None:
    """Return the end of the scale at which a reference point is; None of another controller."""
    return Cell(f"{100 * controller.end:.0f}", tone="point") if controller.end is not None else None


def share_cells(
    condition: Condition, controllers: Sequence[ControllerResults | None], key: str
) -> list[Cell]:
    """Return a column of shares; a reference point has its own end of the scale."""
    shares = condition.shares(key)
    return [
        (controller and point_cell(controller))
        or share_cell(shares.get(controller.key) if controller else None)
        for controller in controllers
    ]


def share_columns(condition: Condition) -> list[Column]:
    """Return a column for each signal that controllers are ranked by; none where there are no shares."""
    keys = [key for key in condition.headline if condition.shares(key)]
    return [
        (
            Heading(metric_signal(key) if len(condition.headline) > 1 else "median", "%", group=SHARE),
            share_cells(condition, condition.controllers, key),
        )
        for key in keys
    ]


def share_statements(condition: Condition) -> list[Statement]:
    """Say how far the controllers come on the way between the reference points; nothing without any."""
    if not condition.points:
        return []
    ends = {controller.key: controller for controller in condition.controllers if controller.is_point}
    missing = [name for name in (condition.points.zero, condition.points.full) if name not in ends]
    if missing:
        return [
            Statement(
                "Distance",
                Markup("No run of {} is among the results: there are no shares of the way.").format(
                    join_words(missing)
                ),
            )
        ]
    zero, full = (ends[name] for name in (condition.points.zero, condition.points.full))
    lines = [(metric_signal(key), _in_words(condition, key, zero, full)) for key in condition.headline]
    what = Markup("Of the way from {} to {}, which do not compete: ").format(*names([zero, full]))
    return [Statement("Distance", what + by_signal(lines))]


def _in_words(condition: Condition, key: str, zero: ControllerResults, full: ControllerResults) -> Markup:
    shares, by_key = condition.shares(key), condition.by_key
    if not shares:
        why = (
            f"{zero.label} did not complete"
            if not zero.completed
            else f"every run of {full.label} failed"
            if not full.succeeded
            else f"there is no seed on which {zero.label} completed and {full.label} did not fail"
            if not (run_once(condition.results.study) & {zero.key, full.key})
            and not {case.seed for case in zero.completed} & {case.seed for case in full.succeeded}
            else f"in {metric_name(key)}, {full.label} is not better than {zero.label} by more than "
            f"{100 * NEGLIGIBLE:.0f}\u00a0% on any seed"
        )
        return Markup("there is no way to go: {}.").format(why)
    order = sorted(shares, key=lambda name: -shares[name].median)
    ahead = [name for name in order if shares[name].median > 0]
    parts = [
        italic(by_key[name].label) + f" {share_words(shares[name])}{interval_words(shares[name])}"
        for name in ahead[:_NAMED]
    ]
    if more := ahead[_NAMED:]:
        parts.append(Markup("{} more down to {}").format(len(more), share_words(shares[more[-1]])))
    text = join_words(parts) if parts else Markup("none is better than at 0\u00a0%")
    ways = max(sample.runs for sample in shares.values())
    if ways < len(condition.seeds):
        text += Markup(" (on {} of {} seeds there is a way to go)").format(ways, len(condition.seeds))
    behind = [by_key[name] for name in order if name not in ahead]
    if behind:
        text += Markup("; worse than at 0\u00a0%, or failed: {}").format(join_words(names(behind)))
    return text + "."
