"""The public names and where they are defined; :mod:`lazy_loader` reads them from here too."""

from .band_edge import BandEdge as BandEdge
from .cascade import Cascade as Cascade
from .data.dictionaries import (
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
from .data.hankel import (
    DataDiagnostics as DataDiagnostics,
    hankel_matrix as hankel_matrix,
    numerical_rank as numerical_rank,
    persistency_of_excitation as persistency_of_excitation,
)
from .decentralised import Decentralised as Decentralised, Group as Group
from .deepc import DeePC as DeePC
from .export.fmu import FMUController as FMUController
from .gpc import GPC as GPC
from .idle import Idle as Idle
from .ipid import IPID as IPID
from .koopman_mpc import KoopmanMPC as KoopmanMPC
from .lqr import LQR as LQR
from .mfac import MFAC as MFAC, MFAPC as MFAPC
from .models.from_fmu import FMUModel as FMUModel, pulse_model as pulse_model
from .models.identification import Identified as Identified
from .models.linear import ModelFunction as ModelFunction, StateSpace as StateSpace
from .mpc import MPC as MPC
from .nmpc import NMPC as NMPC
from .offset_free import OffsetFree as OffsetFree
from .pid import PID as PID
from .policy import Policy as Policy, Training as Training
from .safety_filter import SafetyFilter as SafetyFilter
from .scaling import Scaled as Scaled
from .select_dpc import SelectDPC as SelectDPC
from .spc import SPC as SPC, GammaDDPC as GammaDDPC
from .spsa import SPSA as SPSA
from .wkpc import WKPC as WKPC
