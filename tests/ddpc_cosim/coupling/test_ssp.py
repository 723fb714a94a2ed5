"""SSP archives as they are read: systems, connections, parameters, and what is wrong with them."""

from collections.abc import Callable
from pathlib import Path

import pytest

from ddpc_cosim import ConfigError
from ddpc_cosim.coupling.ssp import SSPSystem, read_ssp
from ddpc_cosim.fmu.archive import UnpackLimits

from .ssp_files import (
    GAIN,
    MASS,
    binding,
    component,
    connection,
    linear,
    ssd,
    ssm,
    ssv,
    system,
    unit,
    write_ssp,
)

Read = Callable[..., SSPSystem]
FILES = {"resources/mass.fmu": MASS, "resources/gain.fmu": GAIN}
A = component("a", "resources/mass.fmu", "input force N, output x m")
B = component("b", "resources/gain.fmu", "input u, output y")


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read(description: str, **files: object) -> SSPSystem:
        given = {f"resources/{name.replace('__', '.')}": content for name, content in files.items()}
        return read_ssp(write_ssp(tmp_path / "test.ssp", description, {**FILES, **given}))  # type: ignore[dict-item]

    return read


def ways(described: SSPSystem) -> set[tuple[str, str, float, float]]:
    return {(way.source, way.target, way.factor, way.offset) for way in described.connections}


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_parts_and_connections_of_a_system(read: Read, version: str) -> None:
    description = ssd(
        system(
            "outer",
            A,
            B,
            connections=connection("a/x", "b/u") + connection("push", "a/force") + connection("b/y", "out"),
            connectors="input push N, output out",
        ),
        version,
        '<ssd:DefaultExperiment startTime="1" stopTime="3"/>',
    )
    result = read(description)
    assert [(part.name, part.source) for part in result.parts] == [
        ("a", "resources/mass.fmu"),
        ("b", "resources/gain.fmu"),
    ]
    assert ways(result) == {("a.x", "b.u", 1, 0), ("push", "a.force", 1, 0), ("b.y", "out", 1, 0)}
    assert [(v.name, v.unit) for v in (*result.inputs, *result.outputs)] == [("push", "N"), ("out", "")]
    experiment = result.default_experiment
    assert (result.version, experiment.start_time, experiment.stop_time) == (version, 1.0, 3.0)


def test_the_ends_of_a_connection_tell_no_direction(read: Read) -> None:
    result = read(ssd(system("outer", A, B, connections=connection("b/u", "a/x"))))
    assert ways(result) == {("a.x", "b.u", 1, 0)}


def test_units_are_converted_before_transformations(read: Read) -> None:
    """From m to a unit of the file, in which 1 m is (1 - 0.5) / 0.01 = 50; then 3 * 50 + 7."""
    b = component("b", "resources/gain.fmu", "input u shifted, output y")
    units = f"<ssd:Units>{unit('shifted', 0.01, 0.5, m=1)}</ssd:Units>"
    for more, (factor, offset) in {
        "": (300.0, -3 * 50.0 + 7.0),
        'suppressUnitConversion="true"': (3.0, 7.0),
    }.items():
        wire = connection("a/x", "b/u", linear(3.0, 7.0), more)
        (way,) = read(ssd(system("outer", A, b, connections=wire), more=units)).connections
        assert (way.factor, way.offset) == pytest.approx((factor, offset))
        assert (way.source_unit, way.target_unit) == ("m", "shifted")


def test_connections_through_nested_systems_are_one(read: Read) -> None:
    """Each has its own conversion and transformation: x [m] -> 2 x [m] -> [mm] -> + 1."""
    inner = system(
        "in.ner", B, connections=connection("u1", "b/u", linear(1.0, 1.0)), connectors="input u1 mm"
    )
    outer = system("outer", A, inner, connections=connection("a/x", "in.ner/u1", linear(2.0)))
    result = read(ssd(outer))
    # The transformation is of a value in mm: 2 * (1000 x) + 1.
    assert ways(result) == {("a.x", "in_ner/b.u", 2000.0, 1.0)}
    assert [part.name for part in result.parts] == ["a", "in_ner/b"]
    assert result.warnings == ('"in.ner/b" is called "in_ner/b"; parts have no dots',)


def test_a_nested_archive_is_a_system(read: Read, tmp_path: Path) -> None:
    inner = ssd(
        system(
            "whatever",
            component("m", "deep/mass.fmu", "input force N, output x m"),
            connections=connection("f", "m/force", linear(2.0)) + connection("m/x", "place"),
            connectors="input f N, output place m",
            bindings=binding(ssv({"m.m": 5.0, "m.d": 1.0})),
        )
    )
    nested = write_ssp(tmp_path / "nested.ssp", inner, {"deep/mass.fmu": MASS}).read_bytes()
    sub = component(
        "sub",
        "resources/nested.ssp",
        bindings=binding(ssv({"m.m": 7.0})),
        more='type="application/x-ssp-package"',
    )
    outer = system("outer", sub, B, connections=connection("b/y", "sub/f") + connection("sub/place", "b/u"))
    result = read(ssd(outer, "2.0"), nested__ssp=nested)
    assert ways(result) == {("b.y", "sub/m.force", 2.0, 0.0), ("sub/m.x", "b.u", 1.0, 0.0)}
    assert result.parts[0].parameters == {"m": 7.0, "d": 1.0}  # those of the component come last


