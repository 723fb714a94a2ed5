"""Algebraic loops: found from what parts declare, solved at every instant, or refused with names."""

import re
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import ConfigError, Connection, CoupledPlant, FMUPlant, FMUStepError, StepStatus
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants import Equations, PlantModel, Variable as PlantVariable

from .conftest import Exported
from .linear import LinearPlant, gain, lag

RING = [Connection("first.y", "second.u"), Connection("second.y", "first.u")]


class Formula(LinearPlant):
    """y = f(u), an output without states; f' is told, wrongly told, or not."""

    def __init__(self, f: Any, slope: Any = None) -> None:
        super().__init__(d=[[1.0]])
        self.f, self.slope, self.asked = f, slope, 0

    def step(self, u: FloatArray, h: float) -> FloatArray:
        return self.outputs_at(u)

    def outputs_at(self, u: FloatArray) -> FloatArray:
        self.asked += 1
        return np.array([self.f(u[0])])

    def feedthrough(self, u: FloatArray) -> FloatArray | None:
        return None if self.slope is None else np.array([[self.slope(u[0])]])


def solution(first: LinearPlant, second: LinearPlant, **options: Any) -> FloatArray:
    with CoupledPlant({"first": first, "second": second}, RING, **options) as plant:
        assert plant.loops == (("first.u", "first.y", "second.u", "second.y"),)
        plant.reset()
        return plant.step(np.empty(0), 0.1)


@pytest.mark.parametrize("algorithm", ["sequential", "parallel"])
@pytest.mark.parametrize("extrapolation", ["hold", "linear"])
@pytest.mark.parametrize("factor", [0.5, -0.99, -3.0, 100.0])
def test_a_linear_loop_is_solved(algorithm: str, extrapolation: str, factor: float) -> None:
    """y1 = factor * y2 and y2 = y1 - 2 meet at y2 = 2 / (factor - 1): iterating alone diverges from 1 on."""
    second = LinearPlant([[0.0]], [[0.0]], [[-2.0]], [[1.0]], x0=[1.0])
    y = solution(gain(factor), second, algorithm=algorithm, extrapolation=extrapolation)
    assert y == pytest.approx(np.array([factor, 1.0]) * 2.0 / (factor - 1.0), rel=1e-8)


@pytest.mark.parametrize("slope", [None, lambda u: -np.exp(u), lambda _: 0.3], ids=["none", "right", "wrong"])
def test_newton_converges_where_iterating_does_not(slope: Any) -> None:
    """Of u = 3 - exp(u) the solution is 3 - W(e^3); the slope there, -2.2, drives a fixed point away."""
    from scipy.special import lambertw

    y = solution(Formula(lambda u: 3.0 - np.exp(u), slope), Formula(lambda u: u, slope and (lambda _: 1.0)))
    assert y == pytest.approx(3.0 - lambertw(np.exp(3.0)).real, rel=1e-8)


def test_a_loop_that_contracts_costs_a_few_evaluations() -> None:
    part = Formula(lambda u: 0.01 * u + 1.0)
    solution(part, Formula(lambda u: u))
    assert part.asked <= 10


def test_fmus_in_a_loop_are_solved_with_their_derivatives(exported: Exported) -> None:
    """x^3 = 8 - x has the solution 1.8335 (Cardano); around it x -> 8 - x^3 diverges."""
    cube = PlantModel(
        name="cube",
        inputs=(PlantVariable("u", start=1.0),),
        outputs=(PlantVariable("y"),),
        equations=lambda v: Equations({}, {"y": 8.0 - v.u**3}),
    )
    parts = {"first": FMUPlant(exported(cube)), "second": gain(1.0)}
    with CoupledPlant(parts, RING) as plant:
        root = np.roots([1.0, 0.0, 1.0, -8.0])
        assert plant.reset() == pytest.approx(root[np.isreal(root)].real[0])


def test_a_loop_through_one_part_only() -> None:
    with CoupledPlant({"only": gain(-0.5)}, [Connection("only.y", "only.u", offset=3.0)]) as plant:
        assert plant.loops == (("only.u", "only.y"),)
        assert plant.reset() == pytest.approx([-1.0])  # y = -0.5 (y + 3)


def test_a_loop_without_solution_is_an_error_with_names() -> None:
    with pytest.raises(
        FMUStepError, match=r"loop of first.y, second.y does not converge at t = 0 s: .* off by"
    ) as e:
        solution(Formula(lambda u: u**2 + 1.0), Formula(lambda u: u))
    assert e.value.status is StepStatus.ERROR


def test_a_loop_that_has_diverged_is_left_to_the_master() -> None:
    assert np.isnan(solution(Formula(lambda _: np.nan), Formula(lambda u: u))).all()


def test_a_part_that_cannot_give_its_outputs_is_refused_in_a_loop() -> None:
    class Stubborn(LinearPlant):
        can_give_outputs = False

    message = 'algebraic loop of first.u, first.y, second.u, second.y: part "second" cannot give its outputs'
    with pytest.raises(ConfigError, match=re.escape(message)):
        CoupledPlant({"first": gain(1.0), "second": Stubborn(d=[[1.0]])}, RING)


def test_no_part_is_asked_without_need() -> None:
    """A part takes what its outputs depend on from one before it: they are as the step left them."""
    parts = {"second": gain(2.0), "first": lag(), "third": lag()}
    links = [
        Connection("first.y", "second.u"),
        Connection("second.y", "third.u"),
        Connection("third.y", "first.u"),
    ]
    with CoupledPlant(parts, links) as plant:
        assert plant.order == ("first", "second", "third")
        assert plant.loops == ()
        plant.reset()
        parts["second"].calls.clear()
        second, first, _ = plant.step(np.empty(0), 0.1)
        assert parts["second"].calls == ["step"]
        assert second == 2.0 * first


def test_a_chain_of_gains_follows_the_inputs_at_once() -> None:
    """What is without delay is so at the beginning of a step as at its end: the lag sees no old value."""
    parts = {"lag": lag(0.5), "double": gain(2.0), "triple": gain(3.0)}
    links = [Connection("double.y", "triple.u"), Connection("triple.y", "lag.u")]
    with CoupledPlant(parts, links, algorithm="parallel", outputs=["lag.y", "triple.y"]) as plant:
        assert plant.dependencies == {"lag.y": frozenset(), "triple.y": {"double.u"}}
        plant.reset()
        y = plant.step(np.array([1.0]), 0.2)
        assert y == pytest.approx([6.0 * (1.0 - np.exp(-0.4)), 6.0], rel=1e-14)
        assert plant.outputs_at(np.array([2.0])) == pytest.approx([y[0], 12.0])


def test_an_array_of_gains_in_a_loop_with_units() -> None:
    """A loop through a conversion: x [mm] = 500 * x [m] + 1 mm, so x = -2 mm."""
    metres = gain(1.0, inputs=[Variable("u", "m")], outputs=[Variable("y", "m")])
    half = LinearPlant(
        [[0.0]], [[0.0]], [[1.0]], [[0.5]], [1.0], [Variable("u", "mm")], [Variable("y", "mm")]
    )
    with CoupledPlant({"first": metres, "second": half}, RING) as plant:
        assert plant.reset() == pytest.approx([2e-3, 2.0])
