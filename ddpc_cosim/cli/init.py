"""The ``init`` command: a study for a supplied FMU, from what is tried on it."""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from ddpc_cosim.cli.output import say
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError, CosimWarning

T = TypeVar("T")


def init_command(
    fmu: Path, out: Path, *, at: Sequence[str], ranges: Sequence[str], force: bool, **wanted: Any
) -> None:
    """Write a study for an FMU.

    Parameters
    ----------
    fmu, out : Path
        The FMU and the file to write.
    at, ranges : sequence of str
        ``NAME=VALUE`` and ``NAME=LO:HI``.
    force : bool
        Whether an existing file may be replaced.
    wanted : Any
        Further keywords of :func:`ddpc_cosim.suggestion.suggest_study`.
    """
    levels = assignments("--at", at, number_or_text)
    limits = assignments("--range", ranges, _limits)
    if out.exists() and not force:  # before the step test, which may take a while
        raise ConfigError(f"{out}: already exists; choose another --out, or --force to replace it")
    with warnings.catch_warnings(), shown(f"init {fmu.name}") as progress:
        from ddpc_cosim.suggestion import suggest_study, write_study  # takes a while itself

        warnings.simplefilter("ignore", CosimWarning)  # they stand in the study
        proposal = suggest_study(fmu, at=levels, ranges=limits, tell=progress, **wanted)
        path = write_study(proposal, fmu, out, replace=force)
    driven, controlled = (", ".join(v.name for v in s) for s in (proposal.inputs, proposal.outputs))
    say(f"{path}: {controlled} by {driven}, every {proposal.sampling_time:g} s")
    for line in proposal.comments.get("head", ()):
        say(line)
    say(f"run it: ddpc-cosim run {path}")


def assignments(option: str, texts: Sequence[str], value_of: Callable[[str], T]) -> dict[str, T]:
    """Return what an option that is repeated as ``NAME=VALUE`` says, by name.

    Raises
    ------
    ConfigError
        A text is not of this form, or a name is given twice; all of them at once.
    """
    values: dict[str, T] = {}
    faults = []
    for text in texts:
        name, equals, value = text.rpartition("=")
        name = name.strip()
        if not (equals and name and value):
            faults.append(f'{option} "{text}" is not possible; needed: NAME=VALUE')
        elif name in values:
            faults.append(f"{option}: {name} is given more than once")
        else:
            values[name] = value_of(value)
    if faults:
        raise ConfigError(faults)
    return values


def number_or_text(text: str) -> float | str:
    """Return a text as a number if it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def _limits(text: str) -> Any:
    """Return a range as two numbers, or as what it is, which will be refused together with other faults."""
    parts = [number_or_text(part) for part in text.split(":")]
    return tuple(parts) if len(parts) == 2 and not any(isinstance(part, str) for part in parts) else text
