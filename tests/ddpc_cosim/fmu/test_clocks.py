"""Clocks and the event mode of FMI 3.0: when what ticks, what is told of the others, and what falls back."""

from pathlib import Path

import numpy as np
import pytest
from fmus.builder import Fault, V, describe, library_name, model_library, with_time, write_archive

from ddpc_cosim import ConfigError, CosimWarning, FMUImportError, FMUPlant
from ddpc_cosim.inspection import as_data, inspect_fmu

U, HELD = V("u", 0, causality="input", start="0"), V("held", 1, causality="output")
LAST = V("last", 2, causality="output")
COUNT = V("count", 5, "Integer", causality="output", variability="discrete")
KINDS = {
    "co-simulation": '<CoSimulation modelIdentifier="models" canHandleVariableCommunicationStepSize="true" '
    'hasEventMode="true" canGetAndSetFMUState="true"/>',
    "model-exchange": '<ModelExchange modelIdentifier="models"/>',
}
BOTH = "".join(KINDS.values())


def clock(name: str = "tick", causality: str = "input", **more: str) -> V:
    return V(name, 14, "Clock", causality=causality, variability="discrete", more=more)


def clocked(
    folder: Path, *clocks: V, interfaces: str = BOTH, model: str = "clocked", fault: Fault = Fault.NO_FAULT
) -> Path:
    """Write a sample-and-hold that counts the ticks of its clock, and tells the time of the last one."""
    token = f"{model}:{int(fault)}"
    signals = (U, HELD, LAST, COUNT) if model == "clocked" else (U, HELD)
    text = describe("3.0", token, with_time("3.0", [*signals, *clocks]), interfaces=interfaces)
    files = {"modelDescription.xml": text.encode(), library_name("3.0"): model_library("3.0")}
    return write_archive(folder / "clocked.fmu", files)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("h", "interval", "shift", "t0"),
    [(0.1, 0.1, 0.0, 0.0), (0.25, 0.1, 0.05, 0.0), (0.1, 0.3, 0.2, 0.0), (0.2, 0.5, 0.0, 7.0)],
)
def test_a_periodic_clock_ticks_at_its_instants(
    tmp_path: Path, kind: str, h: float, interval: float, shift: float, t0: float
) -> None:
    """At an instant that is a sample's, it ticks with that sample's inputs, after its outputs were read."""
    fmu = clocked(
        tmp_path,
        clock(intervalVariability="constant", intervalDecimal=str(interval), shiftDecimal=str(shift)),
    )
    ticks = shift + interval * np.arange(200)
    with FMUPlant(fmu, inputs=["u"], outputs=["count", "held", "last"], fmi_type=kind) as plant:  # type: ignore[arg-type]
        rows = [plant.reset({}, t0)]
        rows += [plant.step(np.array([float(k)]), h) for k in range(40)]
    for k, (count, held, last) in enumerate(rows):
        passed = ticks[ticks < k * h - 1e-9]
        assert count == len(passed)
        if len(passed):
            assert last == pytest.approx(t0 + passed[-1], abs=1e-9)
            assert held == np.floor(passed[-1] / h + 1e-9)


def test_an_interval_can_be_a_fraction(tmp_path: Path) -> None:
    third = clock(intervalVariability="constant", intervalCounter="1", shiftCounter="1", resolution="3")
    with FMUPlant(clocked(tmp_path, third), inputs=["u"], outputs=["count"]) as plant:
        plant.reset()
        counts = [float(plant.step(np.zeros(1), 1.0)[0]) for _ in range(300)]
    assert counts == [2.0 + 3.0 * k for k in range(300)]


def test_a_run_that_goes_back_ticks_again(tmp_path: Path) -> None:
    fmu = clocked(tmp_path, clock(intervalVariability="constant", intervalDecimal="0.1"))
    with FMUPlant(fmu, inputs=["u"], outputs=["last"]) as plant:
        plant.reset()
        plant.step(np.zeros(1), 0.3)
        state = plant.save_state()
        after = plant.step(np.zeros(1), 0.3)
        plant.step(np.zeros(1), 0.3)
        plant.restore_state(state)
        assert plant.step(np.zeros(1), 0.3) == after == pytest.approx([0.5])


@pytest.mark.parametrize("variability", ["triggered", "countdown", "changing", "tunable", "calculated"])
def test_a_clock_that_does_not_tick_is_told(tmp_path: Path, variability: str) -> None:
    fmu = clocked(tmp_path, clock(intervalVariability=variability))
    with pytest.warns(CosimWarning, match=rf"input clocks that do not tick here: tick \({variability}\)"):
        FMUPlant(fmu).close()
    report = as_data(inspect_fmu(fmu))
    assert [defect["kind"] for defect in report["defects"] if "clock" in defect["kind"]] == ["unticked-clock"]
    assert report["clocks"][0] == {
        "name": "tick",
        "causality": "input",
        "interval_variability": variability,
        "interval": None,
        "shift": 0.0,
    }


def test_without_an_event_mode_no_clock_ticks(tmp_path: Path) -> None:
    constant = clock(intervalVariability="constant", intervalDecimal="0.1")
    other = clock("told", causality="output", intervalVariability="triggered")
    silent = KINDS["co-simulation"].replace(' hasEventMode="true"', "")
    with pytest.warns(CosimWarning, match=r"do not tick here: tick \(constant\)"):
        plant = FMUPlant(
            clocked(tmp_path, constant, other, interfaces=silent), inputs=["u"], outputs=["count"]
        )
    with plant:
        plant.reset()
        assert plant.step(np.zeros(1), 1.0) == [0.0]


def test_equal_steps_have_to_meet_the_ticks(tmp_path: Path) -> None:
    equal = KINDS["co-simulation"].replace(' canHandleVariableCommunicationStepSize="true"', "")
    fmu = clocked(tmp_path, clock(intervalVariability="constant", intervalDecimal="0.3"), interfaces=equal)
    with FMUPlant(fmu, inputs=["u"], outputs=["count"]) as plant:
        plant.plan(0.1, 1.0)
        with pytest.raises(
            ConfigError, match=r'steps of 0\.2 s miss the ticks of its clock "tick", every 0\.3 s'
        ):
            plant.plan(0.2, 1.0)


def test_an_fmu_that_insists_on_event_mode(tmp_path: Path) -> None:
    fmu = clocked(
        tmp_path, interfaces=KINDS["co-simulation"], model="integrator", fault=Fault.NEEDS_EVENT_MODE
    )
    with FMUPlant(fmu) as plant:
        plant.reset()
        assert plant.step(np.ones(1), 0.5) == pytest.approx([0.5])


@pytest.mark.parametrize("isolated", [False, True])
def test_an_fmu_that_refuses_co_simulation_runs_for_model_exchange(tmp_path: Path, isolated: bool) -> None:
    fmu = clocked(tmp_path, model="lag", fault=Fault.NO_CO_SIMULATION)
    with FMUPlant(fmu, isolated=isolated) as plant:
        plant.reset()
        assert plant.provenance()["fmi_version"] == "3.0 Model Exchange"
        assert "runs for Model Exchange: cannot be instantiated" in plant.provenance()["fmu_warnings"]
        assert plant.step(np.zeros(1), 0.5) == pytest.approx([0.0])
    with (
        FMUPlant(fmu, fmi_type="co-simulation", isolated=isolated) as plant,
        pytest.raises(FMUImportError, match="cannot be instantiated"),
    ):
        plant.reset()
