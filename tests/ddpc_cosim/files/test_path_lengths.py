"""Paths on Windows: what this project composes is short; what is too long is said before the first case."""

import re
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path, PureWindowsPath

import pytest
from hypothesis import given, strategies as st
from studies import run_file

from ddpc_cosim import ConfigError, FMUImportError, FMUPlant
from ddpc_cosim.files.path_lengths import longest_excess
from ddpc_cosim.fmu import archive
from ddpc_cosim.processes.scratch import scratch_of_cases
from ddpc_cosim.study import runner
from ddpc_cosim.study.case_files import longest_files
from ddpc_cosim.study.cases import cases_of_problems, doing_nothing
from ddpc_cosim.study.reading import read_study

WriteStudy = Callable[..., Path]

NAMES = st.text(st.sampled_from("aB9-_.é𝛼"), min_size=1, max_size=80).filter(lambda name: name.strip("."))


def units(path: PureWindowsPath) -> int:
    """Return how many characters Windows counts."""
    return len(str(path).encode("utf-16-le")) // 2


@given(st.lists(NAMES, min_size=1, max_size=6), st.lists(NAMES, min_size=1, max_size=3))
def test_a_path_is_too_long_by_what_has_to_go(folders: list[str], files: list[str]) -> None:
    """Of 260 one is the end of the text; a folder has to leave room for a name of 8.3."""
    root = PureWindowsPath("C:\\", *folders)
    paths = [root / name for name in files]
    needed = max(*(units(path) - 259 for path in paths), units(root) - 247)
    excess = longest_excess(paths)
    assert (excess.characters if excess else 0) == max(needed, 0)
    assert excess is None or excess.path in paths


def test_at_the_limits() -> None:
    folder = PureWindowsPath("C:\\" + 244 * "d")
    assert longest_excess([folder / (11 * "f")]) is None
    assert longest_excess([folder / (11 * "f"), folder / (12 * "f")]) == (folder / (12 * "f"), 1)
    longer = PureWindowsPath(f"{folder}d", "f")
    assert longest_excess([longer]) == (longer, 1)


LONG = """
name = "long"
[problems.PROBLEM]
plant.name = "pendulum"
plant.inputs = ["torque"]
plant.outputs = ["angle"]
loop = { sampling_time = 0.1, duration = 0.2 }
reference.angle = { kind = "constant", value = 0.0 }
scenarios.SCENARIO = {}
[controllers.ONE]
type = "idle"
[controllers.OTHER]
type = "idle"
"""


def test_what_a_case_adds_to_the_folder_of_results_is_bounded(tmp_path: Path) -> None:
    """Whatever problems, scenarios and controllers are called, a folder of 118 characters will do."""
    first, other = 59 * "c" + "1", 59 * "c" + "2"
    named = LONG.replace("PROBLEM", 60 * "p").replace("SCENARIO", 60 * "s")
    path = tmp_path / "long.toml"
    path.write_text(named.replace("ONE", first).replace("OTHER", other), encoding="utf-8")
    resolved = read_study(str(path))
    problems = {name: (problem, problem.plant.built()) for name, problem in resolved.problems.items()}
    cases = cases_of_problems(problems, [0, 10**18])
    ids = [case.id for case in (*cases, *doing_nothing(cases))]
    assert len(set(ids)) == 6
    assert {len(name) for name in ids} == {91}
    root = PureWindowsPath("C:\\" + 115 * "r")
    assert longest_excess(longest_files(root / "cases", ids)) is None
    excess = longest_excess(longest_files(PureWindowsPath(f"{root}r") / "cases", ids))
    assert excess is not None
    assert excess.characters == 1


TOO_LONG = r"(\d+) characters longer than Windows allows"
TELLING = """
import tempfile
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Action, Controller

@dataclass(kw_only=True)
class Tells(Controller):
    def start(self, loop): ...
    def step(self, sample):
        return Action(np.zeros(1), info={"temporary": len(tempfile.gettempdir())})
"""


def test_files_of_a_run_are_no_longer_than_was_foreseen(write_study: WriteStudy, tmp_path: Path) -> None:
    path = write_study("telling:Tells")
    (tmp_path / "telling.py").write_text(TELLING, encoding="utf-8")
    results = run_file(path)
    (case,) = results.cases
    assert case.trace().info["temporary"].tolist() == 11 * [len(str(scratch_of_cases().parent))]
    cases = results.folder / "cases"
    longest = max(
        len(str(file)) for file in longest_files(cases, [folder.name for folder in cases.iterdir()])
    )
    assert all(len(str(file)) < longest for file in cases.rglob("*"))
    with FMUPlant(next(path.parent.glob("*.fmu"))) as plant:
        assert len(plant._scratch.path.name) == len(scratch_of_cases().name)


def test_a_folder_of_results_that_is_too_long_is_refused_before_the_first_case(
    write_study: WriteStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "are_limited", lambda: True)
    path, above = write_study("mfapc"), tmp_path / "above"
    above.mkdir()
    with pytest.raises(ConfigError, match=TOO_LONG) as caught:
        run_file(path, above / (150 * "o"))
    assert not [*above.rglob("cases")]
    assert "give a folder whose path is that much shorter (--out), or allow long paths" in str(caught.value)
    match = re.search(TOO_LONG, str(caught.value))
    assert match
    room = 150 - int(match[1])
    with pytest.raises(ConfigError, match=" 1 characters longer"):
        run_file(path, above / ((room + 1) * "o"))
    assert len(run_file(path, above / (room * "o")).cases) == 1


def test_an_fmu_that_a_case_cannot_unpack_is_refused_before_the_first_case(
    write_study: WriteStudy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its folder of temporary files is below that of the run, so that less room is left in it."""
    monkeypatch.setattr(archive, "are_limited", lambda: True)
    study = write_study("mfapc")
    (fmu,) = study.parent.glob("*.fmu")
    here = len(tempfile.gettempdir()) + len("/ddpc-cosim-12345678/")
    below = len(f"{scratch_of_cases()}/")
    text = study.read_text(encoding="utf-8").replace(fmu.name, "longer.fmu")
    study.write_text(text, encoding="utf-8")
    longer = fmu.with_name("longer.fmu")

    def write(length: int) -> None:
        longer.write_bytes(fmu.read_bytes())
        with zipfile.ZipFile(longer, "a") as file:
            file.writestr(f"resources/{'n' * (length - len('resources/'))}", "")

    write(259 - below)
    resolved = read_study(str(study)).problem
    assert resolved.plant.built().content
    write(260 - below)
    with pytest.raises(FMUImportError, match=" 1 characters longer than Windows allows; set TEMP"):
        resolved.plant.built()
    FMUPlant(longer).close()
    write(260 - here)
    with pytest.raises(FMUImportError, match=" 1 characters longer than Windows allows; set TEMP"):
        FMUPlant(longer)
