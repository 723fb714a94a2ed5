"""From a plant model, or a sampled block, to an FMU file."""

import hashlib
import importlib.util
import json
import re
import uuid
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.resources import files as package_files
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any

from fmu_plants.export.compiler import Compiler, compile_library, cross_compiler, find_compiler
from fmu_plants.export.description import Contents, Description, plant_contents
from fmu_plants.export.platforms import Platform, binary_files, parse_platforms
from fmu_plants.export.sampled_block import SampledBlock
from fmu_plants.files import cached, write_atomically, zip_bytes
from fmu_plants.model import ExportError, ExportUsageError, PlantModel, identifier

FMI_VERSIONS = ("2.0", "3.0")
_RUNTIME = ("model.h", "simulation.h", "instance.h", "instance.c")
_INTEGRATION = ("dopri54.h", "dopri54.c", "integration.h", "integration.c", "interfaces.c")
_DOPRI54 = ("dopri54.h", "dopri54.c", "interfaces.c")
_EVENTS = ("integration.h", "integration.c", "tables.h", "tables.c", "resources.h", "resources.c")
_SAMPLED = ("sampled_block.h", "sampled_block.c")
_FRONT_ENDS = {"2.0": "fmi2.c", "3.0": "fmi3.c"}
_HEADERS = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
_DECLARED_FUNCTION = re.compile(r"^\s*FMI\d_Export\s+\w+\s+(\w+);", re.MULTILINE)
_MODEL_SOURCE = "model.c"
_COMPILERS_AT_ONCE = 2

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class FMUSource:
    """An FMU before compilation.

    Parameters
    ----------
    name : str
        The model identifier.
    guid : str
        Hash of everything below.
    fmi_version : str
        The standard it follows.
    descriptions : mapping of str to str
        Texts of the description files and resources by name inside the FMU.
    sources : mapping of str to str
        The C files by name.
    packed : frozenset of str
        Those that are part of the FMU.
    apart : frozenset of str
        The C files that may use the same names within a file as others.
    """

    name: str
    guid: str
    fmi_version: str
    descriptions: Mapping[str, str]
    sources: Mapping[str, str]
    packed: frozenset[str]
    apart: frozenset[str] = frozenset()


