"""Variables of every type as inputs, outputs and parameters; arrays; start values that take effect."""

from collections.abc import Callable, Sequence
from pathlib import Path

import fmpy.fmi1
import fmpy.fmi2
import fmpy.fmi3
import numpy as np
import pytest
from fmus.builder import CO_SIMULATION, GAINED, LAG, Fault, V, describe, model_fmu, model_library, write_fmu

from ddpc_cosim import simulate
from ddpc_cosim.errors import ConfigError, FMUImportError, FMUStepError
from ddpc_cosim.fmu.description import FMUDescription
from ddpc_cosim.fmu.description.reader import read_description
from ddpc_cosim.fmu.description.variable_types import TYPES
from ddpc_cosim.fmu.plant import FMUPlant

VERSIONS = ("1.0", "2.0", "3.0")

PAIRS = {
    "real": ("Float64", 2, "2.5"),
    "single": ("Float32", 3, "0"),
    "long": ("Int64", 4, "0"),
    "whole": ("Int32", 5, "0"),
    "unsigned": ("UInt64", 6, "0"),
    "short": ("Int16", 7, "0"),
    "byte": ("Int8", 8, "0"),
    "switch": ("Boolean", 9, "false"),
    "mode": ("Enumeration", 10, "1"),
}
MODES = (
    '<TypeDefinitions><EnumerationType name="Mode"><Item name="off" value="1"/><Item name="on" value="2"/>'
    "</EnumerationType></TypeDefinitions>"
)
LENGTH = '<Dimension valueReference="1"/>'
MATRIX = '<Dimension start="2"/><Dimension start="3"/>'


def feedthrough(folder: Path, *, event_mode: bool = False) -> Path:
    variables = [
        V("time", 0, causality="independent"),
        V("n", 1, "UInt64", "structuralParameter", "fixed", start="2"),
    ]
    for name, (fmi_type, reference, start) in PAIRS.items():
        variability = "continuous" if fmi_type.startswith("Float") else "discrete"
        more = {"declaredType": "Mode"} if name == "mode" else {}
        variables.append(V(f"{name} in", reference, fmi_type, "input", variability, start, more=more))
        variables.append(V(f"{name} out", reference + 100, fmi_type, "output", variability, more=more))
    for name, reference, dimensions, start in (
        ("v", 20, LENGTH, "1 2"),
        ("M", 30, MATRIX, "1 2 3 4 5 6"),
    ):
        nested = {"nested": dimensions}
        variables.append(V(f"{name}", reference, "Float64", "input", start=start, more=nested))
        variables.append(V(f"{name} out", reference + 100, "Float64", "output", more=nested))
    k = V("k", 21, "Float64", "parameter", "tunable", "1 1", more={"nested": LENGTH})
    variables += [k, V("k out", 121, "Float64", "output", more={"nested": LENGTH})]
    variables.append(V("steps", 199, "Float64", "output"))
    interfaces = (
        '<CoSimulation modelIdentifier="models" canHandleVariableCommunicationStepSize="true" '
        f'hasEventMode="{str(event_mode).lower()}"/>'
    )
    text = describe("3.0", "feed", variables, interfaces=interfaces, head=MODES)
    return write_fmu(folder / "feed.fmu", text, model_library("3.0"))


def pass_through(
    path: Path, names: Sequence[str], values: Sequence[float], **parameters: float
) -> list[float]:
    session = FMUPlant(path, inputs=names, outputs=[_output(name) for name in names])
    session.reset(parameters)
    y = session.step(np.array(values), 0.1)
    session.close()
    return [float(value) for value in y]


def _output(name: str) -> str:
    base, bracket, index = name.partition("[")
    return base.replace(" in", "").strip() + " out" + bracket + index


@pytest.mark.parametrize("event_mode", [False, True])
def test_numbers_of_every_type_pass_through(tmp_path: Path, event_mode: bool) -> None:
    """Twice, as discrete inputs are set in event mode where the FMU has one."""
    path = feedthrough(tmp_path, event_mode=event_mode)
    names = [f"{name} in" for name in PAIRS]
    values = [0.1, 0.5, -(2.0**40), -7, 2.0**40, -300, 100, 1, 2]
    assert pass_through(path, names, values) == values


