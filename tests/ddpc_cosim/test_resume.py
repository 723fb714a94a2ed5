"""Studies that are run again, go on, or lose a worker on the way."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from signal import SIGKILL, SIGSEGV
from typing import Any

import numpy as np
import pytest
from fmus.builder import Fault
from studies import run_file

from ddpc_cosim import ConfigError, CosimError, load_results
from ddpc_cosim.study.case_files import CaseResult, read_run
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.results import StudyResults
from ddpc_cosim.study.runner import Update

Run = Callable[..., subprocess.CompletedProcess[str]]
WriteStudy = Callable[..., Path]

DEADLY = """
import ctypes, os, signal
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Action, Controller

@dataclass(kw_only=True)
class Deadly(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        if sample.k == 3:
            self.die()
        return Action(np.ones(1), info={"sample": sample.k})

class Exits(Deadly):
    def die(self): os._exit(3)

class Segfaults(Deadly):
    def die(self): ctypes.string_at(0)

class Killed(Deadly):
    def die(self): os.kill(os.getpid(), signal.SIGKILL)

class Sane(Deadly):
    def die(self): pass
"""


class Diary:
    """Notes what a run says about itself."""

    def __init__(self) -> None:
        self.started: tuple[int, int] | None = None
        self.done: list[str] = []

    def prepare(self, what: str) -> None:
        raise AssertionError(what)  # there is nothing to compile

    def start(self, total: int, kept: int) -> None:
        self.started = (total, kept)

    def update(self, update: Update) -> None:
        assert 0 <= update.samples <= update.planned

    def finished(self, case: Case, result: CaseResult) -> None:
        assert result.id == case.id
        self.done.append(case.name)


def run(study: Path, **selection: Any) -> tuple[StudyResults, Diary]:
    """Run a study in this process's workers."""
    diary = Diary()
    return run_file(study, progress=diary, **selection), diary


def times(folder: Path) -> dict[str, int]:
    return {path.parent.name: path.stat().st_mtime_ns for path in folder.glob("cases/*/run.json")}


def test_a_case_that_is_there_is_not_run_again(write_study: WriteStudy) -> None:
    study = write_study("mfapc", seeds="[0, 1]")
    first, diary = run(study)
    assert diary.started == (4, 0)
    both = ("doing-nothing", "mfapc")
    assert sorted(diary.done) == [f"{who}_seed{seed}" for who in both for seed in (0, 1)]
    before = times(first.folder)

    again, diary = run(study)
    assert diary.started == (0, 4)
    assert diary.done == []
    assert repr(again.cases) == repr(first.cases)  # NaN is not equal to itself
    assert times(first.folder) == before

    _, diary = run(study, seeds=[1, 2])
    assert diary.started == (2, 2)
    assert sorted(diary.done) == ["doing-nothing_seed2", "mfapc_seed2"]

    _, diary = run(study, fresh=True)
    assert diary.started == (4, 0)
    assert times(first.folder) != before


def test_changed_settings_are_another_case(write_study: WriteStudy) -> None:
    study = write_study("mfapc")
    run(study)
    study.write_text(study.read_text(encoding="utf-8") + "settings = { mu = 2.0 }", encoding="utf-8")
    _, diary = run(study)
    assert (diary.started, diary.done) == ((1, 1), ["mfapc_seed0"])


def test_a_changed_fmu_is_another_case(write_study: WriteStudy, make_fmu: Callable[..., Path]) -> None:
    study = write_study("mfapc", "pid")
    first, _ = run(study)
    assert {case.outcome for case in first.cases} == {"completed"}
    make_fmu(Fault.RETURN_ERROR).replace(study.parent / "no_fault.fmu")
    again, diary = run(study)
    assert diary.started == (3, 0)
    assert {case.outcome for case in again.cases} == {"fmu-error"}
    assert not {case.id for case in first.cases} & {case.id for case in again.cases}


MACHINE = """
import numpy as np
from ddpc_cosim import Controller

class Fine(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        return np.ones(1)

class Imports(Fine):
    def start(self, loop):
        import installed_later

class Fills(Fine):
    def start(self, loop):
        raise OSError(28, "No space left on device")

class Grows(Fine):
    def step(self, sample):
        if sample.k == 3:
            raise MemoryError
        return np.ones(1)

class Wrong(Fine):
    def start(self, loop):
        raise ValueError("wrong")
"""


def test_what_may_be_the_machine_s_fault_is_tried_again(
    write_study: WriteStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "machine.py").write_text(MACHINE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    study = write_study(*(f"machine:{kind}" for kind in ("Fine", "Imports", "Fills", "Grows", "Wrong")))
    for _ in range(2):
        results, diary = run(study)
        cases = {case.controller: case for case in results.cases}
        assert {name for name, case in cases.items() if case.transient} == {"imports", "fills", "grows"}
    assert diary.started == (3, 3)
    assert cases["imports"].reason == (
        "before the first sample: Imports.start raised ModuleNotFoundError: No module named "
        "'installed_later'; the machine may be at fault: when this is run again, it is tried again"
    )
    assert len(cases["grows"].trace()) == 4
    (tmp_path / "installed_later.py").touch()
    results, diary = run(study)
    assert next(case.outcome for case in results.cases if case.controller == "imports") == "completed"
    _, diary = run(study)
    assert diary.started == (2, 4)


def test_an_fmu_that_cannot_be_loaded_is_tried_again(write_study: WriteStudy) -> None:
    study = write_study("mfapc", fault=Fault.NO_INSTANCE)
    for _ in range(2):
        results, diary = run(study)
        assert diary.started == (2, 0)
        assert results.cases[0].reason.endswith("when this is run again, it is tried again")


THREADS = """
import os
import numpy as np
from ddpc_cosim import Controller

class Threads(Controller):
    def start(self, loop):
        np.ones((999, 999)) @ np.ones((999, 999))
    def step(self, sample):
        return np.ones(1)
    def diagnostics(self):
        tasks = {name: len(os.listdir(f"/proc/{pid}/task")) for name, pid in
                 (("own", os.getpid()), ("of the server", os.getppid()))}
        return tasks | {"told": float(os.environ["OPENBLAS_NUM_THREADS"])}
"""


def test_a_worker_has_one_thread_of_linear_algebra_whatever_the_surroundings_say(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    (tmp_path / "counting.py").write_text(THREADS, encoding="utf-8")
    write_study("counting:Threads")
    more = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "4")
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out", **more)
    assert done.returncode == 0, done.stderr
    (case,) = load_results(tmp_path / "out").cases
    assert case.diagnostics == {"own": 1.0, "of the server": 1.0, "told": 1.0}


def test_the_results_can_be_loaded(write_study: WriteStudy) -> None:
    results, _ = run(write_study("mfapc"))
    loaded = load_results(results.folder)
    assert repr(loaded.cases) == repr(results.cases)  # NaN is not equal to itself
    assert loaded.study == results.study
    assert loaded.provenance == results.provenance
    assert loaded.provenance["fmu guid"] == "integrator:0"
    (case,) = loaded.cases
    assert len(case.trace()) == 11


def test_a_label_is_the_one_of_the_study_as_it_is_now(write_study: WriteStudy) -> None:
    study = write_study("mfapc")
    run(study)
    study.write_text(study.read_text(encoding="utf-8") + 'label = "ours"', encoding="utf-8")
    results, diary = run(study)
    assert diary.started == (0, 2)
    assert results.cases[0].label == "ours"
    assert load_results(results.folder).cases[0].label == "ours"


def test_damage_to_any_byte_is_noticed_and_only_that_case_run_again(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    study = write_study("mfapc", seeds="[0, 1]")
    results, _ = run(study)
    sound = {case.id for case in results.cases}
    rng = np.random.default_rng(0)
    files = sorted(results.folder.glob("cases/*/*"))
    for path in [*files, *rng.choice(files, 40)]:
        content = path.read_bytes()
        place, other = rng.integers(len(content)), bytes([rng.integers(256)])
        for damaged in (content[:place], content[:place] + other + content[place + 1 :]):
            path.write_bytes(damaged)
            loaded = load_results(results.folder)
            assert damaged == content or list(loaded.damaged) == [path.parent.name]
            assert {case.id for case in loaded.cases} == sound - set(loaded.damaged)
        path.write_bytes(content)
    damaged = next(path for path in files if path.parent.name.startswith("mfapc_"))
    damaged.unlink()
    done = run_program("report", "out")
    assert done.returncode == 1
    assert "1 of 4 cases are damaged and left out; run the study again with --out out: only" in done.stderr
    assert damaged.parent.name in done.stderr
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert "1 of 4 cases are damaged and left out" in page
    metrics = tmp_path / "out/metrics.csv"
    assert len(metrics.read_text(encoding="utf-8").splitlines()) == 2, "rebuilt from the case that is left"
    metrics.write_text("forged", encoding="utf-8")
    _, diary = run(study)
    assert diary.started == (1, 3)
    assert [f"{name}_" in damaged.parent.name for name in diary.done] == [True]
    assert not load_results(results.folder).damaged
    assert len((tmp_path / "out/metrics.csv").read_text(encoding="utf-8").splitlines()) == 3


def test_a_report_on_nothing_but_damaged_cases_says_so(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    results, _ = run(write_study("mfapc"))
    (results.cases[0].folder / "signals.csv").unlink()
    done = run_program("report", "out")
    assert (done.returncode, "Traceback" in done.stderr) == (1, False), done.stderr
    assert "1 of 2 cases are damaged" in (tmp_path / "out/report.html").read_text(encoding="utf-8")


def test_a_faulty_fmu_costs_its_case_a_result_and_the_others_nothing(write_study: WriteStudy) -> None:
    results, _ = run(write_study("mfapc", seeds="[0, 1]", fault=Fault.RETURN_ERROR))
    for case in results.cases:
        assert case.outcome == "fmu-error"
        assert "error.fmu: fmi2DoStep returned error at t = 0.5 s" in case.reason
        assert len(case.trace()) == 6


def test_an_fmu_that_gives_no_instance_fails_before_the_first_sample(write_study: WriteStudy) -> None:
    results, _ = run(write_study("mfapc", fault=Fault.NO_INSTANCE))
    (case,) = results.cases
    assert case.outcome == "fmu-error"
    assert case.reason.startswith("before the first sample: no_instance.fmu: cannot be instantiated")
    assert len(case.trace()) == 0


def test_a_worker_that_dies_costs_one_case(write_study: WriteStudy, tmp_path: Path, run_program: Run) -> None:
    (tmp_path / "deadly.py").write_text(DEADLY, encoding="utf-8")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    write_study("deadly:Exits", "deadly:Segfaults", "deadly:Killed", "deadly:Sane", "mfapc")
    arguments = ("run", "study.toml", "--jobs", "2", "--no-report", "--out", "out")

    done = run_program(*arguments, TMPDIR=str(scratch))
    assert done.returncode == 1
    outcomes = {
        run["controller"]: (run["outcome"], run["reason"])
        for run in (json.loads(p.read_text(encoding="utf-8")) for p in tmp_path.glob("out/cases/*/run.json"))
    }
    segfault, kill = (f"{number.name} ({signal.strsignal(number)})" for number in (SIGSEGV, SIGKILL))
    died = "crashed in step at t = 0.3 s: "
    assert outcomes == {
        "exits": ("crashed", f"controller deadly:Exits: {died}its process ended with exit code 3"),
        "segfaults": ("crashed", f"controller deadly:Segfaults: {died}{segfault}"),
        "killed": ("crashed", f"controller deadly:Killed: {died}{kill}"),
        "sane": ("completed", ""),
        "mfapc": ("completed", ""),
        "doing-nothing": ("completed", ""),
    }
    assert f"crashed: controller deadly:Segfaults: {died}{segfault}" in done.stderr
    crashed = [case for case in load_results(tmp_path / "out").cases if case.outcome == "crashed"]
    for case in crashed:  # the samples before it are kept, its own too
        trace = case.trace()
        np.testing.assert_allclose(trace.time, [0.0, 0.1, 0.2, 0.3])
        np.testing.assert_array_equal(trace.u[:, 0], [1.0, 1.0, 1.0, np.nan])
        np.testing.assert_array_equal(trace.info["sample"], [0.0, 1.0, 2.0, np.nan])
        np.testing.assert_allclose(trace.y[:, 0], trace.time, atol=1e-12)
        np.testing.assert_array_equal(trace.reference, 1.0)
        assert trace.status == ("ok", "ok", "ok", "error")
    assert list(scratch.iterdir()) == []

    again = run_program(*arguments)
    assert "3 cases to run, 3 kept" in again.stderr


LEAVING = """
import os
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller
from ddpc_cosim.study import case_files

class Odd(Exception):
    def __init__(self, one, two):
        super().__init__(one)

@dataclass(kw_only=True)
class Interrupts(Controller):
    def start(self, loop):
        raise KeyboardInterrupt
    def step(self, sample):
        raise AssertionError

@dataclass(kw_only=True)
class Leaves(Interrupts):
    def start(self, loop):
        raise SystemExit(3)

@dataclass(kw_only=True)
class Strange(Interrupts):
    def start(self, loop):
        raise Odd("strange", 2)

@dataclass(kw_only=True)
class Fills(Interrupts):
    def start(self, loop):
        def fail(*_):
            raise OSError(28, "No space left on device")
        case_files.write_table = fail
    def step(self, sample):
        return np.ones(1)
"""


def test_whatever_a_controller_raises_costs_its_case_and_no_other(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    (tmp_path / "leaving.py").write_text(LEAVING, encoding="utf-8")
    write_study("leaving:Interrupts", "leaving:Leaves", "leaving:Strange", "mfapc")
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out")
    assert done.returncode == 1
    outcomes = {case.controller: (case.outcome, case.reason) for case in load_results(tmp_path / "out").cases}
    early = "before the first sample: "
    assert outcomes == {
        "interrupts": ("crashed", "KeyboardInterrupt"),
        "leaves": ("controller-error", f"{early}Leaves.start raised SystemExit: 3"),
        "strange": ("controller-error", f"{early}Strange.start raised Odd: strange"),
        "mfapc": ("completed", ""),
    }


@pytest.mark.parametrize(("what", "place"), [("controller", "controllers.quits"), ("plant", "plant")])
def test_a_constructor_that_exits_is_an_error_and_no_success(
    what: str, place: str, write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    code = f"""
import ddpc_cosim

class Quits(ddpc_cosim.{what.title()}):
    def __new__(cls):
        raise SystemExit(0)
"""
    (tmp_path / "leaving.py").write_text(code, encoding="utf-8")
    if what == "plant":
        write_study("mfapc", plant={"name": "leaving:Quits"})
    else:
        write_study("leaving:Quits")
    done = run_program("run", "study.toml", "--no-report", "--out", "out")
    assert done.returncode == 2
    assert place in done.stderr
    assert "SystemExit: 0" in done.stderr


HANGING = """
import threading
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from ddpc_cosim import Action, Controller, study_folder

@dataclass(kw_only=True)
class Hangs(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        if sample.k == 3:
            threading.Event().wait()
        return Action(np.ones(1), "as well as it can" if sample.k == 1 else "ok")

@dataclass(kw_only=True)
class HangsAtOnce(Hangs):
    def start(self, loop):
        threading.Event().wait()

@dataclass(kw_only=True)
class HangsWhenItIsBuiltToRun(Hangs):
    def __post_init__(self):
        checked = Path(study_folder(), "checked")
        if checked.exists():
            threading.Event().wait()
        checked.touch()

@dataclass(kw_only=True)
class HangsWhenAsked(Hangs):
    @property
    def horizon(self):
        threading.Event().wait()

@dataclass(kw_only=True)
class HangsWhenItIsMade(Hangs):
    gain: float = 1.0
    def __post_init__(self):
        while True:
            pass

@dataclass(kw_only=True)
class HangsAboutItsSettings(Hangs):
    def settings(self):
        threading.Event().wait()

@dataclass(kw_only=True)
class HangsAboutItsRecording(Hangs):
    @property
    def uses_recording(self):
        threading.Event().wait()

@dataclass(kw_only=True)
class HangsAboutItsLength(Hangs):
    def recording_length(self, inputs, outputs, measurements):
        threading.Event().wait()
"""
RECORDING = {"samples": 60, "excitation": {"u": {"low": -1.0, "high": 1.0}}}


def test_a_controller_that_never_returns_costs_its_case_and_no_other(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    (tmp_path / "hanging.py").write_text(HANGING, encoding="utf-8")
    kinds = ("Hangs", "HangsAtOnce", "HangsWhenItIsBuiltToRun", "HangsWhenAsked")
    write_study(*(f"hanging:{kind}" for kind in kinds), "mfapc", loop={"step_timeout": 2.0})
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out")
    assert done.returncode == 1
    cases = {case.controller: case for case in load_results(tmp_path / "out").cases}
    assert {name: case.outcome for name, case in cases.items()} == {
        **dict.fromkeys(map(str.lower, kinds), "timed-out"),
        "mfapc": "completed",
    }
    late = "no return within 2 s in"
    assert cases["hangs"].reason.startswith(f"controller hanging:Hangs: {late} step at t = 0.3 s; ")
    for kind, call in zip(kinds[1:3], ("start", "constructor"), strict=True):
        early = f"before the first sample: controller hanging:{kind}: {late} {call}; "
        assert cases[kind.lower()].reason.startswith(early)
    assert (
        f"controller hanging:{kinds[3]}: {late} horizon when the study was read"
        in cases[kinds[3].lower()].reason
    )
    assert cases["hangs"].trace().status == ("ok", "as well as it can", "ok", "error")


def test_one_that_never_returns_when_the_study_is_read_costs_its_cases_and_no_others(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    """Each limit is waited for once: the variants of a sweep and other seeds are not tried."""
    (tmp_path / "hanging.py").write_text(HANGING, encoding="utf-8")
    calls = {
        "HangsWhenItIsMade": "constructor",
        "HangsAboutItsSettings": "settings",
        "HangsAboutItsRecording": "uses_recording",
        "HangsAboutItsLength": "recording_length",
    }
    controllers = (*(f"hanging:{kind}" for kind in calls), "mfapc")
    study = write_study(*controllers, loop={"step_timeout": 1.0}, recording=RECORDING)
    with study.open("a", encoding="utf-8") as file:
        file.write("[controllers.hangswhenitismade.sweep]\ngain = [2.0, 3.0]\n")
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--seeds", "0:2", "--out", "out")
    assert done.returncode == 1
    results = load_results(tmp_path / "out").cases
    assert [case.outcome for case in results] == ["timed-out"] * 2 * (len(calls) + 2) + ["completed"] * 2
    cases = {case.controller: case for case in results}
    for kind, call in calls.items():
        assert cases[kind.lower()].reason == (
            f"before the first sample: controller hanging:{kind}: no return within 1 s in {call} when the "
            "study was read; raise loop.step_timeout if it needs longer"
        )
    assert cases["hangswhenitismade-gain-3"].settings == {"gain": 3.0}
    judged = [read_run(case.folder)["metric_settings"] for case in results]
    assert judged == judged[-1:] * len(judged)


ENDLESS = """
import signal, time
import numpy as np
from ddpc_cosim import Controller

class Endless(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        signal.sigtimedwait([], 0.3)
        return np.ones(1)
"""


def test_a_case_that_takes_too_long_is_ended_though_each_call_returns(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    (tmp_path / "endless.py").write_text(ENDLESS, encoding="utf-8")
    write_study("endless:Endless", loop={"duration": 1000.0, "case_timeout": 2.0})
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out")
    assert done.returncode == 1
    (case,) = load_results(tmp_path / "out").cases
    assert (case.outcome, case.transient) == ("timed-out", True)
    assert case.reason.endswith(
        "not done within 2 s; its process was ended; raise loop.case_timeout if it needs longer"
    )


def test_a_stabilising_controller_that_never_returns_is_an_error(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    """Without it there is no recording for anyone."""
    (tmp_path / "hanging.py").write_text(HANGING, encoding="utf-8")
    recording = RECORDING | {"controller": {"type": "hanging:HangsWhenItIsMade"}}
    write_study("mfapc", loop={"step_timeout": 1.0}, recording=recording)
    done = run_program("run", "study.toml")
    assert done.returncode == 2
    assert (
        "recording.controller: controller hanging:HangsWhenItIsMade: no return within 1 s in constr"
        in done.stderr
    )


SAYING = """
import numpy as np
from ddpc_cosim import Action, ConfigError, Controller

class Says(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        return Action(np.ones(1), self.words())
    def words(self):
        return "ok"

class Long(Says):
    def words(self): return "x" * 131_073

class Strange(Says):
    def words(self): return "a\\0b\\x1b[31m\\ud800"
    def knowledge(self, loop): return {"k\\ud800": "v" * 1_000_000}
    def warnings(self): return ("w\\0\\udcff",)
    def diagnostics(self): return {"d\\0\\ud800": 1.0}

class Fails(Says):
    def words(self): raise ValueError("y" * 5_000_000 + "\\ud800")

class Refuses(Says):
    def start(self, loop): raise ConfigError("\\ud800" + "z" * 5_000_000)
"""


def test_no_text_costs_a_case_or_the_report(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    """Nor does a path that the locale cannot say."""
    (tmp_path / "saying.py").write_text(SAYING, encoding="utf-8")
    study = write_study(*(f"saying:{kind}" for kind in ("Long", "Strange", "Fails", "Refuses")))
    (tmp_path / "größe").mkdir()
    text = study.read_text(encoding="utf-8").replace("no_fault.fmu", "größe/no_fault.fmu")
    study.write_text(text, encoding="utf-8")
    (tmp_path / "no_fault.fmu").rename(tmp_path / "größe/no_fault.fmu")
    out = str(tmp_path / "größe/out")
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0"}
    done = run_program("run", "study.toml", "--jobs", "1", "--out", out, **locale)
    assert (done.returncode, "Traceback" in done.stderr) == (1, False), done.stderr
    assert len(done.stderr) < 20_000
    results = load_results(out)
    assert Path(results.study.plant.fmu).is_file()
    cases = {case.controller: case for case in results.cases}
    assert {name: case.outcome for name, case in cases.items()} == {
        **dict.fromkeys(("long", "strange"), "completed"),
        **dict.fromkeys(("fails", "refuses"), "controller-error"),
    }
    assert set(cases["long"].trace().status) == {"x" * 1976 + " ... (131073 characters)"}
    assert set(cases["strange"].trace().status) == {"a\\x00b\\x1b[31m?"}
    assert len(cases["refuses"].reason) == 2000
    page = (Path(out) / "report.html").read_bytes()
    assert run_program("report", out, **locale).returncode == 0
    assert (Path(out) / "report.html").read_bytes() == page
    again = run_program("run", f"{out}/study.toml", "--jobs", "1", "--no-report", "--out", out, **locale)
    assert "0 cases to run, 5 kept" in again.stderr


CLOSE_STDOUT = "import os, subprocess, sys; os.close(1); sys.exit(subprocess.call(sys.argv[1:]))"


def test_a_closed_stdout_costs_no_run(write_study: WriteStudy, tmp_path: Path, program: str) -> None:
    write_study("mfapc")
    command = [sys.executable, "-c", CLOSE_STDOUT, program, "run", "study.toml", "--jobs", "1", "--no-report"]
    done = subprocess.run(
        [*command, "--out", "out"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
    assert [case.outcome for case in load_results(tmp_path / "out").cases] == ["completed"]


LINGERING = """
import threading
import numpy as np
from ddpc_cosim import Controller

class Lingers(Controller):
    def start(self, loop):
        self.started = True
    def step(self, sample):
        return np.ones(1)
    def __del__(self):
        if hasattr(self, "started"):
            threading.Event().wait()
"""


def test_a_run_that_hangs_between_two_calls_is_ended_too(
    write_study: WriteStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lingering.py").write_text(LINGERING, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("ddpc_cosim.study.runner._BETWEEN_CALLS_SECONDS", 5.0)
    results, _ = run(write_study("lingering:Lingers", loop={"step_timeout": 2.0}))
    (case,) = results.cases
    assert case.outcome == "timed-out"
    assert case.reason.startswith("the run: no return within 5 s in between two calls; ")


@pytest.fixture
def full_disk(write_study: WriteStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study of two cases, of which the worker of the second cannot write."""
    (tmp_path / "leaving.py").write_text(LEAVING, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    return write_study("mfapc", "leaving:Fills")


def test_a_worker_that_cannot_write_costs_its_case(full_disk: Path) -> None:
    """What it says of the disk need not be so."""
    results, _ = run(full_disk)
    assert [case.outcome for case in results.cases] == ["completed", "crashed"]
    assert results.cases[1].reason == "OSError: [Errno 28] No space left on device"


def test_a_disk_that_is_full_ends_the_run_and_what_is_done_is_kept(
    full_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ddpc_cosim.study.case_files.stage_case", fail)
    with pytest.raises(
        CosimError, match="cannot be written: No space left on device; finished cases are kept"
    ):
        run(full_disk)
    cases = full_disk.parent / "out/cases"
    assert [path.name.partition("_")[0] for path in cases.iterdir()] == ["mfapc"]


def test_results_that_cannot_be_written_are_told(
    write_study: WriteStudy, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ddpc_cosim.study.results.write_atomically", fail)
    with pytest.raises(
        CosimError, match=r"out: results cannot be written: No space left on device; finished"
    ):
        run(write_study("mfapc"))


def at_once(program: str, folder: Path, *commands: list[str]) -> list[tuple[int, str]]:
    """Run commands at the same time; return their exit codes and what they say on stderr."""
    pipe = subprocess.PIPE
    processes = [
        subprocess.Popen([program, *command], cwd=folder, stdout=pipe, stderr=pipe, text=True)
        for command in commands
    ]
    errors = [process.communicate(timeout=120)[1] for process in processes]
    return [(process.returncode, error) for process, error in zip(processes, errors, strict=True)]


def test_several_runs_can_work_in_one_folder_at_once(
    write_study: WriteStudy, tmp_path: Path, program: str
) -> None:
    write_study("mfapc", seeds='["0:20"]')
    command = ["run", "study.toml", "--jobs", "1", "--no-report", "--fresh", "--out", "out"]
    done = at_once(program, tmp_path, command, command)
    assert [code for code, _ in done] == [0, 0], done
    assert len(list((tmp_path / "out/cases").iterdir())) == 40
    assert all(case.trace().completed for case in load_results(tmp_path / "out").cases)


def test_of_two_studies_in_one_folder_at_once_the_second_is_refused(
    write_study: WriteStudy, tmp_path: Path, program: str
) -> None:
    study = write_study("mfapc")
    study.with_name("other.toml").write_bytes(study.read_bytes())
    commands = [["run", f"{name}.toml", "--no-report", "--out", "out"] for name in ("study", "other")]
    done = at_once(program, tmp_path, *commands)
    assert sorted(code for code, _ in done) == [0, 2], done
    first = done.index(min(done))
    assert "error: out: holds the results of another study (name = " in done[1 - first][1]
    assert load_results(tmp_path / "out").study.name == ("study", "other")[first]


def test_a_folder_of_another_study_is_left_as_it_is(
    write_study: WriteStudy, make_fmu: Callable[..., Path]
) -> None:
    """Another one has another name, or none of its plants; one that was extended is the same."""
    study = write_study("mfapc")
    text = study.read_text(encoding="utf-8")
    run(study)
    before = {path: path.read_bytes() for path in study.parent.glob("out/**/*") if path.is_file()}
    plant = make_fmu(Fault.RETURN_ERROR).name
    for other, differs in (
        (f'name = "other"\n{text}', r'name = "study"; this one has name = "other"'),
        (text.replace("no_fault.fmu", plant), rf"plant no_fault.fmu; this one has plant {plant}"),
    ):
        study.write_text(other, encoding="utf-8")
        with pytest.raises(ConfigError, match=rf"out: holds .* another study \({differs}\); give another fo"):
            run(study)
    assert {path: path.read_bytes() for path in study.parent.glob("out/**/*") if path.is_file()} == before
    two = text.replace("[plant]", "[problems.one.plant]").replace("[loop]", "[problems.one.loop]")
    two = two.replace("[reference.", "[problems.one.reference.")
    more = two[two.index("[problems") : two.index("[controllers")].replace("one", "two")
    study.write_text(two + more.replace("no_fault.fmu", plant), encoding="utf-8")
    assert run(study)[1].started == (4, 0)
    (study.parent / "out/study.toml").write_bytes(b"")  # as a power cut may leave it
    assert run(study)[1].started == (0, 4)


def test_a_run_that_has_not_ended_has_no_results_yet(write_study: WriteStudy, tmp_path: Path) -> None:
    results, _ = run(write_study("mfapc"))
    for name in ("provenance.json", "metrics.csv"):
        (results.folder / name).unlink()
    with pytest.raises(
        ConfigError, match="out: no results yet: no run has ended; run the study again, which"
    ):
        load_results(results.folder)


def test_a_temporary_folder_of_any_length_will_do(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    """A socket's path may have about 100 bytes."""
    scratch = tmp_path / ("x" * 100)
    scratch.mkdir()
    write_study("mfapc")
    done = run_program("run", "study.toml", "--no-report", "--out", "out", TMPDIR=str(scratch))
    assert done.returncode == 0, done.stderr
    assert list(scratch.iterdir()) == []


RICH = """
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any
import numpy as np
from ddpc_cosim import Controller, setting

class Mode(Enum):
    FAST = 1

@dataclass(kw_only=True)
class Rich(Controller):
    said: Any = setting(default_factory=lambda: {"weights": np.eye(2), "pair": (1, 2.0)}, doc="said")
    function: Any = setting(np.tanh, doc="own function")
    local: Any = setting(default_factory=lambda: lambda x: x, doc="another one at each time")
    kind: Any = setting(int, doc="class")
    limits: Any = setting((None, 1.0), doc="limits")
    table: Any = setting(default_factory=lambda: {1: 2}, doc="keys that are no texts")
    choices: Any = setting(frozenset("a"), doc="set")
    mode: Any = setting(Mode.FAST, doc="enumeration")
    path: Any = setting(Path("x"), doc="path")
    thing: Any = setting(default_factory=object, doc="object")
    nothing: Any = setting(None, doc="nothing")
    def __post_init__(self):
        self.path = Path(self.path)
    def start(self, loop):
        assert callable(self.function) and callable(self.local) and self.kind is int
    def step(self, sample):
        return np.ones(1)
"""


def test_settings_that_a_study_file_cannot_say_keep_their_defaults(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    (tmp_path / "wealthy.py").write_text(RICH, encoding="utf-8")
    write_study(controllers={"rich": {"type": "wealthy:Rich", "settings": {"path": "y"}}})
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out")
    assert done.returncode == 0, done.stderr
    (controller,) = load_results(tmp_path / "out").study.controllers.values()
    assert controller.settings == {"said": {"weights": [[1, 0], [0, 1]], "pair": [1, 2.0]}, "path": "y"}
    again = run_program("run", "out/study.toml", "--jobs", "1", "--no-report", "--out", "out")
    assert "0 cases to run, 2 kept" in again.stderr


@pytest.mark.parametrize("out", ["file", "file/below"])
def test_a_folder_that_cannot_be_written_to(out: str, write_study: WriteStudy, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    study = write_study("mfapc")
    with pytest.raises(ConfigError, match="results cannot be written there"):
        run_file(study, out, progress=Diary())


def test_a_plant_that_cannot_be_built_says_what_to_do(
    run_program: Run, paper_text: str, tmp_path: Path
) -> None:
    done = run_program(
        *("run", "paper", "--seeds", "0"),
        CC=str(tmp_path / "no-compiler"),
        DDPC_COSIM_CACHE=str(tmp_path / "c"),
    )
    assert done.returncode == 1
    assert "error: " in done.stderr
    assert "no-compiler" in done.stderr
    assert "Traceback" not in done.stderr
