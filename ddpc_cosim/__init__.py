"""Co-simulate FMU plants with plug-in controllers and compare them.

The public names stand in ``__init__.pyi``; each is imported when it is first used, so that the command line
answers at once.
"""

from typing import Any

import lazy_loader

_named, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Return what a public name stands for, or the version, which takes longer to look up than the rest."""
    if name != "__version__":
        return _named(name)
    from importlib.metadata import version

    return version("ddpc-cosim")
