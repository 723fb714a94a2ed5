"""Known disturbances: what acts on a plant besides its inputs and is measured, and what is known ahead."""

from dataclasses import dataclass
from typing import Annotated, Literal

from ddpc_cosim.codec import Section, Size
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.settings import setting
from ddpc_cosim.signals import InputSignal, Reference

Knowledge = Literal["unknown", "measured", "low", "medium", "high", "perfect"]
"""What is known: nothing; what is measured now; a forecast with low, medium or high errors; all."""


@dataclass(frozen=True, slots=True)
class ForecastFile(Section):
    """Forecasts as they were issued: a CSV file with a row for each time of issue.

    Parameters
    ----------
    file : str
        Its path. The first column, or ``time_column``, is the time of issue; each other one is a lead time in
        its header, such as ``0 h``, ``1 h``, ``2 h``.
    time_column : str
        Header of the time of issue, in s or the unit it has.
    unit : str
        Unit of the values; empty: that of the disturbance.
    """

    file: str = setting(doc="path of a CSV file, relative to the study file", file=True)
    time_column: Annotated[str, Size(1)] = setting("time", doc="header of the time of issue")
    unit: str = setting("", doc="unit of the values; empty: that of the disturbance")


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownDisturbance(Section):
    """An input of the plant that no controller drives, or a measured output, of which controllers know.

    Parameters
    ----------
    signal : Reference, optional
        The input over time; default: that among the inputs of the conditions. Of a measured output what it
        will be, which forecasts are made from.
    known : {"unknown", "measured", "low", "medium", "high", "perfect"}
        What controllers know: nothing; what is measured now, which a forecast holds; forecasts with errors of
        a size; or forecasts without.
    lag : int
        By how many samples it is measured late: 1 is the value of the interval before.
    forecast : ForecastFile, optional
        Forecasts as they were issued, in place of what ``known`` says of them.
    """

    signal: InputSignal | None = setting(None, doc="its course; none: that of the scenario's inputs")
    known: Knowledge = setting(
        "measured", doc="what controllers know of it: what is measured, or forecasts with errors of that size"
    )
    lag: int = setting(0, low=0, doc="samples by which it is measured late")
    forecast: ForecastFile | None = setting(None, doc="forecasts as they were issued")

    def __post_init__(self) -> None:
        if not (self.signal is None or isinstance(self.signal, Reference)):
            raise ConfigError(f"disturbance: signal = {self.signal!r}; needed: a signal of time")
        if self.forecast is not None and self.known in ("unknown", "perfect"):
            raise ConfigError(f'disturbance: a file of forecasts does not go with known = "{self.known}"')
