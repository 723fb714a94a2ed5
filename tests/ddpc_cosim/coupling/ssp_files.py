"""SSP archives that tests write: descriptions in short forms, FMUs built from equations."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

from fmu_plants import Equations, PlantModel, Symbols, Variable, build_fmu, tunable

_NAMESPACES = " ".join(
    f'xmlns:{short}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for short, name in {
        "ssc": "Common",
        "ssd": "Description",
        "ssv": "ParameterValues",
        "ssm": "ParameterMapping",
    }.items()
)


def _mass(v: Symbols) -> Equations:
    return Equations({"x": v.v, "v": (v.force - v.c * v.x - v.d * v.v) / v.m}, {"reaction": v.c * v.x})


def _gain(v: Symbols) -> Equations:
    return Equations({"idle": -v.idle}, {"y": v.k * v.u + v.b})


X, V = Variable("x", "m"), Variable("v", "m/s")
MASS = PlantModel(
    name="mass",
    states=(X, V),
    inputs=(Variable("force", "N"),),
    outputs=(X, V, Variable("reaction", "N")),
    parameters=(
        tunable("m", "kg", start=1.0),
        tunable("c", "N/m", start=4.0),
        tunable("d", "N.s/m", start=0.0),
    ),
    equations=_mass,
)
GAIN = PlantModel(
    name="gain",
    states=(Variable("idle"),),
    inputs=(Variable("u"),),
    outputs=(Variable("y"),),
    parameters=(tunable("k", start=1.0), tunable("b")),
    equations=_gain,
)


def ssd(system: str, version: str = "1.0", more: str = "") -> str:
    """Return a system structure description."""
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<ssd:SystemStructureDescription {_NAMESPACES} '
        f'name="test" version="{version}">{system}{more}</ssd:SystemStructureDescription>'
    )


def system(name: str, *elements: str, connections: str = "", connectors: str = "", bindings: str = "") -> str:
    """Return a system of elements."""
    return (
        f'<ssd:System name="{name}">{connectors_of(connectors)}{_bindings(bindings)}'
        f"<ssd:Elements>{''.join(elements)}</ssd:Elements>"
        f"<ssd:Connections>{connections}</ssd:Connections></ssd:System>"
    )


def component(name: str, source: str, connectors: str = "", bindings: str = "", more: str = "") -> str:
    """Return a component that is an FMU."""
    return (
        f'<ssd:Component name="{name}" source="{source}" {more}>{connectors_of(connectors)}'
        f"{_bindings(bindings)}</ssd:Component>"
    )


def connectors_of(text: str) -> str:
    """Return connectors, ``"input force N, output x m, output y"``."""
    connectors = ""
    for connector in filter(None, (words.split() for words in text.split(","))):
        kind, name, *unit = connector
        real = f'<ssc:Real unit="{unit[0]}"/>' if unit else "<ssc:Real/>"
        connectors += f'<ssd:Connector name="{name}" kind="{kind}">{real}</ssd:Connector>'
    return f"<ssd:Connectors>{connectors}</ssd:Connectors>" if connectors else ""


def connection(start: str, end: str, within: str = "", more: str = "") -> str:
    """Return a connection of ``element/connector`` or ``connector``."""
    ends = ""
    for which, signal in (("start", start), ("end", end)):
        element, _, name = signal.rpartition("/")
        ends += f'{which}Element="{element}" ' if element else ""
        ends += f'{which}Connector="{name}" '
    return f"<ssd:Connection {ends}{more}>{within}</ssd:Connection>"


def linear(factor: float, offset: float = 0.0) -> str:
    """Return a linear transformation."""
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def binding(set_or_source: str, mapping: str = "", more: str = "") -> str:
    """Return a parameter binding: of a file, or of a set within it."""
    if set_or_source.startswith("<"):
        values, source = f"<ssd:ParameterValues>{set_or_source}</ssd:ParameterValues>", ""
    else:
        values, source = "", f'source="{set_or_source}"'
    if mapping.startswith("<"):
        mapping = f"<ssd:ParameterMapping>{mapping}</ssd:ParameterMapping>"
    elif mapping:
        mapping = f'<ssd:ParameterMapping source="{mapping}"/>'
    return f"<ssd:ParameterBinding {source} {more}>{values}{mapping}</ssd:ParameterBinding>"


def ssv(values: Mapping[str, object], version: str = "1.0", more: str = "") -> str:
    """Return a parameter set; a value is a number, or an element such as ``<ssv:Integer value="1"/>``."""
    written = "".join(
        f'<ssv:Parameter name="{name}">'
        + (value if isinstance(value, str) else f'<ssv:Real value="{value}"/>')
        + "</ssv:Parameter>"
        for name, value in values.items()
    )
    return (
        f'<ssv:ParameterSet {_NAMESPACES} version="{version}" name="set">'
        f"<ssv:Parameters>{written}</ssv:Parameters>{more}</ssv:ParameterSet>"
    )


def ssm(entries: Mapping[str, str], version: str = "1.0") -> str:
    """Return a mapping of targets to sources; behind a blank what is within the entry."""
    written = ""
    for target, text in entries.items():
        source, _, within = text.partition(" ")
        written += f'<ssm:MappingEntry source="{source}" target="{target}">{within}</ssm:MappingEntry>'
    return f'<ssm:ParameterMapping {_NAMESPACES} version="{version}">{written}</ssm:ParameterMapping>'


def unit(name: str, factor: float = 1.0, offset: float = 0.0, **exponents: int) -> str:
    """Return the definition of a unit."""
    powers = " ".join(f'{base}="{power}"' for base, power in exponents.items())
    return (
        f'<ssc:Unit name="{name}"><ssc:BaseUnit {powers} factor="{factor!r}" offset="{offset!r}"/></ssc:Unit>'
    )


def write_ssp(path: Path, description: str, files: Mapping[str, str | bytes | PlantModel]) -> Path:
    """Write an archive; FMUs are given by their models."""
    with zipfile.ZipFile(path, "w") as archive:
        if description:
            archive.writestr("SystemStructure.ssd", description)
        for name, content in files.items():
            archive.writestr(
                name, build_fmu(content).read_bytes() if isinstance(content, PlantModel) else content
            )
    return path


def _bindings(text: str) -> str:
    return f"<ssd:ParameterBindings>{text}</ssd:ParameterBindings>" if text else ""
