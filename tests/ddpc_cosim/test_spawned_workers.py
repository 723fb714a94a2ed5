"""Workers that are started anew, as on macOS and Windows: what differs, and what must not."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import Fault
from studies import cases_in, run_file, study_text, write

from ddpc_cosim import FMUPlant, FMUStepError
from ddpc_cosim.plugins import is_own
from ddpc_cosim.processes import spawning
from ddpc_cosim.study import runner
from ddpc_cosim.study.case_files import read_run
from ddpc_cosim.study.cases import leaves_nothing_behind
from ddpc_cosim.study.results import StudyResults
from ddpc_cosim.study.runner import run_cases

WriteStudy = Callable[..., Path]

FAILING = """
import os, tempfile, threading
from pathlib import Path
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller

@dataclass(kw_only=True)
class Fails(Controller):
    def start(self, loop):
        print("\\N{GREEK SMALL LETTER PHI} of", type(self).__name__)
    def step(self, sample):
        if sample.k == 3:
            self.fail()
        return np.ones(1)

class Aborts(Fails):
    def fail(self): os.abort()

class Exits(Fails):
    def fail(self): os._exit(3)

class Hangs(Fails):
    def fail(self): threading.Event().wait()

class Raises(Fails):
    def fail(self): raise ArithmeticError

class Works(Fails):
    def fail(self): pass

class Succeeds(Works):
    pass

class Looks(Controller):
    def start(self, loop):
        here, temporary = Path.cwd(), Path(tempfile.gettempdir())
        assert not any(here.iterdir())
        assert here.parent == temporary
        assert not (temporary / "left").exists()
        assert os.environ["TMPDIR"] == str(temporary)
        (here / "left").touch()
        (temporary / "left").touch()
    def step(self, sample):
        return np.ones(1)
"""

PENDULUM = study_text(
    name="spawned",
    seeds=[0, 1],
    reference={"angle": {"kind": "steps", "times": [0.0], "values": [20.0], "unit": "deg"}},
    bounds={"torque": {"min": -5.0, "max": 5.0}},
    recording={"samples": 60, "excitation": {"torque": {"kind": "prbs", "low": -1.0, "high": 1.0}}},
    scenarios={"noisy": {"noise": {"angle": 0.01}}},
    controllers=["mfapc", "deepc", "spsa"],
)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[list["subprocess.Popen[bytes]"]]:
    """Have workers started anew; return the interpreters that have been started."""
    started = list["subprocess.Popen[bytes]"]()

    def start(*arguments: Any, **how: Any) -> "subprocess.Popen[bytes]":
        started.append(start_python(*arguments, **how))
        return started[-1]

    start_python = spawning.start_python
    monkeypatch.setattr(spawning, "start_python", start)
    monkeypatch.setattr(spawning, "forks", lambda: False)
    yield started
    assert all(process.returncode is not None for process in started), "a worker is left behind"


@pytest.fixture
def write_failing(write_study: WriteStudy, tmp_path: Path) -> WriteStudy:
    def write(*names: str) -> Path:
        (tmp_path / "failing.py").write_text(FAILING, encoding="utf-8")
        return write_study(*(f"failing:{name}" for name in names), loop={"step_timeout": 2.0})

    return write


def content(results: StudyResults) -> dict[str, dict[str, Any]]:
    """Return all that is told of each case, but for what depends on the clock."""
    by_case = {}
    for case in (*results.cases, *results.resting):
        trace = {field.name: getattr(case.trace(), field.name) for field in fields(case.trace())}
        del trace["solve_time"]
        facts = read_run(case.folder)
        del facts["wall_time"], facts["signals"]
        facts["metrics"] = {key: value for key, value in facts["metrics"].items() if "solve_time" not in key}
        by_case[case.id] = {key: repr(value) for key, value in (trace | facts).items()}
    return by_case


def test_only_systems_on_which_it_was_tested_fork() -> None:
    forking = [name for name in ("linux", "darwin", "win32", "freebsd14") if spawning.forks(name)]
    assert forking == ["linux"]


def test_results_are_those_of_forked_workers_and_one_interpreter_runs_all_cases(
    tmp_path: Path, started: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Random numbers, warnings and diagnostics included."""
    path = write(tmp_path, PENDULUM)
    spawned = run_file(path, "spawned")
    assert len(started) == 1
    with monkeypatch.context() as patch:
        patch.setattr(spawning, "forks", lambda: True)
        forked = run_file(path, "forked", jobs=2)
    assert len(started) == 1
    assert len(content(spawned)) == 8
    assert content(spawned) == content(forked)


# In a worker that is used again, those that work are followed by those that end it or do not return.
ENDINGS = {
    "works": ("completed", ""),
    "aborts": ("crashed", "crashed in step at t = 0.3 s: SIGABRT (Aborted); it printed: \u03c6 of "),
    "succeeds": ("completed", ""),
    "hangs": ("timed-out", "no return within 2 s in step at t = 0.3 s; its process was ended"),
    "exits": ("crashed", "its process ended with exit code 3; it printed: \u03c6 of Exits"),
    "raises": ("controller-error", "step raised ArithmeticError at t = 0.3 s"),
}


