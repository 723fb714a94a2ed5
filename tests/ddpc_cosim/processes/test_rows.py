"""The rows of a run in a file: whoever opens it sees how far the run is, and what it has left."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import Action, Constant, Controller, FMUPlant, Loop, Sample, Variable, cosimulate
from ddpc_cosim.loop import safe_calls
from ddpc_cosim.processes.rows import RowStore, info_path
from ddpc_cosim.variables import FloatArray


@dataclass(kw_only=True)
class Looks(Controller):
    """Looks at the rows of its own run from outside, and says something else at each sample."""

    look: Callable[[], RowStore]
    seen: list[tuple[object, ...]] = field(default_factory=list)

    def start(self, loop: Loop) -> None:
        self._note()

    def step(self, sample: Sample) -> Action:
        self._note()
        return Action(np.array([0.5]), f"sample {sample.k}")

    def _note(self) -> None:
        store = self.look()
        _, who, name, _ = store.call
        self.seen.append((store.count, who, name, store.written()["status"]))


@pytest.fixture
def announced(tmp_path: Path) -> Iterator[RowStore]:
    """A store in a file, to which the calls of this process are announced."""
    before = safe_calls._announce
    store = RowStore(4, 1, 1, 1, tmp_path / "rows")
    safe_calls.announce_calls(store.announce)
    yield store
    safe_calls.announce_calls(before)


def test_a_call_within_another_gives_it_another_name_only(announced: RowStore) -> None:
    """So an integration without an end, of short calls, is seen not to return."""
    safe_calls.announce_call_of_plant("step", 1.0)
    number = announced.call.number
    safe_calls.announce_call_of_plant('drive of part "a"', 1.5, is_within=True)
    assert announced.call == (number, "plant", 'drive of part "a"', 1.5)
    safe_calls.announce_call_of_plant('step of part "a"', 2.0)
    assert announced.call.number == number + 1


def test_a_run_can_be_followed_in_its_file(announced: RowStore, pendulum_fmu: Path, tmp_path: Path) -> None:
    controller = Looks(look=lambda: RowStore(4, 1, 1, 1, tmp_path / "rows"))
    with FMUPlant(pendulum_fmu, inputs=["torque"], outputs=["angle"]) as plant:
        trace = cosimulate(
            plant,
            controller,
            sampling_time=0.1,
            duration=0.3,
            reference=Constant(0.2),
            start_time=1.0,
            store=announced,
        )
    assert controller.seen == [
        (0, "controller", "start", ()),
        (1, "controller", "step", ("error",)),
        (2, "controller", "step", ("sample 0", "error")),
        (3, "controller", "step", ("sample 0", "sample 1", "error")),
        (4, "controller", "step", ("sample 0", "sample 1", "sample 2", "error")),
    ]
    after = controller.look()
    assert after.call[1:3] == ("", "")
    for name, table in after.written().items():
        np.testing.assert_array_equal(table, getattr(trace, name))


def test_calls_tell_their_time(announced: RowStore) -> None:
    seen = []

    def step(u: FloatArray, h: float) -> FloatArray:
        seen.append(announced.call)
        return u

    plant: Any = SimpleNamespace(step=step, outputs=(Variable("y"),))
    safe_calls.step_plant(plant, np.zeros(1), 0.1, 0.5)
    assert seen == [(1, "plant", "step", 0.5)]
    number, who, name, time = announced.call
    assert (number, who, name) == (2, "", "")
    assert math.isnan(time)


def test_the_texts_of_statuses_are_limited_in_length(tmp_path: Path) -> None:
    """In the file; the run itself knows them all."""
    store = RowStore(40, 1, 0, 1, tmp_path / "rows")
    texts = [f"{k}{4000 * 'x'}" for k in range(40)]
    for k, text in enumerate(texts):
        store.begin(k, np.zeros(1), np.empty(0))
        store.complete(k, np.ones(1), text, 0.0)
    assert list(store.written()["status"]) == texts
    statuses = RowStore(40, 1, 0, 1, tmp_path / "rows").written()["status"]
    assert list(statuses[:16]) == texts[:16]
    assert set(statuses[16:]) == {"(not kept: too many different statuses)"}
    assert (tmp_path / "rows").stat().st_size < 100_000


def test_what_is_said_of_a_step_outlives_the_process_that_says_it(tmp_path: Path) -> None:
    store = RowStore(3, 1, 0, 1, tmp_path / "rows")
    for k, info in enumerate([{}, {"cost": 2.0}, {"gradient \N{GREEK SMALL LETTER PHI}": -1.0, "cost": 3.0}]):
        store.begin(k, np.zeros(1), np.empty(0))
        store.complete(k, np.ones(1), "ok", 0.0, info=info)
    for seen in (store, RowStore(3, 1, 0, 1, tmp_path / "rows")):
        info = seen.written()["info"]
        np.testing.assert_array_equal(info["cost"], [np.nan, 2.0, 3.0])
        np.testing.assert_array_equal(info["gradient \N{GREEK SMALL LETTER PHI}"], [np.nan, np.nan, -1.0])
    info_path(tmp_path / "rows").write_bytes(b"\xff" * 10)
    assert "info" not in RowStore(3, 1, 0, 1, tmp_path / "rows").written()


def test_provenance_is_a_call_too(announced: RowStore) -> None:
    plant: Any = SimpleNamespace(provenance=lambda: {"announced": announced.call.name})
    assert safe_calls.plant_provenance(plant) == {"announced": "provenance"}


def test_a_file_that_another_process_fills_has_its_room_on_the_disk(tmp_path: Path) -> None:
    """Else whoever fills it dies of a bus error when the disk is full."""
    RowStore(100_000, 2, 1, 1, tmp_path / "rows", follow=True)
    status = (tmp_path / "rows").stat()
    assert status.st_size > 8 * 100_000 * 8
    assert status.st_blocks * 512 >= status.st_size


@pytest.mark.parametrize(("written", "count"), [(-1, 0), (1 << 60, 4)])
def test_a_damaged_file_has_no_more_rows_than_it_can_have(written: int, count: int, tmp_path: Path) -> None:
    """An FMU that writes where it should not costs its case; the process that reads its rows goes on."""
    path = tmp_path / "rows"
    size = RowStore(4, 1, 1, 1, path)._memory.size()
    path.write_bytes(np.int64(written).tobytes().ljust(size, b"\xff"))
    store = RowStore(4, 1, 1, 1, path)
    assert store.count == count
    assert [len(table) for table in store.written().values()] == [count] * 7
