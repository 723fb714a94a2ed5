"""Reports: one self-contained HTML page from the results of one or several studies.

Everything heavy is imported when a report is written, so that finding this plug-in costs nothing.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ddpc_cosim import LogSummary, Picture, Replay, Simulation, StudyResults, Trace
    from ddpc_cosim.files.tables import Table

__all__ = [
    "Pictures",
    "write_csv",
    "write_differences",
    "write_json",
    "write_latex",
    "write_log",
    "write_markdown",
    "write_replay",
    "write_report",
    "write_simulation",
]


def write_report(results: "Sequence[StudyResults]", path: Path) -> Path:
    """Write one HTML page about the results of one or several studies.

    The page needs no other file and no network: style, figures, data and script are in it. The same results
    give the same bytes.

    Parameters
    ----------
    results : sequence of StudyResults
        One section of the page for each, in this order.
    path : Path
        The file to write; missing folders are made, an existing file is replaced as a whole.

    Returns
    -------
    path : Path
        The file written.

    Raises
    ------
    ValueError
        There are no results at all.
    OSError
        The file cannot be written; an older one is kept.

    Warns
    -----
    CosimWarning
        A part of the page fails: a sentence in its place says why.
    """
    from ddpc_reports.page import render_page

    return _written(render_page(results), path)


def write_csv(results: "Sequence[StudyResults]", path: Path) -> Path:
    """Write one tidy table as CSV: a row for each metric of a controller in a scenario.

    Parameters and errors are those of :func:`write_report`; ``docs/report-formats.md`` has the columns.
    """
    from ddpc_reports.tidy import tidy_table

    return _written(tidy_table(results), path)


def write_latex(results: "Sequence[StudyResults]", path: Path) -> Path:
    """Write the rankings of all scenarios as LaTeX, a table for each.

    Parameters and errors are those of :func:`write_report`.
    """
    from ddpc_reports.latex import latex

    return _written(latex(results), path)


def write_markdown(results: "Sequence[StudyResults]", path: Path) -> Path:
    """Write what the page says as GitHub Markdown, without its figures.

    Parameters, errors and warnings are those of :func:`write_report`.
    """
    from ddpc_reports.markdown import markdown

    return _written(markdown(results), path)


def write_json(results: "Sequence[StudyResults]", path: Path) -> Path:
    """Write what the page says as JSON: answer, tables, rankings, statistics, and where they come from.

    Parameters, errors and warnings are those of :func:`write_report`; keys: ``docs/report-formats.md``.
    """
    from ddpc_reports.data import json_text

    return _written(json_text(results), path)


def _written(text: str, path: Path) -> Path:
    from ddpc_cosim.plugins import write_atomically

    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode("utf-8", "backslashreplace"))
    return path


def write_differences(
    before: "StudyResults", after: "StudyResults", verdict: str, lines: "Sequence[str]", path: Path
) -> Path:
    """Write one HTML page about what changed from one run of a study to another.

    Parameters
    ----------
    before, after : StudyResults
        The results of both.
    verdict : str
        How many of their cases agree.
    lines : sequence of str
        Of each case that does not, how it differs.
    path : Path
        The file to write; an existing one is replaced.

    Returns
    -------
    path : Path
        The file written.
    """
    from ddpc_reports.differences import differences_page

    return _written(differences_page(before, after, verdict, lines), path)


def write_simulation(simulation: "Simulation", path: Path) -> Path:
    """Write one HTML page about a simulation in open loop, or a drawing if the file's name ends in ``.svg``.

    Parameters
    ----------
    simulation : Simulation
        What came of it.
    path : Path
        The file to write; an existing one is replaced.

    Returns
    -------
    path : Path
        The file written.
    """
    from ddpc_reports.simulation import write

    return write(simulation, path)


def write_log(summary: "LogSummary", path: Path) -> Path:
    """Write one HTML page about what logged data are good for.

    Parameters
    ----------
    summary : LogSummary
        What was found.
    path : Path
        The file to write; an existing one is replaced.

    Returns
    -------
    path : Path
        The file written.
    """
    from ddpc_reports.log import log_page

    return _written(log_page(summary), path)


def write_replay(replay: "Replay", path: Path) -> Path:
    """Write one HTML page about what a controller would have done beside what a log says was done.

    Parameters
    ----------
    replay : Replay
        What came of it.
    path : Path
        The file to write; an existing one is replaced.

    Returns
    -------
    path : Path
        The file written.
    """
    from ddpc_reports.replay import replay_page

    return _written(replay_page(replay), path)


class Pictures:
    """Figures and tables of the page for Python, in its own words and colours.

    Errors are those of the methods of ``StudyResults`` and ``Trace`` that ask for them.
    """

    @staticmethod
    def of_traces(traces: "Mapping[str, Trace]") -> "Picture":
        """Draw runs of one loop, by label, over each other."""
        from ddpc_reports.pictures import of_traces

        return of_traces(traces)

    @staticmethod
    def of_results(
        results: "StudyResults", controllers: Sequence[str], *, problem: str, scenario: str
    ) -> "Picture":
        """Draw responses and control signals of one scenario."""
        from ddpc_reports.pictures import of_results

        return of_results(results, controllers, problem=problem, scenario=scenario)

    @staticmethod
    def spread(
        results: "StudyResults", metric: str, controllers: Sequence[str], *, problem: str, scenario: str
    ) -> "Picture":
        """Draw a metric over the seeds of one scenario."""
        from ddpc_reports.pictures import spread_of_results

        return spread_of_results(results, metric, controllers, problem=problem, scenario=scenario)

    @staticmethod
    def every_figure(results: "StudyResults") -> "Iterator[tuple[str, Picture]]":
        """Yield each figure of the page, and a name for its file."""
        from ddpc_reports.pictures import every_figure

        return every_figure(results)

    @staticmethod
    def ranking(
        results: "StudyResults", controllers: Sequence[str], *, problem: str, scenario: str
    ) -> "Table":
        """Return the table of the first screen, of one scenario."""
        from ddpc_reports.pictures import ranking_of

        return ranking_of(results, controllers, problem=problem, scenario=scenario)
