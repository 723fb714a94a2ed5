"""The section on how often controllers fail, of a whole run, computed again from ``metrics.csv`` alone."""

import csv
import json
import math
from typing import Any

import pytest
from click.testing import CliRunner
from studies import run_file

from ddpc_cosim import StudyResults
from ddpc_cosim.cli.main import main

from .recomputed import failure_interval, quantile_places, rank_correlation

pytestmark = pytest.mark.xdist_group("how-often")

SEEDS = 40
STUDY = f"""
extends = "monte-carlo"
name = "spread"
seeds = ["0:{SEEDS}"]

[loop]
duration = 4.0

[reference.angle]
kind = "constant"
value = 20.0
unit = "deg"

[plant.parameters]
mass = {{ distribution = "uniform", low = 0.5, high = 2.0 }}
damping = {{ distribution = "log-normal", median = 0.4, factor = 2.0 }}

[controllers]
deepc = false

[controllers.pid]
type = "pid"
tuned = false
settings = {{ tuning = "manual", proportional = 4.0, integral = 30.0, derivative = 0.5 }}
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    study = tmp_path_factory.mktemp("spread") / "study.toml"
    study.write_text(STUDY, encoding="utf-8")
    return run_file(study, jobs=2)


@pytest.fixture(scope="module")
def rows(results: StudyResults) -> list[dict[str, str]]:
    with (results.folder / "metrics.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def tables(results: StudyResults, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the tables of the section by the ends of their names, as the report has them as data."""
    path = tmp_path_factory.mktemp("report") / "report.json"
    outcome = CliRunner().invoke(
        main, ["report", str(results.folder), "--format", "json", "--out", str(path)]
    )
    assert outcome.exit_code == 0, outcome.output
    sections = json.loads(path.read_text("utf-8"))["parts"][0]["sections"]
    (section,) = [section for section in sections if section["title"] == "How often it fails"]
    return {block["id"].rpartition("-")[2]: block for block in section["blocks"] if block["kind"] == "table"}


def figures_of(rows: list[dict[str, str]], controller: str) -> list[float]:
    """Return the errors of a controller from the least to the worst, infinite of runs that failed."""
    return sorted(
        math.inf if row["failed"] == "true" else float(row["mean_abs_error.angle [deg]"])
        for row in rows
        if row["controller"] == controller
    )


def ends(cell: dict[str, Any]) -> list[float]:
    return [float(end) for end in cell["value"].split(" … ")]


def test_failures_their_probability_and_quantiles(rows: list[dict[str, str]], tables: dict[str, Any]) -> None:
    compared = 0
    for row in tables["reliability"]["rows"]:
        values, cells = figures_of(rows, row["controller"]), row["cells"]
        failed = sum(map(math.isinf, values))
        assert cells[0]["text"] == f"{failed} of {SEEDS}"
        assert cells[1]["value"] == pytest.approx(100 * failed / SEEDS)
        assert ends(cells[2]) == pytest.approx(
            [100 * end for end in failure_interval(failed, SEEDS)], rel=1e-9
        )
        for share, value, interval in ((0.5, *cells[3:5]), (0.9, *cells[5:7])):
            places = quantile_places(SEEDS, share)
            assert places is not None
            expected = values[math.ceil(share * SEEDS) - 1]
            assert value["text"] == "failed" if math.isinf(expected) else value["value"] == expected
            assert ends(interval) == [values[place - 1] for place in places]
            compared += 1
    assert compared == 4
    assert quantile_places(SEEDS, 0.99) is None
    assert len(tables["reliability"]["columns"]) == 1 + 3 + 4


def test_what_parameters_go_with(rows: list[dict[str, str]], tables: dict[str, Any]) -> None:
    with_figures = [row for row in tables["associations"]["rows"] if row["cells"][1]["text"] != "failures"]
    assert {row["cells"][0]["text"].partition(" ")[0] for row in with_figures} == {"mass", "damping"}
    for row in with_figures:
        runs = [r for r in rows if r["controller"] == row["controller"] and r["failed"] == "false"]
        drawn = [float(run[f"parameter {row['cells'][0]['text']}"]) for run in runs]
        errors = [float(run["mean_abs_error.angle [deg]"]) for run in runs]
        assert row["cells"][2]["value"] == len(runs)
        assert row["cells"][3]["value"] == pytest.approx(rank_correlation(drawn, errors), abs=1e-9)


def test_all_controllers_of_a_seed_had_one_plant(rows: list[dict[str, str]]) -> None:
    plants: dict[str, set[tuple[str, ...]]] = {}
    for row in rows:
        drawn = tuple(value for key, value in row.items() if key.startswith("parameter "))
        plants.setdefault(row["seed"], set()).add(drawn)
    assert len(plants) == SEEDS
    assert all(len(of_seed) == 1 for of_seed in plants.values())
    assert len(set.union(*plants.values())) == SEEDS
