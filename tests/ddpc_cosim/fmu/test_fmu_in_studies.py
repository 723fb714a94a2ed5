"""FMUs of every version in whole studies: parameters of every type, units, warnings."""

import os
import sys
from pathlib import Path
from typing import Any

import fmus.builder
import numpy as np
import pytest
from click.testing import CliRunner
from fmus.builder import LAG, describe, model_fmu, model_library, write_fmu
from studies import run_file, study_text, write

from ddpc_cosim import Constant, Controller, CosimWarning, FMUPlant, Loop, Sample, cosimulate
from ddpc_cosim.cli.main import main
from ddpc_cosim.suggestion import suggest_study
from fmu_plants.export.compiler import find_compiler


def write_study(folder: Path, fmu: Path, **plant: Any) -> Path:
    section = {"fmu": fmu.name, "outputs": ["x"]} | plant
    return write(folder, study_text(plant=section, reference={"x": 1.0}))


def invoke(*arguments: str) -> Any:
    return CliRunner().invoke(main, arguments)


@pytest.mark.parametrize("version", ["1.0", "2.0", "3.0"])
def test_a_study_runs_on_an_fmu_of_any_version(tmp_path: Path, version: str) -> None:
    settings = {"interfaces": "CoSimulation"} if version == "1.0" else {}
    fmu = model_fmu(tmp_path, version, "lag", **settings)
    study = write_study(tmp_path, fmu, parameters={"rate": 2, "x": 0.25, "name": "abc"})
    (case,) = run_file(study).cases
    assert case.trace().y[0] == 0.25
    assert case.trace().provenance["fmi_version"] == f"{version} Co-Simulation"


def test_model_exchange_is_chosen_by_a_study(tmp_path: Path) -> None:
    fmu = model_fmu(tmp_path, "2.0", "lag")
    study = write_study(tmp_path, fmu, fmi_type="model-exchange")
    (case,) = run_file(study).cases
    assert case.trace().provenance["fmi_version"] == "2.0 Model Exchange"


def test_a_display_unit_reaches_the_results(tmp_path: Path) -> None:
    text = describe("2.0", "lag", LAG, interfaces='<CoSimulation modelIdentifier="models"/>')
    text = text.replace(
        "<ModelVariables>", '<UnitDefinitions><Unit name="rad"/></UnitDefinitions><ModelVariables>'
    )
    text = text.replace('initial="exact"><Real start="0"/>', 'initial="exact"><Real start="0" unit="rad"/>')
    fmu = write_fmu(tmp_path / "lag.fmu", text, model_library("2.0"))
    study = write_study(tmp_path, fmu, display_units={"x": "deg"})
    (case,) = run_file(study).cases
    (x,) = case.trace().outputs
    assert (x.unit, x.shown_in.name) == ("rad", "deg")
    assert "[deg" in (tmp_path / "out" / "metrics.csv").read_text(encoding="utf-8").splitlines()[0]


def test_faults_of_the_plant_section_are_told_with_their_place(tmp_path: Path) -> None:
    fmu = model_fmu(tmp_path, "2.0", "lag")
    study = write_study(tmp_path, fmu, display_units={"y": "deg"}, parameters={"rat": 1.0})
    result = invoke("run", str(study))
    assert result.exit_code == 2
    assert "plant.display_units" in result.stderr
    assert "plant.parameters" in result.stderr


def not_quite_valid(folder: Path) -> Path:
    text = describe("2.0", "lag", LAG, interfaces='<CoSimulation modelIdentifier="models"/>')
    return write_fmu(
        folder / "lag.fmu", text.replace('fmiVersion="2.0"', 'fmiVersion="2.0.1"'), model_library("2.0")
    )


def test_a_tolerant_import_warns(tmp_path: Path) -> None:
    with pytest.warns(CosimWarning) as caught:
        plant = FMUPlant(not_quite_valid(tmp_path))
    assert [str(warning.message) for warning in caught] == [
        "lag.fmu: modelDescription.xml: the description departs from the standard but was understood: "
        'fmiVersion "2.0.1" was read as 2.0',
    ]
    assert "fmiVersion" in plant.provenance()["fmu_warnings"]
    plant.close()


def test_a_run_tells_warnings_in_a_line_each(tmp_path: Path) -> None:
    study = write_study(tmp_path, not_quite_valid(tmp_path))
    result = invoke("run", str(study), "--out", str(tmp_path / "out"), "--no-report", "--jobs", "1")
    assert result.exit_code == 0, result.output
    warnings = [line for line in result.stderr.splitlines() if "was read as" in line]
    assert len(warnings) == 1
    assert warnings[0].startswith("warning: lag.fmu: modelDescription.xml: ")


class Hold(Controller):
    """Always 1."""

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> np.ndarray:
        return np.ones(1)


def test_a_run_tells_the_fmu_its_stop_time(tmp_path: Path) -> None:
    with FMUPlant(model_fmu(tmp_path, "2.0", "lag"), outputs=["x"]) as plant:
        trace = cosimulate(plant, Hold(), sampling_time=0.1, duration=0.7, reference=Constant(0.0))
        assert trace.y[:, 0] == pytest.approx(1 - np.exp(-trace.time))
        assert len(trace.time) == 8


def test_c_sources_are_compiled_once_before_anything_is_timed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiler is called by the command's own process, where no call has a time limit, and not again."""
    sources = Path(fmus.builder.__file__).parent
    names = ("models.c", "front2.c", "models.h")
    files = {f"sources/{name}": (sources / name).read_text(encoding="utf-8") for name in names}
    interface = (
        '<CoSimulation modelIdentifier="models" canHandleVariableCommunicationStepSize="true"><SourceFiles>'
        '<File name="models.c"/><File name="front2.c"/></SourceFiles></CoSimulation>'
    )
    fmu = write_fmu(tmp_path / "lag.fmu", describe("2.0", "lag", LAG, interfaces=interface), None, **files)
    callers, real = tmp_path / "callers", find_compiler().command
    asked = tmp_path / "compiler.py"
    asked.write_text(
        f"import os, sys\nopen({str(callers)!r}, 'a').write(f'{{os.getppid()}}\\n')\n"
        f"command = [*{list(real)!r}, *sys.argv[1:]]\nos.execv(command[0], command)\n",
        encoding="utf-8",
    )
    monkeypatch.setenv("CC", f'"{sys.executable}" "{asked}"')
    study = write_study(tmp_path, fmu)
    commands = {
        "run": ("run", str(study), "--out", str(tmp_path / "out"), "--no-report", "--jobs", "1"),
        "check": ("check", str(fmu)),
    }
    for name, command in commands.items():
        monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / f"cache-{name}"))
        callers.unlink(missing_ok=True)
        result = invoke(*command)
        assert result.exit_code == 0, result.output
        assert result.output.count("compiling the C sources of lag.fmu") == 1
        assert set(callers.read_text().split()) == {str(os.getpid())}
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache-init"))
    callers.unlink()
    lines: list[str] = []
    with pytest.warns(CosimWarning, match="compiled from the FMU's C sources"):
        suggest_study(fmu, trial=False, tell=lines.append)
    assert "compiling the C sources of lag.fmu" in lines
    assert set(callers.read_text().split()) == {str(os.getpid())}
    callers.unlink()
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache-run"))
    result = invoke(*commands["run"], "--fresh")
    assert result.exit_code == 0, result.output
    assert "compiling" not in result.output
    assert not callers.exists()
