"""`init` is never silent for two seconds: a status on a terminal, lines elsewhere."""

import io

import pytest
from rich.console import Console

from ddpc_cosim.cli.init import Status


class Ticks:
    """An event that lets three waits pass, and then is set."""

    def __init__(self) -> None:
        self.waits: list[float] = []

    def wait(self, seconds: float) -> bool:
        self.waits.append(seconds)
        return len(self.waits) > 3

    def set(self) -> None:
        """Nothing waits for it any more."""


@pytest.mark.parametrize("terminal", [False, True])
def test_what_is_being_done_is_shown_again_and_again(terminal: bool, monkeypatch) -> None:
    ticks = Ticks()
    monkeypatch.setattr("ddpc_cosim.cli.init.Event", lambda: ticks)
    shown = io.StringIO()
    status = Status(Console(file=shown, force_terminal=terminal, width=80, color_system=None), "init")
    status("step test of a\x1b[31mred.fmu")
    with status:
        pass
    assert max(ticks.waits) < 2.0
    if terminal:
        assert "step test of a" in shown.getvalue()
    else:
        lines = shown.getvalue().splitlines()
        assert lines == ["0 s: step test of a\\x1b[31mred.fmu"] * 4  # at once, and at each wait
