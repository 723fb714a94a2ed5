"""Many cases in one file: their figures without their samples, which running one of them again makes anew.

A batch holds what the ``run.json`` of each of its cases would say; what all of them say stands there once.
Its name is the hash of its content.
"""

import gzip
import os
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ddpc_cosim.errors import CosimError
from ddpc_cosim.study.case_columns import in_columns, kept_with
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


def read_batch(path: Path, known: dict[str, Any] | None = None) -> list[dict[str, Any]]:
    """Return what there is to say of each run of a file.

    Parameters
    ----------
    path : Path
        The file.
    known : dict of str to any, optional
        What the runs of other files have in common, which equal values of this one are then.

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
    known = {} if known is None else known
    common = {key: known.setdefault(repr(value), value) for key, value in batch[_COMMON].items()}
    return [common | run for run in batch[_RUNS]]


def _written(path: Path) -> int:
    """Return when a file was written; another run may have removed it meanwhile."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


_PATH, _SETTINGS = "path", "metric_settings"
"""What is kept with a case: its batch, and what its figures depend on besides its samples."""


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
        self._kept: dict[str, CaseResult] = {}
        self._left: Counter[Path] = Counter()
        self._known: dict[str, Any] = {}
        for path in sorted(folder.glob(f"{_NAME}*{_SUFFIX}"), key=_written):
            with suppress(*DAMAGED):
                self._keep(self._read(path, path))

    def alone(self) -> set[str]:
        """Return the names of what is there by itself: the ids of cases that have files of their own."""
        with suppress(FileNotFoundError), os.scandir(self.folder) as entries:
            return {entry.name for entry in entries}
        return set()

    def take(self, case_id: str, alone: Collection[str]) -> CaseResult:
        """Return a case, as its own files tell of it where it is alone; errors as of :func:`load_case`.

        It is not held here any longer.
        """
        kept = self._kept.pop(case_id, None)
        return load_case(self.folder / case_id) if kept is None or case_id in alone else kept

    def __getitem__(self, case_id: str) -> CaseResult:
        return self._kept[case_id]

    def __iter__(self) -> Iterator[str]:
        return iter(self._kept)

    def __len__(self) -> int:
        return len(self._kept)

    def is_valid(self, case_id: str, settings: dict[str, Any]) -> bool:
        """Whether a case is there, would end the same again, and its figures depend on these settings."""
        case = self._kept.get(case_id)
        return case is not None and not case.transient and kept_with(case, _SETTINGS) == settings

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
        return cases

    def _read(
        self, path: Path, place: Path, heads: Sequence[dict[str, Any]] | None = None
    ) -> list[CaseResult]:
        """Return what is in a file that belongs in a place; raises an error of what is damaged."""
        runs = read_batch(path, self._known)
        for run, head in zip(runs, runs if heads is None else heads, strict=True):
            if any(run[key] != value for key, value in head.items()):
                raise ValueError(f"{path.name} is of case {run['id']}, not {head['id']}")
        cases = (result_of_run(run, self.folder, batched=True) for run in runs)
        settings = [run["metric_settings"] for run in runs]
        return in_columns(cases, self.folder, **{_PATH: [place] * len(runs), _SETTINGS: settings})

    def _keep(self, cases: Iterable[CaseResult]) -> set[Path]:
        """Have cases count in place of those of the same ids; return the batches that these are in."""
        older = set()
        for case in cases:
            if before := self._kept.get(case.id):
                self._left[kept_with(before, _PATH)] -= 1
                older.add(kept_with(before, _PATH))
            self._kept[case.id] = case
            self._left[kept_with(case, _PATH)] += 1
        return older
