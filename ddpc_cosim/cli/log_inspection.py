"""What ``ddpc-cosim inspect`` prints of a log: the verdict first; tables on a terminal, lines elsewhere."""

from collections.abc import Iterator

from rich.console import Console
from rich.text import Text

from ddpc_cosim.cli.output import fitting, terminal_table
from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.files.texts import printable
from ddpc_cosim.inspection.logs import LogSummary

_MOST_ROWS, _LONGEST_NAME, _LONGEST_CELL = 20, 30, 10_000


def print_summary(console: Console, summary: LogSummary, *, every: bool) -> None:
    """Print what a log is good for on a terminal, long tables in part unless every row is wanted."""
    console.print(
        Text(printable(summary.verdict, _LONGEST_CELL), "bold green" if summary.good else "bold red")
    )
    for text in summary.reservations:
        console.print(Text.assemble(("but: ", "yellow"), printable(text, _LONGEST_CELL)))
    for text in summary.advice:
        console.print(Text.assemble(("next: ", "bold"), printable(text, _LONGEST_CELL)))
    facts = tuple(Row(name, (Cell(value),)) for name, value in summary.facts.items())
    headings = (Heading("", numeric=False), Heading("", numeric=False, wraps=True))
    console.print("", terminal_table(Table("", "", headings, facts, kind="facts")), "")
    for table in summary.tables:
        rows = table.rows if every else table.rows[:_MOST_ROWS]
        shown = Table(table.id, table.caption, table.headings, rows)
        rich, left_out = fitting(console, shown, _LONGEST_NAME)
        console.print(rich)
        if len(rows) < len(table.rows):
            console.print(f" and {len(table.rows) - len(rows)} more; --all shows them", highlight=False)
        if left_out:
            words = ", ".join(table.headings[i].words for i in left_out)
            console.print(f" not shown: {words}; in a wider window, and with --json", highlight=False)
        for note in table.notes:
            console.print(Text(note, "dim"))
        console.print()
    for note in summary.notes:
        console.print(Text(f"note: {printable(note, _LONGEST_CELL)}"))


def summary_lines(summary: LogSummary) -> Iterator[str]:
    """Yield the verdict, and one line per finding, fact and row, with tabs between the columns."""
    yield _line("good" if summary.good else "not good", summary.verdict)
    yield from (_line("but", text) for text in summary.reservations)
    yield from (_line("next", text) for text in summary.advice)
    yield from (_line(name, fact) for name, fact in summary.facts.items())
    for table in summary.tables:
        first, *headings = (heading.words for heading in table.headings)
        for row in table.rows:
            cells = (
                f"{words} {cell.text}" for words, cell in zip(headings, row.cells, strict=True) if cell.text
            )
            yield _line(first, row.header, *cells)
    yield from (_line("note", note) for note in summary.notes)


def _line(*cells: str) -> str:
    return "\t".join(printable(cell, _LONGEST_CELL) for cell in cells)
