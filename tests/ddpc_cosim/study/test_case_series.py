"""Cases that are made when they are looked at: a list of cases that were made would say the same."""

from collections.abc import Sequence
from typing import Any

import pytest
from studies import study_text, write

from ddpc_cosim.study.cases import Case, Cases, cases_of, doing_nothing
from ddpc_cosim.study.reading import read_study

STUDY: dict[str, Any] = {
    "plant": {
        "name": "pendulum",
        "inputs": ["torque"],
        "outputs": ["angle"],
        "parameters": {"mass": {"distribution": "normal", "mean": 1.0, "deviation": 0.1, "low": 0.5}},
    },
    "loop": {"sampling_time": 0.1, "duration": 1.0},
    "reference": {"angle": {"kind": "steps", "times": [0.0], "values": [0.3]}},
    "bounds": {"torque": {"min": -3.5, "max": 3.5}},
    "scenarios": {"calm": {}, "noisy": {"noise": {"angle": 0.01}}},
    "controllers": {"idle": {"type": "idle"}, "other": {"type": "idle", "label": "Other"}},
}


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Cases:
    text = study_text(**STUDY, seeds=["5:9", 2])
    resolved = read_study(str(write(tmp_path_factory.mktemp("study"), text))).problem
    return cases_of(resolved, resolved.plant)


def told(cases: Sequence[Case]) -> list[tuple[Any, ...]]:
    return [(case.id, case.name, case.seed, case.parameters, case.drawn, case.engine) for case in cases]


def test_it_is_a_sequence_as_a_list_is(cases: Cases) -> None:
    made = [*cases]
    assert len(cases) == len(made) == 2 * 2 * 5
    assert [case.seed for case in made[:5]] == [5, 6, 7, 8, 2]
    assert told([cases[place] for place in range(-20, 20)]) == told(made + made)
    for part in (
        slice(None),
        slice(3, 12),
        slice(1, None, 3),
        slice(-4, None),
        slice(7, 7),
        slice(None, None, -2),
    ):
        assert told(cases[part]) == told(made[part])
        assert [*cases[part].ids()] == [case.id for case in made[part]]
    with pytest.raises(StopIteration):
        next(iter(cases[:0]))


def test_cases_that_were_made_are_the_same_series(cases: Cases) -> None:
    assert told(Cases.of([*cases])) == told(cases)
    assert Cases.of(cases) is cases


def test_ids_are_different_and_those_of_doing_nothing_do_not_depend_on_how_cases_are_held(
    cases: Cases,
) -> None:
    resting = doing_nothing(cases)
    assert told(resting) == told(doing_nothing([*cases]))
    assert told(resting[:3]) == told(doing_nothing(cases[10:13]))
    assert len({*cases.ids(), *resting.ids()}) == len(cases) + 2 * 5
    masses = {(case.seed, case.parameters["mass"]) for case in (*cases, *resting)}
    assert len(masses) == 5


def test_they_are_parted_by_their_ids(cases: Cases) -> None:
    wanted = {case.id for case in cases if case.seed in (2, 6)}
    first, others = cases.parted(lambda series: lambda case_id: case_id in wanted)
    assert {*first.ids()} == wanted
    assert {*others.ids()} == {*cases.ids()} - wanted
    compiled = first.with_all(engine="compiled")
    assert {case.engine for case in compiled} == {"compiled"}
    assert [*compiled.ids()] == [*first.ids()]
