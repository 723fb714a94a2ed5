"""Models that controllers take from an FMU: those of its equations, whatever the FMU tells."""

import re
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import telling_fmu
from studies import study_text, write

from ddpc_controllers import LQR, MPC, FMUModel, StateSpace, pulse_model
from ddpc_controllers.models.identification import markov_parameters
from ddpc_controllers.models.linear import ModelSource, SampledModel
from ddpc_cosim import (
    Action,
    Bounds,
    ConfigError,
    Constant,
    Controller,
    FloatArray,
    FMUImportError,
    FMUPlant,
    FMUStepError,
    Loop,
    Plant,
    Sample,
    Variable as DisturbanceVariable,
    cosimulate,
)
from ddpc_cosim.study.reading import read_study
from fmu_plants import (
    Equations,
    Parameter,
    PlantModel,
    Variable,
    build_fmu,
    building,
    cart_pendulum,
    cstr,
    pendulum,
    quadruple_tank,
)
from fmu_plants.linear import linearise

H = 0.1
HIDDEN = PlantModel(
    name="hidden",
    states=(Variable("level"), Variable("energy")),
    inputs=(Variable("flow", min=-2.0, max=2.0),),
    outputs=(Variable("shown"),),
    parameters=(Parameter("rate", start=2.0),),
    equations=lambda v: Equations(
        {"level": v.rate * (v.flow - v.level), "energy": v.level}, {"shown": 3 * v.level}
    ),
)


@pytest.fixture(scope="session")
def fmu_of(own_cache_folder: None) -> Any:
    """Build a plant for an FMI version, once for all tests."""

    def build(model: PlantModel, version: str = "2.0") -> str:
        return str(build_fmu(model, version))

    return build


@pytest.fixture
def stepped_only(fmu_of: Any, tmp_path: Path) -> str:
    """The pendulum for Co-Simulation only, its state not to be saved."""
    path = tmp_path / "stepped.fmu"
    with zipfile.ZipFile(fmu_of(pendulum.MODEL)) as full, zipfile.ZipFile(path, "w") as archive:
        for name in full.namelist():
            content = full.read(name)
            if name == "modelDescription.xml":
                text = re.sub(r"<ModelExchange.*?</ModelExchange>", "", content.decode(), flags=re.DOTALL)
                content = text.replace('canGetAndSetFMUstate="true"', "").encode()
            archive.writestr(name, content)
    return str(path)


def loop_of(path: str, inputs: list[str], outputs: list[str], sampling_time: float = H) -> Loop:
    """The loop about an FMU, within its own limits."""
    with FMUPlant(path, inputs=inputs, outputs=outputs) as plant:
        u, y = plant.inputs, plant.outputs
    limits = (np.array([getattr(v, end) for v in group]) for group in (u, y) for end in ("min", "max"))
    return Loop(sampling_time, u, y, y, Bounds(*limits), None, np.random.default_rng(0))


def response(source: ModelSource, loop: Loop, samples: int = 40) -> FloatArray:
    return markov_parameters(source.model(loop), samples)


def exact(model: PlantModel, outputs: list[str], x: FloatArray | None = None, u: Any = None) -> StateSpace:
    """The model of a plant's equations between its inputs and some outputs."""
    rows = [[v.name for v in model.outputs].index(name) for name in outputs]
    a, b, c, d = linearise(model, x, u)
    y_0 = [next(s.start for s in model.states if s.name == name) for name in outputs]
    return StateSpace.about((a, b, c[rows], d[rows]), u_0=[v.start for v in model.inputs], y_0=y_0)


