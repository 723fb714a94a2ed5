"""Libraries that the FMU's library needs, on Linux, whose loader looks for them in the system alone."""

import hashlib
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from click.testing import CliRunner
from fmus.builder import HERE, LAG, describe, platform_folder, write_fmu

from ddpc_cosim import Outcome, Study, simulate
from ddpc_cosim.cli.main import main
from ddpc_cosim.errors import ConfigError, FMUImportError
from ddpc_cosim.fmu.library import kept_loaded
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.inspection import inspect_fmu
from ddpc_cosim.study.plants import PlantSpec
from fmu_plants.export.binaries import needed_libraries
from fmu_plants.export.compiler import find_compiler

from .test_tolerant_reading import value_after_a_second

pytestmark = pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")  # what is told, tests look at

FIRST, SECOND = "libfirst_companion.so", "libsecond_companion.so"


class Chain(NamedTuple):
    """An FMU's library that needs a second one, which needs a third; none says where the others are."""

    main: bytes
    first: bytes
    second: bytes


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    folder = tmp_path_factory.mktemp("chain")
    (folder / "second.c").write_text("int second(void) { return 2; }", encoding="utf-8")
    (folder / "first.c").write_text(
        "int second(void); int first(void) { return 1 + second(); }", encoding="utf-8"
    )
    (folder / "main.c").write_text(
        "int first(void); int needs_others(void) { return first(); }", encoding="utf-8"
    )
    models = [str(HERE / name) for name in ("models.c", "front2.c")]
    for output, inputs in (
        (SECOND, ["second.c"]),
        (FIRST, ["first.c", SECOND]),
        ("main.so", ["main.c", *models, FIRST]),
    ):
        own_name = ["-Wl,-Bsymbolic", "-Wl,-soname," + output, "-Wl,--allow-shlib-undefined"]
        find_compiler().run(["-shared", "-fPIC", *own_name, "-o", output, *inputs, "-lm"], folder)
    return Chain(*((folder / name).read_bytes() for name in ("main.so", FIRST, SECOND)))


def lag_fmu(path: Path, library: bytes, **others: bytes) -> Path:
    write_fmu(path, describe("2.0", "lag", LAG), library)
    with zipfile.ZipFile(path, "a") as archive:
        for name, content in others.items():
            archive.writestr(name, content)
    return path


@pytest.mark.parametrize("place", [f"binaries/{platform_folder('2.0')}", "resources", "resources/lib/deep"])
def test_those_that_the_fmu_brings_along_are_found(tmp_path: Path, chain: Chain, place: str) -> None:
    others = {f"{place}/{FIRST}": chain.first, f"{place}/{SECOND}": chain.second}
    path = lag_fmu(tmp_path / "lag.fmu", chain.main, **others)
    assert inspect_fmu(path).can_run
    assert value_after_a_second(path) == pytest.approx(0.6321206, abs=1e-5)


def test_they_are_unloaded_with_the_fmu(tmp_path: Path, chain: Chain) -> None:
    """Another FMU may bring others of the same names."""
    place = f"binaries/{platform_folder('2.0')}"
    others = {f"{place}/{FIRST}": chain.first, f"{place}/{SECOND}": chain.second}
    value_after_a_second(lag_fmu(tmp_path / "lag.fmu", chain.main, **others))
    mapped = Path("/proc/self/maps").read_text(encoding="utf-8")
    assert FIRST not in mapped
    assert SECOND not in mapped


def test_a_library_that_is_kept_loaded_is_unloaded_with_its_last_user(pendulum_fmu: Path) -> None:
    def is_loaded() -> bool:
        return str(plant.library) in Path("/proc/self/maps").read_text(encoding="utf-8")

    with FMUPlant(pendulum_fmu) as plant:
        with kept_loaded(plant.library):
            for mass in (1.0, 2.0):
                plant.reset({"mass": mass})
            with FMUPlant(pendulum_fmu) as another:  # unpacked into a folder of its own
                another.reset()
            assert is_loaded()
        assert plant.step(np.array([1.0]), 0.1).shape == (2,)
    assert not is_loaded()
    with FMUPlant(pendulum_fmu) as plant, kept_loaded(plant.library):
        plant.reset()
        plant.close()
        assert is_loaded()
    assert not is_loaded()


def test_one_that_is_nowhere_is_named(tmp_path: Path, chain: Chain) -> None:
    session = FMUPlant(lag_fmu(tmp_path / "lag.fmu", chain.main))
    with pytest.raises(FMUImportError, match=f"its library needs {FIRST}, which is neither in the FMU nor"):
        session.reset()
    session.close()


