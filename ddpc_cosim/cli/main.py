"""``ddpc-cosim``: the commands, their options, and what they exit with.

Exit codes: 0 done; 1 some case failed or a check failed; 2 usage or configuration error; 130 interrupted;
143 terminated.
"""

import errno
import math
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from ddpc_cosim.cli.ending import INTERRUPTED, TERMINATED, told_when_asked_to_end
from ddpc_cosim.processes.requests import Terminated, orderly_end

_STDOUT, _NOT_WRITTEN = 1, (errno.ENOSPC, errno.EFBIG, errno.EIO)
FAILED, MISUSED = 1, 2
_LISTED = ("plants", "controllers", "studies", "metrics", "conditions", "reports")
_FMI_TYPES = ("auto", "co-simulation", "model-exchange")


def _complain(error: str) -> None:
    """Print an error; its further lines, which may be anyone's, cannot be taken for this program's own."""
    from ddpc_cosim.cli.output import say

    say("error: " + error.replace("\n", "\n  "), err=True, keep="\n")


@contextmanager
def _harmless_usage_errors() -> Iterator[None]:
    """Write out in click's own messages, too, what would act on a terminal."""
    from ddpc_cosim.cli.output import harmless

    try:
        yield
    except click.UsageError as error:
        words = f"Error: {error.format_message()}"
        if (shown := harmless(words, err=True, keep="\n")) == words:
            raise
        raise click.UsageError(shown.removeprefix("Error: "), error.ctx) from None


class _Command(click.Command):
    """A command whose options are given once, but for those that may be repeated."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments, and say which option with one value has several."""
        if not ctx.resilient_parsing:
            _, _, given = self.make_parser(ctx).parse_args(list(args))
            for option, count in Counter(one for one in given if isinstance(one, click.Option)).items():
                if count > 1 and not (option.multiple or option.is_flag):
                    name = next(name for name in option.opts if name.startswith("--"))
                    ctx.fail(f"{name} is given {count} times; allowed: once, as it has one value.")
        return super().parse_args(ctx, args)


class _Commands(click.Group):
    """A group whose commands report errors of this project in their own words."""

    command_class = _Command

    def main(self, *arguments: Any, **more: Any) -> Any:
        """Run a command, and say if what it prints cannot be written."""
        try:
            try:
                with orderly_end():
                    return super().main(*arguments, **more)
            finally:
                if sys.stdout is not None:
                    sys.stdout.flush()  # at the end of the process it would be a traceback
        except OSError as error:
            if error.filename is not None or error.errno not in _NOT_WRITTEN:
                raise
            _complain(f"stdout cannot be written: {error.strerror}")
            os.dup2(os.open(os.devnull, os.O_WRONLY), _STDOUT)  # for what is left of it
            sys.exit(FAILED)

    def make_context(self, *arguments: Any, **more: Any) -> click.Context:
        """Parse what stands before the command."""
        with told_when_asked_to_end(), _harmless_usage_errors():
            return super().make_context(*arguments, **more)

    def invoke(self, context: click.Context) -> object:
        with told_when_asked_to_end():
            from ddpc_cosim.cli.output import open_streams
            from ddpc_cosim.errors import CosimError, is_of_usage

            open_streams()
            try:
                with told_when_asked_to_end(), _harmless_usage_errors():
                    return super().invoke(context)
            except CosimError as error:
                for fault in getattr(error, "faults", (str(error),)):
                    _complain(fault)
                sys.exit(MISUSED if is_of_usage(error) else FAILED)


class _Choice(click.Choice[str]):
    """One of a few words; for another one the nearest is told."""

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        """Say what was probably meant."""
        from fmu_plants.spelling import did_you_mean

        return f'"{value}" is not possible; {did_you_mean(str(value), self.choices)}'


class _Path(click.Path):
    """A path that is not empty, as that of an unset variable of a shell is."""

    def __init__(self, **more: Any) -> None:
        super().__init__(path_type=Path, **more)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, or say what is wrong with it."""
        if not str(value):
            self.fail("it is empty; needed: a path.", param, ctx)
        return super().convert(value, param, ctx)


class _FiniteRange(click.FloatRange):
    """A range of numbers that are finite, which NaN is in none of."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number, or say why it is not possible."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


_POSITIVE = _FiniteRange(min=0, min_open=True)


def _names(*kinds: str) -> Callable[..., list[CompletionItem]]:
    """Return what a shell completes: names of plug-ins of some kinds, and files."""

    def complete(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
        from ddpc_cosim.plugins import plugin_names

        names = [name for kind in kinds for name in plugin_names(kind) if name.startswith(begun)]
        return [*map(CompletionItem, names), CompletionItem(begun, type="file")]

    return complete


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="ddpc-cosim", message="%(version)s")
def main() -> None:
    """Co-simulate FMU plants with plug-in controllers and compare them in one HTML report."""