CASES = {
    "pendulum": (pendulum.MODEL, ["angle"], 0.1),
    "quadruple_tank": (quadruple_tank.MODEL, ["level_1", "level_2"], 5.0),
    "cart_pendulum": (cart_pendulum.MODEL, ["position", "angle"], 0.02),
    "cstr": (cstr.MODEL, ["temperature"], 0.05),
}


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", CASES)
def test_an_fmu_gives_the_model_of_its_equations(fmu_of: Any, name: str, version: str) -> None:
    model, outputs, sampling_time = CASES[name]
    path = fmu_of(model, version)
    loop = loop_of(path, [v.name for v in model.inputs], outputs, sampling_time)
    true = exact(model, outputs)
    expected = response(true, loop)
    for derivatives, tolerance in (("auto", 1e-9), ("directional", 1e-9), ("differences", 1e-6)):
        source = FMUModel(fmu=path, derivatives=derivatives, isolated=False)  # type: ignore[arg-type]
        linearised = source.model(loop)
        assert (
            np.abs(markov_parameters(linearised, 40) - expected).max() <= tolerance * np.abs(expected).max()
        )
        assert (linearised.u_0.tolist(), linearised.y_0) == (
            list(true.u_0),
            pytest.approx(np.array(true.y_0)),
        )


@pytest.mark.parametrize("can_save", [True, False])
def test_pulses_serve_where_nothing_else_does(fmu_of: Any, stepped_only: str, can_save: bool) -> None:
    """The same response to 1e-5, whether the plant returns to its state or starts anew."""
    path = fmu_of(pendulum.MODEL) if can_save else stepped_only
    loop = loop_of(path, ["torque"], ["angle"])
    source = FMUModel(fmu=path, derivatives="pulses" if can_save else "auto", isolated=False)
    expected = response(exact(pendulum.MODEL, ["angle"]), loop)
    assert np.abs(response(source, loop) - expected).max() < 1e-5
    with pytest.raises((FMUImportError, ConfigError)):
        FMUModel(fmu=stepped_only, derivatives="differences").model(loop)


@pytest.mark.parametrize("derivatives", ["directional", "differences", "pulses"])
def test_the_operating_point_is_where_held_inputs_lead(fmu_of: Any, derivatives: Any) -> None:
    """(22) at rest: m g sin(angle) = u, here with twice the mass."""
    path = fmu_of(pendulum.MODEL)
    loop = loop_of(path, ["torque"], ["angle"])
    source = FMUModel(
        fmu=path,
        derivatives=derivatives,
        operating_input=[1.5],
        settling_time=60.0,
        parameters={"mass": 2.0, "damping": 0.8},
    )
    model, angle = source.model(loop), np.arcsin(1.5 / (2.0 * 9.81))
    true = linearise(pendulum.MODEL, [angle, 0.0], [1.5], {"mass": 2.0, "damping": 0.8})
    expected = StateSpace.about((true.A, true.B, true.C[:1], true.D[:1]))
    assert (model.u_0.tolist(), model.y_0) == ([1.5], pytest.approx([angle], abs=1e-7))
    assert np.abs(markov_parameters(model, 30) - response(expected, loop, 30)).max() < 1e-5


class Counting(Plant):
    """A plant that counts how often it is started."""

    can_save_state = True

    def __init__(self, plant: FMUPlant) -> None:
        self._plant, self.starts = plant, 0
        self.inputs, self.outputs = plant.inputs, plant.outputs
        self.save_state, self.restore_state = plant.save_state, plant.restore_state  # type: ignore[method-assign]

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        self.starts += 1
        return self._plant.reset(parameters, t0)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        return self._plant.step(u, h)


def test_a_plant_that_can_go_back_is_brought_to_the_operating_point_once(fmu_of: Any) -> None:
    path = fmu_of(quadruple_tank.MODEL)
    with FMUPlant(path, outputs=["level_1", "level_2"]) as plant:
        counting = Counting(plant)
        back = pulse_model(counting, 5.0, settling_samples=20)
        counting.can_save_state = False
        anew = pulse_model(counting, 5.0, settling_samples=20)
    assert counting.starts == 1 + 2 * 2 + 1
    loop = loop_of(path, ["pump_1", "pump_2"], ["level_1", "level_2"], 5.0)
    assert np.abs(response(back, loop) - response(anew, loop)).max() < 1e-6


