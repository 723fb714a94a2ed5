"""What all tests share: a cache folder, the pendulum as an FMU, the command line as a process."""

import contextlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import pytest

from ddpc_cosim.plugins import code_version, source_hash
from fmu_plants import build_fmu
from fmu_plants.pendulum import MODEL

# How long an example takes says more about the machine than about the code.
hypothesis.settings.register_profile("suite", deadline=None, derandomize=True)
hypothesis.settings.load_profile("suite")


def pytest_configure(config: pytest.Config) -> None:
    # The cores belong to the workers of the run, started after this, not to threads of BLAS.
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    if config.getoption("numprocesses", None) and "PYTHONPYCACHEPREFIX" not in os.environ:
        _compile_once(config)
    config.addinivalue_line("markers", "slow: takes half a minute; only run by `-m slow`")


COMPILE = """
import ast, contextlib, importlib, pkgutil

def imported(module):  # libraries that are heavy are imported within functions
    source = importlib.util.find_spec(module).loader.get_source(module)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module

for package in ("fmu_plants", "ddpc_cosim", "ddpc_controllers", "ddpc_reports"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not module.name.endswith("__main__"):
            for name in (module.name, *imported(module.name)):
                with contextlib.suppress(Exception):  # tests say what is wrong with it
                    importlib.import_module(name)
"""


def _compile_once(config: pytest.Config) -> None:
    """Where no bytecode is written, keep that of the packages: hundreds of processes would compile them.

    The processes of the tests read it, and write none: a module that a test writes anew is never an old one.
    They look for that of libraries in the same place alone: what has been compiled of them is linked there.
    """
    writing = dict(os.environ)
    if not writing.pop("PYTHONDONTWRITEBYTECODE", ""):
        return
    folder = tempfile.TemporaryDirectory(prefix="ddpc-cosim-bytecode-", ignore_cleanup_errors=True)
    config.add_cleanup(folder.cleanup)
    os.environ["PYTHONPYCACHEPREFIX"] = writing["PYTHONPYCACHEPREFIX"] = folder.name
    for kind in ("stdlib", "purelib"):
        library = Path(sysconfig.get_path(kind))
        for cache in library.rglob("__pycache__"):
            if {"test", "tests"} & {*cache.relative_to(library).parts}:  # many, and not imported
                continue
            place = Path(folder.name) / cache.parent.relative_to(cache.anchor)
            place.mkdir(parents=True, exist_ok=True)
            for compiled in cache.glob(f"*.{sys.implementation.cache_tag}.pyc"):
                with contextlib.suppress(OSError):  # not every system lets everyone link
                    (place / compiled.name).symlink_to(compiled)
    subprocess.run([sys.executable, "-c", COMPILE], env=writing, check=True)


@pytest.fixture(scope="session", autouse=True)
def own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Leave the user's cache folder alone; all workers of a run share one, so that each FMU is built once."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DDPC_COSIM_CACHE", str(folder / "cache"))
        yield


@pytest.fixture(autouse=True)
def no_modules_of_another_test(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Forget the modules that a test has written and imported: the next may write others of these names."""
    before, written = set(sys.modules), tmp_path_factory.getbasetemp()
    yield
    left = [name for name in sys.modules.keys() - before if _place(name).is_relative_to(written)]
    for name in left:
        del sys.modules[name]
    if left:
        code_version.cache_clear()
        source_hash.cache_clear()


def _place(module: str) -> Path:
    """Return where a module is, or the first folder of a package without a file of its own."""
    spec = getattr(sys.modules[module], "__spec__", None)
    folders = getattr(spec, "submodule_search_locations", None) or [""]
    return Path(getattr(sys.modules[module], "__file__", None) or next(iter(folders), ""))


@pytest.fixture(scope="session", autouse=True)
def no_lines_that_depend_on_the_load() -> Iterator[None]:
    """Leave out of what commands say in this process how long they have been at it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ddpc_cosim.cli.progress._SECONDS_BETWEEN_LINES", 3600.0)
        yield


@pytest.fixture(scope="session")
def pendulum_fmu(own_cache_folder: None) -> Path:
    return build_fmu(MODEL)


@pytest.fixture(scope="session")
def program() -> str:
    """The installed command."""
    installed = shutil.which("ddpc-cosim", path=str(Path(sys.executable).parent))
    assert installed, "ddpc-cosim is not installed beside this Python"
    return installed


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run_program(program: str, tmp_path: Path) -> Run:
    """Run the command in an empty folder, in which modules are found too."""

    def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
        return subprocess.run(
            [program, *arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "200", **environment},
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=300,
        )

    return run
