"""One truth: cases of the built-in studies, drawn at random, by the compiled engine and by Python."""

import random
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ddpc_cosim import Constant, FloatArray, Reference, Trace
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.objects import Silent
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection, selected_cases

COUNT, TOLERANCE = 200, 1e-9
ROUNDING, OF_A_LAW, BEGUN = 2e-16, 1e-11, 10
"""Of a number, of what a law with large gains computes, and the samples in which nothing has grown yet."""
STUDIES = (
    *("benchmark", "paper", "noise", "mimo", "time-varying", "unstable", "direction-change"),
    *("forecast", "buildings"),  # others take long in Python
)
IN_PYTHON = {"from-a-log"}
"""The plant has no equations."""
FAR_AWAY = {("limit-that-pays", "mpc"): 1e-7}
"""Where prices outweigh the weights of inputs, so that the optimum without limits is 1e7 times further away.

The tolerance is a hundred times what a double has of that.
"""
WITHOUT_CODE = ("nmpc", "spsa", "wkpc-published", "plant-control", "select-dpc")
SIGNALS = (
    *("time", "reference", "y", "measured", "u", "applied"),
    *("d", "forecast", "price", "charged", "monitored", "intersample"),
)


def drawn() -> list[Case]:
    """Return so many cases, of all studies, problems, methods and scenarios alike."""
    every = [
        case
        for name in STUDIES
        for case in selected_cases(read_study(name), Selection(seeds=[0, 1]), Silent())[1]
        if case.section["type"] not in WITHOUT_CODE and case.problem not in IN_PYTHON
    ]
    return random.Random(20261128).sample(every, COUNT)


def largest_difference(one: Trace, other: Trace, signals: Sequence[str] = SIGNALS) -> float:
    """Return by how much signals differ, relative to the largest value of each."""
    assert (one.outcome, len(one)) == (other.outcome, len(other))
    largest = 0.0
    for name in signals:
        values, others = getattr(one, name), getattr(other, name)
        assert values.shape == others.shape
        assert (np.isnan(values) == np.isnan(others)).all()
        if values.size:
            scale = np.nanmax(np.abs(values), axis=0, initial=0.0)
            difference = np.nanmax(np.abs(values - others), axis=0, initial=0.0)
            largest = max(largest, float((difference / np.where(scale > 0.0, scale, 1.0)).max()))
    return largest


def parts_of(disturbance: Reference | Sequence[Reference]) -> Sequence[Reference]:
    """Return the signals that a disturbance is the sum of."""
    return (disturbance,) if isinstance(disturbance, Reference) else disturbance


def pushed(case: Case, by: FloatArray) -> Trace:
    """Return a run in Python where constants are added to the inputs."""
    disturbances = dict(case.conditions.disturbances)
    for variable, constant in zip(case.inputs, by.tolist(), strict=True):
        others = parts_of(disturbances.get(variable.name, ()))
        disturbances[variable.name] = [*others, Constant(constant)]
    return run_case(replace(case, conditions=replace(case.conditions, disturbances=disturbances)))


def begun(trace: Trace, other: Trace) -> FloatArray:
    """Return by how much inputs differ in the first samples, shape (m,)."""
    return np.asarray(np.abs(trace.u[:BEGUN] - other.u[:BEGUN]).max(axis=0))


def moved_by_rounding(case: Case, trace: Trace, other: Trace) -> float:
    """Return by how much a run in Python changes where each input has a rounding error added to it.

    It is as large as the two engines differ in the first samples, where a law with large gains, or with
    equations that are nearly singular, makes more of the rounding of what it measures than of that of its
    inputs. What Python itself does not come near to there, with the rounding of a number, is a difference.
    """
    largest = np.abs(trace.u).max(axis=0)
    rounding, differs = ROUNDING * largest, begun(trace, other)
    if (differs > OF_A_LAW * largest).any():
        of_python = begun(trace, pushed(case, rounding))
        if (differs > np.maximum(OF_A_LAW * largest, 10.0 * of_python)).any():
            return 0.0
    return largest_difference(trace, pushed(case, np.maximum(rounding, differs)), ("y", "u"))


@pytest.mark.slow
def test_random_cases_are_the_same_in_both_engines() -> None:
    wrong, compiled = [], 0
    for case in drawn():
        python, in_c = run_case(case), run_case(replace(case, engine="compiled"))
        compiled += in_c.engine == "compiled"
        difference = largest_difference(python, in_c)
        if difference <= FAR_AWAY.get((case.problem, case.controller), 0.0):
            continue
        # A loop that amplifies rounding does so in Python, too: by no less than a tenth of that.
        if difference > TOLERANCE and moved_by_rounding(case, python, in_c) < difference / 10.0:
            wrong.append((case.name, difference))
        expected, found = python.metrics(case.metrics), in_c.metrics(case.metrics)
        assert expected.keys() == found.keys()
        if difference <= TOLERANCE:
            for key, value in expected.items():
                if np.isfinite(value) and not key.startswith(("solve_time", "deadline_misses")):
                    size = max([abs(value), *np.abs(python.y).max(axis=0, initial=1.0)])
                    if abs(found[key] - value) > 10.0 * TOLERANCE * size:
                        wrong.append((f"{case.name}: {key}", found[key] - value))
    assert not wrong
    assert compiled >= 0.95 * COUNT
