"""``ddpc-cosim export``: what PLANT may be, what is printed, what is refused."""

import fmpy
import pytest

from ddpc_cosim.cli.commands import export
from ddpc_cosim.errors import ConfigError, CosimError, PluginError

OWN_PLANT = """
from fmu_plants import Equations, PlantModel, Variable

LEVEL = Variable("level", "m")
MODEL = PlantModel(
    name="tank",
    states=(LEVEL,),
    inputs=(Variable("inflow", "m/s"),),
    outputs=(LEVEL,),
    equations=lambda v: Equations({"level": v.inflow - v.level / 10}),
)
WRONG = PlantModel(
    name="wrong", states=(LEVEL,), outputs=(LEVEL,), equations=lambda v: Equations({"level": v.outflow})
)
NOTHING = 3


class SYSTEM:
    A, B, C, D = [[-1.0]], [[1.0]], [[1.0]], [[0.0]]
"""


def export_command(*arguments):
    assert export.export.main(list(map(str, arguments)), standalone_mode=False) == 0


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to be in, with a plant in a module of its own name; libraries are left empty."""
    monkeypatch.setattr("fmu_plants.export.compile_library", lambda *_, **__: b"")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plant_of_mine.py").write_text(OWN_PLANT, encoding="utf-8")
    return tmp_path


def test_an_installed_plant_by_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    export_command("pendulum")
    assert capsys.readouterr() == ("pendulum.fmu\n", "")
    assert fmpy.read_model_description("pendulum.fmu").fmiVersion == "2.0"


@pytest.mark.parametrize(
    "target", ["plant_of_mine:MODEL", "plant_of_mine.py:MODEL", "./plant_of_mine.py:MODEL"]
)
def test_a_plant_of_the_user_s_own(folder, target):
    export_command(target, "--fmi", "3.0")
    description = fmpy.read_model_description("tank.fmu")
    assert (description.fmiVersion, description.modelName) == ("3.0", "tank")


def test_a_file_elsewhere_may_import_what_stands_beside_it(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("else where")
    (elsewhere / "values_of_mine.py").write_text("NAME = 'renamed'", encoding="utf-8")
    changed = OWN_PLANT.replace('name="tank"', "name=NAME")
    (elsewhere / "plant.py").write_text(f"from values_of_mine import NAME\n{changed}", encoding="utf-8")
    out = folder / "out.fmu"
    export_command(f"{elsewhere / 'plant.py'}:MODEL", "--out", out)
    assert fmpy.read_model_description(str(out)).modelName == "renamed"


def test_a_state_space_model(folder):
    export_command("plant_of_mine.py:SYSTEM")
    assert fmpy.read_model_description("system.fmu").modelName == "system"


def test_progress_goes_to_stderr(folder, capsys):
    export_command("pendulum", "--platforms", "linux-x86_64,linux-arm64")
    captured = capsys.readouterr()
    assert captured.out == "pendulum.fmu\n"
    assert captured.err.splitlines() == [
        "compiling for linux-x86_64 (1 of 2)",
        "compiling for linux-arm64 (2 of 2)",
    ]


@pytest.mark.parametrize(
    ("target", "error", "message"),
    [
        ("pendlum", PluginError, 'no plant "pendlum"; did you mean "pendulum"'),
        ("no_such_module:MODEL", PluginError, "No module named 'no_such_module'"),
        ("plant_of_mine:MODLE", PluginError, "MODLE"),
        ("plant_of_mine.py:MODLE", PluginError, 'has no "MODLE"; it has: .*MODEL'),
        ("plant_of_mine.py:NOTHING", ConfigError, "not given by equations"),
        ("plant_of_mine.py:WRONG", ConfigError, "the equations use an unknown 'outflow'; there are: level"),
        ("plant_of_mine.py", PluginError, "name the model in the file, for example plant_of_mine.py:MODEL"),
        ("absent.py:MODEL", PluginError, '"absent.py": no such file'),
    ],
)
def test_what_cannot_be_exported_is_refused(folder, target, error, message):
    with pytest.raises(error, match=message):
        export_command(target)
    assert not list(folder.glob("*.fmu"))


def test_a_file_that_fails_is_refused_with_its_error(folder):
    (folder / "broken.py").write_text("1 / 0", encoding="utf-8")
    with pytest.raises(PluginError, match=r"broken.py.* cannot be loaded: ZeroDivisionError"):
        export_command("broken.py:MODEL")


def test_an_unknown_platform_is_refused(folder):
    with pytest.raises(CosimError, match='no platform "amiga"; there are: all, '):
        export_command("pendulum", "--platforms", "amiga")
