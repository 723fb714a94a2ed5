"""Chaos: of the 200 cases of a study, 60 go wrong in every way that is known, each at no one else's cost.

Processes are real: ``ddpc-cosim run``, its workers, and what these start.
"""

import os
import subprocess
import sys
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import CO_SIMULATION, Fault, V, describe, library_name, model_library, write_archive
from studies import study_text, write

from ddpc_cosim import CaseResult, StudyResults, load_results

pytestmark = pytest.mark.slow

VARIABLES = (
    V("u", 0, causality="input", start="0", more={"min": "-10", "max": "10"}),
    V("fault", 10, causality="input", start="0", more={"min": "0", "max": "99"}),
    V("y", 1, causality="output"),
    V("fault_from_the_start", 10, "Integer", causality="parameter", variability="fixed", start="0"),
)
"""y' = u; the second input is the fault that the FMU shows."""

CODE = """
import ctypes, os, shutil, signal, socket, stat, struct, sys, tempfile, threading, time
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from ddpc_cosim import Action, Controller
from ddpc_cosim.study import case_files

@dataclass(kw_only=True)
class Chaos(Controller):
    faults: list[str]
    @property
    def horizon(self):
        return 50
    def start(self, loop):
        fault = dict(enumerate(self.faults, 1)).get(loop.preview, "")  # scenarios differ in their preview
        self.now, self.later = (fault, "") if fault.endswith("_at_start") else ("", fault)
        self.flow, self.fault = 0.0, float(self.later) if self.later.isdecimal() else 0.0
        if self.now:
            globals()[self.now]()
    def step(self, sample):
        self.flow = 0.9 * self.flow + 0.3 * (sample.setpoint[0] - sample.y[0])
        u = np.array([self.flow, self.fault if sample.k >= 3 else 0.0])
        if sample.k == 3 and self.later and not self.fault:
            returned = globals()[self.later]()
            return u if returned is None else returned
        return u

def hangs_at_start():
    while True:
        signal.pause()

def raises_at_start():
    raise ValueError("wrong")

def lacks_a_module_at_start():
    import not_installed_here

def exits_at_start():
    sys.exit(0)

def hangs(): hangs_at_start()
def raises(): raise ValueError("wrong")
def raises_at_length(): raise ValueError("\\ud800\\x1b[2J" + 5_000_000 * "x")
def recurses(): recurses()
def runs_out_of_memory(): raise MemoryError
def fills_the_disk(): raise OSError(28, "No space left on device")
def interrupts(): raise KeyboardInterrupt
def exits(): sys.exit(0)
def leaves(): os._exit(0)
def is_killed(): os.kill(os.getpid(), signal.SIGKILL)
def kills_its_group(): os.killpg(0, signal.SIGKILL)
def is_stopped(): os.kill(os.getpid(), signal.SIGSTOP)
def stops_the_server(): os.kill(os.getppid(), signal.SIGSTOP)
def segfaults(): ctypes.string_at(0)

def returns_nan(): return np.array([np.nan, 0.0])
def returns_another_shape(): return np.ones((3, 1))
def returns_a_text(): return "as much as possible"
def says_much(): return Action(np.zeros(2), 65_536 * "\\ud800\\x1b" + "x")
def says_many_things(): return Action(np.zeros(2), info={f"n{i}\\ud800": float(i) for i in range(1000)})

def prints():
    for _ in range(20_000):
        print(999 * "x")
    os.write(2, b"\\x1b[2J\\x9b")

def grows():
    grown = []
    while True:
        grown.append(np.ones(1 << 22))

def multiplies():
    while True:
        if os.fork() == 0:
            os.setsid()
            hangs()

def leaves_a_daemon():
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            os.setsid()
            hangs()
        os._exit(0)

def leaves_a_thread():
    threading.Thread(target=threading.Event().wait).start()

def rows():
    mapped = Path("/proc/self/maps").read_text().splitlines()
    return Path(next(line.split()[-1] for line in mapped if line.endswith("/rows")))

def cuts_its_rows():
    os.truncate(rows(), rows().stat().st_size // 2)
    is_killed()

def scribbles_on_its_rows():
    rows().write_bytes(np.random.default_rng(0).bytes(rows().stat().st_size))
    is_killed()

def removes_its_folder():
    shutil.rmtree(tempfile.gettempdir())

def channels():
    for number in range(3, 99):
        try:
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                yield number
        except OSError:
            pass

def closes_its_channel():
    for number in channels():
        os.close(number)
    hangs()

def says(length, content):
    with socket.socket(fileno=os.dup(next(channels()))) as channel:
        channel.sendall(struct.pack("=q", length) + content)
    hangs()

def says_it_is_done(): says(16, b'{"result": null}')
def says_half(): says(100, b'{"result": ')
def says_too_much(): says(1 << 62, b"")
def speaks_pickle(): says(5, b"\\x80\\x04N.x")

def links_its_results():
    case_files.write_table = lambda path, *columns: path.symlink_to("/etc/hostname")
"""

