"""``ddpc-cosim tune``."""

import os
import shlex
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import command, option, parse_seeds
from ddpc_cosim.cli.output import say, warnings_in_one_line
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import MissingLibraryError
from ddpc_cosim.files.texts import printable

if TYPE_CHECKING:
    from ddpc_cosim.tuning import Request, Tuned
    from ddpc_cosim.tuning.search import Trial


@command
def tune(
    study: str = options.STUDY,
    trials: int = option(50, "For each controller.", type=options.AT_LEAST_1, show_default=True),
    jobs: int | None = options.JOBS,
    out: Path | None = option(None, "Folder of results [runs/STUDY-tuning].", type=options.FOLDER),
    objectives: tuple[str, ...] = option(
        ("rmse",),
        "What to compare by; OVER: median, mean, worst or a quantile. Or `prediction`. May be repeated.",
        name="--objective",
        metavar="METRIC[.SIGNAL][:OVER]",
        show_default=True,
    ),
    only: tuple[str, ...] = options.ONLY,
    seeds: str | None = option(
        None, "Seeds of the trials [three that the study does not have].", metavar="100:103"
    ),
    sampler_seed: int = option(
        0, "With another one other settings are tried.", type=click.IntRange(min=0), show_default=True
    ),
    no_comparison: bool = option(False, "Do not compare given and found settings on the study's seeds."),
    executor: options.Executor = options.EXECUTOR,
    scheduler: str = options.SCHEDULER,
    engine: options.Engine = options.ENGINE,
    sandbox: bool = options.SANDBOX,
    no_report: bool = options.NO_REPORT,
) -> int:
    """Tune STUDY's controllers, with as many trials for each, and compare with the settings given."""
    if find_spec("optuna") is None:
        raise MissingLibraryError.of("tune", "Optuna", "tune")
    from ddpc_cosim.cli.results import show_results
    from ddpc_cosim.study.reading import read_study
    from ddpc_cosim.study.runner import Selection
    from ddpc_cosim.tuning import TUNED_FILE, Request, tune_study
    from ddpc_cosim.tuning.objectives import Objective

    said = ["ddpc-cosim", "tune", study, "--trials", str(trials)]
    said += [word for objective in objectives for word in ("--objective", objective)]
    said += ["--seeds", seeds] if seeds else []
    said += ["--sampler-seed", str(sampler_seed)] if sampler_seed else []
    said += [word for pattern in only for word in ("--only", pattern)]
    request = Request(
        tuple(map(Objective.parse, objectives)),
        trials,
        parse_seeds(seeds),
        shlex.join(said),
        sampler_seed,
        not no_comparison,
    )
    selection = Selection(
        jobs or os.cpu_count() or 1,
        only=only,
        sandboxed=sandbox,
        executor=executor,
        scheduler=scheduler,
        engine=engine or "",
    )
    with shown(f"reading {study}") as progress, warnings_in_one_line():
        resolved = read_study(study)
        folder = out or Path("runs") / f"{resolved.head.name}-tuning"
        tuned = tune_study(resolved, folder, request, selection, progress)
    _print_found(tuned, request, named=not resolved.whole.is_flat)
    print(printable(str(folder / TUNED_FILE)))
    return show_results(tuned.results, report=not no_report) if tuned.results else 0


def _print_found(tuned: "Tuned", request: "Request", *, named: bool) -> None:
    """Print the settings found, and how much better they are, on the seeds of the trials and held out."""
    from ddpc_cosim.tuning.search import best

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


def _figures(given: "Trial", best: "Trial", request: "Request") -> str:
    from ddpc_cosim.metrics import metric_name

    pairs = zip(request.objectives, given.values, best.values, strict=True)
    figures = [f"{metric_name(objective.metric)} {old:.4g} -> {new:.4g}" for objective, old, new in pairs]
    return ", ".join([*figures, f"runs failed {given.failed} -> {best.failed} of {best.runs}"])