def test_types_may_be_mixed_in_any_order(tmp_path: Path) -> None:
    path = feedthrough(tmp_path)
    names = ["whole in", "real in", "switch in", "short in", "M[2,1]"]
    assert pass_through(path, names, [3, 0.25, 0, -4, 9.5]) == [3, 0.25, 0, -4, 9.5]


def test_whole_numbers_are_rounded_and_truth_values_cut_at_a_half(tmp_path: Path) -> None:
    path = feedthrough(tmp_path)
    assert pass_through(path, ["whole in", "switch in", "byte in"], [2.6, 0.7, -1.4]) == [3, 1, -1]


LARGEST = {
    "byte in": (-(2.0**7), 2.0**7 - 1),
    "short in": (-(2.0**15), 2.0**15 - 1),
    "whole in": (-(2.0**31), 2.0**31 - 1),
}


@pytest.mark.parametrize("name", LARGEST)
def test_an_integer_that_its_type_cannot_hold_is_an_error_and_not_another_number(
    tmp_path: Path, name: str
) -> None:
    """As an input, and given before the run."""
    path = feedthrough(tmp_path)
    low, high = LARGEST[name]
    for number in (low, high):
        assert pass_through(path, [name], [number]) == [number]
        with FMUPlant(path, inputs=["real in"], outputs=[_output(name)]) as plant:
            plant.reset({name: number})
            assert plant.step(np.zeros(1), 0.1) == [number]
    for number in (low - 1, high + 1, np.nan):
        with pytest.raises(
            FMUStepError, match=rf"{name} = .* is outside what its type can be: \[-\d+, \d+\]"
        ):
            pass_through(path, [name], [number])
        with pytest.raises(ConfigError, match=f"{name} = .* is outside"):
            pass_through(path, ["real in"], [0.0], **{name: number})


def test_the_number_above_the_largest_of_64_bits_is_seen(tmp_path: Path) -> None:
    """2^63 - 1 is not a float; 2^63 is."""
    path = feedthrough(tmp_path)
    assert pass_through(path, ["long in"], [-(2.0**63)]) == [-(2.0**63)]
    with pytest.raises(FMUStepError, match=r"long in = .* is outside"):
        pass_through(path, ["long in"], [2.0**63])


def test_an_input_is_driven_once_whatever_it_is_called(tmp_path: Path) -> None:
    more = {"nested": '<Alias name="v"/>'}
    variables = [
        V("u", 0, causality="input", start="0", more=more),
        V("x", 1, causality="output", more={"nested": '<Alias name="y"/>'}),
    ]
    path = write_fmu(tmp_path / "alias.fmu", describe("3.0", "lag", variables), model_library("3.0"))
    with FMUPlant(path) as plant:
        assert [[v.name for v in signals] for signals in (plant.inputs, plant.outputs)] == [["u"], ["x"]]
    with FMUPlant(path, inputs=["v"], outputs=["y", "x"]) as plant:
        plant.reset()
        assert plant.step([1.0], 0.1) == pytest.approx([1 - np.exp(-0.1)] * 2)
    with pytest.raises(ConfigError, match=r'the input "u" is another name of "v"; drive one of them'):
        FMUPlant(path, inputs=["v", "u"])


