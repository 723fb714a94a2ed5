"""Each defect of an FMU is found, called by its name, and located; sound FMUs are in test_inspection.py."""

import warnings
import zipfile
from pathlib import Path

import pytest

from ddpc_cosim import CosimError, CosimWarning, FMUImportError, FMUPlant
from ddpc_cosim.fmu.description.defects import Severity
from ddpc_cosim.inspection import inspect_fmu

FMI2, FMI3 = "2.0", "3.0"

TORQUE_2 = '<Real unit="N.m" start="0.0" />'
TORQUE_3 = 'causality="input" variability="continuous" unit="N.m" start="0.0" />'

# defect, where, FMI version, what is replaced by what
DESCRIPTIONS = [
    ("duplicate-name", "mass (2 times)", FMI2, ('name="radius"', 'name="mass"')),
    ("duplicate-name", "mass (2 times)", FMI3, ('name="radius"', 'name="mass"')),
    ("no-type", "torque", FMI2, (TORQUE_2, '<Float64 unit="N.m" start="0.0" />')),
    ("no-variables", "in the terms of FMI 3.0", FMI2, ('fmiVersion="2.0"', 'fmiVersion="3.0"')),
    (
        "bad-dimension",
        "torque",
        FMI3,
        (TORQUE_3, TORQUE_3.replace("/>", '><Dimension valueReference="999"/></Float64>')),
    ),
    (
        "huge-array",
        "the array torque has 9000000 elements",
        FMI3,
        (TORQUE_3, TORQUE_3.replace("/>", '><Dimension start="9000000"/></Float64>')),
    ),
    ("no-name", "1 of them", FMI2, ('name="radius"', 'name=""')),
    ("illegal-name", "' radius'", FMI2, ('name="radius"', 'name=" radius"')),
    ("bad-reference", 'torque: "five"', FMI2, ('valueReference="5"', 'valueReference="five"')),
    ("reference-clash", "mass and radius (6)", FMI2, ('valueReference="7"', 'valueReference="6"')),
    ("reference-clash", "torque and mass (5)", FMI3, ('valueReference="6" d', 'valueReference="5" d')),
    ("alias-units", "angle [rad] and angular_velocity [rad/s]", FMI2, ('ence="2"', 'ence="1"')),
    ("unknown-causality", 'torque: "inputt"', FMI2, ('causality="input"', 'causality="inputt"')),
    ("unknown-variability", 'gravity: "fix"', FMI2, ('variability="fixed"', 'variability="fix"')),
    (
        "bad-combination",
        "gravity: parameter, continuous",
        FMI2,
        ('variability="fixed"', 'variability="continuous"'),
    ),
    ("unknown-type", 'torque: "Torque"', FMI2, (TORQUE_2, '<Real declaredType="Torque" start="0" />')),
    ("no-unit", "torque", FMI2, (TORQUE_2, '<Real start="0.0" />')),
    ("no-unit", "torque", FMI3, (TORQUE_3, 'causality="input" variability="continuous" start="0.0" />')),
    ("unknown-unit", "torque [Nm]", FMI2, (TORQUE_2, '<Real unit="Nm" start="0.0" />')),
    ("unknown-display-unit", "angle: grad for rad", FMI2, ('displayUnit="deg" ', 'displayUnit="grad" ')),
    ("not-a-number", 'torque: start = "zero"', FMI2, (TORQUE_2, '<Real unit="N.m" start="zero" />')),
    ("not-a-number", 'torque: start = "NaN"', FMI2, (TORQUE_2, '<Real unit="N.m" start="NaN" />')),
    (
        "not-a-number",
        'torque: start has an element "NaN"',
        FMI3,
        (TORQUE_3, TORQUE_3.replace('"0.0" />', '"0 NaN"><Dimension start="2"/></Float64>')),
    ),
    ("empty-range", "torque: 1 > -1", FMI2, (TORQUE_2, '<Real unit="N.m" min="1" max="-1" start="0" />')),
    (
        "start-outside-range",
        "torque = 0 not in [1, 2]",
        FMI2,
        (TORQUE_2, '<Real min="1" max="2" start="0" />'),
    ),
    (
        "start-outside-range",
        "torque = 9 not in [-inf, 2]",
        FMI3,
        (TORQUE_3, 'causality="input" max="2" start="9" />'),
    ),
    ("zero-nominal", "torque", FMI2, (TORQUE_2, '<Real unit="N.m" nominal="0" start="0" />')),
    ("no-start", "torque", FMI2, (TORQUE_2, '<Real unit="N.m" />')),
    ("no-start", "gravity", FMI3, ('nominal="10.0" start="9.81"', 'nominal="10.0"')),
    ("needless-start", "der(angle)", FMI2, ('derivative="2"', 'derivative="2" start="1"')),
    ("unknown-version", 'fmiVersion = "4.0"', FMI2, ('fmiVersion="2.0"', 'fmiVersion="4.0"')),
    ("no-file-name", 'CoSimulation: ""', FMI2, ('modelIdentifier="pendulum"', 'modelIdentifier=""')),
    ("no-file-name", 'CoSimulation: "xxx', FMI2, ('Identifier="pendulum"', f'Identifier="{"x" * 5000}"')),
    ("no-file-name", 'CoSimulation: "../p"', FMI2, ('Identifier="pendulum"', 'Identifier="../p"')),
    (
        "illegal-identifier",
        'CoSimulation: "my pendulum"',
        FMI2,
        ('Identifier="pendulum"', 'Identifier="my pendulum"'),
    ),
    ("no-guid", "", FMI2, ("guid=", "description2=")),
    ("no-guid", "", FMI3, ("instantiationToken=", "description2=")),
    (
        "needs-tool",
        "ddpc-cosim",
        FMI2,
        ("<CoSimulation ", '<CoSimulation needsExecutionTool="true" '),
    ),
    (
        "one-instance",
        "CoSimulation",
        FMI2,
        ('OnlyOncePerProcess="false"', 'OnlyOncePerProcess="true"'),
    ),
    ("bad-experiment", "stopTime = -40", FMI2, ('stopTime="40.0"', 'stopTime="-40.0"')),
    ("bad-experiment", 'stepSize = "small"', FMI2, ('stepSize="0.1"', 'stepSize="small"')),
    ("bad-structure", 'Derivatives: "99"', FMI2, ('<Unknown index="5" dep', '<Unknown index="99" dep')),
    (
        "bad-structure",
        'Output: "99"',
        FMI3,
        ('<Output valueReference="2" dep', '<Output valueReference="99" dep'),
    ),
    ("bad-dependency", "Outputs 2: 77", FMI2, ('index="2" dependencies="2"', 'index="2" dependencies="77"')),
    ("not-an-output", "torque", FMI2, ('<Unknown index="2" dep', '<Unknown index="6" dep')),
    ("unlisted-output", "angle", FMI2, ('<Unknown index="2" dependencies="2" />', "")),
    ("bad-derivative", 'der(angle): "222"', FMI2, ('derivative="2"', 'derivative="222"')),
    ("no-inputs", "", FMI2, ('causality="input"', 'causality="local"')),
    ("no-outputs", "", FMI2, ('causality="output"', 'causality="local"')),
]


