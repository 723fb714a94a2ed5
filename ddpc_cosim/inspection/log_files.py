"""Files of logged data: which columns are inputs, outputs and disturbances; what the whole is good for."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.log_cells import encoding_of, headers_of, likely_times
from ddpc_cosim.files.logs import Log, LogFormat, read_log
from ddpc_cosim.inspection.columns import (
    ColumnFacts,
    SamplingFacts,
    column_facts,
    sampling_facts,
    whole_pieces,
)
from ddpc_cosim.inspection.logs import LogSummary, summarise
from ddpc_cosim.inspection.words import CERTAIN, Wording, is_reading, setpoint
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.spelling import did_you_mean

_HELD = 0.5
"""Share of rows that are as the row before: what is set is, what is measured with noise is not."""
_SHORTEST_PIECE = 5
_MOST_NOTED = 8


class _Guess(NamedTuple):
    """What a column is taken for, and why; empty: for neither."""

    role: str
    reason: str


def inspect_log(
    path: Path,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    disturbances: Sequence[str] = (),
    sampling_time: float | None = None,
) -> LogSummary:
    """Return what a file of logged data is good for.

    Parameters
    ----------
    path : Path
        A CSV or Parquet file.
    inputs, outputs, disturbances : sequence of str
        Its columns, by name; no inputs or no outputs: they are guessed by words, units and how they move.
    sampling_time : float, optional
        To what time between samples rows are averaged [s]; default: as they are.

    Raises
    ------
    DataError
        It cannot be read at all.
    ConfigError
        A name is not that of a column, or given for two roles; all of them at once.
    """
    format = LogFormat(time_column=time_column_of(path), resample="no" if sampling_time is None else "mean")
    log = read_log(path, sampling_time=sampling_time, format=format, held=inputs, lenient=True)
    given = {"input": inputs, "output": outputs, "disturbance": disturbances}
    if not len(log.values):
        raise DataError(f"{path.name}: has no rows; needed: a header and one row per sample")
    _require_columns(log, given)
    guesses = _guessed(log, given)
    order = [
        log.names.index(name)
        for role in given
        for name in (given[role] or [n for n, guess in guesses.items() if guess.role == role])
    ]
    if twice := dict.fromkeys(log.names[i] for i in order if log.names.count(log.names[i]) > 1):
        hint = "rename all but one, or leave them out"
        raise DataError([f'{path.name}: several columns are called "{name}"; {hint}' for name in twice])
    roles = {log.names[i]: _role_of(log.names[i], given, guesses) for i in order}
    rest = [i for i in range(len(log.names)) if i not in order]
    columns = [
        column_facts(log.names[i], log.units[i], roles.get(log.names[i], ""), log.values[:, i])
        for i in (*order, *rest)
    ]
    sampling = sampling_facts(log.time)
    if not np.isfinite(sampling.sampling_time):
        sampling = replace(sampling, sampling_time=sampling_time or np.nan)
    used = [column for column in columns if column.role and not column.empty]
    recording = _recording(log, used, sampling)
    return summarise(path.name, recording, columns, sampling, [*_notes(log, guesses)])


def time_column_of(path: Path) -> str | list[str]:
    """Return the header of the time, as columns are called so; of date and time both, empty where none is."""
    headers = headers_of(path, LogFormat(encoding=encoding_of(path)))
    titles = [headers[i] for i in likely_times(headers)]
    return titles if len(titles) > 1 else next(iter(titles), "")


def _require_columns(log: Log, given: Mapping[str, Sequence[str]]) -> None:
    faults, seen = [], dict[str, str]()
    for role, names in given.items():
        for name in names:
            if name not in log.names:
                faults.append(
                    f"--{role} {name}: {log.files[0]} has no such column; {did_you_mean(name, log.names)}"
                )
            elif name in seen:
                faults.append(f"--{role} {name}: it is given as --{seen[name]} already")
            else:
                seen[name] = role
    if faults:
        raise ConfigError(faults)


def _role_of(name: str, given: Mapping[str, Sequence[str]], guesses: Mapping[str, _Guess]) -> str:
    return next((role for role, names in given.items() if name in names), "") or guesses[name].role


def _guessed(log: Log, given: Mapping[str, Sequence[str]]) -> dict[str, _Guess]:
    """Return what columns without a role are taken for, where inputs or outputs are not given."""
    missing = {role for role in ("input", "output") if not given[role]}
    if not missing:
        return {}
    named = {name for names in given.values() for name in names}
    guesses = {
        name: _guess(Variable(name, unit=unit), log.values[:, i])
        for i, (name, unit) in enumerate(zip(log.names, log.units, strict=True))
        if name not in named
    }
    # Disturbances are guessed only where nothing is known at all: whoever names some names all.
    allowed = missing | ({"disturbance"} if not any(given.values()) else set())
    return {n: g if g.role in allowed else _Guess("", g.reason) for n, g in guesses.items()}


def _guess(variable: Variable, values: FloatArray) -> _Guess:
    wording = Wording(variable)
    known = values[np.isfinite(values)]
    if not len(known) or known.min() == known.max():
        return _Guess("", "it never moves")
    held = float(np.mean(np.diff(known) == 0.0)) if len(known) > 1 else 0.0
    stays = f"{100 * held:.0f} % of its rows are as the row before"
    if setpoint(wording):
        return _Guess("", "it is called a setpoint")
    points, reasons = wording.disturbance()
    if points >= CERTAIN:
        return _Guess("disturbance", " and ".join(reasons))
    if wording.says_driven or (wording.looks_driven and held > _HELD):
        return _Guess("input", "it is called, or has the unit of, what is driven")
    if is_reading(variable):
        return _Guess("output", "it is called what one reads")
    if variable.unit == "%":
        return _Guess("input", "it is in % and not called what one reads")
    if held > _HELD:
        return _Guess("input", stays)
    return _Guess("output", f"only {stays}")


def _notes(log: Log, guesses: Mapping[str, _Guess]) -> Iterator[str]:
    """Yield what to know of how a log was read, and of roles that were guessed."""
    yield from (f"{treatment.words}" for treatment in log.treatments)
    yield from log.faults
    if log.texts:
        yield f"columns that are not numbers are left out: {', '.join(log.texts)}"
    if not guesses:
        return
    for role in ("input", "output", "disturbance"):
        taken = [name for name, guess in guesses.items() if guess.role == role]
        if taken:
            because = "; ".join(f"{name}: {guesses[name].reason}" for name in taken[:_MOST_NOTED])
            more = f"; and {len(taken) - _MOST_NOTED} more" if len(taken) > _MOST_NOTED else ""
            yield f"guessed to be {role}s (--{role} says otherwise): {because}{more}"
    if neither := [name for name, guess in guesses.items() if not guess.role]:
        because = "; ".join(f"{name}: {guesses[name].reason}" for name in neither[:_MOST_NOTED])
        yield f"taken for neither: {because}"


def _recording(log: Log, columns: Sequence[ColumnFacts], sampling: SamplingFacts) -> Recording | None:
    """Return the rows in which no cell of a signal is missing; None where inputs or outputs are not there."""
    index = {
        role: [log.names.index(column.name) for column in columns if column.role == role]
        for role in ("input", "output", "disturbance")
    }
    if not index["input"] or not index["output"]:
        return None
    every = [i for of_role in index.values() for i in of_role]
    pieces = [
        piece
        for piece in whole_pieces(log.time, log.values[:, every], log.seams)
        if piece.stop - piece.start >= _SHORTEST_PIECE
    ]
    if not pieces:
        return None
    rows: NDArray[np.intp] | slice = np.concatenate([np.arange(p.start, p.stop) for p in pieces])
    if len(pieces) == 1:
        rows = pieces[0]  # a view: a long log is not copied
    ends = np.cumsum([piece.stop - piece.start for piece in pieces])[:-1]
    whole = log.values[rows]
    u, y, d = (whole[:, chosen] for chosen in index.values())
    period = sampling.sampling_time if np.isfinite(sampling.sampling_time) else 1.0
    return Recording(u, y, y, period, tuple(ends.tolist()), d)
