"""Long work is not silent: a spinner on a terminal, elsewhere a line after two seconds and on each change."""

import io
import itertools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from rich.console import Console

from ddpc_cosim import plugins
from ddpc_cosim.cli import progress
from ddpc_cosim.cli.main import main


class Ticks:
    """An event that lets three waits pass, and then is set; something may happen during the last of them."""

    def __init__(self) -> None:
        self.waits: list[float] = []
        self.before_last: Callable[[], None] = lambda: None

    def wait(self, seconds: float) -> bool:
        self.waits.append(seconds)
        if len(self.waits) == 3:
            self.before_last()
        return len(self.waits) > 3

    def set(self) -> None:
        """Nothing waits for it any more."""


@pytest.fixture
def ticks(monkeypatch: pytest.MonkeyPatch) -> Ticks:
    ticks = Ticks()
    monkeypatch.setattr(progress, "Event", lambda: ticks)
    monkeypatch.setattr(progress, "_SECONDS_BETWEEN_LINES", 1.5)
    return ticks


def test_what_is_being_done_is_said_when_it_changes(ticks: Ticks, monkeypatch) -> None:
    clock = itertools.count(0.0, 150.0)
    monkeypatch.setattr(progress, "monotonic", lambda: next(clock))
    lines = io.StringIO()
    display = progress.LineProgress(lines, "step test of a\x1b[31mred.fmu")
    ticks.before_last = lambda: display("step test of b")
    with display:
        pass
    # The clock goes on by 150 s at each look: one before each wait, and one after it.
    assert lines.getvalue().splitlines() == [
        "300 s: step test of a\\x1b[31mred.fmu",
        "900 s: step test of b",
    ]
    assert ticks.waits == [1.5, 4.5, 7.5, 10.5], "1 % of what has passed"


def test_each_running_case_the_rate_and_the_time_left_are_told(monkeypatch) -> None:
    clock = iter(range(0, 1000, 10))
    monkeypatch.setattr(progress, "monotonic", lambda: next(clock))
    cases = progress._Cases()
    cases.start(total=20)
    assert (cases.counts, cases.running(4)) == ("", [])
    for name, samples in {"a": 1, "b": 2, "c": 10, "d": 5}.items():
        cases.update(SimpleNamespace(case=name, samples=samples, planned=10))
    assert cases.running(4) == ["a: 10 %", "b: 20 %", "c: 100 %", "d: 50 %"]
    assert cases.running(3) == ["a: 10 %", "b: 20 %", "2 more"]
    cases.finished(SimpleNamespace(name="c", duration=60.0), SimpleNamespace(simulated_time=40.0))
    # The clock goes on by 10 s at each look: at 10 s, and for the counts at 20 s and 30 s.
    assert cases.rate == "6 cases/min"
    assert cases.counts == "1/20 cases, 40 s simulated, 2 cases/min, about 380 s left, "
    assert cases.running(4) == ["a: 10 %", "b: 20 %", "d: 50 %"]


def test_a_terminal_shows_what_is_being_done(monkeypatch) -> None:
    drawn = io.StringIO()
    monkeypatch.setattr(
        "rich.console.Console", lambda **_: Console(file=drawn, force_terminal=True, width=80)
    )
    with progress.TerminalProgress("reading\x1b[31m study"):
        pass
    assert "reading\\x1b[31m study" in drawn.getvalue()
    assert "0:00:0" in drawn.getvalue(), "since when"


def test_commands_say_what_they_do_before_and_after_their_cases(
    write_study: Callable[..., Path], monkeypatch
) -> None:
    monkeypatch.setattr(progress, "Event", Ticks)
    monkeypatch.chdir(write_study("pid").parent)
    result = CliRunner().invoke(main, ["run", "study.toml", "--jobs", "1"])
    for what in ("reading study.toml", "writing runs/study/report.html"):
        assert f" s: {what}\n" in result.stderr
    result = CliRunner().invoke(main, ["simulate", "pendulum", "--stop", "0.1"])
    assert " s: simulate pendulum\n" in result.stderr


LOUD = """
import ctypes, os, sys
from ddpc_cosim import Controller, Plant, Variable

def shout(what):
    print(what)
    if sys.__stdout__ is not None:
        sys.__stdout__.write(what)
    os.write(1, what.encode())
    ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).printf(what.encode())

shout("LOUD")

class Mine(Controller):
    def __init__(self):
        shout("LOUD")

    def start(self, loop):
        pass

    def step(self, sample):
        return [0.5]

class Tank(Plant):
    def __init__(self):
        shout("LOUD")
        self.inputs, self.outputs, self.level = (Variable("u"),), (Variable("y"),), 0.0

    def plan(self, sampling_time, stop_time):
        pass

    def reset(self, parameters=None, t0=0.0):
        self.level = 0.0
        return [self.level]

    def step(self, u, h):
        self.level += h * (u[0] - self.level)
        return [self.level]
"""


@pytest.fixture
def loud(write_study: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Write a study whose controller and its module print, and return the name of their module."""
    name = f"loud_{tmp_path.name}"
    write_study(f"{name}:Mine")
    (tmp_path / f"{name}.py").write_text(LOUD, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plugins, "_own_folder", tmp_path)
    return name


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("run study.toml --jobs 1 --no-report", "mine"),
        ("check {}:Mine", "passed\t"),
        ("simulate {}:Tank --stop 1", "501 of 501 samples"),
        ("export {}:Tank", ""),
    ],
)
def test_stdout_has_results_only(
    command: str, expected: str, loud: str, capfd: pytest.CaptureFixture[str]
) -> None:
    stdout = CliRunner().invoke(main, command.format(loud).split()).stdout
    assert expected in stdout
    assert "LOUD" not in stdout
    print("own words")
    assert capfd.readouterr().out == "own words\n"


def test_stdout_is_back_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        with progress.shown("work"):
            os.write(1, b"lost")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    os.write(1, b"found")
    print("too")
    assert capfd.readouterr().out == "foundtoo\n"


class Cell:
    """What a notebook's cell shows: outputs, each of which its own handle replaces."""

    def __init__(self) -> None:
        self.outputs: list[list[str]] = []

    def display(self, data: dict[str, str], *, raw: bool, display_id: bool) -> "Cell":
        assert raw
        assert display_id
        self.outputs.append([data["text/plain"]])
        return self

    def update(self, data: dict[str, str], *, raw: bool) -> None:
        assert raw
        self.outputs[-1].append(data["text/plain"])


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Cell:
    """Have this process serve a notebook."""
    cell, shell = Cell(), SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", cell)
    return cell


def test_a_notebook_has_one_output_that_is_empty_at_the_end(
    cell: Cell, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress.shown("reading") as display:
        display.prepare("reading study")
        display.start(2, 1)
    (texts,) = cell.outputs
    assert texts == ["reading study", "2 cases to run, 1 kept", ""]
    assert capsys.readouterr().err == ""


def test_where_nothing_took_long_a_notebook_has_no_output(cell: Cell) -> None:
    with progress.shown("reading"):
        pass
    assert cell.outputs == []


def test_a_program_that_has_ipython_and_no_kernel_has_lines(
    cell: Cell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: None))
    with progress.shown("reading") as display:
        display.prepare("reading study")
    assert (cell.outputs, capsys.readouterr().err) == ([], "reading study\n")
