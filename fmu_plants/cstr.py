r"""A continuous stirred-tank reactor: first-order exothermic reaction, cooled by a jacket.

.. math::
    \dot c &= \frac{q}{V} (c_f - c) - k(T) c \\
    \dot T &= \frac{q}{V} (T_f - T) + \frac{\Delta H}{\rho C_p} k(T) c
              + \frac{U\!A}{V \rho C_p} (T_c - T) \\
    k(T) &= k_0 \exp\left(-\frac{E}{R T}\right)

with concentration :math:`c`, temperature :math:`T` and coolant temperature :math:`T_c`. Equations and
values: D. E. Seborg, T. F. Edgar, D. A. Mellichamp, "Process Dynamics and Control", 2nd ed., 2004, example
2.5 (also M. A. Henson, D. E. Seborg, "Nonlinear Process Control", 1997): V = 100 L, q = 100 L/min, E/R =
8750 K, k_0 = 7.2e10 1/min, heat of reaction 5e4 J/mol, UA = 5e4 J/(min.K), density 1000 g/L, heat capacity
0.239 J/(g.K), feed at 1 mol/L and 350 K. Minutes are seconds here.

At a coolant temperature of 300 K there are three equilibria. The simulation begins at the cold one, which
is stable (324.5 K, 12 % conversion); the middle one at 350 K and 50 % conversion is not. The two meet at a
coolant of 303.23 K and 335.7 K in the reactor: above that coolant it ignites.
"""

from math import exp

from fmu_plants import DisplayUnit, Equations, Parameter, PlantModel, Symbols, Variable, tunable
from fmu_plants.units import KELVIN

MINUTE = 60.0  # s
VOLUME = 100.0  # L
FLOW = 100.0 / MINUTE  # L/s
FEED_CONCENTRATION, FEED_TEMPERATURE = 1.0, 350.0  # mol/L, K
RATE, ACTIVATION = 7.2e10 / MINUTE, 8750.0  # 1/s, K
REACTION_HEAT = 5e4  # J/mol
HEAT_CAPACITY = 1000.0 * 0.239  # J/(L.K): density times specific heat
HEAT_TRANSFER = 5e4 / MINUTE  # W/K
START_TEMPERATURE = 324.475443431599  # K, the cold equilibrium for a coolant of 300 K

CELSIUS = DisplayUnit("degC", 1.0, -KELVIN)


def _equilibrium(temperature: float) -> tuple[float, float]:
    """Return the concentration and the coolant temperature that hold this temperature."""
    rate = RATE * exp(-ACTIVATION / temperature)
    concentration = FLOW * FEED_CONCENTRATION / (FLOW + VOLUME * rate)
    gained = FLOW * HEAT_CAPACITY * (FEED_TEMPERATURE - temperature)
    gained += REACTION_HEAT * VOLUME * rate * concentration
    return concentration, temperature - gained / HEAT_TRANSFER


START_CONCENTRATION, START_COOLANT = _equilibrium(START_TEMPERATURE)

CONCENTRATION = Variable(
    "concentration", "mol/L", 0.0, start=START_CONCENTRATION, description="Concentration c of the reactant"
)
TEMPERATURE = Variable(
    "temperature",
    "K",
    200.0,
    600.0,
    nominal=100.0,
    start=START_TEMPERATURE,
    description="Temperature T in the reactor",
    display_unit=CELSIUS,
)
COOLANT = Variable(
    "coolant_temperature",
    "K",
    250.0,
    350.0,
    nominal=100.0,
    start=START_COOLANT,
    description="Temperature T_c of the coolant",
    display_unit=CELSIUS,
)


def equations(v: Symbols) -> Equations:
    """Return the right-hand side above."""
    from sympy import exp  # reading the plant's variables must not cost SymPy's import

    dilution = v.flow / v.volume
    reaction = v.rate * exp(-v.activation / v.temperature) * v.concentration
    return Equations(
        {
            "concentration": dilution * (v.feed_concentration - v.concentration) - reaction,
            "temperature": dilution * (v.feed_temperature - v.temperature)
            + v.reaction_heat / v.heat_capacity * reaction
            + v.heat_transfer / (v.volume * v.heat_capacity) * (v.coolant_temperature - v.temperature),
        }
    )


MODEL = PlantModel(
    name="cstr",
    description="Continuous stirred-tank reactor with an exothermic reaction",
    source=(
        'D. E. Seborg, T. F. Edgar, D. A. Mellichamp: "Process Dynamics and Control", 2nd ed., 2004, '
        "example 2.5"
    ),
    states=(CONCENTRATION, TEMPERATURE),
    inputs=(COOLANT,),
    outputs=(TEMPERATURE, CONCENTRATION),
    parameters=(
        Parameter("volume", "L", 1e-3, start=VOLUME, nominal=100.0, description="Volume V"),
        tunable(
            "flow",
            "L/s",
            0.0,
            start=FLOW,
            description="Flow q through the reactor",
            display_unit=DisplayUnit("L/min", MINUTE),
        ),
        tunable(
            "feed_concentration",
            "mol/L",
            0.0,
            start=FEED_CONCENTRATION,
            description="Concentration c_f of the feed",
        ),
        tunable(
            "feed_temperature",
            "K",
            250.0,
            450.0,
            nominal=100.0,
            start=FEED_TEMPERATURE,
            description="Temperature T_f of the feed",
            display_unit=CELSIUS,
        ),
        Parameter("rate", "1/s", 0.0, start=RATE, nominal=1e9, description="Rate constant k_0"),
        Parameter(
            "activation", "K", 0.0, start=ACTIVATION, nominal=1e4, description="Activation energy by R, E/R"
        ),
        Parameter(
            "reaction_heat", "J/mol", start=REACTION_HEAT, nominal=1e4, description="Heat that is set free"
        ),
        Parameter(
            "heat_capacity",
            "J/(L.K)",
            1e-3,
            start=HEAT_CAPACITY,
            nominal=100.0,
            description="Density times specific heat capacity",
        ),
        tunable(
            "heat_transfer",
            "W/K",
            0.0,
            start=HEAT_TRANSFER,
            nominal=1e3,
            description="Heat transfer coefficient times area UA",
        ),
    ),
    equations=equations,
    step_size=6.0,
    stop_time=1800.0,
)
