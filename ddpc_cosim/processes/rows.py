"""The rows of a run, in memory or in a file that outlives the process that fills it.

Time is implied. Besides its rows a file tells which call of a plant or controller the run is in: whoever
follows it knows how far the run is, whether it hangs, and where it was when its process died.
"""

import mmap
import os
import stat
import weakref
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import accumulate, pairwise, repeat
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import OK
from ddpc_cosim.errors import ControllerError
from ddpc_cosim.variables import FloatArray

# Rows begun, calls begun, bytes of texts, and the time of the call; then the call.
_ROWS, _CALLS, _TEXT_BYTES, _TIME = range(4)
_CALL = slice(32, 96)
_HEADER = 96
_TEXTS, _CHUNK = 1 << 16, 1 << 20
_NOTHING: FloatArray = np.empty(0)
_END = "\n"
PAIRS = ("band", "input_limits", "output_limits", "monitored_band")
"""The further tables of lower and upper values."""
_MOST_INFO, _LONGEST_NAME = 64, 400
_FAILED, _NOT_KEPT = "error", "(not kept: too many different statuses)"


class Call(NamedTuple):
    """What a run is in.

    Parameters
    ----------
    number : int
        How many calls have begun, and ended.
    who, name : str
        ``"plant"`` or ``"controller"``, and its method; empty between two calls.
    time : float
        Time of the run there [s]; NaN before it.
    """

    number: int
    who: str
    name: str
    time: float


