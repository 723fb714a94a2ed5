"""``ddpc-cosim``: the commands, their options, and what they exit with.

Exit codes: 0 done; 1 some case failed or a check failed; 2 usage or configuration error; 130 interrupted.
"""

import sys
from pathlib import Path

import click

FAILED, MISUSED, INTERRUPTED = 1, 2, 130


class _Commands(click.Group):
    """A group whose commands report errors of this project in their own words."""

    def invoke(self, context: click.Context) -> object:
        from ddpc_cosim.errors import ConfigError, CosimError

        try:
            return super().invoke(context)
        except ConfigError as error:
            for fault in error.faults:
                click.echo(f"error: {fault}", err=True)
            sys.exit(MISUSED)
        except CosimError as error:
            click.echo(f"error: {error}", err=True)
            sys.exit(FAILED)
        except KeyboardInterrupt:
            click.echo("interrupted: finished cases are kept; the same command goes on from there", err=True)
            sys.exit(INTERRUPTED)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="ddpc-cosim", message="%(version)s")
def main() -> None:
    """Co-simulate FMU plants with plug-in controllers and compare them in one HTML report."""


@main.command()
@click.argument("study")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder of results [runs/STUDY]."
)
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes [one per processor].")
@click.option("--only", default="*", metavar="GLOB", help="Only cases or controllers of this name.")
@click.option("--seeds", metavar="0:30", help="Seeds in place of the study's: 7, 0:30 or 5489,0:30.")
@click.option("--fresh", is_flag=True, help="Run cases again that are there already.")
@click.option("--no-report", is_flag=True, help="Write no report.")
def run(
    study: str, out: Path | None, jobs: int | None, only: str, seeds: str | None, fresh: bool, no_report: bool
) -> None:
    """Run STUDY, a file or the name of a built-in study, and write its report."""
    from ddpc_cosim.cli.run import run_command

    sys.exit(run_command(study, out, jobs, only, seeds, fresh, report=not no_report))


@main.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="DIR [DIR ...]")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The report [DIR/report.html].")
def report(folders: tuple[Path, ...], out: Path | None) -> None:
    """Rebuild the report of a run, or put several runs into one."""
    from ddpc_cosim.cli.report import report_command

    report_command(folders, out)


@main.command("list")
@click.argument("kind", required=False, type=click.Choice(["plants", "controllers", "studies"]))
def list_(kind: str | None) -> None:
    """List what is installed, built-in and third-party; a broken plug-in is shown with its error."""
    from ddpc_cosim.cli.list import list_command

    sys.exit(list_command(kind))


@main.command()
@click.argument("plant")
@click.option("--fmi", type=click.Choice(["2.0"]), default="2.0", show_default=True, help="FMI version.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The FMU [PLANT.fmu].")
def export(plant: str, fmi: str, out: Path | None) -> None:
    """Export PLANT, a name from `list plants` or module:MODEL, as an FMU."""
    from ddpc_cosim.cli.export import export_command

    export_command(plant, fmi, out)
