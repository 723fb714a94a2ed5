"""``ddpc-cosim simulate``: what is written, what is printed, and the exit codes."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from fmus.builder import Fault, keeping_fmu, model_fmu

from ddpc_cosim.cli.main import main

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def simulate(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["simulate", *arguments])


def test_a_run_is_written_and_agrees_with_itself(folder: Path) -> None:
    """The CSV file of one run is the golden file of the next; another parameter shows as the worst value."""
    model_fmu(folder, "2.0", "lag")
    (folder / "u.csv").write_text("time,u\n0,1\n1,1\n", encoding="utf-8")
    given = ("lag2.fmu", "--inputs", "u.csv", "--step", "0.25")
    first = simulate(*given, "--out", "a.csv", "--out", "a.html", "--out", "a.svg")
    assert first.exit_code == 0, first.stderr
    assert "lag2.fmu: 5 of 5 samples, 0 s to 1 s, every 0.25 s" in first.stdout
    assert "note: stop = 1 s, as the plant does not say: the end of the inputs" in first.stderr
    lines = (folder / "a.csv").read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["time [s],x [1],u [1]", "0.0,0.0,1.0"]
    assert len(lines) == 6
    page, drawing = ((folder / name).read_text(encoding="utf-8") for name in ("a.html", "a.svg"))
    assert "Simulation of lag2.fmu" in page
    assert "http" not in page.partition("<script")[0].replace("http-equiv", "").replace(
        "http://www.w3.org/", ""
    )
    assert drawing.startswith("<svg xmlns=")
    assert "var(" not in drawing

    again = simulate("lag2.fmu", "--inputs", "u.csv", "--compare", "a.csv")
    assert again.exit_code == 0, again.output
    assert "a.csv: equal to the last bit at 5 of 5 samples: x, u" in again.stdout
    other = simulate(
        "lag2.fmu", "--inputs", "u.csv", "--compare", "a.csv", "--set", "rate=1.1", "--rel", "0.01"
    )
    assert other.exit_code == 1
    assert "a.csv: differs: x at t = 1 s is 0.667128916, golden 0.632120559: difference 0.035" in other.stdout


def test_a_fault_keeps_its_samples_and_exits_with_1(folder: Path) -> None:
    model_fmu(folder, "2.0", "lag", Fault.SEGMENTATION_FAULT)
    given = ("lag2.fmu", "--stop", "1", "--step", "0.1", "--out", "part.csv", "--trace-calls", "calls.txt")
    result = simulate(*given, "--out", "part.html")
    assert result.exit_code == 1
    assert "(crashed)" in result.stdout
    assert (
        "lag2.fmu: crashed: 6 of 11 samples, to t = 0.5 s: lag2.fmu: crashed in step at t = 0.5 s"
        in result.stderr
    )
    lines = (folder / "part.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "time [s],x [1],outcome"
    assert len(lines) == 7
    assert all(line.endswith(",crashed") for line in lines[1:])
    assert "crashed: 6 of 11 samples" in (folder / "part.html").read_text(encoding="utf-8")
    calls = (folder / "calls.txt").read_text(encoding="utf-8").splitlines()
    assert calls[0].startswith("fmi2Instantiate(")
    assert calls[-1].startswith("fmi2DoStep(")
    assert calls[-1].endswith(")")


def test_a_golden_file_that_goes_on_differs(folder: Path) -> None:
    model_fmu(folder, "2.0", "lag", Fault.RETURN_ERROR)
    (folder / "golden.csv").write_text(
        "time,x\n" + "".join(f"{k / 10},0\n" for k in range(11)), encoding="utf-8"
    )
    result = simulate("lag2.fmu", "--compare", "golden.csv")
    assert result.exit_code == 1
    assert "golden.csv: differs: the run ended before its last time, 1 s (fmu-error: " in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("lag2.fmu", "--out", "a.txt"), "--out a.txt: the name must end in .csv, .html, .svg"),
        (("lag2.fmu", "--out", "none/a.csv"), "no such folder: none"),
        (("lag2.fmu", "--set", "rate"), '--set "rate" is not possible; needed: NAME=VALUE'),
        (("lag2.fmu", "--set", "rate=1", "--set", "rate=2"), "--set: rate is given more than once"),
        (("lag2.fmu", "--inputs", "none.csv"), "none.csv: no such file"),
        (("lag2.fmu", "--compare", "none.csv"), "none.csv: no such file"),
        (("lag2.fmu", "--trace-calls", "none/calls.txt"), "none/calls.txt: cannot be written"),
        (("lag2.fmu", "--outputs", "x,y"), 'no output "y"'),
        (("none.fmu",), "none.fmu: no such file"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_runs(
    folder: Path, arguments: tuple[str, ...], words: str
) -> None:
    model_fmu(folder, "2.0", "lag")
    result = simulate(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert "samples" not in result.stdout


@pytest.mark.parametrize("option", ["--out", "--trace-calls"])
@pytest.mark.parametrize("name", ["lag2.fmu", "u.csv", "golden.csv"])
def test_no_file_that_is_read_is_written_over(folder: Path, option: str, name: str) -> None:
    model_fmu(folder, "2.0", "lag")
    for file in ("u.csv", "golden.csv"):
        (folder / file).write_text("time,u\n0,1\n2,1\n")
    before = (folder / name).read_bytes()
    result = simulate("lag2.fmu", "--inputs", "u.csv", "--compare", "golden.csv", option, f"./{name}")
    assert result.exit_code == 2
    assert name in result.stderr
    assert (folder / name).read_bytes() == before


def test_a_run_without_samples_is_told_everywhere(folder: Path) -> None:
    model_fmu(folder, "2.0", "lag", Fault.ERROR_IN_INITIALIZATION)
    outs = [word for kind in ("csv", "html", "svg") for word in ("--out", f"none.{kind}")]
    result = simulate("lag2.fmu", "--stop", "1", *outs)
    assert result.exit_code == 1
    assert "lag2.fmu: fmu-error: before the first sample: " in result.stderr
    assert (folder / "none.csv").read_text(encoding="utf-8") == "time [s],x [1],outcome\n"
    assert "fmu-error: before the first sample: " in (folder / "none.html").read_text(encoding="utf-8")
    assert "lag2.fmu (fmu-error)" in (folder / "none.svg").read_text(encoding="utf-8")


def test_a_winter_day_is_run_and_compared(folder: Path) -> None:
    """Moments and durations in words; the golden file says where a run begins that is compared with it."""
    model_fmu(folder, "2.0", "lag", head='<DefaultExperiment startTime="0" stopTime="31536000"/>')
    moments = ("--start", "day 23", "--stop", "day 23", "--step", "15 min")
    refused = simulate("lag2.fmu", *moments)
    assert refused.exit_code == 2
    assert "stop = 1.9008e+06 s is not possible; allowed: a number > 1.9008e+06" in refused.stderr
    given = ("--start", "2026-01-23", "--stop", "2026-01-23T06:00", "--step", "15 min", "--out", "day.csv")
    first = simulate("lag2.fmu", "--set", "x=1", *given)
    assert first.exit_code == 0, first.stderr
    rows = (folder / "day.csv").read_text(encoding="utf-8").splitlines()
    assert (len(rows), rows[1], rows[-1].partition(",")[0]) == (26, "1900800.0,1.0", "1922400.0")
    again = simulate("lag2.fmu", "--set", "x=1", "--compare", "day.csv")
    assert again.exit_code == 0, again.output
    assert "note: start = 1.9008e+06 s, as in day.csv" in again.stderr
    for option in (("--start", "yesterday"), ("--step", "day 3")):
        wrong = simulate("lag2.fmu", *option)
        assert wrong.exit_code == 2
        assert "must be a number of seconds, or a duration such as" in " ".join(wrong.stderr.split())


def test_a_state_is_saved_and_gone_on_from(folder: Path) -> None:
    """The rest of a divided run is, to the last digit, that of the whole one; the first half in a sandbox."""
    keeping_fmu(folder, "2.0", "lag")
    (folder / "u.csv").write_text("time,u\n0,0\n3,3\n", encoding="utf-8")
    given = ("lag2.fmu", "--inputs", "u.csv", "--step", "0.1")
    whole = simulate(*given, "--stop", "3", "--out", "whole.csv")
    first = simulate(*given, "--stop", "1.7", "--save-state", "mid.state", "--sandbox")
    assert (whole.exit_code, first.exit_code) == (0, 0), first.stderr
    assert first.stdout.splitlines()[-1] == "mid.state"
    rows = (folder / "whole.csv").read_text(encoding="utf-8").splitlines()
    given = ("--inputs", "u.csv", "--load-state", "mid.state", "--stop", "3", "--out", "rest.csv")
    second = simulate("lag2.fmu", *given)
    assert second.exit_code == 0, second.output
    assert "note: goes on at t = 1.7 s from a state" in second.stderr
    rest = (folder / "rest.csv").read_text(encoding="utf-8").splitlines()
    assert rest == [rows[0], *rows[18:]]


def test_states_that_cannot_be_are_told_at_once(folder: Path) -> None:
    keeping_fmu(folder, "2.0", "lag", ["GetAndSet"])
    model_fmu(folder, "3.0", "lag")
    (folder / "torn.state").write_bytes(b"{")
    places = simulate("lag2.fmu", "--save-state", "lag2.fmu", "--load-state", "torn.state")
    assert places.exit_code == 2
    assert "--save-state lag2.fmu: this file is read; choose another one" in places.stderr
    assert "torn.state: is not a state, or is damaged" in places.stderr
    for fmu, lacking in (("lag2.fmu", "canSerializeFMUstate"), ("lag3.fmu", "canGetAndSetFMUstate")):
        unable = simulate(fmu, "--save-state", "mid.state")
        assert unable.exit_code == 2
        assert f"the FMU cannot save its state as bytes ({lacking} is false)" in unable.stderr
    assert not (folder / "mid.state").exists()


def test_a_run_that_ends_early_leaves_no_state(folder: Path) -> None:
    keeping_fmu(folder, "2.0", "lag", fault=Fault.SEGMENTATION_FAULT)
    result = simulate("lag2.fmu", "--stop", "1", "--step", "0.1", "--save-state", "mid.state")
    assert result.exit_code == 1
    assert "--save-state mid.state: not written: there is nothing to go on from" in result.stderr
    assert not (folder / "mid.state").exists()
