"""The results of a study on disk, read back for reports and for people."""

import csv
import hashlib
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ddpc_cosim.config import Study
from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.storage import read_run, read_trace, write_whole
from ddpc_cosim.trace import Outcome, Trace

STUDY_FILE, PROVENANCE_FILE, METRICS_FILE, CASES_FOLDER = (
    "study.toml",
    "provenance.json",
    "metrics.csv",
    "cases",
)


# What reading a file raises that somebody has cut off or changed.
_DAMAGED = (OSError, ValueError, KeyError, TypeError, AttributeError, StopIteration)


@dataclass(frozen=True, slots=True)
class CaseResult:
    """One case: what it was, how it ended, and its figures.

    Parameters
    ----------
    id : str
        Readable name and hash; the name of its folder.
    controller, label : str
        The controller's name in the study and in reports.
    scenario : str
        The scenario's name.
    seed : int
        The seed.
    outcome : Outcome
        How the run ended.
    reason : str
        Why it ended early; empty if completed.
    metrics, diagnostics : dict of str to float
        Figures of the run, and of the controller's data or model.
    settings : dict
        The controller's settings, defaults filled in.
    folder : Path
        Where its files are.
    """

    id: str
    controller: str
    label: str
    scenario: str
    seed: int
    outcome: Outcome
    reason: str
    metrics: dict[str, float]
    diagnostics: dict[str, float]
    settings: dict[str, Any]
    folder: Path

    def trace(self) -> Trace:
        """Read the samples of the run.

        Raises
        ------
        ConfigError
            The files are missing or damaged.
        """
        try:
            return read_trace(self.folder)
        except _DAMAGED as error:
            raise ConfigError(
                f"{self.folder}: the samples cannot be read ({error!r}); run the study again"
            ) from error


@dataclass(frozen=True, slots=True)
class StudyResults:
    """The results of one study.

    Parameters
    ----------
    folder : Path
        The folder of results.
    study : Study
        The resolved study.
    cases : tuple of CaseResult
        In the study's order: controllers x scenarios x seeds.
    provenance : dict of str to str
        Versions, machine, plant, command, date.
    """

    folder: Path
    study: Study
    cases: tuple[CaseResult, ...]
    provenance: dict[str, str]


def load_results(folder: str | Path) -> StudyResults:
    """Read a folder of results.

    Raises
    ------
    ConfigError
        The folder holds no results, or they cannot be read, and why.
    """
    import tomllib

    folder = Path(folder)
    if not (folder / STUDY_FILE).is_file():
        raise ConfigError(f"{folder}: no results: {STUDY_FILE} is missing; give the folder that `run` wrote")
    try:
        study = Study.model_validate(tomllib.loads((folder / STUDY_FILE).read_text(encoding="utf-8")))
        provenance = json.loads((folder / PROVENANCE_FILE).read_text(encoding="utf-8"))
        case_ids = list(provenance.pop("cases"))
    except _DAMAGED as error:
        raise ConfigError(f"{folder}: results cannot be read: {error}; run the study again") from error
    return StudyResults(folder, study, load_cases(folder, study, case_ids), provenance)


def load_cases(folder: Path, study: Study, case_ids: Iterable[str]) -> tuple[CaseResult, ...]:
    """Read cases of a study, labelled as it labels them now: a label does not decide a result.

    Raises
    ------
    ConfigError
        The files of a case are missing or damaged.
    """
    cases = [load_case(folder / CASES_FOLDER / case_id) for case_id in case_ids]
    labels = {name: section.label or name for name, section in study.controllers.items()}
    return tuple(replace(case, label=labels.get(case.controller, case.label)) for case in cases)


def load_case(folder: Path) -> CaseResult:
    """Read one case.

    Raises
    ------
    ConfigError
        Its files are missing or damaged.
    """
    try:
        run = read_run(folder)
        head = {key: run[key] for key in ("id", "controller", "label", "scenario", "seed", "reason")}
        figures = {key: run[key] for key in ("metrics", "diagnostics", "settings")}
        return CaseResult(**head, **figures, outcome=Outcome(run["outcome"]), folder=folder)
    except _DAMAGED as error:
        raise ConfigError(f"{folder}: this case cannot be read ({error!r}); run the study again") from error


def study_hash(study: Study) -> str:
    """Return a hash of everything that a study says, defaults filled in."""
    return hashlib.sha256(study.model_dump_json().encode()).hexdigest()


def write_results(
    folder: Path, study: Study, cases: Sequence[CaseResult], provenance: dict[str, str]
) -> None:
    """Write ``study.toml``, ``metrics.csv`` and ``provenance.json`` beside the cases.

    Raises
    ------
    CosimError
        They cannot be written, and why.
    """
    import tomli_w

    content = study.model_dump(mode="python", exclude_none=True)
    facts: dict[str, Any] = {**provenance, "cases": [case.id for case in cases]}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / STUDY_FILE, tomli_w.dumps(content))
        write_whole(folder / PROVENANCE_FILE, json.dumps(facts, indent=1) + "\n")
        write_whole(folder / METRICS_FILE, _metrics_table(study, cases))
    except OSError as error:
        reason = error.strerror or str(error)
        raise CosimError(f"{folder}: results cannot be written: {reason}; finished cases are kept") from error


def _metrics_table(study: Study, cases: Sequence[CaseResult]) -> str:
    """Return ``metrics.csv``."""
    keys = list(dict.fromkeys(key for case in cases for key in case.metrics))
    plant = study.plant.name or Path(study.plant.fmu).name
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["study", "plant", "controller", "scenario", "seed", "outcome", *keys])
    for case in cases:
        values = [case.metrics.get(key, math.nan) for key in keys]
        cells = ["" if math.isnan(value) else repr(value) for value in values]
        writer.writerow([study.name, plant, case.controller, case.scenario, case.seed, case.outcome, *cells])
    return file.getvalue()
