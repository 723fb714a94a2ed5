"""``ddpc-cosim simulate``."""

import re
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ddpc_cosim.cli import options
from ddpc_cosim.cli.ending import exit_code
from ddpc_cosim.cli.options import FiniteRange, argument, assignments, command, names_of, option
from ddpc_cosim.cli.output import say, screen
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.errors import ConfigError, CosimWarning, DataError
from ddpc_cosim.files.texts import printable

if TYPE_CHECKING:
    from ddpc_cosim.simulation import Simulation
    from ddpc_cosim.simulation.request import SimulationRequest

# A comma between names: those of indices are part of a name.
_COMMA = re.compile(r",(?![^\[(]*[\])])")
_SUFFIXES = (".csv", ".html", ".svg")


@command
def simulate(
    plant: str = argument(metavar="FILE.fmu|FILE.ssp|PLANT", shell_complete=names_of("plants")),
    inputs: Path | None = option(
        None,
        "Signals of inputs: a column `time`, and one for each input; others keep their start values.",
        metavar="FILE.csv",
    ),
    values: tuple[str, ...] = option(
        (),
        "A parameter or start value, with a unit if it is another one (`length=50 cm`); may be repeated.",
        name="--set",
        metavar="NAME=VALUE",
    ),
    start: float | None = option(
        None,
        "Start of the run in s, or a moment such as `day 23` [the FMU's default experiment].",
        type=options.MOMENT,
        metavar="T",
    ),
    stop: float | None = option(
        None, "End of the run, likewise [the FMU's default experiment].", type=options.MOMENT, metavar="T"
    ),
    step: float | None = option(
        None,
        "Time between samples in s, or such as `15 min` [the FMU's, or 500 steps].",
        type=options.DURATION,
        metavar="H",
    ),
    outputs: tuple[str, ...] = option(
        (), "Record these; may be repeated [the outputs, else states].", metavar="NAME,..."
    ),
    out: tuple[Path, ...] = option(
        (), "Write samples, a page or a plot; may be repeated.", metavar="FILE.csv|.html|.svg"
    ),
    golden: Path | None = option(
        None,
        "Compare with these samples; exit with 1 if one differs.",
        name="--compare",
        metavar="GOLDEN.csv",
    ),
    rel: float = option(
        1e-4,
        "Allowed difference, relative to a signal's range in the golden file.",
        type=FiniteRange(min=0, max=1),
        show_default=True,
    ),
    fmi_type: Literal["auto", "co-simulation", "model-exchange"] = option("auto", show_default=True),
    library_path: tuple[Path, ...] = options.LIBRARY_PATH,
    step_timeout: float = options.STEP_TIMEOUT,
    trace_calls: Path | None = option(
        None, "Write every FMI call with its arguments, status and results.", metavar="FILE"
    ),
    sandbox: bool = options.SANDBOX,
    save_state: Path | None = option(
        None, "Save the plant's state at the end, for another run to go on from.", metavar="FILE"
    ),
    load_state: Path | None = option(
        None, "Go on from a state that was saved of this very plant.", metavar="FILE"
    ),
    couplings: tuple[str, ...] = option(
        (),
        "How the parts of an SSP are coupled, as in [plant.coupling] of a study (`algorithm=monolithic`); "
        "may be repeated.",
        name="--coupling",
        metavar="KEY=VALUE",
    ),
) -> int:
    """Simulate an FMU, SSP or PLANT in open loop; exit with 1 if it fails or differs from the golden file."""
    from ddpc_cosim.files.csv_files import CSVFile
    from ddpc_cosim.simulation.request import SimulationRequest
    from ddpc_cosim.simulation.state_file import PlantState

    try:
        read = [Path(plant), *(path for path in (inputs, golden, load_state) if path is not None)]
        faults = [fault for path in out if (fault := _impossible(path, read))]
        if save_state is not None and (fault := _no_place("--save-state", save_state, read)):
            faults.append(fault)
        resumed = None
        if load_state is not None:
            try:
                resumed = PlantState.read(load_state)
            except ConfigError as error:
                faults += error.faults
        files, given = dict[str, CSVFile | None](), dict[str, str]()
        coupling = dict[str, float | str]()
        try:
            given = assignments("--set", values, str)
        except ConfigError as error:
            faults += error.faults
        try:
            coupling = assignments("--coupling", couplings, _number_or_text)
        except ConfigError as error:
            faults += error.faults
        for name, path in (("inputs", inputs), ("compare", golden)):
            try:
                files[name] = None if path is None else CSVFile(path)
            except DataError as error:
                faults += error.faults
        if faults:
            raise ConfigError(faults)
        request = SimulationRequest(
            plant=plant,
            inputs=files["inputs"],
            values=given,
            start=start,
            stop=stop,
            step=step,
            outputs=[name.strip() for text in outputs for name in _COMMA.split(text)] or None,
            fmi_type=fmi_type,
            library_path=[str(path.absolute()) for path in library_path],
            step_timeout=step_timeout,
            trace_calls=str(trace_calls or ""),
            golden=files["compare"],
            resumed=resumed,
            keeps_state=save_state is not None,
            coupling=coupling,
        )
        return _simulate(request, out, rel, save_state, sandbox=sandbox)
    except KeyboardInterrupt as asked:  # no cases are kept, of which something could be said
        return exit_code(asked)


