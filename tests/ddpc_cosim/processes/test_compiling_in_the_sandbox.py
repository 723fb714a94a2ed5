"""C sources of an FMU in the sandbox: the compiler includes nothing that the FMU may not read."""

from pathlib import Path

import fmpy
import fmus.builder
import numpy as np
import pytest
from click.testing import CliRunner, Result
from fmus.builder import CO_SIMULATION, GAINED, LAG, Fault, describe, model_library, write_archive, write_fmu
from fmus.fortran import OLD, USUAL, link
from studies import study_text, write

from ddpc_cosim import FMUImportError, FMUPlant, load_results
from ddpc_cosim.cli.main import main

SECRET = "the key that opens everything"
SOURCES = ("models.c", "front2.c", "models.h")
INTERFACE = (
    '<CoSimulation modelIdentifier="models" canHandleVariableCommunicationStepSize="true"><SourceFiles>'
    "{}</SourceFiles></CoSimulation>"
)
COMPILED = "ignore:.*compiled from the FMU's C sources"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    write(tmp_path, study_text(plant={"fmu": "lag.fmu"}, reference={"x": 1.0}, controllers=["pid"]))
    return tmp_path / "cache"


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "home/.ssh/id_ed25519"
    path.parent.mkdir(parents=True)
    path.write_text(SECRET, encoding="utf-8")
    return path


def fmu_of_sources(folder: Path, more: str = "") -> Path:
    """Write an FMU of C sources, of which one has these lines."""
    files = {
        f"sources/{name}": (Path(fmus.builder.__file__).parent / name).read_text(encoding="utf-8")
        for name in SOURCES
    }
    files["sources/more.c"] = more
    listed = "".join(f'<File name="{name}.c"/>' for name in ("models", "front2", "more"))
    description = describe("2.0", "lag", LAG, interfaces=INTERFACE.format(listed))
    return write_fmu(folder / "lag.fmu", description, None, **files)


def including(path: Path) -> str:
    """Return C code that has the bytes of a file in the library."""
    return f'__asm__(".section .rodata\\nstolen: .incbin \\"{path}\\"\\n.previous");\n'


def holds_secret(folder: Path) -> bool:
    return any(SECRET.encode() in path.read_bytes() for path in folder.rglob("*") if path.is_file())


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


@pytest.mark.filterwarnings("ignore:.*a stand-in was compiled")
def test_a_stand_in_for_an_old_library_is_compiled_before(tmp_path: Path, cache: Path) -> None:
    """In a session, and in the cases of a study, whose processes can write none into the cache."""
    path = write_fmu(tmp_path / "lag.fmu", describe("2.0", "lag", LAG), link(tmp_path, USUAL))
    with FMUPlant(path, inputs=["u"], outputs=["x"], isolated=True, sandbox=True) as plant:
        plant.reset()
        assert plant.step(np.array([1.0]), 1.0)[0] == pytest.approx(1 - np.exp(-1.0), abs=1e-5)
    for file in cache.rglob(f"{OLD}*"):
        file.unlink()
    result = run("run", "study.toml", "--out", "results", "--sandbox", "--no-report")
    assert result.exit_code == 0, result.output
    assert all(case.outcome == "completed" for case in load_results(Path("results")).cases)


@pytest.mark.filterwarnings(COMPILED)
def test_an_inspection_compiles_them_in_it(tmp_path: Path, cache: Path, secret: Path) -> None:
    result = run("inspect", str(fmu_of_sources(tmp_path, including(secret))))
    assert (result.exit_code, "uncompiled" in result.output) == (1, True)
    assert not holds_secret(cache)


@pytest.mark.filterwarnings(COMPILED)
def test_what_sources_may_include(tmp_path: Path, cache: Path, secret: Path) -> None:
    """Without a sandbox any file that the user may read; nor is a library that has it taken in a sandbox."""
    path = fmu_of_sources(tmp_path, including(secret))
    with FMUPlant(path):
        assert holds_secret(cache)
    with pytest.raises(FMUImportError, match="cannot compile its C sources"):
        FMUPlant(path, isolated=True, sandbox=True)


