"""The code that decides a result: a change of it is another version, a change beside it is not."""

import importlib
import sys
from collections.abc import Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from ddpc_cosim.plugins import code_version, source_hash, types_in
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.reading import read_study

LAG = """
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller, Plant, Variable, setting
from tools import filters
import gains.table

@dataclass(kw_only=True)
class Gain:
    value: float = setting(1.0, doc="value")

@dataclass(kw_only=True)
class Proportional(Controller):
    gain: object = setting(default_factory=Gain, doc="gain")
    def start(self, loop): pass
    def step(self, sample): return self.gain.value * (sample.reference[0] - sample.y)

class Lag(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0): return np.zeros(1)
    def step(self, u, h): return np.zeros(1)
"""

FILES = {
    "lag.py": LAG,
    "tools.py": "import limits\nfilters = 1\n",
    "limits.py": "",
    "gains/__init__.py": "",
    "gains/table.py": "",
    "other.py": "from lag import Gain as Base\nclass Gain(Base): pass\n",
    "unrelated.py": "",
    "notes.txt": "",
}

STUDY = """
[plant]
name = "lag:Lag"
[loop]
sampling_time = 0.1
duration = 1.0
[reference]
y = {{ kind = "constant", value = 1.0 }}
[controllers.p]
type = "lag:Proportional"
settings = {{ gain = {{ type = "{gain}" }} }}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a plant and a controller in modules of their own."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    modules = ("lag", "tools", "limits", "gains", "gains.table", "other")
    for module in modules:
        monkeypatch.delitem(sys.modules, module, raising=False)
    importlib.invalidate_caches()
    yield tmp_path
    for module in modules:
        sys.modules.pop(module, None)
    forget()


def forget() -> None:
    code_version.cache_clear()
    source_hash.cache_clear()


def only_case(folder: Path, gain: str = "lag:Gain") -> Case:
    """Return the case of the study, seen as a new process sees it."""
    forget()
    study = folder / "study.toml"
    study.write_text(STUDY.format(gain=gain), encoding="utf-8")
    resolved = read_study(str(study))
    (case,) = cases_of(resolved, resolved.plant.built())
    return case


@pytest.mark.parametrize(
    ("name", "decides"), [(name, name not in ("other.py", "unrelated.py", "notes.txt")) for name in FILES]
)
def test_modules_beside_a_plug_in_decide_if_it_imports_them(name: str, decides: bool, folder: Path) -> None:
    before = only_case(folder).id
    assert only_case(folder).id == before
    with (folder / name).open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert (only_case(folder).id != before) == decides


def test_the_class_of_an_object_in_the_settings_decides_too(folder: Path) -> None:
    before = only_case(folder, "other:Gain").id
    with (folder / "other.py").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert only_case(folder, "other:Gain").id != before


@pytest.mark.parametrize("suffix", EXTENSION_SUFFIXES)
def test_compiled_modules_of_a_package_decide(suffix: str, folder: Path) -> None:
    importlib.import_module("gains.table")
    before = source_hash("gains")
    (folder / "gains" / f"fast{suffix}").write_bytes(b"machine code")
    forget()
    assert source_hash("gains") != before


def test_a_module_that_is_installed_does_not_bring_its_neighbours(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "sysconfig.get_paths", lambda: dict.fromkeys(("stdlib", "purelib", "platlib"), folder)
    )
    importlib.import_module("lag")
    forget()
    before = source_hash("lag")
    (folder / "tools.py").write_text("filters = 2", encoding="utf-8")
    forget()
    assert source_hash("lag") == before


def test_types_are_found_at_any_depth() -> None:
    section = {"type": "a", "settings": {"parts": [{"type": "b", "inner": {"type": "c"}}], "type": 3}}
    assert list(types_in(section)) == ["a", "b", "c"]


def test_a_word_that_names_no_class_has_no_code() -> None:
    assert code_version("butterworth") == ""