def _simulate(
    request: "SimulationRequest", out: Sequence[Path], rel: float, save_state: Path | None, *, sandbox: bool
) -> int:
    """Simulate, write what is asked for, print a summary, and return the exit code.

    Raises
    ------
    KeyboardInterrupt
        It was interrupted; what was simulated until then is written, and told.
    """
    from ddpc_cosim.processes.sandbox import demanded
    from ddpc_cosim.simulation import run
    from ddpc_cosim.simulation.request import prepare

    try:
        with warnings.catch_warnings(), shown(f"simulate {request.plant}") as progress:
            warnings.simplefilter("ignore", CosimWarning)  # they are among the notes
            with demanded(sandbox):
                prepared = prepare(request)
            simulation = run(prepared, progress.update, sandboxed=sandbox)
    except KeyboardInterrupt:
        print("interrupted before the first sample: nothing is written", file=sys.stderr)
        raise
    for path in out:
        _write(simulation, path)
    if save_state is not None and simulation.state is not None:
        simulation.state.write(save_state)
        out = (*out, save_state)
    difference = simulation.compare(prepared, rel)
    _print(simulation)
    for path in out:
        print(printable(str(path)))
    if save_state is not None and simulation.state is None:
        say(f"--save-state {save_state}: not written: there is nothing to go on from", err=True)
    if difference is not None:
        say(difference.words)
    if not simulation.completed:
        say(f"{simulation.plant}: {simulation.outcome}: {simulation.reason}", err=True)
    if simulation.interrupted_by is not None:
        raise simulation.interrupted_by
    differs = difference is not None and not difference.agrees
    return 1 if simulation.failed or differs else 0


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _impossible(path: Path, read: Sequence[Path]) -> str:
    """Return why a file cannot be written; empty if it can be tried."""
    if path.suffix not in _SUFFIXES:
        return f"--out {path}: the name must end in {', '.join(_SUFFIXES)}"
    return _no_place("--out", path, read)


def _no_place(option: str, path: Path, read: Sequence[Path]) -> str:
    """Return why a file that an option names has no place; empty if it can be tried."""
    from ddpc_cosim.simulation.request import overwrites

    if not path.parent.is_dir():
        return f"{option} {path}: no such folder: {path.parent}"
    fault = overwrites(path, read)
    return f"{option} {fault}" if fault else ""


def _write(simulation: "Simulation", path: Path) -> None:
    from ddpc_cosim.plugins import load_plugin

    try:
        if path.suffix == ".csv":
            simulation.write_csv(path)
        else:
            load_plugin("reports", "simulation")(simulation, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from error


def _print(simulation: "Simulation") -> None:
    """Print notes and, of each signal, its values at the start and at the end, and its range."""
    from ddpc_cosim.cli.output import terminal_table
    from ddpc_cosim.files.tables import Cell, Heading, Row, Table, text_headings

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
        summary = (values[0], values.min(), values.max(), values[-1]) if len(values) else ()
        cells = [f"{value:.6g}" for value in summary] or ["-"] * 4
        lines.append(Row(variable.name + kind, tuple(map(Cell, [*cells, variable.unit or "1"]))))
    (signal, unit), figures = text_headings("signal", "unit"), map(Heading, ("start", "min", "max", "end"))
    screen().print(terminal_table(Table("", "", (signal, *figures, unit), tuple(lines)), ruled=True))
