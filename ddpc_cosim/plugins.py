"""Finding plug-ins: by entry point, for built-ins and third parties alike, or as ``module:attribute``."""

import ast
import hashlib
import importlib
import importlib.metadata
import importlib.util
import inspect
import pickle
import re
import sys
import sysconfig
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.abc import MetaPathFinder
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec, PathFinder
from importlib.metadata import Distribution, EntryPoint, entry_points
from pathlib import Path
from types import CodeType, FunctionType, ModuleType, NoneType
from typing import Any

from ddpc_cosim.errors import PluginError
from fmu_plants.files import cached as cached, write_atomically as write_atomically  # for plug-ins
from fmu_plants.spelling import did_you_mean as did_you_mean

KINDS = ("plants", "controllers", "studies", "metrics", "conditions", "reports")


@dataclass(frozen=True, slots=True)
class Plugin:
    """An installed plug-in.

    Parameters
    ----------
    name : str
        Name of the entry point.
    target : str
        ``module:attribute``.
    package : str
        Distribution that installed it, with its version.
    value : object
        What the entry point loads; None if it is broken.
    error : str
        Why it cannot be loaded; empty if it can.
    """

    name: str
    target: str
    package: str
    value: Any = None
    error: str = ""


def installed(kind: str) -> list[Plugin]:
    """Load all plug-ins of a kind (one of ``KINDS``), by name; a broken one carries its error."""
    entries = _entry_points(kind)
    plugins = [_load_entry_point(entry) for entry in sorted(entries, key=lambda entry: entry.name)]
    names = [plugin.name for plugin in plugins]
    return [
        plugin
        if plugin.error or names.count(plugin.name) == 1
        else replace(plugin, value=None, error=f"another package has a {plugin.name} too; uninstall one")
        for plugin in plugins
    ]


def describe(plugin: Plugin) -> tuple[str, bool]:
    """Return one line about a plug-in, or why it is broken; and whether it works."""
    try:
        return (f"broken: {plugin.error}", False) if plugin.error else (_describe(plugin.value), True)
    except Exception as error:  # a third party's object can be anything
        return f"broken: {type(error).__name__}: {error}", False


def _describe(value: Any) -> str:
    """Return a description, the first line of the documentation, or the title of a study file."""
    if isinstance(value, type | FunctionType):
        return (inspect.getdoc(value) or "").partition("\n")[0]
    if description := getattr(value, "description", ""):
        return str(description)
    return str(tomllib.loads(Path(value).read_text(encoding="utf-8-sig")).get("title", ""))


def plugin_names(kind: str) -> list[str]:
    """Return the names of the installed plug-ins of a kind, without loading them."""
    return sorted({entry.name for entry in _entry_points(kind)})


def load_plugin(kind: str, name: str) -> Any:
    """Load a plug-in of a kind by name, or anything as ``module:attribute`` or ``file.py:attribute``.

    Raises
    ------
    PluginError
        There is no such plug-in, or it cannot be loaded, and why.
    """
    singular = {"studies": "study"}.get(kind, kind.removesuffix("s"))
    if ":" in name:
        return load_target(name, singular)
    if name.endswith(".py"):
        what = "model" if kind == "plants" else "class"
        raise PluginError(f'"{name}": name the {what} in the file, for example {name}:{what.upper()}')
    matches = [entry for entry in _entry_points(kind) if entry.name == name]
    if not matches:
        raise PluginError(f'no {singular} "{name}"; {did_you_mean(name, plugin_names(kind))}')
    if len(matches) > 1:
        origins = " and ".join(f"{_package(entry)} ({entry.value})" for entry in matches)
        raise PluginError(
            f'there are several {kind} called "{name}": of {origins}; '
            f"write {matches[0].value} for the first, or uninstall one"
        )
    plugin = _load_entry_point(matches[0])
    if plugin.error:
        raise PluginError(
            f'{singular} "{name}" ({plugin.target}, {plugin.package}) cannot be loaded: {plugin.error}'
        )
    return plugin.value


def _entry_points(kind: str) -> tuple[EntryPoint, ...]:
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    return _entry_points_of(kind, tuple(sys.path))


