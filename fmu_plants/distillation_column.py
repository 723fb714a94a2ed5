r"""A distillation column with dead times: methanol from water, linear about its operating point.

.. math::
    \begin{pmatrix} x_D \\ x_B \end{pmatrix} =
    \begin{pmatrix} \frac{12.8 e^{-s}}{16.7 s + 1} & \frac{-18.9 e^{-3s}}{21.0 s + 1} \\
                    \frac{6.6 e^{-7s}}{10.9 s + 1} & \frac{-19.4 e^{-3s}}{14.4 s + 1} \end{pmatrix}
    \begin{pmatrix} R \\ S \end{pmatrix} +
    \begin{pmatrix} \frac{3.8 e^{-8.1s}}{14.9 s + 1} \\ \frac{4.9 e^{-3.4s}}{13.2 s + 1} \end{pmatrix} F

with compositions :math:`x_D` of the distillate and :math:`x_B` of the bottoms, flows of reflux :math:`R`,
steam :math:`S` and feed :math:`F` (a disturbance), times in minutes, all about 96.25 %, 0.5 %, 1.95, 1.71 and
2.45 lb/min. R. K. Wood, M. W. Berry, "Terminal composition control of a binary distillation column", Chemical
Engineering Science 28 (1973) 1707-1717. Times are seconds here.

An FMU of differential equations has no exact dead time: each is the Pade approximation with two zeros and
three poles, :math:`(60 - 24 p + 3 p^2) / (60 + 36 p + 9 p^2 + p^3)` with :math:`p = \theta s`. The step
responses are those of the exact ones within 5 % of the gain, and within 1 % where the dead time is 1 min.
"""

from typing import Any, NamedTuple

from fmu_plants import DisplayUnit, Equations, Parameter, PlantModel, Symbols, Variable, tunable

MINUTE = 60.0  # s
MINUTES = DisplayUnit("min", 1.0 / MINUTE)


class _Path(NamedTuple):
    """From a flow to a composition: gain [%.min/lb], time constant and dead time [min]."""

    flow: str
    composition: str
    gain: float
    time_constant: float
    dead_time: float


PATHS = (
    _Path("reflux", "distillate", 12.8, 16.7, 1.0),
    _Path("steam", "distillate", -18.9, 21.0, 3.0),
    _Path("feed", "distillate", 3.8, 14.9, 8.1),
    _Path("reflux", "bottoms", 6.6, 10.9, 7.0),
    _Path("steam", "bottoms", -19.4, 14.4, 3.0),
    _Path("feed", "bottoms", 4.9, 13.2, 3.4),
)
FLOWS = {"reflux": 1.95, "steam": 1.71, "feed": 2.45}  # lb/min
COMPOSITIONS = {"distillate": 96.25, "bottoms": 0.5}  # %, by weight


def _name(path: _Path, what: str) -> str:
    return f"{path.flow}_{path.composition}_{what}"


def _states() -> tuple[Variable, ...]:
    states = []
    for path in PATHS:
        where = f"from {path.flow} to {path.composition}"
        states.append(Variable(_name(path, "effect"), "%", description=f"Effect {where}"))
        states += [
            Variable(
                _name(path, f"delay_{i}"),
                "lb/min",
                nominal=0.1,
                description=f"State {i} of the delay {where}",
            )
            for i in (1, 2, 3)
        ]
    return tuple(states)


def _parameters() -> tuple[Parameter, ...]:
    parameters = []
    for path in PATHS:
        where = f"from {path.flow} to {path.composition}"
        times = {"time_constant": path.time_constant, "dead_time": path.dead_time}
        parameters.append(
            tunable(
                _name(path, "gain"), "%.min/lb", start=path.gain, nominal=10.0, description=f"Gain {where}"
            )
        )
        parameters += [
            tunable(
                _name(path, what),
                "s",
                1e-3,
                start=value * MINUTE,
                nominal=10.0 * MINUTE,
                description=f"{what.replace('_', ' ').capitalize()} {where}",
                display_unit=MINUTES,
            )
            for what, value in times.items()
        ]
    return tuple(parameters)


def equations(v: Symbols) -> Equations:
    """Return the equations above."""
    derivatives: dict[str, Any] = {}
    outputs: dict[str, Any] = dict(COMPOSITIONS)
    for path in PATHS:
        delay = [_name(path, f"delay_{i}") for i in (1, 2, 3)]
        q1, q2, q3 = (v[name] for name in delay)
        flow, theta = v[path.flow] - FLOWS[path.flow], v[_name(path, "dead_time")]
        rates = (q2, q3, 60 * (flow - q1) - 36 * q2 - 9 * q3)
        derivatives |= {name: rate / theta for name, rate in zip(delay, rates, strict=True)}
        delayed = (60 * q1 - 24 * q2 + 3 * q3) / 60
        effect = v[_name(path, "effect")]
        derivatives[_name(path, "effect")] = (v[_name(path, "gain")] * delayed - effect) / v[
            _name(path, "time_constant")
        ]
        outputs[path.composition] += effect
    return Equations(derivatives, outputs)


MODEL = PlantModel(
    name="distillation_column",
    description="Distillation column with dead times",
    source="R. K. Wood, M. W. Berry, Chemical Engineering Science 28 (1973) 1707-1717",
    states=_states(),
    inputs=tuple(
        Variable(name, "lb/min", 0.0, 2 * value, nominal=0.1, start=value, description=f"Flow of the {name}")
        for name, value in FLOWS.items()
    ),
    outputs=tuple(
        Variable(name, "%", description=f"Methanol in the {name}, by weight") for name in COMPOSITIONS
    ),
    parameters=_parameters(),
    equations=equations,
    step_size=2.0 * MINUTE,
    stop_time=180.0 * MINUTE,
)
