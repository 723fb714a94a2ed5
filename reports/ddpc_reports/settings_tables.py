"""What was run: settings of every controller, limits, the loop, and diagnostics of the data."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ddpc_cosim import CosimError, StudyResults, Trace, Variable, declared_settings
from ddpc_cosim.plugins import load_plugin
from ddpc_reports.comparison import Condition, ControllerResults, Spread, indices, labels, spread
from ddpc_reports.numbers import MISSING, as_given, integer, significant, unit_symbol, with_unit
from ddpc_reports.table import Cell, Heading, Row, Table


def family_tables(condition: Condition, prefix: str) -> list[Table]:
    """Return one table for each type of controller: a row per setting, a column per controller."""
    sections = condition.results.study.controllers
    families: dict[str, list[ControllerResults]] = {}
    for one in condition.controllers:
        family = sections[one.key].type if one.key in sections else one.key
        families.setdefault(family, []).append(one)
    return [_family_table(family, members, prefix) for family, members in families.items()]


def _family_table(family: str, members: Sequence[ControllerResults], prefix: str) -> Table:
    docs = _setting_docs(family)
    settings = [one.cases[0].settings for one in members]
    names = dict.fromkeys(name for own in settings for name in own)
    several = len(members) > 1
    rows = tuple(Row(name, (*_values(name, settings), Cell(docs.get(name, MISSING)))) for name in names)
    return Table(
        f"{prefix}settings-{_slug(family)}",
        f"Settings of type {family}",
        (
            Heading("Setting", numeric=False),
            *(Heading(one.label) for one in members),
            Heading("meaning", numeric=False),
        ),
        rows,
        ("Marked: differs from the first column.",) if several and _differences(names, settings) else (),
        kind="settings",
        download=f"settings-{_slug(family)}.csv",
    )


def _values(name: str, settings: Sequence[Mapping[str, Any]]) -> list[Cell]:
    texts = [_setting_text(own[name]) if name in own else MISSING for own in settings]
    return [Cell(text, text, differs=text != texts[0]) for text in texts]


def _differences(names: Iterable[str], settings: Sequence[Mapping[str, Any]]) -> bool:
    return any(cell.differs for name in names for cell in _values(name, settings))


def _setting_docs(family: str) -> dict[str, str]:
    """Return what each setting means; nothing where the plug-in is not installed here (any more)."""
    try:
        plugin = load_plugin("controllers", family)
    except CosimError:
        return {}
    if not isinstance(plugin, type):
        return {}
    return {
        name: f"{info.doc} [{unit_symbol(info.unit)}]" if info.unit else info.doc
        for name, info in declared_settings(plugin).items()
    }


def controllers_table(results: StudyResults, prefix: str) -> Table:
    """Return what each controller is: its type, and the study's word about it."""
    sections, numbers = results.study.controllers, indices(results)
    rows = tuple(
        Row(label, (Cell(sections[key].type), Cell(sections[key].note or MISSING)), key, numbers[key])
        for key, label in labels(results).items()
        if key in sections and not sections[key].variant_of
    )
    headings = (
        Heading("Controller", numeric=False),
        Heading("type", numeric=False),
        Heading("note", numeric=False),
    )
    return Table(
        f"{prefix}controllers", "Controllers", headings, rows, download="controllers.csv", kind="facts"
    )


def bounds_table(condition: Condition, prefix: str) -> Table | None:
    """Return the limits that each controller ran with at the first seed, or None if nothing ran."""
    traces = condition.first_traces
    if not traces:
        return None
    names = [variable.name for variable in _bounded(next(iter(traces.values())))]
    rows = tuple(
        Row(one.label, tuple(map(Cell, _limits(traces[one.key]))), one.key, one.index)
        for one in condition.controllers
        if one.key in traces
    )
    headings = (Heading("Controller", numeric=False), *(Heading(name, numeric=False) for name in names))
    caption = "Limits of inputs and outputs, per controller"
    return Table(f"{prefix}bounds", caption, headings, rows, download="limits.csv")


def _bounded(trace: Trace) -> tuple[Variable, ...]:
    return (*trace.inputs, *trace.outputs)


def _limits(trace: Trace) -> list[str]:
    """Write the limits of all inputs, then of all outputs, in display units."""
    bounds = trace.bounds
    lows = [*bounds.u_min, *bounds.y_min]
    highs = [*bounds.u_max, *bounds.y_max]
    return [_interval(*limits) for limits in zip(_bounded(trace), lows, highs, strict=True)]


def _interval(variable: Variable, low: float, high: float) -> str:
    if math.isinf(low) and math.isinf(high):
        return "none"
    # Twelve digits hide the rounding of a conversion to degrees and back.
    ends = [float(f"{float(variable.shown_in.from_unit(np.array(end))):.12g}") for end in (low, high)]
    return with_unit(" … ".join(as_given(end) for end in ends), unit_symbol(variable.shown_in.name))


