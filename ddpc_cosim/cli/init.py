"""``ddpc-cosim init``."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import click

from ddpc_cosim.errors import ConfigError, CosimWarning
from ddpc_cosim.suggestion import suggest_study, write_study


def init_command(
    fmu: Path, out: Path, inputs: Sequence[str], outputs: Sequence[str], *, force: bool, step_timeout: float
) -> None:
    """Write a study for an FMU and say what to do with it."""
    if out.exists() and not force:  # before the step test, which may take a while
        raise ConfigError(f"{out}: is there already; choose another --out, or --force to replace it")
    click.echo(f"step test of {fmu.name} ...", err=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CosimWarning)  # they stand in the study
        proposal = suggest_study(
            fmu, inputs=list(inputs) or None, outputs=list(outputs) or None, step_timeout=step_timeout
        )
        path = write_study(proposal, fmu, out, replace=force)
    driven, controlled = (", ".join(v.name for v in s) for s in (proposal.inputs, proposal.outputs))
    click.echo(f"{path}: {controlled} by {driven}, every {proposal.sampling_time:g} s")
    click.echo(f"run it: ddpc-cosim run {path}")
