"""Parameters that seeds draw: whose plant is whose, what names a case, and what cannot be drawn."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import norm
from studies import cases_in, run_file, study_text, write

from ddpc_controllers import MFAPC, PID
from ddpc_cosim import (
    ConfigError,
    Constant,
    LogNormal,
    Normal,
    Problem,
    Scenario,
    Study,
    Uniform,
    load_results,
)
from ddpc_cosim.study import cases as cases_module
from ddpc_cosim.study.case_files import read_run
from ddpc_cosim.study.cases import Case, cases_of, doing_nothing
from ddpc_cosim.study.objects import Silent
from ddpc_cosim.study.reading import read_study, resolve_file
from ddpc_cosim.study.single import single_case

MASS = {"distribution": "normal", "mean": 1.0, "deviation": 0.1, "low": 0.5}
DAMPING = {"distribution": "uniform", "low": 0.3, "high": 0.5}
PLANT: dict[str, Any] = {"name": "pendulum", "inputs": ["torque"], "outputs": ["angle"]}


def spread(**others: Any) -> dict[str, Any]:
    return PLANT | {"parameters": {"mass": MASS, "damping": DAMPING, "gravity": 9.8}} | others


def write_study(folder: Path, plant: dict[str, Any] | None = None, **others: Any) -> Path:
    given = {"seeds": [0, 1, 5], "controllers": ["pid", "mfapc"], **others}
    return write(folder, study_text(plant or spread(), **given))


def drawn(cases: list[Case]) -> dict[int, set[tuple[tuple[str, Any], ...]]]:
    """Return the plants that the cases of each seed have."""
    plants: dict[int, set[tuple[tuple[str, Any], ...]]] = {}
    for case in cases:
        plants.setdefault(case.seed, set()).add(tuple(sorted(case.parameters.items())))
    return plants


@pytest.mark.parametrize("sampling", ["independent", "latin-hypercube", "sobol"])
def test_all_who_are_run_with_a_seed_have_its_plant(sampling: str, tmp_path: Path) -> None:
    noisy = {"noise": {"angle": 0.01}}
    cases = cases_in(write_study(tmp_path, spread(sampling=sampling), scenarios={"calm": {}, "noisy": noisy}))
    plants = drawn([*cases, *doing_nothing(cases)])
    assert [len(of_seed) for of_seed in plants.values()] == [1, 1, 1]
    assert len(set.union(*plants.values())) == 3
    for case in cases:
        assert case.parameters["gravity"] == 9.8
        assert 0.3 < float(case.parameters["damping"]) < 0.5
        assert set(case.drawn) == {"damping [N.m.s/rad]", "mass [kg]"}


def test_a_scenario_may_fix_a_parameter_or_spread_it_otherwise(tmp_path: Path) -> None:
    wide = {"parameters": {"mass": MASS | {"deviation": 0.2, "low": 0.01}}}
    scenarios = {"given": {}, "fixed": {"parameters": {"mass": 1.2}}, "wide": wide}
    of: dict[tuple[str, int], Case] = {
        (case.scenario, case.seed): case for case in cases_in(write_study(tmp_path, scenarios=scenarios))
    }
    for seed in (0, 1, 5):
        fixed, wider = of["fixed", seed], of["wide", seed]
        assert (fixed.parameters["mass"], list(fixed.drawn)) == (1.2, ["damping [N.m.s/rad]"])
        assert wider.parameters["damping"] == of["given", seed].parameters["damping"]
        # The same number between 0 and 1, of another distribution; hardly anything is cut off.
        number = norm(1.0, 0.1).cdf(of["given", seed].parameters["mass"])
        assert wider.parameters["mass"] == pytest.approx(norm(1.0, 0.2).ppf(number), abs=1e-6)


def test_ids_of_studies_without_distributions_are_what_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kept from before there were distributions, with the code and the plant called by fixed names."""
    monkeypatch.setattr(cases_module, "code_version", lambda _: "code")
    resolved = read_study("noise").problem
    cases = cases_of(resolved, replace(resolved.plant, content="content"))
    shown = [case.id for case in (*cases[:2], cases[-1], *doing_nothing(cases)[:2])]
    assert shown == [
        "deepc_quiet_seed0_4c311d8e8a",
        "deepc_quiet_seed1_54f39e3d8e",
        "ipid_loud-no-preview_seed14_4d3b7a4c1b",
        "doing-nothing_quiet_seed0_03a334f6b6",
        "doing-nothing_quiet_seed1_58d67829fa",
    ]


def test_a_case_is_another_one_where_its_plant_is(tmp_path: Path) -> None:
    def ids(**changes: Any) -> list[str]:
        return [case.id for case in cases_in(write_study(tmp_path, **changes))]

    given = ids()
    assert len(set(given)) == len(given) == 6
    assert ids(seeds=[1, 0, 5, 7])[:3] == [given[1], given[0], given[2]]
    wider = spread() | {
        "parameters": {"mass": MASS | {"deviation": 0.11}, "damping": DAMPING, "gravity": 9.8}
    }
    assert not {*ids(plant=wider)} & {*given}
    assert ids(plant=spread(sampling="sobol")) != given


def test_a_part_of_a_study_has_the_plants_of_the_whole(tmp_path: Path) -> None:
    path = write_study(tmp_path, spread(sampling="latin-hypercube"), seeds=list(range(8)))
    resolved = read_study(str(path)).problem
    whole = {case.id: case for case in cases_in(path)}
    part = cases_of(resolved, resolved.plant.built(), only="pid*seed3")
    assert [case.id for case in part] == [id for id in whole if id.startswith("pid_seed3")]
    alone, _ = single_case(read_study(str(path)), "pid", Silent(), seed=3)
    assert alone.parameters == part[0].parameters


