"""One simulation as a page in the manner of the report, or as a drawing: its signals over time."""

from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ddpc_cosim import FloatArray, Simulation, Variable
from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.plugins import write_atomically
from ddpc_reports.embedding import brought_to_life, pack
from ddpc_reports.figures.clock import SECONDS, clock_for
from ddpc_reports.figures.figure import Entry, Figure, View
from ddpc_reports.figures.samples import level_title
from ddpc_reports.figures.signal import Column, Signal, rounded, times
from ddpc_reports.figures.still import still
from ddpc_reports.figures.time_charts import NARROW, WIDE, time_chart
from ddpc_reports.numbers import given_time, significant, unit_symbol
from ddpc_reports.page import set_page
from ddpc_reports.pictures import stacked
from ddpc_reports.sections import Section, StudyPart

_MOST_DRAWN, _MOST_POINTS = 24, 2000
_LINE = "c0"
_WIDTH, _HEIGHT = 900, 200


def simulation_page(simulation: Simulation) -> str:
    """Return the page: how the run ended, start, range and end of each signal, figures, provenance."""
    signals = _signals(simulation)
    width = WIDE if len(signals) == 1 else NARROW  # beside each other
    figure = Figure(
        "simulation",
        "Signals",
        _caption(simulation, signals),
        tuple(_view(simulation, signal, width) for signal in signals),
        (Entry(_LINE, simulation.plant, 0, "", "" if simulation.completed else simulation.outcome),),
    )
    sections = [
        Section("signals", "Signals", [("table", _table(simulation))]),
        Section("figures", "Figures", [("figure", (figure, "simulation"))] if signals else []),
        Section("notes", "Notes", [("notes", list(simulation.notes))] if simulation.notes else []),
        Section("provenance", "Provenance", [("table", _provenance(simulation))]),
    ]
    ended = [] if simulation.completed else [f"{simulation.outcome}: {simulation.reason}"]
    facts = {
        "Samples": f"{len(simulation.time)} of {simulation.planned_samples}",
        "Sampling time": given_time(simulation.sampling_time),
        "Outcome": simulation.outcome,
    }
    title = f"Simulation of {simulation.plant}"
    part = StudyPart(
        "s1-", 1, title, ended, facts, Markup(""), [], [section for section in sections if section.blocks]
    )
    data = {signal.id: {name: pack(column) for name, column in signal.columns.items()} for signal in signals}
    return set_page([part], data)


def simulation_drawing(simulation: Simulation) -> str:
    """Return the figures below each other as one drawing, in the colours of the light page."""
    title = simulation.plant if simulation.completed else f"{simulation.plant} ({simulation.outcome})"
    size = (_WIDTH, _HEIGHT)
    drawings = (still(signal, [_LINE], (), size, signal.title)[0] for signal in _signals(simulation))
    return stacked(title, (("", str(drawn)) for drawn in drawings))


def write(simulation: Simulation, path: Path) -> Path:
    """Write a page, or a drawing where the name of the file ends in ``.svg``."""
    text = simulation_drawing(simulation) if path.suffix == ".svg" else simulation_page(simulation)
    write_atomically(path, text.encode("utf-8", "backslashreplace"))
    return path


def _every(simulation: Simulation) -> list[tuple[Variable, FloatArray, bool]]:
    """Return all signals, their values, and whether they are inputs."""
    outputs = [(v, simulation.y[:, i], False) for i, v in enumerate(simulation.outputs)]
    return outputs + [(v, simulation.u[:, i], True) for i, v in enumerate(simulation.inputs)]


def _signals(simulation: Simulation) -> list[Signal]:
    """Return the first signals, of long runs their envelope."""
    signals, times_of_run = [], simulation.time
    clock = clock_for(float(times_of_run[0]), float(np.ptp(times_of_run))) if len(times_of_run) else SECONDS
    for i, (variable, values, is_input) in enumerate(_every(simulation)[:_MOST_DRAWN]):
        if not len(values):
            break
        kept = _envelope(values)
        columns: dict[str, Column] = {"t": times(simulation.time[kept], clock), _LINE: rounded(values[kept])}
        unit = unit_symbol(variable.unit)
        name = f"{level_title(variable, unit)}{' (input)' if is_input else ''}"
        signal = Signal(f"x{i}", name, unit, columns, (_LINE,), held=is_input, own_range=True, clock=clock)
        signals.append(signal)
    return signals


def _envelope(values: FloatArray) -> "np.ndarray[tuple[int], np.dtype[np.intp]]":
    """Return which samples to draw: of a long run the smallest and largest of each stretch, and the ends."""
    count = len(values)
    if count <= _MOST_POINTS:
        return np.arange(count)
    edges = np.linspace(0, count, _MOST_POINTS // 2 + 1).astype(np.intp)
    extremes = [
        begin + at(values[begin:end])
        for begin, end in pairwise(edges.tolist())
        for at in (np.argmin, np.argmax)
    ]
    return np.unique(np.array([0, *extremes, count - 1], dtype=np.intp))


def _view(simulation: Simulation, signal: Signal, width: int) -> View:
    spec = time_chart(signal, [_LINE], simulation.sampling_time, size=(width, _HEIGHT))
    description = f"{signal.title} over time"
    draw = partial(still, signal, [_LINE], (), (width, _HEIGHT), description)
    picture = brought_to_life(draw, spec, description)
    place = f"simulation-{signal.id}"
    time = signal.clock.unit
    return View(place, "", description, spec, picture, signal.id, (_LINE,), signal.unit, (_LINE,), time=time)


def _caption(simulation: Simulation, signals: list[Signal]) -> str:
    words = "Outputs, and inputs as they are held from sample to sample, over time."
    if len(simulation.time) > _MOST_POINTS:
        words += " Of so many samples the smallest and the largest of every stretch are drawn."
    left = len(simulation.outputs) + len(simulation.inputs) - len(signals)
    return words + (f" {left} more signals are in the CSV file." if left else "")


def _table(simulation: Simulation) -> Table:
    headings = (Heading("signal", numeric=False), *map(Heading, ("start", "min", "max", "end")))
    rows = []
    for variable, values, is_input in _every(simulation):
        figures = [values[0], values.min(), values.max(), values[-1]] if len(values) else []
        cells = tuple(Cell(significant(float(value), 6), float(value)) for value in figures)
        unit = unit_symbol(variable.unit) or "1"
        name = f"{variable.name}{' (input)' if is_input else ''}"
        rows.append(Row(name, (*(cells or (Cell("-"),) * 4), Cell(unit, unit))))
    caption = f"All signals, {len(simulation.time)} samples"
    return Table("s1-signals-table", caption, (*headings, Heading("unit", numeric=False)), tuple(rows))


def _provenance(simulation: Simulation) -> Table:
    rows = tuple(
        Row(key.replace("_", " "), (Cell(value, value),)) for key, value in simulation.provenance.items()
    )
    headings = (Heading("what", numeric=False), Heading("value", numeric=False))
    return Table("s1-provenance-table", "The plant", headings, rows)
