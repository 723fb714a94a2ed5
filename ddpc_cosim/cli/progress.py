"""What is shown of long work: in place on a terminal, elsewhere lines; at first every other second."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from importlib import import_module
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TextIO

from ddpc_cosim.files.durations import in_words
from ddpc_cosim.files.texts import alike, printable

if TYPE_CHECKING:  # which take a while to import themselves
    from collections.abc import Iterator

    from rich.console import RenderableType

    from ddpc_cosim.study.case_files import CaseResult
    from ddpc_cosim.study.cases import Case
    from ddpc_cosim.study.runner import Update

# Between two lines, and as a part of the time that has passed: a log of a day is not one of 50 000 lines.
_SECONDS_BETWEEN_LINES, _PART = 1.5, 0.01
_MOST_LISTED, _MOST_LINES = 4, 16
_STDOUT = 1


class _Cases:
    """How far the cases of a run are."""

    def __init__(self) -> None:
        self.total, self.done, self.simulated = 0, 0, 0.0
        self._running: dict[str, int] = {}
        self._began = 0.0

    def start(self, total: int) -> None:
        """So many are to be run, from now on."""
        self.total, self.done, self.simulated, self._began = total, 0, 0.0, monotonic()
        self._running.clear()

    def update(self, update: "Update") -> None:
        """Take note of how far a case is."""
        self._running[update.case] = 100 * update.samples // max(update.planned, 1)

    def finished(self, case: "Case", result: "CaseResult") -> None:
        """Count a case, and what of it was simulated."""
        self._running.pop(case.name, None)
        self.done += 1
        self.simulated += result.simulated_time

    @property
    def rate(self) -> str:
        """How many cases are done in a second or a minute; empty before the first one is."""
        rate = self.done / max(monotonic() - self._began, 1e-3)
        if not self.done:
            return ""
        return f"{rate:.3g} cases/s" if rate >= 1.0 else f"{60 * rate:.3g} cases/min"

    @property
    def counts(self) -> str:
        """What is done, and how long the rest takes at this rate; empty before the first one is."""
        if not self.done:
            return ""
        left = (monotonic() - self._began) / self.done * (self.total - self.done)
        counts = f"{self.done}/{self.total} cases, {in_words(round(self.simulated))} simulated"
        return f"{counts}, {self.rate}, about {left:.0f} s left, "

    def running(self, most: int) -> list[str]:
        """Return each case that is running, and how far it is."""
        words = [f"{name}: {share} %" for name, share in self._running.items()]
        return words if len(words) <= most else [*words[: most - 1], f"{len(words) - most + 1} more"]


class LineProgress:
    """What is being done, and since when: lines now and then, for logs.

    Parameters
    ----------
    stream : TextIO
        Where they are written.
    text : str
        What is being done at first.
    """

    def __init__(self, stream: TextIO, text: str = "preparing") -> None:
        self._stream, self._text, self._said = stream, text, ""
        self._over, self._thread = Event(), Thread(target=self._go_on, daemon=True)
        self._cases = _Cases()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        self._stream.flush()

    def __call__(self, what: str) -> None:
        """Note the current activity."""
        self._text = what

    def prepare(self, what: str) -> None:
        """Say what is done before the cases."""
        self._text = what
        self._say()

    def start(self, total: int, kept: int) -> None:
        """Say how many cases there are."""
        self._cases.start(total)
        noun = "case" if total == 1 else "cases"
        self._text = f"{total} {noun} to run" + (f", {kept} kept" if kept else "")
        self._say()

    def drop(self, cases: int) -> None:
        """Take note that so many are not to be run any more."""
        self._cases.total -= cases

    def update(self, update: "Update") -> None:
        """Take note of how far a case is."""
        self._cases.update(update)
        self._text = f"{self._cases.counts}{', '.join(self._cases.running(_MOST_LISTED))}"

    def finished(self, case: "Case", result: "CaseResult") -> None:
        """Count a case; say at the end how many are done."""
        self._cases.finished(case, result)
        self._text = f"{self._cases.counts}last: {case.name}"
        if self._cases.done == self._cases.total:
            self._say()

    def _go_on(self) -> None:
        begin = monotonic()
        while not self._over.wait(max(_SECONDS_BETWEEN_LINES, _PART * (monotonic() - begin))):
            self._say(f"{monotonic() - begin:.0f} s: ")

    def _say(self, since: str = "") -> None:
        """Write what is being done, unless that was the last line."""
        if self._text != self._said:
            self._said = text = self._text
            self._write(printable(f"{since}{text}"))

    def _write(self, line: str) -> None:
        print(line, file=self._stream, flush=True)


class TerminalProgress:
    """What is being done, and since when; of cases how many are done, at which rate, and each running one.

    Parameters
    ----------
    text : str
        What is being done at first.
    """

    def __init__(self, text: str) -> None:
        from rich import progress  # elsewhere it is not needed
        from rich.console import Console
        from rich.text import Text

        what = progress.TextColumn("{task.description}", markup=False)
        since = progress.TimeElapsedColumn()
        self._of_cases = (
            what,
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TextColumn("cases"),
            progress.TextColumn("{task.fields[simulated]} simulated {task.fields[rate]}"),
            since,
            progress.TimeRemainingColumn(),
        )
        self._cases = cases = _Cases()

        class WithCases(progress.Progress):
            def get_renderables(self) -> "Iterator[RenderableType]":
                yield from super().get_renderables()
                for line in cases.running(_MOST_LINES):
                    yield Text(printable(f"  {line}"), no_wrap=True, overflow="ellipsis")

        console = Console(stderr=True)
        self._progress = WithCases(progress.SpinnerColumn(), since, what, console=console, transient=True)
        self._reported: set[tuple[str, str]] = set()
        self._task = self._progress.add_task(printable(text), total=None, simulated="0 s", rate="")

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def __call__(self, what: str) -> None:
        """Show what is being done now."""
        self._progress.update(self._task, description=printable(what))

    prepare = __call__

    def start(self, total: int, kept: int) -> None:
        """Show how many cases there are."""
        self._progress.columns = self._of_cases
        self._progress.reset(self._task, total=total)
        self._cases.start(total)
        self(f"{kept} finished cases are kept" if kept else "starting")

    def drop(self, cases: int) -> None:
        """Show that so many are not to be run any more."""
        self._cases.total -= cases
        self._progress.update(self._task, total=self._cases.total)

    def update(self, update: "Update") -> None:
        """Show how far a running case is."""
        self._cases.update(update)

    def finished(self, case: "Case", result: "CaseResult") -> None:
        """Count a case, and keep a line about one that failed as no other did before."""
        self._cases.finished(case, result)
        rate, simulated = self._cases.rate, in_words(round(self._cases.simulated))
        self._progress.update(self._task, advance=1, description="running", simulated=simulated, rate=rate)
        kind = result.outcome, alike(result.reason)
        if result.reason and kind not in self._reported:
            self._reported.add(kind)
            line = printable(f"{case.name}: {result.outcome}: {result.reason}")
            self._progress.console.print(line, markup=False)


class NotebookProgress(LineProgress):
    """What is being done: one output of a notebook's cell, which is replaced, and is empty at the end."""

    def __init__(self, text: str = "preparing") -> None:
        super().__init__(sys.stderr, text)
        self._display = import_module("IPython.display").display
        self._output: Any = None

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._write("")

    def _write(self, line: str) -> None:
        data = {"text/plain": line}
        if self._output is not None:
            self._output.update(data, raw=True)
        elif line:
            self._output = self._display(data, raw=True, display_id=True)


