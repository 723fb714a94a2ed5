"""docs/methods.md has an entry for every controller, and its tables are those of the code."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from ddpc_cosim.plugins import plugin_names

DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "generate_settings", DOCS / "scripts" / "generate_settings.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_tables_are_current(generator: ModuleType) -> None:
    page = (DOCS / "methods.md").read_text(encoding="utf-8")
    assert generator.with_tables(page) == page, "run python docs/scripts/generate_settings.py"


@pytest.mark.parametrize("name", plugin_names("controllers"))
def test_every_controller_has_an_entry(name: str) -> None:
    assert f"<!-- settings: {name} -->" in (DOCS / "methods.md").read_text(encoding="utf-8")
