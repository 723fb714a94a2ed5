r"""The quadruple-tank process: each of two pumps feeds a lower tank and the upper one of the other side.

.. math::
    A_1 \dot h_1 &= -a_1 \sqrt{2 g h_1} + a_3 \sqrt{2 g h_3} + \gamma_1 k_1 v_1 \\
    A_2 \dot h_2 &= -a_2 \sqrt{2 g h_2} + a_4 \sqrt{2 g h_4} + \gamma_2 k_2 v_2 \\
    A_3 \dot h_3 &= -a_3 \sqrt{2 g h_3} + (1 - \gamma_2) k_2 v_2 \\
    A_4 \dot h_4 &= -a_4 \sqrt{2 g h_4} + (1 - \gamma_1) k_1 v_1

K. H. Johansson, "The quadruple-tank process: a multivariable laboratory process with an adjustable zero",
IEEE Trans. Control Systems Technology 8 (2000) 456-465: equation (1), parameters of its operating point P-
(minimum phase), levels in cm as there. The zero is in the right half-plane where gamma_1 + gamma_2 < 1; for
P+ set gamma_1 = 0.43, gamma_2 = 0.34, k_1 = 3.14, k_2 = 3.29. The levels begin at the equilibrium for pumps
at 3 V.
"""

from fmu_plants import Equations, Parameter, PlantModel, Symbols, Variable, tunable

GRAVITY = 981.0  # cm/s2
AREAS = (28.0, 32.0, 28.0, 32.0)  # cm2, of the tanks
OUTLETS = (0.071, 0.057, 0.071, 0.057)  # cm2
PUMP_GAINS = (3.33, 3.35)  # cm3/(V.s)
SPLITS = (0.70, 0.60)  # the part of each pump's flow that goes to the lower tank
VOLTAGE = 3.0  # V, of both pumps at the beginning


def _equilibrium() -> tuple[float, float, float, float]:
    """Return the levels at which every tank loses what it gets."""
    flows = [gain * VOLTAGE for gain in PUMP_GAINS]
    upper = ((1 - SPLITS[1]) * flows[1], (1 - SPLITS[0]) * flows[0])
    lower = (SPLITS[0] * flows[0] + upper[0], SPLITS[1] * flows[1] + upper[1])
    h1, h2, h3, h4 = (
        (flow / outlet) ** 2 / (2 * GRAVITY) for flow, outlet in zip((*lower, *upper), OUTLETS, strict=True)
    )
    return h1, h2, h3, h4


LEVELS = tuple(
    Variable(f"level_{i}", "cm", 0.0, 20.0, nominal=10.0, start=h, description=f"Level h{i} in tank {i}")
    for i, h in enumerate(_equilibrium(), 1)
)
PUMPS = tuple(
    Variable(
        f"pump_{i}", "V", 0.0, 10.0, nominal=VOLTAGE, start=VOLTAGE, description=f"Voltage v{i} of pump {i}"
    )
    for i in (1, 2)
)


def equations(v: Symbols) -> Equations:
    """Return the right-hand side above; an empty tank has no outflow."""
    from sympy import Max, sqrt  # reading the plant's variables must not cost SymPy's import

    out = {i: v[f"outlet_{i}"] * sqrt(2 * v.gravity * Max(v[f"level_{i}"], 0)) for i in (1, 2, 3, 4)}
    pumped = {i: v[f"pump_gain_{i}"] * v[f"pump_{i}"] for i in (1, 2)}
    gain = {
        1: out[3] + v.split_1 * pumped[1],
        2: out[4] + v.split_2 * pumped[2],
        3: (1 - v.split_2) * pumped[2],
        4: (1 - v.split_1) * pumped[1],
    }
    return Equations({f"level_{i}": (gain[i] - out[i]) / v[f"area_{i}"] for i in (1, 2, 3, 4)})


def _parameters() -> tuple[Parameter, ...]:
    areas = [
        Parameter(f"area_{i}", "cm2", 1e-3, start=value, nominal=10.0, description=f"Area A{i} of tank {i}")
        for i, value in enumerate(AREAS, 1)
    ]
    outlets = [
        tunable(
            f"outlet_{i}",
            "cm2",
            0.0,
            start=value,
            nominal=0.1,
            description=f"Area a{i} of the outlet of tank {i}",
        )
        for i, value in enumerate(OUTLETS, 1)
    ]
    pumps = [
        tunable(
            f"pump_gain_{i}", "cm3/(V.s)", 0.0, start=value, description=f"Flow per voltage k{i} of pump {i}"
        )
        for i, value in enumerate(PUMP_GAINS, 1)
    ]
    splits = [
        tunable(
            f"split_{i}",
            "",
            0.0,
            1.0,
            start=value,
            description=f"Part gamma_{i} of the flow of pump {i} that goes to tank {i}",
        )
        for i, value in enumerate(SPLITS, 1)
    ]
    gravity = Parameter("gravity", "cm/s2", 0.0, start=GRAVITY, nominal=1e3, description="Gravity g")
    return (*areas, *outlets, *pumps, *splits, gravity)


MODEL = PlantModel(
    name="quadruple_tank",
    description="Quadruple-tank process",
    source="K. H. Johansson, IEEE Trans. Control Systems Technology 8 (2000) 456-465, equation (1), P-",
    states=LEVELS,
    inputs=PUMPS,
    outputs=LEVELS[:2],
    parameters=_parameters(),
    equations=equations,
    step_size=5.0,
    stop_time=1000.0,
)