def test_runs_record_what_they_drew_and_go_on(tmp_path: Path) -> None:
    path = write_study(tmp_path, seeds=[0, 1])
    results = run_file(path)
    for case in results.cases:
        assert read_run(case.folder)["drawn"] == case.drawn
    frame = results.frame()
    assert frame["parameter mass [kg]"].tolist() == [case.drawn["mass [kg]"] for case in results.cases]
    header = (results.folder / "metrics.csv").read_text("utf-8").splitlines()[0]
    assert "parameter damping [N.m.s/rad],parameter mass [kg]" in header
    assert [case.drawn for case in load_results(results.folder).cases] == [c.drawn for c in results.cases]
    assert run_file(path).runs[-1]["cases run"] == "0"
    again = read_study(str(results.folder / "study.toml")).problem
    assert {case.id for case in cases_of(again, again.plant.built())} == {case.id for case in results.cases}


def test_python_says_what_a_file_does(tmp_path: Path) -> None:
    problem = Problem(
        plant="pendulum",
        inputs=["torque"],
        outputs=["angle"],
        sampling_time=0.1,
        duration=1.0,
        reference=Constant(0.1),
        parameters={"mass": Normal(1.0, 0.1, low=0.5), "gravity": 9.8},
        sampling="sobol",
        scenarios={"calm": Scenario(), "rough": Scenario(parameters={"damping": LogNormal(0.4, 1.5)})},
    )
    study = Study(problem, {"pid": PID(), "mfapc": MFAPC()}, seeds=range(3))
    written = study.write(tmp_path / "study.toml")
    text = written.read_text("utf-8")
    assert 'distribution = "normal"' in text
    resolved, again = resolve_file(study._file), read_study(str(written))
    assert again.problem.study.plant.parameters["mass"] == Normal(1.0, 0.1, low=0.5)
    assert again.problem.study.scenarios["rough"].parameters["damping"] == LogNormal(0.4, 1.5)
    ids = [[case.id for case in cases_of(r.problem, r.problem.plant.built())] for r in (resolved, again)]
    assert ids[0] == ids[1]


def faults(folder: Path, plant: dict[str, Any], **others: Any) -> list[str]:
    with pytest.raises(ConfigError) as error:
        read_study(str(write_study(folder, plant, **others)))
    return [fault.partition("study.toml:")[2].partition(": ")[2] or fault for fault in error.value.faults]


def test_all_faults_of_distributions_are_said_at_once(tmp_path: Path) -> None:
    parameters = {
        "mass": {"distribution": "norml", "mean": 1.0, "deviation": 0.1},
        "radius": {"distribution": "normal", "mean": 0.2, "deviation": -0.1, "lo": 0.1},
        "damping": {"distribution": "uniform", "low": 3.0, "high": 1.0},
        "gravity": {"distribution": "normal", "mean": 9.81, "deviation": 1.0},
        "torque_gain": {"distribution": "normal", "mean": 1.0, "deviation": 0.1, "low": 5.0},
    }
    said = "\n".join(faults(tmp_path, PLANT | {"parameters": parameters, "sampling": "soboll"}))
    for fault in (
        "plant.sampling: must be one of 'independent', 'latin-hypercube' or 'sobol', got 'soboll'",
        "plant.parameters.mass: must be one of 'normal', 'log-normal', 'uniform', 'triangular', got "
        "'norml'; did you mean \"normal\"?",
        'plant.parameters.radius.lo: unknown key; did you mean "low"?',
        "plant.parameters.radius.deviation: must be greater than 0, got -0.1",
        "plant.parameters.damping: uniform: low = 3 must be less than high = 1",
        "plant.parameters.gravity: draws below 0, which gravity must not be; set low = 0 or higher",
        "plant.parameters.torque_gain: normal: less than 1e-06 of it lies from 5 to inf",
    ):
        assert fault in said


def test_a_distribution_needs_a_parameter_that_nothing_else_sets(tmp_path: Path) -> None:
    said = faults(
        tmp_path,
        PLANT | {"parameters": {"masse": MASS, "radius": {"mean": 1.0}}},
        scenarios={
            "one": {
                "parameters": {"damping": DAMPING},
                "events": [{"time": 0.5, "parameters": {"damping": 0.4}}],
                "drifts": [
                    {"parameter": "damping", "from_value": 0.4, "to_value": 0.5}
                    | {"from_time": 0.1, "to_time": 0.5}
                ],
            }
        },
    )
    text = "\n".join(said)
    assert 'plant.parameters: no parameter "masse"; did you mean "mass"?' in text
    assert 'plant.parameters.radius: required key "distribution" is missing' in text
    assert "scenarios.one.events[0].parameters.damping: each seed draws its own damping" in text
    assert "scenarios.one.drifts[0].parameter: each seed draws its own damping" in text


def test_sampling_without_distributions_is_a_fault(tmp_path: Path) -> None:
    assert faults(tmp_path, PLANT | {"sampling": "sobol"}) == [
        "plant.sampling: no parameter has a distribution, so that seeds draw nothing; leave it out"
    ]


def test_a_uniform_distribution_may_touch_the_limits_of_its_parameter(tmp_path: Path) -> None:
    plant = PLANT | {"parameters": {"damping": {"distribution": "uniform", "low": 0.0, "high": 1.0}}}
    assert [case.spread[0].name for case in cases_in(write_study(tmp_path, plant, seeds=[0]))] == [
        "damping"
    ] * 2
    assert Uniform(0.0, 1.0).support == (0.0, 1.0)
