"""What controllers that hold other controllers share."""

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import ClassVar

from ddpc_controllers.checks import check_settings_and
from ddpc_controllers.export.code import Exportable
from ddpc_controllers.optimisation.qp import StepInfo
from ddpc_cosim import OK, Action, Controller, FloatArray, Loop, Sample, setting


class Inner:
    """A running copy of a controller that another one holds; what it reports carries its name.

    A copy, because the setting stays as it was given, and may be given twice.

    Parameters
    ----------
    controller : Controller
        The controller as it was given.
    name : str
        Stands in front of its statuses, and of the names of its values; empty: it reports as if alone.

    Attributes
    ----------
    controller : Controller
        The copy.
    """

    def __init__(self, controller: Controller, name: str = "") -> None:
        self.controller = deepcopy(controller)
        self._name = name

    def start(self, loop: Loop) -> None:
        """Start the copy on its part of a loop, of whose future it asks for as much as its horizon.

        Raises
        ------
        CosimError
            What it says itself.
        """
        preview = min(loop.preview, self.controller.horizon)
        self.controller.start(replace(loop, preview=preview))

    def step(self, sample: Sample) -> Action:
        """Return its action."""
        answer = self.controller.step(sample)
        action = answer if isinstance(answer, Action) else Action(answer)
        if not self._name:
            return action
        status = f"{self._name}: {action.status}" if is_fallback(action) else action.status
        return Action(action.u, status, StepInfo(self._named, (action.info,)))

    def diagnostics(self) -> dict[str, float]:
        """Return its diagnostics of data or model."""
        return self._named(self.controller.diagnostics())

    def warnings(self) -> list[str]:
        """Return its warnings about data or model."""
        return [f"{self._name}: {text}" if self._name else text for text in self.controller.warnings()]

    def _named(self, values: Mapping[str, float]) -> dict[str, float]:
        prefix = f"{self._name}." if self._name else ""
        return {prefix + name: value for name, value in values.items()}


def is_fallback(action: Action) -> bool:
    """Whether an action's inputs differ from those that its controller wanted."""
    return action.status != OK


def joined(u: FloatArray, actions: Iterable[Action]) -> Action:
    """Return inputs with the statuses and the values of several actions."""
    actions = list(actions)
    fallbacks = [action.status for action in actions if is_fallback(action)]
    info = StepInfo(_merged, tuple(action.info for action in actions))
    return Action(u, "; ".join(fallbacks) or OK, info)


def _merged(*infos: Mapping[str, float]) -> dict[str, float]:
    return {name: value for info in infos for name, value in info.items()}


def joined_prior_info(parts: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the facts that all controllers state, with their names where these differ."""
    common = {}
    for fact in sorted(set.intersection(*(set(facts) for facts in parts.values()))):
        words = {name: facts[fact] for name, facts in parts.items()}
        named = " and ".join(f"{text} ({name})" for name, text in words.items())
        common[fact] = named if len(set(words.values())) > 1 else next(iter(words.values()))
    return common


def controller_faults(who: str, **given: object) -> list[str]:
    """Return which settings do not hold a controller, though they should."""
    return [
        f"{who}: {name} = {value!r} is not a controller; an example is PID()"
        for name, value in given.items()
        if not isinstance(value, Controller)
    ]


class Wrapper(Exportable):
    """Base of the controllers that hold others: what one of these needs, they need."""

    _follows_in_c: ClassVar[bool] = True

    _running: Sequence[Inner]
    """The copies that run, set by ``start``."""

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)

    @property
    @abstractmethod
    def _held(self) -> Sequence[Controller]:
        """The controllers among the settings."""

    @property
    def uses_recording(self) -> bool:
        """Whether one of the controllers needs a recording."""
        return any(controller.uses_recording for controller in self._held)

    @property
    def past_length(self) -> int:
        """How many samples of a running plant the controllers need, the one that needs most."""
        return max(controller.past_length for controller in self._held)

    @property
    def accepts_missing(self) -> bool:
        """Whether all of the controllers go on when a measurement is missing."""
        return all(controller.accepts_missing for controller in self._held)

    def diagnostics(self) -> Mapping[str, float]:
        """Return the diagnostics of all controllers."""
        return {name: value for inner in self._running for name, value in inner.diagnostics().items()}

    def warnings(self) -> Sequence[str]:
        """Return the warnings of all controllers."""
        return [text for inner in self._running for text in inner.warnings()]

    @abstractmethod
    def _faults_between_settings(self) -> list[str]:
        """Return what is wrong with settings that are possible each by itself."""


@dataclass(kw_only=True)
class SingleWrapper(Wrapper):
    """Base of the controllers that change what another one sees."""

    controller: Controller = setting(doc="the controller inside")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.horizon = self.controller.horizon

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return what the controller needs."""
        return self.controller.recording_length(inputs, outputs, measurements, disturbances)

    @property
    def _held(self) -> Sequence[Controller]:
        return (self.controller,)

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        return self._inner.controller.knowledge(loop)

    def _start_inside(self, loop: Loop) -> None:
        """Start a copy of the controller."""
        self._inner = Inner(self.controller)
        self._running = (self._inner,)
        self._inner.start(loop)

    def _faults_between_settings(self) -> list[str]:
        return controller_faults(type(self).__name__, controller=self.controller)
