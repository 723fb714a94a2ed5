"""What ``ddpc-cosim inspect`` prints: tables on a terminal, elsewhere lines for grep and cut."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from shlex import quote

from rich.console import Console
from rich.text import Text

from ddpc_cosim.cli.output import fitting, terminal_table
from ddpc_cosim.coupling.ssp import SSPConnection
from ddpc_cosim.description import DefaultExperiment, DescribedVariable
from ddpc_cosim.files.durations import in_words
from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.files.texts import printable
from ddpc_cosim.files.time_tables import TimeTable
from ddpc_cosim.fmu.description import Clock, FMUDescription, Interface
from ddpc_cosim.fmu.description.defects import Defect, Severity
from ddpc_cosim.fmu.resources import Resources, unit_of
from ddpc_cosim.inspection import Inspection
from ddpc_cosim.inspection.systems import SystemInspection
from ddpc_cosim.variables import Variable

_MOST_ROWS = 20
_LONGEST_CELL = 10_000
_STYLE = {Severity.ERROR: "red", Severity.WARNING: "yellow", Severity.NOTE: ""}
_HEADINGS = ("name", "unit", "start", "min", "max", "nominal", "more", "description")
_IN_WORDS = ("unit", "more", "description", "values set")
_SAID_BESIDE = ("start", "min", "mean", "max", "nominal", "begins", "ends")
_LONGEST_NAME = 30
_BYTES_PER_KILOBYTE = 1000

Cells = tuple[str, ...]
Inspected = Inspection | SystemInspection


@dataclass(frozen=True, slots=True)
class _Section:
    """A list of the page: its title, what one row is called where it stands alone, and its rows."""

    title: str
    singular: str
    headings: Cells
    rows: Sequence[Cells]


def print_tables(console: Console, inspection: Inspected, *, every: bool) -> None:
    """Print facts, variables and defects as tables, long ones in part unless every row is wanted."""
    facts = tuple(Row(name, (Cell(value),)) for name, value in _facts(inspection))
    headings = (Heading("", numeric=False), Heading("", numeric=False, wraps=True))
    console.print(terminal_table(Table("", "", headings, facts, kind="facts")), "")
    for section in _sections(inspection):
        if section.rows:
            shown = section.rows if every else section.rows[:_MOST_ROWS]
            table, left_out = fitting(console, _table(section, shown), _LONGEST_NAME)
            console.print(table)
            if len(shown) < len(section.rows):
                console.print(
                    f" and {len(section.rows) - len(shown)} more; --all shows them", highlight=False
                )
            if left_out:
                words = ", ".join(section.headings[i] for i in left_out)
                console.print(f" not shown: {words}; in a wider window, and with --json", highlight=False)
            console.print()
    for defect in inspection.defects:
        severity = (f"{defect.severity}: ", _STYLE[defect.severity])
        console.print(Text.assemble(severity, printable(str(defect), _LONGEST_CELL)))
    if inspection.can_run:
        console.print("", Text(_next_step(inspection)), sep="\n")


def _table(section: _Section, rows: Sequence[Cells]) -> Table:
    return Table(
        "",
        f"{section.title} ({len(section.rows)})",
        tuple(Heading(title, numeric=False, wraps=title in _IN_WORDS) for title in section.headings),
        tuple(Row(first, tuple(map(Cell, others))) for first, *others in rows),
    )


def plain_lines(inspection: Inspected) -> Iterator[str]:
    """Yield one line per fact, variable and defect, with tabs between the columns: for grep and cut."""
    for name, value in _facts(inspection):
        yield _line(name, value)
    for section in _sections(inspection):
        for row in section.rows:
            cells = (
                f"{h} {cell}" if h in _SAID_BESIDE else cell
                for h, cell in zip(section.headings, row, strict=True)
                if cell
            )
            yield _line(section.singular, *cells)
    for defect in inspection.defects:
        yield from _defect_lines(defect)
    if inspection.can_run:
        yield _next_step(inspection)


def _defect_lines(defect: Defect) -> Iterator[str]:
    remedy = f" ({defect.kind.remedy})" if defect.kind.remedy else ""
    for place in defect.places or ("",):
        yield _line(defect.severity, defect.kind.name, defect.kind.message + remedy, place).rstrip()


def _line(*cells: str) -> str:
    return "\t".join(printable(cell, _LONGEST_CELL) for cell in cells)


def _next_step(inspection: Inspected) -> str:
    path = quote(printable(str(inspection.path)))
    if not inspection.inputs or not inspection.outputs:
        return f"open loop: ddpc-cosim simulate {path}"
    study = f"ddpc-cosim init {path} && ddpc-cosim run study.toml"
    if isinstance(inspection, Inspection) and inspection.is_sampled:
        return f'a controller in a study: type = "fmu", settings.file = "{path}"; a plant: {study}'
    return f"suggested study: {study}"


def _facts(inspection: Inspected) -> Iterator[tuple[str, str]]:
    """Yield the facts that take one line each."""
    if isinstance(inspection, SystemInspection):
        yield from _system_facts(inspection)
        return
    description = inspection.description
    yield "file", f"{inspection.path.name}, {inspection.size / _BYTES_PER_KILOBYTE:.1f} kB"
    if description is not None:
        yield from _model_facts(description)
    binaries = inspection.binaries
    has = [*binaries.platforms, *(["C sources"] if binaries.has_sources else [])]
    yield "platforms", ", ".join(has) or "none"
    runs = {"binary": "yes", "sources": "yes, from its sources", "": "no"}[binaries.route]
    yield "runs here", runs if inspection.can_run else "no"
    yield from _resource_facts(inspection.resources)
    yield "sha256", inspection.sha256


def _resource_facts(resources: Resources) -> Iterator[tuple[str, str]]:
    facts = (
        f"{resources.area:g} m2" if resources.area is not None else "",
        f"step {in_words(resources.step)}" if resources.step is not None else "",
        f"warm-up {in_words(resources.warm_up)}" if resources.warm_up is not None else "",
        f"start {in_words(resources.start_time)}" if resources.start_time is not None else "",
    )
    if any(facts) or resources.name:
        yield "case", _joined((resources.name, *facts))


def _system_facts(inspection: SystemInspection) -> Iterator[tuple[str, str]]:
    yield "file", f"{inspection.path.name}, {inspection.size / _BYTES_PER_KILOBYTE:.1f} kB"
    system = inspection.system
    if system is not None:
        yield "system", _joined((system.name, f"SSP {system.version}"))
        yield "experiment", _in_words(system.default_experiment)
        yield "order", _joined(inspection.order, " -> ")
        for loop in inspection.loops:
            yield "algebraic loop", _joined(loop, " -> ")
        if inspection.order and not inspection.loops:
            yield "algebraic loop", "none"
    yield "runs here", "yes" if inspection.can_run else "no"
    yield "sha256", inspection.sha256


def _system_sections(inspection: SystemInspection) -> Iterator[_Section]:
    system = inspection.system
    if system is None:
        return
    parts = [
        (
            part.name,
            part.source,
            f"FMI {inspected.description.fmi_version}" if inspected.description else "",
            part.fmi_type
            if part.fmi_type != "auto"
            else _joined(inspected.interfaces[0].kind for _ in inspected.interfaces[:1]),
            _joined(f"{name} = {value}" for name, value in {**part.start, **part.parameters}.items()),
        )
        for part in system.parts
        if (inspected := inspection.parts.get(part.name)) is not None
    ]
    yield _Section("Parts", "part", ("name", "file", "fmi", "runs for", "values set"), parts)
    rows = [(c.source, c.target, _units(c), _scale(c.factor, c.offset)) for c in system.connections]
    yield _Section("Connections", "connection", ("from", "to", "unit", "more"), rows)
    yield _inputs(inspection)
    yield _Section("Outputs", "output", _HEADINGS, [_row(v) for v in inspection.outputs])


def _units(connection: SSPConnection) -> str:
    source, target = connection.source_unit or "1", connection.target_unit or "1"
    return f"[{source}]" if source == target else f"[{source}] -> [{target}]"


def _scale(factor: float, offset: float) -> str:
    """Return what happens to a value on its way, conversion of the unit included."""
    return _joined((f"* {factor:g}" if factor != 1.0 else "", f"{offset:+g}" if offset else ""), " ")


def _model_facts(description: FMUDescription) -> Iterator[tuple[str, str]]:
    yield "model", _joined((description.model_name, description.version), " ")
    interfaces = description.interfaces
    yield "fmi", f"{description.fmi_version} {' and '.join(sorted(interfaces)) or 'no interface'}"
    yield from (
        (name, text)
        for name, text in (
            ("about", description.text),
            ("tool", description.generation_tool),
            ("author", description.author),
            ("generated", description.generated_at),
            ("copyright", description.copyright),
            ("licence", description.license),
        )
        if text and text != "unknown"
    )
    for kind in sorted(interfaces):
        yield f"{kind} can", _joined(_capabilities(interfaces[kind])) or "nothing beyond the minimum"
    yield "experiment", _in_words(description.default_experiment)


def _in_words(experiment: DefaultExperiment) -> str:
    facts = (
        ("start", experiment.start_time, " s"),
        ("stop", experiment.stop_time, " s"),
        ("step", experiment.step_size, " s"),
        ("tolerance", experiment.tolerance, ""),
    )
    return (
        _joined(f"{what} {value:g}{unit}" for what, value, unit in facts if value is not None) or "none given"
    )


def _capabilities(interface: Interface) -> Iterator[str]:
    if interface.kind == "co-simulation":
        yield "step by any size" if interface.variable_step else "only equal steps"
    if interface.fixed_step is not None:
        yield f"steps of multiples of {interface.fixed_step:g} s"
    if interface.can_save_state:
        yield "save its state" + (" to bytes" if interface.can_serialize_state else "")
    if interface.provides_directional_derivatives:
        yield "give derivatives"
    if interface.has_event_mode:
        yield "handle events"
    if interface.only_one_instance:
        yield "one instance per process"
    if interface.needs_execution_tool:
        yield "needs its tool"


def _joined(parts: Iterable[str], by: str = ", ") -> str:
    return by.join(part for part in parts if part)


def _sections(inspection: Inspected) -> Iterator[_Section]:
    if isinstance(inspection, SystemInspection):
        yield from _system_sections(inspection)
        return
    feedthrough = inspection.feedthrough
    yield _inputs(inspection)
    outputs = [_row(v, _on_feedthrough(feedthrough, v.name)) for v in inspection.outputs]
    yield _Section("Outputs", "output", _HEADINGS, outputs)
    parameters = [_row(p.variable, _on_parameter(p), p.start_text) for p in inspection.parameters]
    yield _Section("Parameters", "parameter", _HEADINGS, parameters)
    yield _Section("States", "state", _HEADINGS, [_row(v) for v in inspection.states])
    rows = [_clock_row(clock, ticks=ticks) for clock, ticks in inspection.clocks.items()]
    yield _Section("Clocks", "clock", ("name", "kind", "more"), rows)
    yield from _resource_sections(inspection.resources)


def _resource_sections(resources: Resources) -> Iterator[_Section]:
    """Yield what lies in the folder resources: days, sources of key figures, tables over time."""
    days = [(name, str(day)) for name, day in resources.days.items()]
    yield _Section("Days of the year", "day", ("name", "day"), days)
    figures = [(source, _joined(outputs)) for source, outputs in resources.key_figures.items()]
    yield _Section("Key figures", "key figure", ("source", "outputs"), figures)
    tables = [_table_row(table) for table in resources.tables]
    yield _Section("Tables over time", "table", ("file", "rows", "begins", "ends", "more"), tables)
    rows = [_column_row(table, column) for table in resources.tables for column in table.columns]
    yield _Section("Columns of the tables", "column", ("name", "unit", "min", "mean", "max", "file"), rows)


def _table_row(table: TimeTable) -> Cells:
    begin, end = (in_words(float(table.time[i])) for i in (0, -1))
    after = "comes again after its end" if table.period else ""
    return table.file, f"{len(table.time)} rows", begin, end, after


def _column_row(table: TimeTable, column: str) -> Cells:
    figures = (f"{value:.5g}" if math.isfinite(value) else "" for value in table.statistics(column))
    unit = unit_of(table, column)
    return (column, f"[{unit}]" if unit else "", *figures, table.file)


def _inputs(inspection: Inspected) -> _Section:
    switches = inspection.switches
    more = {name: f"switched on by {switch}" for name, switch in switches.items()}
    more |= {switch: f"switches {name} on" for name, switch in switches.items()}
    rows = [_row(variable, more.get(variable.name, "")) for variable in inspection.inputs]
    return _Section("Inputs", "input", _HEADINGS, rows)


def _clock_row(clock: Clock, *, ticks: bool) -> Cells:
    words = "does not tick here" if clock.causality == "input" else ""
    if ticks:
        words = f"ticks every {clock.interval:g} s from {clock.shift:g} s on"
    return clock.name, f"{clock.causality}, {clock.variability}", words


def _on_feedthrough(feedthrough: dict[str, tuple[str, ...] | None], output: str) -> str:
    names = feedthrough.get(output)
    if names is None:
        return "may follow any input at once"
    return f"follows at once: {', '.join(names)}" if names else "no direct feedthrough"


def _on_parameter(parameter: DescribedVariable) -> str:
    kind = "structural" if parameter.is_structural else "tunable" if parameter.is_tunable else "fixed"
    size = f"[{','.join(map(str, parameter.shape))}]" if parameter.shape else ""
    return f"{kind} {parameter.type}{size}"


def _row(variable: Variable, more: str = "", start_text: str | None = None) -> Cells:
    shown = variable.display_unit
    unit = variable.unit or "1"
    return (
        variable.name,
        f"[{unit}]" + (f" shown in [{shown.name}]" if shown else ""),
        start_text if start_text is not None else f"{variable.start:g}",
        _limit(variable.min),
        _limit(variable.max),
        f"{variable.nominal:g}" if variable.nominal != 1.0 else "",
        more,
        " ".join(variable.description.split()),
    )


def _limit(value: float) -> str:
    return f"{value:g}" if math.isfinite(value) else ""
