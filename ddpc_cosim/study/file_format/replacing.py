"""How what one file says replaces what another says, and what differs in a problem what all share."""

from collections.abc import Callable, Collection, Iterator, Set
from typing import Any

from ddpc_cosim.errors import Place
from ddpc_cosim.study.file_format.requirements import REQUIREMENTS, with_requirements
from ddpc_cosim.study.file_format.sweeps import ZIP, path_of
from fmu_plants.spelling import did_you_mean

Table = dict[str, Any]
PROBLEMS, CONTROLLERS, SWEEP = "problems", "controllers", "sweep"
EXTENDS, STUDY = "extends", "study"
"""The keys by which a study, and a problem of one, takes from another study."""
OF_PROBLEM = (
    "plant",
    "loop",
    "reference",
    "bounds",
    "disturbances",
    "prices",
    "recording",
    "scenarios",
    "metrics",
    REQUIREMENTS,
)
"""What a problem takes from a study."""
# What a study says of its results, which are not those of one that extends it.
_OF_RESULTS = ("name", "title", "summary")
# What a controller's section says of one type.
_OF_TYPE = ("settings", "sweep", "search", "first_trials", "tuned")
# Of each table, keys of which one excludes the other.
_ALTERNATIVES = {"plant": {"name", "fmu", "ssp", "parts"}, "recording": {"samples", "file"}}


def replaced(base: Table, changes: Table, *, leave_out: bool = False) -> Table:
    """Return tables of which keys are replaced, such as ``loop.duration``, ``reference.angle``.

    ``leave_out``: ``false`` in place of a table of the base leaves it out.
    """

    def is_left_out(value: Any, old: Any) -> bool:
        return leave_out and value is False and isinstance(old, dict)

    tables = dict(base)
    for key, value in changes.items():
        old = base.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            alternatives = _ALTERNATIVES.get(key, set())
            given, had = alternatives & value.keys(), alternatives & old.keys()
            if not (given and had and given != had):
                both = (with_requirements(old, value) if key == REQUIREMENTS else old | value).items()
                value = {name: entry for name, entry in both if not is_left_out(entry, old.get(name))}
        tables[key] = value
        if is_left_out(value, old):
            del tables[key]
    return tables


def changed_controller(base: Table, changes: Table, kind: Any) -> Table:
    """Return a controller of a type with what differs: another type has settings of its own."""
    return replaced(_without(base, _OF_TYPE if changes.get("type", kind) != kind else ()), changes)


def extended(base: Table, changes: Table, label: str) -> tuple[Table, list[tuple[Place, str]]]:
    """Return a study with what a file that extends it says; and what does not fit it, and why.

    Parameters
    ----------
    base : dict
        The tables of the study.
    changes : dict
        Those of the file.
    label : str
        The name of the study in messages.
    """
    gone = {
        (key, name)
        for key in (PROBLEMS, CONTROLLERS)
        for name, entry in _items(changes.get(key))
        if entry is False and name in dict(_items(base.get(key)))
    }
    base = _remaining(base, gone)
    tables = replaced(base, _without(changes, (EXTENDS, PROBLEMS, CONTROLLERS)), leave_out=True)
    tables |= {SWEEP: changes[SWEEP]} if SWEEP in changes else {}
    faults = list[tuple[Place, str]]()
    for key in (PROBLEMS, CONTROLLERS):
        if isinstance(base.get(key), dict) and isinstance(changes.get(key), dict):
            remaining = {name: entry for name, entry in changes[key].items() if (key, name) not in gone}
            tables[key], wrong = _entries(key, base[key], remaining)
            faults += [
                ((key, name), f'no {key.removesuffix("s")} "{name}" in {label}; {why}') for name, why in wrong
            ]
        elif key == PROBLEMS and key in changes and isinstance(changes[key], dict):
            what = f"{label} is a study of one problem; to have it among several: {PROBLEMS}.NAME.{STUDY}"
            faults.append(((PROBLEMS,), what))
        elif key in changes:
            tables[key] = changes[key]
    if isinstance(tables.get("report"), dict) and "panels" not in dict(_items(changes.get("report"))):
        new = _without(dict(_items(tables.get(CONTROLLERS))), dict(_items(base.get(CONTROLLERS))))
        tables["report"] = _with_panel_of(new, tables["report"])
    return tables, faults


def not_said(tables: Table, said: Table) -> Iterator[Place]:
    """Yield the places of tables, of each the outermost, that a file does not say itself."""
    for key, value in tables.items():
        if key not in said:
            yield (key,)
        elif isinstance(value, dict) and isinstance(said[key], dict):
            yield from ((key, *below) for below in not_said(value, said[key]))


def without_controllers(controllers: Collection[str], report: Table) -> Table:
    """Return a report without these controllers in its panels, as its baseline or as a reference point."""
    if any(name == report.get("baseline") for name in controllers):
        report = _without(report, ("baseline",))
    points = dict(_items(report.get("reference_points"))).values()
    if any(name in points for name in controllers):
        report = _without(report, ("reference_points",))
    panels = report.get("panels")
    if not isinstance(panels, list):
        return report
    kept = []
    for panel in panels:
        if isinstance(panel, dict) and isinstance(panel.get(CONTROLLERS), list):
            shown = [
                name for name in panel[CONTROLLERS] if not (isinstance(name, str) and name in controllers)
            ]
            panel = panel | {CONTROLLERS: shown}
            if not shown:
                continue
        kept.append(panel)
    return report | {"panels": kept}


def with_report(tables: Any, controllers: Collection[str]) -> Any:
    """Return a study or a problem whose report is neither of its results nor of what is left out."""
    if not (isinstance(tables, dict) and isinstance(tables.get("report"), dict)):
        return tables
    report = without_controllers(controllers, _without(tables["report"], ("reproduction",)))
    return tables | {"report": report}


