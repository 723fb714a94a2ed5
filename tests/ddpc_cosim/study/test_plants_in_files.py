"""Plants in files: ``name = "tank.py:MODEL"``, relative to the study, in Python relative to where one is."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studies import cases_in, run_file

from ddpc_controllers import NMPC, PID
from ddpc_cosim import ConfigError, Constant, PluginError, Problem, Study, simulate
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.results import StudyResults

TANK = """
import numpy as np
from ddpc_cosim import Plant, Variable
from fmu_plants import Equations, PlantModel
from {beside} import SLOPE

LEVEL = Variable("level", "m")
START = 0.0

class Tank(Plant):
    inputs, outputs = (Variable("inflow"),), (Variable("level"),)
    def reset(self, parameters=None, t0=0.0):
        self.level = np.full(1, START)
        return self.level.copy()
    def step(self, u, h):
        self.level = self.level + h * (u - SLOPE * self.level)
        return self.level.copy()

def model():
    from fmu_plants import Variable
    level = Variable("level", "m")
    return PlantModel(
        name="tank_of_a_file",
        states=(level,),
        inputs=(Variable("inflow", "m/s"),),
        outputs=(level,),
        equations=lambda v: Equations({{"level": v.inflow - SLOPE * v.level}}),
    )

MODEL = model()
"""
STUDY = """
[plant]
{plant}
[loop]
sampling_time = 0.1
duration = 0.5
[reference]
{level} = {{ kind = "constant", value = 1.0 }}
[bounds]
{inflow} = {{ min = -5.0, max = 5.0 }}
[controllers.pid]
type = "pid"
settings = {{ proportional = 1.0 }}
"""

WriteFolder = Callable[..., Path]


@pytest.fixture
def write_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> WriteFolder:
    """Write a study, with a plant in a folder beside it; one is elsewhere."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")

    def write(
        name: str = "here", plant: str = 'name = "models/tank.py:MODEL"', *, more: str = "", part: str = ""
    ) -> Path:
        models = tmp_path / name / "models"
        models.mkdir(parents=True)
        (models / "tank.py").write_text(TANK.format(beside=f"slope_of_{name}"), encoding="utf-8")
        (models / f"slope_of_{name}.py").write_text("SLOPE = 0.5\n", encoding="utf-8")
        study = tmp_path / name / "study.toml"
        text = STUDY.format(plant=plant, level=f'"{part}level"', inflow=f'"{part}inflow"')
        study.write_text(text + more, encoding="utf-8")
        return study

    return write


def level(results: StudyResults) -> list[float]:
    (case,) = [case for case in results.cases if case.controller == "pid"]
    assert case.outcome == "completed", case.reason
    return case.trace().y[:, 0].tolist()


def test_equations_and_classes_run(write_folder: WriteFolder) -> None:
    """They are relative to the study file, and import what is beside them; the equations are exact."""
    exact = level(run_file(write_folder("equations")))
    assert exact[1] == pytest.approx((1 - np.exp(-0.05)) / 0.5, rel=1e-4)
    assert level(run_file(write_folder("classes", 'name = "models/tank.py:Tank"')))[1] == pytest.approx(0.1)


def test_parts_of_a_coupled_plant_may_be_in_files(write_folder: WriteFolder) -> None:
    study = write_folder(plant='parts = [{ name = "one", plant = "models/tank.py:Tank" }]', part="one.")
    assert level(run_file(study))[1] == pytest.approx(0.1)


def test_a_problem_of_another_folder_has_its_plant_there(write_folder: WriteFolder) -> None:
    other = write_folder("other", 'name = "models/tank.py:Tank"')
    study = other.parent.parent / "study.toml"
    study.write_text('[problems.tank]\nstudy = "other/study.toml"\n', encoding="utf-8")
    study.write_text(
        study.read_text(encoding="utf-8") + '[controllers.pid]\ntype = "pid"\n', encoding="utf-8"
    )
    (problem,) = read_study(str(study)).problems.values()
    assert list(problem.plant.variables().outputs) == ["level"]


def test_the_resolved_study_can_be_run_from_anywhere(write_folder: WriteFolder, tmp_path: Path) -> None:
    first = run_file(write_folder())
    assert [case.id for case in first.cases] == ids(first.folder / "study.toml")
    assert first.study.plant.label == "tank.py:MODEL"


def ids(study: Path) -> list[str]:
    return [case.id for case in cases_in(study)]


@pytest.mark.parametrize("what", ["MODEL", "Tank"])
def test_what_the_file_says_decides_the_id_of_cases_and_not_where_it_is(
    write_folder: WriteFolder, what: str
) -> None:
    """Also of a file of the same length that is changed within the same second."""
    study = write_folder(f"a_{what.lower()}", f'name = "models/tank.py:{what}"')
    before = ids(study)
    assert ids(study) == before
    moved = study.parent.with_name(f"b_{what.lower()}")
    study.parent.rename(moved)
    assert ids(moved / "study.toml") == before
    file = moved / "models" / "tank.py"
    changed = file.read_text(encoding="utf-8").replace("SLOPE * ", "3.000 * ")
    file.write_text(changed, encoding="utf-8")
    assert ids(moved / "study.toml") != before


def test_a_problem_in_python_has_a_plant_in_a_file(
    write_folder: WriteFolder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Relative to where one is when it is made into a study; a controller may know the equations."""
    monkeypatch.chdir(write_folder().parent)
    problem = Problem(
        plant="models/tank.py:MODEL",
        sampling_time=0.1,
        duration=0.5,
        reference={"level": Constant(1.0)},
        bounds={"inflow": (-5.0, 5.0)},
    )
    study = Study(problem, {"pid": PID(proportional=1.0), "nmpc": NMPC(horizon=5)})
    monkeypatch.chdir(tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path / "here")
    results = study.run(tmp_path / "out", progress=False)
    assert [case.outcome for case in results.cases] == ["completed"] * 2, [c.reason for c in results.cases]


def test_open_loop(write_folder: WriteFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(write_folder().parent)
    assert len(simulate("models/tank.py:MODEL", stop=1.0, step=0.1)) == 11


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("models/tank.py", "name the model in the file, for example models/tank.py:MODEL"),
        ("models/tonk.py:MODEL", r'models/tonk\.py": no such file'),
        ("models/tank.py:MODLE", r'models/tank\.py" has no "MODLE"; it has: .*MODEL'),
        ("models/tank.py:START", "is neither a PlantModel nor a Plant class"),
    ],
)
def test_what_cannot_be_is_told_at_its_line(write_folder: WriteFolder, name: str, words: str) -> None:
    study = write_folder(plant=f'name = "{name}"')
    with pytest.raises(ConfigError, match=words) as error:
        read_study(str(study))
    assert str(error.value).startswith("study.toml:3: plant.name: ")


def test_a_file_that_fails_is_told_with_its_error(write_folder: WriteFolder) -> None:
    study = write_folder()
    (study.parent / "models" / "tank.py").write_text("1 / 0", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"tank\.py:MODEL\" cannot be loaded: ZeroDivisionError"):
        read_study(str(study))


def test_two_files_of_one_name_are_two(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "same.py").write_text(f"VALUE = '{name}'", encoding="utf-8")
        assert load_plugin("plants", f"{tmp_path / name / 'same.py'}:VALUE") == name
    with pytest.raises(PluginError, match="no such file"):
        load_plugin("plants", f"{tmp_path / 'three' / 'same.py'}:VALUE")
