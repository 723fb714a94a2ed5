"""What every command says and exits with where a name, a file or an option is wrong."""

import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from ddpc_cosim.cli.main import main

WriteStudy = Callable[..., Path]

WRONG: dict[str, str] = {
    "rnu": "No such command 'rnu'",
    "--vresion": "Did you mean '--version'?",
    "run": "Missing argument 'STUDY'",
    "run papre": 'error: no study "papre"; did you mean "paper"?',
    "run nowhere.toml": "error: nowhere.toml: no such study file",
    "run bad": 'error: no study "bad"',
    "run bad.toml": "error: bad.toml: not a TOML file",
    "run study.toml --jobs 0": "Invalid value for '--jobs'",
    "run study.toml --jbos 2": "Did you mean '--jobs'?",
    "run study.toml --job 2": "error: No such option '--job'. Did you mean '--jobs'?",
    "run study.toml --executor daks": '"daks" is not possible; did you mean "dask"?',
    "run study.toml --seeds 3:1": "error: --seeds: '3:1' is not a seed; allowed",
    "run study.toml --seeds x": "error: --seeds: 'x' is not a seed; allowed",
    "run study.toml --seeds -1": "error: --seeds: '-1' is not a seed",
    "run study.toml --shard 3/2": "error: --shard 3/2: must be",
    "run study.toml --only lqr": "error: --only lqr: no case matches; there are: ",
    "run study.toml --only mfacp": 'error: --only mfacp: no case matches; did you mean "mfapc"?',
    "run study.toml --only mfapc --only mfacp": 'error: --only mfacp: no case matches; did you mean "mfapc"?',
    "run study.toml --out a --out b": "error: --out is given 2 times; allowed: once",
    "run study.toml --seeds 0 --jobs 1 --seeds=1 --seeds 2": "error: --seeds is given 3 times; allowed: once",
    "tune study.toml --trials 1 --trials 2": "error: --trials is given 2 times; allowed: once",
    "diff folder folder --abs 1 --abs 2": "error: --abs is given 2 times; allowed: once",
    "run study.toml --out bad.fmu": "Directory 'bad.fmu' is a file",
    "run study.toml --out bad.fmu/below": "results cannot be written there",
    "run study.toml --out ''": "Invalid value for '--out': it is empty",
    "report ''": "it is empty; needed: a path",
    "tune papre": 'error: no study "papre"; did you mean "paper"?',
    "tune study.toml --objective rsme": 'did you mean "rmse"?',
    "tune study.toml --seeds x": "error: --seeds: 'x' is not a seed",
    "report": "Missing argument 'DIR [DIR ...]'",
    "report nowhere": "error: nowhere: no results: study.toml is missing",
    "report bad.fmu": "error: bad.fmu: no results: study.toml is missing",
    "diff nowhere folder": "error: nowhere: no results: study.toml is missing",
    "diff nowhere": "takes 2 values",
    "list plant": '"plant" is not possible; did you mean "plants"?',
    "list study": '"study" is not possible; did you mean "studies"?',
    "list everything": "there are: conditions, controllers, metrics, plants, reports, studies",
    "simulate pendulm": 'error: no plant "pendulm"; did you mean "pendulum"?',
    "simulate nowhere.fmu": "error: nowhere.fmu: no such file",
    "simulate bad.fmu": "error: bad.fmu: not an FMU",
    "simulate nowhere:Plant": 'error: plant "nowhere:Plant" cannot be loaded',
    "simulate pendulum --set mas=1": 'error: pendulum: no parameter "mas"; did you mean "mass"?',
    "simulate pendulum --outputs angel": 'error: pendulum: no output "angel"; did you mean "angle"?',
    "simulate pendulum --inputs nowhere.csv": "error: nowhere.csv: no such file",
    "simulate pendulum --inputs bad.toml": "error: bad.toml: ",
    "simulate pendulum --compare nowhere.csv": "error: nowhere.csv: no such file",
    "simulate pendulum --out x.txt": "error: --out x.txt: the name must end in",
    "simulate pendulum --out nowhere/x.csv": "error: --out nowhere/x.csv: no such folder",
    "export x --fmi 1.0": '"1.0" is not possible; did you mean "3.0"?',
    "export pendulm": 'error: no plant "pendulm"; did you mean "pendulum"?',
    "export nowhere:MODEL": 'error: plant "nowhere:MODEL" cannot be loaded',
    "export nowhere.py:MODEL": 'error: "nowhere.py": no such file',
    "export ddpc_cosim:FMUPlant": 'error: plant "ddpc_cosim:FMUPlant" is not given by equations',
    "export pendulum --platforms linux-x68_64": 'no platform "linux-x68_64"; did you mean "linux-x86_64"?',
    "export pendulum --out bad.fmu/x.fmu": "error: the FMU cannot be written to bad.fmu/x.fmu",
    "inspect nowhere.fmu": "File 'nowhere.fmu' does not exist",
    "inspect folder": "File 'folder' is a directory",
    "init nowhere.fmu": "File 'nowhere.fmu' does not exist",
    "init bad.fmu --out new.toml": "error: bad.fmu: the file cannot be opened as an FMU",
    "check depc": 'error: no plant or controller "depc"; did you mean "deepc"?',
    "check nowhere:Class": 'error: plant or controller "nowhere:Class" cannot be loaded',
    "check nowhere.fmu": "error: nowhere.fmu: no such file",
    "check deepc --setting horizn=1": 'did you mean "horizon"?',
    "check deepc --setting x": "error: --setting: not TOML",
}
"""Command lines that are wrong, and a part of what is said of each."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write_study: WriteStudy) -> Path:
    """A folder with a study, and with files that are not what their names say."""
    write_study("mfapc")
    (tmp_path / "folder").mkdir()
    for name in ("bad.toml", "bad.fmu"):
        (tmp_path / name).write_text("neither a study nor an FMU", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


@pytest.mark.parametrize("line", WRONG)
def test_wrong_usage_exits_with_2_says_why_and_writes_nothing(line: str, folder: Path) -> None:
    before = sorted(folder.rglob("*"))
    result = invoke(*shlex.split(line))
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert WRONG[line] in result.stderr
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("line", ["inspect bad.fmu", "check bad.fmu"])
def test_a_check_that_fails_exits_with_1(line: str, folder: Path) -> None:
    assert invoke(*line.split()).exit_code == 1


HOSTILE = "\x1b[31m\u202ered\x9b"


def test_nothing_that_a_name_holds_acts_on_the_terminal(folder: Path) -> None:
    """Titles, labels, folders and arguments; what a path says is as it is on the disk."""
    study = folder / "study.toml"
    text = study.read_text(encoding="utf-8").replace('title = "', 'name = "')
    escaped = HOSTILE.replace("\x1b", "\\u001b").replace("\x9b", "\\u009b")
    text = f'title = "{escaped}"\n{text}label = "{escaped}"\n'
    text += f'[scenarios.calm]\nlabel = "{escaped}"\n[scenarios.noisy]\nnoise = {{ y = 0.01 }}\n'
    study.write_text(text, encoding="utf-8")
    lines = [
        ("run", "study.toml", "--dry-run", "--out", HOSTILE),
        ("run", "study.toml", "--out", HOSTILE, "--jobs", "1"),
        ("report", HOSTILE, "--out", f"{HOSTILE}.html"),
        ("diff", HOSTILE, HOSTILE),
        ("run", HOSTILE),
        ("run", "study.toml", "--only", HOSTILE),
        ("run", "study.toml", f"--{HOSTILE}"),
        ("simulate", HOSTILE),
        ("simulate", "pendulum", "--stop", "0.1", "--out", f"{HOSTILE}.csv"),
        ("export", HOSTILE),
        ("inspect", HOSTILE),
        ("list", HOSTILE),
        ("check", HOSTILE),
        (HOSTILE,),
    ]
    for line in lines:
        result = invoke(*line)
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
        assert not set(HOSTILE[:1] + HOSTILE[5] + HOSTILE[-1]) & set(result.output), line
    assert (folder / HOSTILE / "report.html").is_file()
    assert (folder / f"{HOSTILE}.csv").is_file()
