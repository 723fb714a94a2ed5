"""Sweeps and drifts of a study file, as the cases that they become."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from studies import write

from ddpc_cosim import ConfigError
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.reading import read_study

STUDY = """
plant = { name = "pendulum", inputs = ["torque"], outputs = ["angle"] }
loop = { sampling_time = 0.1, duration = 1.0, start_time = 2.0 }
reference.angle = { kind = "constant", value = 0.1 }

[scenarios.nominal]

[controllers.mfapc]
type = "mfapc"
settings = { horizon = 4 }
"""
SWEEPS = """
[[controllers.mfapc.sweep]]
lambda_u = [0.1, 10.0]
form = ["cfdl", "pfdl"]

[[controllers.mfapc.sweep]]
initial_gradient = [-0.1, [0.5]]
"""
TARGET = PlantSpec(name="", fmu="pendulum.fmu")


def cases(folder: Path, text: str) -> list[Case]:
    return cases_of(read_study(str(write(folder, text))).problem, TARGET)


def test_a_table_is_run_in_all_combinations_and_tables_one_after_the_other(tmp_path: Path) -> None:
    settings_of = {case.controller: case.section["settings"] for case in cases(tmp_path, STUDY + SWEEPS)}
    assert list(settings_of) == [
        "mfapc",
        "mfapc-lambda_u-0.1-form-cfdl",
        "mfapc-lambda_u-0.1-form-pfdl",
        "mfapc-lambda_u-10-form-cfdl",
        "mfapc-lambda_u-10-form-pfdl",
        "mfapc-initial_gradient--0.1",
        "mfapc-initial_gradient-0.5",
    ]
    assert {settings["horizon"] for settings in settings_of.values()} == {4}
    assert settings_of["mfapc-lambda_u-10-form-pfdl"]["lambda_u"] == 10.0
    assert settings_of["mfapc-lambda_u-10-form-pfdl"]["form"] == "pfdl"
    assert settings_of["mfapc-initial_gradient-0.5"]["lambda_u"] == settings_of["mfapc"]["lambda_u"]


def test_a_single_table_needs_no_double_brackets(tmp_path: Path) -> None:
    text = STUDY + "[controllers.mfapc.sweep]\nhorizon = [3, 5]\n"
    assert [case.label for case in cases(tmp_path, text)] == [
        "mfapc",
        "mfapc, horizon = 3",
        "mfapc, horizon = 5",
    ]


def test_the_expanded_study_is_a_study_with_the_same_cases(tmp_path: Path) -> None:
    first = cases(tmp_path, STUDY + SWEEPS)
    written: dict[str, Any] = read_study(str(tmp_path / "study.toml")).whole.tables()
    assert written["controllers"]["mfapc-initial_gradient-0.5"]["variant_of"] == "mfapc"
    second = cases(tmp_path, tomli_w.dumps(written))
    assert [case.id for case in first] == [case.id for case in second]


def test_impossible_values_are_all_named(tmp_path: Path) -> None:
    text = STUDY + "[controllers.mfapc.sweep]\nlambda_u = [-1.0]\nno_such = [1]\n[[controllers.mfapc.sweep]]"
    with pytest.raises(ConfigError, match="TOML"):
        cases(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        cases(
            tmp_path,
            STUDY + "[[controllers.mfapc.sweep]]\nlambda_u = [-1.0]\n"
            "[[controllers.mfapc.sweep]]\nlambda = [1]\n",
        )
    assert "controllers.mfapc.sweep[0].lambda_u: -1.0 is not possible" in caught.value.faults[0]
    assert 'unknown setting of mfapc; did you mean "lambda_u"' in caught.value.faults[1]


@pytest.mark.parametrize(
    ("sweep", "reason"),
    [
        ("horizon = []", "sweep: horizon: no values"),
        ("horizon = [3, 3]", 'two controllers are called "mfapc-horizon-3"'),
        (f"horizon = {list(range(1, 1003))}", "1002 variants; allowed: 1000"),
    ],
)
def test_impossible_sweeps_are_refused(sweep: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=reason):
        cases(tmp_path, f"{STUDY}[controllers.mfapc.sweep]\n{sweep}\n")


DRIFT = {"parameter": "mass", "from_value": 1.0, "to_value": 2.0, "from_time": 2.2, "to_time": 2.7}


def with_drift(**changes: Any) -> str:
    study = tomllib.loads(STUDY)
    study["scenarios"] = {"nominal": {"drifts": [DRIFT | changes]}}
    return tomli_w.dumps(study)


def test_a_drift_is_a_step_at_every_sample(tmp_path: Path) -> None:
    (case,) = cases(tmp_path, with_drift())
    times = [event.time for event in case.events]
    values = [event.parameters["mass"] for event in case.events]
    assert times == pytest.approx([2.2, 2.3, 2.4, 2.5, 2.6, 2.7])
    assert values == pytest.approx(np.linspace(1.0, 2.0, 6))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"parameter": "mas"}, 'no tunable parameter "mas"; did you mean "mass"'),
        ({"to_value": -1.0}, r"drifts\[0\].to_value: -1 is outside"),
        ({"to_time": 2.0}, "it must end after it starts, got 2.2 s to 2 s"),
    ],
)
def test_impossible_drifts_are_refused(changes: dict[str, Any], reason: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=reason):
        cases(tmp_path, with_drift(**changes))
