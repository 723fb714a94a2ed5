"""A request to end is never lost: it is raised, on leaving what would lose it or must not be cut in two."""

import gc
import os
import signal
import subprocess
import sys
import weakref
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from studies import write

from ddpc_cosim.processes.fork_server import ExitStatus, Forked
from ddpc_cosim.processes.requests import Terminated, held, orderly_end
from ddpc_cosim.processes.worker import Worker, ask as ask_worker, serve_calls
from ddpc_cosim.study.case_files import CaseResult, load_case
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection, Update, run_study

WriteStudy = Callable[..., Path]
done: list[str] = []


def ask() -> None:
    signal.raise_signal(signal.SIGTERM)


class Thing:
    """Something with a finalizer of its own, if it is given one."""

    def __init__(self, *held: Any) -> None:
        self.held = held


class Deleted:
    def __del__(self) -> None:
        ask()
        done.append("finalized")


class Finalizes:
    """Its finalizer leaves another one."""

    def __del__(self) -> None:
        thing = Thing()
        weakref.finalize(thing, ask)
        del thing
        done.append("finalized")


def by_weakref() -> None:
    thing = Thing()
    weakref.finalize(thing, lambda: (ask(), done.append("finalized")))
    del thing
    done.append("went on")


def by_method() -> None:
    Deleted()
    done.append("went on")


def within_another() -> None:
    Finalizes()
    done.append("went on")


def in_a_cycle() -> None:
    thing = Thing(Deleted())
    thing.held = (*thing.held, thing)
    del thing
    gc.collect()
    done.append("went on")


def at_the_end_of_a_function() -> None:
    def function() -> None:
        kept = Deleted()
        assert kept

    function()
    done.append("went on")


def by_a_thing_that_several_know() -> None:
    known = weakref.WeakValueDictionary({1: Thing(Deleted())})
    assert not known
    done.append("went on")


def in_one_line() -> None:
    [Deleted()].clear() or done.append("went on")  # type: ignore[func-returns-value]


@pytest.mark.parametrize(
    "call",
    [
        by_weakref,
        by_method,
        within_another,
        in_a_cycle,
        at_the_end_of_a_function,
        by_a_thing_that_several_know,
        in_one_line,
    ],
    ids=lambda call: call.__name__,
)
def test_a_finalizer_is_not_interrupted_and_what_follows_it_is(call: Callable[[], None]) -> None:
    done.clear()
    with pytest.raises(Terminated), orderly_end():
        call()
    assert done == ["finalized"]
    assert sys.gettrace() is None


def generator_that_is_left() -> None:
    def generator() -> Any:
        try:
            yield
        finally:
            ask()

    begun = generator()
    next(begun)
    del begun
    done.append("went on")


def callback_of_a_reference() -> None:
    thing = Thing()
    reference = weakref.ref(thing, lambda _: ask())
    del thing
    done.append(f"went on: {reference}")


@pytest.mark.parametrize("call", [generator_that_is_left, callback_of_a_reference], ids=lambda c: c.__name__)
def test_what_python_swallows_is_raised_after_all(call: Callable[[], None]) -> None:
    done.clear()
    with pytest.raises(Terminated), orderly_end():
        call()
    assert done == []


def in_a_commit() -> None:
    with held():
        with held():
            ask()
        done.append("committed")
    done.append("went on")


def test_a_commit_is_done_as_a_whole() -> None:
    done.clear()
    with pytest.raises(Terminated), orderly_end():
        in_a_commit()
    assert done == ["committed"]


def test_a_request_on_leaving_leaves_everything_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    before, hook = (
        [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)],
        sys.unraisablehook,
    )
    restore = signal.signal

    def restored_and_asked(number: int, handler: Any) -> Any:
        restored = restore(number, handler)
        if number == signal.SIGINT and handler is signal.default_int_handler:
            signal.raise_signal(number)
        return restored

    with pytest.raises(KeyboardInterrupt), orderly_end():
        monkeypatch.setattr(signal, "signal", restored_and_asked)
    monkeypatch.undo()
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    assert sys.unraisablehook is hook
    done.clear()
    with pytest.raises(Terminated), orderly_end():
        by_method()
    assert done == ["finalized"]


def test_what_was_half_made_when_a_request_came_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    unraisable_errors: list[Any] = []
    monkeypatch.setattr(
        "sys.unraisablehook", lambda unraisable: unraisable_errors.append(str(unraisable.exc_value))
    )

    class HalfMade:
        def __init__(self) -> None:
            ask()
            self.file = 1

        def __del__(self) -> None:
            done.append(str(self.file))

    with orderly_end():
        try:
            HalfMade()
        except Terminated as request:
            request.__traceback__ = None  # which goes with what it holds
        gc.collect()
    assert unraisable_errors == []


def test_other_errors_of_finalizers_are_told_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    class Faulty:
        def __del__(self) -> None:
            raise ValueError("of its own")

    unraisable_errors: list[Any] = []
    monkeypatch.setattr(
        "sys.unraisablehook", lambda unraisable: unraisable_errors.append(str(unraisable.exc_value))
    )
    with orderly_end():
        Faulty()
    assert unraisable_errors == ["of its own"]


FINALIZED = """
import signal, sys, weakref
from ddpc_cosim.processes.rows import RowStore

made, once = RowStore.__init__, [signal.SIGTERM]

def asks(self, *arguments, **more):
    made(self, *arguments, **more)
    weakref.finalize(self, lambda: once and signal.raise_signal(once.pop()))

RowStore.__init__ = asks
from ddpc_cosim.cli.main import main
main()
"""