def test_a_system_of_the_same_file_can_be_there_twice(read: Read) -> None:
    inner = system("one", A).replace("<ssd:System ", '<ssd:System id="s" ')
    two = component("two", "#s", more='type="application/x-ssp-definition"')
    assert [part.name for part in read(ssd(system("outer", inner, two))).parts] == ["one/a", "two/a"]


def test_a_system_that_contains_itself_is_refused(read: Read) -> None:
    again = component("again", "#s", more='type="application/x-ssp-definition"')
    endless = system("one", again).replace("<ssd:System ", '<ssd:System id="s" ')
    with pytest.raises(ConfigError, match="more than 16 systems within each other"):
        read(ssd(system("outer", endless)))


def test_values_further_out_and_later_ones_count_more(read: Read) -> None:
    a = component(
        "a", "resources/mass.fmu", bindings=binding(ssv({"m": 1.5, "c": 1.5})) + binding(ssv({"d": 1.5}))
    )
    inner = system("in", a, bindings=binding(ssv({"a.c": 2.5, "a.d": 2.5})) + binding(ssv({"a.d": 3.5})))
    result = read(
        ssd(system("outer", inner, bindings=binding("resources/p.ssv"))), p__ssv=ssv({"in.a.m": 9.0})
    )
    assert result.parts[0].parameters == {"m": 9.0, "c": 2.5, "d": 3.5}


def test_a_prefix_and_a_mapping_with_transformations(read: Read) -> None:
    """Only what is mapped is applied: in the unit of the target, then transformed."""
    values = ssv(
        {"M": '<ssv:Real value="2000" unit="g"/>', "C": 10.0, "d": 3.0},
        more=f"<ssv:Units>{unit('g', 1e-3, kg=1)}</ssv:Units>",
    )
    mapping = ssm({"a.m": f"p.M {linear(2.0, 0.5)}", "a.c": "p.C"})
    description = ssd(
        system("outer", A, bindings=binding("resources/p.ssv", "resources/p.ssm", 'prefix="p."'))
    )
    result = read(description, p__ssv=values, p__ssm=mapping)
    assert result.parts[0].parameters == pytest.approx({"m": 4.5, "c": 10.0})
    inline = ssd(system("outer", A, bindings=binding(values, mapping, 'prefix="p."')))
    assert read(inline).parts[0].parameters == result.parts[0].parameters


def test_a_value_of_a_connector_goes_where_it_leads(read: Read) -> None:
    """A start value of an outer input, and a parameter of the system that two parts have."""
    parts = (A, component("c", "resources/mass.fmu", "parameter m kg"))
    wires = (
        connection("push", "a/force", linear(2.0, 1.0))
        + connection("mass", "a/m")
        + connection("mass", "c/m", linear(3.0))
    )
    described = system(
        "outer",
        component("a", "resources/mass.fmu", "input force N, parameter m kg"),
        parts[1],
        connections=wires,
        connectors="input push kN, parameter mass kg",
        bindings=binding(ssv({"push": 0.5, "mass": 4.0})),
    )
    result = read(ssd(described))
    a, c = result.parts
    assert (a.parameters, c.parameters) == ({"m": 4.0}, {"m": 12.0})
    assert a.start == {"force": 2.0 * 500.0 + 1.0}
    (push,) = result.inputs
    assert (push.name, push.unit, push.start) == ("push", "kN", 0.5)
    assert ways(result) == {("push", "a.force", 2000.0, 1.0)}


def test_values_that_fit_nothing_are_told_and_left_out(read: Read) -> None:
    result = read(ssd(system("outer", A, bindings=binding(ssv({"a.mass": 1.0, "a.m": 2.0, "b.k": 3.0})))))
    assert result.parts[0].parameters == {"m": 2.0}
    (warning,) = result.warnings
    assert "parameters that nothing in the system has, which are left out: a.mass, b.k" in warning