_SANDBOX = click.option(
    "--sandbox", is_flag=True, help="Let the FMU write nothing elsewhere, read no files of yours, no network."
)

_EXECUTOR = click.option(
    "--executor", type=_Choice(["local", "dask"]), default="local", help="Where cases run [local]."
)
_SCHEDULER = click.option(
    "--scheduler", default="", metavar="ADDRESS", help="The dask scheduler's: tcp://host:8786."
)
_ONLY = click.option(
    "--only", multiple=True, metavar="GLOB", help="Only cases of this name or label; may be repeated."
)
_NO_REPORT = click.option("--no-report", is_flag=True, help="Write no report.")
_OPEN = click.option("--open", "browse", is_flag=True, help="Open the report in a browser.")


_STEP_TIMEOUT = click.option(
    "--step-timeout",
    type=_POSITIVE,
    default=60.0,
    show_default=True,
    help="Seconds that one call of the plant may take.",
)


@main.command()
@click.argument("study", shell_complete=_names("studies"))
@click.option("--out", type=_Path(file_okay=False), help="Folder of results [runs/STUDY].")
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes [one per processor].")
@_ONLY
@click.option("--seeds", metavar="0:30", help="Seeds in place of the study's: 7, 0:30 or 5489,0:30.")
@click.option("--fresh", is_flag=True, help="Run cases again that already exist.")
@click.option("--shard", default="1/1", metavar="I/N", help="Every N-th case from the I-th on; no report.")
@_EXECUTOR
@_SCHEDULER
@click.option(
    "--storage",
    type=_Choice(["csv", "parquet"]),
    default="csv",
    help="File of each case's samples [csv]; parquet needs pyarrow.",
)
@click.option("--keep-files", is_flag=True, help="Keep what each case leaves in its working directory.")
@click.option("--dry-run", is_flag=True, help="Run nothing: say how many cases, how long, how many bytes.")
@_SANDBOX
@_NO_REPORT
@_OPEN
def run(
    study: str,
    out: Path | None,
    jobs: int | None,
    only: tuple[str, ...],
    seeds: str | None,
    fresh: bool,
    shard: str,
    executor: str,
    storage: str,
    scheduler: str,
    keep_files: bool,
    dry_run: bool,
    sandbox: bool,
    no_report: bool,
    browse: bool,
) -> None:
    """Run STUDY, a file or the name of a built-in study, and write its report."""
    from ddpc_cosim.cli.run import run_command

    how = {"sandboxed": sandbox, "executor": executor, "scheduler": scheduler, "shard": shard}
    how |= {"storage": storage, "keep_files": keep_files}
    what = {"report": not no_report, "dry_run": dry_run, "browse": browse}
    sys.exit(run_command(study, out, jobs, only, seeds, fresh, how, **what))


@main.command()
@click.argument("study", shell_complete=_names("studies"))
@click.option(
    "--trials", type=click.IntRange(min=1), default=50, show_default=True, help="For each controller."
)
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes [one per processor].")
@click.option("--out", type=_Path(file_okay=False), help="Folder of results [runs/STUDY-tuning].")
@click.option(
    "--objective",
    "objectives",
    multiple=True,
    default=["rmse"],
    show_default=True,
    metavar="METRIC[.SIGNAL][:OVER]",
    help="What to compare by; OVER: median, mean, worst or a quantile. Or `prediction`. May be repeated.",
)
@_ONLY
@click.option("--seeds", metavar="100:103", help="Seeds of the trials [three that the study does not have].")
@click.option(
    "--sampler-seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="With another one other settings are tried.",
)
@click.option(
    "--no-comparison", is_flag=True, help="Do not compare given and found settings on the study's seeds."
)
@_EXECUTOR
@_SCHEDULER
@_SANDBOX
@_NO_REPORT
def tune(
    study: str,
    trials: int,
    jobs: int | None,
    out: Path | None,
    objectives: tuple[str, ...],
    only: tuple[str, ...],
    seeds: str | None,
    sampler_seed: int,
    no_comparison: bool,
    executor: str,
    scheduler: str,
    sandbox: bool,
    no_report: bool,
) -> None:
    """Tune STUDY's controllers, with as many trials for each, and compare with the settings given."""
    from ddpc_cosim.cli.tune import tune_command

    how = {"only": only, "sandboxed": sandbox, "executor": executor, "scheduler": scheduler}
    what = {"compares": not no_comparison, "report": not no_report}
    code = tune_command(study, out, trials, jobs, objectives, seeds, how, sampler_seed, **what)
    sys.exit(code)


