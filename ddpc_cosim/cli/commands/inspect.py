"""``ddpc-cosim inspect``."""

import json
import sys
from functools import partial
from pathlib import Path

import click

from ddpc_cosim.cli.options import FMU, JSON, LIBRARY_PATH, command, option


@command
def inspect(
    fmu: Path = FMU,
    as_json: bool = JSON,
    strict: bool = option(False, "FMPy's full validation too; slow with thousands of variables."),
    library_path: tuple[Path, ...] = LIBRARY_PATH,
    every: bool = option(False, "Show every row of long lists.", name="--all"),
) -> int:
    """Show what an FMU or an SSP is, and what is wrong with it; exit with 1 if it cannot run here."""
    from rich.console import Console

    from ddpc_cosim.cli.inspection import plain_lines, print_tables
    from ddpc_cosim.cli.output import say
    from ddpc_cosim.inspection import Inspection, as_data, inspect_fmu, systems

    is_system = fmu.suffix.lower() == ".ssp"
    tell = partial(say, err=True)
    inspection = (
        systems.inspect_ssp(fmu, library_path, tell)
        if is_system
        else inspect_fmu(fmu, strict=strict, library_path=library_path, tell=tell)
    )
    if as_json:
        data = as_data(inspection) if isinstance(inspection, Inspection) else systems.as_data(inspection)
        # Part by part: as one text it would take more memory than its content.
        sys.stdout.writelines(json.JSONEncoder(indent=2, allow_nan=False).iterencode(data))
        click.echo()
    elif (console := Console()).is_terminal:
        print_tables(console, inspection, every=every)
    else:
        for line in plain_lines(inspection):
            click.echo(line)
    return 0 if inspection.can_run else 1
