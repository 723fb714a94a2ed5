"""What was run: settings of every controller, limits, and the loop."""

import json
import math
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from ddpc_cosim import (
    CosimError,
    Distribution,
    Drift,
    ForecastFile,
    Price,
    Ramp,
    StudyResults,
    Trace,
    Variable,
    declared_settings,
)
from ddpc_cosim.codec import differing, write
from ddpc_cosim.conditions import all_conditions
from ddpc_cosim.files.tables import Cell, Heading, Row, Table, text_headings
from ddpc_cosim.files.texts import without_folders
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study.file_format.sections import (
    BandSection,
    ControllerSection,
    LoopSection,
    PlantSection,
    RecordingChanges,
    RecordingSection,
    ScenarioSection,
    Study,
)
from ddpc_reports.comparison import Condition, ControllerResults, in_ranked_order, indices, labels
from ddpc_reports.figures.time_charts import Mark
from ddpc_reports.numbers import MISSING, as_given, computed, given_time, unit_symbol, with_unit
from ddpc_reports.tables.table import controller_row

_LONG = 600.0
"""From how many seconds on times of signals are written as people say them."""


def settings_tables(results: StudyResults, condition: Condition | None, prefix: str) -> list[Table]:
    """Return the loop, the controllers, their limits at the first seed, and the variants of sweeps.

    With the tables of :func:`family_tables`, studies that differ in anything that they set read differently.
    """
    units = own_units([*(condition.first_traces.values() if condition else ()), *_other_inputs(results)])
    tables = [
        _loop_table(results, units, prefix),
        _controllers_table(results, units, prefix),
        _bounds_table(condition, prefix) if condition else None,
        _variants_table(results, prefix),
    ]
    return [table for table in tables if table]


def own_units(traces: Iterable[Trace]) -> dict[str, str]:
    """Return the units of signals by name, which hold where the study names none."""
    return {
        variable.name: variable.unit
        for trace in traces
        for variable in (*_bounded(trace), *trace.measurements, *trace.changed_inputs)
    }


def _other_inputs(results: StudyResults) -> Iterator[Trace]:
    """Yield a run of each scenario in which inputs have signals of their own."""
    recording, scenarios = results.study.recording, results.study.scenarios
    yield from (
        case.trace()
        for case in {case.scenario: case for case in results.cases if case.has_samples}.values()
        if scenarios[case.scenario].inputs or (recording and recording.inputs)
    )


def family_tables(condition: Condition, prefix: str) -> list[Table]:
    """Return one table for each type of controller that has settings: a row per setting, a column each."""
    sections = condition.results.study.controllers
    families: dict[str, list[ControllerResults]] = {}
    for controller in condition.controllers:
        family = sections[controller.key].type if controller.key in sections else controller.key
        families.setdefault(family, []).append(controller)
    tables = [_family_table(family, members, sections, prefix) for family, members in families.items()]
    return [table for table in tables if table.rows]


def _family_table(
    family: str,
    members: Sequence[ControllerResults],
    sections: Mapping[str, ControllerSection],
    prefix: str,
) -> Table:
    docs = _setting_docs(family)
    settings = [
        sections[member.key].settings if member.key in sections else member.cases[0].settings
        for member in members
    ]
    given = dict.fromkeys(name for of_controller in settings for name in of_controller)
    names = [name for name in docs if name in given] + [name for name in given if name not in docs]
    rows = tuple(Row(name, (*_values(name, settings), Cell(docs.get(name, MISSING)))) for name in names)
    differing = any(cell.differs for row in rows for cell in row.cells)
    return Table(
        f"{prefix}settings-{slug(family)}",
        f"Settings of type {family}",
        (
            Heading("Setting", numeric=False),
            *(Heading(member.label, colour=member.index) for member in members),
            Heading("meaning", numeric=False),
        ),
        rows,
        ("Marked: differs from the first column.",) if differing else (),
        kind="settings",
        download=f"settings-{slug(family)}.csv",
    )