@cache
def _entry_points_of(kind: str, path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    # An editable installation next to a wheel lists an entry point twice.
    entries = _every_entry_point(path).select(group=f"ddpc_cosim.{kind}")
    return tuple({(entry.name, entry.value): entry for entry in entries}.values())


def origin(kind: str, name: str) -> str:
    """Return a plug-in's package, its version and a hash of its code; or why it is not here.

    A controller's hash covers the code of the master too.
    """
    packages = "".join(f"{_package(entry)}, " for entry in _entry_points(kind) if entry.name == name)
    try:
        value = load_plugin(kind, name)
        code = code_version(name) if kind == "controllers" else hash_of_code(name, value)
    except (PluginError, AttributeError) as error:
        return f"missing ({error})"
    return f"{packages}code {hashlib.sha256(code.encode()).hexdigest()[:10]}"


def package_of(kind: str, name: str) -> str:
    """Return the package that installed a plug-in, with its version; empty where there is none or several."""
    packages = {_package(entry) for entry in _entry_points(kind) if entry.name == name}
    return packages.pop() if len(packages) == 1 else ""


def is_own(kind: str, name: str) -> bool:
    """Whether a plug-in, or what is named as ``module:attribute``, is of this project and not anyone's."""
    package = f"ddpc-cosim {package_version()}"
    entries = [entry for entry in _entry_points(kind) if _package(entry) == package]
    if ":" not in name:
        return any(entry.name == name for entry in entries)
    packages = {_top_module(entry.value) for entry in entries}
    return not is_in_file(name) and name not in _by_value and _top_module(name) in packages


def look_up() -> None:
    """Find what is installed, which takes a while: the workers that are forked from here know it then."""
    for kind in KINDS:
        for entry in _entry_points(kind):
            _package(entry)


@cache
def _every_entry_point(path: tuple[str, ...]) -> Any:
    """Return what is installed on an import path; its class depends on the version of Python."""
    return entry_points()


def _package(entry: EntryPoint) -> str:
    return _name_and_version(entry.dist) if entry.dist else "unknown package"


@cache  # its metadata are parsed for it, and a study may name 1000 controllers
def _name_and_version(package: Distribution) -> str:
    return f"{package.name} {package.version}"


def _load_entry_point(entry: EntryPoint) -> Plugin:
    package = _package(entry)
    try:
        return Plugin(entry.name, entry.value, package, entry.load())
    except (Exception, SystemExit) as error:  # a third party's import can fail in any way
        return Plugin(entry.name, entry.value, package, error=f"{type(error).__name__}: {error}")


_own_folder: Path | None = None


def find_modules_in(folder: str | Path) -> None:
    """Let ``module:attribute`` name modules of a folder: that of a study, or where a command was typed."""
    global _own_folder
    _own_folder = Path(folder).resolve()


def own_folder() -> str:
    """Return the folder whose modules ``module:attribute`` may name besides those that are installed."""
    return str(_own_folder or Path.cwd())


FOLDER_VARIABLE = "DDPC_COSIM_STUDY_FOLDER"
"""The environment variable of workers that names that folder."""


def study_folder() -> Path:
    """Return the folder of the study that is read or run, for plug-ins that open files beside it.

    Where a study is not in a file, it is the current folder of whoever runs it. The case itself runs in a
    temporary folder of its own. An FMU finds it as the environment variable ``DDPC_COSIM_STUDY_FOLDER``.
    """
    return Path(own_folder())


class _OwnModules(MetaPathFinder):
    """Finds modules of that folder, which is not in the import path: its metadata would install plug-ins.

    And those beside files that were loaded by their path.
    """

    def __init__(self) -> None:
        self.beside: dict[str, None] = {}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how to load a top-level module that is not installed."""
        return PathFinder.find_spec(fullname, [own_folder(), *self.beside]) if path is None else None


_OWN_MODULES = _OwnModules()


def load_target(target: str, kind: str) -> Any:
    """Load anything as ``module:attribute`` or ``file.py:attribute``; ``kind`` is what the error calls it.

    A module that is not installed is looked for in the study's folder, see :func:`find_modules_in`; from then
    on what it imports is found there too, after everything that is installed. The path of a file is relative
    to that folder, and what the file imports is found beside it.

    Raises
    ------
    PluginError
        It cannot be loaded, and why.
    """
    if target in _by_value:
        return _by_value[target]
    if is_in_file(target):
        return _load_from_file(target, kind)
    module_name, _, attribute = target.partition(":")
    top = module_name.partition(".")[0]
    try:
        # Only now: other packages try whether there are modules that they could do without.
        if _OWN_MODULES not in sys.meta_path and top not in sys.modules and not importlib.util.find_spec(top):
            sys.meta_path.append(_OWN_MODULES)
        value: Any = importlib.import_module(module_name)
        for part in attribute.split("."):
            value = getattr(value, part)
    except (Exception, SystemExit) as error:  # a third party's import can fail in any way
        reason = f"{type(error).__name__}: {error}{_hint(error, top)}"
        raise PluginError(f'{kind} "{target}" cannot be loaded: {reason}') from error
    return value


def is_in_file(target: str) -> bool:
    """Whether a name is ``file.py:attribute``, and not one of a module or of an entry point."""
    return target.rpartition(":")[0].endswith(".py")


def name_in_file(target: str, place: Callable[[str], object]) -> str:
    """Return a name with its file elsewhere, at ``place(path)``; one that is not in a file as it is."""
    file, _, attribute = target.rpartition(":")
    return f"{place(file)}:{attribute}" if is_in_file(target) else target


def shown_name(target: str) -> str:
    """Return a name for people, and for what must be the same wherever its file stands: without folders."""
    return name_in_file(target, lambda file: Path(file).name)


def _path_of(target: str) -> Path:
    """Return the path of the file of ``file.py:attribute``."""
    return Path(own_folder(), target.rpartition(":")[0]).resolve()


def _module_of_file(path: Path, content: bytes) -> str:
    """Return the name of a file's module: the same on every machine, unless two files have one content."""
    name = f"{re.sub(r'[^0-9A-Za-z_]', '_', path.stem)}_{hashlib.sha256(content).hexdigest()[:16]}"
    other = getattr(sys.modules.get(name), "__file__", None) or path
    return name if Path(other) == path else f"{name}_{hashlib.sha256(str(path).encode()).hexdigest()[:16]}"


def _load_from_file(target: str, kind: str) -> Any:
    """Load ``file.py:attribute``; errors as of :func:`load_target`."""
    path, (file, _, attribute) = _path_of(target), target.rpartition(":")
    try:
        content = path.read_bytes()
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise PluginError(f'"{file}": {reason}') from error
    name = _module_of_file(path, content)
    try:
        value: Any = sys.modules.get(name) or _run_file(name, path, content)
    except (Exception, SystemExit) as error:  # a user's file can fail in any way
        raise PluginError(f'{kind} "{target}" cannot be loaded: {type(error).__name__}: {error}') from error
    for part in attribute.split("."):
        if not hasattr(value, part):
            names = ", ".join(name for name in vars(value) if not name.startswith("_"))
            raise PluginError(f'"{file}" has no "{attribute}"; it has: {names or "nothing"}')
        value = getattr(value, part)
    return value


def _run_file(name: str, path: Path, content: bytes) -> ModuleType:
    """Make a module of a file. Python's cache of byte code would take two texts of one second for one."""
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None:
        raise ImportError("it is not a Python file")
    if _OWN_MODULES not in sys.meta_path:
        sys.meta_path.append(_OWN_MODULES)
    _OWN_MODULES.beside[str(path.parent)] = None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        exec(compile(content, path, "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _hint(error: BaseException, top: str) -> str:
    """Return why a module was not found, or not the one that was meant."""
    if isinstance(error, ModuleNotFoundError) and error.name == top:
        return f"; it is not installed, and not in {own_folder()}"
    beside, loaded = Path(own_folder(), f"{top}.py"), getattr(sys.modules.get(top), "__file__", None)
    if isinstance(error, AttributeError) and beside.is_file() and loaded and not beside.samefile(loaded):
        return f"; {loaded} is installed and comes first: give {beside} another name"
    return ""


_by_value: dict[str, Any] = {}
"""What another process cannot import, by ``module:attribute``: classes of a notebook or a script, models."""


def name_of(kind: str, value: Any, attribute: str = "") -> str:
    """Return the name by which a study speaks of a class, or of an object that plug-ins of a kind can be.

    It is that of its entry point, else ``module:attribute``. What no other process can import under that name
    (a class of a notebook, a script or a function, an object) is kept, for :func:`load_plugin` here and, sent
    by :func:`values_of` and :func:`keep_values`, in a worker.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    value : object
        The class or object.
    attribute : str
        What an object that has no name of its own is called.
    """
    target = f"{getattr(value, '__module__', '__main__')}:{getattr(value, '__qualname__', attribute)}"
    for entry in _entry_points(kind):
        module, _, name = entry.value.partition(":")
        if module in sys.modules and getattr(sys.modules[module], name, None) is value:
            return entry.name
    if not _is_importable(target, value):
        _by_value[target] = value
        code_version.cache_clear()
    return target


def _is_importable(target: str, value: Any) -> bool:
    """Whether another process finds an object under its name."""
    module_name, _, attribute = target.partition(":")
    reached: Any = sys.modules.get(module_name)
    if module_name == "__main__" or getattr(reached, "__spec__", None) is None:
        return False
    for part in attribute.split("."):
        reached = getattr(reached, part, None)
    return reached is value


def values_of(targets: Iterable[str]) -> dict[str, Any]:
    """Return those of some names that another process cannot import, for :func:`keep_values` there."""
    return {target: _by_value[target] for target in targets if target in _by_value}


def keep_values(values: Mapping[str, Any]) -> None:
    """Have names stand for what another process has sent."""
    _by_value.update(values)


def own_files(targets: Iterable[str]) -> dict[str, Path]:
    """Return the files of the study's folder that names (``module:attribute``) consist of, by path in it."""
    modules = {_top_module(target) for target in targets if ":" in target}
    files = [file for name in modules & sys.modules.keys() for _, file in _source_files(sys.modules[name])]
    folder = Path(own_folder())
    return {f.relative_to(folder).as_posix(): f for f in files if f.is_relative_to(folder)}


def _top_module(target: str) -> str:
    """Return the top-level module that a name is of; empty for a file that is not there."""
    if not is_in_file(target):
        return target.partition(":")[0].partition(".")[0]
    path = _path_of(target)
    return _module_of_file(path, path.read_bytes()) if path.is_file() else ""


def names_in(folder: str, targets: Iterable[str]) -> dict[str, str]:
    """Return names of files below a folder, by name, with paths relative to it."""
    paths = {target: _path_of(target) for target in targets if is_in_file(target)}
    return {
        target: name_in_file(target, lambda _: path.relative_to(folder).as_posix())  # noqa: B023 - at once
        for target, path in paths.items()
        if path.is_relative_to(folder)
    }


def folders_of(targets: Iterable[str]) -> list[str]:
    """Return the folders that names read code from: that of the study, and those of files."""
    named = [target for target in targets if ":" in target]
    files = [str(_path_of(target).parent) for target in named if is_in_file(target)]
    return list(dict.fromkeys(([own_folder()] if named else []) + files))


_CODE = (".py", *EXTENSION_SUFFIXES)


@cache
def package_version() -> str:
    """Return the installed version of ddpc-cosim."""
    return importlib.metadata.version("ddpc-cosim")


@cache
def code_version(controller: str) -> str:
    """Return a hash of the source of the master and of the package that a controller comes from.

    It can be any class that a setting names; an unknown name has no code.
    """
    try:
        return source_hash(__name__) + hash_of_code(controller, load_plugin("controllers", controller))
    except (PluginError, AttributeError):
        return ""


def hash_of_code(target: str, value: Any) -> str:
    """Return a hash of the source that a class consists of: its package's, or its own where it has none."""
    if target in _by_value:
        return hashlib.sha256("\n".join(_own_source(value)).encode()).hexdigest()
    return source_hash(value.__module__)


_DATA = (bool, int, float, complex, str, bytes, tuple, list, dict, set, NoneType)


def _own_source(value: Any) -> list[str]:
    """Return the source of a class and of what it uses of its own module.

    Data are told by their values. Where there is no source, as of a class that was made without a file, its
    code stands in for it.
    """
    parts, waiting, seen = list[str](), [value], {id(value)}
    while waiting:
        entry = waiting.pop()
        if not isinstance(entry, type | FunctionType):
            parts.append(_content_of(entry))
            if type(entry).__module__ != value.__module__:
                continue
            entry = type(entry)
        try:
            source = textwrap.dedent(inspect.getsource(entry))
            used = {node.id for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name)}
        except (OSError, TypeError, SyntaxError):
            source, used = _code_of(entry), set[str]()
        parts.append(source)
        around = vars(sys.modules[entry.__module__]) if entry.__module__ in sys.modules else {}
        for name in sorted(used & around.keys()):
            other = around[name]
            is_code = isinstance(other, type | FunctionType)
            is_own = other.__module__ == entry.__module__ if is_code else not isinstance(other, ModuleType)
            if id(other) not in seen and is_own:
                seen.add(id(other))
                waiting.append(other)
    return parts


def _content_of(value: Any) -> str:
    """Return what an object holds, the same in every process; of one that cannot be written its class."""
    if isinstance(value, set | frozenset):
        return repr(sorted(map(repr, value)))
    try:
        return pickle.dumps(value, protocol=4).hex()
    except Exception:  # what a third party's object can be
        return type(value).__qualname__


def _code_of(value: Any) -> str:
    """Return what a class or function without source does: byte code, constants, names, plain values."""
    if isinstance(value, type):
        return "".join(name + _code_of(entry) for name, entry in sorted(vars(value).items()))
    if isinstance(value, FunctionType):
        return _code_of(value.__code__) + repr(value.__defaults__)
    if isinstance(value, CodeType):
        return repr((value.co_code, value.co_names)) + "".join(map(_code_of, value.co_consts))
    return repr(value) if isinstance(value, _DATA) else type(value).__name__


def types_in(section: Any) -> Iterator[str]:
    """Yield every type that a controller's section names, its own and those of objects in its settings."""
    if isinstance(section, dict):
        if isinstance(section.get("type"), str):
            yield section["type"]
        for entry in section.values():
            yield from types_in(entry)
    elif isinstance(section, list | tuple):
        for entry in section:
            yield from types_in(entry)


@cache
def source_hash(module_name: str) -> str:
    """Return a hash of the source of the top-level package that an imported module belongs to.

    To a module that is a file of its own, outside of what is installed, belong the modules in the same folder
    that it imports.
    """
    module = sys.modules[module_name.split(".")[0]]
    digest = hashlib.sha256()
    for name, file in _source_files(module):
        digest.update(name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _source_files(module: ModuleType) -> Iterator[tuple[str, Path]]:
    """Yield names, the same wherever the package is installed, and paths of all files of code."""
    # A namespace package has folders and no file of its own.
    for folder in map(Path, getattr(module, "__path__", ())):
        yield from _package_files(folder)
    if not hasattr(module, "__path__") and module.__file__:
        yield from _module_files(Path(module.__file__))


def _package_files(folder: Path) -> Iterator[tuple[str, Path]]:
    for file in sorted(folder.rglob("*")):
        if file.name.endswith(_CODE) and file.is_file():
            yield file.relative_to(folder).as_posix(), file


def _module_files(file: Path) -> Iterator[tuple[str, Path]]:
    """Yield a module's file and what it imports from its own folder."""
    waiting, seen = [file], {file}
    while waiting:
        file = waiting.pop()
        yield file.name, file
        for name in [] if _is_installed(file) else sorted(_imported_names(file)):
            beside, package = file.with_name(f"{name}.py"), file.with_name(name)
            if beside.is_file() and beside not in seen:
                waiting.append(beside)
                seen.add(beside)
            elif (package / "__init__.py").is_file() and package not in seen:
                seen.add(package)
                yield from _package_files(package)


def _is_installed(file: Path) -> bool:
    paths = sysconfig.get_paths()
    return any(file.is_relative_to(paths[key]) for key in ("stdlib", "purelib", "platlib"))


def _imported_names(file: Path) -> set[str]:
    """Return the top-level modules that a file imports; none if it is not Python source."""
    try:
        nodes = list(ast.walk(ast.parse(file.read_bytes())))
    except (SyntaxError, ValueError):
        return set()
    imported = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    imported += [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    return {name.split(".")[0] for name in imported}
