"""What a run would take, told before it is begun: cases, time by what has been run, bytes."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.durations import about
from ddpc_cosim.study.case_files import DAMAGED, DOING_NOTHING, RUN_FILE, read_run
from ddpc_cosim.study.results import CASES_FOLDER

if TYPE_CHECKING:
    from ddpc_cosim.study.cases import Case
    from ddpc_cosim.study.resolve import ResolvedProblems
    from ddpc_cosim.study.runner import Progress, Selection

# Of so many cases that have been run the times are read; reading a case takes a millisecond.
_MOST_READ = 300
# Of a case's run.json; of a number of signals.csv; of a row's time, status and computation time.
_RUN_BYTES, _NUMBER_BYTES, _REST_OF_ROW = 3_500, 17, 30
# Of a column of signals.parquet; of a cell, which repeats in part what stands above it.
_COLUMN_BYTES, _CELL_BYTES = 200, 3


def expected(resolved: "ResolvedProblems", folder: Path, selection: "Selection", progress: "Progress") -> str:
    """Return how many cases a run would have, about how long they would take, and how many bytes they have.

    The time is that of cases of the same problem and controller that have been run into the folder, with
    whatever settings; of the same problem where there are none.

    Raises
    ------
    ConfigError
        No case is selected.
    """
    from ddpc_cosim.study.cases import doing_nothing
    from ddpc_cosim.study.runner import selected_cases

    chosen = selected_cases(resolved, selection, progress)[1]
    cases = selection.part_of([*chosen, *doing_nothing(chosen)])
    there = _names_in(folder / CASES_FOLDER)
    missing = [case for case in cases if selection.fresh or case.id not in there]
    kept = len(cases) - len(missing)
    resting = sum(case.controller == DOING_NOTHING for case in cases)
    lines = [
        f"{_counted(len(cases) - resting, 'case')} and {_counted(resting, 'run')} of doing nothing: "
        f"{len(missing)} to run, {kept} already there (a damaged one is run again)"
    ]
    if missing:
        base = {
            ("" if name == resolved.head.name else name, key): section.variant_of or key
            for name, problem in resolved.problems.items()
            for key, section in problem.study.controllers.items()
        }
        lines += [_time(missing, base, folder / CASES_FOLDER, there, selection.jobs)]
        lines.append(_size(missing, selection.storage))
    return "\n".join(lines)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun if number == 1 else f'{noun}s'}"


def _names_in(folder: Path) -> set[str]:
    try:
        return {path.name for path in folder.iterdir() if (path / RUN_FILE).is_file()}
    except OSError:
        return set()


def _time(
    missing: Sequence["Case"],
    base: dict[tuple[str, str], str],
    folder: Path,
    there: Iterable[str],
    jobs: int,
) -> str:
    """Say how long the cases that are missing would take."""
    times: dict[tuple[str, str], list[float]] = {}
    names = sorted(there)
    for name in islice(names, 0, None, 1 + len(names) // _MOST_READ):
        try:
            run = read_run(folder / name)
            problem, controller, seconds = run["problem"], run["controller"], float(run["wall_time"])
        except (ConfigError, *DAMAGED):
            continue
        if math.isfinite(seconds):
            times.setdefault((problem, base.get((problem, controller), controller)), []).append(seconds)
            if controller != DOING_NOTHING:  # which takes less time than any other
                times.setdefault((problem, ""), []).append(seconds)
    total, unknown = 0.0, Counter[str]()
    for case in missing:
        base_controller = base.get((case.problem, case.controller), case.controller)
        known = times.get((case.problem, base_controller)) or times.get((case.problem, ""))
        if known:
            total += fmean(known)
        else:
            unknown[case.problem] += 1
    if unknown.total() == len(missing):
        return "time: not known, as none of them has been run"
    which = f"; not known of {unknown.total()} cases, of which none like them has been run" if unknown else ""
    workers = f"{jobs} {'worker' if jobs == 1 else 'workers'}"
    return f"time: about {about(total / jobs)} with {workers}, by the cases already run{which}"


def _size(missing: Sequence["Case"], storage: str) -> str:
    """Say how many bytes the cases that are missing would have."""
    size = 0.0
    for case in missing:
        signals = 2 * len(case.outputs) + len(case.measurements) + len(case.inputs) + len(case.changed_inputs)
        rows = round(case.duration / case.sampling_time) + 1
        if storage == "parquet":
            size += _RUN_BYTES + (signals + 3) * (_COLUMN_BYTES + rows * _CELL_BYTES)
        else:
            size += _RUN_BYTES + rows * (_REST_OF_ROW + signals * _NUMBER_BYTES)
    factor, unit = next(
        ((f, unit) for f, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")) if size >= f), (1.0, "bytes")
    )
    return f"size: about {size / factor:.3g} {unit}"
