"""Co-simulate FMU plants with plug-in controllers and compare them.

The public names stand in ``__init__.pyi``; each is imported when it is first used, so that the command line
answers at once.
"""

from importlib.metadata import version

import lazy_loader

__version__ = version("ddpc-cosim")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
