"""Long lines on a terminal: no word is broken, and none passes for a line of the program's own."""

import sys

import pytest

from ddpc_cosim.cli.output import harmless, say


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both streams as those of a terminal with lines of 20 letters."""
    monkeypatch.setenv("COLUMNS", "20")
    for stream in (sys.stdout, sys.stderr):
        monkeypatch.setattr(stream, "isatty", lambda: True)


@pytest.mark.usefixtures("terminal")
def test_lines_end_between_words_and_go_on_indented() -> None:
    assert harmless("warning: 3 of 4 cases are damaged").split("\n") == [
        "warning: 3 of 4",
        "  cases are damaged",
    ]
    assert harmless("a /very/long/path/that/is/not/broken b").split("\n") == [
        "a",
        "  /very/long/path/that/is/not/broken",
        "  b",
    ]
    assert harmless("no such thing here, error: forged").split("\n")[1].startswith("  ")
    assert harmless("one\ntwo") == r"one\ntwo"
    assert harmless("one\n\ntwo", keep="\n") == "one\n\ntwo"


def test_elsewhere_a_line_is_as_long_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    say("word " * 100 + "\x1b", err=True)
    assert capsys.readouterr().err == "word " * 100 + "\\x1b\n"
