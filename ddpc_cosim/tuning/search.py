"""The search for a controller's settings: where it looks, what it tries next, which trial is best."""

import math
import operator
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import fmean
from typing import Any, NamedTuple, Self

import numpy as np

from ddpc_cosim.settings import (
    Choice,
    Factor,
    Integer,
    Linear,
    Log,
    Search,
    SettingInfo,
    SettingsError,
    declared_settings,
)
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.controller_plugins import controller_class, make_controller
from ddpc_cosim.study.file_format.sections import ControllerSection
from ddpc_cosim.study.verdicts.standings import Relevant
from ddpc_cosim.tuning.objectives import Objective, Run

# From so many on, the best value that a run has had says what can be hoped for: by this part better at most.
_TRIALS_IN_FULL, _BETTER = 5, 0.1
_DIGITS = 4
# Of a space's length on its scale: as near to an end, something better may lie beyond.
_AT_END = 0.03
AS_GIVEN, FIRST, SEARCHED = "as given", "first trials", "search"
"""Where the settings of a trial come from."""


class Figures(NamedTuple):
    """What a run is judged by.

    Parameters
    ----------
    failed : bool
        Whether it failed; of a prediction, whether it is missing.
    values : tuple of float
        Of each objective, the lower the better.
    """

    failed: bool
    values: tuple[float, ...]

    @property
    def hoped(self) -> Self:
        """What can be hoped for where these are the best yet."""
        values = (value - _BETTER * abs(value) if math.isfinite(value) else value for value in self.values)
        return self._replace(values=tuple(values))


class Trial(NamedTuple):
    """Settings that were tried, and how good they are.

    Parameters
    ----------
    failed : int
        Runs that failed; of a prediction those without one.
    values : tuple of float
        Of each objective, the lower the better; of a pruned trial what it could have reached at best.
    settings : dict
        The settings that are searched.
    runs : int
        How many runs it had.
    pruned : bool
        Whether it was ended before it had all runs, as it would not have been the best.
    origin : str
        Where the settings come from, in words.
    """

    failed: int
    values: tuple[float, ...]
    settings: dict[str, Any]
    runs: int = 0
    pruned: bool = False
    origin: str = ""

    @property
    def penalised(self) -> list[float]:
        """The values such that any trial with fewer failed runs is better: below 1 where none failed."""
        return [
            self.failed + 0.5 * (1 + (value / (1 + abs(value)) if math.isfinite(value) else 1))
            for value in self.values
        ]


