"""The package of docs/extend/write-a-controller-plug-in.md, installed into an environment of its own."""

import os
import re
import subprocess
import sysconfig
import venv
from pathlib import Path

import pytest

# What its fixtures run or build is run and built in one process.
pytestmark = pytest.mark.xdist_group("plug-in")

PAGE = Path(__file__).parents[1] / "docs" / "extend" / "write-a-controller-plug-in.md"
FILE = re.compile(r"^```\w+ (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = "from ddpc_cosim.cli.main import main; main()"


class Scratch:
    """A virtual environment that sees this one's packages, so that nothing need be downloaded."""

    def __init__(self, folder: Path) -> None:
        builder = venv.EnvBuilder(with_pip=True)
        builder.create(folder)
        self.python = builder.ensure_directories(folder).env_exe
        site_packages = sysconfig.get_path(
            "purelib", "venv", vars={"base": str(folder), "platbase": str(folder)}
        )
        # Not a plain path: the .pth files there, of packages installed to be edited, must be read too.
        seen = f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n"
        (Path(site_packages) / "parent.pth").write_text(seen, encoding="utf-8")

    def run(self, *arguments: str, folder: Path) -> str:
        done = subprocess.run(
            [self.python, *arguments],
            cwd=folder,
            env={**os.environ, "COLUMNS": "200"},
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=300,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def command(self, *arguments: str, folder: Path) -> str:
        return self.run("-c", COMMAND, *arguments, folder=folder)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the files of the page."""
    folder = tmp_path_factory.mktemp("ddpc-integral")
    for name, content in FILE.findall(PAGE.read_text(encoding="utf-8")):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(content, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def scratch(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Scratch:
    """Install the package."""
    environment = Scratch(tmp_path_factory.mktemp("scratch"))
    options = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check"]
    environment.run("-m", "pip", "install", *options, ".", folder=package)
    return environment


def test_it_is_short(package: Path) -> None:
    lines = [
        line
        for path in ("pyproject.toml", "ddpc_integral/__init__.py", "tests/test_integral.py")
        for line in (package / path).read_text(encoding="utf-8").splitlines()
        if line.strip()
    ]
    assert len(lines) < 50


def test_its_own_tests_pass(package: Path, scratch: Scratch) -> None:
    assert "18 passed" in scratch.run("-m", "pytest", "-q", "-p", "no:cacheprovider", "tests", folder=package)


def test_it_is_listed_checked_and_run_by_name(package: Path, scratch: Scratch, tmp_path: Path) -> None:
    listed = scratch.command("list", "controllers", folder=tmp_path)
    assert re.search(r"\bintegral\b.*ddpc_integral:Integral", listed)
    assert "failed" not in scratch.command("check", "integral", folder=tmp_path)
    scratch.command("run", "integral-tanks", "--jobs", "1", folder=tmp_path)
    assert (tmp_path / "runs" / "integral-tanks" / "report.html").is_file()
    rows = (tmp_path / "runs" / "integral-tanks" / "metrics.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 3
    assert all(",completed," in row for row in rows[1:])
