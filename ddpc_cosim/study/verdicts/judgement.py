"""What is concluded of a run, in two notions: whether it failed, and whether it settles.

Both ask how far an output ends from its reference: over the last fifth of each stretch of constant
reference, or of the run where there is none. That is taken in parts of the size of the output's task, which
is the larger of how far its reference travels, from where the output begins on, and how far the output goes
while nothing is done; of that no more than three times as far as the reference travels, if it moves, since a
plant that is left alone may run away as far as it likes; of a task without either, the width of the output's
limits, else its nominal value, or the magnitude of its reference where that is larger.

Of an output that is wanted within a band, distances are those to the band. The size of its task is the
largest of the band's width, of how far the band makes the output move, and of how far the output gets from it
while nothing is done, of that no more than three times the larger of the others. What is left is in parts of
the band's width, or of its distance to the one before where that is larger. While a declared disturbance
moves, an output that follows a reference has nothing to settle to: of that nothing is concluded there.

What a scenario makes unavoidable is taken off. With ``s``, the standard deviation of what cannot be known one
sample ahead (measurement noise, and what declared disturbances, inputs and a plant's own noise scatter the
output: the smaller of that of the run and that of doing nothing), ``q``, the step of quantised measurements,
and ``n``, the samples of the window, that is
``0.8 s + 4 * 0.6 s / sqrt(n) + q / 2`` of a mean magnitude (0.8 s is the mean
magnitude of Gaussian noise, 0.6 s its standard deviation) and ``4 s / sqrt(n) + q / 2`` of a mean: four
standard errors, since a run has many windows and a study many runs. Of a mean over the whole run ``n`` is
that of its windows together.

Doing nothing is a run that the tool makes itself, once per scenario and seed, outside every ranking.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean, median
from typing import TYPE_CHECKING, Any, NamedTuple

from ddpc_cosim.files.texts import alike, printable
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.metrics import split_key
from ddpc_cosim.responses import EndWindow, Tracking
from ddpc_cosim.study.case_columns import replaced
from ddpc_cosim.study.case_files import CaseResult

if TYPE_CHECKING:
    from ddpc_cosim.study.file_format.sections import ScenarioSection, Study

SETTLED = 5.0
"""A run settles where it leaves no more of a step than this, in %."""
WHY = "Likely why no controller settles: "
"""How a limitation of a study begins that is such a reason."""
_FAILED = 0.5
"""Of its task: a run that ends as far away failed, as does one that rests between two setpoints."""
_NEGLIGIBLE = 0.01
"""Of its task: what is worse than doing nothing by less is not worse."""
_FARTHEST = 3.0
"""Of the travel of a reference that moves: what doing nothing does counts up to that."""
_MEAN_MAGNITUDE = math.sqrt(2.0 / math.pi)
"""Of Gaussian noise of standard deviation 1."""
_SPREAD_OF_MAGNITUDE = math.sqrt(1.0 - 2.0 / math.pi)
"""Standard deviation of the magnitude of such noise."""
_STANDARD_ERRORS = 4.0
_SMALLEST_STEP = 0.01
"""Of how far a reference travels: a smaller step is not what a run is judged by."""
LONGEST_LABEL = 100
"""Characters of a label that a sentence has room for."""
_STUCK = 0.5  # share of the time from which on inputs at their limits are a likely reason

Run = tuple[str, str, int]
"""Problem, scenario and seed."""


class Unavoidable(NamedTuple):
    """What a scenario makes unavoidable in one output, in its unit.

    Parameters
    ----------
    scatter : float
        Standard deviation of what cannot be known one sample ahead.
    offset : float
        What quantised measurements hide.
    """

    scatter: float = 0.0
    offset: float = 0.0

    def magnitude(self, rows: int) -> float:
        """Of a mean magnitude over so many samples."""
        errors = _STANDARD_ERRORS * _SPREAD_OF_MAGNITUDE / math.sqrt(rows)
        return (_MEAN_MAGNITUDE + errors) * self.scatter + self.offset

    def mean(self, rows: int) -> float:
        """Of a mean over so many samples."""
        return _STANDARD_ERRORS * self.scatter / math.sqrt(rows) + self.offset


def run_of(case: CaseResult) -> Run:
    """Return which run a case is, whoever controls it."""
    return case.problem, case.scenario, case.seed


def judged(
    scenarios: Mapping[str, "ScenarioSection"], cases: Iterable[CaseResult], resting: Mapping[Run, CaseResult]
) -> tuple[CaseResult, ...]:
    """Return cases of one problem with what is concluded of them.

    Parameters
    ----------
    scenarios : mapping of str to ScenarioSection
        The scenarios, by name: noise and quantisation, in the outputs' units.
    cases : iterable of CaseResult
        The cases.
    resting : mapping of Run to CaseResult
        The runs of doing nothing, under the same disturbances; where one is missing, it decides nothing.
    """
    return tuple(
        replaced(
            (case, _concluded(case, resting.get(run_of(case)), scenarios.get(case.scenario)))
            for case in cases
        )
    )


def _concluded(
    case: CaseResult, resting: CaseResult | None, scenario: "ScenarioSection | None"
) -> dict[str, Any]:
    """Return what is concluded of a case, by field."""
    if case.outcome is not Outcome.COMPLETED:
        return {"failed": True, "failure": "", "settles": False, "left": math.inf}
    nothing = {tracking.output: tracking for tracking in resting.tracking} if resting else {}
    followed = case.tracking
    outputs = {tracking.output: tracking for tracking in followed}
    unavoidable = {
        name: _unavoidable(output, nothing.get(name), scenario) for name, output in outputs.items()
    }
    completed = resting is not None and resting.outcome is Outcome.COMPLETED
    at_rest = nothing if completed else {}
    sizes = {name: task_size(output, at_rest.get(name)) for name, output in outputs.items()}
    parts = [_left(output, sizes[name], unavoidable[name]) for name, output in outputs.items()]
    left = [part for part in parts if not math.isnan(part)]
    most = max(left, default=math.nan)
    failure = _distance(followed, sizes, unavoidable)
    # Where the plant controls itself, that is a competitor: to be worse than it is no failure.
    is_idle = completed and not (resting and resting.is_own_control)
    if not failure and is_idle and outputs:
        failure = _against_nothing(followed, nothing, sizes, unavoidable)
    settles = None if math.isnan(most) else most <= SETTLED
    tasks = {name: sizes[name] * output.factor for name, output in outputs.items()}
    return {"failed": bool(failure), "failure": failure, "settles": settles, "left": most, "tasks": tasks}


def task_size(tracking: Tracking, nothing: Tracking | None) -> float:
    """Return the size of an output's task, in its unit, by what it does itself while nothing is done."""
    moved = max(_moved(tracking, nothing), tracking.width or 0.0)
    if 0.0 < moved < math.inf:
        return moved
    return tracking.room if 0.0 < tracking.room < math.inf else tracking.nominal