def test_elements_of_arrays_are_addressed_from_1_in_rows(tmp_path: Path) -> None:
    path = feedthrough(tmp_path)
    session = FMUPlant(
        path, inputs=["M[1,2]", "v[2]"], outputs=[f"M out[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)]
    )
    session.reset({"M[2,3]": 6.0})
    assert session.step(np.array([0.2, 5.0]), 0.1).tolist() == [0.0, 0.2, 0.0, 0.0, 0.0, 6.0]
    session.close()


def test_arrays_are_known_by_their_elements(tmp_path: Path) -> None:
    session = FMUPlant(feedthrough(tmp_path), outputs=["steps"])
    inputs = {v.name: v.start for v in session.inputs}
    session.close()
    assert inputs == {"real in": 2.5, "single in": 0.0, "v[1]": 1.0, "v[2]": 2.0} | {
        f"M[{i},{j}]": 3.0 * (i - 1) + j for i in (1, 2) for j in (1, 2, 3)
    }


def test_structural_parameters_size_arrays_before_anything_else(tmp_path: Path) -> None:
    """The FMU takes the size in configuration mode only, and everything else outside of it only."""
    path = feedthrough(tmp_path)
    session = FMUPlant(path, inputs=["v[1]", "v[4]"], outputs=["v out[4]", "k out[4]", "v out[1]"])
    session.reset({"k[4]": 7.0, "n": 4})
    assert session.step(np.array([1.5, 2.5]), 0.1).tolist() == [2.5, 7.0, 1.5]
    with pytest.raises(ConfigError, match=r"v\[4\] is outside the array v of size \[2\]"):
        session.reset()
    with pytest.raises(ConfigError, match=r"k\[4\] is outside the array k of size \[2\]"):
        session.reset({"k[4]": 7.0})
    session.reset({"n": 5})
    assert session.step(np.array([1.5, 2.5]), 0.1).tolist() == [2.5, 0.0, 1.5]
    session.close()


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        (["v"], '"v" is an array of size [2]; name its elements: v[1], v[2]'),
        (["M[3,1]"], 'no input "M[3,1]"; did you mean "M[2,1]"?'),
        (["M[1]"], 'no input "M[1]"'),
        (["real in", "real in"], 'input "real in" is chosen twice'),
        ([1], "inputs = [1] is not possible; needed: a list of names"),
        ("real in", "inputs = 'real in' is not possible; needed: a list of names"),
        (["real out"], 'no input "real out"'),
    ],
)
def test_names_that_are_no_inputs_are_refused(tmp_path: Path, inputs: list[str], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        FMUPlant(feedthrough(tmp_path), inputs=inputs)
    assert words in str(caught.value)


def test_texts_and_bytes_are_no_signals(tmp_path: Path) -> None:
    path = model_fmu(tmp_path, "2.0", "lag")
    with pytest.raises(ConfigError, match='"name" is a String and cannot be an output; only numbers can'):
        FMUPlant(path, outputs=["name"])


def test_steps_that_return_early_are_continued(tmp_path: Path) -> None:
    session = FMUPlant(feedthrough(tmp_path), inputs=["real in"], outputs=["steps"])
    session.reset()
    assert session.step(np.array([0.0]), 0.4) == [2.0]
    assert session.step(np.array([0.0]), 0.3) == [3.0]
    assert session.time == pytest.approx(0.7)
    session.close()


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
def test_start_values_and_parameters_take_effect(tmp_path: Path, version: str, kind: str) -> None:
    settings = {} if version != "1.0" else {"interfaces": "CoSimulation" if kind == "co-simulation" else ""}
    path = model_fmu(tmp_path, version, "lag", **settings)
    session = FMUPlant(path, outputs=["x", "name_length"], fmi_type=kind, tolerance=1e-9)  # type: ignore[arg-type]
    start = session.reset({"x": 0.5, "rate": 2.0, "name": "größer"})
    assert start.tolist() == [0.5, len("größer".encode())]
    x, _ = session.step(np.array([1.0]), 0.5)
    assert x == pytest.approx(1 - 0.5 * np.exp(-1.0), abs=1e-7)
    session.close()


@pytest.mark.parametrize("driven", [True, False])
def test_inputs_start_where_they_are_told(tmp_path: Path, driven: bool) -> None:
    """speed = gain u count on, with gain = 1, count = 2 and on = 1: already before the first step."""
    text = describe("2.0", "integrator", GAINED, interfaces=CO_SIMULATION)
    path = write_fmu(tmp_path / "gained.fmu", text, model_library("2.0"))
    inputs = ["u"] if driven else []
    with FMUPlant(path, inputs=inputs, outputs=["speed"], start={"u": 3.0}) as plant:
        assert [v.start for v in plant.inputs] == [3.0] * len(inputs)
        assert plant.reset({"gain": 2.0}) == [12.0]
    with pytest.raises(ConfigError, match=r'"v"; did you mean "u"|u = 11 is outside \[-10, 10\]') as caught:
        FMUPlant(path, start={"v": 3.0, "u": 11.0})
    assert len(caught.value.faults) == 2


@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("isolated", [False, True], ids=["in-process", "isolated"])
def test_an_fmu_that_forgets_when_it_is_set_up_is_given_its_values_afterwards(
    tmp_path: Path, kind: str, isolated: bool
) -> None:
    """As those of 20-sim do: fmi2SetupExperiment puts every variable back to its own start value."""
    path = model_fmu(tmp_path, "2.0", "lag", Fault.FORGETS_IN_SET_UP)
    settings = {"fmi_type": kind, "isolated": isolated, "tolerance": 1e-9}
    with FMUPlant(path, outputs=["x", "name_length"], start={"u": 2.0}, **settings) as plant:  # type: ignore[arg-type]
        for rate in (2.0, 3.0):  # of the second run nothing is left of the first
            assert plant.reset({"x": 0.5, "rate": rate, "name": "tank"}).tolist() == [0.5, 4.0]
            x, _ = plant.step(np.array([1.0]), 0.5)
            assert x == pytest.approx(1 - 0.5 * np.exp(-0.5 * rate), abs=1e-7)
    with FMUPlant(path, inputs=[], outputs=["x"], start={"u": 2.0}, **settings) as plant:  # type: ignore[arg-type]
        plant.reset()
        assert plant.step(np.empty(0), 0.5) == pytest.approx(2 - 2 * np.exp(-0.5), abs=1e-7)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"rate": 11.0}, "parameter rate = 11 is outside [-10, 10]"),
        ({"rate": float("inf")}, "parameter rate = inf is outside"),
        ({"rate": "fast"}, "parameter rate = 'fast' must be a number"),
        ({"name": 1.0}, "parameter name = 1.0 must be a text"),
        ({"der(x)": 1.0}, 'no parameter "der(x)": the FMU calculates it'),
        ({"u": 1.0}, '"u" is an input that is driven'),
        ({"ratte": 1.0}, 'no parameter "ratte"; did you mean "rate"?'),
    ],
)
def test_impossible_values_are_refused_by_name(
    tmp_path: Path, values: dict[str, float | str], words: str
) -> None:
    session = FMUPlant(model_fmu(tmp_path, "2.0", "lag"), outputs=["x"])
    with pytest.raises(ConfigError) as caught:
        session.reset(values)
    assert words in str(caught.value)
    session.close()