class RowStore:
    """Arrays of all rows that a run can have, allocated before it.

    Parameters
    ----------
    samples : int
        Number of rows.
    outputs, measurements, inputs : int
        Number of columns.
    changed_inputs : int
        Number of inputs of which the plant may be given something else.
    more : mapping of str to int
        Columns of further tables, by name: known before the run, or filled row by row. Those in ``PAIRS``
        have lower and upper values side by side.
    path : Path, optional
        A file, made if there is none; who opens the same one has the same rows. Default: in memory.
    follow : bool
        Make the file, for another process to fill, and read it: :meth:`look`, :meth:`written`.

    Attributes
    ----------
    reference, y : array, shape (samples, outputs)
        In the outputs' units.
    measured : array, shape (samples, measurements)
        All measurements as the controller saw them.
    u : array, shape (samples, inputs)
        Inputs as held; NaN where the controller failed.
    applied : array, shape (samples, changed_inputs)
        What the plant was given instead.
    solve_time : array, shape (samples,)
        Wall-clock time of ``controller.step`` [s].
    more : dict of str to array, shape (samples, columns), or (samples, columns / 2, 2) of pairs
        The further tables.
    """

    def __init__(
        self,
        samples: int,
        outputs: int,
        measurements: int,
        inputs: int,
        path: Path | None = None,
        *,
        changed_inputs: int = 0,
        more: Mapping[str, int] = MappingProxyType({}),
        follow: bool = False,
    ) -> None:
        columns = (outputs, outputs, measurements, inputs, changed_inputs, 1, 1, *more.values())
        size = _HEADER + 8 * samples * sum(columns) + (_TEXTS if path else 0)
        # Whoever fills a file may cut it off, which would be a bus error in mapped memory.
        self._followed = _made(path, size) if path and follow else None
        if self._followed is not None:
            weakref.finalize(self, os.close, self._followed)
        mapped = path and not follow
        self._memory: Any = _mapped(path, size) if path and mapped else np.zeros(size, np.uint8).data
        head = memoryview(self._memory)[:_HEADER]
        self._numbers_of, self._times, self._call = head.cast("q"), head.cast("d"), head[_CALL]
        ends = [samples * count for count in accumulate(columns, initial=0)]
        numbers = np.frombuffer(self._memory, np.float64, ends[-1], _HEADER)
        tables = [
            numbers[start:end].reshape(samples, count)
            for count, (start, end) in zip(columns, pairwise(ends), strict=True)
        ]
        self.reference, self.y, self.measured, self.u, self.applied, solve_time, status, *further = tables
        self.more = {
            name: table.reshape(samples, -1, 2) if name in PAIRS else table
            for name, table in zip(more, further, strict=True)
        }
        self.solve_time: FloatArray = solve_time[:, 0]
        self._status = status[:, 0].view(np.int64)
        self._info_path = info_path(path) if path else None
        self._text_memory = memoryview(self._memory)[_HEADER + numbers.nbytes :]
        self._read_texts()

    def _read_texts(self) -> None:
        self._info = self._stored_info()
        written = bytes(self._text_memory[: self._numbers_of[_TEXT_BYTES]]).decode("utf-8", "replace")
        self._texts = {text: number for number, text in enumerate([OK, _FAILED, *written.split(_END)[:-1]])}

    def look(self, *, closely: bool = False) -> None:
        """Read from a file that is followed how far the run is; closely: all of it."""
        if self._followed is None:
            return
        memory = memoryview(self._memory)[: None if closely else _HEADER]
        os.lseek(self._followed, 0, os.SEEK_SET)
        while memory and (content := os.read(self._followed, min(len(memory), _CHUNK))):
            memory[: len(content)] = content
            memory = memory[len(content) :]
        if closely:
            self._read_texts()

    @property
    def count(self) -> int:
        """How many rows have been begun, whatever a faulty process has written over its memory."""
        return max(0, min(self._numbers_of[_ROWS], len(self.y)))

    @property
    def call(self) -> Call:
        """The call that the run is in."""
        who, _, name = bytes(self._call).rstrip(b"\0").decode("utf-8", "replace").partition(" ")
        return Call(self._numbers_of[_CALLS], who, name, self._times[_TIME])

    def announce(self, who: str, name: str, time: float, *, is_within: bool = False) -> None:
        """Note the call that begins; an empty one: that the last one has ended.

        One that is within another only gives it another name: how long it takes counts on.
        """
        self._call[:] = _call_as_bytes(who, name)
        self._times[_TIME] = time
        self._numbers_of[_CALLS] += not is_within

    def clear(self) -> None:
        """Have every row that will be begun say that its controller has not decided yet."""
        for table in (self.u, self.solve_time, self.applied):
            table.fill(np.nan)
        self._status.fill(self._texts[_FAILED])

    def begin(self, k: int, y: FloatArray, measured: FloatArray) -> None:
        """Begin row k."""
        self.y[k], self.measured[k] = y, measured
        self._numbers_of[_ROWS] = k + 1

    def complete(
        self,
        k: int,
        u: FloatArray,
        status: str,
        solve_time: float,
        applied: FloatArray = _NOTHING,
        info: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Complete row k with what the controller has decided and says of it, and what the plant is given.

        Raises
        ------
        ControllerError
            It has more to say than is kept: values of too many names.
        """
        for name, value in info.items():
            if name not in self._info:
                self._add_info(name)
            self._info[name][k] = value
        self.u[k], self._status[k], self.solve_time[k] = u, self._number_of(status), solve_time
        if self.applied.size:
            self.applied[k] = applied

    def take(self, begin: int, end: int, statuses: NDArray[np.uint32], words: Callable[[int], str]) -> None:
        """Complete rows that have been filled in: from ``begin`` up to and without ``end``.

        Their statuses are numbers that ``words`` gives the words of.
        """
        for status in dict.fromkeys(statuses.tolist()):
            self._status[begin:end][statuses == status] = self._number_of(words(status))
        self.solve_time[begin:end] = np.nan
        self._numbers_of[_ROWS] = end

    def written(self) -> dict[str, Any]:
        """Return the rows up to the last one that was begun, as a trace names them."""
        self.look(closely=True)
        n = self.count
        numbers = ("reference", "y", "measured", "u", "applied", "solve_time")
        tables = {name: getattr(self, name)[:n] for name in numbers}
        tables |= {name: table[:n] for name, table in self.more.items()}
        texts = {number: text for text, number in self._texts.items()}
        status = tuple(map(texts.get, self._status[:n].tolist(), repeat(_NOT_KEPT)))
        info = {name: values[:n] for name, values in self._info.items()}
        return {**tables, "status": status, **({"info": info} if info else {})}

    def _add_info(self, name: str) -> None:
        """Make room for values of a name, NaN until there are some."""
        if len(self._info) >= _MOST_INFO:
            raise ControllerError(f'info: "{name}" is one name too many; allowed: {_MOST_INFO} in a run')
        values: FloatArray = np.full(len(self.y), np.nan)
        if self._info_path is None:
            self._info[name] = values
        else:
            with self._info_path.open("ab") as file:
                file.write(name.encode()[:_LONGEST_NAME].ljust(_LONGEST_NAME, b"\0") + values.tobytes())
            self._info[name] = list(self._stored_info().values())[-1]

    def _stored_info(self) -> dict[str, FloatArray]:
        """Return the values by name that lie in the file beside the rows'."""
        if self._info_path is None or not self._info_path.exists():
            return {}
        samples = len(self.y)
        width = _LONGEST_NAME + 8 * samples
        if self._followed is not None:
            memory: Any = content_of(self._info_path, _MOST_INFO * width)
        else:
            size = self._info_path.stat().st_size
            memory = _mapped(self._info_path, size) if size >= width else b""
        starts = range(0, len(memory) - width + 1, width)
        names = [memory[i : i + _LONGEST_NAME].rstrip(b"\0").decode("utf-8", "replace") for i in starts]
        columns = [np.frombuffer(memory, np.float64, samples, i + _LONGEST_NAME) for i in starts]
        return dict(zip(names, columns, strict=True))

    def _number_of(self, status: str) -> int:
        """Return the number of a status, remembered in a file too as long as there is room for it."""
        if status in self._texts:
            return self._texts[status]
        self._texts[status] = len(self._texts)
        text = (status.replace(_END, " ") + _END).encode()
        begin = self._numbers_of[_TEXT_BYTES]
        end = begin + len(text)
        if end <= len(self._text_memory):
            self._text_memory[begin:end] = text
            self._numbers_of[_TEXT_BYTES] = end
        else:  # later ones would have other numbers there
            self._text_memory = self._text_memory[:0]
        return self._texts[status]


@lru_cache
def _call_as_bytes(who: str, name: str) -> bytes:
    length = _CALL.stop - _CALL.start
    return f"{who} {name}".strip().encode()[:length].ljust(length, b"\0")


def info_path(path: Path) -> Path:
    """Return the file of what a controller says of its steps, beside that of the rows."""
    return path.with_name(f"{path.name}-info")


def _made(path: Path, size: int) -> int:
    """Make a file of zeros and return its descriptor.

    They are written, so that there is room for them on the disk: where a file only has its length, whoever
    fills it by its mapped memory dies of a bus error when the disk is full.
    """
    made = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o600)
    zeros = memoryview(bytes(min(size, _CHUNK)))
    try:
        while size > 0:
            size -= os.write(made, zeros[:size])
    except OSError as error:
        os.close(made)
        raise OSError(error.errno, error.strerror, str(path)) from error
    return made


def _mapped(path: Path, size: int) -> mmap.mmap:
    with path.open("a+b") as file:
        file.truncate(size)
        return mmap.mmap(file.fileno(), size)


def content_of(path: Path, longest: int) -> bytes:
    """Return the content of a file that another process has made; links are not followed."""
    harmless = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | harmless), "rb") as file:
            return file.read(longest) if stat.S_ISREG(os.fstat(file.fileno()).st_mode) else b""
    except OSError:
        return b""
