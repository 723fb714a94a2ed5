"""How to have the results again: each fact once, and no folder of the machine that they were made on."""

from dataclasses import replace

from ddpc_cosim import StudyResults
from ddpc_cosim.study.problems import WholeStudy
from ddpc_reports.page import render_page
from ddpc_reports.tables.reproduce import reproduce_tables

from ..synthetic import MakeResults

RUN = {
    "run again": "ddpc-cosim run own.toml --seeds 0:3",
    "command": "ddpc-cosim run /home/jo/own.toml --seeds 0:3 --out /home/jo/out",
    "study file": "/home/jo/own.toml",
    "study file sha256": "5a5a",
    "study file commit": "c0ffee, clean",
    "study sha256": "e1e1",
    "ddpc-cosim version": "0.1.0",
    "python version": "3.11.7",
    "numpy version": "2.4.6",
    "system": "Linux",
    "cpu": "a fast one",
    "wall time": "3 s for 2 cases, 0 kept from an earlier run",
    "date": "2020-01-01",
}
PLANT = {"fmu": "lag.fmu", "fmu sha256": "cafe", "plant content": "cafe", "fmu model": "lag"}
PLANT |= {"fmi version": "3.0", "fmu guid": "{12}", "fmu tool": "someone", "largest preview": "5 samples"}


def facts_of(results: StudyResults) -> dict[str, str]:
    (table,) = reproduce_tables(results, "x-")
    return {row.header: row.cells[0].text for row in table.rows}


def test_each_fact_stands_once_and_names_files_without_folders(make_results: MakeResults) -> None:
    results = make_results(provenance=RUN | PLANT, seeds=[0, 1, 2])
    facts = facts_of(results)
    assert facts == {
        "command": "ddpc-cosim run own.toml --seeds 0:3",
        "study file": "own.toml",
        "study file SHA-256": "5a5a",
        "study file commit": "c0ffee, clean",
        "study.toml SHA-256": "e1e1",
        "seeds": "0\N{EN DASH}2",
        "ddpc-cosim": "0.1.0",
        "packages": "python 3.11.7, numpy 2.4.6",
        "machine": "Linux, a fast one",
        "wall time": "3 s for 2 cases, 0 kept from an earlier run",
        "largest preview": "5 samples",
        "plant": "lag.fmu, FMI 3.0, GUID {12}, made by someone",
        "plant SHA-256": "cafe",
        "date": "2020-01-01",
    }
    page = render_page([results])
    assert "/home/jo" not in page
    assert page.count("cafe") == 1


def test_results_of_earlier_versions_have_the_command_that_was_typed(make_results: MakeResults) -> None:
    typed = {"command": "ddpc-cosim run /home/jo/own.toml --out /home/jo/out"}
    assert facts_of(make_results(provenance=typed))["command"] == "ddpc-cosim run own.toml --out out"


def test_a_plant_of_several_problems_stands_once(make_results: MakeResults) -> None:
    results = make_results()
    names = ["first", "second", "third"]
    studies = {name: replace(results.study, name=name, title=name.upper()) for name in names}
    facts = {f"{name}: {key}": fact for name in names for key, fact in PLANT.items()}
    facts["third: plant content"] = "cafe level~10.0"
    cases = [replace(case, problem=name) for name in names for case in results.cases]
    several = replace(
        results, whole=WholeStudy(results.whole.head, studies), cases=tuple(cases), provenance=facts | RUN
    )
    run, plants = reproduce_tables(several, "x-")
    assert not any("cafe" in cell.text for row in run.rows for cell in row.cells)
    words = "lag.fmu, FMI 3.0, GUID {12}, made by someone, largest preview 5 samples"
    assert [(row.header, *(cell.text for cell in row.cells)) for row in plants.rows] == [
        ("FIRST, SECOND", words, "cafe"),
        ("THIRD", words.replace("FMI 3.0", "with level~10.0, FMI 3.0"), "cafe"),
    ]
