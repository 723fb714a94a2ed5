"""FMUs that misbehave on purpose, and studies in files."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import pytest
import studies
from fmus.builder import CO_SIMULATION, GAINED, IDENTIFIER, Fault, describe, model_library, write_archive
from fmus.plants import model_fmu, mutate, pendulum_fmi3
from studies import study_text

__all__ = ["model_fmu", "mutate", "pendulum_fmi3"]  # fixtures

# Signals to process groups and terminals in software are matters of POSIX.
collect_ignore = (
    ["test_interrupt.py", "test_meddling.py", "test_terminal.py"] if sys.platform == "win32" else []
)

MakeFMU = Callable[..., Path]


@pytest.fixture
def make_fmu(tmp_path: Path) -> MakeFMU:
    """Write an FMU: an integrator, y' = gain * u, with a fault from t = 0.5 s on."""

    def make(
        fault: Fault = Fault.NO_FAULT,
        *,
        version: str = "2.0",
        interfaces: str = CO_SIMULATION,
        description: str | None = None,
        library: bytes | None = None,
        platform: str = fmpy.platform,
    ) -> Path:
        if description is None:
            description = describe("2.0", f"integrator:{fault:d}", GAINED, interfaces=interfaces)
        description = description.replace('fmiVersion="2.0"', f'fmiVersion="{version}"')
        files = {
            f"binaries/{platform}/{IDENTIFIER}{fmpy.sharedLibraryExtension}": library
            or model_library("2.0", complete=True)
        }
        if description:
            files["modelDescription.xml"] = description.encode()
        return write_archive(tmp_path / f"{fault.name.lower()}.fmu", files)

    return make


@pytest.fixture
def paper_text() -> str:
    """The built-in study as its file says it."""
    from ddpc_cosim.studies import paper

    return paper.read_text(encoding="utf-8")


WriteStudy = Callable[..., Path]


@pytest.fixture
def write_study(tmp_path: Path, make_fmu: MakeFMU) -> WriteStudy:
    """Write ``study.toml`` beside an FMU: one second of an integrator under the given controllers.

    Further tables stand in place of or beside those that it has.
    """

    def write(*controllers: str, seeds: str = "[0]", fault: Fault = Fault.NO_FAULT, **tables: Any) -> Path:
        given = {"plant": {"fmu": make_fmu(fault).name, "outputs": ["y"]}, "reference": {"y": 1.0}}
        text = study_text(**given | {"controllers": controllers} | tables)
        return studies.write(tmp_path, f"seeds = {seeds}\n{text}")

    return write