def test_so_is_one_that_a_companion_needs(tmp_path: Path, chain: Chain) -> None:
    session = FMUPlant(lag_fmu(tmp_path / "lag.fmu", chain.main, **{f"resources/{FIRST}": chain.first}))
    with pytest.raises(FMUImportError, match=f"its library needs {SECOND}"):
        session.reset()
    session.close()


@pytest.fixture
def libraries(tmp_path: Path, chain: Chain) -> Path:
    folder = tmp_path / "libraries"
    folder.mkdir()
    (folder / FIRST).write_bytes(chain.first)
    (folder / SECOND).write_bytes(chain.second)
    (folder / "libunneeded.so").write_bytes(chain.second)
    return folder


def value_with(path: Path, *library_path: Path, isolated: bool = False) -> float:
    how = {"inputs": ["u"], "outputs": ["x"], "library_path": library_path, "isolated": isolated}
    with FMUPlant(path, **how) as plant:
        plant.reset()
        return float(plant.step(np.array([1.0]), 1.0)[0])


def test_folders_and_files_of_a_study_are_looked_into(tmp_path: Path, chain: Chain, libraries: Path) -> None:
    path = lag_fmu(tmp_path / "lag.fmu", chain.main)
    for given in (
        [libraries],
        [libraries / SECOND, libraries / FIRST],
        [libraries / FIRST, libraries / SECOND],
    ):
        assert inspect_fmu(path, library_path=given).can_run
        assert value_with(path, *given) == pytest.approx(0.6321206, abs=1e-5)
    assert value_with(path, libraries, isolated=True) == pytest.approx(0.6321206, abs=1e-5)
    (libraries / SECOND).unlink()
    with pytest.raises(FMUImportError, match=f"its library needs {SECOND}"):
        value_with(path, libraries)


def test_what_is_loaded_of_them_decides_a_cases_id(tmp_path: Path, chain: Chain, libraries: Path) -> None:
    path = lag_fmu(tmp_path / "lag.fmu", chain.main)
    spec = PlantSpec("", str(path), library_path=(str(libraries),))
    built, hashed = spec.built(), hashlib.sha256(path.read_bytes()).hexdigest()
    assert built.files == (str(path), str(libraries / FIRST), str(libraries / SECOND))
    hashes = [f"{n} {hashlib.sha256((libraries / n).read_bytes()).hexdigest()}" for n in (FIRST, SECOND)]
    assert built.content == f"{hashed} {' '.join(hashes)}"
    (libraries / "libunneeded.so").write_bytes(b"")
    elsewhere = libraries.rename(tmp_path / "elsewhere")
    assert replace(spec, library_path=(str(elsewhere),)).built().content == built.content
    with (elsewhere / SECOND).open("ab") as file:
        file.write(b"\0")
    assert replace(spec, library_path=(str(elsewhere),)).built().content != built.content
    assert PlantSpec("", str(path)).built().content == hashed


def test_one_without_a_name_that_is_needed_serves_too(tmp_path: Path, libraries: Path) -> None:
    """Some tools forget to link what is called; without a library that has it, the FMU cannot be loaded."""
    (tmp_path / "main.c").write_text(
        "int second(void); int call(void) { return second(); }", encoding="utf-8"
    )
    models = [str(HERE / name) for name in ("models.c", "front2.c")]
    flags = ["-shared", "-fPIC", "-Wl,-Bsymbolic"]
    find_compiler().run([*flags, "-o", "main.so", "main.c", *models, "-lm"], tmp_path)
    path = lag_fmu(tmp_path / "lag.fmu", (tmp_path / "main.so").read_bytes())
    assert value_with(path, libraries / SECOND) == pytest.approx(0.6321206, abs=1e-5)
    with pytest.raises(FMUImportError, match="undefined symbol: second"):
        value_with(path, libraries)


def test_places_that_are_not_there_are_all_told(tmp_path: Path, chain: Chain) -> None:
    path = lag_fmu(tmp_path / "lag.fmu", chain.main)
    with pytest.raises(ConfigError) as error:
        FMUPlant(path, library_path=[tmp_path / "a", tmp_path / "b"])
    assert list(error.value.faults) == [
        f"library_path: {tmp_path / name}: no such library or folder" for name in "ab"
    ]


