"""One case of a study, chosen by names."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.processes.sandbox import demanded, require
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.resolve import ResolvedProblems, ResolvedStudy
from ddpc_cosim.study.runner import Progress, built_plants
from fmu_plants.spelling import did_you_mean


def single_case(
    resolved: ResolvedProblems,
    controller: str,
    progress: Progress,
    *,
    problem: str | None = None,
    scenario: str | None = None,
    seed: int | None = None,
    sandboxed: bool = False,
) -> tuple[Case, ResolvedStudy]:
    """Return one case of a study, ready to run, and the study reduced to it.

    Parameters
    ----------
    resolved : ResolvedProblems
        The study.
    controller : str
        The controller's name there.
    progress : Progress
        Follows what is done.
    problem, scenario : str or None
        Which of the study's; default: the only problem, the first scenario.
    seed : int or None
        Default: the study's first.
    sandboxed : bool
        Whether it is to run in a sandbox.

    Raises
    ------
    CosimError
        The study has no such controller, problem or scenario, or the plant cannot be built.
    """
    chosen = _chosen("problem", problem, resolved.problems, only=True)
    study = resolved.problems[chosen].study
    _chosen("controller", controller, study.controllers)
    within = _chosen("scenario", scenario, study.scenarios)
    alone = replace(resolved, problems={chosen: resolved.problems[chosen]})
    with demanded(sandboxed):
        plant = built_plants(alone.problems, progress)[chosen]
    chosen_seed = study.seeds[0] if seed is None else seed
    single = _of_one_case(alone.problem, controller, within, chosen_seed)
    # A plant that is drawn as one of many is that of the study's own case.
    among = study.seeds if chosen_seed in study.seeds else [chosen_seed]
    case = next(case for case in cases_of(single, plant, among) if case.seed == chosen_seed)
    if case.late:
        raise ConfigError(f'controller "{controller}": {case.late}')
    return (replace(case, sandbox=require()) if sandboxed else case), single


def _chosen(what: str, name: str | None, known: Iterable[str], *, only: bool = False) -> str:
    """Return a name that there is; without one the first, or the only one."""
    listed = list(known)
    if name is None:
        if only and len(listed) > 1:
            by = f"by {what}, --{what} of a command"
            raise ConfigError(f"the study has several {what}s: choose one {by}: {', '.join(listed)}")
        return listed[0]
    if name not in listed:
        raise ConfigError(f'the study has no {what} "{name}"; {did_you_mean(name, listed)}')
    return name


def _of_one_case(resolved: ResolvedStudy, controller: str, scenario: str, seed: int) -> ResolvedStudy:
    """Return the study reduced to one case."""
    study = resolved.study
    parts: dict[str, Any] = {
        "seeds": [seed],
        "controllers": {controller: study.controllers[controller]},
        "scenarios": {scenario: study.scenarios[scenario]},
        "requirements": None,
        "report": type(study.report)(),
    }
    return replace(resolved, study=replace(study, **parts))