@pytest.mark.parametrize("shared", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_worker_whose_case_fails_is_not_used_again(
    shared: bool,
    write_failing: WriteStudy,
    tmp_path: Path,
    started: list[Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Those of FMUs that were supplied, and of anyone's controllers, are not in any case."""
    if shared:  # as if all of it were known to leave nothing behind
        monkeypatch.setattr(runner, "leaves_nothing_behind", lambda case: True)
    path = write_failing(*(name.capitalize() for name in ENDINGS))
    results = run_file(path)
    for case in results.cases:
        outcome, reason = ENDINGS[case.controller]
        assert case.outcome == outcome
        assert reason in case.reason
        assert case.trace().u[:3].tolist() == [[1.0]] * 3
    # With the run at rest, which comes last.
    assert len(started) == (5 if shared else 7)
    assert read_run(results.cases[0].folder)["printed"] == ("" if shared else "\u03c6 of Works\n")
    assert not [*(tmp_path / "out/cases").glob(".staging*")]


def test_one_that_has_died_between_two_cases_is_replaced(tmp_path: Path, started: list[Any]) -> None:
    path = write(tmp_path, PENDULUM)
    (folder := tmp_path / "cases").mkdir()
    ran = run_cases([case for case in cases_in(path) if case.controller != "spsa"], folder, 1)
    for died in (False, True, False, False):
        if died:
            started[0].kill()
            started[0].wait()
        assert read_run(folder / next(ran).id)["outcome"] == "completed"
    assert next(ran, None) is None
    assert len(started) == 2


def test_a_case_does_not_begin_where_the_last_one_was(
    write_failing: WriteStudy, tmp_path: Path, started: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has a working directory and temporary files of its own, and nothing holds those of the last one."""
    monkeypatch.setattr(runner, "leaves_nothing_behind", lambda case: True)
    path = write_failing("Looks")
    path.write_text(path.read_text(encoding="utf-8").replace("[0]", "[0, 1, 2]"), encoding="utf-8")
    (folder := tmp_path / "cases").mkdir()
    for case in run_cases(cases_in(path), folder, 1):
        run = read_run(folder / case.id)
        assert run["outcome"] == "completed", run["reason"]
        assert run["left"] == {"left": 0}
        if sys.platform == "linux":
            process = Path(f"/proc/{started[0].pid}")
            held = [str(entry.readlink()) for entry in (process / "cwd", *(process / "fd").iterdir())]
            assert not [path for path in held if "deleted" in path]
    assert len(started) == 1


def test_which_cases_leave_nothing_behind(tmp_path: Path, write_failing: WriteStudy) -> None:
    path = write(tmp_path, PENDULUM)
    case = cases_in(path)[0]
    assert leaves_nothing_behind(case)
    assert not leaves_nothing_behind(replace(case, plant=replace(case.plant, isolated=True)))
    assert not leaves_nothing_behind(replace(case, plant=replace(case.plant, name="any:Plant", fmu="")))
    assert not leaves_nothing_behind(replace(case, section={"type": "any:Controller", "settings": {}}))
    nested = {"type": "deepc", "settings": {"dictionary": {"type": "any:Dictionary"}}}
    assert not leaves_nothing_behind(replace(case, section=nested))
    assert not any(map(leaves_nothing_behind, cases_in(write_failing("Works"))))


@pytest.mark.parametrize(
    ("kind", "name", "is_local"),
    [
        ("controllers", "deepc", True),
        ("controllers", "ddpc_controllers:Polynomials", True),
        ("controllers", "ddpc_controllers.py:Polynomials", False),
        ("controllers", "json:JSONDecoder", False),
        ("controllers", "pendulum", False),
        ("plants", "pendulum", True),
    ],
)
def test_whose_a_plug_in_is(kind: str, name: str, is_local: bool) -> None:
    assert is_own(kind, name) is is_local


@pytest.mark.parametrize("fault", [Fault.NO_FAULT, Fault.CALL_ABORT])
def test_an_isolated_fmu(fault: Fault, make_fmu: Callable[..., Path], started: list[Any]) -> None:
    """It fails from 0.5 s on."""
    with FMUPlant(make_fmu(fault), isolated=True) as plant, FMUPlant(make_fmu()) as here:
        assert plant.reset().tolist() == here.reset().tolist()
        for _ in range(4):
            assert plant.step(np.ones(1), 0.1).tolist() == here.step(np.ones(1), 0.1).tolist()
        if fault:
            with pytest.raises(FMUStepError, match=r"crashed in step at .* s: SIGABRT \(Aborted\)"):
                plant.step(np.ones(1), 0.2)
    assert len(started) == 1
