"""What inputs are for, by their words and units; each rule with what it was made for and what it spares."""

from dataclasses import replace

import pytest

from ddpc_cosim.description import DescribedVariable, PlantDescription, Values, describe
from ddpc_cosim.inspection.words import (
    Wording,
    is_comparison,
    is_named_controller,
    listed,
    unit_of,
    words_of,
)
from ddpc_cosim.suggestion.quantities import usual_levels
from ddpc_cosim.suggestion.roles import order_of_outputs, roles_of
from ddpc_cosim.variables import Variable


def signals(text: str) -> list[Variable]:
    """Return variables as ``name [unit] (description), name``."""
    variables = []
    for part in text.split(", "):
        name, _, words = part.partition(" (")
        name, _, unit = name.partition(" [")
        variables.append(Variable(name, unit.rstrip("]"), description=words.rstrip(")")))
    return variables


def plant(inputs: str, outputs: str = "y") -> PlantDescription:
    return describe(signals(inputs), signals(outputs))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("TOutdoor_air.y2", ("t", "outdoor", "air", "y", "2")),
        ("HGloHor", ("h", "glo", "hor")),
        ("solar_irradiance[3]", ("solar", "irradiance", "3")),
        ("Q-flow (W)", ("q", "flow", "w")),
        ("", ()),
        ("12", ("12",)),
        ("température", ("temp", "rature")),
    ],
)
def test_a_name_is_divided_into_words_however_it_is_spelt(text: str, words: tuple[str, ...]) -> None:
    assert words_of(text) == words


def test_a_list_that_is_cut_says_of_how_many() -> None:
    names = [f"u{i}" for i in range(104)]
    assert listed(names, 2, "inputs") == "u0, u1 (2 of 104 inputs shown)"
    assert listed(names[:2], 2, "inputs") == "u0, u1"


@pytest.mark.parametrize(
    ("inputs", "disturbances"),
    [
        # the weather, by name, description or unit
        ("TOut [K], qHea [W]", {"TOut"}),
        ("T_amb [degC], heater [W]", {"T_amb"}),
        ("Ta [degC] (Ambient temperature), P [W]", {"Ta"}),
        ("in1 (wind speed), in2", {"in1"}),
        ("weather.x, zone.heater [W]", {"weather.x"}),
        ("q [W], sun [W/m2], h [kW/m2]", {"sun", "h"}),
        ("Toutdoor [K], Tsupply [K], mfan [kg/s]", {"Toutdoor"}),
        ("T_oda, Q_flow_heat", {"T_oda"}),
        ("Tamb (Outside [K]), valve", {"Tamb"}),
        # what people and devices bring into a room; the gain of a controller is none
        ("intCon_wes, intRad_wes, conHeat_wes", {"intCon_wes", "intRad_wes"}),
        ("zone_QGaiRad_flow [W], QHea [W]", {"zone_QGaiRad_flow"}),
        ("q1 [W] (Internal heat gain), q2 [W] (heating)", {"q1"}),
        ("cylinderGain, motorSpeed", set()),
        # loads that weigh on a plant, and what is consumed
        ("loadTorque [N.m], voltage [V]", {"loadTorque"}),
        ("heatDemand [W], boilerPower [W]", {"heatDemand"}),
        ("i_load [A], duty", {"i_load"}),
        ("zr [m] (road profile), force [N]", {"zr"}),
        # what streams bring along, where there is something to drive
        ("F (reflux flow), zf (feed composition)", {"zf"}),
        ("caf [mol/m3], coolant [K]", {"caf"}),
        ("T_hot_in [K], m_flow [kg/s]", {"T_hot_in"}),
        ("inflow [m3/s], valve", {"inflow"}),
        ("u1, u2, d", {"d"}),
        ("u, w", {"w"}),
        ("P_pv [W], Pdem [W], P_bat [W]", {"P_pv", "Pdem"}),
        ("reflux [mol/s], boilup [mol/s], feedRate [mol/s], zF", {"feedRate", "zF"}),
        ("feedRate [kg/s], stirrer [rpm]", set()),
        # devices and setpoints are driven, whatever they are called besides
        ("outdoorFanSpeed, u", set()),
        ("solarPump, windTurbinePitch [rad]", set()),
        ("ambientSetpoint [K], u", set()),
        ("heaterTemperature [K], fan", set()),
        ("jacket [K], stirrer [rpm]", set()),
        ("loadVoltage [V], sourceVoltage [V]", set()),
        ("torqueDemand [N.m], gear", set()),
        # one word that also stands for what is driven is not enough where inputs do not outnumber outputs
        ("feed, stirrer", set()),
        # without anything else there is to drive
        ("feedRate [kg/s]", set()),
        ("outdoor [K]", set()),
        ("loadVoltage [V]", set()),
        ("feed [kg/s], outdoor [K]", {"outdoor"}),
        # words within words
        ("train, drain", set()),
        ("window, fan", set()),
        ("distance [m], steering", set()),
    ],
)
def test_what_words_and_units_say_of_inputs(inputs: str, disturbances: set[str]) -> None:
    outputs = "a, b" if inputs == "feed, stirrer" else "y"
    roles = roles_of(plant(inputs, outputs))
    assert set(roles.disturbances) == disturbances
    assert set(roles.driven) == {v.name for v in signals(inputs)} - disturbances


