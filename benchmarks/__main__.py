"""Run a benchmark by name; exit 1 if it misses one of its bounds. ``tuning STUDY`` prints settings."""

import argparse
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from benchmarks import (
    cases,
    coupling,
    exported,
    fmu,
    inspection,
    isolation,
    mfapc,
    online,
    page,
    peers,
    step,
    tuning,
)

BENCHMARKS: Mapping[str, Callable[[], bool]] = {
    "cases": cases.main,
    "coupling": coupling.main,
    "exported": exported.main,
    "fmu": fmu.main,
    "inspect": inspection.main,
    "isolation": isolation.main,
    "mfapc": mfapc.main,
    "online": online.main,
    "page": page.main,
    "peers": peers.main,
    "step": step.main,
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__, allow_abbrev=False)
    commands = parser.add_subparsers(dest="name", required=True, metavar="NAME")
    for name in BENCHMARKS:
        commands.add_parser(name, help="print a table")
    command = commands.add_parser("tuning", help="search the settings of a comparative study's controllers")
    command.add_argument("study", choices=tuning.STUDIES)
    command.add_argument("--out", type=Path, help="folder of the trials; default: runs/STUDY-tuning")
    command.add_argument("--jobs", type=int, default=1, help="number of workers")
    command.add_argument("--shown", type=int, default=1, help="how many settings of each controller to print")
    given = parser.parse_args()
    if given.name == "tuning":
        tuning.main(given.study, given.out or Path("runs") / f"{given.study}-tuning", given.jobs, given.shown)
        return 0
    return 0 if BENCHMARKS[given.name]() else 1


if __name__ == "__main__":
    sys.exit(main())
