"""FMUs that are not quite as the standard wants them run, with a warning that names what is wrong."""

import shutil
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmus.builder import (
    HERE,
    IDENTIFIER,
    LAG,
    V,
    describe,
    model_fmu,
    model_library,
    platform_folder,
    write_fmu,
)

from ddpc_cosim.errors import ConfigError, FMUImportError, FMUStepError
from ddpc_cosim.fmu.archive import unpack
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.inspection import inspect_fmu
from fmu_plants.export.compiler import compile_library, find_compiler

pytestmark = pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")  # what is told, tests look at

SUFFIX = fmpy.sharedLibraryExtension
CO_SIMULATION = '<CoSimulation modelIdentifier="models" canHandleVariableCommunicationStepSize="true"/>'


def value_after_a_second(path: Path) -> float:
    """Run the lag with the input 1 from rest: 1 - exp(-1)."""
    session = FMUPlant(path, inputs=["u"], outputs=["x"])
    session.reset()
    y = session.step(np.array([1.0]), 1.0)
    session.close()
    return float(y[0])


def warnings_of(path: Path) -> str:
    session = FMUPlant(path, inputs=["u"], outputs=["x"])
    session.close()
    return "\n".join(session.warnings)


def lag_description(
    old: str = "", new: str = "", interfaces: str = CO_SIMULATION, version: str = "2.0"
) -> str:
    text = describe(version, "lag", LAG, interfaces=interfaces)
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('fmiVersion="2.0"', 'fmiVersion="2.0.4"', 'fmiVersion "2.0.4" was read as 2.0'),
        ('fmiVersion="2.0"', 'fmiVersion="2.0 "', 'fmiVersion "2.0 " was read as 2.0'),
        (
            '<Real start="0"/>',
            '<Real start="0" declaredType="Torque"/>',
            'declared types that are not defined: u: "Torque"',
        ),
        (' variability="tunable"', "", "rate: parameter, continuous; read as fixed"),
        ('causality="output"', 'causality="out"', 'causalities that the standard does not know: x: "out"'),
        ('<Unknown index="2"/>', '<Unknown index="99"/>', 'variables that do not exist: Outputs: "99"'),
        (
            '<Unknown index="2"/>',
            '<Unknown index="2" dependencies="1  77"/>',
            "variables that do not exist: Outputs 2: 77",
        ),
        (' derivative="2"', ' derivative="44"', 'der(x): "44"'),
        ("<ModelVariables>", "<!-- by hand --><ModelVariables><!-- all of them -->", ""),
        (
            'valueReference="9"',
            'valueReference="nine"',
            'not integers: name_length: "nine"',
        ),
        ('name="x" valueReference="1"', 'name="x" valueReference=" +1 "', ""),
        ('numberOfEventIndicators="0"', 'numberOfEventIndicators="many"', 'numberOfEventIndicators = "many"'),
        ("<fmiModelDescription ", '<fmiModelDescription xmlns="http://example.org/fmi" ', "namespaces"),
        ('<Real start="1" min="-10" max="10"/>', '<Real min="-10" max="10"/>', "without a start value: rate"),
    ],
)
def test_descriptions_that_can_be_understood(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = lag_description(old, new)
    path = write_fmu(tmp_path / "lag.fmu", text, model_library("2.0"))
    assert words in warnings_of(path)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))


def test_what_nothing_here_reads_may_be_wrong(tmp_path: Path) -> None:
    """FMPy's validator finds it, which ``inspect --strict`` asks."""
    definitions = (
        '<UnitDefinitions><Unit name="K"><BaseUnit K="one"/></Unit></UnitDefinitions><TypeDefinitions>'
        '<SimpleType name="Angle"><Real unit="rad" colour="red"/></SimpleType><SimpleType name="Empty"/>'
        "</TypeDefinitions><ModelVariables>"
    )
    text = lag_description("<ModelVariables>", definitions)
    path = write_fmu(tmp_path / "lag.fmu", text, model_library("2.0"))
    assert warnings_of(path) == ""
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))
    assert "invalid" not in [defect.kind.name for defect in inspect_fmu(path).defects]
    assert "invalid" in [defect.kind.name for defect in inspect_fmu(path, strict=True).defects]


