"""Building the library of an FMU that comes as C sources only."""

import hashlib
import importlib.resources
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu.archive import XMLTree, read_xml
from ddpc_cosim.fmu.description import FMUDescription
from ddpc_cosim.processes.rows import content_of
from ddpc_cosim.processes.sandbox import Sandbox, entered, is_demanded, missing, require
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.processes.worker import LostWorkerError, UnexpectedError, Worker, serve_calls

if TYPE_CHECKING:
    from fmu_plants.export.compiler import Compiler

# FMI's headers put a prefix before every function for static linking; a library must not have it.
_DEFINITIONS = (
    "-DDISABLE_PREFIX",
    "-DFMI2_OVERRIDE_FUNCTION_PREFIX",
    "-DFMI3_OVERRIDE_FUNCTION_PREFIX",
)
BUILD_DESCRIPTION = "sources/buildDescription.xml"
_CPP = (".cpp", ".cc", ".cxx")
_HEADERS = (".h", ".hpp", ".hh", ".hxx")
_OUTPUT_SHOWN = 1500
_LONGEST_SECONDS, _LARGEST_FILE = 600.0, 1 << 30  # of a compilation in a sandbox
_INCLUSION = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*"([\x21-\x7e]+\.c)"', re.MULTILINE)


@dataclass(frozen=True, slots=True)
class SourceSet:
    """Sources that are compiled in the same way, relative to the sources folder.

    Parameters
    ----------
    files : tuple of str
        The files to compile.
    model_identifier : str or None
        The library that they are for; None for any.
    definitions : tuple of str
        Options of the compiler that define macros.
    include_folders : tuple of str
        Folders of headers.
    """

    files: tuple[str, ...]
    model_identifier: str | None = None
    definitions: tuple[str, ...] = ()
    include_folders: tuple[str, ...] = ()


def has_sources(folder: Path) -> bool:
    """Whether an unpacked FMU has C sources."""
    return any((folder / "sources").glob("**/*.c*"))


def is_source(sources: Path, name: str) -> bool:
    """Whether a described source is there; a name that is too long for a file is not."""
    try:
        return (sources / name).is_file()
    except OSError:
        return False


def described_sources(folder: Path, description: FMUDescription, label: str) -> list[SourceSet]:
    """Return what is to be compiled according to the model description or, in FMI 3.0, the build description.

    Raises
    ------
    FMUImportError
        The build description is not XML, or may do harm.
    """
    path = folder / BUILD_DESCRIPTION
    if description.major < 3 or not path.is_file():
        return [SourceSet(files, name) for name, files in description.source_files.items()]
    root = read_xml(path, f"{label}: {BUILD_DESCRIPTION}", XMLTree).root
    return [
        SourceSet(
            files=tuple(file.get("name", "") for file in element.iterfind("SourceFile")),
            model_identifier=configuration.get("modelIdentifier"),
            definitions=tuple(
                "-D" + "=".join(filter(None, (definition.get("name"), definition.get("value"))))
                for definition in element.iterfind("PreprocessorDefinition")
            ),
            include_folders=tuple(d.get("name", "") for d in element.iterfind("IncludeDirectory")),
        )
        for configuration in root.iterfind("BuildConfiguration")
        for element in configuration.iterfind("SourceFileSet")
    ]


def compile_sources(
    folder: Path,
    description: FMUDescription,
    model_identifier: str,
    target: Path,
    label: str,
    tell: Callable[[str], object],
    *,
    only_looking: bool = False,
) -> Path:
    """Build the library of an unpacked FMU from its sources; return the folder of the cache that keeps it.

    What has been built before from the same sources by the same compiler is taken from the cache; in a
    sandbox, what was built in one. Where one is demanded, the compiler runs in it, as sources can include any
    file that it may read.

    Parameters
    ----------
    folder : Path
        The unpacked FMU.
    description : FMUDescription
        What it says about itself.
    model_identifier : str
        Name of the library.
    target : Path
        The library to write.
    label : str
        The FMU's file name, for errors.
    tell : callable
        Called with a line before it is compiled, which may take a while.
    only_looking : bool
        Whether it is not going to be run yet: then what was not compiled before is compiled in a sandbox, if
        the system has one.

    Raises
    ------
    FMUImportError
        There is no compiler, it fails, or the description of the sources is wrong.
    """
    from fmu_plants import ExportError
    from fmu_plants.export.compiler import find_compiler
    from fmu_plants.files import cached, is_cached

    sources = folder / "sources"
    described = described_sources(folder, description, label)
    sets = _source_sets(
        sources, [s for s in described if s.model_identifier in (model_identifier, None)], label
    )
    try:
        compiler = find_compiler()
    except ExportError as error:
        raise FMUImportError(f"{label}: the FMU comes as C sources, and {error}") from error
    target.parent.mkdir(parents=True, exist_ok=True)

    apart = is_demanded() and not entered()

    def place(where: str) -> str:
        return f"libraries/{_digest(sources, sets, compiler.identity + where)}/{target.name}"

    def make() -> bytes:
        tell(f"compiling the C sources of {label}")
        return (_built_in_sandbox if apart else _built)(compiler, sources, sets, target.name)

    try:
        if only_looking and not entered() and not missing():
            apart = apart or not is_cached(place(""))
        library = cached(place(" in a sandbox" if apart or entered() else ""), make)
        target.write_bytes(library.read_bytes())
    except ExportError as error:
        what = f"no binary for this platform, and {compiler.command[0]} cannot compile its C sources"
        raise FMUImportError(f"{label}: {what}: {str(error)[:_OUTPUT_SHOWN]}") from error
    except OSError as error:
        raise FMUImportError(f"{label}: its C sources are compiled, and {error}") from error
    return library.parent


