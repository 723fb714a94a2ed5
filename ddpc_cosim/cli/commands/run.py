"""``ddpc-cosim run``."""

import os
from pathlib import Path
from typing import Literal

from ddpc_cosim.cli import options
from ddpc_cosim.cli.options import command, option, parse_seeds
from ddpc_cosim.cli.output import say, warnings_in_one_line
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError


@command
def run(
    study: str = options.STUDY,
    out: Path | None = option(None, "Folder of results [runs/STUDY].", type=options.FOLDER),
    jobs: int | None = options.JOBS,
    only: tuple[str, ...] = options.ONLY,
    seeds: str | None = option(None, "Seeds in place of the study's: 7, 0:30 or 5489,0:30.", metavar="0:30"),
    fresh: bool = option(False, "Run cases again that already exist."),
    shard: str = option("1/1", "Every N-th case from the I-th on; no report.", metavar="I/N"),
    executor: options.Executor = options.EXECUTOR,
    scheduler: str = options.SCHEDULER,
    storage: Literal["csv", "parquet"] = option(
        "csv", "File of each case's samples [csv]; parquet needs pyarrow."
    ),
    engine: options.Engine = options.ENGINE,
    keep_files: bool = option(False, "Keep what each case leaves in its working directory."),
    dry_run: bool = option(False, "Only say how many cases, how long, how many bytes."),
    sandbox: bool = options.SANDBOX,
    no_report: bool = options.NO_REPORT,
    browse: bool = options.OPEN,
) -> int:
    """Run STUDY, a file or the name of a built-in study, and write its report."""
    from ddpc_cosim.cli.results import show_results
    from ddpc_cosim.study.reading import read_study
    from ddpc_cosim.study.runner import Selection, run_study
    from ddpc_cosim.study.running.dry_run import expected

    if browse and no_report:
        raise ConfigError("--open: with --no-report there is nothing to open")
    selection = Selection(
        jobs or os.cpu_count() or 1,
        parse_seeds(seeds),
        only,
        fresh,
        sandboxed=sandbox,
        executor=executor,
        scheduler=scheduler,
        shard=shard,
        storage=storage,
        keep_files=keep_files,
        engine=engine or "",
    )
    with shown(f"reading {study}") as progress:
        with warnings_in_one_line():
            resolved = read_study(study)
        folder = out or Path("runs") / resolved.head.name
        with warnings_in_one_line():
            if dry_run:
                would_be = expected(resolved, folder, selection, progress)
            else:
                results = run_study(resolved, folder, selection, progress)
    if dry_run:  # what is printed while progress is shown is dropped
        say(would_be, keep="\n")
        return 0
    if selection.is_part:
        count = f"{len(results.cases)} {'case' if len(results.cases) == 1 else 'cases'}"
        print(f"shard {selection.shard}: {count}; metrics.csv and report: run without --shard after the last")
    is_part = selection.is_part
    return show_results(results, report=not (no_report or is_part), browse=browse, is_part=is_part)
