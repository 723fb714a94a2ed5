"""A log as what stands in for the plant of a case: its columns, found and read, with every fault at once."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ddpc_cosim.conditions import Conditions
from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import Column, find_column, split_unit
from ddpc_cosim.files.durations import shown
from ddpc_cosim.files.log_cells import headers_of
from ddpc_cosim.files.log_format import WHOLE, LogFormat
from ddpc_cosim.files.logs import read_log
from ddpc_cosim.loop.logged import LoggedSignals
from ddpc_cosim.loop.safe_calls import past_length_of
from ddpc_cosim.signals.signals import Band, Reference, Steps
from ddpc_cosim.study.case_runs import controller_of
from ddpc_cosim.study.cases import Bounded, Case, Replayed
from ddpc_cosim.study.file_format.sections import RecordingSection
from ddpc_cosim.variables import FloatArray, Variable, names
from fmu_plants.spelling import did_you_mean

NO_COLUMNS: Mapping[str, str] = MappingProxyType({})
_HINT = " (--column NAME=HEADER says which column a signal is)"
_FEWEST = 2
"""Samples that are answered."""


class _Wanted(NamedTuple):
    """A signal of a log: the headers that it may have, the first one that is there; some have to be there."""

    variable: Variable
    headers: tuple[str, ...]
    is_needed: bool = True


def prepare(
    log: Path,
    case: Case,
    *,
    recording: RecordingSection | None = None,
    columns: Mapping[str, str] = NO_COLUMNS,
    start: float | None = None,
) -> tuple[Case, tuple[str, ...]]:
    """Return a case in which a log stands in for the plant, and what was chosen.

    Parameters
    ----------
    log : Path
        The log.
    case : Case
        The case on the plant itself.
    recording : RecordingSection or None
        What the study says of its own files of logged data, which holds for this one too.
    columns : mapping of str to str
        Headers of columns that are not called as their signals.
    start : float or None
        Time of the first row in the study [s]; default: the log's own, or, where it has dates or no times,
        that of the study's first sample.

    Raises
    ------
    ConfigError, DataError
        All that is wrong with the log, or it does not fit the case.
    """
    wanted = _wanted(case)
    _check_columns(columns, wanted)
    logged_as = {**(recording.columns if recording else {}), **columns}
    format = LogFormat(**{**recording.format, "part": WHOLE}) if recording else LogFormat()
    known = {header for signal in wanted.values() for header in signal.headers} | {*logged_as.values()}
    located = _located(log, headers_of(log, format, known), wanted, logged_as)
    read = [Column(wanted[name].variable, header) for name, header in located.items()]
    held = [wanted[name].variable.name for name in names(case.inputs)]
    rows = read_log(log, sampling_time=case.sampling_time, format=format, columns=read, held=held)
    time, values = rows.time, rows.values
    if rows.seams:
        when = shown(float(time[rows.seams[0]]))
        raise DataError(f"{log}: rows are missing before t = {when}; replay each piece by itself")
    first = max(past_length_of(controller_of(case)), 1)
    if len(values) < first + _FEWEST:
        needed = f"needed: {first} as the past of {case.controller}, and {_FEWEST} to answer"
        raise DataError(f"{log}: {len(values)} rows are too few; {needed}")
    notes = list[str]()
    if start is None and (rows.begin is not None or not format.time_columns):
        start = case.start_time
        notes.append(f"the log's first row counts as t = {shown(start)} of the study")
    begin = float(time[0]) if start is None else start
    return _replaying(case, dict(zip(located, values.T, strict=True)), begin, first), tuple(notes)


def _wanted(case: Case) -> dict[str, _Wanted]:
    """Return the signals that a log may have, by the names that a result's ``signals.csv`` has."""
    wanted = {name: _Wanted(v, (name,)) for name, v in _by_name(case.inputs).items()}
    seen = (*case.outputs, *case.measurements, *_charged(case))
    wanted |= {name: _Wanted(v, (f"measured {name}", name)) for name, v in _by_name(seen).items()}
    known = [name for name, disturbance in case.disturbances.items() if disturbance.is_known]
    wanted |= {name: _Wanted(case.variable(name), (f"disturbance {name}", name)) for name in known}
    for variable in case.outputs:
        kinds = ("lower", "upper") if isinstance(case.reference[variable.name], Band) else ("reference",)
        wanted |= {(key := f"{kind} {variable.name}"): _Wanted(variable, (key,), False) for kind in kinds}
    for variable in (*case.inputs, *case.outputs):
        wanted |= {
            (key := f"{kind} {variable.name}"): _Wanted(variable, (key,), False) for kind in ("min", "max")
        }
    for name, price in case.prices.items():
        key = f"price {name}"
        wanted[key] = _Wanted(Variable(key, price.unit), (key,), False)
    return wanted


