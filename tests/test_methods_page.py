"""docs/methods.md has an entry for every controller, and the tables of pages are those of the code."""

import dataclasses
import importlib.util
import inspect
import re
from pathlib import Path
from types import ModuleType

import pytest

from ddpc_cosim import Variable, setting
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
    for name in generator.PAGES:
        page = (DOCS / name).read_text(encoding="utf-8")
        assert generator.with_tables(page) == page, "run python docs/scripts/generate_settings.py"


def test_the_page_on_controllers_lists_what_settings_take_and_variables_have() -> None:
    page = (DOCS / "extend" / "write-a-controller-plug-in.md").read_text(encoding="utf-8")
    listed = {name for row in re.findall(r"^\| (`.*?`) \|", page, re.MULTILINE) for name in row.split(", ")}
    keywords = {f"`{name}`" for name in inspect.signature(setting).parameters}
    assert keywords - listed == {"`default`", "`default_factory`"}
    assert keywords - listed <= set(re.findall("`\\w+`", page))
    assert {f"`{field.name}`" for field in dataclasses.fields(Variable)} <= listed


@pytest.mark.parametrize("name", plugin_names("controllers"))
def test_every_controller_has_an_entry(name: str) -> None:
    assert f"<!-- settings: {name} -->" in (DOCS / "methods.md").read_text(encoding="utf-8")
