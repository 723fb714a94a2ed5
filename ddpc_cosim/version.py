"""The version of the code that produced a result."""

import hashlib
import importlib.metadata
import sys
from functools import cache
from pathlib import Path

from ddpc_cosim.plugins import load_plugin


def package_version() -> str:
    """Return the installed version of ddpc-cosim."""
    return importlib.metadata.version("ddpc-cosim")


@cache
def code_version(controller: str) -> str:
    """Return a hash of the source of the master and of the package that a controller comes from."""
    return source_hash(__name__) + source_hash(load_plugin("controllers", controller).__module__)


@cache
def source_hash(module_name: str) -> str:
    """Return a hash of the source of the top-level package that an imported module belongs to."""
    module = sys.modules[module_name.split(".")[0]]
    digest = hashlib.sha256()
    # A namespace package has folders and no file of its own.
    for folder in map(Path, getattr(module, "__path__", ())):
        for file in sorted(folder.rglob("*.py")):
            digest.update(file.relative_to(folder).as_posix().encode())
            digest.update(file.read_bytes())
    if not hasattr(module, "__path__") and module.__file__:
        digest.update(Path(module.__file__).read_bytes())
    return digest.hexdigest()
