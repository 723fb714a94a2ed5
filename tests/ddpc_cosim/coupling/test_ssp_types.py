"""Arrays and values of other types in SSP archives: integers, booleans, texts and enumerations of FMI 3.0."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from ddpc_cosim import ConfigError
from ddpc_cosim.coupling.ssp import SSPSystem, read_ssp

from .ssp_files import binding, component, connection, ssd, ssm, ssv, system, write_ssp

DESCRIPTION = """<fmiModelDescription fmiVersion="3.0" modelName="types" instantiationToken="t">
<CoSimulation modelIdentifier="types"/>
<TypeDefinitions><EnumerationType name="Mode"><Item name="off" value="1"/><Item name="on" value="2"/>
</EnumerationType></TypeDefinitions>
<ModelVariables>
<Float64 name="u" valueReference="1" causality="input" start="0 0 0"><Dimension start="3"/></Float64>
<Float64 name="y" valueReference="2" causality="output"><Dimension start="3"/></Float64>
<Float64 name="short" valueReference="3" causality="output"><Dimension start="2"/></Float64>
<Float64 name="table" valueReference="4" causality="parameter" variability="tunable" start="0 0 0 0">
<Dimension start="2"/><Dimension start="2"/></Float64>
<Int32 name="count" valueReference="5" causality="parameter" variability="fixed" start="1"/>
<Boolean name="flag" valueReference="6" causality="parameter" variability="fixed" start="false"/>
<String name="text" valueReference="7" causality="parameter" variability="fixed"><Start value="a"/></String>
<Enumeration name="mode" declaredType="Mode" valueReference="8" causality="parameter" variability="fixed"
 start="1"/>
</ModelVariables><ModelStructure/></fmiModelDescription>"""
PART = "resources/types.fmu"
Read = Callable[..., SSPSystem]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION)

    def read(*wires: str, bindings: str = "") -> SSPSystem:
        connectors = "input u, output y, output short"
        parts = (component(name, PART, connectors) for name in "ab")
        described = system("s", *parts, connections="".join(wires), bindings=bindings)
        return read_ssp(write_ssp(tmp_path / "t.ssp", ssd(described, "2.0"), {PART: content.getvalue()}))

    return read


def ways(described: SSPSystem) -> set[tuple[str, str]]:
    return {(way.source, way.target) for way in described.connections}


def test_arrays_are_connected_as_a_whole_and_by_element(read: Read) -> None:
    whole = {(f"a.y[{i}]", f"b.u[{i}]") for i in (1, 2, 3)}
    assert ways(read(connection("a/y", "b/u"))) == whole
    by_element = connection("b/short", "a/u", more='startIndices="2" endIndices="3"')
    assert ways(read(connection("a/y", "b/u"), by_element)) == whole | {("b.short[2]", "a.u[3]")}


def test_sizes_that_differ_and_elements_that_are_not_there(read: Read) -> None:
    with pytest.raises(ConfigError, match=r"sizes differ: \[2\] and \[3\]"):
        read(connection("a/short", "b/u"))
    with pytest.raises(ConfigError, match=r"a\.short\[3\] is not an element of an array of size \[2\]"):
        read(connection("a/short", "b/u", more='startIndices="3" endIndices="3"'))


def test_values_of_every_type(read: Read) -> None:
    values = {
        "a.table": '<ssv:Float64 value="1 2 3 4"/><ssv:Dimension size="2"/><ssv:Dimension size="2"/>',
        "a.count": '<ssv:Int32 value="7"/>',
        "a.flag": '<ssv:Boolean value="true"/>',
        "a.text": '<ssv:String value="some text"/>',
        "a.mode": '<ssv:Enumeration value="on"/>',
    }
    a, _ = read(bindings=binding(ssv(values, "2.0"))).parts
    table = {"table[1,1]": 1.0, "table[1,2]": 2.0, "table[2,1]": 3.0, "table[2,2]": 4.0}
    assert a.parameters == table | {"count": 7, "flag": True, "text": "some text", "mode": "on"}


def test_values_are_mapped_by_tables(read: Read) -> None:
    """What a table does not have stays; an enumeration's items are mapped by name or by number."""
    entries = {
        "a.count": 'n <ssc:IntegerMappingTransformation><ssc:MapEntry source="7" target="9"/>'
        "</ssc:IntegerMappingTransformation>",
        "b.count": 'm <ssc:IntegerMappingTransformation><ssc:MapEntry source="7" target="9"/>'
        "</ssc:IntegerMappingTransformation>",
        "a.flag": 'f <ssc:BooleanMappingTransformation><ssc:MapEntry source="true" target="false"/>'
        "</ssc:BooleanMappingTransformation>",
        "a.mode": 'e <ssc:EnumerationMappingTransformation><ssc:MapEntry source="running" target="on"/>'
        "</ssc:EnumerationMappingTransformation>",
    }
    values = {
        "n": '<ssv:Int32 value="7"/>',
        "m": '<ssv:Int32 value="8"/>',
        "f": '<ssv:Boolean value="true"/>',
        "e": '<ssv:Enumeration value="running"/>',
    }
    a, b = read(bindings=binding(ssv(values, "2.0"), ssm(entries, "2.0"))).parts
    assert (a.parameters, b.parameters) == ({"count": 9, "flag": False, "mode": "on"}, {"count": 8})


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("a.count", '<ssv:Real value="1.5"/>', "count = 1.5 must be an integer"),
        ("a.mode", '<ssv:Enumeration value="broken"/>', "allowed: off, on"),
        ("a.flag", '<ssv:Int32 value="2"/>', "flag = 2"),
        (
            "a.table",
            '<ssv:Float64 value="1 2 3"/><ssv:Dimension size="3"/>',
            "3 values for a.table, which has 4",
        ),
        ("a.count", '<ssv:Binary value="00"/>', "values of type Binary are not supported"),
    ],
)
def test_values_that_do_not_fit_are_told(name: str, value: str, words: str, read: Read) -> None:
    with pytest.raises(ConfigError, match=words):
        read(bindings=binding(ssv({name: value}, "2.0")))