STUDY = """
[plant]
fmu = "lag.fmu"
inputs = ["u"]
outputs = ["x"]
library_path = ["libraries"]
[loop]
sampling_time = 0.1
duration = 0.5
[reference.x]
kind = "constant"
value = 0.5
[controllers.pid]
type = "pid"
settings = { proportional = 1.0, integral = 1.0 }
"""


def test_a_study_names_them_beside_itself(tmp_path: Path, chain: Chain, libraries: Path) -> None:
    lag_fmu(tmp_path / "lag.fmu", chain.main)
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    results = Study.read(tmp_path / "study.toml").run(tmp_path / "results", jobs=1, progress=False)
    (case,) = (case for case in results.cases if case.controller == "pid")
    trace = case.trace()
    assert trace.outcome is Outcome.COMPLETED
    assert f"{FIRST}: {hashlib.sha256(chain.first).hexdigest()}" in trace.provenance["fmu_libraries"]
    frame = simulate(tmp_path / "lag.fmu", stop=1.0, step=0.5, library_path=[libraries])
    assert len(frame) == 3


def test_init_tries_the_fmu_with_them_and_names_them_in_the_study(
    tmp_path: Path, chain: Chain, libraries: Path
) -> None:
    path, study = lag_fmu(tmp_path / "lag.fmu", chain.main), tmp_path / "studies" / "study.toml"
    arguments = ["init", str(path), "--library-path", str(libraries), "--out", str(study)]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.stderr
    plant = tomllib.loads(study.read_text(encoding="utf-8"))["plant"]
    assert plant["library_path"] == ["../libraries"]
    both = CliRunner().invoke(main, ["init", str(path), *arguments[1:], "--force"])
    assert both.exit_code == 2
    assert "library_path is of one FMU, and this is a system of several" in both.stderr


def test_an_inspection_tells_before_it_is_loaded(tmp_path: Path, chain: Chain) -> None:
    inspection = inspect_fmu(lag_fmu(tmp_path / "lag.fmu", chain.main))
    (defect,) = [defect for defect in inspection.defects if defect.kind.name == "missing-library"]
    assert defect.places == (FIRST,)
    assert not inspection.can_run


def test_an_inspection_loads_no_file_that_the_fmu_points_at(tmp_path: Path) -> None:
    """A needed library can be a path, of a file whose code runs as soon as it is loaded."""
    trap, sprung = tmp_path / "trap.so", tmp_path / "sprung"
    (tmp_path / "trap.c").write_text(
        "#include <stdio.h>\n"
        f'__attribute__((constructor)) static void spring(void) {{ fclose(fopen("{sprung}", "w")); }}\n'
        "int trap(void) { return 0; }\n",
        encoding="utf-8",
    )
    (tmp_path / "main.c").write_text(
        "int trap(void); int needs_it(void) { return trap(); }", encoding="utf-8"
    )
    compiler = find_compiler()
    compiler.run(["-shared", "-fPIC", f"-Wl,-soname,{trap}", "-o", str(trap), "trap.c"], tmp_path)
    models = [str(HERE / name) for name in ("models.c", "front2.c")]
    own_name = ["-Wl,-Bsymbolic", "-Wl,-soname,main.so"]
    inputs = ["main.c", *models, str(trap), "-lm"]
    compiler.run(["-shared", "-fPIC", *own_name, "-o", "main.so", *inputs], tmp_path)
    library = (tmp_path / "main.so").read_bytes()
    assert str(trap) in needed_libraries(library).libraries
    inspect_fmu(lag_fmu(tmp_path / "lag.fmu", library))
    assert not sprung.exists()


def test_needed_libraries_are_those_that_the_linker_has_written(chain: Chain) -> None:
    assert FIRST in needed_libraries(chain.main).libraries
    assert needed_libraries(chain.main).folders == []
    assert needed_libraries(b"MZ" + chain.main) == needed_libraries(b"") == ([], [])


def test_the_one_with_functions_of_fmi_is_the_fmus(tmp_path: Path, chain: Chain) -> None:
    """Where none of several libraries is named after modelIdentifier."""
    folder = f"binaries/{platform_folder('2.0')}"
    path = write_fmu(
        tmp_path / "lag.fmu", describe("2.0", "lag", LAG), chain.main, place=f"{folder}/renamed.so"
    )
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(f"{folder}/{FIRST}", chain.first)
        archive.writestr(f"{folder}/{SECOND}", chain.second)
    assert value_after_a_second(path) == pytest.approx(0.6321206, abs=1e-5)
    assert "unnamed-library" in [defect.kind.name for defect in inspect_fmu(path).defects]