@pytest.mark.parametrize(
    ("command", "how"),
    [
        ("run", "the assembler"),
        ("check", "the preprocessor"),
        ("simulate", "the assembler"),
        ("init", "the preprocessor"),
    ],
)
def test_no_command_compiles_outside_of_it(
    command: str, how: str, tmp_path: Path, cache: Path, secret: Path
) -> None:
    """Neither the library nor the words of the compiler have what is in the file."""
    fmu_of_sources(tmp_path, including(secret) if how == "the assembler" else f'#include "{secret}"\n')
    subject = "study.toml" if command == "run" else "lag.fmu"
    result = run(command, subject, "--sandbox", *(["--out", "out"] if command in ("run", "init") else []))
    assert result.exit_code in (1, 2)
    assert "cannot compile its C sources" in result.output
    assert SECRET not in result.output
    secret.unlink()
    assert not holds_secret(tmp_path)


@pytest.mark.filterwarnings(COMPILED)
def test_what_is_compiled_in_it_runs_in_it(tmp_path: Path, cache: Path) -> None:
    """Once, whoever asks; signals are the same bit for bit."""
    path = fmu_of_sources(tmp_path)
    for name, more in (("free", ()), ("held", ("--sandbox",))):
        result = run("run", "study.toml", "--jobs", "1", "--no-report", "--out", name, *more)
        assert result.exit_code == 0, result.output
        assert result.output.count("compiling the C sources of lag.fmu") == 1
    free, held = (load_results(tmp_path / name).cases[0] for name in ("free", "held"))
    assert (free.sandbox, held.sandbox[:13]) == ("", "no_new_privs;")
    np.testing.assert_array_equal(free.trace().y, held.trace().y)
    assert len([*cache.glob("libraries/*/*.so")]) == 2
    with FMUPlant(path, isolated=True, sandbox=True) as plant:
        plant.reset()
    assert len([*cache.glob("libraries/*/*.so")]) == 2


@pytest.mark.parametrize(
    ("limit", "value", "words"),
    [
        ("ddpc_cosim.fmu.build._LONGEST_SECONDS", 1e-3, "did not end within 0.001 s"),
        ("ddpc_cosim.processes.worker.default_memory", lambda: 300_000_000, "more than 0.3 GB of memory"),
        ("ddpc_cosim.fmu.build._LARGEST_FILE", 1 << 20, "cannot compile its C sources"),
    ],
)
def test_what_compiling_may_take(
    limit: str, value: object, words: str, tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line can have the compiler read without an end, or write any number of bytes."""
    more = '#include "/dev/zero"\n' if "file" not in limit.lower() else '__asm__(".skip 1 << 34");\n'
    monkeypatch.setattr(limit, value)
    with pytest.raises(FMUImportError, match=words):
        FMUPlant(fmu_of_sources(tmp_path, more), isolated=True, sandbox=True)
    assert not [*cache.rglob("*.so")]


def test_the_cache_is_not_read(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other FMUs' libraries and pictures lie there; a case gets the library that it needs."""
    other = cache / "libraries/0123/other.so"
    other.parent.mkdir(parents=True)
    other.write_text(SECRET, encoding="utf-8")
    monkeypatch.setenv("FAULT_FILE", str(other))
    description = describe("2.0", f"integrator:{Fault.READ_A_FILE:d}", GAINED, interfaces=CO_SIMULATION)
    library = f"binaries/{fmpy.platform}/models.so"
    files = {library: model_library("2.0", complete=True), "modelDescription.xml": description.encode()}
    write_archive(tmp_path / "lag.fmu", files)
    plant = {"fmu": "lag.fmu", "outputs": ["y"]}
    write(tmp_path, study_text(plant=plant, reference={"y": 1.0}, controllers=["pid"]))
    result = run("run", "study.toml", "--no-report", "--out", "out", "--sandbox")
    assert result.exit_code == 1, result.output
    (case,) = load_results(tmp_path / "out").cases
    assert "the file cannot be opened" in case.reason
