"""Studies of several problems: their tables become one flat study for each, and are written as one again."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

from ddpc_cosim.errors import ConfigError, CosimError, Place
from ddpc_cosim.settings import PLANT, map_files
from ddpc_cosim.study.controller_plugins import controller_class
from ddpc_cosim.study.file_format.sections import Study, StudyHead
from ddpc_cosim.study.file_format.validation_errors import ValidationErrors, in_folder
from fmu_plants.spelling import did_you_mean

Table = dict[str, Any]
PROBLEMS = "problems"
OF_HEAD = tuple(StudyHead.model_fields)
_TAKEN = ("plant", "loop", "reference", "bounds", "recording", "scenarios", "metrics")
"""What a problem takes from a study file."""
_WORDS = ("title", "summary", "source")
_OF_PROBLEM = (*_WORDS, "variant_of", "varied", *_TAKEN, "report")
# Of each table, keys of which one excludes the other.
_ALTERNATIVES = {"plant": {"name", "fmu"}, "recording": {"samples", "file"}}


@dataclass(frozen=True, slots=True)
class WholeStudy:
    """A study with all its problems.

    Parameters
    ----------
    head : StudyHead
        What it says of itself; of a flat study that study.
    problems : dict of str to Study
        Each problem as a flat study, which has the problem's name.
    """

    head: StudyHead
    problems: dict[str, Study]

    @property
    def is_flat(self) -> bool:
        """Whether its tables are those of one problem."""
        return isinstance(self.head, Study)

    @classmethod
    def of(cls, study: Study) -> Self:
        """Return a flat study as a whole."""
        return cls(study, {study.name: study})

    @classmethod
    def of_tables(cls, tables: Table) -> Self:
        """Return the study that :meth:`tables` returned the tables of."""
        if PROBLEMS not in tables:
            return cls.of(Study.model_validate(tables))
        head = StudyHead.model_validate({key: tables[key] for key in OF_HEAD if key in tables})
        parts = flat_studies(tables, Path(), _nothing, ValidationErrors())
        return cls(head, {part.problem: Study.model_validate(part.tables) for part in parts})

    def tables(self) -> Table:
        """Return the study as a file says it."""
        written = {
            name: one.model_dump(mode="python", exclude_none=True) for name, one in self.problems.items()
        }
        for one in written.values():
            if not one["variant_of"]:
                del one["variant_of"], one["varied"]
        if self.is_flat:
            return written[self.head.name]
        controllers = {
            key: _shared({name: one["controllers"].get(key, False) for name, one in written.items()})
            for key in dict.fromkeys(key for one in written.values() for key in one["controllers"])
        }
        return {
            **{key: getattr(self.head, key) for key in OF_HEAD},
            PROBLEMS: {
                name: {key: one[key] for key in _OF_PROBLEM if key in one} for name, one in written.items()
            },
            "controllers": controllers,
        }

    def with_seeds(self, seeds: list[int]) -> Self:
        """Return the study on other seeds; on none: on its own."""
        if not seeds:
            return self
        changed = {name: one.model_copy(update={"seeds": seeds}) for name, one in self.problems.items()}
        head = changed[self.head.name] if self.is_flat else self.head.model_copy(update={"seeds": seeds})
        return type(self)(head, changed)


class Taken(NamedTuple):
    """The tables of another study file.

    Parameters
    ----------
    file : str
        Its name in messages.
    folder : Path
        Its folder: paths in it are relative to this.
    tables : dict
        Its content.
    """

    file: str
    folder: Path
    tables: Table


class FlatStudy(NamedTuple):
    """The tables of one problem as a flat study, and where they come from.

    Parameters
    ----------
    problem : str
        The problem's name; of a variant that of the problem that it is a variant of.
    tables : dict
        Its tables; their ``name`` is its own.
    origin : callable
        Of a place in the tables, the file in which it stands (empty: the study's own) and its place there.
    """

    problem: str
    tables: Table
    origin: Callable[[Place], tuple[str, Place]]


def flat_studies(
    tables: Table, folder: Path, read: Callable[[str], Taken], errors: ValidationErrors
) -> Iterator[FlatStudy]:
    """Yield each problem of a file as a flat study; what is wrong with how they are put together is reported.

    Parameters
    ----------
    tables : dict
        The file's content, with a table ``problems``.
    folder : Path
        The file's folder.
    read : callable
        Returns the study that a problem names; a CosimError says why it cannot.
    errors : ValidationErrors
        What is found is added.
    """
    allowed = (*OF_HEAD, PROBLEMS, "controllers", "report", "sweep")
    for key in tables:
        if key in _TAKEN:
            errors.add((key,), f"each problem has its own: {PROBLEMS}.NAME.{key}")
        elif key not in allowed:
            errors.add((key,), f"unknown key; {did_you_mean(key, allowed)}")
    problems = tables[PROBLEMS]
    if not isinstance(problems, dict) or not problems:
        errors.add((PROBLEMS,), "must be a table of problems, each a table")
        return
    controllers = tables.get("controllers", {})
    _check_changes(controllers, problems, errors)
    for name, problem in problems.items():
        place = (PROBLEMS, name)
        if not isinstance(problem, dict):
            errors.add(place, "must be a table")
            continue
        own = {key: value for key, value in problem.items() if key != "study"}
        for key in own.keys() & {"seeds", "controllers", PROBLEMS, "name"}:
            errors.add((*place, key), "belongs to the study and not to one of its problems")
            del own[key]
        taken = _taken(problem, folder, read, (*place, "study"), errors)
        if taken is None:
            continue
        base = {key: taken.tables[key] for key in _TAKEN if key in taken.tables}
        report = {"report": tables["report"]} if "report" in tables else {}
        flat = {
            "name": name,
            **({"seeds": tables["seeds"]} if "seeds" in tables else {}),
            **_replaced(report | base, own),
            "controllers": _controllers_of(name, controllers),
        }
        if isinstance(flat.get("report"), dict):
            flat["report"] = _with_panels_of(flat["report"], controllers, flat["controllers"])
        yield FlatStudy(name, flat, partial(_origin, tables, name, taken))


def _nothing(study: str) -> Taken:
    """Refuse to read another study: what is written out names none."""
    raise ConfigError(f"{study}: not written out")


def _check_changes(controllers: Any, problems: Table, errors: ValidationErrors) -> None:
    """Report changes for problems that do not exist, and those that are not tables."""
    for key, section in controllers.items() if isinstance(controllers, dict) else ():
        place = ("controllers", key, PROBLEMS)
        changes = section.get(PROBLEMS, {}) if isinstance(section, dict) else {}
        if not isinstance(changes, dict):
            errors.add(place, "must be a table, with a table for each problem in which something differs")
            continue
        errors.require_known(place, "problem", changes, problems)
        for name, change in changes.items():
            if not isinstance(change, dict) and change is not False:
                what = "must be a table of what differs there, or false to leave the controller out"
                errors.add((*place, name), what)


def _controllers_of(problem: str, controllers: Any) -> Any:
    """Return the controllers of a problem, with what differs there."""
    if not isinstance(controllers, dict):
        return controllers
    found: Table = {}
    for key, section in controllers.items():
        changes = _changes(section, problem)
        if not isinstance(section, dict):
            found[key] = section
        elif changes is not False:
            base = {name: value for name, value in section.items() if name != PROBLEMS}
            if "type" in changes:  # settings of another type
                base.pop("settings", None)
            found[key] = _replaced(base, changes)
    return found


def _changes(section: Any, problem: str) -> Any:
    """Return what differs for a problem: a table, or False if the controller is left out of it."""
    changes = section.get(PROBLEMS) if isinstance(section, dict) else None
    change = changes.get(problem, {}) if isinstance(changes, dict) else {}
    return change if change is False or isinstance(change, dict) else {}


def _with_panels_of(report: Table, controllers: Any, own: Any) -> Table:
    """Return a report whose panels show no controllers that are left out of the problem."""
    panels = report.get("panels")
    if not (isinstance(panels, list) and isinstance(controllers, dict)):
        return report
    left_out = controllers.keys() - own.keys()
    kept = []
    for panel in panels:
        if isinstance(panel, dict) and isinstance(panel.get("controllers"), list):
            panel = panel | {"controllers": [one for one in panel["controllers"] if one not in left_out]}
            if not panel["controllers"]:
                continue
        kept.append(panel)
    return report | {"panels": kept}


def _taken(
    problem: Table, folder: Path, read: Callable[[str], Taken], place: Place, errors: ValidationErrors
) -> Taken | None:
    """Return the tables of the study that a problem names, with absolute paths; None if there is an error."""
    if "study" not in problem:
        return Taken("", folder, {})
    named = problem["study"]
    if not isinstance(named, str):
        errors.add(place, f"must be a study file or the name of a built-in study, got {named!r}")
        return None
    try:
        taken = read(named)
    except CosimError as error:
        errors.add(place, str(error))
        return None
    if PROBLEMS in taken.tables:
        errors.add(place, f"{taken.file} has problems itself; needed: a study with [plant], [loop], ...")
        return None
    return (
        taken
        if taken.folder == folder
        else taken._replace(
            tables=absolute_paths(
                {key: taken.tables[key] for key in _TAKEN if key in taken.tables}, taken.folder
            )
        )
    )


def absolute_paths(tables: Table, folder: Path) -> Table:
    """Return the tables of a study, or of a problem, in which files are named by absolute paths."""

    def walk(value: Any, key: str = "") -> Any:
        if isinstance(value, dict):
            return {name: walk(item, name) for name, item in value.items()}
        if isinstance(value, list):
            return [walk(item, key) for item in value]
        return str(in_folder(folder, value)) if key == "file" and isinstance(value, str) and value else value

    found: Table = {key: walk(table) if key in _TAKEN else table for key, table in tables.items()}
    with suppress(KeyError, TypeError):
        found["plant"]["fmu"] = str(in_folder(folder, found["plant"]["fmu"]))
    with suppress(KeyError, TypeError, AttributeError):
        found["recording"]["controller"] = _absolute_settings(found["recording"]["controller"], folder)
    with suppress(KeyError, TypeError, AttributeError):
        sections = found["controllers"].items()
        found["controllers"] = {key: _absolute_settings(one, folder) for key, one in sections}
    with suppress(KeyError, TypeError, AttributeError):
        found[PROBLEMS] = {key: absolute_paths(one, folder) for key, one in found[PROBLEMS].items()}
    with suppress(KeyError, TypeError):
        beside = in_folder(folder, found["study"])
        found["study"] = str(beside) if beside.is_file() else found["study"]
    return found


def _absolute_settings(section: Table, folder: Path) -> Table:
    """Return a controller's section in which settings name files by absolute paths."""
    found, kind = dict(section), section.get("type")

    def absolute(table: Table, kind: Any) -> Table:
        with suppress(KeyError, TypeError, AttributeError, CosimError):  # its own check says what is wrong
            settings = map_files(
                controller_class(kind),
                table["settings"],
                lambda path: path if path == PLANT else str(in_folder(folder, path)),
            )
            return table | {"settings": settings}
        return table

    if isinstance(section.get(PROBLEMS), dict):
        found[PROBLEMS] = {
            name: absolute(one, one.get("type", kind)) if isinstance(one, dict) else one
            for name, one in section[PROBLEMS].items()
        }
    return absolute(found, kind)


def _origin(tables: Table, problem: str, taken: Taken, place: Place) -> tuple[str, Place]:
    """Return where a place of a problem's flat study comes from."""
    first, own, said = place[0], (PROBLEMS, problem), tables[PROBLEMS][problem]
    if first == "controllers" and len(place) > 2:
        changes = _changes(tables["controllers"][place[1]], problem) or {}
        of_problem = has_key(changes, place[2:4])  # a key, and a key in it
        return "", (*place[:2], PROBLEMS, problem, *place[2:]) if of_problem else place
    if first == "name":
        return "", own
    if first in ("seeds", "controllers") or (first == "report" and not has_key(said, place[:2])):
        return "", place
    if first in taken.tables and not has_key(said, place[:2]):
        return taken.file, place
    return "", (*own, *place)


def has_key(table: Any, place: Place) -> bool:
    """Whether a table says something of a place."""
    for key in place:
        if not isinstance(table, dict):
            return True  # it stands in a value
        if key not in table:
            return False
        table = table[key]
    return True


def _replaced(base: Table, changes: Table) -> Table:
    """Return tables of which keys are replaced, such as ``loop.duration``, ``reference.angle``."""
    found = dict(base)
    for key, value in changes.items():
        old = base.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            alternatives = _ALTERNATIVES.get(key, set())
            given, had = alternatives & value.keys(), alternatives & old.keys()
            value = value if given and had and given != had else old | value
        found[key] = value
    return found


def _shared(sections: Mapping[str, Any]) -> Table:
    """Return a controller's section for all problems and, under ``problems``, what differs in some.

    The inverse of :func:`_controllers_of`.
    """
    tables = [one for one in sections.values() if one is not False]
    base = _common(tables) if all(one["type"] == tables[0]["type"] for one in tables) else {}
    for key in tables[0]:
        if key not in base and base and all(isinstance(one.get(key), dict) for one in tables):
            base[key] = _common([one[key] for one in tables])
    changes = {name: one and _difference(base, one) for name, one in sections.items()}
    changes = {name: change for name, change in changes.items() if change is False or change}
    return base | ({PROBLEMS: changes} if changes else {})


def _common(tables: Sequence[Table]) -> Table:
    first, *others = tables
    return {key: v for key, v in first.items() if all(key in one and one[key] == v for one in others)}


def _difference(base: Table, section: Table) -> Table:
    """Return what of a section its base does not say."""
    found: Table = {}
    for key, value in section.items():
        if key not in base:
            found[key] = value
        elif base[key] != value:
            found[key] = {entry: item for entry, item in value.items() if entry not in base[key]}
    return found
