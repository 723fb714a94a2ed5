"""Plants as equations, for the controller that goes by them."""

from dataclasses import replace

import numpy as np

from fmu_plants import EmbeddedControl, Equations, InputTable, PlantModel, Rules, Symbols, Variable


def reference_plant(v: Symbols) -> Equations:
    """The plant of the conformance kit: x' = G u - x."""
    return Equations({"y1": v.u1 + 0.1 * v.u2 - v.y1, "y2": 0.1 * v.u1 + v.u2 - v.y2})


def every_function(v: Symbols) -> Equations:
    from sympy import Abs, Max, Min, Piecewise, atan2, ceiling, cos, exp, floor, log, sign, sqrt, tan, tanh

    x, u = v.y1, v.u1
    smooth = exp(-x) * cos(u) + tan(x / 9) + atan2(x, 2 + u) + log(3 + x**2) / sqrt(2 + u) + tanh(x) ** 3
    jumps = floor(3 * x) + ceiling(2 * u) + sign(x) * Abs(u) + Max(x, u, 0.1) - Min(x, -u)
    cases = Piecewise((x**2, x > 0.5), (-u, u <= -0.2), (1.5, True))
    return Equations({"y1": smooth + v.time, "y2": jumps + cases})


def _model(equations: object) -> PlantModel:
    outputs = tuple(Variable(f"y{i}") for i in (1, 2))
    inputs = tuple(Variable(f"u{i}", min=-1.0, max=1.0) for i in (1, 2))
    return PlantModel(
        name=equations.__name__, equations=equations, states=outputs, inputs=inputs, outputs=outputs
    )


REFERENCE, FUNCTIONS = _model(reference_plant), _model(every_function)


def disturbed_plant(v: Symbols) -> Equations:
    """Two lags, the second one with what disturbs it."""
    return Equations({"y1": v.u1 + 0.5 * v.y2 - v.y1 + 0.6 * v.sun, "y2": 0.4 * v.u1 - 1.5 * v.y2 + v.wind})


DISTURBED = PlantModel(
    name="disturbed_plant",
    equations=disturbed_plant,
    states=(Variable("y1"), Variable("y2")),
    inputs=(Variable("u1", min=-1.0, max=1.0), Variable("sun"), Variable("wind")),
    outputs=(Variable("y1"), Variable("y2")),
)


def oscillating_plant(v: Symbols) -> Equations:
    """An oscillator, and what its motion heats."""
    return Equations(
        {"y1": v.x, "x": 2.0 * v.u1 - 4.0 * v.y1 - 0.6 * v.x + v.sun, "y2": 0.5 * v.x - v.y2 + v.wind}
    )


def integrating_plant(v: Symbols) -> Equations:
    """A tank that fills, before it a lag."""
    return Equations({"y1": 0.7 * v.y2 + 0.3 * v.sun, "y2": v.u1 - 2.0 * v.y2 + 0.4 * v.wind})


def _disturbed(equations: object, *states: str) -> PlantModel:
    return replace(
        DISTURBED,
        name=equations.__name__,
        equations=equations,
        states=tuple(Variable(name) for name in states),
    )


OSCILLATING = _disturbed(oscillating_plant, "y1", "x", "y2")
INTEGRATING = _disturbed(integrating_plant, "y1", "y2")


def heated_room(v: Symbols) -> Equations:
    """A room that a table disturbs and a control of its own heats, with a heat pump that cold slows down."""
    heat = v.Pump * (3.0 + 0.05 * v.outdoors)
    return Equations(
        {"room": 0.2 * (v.outdoors - v.room) + heat + v.sun},
        {"weather_y": v.outdoors, "warmer_y": v.outdoors + 1.0},
    )


ROOM_TIMES = np.array([0.0, 10.0, 20.0, 30.0])
ROOM_WEATHER = np.array([[5.0, 0.1], [5.0, 0.3], [-5.0, 0.3], [-5.0, 0.0]])
HEATED_ROOM = PlantModel(
    name="heated_room",
    equations=heated_room,
    states=(Variable("room", start=18.0),),
    outputs=(Variable("room", start=18.0), Variable("weather_y"), Variable("warmer_y")),
    tables=(
        InputTable(
            file="weather.csv",
            variables=(Variable("outdoors"), Variable("sun")),
            values=lambda: (ROOM_TIMES, ROOM_WEATHER),
            interpolation="hold",
        ),
    ),
    control=EmbeddedControl(
        sampling_time=1.0,
        actuators=(Variable("Pump", min=0.0, max=2.0, start=0.5),),
        rules=lambda v: Rules({"Pump": 1.0}),
    ),
)
