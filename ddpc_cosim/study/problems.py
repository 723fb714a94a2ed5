"""Studies of several problems: their tables become one flat study for each, and are written as one again."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Self

from ddpc_cosim.codec import ValidationErrors, declared_fields, known_keys, read, write
from ddpc_cosim.errors import Place
from ddpc_cosim.files.texts import encodable
from ddpc_cosim.study.file_format.replacing import (
    CONTROLLERS,
    OF_PROBLEM,
    PROBLEMS,
    STUDY,
    SWEEP,
    Table,
    changed_controller,
    replaced,
    without_controllers,
)
from ddpc_cosim.study.file_format.requirements import (
    REQUIREMENTS,
    RequirementSection,
    RequirementsSection,
)
from ddpc_cosim.study.file_format.sections import ScenarioSection, Study, StudyHead
from fmu_plants.spelling import did_you_mean

OF_HEAD = tuple(declared_fields(StudyHead))
_WORDS = ("title", "summary", "source")
_OF_PROBLEM = (*_WORDS, "variant_of", "varied", *OF_PROBLEM, "report")
_SHARED = {"report": 2, REQUIREMENTS: 3}
"""What a study may say for all of its problems, and how many keys of a place a problem replaces together."""


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
            return cls.of(_written(tables))
        head = read(StudyHead, {key: tables[key] for key in OF_HEAD if key in tables})
        parts = flat_studies(tables, ValidationErrors())
        return cls(head, {part.problem: _written(part.tables) for part in parts})

    def tables(self) -> Table:
        """Return the study as a file says it."""
        written = {name: write(study) for name, study in self.problems.items()}
        for tables in written.values():
            if not tables["variant_of"]:
                del tables["variant_of"], tables["varied"]
        if self.is_flat:
            only: Table = written[self.head.name]
            return only
        controllers = {
            key: _shared({name: tables[CONTROLLERS].get(key, False) for name, tables in written.items()})
            for key in dict.fromkeys(key for tables in written.values() for key in tables[CONTROLLERS])
        }
        return {
            **{key: getattr(self.head, key) for key in OF_HEAD},
            PROBLEMS: {
                name: {key: tables[key] for key in _OF_PROBLEM if key in tables}
                for name, tables in written.items()
            },
            CONTROLLERS: controllers,
        }

    def toml(self) -> bytes:
        """Return the study as the content of a file."""
        import tomli_w

        return encodable(tomli_w.dumps(self.tables())).encode()

    def with_seeds(self, seeds: list[int]) -> Self:
        """Return the study on other seeds; on none: on its own."""
        if not seeds:
            return self
        changed = {name: replace(study, seeds=seeds) for name, study in self.problems.items()}
        head = changed[self.head.name] if self.is_flat else replace(self.head, seeds=seeds)
        return type(self)(head, changed)


def _written(tables: Table) -> Study:
    """Return a flat study that was run; what is of packages that are not installed is kept by its name."""
    tables, lost = _known_requirements(tables)
    study = _with_its_conditions(tables)
    if lost and study.requirements is not None:
        limits = study.requirements.limits | {key: read(RequirementSection, lost[key]) for key in lost}
        study = replace(study, requirements=replace(study.requirements, limits=limits))
    return study


def _known_requirements(tables: Table) -> tuple[Table, Table]:
    """Return tables without requirements on metrics that are not installed here, and those."""
    requirements = tables.get(REQUIREMENTS, {})
    lost = {key: table for key, table in requirements.items() if key not in known_keys(RequirementsSection)}
    known = {key: table for key, table in requirements.items() if key not in lost}
    return (tables | {REQUIREMENTS: known}, lost) if lost else (tables, lost)


def _with_its_conditions(tables: Table) -> Study:
    known, scenarios = declared_fields(ScenarioSection), tables.get("scenarios")
    gone = {
        name: {key: value for key, value in scenario.items() if key not in known and _is_effect(value)}
        for name, scenario in (scenarios.items() if isinstance(scenarios, dict) else ())
        if isinstance(scenario, dict) and scenario.keys() - known.keys()
    }
    if not gone:
        return read(Study, tables)
    sound = {
        name: {key: value for key, value in scenario.items() if key not in gone.get(name, {})}
        for name, scenario in tables["scenarios"].items()
    }
    study = read(Study, tables | {"scenarios": sound})
    kept = {
        name: replace(scenario, effects=scenario.effects | gone.get(name, {}))
        for name, scenario in study.scenarios.items()
    }
    return replace(study, scenarios=kept)


def _is_effect(value: Any) -> bool:
    return isinstance(value, dict) and all(type(number) in (int, float) for number in value.values())


class FlatStudy(NamedTuple):
    """The tables of one problem as a flat study.

    Parameters
    ----------
    problem : str
        The problem's name; of a variant that of the problem that it is a variant of.
    tables : dict
        Its tables; their ``name`` is its own.
    origin : callable
        Of a place in the tables, that in the tables of the whole study.
    """

    problem: str
    tables: Table
    origin: Callable[[Place], Place]


def flat_studies(tables: Table, errors: ValidationErrors) -> Iterator[FlatStudy]:
    """Yield each problem of a study as a flat study; what is wrong with how they stand is reported.

    Parameters
    ----------
    tables : dict
        The tables of the study, ``problems`` among them.
    errors : ValidationErrors
        What is found is added.
    """
    allowed = (*OF_HEAD, PROBLEMS, CONTROLLERS, *_SHARED, SWEEP)
    for key in tables:
        if key in OF_PROBLEM and key not in _SHARED:
            errors.add((key,), f"each problem has its own: {PROBLEMS}.NAME.{key}")
        elif key not in allowed:
            errors.add((key,), f"unknown key; {did_you_mean(key, allowed)}")
    problems = tables[PROBLEMS]
    if not isinstance(problems, dict) or not problems:
        errors.add((PROBLEMS,), "must be a table of problems, each a table")
        return
    controllers = tables.get(CONTROLLERS, {})
    _check_changes(controllers, problems, errors)
    for name, problem in problems.items():
        place = (PROBLEMS, name)
        if not isinstance(problem, dict):
            errors.add(place, "must be a table")
            continue
        if STUDY in problem:  # it could not be taken, which has been reported
            continue
        problem_tables = dict(problem)
        for key in problem_tables.keys() & {"seeds", CONTROLLERS, PROBLEMS, "name"}:
            errors.add((*place, key), "belongs to the study and not to one of its problems")
            del problem_tables[key]
        flat = {
            "name": name,
            **({"seeds": tables["seeds"]} if "seeds" in tables else {}),
            **replaced({key: tables[key] for key in _SHARED if key in tables}, problem_tables),
            CONTROLLERS: _controllers_of(name, controllers),
        }
        if isinstance(flat.get("report"), dict) and isinstance(controllers, dict):
            left_out = controllers.keys() - flat[CONTROLLERS].keys()
            flat["report"] = without_controllers(left_out, flat["report"])
        yield FlatStudy(name, flat, partial(_origin, tables, name))


def _check_changes(controllers: Any, problems: Table, errors: ValidationErrors) -> None:
    """Report changes for problems that do not exist, and those that are not tables."""
    for key, section in controllers.items() if isinstance(controllers, dict) else ():
        place = (CONTROLLERS, key, PROBLEMS)
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
    sections: Table = {}
    for key, section in controllers.items():
        changes = _changes(section, problem)
        if not isinstance(section, dict):
            sections[key] = section
        elif changes is not False:
            base = {name: value for name, value in section.items() if name != PROBLEMS}
            sections[key] = changed_controller(base, changes, base.get("type"))
    return sections


def _changes(section: Any, problem: str) -> Any:
    """Return what differs for a problem: a table, or False if the controller is left out of it."""
    changes = section.get(PROBLEMS) if isinstance(section, dict) else None
    change = changes.get(problem, {}) if isinstance(changes, dict) else {}
    return change if change is False or isinstance(change, dict) else {}


def _origin(tables: Table, problem: str, place: Place) -> Place:
    """Return where a place of a problem's flat study stands in the whole study."""
    first, place_of_problem = place[0], (PROBLEMS, problem)
    if first == CONTROLLERS and len(place) > 2:
        changes = _changes(tables[CONTROLLERS][place[1]], problem) or {}
        of_problem = has_key(changes, place[2:4])  # a key, and a key in it
        return (*place[:2], *place_of_problem, *place[2:]) if of_problem else place
    if first == "name":
        return place_of_problem
    of_study = first in _SHARED and not has_key(tables[PROBLEMS][problem], place[: _SHARED[first]])
    return place if of_study or first in ("seeds", CONTROLLERS) else (*place_of_problem, *place)