def _items(table: Any) -> Any:
    return table.items() if isinstance(table, dict) else ()


def _without(table: Table, keys: Collection[str]) -> Table:
    return {key: value for key, value in table.items() if key not in keys}


def _remaining(base: Table, gone: Set[tuple[str, str]]) -> Table:
    """Return what of a study others take, without some problems and controllers and what is about them."""
    problems, controllers = (
        {name for first, name in gone if first == key} for key in (PROBLEMS, CONTROLLERS)
    )
    tables = _without(base, _OF_RESULTS)
    for key, names in ((PROBLEMS, problems), (CONTROLLERS, controllers)):
        tables |= {key: _without(base[key], names)} if names else {}
    for name, section in _items(tables.get(CONTROLLERS)) if problems else ():
        if isinstance(section, dict) and isinstance(section.get(PROBLEMS), dict):
            tables[CONTROLLERS] |= {name: section | {PROBLEMS: _without(section[PROBLEMS], problems)}}
    if isinstance(tables.get(PROBLEMS), dict):
        tables[PROBLEMS] = {
            name: with_report(problem, controllers) for name, problem in tables[PROBLEMS].items()
        }
    if gone and isinstance(tables.get(SWEEP), list | dict):
        tables[SWEEP] = _remaining_sweep(tables[SWEEP], gone)
    return dict(with_report(tables, controllers))


def _remaining_sweep(sweep: Any, gone: Set[tuple[str, str]]) -> list[Any]:
    """Return the tables of a sweep without paths into what is left out."""
    kept = [
        {key: values for key, values in table.items() if (path_of(key) or ())[:2] not in gone}
        if isinstance(table, dict)
        else table
        for table in ([sweep] if isinstance(sweep, dict) else sweep)
    ]
    return [table for table in kept if not isinstance(table, dict) or table.keys() - {ZIP}]


def _entries(key: str, base: Table, changes: Table) -> tuple[Table, list[tuple[str, str]]]:
    """Return problems or controllers, changed and joined by others; and the names that are wrong."""
    needed, change = _NEW[key]
    entries, wrong = dict(base), []
    for name, entry in changes.items():
        is_table = isinstance(entry, dict)
        if is_table and isinstance(base.get(name), dict):
            entries[name] = change(base[name], entry)
        elif name in base or needed & dict(_items(entry)).keys() or not (is_table or entry is False):
            entries[name] = entry
        else:
            wrong.append((name, f"{did_you_mean(name, base)}; a new one needs {' or '.join(sorted(needed))}"))
    return entries, wrong


def _changed_problem(base: Table, changes: Table) -> Table:
    """Return a problem with what a file says of it; one that it takes from elsewhere begins anew."""
    return changes if STUDY in changes else replaced(base, changes, leave_out=True)


def _changed_in_all(base: Table, changes: Table) -> Table:
    """Return a controller with what a file says of it, for all problems and then for some."""
    kind, of_all, of_some = base.get("type"), _without(changes, (PROBLEMS,)), changes.get(PROBLEMS, {})
    controller = _tuned_no_more(changed_controller(_without(base, (PROBLEMS,)), of_all, kind), of_all, kind)
    if not isinstance(of_some, dict):
        return controller | {PROBLEMS: of_some}
    problems = {name: _not_replaced(section, of_all, kind) for name, section in _items(base.get(PROBLEMS))}
    for name, change in of_some.items():
        old = dict(_items(problems.get(name)))
        known = old.get("type", controller.get("type"))
        problems[name] = change
        if isinstance(change, dict):
            problems[name] = _tuned_no_more(changed_controller(old, change, known), change, known)
    return controller | ({PROBLEMS: problems} if problems else {})


def _not_replaced(base: Any, changes: Table, kind: Any) -> Any:
    """Return what is left of what differs in a problem where a file says something of all problems."""
    if not isinstance(base, dict):
        return base
    known = base.get("type", kind)
    if "type" in changes:
        base = _without(base, _OF_TYPE if changes["type"] != known else ())
    elif known != kind:  # there the settings are another type's
        changes = _without(changes, _OF_TYPE)
    remaining: Table = {}
    for key, value in base.items():
        if key not in changes:
            remaining[key] = value
        elif isinstance(value, dict) and isinstance(changes[key], dict):
            remaining[key] = _without(value, changes[key])
    return _without(remaining, ("tuned",) if _changes_settings(changes, known) else ())


def _tuned_no_more(section: Table, changes: Table, kind: Any) -> Table:
    """Return a changed section that does not claim that settings were tuned which were not."""
    return section | ({"tuned": changes.get("tuned", False)} if _changes_settings(changes, kind) else {})


def _changes_settings(changes: Table, kind: Any) -> bool:
    return bool(changes.get("settings") or "tuned" in changes or changes.get("type", kind) != kind)


def _with_panel_of(new: Table, report: Table) -> Table:
    """Return a report that shows new controllers in a panel of their own, where it has panels."""
    panels = report.get("panels")
    if not new or not isinstance(panels, list) or not panels:
        return report
    title = ", ".join(str(dict(_items(section)).get("label") or name) for name, section in new.items())
    return report | {"panels": [*panels, {"title": title, CONTROLLERS: list(new)}]}


_NEW: dict[str, tuple[Set[str], Callable[[Table, Table], Table]]] = {
    PROBLEMS: ({"plant", STUDY}, _changed_problem),
    CONTROLLERS: ({"type"}, _changed_in_all),
}
"""What a new one needs, and how one is changed."""