def _is_in_notebook() -> bool:
    """Whether this process serves a notebook, whose outputs are no lines of a stream."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


def display(text: str) -> LineProgress | TerminalProgress:
    """Return a display of long work on stderr, or in a notebook, with a text to begin with."""
    if _is_in_notebook():
        return NotebookProgress(text)
    return TerminalProgress(text) if sys.stderr.isatty() else LineProgress(sys.stderr, text)


@contextmanager
def shown(text: str) -> Iterator[LineProgress | TerminalProgress]:
    """Show long work on stderr, at first what a text says; what it prints to stdout itself is dropped."""
    with display(text) as progress, _without_output():
        yield progress


@contextmanager
def _without_output() -> Iterator[None]:
    """Drop what goes to stdout, from Python or from C."""
    _flush()
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        try:
            saved = os.dup(_STDOUT)
        except OSError:  # closed by whoever started this process
            saved = -1
        os.dup2(nowhere.fileno(), _STDOUT)
        try:
            with redirect_stdout(nowhere):
                yield
        finally:
            with suppress(OSError, ValueError):  # whatever was done to them
                _flush()
            if saved >= 0:
                os.dup2(saved, _STDOUT)
            os.close(saved if saved >= 0 else _STDOUT)


def _flush() -> None:
    """Write out what Python and C hold back of stdout."""
    import ctypes  # which commands that show nothing do without

    for stream in (sys.stdout, sys.__stdout__):
        if stream is not None:
            stream.flush()
    ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fflush(None)
