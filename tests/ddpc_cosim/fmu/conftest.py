"""FMUs that other rooms and other makers write."""

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from fmu_plants import export_fmu
from fmu_plants.pendulum import MODEL

# How libraries find others is a matter of the loader.
collect_ignore = [] if sys.platform.startswith("linux") else ["test_companions.py", "test_stand_ins.py"]


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Export the pendulum for an FMI version: Co-Simulation and Model Exchange in one FMU."""
    folder = tmp_path_factory.mktemp("exported")

    @cache
    def export(version: str) -> Path:
        return export_fmu(MODEL, folder / f"pendulum{version[0]}.fmu", version)

    return export