def _moved(tracking: Tracking, nothing: Tracking | None) -> float:
    gone = nothing.deviation if nothing else 0.0
    most = _FARTHEST * max(tracking.travel, tracking.width or 0.0)
    return max(tracking.travel, gone if tracking.is_regulation else min(gone, most))


def _unavoidable(
    tracking: Tracking, nothing: Tracking | None, scenario: "ScenarioSection | None"
) -> Unavoidable:
    noise = scenario.noise.get(tracking.output, 0.0) if scenario else 0.0
    quantum = scenario.effects.get("quantum", {}).get(tracking.output, 0.0) if scenario else 0.0
    # Where nothing acts on the plant, what its own dynamics do is not noise. The smaller: what is wild in one
    # of the two runs, as an unstable plant that is left alone, is none either.
    by_scenario = scenario is not None and bool(scenario.disturbances or scenario.inputs)
    acts = tracking.is_disturbed or by_scenario
    scatter = min(tracking.scatter, nothing.scatter if nothing else math.inf) if acts else 0.0
    return Unavoidable(math.hypot(noise, scatter), 0.5 * quantum)


def _left(tracking: Tracking, size: float, unavoidable: Unavoidable) -> float:
    """Return what is left at worst of a step, or of the task where the reference makes none [%]."""
    parts = [
        100.0
        * max(end.error - unavoidable.mean(end.rows), 0.0)
        / (end.step if end.step > _SMALLEST_STEP * tracking.travel else size)
        for end in tracking.ends
        if end.settling and not end.disturbed
    ]
    return max(parts, default=math.nan)