@pytest.mark.parametrize(
    ("inputs", "limited", "driven"),
    [
        ("F_ext [N], thrust", ["thrust"], ["thrust"]),
        ("Qin [m3/s], Qout [m3/s]", ["Qin"], ["Qin"]),
        ("n [rpm], mdot_2 [kg/s]", ["n"], ["n"]),
        ("a, b", ["a"], ["a"]),
        ("a, b", ["a", "b"], ["a", "b"]),
        ("a, b", [], ["a", "b"]),
        ("u1 [V], u2 [V]", ["u1"], ["u1", "u2"]),  # both are called inputs
        ("fan, valve", ["fan"], ["fan", "valve"]),  # both are devices
        ("glucoseFeed, base, acid", ["glucoseFeed"], ["glucoseFeed", "base", "acid"]),
        ("duty, Vin [V]", ["duty"], ["duty"]),
        ("insulin, meal [g/min]", ["insulin"], ["insulin"]),
    ],
)
def test_an_actuator_has_limits_and_what_has_none_beside_it_may_be_a_disturbance(
    inputs: str, limited: list[str], driven: list[str]
) -> None:
    variables = [replace(v, min=-1.0, max=1.0) if v.name in limited else v for v in signals(inputs)]
    assert list(roles_of(describe(variables, signals("x, y, z"))).driven) == driven


@pytest.mark.parametrize(
    ("symbol", "unit"),
    [("tau_L", "N.m"), ("T_L", "N.m"), ("F_d", "N"), ("Fd", "N"), ("v_w", "m/s"), ("Tf", "K"), ("Tin", "K")],
)
def test_subscripts_of_textbooks_are_known(symbol: str, unit: str) -> None:
    assert set(roles_of(plant(f"{symbol} [{unit}], u [W]", "a, b, c")).disturbances) == {symbol}


@pytest.mark.parametrize(
    ("inputs", "output", "is_controller"),
    [
        ("r, y", "u", True),
        ("TSet [K] (Set point of the measured temperature), TMea [K] (Measured)", "yVal [1]", True),
        ("a [K] (Set point), b [K] (Measured temperature)", "out", True),
        ("setpoint, feedback", "x [W] (control signal)", True),
        ("TSet [K], TOut [K]", "TRoo [K]", False),  # a room with a control of its own
        ("TSet [K], TMea [K]", "TRoo [K]", False),
        ("TSet [K], pMea [Pa]", "y", False),
        ("r, d", "u", False),
        ("setpoint, measurement", "command", True),
    ],
)
def test_words_alone_tell_a_controller(inputs: str, output: str, is_controller: bool) -> None:
    wanted, measured, sent = (Wording(v) for v in (*signals(inputs), *signals(output)))
    assert is_comparison(wanted, measured, sent) == is_controller


def test_the_evidence_is_told() -> None:
    roles = roles_of(plant("outdoor_temperature [K], heater [W]"))
    assert roles.disturbances == {"outdoor_temperature": 'its name says "outdoor" and its unit is K'}


def with_types(described: PlantDescription, **values: Values) -> PlantDescription:
    variables = {
        name: replace(variable, values=values.get(name, variable.values))
        for name, variable in described.variables.items()
    }
    return replace(described, variables=variables)


@pytest.mark.parametrize(
    ("inputs", "types", "enabling"),
    [
        ("enable, heat [W]", {"enable": "boolean"}, {"enable"}),
        ("flag, heat [W]", {"flag": "boolean"}, {"flag"}),
        ("reset, heat [W]", {"reset": "boolean"}, set()),
        ("emergency_stop, heat [W]", {"emergency_stop": "boolean"}, set()),
        ("mode, heat [W]", {"mode": "integer"}, set()),  # it has no limits: it may be a number of anything
        ("on", {"on": "boolean"}, set()),  # all there is to drive
    ],
)
def test_what_switches_on_is_tried_at_1(inputs: str, types: dict[str, Values], enabling: set[str]) -> None:
    roles = roles_of(with_types(plant(inputs), **types))
    assert set(roles.enabling) == enabling
    assert not enabling & set(roles.driven)


def test_a_burner_that_is_on_or_off_is_driven_where_the_rest_is_the_weather() -> None:
    described = with_types(plant("outdoor [K], burner"), burner="boolean")
    roles = roles_of(described)
    assert (roles.driven, set(roles.disturbances)) == (("burner",), {"outdoor"})
    assert isinstance(described.variables["burner"], DescribedVariable)


def test_an_override_is_an_actuator_whatever_it_is_called() -> None:
    inputs = [
        Variable("oveTOut_u", "K"),
        Variable("oveTOut_activate", description="Activation for ..."),
        Variable("p [W]"),
    ]
    roles = roles_of(describe(inputs, [Variable("y")]))
    assert "oveTOut_u" in roles.driven
    assert not roles.disturbances


def test_readings_come_before_what_is_spent_and_what_goes_on_inside() -> None:
    outputs = signals("internal.x, power [W], z, oveHeat_y [W], T [K], level (tank level)")
    order = order_of_outputs(outputs, ["oveHeat_u"])
    assert order == ["T", "level", "z", "power", "internal.x", "oveHeat_y"]


@pytest.mark.parametrize(
    ("name", "is_one"),
    [
        ("WinchController", True),
        ("tankcontroller", True),
        ("PID", True),
        ("ControlledTemperature", False),
        ("PlantWithController", False),
    ],
)
def test_a_model_may_be_named_a_controller(name: str, is_one: bool) -> None:
    assert is_named_controller(name) == is_one


def test_a_unit_at_the_end_of_a_description_counts_where_there_is_none() -> None:
    said = signals("Alt (Altitude [m]), T [degC] (in [K]), Mach (number [-]), x (state [1] of it)")
    assert [unit_of(variable) for variable in said] == ["m", "degC", "", ""]
    cold = Variable("Tamb", description="[K]")
    assert usual_levels([cold], (), {}) == {"Tamb": 293.15}
