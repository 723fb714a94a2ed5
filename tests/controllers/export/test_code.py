"""The skeleton of exported code: signals in their order, scales, bounds, missing values, hostile names."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from controllers.export.compiled import CompiledController
from ddpc_controllers import Idle, Scaled
from ddpc_controllers.export.code import Code, Exportable
from ddpc_cosim import (
    Action,
    Bounds,
    ConfigError,
    Controller,
    ControllerCode,
    FloatArray,
    Footprint,
    Loop,
    Sample,
    Variable,
)


@dataclass(kw_only=True)
class Mixed(Exportable):
    """Adds up what it is shown, so that each signal's place shows in its inputs."""

    horizon: int = 3

    def start(self, loop: Loop) -> None:
        self._q = len(loop.measurements)

    def step(self, sample: Sample) -> FloatArray:
        shown = [sample.y, sample.measured, sample.reference.ravel(), sample.setpoint]
        values = np.concatenate(shown)
        return np.array([values @ np.arange(1.0, len(values) + 1), sample.measured[-1]])

    def c_step(self, code: Code, loop: Loop) -> str:
        p, q = len(loop.outputs), len(loop.measurements)
        groups = {"y": p, "measured": q, "reference": self.horizon * p, "setpoint": p}
        body, first = "u[0] = 0.0;\n", 1
        for name, size in groups.items():
            body += (
                f"for (size_t i = 0; i < {size}; ++i) u[0] += (double)(i + {first}) * sample->{name}[i];\n"
            )
            first += size
        return code.step(body + f"u[1] = sample->measured[{q - 1}];")


def a_loop(**changes: Any) -> Loop:
    """Return a loop of two inputs and two outputs, one of which is measured beside something else."""
    inputs = Variable("a", "V", start=0.5, nominal=2.0), Variable("b", nominal=3.0)
    first, second, other = (Variable(name, nominal=n) for name, n in (("y1", 0.1), ("y2", 1.0), ("x", 7.0)))
    unlimited = np.full(2, np.inf)
    bounds = Bounds(np.array([-1e4, -np.inf]), np.array([1e4, 2.0]), -unlimited, unlimited)
    loop = Loop(0.1, inputs, (first, second), (second, other), bounds, None, np.random.default_rng(0), 3)
    return replace(loop, **changes)


def inputs_of(controller: Controller, sample: Sample, loop: Loop) -> FloatArray:
    """Return what a controller in Python answers, as the master would apply it."""
    answer = controller.step(sample)
    u = answer.u if isinstance(answer, Action) else answer
    return np.clip(u, loop.bounds.u_min, loop.bounds.u_max)


def a_sample(rng: np.random.Generator, horizon: int, preview: int) -> Sample:
    y, other = rng.normal(size=2), rng.normal(size=1)
    setpoint, reference = rng.normal(size=2), rng.normal(size=(horizon, 2))
    reference[preview:] = reference[preview - 1] if preview else setpoint
    return Sample(0, 0.0, y, np.append(y[1:], other), reference, setpoint)


@pytest.mark.parametrize("preview", [0, 1, 3])
@pytest.mark.parametrize("wrapped", [False, True], ids=["plain", "scaled"])
def test_every_signal_arrives_in_its_place(preview: int, wrapped: bool) -> None:
    controller: Controller = Scaled(controller=Mixed()) if wrapped else Mixed()
    loop, rng = a_loop(preview=preview), np.random.default_rng(preview)
    controller.start(loop)
    c = CompiledController(controller, loop)
    for _ in range(20):
        sample = a_sample(rng, 3, preview)
        wanted = inputs_of(controller, sample, loop)
        np.testing.assert_allclose(c.step(sample), wanted, rtol=1e-13, atol=1e-13)
        assert c.last_step == (0, 0, 0)


def test_an_input_that_is_not_finite_is_held_and_told() -> None:
    controller, loop, rng = Mixed(), a_loop(), np.random.default_rng(1)
    controller.start(loop)
    c, sample = CompiledController(controller, loop), a_sample(rng, 3, 3)
    lost = sample._replace(y=np.array([np.nan, 1.0]))
    assert c.step(lost)[0] == 0.5  # at rest, before any other
    assert c.status == 1
    before = c.step(sample)
    assert (c.step(lost)[0], c.status) == (before[0], 1)
    assert c.step(sample)[0] == before[0]


@pytest.mark.parametrize(
    ("code_of", "begun"), [(Mixed.c_code, 1), (Mixed.loadable_c_code, 10)], ids=["constants", "loaded"]
)
def test_its_footprint_is_what_there_is_to_count(
    code_of: Callable[[Mixed, Loop], ControllerCode], begun: int
) -> None:
    """Of what the memory begins with, one input at rest is not zero."""
    controller, loop = Mixed(), a_loop()
    controller.start(loop)
    remembered = 2 + 3 * 2 + 2  # what is measured, the references of three samples, the last inputs
    constants = 2 + 2 + begun  # lower and upper limits, and what the memory begins with
    code = code_of(controller, loop)
    assert code.footprint == Footprint(8 * constants, 8 * remembered + 16)
    words = f"constants take {8 * constants} bytes, each ControllerState 96,"
    assert words in code.sources["controller.h"]


def test_what_a_step_works_in_has_places_side_by_side_and_is_zero_at_first() -> None:
    code = Code()
    places = [code.memory([1.0]), *code.scratch(2, 0, 3), code.memory([2.0])]
    assert places == [f"(memory + {place})" for place in (0, 1, 3, 3, 6)]
    assert code.start.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]


def test_idle_rests() -> None:
    controller, loop = Idle(), a_loop()
    controller.start(loop)
    sample = a_sample(np.random.default_rng(2), 1, 1)
    np.testing.assert_array_equal(CompiledController(controller, loop).step(sample), [0.5, 0.0])


def test_names_of_signals_cannot_end_a_comment() -> None:
    hostile = Variable('*/ int main(void){} /* \n"\\')
    controller, loop = Idle(), a_loop(outputs=(hostile,), measurements=(hostile,))
    controller.start(loop)
    CompiledController(controller, loop)


def test_a_class_that_changes_an_exportable_one_is_refused() -> None:
    @dataclass(kw_only=True)
    class Louder(Idle):
        def step(self, sample: Sample) -> FloatArray:
            return 2.0 * super().step(sample)

    loop = a_loop()
    for controller in (Louder(), Scaled(controller=Louder())):
        controller.start(loop)
        with pytest.raises(ConfigError, match=r"Louder cannot be exported: the class has no c_step\(\)"):
            controller.c_code(loop)


def test_a_controller_of_others_is_refused_with_the_reason() -> None:
    @dataclass(kw_only=True)
    class Mine(Controller):
        def start(self, loop: Loop) -> None: ...

        def step(self, sample: Sample) -> FloatArray:
            return np.zeros(2)

    loop, mine = a_loop(), Mine()
    with pytest.raises(ConfigError, match=r"Mine cannot be exported: its class has no c_code\(\)"):
        mine.c_code(loop)
    wrapped = Scaled(controller=mine)
    wrapped.start(loop)
    with pytest.raises(ConfigError, match="Mine cannot be exported within another controller"):
        wrapped.c_code(loop)
