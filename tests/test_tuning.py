"""The settings of the built-in comparative studies are those that their grids were searched for."""

import tomllib
from typing import Any

import pytest

from benchmarks import tuning
from ddpc_cosim.study.file_format.sections import Study, expand_seeds
from ddpc_cosim.study.file_format.study_files import find_study

COMPARATIVE = ["direction-change", "mimo", "noise", "reactor", "time-varying", "unstable"]


def study_of(name: str) -> dict[str, Any]:
    return tomllib.loads(find_study(name).read_text(encoding="utf-8"))


def test_every_comparative_study_has_grids() -> None:
    assert tuning.STUDIES == COMPARATIVE


@pytest.mark.parametrize("name", COMPARATIVE)
def test_every_controller_has_a_grid_of_the_same_size(name: str) -> None:
    grid, study = tuning.read_grid(name)["controllers"], study_of(name)["controllers"]
    assert {key: one["type"] for key, one in grid.items()} == {key: one["type"] for key, one in study.items()}
    tried = {key: list(tuning.settings_tried(one)) for key, one in grid.items()}
    assert {key: len(settings) for key, settings in tried.items()} == dict.fromkeys(study, 16)
    for settings in tried.values():
        assert all(one not in settings[:i] for i, one in enumerate(settings))


@pytest.mark.parametrize("name", COMPARATIVE)
def test_the_settings_of_a_study_are_among_those_tried(name: str) -> None:
    grid = tuning.read_grid(name)
    for key, one in study_of(name)["controllers"].items():
        section = grid["controllers"][key]
        assert one["settings"] in list(tuning.settings_tried(section))
        tables = section["sweep"] if isinstance(section["sweep"], list) else [section["sweep"]]
        values = {
            name: [v for table in tables for v in table.get(name, [None])] for t in tables for name in t
        }
        varied = {name for name, tried in values.items() if any(value != tried[0] for value in tried)}
        assert set(one["tuned"]["settings"]) <= varied
        assert one["tuned"]["trials"] == 16
        assert one["tuned"]["seeds"] == grid["seeds"]
        assert one["tuned"]["source"] == f"benchmarks/tuning/{name}.toml"


@pytest.mark.parametrize("name", COMPARATIVE)
def test_no_seed_of_the_trials_is_reported(name: str) -> None:
    tried, reported = (
        expand_seeds(seeds) for seeds in (tuning.read_grid(name)["seeds"], study_of(name)["seeds"])
    )
    assert not set(tried) & set(reported)
    assert len(reported) >= 10


@pytest.mark.parametrize("name", COMPARATIVE)
def test_the_trials_are_a_study_on_the_same_problem(name: str) -> None:
    trials, study = Study.model_validate(tuning.sweep_study(name)), Study.model_validate(study_of(name))
    for key in ("plant", "loop", "reference", "bounds", "recording", "scenarios"):
        assert getattr(trials, key) == getattr(study, key)


@pytest.mark.parametrize("name", COMPARATIVE)
def test_every_condition_is_run_with_preview_and_without(name: str) -> None:
    scenarios = Study.model_validate(study_of(name)).scenarios.values()
    with_preview = [one for one in scenarios if one.preview is None]
    without = [one.model_copy(update={"preview": None}) for one in scenarios if one.preview == 1]
    assert len(with_preview) + len(without) == len(scenarios)
    conditions = [[one.model_dump(exclude={"label"}) for one in group] for group in (with_preview, without)]
    assert conditions[0] == conditions[1]
