"""``ddpc-cosim report``."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import click

from ddpc_cosim.cli.options import FOLDER, OPEN, PathType, argument, command, option
from ddpc_cosim.cli.output import say
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.texts import printable
from fmu_plants.spelling import did_you_mean

if TYPE_CHECKING:
    from ddpc_cosim.study.results import StudyResults

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
        None, "Of the report [that of FILE's name, or html].", name="--format", metavar="html|md|csv|json|tex"
    ),
    figures: Path | None = option(None, "A folder for its figures, each in a file.", type=FOLDER),
    figure_format: str = option("svg", "Of these [svg]: svg, pdf, png, json, or several: svg,pdf."),
    browse: bool = OPEN,
) -> int:
    """Rebuild the report of a run, or put several runs into one."""
    from ddpc_cosim.cli.results import print_damaged, write_and_open, writing
    from ddpc_cosim.loop.plotting import SUFFIXES
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
    suffixes = [f".{word.strip()}" for word in figure_format.split(",")]
    if wrong := [suffix[1:] for suffix in suffixes if suffix not in SUFFIXES]:
        known = [suffix[1:] for suffix in SUFFIXES]
        raise ConfigError([f'--figure-format: "{word}"; {did_you_mean(word, known)}' for word in wrong])
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
    if figures is not None:
        with writing(str(figures)):
            count = _write_figures(results, figures, suffixes)
        say(f"{figures}: {count} figures")
    damaged = [print_damaged(single) for single in results]
    return int(any(damaged))


def _write_figures(results: "Sequence[StudyResults]", folder: Path, suffixes: Sequence[str]) -> int:
    """Write every figure in every format, and return how many figures there are."""
    from ddpc_cosim.loop.plotting import drawn

    names = [single.whole.head.name for single in results]
    count = 0
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for i, single in enumerate(results):
            apart = f"{i + 1}-{printable(names[i])}-" if len(results) > 1 else ""
            for name, picture in drawn("every_figure", single):
                count += 1
                for suffix in suffixes:
                    picture.save(folder / f"{apart}{name}{suffix}")
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror or error}") from error
    return count
