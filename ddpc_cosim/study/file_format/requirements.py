"""What is required of controllers: the table ``requirements`` of a study file, with a key for each metric."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from ddpc_cosim.codec import DeclaredField, Section, declared_fields
from ddpc_cosim.errors import Place
from ddpc_cosim.metrics import all_metrics
from ddpc_cosim.responses import Actuation, Response
from ddpc_cosim.settings import SettingInfo, setting
from fmu_plants.spelling import did_you_mean

REQUIREMENTS = "requirements"
"""The key of the table."""
_OWN = ("controllers", "share")
_LIMITS = "limits"


@dataclass(frozen=True, slots=True, kw_only=True)
class RequirementSection(Section):
    """Between what a metric has to be, both ends included."""

    min: float | None = setting(None, doc="the least that the metric may be; none: any")
    max: float | None = setting(None, doc="the most that it may be; none: any")
    share: float | None = setting(
        None, doc="on how many of the seeds it has to be so; none: the share of the table", low=0, high=1
    )
    unit: str = setting("", doc="unit of `min` and `max`; empty: the one that metrics.csv has")
    scenarios: list[str] = setting([], doc="scenarios in which it is required; empty: all")

    @classmethod
    def hint(cls, key: str) -> str:
        """Return what an unknown key probably stands for."""
        meant = did_you_mean(key, declared_fields(cls))
        return f"{meant}; the name of a signal that has dots stands in quotes"

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield that nothing is required, or nothing can meet it."""
        if self.min is None and self.max is None and not self.has_faults:
            yield "", "needs min or max"
        if self.min is not None and self.max is not None and self.min > self.max:
            yield "", f"min ({self.min:g}) is above max ({self.max:g})"


class Required(NamedTuple):
    """What is required of a metric.

    Parameters
    ----------
    metric, signal : str
        The metric, and the signal that it is of; empty for one of the whole run.
    section : RequirementSection
        What it has to be.
    """

    metric: str
    signal: str
    section: RequirementSection

    @property
    def place(self) -> Place:
        """Where a study says it."""
        return (REQUIREMENTS, self.metric, *filter(None, [self.signal]))


@dataclass(frozen=True, slots=True, kw_only=True)
class RequirementsSection(Section):
    """What controllers have to be: a table for each metric, `overshoot.angle = { max = 5.0 }`."""

    controllers: list[str] = setting(
        [], doc="the controllers that have to meet all of it; empty: one of those that compete has to"
    )
    share: float = setting(1.0, doc="on how many of the seeds a requirement has to be met", low=0, high=1)
    limits: dict[str, Any] = setting({}, doc="what is required, by metric", key=None)

    @classmethod
    def more_fields(cls) -> Mapping[str, DeclaredField]:
        """Return a field for each metric that is installed: a table, or one for each signal that it is of."""
        fields = {}
        for name, metric in all_metrics().items():
            if name not in _OWN:
                of_signal = issubclass(metric.of, Response | Actuation)
                hint: Any = dict[str, RequirementSection] if of_signal else RequirementSection | None
                info = SettingInfo(metric.description or metric.label)
                default = dict if of_signal else _none
                fields[name] = DeclaredField(name, hint, info, False, default, within=_LIMITS)
        return fields

    @classmethod
    def hint(cls, key: str) -> str:
        """Return what an unknown key probably stands for."""
        metric, dot, signal = key.partition(".")
        if dot and metric in declared_fields(cls):
            return f"{metric} and the signal are two keys: {metric}.{signal}, without quotes around both"
        return did_you_mean(key, declared_fields(cls))

    @property
    def required(self) -> Iterator[Required]:
        """All that is required, in the order of the metrics."""
        for metric, limits in self.limits.items():
            by_signal = limits if isinstance(limits, Mapping) else {"": limits}
            for signal, section in by_signal.items():
                yield Required(metric, signal, section)

    def share_of(self, section: RequirementSection) -> float:
        """Return on how many of the seeds one has to be met, as a share."""
        return self.share if section.share is None else section.share


def _none() -> None:
    return None


def by_metric(requirements: Mapping[str, Any]) -> dict[str, Any]:
    """Return requirements as a file says them: ``"overshoot.angle"`` stands below ``overshoot``."""
    tables: dict[str, Any] = {}
    for key, value in requirements.items():
        metric, dot, signal = key.partition(".")
        said, more = tables.get(metric), {signal: value} if dot else value
        tables[metric] = more
        if isinstance(said, Mapping) and isinstance(more, Mapping):
            tables[metric] = {**said, **more}
    return tables


def with_requirements(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return requirements with those that another file says: of a metric each signal is replaced alone."""
    tables = dict(base)
    for key, value in changes.items():
        both = base.get(key), value
        is_by_signal = all(
            isinstance(table, Mapping) and any(isinstance(entry, Mapping) for entry in table.values())
            for table in both
        )
        tables[key] = {**base[key], **value} if is_by_signal else value
    return tables
