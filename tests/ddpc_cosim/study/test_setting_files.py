"""Settings that name files: where they are looked for, and what hangs on their content."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studies import PENDULUM, cases_in, run_file, study_text, write

from ddpc_cosim import (
    ConfigError,
    Controller,
    Loop,
    Outcome,
    Plant,
    Sample,
    Variable,
    check_settings,
    setting,
)
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import Case


@dataclass(kw_only=True)
class Source:
    """An object among the settings that reads a number from a file."""

    path: str = setting("{plant}", file=True, doc="a file that begins with a number, or an FMU")

    def read(self) -> float:
        content = Path(self.path).read_bytes()
        return 0.25 if content.startswith(b"PK") else float(content)


@dataclass(kw_only=True)
class Held(Controller):
    """Hold the number of a file."""

    source: Source = setting(default_factory=Source, doc="where it comes from")
    others: list[Source] = setting(default_factory=list, doc="more of them")

    def __post_init__(self) -> None:
        check_settings(self)

    def start(self, loop: Loop) -> None:
        self._u = np.array([sum(source.read() for source in (self.source, *self.others))])

    def step(self, sample: Sample) -> np.ndarray:
        return self._u


class Line(Plant):
    """y = u, one sample later."""

    inputs = (Variable("u"),)
    outputs = (Variable("y"),)

    def reset(self, parameters: object = None, t0: float = 0.0) -> np.ndarray:
        return np.zeros(1)

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        return np.array(u)


def case_of(folder: Path, plant: dict[str, Any] = PENDULUM, **settings: Any) -> Case:
    text = study_text(
        plant=plant,
        reference={plant["outputs"][0]: 0.0},
        controllers={
            "held": {"type": "tests.ddpc_cosim.study.test_setting_files:Held", "settings": settings}
        },
        loop={"duration": 0.5},
    )
    (case,) = cases_in(write(folder, text))
    return case


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    folder = tmp_path / "numbers and words"
    folder.mkdir()
    (folder / "one.txt").write_text("1.0", encoding="utf-8")
    (folder / "two.txt").write_text("2.0", encoding="utf-8")
    return folder


def test_paths_are_relative_to_the_study(
    tmp_path: Path, numbers: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = {"type": "tests.ddpc_cosim.study.test_setting_files:Source", "path": str(numbers / "two.txt")}
    case = case_of(tmp_path, source={"path": "numbers and words/one.txt"}, others=[other])
    monkeypatch.chdir(numbers)
    trace = run_case(case)
    assert trace.outcome is Outcome.COMPLETED, trace.reason
    assert trace.u[0] == pytest.approx([3.0])


def test_the_plant_of_the_study_can_be_named_without_its_path(tmp_path: Path) -> None:
    assert run_case(case_of(tmp_path)).u[0] == pytest.approx([0.25])


def test_the_content_decides_the_case(tmp_path: Path, numbers: Path) -> None:
    def case_id() -> str:
        return case_of(tmp_path, source={"path": "numbers and words/one.txt"}).id

    before = case_id()
    assert case_id() == before
    (numbers / "one.txt").write_text("1.5", encoding="utf-8")
    assert case_id() != before


def test_the_resolved_study_says_where_the_file_is(tmp_path: Path, numbers: Path) -> None:
    case_of(tmp_path, source={"path": "numbers and words/one.txt"})
    out = tmp_path / "elsewhere" / "out"
    run_file(tmp_path / "study.toml", out)
    resolved = tomllib.loads((out / "study.toml").read_text(encoding="utf-8"))
    named = resolved["controllers"]["held"]["settings"]["source"]["path"]
    assert Path(named) == (numbers / "one.txt").resolve()


def test_files_that_are_not_there_are_faults_of_the_study(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"controllers\.held\.settings: .*none\.txt: no such file"):
        case_of(tmp_path, source={"path": "none.txt"})


def test_a_python_plant_has_no_fmu_to_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'"\{plant\}" stands for the FMU of the plant, which is a Python'):
        case_of(
            tmp_path,
            plant={
                "name": "tests.ddpc_cosim.study.test_setting_files:Line",
                "inputs": ["u"],
                "outputs": ["y"],
            },
        )
