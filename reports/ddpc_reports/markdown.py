"""The page as GitHub Markdown: the same answer, tables and statements, in the same order, without figures."""

import html
import re
from collections.abc import Iterator, Sequence
from typing import Any

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Table
from ddpc_cosim.files.texts import printable
from ddpc_reports.sections import StudyPart, gather, one_by_one

_TAG = re.compile(r"<[^>]*>")
_MARKS = {"<b>": "**", "</b>": "**", "<i>": "*", "</i>": "*"}
_SPECIAL = re.compile(r"[\\`*_{}\[\]<>|~#$&]|(?<=:)//|(?<=www)\.")
"""What Markdown, its tables, formulas and links, or HTML in it would act on."""
_LEADING = re.compile(r"^(\d*)([-+=.)])")
"""What would begin a list, a rule or a heading."""


def markdown(results: Sequence[StudyResults]) -> str:
    """Return the report as Markdown.

    Raises
    ------
    ValueError
        There are no results at all.
    """
    gathered = gather(results)
    return (
        "\n".join([f"# {_text(gathered.title)}", *(line for part in gathered.parts for line in _part(part))])
        + "\n"
    )


def _part(part: StudyPart) -> Iterator[str]:
    yield ""
    yield from (f"**{_text(line)}.**\n" for line in part.warnings)
    if part.answer:
        yield from (_line(part.answer), "")
    yield from (f"{_text(line)}.\n" for line in part.remarks)
    yield "; ".join(f"{_text(name)}: {_text(value)}" for name, value in part.facts.items())
    if part.comment:
        yield from ("", _line(part.comment))
    yield from _blocks(part.first)
    for section in part.sections:
        yield from ("", f"### {_text(section.title)}")
        yield from _blocks(section.blocks)
    for about in filter(None, (part.summary, part.source and f"After {part.source}.")):
        yield from ("", _line(about))


def _blocks(blocks: Sequence[tuple[str, Any]]) -> Iterator[str]:
    for kind, content in one_by_one(blocks):
        if kind == "baseline":  # what the reader of a page chooses from
            continue
        yield ""
        if kind == "table":
            yield from _table(content)
        elif kind == "figure":
            figure, _ = content
            yield f"*A figure of the HTML report.* {_text(figure.caption)}"
        elif kind == "condition":
            yield f"#### {_text(content)}"
        elif kind == "statements":
            yield from (f"- **{_text(statement.topic)}**: {_text(statement.text)}" for statement in content)
        elif kind == "notes":
            yield from (f"- {_line(note)}" for note in content)
        else:
            yield _line(content)


def _table(table: Table) -> Iterator[str]:
    yield from (f"**{_text(table.caption)}**", "")
    yield _row([_text(heading.words) for heading in table.headings])
    yield _row(["--:" if heading.numeric else "---" for heading in table.headings])
    for group, rows in table.groups.items():
        if group:
            yield _row([f"**{_text(group)}**", *[""] * (len(table.headings) - 1)])
        yield from (_row([_text(row.header), *map(_cell, row.cells)]) for row in rows)
    yield from (f"\n{_line(note)}" for note in table.notes)


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(cell: Cell) -> str:
    texts = [_text(text).strip() for text in (cell.text, cell.detail, cell.failures) if text.strip()]
    if cell.best and texts:
        texts[0] = f"**{texts[0]}**"
    return "; ".join(texts)


def _line(text: str) -> str:
    """Return a text that begins a line, and begins nothing else."""
    return _LEADING.sub(r"\1\\\2", _text(text))


def _text(text: str) -> str:
    """Return a text on which Markdown does not act; of a sentence of the page its emphasis is left."""
    if not isinstance(text, Markup):
        return _plain(text)
    marks = [_MARKS.get(tag, "") for tag in _TAG.findall(text)] + [""]
    plain = [_plain(html.unescape(piece)) for piece in _TAG.split(str(text))]
    return "".join(piece + mark for piece, mark in zip(plain, marks, strict=True)).strip()


def _plain(text: str) -> str:
    blanks = re.sub(r"[\s\u2007\u2008]+", " ", text)
    return _SPECIAL.sub(r"\\\g<0>", printable(blanks))