def close_loop(controller: Controller, loop: Loop, path: str, reference: FloatArray) -> FloatArray:
    """Return the inputs of a loop closed on an FMU."""
    controller.start(loop)
    inputs, outputs = ([v.name for v in group] for group in (loop.inputs, loop.outputs))
    with FMUPlant(path, inputs=inputs, outputs=outputs) as plant:
        y, u = plant.reset(), []
        for k in range(len(reference) - controller.horizon - 1):
            future = reference[k + 1 : k + 1 + controller.horizon]
            answer = controller.step(Sample(k, k * loop.sampling_time, y, y, future, future[0]))
            u.append(answer.u if isinstance(answer, Action) else answer)
            y = plant.step(u[-1], loop.sampling_time)
    return np.array(u)


@pytest.mark.parametrize("derivatives", ["directional", "differences"])
@pytest.mark.parametrize("controller", [MPC(), LQR()], ids=["mpc", "lqr"])
@pytest.mark.parametrize("name", ["pendulum", "quadruple_tank"])
def test_controllers_do_the_same_on_the_model_of_the_fmu_as_on_that_of_its_equations(
    fmu_of: Any, name: str, controller: Any, derivatives: Any
) -> None:
    model, outputs, sampling_time = CASES[name]
    path = fmu_of(model)
    loop = loop_of(path, [v.name for v in model.inputs], outputs, sampling_time)
    true = exact(model, outputs)
    steps = np.repeat([0.1, -0.05, 0.15], 40)[:, np.newaxis]
    reference = np.asarray(true.y_0) + steps * np.ones(len(outputs))
    of_equations = close_loop(replace(controller, model=true), loop, path, reference)
    source = FMUModel(fmu=path, derivatives=derivatives, isolated=False)
    of_fmu = close_loop(replace(controller, model=source), loop, path, reference)
    assert np.ptp(of_equations) > 0.1
    assert np.abs(of_fmu - of_equations).max() < 1e-6


def test_states_that_the_outputs_do_not_show_can_be_left_out(fmu_of: Any) -> None:
    """A meter of consumption integrates for ever: no filter can follow it."""
    path = fmu_of(HIDDEN)
    loop = loop_of(path, ["flow"], ["shown"])
    with pytest.raises(ConfigError, match="a mode that is not stable and that the outputs do not show"):
        LQR(model=FMUModel(fmu=path, isolated=False)).start(loop)
    model = FMUModel(fmu=path, order=1, isolated=False).model(loop)
    assert len(model.a) == 1
    expected = [3.0 * (1.0 - np.exp(-2.0 * H)) * np.exp(-2.0 * H * k) for k in range(20)]
    assert markov_parameters(model, 20)[:, 0, 0] == pytest.approx(expected, abs=1e-9)
    LQR(model=FMUModel(fmu=path, order=1, isolated=False)).start(loop)


def test_derivatives_that_the_fmu_contradicts_are_a_warning_of_the_controller(tmp_path: Path) -> None:
    """It says that its output does not depend on its state: there would be nothing to control."""
    path = telling_fmu(tmp_path)
    controller = MPC(model=FMUModel(fmu=str(path), isolated=False))
    controller.start(loop_of(path, ["u"], ["copy"]))
    (warning,) = controller.warnings()
    assert "directional derivatives of copy are not those of its values" in warning
    linearised = controller.model.model(loop_of(path, ["u"], ["copy"]))
    assert markov_parameters(linearised, 1)[0, 0, 0] == pytest.approx(1 - np.exp(-H), abs=1e-8)


def test_a_study_names_the_fmu_in_a_table(fmu_of: Any, tmp_path: Path) -> None:
    path = fmu_of(pendulum.MODEL)
    model = {"type": "ddpc_controllers:FMUModel", "fmu": str(path), "parameters": {"mass": 1.1}}
    study = write(tmp_path, study_text(controllers={"mpc": {"type": "mpc", "settings": {"model": model}}}))
    section = read_study(str(study)).problem.study.controllers["mpc"]
    assert section.settings["model"]["fmu"] == path
    with FMUPlant(path, outputs=["angle"]) as plant:
        trace = cosimulate(
            plant,
            MPC(model=FMUModel(fmu=path, parameters={"mass": 1.1}, isolated=False)),
            sampling_time=0.1,
            duration=2.0,
            reference={"angle": Constant(0.1)},
        )
    assert trace.outcome == "completed"
    assert trace.settings["model"]["parameters"] == {"mass": 1.1}


