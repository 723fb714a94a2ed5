"""``ddpc-cosim tune``."""

import os
import shlex
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ddpc_cosim.cli.output import say
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.cli.run import parse_seeds, show_results, warnings_in_one_line
from ddpc_cosim.errors import MissingLibraryError
from ddpc_cosim.metrics import metric_name
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection
from ddpc_cosim.texts import printable
from ddpc_cosim.tuning import TUNED_FILE, Request, Tuned, tune_study
from ddpc_cosim.tuning.objectives import Objective
from ddpc_cosim.tuning.search import Trial, best


def tune_command(
    name: str,
    out: Path | None,
    trials: int,
    jobs: int | None,
    objectives: Sequence[str],
    seeds: str | None,
    how: Mapping[str, Any],
    sampler_seed: int,
    *,
    compares: bool,
    report: bool,
) -> int:
    """Tune a study, print what was found and the paths of study and report, and return the exit code.

    ``how`` are other fields of :class:`Selection`.

    Raises
    ------
    MissingLibraryError
        Optuna is not installed.
    ConfigError
        Nothing can be tuned so.
    """
    if find_spec("optuna") is None:
        raise MissingLibraryError.of("tune", "Optuna", "tune")
    said = ["ddpc-cosim", "tune", name, "--trials", str(trials)]
    said += [word for objective in objectives for word in ("--objective", objective)]
    said += ["--seeds", seeds] if seeds else []
    said += ["--sampler-seed", str(sampler_seed)] if sampler_seed else []
    said += [word for pattern in how["only"] for word in ("--only", pattern)]
    request = Request(
        tuple(map(Objective.parse, objectives)),
        trials,
        parse_seeds(seeds),
        shlex.join(said),
        sampler_seed,
        compares,
    )
    selection = Selection(jobs or os.cpu_count() or 1, **how)
    with shown(f"reading {name}") as progress, warnings_in_one_line():
        resolved = read_study(name)
        folder = out or Path("runs") / f"{resolved.head.name}-tuning"
        tuned = tune_study(resolved, folder, request, selection, progress)
    _print_found(tuned, request, named=not resolved.whole.is_flat)
    print(printable(str(folder / TUNED_FILE)))
    return show_results(tuned.results, report=report) if tuned.results else 0


def _print_found(tuned: Tuned, request: Request, *, named: bool) -> None:
    """Print the settings found, and how much better they are, on the seeds of the trials and held out."""
    for (problem, controller), trials in tuned.trials.items():
        number = best(trials)
        settings = ", ".join(f"{name} = {value!r}" for name, value in trials[number].settings.items())
        origin = trials[number].origin
        which = origin if not number else f"trial {number} of 0 to {len(trials) - 1}, {origin}"
        figures = [_figures(trials[0], trials[number], request)]
        if again := tuned.held_out.get((problem, controller)):
            figures.append(f"held out: {_figures(*again, request)}")
        who = f"{problem}, {controller}" if named else controller
        say(f"{who}: {settings} ({'; '.join([which, *figures])})")
        if ends := tuned.at_ends[problem, controller]:
            say(f"{who}: {', '.join(ends)}: at an end of where was looked; a wider search may find others")
    for problem, controller in tuned.kept:
        who = f"{problem}, {controller}" if named else controller
        say(f"{who}: nothing to search, left as it is")


def _figures(given: Trial, found: Trial, request: Request) -> str:
    pairs = zip(request.objectives, given.values, found.values, strict=True)
    figures = [f"{metric_name(objective.metric)} {old:.4g} -> {new:.4g}" for objective, old, new in pairs]
    return ", ".join([*figures, f"runs failed {given.failed} -> {found.failed} of {found.runs}"])
