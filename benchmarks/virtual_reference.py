"""PID tuned by a virtual reference against PID tuned by SIMC, from the same noisy recordings: ten problems.

They are the first ten of the study `benchmark` under measurement noise, in the recording and in the loop, and
those of `reactor` and `mimo` with as much. Every seed has its own recording. The figures are those by which
the studies rank, one of each output. A problem is worse if more of its runs fail; if as many fail, where the
paired differences tell it of an output, or an output's median is worse by more than the smallest difference
that matters. Failures come first, as in every ranking: runs that both complete are the easier ones of whoever
fails more. Problems that both tunings fail on throughout do not count.

    python -m benchmarks.virtual_reference --seeds 12
"""

import argparse
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import NamedTuple

from ddpc_cosim import Study
from ddpc_cosim.study.verdicts.baselines import Verdict, against
from ddpc_cosim.study.verdicts.findings import Findings

PROBLEMS, WORSE_AT_MOST = 10, 1
BASELINE, TUNED = "step-test", "virtual-reference"
STUDY = f"""
name = "{TUNED}"
extends = "benchmark"
report = false

[controllers]
{{others}}
{BASELINE} = {{{{ type = "pid", settings = {{{{ tuning = "{BASELINE}" }}}} }}}}
{TUNED} = {{{{ type = "pid", settings = {{{{ tuning = "{TUNED}" }}}} }}}}

[problems]
{{left_out}}

[problems.reactor]
study = "reactor"
scenarios.noise = {{{{ noise = {{{{ temperature = 0.1 }}}} }}}}

[problems.mimo]
study = "mimo"
scenarios.noise = {{{{ noise = {{{{ level_1 = 0.05, level_2 = 0.05 }}}} }}}}
"""


class Figure(NamedTuple):
    """An output of a problem: its figure over that of SIMC, what the seeds tell, and whether it is worse."""

    name: str
    ratio: float
    verdict: str
    is_worse: bool


def figures(findings: Findings) -> Iterator[Figure]:
    """Yield what a problem shows; nothing where no runs of both completed."""
    standings = findings.standings
    failed = standings.failed
    if not {BASELINE, TUNED} <= failed.keys():  # no scenario counts in which all fail
        return
    for key in standings.keys:
        compared = against(standings, key, BASELINE, TUNED)
        if compared is None or compared.verdict == Verdict.UNKNOWN:
            continue
        pairs = [standings.runs[key][name] for name in (TUNED, BASELINE)]
        shared = [run for run, value in pairs[0].items() if math.isfinite(value + pairs[1][run])]
        tuned, base = (median(runs[run] for run in shared) for runs in pairs)
        worse = compared.verdict == Verdict.WORSE or tuned - base > standings.relevant_differences[key]
        more = failed[TUNED] - failed[BASELINE]
        yield Figure(key, tuned / base, compared.verdict, more > 0 or (worse and more == 0))


def main() -> bool:
    """Print the table; return whether enough problems count and few enough of them are worse."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--scenario", default="noise")
    given = parser.parse_args()
    benchmark = Study.read("benchmark")
    others = "\n".join(f"{name} = false" for name in benchmark.controllers)
    left_out = "\n".join(f"{name} = false" for name in [*benchmark.problems][PROBLEMS:])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "study.toml"
        file.write_text(STUDY.format(others=others, left_out=left_out), encoding="utf-8")
        findings_by_problem = (
            Study.read(file)
            .run(
                Path(folder) / "results",
                only=f"*_{given.scenario}_*",
                seeds=range(given.seeds),
                jobs=given.jobs,
                progress=False,
            )
            .findings()
        )
    worse: dict[str, bool] = {}
    for problem, findings in findings_by_problem.items():
        failed = findings.standings.failed
        for figure in figures(findings):
            worse[problem] = worse.get(problem, False) or figure.is_worse
            print(
                f"{problem:20s} {figure.name:38s} {figure.ratio:6.3f} of {BASELINE}  {figure.verdict:26s} "
                f"failed {failed[TUNED]} and {failed[BASELINE]} of {given.seeds}{'  WORSE' * figure.is_worse}"
            )
        if problem not in worse:
            print(f"{problem:20s} no run that both complete: does not count")
    count = sum(worse.values())
    print(f"worse on {count} of {len(worse)} problems; allowed {WORSE_AT_MOST} of {PROBLEMS}")
    return len(worse) >= PROBLEMS and count <= WORSE_AT_MOST


if __name__ == "__main__":
    raise SystemExit(0 if main() else 1)
