"""The version of the code that produced a result."""

import ast
import hashlib
import importlib.metadata
import sys
import sysconfig
from collections.abc import Iterator
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import ModuleType
from typing import Any

from ddpc_cosim.errors import PluginError
from ddpc_cosim.plugins import load_plugin

_CODE = (".py", *EXTENSION_SUFFIXES)


def package_version() -> str:
    """Return the installed version of ddpc-cosim."""
    return importlib.metadata.version("ddpc-cosim")


@cache
def code_version(controller: str) -> str:
    """Return a hash of the source of the master and of the package that a controller comes from.

    It can be any class that a setting names; with a name of nothing comes no code.
    """
    try:
        module = load_plugin("controllers", controller).__module__
    except (PluginError, AttributeError):
        return ""
    return source_hash(__name__) + source_hash(module)


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

    To a module that is a file of its own, outside of what is installed, belong the modules beside it that it
    imports.
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
    """Return the top-level modules that a file imports; none if it is no Python source."""
    try:
        nodes = list(ast.walk(ast.parse(file.read_bytes())))
    except (SyntaxError, ValueError):
        return set()
    imported = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    imported += [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    return {name.split(".")[0] for name in imported}
