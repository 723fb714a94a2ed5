"""A suggested study tried out: what cannot run is dropped, and setpoints go where the plant can go."""

import math
import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim.codec import ValidationErrors
from ddpc_cosim.errors import ConfigError, CosimError, CosimWarning
from ddpc_cosim.loop.trace import Outcome, Trace
from ddpc_cosim.processes.sandbox import demanded
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.responses import Actuation, Response, Stretch
from ddpc_cosim.study.case_files import CaseResult, recompute_metrics
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.file_format.sections import ControllerSection, ReportSection, Study
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.resolve import ResolvedStudy, StudyCache, resolve
from ddpc_cosim.study.results import CASES_FOLDER, load_cases
from ddpc_cosim.study.runner import Update, run_cases
from ddpc_cosim.study.verdicts.judgement import SETTLED, WHY, all_failed, none_settles, scenario_remarks
from ddpc_cosim.suggestion.design import clean, rounded
from ddpc_cosim.suggestion.pace import monotonic
from ddpc_cosim.suggestion.writing import Proposal
from ddpc_cosim.variables import Variable

Tell = Callable[[str], None]

_ATTEMPTS, _ATTEMPTS_WITHOUT_AUTHORITY = 4, 2
_LONGER = 3
_SHRUNK = 0.3
_SHORTER = (0.1, 0.01)
_GENTLER = ((0.1, 0.1), (0.0, 1.0), (1.0, 0.0))  # shares of the way from rest to the limits, down and up
_KEPT_FREE = 0.1  # of the span that was reached, at either end of it
_SETTLED = 0.2  # of a stretch: its end, as in the figures of the response
_STUCK = 0.2  # of that end with an input at its limits: from there on the input cannot do more
_ALIKE = 1e-6  # of the span: samples at a limit of the plant's own
_REACHED = 0.05  # of the span: how far off what counts as reached may be
_MOVED = 0.01  # of the span: setpoints that differ
_LISTED = 3
_NOT_BEGUN = "not begun"
_OTHERWISE = 0.5  # of what an output has moved: what it is off where its step responses say it should be
_NOT_FOUND = "not found; inputs are within their limits, and outputs go where the step test says they should"
_LIMIT = re.compile("max|min|lim|sat|upper|lower|bound|range", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Limit:
    """A level that an output does not pass, 1 upwards or -1 downwards, in words."""

    output: str
    level: float
    sign: int
    words: str


class _TimeUpError(Exception):
    """The time for trying is over."""


@dataclass
class _Attempt:
    """A proposal and what became of its controllers; those that failed are in it no more."""

    proposal: Proposal
    cases: tuple[CaseResult, ...] = ()
    preview: int = 0
    line: str = ""
    limits: "list[_Limit]" = field(default_factory=list)
    surprises: list[str] = field(default_factory=list)
    dropped: dict[str, str] = field(default_factory=dict)
    untried: dict[str, str] = field(default_factory=dict)

    @property
    def controllers(self) -> Mapping[str, ControllerSection]:
        """Those that are left."""
        return self.proposal.study.controllers

    @property
    def left(self) -> dict[str, float]:
        """What is left of a step at worst [%], by label; without controllers for which that is unknown."""
        shares = {case.label: case.left for case in self.cases}
        return {label: share for label, share in shares.items() if not math.isnan(share)}

    @property
    def best(self) -> float:
        """The least that is left [%]."""
        return min(self.left.values(), default=math.inf)

    def drop(self, key: str, reason: str) -> None:
        """Leave a controller out."""
        controllers = dict(self.controllers)
        self.dropped[controllers.pop(key).label] = reason
        self.proposal = self.proposal.changed(controllers=controllers)

    def best_trace(self) -> Trace:
        """Return the run that leaves least."""
        return min(self.cases, key=lambda case: math.inf if math.isnan(case.left) else case.left).trace()


def tried_out(proposal: Proposal, deadline: float, tell: Tell, *, sandboxed: bool = False) -> Proposal:
    """Start every controller of a proposal and run its loop once; return what can be run, and how well.

    Where no controller settles, stretches become longer, and setpoints such as were reached.

    Parameters
    ----------
    proposal : Proposal
        The study.
    deadline : float
        When to stop, also in the middle of a run, on the clock of ``time.monotonic`` if nothing else has the
        processors: what is left until then is time for computing.
    tell : callable
        Called with what is being done.
    sandboxed : bool
        Whether they run in a sandbox.

    Raises
    ------
    CosimError
        No controller runs to the end, and why.
    """
    deadline = monotonic() + deadline - time.monotonic()
    attempts: list[_Attempt] = []
    gentler, number = _gentler_ones(proposal), 0
    faults: dict[str, str] = {}
    wanted: Proposal | None = proposal
    with ScratchFolder() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", CosimWarning)  # `run` tells them
        while wanted is not None:
            number += 1
            attempt = _attempt(wanted, folder / str(number), deadline, tell, sandboxed=sandboxed)
            faults = faults or attempt.dropped
            if attempt.controllers:
                attempts.append(attempt)
            if attempt.untried or (attempt.cases and (not attempt.left or attempt.best <= SETTLED)):
                break
            if not attempt.cases:
                wanted = next(gentler, None)
            else:
                most = _ATTEMPTS_WITHOUT_AUTHORITY if proposal.hints else _ATTEMPTS
                wanted = _within_reach(attempts) if len(attempts) < most else None
        if not attempts:
            what = f"{proposal.study.plant.label}: no controller that was tried runs to the end"
            raise CosimError(f"{what}: {'; '.join(dict.fromkeys(faults.values()))}")
        best = min(attempts, key=lambda attempt: attempt.best)
        reached, cut = _reached_only(best, [limit for attempt in attempts for limit in attempt.limits])
        if cut:  # what is said of it is to be of what is proposed
            attempt = _attempt(reached, folder / "cut", deadline, tell, sandboxed=sandboxed)
            best = attempt if attempt.cases else replace(best, proposal=reached)
            attempts.append(best)
        return _with_outcome(attempts, best, cut)


def tried_once(proposal: Proposal, deadline: float, tell: Tell, *, sandboxed: bool = False) -> Proposal:
    """Start every controller of a proposal and run its loop once; return what can be run, as it stands.

    Parameters and errors as of :func:`tried_out`.
    """
    deadline = monotonic() + deadline - time.monotonic()
    with ScratchFolder() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", CosimWarning)  # `run` tells them
        attempt = _attempt(proposal, folder / "1", deadline, tell, sandboxed=sandboxed)
        if not attempt.controllers:
            what = f"{proposal.study.plant.label}: no controller that was tried runs to the end"
            raise CosimError(f"{what}: {'; '.join(dict.fromkeys(attempt.dropped.values()))}")
        return _with_outcome([attempt], attempt, [])


def _attempt(proposal: Proposal, folder: Path, deadline: float, tell: Tell, *, sandboxed: bool) -> _Attempt:
    """Run each controller of a proposal once, as far as time allows; leave out those that fail."""
    (folder / CASES_FOLDER).mkdir(parents=True)
    attempt = _Attempt(proposal)
    tell("reading the study")
    resolved = _resolved(attempt)
    if resolved is None:
        return attempt
    with demanded(sandboxed):
        cases = cases_of(resolved, resolved.plant.built())
    done: list[str] = []

    def watch(update: Update) -> None:
        label = cases[len(done)].label
        share = f"{100 * update.samples // max(update.planned, 1)} %"
        tell(f"trying {label}: {share} of its run")
        if monotonic() > deadline:
            attempt.untried[label] = f"{share} of its run" if update.samples else _NOT_BEGUN
            raise _TimeUpError

    try:
        for tried in run_cases(cases, folder / CASES_FOLDER, 1, watch, sandboxed=sandboxed):
            done.append(tried.id)
    except _TimeUpError:
        attempt.untried |= dict.fromkeys((case.label for case in cases[len(done) + 1 :]), _NOT_BEGUN)
    results = load_cases(folder, WholeStudy.of(resolved.study), done).cases
    for case in results:
        if case.outcome is not Outcome.COMPLETED:
            attempt.drop(case.controller, f"{case.outcome}: {case.reason}")
    attempt.cases = tuple(case for case in results if case.outcome is Outcome.COMPLETED)
    # What has not been tried is not proposed, as long as there is anything else; what has begun can start.
    undone = {
        case.controller: attempt.untried[case.label]
        for case in cases
        if case.label in attempt.untried and (attempt.cases or attempt.untried[case.label] == _NOT_BEGUN)
    }
    if undone.keys() != attempt.controllers.keys():
        for key, share in undone.items():
            attempt.drop(key, f"not tried in time: {share}")
    if attempt.dropped and attempt.controllers:
        # How far those that are left look ahead decides what all are judged by.
        resolved = _resolved(attempt)
        if resolved is not None:
            for case in attempt.cases:
                recompute_metrics(case.folder, resolved.metrics)
            ids = [case.id for case in attempt.cases]
            attempt.cases = load_cases(folder, WholeStudy.of(resolved.study), ids).cases
    if resolved is not None and attempt.cases:
        attempt.preview = resolved.metrics.preview
        attempt.line = next((remark.text for remark in scenario_remarks(resolved.study, attempt.cases)), "")
        attempt.surprises = [*_surprises(attempt.best_trace(), proposal, attempt.preview)]
        attempt.limits = [*_limits_shown(attempt.best_trace(), resolved.plant.variables().parameters)]
    return attempt


def _resolved(attempt: _Attempt) -> ResolvedStudy | None:
    """Return the study without the controllers that cannot be set up; None if there are no others."""
    study = attempt.proposal.study
    try:
        return _resolve(study)
    except ConfigError:
        for key, controller in study.controllers.items():
            try:
                _resolve(replace(study, controllers={key: controller}))
            except ConfigError as fault:
                attempt.drop(key, "; ".join(fault.faults))
        if not attempt.dropped:
            raise
    return _resolve(attempt.proposal.study) if attempt.controllers else None


def _resolve(study: Study) -> ResolvedStudy:
    """Return what a study comes to that is in no file; ConfigError with all that does not fit."""
    errors, cache = ValidationErrors(), StudyCache()
    try:
        resolved = resolve(study, Path(), errors, cache)
    finally:
        cache.forget()
    if resolved is None:
        raise ConfigError(errors.listed())
    return resolved


def _gentler_ones(proposal: Proposal) -> Iterator[Proposal]:
    """Yield what may be survived where every run has failed: less of the inputs, less of the time."""
    yield from (_gentler(proposal, sides) for sides in _GENTLER)
    if proposal.asked.sampling_time is None and proposal.asked.duration is None:
        yield from (_shorter(proposal, share) for share in _SHORTER)


def _gentler(proposal: Proposal, sides: tuple[float, float]) -> Proposal:
    """Return the proposal with inputs that go less far down and up, in shares: so far, every run failed."""
    study, recording = proposal.study, proposal.study.recording
    rest = {v.name: v.start for v in proposal.inputs} | study.plant.start

    def nearer(name: str, limits: Any, *ends: str) -> Any:
        low, high = (getattr(limits, end) for end in ends)
        centre = min(max(rest[name], low), high)
        down, up = sides if name not in proposal.asked.ranges else (1.0, 1.0)
        less = centre - down * (centre - low), centre + up * (high - centre)
        return replace(limits, **dict(zip(ends, less, strict=True))) if less[0] < less[1] else limits

    if recording is not None:
        excited = {name: nearer(name, signal, "low", "high") for name, signal in recording.excitation.items()}
        recording = replace(recording, excitation=excited)
    bounds = {name: nearer(name, limits, "min", "max") for name, limits in study.bounds.items()}
    why = "; less, as every run failed with that"
    origins = {name: f"{origin}{why}" for name, origin in proposal.origins.items()}
    return replace(proposal.changed(bounds=bounds, recording=recording), origins=origins)


def _within_reach(attempts: Sequence[_Attempt]) -> Proposal:
    """Return the proposal with what may be reached: longer stretches, or setpoints such as were reached."""
    last = attempts[-1]
    trace, proposal = last.best_trace(), last.proposal
    responses = _responses(trace, last.preview)
    ends = {
        response.variable.name: [_settled_part(step) for step in response.steps] for response in responses
    }
    may_be_longer = proposal.asked.duration is None and len(attempts) == 1
    if may_be_longer and not _stuck(trace, chain(*ends.values())):
        return _longer(proposal)
    spans = {}
    for response in responses:
        name = response.variable.name
        old = proposal.setpoints[name].values
        reached = [float(response.values[rows].mean()) for rows in ends[name]]
        if name in proposal.asked.ranges or not reached:
            continue
        if all(100 * step.settled_error < SETTLED * abs(step.size) for step in response.steps):
            continue
        free = _KEPT_FREE * (max(reached) - min(reached))
        low, high = max(min(old), min(reached) + free), min(max(old), max(reached) - free)
        moves = (low - min(old)) + (max(old) - high) > _MOVED * float(np.ptp(old))
        spans[name] = (low, high) if moves and low < high else _shrunk(old)
    return _moved(proposal, spans)


def _responses(trace: Trace, preview: int) -> list[Response]:
    limits = (-np.inf, np.inf)
    return [
        Response(output, trace.y[:, j], limits, 1.0, trace.reference[:, j], preview, trace.preview)
        for j, output in enumerate(trace.outputs)
    ]


def _surprises(trace: Trace, proposal: Proposal, preview: int) -> Iterator[str]:
    """Name the outputs that end elsewhere than the step responses say, going by the inputs."""
    rest_u = np.array([proposal.study.plant.start.get(v.name, v.start) for v in proposal.inputs])
    for j, response in enumerate(_responses(trace, preview)):
        worst, text = _OTHERWISE, ""
        for rows in map(_settled_part, response.steps):
            u, y = trace.u[rows].mean(axis=0), float(response.values[rows].mean())
            expected = float(proposal.rest[j] + proposal.gains[j] @ (u - rest_u))
            moved = max(abs(y - proposal.rest[j]), abs(expected - proposal.rest[j]))
            if abs(y - expected) > worst * moved:  # of NaN there is nothing to say
                worst = abs(y - expected) / moved
                inputs = ", ".join(f"{v.name} {x:.3g}" for v, x in zip(trace.inputs, u, strict=True))
                text = f"{y:.3g} with {inputs}, where its step responses say {expected:.3g}"
        if text:
            yield f"{response.variable.name} ends otherwise than in the step test: at {text}"


def _settled_part(step: Stretch) -> slice:
    return slice(step.end - round(_SETTLED * (step.end - step.first)), step.end)


def _stuck(trace: Trace, ends: Iterable[slice]) -> bool:
    """Whether an input is at a limit where the outputs should have settled."""
    limits = zip(trace.bounds.u_min, trace.bounds.u_max, strict=True)
    at_limit = np.array(
        [
            Actuation(v, trace.u[:, i], ends, 1.0).at_limit
            for i, (v, ends) in enumerate(zip(trace.inputs, limits, strict=True))
        ]
    )
    return any(at_limit[:, rows].mean(axis=1).max() > _STUCK for rows in ends)


def _longer(proposal: Proposal) -> Proposal:
    """Return the proposal with longer stretches."""
    return _stretched(proposal, _LONGER)


def _shorter(proposal: Proposal, share: float) -> Proposal:
    """Return the proposal with everything in a share of the time, from the recording on."""
    note = f"All in {100 * share:g} % of the time that the step test suggests: later on every run failed."
    loop = proposal.study.loop
    faster = proposal.changed(loop=replace(loop, sampling_time=clean(share * loop.sampling_time)))
    return _stretched(replace(faster, comments={**proposal.comments, "loop": (note,)}), share)


def _stretched(proposal: Proposal, by: float) -> Proposal:
    loop = proposal.study.loop
    return proposal.changed(
        loop=replace(loop, duration=clean(by * loop.duration)),
        reference={
            name: replace(steps, times=tuple(clean(by * time) for time in steps.times))
            for name, steps in proposal.setpoints.items()
        },
    )


def _shrunk(values: Sequence[float]) -> tuple[float, float]:
    centre, half = (min(values) + max(values)) / 2, _SHRUNK * (max(values) - min(values)) / 2
    return centre - half, centre + half


def _moved(proposal: Proposal, spans: Mapping[str, tuple[float, float]]) -> Proposal:
    """Return the proposal with the setpoints of some outputs mapped into other spans."""
    reference = proposal.setpoints
    for name, (low, high) in spans.items():
        old = reference[name].values
        if width := max(old) - min(old):
            values = (low + (value - min(old)) / width * (high - low) for value in old)
            moved = tuple(rounded(value, (high - low) / 100) for value in values)
            reference[name] = replace(reference[name], values=moved)
    return proposal.changed(reference={**reference})


def _limits_shown(trace: Trace, parameters: Mapping[str, Variable]) -> Iterator[_Limit]:
    """Name the levels that an output does not pass, and the parameters that have such a value."""
    for j, output in enumerate(trace.outputs):
        y = trace.y[:, j]
        tolerance = _ALIKE * float(np.ptp(y))
        for level, side in ((float(y.max()), "above"), (float(y.min()), "below")):
            there = np.abs(y - level) <= tolerance
            wanted = (trace.reference[:, j] - level) * (1 if side == "above" else -1)
            if tolerance > 0.0 and np.mean(there & (wanted > _MOVED * np.ptp(y))) > _MOVED:
                equal = [
                    f"{p.name} = {p.start:g}"
                    for p in parameters.values()
                    if p.start and math.isclose(abs(p.start), abs(level), rel_tol=1e-3)
                ]
                # Many parameters are 1: of several, those count that are called a limit.
                named = equal if len(equal) == 1 else [text for text in equal if _LIMIT.search(text)]
                why = f" (parameter {', '.join(named[:_LISTED])})" if named else ""
                words = f"{output.name} does not go {side} {level:.4g}{why}"
                yield _Limit(output.name, level, 1 if side == "above" else -1, words)


def _with_outcome(attempts: Sequence[_Attempt], best: _Attempt, cut: Sequence[str]) -> Proposal:
    """Return the best of what was tried, with what came of it in its comments."""
    proposal = best.proposal
    limits = dict.fromkeys(limit.words for attempt in attempts for limit in attempt.limits)
    likely = [*limits, *proposal.hints] if best.line else []
    if best.line and not likely:
        likely = best.surprises or (
            [_NOT_FOUND] if best.line in (all_failed(best.cases), none_settles(best.cases)) else []
        )
    line = best.line
    if likely:  # what speaks against the data of a run is the lesser reason
        for case in best.cases:
            line = line.removesuffix(f"; {next(iter(case.warnings), None)}")
    head = [f"{line}." if line else _best_words(best)]
    head += [f"Likely why: {'; '.join(likely)}."] if likely else []
    if best.untried:
        rest = "; ".join(f"{label} ({share})" for label, share in best.untried.items())
        head.append(f"The time for trying was over before the end of {rest}.")
    shares = ", ".join(f"{label} {_percent(share)}" for label, share in best.left.items())
    kept = {controller.label for controller in proposal.study.controllers.values()}
    dropped = {
        k: why for attempt in reversed(attempts) for k, why in attempt.dropped.items() if k not in kept
    }
    on_controllers = [
        f"Tried once; left of the step at worst: {shares}." if shares else "",
        *(f"{label} is left out: {reason}" for label, reason in dropped.items()),
    ]
    on_reference = []
    if best is not attempts[0]:
        on_reference += [
            "Changed after a trial to what the best controller reached.",
            *(f"{limit}." for limit in limits),
        ]
    on_reference += [f"{name}: cut to what a trial reached." for name in cut]
    comments = {name: [*texts] for name, texts in proposal.comments.items()}
    for name, texts in (("head", head), ("reference", on_reference), ("controllers", on_controllers)):
        comments[name] = [*comments.get(name, ()), *filter(None, texts)]
    report = ReportSection(limitations=[f"{WHY}{'; '.join(likely)}"] if likely else [])
    by_section = {name: tuple(texts) for name, texts in comments.items()}
    return replace(proposal.changed(report=report), comments=by_section)


def _reached_only(best: _Attempt, limits: Sequence[_Limit]) -> tuple[Proposal, list[str]]:
    """Return the proposal without setpoints that no trial reached, or that a limit forbids, and whose.

    Where every controller fails, what they reach says nothing.
    """
    proposal, spans = best.proposal, {}
    if not best.cases:
        return proposal, []
    trace, failed = best.best_trace(), bool(all_failed(best.cases))
    for j, output in enumerate(trace.outputs):
        name, y = output.name, trace.y[:, j]
        if name in proposal.asked.ranges or not (steps := proposal.setpoints.get(name)):
            continue
        wanted = min(steps.values), max(steps.values)
        near = _REACHED * (wanted[1] - wanted[0])
        ends = [
            [limit.level for limit in limits if limit.output == name and limit.sign == sign]
            for sign in (-1, 1)
        ]
        low = max([-math.inf if failed else float(np.nanmin(y)) - near, *ends[0]])
        high = min([math.inf if failed else float(np.nanmax(y)) + near, *ends[1]])
        low, high = max(low, wanted[0] - near), min(high, wanted[1] + near)
        free = _KEPT_FREE * (high - low)
        if low < high and (low > wanted[0] or high < wanted[1]):
            span = max(wanted[0], low + free), min(wanted[1], high - free)
            spans[name] = span if span[0] < span[1] else (low + free, high - free)
    spans = {name: span for name, span in spans.items() if span[0] < span[1]}
    return _moved(proposal, spans), [*spans]


def _best_words(attempt: _Attempt) -> str:
    if not attempt.left:
        return ""
    label = min(attempt.left, key=lambda key: attempt.left[key])
    return f"Tried once; best: {label}, {_percent(attempt.left[label])} of the step left."


def _percent(share: float) -> str:
    if share > 100.0 or share < 0.01:
        return "more than all" if share > 100.0 else "nothing"
    return f"{share:.0f} %" if share >= 10.0 else f"{share:.2g} %"
