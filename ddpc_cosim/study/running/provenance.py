"""Where results come from: what was run, by which code, on what machine, and how to have it again."""

import os
import platform
import shlex
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from itertools import groupby
from math import fsum, isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.texts import recorded
from ddpc_cosim.plugins import package_of, package_version, types_in
from ddpc_cosim.study.case_files import CaseResult, checksum, read_run
from ddpc_cosim.study.plants import PlantSpec
from fmu_plants.commands import captured

if TYPE_CHECKING:  # a worker, which runs cases, does without what reads studies
    from ddpc_cosim.study.file_format.study_files import StudyFile

_VERSIONS_OF = ("numpy", "scipy", "FMPy", "piqp", "sympy", "control", "casadi", "daqp")
_GIT_SECONDS = 2.0
_RESOLVED = "study.toml"
"""What a study is called that was made without a file: the results have it."""


def facts_of_problem(results: Sequence[CaseResult], spec: PlantSpec, preview: int) -> dict[str, str]:
    """Return what is to be said of one problem's plant."""
    # A case that failed before its first sample does not know its plant.
    plant = next(filter(None, map(_plant_of, results)), {})
    facts = {
        **{key.replace("_", " "): value for key, value in plant.items()},
        "plant content": spec.content,
        "largest preview": f"{preview} samples",
    }
    return {name: recorded(fact) for name, fact in facts.items()}


def _plant_of(result: CaseResult) -> dict[str, str]:
    """Return what a case knows of its plant; nothing if it cannot be read any more."""
    try:
        known: dict[str, str] = read_run(result.folder)["provenance"]
    except ConfigError:
        return {}
    return known


def facts_of_run(
    results: Sequence[CaseResult], file: "StudyFile", options: Sequence[str], workers: str, took: str
) -> dict[str, str]:
    """Return what is to be said of a run.

    Parameters
    ----------
    results : sequence of CaseResult
        All cases.
    file : StudyFile
        The study as it was read.
    options : sequence of str
        Those of ``run`` that decide which cases there are, and whether they are sandboxed.
    workers : str
        How many workers of this machine ran them; "dask" for those of a cluster.
    took : str
        How long it took, in words.
    """
    seconds = fsum(filter(isfinite, (result.wall_time for result in results)))
    facts = {
        "sandbox": _sandboxes(results),
        "engine": _engines(results),
        "ddpc-cosim commit": commit_of(Path(__file__)),
        **{f"{name} version": version for name, version in versions().items()},
        "plug-ins": ", ".join(_plugins_of(file)),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "cpu": "of dask workers, not recorded" if workers == "dask" else _cpu(),
        "workers": workers,
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "run again": shlex.join(["ddpc-cosim", "run", Path(file.source).name or _RESOLVED, *options]),
        **_facts_of_file(file),
        "wall time": took,
        "time of all cases": f"{seconds:.3g} s, one after another",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    return {name: recorded(fact) for name, fact in facts.items() if fact}


def seed_ranges(seeds: Iterable[int]) -> str:
    """Write seeds as ``--seeds`` takes them: ``0:30,5489``."""
    runs = [[seed for _, seed in run] for _, run in groupby(enumerate(seeds), lambda pair: pair[1] - pair[0])]
    return ",".join(str(run[0]) if len(run) == 1 else f"{run[0]}:{run[-1] + 1}" for run in runs)


def commit_of(file: Path) -> str:
    """Return the commit of the repository that holds a file, and whether anything was changed since.

    Empty where no repository holds it, or git is not there or does not answer in time.
    """
    if not any((folder / ".git").exists() for folder in file.resolve().parents):
        return ""
    # Another repository's, as git sets them for its hooks; nothing is written, and nothing else is started.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    environment["GIT_OPTIONAL_LOCKS"] = "0"

    def git(*words: str) -> str:
        command = ["git", "-C", str(file.resolve().parent), "-c", "core.fsmonitor=false", *words]
        done = captured(command, _GIT_SECONDS, env=environment)
        done.check_returncode()
        return done.stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "--", file.name)
        description = git("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    except (OSError, subprocess.SubprocessError):
        return ""
    commit = description.removesuffix("-dirty")
    return f"{commit}, {'clean' if commit == description else 'with changes that are not committed'}"


def _facts_of_file(file: "StudyFile") -> dict[str, str]:
    """Return what is to be said of the file or the plug-in that a study was read from; nothing of another."""
    if not file.source:
        return {}
    if package := package_of("studies", file.source):
        return {"study": f"{file.source}, of {package}"}
    path = Path(file.source)
    try:
        content = checksum(path.read_bytes())
    except OSError:  # it was there before the run
        content = ""
    return {"study file": file.source, "study file sha256": content, "study file commit": commit_of(path)}


@cache  # in the process that workers are forked from
def versions() -> dict[str, str]:
    """Return the versions of what decides figures: this program, Python, and the packages that there are."""
    installed = {"ddpc-cosim": package_version(), "python": platform.python_version()}
    for name in _VERSIONS_OF:
        with suppress(metadata.PackageNotFoundError):
            installed[name.lower()] = metadata.version(name)
    return installed


def _plugins_of(file: "StudyFile") -> list[str]:
    """Return the packages of others that the study's controllers come from."""
    packages = {package_of("controllers", name) for name in types_in(file.tables)}
    return sorted(packages - {"", f"ddpc-cosim {package_version()}"})


def _sandboxes(results: Sequence[CaseResult]) -> str:
    """Return in words how many cases ran in which sandbox."""
    counts = Counter(result.sandbox for result in results)
    if list(counts) == [""]:
        return "none"
    return "; ".join(f"{count} of {len(results)} cases: {words or 'none'}" for words, count in counts.items())


def _engines(results: Sequence[CaseResult]) -> str:
    """Return in words how many cases were computed by what; empty where all were by Python, as is usual."""
    counts = Counter(result.engine or "python" for result in results)
    if counts.keys() <= {"python"}:
        return ""
    return "; ".join(f"{count} of {len(results)} cases: {words}" for words, count in counts.most_common())


def _cpu() -> str:
    """Return the processor's name and count; Linux tells it only in a file."""
    name = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text(encoding="utf-8", errors="replace").splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    return f"{name or 'unknown'}, {os.cpu_count()} logical processors"
