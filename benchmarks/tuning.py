"""Settings for the controllers of a built-in comparative study: grids of equal size, on seeds of their own.

``benchmarks/tuning/STUDY.toml`` holds the seeds, none of which the study reports, and a sweep for every
controller of the study. Plant, loop, reference, bounds, recording and scenarios are the study's. Of a
controller's sweep those settings are chosen with which the fewest runs fail, and of these the
ones with the least error: the RMSE in parts of the reference's span, mean over the outputs, median over the
seeds, mean over the scenarios. Of equals the first counts.
"""

import sys
import tomllib
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from ddpc_cosim import CaseResult, Outcome, StudyResults
from ddpc_cosim.cli.progress import LineProgress
from ddpc_cosim.metrics import split_key
from ddpc_cosim.study.file_format.study_files import find_study
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection, run_study

GRIDS = Path(__file__).with_name("tuning")
STUDIES = sorted(path.stem for path in GRIDS.glob("*.toml"))
_OF_THE_STUDY = ("plant", "loop", "reference", "bounds", "recording", "scenarios")


class Trial(NamedTuple):
    """Settings that were tried, and how good they are.

    Parameters
    ----------
    failed : int
        Runs that failed.
    error : float
        RMSE in parts of the reference's span, as above.
    settings : dict
        The settings, without those that are not the grid's to choose.
    """

    failed: int
    error: float
    settings: dict[str, Any]


def read_grid(name: str) -> dict[str, Any]:
    """Return the grids of a study: its seeds and the sweeps of its controllers."""
    return tomllib.loads((GRIDS / f"{name}.toml").read_text(encoding="utf-8"))


def settings_tried(controller: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield all settings of the section of a controller in a grid, in the order of its sweep's variants."""
    tables = controller["sweep"] if isinstance(controller["sweep"], list) else [controller["sweep"]]
    for table in tables:
        for values in product(*table.values()):
            yield controller.get("settings", {}) | dict(zip(table, values, strict=True))


def sweep_study(name: str) -> dict[str, Any]:
    """Return the study of which the cases are the trials."""
    study = tomllib.loads(find_study(name).read_text(encoding="utf-8"))
    return (
        {"name": f"{name}-tuning"}
        | {key: study[key] for key in _OF_THE_STUDY if key in study}
        | read_grid(name)
    )


def trials(results: StudyResults, grid: dict[str, Any]) -> dict[str, list[Trial]]:
    """Return the trials of every controller, the best first."""
    found, spans = {}, reference_spans(results)
    cases: dict[str, list[CaseResult]] = {}
    for case in results.cases:
        cases.setdefault(case.controller, []).append(case)
    for name, section in grid["controllers"].items():
        variants = [key for key, one in results.study.controllers.items() if one.variant_of == name]
        found[name] = sorted(
            (
                _trial(cases[variant], spans, settings)
                for variant, settings in zip(variants, settings_tried(section), strict=True)
            ),
            key=lambda trial: trial[:2],
        )
    return found


def _trial(cases: list[CaseResult], spans: Mapping[str, float], settings: dict[str, Any]) -> Trial:
    errors: dict[str, list[float]] = {}
    for case in cases:
        errors.setdefault(case.scenario, []).append(relative_error(case, spans))
    failed = sum(case.failed for case in cases)
    return Trial(failed, float(np.mean([np.median(values) for values in errors.values()])), settings)


def reference_spans(results: StudyResults) -> dict[str, float]:
    """Return by how much the reference of each output moves, in its display unit."""
    trace = next(case for case in results.cases if case.outcome is Outcome.COMPLETED).trace()
    spans = np.ptp(trace.reference, axis=0)
    return {v.name: float(span * v.shown_in.factor) for v, span in zip(trace.outputs, spans, strict=True)}


def relative_error(case: CaseResult, spans: Mapping[str, float]) -> float:
    """Return the RMSE in parts of the reference's span, mean over the outputs; infinite if it broke off."""
    rmse = {split_key(key)[1]: value for key, value in case.metrics.items() if split_key(key)[0] == "rmse"}
    completed = case.outcome is Outcome.COMPLETED
    return float(np.mean([rmse[output] / span for output, span in spans.items()])) if completed else np.inf


def main(name: str, out: Path, jobs: int, shown: int) -> None:
    """Run a study's trials, those that are not there yet, and print each controller's best as TOML."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{name}-tuning.toml"
    file.write_text(tomli_w.dumps(sweep_study(name)), encoding="utf-8")
    with LineProgress(sys.stderr) as progress:
        results = run_study(read_study(str(file)), out, Selection(jobs), progress)
    for controller, tried in trials(results, read_grid(name)).items():
        for trial in tried[:shown]:
            print(
                f"# {controller}: runs failed {trial.failed}, error {trial.error:.4g}, settings {len(tried)}"
            )
            print(tomli_w.dumps({"controllers": {controller: {"settings": trial.settings}}}))