def test_letters_of_another_encoding_than_the_file_claims(tmp_path: Path) -> None:
    text = lag_description('modelName="lag"', 'modelName="Größe"')
    path = write_fmu(tmp_path / "lag.fmu", "", model_library("2.0"))
    with zipfile.ZipFile(path) as archive:
        content = archive.read(archive.namelist()[1])
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text.encode("cp1252"))
        archive.writestr(f"binaries/{platform_folder('2.0')}/{IDENTIFIER}{SUFFIX}", content)
    session = FMUPlant(path, inputs=["u"], outputs=["x"])
    assert session.description.model_name == "Größe"
    # Warnings are stored with results: they are the same in every run, without any temporary folder.
    assert not any("ddpc-cosim-" in warning for warning in session.warnings)
    session.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<fmiModelDescription", "modelDescription.xml cannot be read"),
        ("<html><body/></html>", "modelDescription.xml cannot be read"),
        (
            '<fmiModelDescription fmiVersion="4.0"/>',
            'can run here: fmiVersion = "4.0"',
        ),
        (
            describe("2.0", "lag", LAG, interfaces=""),
            "neither Co-Simulation nor Model Exchange",
        ),
    ],
)
def test_descriptions_that_cannot_be_understood(tmp_path: Path, text: str, words: str) -> None:
    path = write_fmu(tmp_path / "lag.fmu", text, model_library("2.0"))
    with pytest.raises(FMUImportError) as caught:
        FMUPlant(path)
    assert words in str(caught.value)


def test_missing_functions_count_only_when_they_are_needed(tmp_path: Path) -> None:
    """The libraries here have no functions for states, derivatives, types, or debugging."""
    claims = CO_SIMULATION.replace("/>", ' canGetAndSetFMUstate="true"/>')
    path = write_fmu(tmp_path / "lag.fmu", lag_description(interfaces=claims), model_library("2.0"))
    session = FMUPlant(path, inputs=["u"], outputs=["x"])
    session.reset()
    session.step(np.array([1.0]), 0.1)
    with pytest.raises(FMUStepError, match=r"library has no function fmi2GetFMUstate"):
        session.save_state()
    session.close()


def test_an_fmu_that_cannot_save_its_state_says_so(tmp_path: Path) -> None:
    session = FMUPlant(model_fmu(tmp_path, "2.0", "lag"))
    session.reset()
    assert not session.can_save_state
    with pytest.raises(ConfigError, match="cannot save its state"):
        session.save_state()
    session.close()


@pytest.mark.parametrize("version", ["1.0", "2.0", "3.0"])
def test_the_only_library_under_another_name(tmp_path: Path, version: str) -> None:
    text = lag_description(version=version)
    place = f"binaries/{platform_folder(version)}/other name{SUFFIX}"
    path = write_fmu(tmp_path / "lag.fmu", text, model_library(version), place=place)
    assert f"the library is {place} instead of" in warnings_of(path)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0), abs=1e-5)


@pytest.mark.parametrize(("version", "folder"), [("2.0", fmpy.platform_tuple), ("3.0", fmpy.platform)])
def test_the_folder_name_of_the_other_fmi_version(tmp_path: Path, version: str, folder: str) -> None:
    place = f"binaries/{folder}/{IDENTIFIER}{SUFFIX}"
    path = write_fmu(
        tmp_path / "lag.fmu", lag_description(version=version), model_library(version), place=place
    )
    assert place in warnings_of(path)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))


def test_which_of_two_libraries_is_not_guessed(tmp_path: Path) -> None:
    text = lag_description(interfaces=CO_SIMULATION.replace("models", "lag"))
    library = f"binaries/{fmpy.platform}/one{SUFFIX}"
    path = write_fmu(tmp_path / "lag.fmu", text, model_library("2.0"), place=library)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(f"binaries/{fmpy.platform}/two{SUFFIX}", model_library("2.0"))
    with pytest.raises(FMUImportError, match="no binary for this platform"):
        FMUPlant(path)


