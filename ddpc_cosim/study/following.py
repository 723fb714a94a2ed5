"""Whether any controller follows its reference: one sentence, the same for files, terminal and page."""

import math
from collections.abc import Iterable
from statistics import median

from ddpc_cosim.metrics import split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.texts import printable
from ddpc_cosim.trace import Outcome

FOLLOWS = 5.0
"""A run follows its reference where it leaves less of every step, in %."""
WHY = "Likely why no controller follows: "
"""How a limitation of a study begins that is such a reason."""
_LONGEST_LABEL = 100
_STUCK = 0.5  # share of the time from which on inputs at their limits are a likely reason


def left_by(case: CaseResult) -> float:
    """Return what a case leaves of a step of its reference at worst [%].

    It is infinite of a run that did not complete or that left its limits, and NaN where the reference has no
    steps, or none whose window is long enough.
    """
    if case.outcome is not Outcome.COMPLETED:
        return math.inf
    values = (value for key, value in case.metrics.items() if split_key(key)[0] == "settled_share")
    shares = [value for value in values if not math.isnan(value)]
    most = max(shares, default=math.nan)
    return math.inf if most < FOLLOWS and not case.holds else most


def none_follows(cases: Iterable[CaseResult]) -> str:
    """Return a sentence where no controller follows its reference: none leaves less than 5 % of a step.

    Parameters
    ----------
    cases : iterable of CaseResult
        Of one scenario; what a controller leaves is the median over its cases.

    Returns
    -------
    str
        Empty where one does, or where a run completes whose reference has no steps to judge that by.
    """
    shares: dict[str, list[float]] = {}
    for case in cases:
        shares.setdefault(case.controller, []).append(left_by(case))
    everything = [share for own in shares.values() for share in own]
    if not everything or any(map(math.isnan, everything)):
        return ""
    best = min(map(median, shares.values()))
    if best < FOLLOWS:
        return ""
    return f"No controller follows the reference; {_what_is_left(best, min(everything))}"


def following_lines(study: Study, cases: Iterable[CaseResult]) -> list[str]:
    """Return a line for each scenario of a study in which no controller follows its reference."""
    by_scenario: dict[str, list[CaseResult]] = {}
    for case in cases:
        by_scenario.setdefault(case.scenario, []).append(case)
    labels = {name: printable(one.label or name, _LONGEST_LABEL) for name, one in study.scenarios.items()}
    return [
        (f"{labels.get(name, name)}: " if len(by_scenario) > 1 else "") + text + _likely_reason(own, study)
        for name, own in by_scenario.items()
        if (text := none_follows(own))
    ]


def _what_is_left(best: float, least: float) -> str:
    """Say what the best controller leaves; ``least`` is what the best run of all does."""
    if math.isinf(least):
        return "no run completes within its limits"
    if math.isinf(best):
        return "none completes most of its runs within its limits"
    if best > 100.0:
        return "the best ends further from it than it began"
    return f"the best leaves {best:.{0 if best >= 10.0 else 1}f} % of its change"


def _likely_reason(cases: Iterable[CaseResult], study: Study) -> str:
    """Return which inputs of the best run are mostly at their limits, and why the study says it may be.

    Where there is neither, it is what spoke against the best run's data or model.
    """
    best = min(cases, key=left_by)
    times = {
        split_key(key)[1]: time / study.loop.duration
        for key, time in best.metrics.items()
        if key.startswith("time_at_bounds.")
    }
    stuck = [f"{name} {100 * time:.0f} % of the time" for name, time in times.items() if time > _STUCK]
    told = [text.removeprefix(WHY) for text in study.report.limitations if text.startswith(WHY)]
    reasons = [*([f"at its limits: {', '.join(stuck)}"] if stuck else []), *told]
    return "".join(f"; {reason}" for reason in reasons or best.warnings[:1])
