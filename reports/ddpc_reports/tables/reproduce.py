"""How to have the results again: the command, the study, the code, the machine, and the plants."""

from collections.abc import Iterator, Mapping, Sequence

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Row, Table, text_headings
from ddpc_cosim.files.texts import without_folders
from ddpc_reports.numbers import MISSING
from ddpc_reports.tables.settings import compact_seeds, facts_table

_VERSION, _CASES_RUN = " version", "cases run"
_SAID = {"run again", "command", "system", "cpu", "date", "ddpc-cosim commit"}
_SAID |= {"study", "study file", "study file sha256", "study file commit", "study sha256"}
_OF_PLANT = ("fmu", "fmi version", "plant content", "parts", "coupling")
_WORDS = {
    "fmi version": "FMI {}",
    "fmu model": "model {}",
    "fmu tool": "made by {}",
    "fmu guid": "GUID {}",
    "fmu tolerance": "tolerance {}",
    "plant content": "with {}",
}


def reproduce_tables(results: StudyResults, prefix: str) -> list[Table]:
    """Return what was run, by what and on what, as the run recorded it, and the plants, each once."""
    parts = results.problems()
    several = len(parts) > 1
    plants: dict[tuple[tuple[str, str], ...], list[str]] = {}
    common = dict[str, str]()
    for part in parts:
        provenance = {name: without_folders(fact) for name, fact in part.provenance.items()}
        # Of several problems, what is of one plant stands with the problem's name.
        of_plant = {
            name: fact
            for name, fact in provenance.items()
            if (name not in results.provenance if several else _is_of_plant(name))
        }
        common = {name: fact for name, fact in provenance.items() if name not in of_plant}
        common |= _of_last_with_cases(results)
        plants.setdefault(tuple(of_plant.items()), []).append(part.study.title or part.study.name)
    facts = dict(_facts(results, common))
    if not several and any(plants):
        (of_plant,) = map(dict, plants)
        facts = {**facts, "plant": _plant_words(of_plant), "plant SHA-256": _content(of_plant)}
    date = {"date": common["date"]} if "date" in common else {}
    run = facts_table(f"{prefix}run", "What was run", (facts | date).items(), "run.csv")
    runs = [_runs_table(results, prefix)] if len(results.runs) > 1 else []
    return [run, *runs, *([_plants_table(plants, prefix)] if several else [])]


def _of_last_with_cases(results: StudyResults) -> dict[str, str]:
    """Return the provenance of the last run that ran cases: only such a run has a part in the figures."""
    last = next((run for run in reversed(results.runs) if run.get(_CASES_RUN) != "0"), {})
    return {name: without_folders(fact) for name, fact in last.items() if name != _CASES_RUN}


def _runs_table(results: StudyResults, prefix: str) -> Table:
    """Return every run over the folder: its figures may be of several."""
    rows = tuple(
        Row(
            run.get("date", MISSING),
            tuple(
                Cell(without_folders(run.get(name, "")) or MISSING)
                for name in ("run again", _CASES_RUN, "wall time", "ddpc-cosim version", "system")
            ),
        )
        for run in results.runs
    )
    headings = text_headings("Date", "Command", "Cases run", "Wall time", "ddpc-cosim", "Machine")
    return Table(f"{prefix}runs", "All runs over the folder", headings, rows, download="runs.csv")


def _is_of_plant(name: str) -> bool:
    """Whether a fact is one of the plant, or of a part of it: ``part.fmu``."""
    of_part = name.rpartition(".")[2]
    return of_part in _OF_PLANT or of_part.startswith("fmu ")


def _facts(results: StudyResults, provenance: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield names and values, as far as they are known: what to type, what it was done with, how it went."""
    versions = {
        name.removesuffix(_VERSION): fact for name, fact in provenance.items() if name.endswith(_VERSION)
    }
    facts = {
        # Earlier versions kept what was typed, and nothing else of it.
        "command": provenance.get("run again") or provenance.get("command"),
        "study": provenance.get("study"),
        "study file": provenance.get("study file"),
        "study file SHA-256": provenance.get("study file sha256"),
        "study file commit": provenance.get("study file commit"),
        "study.toml SHA-256": provenance.get("study sha256"),
        "seeds": compact_seeds([*dict.fromkeys(case.seed for case in results.cases)]),
        "ddpc-cosim": versions.pop("ddpc-cosim", ""),
        "ddpc-cosim commit": provenance.get("ddpc-cosim commit"),
        "packages": ", ".join(f"{name} {fact}" for name, fact in versions.items()),
        "machine": ", ".join(provenance[name] for name in ("system", "cpu") if name in provenance),
    }
    known = {name for name in provenance if name in _SAID or name.endswith(_VERSION)}
    facts |= {name.replace("_", " "): fact for name, fact in provenance.items() if name not in known}
    return ((name, fact) for name, fact in facts.items() if fact)


def _plants_table(plants: Mapping[tuple[tuple[str, str], ...], Sequence[str]], prefix: str) -> Table:
    rows = tuple(
        Row(", ".join(titles), (Cell(_plant_words(dict(facts))), Cell(_content(dict(facts)))))
        for facts, titles in plants.items()
    )
    headings = text_headings("Problem", "plant", "SHA-256")
    return Table(f"{prefix}plants", "The plants", headings, rows, kind="facts", download="plants.csv")


def _plant_words(provenance: Mapping[str, str]) -> str:
    """Return all that is said of a plant besides its hash, and nothing twice."""
    file, content = provenance.get("fmu", ""), _content(provenance)
    said = {"fmu", "fmu sha256"} | (
        {"fmu model"} if provenance.get("fmu model") == file.removesuffix(".fmu") else set()
    )
    rest = {name: fact for name, fact in provenance.items() if name not in said}
    # A plant is an FMU's file and what the study has changed of its variables.
    rest["plant content"] = rest.get("plant content", "").removeprefix(content).strip()
    words = [
        _WORDS.get(name, f"{name.replace('_', ' ')} {{}}").format(fact) for name, fact in rest.items() if fact
    ]
    return ", ".join(filter(None, [file, *words])) or MISSING


def _content(provenance: Mapping[str, str]) -> str:
    return provenance.get("fmu sha256") or provenance.get("plant content", MISSING)
