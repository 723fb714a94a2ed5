"""From a log to a report: a plant that is identified from data, and what the report says of that."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

from ddpc_cosim import FloatArray
from ddpc_cosim.cli.main import main
from fmu_plants.quadruple_tank import AREAS, GRAVITY, LEVELS, OUTLETS, PUMP_GAINS, SPLITS
from tests.studies import run_file, study_text, write

H, SAMPLES = 10.0, 700
PUMPS = ("pump_1", "pump_2")


def levels_of(u: FloatArray) -> FloatArray:
    """Integrate Johansson's equations, shape (len(u), 4) [cm]."""

    def derivative(_: float, level: FloatArray, pumped: FloatArray) -> FloatArray:
        out = np.array(OUTLETS) * np.sqrt(2 * GRAVITY * np.maximum(level, 0.0))
        upper = (1 - SPLITS[1]) * pumped[1], (1 - SPLITS[0]) * pumped[0]
        gain = out[2] + SPLITS[0] * pumped[0], out[3] + SPLITS[1] * pumped[1], *upper
        return np.asarray((gain - out) / AREAS)

    levels = [np.array([level.start for level in LEVELS])]
    for row in u[:-1]:
        pumped = np.array(PUMP_GAINS) * row
        levels.append(solve_ivp(derivative, (0.0, H), levels[-1], args=(pumped,), rtol=1e-8).y[:, -1])
    return np.array(levels)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(5)
    u = 3.0 + np.repeat(rng.uniform(-0.5, 0.5, (SAMPLES // 5, 2)), 5, axis=0)
    y = levels_of(u)[:, :2] + 0.03 * rng.standard_normal((SAMPLES, 2))
    path = tmp_path_factory.mktemp("log") / "tanks.csv"
    rows = np.column_stack([np.arange(SAMPLES) * H, u, y])
    header = "time [s],pump_1 [V],pump_2 [V],level_1 [cm],level_2 [cm]"
    np.savetxt(path, rows, "%.9g", ",", header=header, comments="")
    return path


@pytest.mark.slow
def test_three_controllers_on_a_plant_from_a_log(log: Path, tmp_path: Path) -> None:
    steps = {"level_1": [12.3, 13.3], "level_2": [12.8, 12.3]}
    text = study_text(
        {
            "identified": {"file": str(log), "method": "arx", "order": 4, "members": 6},
            "inputs": [*PUMPS],
            "outputs": list(steps),
        },
        {name: {"kind": "steps", "times": [0, 100], "values": levels} for name, levels in steps.items()},
        {
            "spc": "spc",
            "slow": {"type": "pid", "settings": {"proportional": 0.5, "integral": 0.004}},
            "idle": "idle",
        },
        {"sampling_time": H, "duration": 600.0},
        bounds={name: {"min": 0.0, "max": 10.0} for name in PUMPS},
        recording={
            "samples": 150,
            "excitation": {
                name: {"kind": "uniform", "low": 2.5, "high": 3.5} for name in ("pump_1", "pump_2")
            },
        },
        seeds=["0:8"],
    )
    results = run_file(write(tmp_path, text))
    assert len(results.cases) == 24
    spread = results.frame().query("controller == 'spc'")["mean_abs_error.level_1 [cm]"]
    assert all(first != other for first, other in pairwise(spread))
    page = results.report(tmp_path / "report.html").read_text(encoding="utf-8")
    assert (
        "The plant is an estimate, and each seed plays another model of it: intervals allow for that." in page
    )
    assert "is ahead of" in page
    assert "Seed s plays model s of 6, number 0 that of all data" in page
    assert "It does not know what the plant does beyond what was recorded (pump_1 2.5" in page
    assert "2 of 8 seeds play a model that another one plays too" in page
    assert "plant identified from" in page


def test_the_models_have_the_gains_of_the_plant_at_its_operating_point(log: Path) -> None:
    """Those of the linearised equations: dh/dv = h'(q) at rest, of lower and upper tank."""
    signals = ("--input=pump_1", "--input=pump_2", "--output=level_1", "--output=level_2")
    options = ("--method=arx", "--order=4", "--members=20", "--json")
    printed = CliRunner().invoke(main, ["identify", str(log), *signals, *options])
    data = json.loads(printed.stdout)
    lower = (
        2.0 * np.array([level.start for level in LEVELS[:2]]) / 3.0
    )  # h is in proportion to the flow squared
    flows = np.array(PUMP_GAINS)[:, np.newaxis] * [[SPLITS[0], 1 - SPLITS[0]], [1 - SPLITS[1], SPLITS[1]]]
    parts = flows / flows.sum(axis=0)
    for i, output in enumerate(("level_1", "level_2")):
        for j, name in enumerate(PUMPS):
            expected = lower[i] * parts[j, i]
            assert data["gains"][output][name]["value"] == pytest.approx(expected, rel=0.1)
