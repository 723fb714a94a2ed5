"""The halves of the oscillator as FMUs."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from fmu_plants import PlantModel, export_fmu

Exported = Callable[..., Path]


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Export a model once for an FMI version."""
    folder = tmp_path_factory.mktemp("coupled")

    @cache
    def export(model: PlantModel, version: str = "2.0") -> Path:
        (folder / version).mkdir(exist_ok=True)
        return export_fmu(model, folder / version / f"{model.name}.fmu", version)

    return export