FMU_FAULTS = {
    Fault.RETURN_WARNING: "completed",
    Fault.RETURN_ERROR: "fmu-error",
    Fault.RETURN_FATAL: "fmu-fatal",
    Fault.RETURN_ILLEGAL: "fmu-error",
    Fault.RETURN_DISCARD: "fmu-discarded",
    Fault.ASK_TO_TERMINATE: "terminated",
    Fault.RETURN_NAN: "diverged",
    Fault.SEGMENTATION_FAULT: "crashed",
    Fault.CALL_ABORT: "crashed",
    Fault.CALL_EXIT: "crashed",
    Fault.OVERFLOW_STACK: "crashed",
    Fault.HANG_IN_STEP: "timed-out",
    Fault.HANG_IN_TERMINATE: "timed-out",
    Fault.CRASH_IN_TERMINATE: "crashed",
    Fault.FLOOD_DESCRIPTOR: "completed",
    Fault.LEAVE_A_FILE: "completed",
    Fault.PRINT_AND_ABORT: "crashed",
}
FAULTS = {
    **{str(int(fault)): outcome for fault, outcome in FMU_FAULTS.items()},
    "hangs_at_start": "timed-out",
    "raises_at_start": "controller-error",
    "lacks_a_module_at_start": "controller-error",
    "exits_at_start": "controller-error",
    "hangs": "timed-out",
    "raises": "controller-error",
    "raises_at_length": "controller-error",
    "recurses": "controller-error",
    "runs_out_of_memory": "controller-error",
    "fills_the_disk": "controller-error",
    "interrupts": "crashed",
    "exits": "controller-error",
    "leaves": "crashed",
    "is_killed": "crashed",
    "kills_its_group": "crashed",
    "is_stopped": "timed-out",
    "stops_the_server": "completed",
    "segfaults": "crashed",
    "returns_nan": "controller-error",
    "returns_another_shape": "controller-error",
    "returns_a_text": "controller-error",
    "says_much": "completed",
    "says_many_things": "controller-error",
    "prints": "completed",
    "grows": "crashed",
    "multiplies": "crashed",
    "leaves_a_daemon": "completed",
    "leaves_a_thread": "completed",
    "cuts_its_rows": "crashed",
    "scribbles_on_its_rows": "crashed",
    "removes_its_folder": "completed",
    "closes_its_channel": "crashed",
    "says_it_is_done": "crashed",
    "says_half": "crashed",
    "links_its_results": "crashed",
}
EARLY = {Fault.HANG_IN_INITIALIZATION: "timed-out", Fault.CRASH_IN_INITIALIZATION: "crashed"}
OF_THE_MACHINE = {"lacks_a_module_at_start", "runs_out_of_memory", "fills_the_disk"}
CONTROLLERS, SCENARIOS = 4, 50
EACH = len(FAULTS) // CONTROLLERS


# The command, which leaves how much memory it has had at most: itself, not what it has started.
MEASURED = """
import atexit
from pathlib import Path
from ddpc_cosim.cli.main import main

def leave_peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    Path("peak").write_text(next(line.split()[1] for line in lines if line.startswith("VmHWM")))

atexit.register(leave_peak)
main()
"""


def write_study(folder: Path, isolated: str | bool) -> tuple[dict[str, str], dict[str, str]]:
    """Write study, FMU and module; return outcomes and faults of the cases that go wrong, by their names."""
    assert (len(FAULTS), EACH + len(EARLY)) == (EACH * CONTROLLERS, 15)
    content = {
        "modelDescription.xml": describe("2.0", "integrator", VARIABLES, interfaces=CO_SIMULATION).encode(),
        library_name("2.0"): model_library("2.0", complete=True),
    }
    write_archive(folder / "chaos.fmu", content)
    (folder / "chaos.py").write_text(CODE, encoding="utf-8")
    controllers, scenarios, outcomes, names, faults = {}, {}, {}, {}, iter(FAULTS.items())
    numbered = [*(f"faulty-{k}" for k in range(1, 16)), *(f"good-{k}" for k in range(16, SCENARIOS + 1))]
    for i in range(CONTROLLERS):
        faults_here = dict(islice(faults, EACH))
        controllers[f"c{i}"] = {"type": "chaos:Chaos", "settings": {"faults": [*faults_here]}}
        cases = [f"c{i}_{scenario}_seed0" for scenario in numbered]
        outcomes |= dict(zip(cases, [*faults_here.values(), *EARLY.values()], strict=False))
        names |= dict(zip(cases, faults_here, strict=False))
    early = {f"faulty-{EACH + n}": int(fault) for n, fault in enumerate(EARLY, 1)}
    # Good ones run beside faulty ones.
    for k in np.random.default_rng(0).permutation(SCENARIOS):
        name = numbered[k]
        scenarios[name] = {"preview": int(k) + 1, "noise": {"y": (int(k) + 1) / 1000}}
        if name in early:
            scenarios[name]["parameters"] = {"fault_from_the_start": early[name]}
    text = study_text(
        plant={"fmu": "chaos.fmu", "isolated": isolated, "outputs": ["y"]},
        reference={"y": 1.0},
        controllers=controllers,
        loop={"step_timeout": 6.0, "memory_limit": 1.0},
        scenarios=scenarios,
    )
    write(folder, text)
    return outcomes, names


