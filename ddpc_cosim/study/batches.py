"""Many cases in one file: their figures without their samples, which running one of them again makes anew.

A batch holds what the ``run.json`` of each of its cases would say; what all of them say stands there once.
Its name is the hash of its content.
"""

import gzip
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

from ddpc_cosim.errors import CosimError
from ddpc_cosim.metrics import MetricSettings
from ddpc_cosim.study.case_files import (
    DAMAGED,
    CaseResult,
    checksum,
    load_case,
    parse_sealed,
    result_of_run,
    sealed_json,
)
from fmu_plants.files import write_through

_NAME, _SUFFIX = "batch-", ".json.gz"
_DIGITS = 24
_COMMON, _RUNS = "common", "runs"
_LONGEST = 1 << 28


def stage_batch(folder: Path, runs: Sequence[dict[str, Any]]) -> Path:
    """Write what there is to say of some runs into one file of a folder, and return it.

    Raises
    ------
    OSError
        It cannot be written.
    """
    first, *others = runs
    common = {key: value for key, value in first.items() if all(run.get(key) == value for run in others)}
    rest = [{key: value for key, value in run.items() if key not in common} for run in runs]
    content = gzip.compress(sealed_json({_COMMON: common, _RUNS: rest}), mtime=0)
    path = folder / f"{_NAME}{checksum(content)[:_DIGITS]}{_SUFFIX}"
    path.write_bytes(content)
    write_through(path)
    return path


def read_batch(path: Path) -> list[dict[str, Any]]:
    """Return what there is to say of each run of a file.

    Raises
    ------
    ValueError, OSError, KeyError, TypeError
        It does not hold what was written.
    """
    if path.is_symlink() or path.stat().st_size > _LONGEST:
        raise ValueError(f"{path.name} is not a file of its own")
    content = path.read_bytes()
    if path.name != f"{_NAME}{checksum(content)[:_DIGITS]}{_SUFFIX}":
        raise ValueError(f"{path.name} is not what was written: its checksum differs")
    with gzip.GzipFile(fileobj=BytesIO(content)) as file:
        text = file.read(_LONGEST + 1)
    if len(text) > _LONGEST:
        raise ValueError(f"{path.name} has more than {_LONGEST} bytes")
    batch = parse_sealed(text, path.name)
    return [batch[_COMMON] | run for run in batch[_RUNS]]


def _written(path: Path) -> int:
    """Return when a file was written; another run may have removed it meanwhile."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


class Batched(Mapping[str, CaseResult]):
    """The cases in the batches of a folder, by id, as their files would tell them; a damaged batch has none.

    Of a case in several the latest counts.

    Parameters
    ----------
    folder : Path
        The folder of cases. What is there of a case by itself is not looked at.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._cases: dict[str, CaseResult] = {}
        self._settings: dict[str, dict[str, Any]] = {}
        self._places: dict[str, list[Path]] = {}
        self._left: Counter[Path] = Counter()
        for path in sorted(folder.glob(f"{_NAME}*{_SUFFIX}"), key=_written):
            try:
                runs = read_batch(path)
                cases = self._results(runs)
            except DAMAGED:
                continue
            self._keep(path, runs, cases)

    def load(self, case_id: str) -> CaseResult:
        """Return a case, as its own files tell of it where it has some; errors as of :func:`load_case`."""
        place = self.folder / case_id
        return self._cases[case_id] if case_id in self._cases and not place.exists() else load_case(place)

    def __getitem__(self, case_id: str) -> CaseResult:
        return self._cases[case_id]

    def __iter__(self) -> Iterator[str]:
        return iter(self._cases)

    def __len__(self) -> int:
        return len(self._cases)

    def is_valid(self, case_id: str, settings: MetricSettings) -> bool:
        """Whether a case is there, would end the same again, and its figures depend on these settings."""
        if case_id not in self._cases:
            return False
        return not self._cases[case_id].transient and self._settings[case_id] == asdict(settings)

    def accept(self, staged: Path, heads: Sequence[dict[str, Any]]) -> list[CaseResult]:
        """Move a batch that a process has staged to where its cases belong, if it has those; return them.

        Parameters
        ----------
        staged : Path
            The file, on the same disk as the folder.
        heads : sequence of dict
            What each case is.

        Raises
        ------
        CosimError
            It has others, or cannot be moved.
        """
        path = self.folder / staged.name
        try:
            runs = read_batch(staged)
            for run, head in zip(runs, heads, strict=True):
                if any(run[key] != value for key, value in head.items()):
                    raise ValueError(f"{staged.name} is of case {run['id']}, not {head['id']}")
            cases = self._results(runs)
            staged.replace(path)
        except DAMAGED as error:
            raise CosimError(f"a batch of cases cannot be kept: {error}") from error
        for case in cases:
            self._forget(case.id)
        self._keep(path, runs, cases)
        return cases

    def _results(self, runs: Sequence[dict[str, Any]]) -> list[CaseResult]:
        return [result_of_run(run, self.folder / run["id"], batched=True) for run in runs]

    def _keep(self, path: Path, runs: Sequence[dict[str, Any]], cases: Sequence[CaseResult]) -> None:
        """Have the cases of a batch in place of those of the same ids that are there already."""
        self._left[path] = len(cases)
        for run, case in zip(runs, cases, strict=True):
            self._cases[case.id] = case
            self._settings[case.id] = run["metric_settings"]
            self._places.setdefault(case.id, []).append(path)

    def _forget(self, case_id: str) -> None:
        """Remove the batch of which a case, which has been run again, was the last one that counted."""
        for path in self._places.pop(case_id, ()):
            self._left[path] -= 1
            if not self._left[path]:
                path.unlink(missing_ok=True)
