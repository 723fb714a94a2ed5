r"""A heated building: indoor air, heaters and envelope, disturbed by the outdoor temperature and the sun.

.. math::
    C_i \dot T_i &= (T_e - T_i) / R_{ie} + (T_h - T_i) / R_{ih} + A_w \Phi_s \\
    C_h \dot T_h &= (T_i - T_h) / R_{ih} + \Phi_h \\
    C_e \dot T_e &= (T_i - T_e) / R_{ie} + (T_a - T_e) / R_{ea}

with temperatures :math:`T_i` indoors, :math:`T_h` of the heaters, :math:`T_e` of the envelope and :math:`T_a`
outdoors, heating power :math:`\Phi_h` and solar irradiance :math:`\Phi_s`. The equations are those of the
model TiTeTh of P. Bacher, H. Madsen, "Identifying suitable models for the heat dynamics of buildings", Energy
and Buildings 43 (2011) 1511-1522, without its noise. The values are not copied from there: they are chosen
here, of the size that its light building of one storey and 120 m2 has. The building begins at rest at 20 degC
with 0 degC outdoors and no sun.
"""

from fmu_plants import DisplayUnit, Equations, PlantModel, Symbols, Variable, tunable
from fmu_plants.units import KELVIN

KWH = 3.6e6  # J
CAPACITIES = {"air": 0.9 * KWH, "heater": 0.3 * KWH, "envelope": 3.2 * KWH}  # J/K
RESISTANCES = {"heater_air": 0.4e-3, "air_envelope": 0.9e-3, "envelope_outdoor": 4.4e-3}  # K/W
WINDOW_AREA = 6.0  # m2, effective
INDOOR, OUTDOOR = 293.15, 273.15  # K

HEATING = (INDOOR - OUTDOOR) / (RESISTANCES["air_envelope"] + RESISTANCES["envelope_outdoor"])  # W
CELSIUS = DisplayUnit("degC", 1.0, -KELVIN)


def _temperature(name: str, start: float, description: str) -> Variable:
    return Variable(
        name, "K", 200.0, 400.0, nominal=10.0, start=start, description=description, display_unit=CELSIUS
    )


INDOORS = _temperature("indoor_temperature", INDOOR, "Temperature T_i indoors")
HEATER = _temperature(
    "heater_temperature", INDOOR + HEATING * RESISTANCES["heater_air"], "Temperature T_h of the heaters"
)
ENVELOPE = _temperature(
    "envelope_temperature", INDOOR - HEATING * RESISTANCES["air_envelope"], "Temperature T_e of the envelope"
)
POWER = Variable(
    "heating_power", "W", 0.0, 8000.0, nominal=1000.0, start=HEATING, description="Heating power Phi_h"
)
OUTDOORS = _temperature("outdoor_temperature", OUTDOOR, "Temperature T_a outdoors")
SUN = Variable("solar_irradiance", "W/m2", 0.0, 1500.0, nominal=100.0, description="Solar irradiance Phi_s")


def equations(v: Symbols) -> Equations:
    """Return the right-hand side above."""
    from_heater = (v.heater_temperature - v.indoor_temperature) / v.heater_air_resistance
    to_envelope = (v.indoor_temperature - v.envelope_temperature) / v.air_envelope_resistance
    to_outdoors = (v.envelope_temperature - v.outdoor_temperature) / v.envelope_outdoor_resistance
    sun = v.window_area * v.solar_irradiance
    return Equations(
        {
            "indoor_temperature": (from_heater - to_envelope + sun) / v.air_capacity,
            "heater_temperature": (v.heating_power - from_heater) / v.heater_capacity,
            "envelope_temperature": (to_envelope - to_outdoors) / v.envelope_capacity,
        }
    )


MODEL = PlantModel(
    name="building",
    description="Heated building in the weather",
    source=(
        "P. Bacher, H. Madsen, Energy and Buildings 43 (2011) 1511-1522, model TiTeTh; values chosen here"
    ),
    states=(INDOORS, HEATER, ENVELOPE),
    inputs=(POWER, OUTDOORS, SUN),
    outputs=(INDOORS, HEATER),
    parameters=(
        *(
            tunable(f"{name}_capacity", "J/K", 1.0, start=value, nominal=KWH, description=f"C of the {name}")
            for name, value in CAPACITIES.items()
        ),
        *(
            tunable(
                f"{name}_resistance",
                "K/W",
                1e-9,
                start=value,
                nominal=1e-3,
                description=f"R, {name.replace('_', ' to ')}",
            )
            for name, value in RESISTANCES.items()
        ),
        tunable("window_area", "m2", 0.0, start=WINDOW_AREA, description="Effective area A_w of the windows"),
    ),
    equations=equations,
    step_size=900.0,
    stop_time=86400.0,
)
