"""What a study requires of its controllers: whether each meets it, on how many of its seeds, and why not.

A run meets a requirement if it did not fail and its metric is within the limits, both ends included; a metric
without a value meets nothing. A controller meets a requirement in a scenario if it misses it on no more than
``1 - share`` of its runs there, and altogether if it does so in each scenario in which it is required.
Requirements judge runs; they decide none.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.texts import printable
from ddpc_cosim.metrics import in_unit, metric_name, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.verdicts.judgement import LONGEST_LABEL, scenario_labels, set_aside

if TYPE_CHECKING:
    import pandas as pd

    from ddpc_cosim.study.file_format.requirements import Required
    from ddpc_cosim.study.file_format.sections import Study

_ROUNDING = 1e-9
"""Of the runs: what rounding leaves of a share is no run."""
_NAMED = 3
"""Reasons and controllers that a line names where there are more."""


@dataclass(frozen=True)
class Requirement:
    """One requirement.

    Parameters
    ----------
    key : str
        The metric, as the runs have it; without a unit if none of them has it.
    min, max : float
        The limits, in ``unit``; infinite where there is none.
    share : float
        On how many of the seeds it has to be met.
    unit : str
        The unit that the study gives, else that of the metric.
    scenarios : tuple of str
        Where it is required.
    words : str
        What the metric is called, with its signal.
    """

    key: str
    min: float
    max: float
    share: float
    unit: str
    scenarios: tuple[str, ...]
    words: str

    @property
    def limits(self) -> str:
        """The limits in words: ``at most 5 %``."""
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        if math.isinf(self.max):
            return f"at least {self.min:g}{unit}"
        return (
            f"at most {self.max:g}{unit}" if math.isinf(self.min) else f"{self.min:g} to {self.max:g}{unit}"
        )

    def value(self, case: CaseResult) -> float:
        """Return the metric of a run in the unit of the limits; NaN where it has none."""
        value = case.metrics.get(self.key, math.nan)
        try:
            shown = in_unit(self.key, self.unit)
        except ConfigError:  # of a metric that is installed no more, or that no run has
            return math.nan
        return value * shown.factor + shown.offset

    def is_met(self, case: CaseResult) -> bool:
        """Whether a run meets it."""
        return not case.failed and self.min <= self.value(case) <= self.max


class Tally(NamedTuple):
    """How often a controller meets a requirement in a scenario.

    Parameters
    ----------
    controller, scenario : str
        Their names in the study.
    requirement : Requirement
        What is required.
    runs, met : int
        How many runs there are, and how many meet it.
    failed, unknown : int
        Runs that failed, and those of the others without a value of the metric.
    worst : float
        Of the values outside the limits the one that is furthest from them, in their unit; NaN: none is.
    """

    controller: str
    scenario: str
    requirement: Requirement
    runs: int
    met: int
    failed: int
    unknown: int
    worst: float

    @property
    def is_met(self) -> bool:
        """Whether that is often enough; without a run it is not."""
        missed = self.runs - self.met
        return self.runs > 0 and missed <= (1.0 - self.requirement.share) * self.runs + _ROUNDING * self.runs

    @property
    def why(self) -> str:
        """Why runs miss it; empty if none does."""
        beyond = self.runs - self.met - self.failed - self.unknown
        value = f"{self.worst:.3g} {self.requirement.unit}".removesuffix(" 1").strip()
        reasons = {
            f"{self.failed} failed": self.failed,
            f"{self.unknown} without a value": self.unknown,
            f"{beyond} beyond, as far as {value}": beyond,
            "no run": not self.runs,
        }
        return ", ".join(text for text, count in reasons.items() if count)


@dataclass(frozen=True)
class RequirementFindings:
    """Who meets what a study of one problem requires.

    Parameters
    ----------
    requirements : tuple of Requirement
        What is required.
    named : tuple of str
        The controllers that have to meet all of it; empty: one of those that compete has to.
    tallies : tuple of Tally
        Of each controller that is named or competes, each requirement and each scenario in which it is
        required.
    labels, scenarios : dict of str to str
        What controllers and scenarios are called.
    """

    requirements: tuple[Requirement, ...]
    named: tuple[str, ...]
    tallies: tuple[Tally, ...]
    labels: dict[str, str]
    scenarios: dict[str, str]

    @cached_property
    def controllers(self) -> tuple[str, ...]:
        """Those that are judged, in the order of the study."""
        return tuple(dict.fromkeys(tally.controller for tally in self.tallies))

    def of(self, controller: str, requirement: Requirement | None = None) -> list[Tally]:
        """Return the tallies of a controller, of one requirement or of all."""
        return [
            tally
            for tally in self.tallies
            if tally.controller == controller and requirement in (None, tally.requirement)
        ]

    def meets(self, controller: str, requirement: Requirement | None = None) -> bool:
        """Whether a controller meets a requirement, or all of them."""
        return all(tally.is_met for tally in self.of(controller, requirement))

    @cached_property
    def meeting(self) -> tuple[str, ...]:
        """The controllers that meet all of it."""
        return tuple(name for name in self.controllers if self.meets(name))

    @property
    def passed(self) -> bool:
        """Whether all that are named meet all of it; where none is, whether one that competes does."""
        return all(name in self.meeting for name in self.named) if self.named else bool(self.meeting)

    @property
    def verdict(self) -> str:
        """Whether the study passes, and why not, in a sentence without its full stop."""
        if self.passed:
            return "Requirements: passed"
        missing = [self.labels[name] for name in self.named if name not in self.meeting]
        who = (
            f"{', '.join(missing)} must meet all of them" if self.named else "no controller meets all of them"
        )
        return f"Requirements: not passed, as {who}"

    def missed(self, controller: str) -> list[str]:
        """Return which requirements a controller misses, each with how often it is met and why not more."""
        parts = []
        for requirement in self.requirements:
            tallies = [tally for tally in self.of(controller, requirement) if not tally.is_met]
            several = len(self.of(controller, requirement)) > 1
            where = [
                (f"in {self.scenarios[tally.scenario]} " if several else "")
                + f"{tally.met} of {tally.runs} runs ({tally.why})"
                for tally in tallies
            ]
            if where:
                parts.append(f"{requirement.words} {requirement.limits}: {', '.join(where)}")
        return parts

    @property
    def lines(self) -> list[str]:
        """What the terminal prints: the verdict, who meets all, and what each of the others misses."""
        lines = [self.verdict]
        if self.meeting:
            lines.append(f"met by {', '.join(self.labels[name] for name in self.meeting)}")
        # Those that have to meet them are never left out.
        missing = sorted(
            (name for name in self.controllers if name not in self.meeting),
            key=lambda name: name not in self.named,
        )
        most = max(_NAMED, len(self.named))
        for name in missing[:most]:
            parts = self.missed(name)
            more = [f"and {len(parts) - _NAMED} more"] if len(parts) > _NAMED else []
            lines.append(f"missed by {self.labels[name]}: {'; '.join([*parts[:_NAMED], *more])}")
        if missing[most:]:
            lines.append(f"missed by {len(missing) - most} more")
        return lines


def requirement_findings(study: "Study", cases: Iterable[CaseResult]) -> RequirementFindings | None:
    """Return who meets what a study of one problem requires; None where it requires nothing.

    Reference points and the variants of sweeps are judged only where the study names them.

    Parameters
    ----------
    study : Study
        The study, of one problem.
    cases : iterable of CaseResult
        Its cases.
    """
    section = study.requirements
    everything = [*cases]
    if section is None or not (entries := [*section.required]) or not everything:
        return None
    ran = dict.fromkeys(case.scenario for case in everything)
    keys = dict.fromkeys(key for case in everything for key in case.metrics)
    requirements = tuple(
        _requirement(entry, section.share_of(entry.section), keys, tuple(ran)) for entry in entries
    )
    aside = set_aside(study) - {*section.controllers}
    runs: dict[tuple[str, str], list[CaseResult]] = {}
    for case in everything:
        runs.setdefault((case.controller, case.scenario), []).append(case)
    judged = [name for name in study.controllers if name not in aside]
    judged = [name for name in judged if name in section.controllers or any(name == ran for ran, _ in runs)]
    tallies = tuple(_tallies(judged, requirements, runs))
    labels = {name: study.controllers[name].label or name for name in judged}
    labels |= {case.controller: case.label for case in everything}
    labels = {name: _quoted(printable(label.strip(), LONGEST_LABEL)) for name, label in labels.items()}
    named = tuple(section.controllers)
    return RequirementFindings(requirements, named, tallies, labels, scenario_labels(study))


def _quoted(label: str) -> str:
    """Return a label among others, in quotes where it holds a comma itself."""
    return f'"{label}"' if "," in label else label


def _requirement(
    required: "Required", share: float, keys: Iterable[str], ran: tuple[str, ...]
) -> Requirement:
    metric, signal, section = required
    every = [*keys]
    short = ".".join(filter(None, (metric, signal)))
    key = next((key for key in every if split_key(key)[:2] == (metric, signal)), short)
    words = " of ".join(filter(None, (metric_name(key, every), printable(signal))))
    least = -math.inf if section.min is None else section.min
    most = math.inf if section.max is None else section.max
    unit = section.unit or split_key(key)[2]
    return Requirement(key, least, most, share, unit, tuple(section.scenarios) or ran, words)


def _tallies(
    controllers: Sequence[str],
    requirements: Sequence[Requirement],
    runs: dict[tuple[str, str], list[CaseResult]],
) -> Iterator[Tally]:
    for controller in controllers:
        for requirement in requirements:
            for scenario in requirement.scenarios:
                yield _tally(controller, scenario, requirement, runs.get((controller, scenario), []))


def _tally(controller: str, scenario: str, requirement: Requirement, cases: Sequence[CaseResult]) -> Tally:
    sound = [case for case in cases if not case.failed]
    values = [value for case in sound if not math.isnan(value := requirement.value(case))]
    met = sum(requirement.is_met(case) for case in sound)
    beyond = [value for value in values if not requirement.min <= value <= requirement.max]
    worst = max(
        beyond, key=lambda value: max(value - requirement.max, requirement.min - value), default=math.nan
    )
    failed = len(cases) - len(sound)
    return Tally(controller, scenario, requirement, len(cases), met, failed, len(sound) - len(values), worst)


def requirements_frame(problems: Iterable[tuple[str, "Study", Sequence[CaseResult]]]) -> "pd.DataFrame":
    """Return a row per problem, controller, requirement and scenario: see ``StudyResults.requirements``."""
    import pandas as pd

    columns = ["problem", "controller", "label", "metric", "min", "max", "unit", "scenario"]
    columns += ["runs", "met", "share", "needed", "is_met", "why"]
    rows = []
    for problem, study, cases in problems:
        findings = requirement_findings(study, cases)
        for tally in findings.tallies if findings else ():
            requirement = tally.requirement
            share = tally.met / tally.runs if tally.runs else math.nan
            label = findings.labels[tally.controller] if findings else ""
            row = [problem, tally.controller, label, requirement.key, requirement.min, requirement.max]
            row += [requirement.unit, tally.scenario, tally.runs, tally.met, share, requirement.share]
            rows.append([*row, tally.is_met, tally.why])
    return pd.DataFrame(rows, columns=columns)
