"""``ddpc-cosim check``: the conformance kit from the command line."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import argument, command, names_of, option
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.files.texts import printable

if TYPE_CHECKING:
    from ddpc_cosim.testing.check_results import CheckResult

_STYLE = {"passed": "green", "failed": "red", "not applicable": "dim"}


@command
def check(
    subject: str = argument(
        metavar="NAME|MODULE:CLASS|FILE.fmu", shell_complete=names_of("controllers", "plants")
    ),
    sampling_time: float | None = option(
        None, "Step size of the runs in s [the FMU's own, or 0.1].", type=options.POSITIVE
    ),
    timeout: float = option(
        60.0, "Seconds that one check may take.", type=options.POSITIVE, show_default=True
    ),
    settings: tuple[str, ...] = option(
        (), "A controller's setting; may be repeated.", name="--setting", metavar="TOML"
    ),
    sandbox: bool = options.SANDBOX,
) -> int:
    """Run the conformance kit on a plant or a controller; exit with 1 if a check fails."""
    from ddpc_cosim.plugins import find_modules_in
    from ddpc_cosim.processes.sandbox import require
    from ddpc_cosim.testing.check_results import CheckStatus
    from ddpc_cosim.testing.subjects import find_subject, natural_step, run_checks

    find_modules_in(Path.cwd())
    if sandbox:
        require()
    with shown(f"check {subject}") as progress:
        checked = find_subject(subject, settings, timeout)
        step = sampling_time or natural_step(checked)
        results = run_checks(
            checked,
            step,
            timeout,
            progress.prepare,
            lambda name: progress(f"{subject}: {name}"),
            sandboxed=sandbox,
        )
    _print(f"{subject}, steps of {step:g} s", results)
    return 1 if any(result.status is CheckStatus.FAILED for result in results) else 0


def _print(title: str, results: "list[CheckResult]") -> None:
    from rich.console import Console

    from ddpc_cosim.cli.output import terminal_table
    from ddpc_cosim.files.tables import Cell, Heading, Row, Table, text_headings

    console = Console()
    if not console.is_terminal:
        for result in results:
            click.echo(f"{result.status}\t{result.name}\t{printable(result.reason)}".rstrip())
        return
    headings = (*text_headings("check", "result"), Heading("why", numeric=False, wraps=True))
    rows = (
        Row(result.name, (Cell(result.status, tone=_STYLE[result.status]), Cell(result.reason)))
        for result in results
    )
    console.print(terminal_table(Table("", title, headings, tuple(rows))))