def _values(name: str, settings: Sequence[Mapping[str, Any]]) -> list[Cell]:
    texts = [value_text(given[name]) if name in given else MISSING for given in settings]
    return [Cell(text, text, differs=text != texts[0]) for text in texts]


def _setting_docs(family: str) -> dict[str, str]:
    """Return what each setting means; nothing where the plug-in is not installed here (any more)."""
    if ":" in family:  # a report executes nothing that a folder of results names
        return {}
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


def _in_ranked_order(results: StudyResults) -> list[tuple[str, str]]:
    """Return names and labels of the controllers as they are ranked."""
    names = labels(results)
    return [(key, names[key]) for key in in_ranked_order(results, names)]


def _controllers_table(results: StudyResults, units: Mapping[str, str], prefix: str) -> Table:
    """Return what each controller is: its type, the study's note about it, and what it has of its own."""
    numbers = indices(results)
    listed = {
        key: (label, section)
        for key, label in _in_ranked_order(results)
        if (section := results.study.controllers.get(key)) and not section.variant_of
    }
    columns = {
        "type": [section.type for _, section in listed.values()],
        "name": [key if key != label else "" for key, (label, _) in listed.items()],
        "differs from the study": [_own_words(section, units) for _, section in listed.values()],
        "tuned settings": [
            ", ".join(section.tuned.settings or ()) if section.tuned else "" for _, section in listed.values()
        ],
        "note": [section.note for _, section in listed.values()],
    }
    shown = {title: texts for title, texts in columns.items() if title in ("type", "note") or any(texts)}
    rows = tuple(
        Row(
            label,
            tuple(Cell(texts[i] or MISSING) for texts in shown.values()),
            key,
            numbers[key],
        )
        for i, (key, (label, _)) in enumerate(listed.items())
    )
    headings = text_headings("Controller", *shown)
    return Table(
        f"{prefix}controllers", "Controllers", headings, rows, download="controllers.csv", kind="facts"
    )


def _own_words(section: ControllerSection, units: Mapping[str, str]) -> str:
    """Return the limits that replace the study's, and whatever else the study says of a controller."""
    limits = [
        f"limits of {name}: {_signal(bounds, units.get(name, ''))}" for name, bounds in section.bounds.items()
    ]
    said = {"type", "label", "note", "settings", "bounds", "variant_of", "varied"}
    return "; ".join([*limits, *(f"{name}: {text}" for name, text in _others(section, said))])


def _variants_table(results: StudyResults, prefix: str) -> Table | None:
    """Return in what each variant of a sweep differs from its controller; None without sweeps."""
    sections, numbers = results.study.controllers, indices(results)
    variants = {
        key: (label, section.variant_of)
        for key, label in _in_ranked_order(results)
        if (section := sections.get(key)) and section.variant_of
    }
    if not variants:
        return None
    rows = tuple(
        Row(
            label,
            (Cell(key), Cell(_difference(sections[key], sections.get(base)))),
            key,
            numbers[key],
            group=base,
        )
        for key, (label, base) in variants.items()
    )
    headings = text_headings("Variant", "name", "settings that differ")
    caption = f"Variants in sweeps ({len(rows)})"
    return Table(f"{prefix}variants", caption, headings, rows, kind="grouped", download="variants.csv")


def _difference(variant: ControllerSection, base: ControllerSection | None) -> str:
    """Return the settings that were varied, and whatever else differs from the controller."""
    settings, theirs = variant.settings, base.settings if base else {}
    varied = {name: settings.get(name) for name in variant.varied}
    names = dict.fromkeys(name for name in (*settings, *theirs) if name not in varied)
    others = {name: settings.get(name) for name in names if settings.get(name) != theirs.get(name)}
    said = {"label", "settings", "tuned", "variant_of", "varied"}
    keys, their_keys = (_without(write(section), said) for section in (variant, base or variant))
    parts = [
        mapping_text(varied),
        f"also {mapping_text(others)}" if others else "",
        *(f"{name}: {value_text(value)}" for name, value in keys.items() if value != their_keys.get(name)),
    ]
    return "; ".join(filter(None, parts))


