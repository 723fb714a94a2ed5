"""Units and display units, from the model description to the trace and its metrics."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import V, describe, model_library, write_fmu
from hypothesis import given, strategies as st

from ddpc_cosim import ConfigError, FMUPlant, Variable
from ddpc_cosim.variables import DisplayUnit, conversions, converter, with_display_units

DEFINED = (
    '<UnitDefinitions><Unit name="K"><BaseUnit K="1"/><DisplayUnit name="°C" offset="-273.15"/>'
    '<DisplayUnit name="half" factor="0.5"/></Unit></UnitDefinitions>'
)
DEFINED_1 = (
    '<UnitDefinitions><BaseUnit unit="K"><DisplayUnitDefinition displayUnit="°C" gain="1" offset="-273.15"/>'
    '<DisplayUnitDefinition displayUnit="half" gain="0.5" offset="0"/></BaseUnit></UnitDefinitions>'
)


@pytest.mark.parametrize("version", ["1.0", "2.0", "3.0"])
@pytest.mark.parametrize(
    ("asked", "shown"),
    [({}, 26.85), ({"x": "half"}, 150.0), ({"x": "degF"}, 80.33), ({"x": "K"}, 300.0)],
)
def test_display_units_of_the_fmu_and_of_the_user(
    tmp_path: Path, version: str, asked: dict[str, str], shown: float
) -> None:
    variables = [
        V("time", 15, causality="independent"),
        V("u", 0, causality="input", start="0"),
        V("x", 1, causality="output", more={"unit": "K", "displayUnit": "°C"}),
    ]
    text = describe(
        version,
        "lag",
        variables if version == "3.0" else variables[1:],
        interfaces='<CoSimulation modelIdentifier="models"/>',
        head=DEFINED_1 if version == "1.0" else DEFINED,
    )
    path = write_fmu(tmp_path / "lag.fmu", text, model_library(version))
    with FMUPlant(path, display_units=asked) as plant:
        (x,) = plant.outputs
    assert x.unit == "K"
    assert x.shown_in.from_unit(np.array([300.0])) == pytest.approx([shown])


def test_unknown_units_and_signals_are_refused(exported: Callable[[str], Path]) -> None:
    with pytest.raises(ConfigError, match=r'angle: no conversion from "rad" to "K"; there are: deg'):
        FMUPlant(exported("2.0"), display_units={"angle": "K"})
    with pytest.raises(ConfigError, match=r'display_units: no signal "angel"; did you mean "angle"'):
        FMUPlant(exported("2.0"), display_units={"angel": "deg"})


@given(
    st.sampled_from([(u, s) for u in ("rad", "K", "Pa", "m", "s", "1") for s in conversions(u)]),
    st.floats(-1e6, 1e6),
)
def test_what_a_study_gives_in_a_display_unit_is_converted_back(pair: tuple[str, str], value: float) -> None:
    unit, shown = pair
    variable = Variable("x", unit)
    back = conversions(unit)[shown].from_unit(np.array([converter(variable, shown)(value)]))
    assert back == pytest.approx([value], abs=1e-6)


def test_a_definition_of_the_fmu_counts_before_the_usual_one() -> None:
    definitions = {"K": (DisplayUnit("degC", 2.0, 1.0),)}
    (variable,) = with_display_units([Variable("T", "K")], {"T": "degC"}, definitions)
    assert variable.shown_in == DisplayUnit("degC", 2.0, 1.0)
