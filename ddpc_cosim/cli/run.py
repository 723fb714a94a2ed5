"""``ddpc-cosim run``."""

import os
import sys
import warnings
import webbrowser
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from ddpc_cosim.cli.output import say, screen
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.cli.summary import overall_table, summary_table
from ddpc_cosim.errors import ConfigError, CosimWarning
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.file_format.sections import expand_seeds
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.results import (
    HTML,
    METRICS_FILE,
    REPORT_FILE,
    StudyResults,
    load_results,
    report_formats,
    report_writer,
    write_metrics,
    write_report,
)
from ddpc_cosim.study.runner import Selection, run_study
from ddpc_cosim.study.running.dry_run import expected
from ddpc_cosim.study.verdicts.findings import findings_of
from ddpc_cosim.texts import alike, printable
from ddpc_cosim.trace import Outcome

_MOST_LISTED = 20


def run_command(
    name: str,
    out: Path | None,
    jobs: int | None,
    only: Sequence[str],
    seeds: str | None,
    fresh: bool,
    how: Mapping[str, Any],
    *,
    report: bool,
    dry_run: bool,
    browse: bool,
) -> int:
    """Run a study, print the result table and the report's path, and return the exit code.

    If dry, nothing is run: what would be is printed. ``how`` are other fields of :class:`Selection`.
    """
    if browse and not report:
        raise ConfigError("--open: with --no-report there is nothing to open")
    selection = Selection(jobs or os.cpu_count() or 1, parse_seeds(seeds), only, fresh, **how)
    with shown(f"reading {name}") as progress:
        with warnings_in_one_line():
            resolved = read_study(name)
        folder = out or Path("runs") / resolved.head.name
        with warnings_in_one_line():
            if dry_run:
                would_be = expected(resolved, folder, selection, progress)
            else:
                results = run_study(resolved, folder, selection, progress)
    if dry_run:  # what is printed while progress is shown is dropped
        say(would_be, keep="\n")
        return 0
    if selection.is_part:
        count = f"{len(results.cases)} {'case' if len(results.cases) == 1 else 'cases'}"
        print(f"shard {selection.shard}: {count}; metrics.csv and report: run without --shard after the last")
    return show_results(results, report=report and not selection.is_part, browse=browse)


def show_results(results: StudyResults, *, report: bool = True, browse: bool = False) -> int:
    """Print the result table, the path of the report and what has failed, and return the exit code."""
    folder = results.folder
    console = screen()
    ran = [problem for problem in results.problems() if problem.cases]
    for problem in results.problems():
        told = findings_of(problem.study, problem.cases)
        for remark in told.remarks:
            style = "bold red" if remark.is_failure else ""
            console.print(printable(f"{remark.text}."), markup=False, highlight=False, style=style)
        if problem.cases:
            console.print(summary_table(problem, console, told), crop=False)
        if several := len(results.variants(problem.study.name)):
            noun = "variant" if several == 1 else "variants"
            console.print(
                printable(f"{several} {noun} by the study's sweep: {folder / METRICS_FILE}"), markup=False
            )
    if len(ran) > 1 and (table := overall_table(ran, console)) is not None:
        console.print(table, crop=False)
    if report:
        _write_report([results], folder / REPORT_FILE, HTML, browse=browse)
    _print_warnings(results)
    failed: dict[tuple[Outcome, str], list[CaseResult]] = {}
    for case in results.cases:
        if case.failed:
            failed.setdefault((case.outcome, alike(case.reason or case.failure)), []).append(case)
    _print_some([_failure(cases) for cases in failed.values()], f": {folder / METRICS_FILE}")
    ended_early = any(outcome is not Outcome.COMPLETED for outcome, _ in failed)
    return 1 if _damaged(results) or ended_early else 0


