"""The search for a controller's settings: where it looks, what it tries next, which trial is best."""

import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from ddpc_cosim.settings import Choice, Factor, Integer, Log, Search, SettingsError, declared_settings
from ddpc_cosim.study.controller_plugins import controller_class, make_controller
from ddpc_cosim.study.file_format.sections import ControllerSection


class Trial(NamedTuple):
    """Settings that were tried, and how good they are.

    Parameters
    ----------
    lost : int
        Runs that do not hold their reference; of a prediction those without one.
    values : tuple of float
        Of each objective, the lower the better.
    settings : dict
        The settings that are searched.
    """

    lost: int
    values: tuple[float, ...]
    settings: dict[str, Any]

    @property
    def penalised(self) -> list[float]:
        """The values such that any trial that loses fewer runs is better: below 1 where none is lost."""
        return [
            self.lost + 0.5 * (1 + (value / (1 + abs(value)) if math.isfinite(value) else 1))
            for value in self.values
        ]


class SettingsSearch:
    """The search for the settings of one controller in one problem."""

    def __init__(
        self, problem: str, name: str, given: dict[str, Any], spaces: dict[str, Search], objectives: int
    ) -> None:
        import optuna

        self.problem, self.name, self.given, self.spaces = problem, name, given, spaces
        self.trials: list[Trial] = []
        seed = zlib.crc32(f"{problem}/{name}".encode())
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._optuna = optuna.create_study(
            sampler=optuna.samplers.TPESampler(seed=seed), directions=["minimize"] * objectives
        )
        self._distributions = {setting: _distribution(space) for setting, space in spaces.items()}
        self._asked: Any = None

    def next_settings(self) -> dict[str, Any]:
        """Return what to try: at first what the study says."""
        if not self.trials:
            return {setting: _entry(self.given, setting) for setting in self.spaces}
        self._asked = self._optuna.ask(self._distributions)
        return {
            setting: _value(space, self._asked.params[setting], _entry(self.given, setting))
            for setting, space in self.spaces.items()
        }

    def tell(self, trial: Trial) -> None:
        """Take note of a trial."""
        import optuna

        if self.trials:
            self._optuna.tell(self._asked, trial.penalised)
        elif params := self._params(trial.settings):
            self._optuna.add_trial(
                optuna.create_trial(params=params, distributions=self._distributions, values=trial.penalised)
            )
        self.trials.append(trial)

    def _params(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return the study's own settings as a point of the spaces; empty if one is outside."""
        params: dict[str, Any] = {}
        for setting, space in self.spaces.items():
            value: Any = 1.0 if isinstance(space, Factor) else settings[setting]
            if isinstance(space, Choice):
                if value not in space.values:
                    return {}
                value = list(space.values).index(value)
            elif not space.low <= value <= space.high:
                return {}
            params[setting] = value
        return params


def _distribution(space: Search) -> Any:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if isinstance(space, Choice):  # by number: a value may be a table
        return CategoricalDistribution(range(len(space.values)))
    if isinstance(space, Integer):
        return IntDistribution(space.low, space.high)
    return FloatDistribution(space.low, space.high, log=isinstance(space, Log))


def _value(space: Search, param: Any, given: Any) -> Any:
    if isinstance(space, Choice):
        return space.values[param]
    return _times(given, param) if isinstance(space, Factor) else param


def _times(value: Any, factor: float) -> Any:
    return [_times(item, factor) for item in value] if isinstance(value, list) else value * factor


def _entry(settings: Mapping[str, Any], name: str) -> Any:
    """Return the value of a setting by its name, which is dotted where a setting is a table."""
    value: Any = settings
    for key in name.split("."):
        value = value[key]
    return value


def with_settings(settings: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings in which others, by their dotted names, take the place of some."""
    changed = dict(settings)
    for name, value in found.items():
        key, _, rest = name.partition(".")
        changed[key] = with_settings(changed[key], {rest: value}) if rest else value
    return changed


def best(trials: Sequence[Trial]) -> int:
    """Return the number of the best trial, the first of equals."""
    return min(range(len(trials)), key=lambda number: (trials[number].lost, trials[number].values[0]))


def search_spaces(section: ControllerSection, *, by_prediction: bool) -> Iterator[tuple[str, Search]]:
    """Yield the search spaces of a controller: the study's, or else those that its class declares."""
    declared = declared_settings(controller_class(section.type))
    for name in dict.fromkeys((*declared, *section.search)):
        info, said = declared.get(name), section.search.get(name)
        if by_prediction and not (info and info.predicts):
            continue
        space = said.space if said else info.search if info else None
        if space is None or (not said and _has_no_multiple(space, _entry(section.settings, name))):
            continue
        yield name, space


def _has_no_multiple(space: Search, value: Any) -> bool:
    """Whether multiples of a value are none: it is zero, or not a number."""
    numbers = isinstance(value, int | float) and not isinstance(value, bool) and value
    is_list = (
        isinstance(value, list) and bool(value) and any(not _has_no_multiple(space, item) for item in value)
    )
    return isinstance(space, Factor) and not numbers and not is_list


def space_faults(section: ControllerSection, spaces: Mapping[str, Search]) -> Iterator[str]:
    """Yield why settings cannot be searched so: the ends of a space have to be possible."""
    for name, space in spaces.items():
        given = _entry(section.settings, name)
        if _has_no_multiple(space, given):
            yield f"{name}: {given!r} has no multiples; needed: log or linear instead of factor, or a value"
            continue
        params = range(len(space.values)) if isinstance(space, Choice) else (space.low, space.high)
        found = dict[str, None]()
        for param in params:
            try:
                make_controller(
                    section.type, with_settings(section.settings, {name: _value(space, param, given)})
                )
            except SettingsError as error:
                own = [fault for place, fault in error.found if place and place[0] == name.partition(".")[0]]
                found |= dict.fromkeys(own)
        yield from (f"{name}: {fault}" for fault in found)


def dominates(one: Trial, other: Trial) -> bool:
    """Whether a trial is better than another in something and worse in nothing."""
    pairs = list(zip((one.lost, *one.values), (other.lost, *other.values), strict=True))
    return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)
