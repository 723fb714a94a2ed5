"""The study of the house that controls itself says what its runs show, and its page can be followed."""

import re
import shlex
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import pytest

from ddpc_cosim import CaseResult, Outcome, StudyResults, load_results
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.verdicts.findings import findings_of, overall_findings
from tests.conftest import Run
from tests.studies import folder_of_runs, run_file

from .recomputed import key_figures_in, key_figures_of
from .test_studies import STUDIES

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("weather")]

ROOT = Path(__file__).parents[2]
AREA = 180.0  # m2
SOURCES = {f"OperativeZoneTemperature[{i}]": [f"reaTZon{i}_y"] for i in (1, 2)} | {
    "ElectricPower": ["reaPHeaPum_y"]
}
MONEY, DISCOMFORT = "money [EUR]", "tdis_tot [K.h]"
BOUGHT_AHEAD = ("*highly-dynamic*", "forecasts*unknown*", "forecasts*measured*", "forecasts*perfect*")
DAYS = ("peak-heat-day", "typical-heat-day")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> dict[str, StudyResults]:
    """The price of the market, and three levels of knowing, judged without the reference point."""
    folder = tmp_path_factory.mktemp("buildings")
    out = folder_of_runs("buildings", folder / "out")
    results = run_file(STUDIES / "buildings.toml", out, jobs=2, seeds=[0, 1], only=BOUGHT_AHEAD)
    text = 'extends = "buildings"\ncontrollers.nmpc = false\n'
    (folder / "house.toml").write_text(text, encoding="utf-8")
    judged = read_study(str(folder / "house.toml")).problems
    return {
        problem.study.name: replace(
            problem,
            whole=WholeStudy.of(judged[problem.study.name].study),
            cases=tuple(case for case in problem.cases if case.controller != "nmpc"),
        )
        for problem in results.problems()
    }


def mean_of(results: StudyResults, controller: str, metric: str, scenario: str = "highly-dynamic") -> float:
    return fmean(
        case.metrics[metric]
        for case in results.cases
        if (case.controller, case.scenario) == (controller, scenario)
    )


def test_mpc_pays_less_than_the_own_control_at_no_more_discomfort(study: dict[str, StudyResults]) -> None:
    for day in DAYS:
        for metric in (MONEY, DISCOMFORT):
            assert mean_of(study[day], "mpc", metric) < mean_of(study[day], "plant", metric)
        findings = findings_of(study[day].study, study[day].cases)
        # What MPC saves around the coldest day is less than the 1 % from which on a difference matters.
        assert "mpc" in findings.leaders
        assert set(findings.leaders) <= {"koopman-mpc", "mpc", "plant"}


def test_koopman_mpc_pays_less_around_the_typical_day_alone(study: dict[str, StudyResults]) -> None:
    for day, less in zip(DAYS, (False, True), strict=True):
        money = [mean_of(study[day], controller, MONEY) for controller in ("koopman-mpc", "plant")]
        assert (money[0] < money[1]) is less
        assert mean_of(study[day], "koopman-mpc", DISCOMFORT) < 0.6


def test_nobody_fails_by_being_worse_than_the_own_control(study: dict[str, StudyResults]) -> None:
    for results in study.values():
        for case in results.cases:
            assert case.outcome is Outcome.COMPLETED
            assert not case.failure.startswith("worse")


def test_key_figures_are_those_of_the_papers_formulas(study: dict[str, StudyResults]) -> None:
    driven = [case for results in study.values() for case in results.cases if case.controller != "plant"]
    assert driven
    for case in driven:  # what the own control applied is in no column of an input
        expected = key_figures_of(case.folder, AREA, SOURCES)
        assert key_figures_in(case.metrics) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert case.metrics[MONEY] == pytest.approx(AREA * expected["cost_tot [EUR/m2]"], rel=1e-9)


def test_reading_the_house_twice_as_often_changes_no_figure_by_a_percent(
    study: dict[str, StudyResults], tmp_path: Path
) -> None:
    """That of the own control, which switches every 5 minutes, included."""
    text = 'extends = "buildings"\nproblems.forecasts = false\n'
    for day in DAYS:
        text += f'problems.{day}.loop.communication_step = "2.5 min"\n'
    (tmp_path / "house.toml").write_text(text, encoding="utf-8")
    only = [f"*_{name}_highly-dynamic_seed0" for name in ("plant", "koopman-mpc")]
    results = run_file(tmp_path / "house.toml", jobs=2, only=only)
    assert len(results.cases) == 2 * len(DAYS)
    for case in results.cases:
        (known,) = (
            other
            for other in study[case.problem].cases
            if (other.controller, other.scenario, other.seed) == (case.controller, case.scenario, case.seed)
        )
        for key, value in key_figures_in(case.metrics).items():
            if not key.startswith("time_rat"):
                assert value == pytest.approx(known.metrics[key], rel=0.01)


def test_a_problem_of_one_controller_does_not_keep_the_others_from_being_ranked(
    study: dict[str, StudyResults],
) -> None:
    over_all = overall_findings((results.study, results.cases) for results in study.values())
    assert over_all is not None
    assert over_all.ranks.problems == len(DAYS)
    assert len(over_all.ranks.ranks) == 7


def test_no_room_leaves_what_a_house_may_have(study: dict[str, StudyResults]) -> None:
    for results in study.values():
        for case in results.cases:
            celsius = case.trace().y - 273.15
            assert 14.0 < celsius.min() < celsius.max() < 31.0


@pytest.fixture
def followed(tmp_path: Path, run_program: Run) -> list[CaseResult]:
    """What the commands of the page come to, in an empty folder, of the FMU under a stranger's name."""
    page = (ROOT / "docs" / "a-building-its-weather-and-its-price.md").read_text(encoding="utf-8")
    commands = re.search(r"```sh\n(.*?)```", page, re.DOTALL)
    assert commands
    for line in commands[1].replace("two_zone_house.fmu", "stranger.fmu").splitlines():
        _, *arguments = shlex.split(line)
        ended = run_program(*arguments)
        assert ended.returncode == 0, ended.stderr
        if arguments[0] == "export":
            (tmp_path / "two_zone_house.fmu").rename(tmp_path / "stranger.fmu")
    return list(load_results(tmp_path / "runs" / "house").cases)


def test_the_pages_commands_lead_to_a_study_whose_best_keeps_the_band(followed: list[CaseResult]) -> None:
    violations = [
        fmean(tracking.mean_abs_error / (tracking.width or 0.0) for tracking in case.tracking)
        for case in followed
        if case.controller != "plant"
    ]
    assert len(violations) >= 3
    assert min(violations) < 0.05
