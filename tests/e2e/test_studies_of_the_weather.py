"""The studies of what knowing is worth, and of comfort against money, say what their runs show."""

from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from ddpc_cosim import CaseResult, StudyResults, load_results
from ddpc_cosim.study.verdicts.findings import findings_of
from tests.studies import folder_of_runs, run_file

from .test_studies import STUDIES, check_figures, check_that_cases_end_within_bounds

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("weather")]

SEEDS = range(6)
"""As few as tell anything apart."""

USES_IT = ("deepc", "spc", "koopman-mpc", "mpc")


@pytest.fixture(scope="module")
def run_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    done: dict[str, Path] = {}

    def run(name: str) -> Path:
        if name not in done:
            done[name] = folder_of_runs(name, tmp_path_factory.mktemp(name))
            run_file(STUDIES / f"{name}.toml", done[name], jobs=2, seeds=list(SEEDS))
        return done[name]

    return run


def problems(folder: Path) -> dict[str, StudyResults]:
    """Return the results of each problem by its name."""
    return {results.study.name: results for results in load_results(folder).problems()}


def error(case: CaseResult) -> float:
    return float(sum(value for key, value in case.metrics.items() if key.startswith("mean_abs_error")))


def left(results: StudyResults, controller: str, scenario: str) -> float:
    """Return the median ratio of a controller's error in a scenario to that with nothing known."""
    by_seed = {
        (case.scenario, case.seed): error(case) for case in results.cases if case.controller == controller
    }
    return median(by_seed[scenario, seed] / by_seed["unknown", seed] for seed in SEEDS)


def test_measuring_is_worth_much_a_forecast_what_its_errors_leave(run_once: Callable[[str], Path]) -> None:
    found = problems(run_once("forecast"))
    for name in ("column", "drive"):
        for controller in USES_IT:
            assert left(found[name], controller, "measured") < 0.7
            assert left(found[name], controller, "perfect") < 0.7
    for controller in USES_IT:
        worse_by_errors = [
            left(found["building"], controller, level) for level in ("perfect", "low", "medium", "high")
        ]
        assert worse_by_errors == sorted(worse_by_errors)
        assert worse_by_errors[0] < 0.7
        assert worse_by_errors[-1] > 1.5  # errors of weather forecasts are larger than what was not known
    for results in found.values():
        knowing = findings_of(results.study, results.cases).knowing
        assert knowing is not None
        assert "ipid" in knowing.others
        assert "ipid" not in {worth.controller for worth in knowing.gaining}


def test_who_does_not_use_it_does_the_same_in_all_scenarios(run_once: Callable[[str], Path]) -> None:
    for results in problems(run_once("forecast")).values():
        for seed in SEEDS:
            runs = [case for case in results.cases if case.controller == "ipid" and case.seed == seed]
            assert len({error(case) for case in runs}) == 1


def test_economic_control_costs_less_at_no_more_discomfort(run_once: Callable[[str], Path]) -> None:
    (results,) = problems(run_once("prices")).values()
    check_that_cases_end_within_bounds(results)
    check_figures(results)

    def medians(controller: str, scenario: str) -> tuple[float, float]:
        cases = [case for case in results.cases if (case.controller, case.scenario) == (controller, scenario)]
        money = median(case.metrics["money [EUR]"] for case in cases)
        key = next(key for key in cases[0].metrics if key.startswith("band_violation."))
        return money, median(case.metrics[key] for case in cases)

    for scenario in results.study.scenarios:
        economic, edge = medians("deepc", scenario), medians("edge-mpc", scenario)
        assert economic[0] < 0.9 * edge[0]
        assert economic[1] <= edge[1]
    leaders = findings_of(results.study, results.cases).leaders
    assert set(leaders) <= {"deepc", "spc"}
    assert "deepc" in leaders


def test_money_is_what_the_samples_say(run_once: Callable[[str], Path]) -> None:
    (results,) = problems(run_once("prices")).values()
    for case in results.cases[:10]:
        trace = case.trace()
        heat, price = trace.u[:-1, 0], trace.price[:-1, 0]
        by_hand = float(np.sum(price * 0.333 * heat) * 900.0 / 3.6e6)
        assert case.metrics["money [EUR]"] == pytest.approx(by_hand, rel=1e-9)
        hours = np.mod(trace.time[:-1], 86400.0) / 3600.0
        dear = (hours >= 7) & (hours < 20) if case.scenario == "day-and-night" else (hours >= 6) & (hours < 9)
        assert (price[dear] > 0.3).all()
