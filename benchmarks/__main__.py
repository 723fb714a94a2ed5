"""Run a benchmark by name; exit 1 if it misses one of its bounds."""

import argparse
import sys
from collections.abc import Callable, Mapping

from benchmarks import (
    cases,
    compiled,
    coupling,
    environment,
    exported,
    fmu,
    identified,
    inspection,
    isolation,
    mfapc,
    online,
    page,
    peers,
    proposals,
    step,
)

BENCHMARKS: Mapping[str, Callable[[], bool]] = {
    "cases": cases.main,
    "compiled": compiled.main,
    "coupling": coupling.main,
    "environment": environment.main,
    "exported": exported.main,
    "fmu": fmu.main,
    "identified": identified.main,
    "inspect": inspection.main,
    "isolation": isolation.main,
    "mfapc": mfapc.main,
    "online": online.main,
    "page": page.main,
    "peers": peers.main,
    "proposals": proposals.main,
    "step": step.main,
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__, allow_abbrev=False)
    commands = parser.add_subparsers(dest="name", required=True, metavar="NAME")
    for name in BENCHMARKS:
        commands.add_parser(name, help="print a table")
    return 0 if BENCHMARKS[parser.parse_args().name]() else 1


if __name__ == "__main__":
    sys.exit(main())