def test_an_array_as_a_whole_is_refused_with_its_elements(tmp_path: Path) -> None:
    with FMUPlant(feedthrough(tmp_path), inputs=["real in"], outputs=["steps"]) as plant:
        with pytest.raises(ConfigError, match=r'"k" is an array; set its elements: k\[1\], k\[2\]'):
            plant.reset({"k": 1.0})
        with pytest.raises(ConfigError, match=r"M\[1,1\], M\[1,2\], M\[1,3\], M\[2,1\]"):
            plant.reset({"M": 1.0})


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_value_that_the_fmu_refuses_is_an_error(tmp_path: Path, version: str) -> None:
    session = FMUPlant(model_fmu(tmp_path, version, "lag"), outputs=["x"])
    with pytest.raises(FMUStepError, match=r"the FMU refuses rate = -1: fmi\dSet\w+ returned error"):
        session.reset({"rate": -1.0})
    session.close()


def test_a_value_that_the_fmu_ignores_is_an_error(tmp_path: Path) -> None:
    session = FMUPlant(
        model_fmu(tmp_path, "2.0", "ball", interfaces='<ModelExchange modelIdentifier="models"/>')
    )
    with pytest.raises(FMUStepError, match=r"the FMU ignores e = 0.123: initialised, it has 0.7"):
        session.reset({"e": 0.123})
    session.close()


