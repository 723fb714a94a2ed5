"""Long work is not silent for two seconds: a spinner on a terminal, lines elsewhere."""

import io
import itertools
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console

from ddpc_cosim.cli import progress
from ddpc_cosim.cli.main import main


class Ticks:
    """An event that lets three waits pass, and then is set."""

    def __init__(self) -> None:
        self.waits: list[float] = []

    def wait(self, seconds: float) -> bool:
        self.waits.append(seconds)
        return len(self.waits) > 3

    def set(self) -> None:
        """Nothing waits for it any more."""


@pytest.fixture
def ticks(monkeypatch: pytest.MonkeyPatch) -> Ticks:
    ticks = Ticks()
    monkeypatch.setattr(progress, "Event", lambda: ticks)
    monkeypatch.setattr(progress, "_SECONDS_BETWEEN_LINES", 1.5)
    return ticks


def test_what_is_being_done_is_said_again_and_again(ticks: Ticks, monkeypatch) -> None:
    clock = itertools.count(0.0, 150.0)
    monkeypatch.setattr(progress, "monotonic", lambda: next(clock))
    lines = io.StringIO()
    with progress.LineProgress(lines, "step test of a\x1b[31mred.fmu"):
        pass
    text = "step test of a\\x1b[31mred.fmu"
    times = [int(line.removesuffix(f" s: {text}")) for line in lines.getvalue().splitlines()]
    assert len(times) == 3
    assert times == sorted(times)
    assert ticks.waits == [1.5, *(max(1.5, 0.01 * (time + 150)) for time in times)], "1 % of what has passed"


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
