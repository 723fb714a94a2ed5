"""The rankings of the first screen as LaTeX, for papers: one table for each scenario, with booktabs."""

import re
from collections.abc import Iterator, Sequence

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Table
from ddpc_cosim.files.texts import printable
from ddpc_reports.comparison import conditions, on_one_page
from ddpc_reports.tables.ranking import ranking_table

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "\N{DEGREE SIGN}": r"$^\circ$",
    "\N{MIDDLE DOT}": r"$\cdot$",
    "\N{MICRO SIGN}": r"$\mu$",
    "\N{EN DASH}": "--",
    "\N{MINUS SIGN}": "$-$",
    "\N{MULTIPLICATION SIGN}": r"$\times$",
    "\N{PLUS-MINUS SIGN}": r"$\pm$",
    "\N{SUPERSCRIPT TWO}": "$^2$",
    "\N{SUPERSCRIPT THREE}": "$^3$",
    "\N{NO-BREAK SPACE}": "~",
    "\N{NARROW NO-BREAK SPACE}": r"\,",
    "\N{HORIZONTAL ELLIPSIS}": r"\ldots{}",
} | {sign: f"\\{sign}" for sign in "&%$#_{}"}
_SIGNS = re.compile("|".join(map(re.escape, _SPECIAL)))


def latex(results: Sequence[StudyResults]) -> str:
    """Return the rankings of all scenarios as tables of LaTeX, which need the package booktabs.

    Raises
    ------
    ValueError
        There are no results at all.
    """
    if not results:
        raise ValueError("there are no results to report")
    lines = ["% needs \\usepackage{booktabs}"]
    for problem in (problem for single in on_one_page(results) for problem in single.problems()):
        seen = conditions(problem)
        for condition in seen:
            of = [problem.study.title or problem.study.name, *[condition.label] * (len(seen) > 1)]
            table = ranking_table(condition, condition.standings, "")
            lines += ["", *_table(table, f"{': '.join(of)}. {table.caption}.")]
    return "\n".join(lines) + "\n"


def _table(table: Table, caption: str) -> Iterator[str]:
    aligned = "".join("r" if heading.numeric else "l" for heading in table.headings)
    yield "\\begin{table}"
    yield f"  \\caption{{{_text(caption)}}}"
    yield "  \\centering"
    yield f"  \\begin{{tabular}}{{{aligned}}}"
    yield "    \\toprule"
    yield _row(map(_head, table.headings))
    yield "    \\midrule"
    yield from (_row([_text(row.header), *map(_cell, row.cells)]) for row in table.rows)
    yield "    \\bottomrule"
    yield "  \\end{tabular}"
    yield "\\end{table}"


def _row(cells: "Sequence[str] | map[str]") -> str:
    return f"    {' & '.join(cells)} \\\\"


def _head(heading: Heading) -> str:
    return _text(heading.words)


def _cell(cell: Cell) -> str:
    text = " ".join(_text(part) for part in (cell.text, cell.detail) if part)
    return f"\\textbf{{{text}}}" if cell.best and text else text


def _text(text: str) -> str:
    """Return a text on which LaTeX does not act."""
    plain = printable(re.sub(r"[\n\t\u2007\u2008]+", " ", text))
    return _SIGNS.sub(lambda sign: _SPECIAL[sign[0]], plain)
