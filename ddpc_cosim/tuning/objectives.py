"""What trials are compared by: a figure of their runs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import NamedTuple, Self

import numpy as np

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.metrics import all_metrics, split_key
from ddpc_cosim.responses import Actuation, Response, StepTimes
from ddpc_cosim.signals.signals import Band
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.resolve import ResolvedStudy
from fmu_plants.spelling import did_you_mean

PREDICTION = "prediction"
_PREDICTION_ERROR = "prediction_error"


class Run(NamedTuple):
    """Which of a trial's runs."""

    scenario: str
    seed: int


@dataclass(frozen=True, slots=True)
class Objective:
    """What the trials are compared by.

    Parameters
    ----------
    metric : str
        Name of a metric, or ``prediction``: the error of the controller's prediction on the part of the
        recording that was held out, for which no loop is closed.
    signal : str
        Of which signal; empty: the mean over the signals, errors as shares of their reference's span.
    over : str
        How the runs of a trial are summed up: ``mean``, ``median`` or a quantile such as ``0.9`` over the
        seeds, and the mean over the scenarios; or ``worst`` of all.
    """

    metric: str = "rmse"
    signal: str = ""
    over: str = "median"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the objective ``METRIC[.SIGNAL][:OVER]``.

        Raises
        ------
        ConfigError
            The metric does not exist, or runs are not summed up so.
        """
        key, _, over = text.partition(":")
        name, signal, _ = split_key(key)
        judged = {key for key, metric in all_metrics().items() if metric.better}
        if name not in (PREDICTION, *judged):
            hint = did_you_mean(name, [PREDICTION, *judged])
            raise ConfigError(
                f'--objective {text}: no metric "{name}" that trials can be compared by; {hint}'
            )
        if over not in ("", "mean", "median", "worst") and not _is_share(over):
            allowed = "allowed: mean, median, worst, or a quantile from 0 to 1, such as rmse:0.9"
            raise ConfigError(f'--objective {text}: "{over}" is not possible; {allowed}')
        return cls(name, signal, over or "median")

    def __str__(self) -> str:
        what = ".".join(filter(None, (self.metric, self.signal)))
        over = f"{self.over} quantile" if _is_share(self.over) else self.over
        return f"{what}, " + (
            "worst of all runs" if over == "worst" else f"{over} over the seeds, mean over the scenarios"
        )

    def check(self, resolved: ResolvedStudy, engine: str) -> None:
        """Raise a ConfigError if a problem, whose samples an engine computes, does not have such a figure."""
        if self.metric == PREDICTION:
            return
        metric = all_metrics()[self.metric]
        if metric.of is StepTimes and engine == "compiled":
            what = "a compiled loop has no times of steps"
            raise ConfigError(f"--objective {self.metric}: {what}; use --engine python")
        variables = {Response: resolved.outputs, Actuation: resolved.inputs}.get(metric.of, ())
        known = [variable.name for variable in variables]
        if self.signal and self.signal not in known:
            hint = did_you_mean(self.signal, known) if known else f"needed: {self.metric}"
            raise ConfigError(
                f'--objective: {self.metric} has no signal "{self.signal}" in {resolved.study.name}; {hint}'
            )
        in_own_units = metric.unit in ("value", "difference", "difference.s") and not self._is_share_of_span
        if not self.signal and len(known) > 1 and in_own_units:
            what = f"{self.metric} of {', '.join(known)} cannot be added up, as their units differ"
            raise ConfigError(f"--objective: {what}; needed: one of them, such as {self.metric}.{known[0]}")

    @property
    def _is_share_of_span(self) -> bool:
        metric = all_metrics()[self.metric]
        return not self.signal and metric.of is Response and metric.unit == "difference"

    def of(self, runs: Mapping[Run, float]) -> float:
        """Return the figure of a trial, the lower the better; infinite where too many runs do not have one.

        Parameters
        ----------
        runs : mapping of Run to float
            The figure of each run, as :meth:`of_run` gives it.
        """
        values: dict[str, list[float]] = {}
        for run, value in runs.items():
            values.setdefault(run.scenario, []).append(value)
        if not values:
            return math.inf
        if self.over == "worst":
            return max(max(figures) for figures in values.values())
        if self.over == "mean":
            return fmean(fmean(figures) for figures in values.values())
        if self.over == "median":
            return fmean(float(np.median(figures)) for figures in values.values())
        share = float(self.over)  # infinite values cannot be interpolated
        return fmean(float(np.quantile(figures, share, method="higher")) for figures in values.values())

    def of_run(self, case: CaseResult, spans: Mapping[str, float]) -> float:
        """Return the figure of a run, the lower the better; infinite where it does not exist."""
        if case.outcome is not Outcome.COMPLETED:
            return math.inf
        if self.metric == PREDICTION:
            return _or_infinite(case.diagnostics.get(_PREDICTION_ERROR, math.nan))
        metric = all_metrics()[self.metric]
        values = {
            split_key(key)[1]: value
            for key, value in case.metrics.items()
            if split_key(key)[0] == self.metric
        }
        wanted = {signal: value for signal, value in values.items() if self.signal in ("", signal)}
        if self._is_share_of_span:
            wanted = {signal: value / spans[signal] for signal, value in wanted.items()}
        return _or_infinite(metric.rank(fmean(wanted.values()))) if wanted else math.inf

    def failed(self, case: CaseResult) -> bool:
        """Whether a run failed; where predictions alone count, whether they are missing."""
        if self.metric == PREDICTION:
            return not math.isfinite(self.of_run(case, {}))
        return case.failed


def _is_share(text: str) -> bool:
    try:
        return 0 <= float(text) <= 1
    except ValueError:
        return False


def _or_infinite(value: float) -> float:
    return math.inf if math.isnan(value) else value


def reference_spans(resolved: ResolvedStudy) -> dict[str, float]:
    """Return by how much each reference, or edge of a band, moves, in display units; else nominal values."""
    loop = resolved.study.loop
    samples = np.arange(loop.steps + 1, dtype=np.float64) * loop.sampling_time
    time = np.concatenate([each.start_time + samples for each in resolved.study.loops])
    spans = dict[str, float]()
    for variable in resolved.outputs:
        wanted = resolved.reference[variable.name]
        lines = wanted.edges(variable) if isinstance(wanted, Band) else (wanted,)
        moved = max(float(np.ptp(line.at(time))) for line in lines) or variable.nominal
        spans[variable.name] = moved * variable.shown_in.factor
    return spans
