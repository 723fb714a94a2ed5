"""Plants in Python can fail in any way; the samples up to the fault are kept, and the reason is true."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import (
    ConfigError,
    Constant,
    Controller,
    FloatArray,
    FMUStepError,
    Loop,
    Outcome,
    ParameterChange,
    Plant,
    Sample,
    StepStatus,
    Trace,
    UniformRandom,
    Variable,
    cosimulate,
)


class Counter(Plant):
    """Counts its steps; the third one may do something else, and so may the reset."""

    inputs = (Variable("push"),)
    outputs = (Variable("count"),)

    def __init__(self, third: Any = None, first: Any = None, change: Any = None) -> None:
        self.third, self.first, self.change = third, first, change

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        self.count = 0
        return self._answer(self.first)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.count += 1
        return self._answer(self.third if self.count == 3 else None)

    def set_parameters(self, parameters: Mapping[str, Any]) -> None:
        self._answer(self.change)

    def _answer(self, answer: Any) -> Any:
        if isinstance(answer, BaseException):
            raise answer
        return np.array([float(self.count)]) if answer is None else answer


@dataclass(kw_only=True)
class Pushing(Controller):
    """Pushes."""

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> FloatArray:
        return np.ones(1)


def close_loop(plant: Plant, **settings: Any) -> Trace:
    arguments: dict[str, Any] = {"sampling_time": 0.5, "duration": 3.0, "reference": Constant(0.0)}
    return cosimulate(plant, Pushing(), **(arguments | settings))


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (ZeroDivisionError("by zero"), "Counter.step raised ZeroDivisionError: by zero at t = 1 s"),
        (SystemExit(3), "Counter.step raised SystemExit: 3 at t = 1 s"),
        (ConfigError("no"), "Counter.step raised ConfigError: no at t = 1 s"),
        (1.0, "Counter.step returned 1.0, shape (); needed: real numbers, shape (1,) at t = 1.5 s"),
        (np.ones(2), "Counter.step returned [1.0, 1.0], shape (2,)"),
        (np.ones((1, 1)), "Counter.step returned [[1.0]], shape (1, 1)"),
        (np.array([1j]), "Counter.step returned [1j], shape (1,)"),
        ("y", "Counter.step returned 'y', shape ()"),
    ],
)
def test_a_step_that_fails_ends_the_run_and_its_samples_are_kept(fault: Any, words: str) -> None:
    trace = close_loop(Counter(third=fault))
    assert trace.outcome is Outcome.CRASHED
    assert words in trace.reason
    assert np.array_equal(trace.y[:, 0], [0.0, 1.0, 2.0])
    assert np.array_equal(trace.u[:, 0], np.ones(3))
    assert trace.held == 3


@pytest.mark.parametrize("answer", [[3.0], (3,), np.array([3]), np.array([3.0], dtype=np.float32)])
def test_outputs_may_be_any_row_of_real_numbers(answer: Any) -> None:
    trace = close_loop(Counter(third=answer))
    assert trace.completed
    assert np.array_equal(trace.y[:, 0], np.arange(7.0))


def test_what_a_plant_says_itself_is_kept() -> None:
    error = FMUStepError("out of range at t = 1 s", StepStatus.DISCARD, 1.0)
    trace = close_loop(Counter(third=error))
    assert (trace.outcome, trace.reason) == (Outcome.FMU_DISCARDED, "out of range at t = 1 s")


def test_a_plant_may_end_the_run_itself() -> None:
    error = FMUStepError("the tank is empty at t = 1 s", StepStatus.TERMINATED, 1.0)
    trace = close_loop(Counter(third=error))
    assert (trace.outcome, trace.reason) == (Outcome.TERMINATED, "the tank is empty at t = 1 s")
    assert not trace.completed
    assert np.array_equal(trace.y[:, 0], [0.0, 1.0, 2.0])


@pytest.mark.parametrize("fault", [ZeroDivisionError("by zero"), np.ones(2)])
def test_a_reset_that_fails_is_an_error(fault: Any) -> None:
    with pytest.raises(
        FMUStepError, match=r"Counter\.reset (raised Zero|returned \[).* at t = 0 s"
    ) as caught:
        close_loop(Counter(first=fault))
    assert caught.value.status is StepStatus.CRASHED


def test_an_interrupt_is_the_users() -> None:
    with pytest.raises(KeyboardInterrupt):
        close_loop(Counter(third=KeyboardInterrupt()))


@pytest.mark.parametrize(
    ("fault", "outcome", "words"),
    [
        (ConfigError("Counter: no gain"), Outcome.FMU_ERROR, "Counter: no gain at t = 1 s"),
        (KeyError("gain"), Outcome.CRASHED, "Counter.set_parameters raised KeyError: 'gain' at t = 1 s"),
    ],
)
def test_a_change_that_a_plant_refuses_later_ends_the_run(fault: Any, outcome: Outcome, words: str) -> None:
    trace = close_loop(Counter(change=fault), events=[ParameterChange(1.0, {"gain": 2.0})])
    assert (trace.outcome, trace.reason) == (outcome, words)
    assert np.array_equal(trace.y[:, 0], [0.0, 1.0])


def test_a_plant_that_fails_during_the_experiment_says_when() -> None:
    with pytest.raises(FMUStepError, match=r"Counter\.step raised ZeroDivisionError: by zero at t = 1 s"):
        close_loop(Counter(third=ZeroDivisionError("by zero")), excitation=UniformRandom(-1.0, 1.0, 9))


def test_a_plant_that_cannot_say_what_it_is_runs_all_the_same() -> None:
    class Nameless(Counter):
        def provenance(self) -> Any:
            raise OSError("no licence")

    trace = close_loop(Nameless())
    assert trace.completed
    assert trace.provenance["provenance"] == "raised OSError: no licence"


def test_a_plant_is_closed_at_the_end_of_a_with_block(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever ends it; a plug-in needs no more than its `close`."""
    closed = list[Plant]()
    monkeypatch.setattr(Counter, "close", lambda plant: closed.append(plant))
    with pytest.raises(ConfigError, match="cannot be computed without a step"), Counter() as plant:
        plant.outputs_at(np.zeros(1))
    assert closed == [plant]