@pytest.fixture
def fmus(pendulum_fmu: Path, pendulum_fmi3: Path) -> dict[str, Path]:
    return {FMI2: pendulum_fmu, FMI3: pendulum_fmi3}


@pytest.mark.parametrize(("name", "place", "version", "replacement"), DESCRIPTIONS)
def test_defects_of_the_description(fmus, mutate, name, place, version, replacement) -> None:
    inspection = inspect_fmu(mutate(fmus[version], replacement))
    places = {defect.kind.name: defect.places for defect in inspection.defects}
    assert name in places, places
    assert any(entry.startswith(place) for entry in places[name]) if place else places[name] == ()


def runs(fmu: Path) -> bool:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CosimWarning)
            with FMUPlant(fmu) as plant:
                plant.reset()
    except CosimError:
        return False
    return True


# Whether an FMU insists on its GUID cannot be seen from outside.
@pytest.mark.parametrize(
    ("name", "place", "version", "replacement"), [row for row in DESCRIPTIONS if row[0] != "no-guid"]
)
def test_what_is_said_to_run_runs(fmus, mutate, name, place, version, replacement) -> None:
    fmu = mutate(fmus[version], replacement)
    assert inspect_fmu(fmu).can_run == runs(fmu)


def test_only_what_prevents_running_is_an_error(pendulum_fmu, mutate) -> None:
    blemished = mutate(pendulum_fmu, (TORQUE_2, "<Real />"), ('stopTime="40.0"', 'stopTime="-1"'))
    inspection = inspect_fmu(blemished)
    assert inspection.defects
    assert inspection.can_run
    fatal = inspect_fmu(
        mutate(
            pendulum_fmu,
            ("<CoSimulation", "<ScheduledExecution"),
            ("</CoSimulation", "</ScheduledExecution"),
            ("<ModelExchange", "<Other"),
            ("</ModelExchange", "</Other"),
        )
    )
    assert not fatal.can_run
    assert fatal.defects[0].severity is Severity.ERROR  # the worst come first
    assert "no-interface" in [defect.kind.name for defect in fatal.defects]


