"""Data-driven predictive controllers for ddpc-cosim, importable on demand."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ddpc_controllers.behavioral import DataDiagnostics as DataDiagnostics
    from ddpc_controllers.behavioral import hankel_matrix as hankel_matrix
    from ddpc_controllers.behavioral import numerical_rank as numerical_rank
    from ddpc_controllers.behavioral import persistency_of_excitation as persistency_of_excitation
    from ddpc_controllers.deepc import DeePC as DeePC
    from ddpc_controllers.dictionaries import Dictionary as Dictionary
    from ddpc_controllers.dictionaries import ThinPlate as ThinPlate
    from ddpc_controllers.mfapc import MFAPC as MFAPC
    from ddpc_controllers.wkpc import WKPC as WKPC

_HOME = {
    "behavioral": ("DataDiagnostics", "hankel_matrix", "numerical_rank", "persistency_of_excitation"),
    "deepc": ("DeePC",),
    "dictionaries": ("Dictionary", "ThinPlate"),
    "mfapc": ("MFAPC",),
    "wkpc": ("WKPC",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "MFAPC",
    "WKPC",
    "DataDiagnostics",
    "DeePC",
    "Dictionary",
    "ThinPlate",
    "hankel_matrix",
    "numerical_rank",
    "persistency_of_excitation",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
