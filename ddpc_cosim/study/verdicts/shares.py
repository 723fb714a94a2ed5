"""Shares of the way between two reference points: distances where ranks only say who is ahead.

Of a metric m, in pairs of runs of the same problem, scenario and seed::

    share = (m_zero - m) / (m_zero - m_full)

It is 0 for a run that is as good as that of the controller at 0 %, and 1 for one as good as that of the
controller at 100 %; it may be negative or above 1. A reference point that is run with the first seed alone is
set beside the runs of all seeds. Scaling and shifting the metric changes nothing, so that shares of different
plants can be set side by side.
"""

import math
from collections.abc import Collection, Hashable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.metrics import headline, metric_of, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.file_format.sections import ReferencePoints
from ddpc_cosim.study.file_format.sweeps import variant_words
from ddpc_cosim.study.verdicts.statistics import Runs, Sample, describe
from fmu_plants.spelling import did_you_mean

if TYPE_CHECKING:
    import pandas as pd

    from ddpc_cosim.study.file_format.sections import Study
    from ddpc_cosim.study.problems import WholeStudy

FLOOR = -1.0
"""What a run that failed counts as where runs are summed up; and a share below it."""
NEGLIGIBLE = 0.01
"""There is no way to go between two points that differ by no more than this part of the metric at 0 %."""


class RunShare(NamedTuple):
    """What one run reaches of the way between the reference points.

    Parameters
    ----------
    case : CaseResult
        The run.
    metric : str
        The metric.
    zero, full : float
        The metric at the two points, in the same scenario and with the same seed; NaN where it is not known.
    share : float
        1 for as good as at ``full``; NaN of a run that failed, and where there is no way to go.
    """

    case: CaseResult
    metric: str
    zero: float
    full: float
    share: float

    @property
    def has_way(self) -> bool:
        """Whether the controller at 100 % is better than that at 0 %, by more than next to nothing."""
        ahead = self.full - self.zero if metric_of(self.metric).better == "high" else self.zero - self.full
        return math.isfinite(ahead) and ahead > NEGLIGIBLE * abs(self.zero)


def share_runs(
    cases: Sequence[CaseResult],
    points: ReferencePoints,
    metrics: Iterable[str],
    run_once: Collection[str] = (),
) -> Iterator[RunShare]:
    """Yield what each run of one problem reaches, without those of the reference points.

    The run at 0 % has to complete, and may have failed: doing nothing mostly ends far from its reference. The
    run at 100 % must not have failed. ``run_once``: those that are run with the first seed alone.
    """
    at = {(case.controller, case.scenario, case.seed): case for case in cases}
    seeds = dict.fromkeys(case.seed for case in cases)
    for case in cases:
        for seed in seeds if case.controller in run_once else ():
            at.setdefault((case.controller, case.scenario, seed), case)
    for metric in metrics:
        for case in cases:
            if end_of(case.controller, points) is not None:
                continue
            zero, full = (at.get((name, case.scenario, case.seed)) for name in (points.zero, points.full))
            m_zero = (
                zero.metrics.get(metric, math.nan) if zero and zero.outcome is Outcome.COMPLETED else math.nan
            )
            m_full = full.metrics.get(metric, math.nan) if full and not full.failed else math.nan
            run_share = RunShare(case, metric, m_zero, m_full, math.nan)
            if not case.failed and run_share.has_way:
                gained = m_zero - case.metrics.get(metric, math.nan)
                run_share = run_share._replace(share=gained / (m_zero - m_full))
            yield run_share


def shares_of(
    cases: Sequence[CaseResult],
    points: ReferencePoints,
    metrics: Iterable[str],
    run_once: Collection[str] = (),
) -> dict[str, Runs]:
    """Return the shares by controller, NaN of runs that failed; none where there is no way to go.

    A condition is a scenario and a metric. ``run_once`` is that of :func:`share_runs`.
    """
    shares: dict[str, dict[tuple[Hashable, int], float]] = {}
    for run_share in share_runs(cases, points, metrics, run_once):
        if run_share.has_way:
            run = (run_share.case.scenario, run_share.metric), run_share.case.seed
            shares.setdefault(run_share.case.controller, {})[run] = run_share.share
    return dict(shares)


def run_once(study: "Study") -> set[str]:
    """Return the controllers of a study of one problem that are run with its first seed alone."""
    return {name for name, section in study.controllers.items() if section.seeds == "first"}


def end_of(controller: str, points: ReferencePoints | None) -> float | None:
    """Return where a controller is on the scale if it is a reference point, which does not compete."""
    return {points.zero: 0.0, points.full: 1.0}.get(controller) if points else None


def marked(label: str, controller: str, points: ReferencePoints | None) -> str:
    """Return a label; of a reference point with its end of the scale, as it does not compete."""
    end = end_of(controller, points)
    return label if end is None else f"{label} ({100 * end:.0f}\u00a0%)"


def floored(runs: Runs) -> Runs:
    """Return shares of which none is below -1, which is also that of a run that failed."""
    return {run: max(share, FLOOR) if math.isfinite(share) else FLOOR for run, share in runs.items()}


def describe_shares(runs: Runs) -> Sample:
    """Sum up shares; a run that failed counts as -1, so that failing does not flatter."""
    known = sum(map(math.isfinite, runs.values()))
    return describe(floored(runs))._replace(known=known)


def share_frame(whole: "WholeStudy", cases: Sequence[CaseResult], metric: str) -> "pd.DataFrame":
    """Return a row per metric and case: see :meth:`ddpc_cosim.StudyResults.shares`."""
    import pandas as pd

    keys = list(dict.fromkeys(key for case in cases for key in case.metrics))
    chosen = [key for key in keys if metric in (key, key.partition(" [")[0], split_key(key)[0])]
    if metric and not chosen:
        shown = dict.fromkeys(split_key(key)[0] for key in keys)
        raise ConfigError(f'no metric "{metric}"; {did_you_mean(metric, shown)}')
    if neither := [key for key in chosen if not metric_of(key).better]:
        raise ConfigError(f'metric "{neither[0]}": no value of it is better, so there is no way to go')
    if not any(study.report.reference_points for study in whole.problems.values()):
        raise ConfigError(
            f"{whole.head.name}: no reference points; needed: in [report] of the study, "
            'reference_points = { zero = "CONTROLLER", full = "CONTROLLER" }'
        )
    by_problem: dict[str, list[CaseResult]] = {}
    for case in cases:
        by_problem.setdefault(case.problem, []).append(case)
    rows = []
    for name, problem_cases in by_problem.items():
        study = whole.problems[name]
        if study.report.reference_points:
            known = dict.fromkeys(key for case in problem_cases for key in case.metrics)
            metrics = (
                [key for key in chosen if key in known] if metric else headline(known, study.metrics.ranking)
            )
            rows += [
                {
                    "problem": study.variant_of or name,
                    "controller": run_share.case.controller,
                    "label": run_share.case.label,
                    "scenario": run_share.case.scenario,
                    "variant": variant_words(study.varied),
                    "seed": run_share.case.seed,
                    "failed": run_share.case.failed,
                    "metric": run_share.metric,
                    "value": run_share.case.metrics.get(run_share.metric, math.nan),
                    "zero": run_share.zero,
                    "full": run_share.full,
                    "share": run_share.share,
                }
                for run_share in share_runs(
                    problem_cases, study.report.reference_points, metrics, run_once(study)
                )
            ]
    return pd.DataFrame(rows)