def test_enumerations_are_given_by_name_or_number(tmp_path: Path) -> None:
    session = FMUPlant(feedthrough(tmp_path), inputs=["real in"], outputs=["mode out"])
    for value in ("on", 2):
        session.reset({"mode in": value})
        assert session.step(np.array([0.0]), 0.1) == [2.0]
    with pytest.raises(ConfigError, match="must be a number; allowed: off, on"):
        session.reset({"mode in": "broken"})
    session.close()


def test_an_fmu_without_inputs_runs(exported: Callable[[str], Path]) -> None:
    session = FMUPlant(exported("3.0"), inputs=[], outputs=["angle"])
    session.reset({"torque": 1.0})
    assert session.step(np.empty(0), 0.1) > 0
    session.close()


NEGATED = ("minus_u", "minus_x", "minus_rate")


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_negated_aliases_have_the_opposite_sign(tmp_path: Path, kind: str) -> None:
    """FMI 1.0 lets a variable be the opposite of what the FMU has under its value reference."""
    aliases = [
        V("minus_u", 0, causality="input", start="0"),
        V("minus_x", 1, causality="output"),
        V("minus_rate", 6, causality="parameter", start="-1"),
    ]
    text = describe("1.0", "lag", [*LAG, *aliases], interfaces=kind)
    for name in NEGATED:
        text = text.replace(f'name="{name}"', f'name="{name}" alias="negatedAlias"')
    path = write_fmu(tmp_path / "lag.fmu", text, model_library("1.0"))
    session = FMUPlant(path, inputs=["minus_u"], outputs=["x", "minus_x", "rate"])
    session.reset({"minus_rate": -2.0})
    x, minus_x, rate = session.step(np.array([-1.0]), 1.0)
    session.close()
    assert rate == 2.0
    assert x == pytest.approx(1 - np.exp(-2.0), abs=1e-5)
    assert minus_x == -x


def test_limits_that_mean_none_are_none(tmp_path: Path) -> None:
    """Many tools write the largest number that they know."""
    unlimited = {"min": "-1.7976931348623157E+308", "max": "1E+60"}
    variables = [V("u", 0, causality="input", start="0", more=unlimited), *LAG[1:]]
    session = FMUPlant(
        write_fmu(tmp_path / "lag.fmu", describe("2.0", "lag", variables), model_library("2.0"))
    )
    session.close()
    assert (session.inputs[0].min, session.inputs[0].max) == (-np.inf, np.inf)


@pytest.mark.parametrize("word", ["INF", "-INF", "NaN"])
def test_a_stop_time_that_is_no_number_is_none(tmp_path: Path, word: str) -> None:
    experiment = f'<DefaultExperiment startTime="0" stopTime="{word}"/>'
    text = describe("2.0", "lag", LAG, head=experiment)
    session = FMUPlant(write_fmu(tmp_path / "lag.fmu", text, model_library("2.0")))
    session.close()
    assert session.description.default_experiment.stop_time is None


def test_arrays_that_would_not_fit_into_memory_are_refused(tmp_path: Path) -> None:
    huge = '<Dimension start="65536"/>' * 10_000
    text = describe("3.0", "lag", [*LAG, V("field", 30, more={"nested": huge})])
    with pytest.raises(FMUImportError, match="the array field has 4294967296 elements; allowed: 1000000"):
        FMUPlant(write_fmu(tmp_path / "lag.fmu", text, model_library("3.0")))


def test_arrays_that_together_would_not_fit_into_memory_are_refused(tmp_path: Path) -> None:
    large = '<Dimension start="600000"/>'
    arrays = [V(f"field{i}", 30 + i, more={"nested": large}) for i in range(2)]
    words = "1200000 elements up to the array field1; allowed: 1000000"
    with pytest.raises(FMUImportError, match=words):
        FMUPlant(
            write_fmu(tmp_path / "lag.fmu", describe("3.0", "lag", [*LAG, *arrays]), model_library("3.0"))
        )


