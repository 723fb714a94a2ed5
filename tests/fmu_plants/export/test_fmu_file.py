"""The FMU as a file: valid, complete, the same bytes every time."""

import zipfile
from xml.etree import ElementTree as ET

import fmpy
import pytest

from fmu_plants import ExportError, export_fmu
from fmu_plants.pendulum import MODEL


def test_it_is_for_this_platform_and_can_be_compiled_on_others(pendulum_fmu, pendulum3_fmu):
    for path in (pendulum_fmu, pendulum3_fmu):
        assert set(fmpy.supported_platforms(str(path))) == {"c-code", fmpy.platform}


def test_variables_of_the_pendulum(pendulum_fmu):
    description = fmpy.read_model_description(str(pendulum_fmu))
    described = {
        v.name: (v.causality, v.variability, v.unit, v.displayUnit, v.start)
        for v in description.modelVariables
    }
    assert described == {
        "time": ("independent", "continuous", "s", None, None),
        "angle": ("output", "continuous", "rad", "deg", "0.0"),
        "angular_velocity": ("output", "continuous", "rad/s", "deg/s", "0.0"),
        "der(angle)": ("local", "continuous", "rad/s", None, None),
        "der(angular_velocity)": ("local", "continuous", "rad/s2", None, None),
        "torque": ("input", "continuous", "N.m", None, "0.0"),
        "mass": ("parameter", "tunable", "kg", None, "1.0"),
        "radius": ("parameter", "tunable", "m", None, "0.2"),
        "damping": ("parameter", "tunable", "N.m.s/rad", None, "0.4"),
        "torque_gain": ("parameter", "tunable", None, None, "1.0"),
        "gravity": ("parameter", "fixed", "m/s2", None, "9.81"),
    }
    torque = next(v for v in description.modelVariables if v.name == "torque")
    assert (torque.min, torque.max) == (None, None)  # the limits of the torque are the study's


def test_units_and_experiment_of_the_pendulum(pendulum_fmu):
    description = fmpy.read_model_description(str(pendulum_fmu))
    units = {unit.name: unit for unit in description.unitDefinitions}
    torque = units["N.m"].baseUnit
    assert (torque.kg, torque.m, torque.s, torque.rad) == (1, 2, -2, 0)
    degrees = units["rad"].displayUnits[0]
    assert degrees.name == "deg"
    assert float(degrees.factor) == pytest.approx(57.29577951308232, rel=1e-15)
    experiment = description.defaultExperiment
    assert [experiment.stopTime, experiment.stepSize, experiment.tolerance] == ["40.0", "0.1", "1e-10"]
    assert description.coSimulation.canGetAndSetFMUstate
    assert description.coSimulation.canSerializeFMUstate
    assert not description.coSimulation.canBeInstantiatedOnlyOncePerProcess


def test_both_versions_describe_the_same_variables(pendulum_fmu, pendulum3_fmu):
    def described(path):
        return {
            v.name: (v.valueReference, v.causality, v.variability, v.unit, v.displayUnit, v.min, v.start)
            for v in fmpy.read_model_description(str(path)).modelVariables
        }

    assert described(pendulum3_fmu) == described(pendulum_fmu)


def test_both_versions_describe_the_same_structure(pendulum_fmu, pendulum3_fmu):
    def structure(path):
        description = fmpy.read_model_description(str(path))
        return {
            (group, unknown.variable.name): [known.name for known in unknown.dependencies]
            for group in ("outputs", "derivatives", "initialUnknowns")
            for unknown in getattr(description, group)
        }

    assert structure(pendulum3_fmu) == structure(pendulum_fmu)
    assert structure(pendulum3_fmu)["derivatives", "der(angular_velocity)"] == [
        "angle",
        "angular_velocity",
        "torque",
    ]


def test_capabilities(pendulum3_fmu):
    with zipfile.ZipFile(pendulum3_fmu) as archive:
        root = ET.fromstring(archive.read("modelDescription.xml"))
    for interface in ("CoSimulation", "ModelExchange"):
        attributes = root.find(interface).attrib
        assert attributes["modelIdentifier"] == "pendulum"
        for capability in (
            "canGetAndSetFMUState",
            "canSerializeFMUState",
            "providesDirectionalDerivatives",
            "providesAdjointDerivatives",
        ):
            assert attributes[capability] == "true"
        assert "hasEventMode" not in attributes
        assert "needsCompletedIntegratorStep" not in attributes


def test_sources_are_included_and_listed(pendulum_fmu):
    with zipfile.ZipFile(pendulum_fmu) as archive:
        included = {n.removeprefix("sources/") for n in archive.namelist() if n.startswith("sources/")}
        text = archive.read("modelDescription.xml").decode()
    listed = {name for name in included if f'<File name="{name}" />' in text}
    assert listed == {name for name in included if name.endswith(".c")}
    assert "model.c" in listed
    assert "model.h" in included


def test_the_same_model_gives_the_same_bytes(pendulum_fmu, tmp_path):
    again = export_fmu(MODEL, tmp_path / "again.fmu")
    assert again.read_bytes() == pendulum_fmu.read_bytes()


def test_another_tolerance_is_another_fmu(no_compilation, pendulum_fmu, tmp_path):
    other = export_fmu(MODEL, tmp_path / "other.fmu", relative_tolerance=1e-6)
    guids = [fmpy.read_model_description(str(path)).guid for path in (pendulum_fmu, other)]
    assert guids[0] != guids[1]


def test_an_existing_file_is_replaced(no_compilation, tmp_path):
    path = tmp_path / "pendulum.fmu"
    path.write_bytes(b"old")
    assert export_fmu(MODEL, path) == path
    assert zipfile.is_zipfile(path)
    assert list(tmp_path.iterdir()) == [path]


def test_paths_may_have_spaces_and_any_letters(tmp_path, monkeypatch, open_fmu):
    folder = tmp_path / "Prüfstand 振り子 1"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", None)  # the folder for temporary files is asked for anew
    path = export_fmu(MODEL, folder / "Pendel θ.fmu")
    assert open_fmu(path).start({"angle": 0.1}).step(0.0, 0.1) == 0


def test_an_unknown_version_of_fmi_is_refused(tmp_path):
    with pytest.raises(ExportError, match=r"'1.0' cannot be exported; available: 2.0, 3.0"):
        export_fmu(MODEL, tmp_path / "pendulum.fmu", fmi_version="1.0")


@pytest.mark.parametrize("name", ["relative_tolerance", "absolute_tolerance"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_tolerances_must_be_positive(tmp_path, name, value):
    with pytest.raises(ExportError, match=f"{name} must be positive and finite"):
        export_fmu(MODEL, tmp_path / "pendulum.fmu", **{name: value})


def test_a_missing_folder_is_named(no_compilation, tmp_path):
    with pytest.raises(ExportError, match=r"cannot be written to .*missing"):
        export_fmu(MODEL, tmp_path / "missing" / "pendulum.fmu")
