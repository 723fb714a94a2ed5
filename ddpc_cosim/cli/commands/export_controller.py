"""``ddpc-cosim export-controller``."""

from pathlib import Path

import click

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import command, option
from ddpc_cosim.cli.output import warnings_in_one_line
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.files.texts import printable


@command
def export_controller(
    study: str = options.STUDY,
    controller: str = option(..., "Its name in the study.", metavar="NAME"),
    out: Path | None = option(None, "The FMU [NAME.fmu].", metavar="FILE.fmu"),
    fmi: options.FMIVersion = options.FMI_VERSION,
    platforms: str | None = options.PLATFORMS,
    problem: str | None = option(None, "Where the study has several.", metavar="NAME"),
    scenario: str | None = option(None, "Whose experiment, bounds and preview [the first].", metavar="NAME"),
    seed: int | None = option(None, "Of the experiment [the study's first].", type=click.IntRange(min=0)),
    sandbox: bool = options.SANDBOX,
) -> int:
    """Export a controller of STUDY, as it is after its experiment, as an FMU in plain C."""
    from ddpc_cosim.exporting.of_study import export_from_study
    from ddpc_cosim.study.reading import read_study

    with shown(f"reading {study}") as progress, warnings_in_one_line():
        path = export_from_study(
            read_study(study),
            controller,
            out,
            fmi,
            platforms,
            progress,
            problem=problem,
            scenario=scenario,
            seed=seed,
            sandboxed=sandbox,
        )
    print(printable(str(path)))
    return 0
