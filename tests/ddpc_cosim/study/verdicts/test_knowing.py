"""What knowing a disturbance is worth, from pairs of runs of scenarios that differ in nothing else."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.findings import findings_of
from ddpc_cosim.study.verdicts.knowing import Knowing, knowing
from ddpc_cosim.study.verdicts.sentences import knowing_clause
from ddpc_cosim.study.verdicts.standings import standings

KEYS = ("mean_abs_error.y [K]", "mean_abs_error.z [K]")
LEVELS = ("unknown", "measured", "high", "perfect")


def study(scenarios: dict[str, dict[str, Any]]) -> Study:
    controllers = {name: {"type": name} for name in ("a", "b", "c")}
    return read(
        Study,
        {
            "plant": {"name": "p"},
            "loop": {"sampling_time": 0.1, "duration": 1.0},
            "reference": {"y": {"kind": "constant", "value": 1.0}},
            "disturbances": {"d": {"signal": {"kind": "constant", "value": 1.0}, "known": "measured"}},
            "controllers": controllers,
            "scenarios": scenarios,
        },
    )


def cases(
    factors: dict[str, dict[str, float]],
    keys: tuple[str, ...] = KEYS[:1],
    failing: tuple[str, str] = ("", ""),
) -> list[CaseResult]:
    """Return runs on eight seeds whose figures are a level of the seed times a factor."""
    rng = np.random.default_rng(3)
    level = rng.uniform(1.0, 2.0, 8)
    return [
        CaseResult(
            *(f"{controller}{scenario}{seed}", controller, controller, scenario, seed),
            *(Outcome.COMPLETED, "", ()),
            {key: float(factor * level[seed] * (1 + 0.01 * rng.standard_normal())) for key in keys},
            *({}, {}, (), Path()),
            failed=(controller, scenario) == failing and seed == 0,
        )
        for controller, of_scenario in factors.items()
        for scenario, factor in of_scenario.items()
        for seed in range(8)
    ]


ALL = study({level: {"known": {"d": level}} for level in reversed(LEVELS)})
GAINS = {
    "a": {"unknown": 1.0, "measured": 0.5, "high": 1.5, "perfect": 0.2},
    "b": {"unknown": 2.0, "measured": 1.6, "high": 1.6, "perfect": 1.6},
    "c": dict.fromkeys(LEVELS, 0.7),
}


def worth(of: Study, runs: list[CaseResult]) -> Knowing | None:
    return knowing(of, standings(of, runs))


def test_what_is_left_of_the_error_is_the_ratio_to_the_scenario_where_the_least_is_known() -> None:
    found = worth(ALL, cases(GAINS))
    assert found is not None
    assert (found.least, found.more) == ("unknown", ("measured", "high", "perfect"))
    assert [gain.controller for gain in found.gaining] == ["a", "b"]
    assert found.others == ("c",)
    for gain in found.gaining:
        for scenario, left in gain.left.items():
            expected = GAINS[gain.controller][scenario] / GAINS[gain.controller]["unknown"]
            assert left == pytest.approx(expected, rel=0.02)
    assert found.typical("measured") == pytest.approx((0.5 + 0.8) / 2, rel=0.02)


def test_of_several_figures_it_is_their_geometric_mean() -> None:
    runs = cases(GAINS, KEYS)
    for case in runs:
        case.metrics[KEYS[1]] *= {"perfect": 4.0}.get(case.scenario, 1.0)
    found = worth(ALL, runs)
    assert found is not None
    assert {gain.controller: gain for gain in found.gaining}["a"].left["perfect"] == pytest.approx(
        0.4, rel=0.02
    )


def test_who_has_failed_runs_is_not_said_to_gain_or_not() -> None:
    found = worth(ALL, cases(GAINS, failing=("b", "unknown")))
    assert found is not None
    assert [gain.controller for gain in found.gaining] == ["a"]
    assert found.others == ("c",)


def test_scenarios_that_differ_in_more_are_not_compared() -> None:
    noisy = {level: {"known": {"d": level}, "noise": {"y": float(i)}} for i, level in enumerate(LEVELS)}
    assert worth(study(noisy), cases(GAINS)) is None
    pair = {"unknown": {"known": {"d": "unknown"}, "label": "blind"}, "measured": {}}
    halves = {name: {key: of[key] for key in pair} for name, of in GAINS.items()}
    found = worth(study(pair), cases(halves))
    assert found is not None
    assert (found.least, found.more) == ("unknown", ("measured",))
    assert worth(ALL, cases({name: dict.fromkeys(LEVELS, 1.0) for name in "abc"})) is None


def test_it_is_said_in_one_clause() -> None:
    findings = findings_of(ALL, cases(GAINS))
    names = {name: name.upper() for name in "abc"}
    clause = knowing_clause(findings.knowing, names, {level: level for level in LEVELS}).striptags()
    shown = clause.replace("\u00a0", " ")
    assert shown.startswith(
        "knowing the disturbances leaves the 2 controllers that gain (median) 65 % (measured)"
    )
    assert "1.1 times (high)" in shown or "1.2 times (high)" in shown
    assert "of their mean absolute error without (unknown); A gains most (20 %); C gains nothing" in shown
    assert knowing_clause(None, names, {}) == ""
