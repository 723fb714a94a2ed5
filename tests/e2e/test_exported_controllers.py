"""Every controller of the built-in studies that can be exported: its C code decides as it does."""

from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
import pytest
from controllers.export.compiled import Beside

from ddpc_cosim import Action, ConfigError, Controller, FloatArray, Loop, Outcome, Sample
from ddpc_cosim.loop import safe_calls
from ddpc_cosim.study import case_runs
from ddpc_cosim.study.cases import Case, cases_of_problems
from ddpc_cosim.study.reading import read_study

from .test_studies import STUDIES

pytestmark = pytest.mark.slow

BOUND = 1e-8
LAST_DIGIT = 2.0**-52
MOST = 45
"""Cases of a study: spread evenly where there are more."""
LONGEST = 250
"""Samples of a case: all that a controller keeps of the past has been replaced several times by then."""

REFUSED = {
    "spsa": "it draws random perturbations of its gains for as long as it runs",
    "select-dpc": "it factorises the windows that it chooses",
    "wkpc-published-code": "the program draws random centres",
    "deepc-online": "the data are factorised anew while the loop runs",
    "wkpc-online": "the data are factorised anew while the loop runs",
}
"""Of controllers by name; others of a type:"""
NONLINEAR = "it solves a nonlinear program"
REFUSED_TYPES = {"nmpc": NONLINEAR, "ddpc_controllers.nmpc:NMPC": NONLINEAR}


def refusal_of(case: Case) -> str | None:
    """Return why a case's controller cannot be exported; None: it can be."""
    inside = case.section["settings"].get("controller", case.section)["type"]
    return REFUSED_TYPES.get(inside) or REFUSED.get(case.controller)


class Rounded:
    """A controller in Python whose measurements are rounded otherwise, in their last digit."""

    status, last_step = 0, (0, 0, 0)

    def __init__(self, controller: Controller, loop: Loop) -> None:
        self._controller, self._bounds = deepcopy(controller), loop.bounds
        self._rng = np.random.default_rng(0)
        self._controller.start(loop)

    def step(self, sample: Sample) -> FloatArray:
        y, measured = (v * (1.0 + LAST_DIGIT * self._rng.choice([-1.0, 1.0], v.shape)) for v in sample[2:4])
        answer = self._controller.step(sample._replace(y=y, measured=measured))
        u = answer.u if isinstance(answer, Action) else answer
        return np.asarray(np.clip(u, self._bounds.u_min, self._bounds.u_max))


@dataclass(kw_only=True)
class BesideRounded(Beside):
    """The same with a controller in Python in place of the C code."""

    def _other(self, loop: Loop) -> Rounded:
        return Rounded(self.controller, loop)


def closed(case: Case, kind: type[Beside], drives: bool) -> tuple[Beside, FloatArray]:
    """Close the loop of a case with its controller and another one beside it; return both and the inputs."""
    controller = case_runs._controller(case.section, case.plant)
    assert controller is not None
    beside, plant = kind(controller=controller, drives=drives), case_runs.open_plant(case)
    try:
        trace = case_runs._close_the_loop(case, plant, beside, None)
    finally:
        safe_calls.close_plant(plant)
    assert trace.outcome is Outcome.COMPLETED, trace.reason
    return beside, trace.u


def distance(case: Case, kind: type[Beside]) -> float:
    """Return how far another controller is from a case's: at the same samples, or in a loop of its own.

    Where a controller by itself is unstable, roundings grow in the one of the two that drives nothing.
    """
    beside, u = closed(case, kind, drives=False)
    if beside.difference < BOUND:
        assert not beside.disagreements
        return beside.difference
    _, u_driven = closed(case, kind, drives=True)
    return min(beside.difference, float((np.abs(u - u_driven) / beside.span).max()))


def cases_of(study: str) -> list[Case]:
    """Return the cases of a study's first scenario and seed, of all its problems."""
    resolved, cases_of_all = read_study(study), list[Case]()
    for name, problem in resolved.problems.items():
        of_problem = cases_of_problems({name: (problem, problem.plant.built())}, problem.study.seeds[:1])
        cases_of_all += [case for case in of_problem if case.scenario == of_problem[0].scenario]
    # Problems that differ by their days or prices alone have the same controllers.
    cases_of_all = [
        *{repr((case.section, case.plant.content, case.inputs)): case for case in cases_of_all}.values()
    ]
    chosen = sorted(cases_of_all, key=lambda case: case.section["type"])[:: -(-len(cases_of_all) // MOST)]
    assert {case.section["type"] for case in chosen} == {case.section["type"] for case in cases_of_all}
    return [replace(case, duration=min(case.duration, LONGEST * case.sampling_time)) for case in chosen]


@pytest.mark.parametrize("study", sorted(path.stem for path in STUDIES.glob("*.toml")))
def test_the_code_of_every_controller_is_that_controller(study: str) -> None:
    for case in cases_of(study):
        if case.section["type"] == "plant":  # its own control: there is nothing to export
            continue
        if refused := refusal_of(case):
            with pytest.raises(ConfigError, match=f"{refused}|exported with moving limits"):
                closed(case, Beside, drives=False)
            continue
        apart = distance(case, Beside)
        # Where a loop is that sensitive, Python is as far from itself with a digit rounded otherwise.
        assert apart < BOUND or apart < 10.0 * distance(case, BesideRounded), (case.controller, apart)