def test_many_occurrences_are_one_defect(model_fmu, mutate) -> None:
    inspection = inspect_fmu(
        mutate(model_fmu("two_by_two"), (' unit="V"', ""), (' unit="K"', ""), (' unit="Pa"', ""))
    )
    (defect,) = [d for d in inspection.defects if d.kind.name == "no-unit"]
    assert sorted(defect.places) == ["u1", "u2", "y1", "y2"]
    assert str(defect).count("no-unit") == 0
    assert "and 1 more" in str(defect)


def test_texts_of_any_length_do_not_fill_a_message(pendulum_fmu, mutate) -> None:
    inspection = inspect_fmu(mutate(pendulum_fmu, ('causality="input"', f'causality="{"x" * 100_000}"')))
    (defect,) = [d for d in inspection.defects if d.kind.name == "unknown-causality"]
    assert len(str(defect)) < 1000


def binary_of(fmu: Path) -> str:
    with zipfile.ZipFile(fmu) as archive:
        return next(name for name in archive.namelist() if name.startswith("binaries/"))


def without_sources(fmu: Path) -> dict[str, str | None]:
    with zipfile.ZipFile(fmu) as archive:
        return dict.fromkeys(name for name in archive.namelist() if name.startswith("sources/"))


def kinds(fmu: Path) -> list[str]:
    return [defect.kind.name for defect in inspect_fmu(fmu).defects]


def test_no_binary_and_no_sources(pendulum_fmu, mutate) -> None:
    fmu = mutate(
        pendulum_fmu,
        renamed={binary_of(pendulum_fmu): "binaries/amiga/pendulum.lib", **without_sources(pendulum_fmu)},
    )
    inspection = inspect_fmu(fmu)
    assert inspection.binaries.route == ""
    assert "there are binaries for: amiga" in str(inspection.defects[0])
    assert inspection.defects[0].kind.name == "no-binary"


def test_sources_stand_in_for_a_binary(pendulum_fmu, mutate) -> None:
    inspection = inspect_fmu(mutate(pendulum_fmu, renamed={binary_of(pendulum_fmu): None}))
    assert inspection.binaries.route == "sources"
    assert inspection.can_run
    assert [defect.kind.name for defect in inspection.defects] == ["compiled-here"]


def test_a_library_of_another_name(pendulum_fmu, mutate) -> None:
    library = binary_of(pendulum_fmu)
    assert kinds(mutate(pendulum_fmu, renamed={library: library.replace("pendulum", "other")})) == [
        "unnamed-library"
    ]


