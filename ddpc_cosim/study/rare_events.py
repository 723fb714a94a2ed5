"""How probable it is that a figure of a run gets beyond a level, where that happens too seldom to be counted.

Subset simulation: of runs with parameters, noise and seeds as the study draws them, the tenth that comes
nearest to the level is gone on from, by moves that leave the distributions as they are, among runs that are
no farther from it; and so on, until a tenth is beyond it. Each time makes it ten times as rare. A move mixes
new parameters and new noise to those that there are; what else a seed draws, an experiment and what is random
in a controller, stays or is drawn anew.

S.-K. Au, J. L. Beck, Estimation of small failure probabilities in high dimensions by subset simulation,
Probabilistic Engineering Mechanics 16 (2001) 263-277; the moves: I. Papaioannou, W. Betz, K. Zwirglmaier,
D. Straub, MCMC algorithms for subset simulation, Probabilistic Engineering Mechanics 41 (2015) 89-103.
"""

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from ddpc_cosim.distributions import CLOSEST, Distribution
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.metrics import keys_named, metric_of
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.study.batches import Batched
from ddpc_cosim.study.case_files import CaseResult, load_case
from ddpc_cosim.study.cases import Case, Cases, leaves_nothing_behind
from ddpc_cosim.study.runner import run_batches, run_cases
from ddpc_cosim.variables import FloatArray

_KEPT = 10  # one of so many is gone on from
_MOST_LEVELS = 12
_WANTED = 0.44  # of moves that are made: Papaioannou et al., section 5
_ANOTHER_SEED = 0.3
_LARGEST_SEED = 2**31
_LEVEL = 0.95
_FEWEST_SAMPLES, _FEWEST_REPETITIONS = 100, 3


class Draws(NamedTuple):
    """What n runs draw.

    Parameters
    ----------
    parameters : array, shape (n, d)
        Standard normal numbers, a column for each parameter.
    noise : list of tuple of (int, float)
        Seeds and weights that the noise of each is mixed of, the squares of the weights summing to 1.
    seeds : array, shape (n,)
        For what else is random.
    """

    parameters: FloatArray
    noise: list[tuple[tuple[int, float], ...]]
    seeds: NDArray[np.int64]

    def chosen(self, rows: NDArray[np.intp]) -> "Draws":
        """Return the draws of some runs."""
        return Draws(self.parameters[rows], [self.noise[row] for row in rows.tolist()], self.seeds[rows])

    @staticmethod
    def joined(parts: "Sequence[Draws]") -> "Draws":
        """Return draws one after the other."""
        parameters, noise, seeds = zip(*parts, strict=True)
        every = [mixture for mixtures in noise for mixture in mixtures]
        return Draws(np.concatenate(parameters), every, np.concatenate(seeds))

    def moved(self, share: float, rng: np.random.Generator) -> "Draws":
        """Return other draws from the same distributions, which have a share of what is new."""
        n, kept = len(self.seeds), math.sqrt(1.0 - share**2)
        mixed = [
            (*((seed, kept * weight) for seed, weight in mixture), (new, share))
            for mixture, new in zip(self.noise, rng.integers(_LARGEST_SEED, size=n).tolist(), strict=True)
        ]
        others = rng.integers(_LARGEST_SEED, size=n)
        return Draws(
            kept * self.parameters + share * rng.standard_normal(self.parameters.shape),
            mixed,
            np.where(rng.random(n) < _ANOTHER_SEED, others, self.seeds),
        )

    def replaced(self, others: "Draws", where: NDArray[np.bool_]) -> "Draws":
        """Return these, some of which others take the place of."""
        noise = zip(where.tolist(), others.noise, self.noise, strict=True)
        return Draws(
            np.where(where[:, np.newaxis], others.parameters, self.parameters),
            [other if is_other else mixture for is_other, other, mixture in noise],
            np.where(where, others.seeds, self.seeds),
        )


Figures = Callable[[Draws], FloatArray]
"""How near to the event runs are, shape (n,)."""


class RareEvent(NamedTuple):
    """How probable an event is.

    Parameters
    ----------
    probability : float
        Mean of the repetitions.
    low, high : float
        Its 95 % interval, from how much they differ.
    loops : int
        How many loops were run.
    repetitions : tuple of float
        What each of them says.
    """

    probability: float
    low: float
    high: float
    loops: int
    repetitions: tuple[float, ...]

    def __str__(self) -> str:
        interval = f"95 % interval {self.low:.2g} to {self.high:.2g}"
        return f"{self.probability:.2g} ({interval}), from {self.loops} loops"


def rare_event(
    figures: Figures,
    dimension: int,
    level: float,
    *,
    samples: int,
    repetitions: int,
    seed: int,
    tell: Callable[[str], object] = lambda _: None,
) -> RareEvent:
    """Estimate the probability that a figure is at a level or above, by repeated subset simulation.

    Parameters
    ----------
    figures : callable
        The figures, shape (n,), of n runs; infinite where the event is certain.
    dimension : int
        How many parameters there are.
    level : float
        The level.
    samples, repetitions : int
        Runs of a subset, and how often it is done.
    seed : int
        Of what is drawn.
    tell : callable, optional
        Is told how far it is.

    Raises
    ------
    ConfigError
        Too few samples or repetitions.
    """
    least = {"samples": (samples, _FEWEST_SAMPLES), "repetitions": (repetitions, _FEWEST_REPETITIONS)}
    if faults := [f"{name} = {n!r}: needed: at least {low}" for name, (n, low) in least.items() if n < low]:
        raise ConfigError(faults)
    streams = np.random.default_rng(seed).spawn(repetitions)
    running = {i: _repetition(dimension, level, samples, rng) for i, rng in enumerate(streams)}
    asked = {i: next(repetition) for i, repetition in running.items()}
    estimates, loops = dict[int, float](), 0
    while running:  # all of them at a time, so that workers have enough to do
        order = [*running]
        tell(f"{loops} loops run, {len(order)} of {repetitions} repetitions going on")
        of_all = figures(Draws.joined([asked[i] for i in order]))
        loops += len(of_all)
        ends = np.cumsum([len(asked[i].seeds) for i in order])
        for i, of_repetition in zip(order, np.split(of_all, ends[:-1]), strict=True):
            try:
                asked[i] = running[i].send(of_repetition)
            except StopIteration as stop:
                estimates[i] = stop.value
                del running[i]
    return _summary([estimates[i] for i in range(repetitions)], loops)