def loop_table(results: StudyResults, condition: Condition | None, prefix: str) -> Table:
    """Return plant, timing, references, recording and scenarios as the study sets them."""
    study = results.study
    units = _own_units(condition)
    plant, loop = study.plant, study.loop
    facts = {
        "plant": plant.name or plant.fmu,
        "inputs": ", ".join(plant.inputs) or "all of the plant",
        "controlled outputs": ", ".join(plant.outputs) or "all of the plant",
        "measurements": ", ".join(plant.measurements) or "the controlled outputs",
        "plant parameters changed": _mapping(plant.parameters),
        "sampling time": with_unit(as_given(loop.sampling_time), "s"),
        "duration": f"{with_unit(as_given(loop.duration), 's')}, {loop.steps} samples",
        "start": {"rest": "from rest", "recording-end": "where the recording ended"}[loop.start],
    }
    facts |= {
        f"reference of {name}": _signal(section, units.get(name, ""))
        for name, section in study.reference.items()
    }
    if study.recording:
        facts["recording"] = f"{study.recording.samples} samples"
        if study.recording.controller:
            facts["recorded under"] = f"{study.recording.controller.type}, excitation added to its inputs"
        facts |= {
            f"excitation of {name}": _signal(one, units.get(name, ""))
            for name, one in study.recording.excitation.items()
        }
    facts |= {
        f"scenario {section.label or name}": _scenario(section) for name, section in study.scenarios.items()
    }
    facts["seeds"] = compact_seeds(study.seeds)
    return facts_table(f"{prefix}loop", "The loop, the same for all controllers", facts, "loop.csv")


def facts_table(identifier: str, caption: str, facts: Mapping[str, str], download: str) -> Table:
    """Return a table of two columns, names and values."""
    rows = tuple(Row(name, (Cell(value or MISSING),)) for name, value in facts.items())
    headings = (Heading("What", numeric=False), Heading("Value", numeric=False))
    return Table(identifier, caption, headings, rows, kind="facts", download=download)


def compact_seeds(seeds: Sequence[int]) -> str:
    """Write seeds, runs of them as ranges."""
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][-1] + 1:
            runs[-1].append(seed)
        else:
            runs.append([seed])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}\N{EN DASH}{run[-1]}" for run in runs)


def _own_units(condition: Condition | None) -> dict[str, str]:
    """Return the units that hold where the study file names none: the variables' own."""
    traces = condition.first_traces.values() if condition else ()
    return {variable.name: variable.unit for trace in traces for variable in _bounded(trace)}


def _signal(section: Any, own_unit: str) -> str:
    """Write a signal's section as its kind and its values, with their unit last."""
    values = section.model_dump(exclude={"kind", "unit"})
    words = ", ".join(f"{key.replace('_', ' ')} {_setting_text(value)}" for key, value in values.items())
    unit = unit_symbol(section.unit or own_unit)
    return f"{section.kind}: {words}" + (f" (values in {unit})" if unit else "")


def _scenario(section: Any) -> str:
    parts = [
        f"parameters {_mapping(section.parameters)}" if section.parameters else "",
        f"noise, standard deviation {_mapping(section.noise)}" if section.noise else "",
        *(f"at {as_given(event.time)} s: {_mapping(event.parameters)}" for event in section.events),
    ]
    return "; ".join(filter(None, parts)) or "nothing changed"


def _mapping(values: Mapping[str, float | str]) -> str:
    texts = (value if isinstance(value, str) else as_given(value) for value in values.values())
    return ", ".join(f"{name} = {text}" for name, text in zip(values, texts, strict=True)) or "none"


def _setting_text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return as_given(float(value))
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_setting_text(entry) for entry in value) + "]"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} = {_setting_text(entry)}" for key, entry in value.items())
    return str(value)


def _slug(text: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in text.lower())


_TITLES = {
    "pe_order": "PE order reached",
    "pe_order_needed": "PE order needed",
    "data_rows": "data rows",
    "data_columns": "data columns",
    "data_rank": "rank",
    "smallest_singular_value": "smallest singular value",
}


def diagnostics_table(condition: Condition, prefix: str) -> Table | None:
    """Return what the controllers say about their data, first seed and range; None if they say nothing."""
    talkers = [one for one in condition.controllers if any(case.diagnostics for case in one.cases)]
    if not talkers:
        return None
    several = len(condition.seeds) > 1
    headings = (
        Heading("Diagnostic", numeric=False),
        Heading(f"seed {condition.seeds[0]}"),
        *([Heading("range over the seeds")] if several else []),
    )
    return Table(
        f"{prefix}diagnostics",
        "Data that the controllers learned from",
        headings,
        tuple(row for one in talkers for row in _rows(one, several=several)),
        (
            "PE order: order of persistent excitation of the recorded inputs. "
            "Rank and singular value: of the stacked data.",
        ),
        kind="grouped facts",
        download="diagnostics.csv",
    )


def _rows(one: ControllerResults, *, several: bool) -> list[Row]:
    given = dict.fromkeys(name for case in one.cases for name in case.diagnostics)
    ordered = [name for name in _TITLES if name in given] + [name for name in given if name not in _TITLES]
    rows = []
    for name in ordered:
        values = [case.diagnostics.get(name, math.nan) for case in one.cases]
        first = one.cases[0].diagnostics.get(name, math.nan)
        cells = [Cell(_written(first), first)]
        if several:
            cells.append(Cell(_range(spread(values))))
        rows.append(Row(_TITLES.get(name, name.replace("_", " ")), tuple(cells), group=one.label))
    return rows


def _range(figure: Spread) -> str:
    return f"{_written(figure.low)} … {_written(figure.high)}" if figure.varies else MISSING


def _written(value: float) -> str:
    return integer(value) if value.is_integer() and abs(value) < 1e6 else significant(value)
