"""Building the library of an FMU that comes as C sources only."""

import hashlib
import importlib.resources
import os
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fmpy.model_description

from ddpc_cosim.errors import FMUImportError

if TYPE_CHECKING:
    from fmu_plants.export.compiler import Compiler

# FMI's headers put a prefix before every function for static linking; a library must not have it.
_DEFINITIONS = (
    "-DDISABLE_PREFIX",
    "-DFMI2_OVERRIDE_FUNCTION_PREFIX",
    "-DFMI3_OVERRIDE_FUNCTION_PREFIX",
)
_CPP = (".cpp", ".cc", ".cxx")
_OUTPUT_SHOWN = 1500
_INCLUSION = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*"([\x21-\x7e]+\.c)"', re.MULTILINE)


@dataclass(frozen=True, slots=True)
class _SourceSet:
    """Sources that are compiled in the same way, relative to the sources folder."""

    files: tuple[str, ...]
    definitions: tuple[str, ...] = ()
    include_folders: tuple[str, ...] = ()


def has_sources(folder: Path) -> bool:
    """Whether an unpacked FMU has C sources."""
    return any((folder / "sources").glob("**/*.c*"))


def compile_sources(folder: Path, model_identifier: str, target: Path, label: str) -> None:
    """Build the library of an unpacked FMU from its sources.

    What has been built before from the same sources by the same compiler is taken from the cache.

    Parameters
    ----------
    folder : Path
        The unpacked FMU.
    model_identifier : str
        Name of the library.
    target : Path
        The library to write.
    label : str
        The FMU's file name, for errors.

    Raises
    ------
    FMUImportError
        There is no compiler, it fails, or the description of the sources is wrong.
    """
    from fmu_plants import ExportError
    from fmu_plants.export.compiler import find_compiler
    from fmu_plants.files import cache_dir, write_to_cache

    sources = folder / "sources"
    sets = _source_sets(folder, model_identifier, label)
    try:
        compiler = find_compiler()
    except ExportError as error:
        raise FMUImportError(f"{label}: the FMU comes as C sources, and {error}") from error
    cached = cache_dir() / "libraries" / _digest(sources, sets, compiler.identity) / target.name
    target.parent.mkdir(parents=True, exist_ok=True)
    if not cached.is_file():
        with tempfile.TemporaryDirectory(prefix="ddpc-cosim-") as scratch:
            built = Path(scratch) / target.name
            try:
                _build(compiler, sources, sets, built)
            except ExportError as error:
                what = f"no binary for this platform, and {compiler.command[0]} cannot compile its C sources"
                raise FMUImportError(f"{label}: {what}: {str(error)[:_OUTPUT_SHOWN]}") from error
            write_to_cache(cached, built.read_bytes())
    target.write_bytes(cached.read_bytes())


def _source_sets(folder: Path, model_identifier: str, label: str) -> list[_SourceSet]:
    """Return what is to be compiled: what the description says, else all C files in the sources folder."""
    configurations = fmpy.model_description.read_model_description(
        str(folder), validate=False
    ).buildConfigurations
    sets = [
        _SourceSet(
            files=tuple(source_set.sourceFiles),
            definitions=tuple(map(_definition, source_set.preprocessorDefinitions)),
            include_folders=tuple(source_set.includeDirectories),
        )
        for configuration in configurations
        if configuration.modelIdentifier in (model_identifier, None)
        for source_set in configuration.sourceFileSets
    ]
    sources = folder / "sources"
    if not any(source_set.files for source_set in sets):
        sets = [_SourceSet(_compiled_by_themselves(sources))]
    for source_set in sets:
        for name in (*source_set.files, *source_set.include_folders):
            if not (sources / name).resolve().is_relative_to(sources.resolve()):
                raise FMUImportError(f"{label}: the source {name!r} is outside the FMU")
        for name in source_set.files:
            if not (sources / name).is_file():
                raise FMUImportError(
                    f"{label}: no binary for this platform, and the source {name} is missing"
                )
    return sets


def _compiled_by_themselves(sources: Path) -> tuple[str, ...]:
    """Return the C files that none of the others includes, as templates of FMUs are."""
    files = sorted(sources.glob("*.c"))
    included = {name.decode() for path in files for name in _INCLUSION.findall(path.read_bytes())}
    return tuple(path.name for path in files if path.name not in included)


def _definition(definition: Any) -> str:
    value = definition.value
    return f"-D{definition.name}" + (f"={value}" if value else "")


def _build(compiler: "Compiler", sources: Path, sets: Sequence[_SourceSet], built: Path) -> None:
    headers = importlib.resources.files("fmpy") / "c-code"
    position = () if os.name == "nt" else ("-fPIC",)
    objects: list[str] = []
    for i, source_set in enumerate(sets):
        folder = built.parent / str(i)
        folder.mkdir()
        includes = [f"-I{sources / name}" for name in (".", *source_set.include_folders)]
        flags = ["-c", "-O2", "-w", *position, *_DEFINITIONS, *source_set.definitions]
        files = [str(sources / name) for name in source_set.files]
        compiler.run([*flags, *includes, f"-I{headers}", *files], folder)
        objects += map(str, sorted(folder.iterdir()))
    is_cpp = any(name.endswith(_CPP) for source_set in sets for name in source_set.files)
    standard_library = ("-lstdc++",) if is_cpp else ()
    # Without it, a function of the FMU would give way to one of the same name anywhere in this process.
    own_symbols = ("-Wl,-Bsymbolic",) if sys.platform.startswith("linux") else ()
    link = ["-shared", *own_symbols, "-o", str(built), *objects, *compiler.libraries, *standard_library]
    compiler.run(link, built.parent)


def _digest(sources: Path, sets: Sequence[_SourceSet], compiler: str) -> str:
    digest = hashlib.sha256()
    for part in _parts(sources, sets, compiler):
        digest.update(len(part).to_bytes(8, "big") + part)
    return digest.hexdigest()[:16]


def _parts(sources: Path, sets: Sequence[_SourceSet], compiler: str) -> Iterator[bytes]:
    yield compiler.encode()
    yield repr(sets).encode()
    for path in sorted(p for p in sources.rglob("*") if p.is_file()):
        yield path.relative_to(sources).as_posix().encode()
        yield path.read_bytes()
