"""One table, set for the terminal, a notebook and files."""

import math
import re

import pytest
from rich.console import Console

from ddpc_cosim.cli.output import fitting, terminal_table
from ddpc_cosim.files.tables import (
    Cell,
    Heading,
    Row,
    Table,
    own_rows,
    plain_table,
    table_text,
    text_headings,
)

HEADINGS = (
    *text_headings("name", "note"),
    Heading("mean error", "angle [deg]"),
    Heading("what", numeric=False, wraps=True),
)
ROWS = (
    Row("a", (Cell(""), Cell("1.0", 1.0, best=True), Cell("a sentence of some length"))),
    Row("b", (Cell(""), Cell("22.0", 22.0, failed=True), Cell("short"))),
    Row("and more", ()),
)
TABLE = Table("t", "A table", HEADINGS, ROWS)


def printed(table: Table, width: int = 80) -> list[str]:
    console = Console(width=width)
    with console.capture() as capture:
        console.print(terminal_table(table, ruled=True))
    return [line.strip() for line in capture.get().splitlines() if line.strip()]


def test_a_column_in_which_nothing_stands_is_left_out() -> None:
    lines = printed(TABLE)
    assert lines[0] == "A table"
    assert "mean error" in lines[1]
    assert lines[2].split() == ["name", "angle", "[deg]", "what"]
    assert lines[-3].split() == ["a", "1.0", "a", "sentence", "of", "some", "length"]
    assert lines[-1] == "and more"


def test_marks_are_styles() -> None:
    console = Console(width=80, force_terminal=True, color_system="standard")
    with console.capture() as capture:
        console.print(terminal_table(Table("", "", HEADINGS, ROWS, kind="facts")))
    assert re.search("\x1b\\[1m *1.0\x1b", capture.get())
    assert re.search("\x1b\\[31m *22.0\x1b", capture.get())
    assert "\x1b[1ma " in capture.get()  # of a table of facts the names


@pytest.mark.parametrize(("width", "left_out"), [(80, []), (30, []), (20, [3]), (16, [2, 3])])
def test_a_narrow_window_has_the_first_columns(width: int, left_out: list[int]) -> None:
    console = Console(width=width)
    table, others = fitting(console, TABLE, 10)
    assert others == left_out
    assert console.measure(table).maximum <= width


def test_nothing_of_a_text_acts_on_what_shows_it() -> None:
    hostile = Table("", "[red]c\x1b[31m", text_headings("<h>"), (Row("\x1b[2J[bold]x", ()),))
    assert not {"\x1b"} & {*"".join(printed(hostile))}
    assert "[bold]x" in "".join(printed(hostile))
    assert "&lt;h&gt;" in hostile.html
    assert "\x1b" not in hostile.html


def test_a_notebook_has_numbers_with_four_digits() -> None:
    table = plain_table("T", ("name", "value"), [("a", 1.23456789), ("b", math.nan), ("c", 3)])
    assert table.html == (
        "<table><caption>T</caption><tr><th>name</th><th>value</th></tr><tr><td>a</td><td>1.235</td></tr>"
        "<tr><td>b</td><td>\N{EN DASH}</td></tr><tr><td>c</td><td>3</td></tr></table>"
    )


def test_a_file_has_numbers_in_full_and_is_read_back() -> None:
    text = table_text(["a", "=b"], [[0.1 + 0.2, True], [math.nan, "x,\n'y'"], [-3, "+1"]])
    assert text == "a,'=b\n0.30000000000000004,true\n,\"x,\n'y'\"\n-3,+1\n"
    assert own_rows(text) == (["a", "'=b"], [["0.30000000000000004", "true"], ["", "x,\n'y'"], ["-3", "+1"]])
    with pytest.raises(ValueError, match="not enough values"):
        own_rows("")


def test_in_a_terminal_it_is_shown_in_columns_and_nothing_in_it_acts_there() -> None:
    table = plain_table("all", ["name", "value"], [["pid", 0.123456], ["\x1b[31mred", math.nan]])
    first, *lines = repr(table).splitlines()
    assert first == "all"
    assert [line.split()[1] for line in lines] == ["value", "0.1235", "\N{EN DASH}"]
    assert len({line.index(line.split()[1]) for line in lines[:2]}) == 1
    assert "\x1b" not in repr(table)
