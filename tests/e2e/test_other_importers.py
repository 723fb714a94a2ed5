"""The FMUs of a plant and of its controller give our closed loop in importers that are not ours."""

import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.container_fmu.cli import create_container_fmu
from fmpy.container_fmu.config import Component, Configuration, Connection
from fmpy.model_description import CoSimulation, DefaultExperiment, ModelDescription, ModelVariable
from fmpy.ssp.simulation import simulate_ssp

from ddpc_cosim import (
    Conditions,
    Connection as Ours,
    Constant,
    CoupledPlant,
    FMUPlant,
    Outcome,
    Reference,
    Steps,
    Trace,
    export_controller,
)
from ddpc_cosim.coupling.plant import Algorithm, Extrapolation
from ddpc_cosim.study.case_runs import run_case, started
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.reading import read_study
from fmu_plants import export_fmu
from fmu_plants.pendulum import MODEL

TS = 0.1
STEPS = 80
CONTROLLERS = [("paper", "deepc"), ("paper", "mfapc"), ("paper", "wkpc"), ("time-varying", "pid")]
TOLERANCE = 1e-6  # in the unit of the signal; the plant's FMU integrates with 1e-10

SSD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription name="loop" version="1.0"
 xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon">
<ssd:System name="loop"><ssd:Connectors>{system}</ssd:Connectors><ssd:Elements>{parts}</ssd:Elements>
<ssd:Connections>{connections}</ssd:Connections></ssd:System></ssd:SystemStructureDescription>"""


def connectors(names: Iterable[str], kind: str) -> str:
    return "".join(f'<ssd:Connector name="{n}" kind="{kind}"><ssc:Real/></ssd:Connector>' for n in names)


def component(name: str, inputs: Sequence[str], outputs: Sequence[str]) -> str:
    signals = connectors(inputs, "input") + connectors(outputs, "output")
    source = f'type="application/x-fmu-sharedlibrary" source="resources/{name}.fmu"'
    return f'<ssd:Component name="{name}" {source}><ssd:Connectors>{signals}</ssd:Connectors></ssd:Component>'


def connection(start: str, end: str) -> str:
    ends = zip(("start", "end"), (start, end), strict=True)
    words = []
    for kind, (*element, connector) in ((kind, place.split(":")) for kind, place in ends):
        words += [f'{kind}Element="{name}"' for name in element] + [f'{kind}Connector="{connector}"']
    return f"<ssd:Connection {' '.join(words)}/>"


def case_of(study: str, controller: str, reference: Reference, conditions: Conditions) -> Case:
    """Return a short case of a built-in study whose plant is the pendulum."""
    resolved = read_study(study).problem
    (case, *_) = cases_of(resolved, resolved.plant.built(), [1], controller)
    return replace(
        case,
        duration=STEPS * TS,
        reference={"angle": reference},
        conditions=conditions,
        noise={},
        events=(),
        parameters={},
    )


def run_here(case: Case) -> Trace:
    trace = run_case(case)
    assert trace.outcome is Outcome.COMPLETED
    assert np.ptp(trace.u) > 0.1
    assert np.ptp(trace.y) > 0.05
    return trace


def controller_fmu(case: Case, path: Path, fmi_version: str) -> tuple[Path, list[str], list[str]]:
    """Export the controller of a case; return the FMU with its measurements and its references in order."""
    controller, loop = started(case)
    export_controller(controller, loop, path, fmi_version)
    inputs = [v.name for v in read_model_description(path).modelVariables if v.causality == "input"]
    asked = [name for name in inputs if name.startswith(("setpoint.", "reference."))]
    # What takes over from another controller is left as it is: this one is active from the start.
    of_hand_over = [name for name in inputs if name == "active" or name.startswith("applied.")]
    return path, [name for name in inputs if name not in (*asked, *of_hand_over)], asked


@pytest.mark.parametrize(("study", "name"), CONTROLLERS)
def test_ssp_simulation_of_fmpy(study: str, name: str, tmp_path: Path) -> None:
    """It steps all FMUs, then copies their outputs: u acts one sample late, as our delay of an actuator.

    Its connectors are 0 at the start, which is the pendulum at rest, and it hands on what comes from outside
    one step late as well: the references are given one step early.
    """
    reference = Steps([0.0, 1.0, 4.0], [0.0, 0.3, -0.2])
    case = case_of(study, name, reference, Conditions(delay={"torque": TS}))
    expected = run_here(case)
    plant = export_fmu(MODEL, tmp_path / "plant.fmu")
    controller, measured, asked = controller_fmu(case, tmp_path / "controller.fmu", "2.0")
    ssd = SSD.format(
        system=connectors(asked, "input"),
        parts=component("controller", [*measured, *asked], ["torque"])
        + component("plant", ["torque"], measured),
        connections="".join(connection(output, f"controller:{output}") for output in asked)
        + "".join(connection(f"plant:{output}", f"controller:{output}") for output in measured)
        + connection("controller:torque", "plant:torque"),
    )
    with zipfile.ZipFile(tmp_path / "loop.ssp", "w") as archive:
        archive.writestr("SystemStructure.ssd", ssd)
        for file in (plant, controller):
            archive.write(file, f"resources/{file.name}")
    time = np.arange(STEPS + len(asked) + 1) * TS
    values = reference.at(time)
    given = {
        variable: lambda t, ahead=ahead: values[round(t / TS) + ahead + 1]
        for ahead, variable in enumerate(asked)
    }
    result = simulate_ssp(str(tmp_path / "loop.ssp"), stop_time=(STEPS - 0.5) * TS, step_size=TS, input=given)
    assert len(result) == STEPS  # the row at t has what the step from t to t + h led to
    np.testing.assert_allclose(result["plant.angle"], expected.y[1:, 0], atol=TOLERANCE)
    np.testing.assert_allclose(result["controller.torque"], expected.u[:-1, 0], atol=TOLERANCE)


@pytest.mark.parametrize("name", ["deepc", "mfapc"])
def test_parts_of_a_coupled_plant(name: str, tmp_path: Path) -> None:
    """Here, too, however values are exchanged: a sampled part takes what is there at its instants."""
    algorithms = {*get_args(Algorithm)} - {"monolithic"}  # which exchanges nothing in steps
    case = case_of("paper", name, Constant(0.3), Conditions())
    expected = run_here(case)
    plant = export_fmu(MODEL, tmp_path / "plant.fmu")
    controller, measured, asked = controller_fmu(case, tmp_path / "controller.fmu", "2.0")
    connected = [Ours(f"plant.{output}", f"controller.{output}") for output in measured]
    connected.append(Ours("controller.torque", "plant.torque"))
    for algorithm, extrapolation, step in product(algorithms, get_args(Extrapolation), (TS, TS / 2)):
        with CoupledPlant(
            {"plant": FMUPlant(plant), "controller": FMUPlant(controller)},
            connected,
            inputs=[f"controller.{variable}" for variable in asked],
            outputs=["plant.angle", "controller.torque"],
            algorithm=algorithm,
            extrapolation=extrapolation,
            communication_step=step,
        ) as both:
            both.plan(TS, STEPS * TS)
            both.reset()
            reference = np.full(len(asked), 0.3)
            outputs = [both.outputs_at(reference)] + [both.step(reference, TS) for _ in range(STEPS)]
        np.testing.assert_allclose(np.array(outputs)[:, 0], expected.y[:, 0], atol=TOLERANCE)
        np.testing.assert_allclose(np.array(outputs)[:-1, 1], expected.u[:-1, 0], atol=TOLERANCE)


@pytest.mark.parametrize(("study", "name"), CONTROLLERS[::3])
def test_container_fmu_of_fmpy(study: str, name: str, tmp_path: Path) -> None:
    """It follows its connections in their order at every communication point: u_k answers y_k at once."""
    case = case_of(study, name, Constant(0.3), Conditions())
    expected = run_here(case)
    plant = export_fmu(MODEL, tmp_path / "plant.fmu", "3.0")
    controller, measured, asked = controller_fmu(case, tmp_path / "controller.fmu", "3.0")
    part = {p.stem: Component(p.stem, p, read_model_description(p)) for p in (plant, controller)}
    signals = {
        (name, v.name): v
        for name, component_of_fmu in part.items()
        for v in component_of_fmu.modelDescription.modelVariables
    }

    def outer(name: str, causality: str, **more: str) -> ModelVariable:
        return ModelVariable(type="Float64", variability="continuous", causality=causality, name=name, **more)

    shown = {outer(output, "output", initial="calculated"): ("plant", output) for output in measured}
    shown[outer("torque", "output", initial="calculated")] = ("controller", "torque")
    shown |= {outer(variable, "input", start="0.3"): ("controller", variable) for variable in asked}
    connected = [("plant", output, "controller", output) for output in measured]
    connected.append(("controller", "torque", "plant", "torque"))
    configuration = Configuration(
        parallelDoStep=False,
        modelDescription=ModelDescription(
            fmiVersion="3.0",
            modelName="loop",
            instantiationToken="",
            defaultExperiment=DefaultExperiment(stopTime=str(STEPS * TS), stepSize=str(TS)),
            coSimulation=CoSimulation(fixedInternalStepSize=TS),
            modelVariables=[outer("time", "independent"), *shown],
        ),
        components=list(part.values()),
        connections=[
            Connection(part[a], [signals[a, out]], part[b], [signals[b, into]])
            for a, out, b, into in connected
        ],
        variableMappings={v: [(part[a], signals[a, variable])] for v, (a, variable) in shown.items()},
    )
    (tmp_path / "container").mkdir()
    create_container_fmu(configuration, tmp_path / "container", tmp_path / "loop.fmu")
    result = simulate_fmu(
        str(tmp_path / "loop.fmu"), stop_time=STEPS * TS, step_size=TS, output=["angle", "torque"]
    )
    np.testing.assert_allclose(result["angle"], expected.y[:, 0], atol=TOLERANCE)
    np.testing.assert_allclose(result["torque"][:-1], expected.u[:-1, 0], atol=TOLERANCE)
