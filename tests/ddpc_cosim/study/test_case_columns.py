"""Many cases in columns: whatever is asked of one is what it was given, to the last bit and type."""

import math
import pickle
from dataclasses import fields, replace
from pathlib import Path

import pytest

from ddpc_cosim import CaseResult
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.responses import EndWindow, Tracking
from ddpc_cosim.study.case_columns import in_columns, kept_with, replaced

NAMES = [field.name for field in fields(CaseResult)]


def case(seed: int, folder: Path = Path("cases"), *, ends: int = 2, **more: object) -> CaseResult:
    """Return a case of which some is that of all, and some its own."""
    windows = tuple(EndWindow(15, seed / 7, seed / 3, 0.1 * (i > 0), settling=True) for i in range(ends))
    own = {
        "id": f"pid_seed{seed}",
        "seed": seed,
        "tracking": (Tracking("y", 0.5, math.inf, 1.0, seed / 9, -0.0, 0.1, ends=windows),),
        "metrics": {"rmse.y [m]": seed / 11, "late.y [s]": math.nan, "zero [1]": -0.0 if seed % 2 else 0.0},
        "warnings": (f"gain {seed}",) if seed % 3 else (),
        "drawn": {"mass [kg]": 1.0 + seed},
        "folder": folder / f"pid_seed{seed}",
        "beyond_log": {},
    }
    shared = {
        "controller": "pid",
        "label": "PID",
        "scenario": "s",
        "outcome": Outcome.COMPLETED,
        "reason": "",
    }
    rest = {"diagnostics": {"rank": 3.0}, "settings": {"gain": 2.0, "kinds": ["a"]}, "batched": True}
    return CaseResult(**{**own, **shared, **rest, **more})  # type: ignore[arg-type]


def values(of: CaseResult) -> list[str]:
    return [repr(getattr(of, name)) for name in NAMES]


@pytest.mark.parametrize(
    "cases",
    [
        [case(seed) for seed in range(5)],
        [case(7)],
        [case(seed, ends=1 + seed % 2) for seed in range(5)],
        [case(0), case(1, metrics={"rmse.y [m]": 1.0}, outcome=Outcome.DIVERGED), case(2)],
        [case(1 << 70), case(-1), case(2, beyond_log={"y": 0.5}, settles=True)],
    ],
    ids=["alike", "one", "of two shapes", "one that diverged", "large seeds"],
)
def test_a_case_in_columns_is_the_same_to_the_last_bit(cases: list[CaseResult]) -> None:
    kept = in_columns((replace(case, folder=Path()) for case in cases), Path("cases"))
    assert [*map(values, kept)] == [*map(values, cases)]
    assert [*map(repr, kept)] == [*map(repr, cases)]
    for case, other in zip(kept, cases, strict=True):
        assert isinstance(case, CaseResult)
        assert type(case.seed) is int
        assert isinstance(case.beyond_log, dict)
        assert isinstance(case.settings, dict)
        assert values(pickle.loads(pickle.dumps(case))) == values(other)


def test_cases_that_are_equal_are_so_wherever_their_values_are() -> None:
    one = case(3, metrics={"rmse.y [m]": 0.5})
    (kept,) = in_columns([one], one.folder.parent)
    assert kept == one
    assert one == kept
    assert kept != case(4)
    changed = replace(kept, label="other")
    assert (changed.label, kept.label, replace(changed, label="PID")) == ("other", "PID", one)


def test_values_are_replaced_where_they_are() -> None:
    alone, cases = case(9), in_columns([case(seed) for seed in range(6)], Path("cases"))
    chosen = [cases[4], alone, cases[1], cases[3]]
    marked = [*replaced((case, {"left": float(case.seed), "tasks": {"y": 2.0}}) for case in chosen)]
    assert [(case.seed, case.left, dict(case.tasks)) for case in marked] == [
        (seed, float(seed), {"y": 2.0}) for seed in (4, 9, 1, 3)
    ]
    assert all(math.isnan(case.left) and not case.tasks for case in cases)
    same = [values(replace(case, left=math.nan, tasks={})) for case in marked]
    assert same == [values(case) for case in chosen]


def test_some_may_lack_what_others_have_replaced() -> None:
    cases = in_columns([case(seed) for seed in range(3)], Path("cases"))
    changes = ({"failure": "far", "tasks": {"y": 1.0}}, {"failed": True}, {"tasks": {"y": 2.0}})
    marked = [*replaced(zip(cases, changes, strict=True))]
    assert [(case.failed, case.failure, dict(case.tasks)) for case in marked] == [
        (False, "far", {"y": 1.0}),
        (True, "", {}),
        (False, "", {"y": 2.0}),
    ]


def test_more_is_kept_with_cases() -> None:
    cases = in_columns([case(seed, ends=1 + seed % 2) for seed in range(4)], Path("cases"), row=[3, 2, 1, 0])
    assert [kept_with(case, "row") for case in cases] == [3, 2, 1, 0]
