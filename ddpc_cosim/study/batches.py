"""Many cases in one file: their figures without their samples, which running one of them again makes anew.

A batch holds what the ``run.json`` of each of its cases would say; what all of them say stands there once.
Its name is the hash of its content.
"""

import gzip
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

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
_GZIP = 16 + zlib.MAX_WBITS


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
    content = gzip.compress(sealed_json({_COMMON: common, _RUNS: rest}), 6, mtime=0)
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
    try:
        text = zlib.decompressobj(_GZIP).decompress(content, _LONGEST + 1)
    except zlib.error as error:
        raise ValueError(f"{path.name}: {error}") from error
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


class _Kept(NamedTuple):
    """A case, what its figures depend on besides its samples, and the batch that it is in."""

    result: CaseResult
    settings: dict[str, Any]
    batch: Path


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
        self._kept: dict[str, _Kept] = {}
        self._left: Counter[Path] = Counter()
        for path in sorted(folder.glob(f"{_NAME}*{_SUFFIX}"), key=_written):
            with suppress(*DAMAGED):
                self._keep(self._read(path, path))

    def load(self, case_id: str) -> CaseResult:
        """Return a case, as its own files tell of it where it has some; errors as of :func:`load_case`."""
        place = self.folder / case_id
        return self[case_id] if case_id in self and not place.exists() else load_case(place)

    def __getitem__(self, case_id: str) -> CaseResult:
        return self._kept[case_id].result

    def __iter__(self) -> Iterator[str]:
        return iter(self._kept)

    def __len__(self) -> int:
        return len(self._kept)

    def is_valid(self, case_id: str, settings: MetricSettings) -> bool:
        """Whether a case is there, would end the same again, and its figures depend on these settings."""
        kept = self._kept.get(case_id)
        return kept is not None and not kept.result.transient and kept.settings == asdict(settings)

    def accept(self, staged: Path, heads: Sequence[dict[str, Any]]) -> list[CaseResult]:
        """Move a batch that a process has staged to where its cases belong, if it has those; return them.

        A batch of which no case counts any more is removed.

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
            cases = self._read(staged, path, heads)
            staged.replace(path)
        except DAMAGED as error:
            raise CosimError(f"a batch of cases cannot be kept: {error}") from error
        for older in self._keep(cases):
            if not self._left[older]:
                older.unlink(missing_ok=True)
        return [kept.result for kept in cases]

    def _read(self, path: Path, place: Path, heads: Sequence[dict[str, Any]] | None = None) -> list[_Kept]:
        """Return what is in a file that belongs in a place; raises an error of what is damaged."""
        runs = read_batch(path)
        for run, head in zip(runs, runs if heads is None else heads, strict=True):
            if any(run[key] != value for key, value in head.items()):
                raise ValueError(f"{path.name} is of case {run['id']}, not {head['id']}")
        return [
            _Kept(result_of_run(run, self.folder / run["id"], batched=True), run["metric_settings"], place)
            for run in runs
        ]

    def _keep(self, cases: Iterable[_Kept]) -> set[Path]:
        """Have cases count in place of those of the same ids; return the batches that these are in."""
        older = set()
        for kept in cases:
            if before := self._kept.get(kept.result.id):
                self._left[before.batch] -= 1
                older.add(before.batch)
            self._kept[kept.result.id] = kept
            self._left[kept.batch] += 1
        return older
