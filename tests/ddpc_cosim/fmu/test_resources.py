"""What lies in the resources of an FMU is read as far as it can be; what is wrong is told, never a crash."""

import json
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from resources import OUTDOORS, files_of_a_house, with_resources

from ddpc_cosim.files.time_tables import LARGEST
from ddpc_cosim.fmu.description.defects import Findings
from ddpc_cosim.fmu.resources import Resources, read_resources, usual_unit
from ddpc_cosim.inspection import as_data, inspect_fmu


def read(folder: Path, **files: str | bytes) -> tuple[Resources, list[str]]:
    """Return what an archive with these files says, and what is wrong with it."""
    path = folder / "a.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(f"resources/{name.replace('_', '.')}", content)
    findings = Findings()
    resources = read_resources(path, findings)
    return resources, [f"{defect.severity}: {place}" for defect in findings for place in defect.places]


def test_inspect_shows_what_the_resources_say(pendulum_fmu: Path, tmp_path: Path) -> None:
    files = files_of_a_house()
    inspection = inspect_fmu(with_resources(pendulum_fmu, tmp_path, files))
    resources = inspection.resources
    assert set(files) <= set(resources.files)
    assert (resources.name, resources.area, resources.step) == ("house", 120.0, 1800.0)
    assert (resources.warm_up, resources.start_time) == (86_400.0, 0.0)
    assert resources.days == {"peak_heat_day": 23, "typical_heat_day": 115}
    assert resources.key_figures["ElectricPower"] == ("heating_power",)
    said = as_data(inspection)["resources"]
    assert json.loads(json.dumps(said)) == said
    (weather,) = [table for table in said["tables"] if table["file"] == "weather.csv"]
    assert (weather["rows"], weather["from"], weather["to"]) == (8761, 0.0, 31_536_000.0)
    column = weather["columns"][0]
    assert (column["name"], column["unit"]) == ("TDryBul", "K")
    figures = [OUTDOORS.min(), OUTDOORS.mean(), OUTDOORS.max()]
    np.testing.assert_allclose([column[key] for key in ("min", "mean", "max")], figures)
    (absent,) = [defect for defect in inspection.defects if defect.kind.name == "no-key-output"]
    assert absent.places[-1] == 'CO2Concentration[1]: "no_such_output"'


def test_inspect_prints_one_line_for_each_day_source_table_and_column(
    pendulum_fmu: Path, tmp_path: Path, run_program: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    path = with_resources(pendulum_fmu, tmp_path, files_of_a_house())
    lines = run_program("inspect", str(path)).stdout.splitlines()
    assert "case\thouse, 120 m2, step 30 min, warm-up 1 d, start 0 s" in lines
    assert "day\tpeak_heat_day\t23" in lines
    assert "key figure\tElectricPower\theating_power" in lines
    assert "table\tsetpoints.csv\t8761 rows\tbegins 0 s\tends 365 d\tcomes again after its end" in lines
    assert "column\tUpperSetp[1]\t[K]\tmin 299.15\tmean 299.15\tmax 299.15\tsetpoints.csv" in lines


def test_an_fmu_without_such_files_says_nothing_of_them(tmp_path: Path) -> None:
    assert read(tmp_path) == (Resources(), [])


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({"config_json": "{"}, "warning: config.json, line 1: not JSON"),
        ({"config_json": "[" * 100_000}, "warning: config.json: not JSON"),
        ({"config_json": '{"area": NaN}'}, "warning: config.json: not JSON: NaN is not a number of JSON"),
        ({"config_json": b"\xff\xfe\x00"}, "warning: config.json: not JSON"),
        ({"config_json": "[1, 2]"}, "warning: config.json: [1, 2]; needed: a JSON object"),
        ({"config_json": '{"area": -1}'}, "warning: config.json: area = -1; needed: a finite number > 0"),
        ({"config_json": '{"step": "fast"}'}, "warning: config.json: step = 'fast'; needed"),
        ({"config_json": '{"step": true}'}, "warning: config.json: step = True; needed"),
        ({"config_json": '{"warmup_period": 1e999}'}, "warning: config.json: warmup_period = inf; needed"),
        ({"config_json": b" " * 2_000_000}, "warning: config.json: is too large; allowed: 1 MB"),
        ({"days_json": '{"cold": 400}'}, "warning: days.json: 'cold' = 400; needed: a day of the year"),
        ({"days_json": '{"cold": 1.5}'}, "warning: days.json: 'cold' = 1.5; needed"),
        ({"kpis_json": '{"ElectricPower": "p"}'}, "warning: kpis.json: 'ElectricPower': 'p'; needed: a list"),
        ({"w_csv": "a,b\n1,2\n"}, 'note: w.csv: no column "time" (it begins with a, b)'),
        ({"w_csv": ""}, "note: w.csv: is empty"),
        ({"w_csv": "time,a\n0,x\n1,2\n"}, 'warning: w.csv, line 2, column "a": "x" is not a finite number'),
    ],
)
def test_what_is_wrong_with_a_file_is_told_and_left_out(
    tmp_path: Path, files: dict[str, str | bytes], told: str
) -> None:
    resources, defects = read(tmp_path, **files)
    assert any(defect.startswith(told) for defect in defects), defects
    assert (resources.area, resources.step, resources.warm_up, dict(resources.days)) == (None, None, None, {})
    assert not resources.key_figures


def test_a_table_that_unpacks_to_more_than_is_allowed_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("resources/bomb.csv", b"0" * (LARGEST + 10))
    findings = Findings()
    assert read_resources(path, findings).tables == ()
    assert "bomb.csv: is too large; allowed: 100 MB" in str(next(iter(findings)))


def test_units_are_those_of_the_convention_for_all_zones() -> None:
    said = ["TDryBul", "HGloHor", "LowerSetp[nor]", "InternalGainsRad[1]", "PriceGasPower", "Occupancy[1]"]
    assert [usual_unit(column) for column in said] == ["K", "W/m2", "K", "W", "EUR/kWh", "1"]
    assert [usual_unit(column) for column in ("EmissionsGasPower", "UpperCO2[a]", "x")] == [
        "kg/kWh",
        "ppm",
        "",
    ]


def test_they_are_read_without_a_runtime_of_fmus() -> None:
    code = "import sys, ddpc_cosim.fmu.resources; print('fmpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
