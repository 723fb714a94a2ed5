"""``ddpc-cosim inspect``."""

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import click

from ddpc_cosim.cli.options import JSON, LIBRARY_PATH, POSITIVE, PathType, argument, command, option
from ddpc_cosim.errors import ConfigError

_FILE = PathType(exists=True, dir_okay=False)
_LOGS = (".csv", ".parquet", ".txt", ".tsv")


@command
def inspect(
    file: Path = argument(type=_FILE, metavar="FILE.fmu|FILE.ssp|LOG.csv"),
    as_json: bool = JSON,
    strict: bool = option(False, "FMPy's full validation too; slow with thousands of variables."),
    library_path: tuple[Path, ...] = LIBRARY_PATH,
    every: bool = option(False, "Show every row of long lists.", name="--all"),
    inputs: tuple[str, ...] = option(
        (), "Of a log: this column is an input; may be repeated.", name="--input", metavar="NAME"
    ),
    outputs: tuple[str, ...] = option(
        (), "Of a log: this is an output; may be repeated.", name="--output", metavar="NAME"
    ),
    disturbances: tuple[str, ...] = option(
        (), "Of a log: this is a known disturbance; may be repeated.", name="--disturbance", metavar="NAME"
    ),
    sampling_time: float | None = option(
        None, "Of a log: average rows to samples so many s apart [as they are].", type=POSITIVE
    ),
    page: Path | None = option(None, "Of a log: write a page too.", name="--html", metavar="FILE"),
) -> int:
    """Show what is in an FMU or SSP, or what a log is good for; exit with 1 if it cannot serve."""
    is_log = file.suffix.lower() in _LOGS
    of_logs = {
        "--input": inputs,
        "--output": outputs,
        "--disturbance": disturbances,
        "--sampling-time": sampling_time,
        "--html": page,
    }
    of_models = {"--strict": strict, "--library-path": library_path}
    unfit = [name for name, value in (of_models if is_log else of_logs).items() if value]
    if unfit:
        kind = "a log" if is_log else "an FMU or an SSP"
        raise ConfigError([f"{name}: not for {kind}, such as {file}" for name in unfit])
    if is_log:
        return _inspect_log(file, inputs, outputs, disturbances, sampling_time, page, as_json, every)
    return _inspect_model(file, library_path, strict=strict, as_json=as_json, every=every)


def _inspect_model(
    file: Path, library_path: tuple[Path, ...], *, strict: bool, as_json: bool, every: bool
) -> int:
    from rich.console import Console

    from ddpc_cosim.cli.inspection import plain_lines, print_tables
    from ddpc_cosim.cli.output import say
    from ddpc_cosim.inspection import Inspection, as_data, inspect_fmu, systems

    tell = partial(say, err=True)
    inspection = (
        systems.inspect_ssp(file, library_path, tell)
        if file.suffix.lower() == ".ssp"
        else inspect_fmu(file, strict=strict, library_path=library_path, tell=tell)
    )
    if as_json:
        _print_json(
            as_data(inspection) if isinstance(inspection, Inspection) else systems.as_data(inspection)
        )
    elif (console := Console()).is_terminal:
        print_tables(console, inspection, every=every)
    else:
        for line in plain_lines(inspection):
            click.echo(line)
    return 0 if inspection.can_run else 1


def _inspect_log(
    file: Path,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    disturbances: tuple[str, ...],
    sampling_time: float | None,
    page: Path | None,
    as_json: bool,
    every: bool,
) -> int:
    from rich.console import Console

    from ddpc_cosim.cli.log_inspection import print_summary, summary_lines
    from ddpc_cosim.inspection.log_files import inspect_log
    from ddpc_cosim.plugins import load_plugin

    if page is not None and not page.parent.is_dir():
        raise ConfigError(f"--html {page}: no such folder: {page.parent}")
    summary = inspect_log(file, inputs, outputs, disturbances, sampling_time)
    if page is not None:
        try:
            load_plugin("reports", "log")(summary, page)
        except OSError as error:
            raise ConfigError(f"{page}: cannot be written: {error.strerror or error}") from error
    if as_json:
        _print_json(summary.as_data())
    elif (console := Console()).is_terminal:
        print_summary(console, summary, every=every)
    else:
        for line in summary_lines(summary):
            click.echo(line)
    return 0 if summary.good else 1


def _print_json(data: Any) -> None:
    # Part by part: as one text it would take more memory than its content.
    sys.stdout.writelines(json.JSONEncoder(indent=2, allow_nan=False).iterencode(data))
    click.echo()