@dataclass
class Run:
    """One call of the command, and what was there afterwards."""

    done: subprocess.CompletedProcess[str]
    peak: int
    """Largest memory of the command [kB]."""

    left: list[str]
    """Processes and temporary files."""


def run(folder: Path, *arguments: str) -> Run:
    """Run the study as a user does."""
    scratch, mark = folder / "scratch", f"CHAOS_MARK={folder}"
    scratch.mkdir(exist_ok=True)
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, "run", "study.toml", "--jobs", "4", *arguments],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(scratch), "CHAOS_MARK": str(folder)},
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=300,
        check=False,
    )
    processes = [
        path.parent.name for path in Path("/proc").glob("[0-9]*/environ") if mark in environment_of(path)
    ]
    files = [*scratch.rglob("*"), *folder.glob("*/cases/.*")]
    return Run(done, int((folder / "peak").read_text()), processes + [str(path) for path in files])


def environment_of(path: Path) -> str:
    """Return the environment of a process, if it is still there and ours."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def signals(case: CaseResult) -> list[bytes]:
    """Return all that a run computes."""
    trace = case.trace()
    return [getattr(trace, name).tobytes() for name in ("time", "reference", "y", "measured", "u")]


def name_of(case: CaseResult) -> str:
    return f"{case.controller}_{case.scenario}_seed{case.seed}"


@pytest.mark.parametrize("isolated", ["auto", False], ids=["own-processes", "shared-processes"])
def test_what_goes_wrong_costs_itself_and_nothing_else(isolated: str | bool, tmp_path: Path) -> None:
    """Processes that run one case after the other included."""
    wrong, faults = write_study(tmp_path, isolated)
    chaos = run(tmp_path, "--out", "out")
    assert chaos.done.returncode == 1, chaos.done.stderr
    assert chaos.left == []
    assert chaos.peak < 300_000
    printed = chaos.done.stdout + chaos.done.stderr
    assert len(printed) < 100_000
    assert "Traceback" not in printed
    assert printed.replace("\n", "").isprintable()

    results = load_results(tmp_path / "out")
    assert (len(results.cases), len(wrong), results.damaged) == (CONTROLLERS * SCENARIOS, 60, {})
    outcomes = {name_of(case): case.outcome for case in results.cases}
    # The limit of memory or processes, or that of time, whichever is reached first.
    limited = {name: outcomes[name] for name, fault in faults.items() if fault in ("grows", "multiplies")}
    assert set(limited.values()) <= {"crashed", "timed-out"}
    assert outcomes == {**dict.fromkeys(outcomes, "completed"), **wrong, **limited}
    assert len((tmp_path / "out/metrics.csv").read_text(encoding="utf-8").splitlines()) == 1 + len(outcomes)
    assert "</html>" in (tmp_path / "out/report.html").read_text(encoding="utf-8")
    written = [path.stat().st_size for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert sum(written) < 1e7

    (tmp_path / "calm").mkdir()
    write_study(tmp_path / "calm", False)
    calm = run(tmp_path / "calm", "--out", "out", "--no-report", "--only", "*good*")
    assert (calm.done.returncode, calm.left) == (0, []), calm.done.stderr
    alone = {name_of(case): signals(case) for case in load_results(tmp_path / "calm/out").cases}
    assert len(alone) == 140
    assert {name_of(case): signals(case) for case in results.cases if name_of(case) in alone} == alone

    if isolated:  # it makes no difference to going on
        check_going_on(tmp_path, results, faults)


def check_going_on(folder: Path, results: StudyResults, faults: dict[str, str]) -> None:
    """Damage some cases of a controller: they are run again, and those that may end otherwise."""
    cases = {name_of(case): case for case in results.cases if case.controller == "c1"}
    rng, damaged = np.random.default_rng(0), list(cases)[::10]
    for name in damaged:
        path = cases[name].folder / rng.choice(["signals.csv", "run.json"])
        content = bytearray(path.read_bytes())
        content[rng.integers(len(content))] ^= 1
        path.write_bytes(content)

    def times() -> dict[str, int]:
        return {name: (case.folder / "run.json").stat().st_mtime_ns for name, case in cases.items()}

    before = times()
    again = run(folder, "--out", "out", "--no-report", "--only", "c1_*")
    assert (again.done.returncode, again.left) == (1, []), again.done.stderr
    after = times()
    may_end_otherwise = {
        name
        for name, case in cases.items()
        if case.outcome in ("crashed", "timed-out") or faults.get(name) in OF_THE_MACHINE
    }
    assert {name for name in cases if after[name] != before[name]} == {*damaged, *may_end_otherwise}
    outcomes = {name_of(case): case.outcome for case in load_results(folder / "out").cases}
    assert outcomes == {name: case.outcome for name, case in cases.items()}
