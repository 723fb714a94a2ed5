"""What the examination of `init` expects follows from the plants' equations, integrated by SciPy alone."""

from collections.abc import Mapping

import numpy as np
import pytest
import sympy
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from e2e.proposal_plants import DAY, DELIVERIES, Delivery, Levels
from fmu_plants.equations import resolve

Floats = NDArray[np.float64]

LONG, OF_LEVELS = 40.0, (0.35, 0.65)
EQUAL = 1e-3
RISEN = np.exp(-1.0)
APART = 1.6  # responses of higher order, and of plants that are not linear

WITH_REST = [label for label, delivery in DELIVERIES.items() if delivery.steady and delivery.constants]


def levels(delivery: Delivery, share: float, label: str) -> dict[str, float]:
    """Return levels of all inputs, those that may be driven at a share of their ranges."""
    given = {delivery.spelt.get(v.name, v.name): v.start for v in delivery.model.inputs}
    on = {name: 1.0 for name in given if name.endswith((".on", "_activate"))}
    warm = {"bus.TAmb": 280.0} if label == "ambient at 0 K" else {}
    ends = {name: low + share * (high - low) for name, (low, high) in delivery.ends.items()}
    return {**given, **on, **warm, **ends}


def simulate(
    delivery: Delivery, u: Levels, times: Floats, start: Floats | None = None
) -> tuple[Mapping[str, Floats], Floats]:
    """Return the outputs over time, by name, and where the states end."""
    model, equations = delivery.model, resolve(delivery.model)
    states = [v.name for v in model.states]
    held = {v.name: u[delivery.spelt.get(v.name, v.name)] for v in model.inputs}
    held |= {p.name: p.start for p in model.parameters}
    symbols = [sympy.Symbol(name, real=True) for name in ("time", *states)]
    values = {sympy.Symbol(name, real=True): value for name, value in held.items()}

    def function(expressions: Mapping[str, sympy.Expr]) -> object:
        return sympy.lambdify(symbols, [e.subs(values) for e in expressions.values()], "numpy")

    slope, output = function(equations.derivatives), function(equations.outputs)
    first = np.array([v.start for v in model.states]) if start is None else start
    solution = solve_ivp(
        lambda t, x: slope(t, *x),  # type: ignore[operator]
        (0.0, float(times[-1])),
        first,
        "LSODA",
        times,
        rtol=1e-9,
        atol=1e-9 * np.maximum(np.abs(first), 1e-3),
    )
    rows = dict(zip(states, solution.y, strict=True))
    computed = output(times, *solution.y)  # type: ignore[operator]
    rows |= {
        name: np.broadcast_to(y, times.shape) for name, y in zip(equations.outputs, computed, strict=True)
    }
    return rows, solution.y[:, -1]


@pytest.mark.parametrize("share", OF_LEVELS)
@pytest.mark.parametrize("label", WITH_REST)
def test_a_plant_comes_to_rest_where_the_formula_says(label: str, share: float) -> None:
    delivery = DELIVERIES[label]
    assert delivery.constants is not None
    assert delivery.steady is not None
    u = levels(delivery, share, label)
    end = LONG * delivery.constants[1]
    last = delivery.period or delivery.constants[0]
    outputs, _ = simulate(delivery, u, np.linspace(end - last, end, 101))
    for name, value in delivery.steady(u).items():
        reached = np.trapezoid(outputs[name], dx=1.0) / (len(outputs[name]) - 1)
        assert reached == pytest.approx(value, rel=EQUAL), name


@pytest.mark.parametrize("label", WITH_REST)
def test_a_small_step_is_as_fast_as_the_time_constants_say(label: str) -> None:
    """When a response is within 37 % of its way for good lies between the two, or about them."""
    delivery = DELIVERIES[label]
    assert delivery.constants is not None
    driven = min(delivery.driven[0])
    rest = levels(delivery, 0.5, label)
    declared = {delivery.spelt.get(v.name, v.name): v.start for v in delivery.model.inputs}
    rest |= {name: declared[name] for name in delivery.ends if declared[name]}
    shortest, longest = delivery.constants
    end = LONG * longest
    if delivery.period:  # a day's swing comes and goes alike in both runs
        end = DAY * np.ceil(end / DAY)
    _, resting = simulate(delivery, rest, np.array([0.0, end]))
    low, high = delivery.ends[driven]
    times = np.linspace(0.0, 10.0 * longest, 20_001)
    before, _ = simulate(delivery, rest, times, resting)
    after, _ = simulate(delivery, {**rest, driven: rest[driven] + 1e-3 * (high - low)}, times, resting)
    moved = {name: after[name] - before[name] for name in after}
    name = max(
        (min(names) for names in delivery.controlled),
        key=lambda output: abs(float(moved[output][-1])) / (abs(float(before[output][-1])) + 1e-9),
    )
    missing = np.abs(moved[name] / moved[name][-1] - 1.0)
    risen = times[np.flatnonzero(missing > RISEN)[-1] + 1]
    assert shortest / APART <= risen <= longest * APART