@main.command()
@click.argument("folders", nargs=-1, required=True, type=_Path(), metavar="DIR [DIR ...]")
@click.option(
    "--out",
    type=_Path(dir_okay=False, allow_dash=True),
    metavar="FILE",
    help="The report [DIR/report.FORMAT]; - prints it.",
)
@click.option(
    "--format", "form", metavar="html|md|csv|json", help="Of the report [that of FILE's name, or html]."
)
@_OPEN
def report(folders: tuple[Path, ...], out: Path | None, form: str | None, browse: bool) -> None:
    """Rebuild the report of a run, or put several runs into one."""
    from ddpc_cosim.cli.run import report_command

    sys.exit(report_command(folders, out, form, browse=browse))


_TOLERANCE = _FiniteRange(min=0)


@main.command()
@click.argument("folders", nargs=2, type=_Path(), metavar="DIR_A DIR_B")
@click.option(
    "--abs", "absolute", type=_TOLERANCE, default=1e-9, show_default=True, help="Allowed difference."
)
@click.option(
    "--rel",
    "relative",
    type=_TOLERANCE,
    default=1e-6,
    show_default=True,
    help="Allowed difference, relative to the larger value.",
)
def diff(folders: tuple[Path, Path], absolute: float, relative: float) -> None:
    """Compare two runs case by case; exit with 1 if one differs by more than both allow."""
    from ddpc_cosim.cli.diff import diff_command

    sys.exit(diff_command(folders, absolute, relative))


@main.command("list")
@click.argument("kind", required=False, type=_Choice(_LISTED))
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output (JSON).")
def list_(kind: str | None, as_json: bool) -> None:
    """List what is installed, built-in and third-party; a broken plug-in is shown with its error."""
    from ddpc_cosim.cli.listing import list_command

    sys.exit(list_command((kind,) if kind else _LISTED, as_json=as_json))


_FMU = click.argument("fmu", type=_Path(exists=True, dir_okay=False), metavar="FILE.fmu|FILE.ssp")


@main.command()
@_FMU
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output (JSON).")
@click.option("--strict", is_flag=True, help="FMPy's full validation too; slow with thousands of variables.")
@click.option("--all", "every", is_flag=True, help="Show every row of long lists.")
def inspect(fmu: Path, as_json: bool, strict: bool, every: bool) -> None:
    """Show what an FMU or an SSP is, and what is wrong with it; exit with 1 if it cannot run here."""
    from ddpc_cosim.cli.inspect import inspect_command

    sys.exit(inspect_command(fmu, as_json=as_json, strict=strict, every=every))


@main.command()
@_FMU
@click.option(
    "--out",
    type=_Path(dir_okay=False),
    default=Path("study.toml"),
    show_default=True,
    help="The study.",
)
@click.option("--input", "inputs", multiple=True, metavar="NAME", help="Drive this input; may be repeated.")
@click.option("--output", "outputs", multiple=True, metavar="NAME", help="Control this; may be repeated.")
@click.option(
    "--at", multiple=True, metavar="NAME=VALUE", help="Level of an input, or a parameter; may be repeated."
)
@click.option(
    "--range",
    "ranges",
    multiple=True,
    metavar="NAME=LO:HI",
    help="How far an input may go, or an output's setpoints; may be repeated.",
)
@click.option("--sampling-time", type=float, help="Of the loop, in s [what the step test shows].")
@click.option("--duration", type=float, help="Of the loop, in s [what the step test shows].")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@_STEP_TIMEOUT
@click.option(
    "--budget",
    type=_POSITIVE,
    default=60.0,
    show_default=True,
    help="Seconds for step test and trial; what is not tried in them is told.",
)
@_SANDBOX
def init(
    fmu: Path,
    out: Path,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    at: tuple[str, ...],
    ranges: tuple[str, ...],
    sampling_time: float | None,
    duration: float | None,
    force: bool,
    step_timeout: float,
    budget: float,
    sandbox: bool,
) -> None:
    """Write a study for an FMU or an SSP, from a step test, with controllers that were tried on it."""
    from ddpc_cosim.cli.init import init_command

    init_command(
        fmu,
        out,
        at=at,
        ranges=ranges,
        force=force,
        inputs=list(inputs) or None,
        outputs=list(outputs) or None,
        sampling_time=sampling_time,
        duration=duration,
        step_timeout=step_timeout,
        budget=budget,
        sandbox=sandbox,
    )