def _distance(
    tracking: Iterable[Tracking], sizes: Mapping[str, float], unavoidable: Mapping[str, Unavoidable]
) -> str:
    """Say which output ends further than half of its task away; nothing if none does."""
    for output in tracking:
        far = max((_far(end, unavoidable[output.output]) for end in output.ends), default=math.inf)
        share = far / sizes[output.output]
        if not share < _FAILED:
            what = "reference" if output.width is None else "band"
            return f"{output.output} ends {_percent(share)} its task away from its {what}"
    return ""


def _far(end: EndWindow, unavoidable: Unavoidable) -> float:
    return end.magnitude - unavoidable.magnitude(end.rows)


def _against_nothing(
    tracking: Sequence[Tracking],
    nothing: Mapping[str, Tracking],
    sizes: Mapping[str, float],
    unavoidable: Mapping[str, Unavoidable],
) -> str:
    """Say in which output a run is worse than doing nothing, or over all together; nothing if in none."""
    # One that rests while nothing is done has no task of its own: whatever acts on the others moves it.
    alone = [[output] for output in tracking if _moved(output, nothing[output.output]) > 0.0]
    for outputs in (*alone, tracking):
        mean_error = fmean(output.mean_abs_error / sizes[output.output] for output in outputs)
        rest = fmean(nothing[output.output].mean_abs_error / sizes[output.output] for output in outputs)
        more = fmean(
            unavoidable[output.output].magnitude(_rows(output)) / sizes[output.output] for output in outputs
        )
        if not mean_error - rest <= more + _NEGLIGIBLE:
            where = f"{outputs[0].output} is " if len(outputs) == 1 else ""
            means = f"mean error {_percent(mean_error)} the task, doing nothing {_percent(rest)} it"
            return f"{where}worse than doing nothing: {means}"
    return ""


def _rows(tracking: Tracking) -> int:
    return sum(end.rows for end in tracking.ends)


def _percent(share: float) -> str:
    return f"{100.0 * share:.{0 if share >= 0.1 else 1}f} % of" if share < 100.0 else "more than 100 times"


def all_failed(cases: Iterable[CaseResult]) -> str:
    """Return a sentence where every run of every controller failed; nothing where one did not.

    Parameters
    ----------
    cases : iterable of CaseResult
        Of one scenario.
    """
    everything = [*cases]
    if not everything or not all(case.failed for case in everything):
        return ""
    ended = [case for case in everything if case.outcome is Outcome.COMPLETED]
    if not ended:
        return "Every controller fails: none completes a run"
    best = min(ended, key=_left_first)
    return f"Every controller fails; in the best run, {best.failure}"


def _left_first(case: CaseResult) -> tuple[float, str]:
    """Return what cases are sorted by, the one that leaves least first."""
    return math.inf if math.isnan(case.left) else case.left, case.id


def none_settles(cases: Iterable[CaseResult]) -> str:
    """Return a sentence where no controller settles in most of its runs; nothing where one does.

    Parameters
    ----------
    cases : iterable of CaseResult
        Of one scenario; what a controller leaves is the median over its cases.
    """
    shares: dict[str, list[float]] = {}
    everything = [*cases]
    for case in everything:
        shares.setdefault(case.controller, []).append(math.inf if case.failed else case.left)
    if not shares or any(
        math.isnan(share) for controller_shares in shares.values() for share in controller_shares
    ):
        return ""
    best = min(map(median, shares.values()))
    has_bands = any(output.width is not None for case in everything for output in case.tracking)
    if best <= SETTLED:
        return ""
    if math.isinf(best):
        return "No controller settles in most of its runs: at least half of the runs of each fail"
    what = f"the best leaves {best:.{0 if best >= 10.0 else 1}f} % of a {'band' if has_bands else 'step'}"
    return f"No controller settles within {SETTLED:g} %: {what}"


