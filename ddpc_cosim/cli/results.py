"""What is printed of a folder of results, and its report, written and opened."""

import sys
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from ddpc_cosim.cli.output import clipped, say, screen, warnings_in_one_line
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.cli.summary import overall_table, summary_table
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.texts import alike, printable
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.results import HTML, METRICS_FILE, REPORT_FILE, StudyResults, write_report
from ddpc_cosim.study.verdicts.findings import findings_of

_MOST_LISTED, _LONGEST_WARNING = 20, 160


def show_results(
    results: StudyResults, *, report: bool = True, browse: bool = False, is_part: bool = False
) -> int:
    """Print the result table, what has failed, and last the path of the report; return the exit code.

    Requirements count in it unless the results are a part of the study's alone.
    """
    folder = results.folder
    console = screen()
    ran, passes = [problem for problem in results.problems() if problem.cases], True
    for problem in results.problems():
        findings = findings_of(problem.study, problem.cases)
        passes = passes and (findings.requirements is None or findings.requirements.passed)
        for remark in findings.remarks:
            style = "bold red" if remark.is_failure else ""
            console.print(printable(f"{remark.text}."), markup=False, highlight=False, style=style)
        if problem.cases:
            console.print(summary_table(problem, console, findings), crop=False)
        if several := len(results.variants(problem.study.name)):
            noun = "variant" if several == 1 else "variants"
            console.print(
                printable(f"{several} {noun} by the study's sweep: {folder / METRICS_FILE}"), markup=False
            )
    if len(ran) > 1 and (table := overall_table(ran, console)) is not None:
        console.print(table, crop=False)
    sys.stdout.flush()  # what follows on stderr comes after it, wherever both go
    _print_warnings(results)
    failed: dict[tuple[Outcome, str], list[CaseResult]] = {}
    for case in results.cases:
        if case.failed:
            failed.setdefault((case.outcome, alike(case.reason or case.failure)), []).append(case)
    _print_some([_failure(cases) for cases in failed.values()], f": {folder / METRICS_FILE}")
    ended_early = any(outcome is not Outcome.COMPLETED for outcome, _ in failed)
    damaged = print_damaged(results)
    if report:
        write_and_open([results], folder / REPORT_FILE, HTML, browse=browse)
    return 1 if damaged or ended_early or not (passes or is_part) else 0


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


def print_damaged(results: StudyResults) -> bool:
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
    by_words: dict[str, tuple[str, list[CaseResult]]] = {}
    for (_, text), cases in results.warnings().items():
        by_words.setdefault(alike(text), (text, []))[1].extend(cases)
    for text, all_cases in by_words.values():
        controllers = ", ".join(dict.fromkeys(case.controller for case in all_cases))
        count = f"{len(all_cases)} {'case' if len(all_cases) == 1 else 'cases'}"
        say(f"warning: {controllers} ({count}): {clipped(text, _LONGEST_WARNING)}", err=True)


def write_and_open(results: Sequence[StudyResults], path: Path, form: str, *, browse: bool) -> None:
    """Write a report, print its path, and open it if that is wanted and there is a browser."""
    with writing(str(path)):
        path = write_report(results, path, form)
    if browse and not _is_opened(path):
        say("no browser was found to open the report with", err=True)
    print(printable(str(path)))


def _is_opened(path: Path) -> bool:
    """Open a page in a browser, if there is one."""
    with suppress(webbrowser.Error):
        return webbrowser.open(path.resolve().as_uri())
    return False


def write_page(kind: str, path: Path, *content: object) -> None:
    """Write a page that is not the report of a study by its installed writer, and print its path."""
    writer = load_plugin("reports", kind)
    with writing(str(path)):
        try:
            path = writer(*content, path)
        except OSError as error:
            raise ConfigError(f"{path}: the page cannot be written: {error.strerror}") from error
    print(printable(str(path)))


@contextmanager
def writing(what: str) -> Iterator[None]:
    """Show that something is being written, and print warnings after it."""
    with shown(f"writing {what}"), warnings_in_one_line():
        yield