def _bounds_table(condition: Condition, prefix: str) -> Table | None:
    """Return the limits that each controller ran with at the first seed, or None if nothing ran."""
    traces = condition.first_traces
    if not traces:
        return None
    names = [variable.name for variable in _bounded(next(iter(traces.values())))]
    rows = tuple(
        controller_row(controller, tuple(map(Cell, limits_texts(trace))))
        for controller in condition.controllers
        if (trace := traces.get(controller.key)) is not None
    )
    headings = text_headings("Controller", *names)
    caption = "Limits of inputs and outputs, per controller"
    return Table(f"{prefix}bounds", caption, headings, rows, download="limits.csv")


def _bounded(trace: Trace) -> tuple[Variable, ...]:
    return (*trace.inputs, *trace.outputs)


def limits_texts(trace: Trace) -> list[str]:
    """Write the limits of all inputs, then of all outputs, in display units."""
    bounds = trace.bounds
    lows = [*bounds.u_min, *bounds.y_min]
    highs = [*bounds.u_max, *bounds.y_max]
    return [
        _interval(variable, low, high)
        + (", changing over time" if variable.name in trace.moving_limits else "")
        for variable, low, high in zip(_bounded(trace), lows, highs, strict=True)
    ]


def _interval(variable: Variable, low: float, high: float) -> str:
    if math.isinf(low) and math.isinf(high):
        return "none"
    ends = [computed(float(variable.shown_in.from_unit(np.array(end)))) for end in (low, high)]
    return with_unit(" … ".join(as_given(end) for end in ends), unit_symbol(variable.shown_in.name))


def _loop_table(results: StudyResults, units: Mapping[str, str], prefix: str) -> Table:
    """Return plant, timing, references, limits, recording and scenarios: everything that the study sets."""
    study = results.study
    facts = [
        ("study", study.name),
        *_plant_facts(study.plant, units, controls=bool(study.reference)),
        *_timing_facts(study.loop),
    ]
    facts += [
        (f"{_wanted_as(section) or what} of {name}", _signal(section, units.get(name, "")))
        for what, sections in (("reference", study.reference or {}), ("limits", study.bounds))
        for name, section in cast("Mapping[str, Any]", sections).items()
    ]
    facts += _outside_facts(study, units)
    facts += _recording_facts(study.recording, units) if study.recording else []
    facts += [
        (
            f"scenario {_labelled(name, section.label)}",
            ";\n".join(effect.text for effect in scenario_effects(section, units, study.prices))
            or "nothing changed",
        )
        for name, section in study.scenarios.items()
    ]
    cost = study.metrics.cost
    facts += [(f"cost: weights of {kind}", text) for kind, text in _others(cost, ())] if cost else []
    relevant = study.metrics.relevant
    facts += [
        (f"smallest relevant difference: {kind}", text)
        for kind, text in (_others(relevant, ()) if relevant else ())
    ]
    if study.metrics.ranking is not None:
        facts.append(("ranking", study.metrics.ranking))
    key_figures = study.metrics.key_figures
    facts += [
        (f"key figures: {kind}", text) for kind, text in (_others(key_figures, ()) if key_figures else ())
    ]
    facts.append(("seeds", compact_seeds(study.seeds)))
    own_limits = any(section.bounds for section in study.controllers.values())
    but = ", but for limits of their own" if own_limits else ""
    caption = f"The loop, the same for all controllers{but}"
    return facts_table(f"{prefix}loop", caption, facts, "loop.csv")


def _wanted_as(section: Any) -> str:
    return "band" if isinstance(section, BandSection) else ""


