"""Plug-ins of third parties: by entry point, or as ``module:Class``."""

import importlib
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest
from click.testing import CliRunner
from studies import cases_in, study_text, write

from ddpc_cosim import ConfigError, PluginError
from ddpc_cosim.cli.main import main
from ddpc_cosim.plugins import (
    code_version,
    installed,
    load_plugin,
    load_target,
    plugin_names,
    source_hash,
    types_in,
)
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.reading import read_study

MODULE = '''
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller, Plant, Variable, setting

@dataclass(kw_only=True)
class Proportional(Controller):
    """u = gain * error, without [brackets] of markup.

    More about it.
    """
    gain: float = setting(1.0, low=0.0, doc="gain")
    def start(self, loop): pass
    def step(self, sample): return self.gain * (sample.reference[0] - sample.y)

class Lag(Plant):
    """A first-order lag."""
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        self.y = np.zeros(1)
        return self.y
    def step(self, u, h):
        self.y = self.y + h * (u - self.y)
        return self.y

class Refusing(Lag):
    def __init__(self):
        raise RuntimeError("no licence")

study = __file__.replace("thirdparty.py", "lag.toml")
'''

STUDY = study_text(
    title="A lag [of first order]",
    plant={"name": "lag"},
    reference={"y": 1.0},
    controllers={"p": {"type": "proportional", "settings": {"gain": 2.0}}},
)

ENTRY_POINTS = """
[ddpc_cosim.plants]
lag = thirdparty:Lag
[ddpc_cosim.controllers]
proportional = thirdparty:Proportional
[ddpc_cosim.studies]
lag-study = thirdparty:study
"""