class SettingsSearch:
    """The search for the settings of one controller in one problem.

    Parameters
    ----------
    problem, name : str
        Which controller it is.
    given : dict
        Its settings in the study, which are tried first.
    spaces : dict
        Where to look, by setting.
    objectives : sequence of Objective
        What trials are compared by.
    first : sequence of dict
        Settings that are tried next, those that they leave out as given.
    sampler_seed : int
        Seed of what is tried then.
    """

    def __init__(
        self,
        problem: str,
        name: str,
        given: dict[str, Any],
        spaces: dict[str, Search],
        objectives: Sequence[Objective],
        first: Sequence[dict[str, Any]] = (),
        sampler_seed: int = 0,
    ) -> None:
        import optuna

        self.problem, self.name, self.given, self.spaces = problem, name, given, spaces
        self.trials: list[Trial] = []
        self._as_given = {setting: _entry(given, setting) for setting in spaces}
        self._proposed = [({}, AS_GIVEN), *((settings, FIRST) for settings in first)]
        self._objectives = objectives
        self._best_yet: dict[Run, Figures] = {}
        self._lost = Counter[Run]()
        which = [problem, name, *([str(sampler_seed)] if sampler_seed else [])]
        seed = zlib.crc32("/".join(which).encode())
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._optuna = optuna.create_study(
            sampler=optuna.samplers.TPESampler(seed=seed), directions=["minimize"] * len(objectives)
        )
        self._distributions = {setting: _distribution(space) for setting, space in spaces.items()}
        self._asked: Any = None
        self._origin = ""

    def propose(self, settings: Mapping[str, Any], origin: str) -> None:
        """Have settings tried next, others as given."""
        changed = {name: value for name, value in settings.items() if value != self.given.get(name)}
        self._proposed.append((changed, origin))

    def next_settings(self) -> dict[str, Any]:
        """Return what to try: at first what the study says."""
        if self._proposed:
            self._asked = None
            settings, self._origin = self._proposed.pop(0)
            return self._as_given | settings
        self._asked, self._origin = self._optuna.ask(self._distributions), SEARCHED
        return {
            setting: _value(space, self._asked.params[setting], _entry(self.given, setting))
            for setting, space in self.spaces.items()
        }

    def hardest_first(self, cases: Iterable[Case]) -> list[Case]:
        """Return the runs of a trial, those first in which most trials failed."""
        return sorted(cases, key=lambda case: -self._lost[Run(case.scenario, case.seed)])

    def is_hopeless(self, runs: Mapping[Run, Figures]) -> bool:
        """Whether a trial, by the runs that it has had so far, need not go on.

        More of its runs failed than of the best trial; or it would not be the best even if each run that is
        left were better, by a part, than any trial has had it. Of several objectives there is no best trial.
        """
        if not self.trials or len(self._objectives) > 1:
            return False
        foremost = self.trials[best(self.trials)]
        if sum(run.failed for run in runs.values()) > foremost.failed:
            return True
        hoped = self._hoped({}, runs)
        in_full = sum(not trial.pruned for trial in self.trials)
        return in_full >= _TRIALS_IN_FULL and hoped[:2] > foremost[:2]

    def tell(self, settings: dict[str, Any], runs: Mapping[Run, Figures], *, pruned: bool = False) -> None:
        """Take note of the runs of a trial."""
        import optuna

        hoped = self._hoped(settings, runs)
        failed = sum(run.failed for run in runs.values())
        trial = hoped._replace(failed=failed, runs=len(runs), pruned=pruned, origin=self._origin)
        if self._asked is None:
            if not pruned and (params := self._params(trial.settings)):
                trial_as_given = optuna.create_trial(
                    params=params, distributions=self._distributions, values=trial.penalised
                )
                self._optuna.add_trial(trial_as_given)
        else:
            # Reported as pruned, any trial would count as worse than every whole one, the poorest among them.
            self._optuna.tell(self._asked, self._expected(runs).penalised if pruned else trial.penalised)
        self._lost.update(run for run, figures in runs.items() if figures.failed)
        for run, figures in runs.items():
            other = self._best_yet.get(run, figures)
            self._best_yet[run] = Figures(
                min(figures.failed, other.failed), tuple(map(min, figures.values, other.values))
            )
        self.trials.append(trial)

    def _hoped(self, settings: dict[str, Any], runs: Mapping[Run, Figures]) -> Trial:
        """Return what a trial is if it does in the runs that are left as well as can be hoped."""
        every = {run: best_yet.hoped for run, best_yet in self._best_yet.items()} | {**runs}
        return trial_of(settings, every, self._objectives)

    def _expected(self, runs: Mapping[Run, Figures]) -> Trial:
        """Return what a trial is if in the runs left it is as much worse than the best as so far.

        Of these as many fail as of other trials: the first runs fail most, and say nothing about later ones.
        """
        behind = [map(_behind, figures.values, self._best_yet[run].values) for run, figures in runs.items()]
        worse = [fmean(values) for values in zip(*behind, strict=True)]
        left = {
            run: Figures(failed=False, values=tuple(map(operator.add, figures.values, worse)))
            for run, figures in self._best_yet.items()
            if run not in runs
        }
        expected = trial_of({}, {**left, **runs}, self._objectives)
        failing = sum(self._lost[run] for run in left) / max(len(self.trials), 1)
        return expected._replace(failed=expected.failed + round(failing))

    def at_ends(self, settings: Mapping[str, Any]) -> list[str]:
        """Return which settings lie at an end of where was looked, or beyond it."""
        settings_at_ends = []
        for setting, space in self.spaces.items():
            value = _param(space, settings[setting], _entry(self.given, setting))
            if isinstance(space, Choice) or value is None:
                continue
            low, high = _on_scale(space, space.low), _on_scale(space, space.high)
            margin = _AT_END * (high - low)
            if not low + margin < _on_scale(space, value) < high - margin:
                settings_at_ends.append(setting)
        return settings_at_ends

    def _params(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return settings as a point of the spaces; empty if they do not lie in them."""
        params: dict[str, Any] = {}
        for setting, space in self.spaces.items():
            value = _param(space, settings[setting], _entry(self.given, setting))
            if value is None or (not isinstance(space, Choice) and not space.low <= value <= space.high):
                return {}
            params[setting] = value
        # With other differences from the study it is another controller: the point says nothing about it.
        return params if settings.keys() <= params.keys() else {}


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
    if isinstance(space, Integer):
        return param
    if isinstance(space, Factor):
        return _times(given, param)
    return min(max(_rounded(param), space.low), space.high)


def _param(space: Search, value: Any, given: Any) -> Any:
    """Return the parameter of a value, as :func:`_value` makes it; None if it does not have one."""
    if isinstance(space, Choice):
        return list(space.values).index(value) if value in space.values else None
    if isinstance(space, Factor):
        numbers, of = np.ravel(value), np.ravel(given)
        if numbers.shape != of.shape or not of.any():
            return None
        factor = float(numbers[of != 0][0] / of[of != 0][0])
        return factor if np.allclose(numbers, of * factor, rtol=10.0**-_DIGITS) else None
    return value if isinstance(value, int | float) else None


def _behind(value: float, best: float) -> float:
    """Return by how much a value is worse than the best; without a best one yet, by nothing."""
    if not math.isfinite(value):
        return math.inf
    return value - best if math.isfinite(best) else 0.0


def _on_scale(space: Linear, value: float) -> float:
    """Return where a number is on a space's scale."""
    if isinstance(space, Log):
        return math.log(value) if value > 0 else -math.inf
    return value


def _times(value: Any, factor: float) -> Any:
    return [_times(item, factor) for item in value] if isinstance(value, list) else _rounded(value * factor)


def _rounded(value: float) -> float:
    """Return a number that a person would write: further digits decide nothing."""
    return float(f"{value:.{_DIGITS}g}")


def _entry(settings: Mapping[str, Any], name: str) -> Any:
    """Return the value of a setting by its name, which is dotted where a setting is a table."""
    value: Any = settings
    for key in name.split("."):
        value = value[key]
    return value


def with_settings(settings: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings in which others, by their dotted names, take the place of some."""
    changed = dict(settings)
    for name, value in others.items():
        key, _, rest = name.partition(".")
        changed[key] = with_settings(changed[key], {rest: value}) if rest else value
    return changed


def figures_of(
    results: Iterable[CaseResult], objectives: Sequence[Objective], spans: Mapping[str, float]
) -> dict[Run, Figures]:
    """Return what each run of a trial is judged by."""
    return {
        Run(result.scenario, result.seed): Figures(
            objectives[0].failed(result), tuple(objective.of_run(result, spans) for objective in objectives)
        )
        for result in results
    }


def trial_of(settings: dict[str, Any], runs: Mapping[Run, Figures], objectives: Sequence[Objective]) -> Trial:
    """Return the trial that has had these runs."""
    values = tuple(
        objective.of({run: figures.values[number] for run, figures in runs.items()})
        for number, objective in enumerate(objectives)
    )
    return Trial(sum(figures.failed for figures in runs.values()), values, settings, len(runs))


def best(trials: Sequence[Trial]) -> int:
    """Return the number of the best trial: the first of those from which it differs by nothing that matters.

    What gains less than that is an accident of the trials' seeds, and may cost much that no objective sees.
    """
    whole = [number for number, trial in enumerate(trials) if not trial.pruned]
    least = min((trials[number] for number in whole), key=lambda trial: (trial.failed, trial.values[0]))
    enough = least.values[0] + Relevant().difference("", least.values[0])
    return next(n for n in whole if trials[n].failed == least.failed and trials[n].values[0] <= enough)


def search_spaces(section: ControllerSection, *, by_prediction: bool) -> Iterator[tuple[str, Search]]:
    """Yield the search spaces of a controller: the study's, or else those that its class declares."""
    declared = declared_settings(controller_class(section.type))
    for name in dict.fromkeys((*declared, *section.search)):
        info, said = declared.get(name), section.search.get(name)
        if by_prediction and not (info and _predicts(info, section.settings)):
            continue
        space = said.space if said else info.search if info else None
        if space is None or (not said and _has_no_multiple(space, _entry(section.settings, name))):
            continue
        yield name, space


def _predicts(info: SettingInfo, settings: Mapping[str, Any]) -> bool:
    if isinstance(info.predicts, bool):
        return info.predicts
    return all(settings[name] == value for name, value in info.predicts.items())


def _has_no_multiple(space: Search, value: Any) -> bool:
    """Whether a value does not have multiples: it is zero, or not a number."""
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
        faults = dict[str, None]()
        for param in params:
            try:
                make_controller(
                    section.type, with_settings(section.settings, {name: _value(space, param, given)})
                )
            except SettingsError as error:
                key = name.partition(".")[0]
                faults |= dict.fromkeys(fault for place, fault in error.found if place[:1] == (key,))
        yield from (f"{name}: {fault}" for fault in faults)


def settings_faults(section: ControllerSection, settings: Mapping[str, Any]) -> Iterator[str]:
    """Yield why settings are not possible in place of some of a controller's."""
    try:
        make_controller(section.type, with_settings(section.settings, settings))
    except SettingsError as error:
        yield from error.faults


def dominates(trial: Trial, other: Trial) -> bool:
    """Whether a trial is better than another in something and worse in nothing."""
    pairs = list(zip((trial.failed, *trial.values), (other.failed, *other.values), strict=True))
    return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)
