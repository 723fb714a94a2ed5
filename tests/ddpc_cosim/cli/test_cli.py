"""The command line: what is printed where, and the exit codes."""

import csv
import json
import re
import shutil
import subprocess
import webbrowser
from collections.abc import Callable
from pathlib import Path

import click
import fmpy
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner, Result
from fmus.builder import Fault

from ddpc_cosim.cli.main import main
from ddpc_cosim.plugins import package_version

Run = Callable[..., subprocess.CompletedProcess[str]]
WriteStudy = Callable[..., Path]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


def test_help_names_every_command() -> None:
    for flag in ("--help", "-h"):
        result = invoke(flag)
        assert result.exit_code == 0
        for command in ("run", "report", "list", "export"):
            assert f"\n  {command}" in result.stdout


def test_what_a_file_says_does_not_steer_the_terminal(folder: Path) -> None:
    (folder / "study.toml").write_text('"\\u001b[31mred é" = 1\n', encoding="utf-8")
    result = invoke("run", "study.toml")
    assert result.exit_code == 2
    assert "\x1b" not in result.stderr
    assert "\\x1b[31mred é" in result.stderr


def test_a_line_of_a_file_is_no_line_of_the_program(folder: Path) -> None:
    (folder / "study.toml").write_text('"a\\nerror: forged" = 1\n', encoding="utf-8")
    lines = invoke("run", "study.toml").stderr.splitlines()
    assert "  error: forged" in "\n".join(lines)
    assert not any(line.startswith("error: forged") for line in lines)


def test_version() -> None:
    assert invoke("--version").stdout == f"{package_version()}\n"


def test_no_range_of_numbers_has_nan_or_infinity_in_it() -> None:
    options = [
        (option, option.type)
        for command in main.commands.values()
        for option in command.params
        if isinstance(option.type, click.FloatRange)
    ]
    assert len(options) >= 7
    for option, kind in options:
        for text in ("nan", "inf"):
            with pytest.raises(click.BadParameter, match=r"is not (a finite number|in the range)"):
                kind.convert(text, option, None)


def test_times_that_are_not_finite_are_refused() -> None:
    for text in ("nan", "inf"):
        done = invoke("simulate", "pendulum", "--stop", text)
        assert (done.exit_code, f"error: stop = {text} s is not possible" in done.stderr) == (2, True)
        done = invoke("simulate", "pendulum", "--step", text)
        assert (done.exit_code, f"error: step = {text} s is not possible" in done.stderr) == (2, True)


def test_run_prints_the_table_and_writes_everything(folder: Path, write_study: WriteStudy) -> None:
    write_study("mfapc", seeds="[0, 1]")
    result = invoke("run", "study.toml", "--jobs", "1")
    assert result.exit_code == 0, result.output
    out = folder / "runs" / "study"
    assert sorted(path.name for path in out.iterdir()) == [
        "cases",
        "metrics.csv",
        "provenance.json",
        "report.html",
        "study.toml",
    ]
    lines = result.stdout.splitlines()
    assert lines[0] == "study (2 seeds)"
    assert any(line.split()[:1] == ["mfapc"] for line in lines)
    assert Path(lines[-1]) == Path("runs/study/report.html")
    assert "4 cases to run" in result.stderr
    assert "\x1b" not in result.output


def test_metrics_have_one_row_per_case_with_units_in_the_header(
    folder: Path, write_study: WriteStudy
) -> None:
    write_study("mfapc", seeds="[3, 4]")
    assert invoke("run", "study.toml", "--no-report", "--out", "out").exit_code == 0
    assert not (folder / "out" / "report.html").exists()
    with (folder / "out" / "metrics.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["study"], row["plant"], row["controller"], row["seed"]) for row in rows] == [
        ("study", "no_fault.fmu", "mfapc", "3"),
        ("study", "no_fault.fmu", "mfapc", "4"),
    ]
    assert {row["outcome"] for row in rows} == {"completed"}
    assert all(float(row["sum_abs_error.y [1]"]) > 0 for row in rows)


def test_a_case_that_failed_exits_with_1_and_is_explained(folder: Path, write_study: WriteStudy) -> None:
    write_study("mfapc", fault=Fault.RETURN_ERROR)
    result = invoke("run", "study.toml", "--jobs", "1")
    assert result.exit_code == 1
    assert "mfapc_seed0" in result.stderr
    assert (
        "fmu-error: return_error.fmu: fmi2DoStep returned error at t = 0.5 s; [error] division by zero"
        in result.stderr
    )
    assert (folder / "runs" / "study" / "report.html").is_file()
    (row,) = (line for line in result.stdout.splitlines() if " mfapc " in line)
    assert row.split()[:5] == ["mfapc", "1/1", "-", "-", "-"]


