"""Many cases in the memory of few: what they share is there once, and their numbers are in columns."""

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from sys import intern
from typing import Any, Protocol, Self

from ddpc_cosim.study.case_files import CaseResult

_OF_NUMBERS = ("metrics", "diagnostics", "drawn", "tasks")
"""The fields that are numbers by name."""
_LARGEST = (1 << 63) - 1


class Column(Protocol):
    """The values of some cases, by row."""

    def __getitem__(self, row: int, /) -> Any: ...


class ColumnCase(CaseResult):
    """A case whose values are in columns; it is equal to one of the same values that has its own."""

    __slots__ = ("_columns", "_row")
    _columns: dict[str, Column]
    _row: int

    @classmethod
    def at(cls, columns: dict[str, Column], row: int) -> Self:
        """Return the case of a row; there is a column of each field."""
        case = object.__new__(cls)
        object.__setattr__(case, "_columns", columns)
        object.__setattr__(case, "_row", row)
        return case

    @property  # type: ignore[misc]
    def __class__(self) -> type[CaseResult]:  # type: ignore[override]
        """What it is to whoever compares it, shows it, or replaces values: these are its own then."""
        return CaseResult

    def __reduce__(self) -> tuple[Any, ...]:
        return ColumnCase.at, (self._columns, self._row)


def _of_column(name: str) -> property:
    def value(case: ColumnCase) -> Any:
        column = case._columns[name]
        # Most are the same: to ask the column takes as long as all else.
        return column.value if type(column) is _Same else column[case._row]

    return property(value)


for _field in fields(CaseResult):
    setattr(ColumnCase, _field.name, _of_column(_field.name))


class Numbers(Mapping[str, float]):
    """Numbers by name, in a row of columns.

    Parameters
    ----------
    columns : mapping of str to Column
        The columns, by name.
    row : int
        The row.
    """

    __slots__ = ("_columns", "_row")

    def __init__(self, columns: Mapping[str, Column], row: int) -> None:
        self._columns, self._row = columns, row

    def __getitem__(self, name: str) -> float:
        number: float = self._columns[name][self._row]
        return number

    def get(self, name: str, default: Any = None) -> Any:
        """Return a number, which is asked for more than all else."""
        column = self._columns.get(name)
        return default if column is None else column[self._row]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        return repr(dict(self))


class _Same:
    """A column of one value."""

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value

    def __getitem__(self, row: int) -> Any:
        return self.value


class _Texts:
    """A column of texts of the same length, in one."""

    __slots__ = ("_length", "_text")

    def __init__(self, texts: Sequence[str]) -> None:
        self._text, self._length = "".join(texts), len(texts[0])

    def __getitem__(self, row: int) -> str:
        return self._text[row * self._length : (row + 1) * self._length]


class _Made:
    """A column of what is made of a row of columns when it is looked at."""

    __slots__ = ("_columns", "_make")

    def __init__(self, make: Any, columns: Sequence[Column]) -> None:
        self._make, self._columns = make, columns

    def __getitem__(self, row: int) -> Any:
        return self._make(*[column[row] for column in self._columns])


class _OfNumbers:
    """A column of numbers by name."""

    __slots__ = ("_columns",)

    def __init__(self, columns: Mapping[str, Column]) -> None:
        self._columns = columns

    def __getitem__(self, row: int) -> Numbers:
        return Numbers(self._columns, row)


def in_columns(cases: Iterable[CaseResult], folder: Path, **more: Sequence[Any]) -> list[CaseResult]:
    """Return cases in the same order, with their values in columns.

    Parameters
    ----------
    cases : iterable of CaseResult
        The cases, whatever their folders are.
    folder : Path
        Where their folders would be.
    **more : sequence
        A value for each case of what is kept with it: see :func:`kept_with`.
    """
    groups: dict[tuple[Any, ...], list[tuple[int, CaseResult]]] = {}
    for place, case in enumerate(cases):
        ends = tuple(len(output.ends) for output in case.tracking)
        names = map(tuple, (case.metrics, case.diagnostics, case.drawn))
        groups.setdefault((ends, *names), []).append((place, case))
    by_place: dict[int, CaseResult] = {}
    for alike in groups.values():
        columns = {
            field.name: _of_field(field.name, [getattr(case, field.name) for _, case in alike])
            for field in fields(CaseResult)
        }
        columns["folder"] = _Made(folder.joinpath, [columns["id"]])
        columns |= {name: _column([values[place] for place, _ in alike]) for name, values in more.items()}
        by_place |= {place: ColumnCase.at(columns, row) for row, (place, _) in enumerate(alike)}
    return [by_place[place] for place in range(len(by_place))]


def kept_with(case: CaseResult, name: str) -> Any:
    """Return what is kept with a case of :func:`in_columns`."""
    assert isinstance(case, ColumnCase)
    return case._columns[name][case._row]


def replaced(changes: Iterable[tuple[CaseResult, Mapping[str, Any]]]) -> Iterator[CaseResult]:
    """Yield cases with other values of some fields; what is in columns stays there, once for all of them.

    Parameters
    ----------
    changes : iterable of (CaseResult, mapping of str to any)
        Each case, and its values that change.
    """
    for columns, neighbours in groupby(changes, _columns_of):
        if columns is None:
            yield from (replace(case, **changed) for case, changed in neighbours)
            continue
        in_rows = ((case._row, changed) for case, changed in neighbours if isinstance(case, ColumnCase))
        rows, of_rows = zip(*in_rows, strict=True)
        changed = dict(zip(rows, of_rows, strict=True))
        every = range(max(rows) + 1)
        others = {
            name: _of_field(name, [changed.get(row, {}).get(name, columns[name][row]) for row in every])
            for name in dict.fromkeys(name for of_row in of_rows for name in of_row)
        }
        yield from map(partial(ColumnCase.at, columns | others), rows)


def _columns_of(change: tuple[CaseResult, Any]) -> dict[str, Column] | None:
    return change[0]._columns if isinstance(change[0], ColumnCase) else None


def _of_field(name: str, values: Sequence[Any]) -> Column:
    names = dict.fromkeys(map(tuple, values)) if name in _OF_NUMBERS else ()
    if len(names) != 1:
        return _column(values)
    # Other cases have the same names.
    columns = {intern(name): _column([value[name] for value in values]) for name in next(iter(names))}
    return _OfNumbers(columns)


def _column(values: Sequence[Any]) -> Column:
    first, kinds = values[0], set(map(type, values))
    if all(value is first for value in values):
        return _Same(first)
    kind = kinds.pop()
    if kinds:
        return tuple(values)
    if kind is float:
        numbers = array("d", values)
        content = numbers.tobytes()  # zeros have signs, and NaN is not equal to itself
        return _Same(first) if content == content[: numbers.itemsize] * len(values) else numbers
    if kind is int and all(abs(value) <= _LARGEST for value in values):
        return array("q", values)
    if kind is str and len(set(map(len, values))) == 1 and len(set(values)) > 1:
        return _Texts(values)
    if kind is tuple and all(len(value) == len(first) for value in values):
        return _Made(_tuple_of, [*map(_column, zip(*values, strict=True))])
    if is_dataclass(kind):
        parts = [[getattr(value, field.name) for value in values] for field in fields(kind)]
        return _Made(kind, [*map(_column, parts)])
    return _Same(first) if all(value == first for value in values) else tuple(values)


def _tuple_of(*values: Any) -> tuple[Any, ...]:
    return values