def has_key(table: Any, place: Place) -> bool:
    """Whether a table says something of a place."""
    for key in place:
        if not isinstance(table, dict):
            return True  # it stands in a value
        if key not in table:
            return False
        table = table[key]
    return True


def _shared(sections: Mapping[str, Any]) -> Table:
    """Return a controller's section for all problems and, under ``problems``, what differs in some.

    The inverse of :func:`_controllers_of`.
    """
    tables = [section for section in sections.values() if section is not False]
    base = _common(tables) if all(table["type"] == tables[0]["type"] for table in tables) else {}
    for key in tables[0]:
        if key not in base and base and all(isinstance(table.get(key), dict) for table in tables):
            base[key] = _common([table[key] for table in tables])
    changes = {name: section and _difference(base, section) for name, section in sections.items()}
    changes = {name: change for name, change in changes.items() if change is False or change}
    return base | ({PROBLEMS: changes} if changes else {})


def _common(tables: Sequence[Table]) -> Table:
    first, *others = tables
    return {key: v for key, v in first.items() if all(key in other and other[key] == v for other in others)}


def _difference(base: Table, section: Table) -> Table:
    """Return what of a section its base does not say."""
    differences: Table = {}
    for key, value in section.items():
        if key not in base:
            differences[key] = value
        elif base[key] != value:
            differences[key] = {entry: item for entry, item in value.items() if entry not in base[key]}
    return differences
