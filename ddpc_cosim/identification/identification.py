"""What a study says of a plant that is identified from data: the logs, and how they become models."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from ddpc_cosim.codec import Prepared, Size
from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import DataError
from ddpc_cosim.files.csv_files import Column, split_unit
from ddpc_cosim.files.log_format import LogFormat
from ddpc_cosim.files.logs import read_log
from ddpc_cosim.settings import setting
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.spelling import did_you_mean

Method = Literal["auto", "arx", "armax", "subspace", "hammerstein-wiener", "koopman"]
Start = Literal["rest", "log-end"]
_NAMED = {
    "inputs": "plant.inputs in a study, --input of `ddpc-cosim identify`",
    "outputs": "plant.outputs, or --output",
}
_STILL = 1e-9
_DIGITS = 3


def _one_or_more(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification(LogFormat):
    """A plant identified from data: an ensemble of models, of which seed s plays number s.

    Number 0 is the model of all data; the others are those of data that might have been recorded as well, so
    that differences over seeds say how sure they are given that the plant itself is an estimate.

    Parameters
    ----------
    file : list of str
        Paths of the logs. A study file may say the path alone.
    disturbances : list of str
        Signals that act on the plant and that no controller drives.
    columns : dict of str to str
        Headers of columns that are not called as their signals.
    sampling_time : float or None
        Time between samples of the models [s]; none: that of the logs. The loop's is a multiple of it.
    method : str
        How models are found; ``"auto"``: as predicts best on a stretch that is held out.
    order : int
        Past samples, of ``"arx"`` and the like, or states; 0: by the data.
    members : int
        Number of models.
    noise : bool
        Whether the noise that the model leaves drives the plant, drawn anew for each seed.
    start : {"rest", "log-end"}
        Where runs start: at rest with the inputs as they were on average, or where the last log ends.
    """

    file: Annotated[list[str], Prepared(_one_or_more, {"type": "string"}), Size(1)] = setting(
        doc="CSV or Parquet files of logged data; one or several", file=True
    )
    disturbances: list[str] = setting(
        [], doc="signals in the files that act on the plant and that no controller drives"
    )
    columns: dict[str, str] = setting(
        {}, doc="headers of the columns in the files that are not called as their signals"
    )
    sampling_time: float | None = setting(
        None,
        doc="time between samples of the models, of which that of the loop is a multiple; none: that of the "
        "files",
        unit="s",
        above=0,
    )
    method: Method = setting("auto", doc="how models are found; auto: as predicts best on data held out")
    order: int = setting(0, low=0, high=200, doc="past samples, or states, of the models; 0: by the data")
    members: int = setting(
        30, low=1, high=1000, doc="number of models: seed s plays number s, and counts anew from there on"
    )
    noise: bool = setting(
        True, doc="whether the noise that the model leaves drives the plant, drawn anew for each seed"
    )
    start: Start = setting(
        "rest", doc="where runs start: at rest, the inputs at their averages, or where the last file ends"
    )


def identification_table(value: Any) -> Any:
    """Return the table that stands for a path, or a list of paths, of logs."""
    return {"file": value} if isinstance(value, str | list) else value


@dataclass(frozen=True, slots=True, eq=False)
class LoggedPlant:
    """What logs hold of a plant's signals.

    Parameters
    ----------
    recording : Recording
        The samples; ``measured`` are the outputs.
    inputs, disturbances, outputs : tuple of Variable
        The signals, with the units of their columns. They start and rest at their averages, or where the log
        ends, and are scaled by half of the range that they were recorded in.
    ranges : dict of str to (float, float)
        The smallest and the largest value of each.
    treatments : tuple of str
        What was done to the data.
    """

    recording: Recording
    inputs: tuple[Variable, ...]
    disturbances: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    ranges: dict[str, tuple[float, float]]
    treatments: tuple[str, ...]


def read_logged_plant(
    identification: Identification, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> LoggedPlant:
    """Read the logs of a plant.

    Parameters
    ----------
    identification : Identification
        The logs, with absolute paths.
    inputs, outputs : tuple of str
        Signals that are driven, and those that are controlled or measured.

    Raises
    ------
    DataError
        Signals that are not named or have no column, and all that is wrong with the files.
    """
    disturbances = tuple(identification.disturbances)
    if faults := _faults(identification, inputs, outputs):
        there = read_log(identification.file[0], format=identification, lenient=True)
        raise DataError([*faults, f"{there.files[0]} has the columns {', '.join(there.names)}"])
    names = (*inputs, *disturbances, *outputs)
    headers = [identification.columns.get(name, name) for name in names]
    log = read_log(
        identification.file,
        sampling_time=identification.sampling_time,
        format=identification,
        columns=[Column(None, header) for header in headers],
        held={split_unit(header)[0] for header in headers[: -len(outputs)]},
    )
    u, d, y = np.split(log.values, [len(inputs), len(inputs) + len(disturbances)], axis=1)
    still = [name for name, values in zip(inputs, u.T, strict=True) if np.ptp(values) == 0.0]
    if still:
        raise DataError(
            f"{', '.join(still)}: never moved, so the data do not say what it does; leave it out, or take "
            "files in which it moves"
        )
    ends = identification.start == "log-end"
    variables = [
        _variable(name, unit, values, ends=ends)
        for name, unit, values in zip(names, log.units, log.values.T, strict=True)
    ]
    return LoggedPlant(
        Recording(u, y, y, log.sampling_time, log.seams, d),
        tuple(variables[: len(inputs)]),
        tuple(variables[len(inputs) : -len(outputs)]),
        tuple(variables[-len(outputs) :]),
        {
            name: (float(values.min()), float(values.max()))
            for name, values in zip(names, log.values.T, strict=True)
        },
        tuple(treatment.words for treatment in log.treatments),
    )


def _faults(identification: Identification, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> list[str]:
    """Return what is wrong with the names of signals."""
    given = {"inputs": inputs, "outputs": outputs, "disturbances": tuple(identification.disturbances)}
    faults = [
        f"{kind}: none are named, and a log does not say which of its columns they are: {how}"
        for kind, how in _NAMED.items()
        if not given[kind]
    ]
    kinds: dict[str, str] = {}
    for kind, names in given.items():
        for name in names:
            if name in kinds:
                faults.append(f'"{name}" is among the {kinds[name]} and the {kind}; it can be one of them')
            kinds.setdefault(name, kind)
    faults += [
        f'columns: "{name}" is not among the inputs, outputs and disturbances; {did_you_mean(name, kinds)}'
        for name in identification.columns
        if name not in kinds
    ]
    return faults


def _variable(name: str, unit: str, values: FloatArray, *, ends: bool) -> Variable:
    mean, half = float(values.mean()), float(np.ptp(values)) / 2.0
    if half <= _STILL * max(abs(mean), 1.0):
        half = abs(mean) or 1.0
    start = float(values[-1]) if ends else _rounded(mean, half)
    return Variable(name, unit, start=start, nominal=float(f"{half:.{_DIGITS - 1}g}"))


def _rounded(value: float, size: float) -> float:
    """Return a value rounded to a thousandth of a size: that of an average has no more digits that matter."""
    return round(value, _DIGITS - int(np.floor(np.log10(size))))
