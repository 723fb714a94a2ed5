"""Studies that regulate: within bands against prices, and at a constant reference against what moves."""

from pathlib import Path
from typing import Any

import pytest

from ddpc_controllers import PID, Idle
from ddpc_cosim import (
    Band,
    Constant,
    KnownDisturbance,
    Price,
    Problem,
    Scenario,
    Sine,
    Steps,
    Study,
    StudyResults,
)

from .recomputed import figures_of, read_case, resting_folder, verdict

DAY = 86400.0
SETBACK = Steps(
    [0.0, 6 * 3600.0, 22 * 3600.0, 30 * 3600.0, 46 * 3600.0], [16.0, 20.0, 16.0, 20.0, 16.0], unit="degC"
)
COLD = KnownDisturbance(signal=Sine(6.0, 1.0 / DAY, offset=-2.0, unit="degC"), known="perfect")
SUN = KnownDisturbance(signal=Steps([0.0, 9 * 3600.0, 15 * 3600.0], [0.0, 150.0, 0.0]))
TARIFF = Steps([0.0, 7 * 3600.0, 21 * 3600.0], [0.1, 0.3, 0.1])
CONTROLLERS = {
    "tight": PID(proportional=1500.0, integral=0.15),
    "loose": PID(proportional=300.0, integral=0.01),
    "wrong": PID(proportional=-500.0, integral=-0.05),
    "idle": Idle(),
}


def building(**changes: Any) -> Problem:
    loop = {"sampling_time": "15 min", "duration": "2 d", "inputs": ["heating_power"]}
    weather = {"outdoor_temperature": COLD, "solar_irradiance": SUN}
    settings: dict[str, Any] = {"outputs": ["indoor_temperature"], "disturbances": weather, **loop, **changes}
    return Problem(plant="building", **settings)


PRICE = Price(signal="heating_power", factor=1 / 3, price=TARIFF, unit="EUR/kWh", emissions=0.2)
UNKNOWN = Scenario(known={"outdoor_temperature": "unknown", "solar_irradiance": "unknown"})
PROBLEMS = {
    "band": {
        "reference": {"indoor_temperature": Band(SETBACK, 24.0, "degC")},
        "prices": {"electricity": PRICE},
    },
    "line": {
        "reference": {"indoor_temperature": Constant(20.0, unit="degC")},
        "scenarios": {"nominal": Scenario(), "unknown": UNKNOWN},
    },
    "mild": {"reference": {"indoor_temperature": Band(10.0, 30.0, "degC")}},
}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, StudyResults]:
    folder = tmp_path_factory.mktemp("regulation")
    return {
        name: Study(building(**settings), CONTROLLERS).run(folder / name, progress=False)
        for name, settings in PROBLEMS.items()
    }


def test_figures_and_verdicts_are_those_of_the_samples(results: dict[str, StudyResults]) -> None:
    for result in results.values():
        for case in result.cases:
            figures = figures_of(case.folder, 1)
            actual = {key: case.metrics[key] for key in figures}
            assert actual == pytest.approx(figures, rel=1e-9, abs=1e-9, nan_ok=True)
            assert (case.failed, case.settles) == verdict(case.folder, 1), (case.id, case.failure)


def test_doing_nothing_has_the_same_disturbances(results: dict[str, StudyResults]) -> None:
    for result in results.values():
        for case in result.cases:
            _, driven = read_case(case.folder)
            _, resting = read_case(resting_folder(case.folder))
            acting = [header for header in driven if header.startswith(("applied ", "disturbance "))]
            assert len(acting) == (2 if case.scenario == "unknown" else 4)
            assert all(driven[header] == resting[header] for header in acting)


def test_what_is_concluded_where_nothing_is_a_step(results: dict[str, StudyResults]) -> None:
    """Who drives away from its band fails, who stays in it does not; no percentage is absurd."""
    cases = {
        (name, case.controller, case.scenario): case for name, of in results.items() for case in of.cases
    }
    for (name, controller, _), case in cases.items():
        assert not (case.failed and controller == "tight"), (name, case.failure)
        assert case.failed or not case.left > 200.0
    assert cases["band", "wrong", "nominal"].failed
    assert cases["line", "wrong", "nominal"].failed
    inside = cases["mild", "loose", "nominal"]
    assert (inside.failed, inside.settles, inside.left) == (False, True, 0.0)
    for known in ("nominal", "unknown"):
        assert cases["line", "tight", known].settles is None, "the weather moves, known or not"
    assert cases["line", "tight", "nominal"].tasks["indoor_temperature"] > 1.0, "what the weather does"


def test_the_one_with_prices_is_ranked_by_fronts(results: dict[str, StudyResults], tmp_path: Path) -> None:
    (findings,), (unpaid,) = (results[name].findings().values() for name in ("band", "line"))
    assert findings.standings.is_pareto
    assert not unpaid.standings.is_of_money
    page = results["band"].report(tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Ranked by money and discomfort" in page
    assert "Pareto front" in page
