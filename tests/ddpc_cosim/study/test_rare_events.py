"""Probabilities of what is rare: against formulas, and with fewer loops than counting takes."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from ddpc_controllers import PID
from ddpc_cosim import ConfigError, Constant, GaussianNoise, Normal, Problem, RareEvent, Scenario, Study
from ddpc_cosim.study.rare_events import Draws, rare_event
from ddpc_cosim.variables import FloatArray

RARE = 1e-4


def numbers_of(seeds: NDArray[np.int64]) -> FloatArray:
    """Return a standard normal number for each seed (SplitMix64)."""
    with np.errstate(over="ignore"):
        bits = seeds.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    bits ^= bits >> np.uint64(31)
    return np.asarray(ndtri((bits >> np.uint64(11)).astype(float) / 2**53 + 2.0**-54))


def noise_of(draws: Draws) -> FloatArray:
    """Return one number of the noise of each run."""
    begins = np.cumsum([0, *map(len, draws.noise)])[:-1]
    seeds, weights = zip(*[part for mixture in draws.noise for part in mixture], strict=True)
    return np.asarray(np.add.reduceat(np.array(weights) * numbers_of(np.array(seeds)), begins))


def estimated(parameters: float, noise: float, others: float, seed: int, samples: int = 500) -> RareEvent:
    """Estimate how often a sum of a parameter, noise and what else a seed draws gets that far."""

    def figures(draws: Draws) -> FloatArray:
        of_seeds = others * numbers_of(draws.seeds)
        return np.asarray(parameters * draws.parameters[:, 0] + noise * noise_of(draws) + of_seeds)

    return rare_event(figures, 1, float(-ndtri(RARE)), samples=samples, repetitions=10, seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize("weights", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.0), (0.5, 0.5, 0.5**0.5)])
def test_intervals_hold_as_often_as_they_say_with_an_eighteenth_of_the_loops(
    weights: tuple[float, float, float],
) -> None:
    """That is of parameters and noise; of what moves only by other seeds they hold, and are wider."""
    events = [estimated(*weights, seed) for seed in range(100)]
    assert sum(event.low <= RARE <= event.high for event in events) >= 90
    assert np.mean([event.probability for event in events]) == pytest.approx(RARE, rel=0.15)
    if not weights[2]:
        loops = np.mean([event.loops for event in events])
        half_width = np.median([math.log(event.high / event.low) / 2 for event in events])
        of_counting = 1.96 / math.sqrt(18 * loops * RARE)
        assert half_width <= of_counting


@pytest.mark.parametrize("weights", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
def test_a_known_probability(weights: tuple[float, float, float]) -> None:
    event = estimated(*weights, seed=1, samples=200)
    assert event.low <= RARE <= event.high
    assert len(event.repetitions) == 10
    assert event.loops < 10_000
    assert f"{event.loops} loops" in str(event)
    assert event == estimated(*weights, seed=1, samples=200)


def test_moves_leave_the_distributions_as_they_are() -> None:
    rng = np.random.default_rng(0)
    n = 4000
    mixtures = [((seed, 1.0),) for seed in rng.integers(2**31, size=n).tolist()]
    draws = Draws(rng.standard_normal((n, 2)), mixtures, rng.integers(2**31, size=n))
    moved = draws
    for share in (0.3, 1.0, 0.7):
        moved = moved.moved(share, rng)
    assert all(math.fsum(weight**2 for _, weight in own) == pytest.approx(1.0) for own in moved.noise)
    for values in (moved.parameters[:, 0], noise_of(moved), numbers_of(moved.seeds)):
        assert np.mean(values) == pytest.approx(0.0, abs=4 / math.sqrt(n))
        assert np.var(values) == pytest.approx(1.0, abs=4 * math.sqrt(2 / n))


def test_what_never_happens_has_an_upper_bound() -> None:
    event = rare_event(lambda draws: np.zeros(len(draws.seeds)), 0, 1.0, samples=100, repetitions=3, seed=0)
    assert (event.probability, event.low) == (0.0, 0.0)
    assert 0.0 < event.high < 1e-9


def test_where_nothing_leads_to_the_event_it_is_counted() -> None:
    """A figure of two values, or one that is 0 of nearly all runs, has no tenth that is nearer."""
    chance = 1 - float(ndtr(2.0))
    how = {"samples": 400, "repetitions": 10, "seed": 3}
    rare = rare_event(lambda draws: (numbers_of(draws.seeds) > 2.0).astype(float), 0, 0.5, **how)
    assert rare.low <= chance <= rare.high
    assert rare.loops == 4000
    beyond = rare_event(lambda draws: np.maximum(noise_of(draws) - 2.0, 0.0), 0, 1.0, **how)
    assert beyond.low <= 1 - float(ndtr(3.0)) <= beyond.high
    unseen = rare_event(lambda draws: (numbers_of(draws.seeds) > 3.5).astype(float), 0, 0.5, **how)
    assert 0.0 in unseen.repetitions
    assert unseen.low == 0.0 <= unseen.probability <= unseen.high


def test_what_is_certain_is() -> None:
    event = rare_event(
        lambda draws: np.full(len(draws.seeds), np.inf), 0, 1.0, samples=100, repetitions=3, seed=0
    )
    assert (event.probability, event.low, event.high, event.loops) == (1.0, 1.0, 1.0, 300)


def test_too_few_are_refused_all_at_once() -> None:
    with pytest.raises(ConfigError, match=r"samples = 50.*\n.*repetitions = 1"):
        rare_event(lambda draws: draws.parameters[:, 0], 1, 1.0, samples=50, repetitions=1, seed=0)


def drive(noise: float = 0.0, torque: float = 1.0, **spread: Normal) -> Study:
    """Return the beginning of a run of a linear plant under proportional control of a noisy output."""
    problem = Problem(
        plant="two-mass-drive",
        inputs=["motor_torque"],
        outputs=["load_speed"],
        sampling_time=0.1,
        duration=0.2,  # of the last sample no error is counted
        reference=Constant(0.0 if noise else torque),
        parameters=spread,
        scenarios={"noisy": Scenario(noise=GaussianNoise({"load_speed": noise}))} if noise else {},
    )
    return Study(problem, {"P": PID(proportional=1.0, integral=0.0)}, seeds=[0])


METRIC = "max_abs_error.load_speed"


@pytest.mark.slow
def test_a_level_that_noise_makes_a_linear_plant_cross(tmp_path: Path) -> None:
    """y_1 = -g n_0, of which the first sample of a run without noise tells g."""
    still = drive(torque=1.0).run(tmp_path, progress=False).trace("P")
    gain = abs(float(still.y[1, 0] / still.u[0, 0]))
    level = gain * 0.1 * float(-ndtri(RARE / 2))
    shown = abs(still.outputs[0].shown_in.factor)
    event = drive(noise=0.1).probability(
        METRIC, level * shown, controller="P", samples=100, repetitions=4, jobs=2
    )
    assert event.low <= RARE <= event.high
    counted = 2 * (1 - float(ndtr(level / gain / 0.1)))
    assert counted == pytest.approx(RARE)


def test_what_seeds_alone_decide_is_refused() -> None:
    with pytest.raises(ConfigError, match="give a parameter a distribution or a measurement noise"):
        drive().probability(METRIC, 1.0, controller="P")


def test_metrics_and_controllers_that_are_not_there() -> None:
    with pytest.raises(ConfigError, match='no controller "Q"'):
        drive(0.1).probability(METRIC, 1.0, controller="Q")
    with pytest.raises(ConfigError, match=r'no metric "max_abs_eror.load_speed"; did you mean'):
        drive(0.1).probability("max_abs_eror.load_speed", 1.0, controller="P")