BROKEN = """
broken = nowhere:Nothing
exiting = exits:Nothing
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of installed packages with a third party's one."""
    info = tmp_path / "thirdparty-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: thirdparty\nVersion: 1.2\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(ENTRY_POINTS, encoding="utf-8")
    (tmp_path / "thirdparty.py").write_text(MODULE, encoding="utf-8")
    (tmp_path / "lag.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "exits.py").write_text("raise SystemExit('bye')", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


@pytest.fixture
def broken_site(site: Path) -> Path:
    """The same with two plug-ins that cannot be loaded."""
    entry_points = ENTRY_POINTS.replace("[ddpc_cosim.studies]", f"{BROKEN}[ddpc_cosim.studies]")
    (site / "thirdparty-1.2.dist-info" / "entry_points.txt").write_text(entry_points, encoding="utf-8")
    importlib.invalidate_caches()
    return site


def test_built_ins_are_plug_ins_like_any_other() -> None:
    assert "pendulum" in plugin_names("plants")
    assert {"deepc", "wkpc", "mfapc"} <= set(plugin_names("controllers"))
    assert "paper" in plugin_names("studies")
    assert "html" in plugin_names("reports")
    for kind in ("plants", "controllers", "studies", "reports"):
        for plugin in installed(kind):
            assert plugin.error == ""
            assert plugin.package.startswith("ddpc-cosim ")


def test_plug_ins_of_third_parties_are_found(site: Path) -> None:
    (plugin,) = (plugin for plugin in installed("controllers") if plugin.name == "proportional")
    assert (plugin.target, plugin.package, plugin.error) == ("thirdparty:Proportional", "thirdparty 1.2", "")
    assert load_plugin("controllers", "proportional") is load_plugin("controllers", "thirdparty:Proportional")


@pytest.mark.xdist_group("modules of one name")
@pytest.mark.parametrize("value", [1, 2])
def test_modules_of_one_name_in_two_tests_are_two(
    value: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in ("own.py", "own_package/__init__.py", "own_parts/part.py"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(f"VALUE = {value}", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    for module in ("own", "own_package", "own_parts.part"):
        assert load_target(f"{module}:VALUE", "plant") == value


def test_a_study_of_third_party_plug_ins_runs(site: Path) -> None:
    """y' = u - y with u = 2 (1 - y), by Euler's method: y goes to 2/3."""
    result = CliRunner().invoke(main, ["run", "lag-study", "--out", str(site / "out"), "--no-report"])
    assert result.exit_code == 0, result.output
    (run,) = (path for path in site.glob("out/cases/*/signals.csv") if "doing-nothing" not in str(path))
    rows = [line.split(",") for line in run.read_text(encoding="utf-8").splitlines()]
    y = [float(row[rows[0].index("y [1]")]) for row in rows[1:]]
    expected = [0.0]
    for _ in range(10):
        expected.append(expected[-1] + 0.1 * (2.0 * (1.0 - expected[-1]) - expected[-1]))
    assert y == pytest.approx(expected, rel=1e-12)


def test_the_list_shows_them(site: Path) -> None:
    result = CliRunner().invoke(main, ["list"])
    assert result.exit_code == 0
    for text in (
        "u = gain * error, without [brackets] of markup.",
        "thirdparty 1.2 (thirdparty:Proportional)",
        "A first-order lag.",
        "A lag [of first order]",
        "Pendulum driven by a torque",
        "Comparative analysis of data-driven predictive control strategies",
    ):
        assert text in result.stdout


def test_the_list_can_be_of_one_kind(site: Path) -> None:
    result = CliRunner().invoke(main, ["list", "plants"])
    assert "lag" in result.stdout
    assert "proportional" not in result.stdout
    assert CliRunner().invoke(main, ["list", "everything"]).exit_code == 2


def test_a_broken_plug_in_is_listed_with_its_error(broken_site: Path) -> None:
    result = CliRunner().invoke(main, ["list"])
    assert result.exit_code == 1
    assert "broken: ModuleNotFoundError: No module named 'nowhere'" in result.stdout
    assert "broken: SystemExit: bye" in result.stdout
    assert "proportional" in result.stdout


def test_a_broken_study_is_listed_with_its_error(site: Path) -> None:
    (site / "lag.toml").unlink()
    result = CliRunner().invoke(main, ["list", "studies"])
    assert result.exit_code == 1
    assert "broken: FileNotFoundError" in result.stdout


def test_a_broken_plug_in_says_so_when_it_is_used(broken_site: Path) -> None:
    with pytest.raises(
        PluginError,
        match=r'controller "broken" \(nowhere:Nothing, thirdparty 1\.2\) cannot be loaded: ModuleNotFound',
    ):
        load_plugin("controllers", "broken")


def test_a_name_that_two_packages_have_is_nobodys(site: Path) -> None:
    """Which of them was meant would depend on the order of installation."""
    info = site / "other-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 2.0\n", encoding="utf-8")
    entries = (
        "[ddpc_cosim.controllers]\nmfapc = thirdparty:Proportional\nproportional = thirdparty:Proportional\n"
    )
    (info / "entry_points.txt").write_text(entries, encoding="utf-8")
    importlib.invalidate_caches()
    with pytest.raises(PluginError) as caught:
        load_plugin("controllers", "mfapc")
    assert str(caught.value).startswith('there are several controllers called "mfapc": of ')
    for origin in ("other 2.0 (thirdparty:Proportional)", "(ddpc_controllers.mfac:MFAPC)", "; write "):
        assert origin in str(caught.value)
    assert load_plugin("controllers", "proportional").__name__ == "Proportional"  # the same thing twice
    assert plugin_names("controllers").count("mfapc") == 1
    errors = [plugin.error for plugin in installed("controllers") if plugin.name == "mfapc"]
    assert errors == ["another package has a mfapc too; uninstall one"] * 2


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        ("controllers", "deepcc", 'no controller "deepcc"; did you mean "deepc"?'),
        ("plants", "boat", 'no plant "boat"; there are: '),
        ("studies", "papre", 'no study "papre"; did you mean "paper"?'),
        ("reports", "htm", 'no report "htm"; did you mean "html"?'),
        ("controllers", "nowhere:X", 'controller "nowhere:X" cannot be loaded: ModuleNotFoundError'),
        ("controllers", "math:", 'controller "math:" cannot be loaded: AttributeError'),
        ("controllers", ":X", 'controller ":X" cannot be loaded: ValueError'),
        ("plants", "exits:X", 'plant "exits:X" cannot be loaded: SystemExit: bye'),
    ],
)
def test_a_plug_in_that_is_not_there(site: Path, kind: str, name: str, words: str) -> None:
    with pytest.raises(PluginError) as caught:
        load_plugin(kind, name)
    assert str(caught.value).startswith(words)


def test_a_plant_that_cannot_be_made_is_a_fault_of_the_study(site: Path) -> None:
    (site / "lag.toml").write_text(STUDY.replace('"lag"', '"thirdparty:Refusing"'), encoding="utf-8")
    result = CliRunner().invoke(main, ["run", "lag-study"])
    assert result.exit_code == 2
    assert 'lag.toml:4: plant.name: plant "thirdparty:Refusing": RuntimeError: no licence' in result.stderr


def test_parameters_of_a_plant_that_has_none_are_faults(site: Path) -> None:
    text = STUDY.replace("[loop]", "parameters = { mass = 1.0 }\n[loop]")
    (site / "lag.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r'plant\.parameters: no parameter "mass"; there are none'):
        read_study("lag-study")


def test_the_version_of_the_code_covers_the_package_that_a_plug_in_is_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A module, a package, and a namespace package, which has no file of its own."""
    monkeypatch.syspath_prepend(str(tmp_path))
    for number, path in enumerate(["single.py", "whole/__init__.py", "space/part/deep.py"]):
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(MODULE, encoding="utf-8")
        name = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        hashes = set()
        for change in ("", "# changed"):
            file.write_text(MODULE + change, encoding="utf-8")
            code_version.cache_clear()
            source_hash.cache_clear()
            hashes.add(code_version(f"{name}:Proportional"))
        assert len(hashes) == 2, number


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


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a plant and a controller in modules of their own."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    return tmp_path


def forget_versions() -> None:
    code_version.cache_clear()
    source_hash.cache_clear()


def only_case(folder: Path, gain: str = "lag:Gain") -> Case:
    """Return the case of the study, seen as a new process sees it."""
    forget_versions()
    controller = {"type": "lag:Proportional", "settings": {"gain": {"type": gain}}}
    text = study_text(plant={"name": "lag:Lag"}, reference={"y": 1.0}, controllers={"p": controller})
    (case,) = cases_in(write(folder, text))
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
    forget_versions()
    assert source_hash("gains") != before


def test_a_module_that_is_installed_does_not_bring_its_neighbours(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "sysconfig.get_paths", lambda: dict.fromkeys(("stdlib", "purelib", "platlib"), folder)
    )
    importlib.import_module("lag")
    forget_versions()
    before = source_hash("lag")
    (folder / "tools.py").write_text("filters = 2", encoding="utf-8")
    forget_versions()
    assert source_hash("lag") == before


def test_types_are_found_at_any_depth() -> None:
    section = {"type": "a", "settings": {"parts": [{"type": "b", "inner": {"type": "c"}}], "type": 3}}
    assert list(types_in(section)) == ["a", "b", "c"]


def test_a_word_that_names_no_class_has_no_code() -> None:
    assert code_version("butterworth") == ""