def _failure(cases: Sequence[CaseResult]) -> str:
    """Say how runs that failed for one reason ended, and why, in the words of the first."""
    first = cases[0]
    done = first.outcome is Outcome.COMPLETED
    how = f"{first.outcome}, failed: {first.failure}" if done else f"{first.outcome}: {first.reason}"
    return f"{_first_and_more(cases)}: {how}"


def _first_and_more(cases: Sequence[CaseResult]) -> str:
    return cases[0].id + (f" and {len(cases) - 1} more" if len(cases) > 1 else "")


def _print_some(lines: Sequence[str], rest: str) -> None:
    for line in lines[:_MOST_LISTED]:
        say(line, err=True)
    if len(lines) > _MOST_LISTED:
        say(f"and {len(lines) - _MOST_LISTED} more{rest}", err=True)


def _damaged(results: StudyResults) -> bool:
    """Print which cases are damaged and what to do, and return whether any is."""
    damaged = len(results.damaged)
    total = damaged + len(results.cases) + len(results.resting)
    _print_some([f"error: {why}" for why in results.damaged.values()], "")
    if damaged:
        remedy = f"run the study again with --out {results.folder}: only they are run"
        say(f"{damaged} of {total} cases are damaged and left out; {remedy}", err=True)
    return damaged > 0


def _print_warnings(results: StudyResults) -> None:
    """Print what spoke against data and models before the loops were closed, each text once."""
    found: dict[str, tuple[str, list[CaseResult]]] = {}
    for (_, text), cases in results.warnings().items():
        found.setdefault(alike(text), (text, []))[1].extend(cases)
    for text, all_cases in found.values():
        controllers = ", ".join(dict.fromkeys(case.controller for case in all_cases))
        count = f"{len(all_cases)} {'case' if len(all_cases) == 1 else 'cases'}"
        say(f"warning: {controllers} ({count}): {text}", err=True)


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Print what is not quite right with a plant in one line each."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CosimWarning)
        yield
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        say(f"warning: {message}", err=True)


def parse_seeds(text: str | None) -> list[int]:
    """Return the seeds that ``--seeds`` gives."""
    if text is None:
        return []
    try:
        return expand_seeds([part.strip() for part in text.split(",")])
    except ValueError as error:
        raise ConfigError(f"--seeds: {error}") from error


def report_command(folders: Sequence[Path], out: Path | None, form: str | None, *, browse: bool) -> int:
    """Write one report on several folders of results, print its path, and return the exit code.

    Their ``metrics.csv`` are written again, so that they say the same. Without a format, the file's name says
    which it is. To the file ``-``, the report itself is printed.
    """
    form = form or (out.suffix[1:] if out and out.suffix[1:] in report_formats() else HTML)
    report_writer(form)  # before the results are read, which takes a while
    printed = out == Path("-")
    if printed and browse:
        raise ConfigError("--open: there is no file to open with --out -")
    with shown("reading results"):
        results = [load_results(folder) for folder in folders]
        for one in results:
            with suppress(OSError):  # what one may only read can be reported all the same
                write_metrics(one)
    if printed:
        with TemporaryDirectory() as scratch, _writing("the report"):
            content = write_report(results, Path(scratch, f"report.{form}"), form).read_bytes()
        click.echo(content, nl=False)
    else:
        file = folders[0] / REPORT_FILE
        _write_report(results, out or file.with_suffix(f".{form}"), form, browse=browse)
    damaged = [_damaged(one) for one in results]
    return int(any(damaged))


def _write_report(results: Sequence[StudyResults], path: Path, form: str, *, browse: bool) -> None:
    """Write a report, print its path, and open it if that is wanted and there is a browser."""
    with _writing(str(path)):
        path = write_report(results, path, form)
    print(printable(str(path)))
    if browse:
        with suppress(webbrowser.Error):
            if webbrowser.open(path.resolve().as_uri()):
                return
        print("no browser was found to open the report with", file=sys.stderr)


@contextmanager
def _writing(what: str) -> Iterator[None]:
    with shown(f"writing {what}"), warnings_in_one_line():
        yield