def _outside_facts(study: Study, units: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield what acts from outside and is known, and what signals cost."""
    for (name, section), known in zip(study.disturbances.items(), known_words(study), strict=True):
        words = [f"{section.known}: {known.partition(': ')[2]}"]
        words += [f"forecasts: {value_text(_short(section.forecast))}"] if section.forecast else []
        words += [f"its course: {_signal(section.signal, units.get(name, ''))}"] if section.signal else []
        yield f"known disturbance {_plain(name)}", "; ".join(words)
    for name, price in study.prices.items():
        factor = f"{as_given(price.factor)} · " if price.factor != 1.0 else ""
        ahead = "known ahead" if price.known else "not known ahead"
        paid = f"{_course(price.price, price.unit)} for {factor}{_plain(price.signal)}, {ahead}"
        emitted = f"; emissions: {_course(price.emissions, price.emissions_unit)}" if price.emissions else ""
        yield f"price {_plain(name)}", f"{paid}{emitted}"


def _short(forecast: ForecastFile) -> dict[str, Any]:
    """Return what is said of a file of forecasts; its folder is that of one machine."""
    return {**differing(forecast), "file": Path(forecast.file).name}


_KNOWN = {
    "unknown": "controllers are told nothing of it",
    "measured": "measured, and held ahead",
    "low": "measured, and forecasts with low errors",
    "medium": "measured, and forecasts with medium errors",
    "high": "measured, and forecasts with high errors",
    "perfect": "measured, and known ahead without errors",
}


def known_words(study: Study, scenario: str = "") -> list[str]:
    """Return for each known disturbance what controllers are told of it; perhaps in a scenario."""
    others = study.scenarios[scenario].known if scenario else {}
    words = []
    for name, section in study.disturbances.items():
        known = _KNOWN[others.get(name, section.known)]
        if section.forecast is not None and name not in others:
            known = f"measured, and the forecasts of {Path(section.forecast.file).name}"
        late = f", measured {section.lag} samples late" if section.lag else ""
        words.append(f"{_plain(name)}: {known}{late}")
    return words


def _course(value: Any, unit: str) -> str:
    """Write a number or a signal in a unit."""
    symbol = unit_symbol(unit)
    if isinstance(value, int | float):
        return with_unit(as_given(value), symbol)
    return f"{_written_signal(write(value))} (values in {symbol})"


def _plant_facts(plant: PlantSection, units: Mapping[str, str], controls: bool) -> list[tuple[str, str]]:
    said = {"name", "fmu", "inputs", "outputs", "measurements", "parameters", "nominal"}
    said |= {"ssp", "parts", "connections", "coupling", "identified"}
    return [
        *_what_plant(plant),
        ("inputs", _names(plant.inputs) or "all of the plant"),
        ("controlled outputs", _names(plant.outputs) or ("all of the plant" if controls else "none")),
        ("measurements", _names(plant.measurements) or "the controlled outputs"),
        ("plant parameters changed", mapping_text(plant.parameters)),
        *(
            (f"nominal value of {name}", with_unit(as_given(value), unit_symbol(units.get(name, ""))))
            for name, value in plant.nominal.items()
        ),
        *((f"plant: {name}", text) for name, text in _others(plant, said)),
    ]


def _what_plant(plant: PlantSection) -> Iterator[tuple[str, str]]:
    """Yield what a plant is: a plug-in, an FMU, or parts and how they are coupled."""
    if plant.name:
        yield "plant", plant.label
    elif plant.ssp or plant.fmu:
        yield ("SSP", Path(plant.ssp).name) if plant.ssp else ("FMU", Path(plant.fmu).name)
    elif plant.identified:
        yield "plant identified from", plant.label
        for name, text in _others(plant.identified, {"file"}):
            yield f"identification: {name}", text
    for part in plant.parts:
        what = part.label
        others = (f"{name}: {text}" for name, text in _others(part, {"name", "plant", "fmu"}))
        yield f"part {_plain(part.name)}", "; ".join(filter(None, (what, *others)))
    for connection in plant.connections:
        scale = f"{as_given(connection.factor)} · " if connection.factor != 1.0 else ""
        more = f" + {as_given(connection.offset)}" if connection.offset else ""
        how = "" if connection.convert_units else ", whatever their units"
        yield _plain(connection.target), f"follows {scale}{connection.source}{more}{how}"
    if plant.coupling:
        yield from ((f"coupling: {name}", text) for name, text in _others(plant.coupling, ()))


def _timing_facts(loop: LoopSection) -> list[tuple[str, str]]:
    starts = {"rest": "from rest", "recording-end": "where the recording ended"}
    said = {
        "sampling_time",
        "duration",
        "start",
        "start_time",
        "step_timeout",
        "warm_up",
        "warm_up_controller",
    }
    seconds = {"start time": loop.start_time, "longest time for a call": loop.step_timeout}
    samples = f"{loop.steps} sample" if loop.steps == 1 else f"{loop.steps} samples"
    return [
        ("sampling time", given_time(loop.sampling_time)),
        ("duration", f"{given_time(loop.duration)}, {samples}"),
        ("start", starts.get(loop.start, loop.start)),
        *((name, given_time(value)) for name, value in seconds.items()),
        *([("warm-up", _warm_up_words(loop))] if loop.warm_up else []),
        *((f"loop: {name}", text) for name, text in _others(loop, said)),
    ]


def _warm_up_words(loop: LoopSection) -> str:
    """Say how long a plant runs before it is judged, and under whom."""
    under = "the plant's own control, or inputs at rest"
    if section := loop.warm_up_controller:
        under = section.type + (f" ({mapping_text(section.settings)})" if section.settings else "")
    return f"{given_time(loop.warm_up)} before the start, not judged, under {under}"


def _recording_facts(recording: RecordingSection, units: Mapping[str, str]) -> list[tuple[str, str]]:
    source = [f"{recording.samples} samples"] if recording.samples else []
    source += [f"the file {Path(file).name}" for file in recording.file]
    facts = [("recording", ", ".join(source))]
    if recording.controller:
        section = recording.controller
        settings = f" ({mapping_text(section.settings)})" if section.settings else ""
        facts.append(("recorded under", f"{section.type}{settings}, excitation added to its inputs"))
    facts += [
        (f"excitation of {name}", _signal(signal, units.get(name, "")))
        for name, signal in recording.excitation.items()
    ]
    facts += [
        (f"{name} in the recording", _signal(signal, units.get(name, "")))
        for name, signal in (*recording.inputs.items(), *recording.disturbances.items())
    ]
    if recording.start_time is not None:
        facts.append(("recording: start time", given_time(recording.start_time)))
    said = {"samples", "controller", "excitation", "inputs", "file", "disturbances", "start_time"}
    others = _others(recording, said)
    return facts + [(f"recording: {name}", text) for name, text in others]


def _others(section: Any, said: Container[str]) -> Iterator[tuple[str, str]]:
    """Yield names and values of the keys that are not said elsewhere and differ from their defaults."""
    for name, value in differing(section).items():
        if name not in said:
            yield name.replace("_", " "), value_text(value)


def _without(table: Mapping[str, Any], keys: Container[str]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}


def facts_table(identifier: str, caption: str, facts: Iterable[tuple[str, str]], download: str) -> Table:
    """Return a table of two columns, names and values."""
    rows = tuple(Row(name, (Cell(value or MISSING),)) for name, value in facts)
    headings = text_headings("What", "Value")
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


def _signal(section: Any, own_unit: str) -> str:
    """Write a section about a signal: its kind, its values, and their unit last."""
    values = _without(write(section), {"kind", "unit"})
    if "file" in values:  # the folder is that of one machine
        values["file"] = Path(values["file"]).name
    values = values.get("band", values)
    words = _entries_of(values)
    kind = f"{section.kind}: " if hasattr(section, "kind") else ""
    unit = unit_symbol(section.unit) or section.unit
    whose_unit = f"{unit_symbol(own_unit)}, its own unit".removeprefix(", ")
    whose_unit = "the unit of the column, else its own" if "file" in values else whose_unit
    return f"{kind}{words or 'none'} (values in {unit or whose_unit})"


_TIMES = {"times", "start_time", "from_time", "to_time", "period", "hold"}
"""Keys of signals that are times."""


def _entries_of(values: Mapping[str, Any]) -> str:
    """Write the values of a signal by their names, times of long runs as people say them."""
    given = {key: value for key, value in values.items() if value != "" and (key, value) != ("period", 0)}
    return ", ".join(f"{key.replace('_', ' ')} {_entry_text(key, value)}" for key, value in given.items())


def _entry_text(key: str, value: Any) -> str:
    if key in _TIMES and np.max(np.abs(value), initial=0.0) >= _LONG:
        return f"[{', '.join(map(given_time, value))}]" if isinstance(value, list) else given_time(value)
    if isinstance(value, Mapping) and "kind" in value:
        return _written_signal(value)
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return f"[{', '.join(map(_written_signal, value))}]"
    return value_text(value)


def _written_signal(table: Mapping[str, Any]) -> str:
    """Write a signal that stands within another table."""
    unit = f", in {unit_symbol(table['unit']) or table['unit']}" if table.get("unit") else ""
    return f"{table['kind']} ({_entries_of(_without(table, {'kind', 'unit'}))}{unit})"


@dataclass(frozen=True)
class Effect:
    """What a scenario does: in words, and briefly at which instants and in which spans of time it does it."""

    text: str
    marks: tuple[Mark, ...] = ()


def scenario_effects(
    section: ScenarioSection, units: Mapping[str, str], prices: Mapping[str, Price] | None = None
) -> list[Effect]:
    """Return all that a scenario changes, in the order of a study file; ``prices`` are those of the study."""
    price_units = {name: price.unit for name, price in (prices or {}).items()}
    disturbances = [(name, part) for name, parts in section.disturbances.items() for part in parts]
    said = {"parameters", "noise", "events", "drifts", "disturbances", "inputs", "known", "prices"}
    said |= {"label", "bounds", "recording", "start_time", *section.effects}
    start = section.start_time
    return [
        *([] if start is None else [Effect(f"the run starts at t = {given_time(start)}")]),
        *([Effect(f"parameters {mapping_text(section.parameters)}")] if section.parameters else []),
        *(
            Effect(f"noise of {_plain(name)}, standard deviation {_in_unit(value, units.get(name, ''))}")
            for name, value in section.noise.items()
        ),
        *_events(section),
        *map(_drift_effect, section.drifts),
        *(
            _signal_effect(f"disturbance of {_plain(name)}", disturbance, units.get(name, ""))
            for name, disturbance in disturbances
        ),
        *(
            _signal_effect(f"input {_plain(name)}", signal, units.get(name, ""), first=1)
            for name, signal in section.inputs.items()
        ),
        *(Effect(f"{_plain(name)}: {_KNOWN[known]}") for name, known in section.known.items()),
        *(
            Effect(f"price of {_plain(name)}: {_course(price, price_units.get(name, ''))}")
            for name, price in section.prices.items()
        ),
        *(
            Effect(f"limits of {_plain(name)}: {_signal(bounds, units.get(name, ''))}")
            for name, bounds in section.bounds.items()
        ),
        *(
            Effect(
                kind.words.format(name=_plain(name), value=_in_unit(value, kind.unit_of(units.get(name, ""))))
            )
            for key, kind in all_conditions().items()
            for name, value in section.effects.get(key, {}).items()
        ),
        *(
            Effect(f"{_plain(key)} of {_plain(name)}: {as_given(value)} (not installed here)")
            for key in section.effects
            if key not in all_conditions()
            for name, value in section.effects[key].items()
        ),
        *(Effect(f"{name}: {text}") for name, text in _others(section, said)),
        *([Effect(_recording_text(section.recording))] if section.recording else []),
    ]


def _in_unit(value: float, unit: str) -> str:
    return with_unit(as_given(value), unit_symbol(unit))


def _signal_effect(what: str, section: Any, own_unit: str, first: int = 0) -> Effect:
    """Write a signal, and when it changes: the steps from the ``first`` on, or while it is a ramp."""
    marks: tuple[Mark, ...] = ()
    if isinstance(section, Ramp):
        values = f"{as_given(section.start)} → {as_given(section.stop)}"
        marks = (Mark(f"{what} {values}", section.start_time, section.stop_time),)
    elif steps := [*zip(getattr(section, "times", ()), getattr(section, "values", ()), strict=False)]:
        marks = tuple(Mark(f"{what} {as_given(value)}", time, time) for time, value in steps[first:])
    return Effect(f"{what}: {_signal(section, own_unit)}", marks)


def _events(section: ScenarioSection) -> Iterator[Effect]:
    """Yield the events in the order of the file; briefly from which value, where the scenario says it."""
    before = {name: value_text(value) for name, value in section.parameters.items()}
    briefly: dict[int, str] = {}
    for event in sorted(section.events, key=lambda event: event.time):
        after = {name: value_text(value) for name, value in event.parameters.items()}
        briefly[id(event)] = ", ".join(
            f"{_plain(name)} {before[name]} → {text}" if name in before else f"{_plain(name)} = {text}"
            for name, text in after.items()
        )
        before |= after
    for event in section.events:
        text = f"at {given_time(event.time)}: {mapping_text(event.parameters)}"
        yield Effect(text, (Mark(briefly[id(event)], event.time, event.time),))


def _recording_text(changes: RecordingChanges) -> str:
    return f"recording with {mapping_text(differing(changes))}"


def _drift_effect(drift: Drift) -> Effect:
    first, last = given_time(drift.start_time), given_time(drift.stop_time)
    old, new, name = as_given(drift.start), as_given(drift.stop), _plain(drift.parameter)
    text = f"{name} from {old} to {new} between {first} and {last}"
    return Effect(text, (Mark(f"{name} {old} → {new}", drift.start_time, drift.stop_time),))


def _labelled(name: str, label: str) -> str:
    return f"{label} ({name})" if label and label != name else name


def mapping_text(values: Mapping[str, Any]) -> str:
    """Write names and values: ``a = 1, b = 2``; of none, ``none``."""
    return value_text(values) if values else "none"


def value_text(value: Any, *, nested: bool = False) -> str:
    """Write a value of a setting in full, so that different values read differently."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return as_given(value) if float(value) == value else str(value)
    if value is None:
        return "not set"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(value_text(entry, nested=True) for entry in value) + "]"
    if isinstance(value, Mapping):
        entries = ((_plain(name), value_text(entry, nested=True)) for name, entry in value.items())
        pairs = ", ".join(f"{name} = {text}" for name, text in entries)
        return pairs if pairs and not nested else f"{{{pairs}}}"
    if isinstance(value, Distribution):
        table = write(value)
        return f"{table.pop(value.kind_key)} ({value_text(table)})"
    return _plain(without_folders(str(value)))


def _names(names: Sequence[str]) -> str:
    return ", ".join(map(_plain, names))


_AMBIGUOUS = re.compile(
    r"|yes|no|not set|\{\}"  # what other values read like
    r'|[\d\s\-"\[\u2212\u2013\u221e].*'  # begins like a number, a list or a dash
    r'|.*(?:[,;="\n]|\s$).*',  # has what separates values
    re.DOTALL,
)
"""Texts that could be read as another value, or as several."""


def _plain(text: str) -> str:
    return json.dumps(text, ensure_ascii=False) if _AMBIGUOUS.fullmatch(text) else text


def slug(text: str) -> str:
    """Return a text as a part of an anchor or of a file's name."""
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in text.lower())
