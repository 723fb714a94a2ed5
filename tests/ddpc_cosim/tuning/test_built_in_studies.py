"""The built-in comparative studies can be tuned as they are: every method, on the same terms."""

from dataclasses import replace

import pytest

from ddpc_cosim import Constant
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.tuning.search import search_spaces, space_faults

COMPARATIVE = ["direction-change", "mimo", "noise", "reactor", "time-varying", "unstable"]


@pytest.mark.parametrize("name", [*COMPARATIVE, "benchmark"])
def test_every_method_has_somewhere_to_look(name: str) -> None:
    for problem in read_study(name).problems.values():
        points = problem.study.report.reference_points
        for key, section in problem.study.controllers.items():
            spaces = dict(search_spaces(section, by_prediction=False))
            assert bool(spaces) == (points is None or key != points.zero), key
            assert not [*space_faults(section, spaces)], key


@pytest.mark.parametrize("name", COMPARATIVE)
def test_every_condition_is_run_with_preview_and_without(name: str) -> None:
    scenarios = read_study(name).problem.study.scenarios.values()
    with_preview = [scenario for scenario in scenarios if scenario.preview is None]
    without = [replace(scenario, preview=None) for scenario in scenarios if scenario.preview == 1]
    assert len(with_preview) + len(without) == len(scenarios)
    conditions = [[replace(scenario, label="") for scenario in group] for group in (with_preview, without)]
    assert conditions[0] == conditions[1]


def test_no_recording_of_the_benchmark_knows_what_disturbs_its_loop() -> None:
    """A load and a feed rest while data are recorded, and the weather is another day's."""
    known = {}
    for name, problem in read_study("benchmark").problems.items():
        if problem.study.recording is not None and problem.study.recording.inputs:
            known[name] = problem.conditions
    assert list(known) == ["two-mass-drive", "building", "distillation-column"]
    for name, scenarios in known.items():
        for scenario in scenarios if name == "building" else ["disturbance"]:
            conditions = scenarios[scenario]
            assert conditions.inputs.keys() == conditions.recorded_inputs.keys()
            assert all(
                conditions.inputs[variable] != conditions.recorded_inputs[variable]
                for variable in conditions.inputs
            )
        if name != "building":
            assert all(isinstance(signal, Constant) for signal in conditions.recorded_inputs.values())
    for problem in read_study("benchmark").problems.values():
        if problem.study.disturbances:  # which are measured, in the recording as in the loop
            continue
        for scenario in problem.conditions.values():
            assert scenario.inputs.keys() == scenario.recorded_inputs.keys()