BAD = {
    "another version": (ssd(system("o", A), "3.0"), {}, 'version "3.0" of SSP; 1.0 and 2.0 can be read'),
    "no FMU": (ssd(system("o", component("q", "resources/q.fmu"))), {}, 'q: no file "resources/q.fmu"'),
    "an FMU elsewhere": (ssd(system("o", component("q", "../q.fmu"))), {}, "outside of the archive"),
    "a URL": (ssd(system("o", component("q", "http://x.y/q.fmu"))), {}, "outside of the archive"),
    "no element": (ssd(system("o", A, connections=connection("a/x", "z/u"))), {}, 'no element "z"'),
    "no variable": (
        ssd(system("o", A, B, connections=connection("a/place", "b/u"))),
        {},
        r'a \(mass.fmu\) has no variable "place"',
    ),
    "no connector": (
        ssd(system("o", A, connections=connection("push", "a/force"), connectors="input pull N")),
        {},
        'the system has no connector "push"',
    ),
    "two outputs": (
        ssd(system("o", A, B, connections=connection("a/x", "b/y"))),
        {},
        r"no value flows between these \(output and output\)",
    ),
    "two sources": (
        ssd(system("o", A, B, connections=connection("a/x", "b/u") + connection("a/v", "b/u"))),
        {},
        "b.u is connected to a.x already",
    ),
    "units": (
        ssd(
            system(
                "o",
                A,
                component("c", "resources/mass.fmu", "input force N"),
                connections=connection("a/x", "c/force"),
            )
        ),
        {},
        '"m" and "N" are units of different quantities',
    ),
    "a unit that is not the FMU's": (
        ssd(system("o", component("q", "resources/mass.fmu", "output x mm"))),
        {},
        r'connector q\.x is in "mm", and its variable in the FMU in "m"',
    ),
    "a dictionary": (
        ssd(system("o", A, '<ssd:SignalDictionaryReference name="bus" dictionary="d"/>')),
        {},
        "<SignalDictionaryReference> is not supported",
    ),
    "a Modelica model": (
        ssd(system("o", component("q", "q.mo", more='type="text/x-modelica; path=A.B"')), "2.0"),
        {},
        'type "text/x-modelica" are not supported',
    ),
    "an impossible value": (
        ssd(system("o", A, bindings=binding(ssv({"a.m": '<ssv:Real value="much"/>'})))),
        {},
        "parameter a.m: could not convert",
    ),
    "a set of another version": (
        ssd(system("o", A, bindings=binding("resources/p.ssv"))),
        {"p__ssv": ssv({"a.m": 1.0}, "0.9")},
        'p.ssv: version "0.9"',
    ),
    "no set": (ssd(system("o", A, bindings=binding("resources/p.ssv"))), {}, 'no file "resources/p.ssv"'),
    "two to one target": (
        ssd(
            system(
                "o",
                A,
                bindings=binding(
                    ssv({"p": 1.0}),
                    ssm({"a.m": "p"}).replace(
                        "</ssm:P", '<ssm:MappingEntry source="q" target="a.m"/></ssm:P'
                    ),
                ),
            )
        ),
        {},
        "two parameters are mapped to a.m",
    ),
    "an entity": (
        ssd(system("o", A)).replace("<ssd:SystemS", '<!DOCTYPE x [<!ENTITY a "b">]><ssd:SystemS', 1),
        {},
        "declares a document type",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_said_with_names(read: Read, what: str) -> None:
    description, files, message = BAD[what]
    with pytest.raises(ConfigError, match=message):
        read(description, **files)


def test_all_faults_are_told_at_once(read: Read) -> None:
    description = ssd(
        system(
            "o",
            A,
            component("q", "resources/q.fmu"),
            connections=connection("a/x", "z/u") + connection("a/x", "q/u") + connection("a/force", "push"),
            bindings=binding("resources/p.ssv"),
        )
    )
    with pytest.raises(ConfigError) as caught:
        read(description)
    assert len(caught.value.faults) == 4  # what is said of q is said once
    assert all(fault.startswith("test.ssp: SystemStructure.ssd: ") for fault in caught.value.faults)


def test_an_archive_without_description_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"not an SSP archive: the archive has no SystemStructure\.ssd"):
        read_ssp(write_ssp(tmp_path / "empty.ssp", "", {"other.ssd": ssd(system("o", A))}))
    with pytest.raises(ConfigError, match="no such file"):
        read_ssp(tmp_path / "missing.ssp")
    (tmp_path / "text.ssp").write_text("no archive")
    with pytest.raises(ConfigError, match="not an SSP archive"):
        read_ssp(tmp_path / "text.ssp")


def test_archives_within_each_other_share_the_room_that_there_is(
    read: Read, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    filler = {"extra/zeros": bytes(300_000)}
    nested = write_ssp(tmp_path / "nested.ssp", ssd(system("n")), filler).read_bytes()
    parts = (
        component(name, f"resources/{name}.ssp", more='type="application/x-ssp-package"') for name in "ab"
    )
    monkeypatch.setattr(
        "ddpc_cosim.coupling.ssp.documents.UnpackLimits",
        lambda max_unpacked_size=400_000: UnpackLimits(max_unpacked_size),
    )
    with pytest.raises(ConfigError, match="unpacks to more than") as caught:
        read(ssd(system("o", *parts)), a__ssp=nested, b__ssp=nested)
    assert len(caught.value.faults) == 1