def test_controllers_of_the_same_label_are_not_mixed_up(folder: Path, write_study: WriteStudy) -> None:
    study = write_study("mfapc")
    text = study.read_text(encoding="utf-8")
    text += 'label = "same"\n[controllers.other]\ntype = "mfapc"\nlabel = "same"\nsettings = { mu = 2.0 }\n'
    study.write_text(text, encoding="utf-8")
    result = invoke("run", "study.toml", "--no-report")
    assert result.exit_code == 0
    rows = [line for line in result.stdout.splitlines() if re.match(r" *[\d-]+ +same \(", line)]
    assert sorted(line[7:].strip().split("  ")[0] for line in rows) == ["same (mfapc)", "same (other)"]


def test_report_rebuilds_one_or_joins_several(folder: Path, write_study: WriteStudy) -> None:
    write_study("mfapc")
    for out in ("a", "b"):
        assert invoke("run", "study.toml", "--no-report", "--out", out).exit_code == 0
    result = invoke("report", "a")
    assert (result.exit_code, Path(result.stdout.strip())) == (0, Path("a/report.html"))
    result = invoke("report", "a", "b", "--out", "both.html")
    assert (result.exit_code, result.stdout) == (0, "both.html\n")
    assert (folder / "both.html").stat().st_size > 0


@pytest.fixture
def out(folder: Path, write_study: WriteStudy) -> Path:
    """A folder of results without a report."""
    write_study("mfapc")
    assert invoke("run", "study.toml", "--no-report", "--out", "out", "--jobs", "1").exit_code == 0
    return folder / "out"


def test_a_report_can_be_printed_and_its_format_is_one_that_is_installed(out: Path) -> None:
    printed = invoke("report", "out", "--out", "-")
    assert printed.exit_code == 0
    assert printed.stdout.startswith("<!doctype html>")
    assert not (out / "report.html").exists()
    unknown = invoke("report", "out", "--format", "htlm")
    assert (unknown.exit_code, unknown.stdout) == (2, "")
    assert unknown.stderr == 'error: no report format "htlm"; did you mean "html"?\n'
    assert "simulation" not in invoke("report", "out", "--format", "x").stderr