def _by_name(variables: tuple[Variable, ...]) -> dict[str, Variable]:
    return {variable.name: variable for variable in variables}


def _charged(case: Case) -> tuple[Variable, ...]:
    """Return the outputs that are paid for."""
    inputs = names((*case.inputs, *case.undriven))
    signals = dict.fromkeys(price.signal for price in case.prices.values())
    return tuple(case.variable(signal) for signal in signals if signal not in inputs)


def _check_columns(columns: Mapping[str, str], wanted: Mapping[str, _Wanted]) -> None:
    if unknown := [name for name in columns if name not in wanted]:
        what = "is not a signal of the study"
        raise ConfigError([f'column "{name}" {what}; {did_you_mean(name, wanted)}' for name in unknown])


def _located(
    log: Path, titles: Sequence[str], wanted: Mapping[str, _Wanted], logged_as: Mapping[str, str]
) -> dict[str, str]:
    """Return the header of each signal that the log has."""
    has = {split_unit(title)[0] for title in titles} | {*titles}
    located, faults = dict[str, str](), list[str]()
    for name, signal in wanted.items():
        given = logged_as.get(name)
        headers = signal.headers if given is None else (given,)
        header = next((header for header in headers if header in has), headers[-1])
        if header not in has and not signal.is_needed and given is None:
            continue
        try:
            find_column(str(log), titles, header, _HINT)
            located[name] = header
        except DataError as error:
            faults += error.faults
    if faults:
        raise DataError(faults)
    return located


def _replaying(case: Case, table: Mapping[str, FloatArray], begin: float, first: int) -> Case:
    """Return a case in which the signals of a log stand in for the plant, from one of its rows on."""
    count = len(next(iter(table.values())))
    time = tuple((begin + np.arange(count) * case.sampling_time).tolist())
    logged = {name: Steps(time, tuple(values.tolist())) for name, values in table.items()}
    known = {
        name: replace(disturbance, signal=logged[name], lag=0)
        for name, disturbance in case.disturbances.items()
        if disturbance.is_known
    }
    undriven = tuple(variable for variable in case.undriven if variable.name in known)
    known_variables = tuple(case.variable(name) for name in known)
    seen = (*case.outputs, *case.measurements)
    outputs = tuple(
        _by_name((*seen, *_charged(case), *(v for v in known_variables if v not in undriven))).values()
    )
    kinds = (case.inputs, case.outputs, case.measurements, known_variables, outputs)
    u, y, measured, d, values = (
        np.array([table[variable.name] for variable in kind]).reshape(len(kind), count).T for kind in kinds
    )
    for array in (u, y, measured, d):
        array.setflags(write=False)  # controllers are handed views of them
    recorded = Recording(u, y, measured, case.sampling_time, d=d)
    on_plant = replace(case, warm_up=0.0, warm_up_controller=None, continue_recording=False)
    return replace(
        on_plant,
        id="replay",
        undriven=undriven,
        read=tuple(variable for variable in outputs if variable not in seen),
        start_time=begin + first * case.sampling_time,
        duration=(count - 1 - first) * case.sampling_time,
        reference={name: _wish(name, wish, logged) for name, wish in case.reference.items()},
        bounds=case.bounds | _limits(case, logged),
        excitation=None,
        stabiliser=None,
        parameters={},
        spread=(),
        noise={},
        events=(),
        conditions=Conditions(inputs={variable.name: logged[variable.name] for variable in undriven}),
        disturbances=known,
        recorded_disturbances={},
        recording_start=None,
        prices={
            name: replace(price, price=logged.get(f"price {name}", price.price))
            for name, price in case.prices.items()
        },
        monitors={},
        communication_step=None,
        keeps_state=False,
        replayed=Replayed(LoggedSignals(recorded, outputs, values), first, on_plant),
    )


def _wish(name: str, wish: Reference | Band, logged: Mapping[str, Steps]) -> Reference | Band:
    """Return what is wanted of an output, as the log says or else the study."""
    if isinstance(wish, Band):
        edges = {side: logged.get(f"{side} {name}", getattr(wish, side)) for side in ("lower", "upper")}
        return replace(wish, **edges)
    return logged.get(f"reference {name}", wish)


def _limits(case: Case, logged: Mapping[str, Steps]) -> Bounded:
    """Return the limits that the log has."""
    limits = Bounded()
    for variable in (*case.inputs, *case.outputs):
        sides = [logged.get(f"{side} {variable.name}") for side in ("min", "max")]
        if any(sides):
            given = case.bounds.get(variable.name, (variable.min, variable.max))
            low, high = (side or limit for side, limit in zip(sides, given, strict=True))
            limits[variable.name] = (low, high)
    return limits
