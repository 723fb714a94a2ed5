"""What was run: settings of every controller, limits, and the loop."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ddpc_cosim import CosimError, StudyResults, declared_settings
from ddpc_cosim.config import BoundsSection, ControllerSection
from ddpc_cosim.plugins import load_plugin
from ddpc_reports.comparison import Competitor, Condition
from ddpc_reports.numbers import MINUS, MISSING, significant, unit_symbol, with_unit
from ddpc_reports.table import Cell, Heading, Row, Table


def family_tables(condition: Condition, prefix: str) -> list[Table]:
    """Return one table for each type of controller: a row per setting, a column per controller."""
    sections = condition.results.study.controllers
    families: dict[str, list[Competitor]] = {}
    for one in condition.competitors:
        family = sections[one.key].type if one.key in sections else one.key
        families.setdefault(family, []).append(one)
    return [_family_table(family, members, prefix) for family, members in families.items()]


def _family_table(family: str, members: Sequence[Competitor], prefix: str) -> Table:
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
    order = dict.fromkeys(case.controller for case in results.cases)
    sections = {key: results.study.controllers.get(key, _NO_SECTION) for key in order}
    labels = {case.controller: case.label for case in results.cases}
    rows = tuple(
        Row(labels[key], (Cell(section.type), Cell(section.note or MISSING)), key, index)
        for index, (key, section) in enumerate(sections.items())
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
    """Return the limits that each controller ran with, or None where the study sets none."""
    study = condition.results.study
    own = {one.key: study.controllers.get(one.key, _NO_SECTION).bounds for one in condition.competitors}
    signals = list(dict.fromkeys([*study.bounds, *(name for bounds in own.values() for name in bounds)]))
    if not signals:
        return None
    rows = tuple(
        Row(
            one.label,
            tuple(_limits({**study.bounds, **own[one.key]}.get(name)) for name in signals),
            one.key,
            one.index,
        )
        for one in condition.competitors
    )
    headings = (Heading("Controller", numeric=False), *(Heading(name, numeric=False) for name in signals))
    return Table(
        f"{prefix}bounds",
        "Limits of inputs and outputs, per controller",
        headings,
        rows,
        download="limits.csv",
    )


_NO_SECTION = ControllerSection(type="unknown")


def _limits(bounds: BoundsSection | None) -> Cell:
    if bounds is None:
        return Cell("as the plant declares")
    low = f"{MINUS}∞" if bounds.min is None else _number(bounds.min)
    high = "∞" if bounds.max is None else _number(bounds.max)
    return Cell(with_unit(f"{low} … {high}", unit_symbol(bounds.unit)))


def loop_table(results: StudyResults, prefix: str) -> Table:
    """Return plant, timing, references, recording and scenarios as the study sets them."""
    study = results.study
    plant, loop = study.plant, study.loop
    facts = {
        "plant": plant.name or plant.fmu,
        "inputs": ", ".join(plant.inputs) or "all of the plant",
        "controlled outputs": ", ".join(plant.outputs) or "all of the plant",
        "measurements": ", ".join(plant.measurements) or "the controlled outputs",
        "plant parameters changed": _mapping(plant.parameters),
        "sampling time": with_unit(significant(loop.sampling_time, 6), "s"),
        "duration": f"{with_unit(significant(loop.duration, 6), 's')}, {loop.steps} samples",
        "start": {"rest": "from rest", "recording-end": "where the recording ended"}[loop.start],
    }
    facts |= {f"reference of {name}": _signal(section) for name, section in study.reference.items()}
    if study.recording:
        facts["recording"] = f"{study.recording.samples} samples"
        facts |= {f"excitation of {name}": _signal(one) for name, one in study.recording.excitation.items()}
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


def _signal(section: Any) -> str:
    """Write a signal's section as ``kind: key value, ...``, its unit last."""
    values = section.model_dump(exclude={"kind", "unit"})
    words = ", ".join(f"{key.replace('_', ' ')} {_setting_text(value)}" for key, value in values.items())
    unit = f" ({section.unit})" if section.unit else ""
    return f"{section.kind}: {words}{unit}"


def _scenario(section: Any) -> str:
    parts = [
        f"parameters {_mapping(section.parameters)}" if section.parameters else "",
        f"noise, standard deviation {_mapping(section.noise)}" if section.noise else "",
        *(f"at {_number(event.time)} s: {_mapping(event.parameters)}" for event in section.events),
    ]
    return "; ".join(filter(None, parts)) or "nothing changed"


def _mapping(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {_number(value)}" for name, value in values.items()) or "none"


def _setting_text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return _number(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_setting_text(entry) for entry in value) + "]"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} = {_setting_text(entry)}" for key, entry in value.items())
    return str(value)


def _number(value: float) -> str:
    """Write a setting with every digit that it has."""
    return f"{value:.12g}".replace("-", MINUS)


def _slug(text: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in text.lower())