def export_fmu(
    model: PlantModel | Any,
    path: str | Path,
    fmi_version: str = "2.0",
    *,
    platforms: str | Sequence[str] | None = None,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write a plant as a standalone FMU for Co-Simulation and Model Exchange.

    One that reads tables or has a control of its own is for Co-Simulation only: it meets their events itself.

    Parameters
    ----------
    model : PlantModel or control.StateSpace
        A state-space model is named after the file; see `fmu_plants.linear.state_space_model` for more.
    path : str or Path
        The file to write; an existing one is replaced. Its folder must exist.
    fmi_version : str
        ``"2.0"`` or ``"3.0"``.
    platforms : str or sequence of str, optional
        ``"all"``, or some of linux-x86_64, linux-arm64, windows-x86_64, macos-x86_64 and macos-arm64, which
        the Python package ziglang compiles for; by default this platform only, with the compiler at hand, and
        with the sources, from which importers on other platforms can compile the library.
    relative_tolerance, absolute_tolerance : float, optional
        Defaults of the integrator, by default the model's; the absolute one is in units of the nominal value
        of each state.
    progress : callable, optional
        Is told in words how far a build for several platforms is.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ModelError
        The equations do not fit the model's variables, or the model is not a plant.
    ExportError
        There is no compiler, it fails, a platform is unknown, or the file cannot be written.

    Examples
    --------
    >>> from fmu_plants.pendulum import MODEL
    >>> export_fmu(MODEL, "pendulum.fmu", "3.0", platforms="all").name
    'pendulum.fmu'
    """
    path = Path(path)
    compilers = _compilers(platforms)
    source = fmu_source(
        _plant(model, path),
        fmi_version,
        relative_tolerance,
        absolute_tolerance,
        with_sources=platforms is None,
    )
    return _write(source, path, compilers, progress)


def export_block(
    block: SampledBlock,
    path: str | Path,
    fmi_version: str = "2.0",
    *,
    platforms: str | Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write a sampled block as a standalone FMU for Co-Simulation, with its own C code in `sources` always.

    Parameters and errors as of `export_fmu`.
    """
    compilers = _compilers(platforms)
    sources = frozenset(block.sources)
    source = _fmu_source(
        fmi_version,
        block.contents(),
        block.code(),
        {**block.sources, **_runtime(*_SAMPLED)},
        resources=block.resources,
        packed=None if platforms is None else sources,
        apart=sources,
    )
    return _write(source, Path(path), compilers, progress)


def _write(source: FMUSource, path: Path, compilers: Sequence[Compiler], progress: Progress | None) -> Path:
    content = _archive(source, compilers, progress)
    try:
        write_atomically(path, content)
    except OSError as error:
        raise ExportUsageError(f"the FMU cannot be written to {path}: {error}") from error
    return path


def build_fmu(
    model: PlantModel,
    fmi_version: str = "2.0",
    *,
    relative_tolerance: float | None = None,
    absolute_tolerance: float | None = None,
) -> Path:
    """Return the plant's FMU for this platform from the user's cache folder; compile it if it is new there.

    The cache folder is ``$DDPC_COSIM_CACHE``, or else the usual place of the operating system. Several
    processes may build at the same time; a file that was damaged is built again. Parameters and errors are
    those of `export_fmu`.
    """
    source = fmu_source(model, fmi_version, relative_tolerance, absolute_tolerance)
    compiler = find_compiler()
    key = _digest([source.guid, compiler.identity, *compiler.flags, compiler.platform.name])
    try:
        return cached(f"fmus/{key[:16]}/{model.name}.fmu", lambda: _archive(source, [compiler]))
    except OSError as error:
        raise ExportError(str(error)) from error


def fmu_source(
    model: PlantModel,
    fmi_version: str,
    relative_tolerance: float | None,
    absolute_tolerance: float | None,
    *,
    with_sources: bool = True,
) -> FMUSource:
    """Generate everything that an FMU consists of, except its binaries."""
    # Here and not above: a plant's variables can be read without the cost of SymPy's import.
    from fmu_plants.equations import resolve
    from fmu_plants.export.ccode import model_source

    given = (relative_tolerance, absolute_tolerance)
    usual = (model.relative_tolerance, model.absolute_tolerance)
    tolerances = [other if one is None else one for one, other in zip(given, usual, strict=True)]
    for name, value in zip(("relative_tolerance", "absolute_tolerance"), tolerances, strict=True):
        if not (isfinite(value) and value > 0):
            raise ExportUsageError(f"{name} must be positive and finite, not {value}")
    symbolic = resolve(model)
    contents = plant_contents(model, symbolic.dependencies(), tolerances[0])
    code = model_source(model, symbolic, *tolerances)
    packed = None if with_sources else frozenset[str]()
    return _fmu_source(
        fmi_version,
        contents,
        code,
        _with_events(fmi_version) if model.has_events else _runtime(*_INTEGRATION),
        packed=packed,
        resources=model.resource_files(),
    )


def _with_events(fmi_version: str) -> dict[str, str]:
    """Return the files of the C side of plants with events, of which some have the place of others.

    The front end is one that includes the other: it hands on where the resources are.
    """
    runtime = package_files("fmu_plants") / "runtime"
    front_end = _FRONT_ENDS[_known(fmi_version)]
    files = {name: (runtime / "events" / name).read_text(encoding="utf-8") for name in (*_EVENTS, front_end)}
    included = front_end.replace(".c", "_functions.h")
    return _runtime(*_DOPRI54) | files | {included: (runtime / front_end).read_text(encoding="utf-8")}


def _runtime(*names: str) -> dict[str, str]:
    """Return files of the C side by name, with those that every FMU has."""
    folder = package_files("fmu_plants") / "runtime"
    return {name: (folder / name).read_text(encoding="utf-8") for name in (*_RUNTIME, *names)}


def _fmu_source(
    fmi_version: str,
    contents: Contents,
    code: str,
    sources: Mapping[str, str],
    *,
    packed: frozenset[str] | None,
    resources: Mapping[str, str] = MappingProxyType({}),
    apart: frozenset[str] = frozenset(),
) -> FMUSource:
    """Put together what an FMU consists of; the code, with an empty GUID, is that of its `model.c`.

    ``packed`` are the sources that are part of it; None: all, from which importers can compile it.
    """
    front_end = _FRONT_ENDS[_known(fmi_version)]
    text = (package_files("fmu_plants") / "runtime" / front_end).read_text(encoding="utf-8")
    others = {front_end: text, **sources}
    texts = {f"resources/{name}": text for name, text in resources.items()}

    # The code of the model is the same but for the GUID in it, which its own text decides on.
    def described(guid: str) -> FMUSource:
        all_sources = {_MODEL_SOURCE: code.replace('.guid = ""', f'.guid = "{guid}"'), **others}
        listed = [name for name in all_sources if name.endswith(".c") and packed is None]
        files = Description(fmi_version, contents, guid, listed).files() | texts
        included = frozenset(all_sources) if packed is None else packed
        return FMUSource(contents.name, guid, fmi_version, files, all_sources, included, apart)

    without_guid = described(guid="")
    all_texts = {**without_guid.descriptions, **without_guid.sources}
    digest = _digest([text for item in sorted(all_texts.items()) for text in item])
    return described(guid=f"{{{uuid.UUID(digest[:32])}}}")


def _known(fmi_version: str) -> str:
    """Return a version that there is."""
    if fmi_version not in _FRONT_ENDS:
        available = ", ".join(FMI_VERSIONS)
        raise ExportUsageError(f"FMI version {fmi_version!r} cannot be exported; available: {available}")
    return fmi_version


def _plant(model: PlantModel | Any, path: Path) -> PlantModel:
    if isinstance(model, PlantModel):
        return model
    # NumPy, which it needs, is not needed for models that are equations.
    from fmu_plants.linear import state_space_model

    return state_space_model(model, identifier(path.stem))


def _compilers(platforms: str | Sequence[str] | None) -> list[Compiler]:
    """Return a compiler for each platform; those that are named get the same compiler on every machine."""
    if platforms is None:
        return [find_compiler()]
    return [cross_compiler(platform) for platform in parse_platforms(platforms)]


def _archive(source: FMUSource, compilers: Sequence[Compiler], progress: Progress | None = None) -> bytes:
    """Compile the library for every platform and return the FMU's content."""
    files = {name: text.encode() for name, text in source.descriptions.items()}
    files |= {f"sources/{name}": source.sources[name].encode() for name in source.packed}
    files |= binary_files(source.fmi_version, source.name, _compile(source, compilers, progress))
    return zip_bytes(files)


def _compile(
    source: FMUSource, compilers: Sequence[Compiler], progress: Progress | None
) -> dict[Platform, bytes]:
    """Compile two at a time; the first failure ends it."""
    headers = fmi_headers(source.fmi_version)
    all_files, functions = {**source.sources, **headers}, fmi_functions(headers)
    libraries: dict[Platform, bytes] = {}
    with ThreadPoolExecutor(_COMPILERS_AT_ONCE) as pool:
        jobs = {
            c.platform: pool.submit(compile_library, c, all_files, functions, apart=source.apart)
            for c in compilers
        }
        try:
            for count, (platform, job) in enumerate(jobs.items(), 1):
                if progress:
                    progress(f"compiling for {platform.name} ({count} of {len(jobs)})")
                libraries[platform] = job.result()
        finally:
            pool.shutdown(cancel_futures=True)
    return libraries


def fmi_headers(fmi_version: str) -> dict[str, str]:
    """Return the standard's headers by name, read where FMPy keeps them, without the cost of its import."""
    package = importlib.util.find_spec("fmpy")
    if package is None or not package.submodule_search_locations:
        raise ExportError("the FMI headers were not found: install the Python package fmpy, which has them")
    folder = Path(package.submodule_search_locations[0]) / "c-code"
    return {name: (folder / name).read_text(encoding="utf-8") for name in _HEADERS[fmi_version]}


def fmi_functions(headers: Mapping[str, str]) -> list[str]:
    """Return the names of the functions that the headers declare: a library must export all of them."""
    return [name for text in headers.values() for name in _DECLARED_FUNCTION.findall(text)]


def _digest(texts: Sequence[str]) -> str:
    """Return a hash that tells any two lists of texts apart."""
    return hashlib.sha256(json.dumps(list(texts)).encode()).hexdigest()
