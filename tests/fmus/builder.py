"""The FMUs that tests compile: model descriptions for three FMI versions, models and faults, archives.

There is one family, of C files in this folder: ``models.c`` behind a front end for each FMI version. A GUID
or token says which model an instance is, and which fault it has.
"""

import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, auto
from functools import cache
from pathlib import Path
from typing import Any

import fmpy

from fmu_plants.export.compiler import compile_library, find_compiler

HERE = Path(__file__).parent
IDENTIFIER = "models"


class Fault(IntEnum):
    """The faults of models.h, in its order."""

    NO_FAULT = 0
    RETURN_WARNING = auto()
    RETURN_ERROR = auto()
    RETURN_FATAL = auto()
    RETURN_ILLEGAL = auto()
    RETURN_DISCARD = auto()
    DISCARD_AND_TERMINATE = auto()
    RETURN_NAN = auto()
    RETURN_INFINITY = auto()
    SEGMENTATION_FAULT = auto()
    CALL_ABORT = auto()
    CALL_EXIT = auto()
    OVERFLOW_STACK = auto()
    HANG_IN_STEP = auto()
    HANG_IN_INITIALIZATION = auto()
    HANG_IN_TERMINATE = auto()
    CRASH_IN_INITIALIZATION = auto()
    CRASH_IN_TERMINATE = auto()
    ERROR_IN_INITIALIZATION = auto()
    ERROR_WHEN_READ = auto()
    WARNING_WHEN_SET = auto()
    NO_INSTANCE = auto()
    LOG_AT_EVERY_STEP = auto()
    FLOOD_LOG = auto()
    FLOOD_STDOUT = auto()
    FLOOD_STDERR = auto()
    FLOOD_DESCRIPTOR = auto()
    LEAVE_A_FILE = auto()
    PRINT_AND_ABORT = auto()
    ASK_TO_TERMINATE = auto()
    WRITE_A_FILE = auto()
    READ_A_FILE = auto()
    OPEN_A_SOCKET = auto()
    NEEDS_EVENT_MODE = auto()
    NO_CO_SIMULATION = auto()
    MINUS_ONE_IN_STEP = auto()
    MINUS_ONE_IN_INITIALIZATION = auto()
    MINUS_ONE_WHEN_READ = auto()
    MINUS_ONE_WHEN_SET = auto()
    ROUND_UP = auto()
    ROUND_TO_ZERO = auto()
    FLUSH_DENORMALS = auto()
    EVENTS_WITHOUT_END = auto()
    FORGETS_IN_SET_UP = auto()
    LARGE_STATE = auto()


@dataclass(frozen=True)
class V:
    """A variable; ``start`` as in XML, ``more`` are further attributes of the type's element."""

    name: str
    reference: int
    type: str = "Real"
    causality: str = "local"
    variability: str = "continuous"
    start: str | None = None
    initial: str | None = None
    derivative: int | None = None
    more: Mapping[str, str] = field(default_factory=dict)


def attributes(**values: object) -> str:
    return "".join(f' {key}="{value}"' for key, value in values.items() if value is not None)


def describe(
    version: str,
    token: str,
    variables: Iterable[V],
    *,
    interfaces: str | None = None,
    indicators: int = 0,
    head: str = "",
    identifier: str = IDENTIFIER,
) -> str:
    """Return the modelDescription.xml of an FMU."""
    write = {"1": _describe_1, "2": _describe_2, "3": _describe_3}[version[0]]
    if interfaces is None:
        both = f'<{{}} modelIdentifier="{identifier}"{{}}/>'
        step = ' canHandleVariableCommunicationStepSize="true"'
        interfaces = both.format("ModelExchange", "") + both.format("CoSimulation", step)
    return write(token, list(variables), interfaces, indicators, head)


def _describe_1(token: str, variables: list[V], interfaces: str, indicators: int, head: str) -> str:
    rows = ""
    for v in variables:
        causality = {"parameter": "internal", "local": "internal"}.get(v.causality, v.causality)
        variability = "parameter" if v.causality == "parameter" else v.variability
        typed = f"<{v.type}{attributes(start=v.start, **v.more)}/>"
        name = attributes(
            name=v.name, valueReference=v.reference, causality=causality, variability=variability
        )
        rows += f"<ScalarVariable{name}>{typed}</ScalarVariable>"
    states = sum(v.derivative is not None for v in variables)
    implementation = (
        "<Implementation><CoSimulation_StandAlone>"
        '<Capabilities canHandleVariableCommunicationStepSize="true" canHandleEvents="true"/>'
        "</CoSimulation_StandAlone></Implementation>"
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="1.0" modelName="{token}" '
        f'modelIdentifier="{IDENTIFIER}" guid="{token}" numberOfContinuousStates="{states}" '
        f'numberOfEventIndicators="{indicators}">{head}<ModelVariables>{rows}</ModelVariables>'
        f"{implementation if 'CoSimulation' in interfaces else ''}</fmiModelDescription>"
    )


