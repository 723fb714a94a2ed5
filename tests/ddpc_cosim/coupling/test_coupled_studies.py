"""Coupled plants in studies: as a file says them, as Python does, and what is wrong with them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import (
    GAINED,
    Fault,
    V,
    describe,
    integrator_files,
    model_library,
    with_time,
    write_archive,
    write_fmu,
)
from gymnasium.utils.env_checker import check_env
from studies import cases_in, run_file, study_text, write

from ddpc_cosim import (
    ConfigError,
    Connection,
    Constant,
    Outcome,
    ParameterChange,
    Problem,
    Scenario,
    Study,
    load_results,
    simulate,
)
from ddpc_cosim.gymnasium import make as make_environment
from ddpc_cosim.study.case_files import read_trace
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import run_cases
from fmu_plants.pendulum import MODEL as PENDULUM

from .conftest import Exported
from .oscillator import BACK, DISPLACEMENTS, FRONT, exact
from .ssp_files import GAIN, binding, component, connection, ssd, ssv, system, write_ssp

MODULE = """
import numpy as np
from ddpc_cosim import Plant, Variable

class Lag(Plant):
    inputs = (Variable("u", start=0.5),)
    outputs = (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        self.y = np.zeros(1)
        return self.y
    def step(self, u, h):
        self.y = u + np.exp(-h) * (self.y - u)
        return self.y
"""


@pytest.fixture
def halves(exported: Exported) -> dict[str, Any]:
    """The section of a plant that is the oscillator in two halves."""
    return {
        "outputs": ["front.x"],
        "measurements": ["front.x", "back.x"],
        "parts": [
            {"name": "front", "fmu": str(exported(FRONT))},
            {"name": "back", "fmu": str(exported(BACK))},
        ],
        "connections": [{"from": connection.source, "to": connection.target} for connection in DISPLACEMENTS],
        "coupling": {"communication_step": 1e-3, "extrapolation": "linear"},
        "isolated": False,
    }


def study(plant: dict[str, Any], **tables: Any) -> str:
    reference = {plant["outputs"][0]: 0.0}
    return study_text(plant=plant, reference=reference, controllers={"nothing": "idle"}, **tables)


def faults(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        cases_in(write(folder, text))
    return "\n".join(caught.value.faults)


def test_a_study_of_two_fmus_is_that_of_the_whole(halves: dict[str, Any], tmp_path: Path) -> None:
    (case,) = cases_in(write(tmp_path, study(halves)))
    trace = run_case(case)
    whole = exact(np.zeros(10).tolist(), 0.1)
    np.testing.assert_allclose(trace.measured, whole[:, [0, 2]], atol=1e-5)
    assert [v.name for v in trace.inputs] == ["front.force"]
    assert trace.provenance["parts"] == "front, back"
    assert trace.provenance["back.fmu"] == "back.fmu"


def test_parts_are_one_equation_where_a_study_says_so(halves: dict[str, Any], tmp_path: Path) -> None:
    """It has another id than without, and is exact."""
    (stepped,) = cases_in(write(tmp_path, study(halves)))
    (case,) = cases_in(write(tmp_path, study(halves | {"coupling": {"algorithm": "monolithic"}})))
    assert case.id != stepped.id
    trace = run_case(case)
    np.testing.assert_allclose(trace.measured, exact(np.zeros(10).tolist(), 0.1)[:, [0, 2]], atol=1e-6)
    assert trace.provenance["coupling"] == "monolithic"


def test_the_results_folder_has_the_study_as_it_was_resolved(halves: dict[str, Any], tmp_path: Path) -> None:
    """Written out, read back and run, it has the same cases; and the report shows what the plant is."""
    first = cases_in(write(tmp_path, study(halves)))
    results = run_file(tmp_path / "study.toml")
    assert [case.id for case in results.cases] == [case.id for case in first]
    assert [case.id for case in cases_in(tmp_path / "out" / "study.toml")] == [case.id for case in first]
    assert "front + back" in (tmp_path / "out" / "metrics.csv").read_text(encoding="utf-8")
    page = results.report().read_text(encoding="utf-8")
    for words in ("part back", "back.fmu", "follows back.x", "communication step", "back.fmu sha256"):
        assert words in page
    assert "back.fmi 2.0" not in page  # it is no package
    assert load_results(tmp_path / "out").study.plant.label == "front + back"


def test_parts_may_be_equations_fmus_classes_and_archives(
    exported: Exported, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pendulum, driven by a lag that follows a gain; y(t) of the lag is known."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_lag.py").write_text(MODULE, encoding="utf-8")
    plant = {
        "inputs": ["gain.u"],
        "outputs": ["pendulum.angle"],
        "measurements": ["lag.y", "gain.y"],
        "parameters": {"gain.k": 3.0, "pendulum.mass": 2.0},
        "parts": [
            {"name": "pendulum", "plant": "pendulum"},
            {"name": "lag", "plant": "own_lag:Lag"},
            {"name": "gain", "fmu": str(exported(GAIN)), "parameters": {"k": 2.0, "b": 1.0}},
        ],
        "connections": [
            {"from": "gain.y", "to": "lag.u", "factor": 2.0, "offset": 1.0},
            {"from": "lag.y", "to": "pendulum.torque", "convert_units": False},
        ],
    }
    scenarios = {"changed": {"events": [{"time": 0.5, "parameters": {"gain.k": 5.0, "gain.b": 0.0}}]}}
    (case,) = cases_in(write(tmp_path, study(plant, scenarios=scenarios)))
    assert case.plant.isolated
    trace = run_case(case)
    assert trace.outcome is Outcome.COMPLETED, trace.reason
    # With u = 0 the gain's output is b, and the lag goes to 2 b + 1.
    early = 3.0 * (1.0 - np.exp(-trace.time[:6]))
    np.testing.assert_allclose(trace.measured[:6, 0], early, atol=1e-9)
    late = 1.0 + (early[-1] - 1.0) * np.exp(-(trace.time[6:] - 0.5))
    np.testing.assert_allclose(trace.measured[6:, 0], late, atol=1e-9)


def test_case_ids_depend_on_parts_connections_and_options(halves: dict[str, Any], tmp_path: Path) -> None:
    def identifier(**changes: Any) -> str:
        (case,) = cases_in(write(tmp_path, study({**halves, **changes})))
        return case.id

    first, (front, back) = identifier(), halves["parts"]
    assert identifier() == first
    others = [
        identifier(parts=[front, {**back, "fmu": front["fmu"]}], connections=halves["connections"][:2]),
        identifier(connections=[*halves["connections"][:3]]),
        identifier(connections=[{**halves["connections"][0], "factor": 2.0}, *halves["connections"][1:]]),
        identifier(coupling={**halves["coupling"], "algorithm": "parallel"}),
        identifier(parts=[{**front, "step": 5e-4}, back]),
        identifier(parts=[{**front, "start": {"force": 1.0}}, back]),
    ]
    assert len({first, *others}) == 7


def test_a_study_in_python_is_the_one_of_the_file(
    halves: dict[str, Any], exported: Exported, tmp_path: Path
) -> None:
    problem = Problem(
        plant={"front": exported(FRONT), "back": str(exported(BACK))},
        connections=DISPLACEMENTS,
        coupling={"communication_step": 1e-3, "extrapolation": "linear", "steps": {"back": 5e-4}},
        sampling_time=0.1,
        duration=1.0,
        outputs=["front.x"],
        reference=Constant(0.0),
    )
    results = Study(problem, {"nothing": "idle"}).run(tmp_path / "out", progress=False)
    del halves["measurements"], halves["isolated"]
    halves["parts"][1]["step"] = 5e-4
    (expected,) = cases_in(write(tmp_path, study(halves)))
    assert [case.id for case in results.cases] == [expected.id]


def test_equations_and_connections_in_python(tmp_path: Path) -> None:
    problem = Problem(
        plant={"one": PENDULUM, "two": "pendulum"},
        connections=[Connection("one.angle", "two.torque", 0.5, convert_units=False)],
        sampling_time=0.1,
        duration=0.3,
        outputs=["two.angle"],
        reference=Constant(0.0),
        scenarios={"heavier": Scenario(events=[ParameterChange(0.2, {"two.mass": 3.0})])},
    )
    written = Study(problem, {"nothing": "idle"}).write(tmp_path / "study.toml").read_text(encoding="utf-8")
    assert 'plant = "pendulum"' in written
    assert "factor = 0.5, convert_units = false" in written
    resolved = read_study(str(tmp_path / "study.toml")).problem
    assert [v.name for v in resolved.inputs] == ["one.torque"]


class TestWhatIsWrong:
    def test_connections(self, halves: dict[str, Any], tmp_path: Path) -> None:
        halves["connections"] += [
            {"from": "front.y", "to": "back.other_x"},
            {"from": "middle.x", "to": "front.force"},
            {"from": "front.x", "to": "front.force"},
            {"from": "front.other_x", "to": "front.force"},
        ]
        messages = faults(tmp_path, study(halves))
        for words in (
            'plant.connections[4]: connection from "front.y" to "back.other_x": front has no output "y"',
            'plant.connections[5]: connection from "middle.x" to "front.force": no part "middle"',
            'plant.connections[6]: connection from "front.x" to "front.force": "front.x" is in m',
            "plant.connections[7]: connection",
        ):
            assert words in messages

    def test_two_sources_of_one_input(self, halves: dict[str, Any], tmp_path: Path) -> None:
        halves["connections"].append({"from": "front.v", "to": "front.other_v"})
        assert (
            'plant.connections[4]: connection from "front.v" to "front.other_v": "front.other_v"'
            in faults(tmp_path, study(halves))
        )

    def test_parts(self, halves: dict[str, Any], tmp_path: Path) -> None:
        halves["parts"] = [{"name": "a.b", "fmu": "x.fmu"}]
        assert (
            'plant.parts[0].name: must be a name without dots, as signals are NAME.variable, got "a.b"'
            in faults(tmp_path, study(halves))
        )
        halves["parts"] = [{"name": "front", "fmu": "x.fmu", "plant": "pendulum"}, {"name": "front"}]
        messages = faults(tmp_path, study(halves))
        assert 'plant.parts: there are two parts "front"' in messages
        assert 'plant.parts: "front": needs exactly one of the keys fmu and plant' in messages

    def test_files(self, halves: dict[str, Any], tmp_path: Path) -> None:
        halves["parts"][1] = {"name": "back", "fmu": "missing.fmu"}
        assert f'plant.parts[1]: part "back": {tmp_path / "missing.fmu"}: no such file' in faults(
            tmp_path, study(halves)
        )

    def test_keys_that_exclude_each_other(self, halves: dict[str, Any], tmp_path: Path) -> None:
        messages = faults(tmp_path, study({**halves, "name": "pendulum"}))
        assert "plant: needs exactly one of the keys name, fmu, ssp, parts and identified" in messages
        messages = faults(tmp_path, study({"name": "pendulum", "outputs": ["angle"], "coupling": {}}))
        assert "plant.coupling: needs parts or ssp" in messages


@pytest.mark.parametrize(
    ("coupling", "words"),
    [
        ({"communication_step": 0.03}, "communication_step = 0.03 s does not divide the sampling time"),
        ({"error_tolerance": 1e-3}, 'as part "lag" cannot save its state'),
        ({"algorithm": "monolithic"}, 'part "lag": it is not an FMU'),
    ],
)
def test_a_coupling_that_is_not_possible_is_told_before_any_case_runs(
    coupling: dict[str, Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_lags.py").write_text(MODULE, encoding="utf-8")
    plant = {
        "outputs": ["lag.y"],
        "parts": [{"name": "lag", "plant": "own_lags:Lag"}, {"name": "other", "plant": "own_lags:Lag"}],
        "connections": [{"from": "lag.y", "to": "other.u"}],
        "coupling": coupling,
    }
    with pytest.raises(ConfigError, match=words):
        run_file(write(tmp_path, study(plant)))


@pytest.mark.parametrize("in_own_process", [False, True])
@pytest.mark.parametrize(
    ("fault", "outcome", "words"),
    [
        (Fault.RETURN_ERROR, Outcome.FMU_ERROR, 'part "bad": faulty.fmu: '),
        (Fault.SEGMENTATION_FAULT, Outcome.CRASHED, "crashed in step"),
    ],
)
def test_a_part_that_fails_ends_the_case_with_its_name(
    fault: Fault, outcome: Outcome, words: str, in_own_process: bool, exported: Exported, tmp_path: Path
) -> None:
    bad = write_archive(tmp_path / "faulty.fmu", integrator_files("2.0"))
    plant = {
        "outputs": ["good.y"],
        "parts": [
            {"name": "good", "fmu": str(exported(GAIN))},
            {
                "name": "bad",
                "fmu": str(bad),
                "parameters": {"fault": int(fault), "fault_time": 0.5},
                "isolated": in_own_process,
            },
        ],
        "connections": [{"from": "bad.y", "to": "good.u"}],
    }
    planned = cases_in(write(tmp_path, study(plant)))
    (case,) = run_cases(planned, tmp_path, 1, lambda _: None)
    trace = read_trace(tmp_path / case.id)
    assert trace.outcome is outcome
    assert words in trace.reason
    assert 'part "bad"' in trace.reason
    assert 5 <= len(trace) <= 6  # the samples before it are there


def test_a_class_that_crashes_as_a_part_is_named_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is guarded by itself as well, within the coupled plant."""
    crash = MODULE.replace("Lag", "Bad").replace(
        "        self.y = u +", "        os.abort()\n        self.y = u +"
    )
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_bad.py").write_text(f"import os\n{MODULE}\n{crash}", encoding="utf-8")
    parts = [{"name": name.lower(), "plant": f"own_bad:{name}"} for name in ("Lag", "Bad")]
    plant = {
        "inputs": ["lag.u"],
        "outputs": ["bad.y"],
        "parts": parts,
        "connections": [{"from": "lag.y", "to": "bad.u"}],
    }
    (case,) = run_cases(cases_in(write(tmp_path, study(plant))), tmp_path, 1, lambda _: None)
    assert 'crashed in step of part "bad" at t = 0 s' in read_trace(tmp_path / case.id).reason


def test_an_archive_in_a_study(tmp_path: Path) -> None:
    """Its connectors are the signals; parts get steps and parameters of the study's own."""
    parts = (
        component("a", "resources/gain.fmu", "input u, output y"),
        component("b", "resources/gain.fmu", "input u, output y"),
    )
    wires = connection("in", "a/u") + connection("a/y", "b/u") + connection("b/y", "out")
    described = ssd(system("s", *parts, connections=wires, connectors="input in, output out"))
    write_ssp(tmp_path / "two.ssp", described, {"resources/gain.fmu": GAIN})
    plant = {
        "ssp": "two.ssp",
        "outputs": ["out"],
        "parts": [{"name": "b", "parameters": {"k": 2.0, "b": 0.25}, "step": 0.05}],
        "parameters": {"a.b": 1.0},
        "isolated": False,
    }
    (case,) = cases_in(write(tmp_path, study(plant)))
    trace = run_case(case)
    assert [v.name for v in (*trace.inputs, *trace.outputs)] == ["in", "out"]
    np.testing.assert_allclose(trace.y, 2.25)
    plant["parts"] = [{"name": "c"}]
    assert 'plant.ssp: parts: no part "c" in the SSP' in faults(tmp_path, study(plant))


@pytest.mark.filterwarnings("ignore:.*A Box observation space m(in|ax)imum value is")
def test_an_archive_is_an_environment(tmp_path: Path) -> None:
    """What acts there drives its connectors, and its parts, one behind the other, step as in a study."""
    parts = [component(name, "resources/gain.fmu", "input u, output y") for name in "ab"]
    wires = connection("in", "a/u") + connection("a/y", "b/u") + connection("b/y", "out")
    described = ssd(system("s", *parts, connections=wires, connectors="input in, output out"))
    write_ssp(tmp_path / "two.ssp", described, {"resources/gain.fmu": GAIN})
    factors = {"a.k": 2.0, "b.k": -3.0, "b.b": 0.25}
    plant = {"ssp": "two.ssp", "outputs": ["out"], "parameters": factors, "isolated": False}
    bounds = {"in": {"min": -1.0, "max": 1.0}}
    env = make_environment(write(tmp_path, study(plant, bounds=bounds)))
    check_env(env, skip_render_check=True)
    env.reset(seed=0)
    observation, *_ = env.step(np.array([0.5]))
    np.testing.assert_allclose(observation[0], -3.0 * (2.0 * 0.5) + 0.25)
    env.close()


def test_an_archive_is_simulated_in_open_loop(tmp_path: Path) -> None:
    """Its default experiment says for how long; inputs start where the file of inputs does."""
    described = ssd(
        system(
            "s",
            component("a", "resources/gain.fmu", "input u, output y"),
            connections=connection("in", "a/u") + connection("a/y", "out"),
            connectors="input in, output out",
        ),
        more='<ssd:DefaultExperiment startTime="1" stopTime="2"/>',
    )
    path = write_ssp(tmp_path / "one.ssp", described, {"resources/gain.fmu": GAIN})
    (tmp_path / "in.csv").write_text("time,in\n1,0.5\n2,1.5\n", encoding="utf-8")
    table = simulate(path, inputs=tmp_path / "in.csv", parameters={"a.k": 2.0}, step=0.5)
    assert [*table.columns] == ["time [s]", "out [1]", "in [1]"]
    # Inputs are held, so that the output of a step is of the input at its beginning.
    np.testing.assert_allclose(table.to_numpy(), [[1.0, 1.0, 0.5], [1.5, 1.0, 1.0], [2.0, 2.0, 1.5]])
    with pytest.raises(ConfigError, match="trace_calls is of one FMU"):
        simulate(path, trace_calls=tmp_path / "calls.txt")


def one_part(folder: Path, *variables: V, version: str = "2.0", **settings: str) -> Path:
    """An archive of one FMU with these variables, whose gain the system gives."""
    text = describe(version, "integrator", with_time(version, variables), **settings)
    fmu = write_fmu(folder / "a.fmu", text, model_library(version))
    part = component("a", "resources/a.fmu", "input u, output y", binding(ssv({"gain": 3.0})))
    described = ssd(system("s", part), more='<ssd:DefaultExperiment startTime="0" stopTime="2"/>')
    return write_ssp(folder / "one.ssp", described, {"resources/a.fmu": fmu.read_bytes()})


def test_a_system_has_the_variables_of_its_parts_with_the_values_that_it_gives_them(tmp_path: Path) -> None:
    one_part(tmp_path, *GAINED)
    (case,) = cases_in(write(tmp_path, study({"ssp": "one.ssp", "outputs": ["a.y"], "isolated": False})))
    described = case.plant.variables()
    assert {name: described.variables[name].causality for name in ("a.u", "a.y", "a.gain", "a.hidden")} == {
        "a.u": "input",
        "a.y": "output",
        "a.gain": "parameter",
        "a.hidden": "local",
    }
    gain = described.variables["a.gain"]
    assert (gain.variable.start, gain.start_text, gain.is_tunable) == (3.0, "3.0", True)
    assert described.variables["a.on"].values == "boolean"
    assert (described.default_experiment.start_time, described.default_experiment.stop_time) == (0.0, 2.0)
    assert (described.default_inputs, described.default_outputs) == (("a.u",), ("a.y", "a.speed"))


def test_inputs_of_a_part_that_are_not_continuous_hold_their_last_value(tmp_path: Path) -> None:
    """As those of an FMU do that is simulated by itself."""
    path = one_part(tmp_path, V("u", 0, causality="input", variability="discrete", start="0"), *GAINED[1:])
    (tmp_path / "in.csv").write_text("time,a.u\n0,1\n1,2\n2,2\n", encoding="utf-8")
    table = simulate(path, inputs=tmp_path / "in.csv", step=0.5)
    assert table["a.u [1]"].tolist() == [1.0, 1.0, 2.0, 2.0, 2.0]
    np.testing.assert_allclose(table["a.y [1]"], [0.0, 1.5, 3.0, 6.0, 9.0])


def test_steps_that_nobody_asks_for_fit_those_of_the_parts(tmp_path: Path) -> None:
    fixed = '<CoSimulation modelIdentifier="models" fixedInternalStepSize="0.25"/>'
    reals = [variable for variable in GAINED if variable.type == "Real"]
    table = simulate(one_part(tmp_path, *reals, version="3.0", interfaces=fixed))
    np.testing.assert_allclose(table["time [s]"], 0.25 * np.arange(9))
    assert table.attrs["notes"] == ["step = 0.25 s, as the plant does not say"]
