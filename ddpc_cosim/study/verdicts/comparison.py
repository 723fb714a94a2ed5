"""A comparison of controllers with one of them as a DataFrame that prints what is read first."""

from typing import Any, ClassVar

import pandas as pd

from ddpc_cosim.files.tables import Table, plain_table

_FIRST = ("problem", "controller", "median", "difference", "difference_low", "difference_high", "verdict")
_HEADINGS = {"difference_low": "from (95 %)", "difference_high": "to"}


class Comparison(pd.DataFrame):
    """The table of :meth:`StudyResults.compare`, which prints difference, interval and verdict.

    Whatever is made of it, such as by choosing columns, is a plain DataFrame.
    """

    title: str
    _metadata: ClassVar = ["title"]

    @classmethod
    def of(cls, table: pd.DataFrame, title: str) -> "Comparison":
        """Return a table, and what it is of."""
        comparison = cls(table)
        comparison.title = title
        return comparison

    @property
    def _constructor(self) -> Any:
        return pd.DataFrame

    def _table(self) -> Table:
        is_flat = self["problem"].nunique() < 2
        columns = [name for name in _FIRST if not (is_flat and name == "problem")]
        rows = pd.DataFrame(self)[columns].itertuples(index=False, name=None)
        return plain_table(self.title, [_HEADINGS.get(name, name) for name in columns], rows)

    def __repr__(self) -> str:
        more = [str(column) for column in self.columns if column not in _FIRST]
        return f"{self._table().text}\nmore columns: {', '.join(more)}"

    def _repr_html_(self) -> str:
        return self._table().html
