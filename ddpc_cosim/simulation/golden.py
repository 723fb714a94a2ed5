"""Comparing a simulation with a golden file: what is compared, at which times, within which tolerance.

A value agrees if it differs by at most ``rel`` times the range of its signal in the golden file, plus a floor
for signals that are constant there and for rounding: 1e-9 of the signal's largest magnitude, plus 1e-12.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.csv_files import Column, CSVFile, plain_cells, read_table, split_unit
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.spelling import did_you_mean

TIME, OUTCOME = "time", "outcome"
_RELATIVE_FLOOR, _FLOOR = 1e-9, 1e-12
_EVEN = 1e-6
_MOST_LISTED = 8


class Difference(NamedTuple):
    """What a comparison came to: whether all values agree, and in words the worst of them."""

    agrees: bool
    words: str


class Golden:
    """The columns of a golden file that can be compared, in the units of their signals.

    Parameters
    ----------
    file : CSVFile
        A column ``time`` and one for each signal, with its unit if that is not the signal's own.
    known : mapping of str to Variable
        What will be recorded, by name.
    shapes : mapping of str to tuple of int
        The sizes of arrays by name.
    others : mapping of str to str
        The plant's other variables, and why they are not recorded.

    Attributes
    ----------
    time : array, shape (T,)
        Its times [s].
    notes : list of str
        What is in it and not compared.

    Raises
    ------
    ConfigError, DataError
        It cannot be compared, and why; all faults at once.
    """

    def __init__(
        self,
        file: CSVFile,
        known: Mapping[str, Variable],
        shapes: Mapping[str, tuple[int, ...]],
        others: Mapping[str, str],
    ) -> None:
        self.path = file.path
        file = plain_cells(file, shapes)
        given = [split_unit(header)[0] for header in file.header]
        faults = []
        if OUTCOME in given and OUTCOME not in known:
            faults.append(f"{file.path}: it has a column {OUTCOME}: it is that of a run that ended early")
        if TIME not in given:
            faults.append(f'{file.path}: no column "{TIME}"; {did_you_mean(TIME, given)}')
        signals = [name for name in given if name not in (TIME, OUTCOME)]
        faults += [
            f'{file.path}: no variable "{name}"; {did_you_mean(name, known)}'
            for name in signals
            if name not in known and name not in others
        ]
        self.names = [name for name in signals if name in known]
        if not self.names and not faults:
            columns, recorded = (", ".join(some) or "none" for some in (signals, known))
            faults.append(f"{file.path}: no column in common: it has {columns}; recorded are {recorded}")
        if faults:
            raise ConfigError(faults)
        left = [f"{name} ({others[name]})" for name in signals if name not in known]
        self.notes = [f"not compared: {', '.join(left)}"] if left else []
        self.time, self.values = read_table(file, [Column(known[name], name) for name in self.names], TIME)
        self._rows = np.empty(0, dtype=np.intp)

    @property
    def step(self) -> float | None:
        """Time between its rows [s]; None where that is not one and the same."""
        if len(self.time) < 2:
            return None
        step = float((self.time[-1] - self.time[0]) / (len(self.time) - 1))
        return step if np.abs(np.diff(self.time) - step).max() <= _EVEN * step else None

    def check_times(self, start: float, step: float, count: int) -> None:
        """Find the samples of a run, ``count`` steps from its start on [s], at which there are golden values.

        Raises
        ------
        ConfigError
            It does not cover the run, or has times between two samples: nothing is interpolated.
        """
        end, slack = start + count * step, _EVEN * step
        first, last = float(self.time[0]), float(self.time[-1])
        if abs(first - start) > slack or abs(last - end) > slack:
            raise ConfigError(
                f"{self.path}: its times, {first:g} s to {last:g} s, are not those of the run, {start:g} s "
                f"to {end:g} s; choose start = {first:g} and stop = {last:g}"
            )
        self._rows = np.rint((self.time - start) / step).astype(np.intp)
        between = self.time[np.abs(self.time - (start + self._rows * step)) > slack]
        if between.size:
            listed = ", ".join(f"{time:.9g}" for time in between[:_MOST_LISTED])
            more = f" and {between.size - _MOST_LISTED} more" if between.size > _MOST_LISTED else ""
            raise ConfigError(
                f"{self.path}: {between.size} of its {len(self.time)} times are between two samples of the "
                f"run, every {step:g} s: {listed}{more} s; choose another step"
            )

    def compare(self, recorded: Mapping[str, FloatArray], rel: float, ended: str) -> Difference:
        """Compare a run with the golden values.

        Parameters
        ----------
        recorded : mapping of str to array, shape (K,)
            The samples of a run whose times were checked, by the variables' names, in their units.
        rel : float
            Allowed difference, relative to the range of each signal in the golden file.
        ended : str
            How the run ended, in words.
        """
        label, columns = self.path.name, np.column_stack([recorded[name] for name in self.names])
        if not (self._rows < len(columns)).all():
            last = f"{self.time[-1]:g} s"
            return Difference(
                False, f"{label}: differs: the run ended before its last time, {last} ({ended})"
            )
        result = columns[self._rows]
        spans, sizes = np.ptp(self.values, axis=0), np.abs(self.values).max(axis=0)
        allowed = rel * spans + _RELATIVE_FLOOR * sizes + _FLOOR
        differences = np.abs(result - self.values)
        wrong = ~(differences <= allowed)  # which NaN is, too
        row, column = np.unravel_index(
            np.argmax(np.nan_to_num(differences / allowed, nan=np.inf)), wrong.shape
        )
        name, cell = self.names[column], (row, column)
        worst = (
            f"{name} at t = {self.time[row]:.9g} s is {result[cell]:.9g}, golden {self.values[cell]:.9g}: "
            f"difference {differences[cell]:.3g}, allowed {allowed[column]:.3g}"
        )
        if not wrong.any():
            samples = f"{len(self.time)} of {len(columns)} samples"
            signals = ", ".join(self._some(self.names))
            if not differences[cell]:
                return Difference(True, f"{label}: equal to the last bit at {samples}: {signals}")
            return Difference(True, f"{label}: agrees at {samples}: {signals}; the worst: {worst}")
        signals = ", ".join(
            self._some([n for n, bad in zip(self.names, wrong.any(axis=0), strict=True) if bad])
        )
        return Difference(
            False, f"{label}: differs: {worst} ({wrong.sum()} of {wrong.size} values, in {signals})"
        )

    @staticmethod
    def _some(listed: Sequence[str]) -> list[str]:
        more = len(listed) - _MOST_LISTED
        return [*listed[:_MOST_LISTED], *([f"{more} more"] if more > 0 else [])]