def test_a_description_that_begins_with_blanks(tmp_path: Path) -> None:
    path = write_fmu(tmp_path / "lag.fmu", "\n  " + lag_description(), model_library("2.0"))
    assert "blanks before the XML declaration" in warnings_of(path)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))


def test_every_fmu_finds_the_folder_for_its_resources(tmp_path: Path) -> None:
    """Empty folders are unpacked too, and the one that FMUs are told of is there in any case."""
    path = write_fmu(tmp_path / "lag.fmu", lag_description(), model_library("2.0"), **{"extra/": ""})
    folder = tmp_path / "unpacked"
    folder.mkdir()
    unpack(path, folder)
    assert (folder / "extra").is_dir()
    assert (folder / "resources").is_dir()


def test_nominal_values_that_the_fmu_does_not_tell_count_as_one(tmp_path: Path) -> None:
    text = source("front2.c").replace("fmi2GetNominalsOfContinuousStates", "nothing")
    sources = {"models.c": source("models.c"), "models.h": source("models.h"), "front2.c": text}
    library = compile_library(find_compiler(), sources, ["fmi2SetTime"])
    model_exchange = '<ModelExchange modelIdentifier="models"/>'
    path = write_fmu(tmp_path / "lag.fmu", lag_description(interfaces=model_exchange), library)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0), abs=1e-5)


def test_an_fmu_that_refuses_without_a_word_is_asked_why(tmp_path: Path) -> None:
    """Some say what is wrong only when their log is on."""
    said = """
        typedef struct { void (*log)(void *, const char *, int, const char *, const char *, ...); } Callbacks;
        EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                                     const Callbacks *functions, int visible, int logging)
        {
            if (logging)
                functions->log(0, name, 3, "error", "no licence for %s", guid);
            return 0;
        }
        EXPORT void *unused("""
    text = source("front2.c").replace("EXPORT void *fmi2Instantiate(", said, 1)
    sources = {"models.c": source("models.c"), "models.h": source("models.h"), "front2.c": text}
    library = compile_library(find_compiler(), sources, ["fmi2Instantiate"])
    session = FMUPlant(write_fmu(tmp_path / "lag.fmu", lag_description(), library))
    with pytest.raises(FMUImportError, match=r"cannot be instantiated: .*\[error\] no licence for lag"):
        session.reset()
    session.close()