def _describe_2(token: str, variables: list[V], interfaces: str, indicators: int, head: str) -> str:
    rows, outputs, derivatives = "", "", ""
    place = {v.reference: i + 1 for i, v in enumerate(variables)}
    for i, v in enumerate(variables):
        derivative = None if v.derivative is None else place[v.derivative]
        typed = f"<{v.type}{attributes(start=v.start, derivative=derivative, **v.more)}/>"
        outer = attributes(
            name=v.name,
            valueReference=v.reference,
            causality=v.causality,
            variability=v.variability,
            initial=v.initial,
        )
        rows += f"<ScalarVariable{outer}>{typed}</ScalarVariable>"
        outputs += f'<Unknown index="{i + 1}"/>' if v.causality == "output" else ""
        derivatives += f'<Unknown index="{i + 1}"/>' if v.derivative is not None else ""
    structure = (f"<Outputs>{outputs}</Outputs>" if outputs else "") + (
        f"<Derivatives>{derivatives}</Derivatives>" if derivatives else ""
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="{token}" '
        f'guid="{token}" numberOfEventIndicators="{indicators}">{interfaces}{head}'
        f"<ModelVariables>{rows}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
        "</fmiModelDescription>"
    )


def _describe_3(token: str, variables: list[V], interfaces: str, indicators: int, head: str) -> str:
    renamed = {"Real": "Float64", "Integer": "Int32"}
    rows, structure = "", ""
    for v in variables:
        fmi_type = renamed.get(v.type, v.type)
        nested = f'<Start value="{v.start}"/>' if fmi_type == "String" else v.more.get("nested", "")
        outer: dict[str, Any] = {
            "name": v.name,
            "valueReference": v.reference,
            "causality": v.causality,
            "variability": v.variability,
            "start": None if fmi_type == "String" else v.start,
            "initial": v.initial,
            "derivative": v.derivative,
            **{key: value for key, value in v.more.items() if key != "nested"},
        }
        rows += f"<{fmi_type}{attributes(**outer)}>{nested}</{fmi_type}>"
    for tag, chosen in (
        ("Output", [v for v in variables if v.causality == "output"]),
        ("ContinuousStateDerivative", [v for v in variables if v.derivative is not None]),
    ):
        structure += "".join(f'<{tag} valueReference="{v.reference}"/>' for v in chosen)
    # FMI 3.0 counts event indicators by naming them; here the first state is the indicator.
    structure += '<EventIndicator valueReference="1"/>' * indicators
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="{token}" '
        f'instantiationToken="{token}">{interfaces}{head}<ModelVariables>{rows}</ModelVariables>'
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


@cache
def model_library(
    version: str,
    *,
    complete: bool = False,
    telling: bool = False,
    fast_math: bool = False,
    keeping: bool = False,
) -> bytes:
    """Return the library for an FMI version.

    It has no more functions than runs need, or is complete, or tells directional derivatives (FMI 2.0), or
    does when it is loaded what compilers link in for fast-math, or keeps states and makes bytes of them.
    """
    names = ("models.h", "models.c", f"front{version[0]}.c")
    sources = {name: (HERE / name).read_text(encoding="utf-8") for name in names}
    required = {"1": "models_fmiDoStep", "2": "fmi2DoStep", "3": "fmi3DoStep"}[version[0]]
    asked = {"COMPLETE": complete, "TELLING": telling, "FAST_MATH": fast_math, "KEEPING": keeping}
    switches = [f"-D{name}" for name, wanted in asked.items() if wanted]
    return compile_library(find_compiler(), sources, [required], switches)


def platform_folder(version: str) -> str:
    return str(fmpy.platform_tuple if version[0] == "3" else fmpy.platform)


def write_fmu(
    path: Path, description: str, content: bytes | None, *, place: str | None = None, **files: str
) -> Path:
    """Write an archive; ``place`` is the library's path in it, ``files`` are texts by path."""
    version = "3" if 'fmiVersion="3' in description else "2"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        if content is not None:
            archive.writestr(place or library_name(version), content)
        for name, text in files.items():
            archive.writestr(name, text)
    return path