def set_aside(study: "Study") -> set[str]:
    """Return the controllers that do not compete: reference points, and the variants of sweeps."""
    points = study.report.reference_points
    aside = {name for name, section in study.controllers.items() if section.variant_of}
    return aside | ({points.zero, points.full} if points else set())


def unsettled(study: "Study", cases: Iterable[CaseResult]) -> str:
    """Return a sentence on the runs that did not fail and do not settle, by controller; nothing without any.

    Parameters
    ----------
    study : Study
        The study: its reference points and the variants of sweeps, which do not compete, are left out.
    cases : iterable of CaseResult
        Of one problem, over all its scenarios.
    """
    aside = set_aside(study)
    by_controller: dict[str, list[CaseResult]] = {}
    for case in cases:
        if case.controller not in aside:
            by_controller.setdefault(case.controller, []).append(case)
    counts = {
        key: sum(not case.failed and case.settles is False for case in runs)
        for key, runs in by_controller.items()
    }
    parts = [
        f"{printable(runs[0].label, LONGEST_LABEL)} in {counts[key]} of {len(runs)} runs"
        for key, runs in by_controller.items()
        if counts[key]
    ]
    return f"Does not settle within {SETTLED:g} %: {', '.join(parts)}" if parts else ""


class Remark(NamedTuple):
    """What is to be known of a scenario before its ranking.

    Parameters
    ----------
    text : str
        In a sentence without its full stop.
    is_failure : bool
        Whether nothing is ranked for it; otherwise it is a note.
    """

    text: str
    is_failure: bool


def scenario_labels(study: "Study") -> dict[str, str]:
    """Return what the scenarios of a study are called in sentences, by name."""
    return {
        name: printable(scenario.label or name, LONGEST_LABEL) for name, scenario in study.scenarios.items()
    }


def scenario_remarks(study: "Study", cases: Iterable[CaseResult]) -> list[Remark]:
    """Return a remark for each scenario of a study in which every run fails, or no controller settles.

    That a reference point or a variant of a sweep does not fail changes nothing: they do not compete.
    """
    aside = set_aside(study)
    by_scenario: dict[str, list[CaseResult]] = {}
    for case in cases:
        by_scenario.setdefault(case.scenario, []).append(case)
    labels = scenario_labels(study)
    where = "{}: " if len(by_scenario) > 1 else ""
    remarks = []
    for name, scenario_cases in by_scenario.items():
        competing = [case for case in scenario_cases if case.controller not in aside]
        failed = all_failed(competing)
        if text := failed or none_settles(scenario_cases):
            reason = _likely_reason(competing if failed else scenario_cases, study)
            remarks.append(Remark(f"{where.format(labels.get(name, name))}{text}{reason}", bool(failed)))
    return remarks


def _likely_reason(cases: Sequence[CaseResult], study: "Study") -> str:
    """Return which inputs of the best run are mostly at their limits, and why the study says it may be.

    Where there is neither, it is what spoke against the data or model of every controller.
    """
    best = min(cases, key=_left_first)
    times = {
        split_key(key)[1]: time / study.loop.duration
        for key, time in best.metrics.items()
        if key.startswith("time_at_bounds.")
    }
    stuck = [f"{name} {100 * time:.0f} % of the time" for name, time in times.items() if time > _STUCK]
    declared = [text.removeprefix(WHY) for text in study.report.limitations if text.startswith(WHY)]
    reasons = [*([f"at its limits: {', '.join(stuck)}"] if stuck else []), *declared]
    return "".join(f"; {reason}" for reason in reasons or _shared_warnings(cases)[:1])


def _shared_warnings(cases: Sequence[CaseResult]) -> list[str]:
    """Return the warnings that all controllers have, in the words of the first: of one it says too little."""
    by_controller: dict[str, set[str]] = {}
    for case in cases:
        by_controller.setdefault(case.controller, set()).update(map(alike, case.warnings))
    shared = set.intersection(*by_controller.values())
    return [text for text in cases[0].warnings if alike(text) in shared]