@pytest.mark.parametrize("opened", [True, False])
def test_a_report_is_opened_where_there_is_a_browser(
    out: Path, opened: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []

    def browser(address: str) -> bool:
        seen.append(address)
        return opened

    monkeypatch.setattr(webbrowser, "open", browser)
    for command in (("report", "out"), ("run", "study.toml", "--out", "out")):
        result = invoke(*command, "--open")
        assert result.exit_code == 0
        assert Path(result.stdout.splitlines()[-1]) == Path("out/report.html")
        assert seen.pop() == (out / "report.html").resolve().as_uri()
        assert ("no browser was found" in result.stderr) != opened


@pytest.mark.parametrize(
    "command",
    [("report", "out", "--out", "-", "--open"), ("run", "study.toml", "--no-report", "--open")],
)
def test_what_is_not_written_cannot_be_opened(out: Path, command: tuple[str, ...]) -> None:
    result = invoke(*command)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("error: --open: ")


def test_a_report_that_cannot_be_written_is_explained(folder: Path, write_study: WriteStudy) -> None:
    write_study("mfapc")
    assert invoke("run", "study.toml", "--no-report", "--out", "out").exit_code == 0
    (folder / "file").touch()
    result = invoke("report", "out", "--out", "file/report.html")
    assert result.exit_code == 2
    assert "the report cannot be written" in result.stderr


def test_damaged_samples_do_not_give_a_traceback(folder: Path, write_study: WriteStudy) -> None:
    write_study("mfapc")
    assert invoke("run", "study.toml", "--no-report", "--out", "out").exit_code == 0
    (samples,) = folder.glob("out/cases/mfapc_*/signals.csv")
    samples.write_text("time [s]", encoding="utf-8")
    result = invoke("report", "out")
    assert result.exit_code == 1
    assert f"{samples.parent.name}: damaged: signals.csv is not what was written" in result.stderr
    assert "1 of 2 cases are damaged" in Path("out/report.html").read_text(encoding="utf-8")


def test_fresh_runs_everything_again(folder: Path, write_study: WriteStudy) -> None:
    write_study("mfapc")
    arguments = ("run", "study.toml", "--no-report")
    assert "2 cases to run" in invoke(*arguments).stderr
    assert "0 cases to run, 2 kept" in invoke(*arguments).stderr
    assert "2 cases to run\n" in invoke(*arguments, "--fresh").stderr


def test_export_writes_an_fmu_that_others_can_read(folder: Path) -> None:
    result = invoke("export", "pendulum")
    assert (result.exit_code, result.stdout) == (0, "pendulum.fmu\n")
    assert fmpy.read_model_description("pendulum.fmu").modelName == "pendulum"
    assert invoke("export", "pendulum", "--out", "other.fmu").stdout == "other.fmu\n"


def test_as_a_process_results_go_to_stdout_and_the_rest_to_stderr(
    run_program: Run, write_study: WriteStudy
) -> None:
    study = write_study("mfapc")
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report")
    assert done.returncode == 0, done.stderr
    assert "mfapc" in done.stdout
    assert "2 cases to run" in done.stderr.splitlines()
    assert "\x1b" not in done.stdout + done.stderr
    shutil.rmtree(study.parent / "runs")
    study.write_text("x", encoding="utf-8")
    done = run_program("run", "study.toml")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines()[-1].startswith("error: study.toml: not a TOML file: ")


def test_equal_failures_stand_in_one_line(folder: Path, write_study: WriteStudy) -> None:
    write_study("mfapc", fault=Fault.RETURN_ERROR, seeds='["0:10"]')
    result = invoke("run", "study.toml", "--jobs", "1", "--no-report")
    assert result.exit_code == 1
    (line,) = (line for line in result.stderr.splitlines() if "fmu-error" in line)
    assert re.match(r"mfapc_seed0_\w+ and 9 more: fmu-error: return_error.fmu: ", line)


def test_what_is_installed_is_listed_as_json() -> None:
    """The shape that docs/command-line.md tells."""
    result = invoke("list", "--json")
    assert result.exit_code == 0
    listed = json.loads(result.stdout)
    assert list(listed) == ["plants", "controllers", "studies", "metrics", "conditions", "reports"]
    for entries in listed.values():
        assert {tuple(entry) for entry in entries} == {("name", "what", "package", "target", "works")}
    names = {kind: [entry["name"] for entry in entries] for kind, entries in listed.items()}
    assert "pendulum" in names["plants"]
    assert names["metrics"][:2] == ["mean_abs_error", "rmse"]
    assert json.loads(invoke("list", "studies", "--json").stdout) == {"studies": listed["studies"]}


def test_on_a_terminal_of_80_columns_names_are_whole_and_no_word_is_broken() -> None:
    listed = json.loads(invoke("list", "--json").stdout)
    words = {word for entries in listed.values() for entry in entries for word in entry["what"].split()}
    result = CliRunner().invoke(main, ["list"], env={"COLUMNS": "80"})
    assert max(map(len, result.stdout.splitlines())) <= 80
    shown = set(result.stdout.split())
    assert {entry["name"] for entries in listed.values() for entry in entries} <= shown
    assert {word for word in words if len(word) < 25} <= shown


def test_cases_are_chosen_by_labels_with_brackets_too(folder: Path, write_study: WriteStudy) -> None:
    write_study(controllers={"mfapc": "mfapc", "idle": {"type": "idle", "label": "At [rest]"}})
    for only in ("At [rest]", "At *", "idle"):
        result = invoke("run", "study.toml", "--only", only, "--dry-run")
        assert result.stdout.startswith("1 case and 1 run of doing nothing: ")


def test_cases_are_chosen_by_several_patterns(folder: Path, write_study: WriteStudy) -> None:
    write_study("mfapc", "idle", "spsa")
    twice = ("--only", "mfapc", "--only", "id*")
    for more, count in (("mf*", 2), ("*", 3)):
        result = invoke("run", "study.toml", *twice, "--only", more, "--dry-run")
        assert result.stdout.startswith(f"{count} cases and 1 run of doing nothing: ")
    assert invoke("run", "study.toml", *twice, "--no-report").exit_code == 0
    run = folder / "runs" / "study"
    chosen = {case.name.split("_")[0] for case in (run / "cases").iterdir()}
    assert chosen == {"mfapc", "idle", "doing-nothing"}
    wrong = invoke("run", "study.toml", *twice, "--only", "spas", "--only", "x*", "--dry-run")
    assert wrong.stderr.splitlines()[0] == 'error: --only spas: no case matches; did you mean "spsa"?'
    assert wrong.stderr.splitlines()[1].startswith("error: --only x*: no case matches; there are: ")


@pytest.mark.parametrize(
    ("words", "begun", "expected"),
    [
        (["run"], "pa", {"paper", "pa"}),
        (["export"], "pend", {"pendulum", "pend"}),
        (["check"], "deepc", {"deepc", "deepc-published"}),
        (["list"], "pl", {"plants"}),
        (["run", "paper"], "--no-r", {"--no-report"}),
        (["run", "paper", "--executor"], "d", {"dask"}),
        ([], "exp", {"export", "export-controller"}),
    ],
)
def test_a_shell_completes_commands_options_and_names(
    words: list[str], begun: str, expected: set[str]
) -> None:
    complete = ShellComplete(main, {}, "ddpc-cosim", "_DDPC_COSIM_COMPLETE")
    assert {item.value for item in complete.get_completions(words, begun)} == expected


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_is_told_how_to_complete(shell: str) -> None:
    environment = {"_DDPC_COSIM_COMPLETE": f"{shell}_source"}
    result = CliRunner().invoke(main, [], prog_name="ddpc-cosim", env=environment)
    assert result.exit_code == 0
    assert f"_DDPC_COSIM_COMPLETE={shell}_complete" in result.stdout