def test_signals_in_other_units_are_refused(fmu_of: Any) -> None:
    """As a wrapper shows them that scales signals: the model would not be theirs."""
    path = fmu_of(pendulum.MODEL)
    loop = loop_of(path, ["torque"], ["angle"])
    inputs = tuple(replace(v, unit="kN.m") for v in loop.inputs)
    outputs = tuple(replace(v, unit="") for v in loop.outputs)
    with pytest.raises(ConfigError) as caught:
        FMUModel(fmu=path, isolated=False).model(replace(loop, inputs=inputs, outputs=outputs))
    assert [fault.split(",")[0] for fault in caught.value.faults] == [
        'FMUModel: "torque" is in N.m in the FMU and in kN.m in the loop',
        'FMUModel: "angle" is in rad in the FMU and in no unit in the loop',
    ]


def test_what_cannot_be_is_an_error_that_says_so(fmu_of: Any, tmp_path: Path) -> None:
    path = fmu_of(pendulum.MODEL)
    loop = loop_of(path, ["torque"], ["angle"])

    def model(**settings: Any) -> SampledModel:
        return FMUModel(**{"fmu": path, "isolated": False, **settings}).model(loop)

    with pytest.raises(ConfigError, match=r"operating_input has shape \(2,\); needed: 1 numbers"):
        model(operating_input=[1.0, 2.0])
    with pytest.raises(ConfigError, match=r'pendulum\.fmu: no parameter "mas"'):
        model(parameters={"mas": 1.0})
    with pytest.raises(FMUImportError, match="no such file"):
        model(fmu=str(tmp_path / "none.fmu"))
    with pytest.raises(ConfigError, match='no input "torque"'):
        model(fmu=fmu_of(cart_pendulum.MODEL))
    with pytest.raises(ConfigError, match="derivatives = 'magic' is not possible"):
        model(derivatives="magic")
    with pytest.raises(ConfigError, match="fmu = '' is not a path of an FMU"):
        model(fmu="")
    with pytest.raises(ConfigError, match="only studies know"):
        model(fmu="{plant}")
    with pytest.raises(FMUStepError):
        model(parameters={"angle": 1e308, "angular_velocity": 1e308}, settling_time=1.0)


@pytest.mark.parametrize("derivatives", ["directional", "differences", "pulses"])
def test_known_disturbances_are_inputs_of_the_fmu(fmu_of: Any, derivatives: Any) -> None:
    path = fmu_of(building.MODEL)
    names = [v.name for v in building.MODEL.inputs]
    whole = loop_of(path, names, ["indoor_temperature"], 900.0)
    driven = loop_of(path, names[:1], ["indoor_temperature"], 900.0)
    loop = replace(driven, disturbances=whole.inputs[1:])
    source = FMUModel(fmu=path, derivatives=derivatives, isolated=False)
    together, model = source.model(whole), source.model(loop)
    every = replace(model, b=np.hstack([model.b, model.e]))
    expected = markov_parameters(together, 40)
    error = np.abs(markov_parameters(every, 40) - expected).max(axis=(0, 1))
    assert (error <= 1e-6 * np.abs(expected).max(axis=(0, 1))).all()
    assert [*model.u_0, *model.d_0] == together.u_0.tolist()


def test_a_disturbance_that_is_not_an_input_of_the_fmu_is_refused(fmu_of: Any) -> None:
    path = fmu_of(pendulum.MODEL)
    loop = replace(loop_of(path, ["torque"], ["angle"]), disturbances=(DisturbanceVariable("wind"),))
    with pytest.raises(ConfigError, match=r"wind.*\n?.*include the known disturbances \(wind\)"):
        FMUModel(fmu=path, isolated=False).model(loop)
