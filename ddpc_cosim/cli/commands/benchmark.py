"""``ddpc-cosim benchmark``: a method of one's own in a benchmark, a submission verified, the leaderboard."""

import os
import secrets
import shlex
from pathlib import Path

import click

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import FiniteRange, PathType, argument, command, option, parse_seeds
from ddpc_cosim.cli.output import say, warnings_in_one_line
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.files.texts import printable

_BENCHMARK = option(
    "benchmark", "The benchmark: a study.", name="--study", metavar="STUDY", show_default=True
)
_SUBMISSION = PathType(exists=True, file_okay=False)


@command
def enter(
    target: str = argument(metavar="FILE.py:CLASS|NAME"),
    study: str = _BENCHMARK,
    problems: tuple[str, ...] = option(
        (), "Only these of its problems; may be repeated.", name="--problem", metavar="GLOB"
    ),
    trials: int | None = option(
        None, "Settings that are tried [as many as for its own methods].", type=options.AT_LEAST_1
    ),
    seeds: str | None = option(None, "Seeds of the trials [those of its own methods].", metavar="100:102"),
    jobs: int | None = options.JOBS,
    out: Path | None = option(None, "Folder of the submission [runs/STUDY-NAME].", type=options.FOLDER),
    no_report: bool = options.NO_REPORT,
) -> int:
    """Tune a controller as a benchmark's own methods were, run it on their terms, and write a submission."""
    from ddpc_cosim.benchmarking.submission import Budget, enter as enter_benchmark
    from ddpc_cosim.cli.results import show_results
    from ddpc_cosim.study.runner import Selection

    words = [
        "ddpc-cosim",
        "benchmark",
        "enter",
        target,
        *(["--study", study] if study != "benchmark" else []),
    ]
    words += [word for pattern in problems for word in ("--problem", pattern)]
    words += ["--trials", str(trials)] if trials else []
    words += ["--seeds", seeds] if seeds else []
    with shown(f"reading {study}") as progress, warnings_in_one_line():
        results = enter_benchmark(
            target,
            study,
            problems,
            out,
            Budget(trials, parse_seeds(seeds)),
            Selection(jobs or os.cpu_count() or 1),
            progress,
            shlex.join(words),
        )
    code = show_results(results, report=not no_report)
    print(printable(str(results.folder.parent)))
    return code


@command
def verify(
    folder: Path = argument(type=_SUBMISSION, metavar="FOLDER"),
    study: str = _BENCHMARK,
    share: float = option(
        0.1,
        "Of the runs of each problem, how many are run again: all are compared with the plant's.",
        type=FiniteRange(min=0, max=1),
        show_default=True,
    ),
    seed: int | None = option(None, "Of their choice [any].", type=click.IntRange(min=0)),
    jobs: int | None = options.JOBS,
    sandbox: bool = options.SANDBOX,
) -> int:
    """Check all that a submission says; exit with 1 at the first that is not so. Runs the code in it."""
    from ddpc_cosim.benchmarking.verification import RefusedError, verify as verify_submission
    from ddpc_cosim.study.runner import Selection

    selection = Selection(jobs or os.cpu_count() or 1, sandboxed=sandbox)
    chosen = secrets.randbelow(1 << 31) if seed is None else seed
    try:
        with shown(f"reading {folder}") as progress, warnings_in_one_line():
            done = verify_submission(folder, study, share, chosen, selection, progress)
    except RefusedError as error:
        say(f"refused: {error}")
        return 1
    say(
        f"accepted: {done.files} files are what was sealed; of {done.cases} runs figures are those of their "
        f"samples and samples those of the plant; {done.again} were run again (--seed {done.seed}). Times of "
        "computation are not verified."
    )
    return 0


@command
def page(
    folders: tuple[Path, ...] = argument(type=_SUBMISSION, metavar="FOLDER [FOLDER ...]"),
    out: Path = option(
        Path("leaderboard.html"), "The page.", type=options.FILE, metavar="FILE", show_default=True
    ),
    browse: bool = options.OPEN,
) -> int:
    """Write the leaderboard of submissions to one benchmark, as one page. Verifies none of them."""
    from ddpc_cosim.benchmarking.leaderboard import leaderboard
    from ddpc_cosim.cli.results import write_and_open
    from ddpc_cosim.study.results import HTML

    with shown("reading results"), warnings_in_one_line():
        results = leaderboard(folders)
    write_and_open([results], out, HTML, browse=browse)
    return 0


benchmark = click.Group(
    "benchmark",
    commands=[enter, verify, page],
    help="Enter a benchmark with a method of your own, verify a submission, write the leaderboard.",
)
