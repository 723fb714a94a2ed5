"""``ddpc-cosim run``."""

import os
import sys
import warnings
from pathlib import Path

from rich.console import Console

from ddpc_cosim.checked_study import CheckedStudy
from ddpc_cosim.cli.progress import LineProgress, TerminalProgress
from ddpc_cosim.cli.report import write_report
from ddpc_cosim.cli.summary import summary_table
from ddpc_cosim.config import expand_seeds
from ddpc_cosim.errors import ConfigError, CosimWarning
from ddpc_cosim.results import METRICS_FILE
from ddpc_cosim.run import Selection, run_study
from ddpc_cosim.study_file import read_study
from ddpc_cosim.trace import Outcome

REPORT_FILE = "report.html"
_WIDE = 1000
_FAILED_LISTED = 20


def run_command(
    name: str, out: Path | None, jobs: int | None, only: str, seeds: str | None, fresh: bool, *, report: bool
) -> int:
    """Run a study, print the result table and the report's path, and return the exit code."""
    chosen = _parse_seeds(seeds)
    checked = _read(name)
    folder = out or Path("runs") / checked.study.name
    console = Console(stderr=True)
    selection = Selection(jobs or os.cpu_count() or 1, chosen, only, fresh)
    progress = TerminalProgress(console) if console.is_terminal else LineProgress(sys.stderr)
    with progress:
        results = run_study(checked, folder, selection, progress)
    # Where nobody's window limits it, the table takes the width it needs.
    screen = Console(width=None if sys.stdout.isatty() else _WIDE)
    screen.print(summary_table(results, screen))
    if report:
        print(write_report([results], folder / REPORT_FILE))
    failed = [case for case in results.cases if case.outcome is not Outcome.COMPLETED]
    for case in failed[:_FAILED_LISTED]:
        print(f"{case.id}: {case.outcome}: {case.reason}", file=sys.stderr)
    if len(failed) > _FAILED_LISTED:
        print(f"and {len(failed) - _FAILED_LISTED} more: {folder / METRICS_FILE}", file=sys.stderr)
    return 1 if failed else 0


def _read(name: str) -> CheckedStudy:
    """Read a study; what is not quite right with its plant is told in one line each."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CosimWarning)
        checked = read_study(name)
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        print(f"warning: {message}", file=sys.stderr)
    return checked


def _parse_seeds(text: str | None) -> list[int]:
    if text is None:
        return []
    try:
        seeds = expand_seeds([part.strip() for part in text.split(",")])
    except ValueError as error:
        raise ConfigError(f"--seeds: {error}") from error
    wrong = [seed for seed in seeds if not isinstance(seed, int) or not 0 <= seed < 2**32]
    if wrong:
        raise ConfigError(
            f"--seeds: {wrong[0]!r} is not a seed; allowed: whole numbers from 0, or ranges such as 0:30"
        )
    return list(seeds)
