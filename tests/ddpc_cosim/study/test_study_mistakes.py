"""Studies with any mistakes at all: they run, or what is wrong is a ConfigError."""

import copy
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, example, given, settings, strategies as st

from .test_validation_errors import PAPER, errors_of


def places(table: Any, place: tuple[int | str, ...] = ()) -> list[tuple[int | str, ...]]:
    """Return the places of all values of a study."""
    found = [place] if place else []
    if isinstance(table, dict | list):
        for key, item in table.items() if isinstance(table, dict) else enumerate(table):
            found.extend(places(item, (*place, key)))
    return found


VALUES: st.SearchStrategy[Any] = st.sampled_from(
    [None, 0, -1, 3, 1.5, -2.5, 1e300, float("nan"), True, "", "x", "angle", [], [1.0], {}]
)
MUTATIONS = st.lists(
    st.tuples(st.sampled_from(places(PAPER)), st.sampled_from(["delete", "rename", "replace"]), VALUES),
    min_size=1,
    max_size=4,
)


def has(table: Any, key: int | str) -> bool:
    if isinstance(table, list):
        return isinstance(key, int) and key < len(table)
    return isinstance(table, dict) and key in table


def mutate(study: dict[str, Any], place: tuple[int | str, ...], kind: str, value: Any) -> None:
    """Change one value of a study, if an earlier change has left it there."""
    table: Any = study
    for key in place[:-1]:
        if not has(table, key):
            return
        table = table[key]
    last = place[-1]
    if not has(table, last):
        return
    if kind == "rename" and isinstance(table, dict):
        table[f"{last}x"] = table.pop(last)
    elif kind == "replace" and value is not None:
        table[last] = copy.deepcopy(value)
    else:
        del table[last]


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(MUTATIONS)
@example([(("seeds", 1), "replace", "")])
@example([(("report", "panels", 1), "replace", 3), (("report", "panels", 2), "delete", None)])
def test_a_study_with_any_mistakes_is_a_config_error_or_runs(
    tmp_path: Path, mutations: list[tuple[tuple[int | str, ...], str, Any]]
) -> None:
    """Nothing but ConfigError, and no key both wrong and missing."""
    study = copy.deepcopy(PAPER)
    for place, kind, value in mutations:
        mutate(study, place, kind, value)
    found = errors_of(study, tmp_path)
    assert len(found) == len(set(found))
    keys = [fault.partition(": ") for fault in found]
    missing = {key for key, _, what in keys if what == "required key is missing"}
    assert not missing & {key for key, _, what in keys if what != "required key is missing"}
