"""Every code block of the README and of docs/ runs."""

import re
import shlex
import shutil
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from ddpc_cosim.cli.main import main
from ddpc_cosim.study.reading import read_study

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ROOMS = ("fmu_plants", "ddpc_cosim", "controllers", "reports", "tests", "docs", "benchmarks")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[object]:
    return [
        pytest.param(code, id=f"{page.name}-{number}")
        for page in PAGES
        for number, (kind, code) in enumerate(BLOCK.findall(page.read_text(encoding="utf-8")))
        if kind == language
    ]


@pytest.fixture
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder that holds the files beside the pages, and nothing else."""
    monkeypatch.chdir(tmp_path)
    for path in (ROOT / "docs").glob("*.csv"):
        shutil.copy(path, tmp_path)
    return tmp_path


@pytest.mark.parametrize("code", blocks("python"))
def test_python_blocks_run(code: str, empty_folder: Path) -> None:
    assert CliRunner().invoke(main, ["export", "pendulum"]).exit_code == 0
    exec(compile(code, "documentation", "exec"), {})


@pytest.mark.parametrize("text", blocks("toml"))
def test_studies_run(text: str, empty_folder: Path) -> None:
    study = empty_folder / "study.toml"
    study.write_text(text, encoding="utf-8")
    for name in re.findall(r'^fmu = "(\w+)\.fmu"', text, re.MULTILINE):
        assert CliRunner().invoke(main, ["export", name.replace("_", "-")]).exit_code == 0
    assert read_study(str(study)).problems
    only = ["--only", "mine"] if 'extends = "benchmark"' in text else []  # not all of its 840 cases
    command = ["run", str(study), "--jobs", "1", "--no-report", "--seeds", "0", *only]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output


def test_every_file_that_the_house_on_one_page_names_exists() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w/-]+\.(?:py|pyi|toml|md|jinja)|[\w/]+/)`", page)
    tree = [path.relative_to(ROOT).as_posix() for folder in ROOMS for path in (ROOT / folder).rglob("*")]
    tree += [path.name for path in ROOT.iterdir()]
    missing = [
        name for name in named if not any(f"/{path}/".endswith(f"/{name.strip('/')}/") for path in tree)
    ]
    assert len(named) > 30
    assert missing == []


def test_every_command_that_the_readme_shows_exists() -> None:
    """The commands themselves run in the end-to-end tests; here none may be misspelt."""
    shown = re.findall(r"ddpc-cosim ([a-z]+)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert set(shown) <= set(main.commands)
    assert {"run", "report", "list", "export"} <= set(shown)


@pytest.mark.parametrize("code", blocks("sh"))
def test_commands_have_the_options_that_they_are_shown_with(code: str) -> None:
    for line in code.replace("\\\n", " ").splitlines():
        if line.startswith("ddpc-cosim "):
            _, name, *arguments = shlex.split(line, comments=True)
            command = main.commands[name]
            command.make_parser(click.Context(command)).parse_args(arguments)


def test_the_readme_begins_with_the_two_commands() -> None:
    shell = blocks("sh")
    first = shell[0].values[0]  # type: ignore[attr-defined]
    commands = [shlex.split(line, comments=True) for line in first.splitlines()]
    assert commands == [
        ["pip", "install", "uv", "&&", "uv", "run", "ddpc-cosim", "run", "paper"],
        ["uv", "run", "pytest"],
    ]
