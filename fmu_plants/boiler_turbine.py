r"""A boiler and its turbine, of 160 MW: fuel, steam and feedwater valves, and what each does to the others.

.. math::
    \dot p &= -0.0018 u_2 p^{9/8} + 0.9 u_1 - 0.15 u_3 \\
    \dot P &= (0.073 u_2 - 0.016) p^{9/8} - 0.1 P \\
    \dot \rho &= (141 u_3 - (1.1 u_2 - 0.19) p) / 85 \\
    L &= 0.05 (0.13073 \rho + 100 a + q / 9 - 67.975) \\
    a &= \frac{(1 - 0.001538 \rho) (0.8 p - 25.6)}{\rho (1.0394 - 0.0012304 p)} \\
    q &= (0.854 u_2 - 0.147) p + 45.59 u_1 - 2.514 u_3 - 2.096

with drum pressure :math:`p`, electric power :math:`P`, density :math:`\rho` of the fluid in the drum,
deviation :math:`L` of the drum's water level, steam quality :math:`a`, evaporation rate :math:`q` in kg/s,
and valve positions :math:`u_1` of fuel, :math:`u_2` of steam and :math:`u_3` of feedwater. R. D. Bell, K. J.
Astrom, "Dynamic models for boiler-turbine-alternator units: data logs and parameter estimation for a 160 MW
unit", Report TFRT-3192, Lund Institute of Technology, 1987. It begins at the nominal operating point there:
108 kgf/cm2, 66.65 MW and 428 kg/m3, which takes valves at 0.340, 0.690 and 0.436. The density integrates. The
unit's valves move by at most 0.007, 0.02 (opening) and 0.05 in a second; here nothing limits their rates.
"""

from typing import Any

from fmu_plants import Equations, PlantModel, Symbols, Variable, tunable

PRESSURE_START, POWER_START, DENSITY_START = 108.0, 66.65, 428.0


def _resting_valves() -> tuple[float, float, float]:
    """Return the valve positions that hold the starting point."""
    flow = PRESSURE_START ** (9 / 8)
    steam = (0.1 * POWER_START / flow + 0.016) / 0.073
    feedwater = (1.1 * steam - 0.19) * PRESSURE_START / 141
    return (0.0018 * steam * flow + 0.15 * feedwater) / 0.9, steam, feedwater


PRESSURE = Variable("pressure", "kgf/cm2", nominal=10.0, start=PRESSURE_START, description="Drum pressure p")
POWER = Variable("power", "MW", nominal=10.0, start=POWER_START, description="Electric power P")
DENSITY = Variable(
    "density", "kg/m3", nominal=100.0, start=DENSITY_START, description="Density rho of the fluid in the drum"
)
LEVEL = Variable("level", "m", nominal=0.1, description="Deviation L of the drum's water level")
VALVES = tuple(
    Variable(
        f"{name}_valve", "", 0.0, 1.0, nominal=0.1, start=start, description=f"Position of the {name} valve"
    )
    for name, start in zip(("fuel", "steam", "feedwater"), _resting_valves(), strict=True)
)


def equations(v: Symbols) -> Equations:
    """Return the equations above; without pressure there is no flow."""
    from sympy import Max, Rational  # reading the plant's variables must not cost SymPy's import

    p, rho, fuel, steam, water = v.pressure, v.density, v.fuel_valve, v.steam_valve, v.feedwater_valve
    flow: Any = Max(p, 0) ** Rational(9, 8)
    quality = (1 - 0.001538 * rho) * (0.8 * p - 25.6) / (rho * (1.0394 - 0.0012304 * p))
    evaporation = (0.854 * steam - 0.147) * p + 45.59 * fuel - 2.514 * water - 2.096
    return Equations(
        {
            "pressure": -0.0018 * steam * flow + v.fuel_gain * fuel - 0.15 * water,
            "power": (v.steam_gain * steam - 0.016) * flow - 0.1 * v.power,
            "density": (141 * water - (1.1 * steam - 0.19) * p) / v.drum_volume,
        },
        {"level": 0.05 * (0.13073 * rho + 100 * quality + evaporation / 9 - 67.975)},
    )


MODEL = PlantModel(
    name="boiler_turbine",
    description="Boiler and turbine of 160 MW",
    source="R. D. Bell, K. J. Astrom, Report TFRT-3192, Lund Institute of Technology, 1987",
    states=(PRESSURE, POWER, DENSITY),
    inputs=VALVES,
    outputs=(PRESSURE, POWER, LEVEL),
    parameters=(
        tunable("fuel_gain", "kgf/(cm2.s)", 0.0, start=0.9, description="Pressure that open fuel gives"),
        tunable("steam_gain", "", 0.0, start=0.073, nominal=0.1, description="Power that open steam gives"),
        tunable("drum_volume", "m3", 1.0, start=85.0, nominal=100.0, description="Volume of the drum"),
    ),
    equations=equations,
    step_size=5.0,
    stop_time=500.0,
)
