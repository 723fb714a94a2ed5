"""How what one file says replaces what another says, and what differs in a problem what all share."""

from collections.abc import Callable, Collection, Iterator, Set
from typing import Any

from ddpc_cosim.errors import Place
from ddpc_cosim.study.file_format.sweeps import ZIP, path_of
from fmu_plants.spelling import did_you_mean

Table = dict[str, Any]
PROBLEMS, CONTROLLERS, SWEEP = "problems", "controllers", "sweep"
EXTENDS, STUDY = "extends", "study"
"""The keys by which a study, and a problem of one, takes from another study."""
OF_PROBLEM = ("plant", "loop", "reference", "bounds", "recording", "scenarios", "metrics")
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

    found = dict(base)
    for key, value in changes.items():
        old = base.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            alternatives = _ALTERNATIVES.get(key, set())
            given, had = alternatives & value.keys(), alternatives & old.keys()
            if not (given and had and given != had):
                both = (old | value).items()
                value = {name: one for name, one in both if not is_left_out(one, old.get(name))}
        found[key] = value
        if is_left_out(value, old):
            del found[key]
    return found


def changed_controller(base: Table, changes: Table, kind: Any) -> Table:
    """Return a controller of a type with what differs: another type has settings of its own."""
    return replaced(_without(base, _OF_TYPE if changes.get("type", kind) != kind else ()), changes)


def extended(base: Table, own: Table, label: str) -> tuple[Table, list[tuple[Place, str]]]:
    """Return a study with what a file that extends it says; and what does not fit it, and why.

    Parameters
    ----------
    base : dict
        The tables of the study.
    own : dict
        Those of the file.
    label : str
        The name of the study in messages.
    """
    gone = {
        (key, name)
        for key in (PROBLEMS, CONTROLLERS)
        for name, one in _items(own.get(key))
        if one is False and name in dict(_items(base.get(key)))
    }
    base = _remaining(base, gone)
    found = replaced(base, _without(own, (EXTENDS, PROBLEMS, CONTROLLERS)), leave_out=True)
    found |= {SWEEP: own[SWEEP]} if SWEEP in own else {}
    faults = list[tuple[Place, str]]()
    for key in (PROBLEMS, CONTROLLERS):
        if isinstance(base.get(key), dict) and isinstance(own.get(key), dict):
            found[key], wrong = _entries(
                key, base[key], {name: one for name, one in own[key].items() if (key, name) not in gone}
            )
            faults += [
                ((key, name), f'no {key.removesuffix("s")} "{name}" in {label}; {why}') for name, why in wrong
            ]
        elif key == PROBLEMS and key in own and isinstance(own[key], dict):
            what = f"{label} is a study of one problem; to have it among several: {PROBLEMS}.NAME.{STUDY}"
            faults.append(((PROBLEMS,), what))
        elif key in own:
            found[key] = own[key]
    if isinstance(found.get("report"), dict) and "panels" not in dict(_items(own.get("report"))):
        new = _without(dict(_items(found.get(CONTROLLERS))), dict(_items(base.get(CONTROLLERS))))
        found["report"] = _with_panel_of(new, found["report"])
    return found, faults


def not_said(tables: Table, own: Table) -> Iterator[Place]:
    """Yield the places of tables, of each the outermost, that a file does not say itself."""
    for key, value in tables.items():
        if key not in own:
            yield (key,)
        elif isinstance(value, dict) and isinstance(own[key], dict):
            yield from ((key, *below) for below in not_said(value, own[key]))


def without_panels_of(controllers: Collection[str], report: Table) -> Table:
    """Return a report whose panels show none of these controllers."""
    panels = report.get("panels")
    if not isinstance(panels, list):
        return report
    kept = []
    for panel in panels:
        if isinstance(panel, dict) and isinstance(panel.get(CONTROLLERS), list):
            shown = [one for one in panel[CONTROLLERS] if not (isinstance(one, str) and one in controllers)]
            panel = panel | {CONTROLLERS: shown}
            if not shown:
                continue
        kept.append(panel)
    return report | {"panels": kept}


def with_report(tables: Any, controllers: Collection[str]) -> Any:
    """Return a study or a problem whose report is neither of its results nor of what is left out."""
    if not (isinstance(tables, dict) and isinstance(tables.get("report"), dict)):
        return tables
    report = without_panels_of(controllers, _without(tables["report"], ("reproduction",)))
    points = dict(_items(report.get("reference_points"))).values()
    is_cut = any(one in points for one in controllers)
    return tables | {"report": _without(report, ("reference_points",) if is_cut else ())}


def _items(table: Any) -> Any:
    return table.items() if isinstance(table, dict) else ()