def _source_sets(sources: Path, sets: list[SourceSet], label: str) -> list[SourceSet]:
    """Return the files to compile: those described, else all C files in the sources folder."""
    if not any(source_set.files for source_set in sets):
        sets = [SourceSet(_compiled_by_themselves(sources))]
    for source_set in sets:
        for name in (*source_set.files, *source_set.include_folders):
            if not (sources / name).resolve().is_relative_to(sources.resolve()):
                raise FMUImportError(f"{label}: the source {name!r} is outside the FMU")
        for name in source_set.files:
            if not is_source(sources, name):
                raise FMUImportError(
                    f"{label}: no binary for this platform, and the source {name[:100]} is missing"
                )
    return [_without_headers(source_set) for source_set in sets]


def _without_headers(source_set: SourceSet) -> SourceSet:
    """Return sources without the headers that some tools list among them: they are included, not compiled."""
    headers = [name for name in source_set.files if name.lower().endswith(_HEADERS)]
    folders = dict.fromkeys(name.rpartition("/")[0] or "." for name in headers)
    return replace(
        source_set,
        files=tuple(name for name in source_set.files if name not in headers),
        include_folders=(*source_set.include_folders, *folders),
    )


def _compiled_by_themselves(sources: Path) -> tuple[str, ...]:
    """Return the C files that none of the others includes, as templates of FMUs are."""
    files = sorted(sources.glob("*.c"))
    included = {name.decode() for path in files for name in _INCLUSION.findall(path.read_bytes())}
    return tuple(path.name for path in files if path.name not in included)


def _built(compiler: "Compiler", sources: Path, sets: Sequence[SourceSet], name: str) -> bytes:
    """Return the library."""
    with tempfile.TemporaryDirectory(prefix="ddpc-cosim-") as scratch:
        built = Path(scratch) / name
        _build(compiler, sources, sets, built)
        return built.read_bytes()


def _built_in_sandbox(compiler: "Compiler", sources: Path, sets: Sequence[SourceSet], name: str) -> bytes:
    """Return the library, built by a process that reads the sources and what is installed, and no more."""
    from fmu_plants import ExportError

    require()
    with ScratchFolder() as folder:
        read = (sources, *_places(Path(compiler.command[0])))
        worker = Worker(serve_calls, folder=folder, sandbox=Sandbox((folder,), read))
        try:
            target = folder / name
            fault = worker.call(_build_alone, compiler, sources, sets, target, seconds=_LONGEST_SECONDS)
        except UnexpectedError as error:
            raise ExportError(str(error)) from error
        except LostWorkerError as error:
            reason = str(error)
            if error.exit_status is None:
                reason = f"it did not end within {_LONGEST_SECONDS:g} s and was ended"
            elif error.exit_status.excess:
                reason = f"{error.exit_status.excess}, so it was ended"
            raise ExportError(reason) from error
        finally:
            worker.end()
        if fault:
            raise ExportError(str(fault))
        library = content_of(target, _LARGEST_FILE)
        if not library:
            raise ExportError("it wrote no library")
        return library


def _places(program: Path) -> Iterator[Path]:
    """Yield where a compiler has its own files, which for the system's are read anyway."""
    yield program
    temporary = Path(tempfile.gettempdir()).resolve()
    folders = {program.parent.resolve(), program.resolve().parent}
    # Of ~/.local/bin, all that programs keep of the user's would be around it.
    folders |= {f.parent for f in folders if f.name == "bin" and not f.parent.name.startswith(".")}
    yield from (folder for folder in folders if not temporary.is_relative_to(folder))


def _build_alone(compiler: "Compiler", sources: Path, sets: Sequence[SourceSet], built: Path) -> str:
    """Build a library in a sandbox (Linux); return what is wrong."""
    import resource

    from fmu_plants import ExportError

    resource.setrlimit(resource.RLIMIT_FSIZE, (_LARGEST_FILE, _LARGEST_FILE))  # one line can ask for any size
    # Caches of compilers: what is in those of the user is executed elsewhere.
    caches = dict.fromkeys(("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"), str(built.parent / "zig"))
    os.environ.update(caches | {"CCACHE_DISABLE": "1"})
    try:
        _build(compiler, sources, sets, built)
    except ExportError as error:
        return str(error)
    return ""


def _build(compiler: "Compiler", sources: Path, sets: Sequence[SourceSet], built: Path) -> None:
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
    # Without it, a function of the same name elsewhere in this process would replace the FMU's.
    own_symbols = ("-Wl,-Bsymbolic",) if sys.platform.startswith("linux") else ()
    link = ["-shared", *own_symbols, "-o", str(built), *objects, *compiler.libraries, *standard_library]
    compiler.run(link, built.parent)


def _digest(sources: Path, sets: Sequence[SourceSet], compiler: str) -> str:
    digest = hashlib.sha256()
    for part in _parts(sources, sets, compiler):
        digest.update(len(part).to_bytes(8, "big") + part)
    return digest.hexdigest()[:16]


def _parts(sources: Path, sets: Sequence[SourceSet], compiler: str) -> Iterator[bytes]:
    yield compiler.encode()
    yield repr(sets).encode()
    for path in sorted(p for p in sources.rglob("*") if p.is_file()):
        yield path.relative_to(sources).as_posix().encode()
        yield path.read_bytes()
