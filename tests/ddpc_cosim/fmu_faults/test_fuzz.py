"""Whatever is wrong with a model description or an archive: it works, or a CosimError comes out."""

import contextlib
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from fmus.builder import integrator_description, integrator_files, write_archive
from hypothesis import HealthCheck, given, settings, strategies as st

from ddpc_cosim import CosimError, FMUPlant

fuzz = settings(
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)

RICH_2 = integrator_description("2.0").replace(
    "<ModelVariables>",
    """<UnitDefinitions>
    <Unit name="rad"><BaseUnit rad="1"/><DisplayUnit name="deg" factor="57.3" offset="0"/></Unit>
  </UnitDefinitions>
  <TypeDefinitions>
    <SimpleType name="Angle"><Real unit="rad" displayUnit="deg" min="-10" max="10"/></SimpleType>
    <SimpleType name="Mode">
      <Enumeration><Item name="off" value="0"/><Item name="on" value="1"/></Enumeration>
    </SimpleType>
  </TypeDefinitions>
  <DefaultExperiment startTime="0" stopTime="10" tolerance="1e-6" stepSize="0.1"/>
  <ModelVariables>
    <ScalarVariable name="angle" valueReference="0" causality="input">
      <Real declaredType="Angle" start="0"/>
    </ScalarVariable>
    <ScalarVariable name="mode" valueReference="2" causality="parameter" variability="tunable">
      <Enumeration declaredType="Mode" start="1"/>
    </ScalarVariable>
    <ScalarVariable name="der" valueReference="1" causality="local"><Real derivative="4"/></ScalarVariable>
    <ScalarVariable name="text" valueReference="0" causality="local"><String start="x"/></ScalarVariable>""",
)
RICH_3 = integrator_description("3.0").replace(
    "<ModelVariables>",
    """<UnitDefinitions>
    <Unit name="rad"><BaseUnit rad="1"/><DisplayUnit name="deg" factor="57.3" inverse="false"/></Unit>
  </UnitDefinitions>
  <TypeDefinitions>
    <Float64Type name="Angle" unit="rad" displayUnit="deg" min="-10" max="10"/>
    <EnumerationType name="Mode"><Item name="off" value="0"/><Item name="on" value="1"/></EnumerationType>
  </TypeDefinitions>
  <DefaultExperiment startTime="0" stopTime="10" tolerance="1e-6" stepSize="0.1"/>
  <ModelVariables>
    <UInt64 name="n" valueReference="7" causality="structuralParameter" variability="fixed" start="2"/>
    <Float64 name="x" valueReference="8" causality="local" start="1 2">
      <Dimension valueReference="7"/>
    </Float64>
    <Float64 name="z" valueReference="9" causality="output">
      <Dimension start="2"/><Dimension start="2"/>
    </Float64>
    <Float64 name="dx" valueReference="10" causality="local" derivative="8"/>
    <Enumeration name="mode" valueReference="3" causality="parameter" declaredType="Mode" start="1"/>
    <String name="text" valueReference="11" causality="parameter" variability="fixed">
      <Start value="x"/>
    </String>
    <Binary name="blob" valueReference="12" causality="input"><Start value="00ff"/></Binary>
    <Clock name="clock" valueReference="13" causality="input" intervalVariability="triggered"/>""",
)
DESCRIPTIONS = {2: RICH_2, 3: RICH_3}

NUMBERS = ("-1", "0", "1", "3", "7", "1e400", "-1e400", "NaN", "inf", "4294967296", "9" * 30, "1.5", "0x10")
WORDS = (
    "true",
    "tunable",
    "output",
    "fixed",
    "input",
    "parameter",
    "calculated",
    "exact",
    "independent",
    "u",
    "y",
)
ODD_TEXTS = ("", " ", "1 2 3", "../x", "a/b", "x" * 3000, "\u00e4\u4e2d\U0001f600", "{}", "%s%n")
TYPES = (
    "Real",
    "Integer",
    "Boolean",
    "String",
    "Enumeration",
    "Float64",
    "Float32",
    "Int8",
    "UInt64",
    "Clock",
)
TAGS = (*TYPES, "Binary", "Dimension", "Start", "Unknown", "Output", "Nonsense", "ModelExchange", "Alias")
NAMES = ("name", "valueReference", "causality", "variability", "initial", "start", "min", "max", "nominal")
OTHER_NAMES = (
    "unit",
    "declaredType",
    "derivative",
    "index",
    "fmiVersion",
    "modelIdentifier",
    "value",
    "nonsense",
)
MUTATIONS = st.lists(
    st.tuples(
        st.sampled_from(("drop", "set", "add", "remove", "duplicate", "retag", "insert", "move")),
        st.integers(0, 10**6),
        st.integers(0, 10**6),
        st.sampled_from((*NUMBERS, *WORDS, *ODD_TEXTS, "structuralParameter")),
        st.sampled_from(TAGS),
        st.sampled_from(
            (*NAMES, *OTHER_NAMES, "canBeInstantiatedOnlyOncePerProcess", "fixedInternalStepSize")
        ),
    ),
    min_size=1,
    max_size=4,
)


