"""Running a study: prepare the plant, run what is not there yet, write what is known of all cases."""

import os
import platform
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Protocol

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plugins import package_version
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.executors import Update, run_cases
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.resolve import ResolvedStudy
from ddpc_cosim.study.results import (
    CASES_FOLDER,
    CaseResult,
    StudyResults,
    load_case,
    load_cases,
    read_run,
    study_hash,
    write_results,
)
from ddpc_cosim.study.sections import Study
from ddpc_cosim.trace import Outcome

_VERSIONS_OF = ("numpy", "scipy", "FMPy", "piqp", "sympy")
# These may end differently next time: only a result that would come out the same is kept.
_TRANSIENT = (Outcome.CRASHED, Outcome.TIMED_OUT)


class Progress(Protocol):
    """What follows a run of cases."""

    def start(self, total: int, kept: int) -> None:
        """``total`` cases are to be run; ``kept`` more are there from before."""

    def update(self, update: Update) -> None:
        """Take note of a running case."""

    def finished(self, case: Case, result: CaseResult) -> None:
        """Take note of a case that is done."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Which cases to run, and how.

    Parameters
    ----------
    jobs : int
        Number of worker processes.
    seeds : list of int
        In place of the study's; empty: the study's.
    only : str
        Glob pattern of case or controller names.
    fresh : bool
        Run cases again that already exist.
    """

    jobs: int = 1
    seeds: list[int] = field(default_factory=list)
    only: str = "*"
    fresh: bool = False


def run_study(
    resolved: ResolvedStudy, folder: Path, selection: Selection, progress: Progress
) -> StudyResults:
    """Run a study's cases into a folder and return the results.

    Cases that are there from an earlier run and whose settings, FMU, seed and code are the same are kept. If
    the run is interrupted, the cases that were finished stay; the same call goes on from there.

    Raises
    ------
    ConfigError
        No case is selected, or the folder cannot be written to.
    """
    plant = resolved.plant.built()
    cases = cases_of(resolved, plant, selection.seeds, selection.only)
    cases_folder = folder / CASES_FOLDER
    try:
        cases_folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: results cannot be written there: {error.strerror}") from error
    missing = [case for case in cases if selection.fresh or not _is_there(cases_folder / case.id)]
    progress.start(len(missing), len(cases) - len(missing))
    for case in run_cases(missing, cases_folder, selection.jobs, progress.update) if missing else ():
        progress.finished(case, load_case(cases_folder / case.id))
    study = resolved.study.model_copy(update={"seeds": selection.seeds or resolved.study.seeds})
    results = load_cases(folder, study, [case.id for case in cases])
    provenance = _provenance(results, plant, selection, study)
    write_results(folder, study, results, provenance)
    return StudyResults(folder, study, results, provenance)


def _is_there(folder: Path) -> bool:
    """Whether a case need not be run: one whose files are damaged is run again."""
    try:
        return load_case(folder).outcome not in _TRANSIENT
    except ConfigError:
        return False


def _provenance(
    results: Sequence[CaseResult], spec: PlantSpec, selection: Selection, study: Study
) -> dict[str, str]:
    # A case that failed before its first sample does not know its plant.
    known: Iterator[dict[str, str]] = (read_run(result.folder)["provenance"] for result in results)
    plant = next(filter(None, known), {})
    versions = {f"{name.lower()} version": metadata.version(name) for name in _VERSIONS_OF}
    return {
        **{key.replace("_", " "): value for key, value in plant.items()},
        "plant content": spec.content,
        "study sha256": study_hash(study),
        "ddpc-cosim version": package_version(),
        "python version": platform.python_version(),
        **versions,
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "cpu": _cpu(),
        "workers": str(selection.jobs),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _cpu() -> str:
    """Return the processor's name and count; Linux tells it only in a file."""
    name = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text(encoding="utf-8", errors="replace").splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    return f"{name or 'unknown'}, {os.cpu_count()} logical processors"
