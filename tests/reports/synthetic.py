"""Results made from synthetic runs, written and read by the classes that the report is written for."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ddpc_cosim import Bounds, CaseResult, DisplayUnit, Outcome, StudyResults, Trace, Variable
from ddpc_cosim.codec import read
from ddpc_cosim.files.tables import Table
from ddpc_cosim.metrics import MetricSettings
from ddpc_cosim.study.case_files import load_case, write_case
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.verdicts.judgement import judged
from ddpc_cosim.study.verdicts.standings import standings
from ddpc_reports.comparison import Condition
from ddpc_reports.tables.ranking import ranking_table
from ddpc_reports.verdict import Part, Statement, findings

SAMPLING_TIME = 0.1
SAMPLES = 61

ANGLE = Variable("angle", "rad", display_unit=DisplayUnit("deg", 180 / math.pi))
SPEED = Variable("speed", "m/s")
TORQUE = Variable("torque", "N.m")
FORCE = Variable("force", "N")

MakeResults = Callable[..., StudyResults]


def make_trace(
    lag: float,
    *,
    outputs: tuple[Variable, ...] = (ANGLE,),
    inputs: tuple[Variable, ...] = (TORQUE,),
    outcome: Outcome = Outcome.COMPLETED,
    reason: str = "",
    step_time: float = 2e-5,
    noise_seed: int = 0,
    fallbacks: int = 0,
    settings: dict[str, Any] | None = None,
    diagnostics: dict[str, float] | None = None,
) -> Trace:
    """Return a run whose outputs follow a step of 20 deg with a lag [s]; a fault ends it half-way."""
    rows = SAMPLES if outcome is Outcome.COMPLETED else SAMPLES // 2
    time = SAMPLING_TIME * np.arange(rows, dtype=np.float64)
    target = math.radians(20)
    reference = np.full((rows, len(outputs)), target)
    noise = 0.002 * np.random.default_rng(noise_seed).standard_normal((rows, len(outputs)))
    y = reference * (1 - np.exp(-time / lag))[:, np.newaxis] + noise
    u = np.tile((3 * np.exp(-time / lag))[:, np.newaxis], (1, len(inputs)))
    wide = np.full(len(outputs), math.radians(70))
    return Trace(
        time=time,
        reference=reference,
        y=y,
        measured=y,
        u=u,
        status=("ok",) * (rows - fallbacks) + ("infeasible",) * fallbacks,
        solve_time=np.linspace(step_time, 3 * step_time, rows),
        inputs=inputs,
        outputs=outputs,
        measurements=outputs,
        bounds=Bounds(np.full(len(inputs), -3.5), np.full(len(inputs), 3.5), -wide, wide),
        sampling_time=SAMPLING_TIME,
        planned_samples=SAMPLES,
        outcome=outcome,
        reason=reason,
        settings=settings or {"horizon": 5, "lambda_g": 50.0},
        diagnostics=diagnostics or {},
    )


def findings_of(condition: Condition) -> list[Statement]:
    """Return all findings of a condition."""
    return [statement for part in get_args(Part) for statement in findings(condition, part)]


def ranked(condition: Condition) -> Table:
    """Return the ranked table of a condition as if it were the only one."""
    results = condition.results
    cases = [case for case in results.cases if case.scenario == condition.scenario]
    return ranking_table(condition, standings(results.study, cases), "")


def make_study(controllers: dict[str, dict[str, Any]], **changes: Any) -> Study:
    """Return a study of the given controllers on a pendulum."""
    content: dict[str, Any] = {
        "name": "synthetic",
        "title": "Synthetic study",
        "summary": "Runs made by a formula.",
        "seeds": [7],
        "plant": {"name": "pendulum", "inputs": ["torque"], "outputs": ["angle"]},
        "loop": {"sampling_time": SAMPLING_TIME, "duration": (SAMPLES - 1) * SAMPLING_TIME},
        "reference": {"angle": {"kind": "constant", "value": 20.0, "unit": "deg"}},
        "controllers": controllers,
    }
    return read(Study, content | changes)


def make_results_in(
    folder: Path,
    trace_of: Callable[[str, int], Trace] | None = None,
    controllers: dict[str, dict[str, Any]] | None = None,
    provenance: dict[str, str] | None = None,
    settings: MetricSettings | None = None,
    **changes: Any,
) -> StudyResults:
    """Make results: the trace of a controller and a seed for each controller, scenario and seed."""
    study = make_study(controllers or {"quick": {"type": "quick"}, "slow": {"type": "slow"}}, **changes)
    trace_of = trace_of or (lambda key, seed: make_trace(0.3 if key == "quick" else 1.0, noise_seed=seed))
    written = [
        _write_one(folder, study, key, scenario, seed, trace_of(key, seed), settings)
        for key in study.controllers
        for scenario in study.scenarios
        for seed in study.seeds[: 1 if study.controllers[key].seeds == "first" else None]
    ]
    cases = judged(study.scenarios, written, {})
    return StudyResults(
        folder, WholeStudy.of(study), cases, provenance or {"date": "2020-01-01", "fmu sha256": "abc"}
    )


def _write_one(
    folder: Path,
    study: Study,
    key: str,
    scenario: str,
    seed: int,
    trace: Trace,
    settings: MetricSettings | None,
) -> CaseResult:
    """Write one case and read it back."""
    case_id = f"{key}_{scenario}_{seed}"
    label = study.controllers[key].label or key
    head = {"id": case_id, "controller": key, "label": label, "scenario": scenario, "seed": seed}
    head |= {"problem": study.name}
    write_case(folder / "cases" / case_id, trace, head, settings=settings)
    return load_case(folder / "cases" / case_id)
