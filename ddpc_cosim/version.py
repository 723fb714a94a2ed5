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
    plugin = load_plugin("controllers", controller)
    own, foreign = (sys.modules[name.split(".")[0]] for name in (__name__, plugin.__module__))
    digest = hashlib.sha256()
    for module in (own, foreign):
        source = Path(module.__file__ or "")
        files = sorted(source.parent.rglob("*.py")) if source.name == "__init__.py" else [source]
        for file in files:
            digest.update(file.relative_to(source.parent).as_posix().encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()
