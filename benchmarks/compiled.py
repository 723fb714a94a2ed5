"""Closed loops in C beside the same ones in Python: the samples alone, and all of a case but its files.

CPU time of this process, the least of several repetitions. What both engines do alike, before and after the
samples, is what a compiled case takes beyond its calls of the compiled loop. Beside that stands a loop in C
that is written by hand for this plant and this law, and calls the same functions of both.
"""

from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path
from time import process_time
from typing import Any, Self
from unittest.mock import patch

import numpy as np

from benchmarks.step import Row, print_header, print_rows
from ddpc_cosim import Trace
from ddpc_cosim.compiled import engine, program
from ddpc_cosim.compiled.engine import CompiledRun
from ddpc_cosim.controller import ControllerCode
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.objects import Silent
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection, selected_cases
from ddpc_cosim.variables import FloatArray

REPETITIONS = 7
METHODS = ("deepc", "mfapc", "wkpc")
"""Of the study `paper`: 401 samples each."""
_SAMPLES, _CASE, _BY_HAND = 20.0, 1.2, 1.3
_HAND_WRITTEN = Path(__file__).with_name("loop.c")


def main() -> bool:
    """Print the table; return whether all bounds are held."""
    print_header()
    rows = []
    for case in selected_cases(read_study("paper"), Selection(seeds=[0], only=METHODS), Silent())[1]:
        python, _ = _least(case)
        compiled, in_c = _least(replace(case, engine="compiled"))
        in_python = python - (compiled - in_c)
        generated, by_hand = _loops(replace(case, engine="compiled"))
        ratio = generated / by_hand
        rows += [
            Row(f"{case.label}: the loop in C / by hand", generated, by_hand, ratio, _BY_HAND, at_most=True),
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


def _loops(case: Case) -> tuple[float, float]:
    """Return the CPU time of the compiled loops of a case, and of hand-written ones [us], the least of many.

    A case has two, the experiment and the closed loop.
    """
    generated = program._own_sources()
    makes = {
        "generated": generated,
        "by hand": {**generated, "loop.c": _HAND_WRITTEN.read_text(encoding="utf-8")},
    }
    least, signals = dict.fromkeys(makes, inf), {}
    for _ in range(REPETITIONS):
        for name, sources in makes.items():
            timed = _TimedProgram()
            program._programs.clear()
            with (
                patch.object(program, "_own_sources", lambda sources=sources: sources),
                patch.object(engine, "program_of", timed.take),
            ):
                trace = run_case(case)
            assert (trace.outcome, trace.engine) == ("completed", "compiled"), trace.reason
            signals[name], least[name] = trace.u, min(least[name], 1e6 * timed.seconds)
    assert np.array_equal(*signals.values())
    return least["generated"], least["by hand"]


class _TimedProgram:
    """The programs of a case, one after the other, and what their loops have taken."""

    seconds = 0.0

    def take(self, code: ControllerCode) -> Self:
        """Take the program of a controller's code."""
        self._program = program.program_of(code)
        return self

    def started(self, numbers: FloatArray) -> Any:
        return self._program.started(numbers)

    def run(self, loop: int, progress: int) -> int:
        began = process_time()
        ended: int = self._program.run(loop, progress)
        self.seconds += process_time() - began
        return ended
