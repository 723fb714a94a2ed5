"""Closed loops in C beside the same ones in Python: the samples alone, and all of a case but its files.

CPU time of this process, the least of several repetitions. What both engines do alike, before and after the
samples, is what a compiled case takes beyond its calls of the compiled loop.
"""

from collections.abc import Callable
from dataclasses import replace
from time import process_time

from benchmarks.step import Row, print_header, print_rows
from ddpc_cosim import Trace
from ddpc_cosim.compiled.engine import CompiledRun
from ddpc_cosim.study.cases import Case, run_case
from ddpc_cosim.study.objects import Silent
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection, selected_cases
from ddpc_cosim.variables import FloatArray

REPETITIONS = 7
METHODS = ("deepc", "mfapc", "wkpc")
"""Of the study `paper`: 401 samples each."""
_SAMPLES, _CASE = 20.0, 1.2


def main() -> bool:
    """Print the table; return whether all bounds are held."""
    print_header()
    rows = []
    for case in selected_cases(read_study("paper"), Selection(seeds=[0], only=METHODS), Silent())[1]:
        python, _ = _least(case)
        compiled, in_c = _least(replace(case, engine="compiled"))
        in_python = python - (compiled - in_c)
        rows += [
            Row(f"{case.label}: all samples of a case", in_c, in_python, in_python / in_c, _SAMPLES),
            Row(f"{case.label}: a case", compiled, python, python / compiled, _CASE),
        ]
    return print_rows(rows)


def _least(case: Case) -> tuple[float, float]:
    """Return the CPU time of a case, and of its calls of the compiled loop [us], the least of repetitions."""
    wholes, parts = [], []
    for _ in range(REPETITIONS):
        seconds = [0.0]
        advance = CompiledRun.advance

        def timed(
            run: CompiledRun,
            begin: int,
            end: int,
            *,
            hold_last: bool,
            seconds: list[float] = seconds,
            advance: Callable[..., FloatArray] = advance,
        ) -> FloatArray:
            began = process_time()
            outputs = advance(run, begin, end, hold_last=hold_last)
            seconds[0] += process_time() - began
            return outputs

        CompiledRun.advance = timed  # type: ignore[method-assign]
        began = process_time()
        trace: Trace = run_case(case)
        wholes.append(1e6 * (process_time() - began))
        CompiledRun.advance = advance  # type: ignore[method-assign]
        parts.append(1e6 * seconds[0])
        assert trace.outcome == "completed", trace.reason
    return min(wholes), min(parts)