@main.command()
@click.argument("plant", metavar="FILE.fmu|FILE.ssp|PLANT", shell_complete=_names("plants"))
@click.option(
    "--inputs",
    type=_Path(dir_okay=False),
    metavar="FILE.csv",
    help="Signals of inputs: a column `time`, and one for each input; others keep their start values.",
)
@click.option(
    "--set",
    "values",
    multiple=True,
    metavar="NAME=VALUE",
    help="A parameter or start value, with a unit if it is another one (`length=50 cm`); may be repeated.",
)
@click.option("--stop", type=float, metavar="T", help="End of the run in s [the FMU's default experiment].")
@click.option("--step", type=float, metavar="H", help="Time between samples in s [the FMU's, or 500 steps].")
@click.option(
    "--outputs",
    multiple=True,
    metavar="NAME,...",
    help="Record these; may be repeated [the outputs, else states].",
)
@click.option(
    "--out",
    type=_Path(dir_okay=False),
    metavar="FILE.csv|.html|.svg",
    help="Write samples, a page or a plot; may be repeated.",
    multiple=True,
)
@click.option(
    "--compare",
    "golden",
    type=_Path(dir_okay=False),
    metavar="GOLDEN.csv",
    help="Compare with these samples; exit with 1 if one differs.",
)
@click.option(
    "--rel",
    type=_FiniteRange(min=0, max=1),
    default=1e-4,
    show_default=True,
    help="Allowed difference, relative to a signal's range in the golden file.",
)
@click.option("--fmi-type", type=_Choice(_FMI_TYPES), default="auto", show_default=True)
@_STEP_TIMEOUT
@click.option(
    "--trace-calls",
    type=_Path(dir_okay=False),
    metavar="FILE",
    help="Write every FMI call with its arguments, status and results.",
)
@_SANDBOX
def simulate(**options: Any) -> None:
    """Simulate an FMU, SSP or PLANT in open loop; exit with 1 if it fails or differs from the golden file."""
    from ddpc_cosim.cli.simulate import simulate_command

    try:
        sys.exit(simulate_command(**options))
    except Terminated:
        sys.exit(TERMINATED)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


@main.command()
@click.argument(
    "subject", metavar="NAME|MODULE:CLASS|FILE.fmu", shell_complete=_names("controllers", "plants")
)
@click.option(
    "--sampling-time",
    type=_POSITIVE,
    help="Step size of the runs in s [the FMU's own, or 0.1].",
)
@click.option(
    "--timeout",
    type=_POSITIVE,
    default=60.0,
    show_default=True,
    help="Seconds that one check may take.",
)
@click.option(
    "--setting", "settings", multiple=True, metavar="TOML", help="A controller's setting; may be repeated."
)
@_SANDBOX
def check(
    subject: str, sampling_time: float | None, timeout: float, settings: tuple[str, ...], sandbox: bool
) -> None:
    """Run the conformance kit on a plant or a controller; exit with 1 if a check fails."""
    from ddpc_cosim.cli.check import check_command

    sys.exit(check_command(subject, sampling_time, timeout, settings, sandboxed=sandbox))


_FMI = click.option(
    "--fmi", type=_Choice(["2.0", "3.0"]), default="2.0", show_default=True, help="FMI version."
)
_PLATFORMS = click.option("--platforms", metavar="all|NAME,...", help="Platforms to compile for [this one].")


@main.command()
@click.argument("plant", shell_complete=_names("plants"))
@_FMI
@_PLATFORMS
@click.option("--out", type=_Path(dir_okay=False), help="The FMU [PLANT.fmu].")
def export(plant: str, fmi: str, platforms: str | None, out: Path | None) -> None:
    """Export PLANT (a name from `list plants`, module:MODEL or file.py:MODEL) as an FMU."""
    from ddpc_cosim.cli.export import export_command

    export_command(plant, fmi, out, platforms)


@main.command()
def schema() -> None:
    """Print the JSON Schema of study files, for editors; it knows what is installed here."""
    import json

    from ddpc_cosim.study.file_format.schema import study_schema

    click.echo(json.dumps(study_schema(), indent=2))


@main.command("export-controller")
@click.argument("study", shell_complete=_names("studies"))
@click.option("--controller", required=True, metavar="NAME", help="Its name in the study.")
@click.option("--out", type=_Path(dir_okay=False), metavar="FILE.fmu", help="The FMU [NAME.fmu].")
@_FMI
@_PLATFORMS
@click.option("--problem", metavar="NAME", help="Where the study has several.")
@click.option("--scenario", metavar="NAME", help="Whose experiment, bounds and preview [the first].")
@click.option("--seed", type=click.IntRange(min=0), help="Of the experiment [the study's first].")
@_SANDBOX
def export_controller(
    study: str, controller: str, out: Path | None, fmi: str, platforms: str | None, sandbox: bool, **case: Any
) -> None:
    """Export a controller of STUDY, as it is after its experiment, as an FMU in plain C."""
    from ddpc_cosim.cli.export import export_controller_command

    export_controller_command(study, controller, out, fmi, platforms, sandboxed=sandbox, **case)
