"""One case on disk: ``run.json`` and ``signals.csv`` in a folder of its own, written whole or not at all."""

import csv
import json
import os
import shutil
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim.controller import Bounds
from ddpc_cosim.errors import CosimError
from ddpc_cosim.trace import Outcome, Trace
from ddpc_cosim.variables import DisplayUnit, FloatArray, Variable


def write_case(folder: Path, trace: Trace, head: dict[str, Any], drafts: Path | None = None) -> None:
    """Write a case's folder in one move, replacing an older one.

    Parameters
    ----------
    folder : Path
        The case's folder.
    trace : Trace
        What the run left behind.
    head : dict
        What the case is: id, controller, scenario, seed, ...
    drafts : Path, optional
        Where it stands until it is complete, on the same disk; default: beside the folder.

    Raises
    ------
    CosimError
        It cannot be written, and why; an older one is kept.
    """
    run = head | {
        "outcome": trace.outcome.value,
        "reason": trace.reason,
        "metrics": trace.metrics(),
        "diagnostics": trace.diagnostics,
        "settings": trace.settings,
        "sampling_time": trace.sampling_time,
        "planned_samples": trace.planned_samples,
        "inputs": [asdict(v) for v in trace.inputs],
        "outputs": [asdict(v) for v in trace.outputs],
        "measurements": [asdict(v) for v in trace.measurements],
        "bounds": {
            name: getattr(trace.bounds, name).tolist() for name in ("u_min", "u_max", "y_min", "y_max")
        },
        "provenance": trace.provenance,
    }
    draft = (drafts or folder.parent) / f".{folder.name}.{os.getpid()}"
    shutil.rmtree(draft, ignore_errors=True)  # of a process of the same number that died here
    try:
        draft.mkdir(parents=True)
        (draft / "run.json").write_text(json.dumps(_finite(run), indent=1) + "\n", encoding="utf-8")
        _write_signals(draft / "signals.csv", trace)
        _move_into_place(draft, folder)
    except OSError as error:
        reason = error.strerror or str(error)
        raise CosimError(f"{folder}: cannot be written: {reason}; finished cases are kept") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _move_into_place(draft: Path, folder: Path) -> None:
    """Put a complete draft in the place of its folder, while other runs may do the same."""
    older = draft.with_name(f"{draft.name}.older")
    with suppress(FileNotFoundError):
        folder.replace(older)  # quicker than removing it: hardly a moment without a case
    try:
        draft.replace(folder)
    except OSError:
        if not (folder / "run.json").is_file():
            with suppress(FileNotFoundError):
                older.replace(folder)
            raise
        # Another run has just written the same case, and what decides its result is the same.
    shutil.rmtree(older, ignore_errors=True)


def write_whole(path: Path, text: str) -> None:
    """Write a text file in one move, so that nobody ever finds half of it."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.write_text(text, encoding="utf-8", newline="")
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def read_run(folder: Path) -> dict[str, Any]:
    """Return ``run.json`` of a case."""
    run: dict[str, Any] = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    run["metrics"] = {name: float(value) for name, value in run["metrics"].items()}
    run["diagnostics"] = {name: float(value) for name, value in run["diagnostics"].items()}
    return run


def read_trace(folder: Path) -> Trace:
    """Return the trace that :func:`write_case` wrote."""
    run = read_run(folder)
    inputs, outputs, measurements = (
        [_variable(v) for v in run[key]] for key in ("inputs", "outputs", "measurements")
    )
    columns, status = _read_signals(folder / "signals.csv")

    def table(variables: list[Variable], prefixes: tuple[str, ...] = ("",)) -> FloatArray:
        found = [
            next(columns[header] for p in prefixes if (header := p + v.header) in columns) for v in variables
        ]
        return np.column_stack(found) if found else np.empty((len(status), 0))

    return Trace(
        time=columns["time [s]"],
        reference=table(outputs, ("reference ",)),
        y=table(outputs, ("output ", "")),
        measured=table(measurements, ("measured ", "")),
        u=table(inputs, ("input ", "")),
        status=status,
        solve_time=columns["solve_time [s]"],
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        measurements=tuple(measurements),
        bounds=Bounds(**{name: np.array(values, dtype=float) for name, values in run["bounds"].items()}),
        sampling_time=run["sampling_time"],
        planned_samples=run["planned_samples"],
        outcome=Outcome(run["outcome"]),
        reason=run["reason"],
        settings=run["settings"],
        diagnostics=run["diagnostics"],
        provenance=run["provenance"],
    )


def _write_signals(path: Path, trace: Trace) -> None:
    columns = trace.columns()
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*columns, "status"])
        # The shortest text that gives the same number again.
        cells = [map(repr, column.tolist()) for column in columns.values()]
        writer.writerows(zip(*cells, trace.status, strict=True))


def _read_signals(path: Path) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    cells = list(zip(*rows, strict=True)) or [()] * len(header)
    columns = {name: np.array(column, dtype=float) for name, column in zip(header[:-1], cells, strict=False)}
    return columns, tuple(cells[-1])


def _variable(stored: dict[str, Any]) -> Variable:
    shown = stored["display_unit"]
    numbers = {key: float(stored[key]) for key in ("min", "max", "nominal", "start")}
    return Variable(**{**stored, **numbers, "display_unit": DisplayUnit(**shown) if shown else None})


def _finite(value: Any) -> Any:
    """Return JSON's version of a value: infinity and NaN, which JSON lacks, as text that ``float`` reads."""
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _finite(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return repr(value)
    return value if isinstance(value, str | int | float | bool | None) else repr(value)