def source(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


# FMI's headers put the model's name before every function unless a library is built.
PREFIXED_2 = '#define FMI2_FUNCTION_PREFIX lag_\n#include "fmi2Functions.h"\n'
PREFIXED_3 = '#define FMI3_FUNCTION_PREFIX lag_\n#include "fmi3Functions.h"\n'
LISTED = CO_SIMULATION.replace(
    "/>", '><SourceFiles><File name="models.c"/><File name="front2.c"/></SourceFiles></CoSimulation>'
)
BUILD_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="models">
<SourceFileSet language="C99"><SourceFile name="code/models.c"/><SourceFile name="code/front3.c"/>
<PreprocessorDefinition name="NOTHING" value="1"/><IncludeDirectory name="headers"/></SourceFileSet>
</BuildConfiguration></fmiBuildDescription>"""


def test_c_sources_are_compiled_fmi_2(tmp_path: Path, own_cache: Path) -> None:
    names = ("models.c", "front2.c", "models.h")
    files = {f"sources/{name}": source(name) for name in names}
    path = write_fmu(tmp_path / "lag.fmu", lag_description(interfaces=LISTED), None, **files)
    assert "compiled from the FMU's C sources" in warnings_of(path)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))
    assert len(list(own_cache.rglob(f"{IDENTIFIER}{SUFFIX}"))) == 1


def test_headers_among_the_sources_are_included_and_not_compiled(tmp_path: Path, own_cache: Path) -> None:
    """As some tools list them; their folders are searched for headers then."""
    listed = LISTED.replace("</SourceFiles>", '<File name="lib/models.h"/></SourceFiles>')
    files = {f"sources/{name}": source(name) for name in ("models.c", "front2.c")}
    files["sources/lib/models.h"] = source("models.h")
    path = write_fmu(tmp_path / "lag.fmu", lag_description(interfaces=listed), None, **files)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))


def test_c_sources_are_compiled_fmi_3(tmp_path: Path, own_cache: Path) -> None:
    files = {
        "sources/buildDescription.xml": BUILD_3,
        "sources/code/models.c": source("models.c"),
        "sources/code/front3.c": source("front3.c"),
        "sources/headers/models.h": source("models.h"),
    }
    text = describe("3.0", "lag", [V("time", 15, causality="independent"), *LAG], interfaces=CO_SIMULATION)
    path = write_fmu(tmp_path / "lag.fmu", text, None, **files)
    assert warnings_of(path) == "no binary for this platform: compiled from the FMU's C sources"
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_prefixes_for_static_linking_do_no_harm(tmp_path: Path, own_cache: Path, version: str) -> None:
    major = version[0]
    front = source(f"front{major}.c")
    prefixed = front.replace(f"fmi{major}", f"lag_fmi{major}").replace("lag_lag_", "lag_")
    files = {
        "sources/models.c": source("models.c"),
        "sources/models.h": source("models.h"),
        "sources/f.c": prefixed,
    }
    text = lag_description(version=version, interfaces=CO_SIMULATION.replace("models", "lag"))
    path = write_fmu(tmp_path / "lag.fmu", text, None, **files)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))


def test_the_headers_of_fmi_are_there_and_their_prefix_is_off(tmp_path: Path, own_cache: Path) -> None:
    files = {
        "sources/all.c": PREFIXED_2 + "fmi2Component fmi2Instantiate(fmi2String a, fmi2Type b, fmi2String c, "
        "fmi2String d, const fmi2CallbackFunctions *e, fmi2Boolean f, fmi2Boolean g) { return 0; }"
    }
    path = write_fmu(tmp_path / "lag.fmu", lag_description(), None, **files)
    session = FMUPlant(path)
    with pytest.raises(FMUImportError, match=r"cannot be instantiated: Failed to instantiate"):
        session.reset()
    session.close()


def test_sources_that_others_include_are_not_compiled_by_themselves(tmp_path: Path, own_cache: Path) -> None:
    files = {"sources/models.h": source("models.h"), "sources/template.c": source("front2.c")}
    files["sources/models.c"] = source("models.c") + '\n#include "template.c"\n'
    files["sources/template.c"] += "\nint twice(void) { return 1; }\n"
    path = write_fmu(tmp_path / "lag.fmu", lag_description(), None, **files)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))


def test_sources_that_do_not_compile_are_reported_with_the_compilers_words(
    tmp_path: Path, own_cache: Path
) -> None:
    path = write_fmu(
        tmp_path / "lag.fmu", lag_description(), None, **{"sources/all.c": "#error no such thing"}
    )
    with pytest.raises(FMUImportError, match=r"(?s)lag.fmu: no binary .* cannot compile .*no such thing"):
        FMUPlant(path)


def test_sources_outside_of_the_fmu_are_refused(tmp_path: Path, own_cache: Path) -> None:
    listed = LISTED.replace("models.c", "../../models.c")
    path = write_fmu(
        tmp_path / "lag.fmu", lag_description(interfaces=listed), None, **{"sources/front2.c": ""}
    )
    with pytest.raises(FMUImportError, match="is outside the FMU"):
        FMUPlant(path)


def test_a_library_that_cannot_be_loaded_leaves_the_working_directory(tmp_path: Path) -> None:
    here = Path.cwd()
    path = write_fmu(tmp_path / "lag.fmu", lag_description(), b"no library")
    session = FMUPlant(path)
    with pytest.raises(FMUImportError, match=r"lag\.fmu: cannot be instantiated"):
        session.reset()
    session.close()
    assert Path.cwd() == here


def test_paths_with_spaces_and_letters_of_any_alphabet(tmp_path: Path) -> None:
    folder = tmp_path / "My FMUs ø 模型"
    folder.mkdir()
    path = folder / "lag größer.fmu"
    shutil.copy(model_fmu(tmp_path, "2.0", "lag"), path)
    assert value_after_a_second(path) == pytest.approx(1 - np.exp(-1.0))
