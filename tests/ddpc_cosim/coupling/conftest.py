"""The halves of the oscillator as FMUs."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from fmu_plants import PlantModel, export_fmu

Exported = Callable[[PlantModel], Path]


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Export a model once."""
    folder = tmp_path_factory.mktemp("coupled")
    return cache(lambda model: export_fmu(model, folder / f"{model.name}.fmu"))
