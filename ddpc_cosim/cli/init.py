"""The ``init`` command: a study for a supplied FMU, from what is tried on it."""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import Any, Self, TypeVar

import click
from rich.console import Console
from rich.text import Text

from ddpc_cosim.errors import ConfigError, CosimWarning
from ddpc_cosim.texts import printable

T = TypeVar("T")
_SECONDS_BETWEEN_LINES = 1.5


def init_command(
    fmu: Path, out: Path, *, at: Sequence[str], ranges: Sequence[str], force: bool, **wanted: Any
) -> None:
    """Write a study for an FMU.

    Parameters
    ----------
    fmu, out : Path
        The FMU and the file to write.
    at, ranges : sequence of str
        ``NAME=VALUE`` and ``NAME=LO:HI``.
    force : bool
        Whether an existing file may be replaced.
    wanted : Any
        Further keywords of :func:`ddpc_cosim.suggestion.suggest_study`.
    """
    levels = assignments("--at", at, number_or_text)
    limits = assignments("--range", ranges, _limits)
    if out.exists() and not force:  # before the step test, which may take a while
        raise ConfigError(f"{out}: already exists; choose another --out, or --force to replace it")
    with warnings.catch_warnings(), Status(Console(stderr=True), f"init {fmu.name}") as status:
        from ddpc_cosim.suggestion import suggest_study, write_study  # takes a while itself

        warnings.simplefilter("ignore", CosimWarning)  # they stand in the study
        proposal = suggest_study(fmu, at=levels, ranges=limits, tell=status, **wanted)
        path = write_study(proposal, fmu, out, replace=force)
    driven, controlled = (", ".join(v.name for v in s) for s in (proposal.inputs, proposal.outputs))
    click.echo(printable(f"{path}: {controlled} by {driven}, every {proposal.sampling_time:g} s"))
    for line in proposal.comments.get("head", ()):
        click.echo(printable(line))
    click.echo(printable(f"run it: ddpc-cosim run {path}"))


def assignments(option: str, texts: Sequence[str], value_of: Callable[[str], T]) -> dict[str, T]:
    """Return what an option that is repeated as ``NAME=VALUE`` says, by name.

    Raises
    ------
    ConfigError
        A text is not of this form, or a name is given twice; all of them at once.
    """
    values: dict[str, T] = {}
    faults = []
    for text in texts:
        name, equals, value = text.rpartition("=")
        name = name.strip()
        if not (equals and name and value):
            faults.append(f'{option} "{text}" is not possible; needed: NAME=VALUE')
        elif name in values:
            faults.append(f"{option}: {name} is given more than once")
        else:
            values[name] = value_of(value)
    if faults:
        raise ConfigError(faults)
    return values


def number_or_text(text: str) -> float | str:
    """Return a text as a number if it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def _limits(text: str) -> Any:
    """Return a range as two numbers, or as what it is, which will be refused together with other faults."""
    parts = [number_or_text(part) for part in text.split(":")]
    return tuple(parts) if len(parts) == 2 and not any(isinstance(part, str) for part in parts) else text


class Status:
    """What is being done, and for how long: in place on a terminal, elsewhere a line every other second.

    Parameters
    ----------
    console : Console
        Where it is shown.
    text : str
        What is being done at first.
    """

    def __init__(self, console: Console, text: str) -> None:
        self._console, self._began, self._text = console, monotonic(), text
        self._done, self._thread = Event(), Thread(target=self._go_on, daemon=True)
        self._shown = console.status("") if console.is_terminal else None

    def __enter__(self) -> Self:
        if self._shown is not None:
            self._shown.start()
        self._tell()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
        if self._shown is not None:
            self._shown.stop()

    def __call__(self, text: str) -> None:
        """Take note of what is being done now."""
        self._text = text

    def _go_on(self) -> None:
        while not self._done.wait(_SECONDS_BETWEEN_LINES):
            self._tell()

    def _tell(self) -> None:
        line = Text(f"{monotonic() - self._began:.0f} s: {printable(self._text)}")
        if self._shown is not None:
            self._shown.update(line)
        else:
            self._console.print(line, soft_wrap=True)
