"""What an FMU says about itself, in the terms of the contracts."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from ddpc_cosim.description import (
    Declarations,
    DefaultExperiment,
    DescribedVariable,
    PlantDescription,
    PlantSignal,
    default_signals,
    switches_of,
)
from ddpc_cosim.errors import ConfigError, FMUImportError
from ddpc_cosim.variables import DisplayUnit

InterfaceKind = Literal["co-simulation", "model-exchange"]

INTERFACES: Mapping[InterfaceKind, str] = {"co-simulation": "CoSimulation", "model-exchange": "ModelExchange"}
"""The kinds of interfaces, the preferred one first, and what model descriptions call them."""


@dataclass(frozen=True, slots=True)
class Interface:
    """One of the ways in which an FMU can be run, and what it can do there.

    Parameters
    ----------
    kind : str
        ``"co-simulation"`` or ``"model-exchange"``.
    model_identifier : str
        Name of the library.
    variable_step : bool
        Whether the communication step size may change.
    fixed_step : float or None
        Step size of which communication steps must be multiples [s] (FMI 3.0).
    """

    kind: InterfaceKind
    model_identifier: str
    needs_execution_tool: bool = False
    only_one_instance: bool = False
    can_save_state: bool = False
    can_serialize_state: bool = False
    provides_directional_derivatives: bool = False
    variable_step: bool = True
    fixed_step: float | None = None
    has_event_mode: bool = False
    needs_completed_step: bool = True


@dataclass(frozen=True, slots=True)
class Clock:
    """A clock (FMI 3.0, section 2.2.8).

    Parameters
    ----------
    name : str
        Its name.
    reference : int
        Value reference.
    causality : str
        ``input``, ``output`` or ``local``: who lets it tick.
    variability : str
        What its interval is: ``constant``, ``fixed``, ``calculated``, ``tunable``, ``changing``,
        ``countdown`` or ``triggered``.
    interval, shift : float
        Time between two ticks, and from the start to the first one [s]; NaN and 0 where nothing is written.
    """

    name: str
    reference: int
    causality: str
    variability: str
    interval: float = math.nan
    shift: float = 0.0

    @property
    def is_periodic_input(self) -> bool:
        """Whether it ticks by what the description says, and from outside."""
        is_known = 0.0 < self.interval < math.inf and 0.0 <= self.shift < math.inf
        is_constant = self.variability in ("constant", "fixed", "tunable")  # the latter are not changed here
        return self.causality == "input" and is_constant and is_known


@dataclass(frozen=True)
class FMUDescription(Declarations):
    """The part of a model description that co-simulation needs.

    Parameters
    ----------
    guid : str
        GUID (FMI 1.0, 2.0) or instantiation token (FMI 3.0).
    variables : dict of str to DescribedVariable
        All variables by name, in the order of the description.
    interfaces : mapping of str to Interface
        What the FMU offers, by kind.
    display_units : mapping of str to tuple of DisplayUnit
        The display units that the FMU defines for each unit.
    derivatives : tuple of str
        Names of the continuous states' derivatives, in the order of the states' vector; arrays as a whole.
    direct_feedthrough : mapping of str to tuple of str or None
        The variables that each output depends on directly; None where the FMU does not say.
    source_files : mapping of str to tuple of str
        The C files to compile, by model identifier (FMI 2.0).
    clocks : tuple of Clock
        Its clocks (FMI 3.0).
    warnings : tuple of str
        What is wrong with the description but was understood.
    """

    fmi_version: str
    guid: str
    model_name: str
    variables: dict[str, DescribedVariable]
    interfaces: Mapping[str, Interface]
    generation_tool: str = "unknown"
    generated_at: str = ""
    author: str = ""
    version: str = ""
    copyright: str = ""
    license: str = ""
    text: str = ""
    continuous_states: int = 0
    event_indicators: int = 0
    derivatives: tuple[str, ...] = ()
    default_experiment: DefaultExperiment = field(default_factory=DefaultExperiment)
    display_units: Mapping[str, tuple[DisplayUnit, ...]] = field(default_factory=dict)
    dependencies: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    source_files: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    clocks: tuple[Clock, ...] = ()
    warnings: tuple[str, ...] = ()

    def ticking_clocks(self, interface: Interface) -> tuple[Clock, ...]:
        """Return the clocks that tick where the FMU is run: periodic inputs, if there are events."""
        has_events = interface.kind == "model-exchange" or interface.has_event_mode
        return tuple(clock for clock in self.clocks if clock.is_periodic_input and has_events)

    @property
    def major(self) -> int:
        """The FMI version: 1, 2 or 3."""
        return int(self.fmi_version[0])

    @property
    def preferred(self) -> Interface | None:
        """The interface that is used unless another is asked for; None if there is none."""
        return next((self.interfaces[kind] for kind in INTERFACES if kind in self.interfaces), None)

    @property
    def state_order(self) -> tuple[str, ...]:
        """Names of the continuous states in the order of their vector; empty where one has no name."""
        known = [self.variables[name].derivative_of for name in self.derivatives if name in self.variables]
        return tuple(known) if all(name in self.variables for name in known) else ()


def direct_dependencies(
    description: FMUDescription, inputs: Sequence[PlantSignal], outputs: Sequence[PlantSignal]
) -> dict[str, frozenset[str]]:
    """Return for outputs the inputs that they depend on directly: all, where the FMU does not say."""
    dependencies = {}
    for output in outputs:
        source = output.source
        known = description.dependencies.get(source.alias_of or source.name)
        on = [s for s in inputs if known is None or (s.source.alias_of or s.source.name) in known]
        dependencies[output.variable.name] = frozenset(signal.variable.name for signal in on)
    return dependencies


def is_sampled(inputs: Sequence[PlantSignal]) -> bool:
    """Return whether all inputs are discrete: those of a sampled block, such as an exported controller."""
    return bool(inputs) and all(signal.source.variability == "discrete" for signal in inputs)


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


def describe_plant(description: FMUDescription, label: str, fmi_type: str) -> PlantDescription:
    """Return the description of an FMU as a plant; errors as of :func:`choose_interface`."""
    interface = choose_interface(description, fmi_type, label)
    settable = {v.name: v.variable for v in description.variables.values() if v.is_settable and not v.shape}
    given = [*description.signals("parameter", "input")]
    inputs = {s.variable.name: s.variable for s in given if s.source.causality == "input"}
    # However it is run: this is its author's time unit.
    fixed = (offered.fixed_step for offered in description.interfaces.values() if offered.fixed_step)
    return PlantDescription(
        inputs=inputs,
        outputs={s.variable.name: s.variable for s in description.signals("output", "local")},
        parameters=settable | {s.variable.name: s.variable for s in given},
        tunable=frozenset(s.variable.name for s in given if s.source.is_tunable) | inputs.keys(),
        default_inputs=tuple(s.variable.name for s in default_signals(description, "input")),
        default_outputs=tuple(s.variable.name for s in default_signals(description, "output")),
        display_units=description.display_units,
        variables=description.variables,
        default_experiment=description.default_experiment,
        variable_step=interface.variable_step,
        fixed_step=next(fixed, None),
        warnings=description.warnings,
        switches=switches_of(description),
    )