@pytest.mark.parametrize(("major", "name"), [(major, name) for major in TYPES for name in TYPES[major]])
def test_the_table_of_types_agrees_with_fmpy_and_numpy(major: int, name: str) -> None:
    row = TYPES[major][name]
    functions = {1: fmpy.fmi1.FMU1Slave, 2: fmpy.fmi2.FMU2Slave, 3: fmpy.fmi3.FMU3Slave}[major]
    if row.function:
        assert hasattr(functions, f"fmi{major}Get{row.function}")
        assert hasattr(functions, f"fmi{major}Set{row.function}")
    if "Int" in name and name != "Integer":
        limits = np.iinfo(np.dtype(row.c_type))
        assert (row.min, row.max) == (float(limits.min), float(limits.max))


def read(tmp_path: Path, version: str, variables: Sequence[V], head: str = "") -> FMUDescription:
    (tmp_path / "modelDescription.xml").write_text(describe(version, "lag", variables, head=head))
    return read_description(tmp_path, "lag.fmu")


def test_limits_of_unsigned_integers_count(tmp_path: Path) -> None:
    n = V("n", 30, "UInt8", "parameter", "fixed", "2", more={"min": "1", "max": "5"})
    variable = read(tmp_path, "3.0", [*LAG, n]).variables["n"].variable
    assert (variable.min, variable.max) == (1.0, 5.0)


def test_display_units_of_the_reciprocal_value_are_left_out(tmp_path: Path) -> None:
    """They would need another formula than the others: 1/(factor * value) (FMI 3.0, section 2.4.3.1)."""
    unit = (
        '<UnitDefinitions><Unit name="km/l"><BaseUnit/><DisplayUnit name="l/100km" factor="0.01" '
        'inverse="true"/><DisplayUnit name="m/l" factor="1000"/></Unit></UnitDefinitions>'
    )
    assert [shown.name for shown in read(tmp_path, "3.0", LAG, unit).display_units["km/l"]] == ["m/l"]


def test_places_count_after_a_variable_that_cannot_be_used(tmp_path: Path) -> None:
    """The model structure of FMI 2.0 counts all variables, also those without a type."""
    description = read(tmp_path, "2.0", [V("odd", 40, "Complex"), *LAG])
    assert "odd" not in description.variables
    assert description.derivatives == ("der(x)",)
    assert description.states == ("x",)
    assert list(description.dependencies) == ["x"]


def test_defaults_that_follow_the_causality(tmp_path: Path) -> None:
    """FMI 3.0, section 2.4.7.4: a parameter is fixed, an integer discrete."""
    text = describe("3.0", "lag", [*LAG, V("n", 30, "Int32"), V("p", 31, causality="parameter", start="1")])
    text = text.replace(' variability="continuous"', "")
    (tmp_path / "modelDescription.xml").write_text(text)
    description = read_description(tmp_path, "lag.fmu")
    kinds = {name: (v.variability, v.initial) for name, v in description.variables.items()}
    assert kinds["p"] == ("fixed", "exact")
    assert kinds["n"] == ("discrete", "calculated")
    assert kinds["u"] == ("continuous", "exact")
    assert not description.warnings


def test_an_integer_that_would_be_rounded_is_an_error(tmp_path: Path) -> None:
    path = feedthrough(tmp_path)
    words = r"long in = 9007199254740993 is not a number of double precision.* nearest is 9007199254740992"
    with FMUPlant(path, inputs=[], outputs=["long out"]) as plant:
        plant.reset({"long in": 2**53})
        assert plant.step(np.empty(0), 0.1)[0] == 2.0**53
        with pytest.raises(ConfigError, match=words):
            plant.reset({"long in": 2**53 + 1})
        with pytest.raises(ConfigError, match="must be a number"):
            plant.reset({"long in": 10**400})
    with pytest.raises(ConfigError, match=words):
        simulate(path, parameters={"long in": str(2**53 + 1)}, stop=0.1)
