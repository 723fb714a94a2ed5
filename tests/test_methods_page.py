"""docs/methods/ has an entry for every controller, and the tables of pages are those of the code."""

import dataclasses
import importlib.util
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import pytest

from ddpc_cosim import KnownDisturbance, Price, Variable, setting
from ddpc_cosim.codec import Kinds, declared_fields
from ddpc_cosim.plugins import plugin_names
from ddpc_cosim.study.file_format.sections import (
    BoundsSection,
    ControllerSection,
    LoopSection,
    MetricsSection,
    PlantSection,
    RecordingSection,
    ReportSection,
    ScenarioSection,
    Study,
    StudyHead,
)

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
    for path in generator.PAGES:
        page = path.read_text(encoding="utf-8")
        assert generator.with_tables(page) == page, "run python docs/scripts/generate_settings.py"


def test_the_page_on_controllers_lists_what_settings_take_and_variables_have() -> None:
    page = (DOCS / "extend" / "write-a-controller-plug-in.md").read_text(encoding="utf-8")
    listed = {name for row in re.findall(r"^\| (`.*?`) \|", page, re.MULTILINE) for name in row.split(", ")}
    keywords = {f"`{name}`" for name in inspect.signature(setting).parameters}
    assert keywords - listed == {"`default`", "`default_factory`"}
    assert keywords - listed <= set(re.findall("`\\w+`", page))
    assert {f"`{field.name}`" for field in dataclasses.fields(Variable)} <= listed


def classes_below(kind: Any) -> Iterator[type[Any]]:
    """Yield a class of tables of a study file, and those of what its keys hold."""
    yield kind
    hints = [field.hint for field in declared_fields(kind).values()]
    while hints:
        hint = hints.pop()
        if isinstance(hint, type) and dataclasses.is_dataclass(hint) and not inspect.isabstract(hint):
            yield from classes_below(hint)
        for inner in get_args(hint):
            is_choice = isinstance(inner, Kinds)
            hints += [*inner.classes.values(), *inner.marked.values()] if is_choice else [inner]


def test_every_table_of_a_study_file_has_its_keys_on_their_page() -> None:
    page = (DOCS / "study-keys.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^<!-- keys: (\S+) -->$", page, re.MULTILINE))
    assert {f"{kind.__module__}:{kind.__name__}" for kind in classes_below(Study)} == listed


def test_the_overview_of_sections_names_every_key() -> None:
    """But what tools write: which study or controller another one is a variant of."""
    page = (DOCS / "studies.md").read_text(encoding="utf-8").partition("## Sections")[2].partition("## ")[0]
    rows = dict(re.findall(r"^\| `?(\w+)(?:\.[A-Z]+)?`? \| (.*) \|$", page, re.MULTILINE))
    sections = {
        "top": StudyHead,
        "plant": PlantSection,
        "loop": LoopSection,
        "bounds": BoundsSection,
        "disturbances": KnownDisturbance,
        "prices": Price,
        "recording": RecordingSection,
        "scenarios": ScenarioSection,
        "controllers": ControllerSection,
        "metrics": MetricsSection,
        "report": ReportSection,
    }
    for name, kind in sections.items():
        named = set(re.findall(r"`(\w+)(?:\.\w+)*`", rows[name]))
        assert {*declared_fields(kind)} - named <= {"based_on", "variant_of", "varied"}, name


@pytest.mark.parametrize("name", plugin_names("controllers"))
def test_every_controller_has_an_entry(name: str) -> None:
    tables = f"<!-- settings: {name} -->"
    pages = [path for path in (DOCS / "methods").glob("*.md") if tables in path.read_text(encoding="utf-8")]
    assert len(pages) == 1
    row = rf"^\| \[.+\]\({pages[0].name}\) \| .*`{name}`"
    assert re.search(row, (DOCS / "methods" / "index.md").read_text(encoding="utf-8"), re.MULTILINE)


def test_the_index_leads_to_every_page_on_methods() -> None:
    index = (DOCS / "methods" / "index.md").read_text(encoding="utf-8")
    pages = {path.name for path in (DOCS / "methods").glob("*.md")} - {"index.md"}
    assert pages <= set(re.findall(r"\]\(([\w-]+\.md)\)", index))
