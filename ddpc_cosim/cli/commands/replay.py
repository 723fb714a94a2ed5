"""``ddpc-cosim replay``."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import argument, assignments, command, option
from ddpc_cosim.cli.output import say, screen, warnings_in_one_line
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.texts import printable

if TYPE_CHECKING:
    from ddpc_cosim.replaying import Replay

_SUFFIXES = (".csv", ".html", ".svg", ".json")


@command
def replay(
    log: Path = argument(metavar="LOG.csv", type=options.FILE),
    study: str = options.STUDY,
    controller: str = option(..., "Its name in the study.", metavar="NAME"),
    columns: tuple[str, ...] = option(
        (),
        "The column of a signal that is not called as it (`torque=M1_TRQ`); may be repeated.",
        name="--column",
        metavar="NAME=HEADER",
    ),
    start: float | None = option(
        None,
        "Time of the log's first row in the study, in s or such as `day 23` [the log's own].",
        type=options.MOMENT,
        metavar="T",
    ),
    problem: str | None = option(None, "Where the study has several.", metavar="NAME"),
    scenario: str | None = option(None, "Whose experiment, bounds and preview [the first].", metavar="NAME"),
    seed: int | None = option(None, "Of the experiment [the study's first].", type=click.IntRange(min=0)),
    out: tuple[Path, ...] = option(
        (),
        "Write samples, a page, a plot or the figures; may be repeated.",
        metavar="FILE.csv|.html|.svg|.json",
    ),
    sandbox: bool = options.SANDBOX,
) -> int:
    """Say what a controller of STUDY would have done at each sample of a log, beside what was done."""
    from ddpc_cosim.replaying import run
    from ddpc_cosim.study.reading import read_study

    faults = [fault for path in out if (fault := _impossible(path, log))]
    try:
        named = assignments("--column", columns, str)
    except ConfigError as error:
        faults += error.faults
    if faults:
        raise ConfigError(faults)
    with shown(f"reading {study}") as progress, warnings_in_one_line():
        result = run(
            read_study(study),
            log,
            controller,
            progress,
            problem=problem,
            scenario=scenario,
            seed=seed,
            columns=named,
            start=start,
            sandboxed=sandbox,
        )
    for path in out:
        _write(result, path)
    _print(result)
    for path in out:
        print(printable(str(path)))
    trace = result.trace
    if not trace.completed:
        say(f"{controller}: {trace.outcome}: {trace.reason}", err=True)
    return 0 if trace.completed else 1


def _impossible(path: Path, log: Path) -> str:
    """Return why a file cannot be written; empty if it can be tried."""
    from ddpc_cosim.simulation.request import overwrites

    if path.suffix not in _SUFFIXES:
        return f"--out {path}: the name must end in {', '.join(_SUFFIXES)}"
    if not path.parent.is_dir():
        return f"--out {path}: no such folder: {path.parent}"
    fault = overwrites(path, [log])
    return f"--out {fault}" if fault else ""


def _write(result: "Replay", path: Path) -> None:
    from ddpc_cosim.plugins import load_plugin

    try:
        if path.suffix == ".csv":
            result.write_csv(path)
        elif path.suffix == ".json":
            path.write_text(json.dumps(result.figures(), indent=2, ensure_ascii=False) + "\n", "utf-8")
        elif path.suffix == ".svg":
            result.plot().save(path)
        else:
            load_plugin("reports", "replay")(result, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from error


def _print(result: "Replay") -> None:
    """Print notes, what is to be said, and the figures of each input."""
    from ddpc_cosim.cli.output import terminal_table

    for note in result.notes:
        say(f"note: {note}", err=True)
    for sentence in result.summary():
        say(sentence)
    screen().print(terminal_table(result.table(), ruled=True))
