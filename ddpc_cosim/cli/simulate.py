"""``ddpc-cosim simulate``."""

import re
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

from ddpc_cosim.cli.init import assignments
from ddpc_cosim.cli.output import say, screen, terminal_table
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.csv_files import CSVFile
from ddpc_cosim.errors import ConfigError, CosimWarning, DataError
from ddpc_cosim.plant import FMIType
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.processes.sandbox import demanded
from ddpc_cosim.simulation import Simulation, run
from ddpc_cosim.simulation.request import Request, overwrites, prepare
from ddpc_cosim.tables import Cell, Heading, Row, Table, text_headings
from ddpc_cosim.texts import printable

# A comma between names: those of indices are part of a name.
_COMMA = re.compile(r",(?![^\[(]*[\])])")
_SUFFIXES = (".csv", ".html", ".svg")


def simulate_command(
    plant: str,
    inputs: Path | None,
    values: Sequence[str],
    stop: float | None,
    step: float | None,
    outputs: Sequence[str],
    out: Sequence[Path],
    golden: Path | None,
    rel: float,
    fmi_type: FMIType,
    step_timeout: float,
    trace_calls: Path | None,
    sandbox: bool,
) -> int:
    """Simulate, write what is asked for, print a summary, and return the exit code.

    Raises
    ------
    KeyboardInterrupt
        It was interrupted; what was simulated until then is written, and told.
    """
    read = [Path(plant), *(path for path in (inputs, golden) if path is not None)]
    faults = [fault for path in out if (fault := _impossible(path, read))]
    files, given = dict[str, CSVFile | None](), dict[str, str]()
    try:
        given = assignments("--set", values, str)
    except ConfigError as error:
        faults += error.faults
    for option, path in (("inputs", inputs), ("compare", golden)):
        try:
            files[option] = None if path is None else CSVFile(path)
        except DataError as error:
            faults += error.faults
    if faults:
        raise ConfigError(faults)
    request = Request(
        plant=plant,
        inputs=files["inputs"],
        values=given,
        stop=stop,
        step=step,
        outputs=[name.strip() for text in outputs for name in _COMMA.split(text)] or None,
        fmi_type=fmi_type,
        step_timeout=step_timeout,
        trace_calls=str(trace_calls or ""),
        golden=files["compare"],
    )
    code = 0
    try:
        with warnings.catch_warnings(), shown(f"simulate {plant}") as progress:
            warnings.simplefilter("ignore", CosimWarning)  # they are among the notes
            with demanded(sandbox):
                prepared = prepare(request)
            simulation = run(prepared, progress.update, sandboxed=sandbox)
    except KeyboardInterrupt:
        print("interrupted before the first sample: nothing is written", file=sys.stderr)
        raise
    for path in out:
        _write(simulation, path)
    difference = simulation.compare(prepared, rel)
    _print(simulation)
    for path in out:
        print(printable(str(path)))
    if difference is not None:
        say(difference.words)
        code = 0 if difference.agrees else 1
    if not simulation.completed:
        say(f"{simulation.plant}: {simulation.outcome}: {simulation.reason}", err=True)
    if simulation.interrupted_by is not None:
        raise simulation.interrupted_by
    return 1 if simulation.failed else code


def _impossible(path: Path, read: Sequence[Path]) -> str:
    """Return why a file cannot be written; empty if it can be tried."""
    if path.suffix not in _SUFFIXES:
        return f"--out {path}: the name must end in {', '.join(_SUFFIXES)}"
    if not path.parent.is_dir():
        return f"--out {path}: no such folder: {path.parent}"
    fault = overwrites(path, read)
    return f"--out {fault}" if fault else ""


def _write(simulation: Simulation, path: Path) -> None:
    try:
        if path.suffix == ".csv":
            simulation.write_csv(path)
        else:
            load_plugin("reports", "simulation")(simulation, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from error


def _print(simulation: Simulation) -> None:
    """Print notes and, of each signal, its values at the start and at the end, and its range."""
    for note in simulation.notes:
        say(f"note: {note}", err=True)
    title = f"{simulation.plant}: {len(simulation.time)} of {simulation.planned_samples} samples"
    if len(simulation.time):
        title += (
            f", {simulation.time[0]:g} s to {simulation.time[-1]:g} s, every {simulation.sampling_time:g} s"
        )
    if not simulation.completed:
        title += f" ({simulation.outcome})"
    say(title)
    rows = [(v, simulation.y[:, i], "") for i, v in enumerate(simulation.outputs)]
    rows += [(v, simulation.u[:, i], " (input)") for i, v in enumerate(simulation.inputs)]
    lines = []
    for variable, values, kind in rows:
        found = (values[0], values.min(), values.max(), values[-1]) if len(values) else ()
        cells = [f"{value:.6g}" for value in found] or ["-"] * 4
        lines.append(Row(variable.name + kind, tuple(map(Cell, [*cells, variable.unit or "1"]))))
    (signal, unit), figures = text_headings("signal", "unit"), map(Heading, ("start", "min", "max", "end"))
    screen().print(terminal_table(Table("", "", (signal, *figures, unit), tuple(lines)), ruled=True))
