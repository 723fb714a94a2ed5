"""Every code block of the README and of docs/ runs."""

import re
import runpy
import shlex
import shutil
import tomllib
from pathlib import Path
from types import ModuleType

import click
import pytest
from click.testing import CliRunner

import ddpc_controllers
import ddpc_cosim
import ddpc_reports
import fmu_plants
from ddpc_cosim.cli.main import main
from ddpc_cosim.study.reading import read_study

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("[a-z]*.md"))]
API = (ddpc_controllers, ddpc_cosim, ddpc_reports, fmu_plants)
STUDIES = sorted((ROOT / "ddpc_cosim" / "studies").glob("*.toml"))
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))
ROOMS = ("fmu_plants", "ddpc_cosim", "controllers", "reports", "tests", "docs", "benchmarks")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OF_THE_BENCHMARK = 'extends = "benchmark"'


def blocks(language: str) -> list[object]:
    return [
        pytest.param(
            code, id=f"{page.name}-{number}", marks=[pytest.mark.slow] if OF_THE_BENCHMARK in code else []
        )
        for page in PAGES
        for number, (kind, code) in enumerate(BLOCK.findall(page.read_text(encoding="utf-8")))
        if kind == language
    ]


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and the site make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.fixture
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder that holds the files beside the pages, and nothing else."""
    monkeypatch.chdir(tmp_path)
    for path in (ROOT / "docs" / "examples").glob("*.csv"):
        shutil.copy(path, tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", PAGES[1:], ids=lambda page: page.name)
def test_a_page_says_in_its_first_line_what_it_is_for(page: Path) -> None:
    title, blank, purpose, after = page.read_text(encoding="utf-8").splitlines()[:4]
    assert title.startswith("# ")
    assert blank == after == ""
    assert purpose.endswith(".")
    assert len(purpose) <= 120


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_headings_as_on_github(page: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#:\s]*)(#[^)]+)?\)", page.read_text(encoding="utf-8")):
        path = page.parent / target if target else page
        assert path.exists(), target
        assert not anchor or anchor.removeprefix("#") in anchors(path), anchor


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_the_gallery_has_every_built_in_study(study: Path) -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert f"## {tomllib.loads(study.read_text(encoding='utf-8'))['title']}\n" in page
    assert f"(pictures/reports/{study.stem}.png)" in page


def test_the_readme_leads_to_every_page_that_is_written_by_hand() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    pages = {
        path.relative_to(ROOT).as_posix() for path in PAGES[1:] if path.parent.name in {"docs", "extend"}
    }
    of_the_site = {"docs/index.md", "docs/architecture.md"}  # the latter is CONTRIBUTING.md
    assert pages - of_the_site <= set(re.findall(r"\]\(([^)#]+)", text))


@pytest.mark.parametrize("package", API, ids=lambda package: package.__name__)
def test_the_reference_has_every_public_name(package: ModuleType) -> None:
    page = (ROOT / "docs" / "api" / f"{package.__name__}.md").read_text(encoding="utf-8")
    named = re.findall(r"^   (\w+)$|`(\w+)`", page, re.MULTILINE)
    assert {first or second for first, second in named} >= set(package.__all__)


@pytest.mark.parametrize("code", blocks("python"))
def test_python_blocks_run(code: str, empty_folder: Path) -> None:
    assert CliRunner().invoke(main, ["export", "pendulum"]).exit_code == 0
    exec(compile(code, "documentation", "exec"), {})


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(path: Path, empty_folder: Path) -> None:
    runpy.run_path(str(path))


@pytest.mark.parametrize("text", blocks("toml"))
def test_studies_run(text: str, empty_folder: Path) -> None:
    study = empty_folder / "study.toml"
    study.write_text(text, encoding="utf-8")
    for name in re.findall(r'^fmu = "(\w+)\.fmu"', text, re.MULTILINE):
        assert CliRunner().invoke(main, ["export", name.replace("_", "-")]).exit_code == 0
    assert read_study(str(study)).problems
    only = ["--only", "mine"] if OF_THE_BENCHMARK in text else []  # not all of its 840 cases
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


def test_extras_are_installed_from_a_checkout_and_are_those_that_there_are() -> None:
    """The project is on no index: ``pip install ddpc-cosim[nmpc]`` would find nothing, or something else."""
    written = [*PAGES, *(path for room in ROOMS[:4] for path in (ROOT / room).rglob("*.py"))]
    texts = {path: path.read_text(encoding="utf-8") for path in written}
    assert [path for path, text in texts.items() if "ddpc-cosim[" in text] == []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = re.compile(r"""pip install ["']\.\[(\w+)\]|uv sync --extra (\w+)|how_to_install\(["'](\w+)""")
    extras = {name for text in texts.values() for names in named.findall(text) for name in names if name}
    assert extras <= project["optional-dependencies"].keys()
    assert {"nmpc", "tune", "parquet", "cluster", "zig"} <= extras


def test_the_readme_begins_with_the_two_commands() -> None:
    shell = blocks("sh")
    first = shell[0].values[0]  # type: ignore[attr-defined]
    commands = [shlex.split(line, comments=True) for line in first.splitlines()]
    assert commands == [
        ["pip", "install", "uv", "&&", "uv", "run", "ddpc-cosim", "run", "paper"],
        ["uv", "run", "pytest"],
    ]
