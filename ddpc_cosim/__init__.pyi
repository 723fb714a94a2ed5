"""The public names and where they are defined; :mod:`lazy_loader` reads them from here too."""

from .conditions import Conditions as Conditions
from .conditions.condition import Condition as Condition, ConditionSetup as ConditionSetup
from .controller import (
    OK as OK,
    Action as Action,
    Bounds as Bounds,
    Charge as Charge,
    Controller as Controller,
    ControllerCode as ControllerCode,
    Footprint as Footprint,
    Loop as Loop,
    Recording as Recording,
    Sample as Sample,
    further_arguments as further_arguments,
)
from .coupling.plant import CoupledPlant as CoupledPlant
from .coupling.wiring import Connection as Connection
from .distributions import (
    Distribution as Distribution,
    LogNormal as LogNormal,
    Normal as Normal,
    Triangular as Triangular,
    Uniform as Uniform,
)
from .errors import (
    ConfigError as ConfigError,
    ControllerError as ControllerError,
    CosimError as CosimError,
    CosimWarning as CosimWarning,
    DataError as DataError,
    DivergenceError as DivergenceError,
    FMUImportError as FMUImportError,
    FMUStepError as FMUStepError,
    MissingLibraryError as MissingLibraryError,
    PluginError as PluginError,
    StepStatus as StepStatus,
)
from .exporting import export_controller as export_controller
from .fmu.linearisation import LinearModel as LinearModel
from .fmu.plant import FMUPlant as FMUPlant
from .identification.identification import Identification as Identification
from .identification.plant import IdentifiedPlant as IdentifiedPlant
from .inspection.logs import LogSummary as LogSummary
from .loop.master import cosimulate as cosimulate, record as record
from .loop.plant_control import PlantControl as PlantControl
from .loop.plotting import Picture as Picture
from .loop.rollouts import rollout as rollout
from .loop.trace import Outcome as Outcome, Trace as Trace
from .metrics import Metric as Metric, MetricSettings as MetricSettings
from .monomials import Monomials as Monomials
from .observation import Observation as Observation, further_signals as further_signals
from .plant import ParameterValue as ParameterValue, Plant as Plant
from .plugins import study_folder as study_folder
from .replaying import Difference as Difference, Replay as Replay, replay as replay
from .settings import (
    SIGNAL as SIGNAL,
    Choice as Choice,
    Factor as Factor,
    Integer as Integer,
    Linear as Linear,
    Log as Log,
    SettingInfo as SettingInfo,
    Weight as Weight,
    check_settings as check_settings,
    declared_settings as declared_settings,
    setting as setting,
    weight_matrix as weight_matrix,
)
from .signals.disturbances import ForecastFile as ForecastFile, KnownDisturbance as KnownDisturbance
from .signals.excitations import (
    PRBS as PRBS,
    Chirp as Chirp,
    Excitation as Excitation,
    MixedExcitation as MixedExcitation,
    Multisine as Multisine,
    SignalExcitation as SignalExcitation,
    UniformRandom as UniformRandom,
)
from .signals.prices import Price as Price
from .signals.signals import (
    Band as Band,
    Constant as Constant,
    Drift as Drift,
    GaussianNoise as GaussianNoise,
    Interpolated as Interpolated,
    ParameterChange as ParameterChange,
    Product as Product,
    Ramp as Ramp,
    RandomLevels as RandomLevels,
    RecordedSignal as RecordedSignal,
    Reference as Reference,
    Signal as Signal,
    SignalFromFile as SignalFromFile,
    SignalFromResource as SignalFromResource,
    Sine as Sine,
    Steps as Steps,
    Sum as Sum,
    TabulatedSignal as TabulatedSignal,
    WhiteNoise as WhiteNoise,
)
from .simulation import Simulation as Simulation, simulate as simulate
from .study.case_files import CaseResult as CaseResult
from .study.objects import Entry as Entry, Problem as Problem, Scenario as Scenario, Study as Study
from .study.rare_events import RareEvent as RareEvent
from .study.report_sections import (
    ReportBlock as ReportBlock,
    ReportSection as ReportSection,
    ReportTable as ReportTable,
)
from .study.results import StudyResults as StudyResults, load_results as load_results
from .variables import DisplayUnit as DisplayUnit, FloatArray as FloatArray, Variable as Variable
from .windows import (
    RANK_TOLERANCE as RANK_TOLERANCE,
    count_windows as count_windows,
    hankel_matrix as hankel_matrix,
    judge_prediction as judge_prediction,
    numerical_rank as numerical_rank,
    persistency_of_excitation as persistency_of_excitation,
    window_starts as window_starts,
)