def _without(table: Table, keys: Collection[str]) -> Table:
    return {key: value for key, value in table.items() if key not in keys}


def _remaining(base: Table, gone: Set[tuple[str, str]]) -> Table:
    """Return what of a study others take, without some problems and controllers and what is about them."""
    problems, controllers = (
        {name for first, name in gone if first == key} for key in (PROBLEMS, CONTROLLERS)
    )
    found = _without(base, _OF_RESULTS)
    for key, names in ((PROBLEMS, problems), (CONTROLLERS, controllers)):
        found |= {key: _without(base[key], names)} if names else {}
    for name, section in _items(found.get(CONTROLLERS)) if problems else ():
        if isinstance(section, dict) and isinstance(section.get(PROBLEMS), dict):
            found[CONTROLLERS] |= {name: section | {PROBLEMS: _without(section[PROBLEMS], problems)}}
    if isinstance(found.get(PROBLEMS), dict):
        found[PROBLEMS] = {name: with_report(one, controllers) for name, one in found[PROBLEMS].items()}
    if gone and isinstance(found.get(SWEEP), list | dict):
        found[SWEEP] = _remaining_sweep(found[SWEEP], gone)
    return dict(with_report(found, controllers))


def _remaining_sweep(sweep: Any, gone: Set[tuple[str, str]]) -> list[Any]:
    """Return the tables of a sweep without paths into what is left out."""
    kept = [
        {key: values for key, values in one.items() if (path_of(key) or ())[:2] not in gone}
        if isinstance(one, dict)
        else one
        for one in ([sweep] if isinstance(sweep, dict) else sweep)
    ]
    return [one for one in kept if not isinstance(one, dict) or one.keys() - {ZIP}]


def _entries(key: str, base: Table, own: Table) -> tuple[Table, list[tuple[str, str]]]:
    """Return problems or controllers, changed and joined by others; and the names that are wrong."""
    needed, change = _NEW[key]
    found, wrong = dict(base), []
    for name, one in own.items():
        if isinstance(one, dict) and isinstance(base.get(name), dict):
            found[name] = change(base[name], one)
        elif name in base or needed & dict(_items(one)).keys() or not (one is False or isinstance(one, dict)):
            found[name] = one
        else:
            wrong.append((name, f"{did_you_mean(name, base)}; a new one needs {' or '.join(sorted(needed))}"))
    return found, wrong


def _changed_problem(base: Table, own: Table) -> Table:
    """Return a problem with what a file says of it; one that it takes from elsewhere begins anew."""
    return own if STUDY in own else replaced(base, own, leave_out=True)


def _changed_in_all(base: Table, own: Table) -> Table:
    """Return a controller with what a file says of it, for all problems and then for some."""
    kind, of_all, of_some = base.get("type"), _without(own, (PROBLEMS,)), own.get(PROBLEMS, {})
    found = _tuned_no_more(changed_controller(_without(base, (PROBLEMS,)), of_all, kind), of_all, kind)
    if not isinstance(of_some, dict):
        return found | {PROBLEMS: of_some}
    problems = {name: _not_replaced(one, of_all, kind) for name, one in _items(base.get(PROBLEMS))}
    for name, one in of_some.items():
        old = dict(_items(problems.get(name)))
        known = old.get("type", found.get("type"))
        problems[name] = (
            _tuned_no_more(changed_controller(old, one, known), one, known) if isinstance(one, dict) else one
        )
    return found | ({PROBLEMS: problems} if problems else {})


def _not_replaced(base: Any, own: Table, kind: Any) -> Any:
    """Return what is left of what differs in a problem where a file says something of all problems."""
    if not isinstance(base, dict):
        return base
    known = base.get("type", kind)
    if "type" in own:
        base = _without(base, _OF_TYPE if own["type"] != known else ())
    elif known != kind:  # there the settings are another type's
        own = _without(own, _OF_TYPE)
    found: Table = {}
    for key, value in base.items():
        if key not in own:
            found[key] = value
        elif isinstance(value, dict) and isinstance(own[key], dict):
            found[key] = _without(value, own[key])
    return _without(found, ("tuned",) if _changes_settings(own, known) else ())


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
    title = ", ".join(str(dict(_items(one)).get("label") or name) for name, one in new.items())
    return report | {"panels": [*panels, {"title": title, CONTROLLERS: list(new)}]}


_NEW: dict[str, tuple[Set[str], Callable[[Table, Table], Table]]] = {
    PROBLEMS: ({"plant", STUDY}, _changed_problem),
    CONTROLLERS: ({"type"}, _changed_in_all),
}
"""What a new one needs, and how one is changed."""