def test_the_file_may_lie_about_its_encoding(pendulum_fmu, tmp_path) -> None:
    """What can be read for a run can be read for an inspection."""
    fmu = tmp_path / "encoded.fmu"
    with zipfile.ZipFile(pendulum_fmu) as source, zipfile.ZipFile(fmu, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            is_description = name == "modelDescription.xml"
            target.writestr(name, content.decode("utf-8").encode("utf-16") if is_description else content)
    assert inspect_fmu(fmu).can_run


def test_a_library_for_another_platform(pendulum_fmu, tmp_path) -> None:
    fmu = tmp_path / "foreign.fmu"
    with zipfile.ZipFile(pendulum_fmu) as source, zipfile.ZipFile(fmu, "w") as target:
        for name in source.namelist():
            content = b"not a library" if name == binary_of(pendulum_fmu) else source.read(name)
            target.writestr(name, content)
    assert kinds(fmu) == ["foreign-library"]


def test_a_library_without_the_functions_it_needs(pendulum_fmu, pendulum_fmi3, tmp_path) -> None:
    """An FMU for FMI 3.0 that carries a library for FMI 2.0."""
    fmu = tmp_path / "wrong.fmu"
    with (
        zipfile.ZipFile(pendulum_fmi3) as source,
        zipfile.ZipFile(pendulum_fmu) as other,
        zipfile.ZipFile(fmu, "w") as target,
    ):
        for name in source.namelist():
            wrong = name == binary_of(pendulum_fmi3)
            target.writestr(name, other.read(binary_of(pendulum_fmu)) if wrong else source.read(name))
    (defect,) = inspect_fmu(fmu).defects
    assert defect.kind.name == "no-functions"
    assert "fmi3DoStep" in str(defect.places)


def test_missing_source_files(pendulum_fmu, pendulum_fmi3, mutate) -> None:
    for fmu in (pendulum_fmu, pendulum_fmi3):
        (defect,) = inspect_fmu(mutate(fmu, renamed={"sources/model.c": None})).defects
        assert defect.kind.name == "no-source-file"
        assert defect.places == ("sources/model.c",)


def test_a_source_whose_name_no_file_can_have_is_missing(pendulum_fmu, mutate) -> None:
    fmu = mutate(pendulum_fmu, ('<File name="model.c"', f'<File name="{"x" * 5000}"'))
    defects = {defect.kind.name: defect.places for defect in inspect_fmu(fmu).defects}
    assert defects == {"no-source-file": (f"sources/{'x' * 5000}",)}
    without_library = mutate(fmu, renamed={binary_of(fmu): None})
    with pytest.raises(FMUImportError, match=r"the source x+ is missing$"):
        FMUPlant(without_library)


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 half an archive"])
def test_what_is_no_archive(tmp_path, content) -> None:
    path = tmp_path / "broken.fmu"
    path.write_bytes(content)
    inspection = inspect_fmu(path)
    assert [defect.kind.name for defect in inspection.defects] == ["refused"]
    assert inspection.description is None
    assert inspection.inputs == inspection.outputs == inspection.parameters == inspection.states == ()


def test_hostile_archives_are_refused(pendulum_fmu, mutate) -> None:
    traversal = mutate(pendulum_fmu, renamed={"sources/model.c": "../../outside.c"})
    (defect,) = inspect_fmu(traversal).defects
    assert defect.kind.name == "refused"
    assert "outside.c" in str(defect)


def test_a_description_that_is_no_xml(pendulum_fmu, mutate) -> None:
    inspection = inspect_fmu(mutate(pendulum_fmu, ("</ModelVariables>", "")))
    assert not inspection.can_run
    assert "modelDescription.xml" in str(inspection.defects[0])


def test_strict_adds_the_full_validation(pendulum_fmu, mutate) -> None:
    fmu = mutate(pendulum_fmu, ('variableNamingConvention="structured"', 'variableNamingConvention="odd"'))
    assert "invalid" not in kinds(fmu)
    defect_names = [defect.kind.name for defect in inspect_fmu(fmu, strict=True).defects]
    assert "invalid" in defect_names