def _summary(estimates: Sequence[float], loops: int) -> RareEvent:
    """Return mean and interval of estimates, whose distribution is skewed: about log-normal.

    The interval is Cox's with Student's t: U. Olsson, Confidence intervals for the mean of a log-normal
    distribution, Journal of Statistics Education 13 (2005). With an estimate of 0, that of the mean.
    """
    values, n = np.array(estimates), len(estimates)
    mean, t = float(np.mean(values)), float(stdtrit(n - 1, (1 + _LEVEL) / 2))
    if mean == 0.0:
        low, high = 0.0, float(_KEPT) ** -_MOST_LEVELS
    elif values.min() == 0.0:
        low, high = 0.0, mean + t * float(np.std(values, ddof=1)) / math.sqrt(n)
    else:
        logs = np.log(values)
        variance = float(np.var(logs, ddof=1))
        centre = float(np.mean(logs)) + variance / 2
        half = t * math.sqrt(variance / n + variance**2 / (2 * (n - 1)))
        low, high = math.exp(centre - half), math.exp(centre + half)
    return RareEvent(mean, min(low, mean), min(max(high, mean), 1.0), loops, tuple(estimates))


def _repetition(
    dimension: int, level: float, samples: int, rng: np.random.Generator
) -> Generator[Draws, FloatArray, float]:
    """Yield what is to be run, are sent the figures, and return an estimate."""
    first = rng.integers(_LARGEST_SEED, size=(2, samples))
    parameters = rng.standard_normal((samples, dimension))
    draws = Draws(parameters, [((seed, 1.0),) for seed in first[0].tolist()], first[1])
    figures = yield draws
    probability, share = 1.0, 1.0
    for _ in range(_MOST_LEVELS):
        kept = samples // _KEPT
        reached = float(np.partition(figures, -kept)[-kept])
        if reached >= level:
            break
        if (
            np.count_nonzero(figures >= reached) > 2 * kept
        ):  # many are equal: only what is beyond them is nearer
            nearer = figures[figures > reached]
            if not nearer.size:
                break
            reached = float(nearer.min())
            if reached >= level:
                break
        members = np.flatnonzero(figures >= reached)
        probability *= len(members) / samples
        # Of equal ones any, so that those are not preferred that happen to be beyond the level.
        begin = rng.choice(members, kept, replace=len(members) < kept)
        chains = [(draws.chosen(begin), figures[begin])]
        for _ in range(_KEPT - 1):
            here, its_figures = chains[-1]
            moved = here.moved(share, rng)
            others = yield moved
            is_made = others >= reached
            chains.append((here.replaced(moved, is_made), np.where(is_made, others, its_figures)))
            share = min(share * math.exp(float(np.mean(is_made)) - _WANTED), 1.0)
        draws = Draws.joined([part for part, _ in chains])
        figures = np.concatenate([part for _, part in chains])
    return probability * float(np.mean(figures >= level))


@dataclass
class FiguresOfCases:
    """The figures of runs of one case with other parameters and seeds; each is run in a worker.

    Parameters
    ----------
    case : Case
        The case.
    distributions : dict of str to Distribution
        What its seed draws, by parameter.
    metric : str
        The metric, its unit may be left out.
    jobs : int
        Number of workers.
    """

    case: Case
    distributions: dict[str, Distribution]
    metric: str
    jobs: int

    def __call__(self, draws: Draws) -> FloatArray:
        """Return figures that are the larger the worse; of a run that does not complete infinity."""
        shares = np.clip(ndtr(draws.parameters), CLOSEST, 1.0 - CLOSEST)
        drawn = {
            name: distribution.quantile(shares[:, i]).tolist()
            for i, (name, distribution) in enumerate(self.distributions.items())
        }
        cases = [
            replace(
                self.case,
                seed=seed,
                parameters=self.case.parameters | {name: values[i] for name, values in drawn.items()},
                noise_mixture=mixture if self.case.noise else (),
                id=f"run-{i}",
            )
            for i, (seed, mixture) in enumerate(zip(draws.seeds.tolist(), draws.noise, strict=True))
        ]
        figures = {case.id: self._figure(result) for case, result in self._results(cases)}
        return np.array([figures[case.id] for case in cases])

    def _results(self, cases: list[Case]) -> Iterator[tuple[Case, CaseResult]]:
        """Yield cases and their results as they come, so that an unknown metric is told by the first."""
        alone = cases
        with ScratchFolder() as folder:
            if leaves_nothing_behind(self.case) and not self.case.sandbox:
                alone = []
                yield from run_batches(Cases.of(cases), Batched(folder), self.jobs, alone)
            for case in run_cases(alone, folder, self.jobs):
                yield case, load_case(folder / case.id)

    def _figure(self, result: CaseResult) -> float:
        if result.outcome is not Outcome.COMPLETED:
            return math.inf
        key = keys_named(self.metric, result.metrics)[0]
        value = result.metrics[key] * (-1.0 if metric_of(key).better == "high" else 1.0)
        return -math.inf if math.isnan(value) else value
