"""The second benchmark: its problems are what they are called, every method meets them on the same terms."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigvals
from studies import run_file

from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study.reading import read_study
from fmu_plants import quadruple_tank
from fmu_plants.linear import linearise

SCENARIOS = ["nominal", "noise", "drift", "no-preview"]


def test_every_method_meets_the_same_problems_with_the_same_budget_of_tuning() -> None:
    study = read_study("benchmark-2")
    budgets = set()
    for problem in study.problems.values():
        assert list(problem.study.scenarios) == SCENARIOS
        assert problem.study.source
        for name, section in problem.study.controllers.items():
            tuned = section.tuned
            assert tuned is not None, (problem.study.name, name)
            assert tuned.settings
            budgets.add((tuned.trials, str(tuned.seeds), tuned.by, tuned.source))
    assert len(budgets) == 1


def test_the_tanks_rest_where_they_start_and_have_a_zero_in_the_right_half_plane() -> None:
    plant = read_study("benchmark-2").problems["non-minimum-phase-tanks"].study.plant
    given = {name: value for name, value in plant.parameters.items() if isinstance(value, float)}
    values = {parameter.name: parameter.start for parameter in quadruple_tank.MODEL.parameters} | given
    h1, h2, h3, h4 = (
        values[f"outlet_{i}"] * np.sqrt(2 * 981.0 * level.start)
        for i, level in enumerate(quadruple_tank.LEVELS, 1)
    )
    pumped = [3.0 * values["pump_gain_1"], 3.0 * values["pump_gain_2"]]
    splits = values["split_1"], values["split_2"]
    assert h3 == pytest.approx((1 - splits[1]) * pumped[1], rel=1e-6)
    assert h4 == pytest.approx((1 - splits[0]) * pumped[0], rel=1e-6)
    assert h1 - h3 == pytest.approx(splits[0] * pumped[0], rel=1e-6)
    assert h2 - h4 == pytest.approx(splits[1] * pumped[1], rel=1e-6)
    a, b, c, d = linearise(quadruple_tank.MODEL, parameters=given)
    n, m = b.shape
    right = np.zeros((n + m, n + m))
    right[:n, :n] = np.eye(n)
    zeros = eigvals(np.block([[a, b], [c, d]]), right)
    assert max(zeros[np.isfinite(zeros) & (np.abs(zeros) < 1e3)].real) > 0.01


def test_no_method_looks_as_far_as_the_dead_time_unless_it_is_told() -> None:
    problem = read_study("benchmark-2").problems["late-reflux"]
    sampling_time = problem.study.loop.sampling_time
    late = {
        scenario.effects["delay"]["reflux"] / sampling_time for scenario in problem.study.scenarios.values()
    }
    (samples,) = late
    for name in problem.study.controllers:
        assert load_plugin("controllers", name)().horizon < samples, name


@pytest.mark.slow
def test_who_learns_on_follows_a_plant_that_drifts(tmp_path: Path) -> None:
    frame = run_file("benchmark-2", tmp_path, jobs=2, seeds=[0], only="drift").frame()
    for problem, error in (
        ("ph-neutralisation", "mean_abs_error.pH [1]"),
        ("non-minimum-phase-tanks", "mean_abs_error.level_1 [cm]"),
    ):
        of_problem = frame[frame["problem"] == problem].set_index("controller")[error]
        assert of_problem["gpc"] < 0.6 * of_problem[["deepc", "spc"]].min()
