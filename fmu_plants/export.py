"""From a plant model to an FMU file."""

import hashlib
import importlib.util
import json
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files as package_files
from math import isfinite
from pathlib import Path

from fmu_plants import fmi2
from fmu_plants.archive import write_atomically, zip_bytes
from fmu_plants.compiler import Compiler, cache_dir, compile_library, find_compiler, library_suffix
from fmu_plants.errors import ExportError
from fmu_plants.model import PlantModel

DEFAULT_TOLERANCE = 1e-10
_FRONT_ENDS = {"2.0": fmi2}
_CORE = ("model.h", "simulation.h", "simulation.c", "dopri54.h", "dopri54.c")
_MODEL_SOURCE = "model.c"


@dataclass(frozen=True, slots=True)
class FMUSource:
    """An FMU before compilation.

    Parameters
    ----------
    name : str
        The model identifier.
    guid : str
        Hash of everything below.
    description : str
        Text of modelDescription.xml.
    sources : mapping of str to str
        The C files by name.
    """

    name: str
    guid: str
    description: str
    sources: Mapping[str, str]


def export_fmu(
    model: PlantModel,
    path: str | Path,
    fmi_version: str = "2.0",
    *,
    relative_tolerance: float = DEFAULT_TOLERANCE,
    absolute_tolerance: float = DEFAULT_TOLERANCE,
) -> Path:
    """Write a plant as a standalone FMU for Co-Simulation on this platform.

    Parameters
    ----------
    model : PlantModel
    path : str or Path
        The file to write; an existing one is replaced. Its folder must exist.
    fmi_version : str
        ``"2.0"``.
    relative_tolerance, absolute_tolerance : float
        Defaults of the integrator; the absolute one is in units of the nominal value of each state.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ModelError
        The equations do not fit the model's variables.
    ExportError
        There is no compiler, it fails, or the file cannot be written.
    """
    source = fmu_source(model, fmi_version, relative_tolerance, absolute_tolerance)
    return _write(Path(path), source, fmi_version, find_compiler())


def build_fmu(
    model: PlantModel,
    fmi_version: str = "2.0",
    *,
    relative_tolerance: float = DEFAULT_TOLERANCE,
    absolute_tolerance: float = DEFAULT_TOLERANCE,
) -> Path:
    """Return the plant's FMU from the user's cache folder; compile it if its content is new there.

    The cache folder is ``$DDPC_COSIM_CACHE``, or else the usual place of the operating system. Several
    processes may build at the same time. Parameters and errors are those of `export_fmu`.
    """
    source = fmu_source(model, fmi_version, relative_tolerance, absolute_tolerance)
    compiler = find_compiler()
    key = _digest([source.guid, compiler.identity, *compiler.flags, fmi2.platform()])
    path = cache_dir() / "fmus" / key[:16] / f"{model.name}.fmu"
    if path.is_file():
        return path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = f"the cache folder {path.parent} cannot be made: {error}; set DDPC_COSIM_CACHE"
        raise ExportError(reason) from error
    try:
        return _write(path, source, fmi_version, compiler)
    except ExportError:
        # Another process may have been faster, and Windows does not replace a file that is being read.
        if path.is_file():
            return path
        raise


def fmu_source(
    model: PlantModel, fmi_version: str, relative_tolerance: float, absolute_tolerance: float
) -> FMUSource:
    """Generate everything that an FMU consists of, except its binary."""
    # Here and not above: a plant's variables can be read without the cost of SymPy's import.
    from fmu_plants.codegen import model_source
    from fmu_plants.symbolic import dependencies, resolve

    if fmi_version not in _FRONT_ENDS:
        available = ", ".join(_FRONT_ENDS)
        raise ExportError(f"FMI version {fmi_version!r} cannot be exported; available: {available}")
    tolerances = {"relative_tolerance": relative_tolerance, "absolute_tolerance": absolute_tolerance}
    for name, value in tolerances.items():
        if not (isfinite(value) and value > 0):
            raise ExportError(f"{name} must be positive and finite, not {value}")
    front_end = _FRONT_ENDS[fmi_version]
    symbolic = resolve(model)
    uses = dependencies(model, symbolic)
    runtime = package_files("fmu_plants") / "runtime"
    sources = {name: (runtime / name).read_text(encoding="utf-8") for name in (*_CORE, *front_end.FRONT_END)}

    def described(guid: str) -> FMUSource:
        code = model_source(model, symbolic, guid=guid, **tolerances)
        all_sources = {_MODEL_SOURCE: code, **sources}
        compiled = [name for name in all_sources if name.endswith(".c")]
        description = front_end.model_description(
            model, uses, guid=guid, relative_tolerance=relative_tolerance, sources=compiled
        )
        return FMUSource(model.name, guid, description, all_sources)

    draft = described(guid="")
    digest = _digest([draft.description, *(text for item in sorted(draft.sources.items()) for text in item)])
    return described(guid=f"{{{uuid.UUID(digest[:32])}}}")


def _write(path: Path, source: FMUSource, fmi_version: str, compiler: Compiler) -> Path:
    front_end = _FRONT_ENDS[fmi_version]
    all_files = {**source.sources, **fmi_headers(front_end.HEADERS)}
    library = compile_library(compiler, all_files, front_end.FUNCTIONS)
    files = {f"sources/{name}": text.encode() for name, text in source.sources.items()}
    files["modelDescription.xml"] = source.description.encode()
    files[f"binaries/{front_end.platform()}/{source.name}{library_suffix()}"] = library
    try:
        write_atomically(path, zip_bytes(files))
    except OSError as error:
        raise ExportError(f"the FMU cannot be written to {path}: {error}") from error
    return path


def fmi_headers(names: Sequence[str]) -> dict[str, str]:
    """Read the standard's headers where FMPy keeps them, without the cost of its import."""
    package = importlib.util.find_spec("fmpy")
    if package is None or not package.submodule_search_locations:
        raise ExportError("the FMI headers were not found: install the Python package fmpy, which has them")
    folder = Path(package.submodule_search_locations[0]) / "c-code"
    return {name: (folder / name).read_text(encoding="utf-8") for name in names}


def _digest(texts: Sequence[str]) -> str:
    """Return a hash that tells any two lists of texts apart."""
    return hashlib.sha256(json.dumps(list(texts)).encode()).hexdigest()