U = V("u", 0, causality="input", start="0")
LAG = (
    U,
    V("x", 1, causality="output", initial="exact", start="0"),
    V("der(x)", 7, derivative=1),
    V("rate", 6, causality="parameter", variability="tunable", start="1", more={"min": "-10", "max": "10"}),
    V("name", 20, "String", causality="parameter", variability="fixed", start="a"),
    V("name_length", 9),
)
BALL = (
    U,
    V("h", 1, causality="output", initial="exact", start="1"),
    V("v", 2, causality="output", initial="exact", start="0"),
    V("der(h)", 7, derivative=1),
    V("der(v)", 8, derivative=2),
    V("g", 3, causality="parameter", variability="fixed", start="9.81"),
    V("e", 4, causality="parameter", variability="fixed", start="0.7"),
    V("bounces", 5, variability="discrete"),
)
STAIR = (U, V("count", 5, "Integer", causality="output", variability="discrete"))
RELAY = (
    U,
    V("x", 1, causality="output", initial="exact", start="0"),
    V("der(x)", 7, derivative=1),
    V("rate", 6, causality="parameter", variability="fixed", start="1"),
    V("count", 5, causality="output", variability="discrete"),
)
FAULTS = (
    V("fault", 10, "Integer", causality="parameter", variability="fixed", start="0"),
    V("fault_time", 11, causality="parameter", variability="fixed", start="0"),
)
INTEGRATOR = (
    V("u", 0, causality="input", start="0", more={"min": "-10", "max": "10"}),
    V("y", 1, causality="output", more={"min": "-100", "max": "100"}),
    *FAULTS,
)
"""y' = u, with a fault and its time as parameters."""
GAINED = (
    V("u", 0, causality="input", start="0", more={"min": "-10", "max": "10"}),
    V("y", 1, causality="output"),
    V("speed", 12, causality="output"),
    V("hidden", 1),
    V("gain", 6, causality="parameter", variability="tunable", start="1", more={"min": "0", "max": "5"}),
    V("count", 0, "Integer", causality="parameter", variability="fixed", start="2"),
    V("on", 0, "Boolean", causality="parameter", variability="fixed", start="true"),
)
"""y' = gain * u, and speed = gain * u * count * on."""
MODELS = {"lag": LAG, "ball": BALL, "stair": STAIR, "relay": RELAY, "integrator": INTEGRATOR}
CO_SIMULATION = (
    f'<CoSimulation modelIdentifier="{IDENTIFIER}" canHandleVariableCommunicationStepSize="true"/>'
)


def with_time(version: str, variables: Iterable[V]) -> list[V]:
    """Return variables with the independent one, where an FMI version needs it."""
    return [*([V("time", 15, causality="independent")] if version[0] == "3" else []), *variables]


def model_fmu(folder: Path, version: str, model: str, fault: Fault = Fault.NO_FAULT, **settings: Any) -> Path:
    """Write one of the models of models.c as an FMU, with a fault from t = 0.5 s on."""
    token = f"{model}:{int(fault)}" if fault else model
    description = describe(
        version, token, with_time(version, MODELS[model]), indicators=int(model == "ball"), **settings
    )
    return write_fmu(folder / f"{model}{version[0]}.fmu", description, model_library(version))


def keeping_fmu(
    folder: Path, version: str, model: str, claims: Iterable[str] = ("GetAndSet", "Serialize"), **how: Any
) -> Path:
    """Write one of the models as an FMU that keeps states and makes bytes of them, as far as it claims so.

    ``head`` is a part of its description; ``able``: whether its library can; ``fault`` as of model_fmu.
    """
    state = "State" if version[0] == "3" else "state"
    claimed = "".join(f' can{claim}FMU{state}="true"' for claim in claims)
    both = f'<{{}} modelIdentifier="{IDENTIFIER}"{claimed}{{}}/>'
    step = ' canHandleVariableCommunicationStepSize="true"'
    interfaces = both.format("ModelExchange", "") + both.format("CoSimulation", step)
    able, fault = how.pop("able", True), how.pop("fault", Fault.NO_FAULT)
    token, variables = f"{model}:{int(fault)}" if fault else model, with_time(version, MODELS[model])
    text = describe(version, token, variables, indicators=int(model == "ball"), interfaces=interfaces, **how)
    library = model_library(version, keeping=able)
    return write_fmu(folder / f"{model}{version[0]}.fmu", text, library)


TELLS = (
    V("u", 0, causality="input", start="0", more={"min": "0", "max": "1"}),
    V("x", 1, causality="output", initial="exact", start="0"),
    V("copy", 16, causality="output"),
    V("der(x)", 7, derivative=1),
    V("rate", 6, causality="parameter", variability="fixed", start="1"),
    V("told", 13, causality="parameter", variability="fixed", start="1"),
)


def telling_fmu(folder: Path, *left_out: str) -> Path:
    """Write an FMU for Model Exchange with x' = rate (u - x) and copy = x.

    Of the derivatives of x' it tells ``told`` times what they are; of those of outputs that they are 0.
    """
    variables = [v for v in TELLS if v.name not in left_out]
    claim = f'<ModelExchange modelIdentifier="{IDENTIFIER}" providesDirectionalDerivative="true"/>'
    text = describe("2.0", "lag", variables, interfaces=claim)
    return write_fmu(folder / "tells.fmu", text, model_library("2.0", telling=True))


def integrator_description(version: str) -> str:
    """Return the description of the integrator whose parameters say which fault it shows and when."""
    return describe(version, "integrator", with_time(version, INTEGRATOR), interfaces=CO_SIMULATION)


def integrator_files(version: str) -> dict[str, bytes]:
    """Return the files of the FMU of that integrator."""
    return {
        "modelDescription.xml": integrator_description(version).encode(),
        library_name(version): model_library(version, complete=True),
    }


def library_name(version: str) -> str:
    """Return the path of the library in an archive."""
    return f"binaries/{platform_folder(version)}/{IDENTIFIER}{fmpy.sharedLibraryExtension}"


def write_archive(path: Path, files: Mapping[str, bytes]) -> Path:
    """Write files into an archive."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path
