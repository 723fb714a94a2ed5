"""Study files of tests, each of which says only what is special in its own, and how they are run."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from ddpc_cosim import Study, StudyResults
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.reading import read_study

Table = Mapping[str, Any]

PENDULUM: dict[str, Any] = {"name": "pendulum", "inputs": ["torque"], "outputs": ["angle"]}


def study_text(
    plant: Table = PENDULUM,
    reference: Mapping[str, float | Table] = {"angle": 0.1},
    controllers: Iterable[str] | Mapping[str, str | Table] = ("mfapc",),
    loop: Mapping[str, Any] = {},
    **others: Any,
) -> str:
    """Return a study of one second in steps of 0.1 s, and with what is given in place of or beside that.

    A reference that is a number is constant; without any there is no such section. A controller is its
    section or its type, by which it is called where it has no name.
    """
    if not isinstance(controllers, Mapping):
        controllers = {kind.rpartition(":")[2].lower(): kind for kind in controllers}
    references = {
        name: signal if isinstance(signal, Mapping) else {"kind": "constant", "value": signal}
        for name, signal in reference.items()
    }
    sections = {
        name: section if isinstance(section, Mapping) else {"type": section}
        for name, section in controllers.items()
    }
    tables = {"plant": plant, "loop": {"sampling_time": 0.1, "duration": 1.0} | loop}
    tables |= {"reference": references} if references else {}
    return tomli_w.dumps(others | tables | {"controllers": sections})


def write(folder: Path, text: str, name: str = "study.toml") -> Path:
    """Write a study file."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def run_file(study: str | Path, out: str | Path = "out", **options: Any) -> StudyResults:
    """Run a study into a folder beside it, as a user of Python does, without a word."""
    return Study.read(study).run(Path(study).parent / out, **{"progress": False} | options)


def folder_of_runs(study: str, otherwise: Path) -> Path:
    """Return where a built-in study is run: where the site looks for its cases, too, if that is said."""
    shared = os.environ.get("STUDY_RUNS")
    return Path(shared, study) if shared else otherwise


def cases_in(study: str | Path) -> list[Case]:
    """Return the cases of a study of one problem, ready to run."""
    resolved = read_study(str(study)).problem
    return cases_of(resolved, resolved.plant.built())
