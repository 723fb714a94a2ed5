"""Progress of a run: a live display on a terminal, plain lines elsewhere."""

from time import monotonic
from types import TracebackType
from typing import Self, TextIO

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from ddpc_cosim.executors import Update
from ddpc_cosim.results import CaseResult
from ddpc_cosim.study import Case
from ddpc_cosim.trace import Outcome

_SECONDS_BETWEEN_LINES = 5.0


class TerminalProgress:
    """Cases done, current case, simulated time and time left, drawn in place."""

    def __init__(self, console: Console) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("cases"))
        times = (
            TextColumn("{task.fields[simulated]:.0f} s simulated"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._progress = Progress(*columns, *times, console=console, transient=True)
        self._task = self._progress.add_task("preparing the plant", total=None, simulated=0.0)
        self._simulated = 0.0

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def start(self, total: int, kept: int) -> None:
        """Show how many cases there are."""
        note = f"{kept} cases are there already" if kept else "starting"
        self._progress.update(self._task, total=total, description=note)

    def update(self, update: Update) -> None:
        """Show how far a running case is."""
        percent = 100 * update.samples // max(update.planned, 1)
        self._progress.update(self._task, description=f"{update.case} {percent} %")

    def finished(self, case: Case, result: CaseResult) -> None:
        """Count a case, and keep a line about one that failed."""
        self._simulated += case.duration
        self._progress.update(self._task, advance=1, description=case.name, simulated=self._simulated)
        if result.outcome is not Outcome.COMPLETED:
            self._progress.console.print(f"{case.name}: {result.outcome}: {result.reason}", markup=False)


class LineProgress:
    """A line now and then, for logs."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._began = self._last = monotonic()
        self._total = self._done = 0
        self._simulated = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.flush()

    def start(self, total: int, kept: int) -> None:
        """Say how many cases there are."""
        self._total = total
        noun = "case" if total == 1 else "cases"
        self._say(f"{total} {noun} to run" + (f", {kept} there already" if kept else ""))

    def update(self, update: Update) -> None:
        """Say how far a long case is."""
        if monotonic() - self._last > _SECONDS_BETWEEN_LINES:
            self._say(f"{update.case}: {100 * update.samples // max(update.planned, 1)} %")

    def finished(self, case: Case, result: CaseResult) -> None:
        """Say now and then, and at the end, how many cases are done."""
        self._done += 1
        self._simulated += case.duration
        if self._done == self._total or monotonic() - self._last > _SECONDS_BETWEEN_LINES:
            left = (monotonic() - self._began) / self._done * (self._total - self._done)
            counts = f"{self._done}/{self._total} cases, {self._simulated:.0f} s simulated"
            self._say(f"{counts}, about {left:.0f} s left, last: {case.name}")

    def _say(self, line: str) -> None:
        self._last = monotonic()
        print(line, file=self._stream, flush=True)
