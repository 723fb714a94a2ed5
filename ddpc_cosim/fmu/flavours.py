"""The choices that depend on an FMU's version and kind: interface, instance, run."""

from collections.abc import Sequence
from weakref import WeakValueDictionary

from ddpc_cosim.errors import ConfigError, FMUImportError
from ddpc_cosim.fmu.co_simulation import BareRun, CoSimulationRun
from ddpc_cosim.fmu.fmi1 import Fmi1Model, Fmi1Slave
from ddpc_cosim.fmu.fmi2 import Fmi2Model, Fmi2Slave
from ddpc_cosim.fmu.fmi3 import Fmi3Model, Fmi3Slave
from ddpc_cosim.fmu.instance import Instance, Model, Origin, Slave
from ddpc_cosim.fmu.model_description import FMUDescription, Interface, Signal
from ddpc_cosim.fmu.model_exchange import ModelExchangeRun
from ddpc_cosim.fmu.ports import Port
from ddpc_cosim.fmu.run import Run
from ddpc_cosim.fmu.step_size import StepSizes

_SLAVES: dict[int, type[Slave]] = {1: Fmi1Slave, 2: Fmi2Slave, 3: Fmi3Slave}
_MODELS: dict[int, type[Model]] = {1: Fmi1Model, 2: Fmi2Model, 3: Fmi3Model}
_DEFAULT_TOLERANCE = 1e-6
_TOLERANCES = (1e-12, 1e-2)

_only_ones: WeakValueDictionary[tuple[str, str], Instance] = WeakValueDictionary()
"""The instances of FMUs that allow only one in a process."""


def choose_interface(description: FMUDescription, fmi_type: str, label: str) -> Interface:
    """Return how the FMU is run.

    Raises
    ------
    ConfigError
        The type is none.
    FMUImportError
        The FMU does not have it.
    """
    kinds = ("co-simulation", "model-exchange")
    if fmi_type not in ("auto", *kinds):
        raise ConfigError(f'fmi_type = "{fmi_type}" is not possible; allowed: auto, {", ".join(kinds)}')
    for kind in kinds if fmi_type == "auto" else (fmi_type,):
        if kind in description.interfaces:
            return description.interfaces[kind]
    offered = ", ".join(description.interfaces) or "neither Co-Simulation nor Model Exchange"
    wanted = "" if fmi_type == "auto" else f"it cannot be run for {fmi_type}: "
    raise FMUImportError(f"{label}: {wanted}the FMU is for {offered} (FMI {description.fmi_version})")


def make_instance(
    origin: Origin, description: FMUDescription, interface: Interface, driven: Sequence[Signal]
) -> Instance:
    """Load and instantiate the FMU; raises whatever the loader or the FMU says."""
    key = (interface.model_identifier, description.guid)
    other = _only_ones.get(key)
    if interface.only_one_instance and other is not None and other.is_alive:
        raise RuntimeError(
            "it allows one instance per process (canBeInstantiatedOnlyOncePerProcess), and there is one; "
            "close that, or give each a process of its own (isolated=True)"
        )
    instance = _new_instance(origin, description, interface, driven)
    if interface.only_one_instance:
        _only_ones[key] = instance
    return instance


def _new_instance(
    origin: Origin, description: FMUDescription, interface: Interface, driven: Sequence[Signal]
) -> Instance:
    if interface.kind == "model-exchange":
        sizes = {"states": description.continuous_states, "event_indicators": description.event_indicators}
        return _MODELS[description.major](origin, **sizes)
    # Only inputs that are discrete need event mode; without it the FMU handles its events itself.
    discrete = any(signal.source.variability == "discrete" for signal in driven)
    event_mode = {"event_mode": interface.has_event_mode and discrete} if description.major == 3 else {}
    return _SLAVES[description.major](origin, **event_mode)


def start_run(
    instance: Instance,
    inputs: Port,
    outputs: Port,
    t0: float,
    *,
    description: FMUDescription,
    interface: Interface,
    tolerance: float | None,
    label: str,
) -> Run:
    """Return the run of an instance that has been initialised."""
    if isinstance(instance, Model):
        low, high = _TOLERANCES
        own = description.default_experiment.tolerance or _DEFAULT_TOLERANCE
        chosen = tolerance if tolerance is not None else min(max(own, low), high)
        needs_completed_step = interface.needs_completed_step or description.major == 1
        return ModelExchangeRun(
            instance, inputs, outputs, t0, tolerance=chosen, needs_completed_step=needs_completed_step
        )
    if isinstance(instance, Slave):
        steps = StepSizes(description, interface, label)
        bare = (inputs.plain, outputs.plain, instance.bare_step)
        if bare[0] is None or bare[1] is None or bare[2] is None:
            return CoSimulationRun(instance, inputs, outputs, t0, steps.change)
        return BareRun(
            instance,
            inputs,
            outputs,
            t0,
            steps.change,
            set_inputs=bare[0],
            get_outputs=bare[1],
            step=bare[2],
        )
    raise TypeError(f"{type(instance).__name__} is neither a slave nor a model")