class Files(dict[str, bytes]):
    """An archive's files, whose contents would be of no use in a report."""

    def __repr__(self) -> str:
        return f"Files({', '.join(self)})"


def mutate(description: str, mutations: Sequence[tuple[str, int, int, str, str, str]]) -> bytes:
    """Apply changes to a model description, each to some element."""
    root = ET.fromstring(description)
    for action, place, which, text, tag, name in mutations:
        parents = {child: parent for parent in root.iter() for child in parent}
        elements = list(root.iter())
        element = elements[place % len(elements)]
        keys = sorted(element.attrib)
        parent = parents.get(element, root)
        if action == "drop" and keys:
            del element.attrib[keys[which % len(keys)]]
        elif action == "set" and keys:
            element.set(keys[which % len(keys)], text)
        elif action == "add":
            element.set(name, text)
        elif action == "retag":
            element.tag = tag
        elif action == "insert":
            element.insert(0, ET.Element(tag, {name: text}))
        elif element is not root:
            parent.remove(element) if action in ("remove", "move") else None
            target = root if action == "move" else parent
            if action != "remove":
                target.append(element)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


def use(files: Mapping[str, bytes]) -> None:
    """Write an archive and use it."""
    with tempfile.TemporaryDirectory() as folder:
        use_archive(write_archive(Path(folder) / "fuzz.fmu", files))


def use_archive(path: Path) -> None:
    """Load an FMU, start it and make a step; only errors of the family may come out."""
    with contextlib.suppress(CosimError), FMUPlant(path, max_unpacked_size=10**7) as plant:
        plant.reset({name: 0 for name in ("fault",) if name in plant.description.variables})
        plant.step(np.zeros(len(plant.inputs)), 0.1)


@pytest.fixture(scope="module")
def binaries() -> dict[int, Files]:
    """The misbehaving FMU's files by FMI version."""
    return {version: Files(integrator_files(f"{version}.0")) for version in DESCRIPTIONS}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.usefixtures("nothing_left")
class TestOnlyErrorsOfTheFamily:
    @pytest.mark.parametrize("version", [2, 3])
    @settings(fuzz, max_examples=100)
    @given(mutations=MUTATIONS)
    def test_descriptions(self, version: int, binaries: Any, mutations: Any) -> None:
        use({**binaries[version], "modelDescription.xml": mutate(DESCRIPTIONS[version], mutations)})

    @settings(fuzz, max_examples=100)
    @given(changes=st.lists(st.tuples(st.integers(0, 10**6), st.binary(max_size=3)), min_size=1, max_size=3))
    def test_bytes_of_descriptions(self, binaries: Any, changes: Any) -> None:
        text = bytearray(RICH_2.encode())
        for place, content in changes:
            start = place % len(text)
            text[start : start + len(content)] = content
        use({**binaries[2], "modelDescription.xml": bytes(text)})

    @settings(fuzz, max_examples=100)
    @given(
        changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=8),
        cut=st.none() | st.integers(0, 10**6),
        compression=st.sampled_from(
            [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]
        ),
    )
    def test_bytes_of_archives(self, changes: Any, cut: int | None, compression: int) -> None:
        """Without a library in these: a damaged one would be arbitrary code."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "fuzz.fmu"
            with zipfile.ZipFile(path, "w", compression) as archive:
                archive.writestr("modelDescription.xml", RICH_3)
                archive.writestr("resources/data.txt", "0123456789" * 20)
            content = bytearray(path.read_bytes())
            for place, value in changes:
                content[place % len(content)] = value
            path.write_bytes(content[: cut % len(content)] if cut is not None else content)
            use_archive(path)

    @settings(fuzz, max_examples=60)
    @given(names=st.lists(st.text(st.sampled_from("./\\:aA~ \u00e4*"), min_size=1, max_size=12), max_size=4))
    def test_names_of_entries(self, binaries: Any, names: list[str]) -> None:
        use({**binaries[2], **dict.fromkeys(names, b"x")})
