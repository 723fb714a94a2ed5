"""``ddpc-cosim report``."""

from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from ddpc_cosim.cli.options import OPEN, PathType, argument, command, option
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError

_FILE_OR_STDOUT = PathType(dir_okay=False, allow_dash=True)


@command
def report(
    folders: tuple[Path, ...] = argument(type=PathType(), metavar="DIR [DIR ...]"),
    out: Path | None = option(
        None,
        "The report [DIR/report.FORMAT]; - prints it.",
        type=_FILE_OR_STDOUT,
        metavar="FILE",
    ),
    form: str | None = option(
        None, "Of the report [that of FILE's name, or html].", name="--format", metavar="html|md|csv|json"
    ),
    browse: bool = OPEN,
) -> int:
    """Rebuild the report of a run, or put several runs into one."""
    from ddpc_cosim.cli.results import print_damaged, write_and_open, writing
    from ddpc_cosim.study.results import (
        HTML,
        REPORT_FILE,
        load_results,
        report_formats,
        report_writer,
        write_metrics,
        write_report,
    )

    form = form or (out.suffix[1:] if out and out.suffix[1:] in report_formats() else HTML)
    report_writer(form)  # before the results are read, which takes a while
    is_printed = out == Path("-")
    if is_printed and browse:
        raise ConfigError("--open: there is no file to open with --out -")
    with shown("reading results"):
        results = [load_results(folder) for folder in folders]
        for single in results:
            with suppress(OSError):  # what one may only read can be reported all the same
                write_metrics(single)  # so that it says the same as the report
    if is_printed:
        with TemporaryDirectory() as scratch, writing("the report"):
            content = write_report(results, Path(scratch, f"report.{form}"), form).read_bytes()
        click.echo(content, nl=False)
    else:
        path = out or (folders[0] / REPORT_FILE).with_suffix(f".{form}")
        write_and_open(results, path, form, browse=browse)
    damaged = [print_damaged(single) for single in results]
    return int(any(damaged))
