"""Data-driven predictive controllers for ddpc-cosim, importable on demand."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ddpc_controllers.cascade import Cascade as Cascade
    from ddpc_controllers.data.dictionaries import (
        Combined as Combined,
        Constant as Constant,
        Delays as Delays,
        Dictionary as Dictionary,
        Gaussian as Gaussian,
        Identity as Identity,
        OwnFunction as OwnFunction,
        Polynomials as Polynomials,
        ThinPlate as ThinPlate,
    )
    from ddpc_controllers.data.hankel import (
        DataDiagnostics as DataDiagnostics,
        hankel_matrix as hankel_matrix,
        numerical_rank as numerical_rank,
        persistency_of_excitation as persistency_of_excitation,
    )
    from ddpc_controllers.decentralised import Decentralised as Decentralised, Group as Group
    from ddpc_controllers.deepc import DeePC as DeePC
    from ddpc_controllers.ipid import IPID as IPID
    from ddpc_controllers.koopman_mpc import KoopmanMPC as KoopmanMPC
    from ddpc_controllers.lqr import LQR as LQR
    from ddpc_controllers.mfac import MFAC as MFAC, MFAPC as MFAPC
    from ddpc_controllers.models.from_fmu import FMUModel as FMUModel, pulse_model as pulse_model
    from ddpc_controllers.models.identification import Identified as Identified
    from ddpc_controllers.models.linear import ModelFunction as ModelFunction, StateSpace as StateSpace
    from ddpc_controllers.mpc import MPC as MPC
    from ddpc_controllers.offset_free import OffsetFree as OffsetFree
    from ddpc_controllers.pid import PID as PID
    from ddpc_controllers.scaling import Scaled as Scaled
    from ddpc_controllers.spc import SPC as SPC, GammaDDPC as GammaDDPC
    from ddpc_controllers.spsa import SPSA as SPSA
    from ddpc_controllers.wkpc import WKPC as WKPC

_HOME = {
    "cascade": ("Cascade",),
    "data.dictionaries": (
        "Combined",
        "Constant",
        "Delays",
        "Dictionary",
        "Gaussian",
        "Identity",
        "OwnFunction",
        "Polynomials",
        "ThinPlate",
    ),
    "data.hankel": ("DataDiagnostics", "hankel_matrix", "numerical_rank", "persistency_of_excitation"),
    "decentralised": ("Decentralised", "Group"),
    "deepc": ("DeePC",),
    "ipid": ("IPID",),
    "koopman_mpc": ("KoopmanMPC",),
    "lqr": ("LQR",),
    "mfac": ("MFAC", "MFAPC"),
    "models.from_fmu": ("FMUModel", "pulse_model"),
    "models.identification": ("Identified",),
    "models.linear": ("ModelFunction", "StateSpace"),
    "mpc": ("MPC",),
    "offset_free": ("OffsetFree",),
    "pid": ("PID",),
    "scaling": ("Scaled",),
    "spc": ("SPC", "GammaDDPC"),
    "spsa": ("SPSA",),
    "wkpc": ("WKPC",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "IPID",
    "LQR",
    "MFAC",
    "MFAPC",
    "MPC",
    "PID",
    "SPC",
    "SPSA",
    "WKPC",
    "Cascade",
    "Combined",
    "Constant",
    "DataDiagnostics",
    "Decentralised",
    "DeePC",
    "Delays",
    "Dictionary",
    "FMUModel",
    "GammaDDPC",
    "Gaussian",
    "Group",
    "Identified",
    "Identity",
    "KoopmanMPC",
    "ModelFunction",
    "OffsetFree",
    "OwnFunction",
    "Polynomials",
    "Scaled",
    "StateSpace",
    "ThinPlate",
    "hankel_matrix",
    "numerical_rank",
    "persistency_of_excitation",
    "pulse_model",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
