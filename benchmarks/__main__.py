"""Run a benchmark by name; exit 1 if it misses one of its bounds."""

import argparse
import sys
from collections.abc import Callable, Mapping

from benchmarks import fmu, inspection, isolation, mfapc, online, peers, step

BENCHMARKS: Mapping[str, Callable[[], bool]] = {
    "fmu": fmu.main,
    "inspect": inspection.main,
    "isolation": isolation.main,
    "mfapc": mfapc.main,
    "online": online.main,
    "peers": peers.main,
    "step": step.main,
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__, allow_abbrev=False)
    parser.add_argument("name", choices=sorted(BENCHMARKS), help="what to measure")
    return 0 if BENCHMARKS[parser.parse_args().name]() else 1


if __name__ == "__main__":
    sys.exit(main())
