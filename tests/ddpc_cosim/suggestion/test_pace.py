"""The step test of a slow plant fits its time: fewer samples of the same responses, and no run beyond it."""

import subprocess
import sys
from collections.abc import Mapping
from time import monotonic

import numpy as np
import pytest

from ddpc_cosim import CosimError, Plant
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.suggestion import pace
from ddpc_cosim.suggestion.choice import choose
from ddpc_cosim.suggestion.design import first_gains
from ddpc_cosim.suggestion.response_types import ResponseType
from ddpc_cosim.suggestion.step_test import Resting, StepTest, Timing, step_test
from ddpc_cosim.variables import FloatArray, Variable


class SlowLag(Plant):
    """y' = u - y, each step of which takes a while on a clock of its own."""

    inputs = (Variable("u"),)
    outputs = (Variable("y"),)

    def __init__(self, seconds: float) -> None:
        self.seconds, self.clock, self.y, self.longest = seconds, 0.0, 0.0, 0.0

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        self.y = 0.0
        return np.zeros(1)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.clock += self.seconds
        self.y = float(u[0]) + (self.y - float(u[0])) * np.exp(-h)
        return np.array([self.y])


def run(plant: SlowLag, monkeypatch: pytest.MonkeyPatch, **timing: float) -> StepTest:
    monkeypatch.setattr(sys.modules[step_test.__module__], "monotonic", lambda: plant.clock)
    resting = Resting(np.zeros(1), np.ones(1))
    return step_test(plant, resting, Timing(1e-4, longest=1e5, **timing))  # type: ignore[arg-type]


@pytest.mark.parametrize("seconds", [1e-6, 0.01, 0.05, 0.5])
def test_it_ends_in_time_and_still_sees_the_response(seconds, monkeypatch) -> None:
    plant = SlowLag(seconds)
    result = run(plant, monkeypatch, budget=30.0)
    assert plant.clock <= 30.0 + seconds
    response = result.responses[0][0]
    assert response.type is not ResponseType.INSENSITIVE
    assert response.effect == pytest.approx(0.1, rel=0.1 if seconds < 0.1 else 0.25)
    if seconds < 0.1:
        assert response.type is ResponseType.SETTLED
        assert response.settling_time == pytest.approx(3.0, rel=0.4)


def test_too_slow_for_a_single_block_is_refused_with_what_it_takes(monkeypatch) -> None:
    """24 samples at rest and 24 after a step, 2 s each: 96 s."""
    with pytest.raises(CosimError, match=r"takes 2 s, so a step test of 1 inputs takes 96 s: .* --budget"):
        run(SlowLag(2.0), monkeypatch, budget=30.0)


def test_steps_of_fixed_size_are_as_many_as_fit(monkeypatch) -> None:
    plant = SlowLag(0.05)
    result = run(plant, monkeypatch, budget=30.0, fixed=True, blocks=8)
    assert plant.clock <= 30.05
    assert result.time[-1] == pytest.approx(
        1e-4 * 24 * (2**3 - 1), rel=0.05
    )  # 3 blocks: 168 of 300 steps each


class Stalling(SlowLag):
    """It takes a while only from one of its steps on: the machine has something else to do."""

    def __init__(self, stalls_at: int) -> None:
        super().__init__(1e-4)
        self.count, self.stalls_at = 0, stalls_at

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.count += 1
        self.seconds = 10.0 if self.count >= self.stalls_at else 1e-4
        return super().step(u, h)


@pytest.mark.parametrize("stalls_at", [600, 700, 900, 1100])
def test_what_there_was_no_time_for_leaves_gains_that_are_numbers(
    stalls_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run(Stalling(stalls_at), monkeypatch, budget=30.0, blocks=12)
    chosen = choose(result, np.ones(1), 1.0, all_outputs=True)
    assert np.isfinite(chosen.gains).all()
    assert chosen.gains.any()
    assert np.isfinite(first_gains(result, chosen, 0.1)).all()


@pytest.mark.parametrize("stalls_at", [292, 293, 300, 312])
def test_a_step_that_was_cut_short_has_not_been_identified(
    stalls_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps 4 to 291 are those at rest; those after it make the first block of the response."""
    with pytest.raises(CosimError, match="not identified in time: the response to a step of u; raise --budg"):
        run(Stalling(stalls_at), monkeypatch, budget=30.0, blocks=12)


BUSY = """
import time
while time.process_time() < 0.3:
    pass
"""


def test_the_clock_runs_with_what_is_computed_in_other_processes_too() -> None:
    begin, on_the_wall = pace.monotonic(), monotonic()
    with subprocess.Popen([sys.executable, "-c", BUSY]) as busy:
        while busy.poll() is None:
            before = pace.monotonic()
            assert pace.monotonic() >= before
    assert 0.25 <= pace.monotonic() - begin <= monotonic() - on_the_wall


def test_others_that_have_the_processors_do_not_make_it_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 s on the wall, of which this process has computed 1 s and waited 98 s for its turn."""
    wall, cpu, waited = 0.0, 0.0, 0.0
    monkeypatch.setattr(pace.time, "monotonic", lambda: wall)
    monkeypatch.setattr(pace.time, "process_time", lambda: cpu)
    monkeypatch.setattr(pace, "_delay", lambda _: waited)
    monkeypatch.setattr(pace, "_IS_KNOWN", True)
    monkeypatch.setattr(pace, "children", lambda _: set())
    clock = pace.ComputingClock()
    begin = clock()
    for _ in range(100):
        wall, cpu, waited = wall + 1.0, cpu + 0.01, waited + 0.98
        now = clock()
    assert 1.0 <= now - begin <= 5.0
    for _ in range(100):  # now it sleeps: what it waits for counts
        wall += 1.0
        later = clock()
    assert later - now >= 95.0
