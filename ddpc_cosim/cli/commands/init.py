"""``ddpc-cosim init``: a study for a supplied FMU, or for logs, from what is tried on it."""

import warnings
from pathlib import Path
from typing import Any

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import assignments, command, option
from ddpc_cosim.cli.output import say
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError, CosimWarning

_TABLES = (".csv", ".txt")


@command
def init(
    fmus: tuple[Path, ...] = options.FMUS,
    out: Path = option(Path("study.toml"), "The study.", show_default=True),
    inputs: tuple[str, ...] = option(
        (), "Drive this input; may be repeated.", name="--input", metavar="NAME"
    ),
    outputs: tuple[str, ...] = option((), "Control this; may be repeated.", name="--output", metavar="NAME"),
    disturbances: tuple[str, ...] = option(
        (), "A column of a log that acts from outside; may be repeated.", name="--disturbance", metavar="NAME"
    ),
    at: tuple[str, ...] = option(
        (),
        "Level of an input, or a parameter, or a file of them; may be repeated.",
        metavar="NAME=VALUE|FILE.csv",
    ),
    ranges: tuple[str, ...] = option(
        (),
        "How far an input may go, or an output's setpoints; may be repeated.",
        name="--range",
        metavar="NAME=LO:HI[ UNIT]",
    ),
    sampling_time: float | None = option(None, "Of the loop, in s [what the step test shows]."),
    duration: float | None = option(None, "Of the loop, in s [what the step test shows]."),
    force: bool = option(False, "Replace an existing file."),
    step_timeout: float = options.STEP_TIMEOUT,
    budget: float = option(
        60.0,
        "Seconds of CPU time for step test and trial; what is not tried in them is told.",
        type=options.POSITIVE,
        show_default=True,
    ),
    sandbox: bool = options.SANDBOX,
    library_path: tuple[Path, ...] = options.LIBRARY_PATH,
) -> int:
    """Write a study for an FMU, an SSP, FMUs that it connects, or logs; its controllers were tried on it."""
    from ddpc_cosim.suggestion.values import number_or_text

    files = [Path(text) for text in at if "=" not in text and text.lower().endswith(_TABLES)]
    levels = assignments("--at", [text for text in at if Path(text) not in files], number_or_text)
    limits = assignments("--range", ranges, _limits)
    if out.exists() and not force:  # before the step test, which may take a while
        raise ConfigError(f"{out}: already exists; choose another --out, or --force to replace it")
    with warnings.catch_warnings(), shown(f"init {' '.join(fmu.name for fmu in fmus)}") as progress:
        from ddpc_cosim.suggestion import suggest_study, write_study

        warnings.simplefilter("ignore", CosimWarning)  # they stand in the study
        proposal = suggest_study(
            fmus,
            inputs=list(inputs) or None,
            outputs=list(outputs) or None,
            disturbances=disturbances,
            at=[*files, levels],
            ranges=limits,
            sampling_time=sampling_time,
            duration=duration,
            step_timeout=step_timeout,
            budget=budget,
            tell=progress,
            sandbox=sandbox,
            library_path=library_path,
        )
        path = write_study(proposal, fmus, out, replace=force)
    driven, controlled = (", ".join(v.name for v in s) for s in (proposal.inputs, proposal.outputs))
    say(f"{path}: {controlled} by {driven}, every {proposal.sampling_time:g} s")
    for line in proposal.comments.get("head", ()):
        say(line)
    say(f"run it: ddpc-cosim run {path}")
    return 0


def _limits(text: str) -> Any:
    """Return a range as two numbers; one in a unit, or to be refused with other faults, unchanged."""
    from ddpc_cosim.suggestion.values import number_or_text

    parts = [number_or_text(part) for part in text.split(":")]
    return tuple(parts) if len(parts) == 2 and not any(isinstance(part, str) for part in parts) else text
