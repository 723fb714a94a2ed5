"""FMUs of tests that have weather, prices and comfort in their resources, by BOPTEST's names."""

import json
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

HOURS = np.arange(8761) * 3600.0
OUTDOORS = 278 + 8 * np.sin(2 * np.pi * HOURS / 86_400)
SUN = np.maximum(0.0, 500 * np.sin(2 * np.pi * (HOURS / 86_400 - 0.25)))
BY_DAY = (HOURS / 3600 % 24 >= 7) & (HOURS / 3600 % 24 < 21)


def csv(columns: Mapping[str, Any]) -> str:
    """Return a table over the hours of a year."""
    cells = [np.broadcast_to(column, HOURS.shape).tolist() for column in columns.values()]
    rows = (",".join(map(repr, row)) for row in zip(HOURS.tolist(), *cells, strict=True))
    return "\n".join([",".join(["time", *columns]), *rows, ""])


def files_of_a_house() -> dict[str, str]:
    """Return the resources of the plant `building`, as its author would have said them."""
    kinds = {"Constant": 0.25, "Dynamic": np.where(BY_DAY, 0.3, 0.2)}
    comfort = {"LowerSetp[1]": np.where(BY_DAY, 294.15, 290.15), "UpperSetp[1]": 299.15}
    key_figures = {
        "AirZoneTemperature[1]": ["indoor_temperature"],
        "ElectricPower": ["heating_power"],
        "CO2Concentration[1]": ["no_such_output"],
    }
    config = {"name": "house", "area": 120.0, "start_time": 0.0, "warmup_period": 86_400.0, "step": 1800.0}
    return {
        "config.json": json.dumps(config),
        "days.json": json.dumps({"peak_heat_day": 23, "typical_heat_day": 115}),
        "kpis.json": json.dumps(key_figures),
        "weather.csv": csv({"TDryBul": OUTDOORS, "HGloHor": SUN}),
        "setpoints.csv": csv(comfort),
        "prices.csv": csv({f"PriceElectricPower{kind}": price for kind, price in kinds.items()}),
        "emissions.csv": csv({"EmissionsElectricPower": 0.167}),
    }


def with_resources(fmu: Path, folder: Path, files: Mapping[str, str | bytes]) -> Path:
    """Return a copy of an FMU in a folder, called as a stranger would, with files in its resources."""
    copy = folder / "stranger.fmu"
    shutil.copy(fmu, copy)
    with zipfile.ZipFile(copy, "a") as archive:
        for name, content in files.items():
            archive.writestr(f"resources/{name}", content)
    return copy