def test_a_run_ends_where_a_request_meets_the_finalizer_of_its_rows(
    write_study: WriteStudy, tmp_path: Path
) -> None:
    write_study("mfapc", seeds="[0, 1, 2]")
    command = ["run", "study.toml", "--jobs", "1", "--no-report", "--out", "out"]
    ended = subprocess.run(
        [sys.executable, "-c", FINALIZED, *command],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )
    assert ended.returncode == 143, ended.stderr
    assert "terminated: finished cases are kept; the same command goes on from there" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert "ignored" not in ended.stderr
    assert len(list((tmp_path / "out/cases").glob("*/run.json"))) == 1


class _AtEvent:
    """Raises a signal at the n-th call, return or call of C in this thread."""

    def __init__(self, event: int, number: int) -> None:
        self.count, self.is_made, self._event, self._number = 0, False, event, number

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        self.count += 1
        if self.count == self._event:
            sys.setprofile(None)
            self.is_made = True
            signal.raise_signal(self._number)


class Silent:
    """Follows a run without a word."""

    def prepare(self, what: str) -> None: ...

    def start(self, total: int, kept: int) -> None: ...

    def update(self, update: Update) -> None: ...

    def finished(self, case: Case, result: CaseResult) -> None: ...


# A socket or process that is not registered yet goes with a warning, and with it what is at the other end; so
# does what was half made.
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("count", [5, pytest.param(100, marks=pytest.mark.slow)])
def test_no_request_at_a_random_moment_of_a_run_is_lost(
    count: int, write_study: WriteStudy, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """And no case is half there, nor anything beside them."""
    resolved = read_study(str(write_study("mfapc")))
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))

    def run(at: _AtEvent) -> type[BaseException] | None:
        """Return what a run is ended by."""
        try:
            with orderly_end():
                sys.setprofile(at)
                run_study(resolved, tmp_path / "out", Selection(fresh=True), Silent())
        except KeyboardInterrupt as request:
            return type(request)
        finally:
            sys.setprofile(None)
        return None

    run(_AtEvent(0, signal.SIGTERM))  # what is imported, compiled and started once
    whole = _AtEvent(0, signal.SIGTERM)
    run(whole)
    rng, made = np.random.default_rng(0), 0
    while made < count:
        event = int(rng.integers(1, whole.count))
        at = _AtEvent(event, signal.SIGTERM if event % 2 else signal.SIGINT)
        ended_by = run(at)
        if not at.is_made:  # how often it looks whether a case is done differs from run to run
            continue
        assert ended_by is (Terminated if event % 2 else KeyboardInterrupt), f"at event {event}"
        made += 1
        cases = list((tmp_path / "out/cases").iterdir())
        assert len(cases) == 2
        assert all(load_case(case) for case in cases)
    run(whole)
    gc.collect()  # what the last request holds by its traceback
    assert list(scratch.iterdir()) == []


WAITING = """
from ddpc_controllers import MFAPC

class Waiting(MFAPC):
    def start(self, loop):
        open("{pipe}", "rb").read(1)
        super().start(loop)
"""


def test_a_request_when_a_worker_was_just_told_to_begin_ends_it(
    write_study: WriteStudy, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Or it would go on, and make anew the folder for what is not complete, which is gone by then."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    write(tmp_path, WAITING.format(pipe=pipe), "waiting.py")
    resolved = read_study(str(write_study("waiting:Waiting")))
    writing = list[int]()

    def asked(*arguments: Any) -> None:
        ask_worker(*arguments)
        writing.append(os.open(pipe, os.O_WRONLY))  # as soon as the run reads it
        ask()

    monkeypatch.setattr("ddpc_cosim.study.runner.ask", asked)
    with pytest.raises(Terminated), orderly_end():
        run_study(resolved, tmp_path / "out", Selection(), Silent())
    with pytest.raises(BrokenPipeError):  # no process reads it any more
        os.write(*writing, b"go on")
    os.close(*writing)
    assert list((tmp_path / "out/cases").iterdir()) == []


def test_a_worker_ends_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    end = Forked.end

    def asked(forked: Forked) -> ExitStatus:
        ask()
        return end(forked)

    monkeypatch.setattr(Forked, "end", asked)
    worker = Worker(serve_calls, folder=tmp_path)
    pid = worker.call(os.getpid, seconds=60.0)
    with pytest.raises(Terminated), orderly_end():
        worker.end()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


AT_EVENT = """
import os, signal, sys

if event := int(os.environ.pop("AT_EVENT", "")):
    began, count = False, 0

    def look(frame, kind, argument):
        global began, count
        began = began or kind == "return" and frame.f_code.co_name == "_handle"
        count += began
        if count == event:
            sys.setprofile(None)
            signal.raise_signal(signal.SIGTERM)

    sys.setprofile(look)
"""


@pytest.mark.parametrize("count", [3, pytest.param(12, marks=pytest.mark.slow)])
def test_a_request_while_the_program_is_imported(count: int, tmp_path: Path, program: str) -> None:
    """A message, never a traceback, whatever it meets."""
    (tmp_path / "sitecustomize.py").write_text(AT_EVENT, encoding="utf-8")
    paths = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    for event in 10.0 ** np.random.default_rng(1).uniform(1.0, 5.5, count):
        ended = subprocess.run(
            [program, "run", "paper", "--dry-run"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": paths, "AT_EVENT": str(int(event))},
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=120,
            check=False,
        )
        message = "terminated: finished cases are kept; the same command goes on from there"
        assert (ended.returncode, ended.stderr.splitlines()[-1]) == (143, message), (event, ended.stderr)
        assert "Traceback" not in ended.stderr, event
