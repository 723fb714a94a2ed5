"""Why a controller lost: where it falls behind the best, and what limits it there."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from ddpc_cosim import CaseResult, FloatArray, Trace, judge_prediction
from ddpc_cosim.files.texts import recorded, without_folders
from ddpc_cosim.study.verdicts.sentences import italic, join_words
from ddpc_reports.comparison import Condition, ControllerResults
from ddpc_reports.figures.clock import Clock
from ddpc_reports.figures.over_time import scenario_marks
from ddpc_reports.figures.samples import clock_of
from ddpc_reports.numbers import significant, with_unit
from ddpc_reports.tables.ranking import in_order
from ddpc_reports.verdict import Statement

_AT_LIMIT = 1e-6
"""Of the range of an input: what is nearer to a limit stands at it."""
_OFTEN = 0.3
"""Share of a stretch from which on a limit or a fallback is named."""
_BEFORE = 0.05
"""Of the run: what begins so long before a stretch may be its cause."""


class Stretch(NamedTuple):
    """Where a run falls behind another: its first and its last sample, and its part of all that it loses."""

    first: int
    last: int
    share: float


def why_statements(condition: Condition) -> list[Statement]:
    """Return a statement for each controller that failed, and for the last of those that did not."""
    if not condition.controllers or len(condition.contenders) < 2:
        return []
    standing = in_order(condition.contenders, condition.standings)
    sound = [controller for controller in standing if condition.may_win(controller)]
    best = sound[0] if sound else None
    losing = [controller for controller in standing if controller.failed]
    losing += [sound[-1]] if len(sound) > 1 and _is_behind(condition, sound[-1]) else []
    statements = []
    for controller in losing:
        if text := _why(condition, controller, best):
            statements.append(Statement(controller.label, text))
    return statements


def _is_behind(condition: Condition, last: ControllerResults) -> bool:
    """Whether the last one is not level with the first."""
    places = {place.controller: place.rank for place in condition.standings.order}
    return places[last.key] > min(places.values())


def _why(condition: Condition, controller: ControllerResults, best: ControllerResults | None) -> Markup:
    failing = (case for case in controller.cases if case.failed and case.has_samples)
    case = next(failing, controller.first_case)
    if case is None or not case.has_samples:
        return Markup("")
    trace = case.trace()
    if not len(trace):
        return Markup("Seed {}: {}: {}.").format(case.seed, case.outcome, _reason(case))
    clock = clock_of(condition)
    rivals = (other for other in best.cases if other.seed == case.seed and other.has_samples) if best else ()
    rival = next(iter(rivals), None)
    theirs = rival.trace() if rival else None
    at = _time(clock, trace.time[-1])
    ended = "" if trace.completed else f"It ends at {at}: {_reason(case)}. "
    stretch = where_behind(trace, theirs) if theirs is not None else _from_where_it_leaves(trace)
    if stretch is None:
        return Markup("Seed {}: {}").format(case.seed, ended) if ended else Markup("")
    begin, end = (_time(clock, trace.time[place]) for place in (stretch.first, stretch.last))
    whom = Markup(" to {}").format(italic(best.label)) if best else Markup("")
    lost = (
        Markup("from {} to {} it loses {}\N{NO-BREAK SPACE}% of what it loses{}").format(
            begin, end, significant(100 * stretch.share, 2), whom
        )
        if theirs is not None
        else Markup("from {} on it is far from what is wanted").format(begin)
    )
    causes = [*_causes(condition, trace, theirs, stretch, clock)]
    said = join_words(causes) if causes else Markup("no limit, fallback or disturbance is there")
    return Markup("Seed {}: {}{}; {}.").format(case.seed, ended, lost, said)


def _reason(case: CaseResult) -> str:
    return without_folders(recorded(case.reason)).rstrip(".")


def where_behind(trace: Trace, other: Trace) -> Stretch | None:
    """Return where a run loses most to another one.

    Of both, e_k is the sum over the outputs of abs(reference - output) in parts of the output's travel in the
    other run. The run loses x_k = e_k - e_k of the other one; the stretch is that whose sum of
    x_k - mean(x) is the largest, its share the part of the sum of x over all samples.

    Returns
    -------
    stretch : Stretch or None
        None where the run loses nothing in total.
    """
    length = min(len(trace), len(other))
    travel = np.maximum(np.ptp(other.y, axis=0), np.ptp(other.reference, axis=0))
    size = np.where(travel > 0, travel, 1.0)
    errors = [np.abs(run.reference - run.y)[:length] / size for run in (trace, other)]
    lost = np.nan_to_num((errors[0] - errors[1]).sum(axis=1), posinf=np.finfo(float).max / length)
    total = float(lost.sum())
    if not total > 0:
        return None
    first, last = _largest_sum(lost - lost.mean())
    return Stretch(first, last, min(float(lost[first : last + 1].sum()) / total, 1.0))


def _largest_sum(values: FloatArray) -> tuple[int, int]:
    """Return first and last of the neighbours whose sum is the largest (Kadane's algorithm)."""
    best, begin, ends, running = -math.inf, 0, (0, len(values) - 1), 0.0
    for i, value in enumerate(values.tolist()):
        if running <= 0:
            running, begin = 0.0, i
        running += value
        if running > best:
            best, ends = running, (begin, i)
    return ends


def _from_where_it_leaves(trace: Trace) -> Stretch | None:
    """Return from where on a run without a rival is further than half of its task away; None if nowhere."""
    size = np.ptp(trace.reference, axis=0) + np.abs(trace.reference[0] - trace.y[0])
    far = (np.abs(trace.reference - trace.y) > 0.5 * np.where(size > 0, size, 1.0)).any(axis=1)
    near = np.flatnonzero(~far)
    first = int(near[-1]) + 1 if near.size else 0
    return Stretch(first, len(trace) - 1, 1.0) if first < len(trace) else None


def _causes(
    condition: Condition, trace: Trace, other: Trace | None, stretch: Stretch, clock: Clock
) -> Iterator[Markup]:
    """Yield what is there where a run falls behind."""
    rows = slice(stretch.first, stretch.last + 1)
    begin, end = trace.time[stretch.first], trace.time[stretch.last]
    early = begin - _BEFORE * (trace.time[-1] - trace.time[0])
    moved = np.flatnonzero(np.abs(np.diff(trace.reference, axis=0)).max(axis=1, initial=0.0) > 0) + 1
    steps = [time for time in trace.time[moved] if early <= time <= end + trace.preview * trace.sampling_time]
    if steps and len(moved) < len(trace) / 10:
        times = join_words([Markup.escape(_time(clock, time)) for time in steps[:3]])
        yield Markup("the reference changes at {}").format(times)
    for mark in scenario_marks(condition)[0]:
        if mark.begin <= end and max(mark.end, mark.begin) >= early:
            since = _time(clock, mark.begin)
            yield Markup("<b>{}</b> acts from {} on").format(mark.label, since)
    limited = at_limit(trace)[rows].mean()
    if limited >= _OFTEN:
        theirs = "" if other is None else f" (the best in {_percent(at_limit(other)[rows])})"
        yield Markup("its input is <b>at a limit</b> in {} of these samples{}").format(
            _percent(at_limit(trace)[rows]), theirs
        )
    reasons = Counter(status for status in trace.status[rows] if status != "ok")
    if reasons.total() >= _OFTEN * (stretch.last - stretch.first + 1):
        reason, _ = reasons.most_common(1)[0]
        yield Markup("it <b>falls back</b> in {} of these samples ({})").format(reasons.total(), reason)
    error = trace.diagnostics.get("prediction_error", math.nan)
    judged = judge_prediction(error, trace.diagnostics.get("prediction_error_fitted", math.nan))
    if judged.startswith("poor") and not math.isnan(error):
        part = f"{100 * error:.0f}\N{NO-BREAK SPACE}%"
        text = "its <b>model is poor</b>: off by {} of the standard deviation of samples that were held out"
        yield Markup(text).format(part)


def _time(clock: Clock, seconds: float) -> str:
    return with_unit(significant(clock.of(seconds), 3), clock.unit)


def at_limit(trace: Trace) -> FloatArray:
    """Return of each sample whether an input stands at a limit: 1 or 0, shape (K,)."""
    if trace.input_limits.size:
        low, high = trace.input_limits[..., 0], trace.input_limits[..., 1]
    else:
        sides = (trace.bounds.u_min, trace.bounds.u_max)
        low, high = (np.broadcast_to(side, trace.u.shape) for side in sides)
    near = _AT_LIMIT * np.where(np.isfinite(high - low), high - low, 0.0)
    at = (trace.u <= low + near) | (trace.u >= high - near)
    return np.asarray(at.any(axis=1), dtype=np.float64)


def _percent(share: FloatArray) -> str:
    return f"{100 * float(share.mean()):.0f}\N{NO-BREAK SPACE}%"
