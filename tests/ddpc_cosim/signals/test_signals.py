"""References, excitations and noise against the formulas that define them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from ddpc_cosim import (
    ConfigError,
    Constant,
    Excitation,
    FloatArray,
    GaussianNoise,
    Interpolated,
    ParameterChange,
    Product,
    Ramp,
    RandomLevels,
    Sine,
    Steps,
    Sum,
    UniformRandom,
    Variable,
    WhiteNoise,
)

DATA = Path(__file__).parents[2] / "data"


def test_constant() -> None:
    assert np.array_equal(Constant(2.5).at(np.array([0.0, 1.0])), [2.5, 2.5])


def test_steps_take_each_value_from_its_instant_on() -> None:
    steps = Steps([1.0, 2.0], [10.0, 20.0])
    assert np.array_equal(steps.at(np.array([0.0, 1.0, 1.9, 2.0, 99.0])), [10.0, 10.0, 10.0, 20.0, 20.0])


@given(st.integers(1, 4000), st.sampled_from([0.1, 0.3, 0.7, 1e-3]), st.floats(0, 1e4))
@example(k=3, h=1e-9, t0=0.0)
def test_a_step_is_not_missed_by_a_rounding_error_of_the_time(k: int, h: float, t0: float) -> None:
    """The instant may be written as a sum or as a product: the sample k is at it or after it either way."""
    steps = Steps([0.0, k * h + t0], [0.0, 1.0])
    samples = t0 + np.arange(k - 1, k + 2, dtype=np.float64) * h
    assert np.array_equal(steps.at(samples), [0.0, 1.0, 1.0])


@given(st.floats(-10, 10), st.integers(-3, 3))
def test_what_has_a_period_comes_again(time: float, periods: int) -> None:
    tariff = Steps([6.0, 22.0], [0.3, 0.2], period=24.0)
    day = Interpolated([0.0, 6.0, 18.0], [0.0, 1.0, -1.0], period=24.0)
    assert np.array_equal(tariff.at(np.array([5.0, 6.0, 21.0, 22.0, 24.0])), [0.2, 0.3, 0.3, 0.2, 0.2])
    assert np.allclose(day.at(np.array([3.0, 12.0, 21.0, 27.0])), [0.5, 0.0, -0.5, 0.5])
    for signal in (tariff, day):
        shifted = np.array([time + 24.0 * periods, time])
        assert (
            np.ptp(signal.at(shifted)) < 1e-6 or min(abs(np.mod(time, 24.0) - [0.0, 6.0, 22.0, 24.0])) < 1e-9
        )
    with pytest.raises(ConfigError, match="times must be from 0 to below period = 24"):
        Steps([6.0, 24.0], [0.3, 0.2], period=24.0)


@given(st.integers(0, 1000), st.floats(-1e4, 1e4), st.sampled_from(["hold", "linear"]))
def test_random_levels_are_a_function_of_time(seed: int, start: float, interpolation: str) -> None:
    levels = RandomLevels(-1.0, 3.0, 7.0, seed=seed, interpolation=interpolation)  # type: ignore[arg-type]
    time = start + np.linspace(0.0, 50.0, 200)
    values = levels.at(time)
    assert np.array_equal(values[60:90], levels.at(time[60:90]))
    assert (values >= -1.0).all()
    assert (values <= 3.0).all()
    assert not np.array_equal(values, levels.with_seed(seed + 1).at(time))
    if interpolation == "hold":
        assert len(np.unique(values)) <= 9
    else:
        assert np.abs(np.diff(values)).max() <= 4.0 / 7.0 * 50.0 / 199.0 + 1e-9


def test_random_levels_are_uniform_and_independent() -> None:
    drawn = RandomLevels(-1.0, 3.0, 1.0).at(np.arange(4000.0) + 0.5)
    assert drawn.mean() == pytest.approx(1.0, abs=0.08)
    assert drawn.std() == pytest.approx(4.0 / 12**0.5, rel=0.05)
    assert abs(np.corrcoef(drawn[1:], drawn[:-1])[0, 1]) < 0.06


def test_sums_and_products_in_other_units() -> None:
    outdoors, time = Variable("T", "K"), np.arange(5.0)
    swing, factor = Sine(3.0, 0.1), RandomLevels(0.5, 1.0, 2.0)
    warm = Sum([Constant(20.0), swing], unit="degC").in_unit(outdoors)
    assert np.allclose(warm.at(time), 293.15 + swing.at(time))
    part = Sum([Constant(20.0, unit="degC"), Constant(1.8, unit="degF")]).in_unit(outdoors)
    assert np.allclose(part.at(time), 294.15)
    sun = Product([Constant(0.4), factor], unit="kW/m2").in_unit(Variable("sun", "W/m2"))
    assert np.allclose(sun.at(time), 400.0 * factor.at(time))
    pair = Sum([factor, factor]).with_seed(3)
    first, second = (part.at(time) for part in pair.parts)
    assert not np.array_equal(first, second)
    assert np.allclose(pair.at(time), first + second)
    with pytest.raises(ConfigError, match=r"needed: signals of time, got 1\.0"):
        Sum([Constant(1.0), 1.0])  # type: ignore[list-item]


def test_ramp_is_constant_outside_its_instants() -> None:
    ramp = Ramp(1.0, 3.0, start_time=2.0, stop_time=4.0)
    assert np.allclose(ramp.at(np.array([0.0, 2.0, 2.5, 4.0, 9.0])), [1.0, 1.0, 1.5, 3.0, 3.0])


def test_sine() -> None:
    sine = Sine(2.0, frequency=0.25, offset=1.0, phase=np.pi / 2)
    assert np.allclose(sine.at(np.array([0.0, 1.0, 2.0])), [3.0, 1.0, -1.0])


def test_excitation_of_the_paper_to_the_last_bit() -> None:
    """The default stream of MATLAB, scaled as the authors' program scales it."""
    recorded = np.loadtxt(DATA / "excitation_seed5489.csv", delimiter=",", skiprows=1)
    assert np.array_equal(UniformRandom(-3.5, 3.5, 200, seed=5489).draw(1)[:, 0], recorded[:, 0])


@given(st.integers(1, 50), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_excitation_is_uniform_between_its_limits(samples: int, inputs: int, seed: int) -> None:
    drawn = UniformRandom(-1.0, 3.0, samples, seed).draw(inputs)
    stream = np.random.RandomState(seed).random_sample((samples, inputs))
    assert drawn.shape == (samples, inputs)
    assert np.allclose(drawn, -1.0 + 4.0 * stream, rtol=0, atol=1e-14)


def test_another_seed_changes_nothing_else() -> None:
    assert UniformRandom(-1.0, 3.0, 20, 1).with_seed(7) == UniformRandom(-1.0, 3.0, 20, 7)


def test_an_excitation_without_random_numbers_is_the_same_for_all_seeds() -> None:
    class Alternating(Excitation):
        def draw(self, inputs: int) -> FloatArray:
            return np.tile([[1.0], [-1.0]], (4, inputs))

    excitation = Alternating()
    assert excitation.with_seed(7) is excitation


def test_each_input_has_its_own_range() -> None:
    drawn = UniformRandom([0.0, 10.0], [1.0, 20.0], 1000).draw(2)
    assert np.all(drawn.min(axis=0) >= [0.0, 10.0])
    assert np.all(drawn.max(axis=0) <= [1.0, 20.0])
    assert drawn[:, 1].max() > 19.0


@pytest.mark.parametrize(
    ("make", "faults"),
    [
        (lambda: Steps([0.0], [1.0, 2.0]), ["times (1) and values (2)"]),
        (lambda: Steps([], []), ["at least 1"]),
        (lambda: Steps([1.0, 1.0], [1.0, 2.0]), ["times must increase"]),
        (lambda: Ramp(0.0, 1.0, 2.0, 2.0), ["it must end after it starts, got 2 s to 2 s"]),
        (lambda: UniformRandom(1.0, -1.0, 0), ["samples = 0", "low (1.0) must be below high (-1.0)"]),
        (lambda: Steps([0.0, np.nan], [1.0, 2.0]), ["times must increase"]),
        (lambda: Ramp(0.0, 1.0, np.nan, 2.0), ["it must end after it starts, got nan s to 2 s"]),
        (lambda: UniformRandom(-np.inf, np.nan, 1), ["low (-inf) and high (nan) must be finite numbers"]),
        (lambda: UniformRandom("a", 1.0, 1), ["low (a) and high (1.0) must be finite numbers"]),
        (lambda: UniformRandom(0.0, ((1,), (2, 3)), 1), ["high (((1,), (2, 3))) must be finite"]),
        (lambda: UniformRandom((0, 0), (1, 1, 1), 1), ["low ((0, 0)) and high ((1, 1, 1)) need the same"]),
        (lambda: UniformRandom(0, 1, 1.5, -1), ["samples = 1.5", "seed = -1 is not possible"]),
        (lambda: UniformRandom((0, 0), (1, 1), 9).draw(1), ["low = (0, 0); needed: a number, or 1"]),
        (lambda: GaussianNoise({"a": -1.0, "b": np.nan}), ["of a = -1.0", "of b = nan"]),
    ],
)
def test_impossible_signals_are_refused(make: "type[Steps]", faults: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        make()  # type: ignore[call-arg]
    for fault, expected in zip(caught.value.faults, faults, strict=True):
        assert expected in fault


@pytest.mark.parametrize(
    ("make", "faults"),
    [
        (lambda: Constant("a"), ["Constant: value = 'a' is not possible; needed: a number"]),
        (
            lambda: Steps("ab", [1, "x"]),
            [
                "Steps: times = 'ab' is not possible; needed: a sequence of numbers",
                "Steps: values = [1, 'x'] is not possible; needed: a sequence of numbers",
            ],
        ),
        (lambda: Interpolated(None, 3), ["Interpolated: times = None", "Interpolated: values = 3 is not"]),
        (lambda: Ramp(0, 1, "0", None), ["Ramp: start_time = '0'", "Ramp: stop_time = None is not possible"]),
        (lambda: Sine("1", []), ["Sine: amplitude = '1'", "Sine: frequency = [] is not possible"]),
        (
            lambda: WhiteNoise("1", seed=0.5),
            ["standard_deviation = '1'", "seed = 0.5 is not possible; needed: an"],
        ),
        (lambda: GaussianNoise({"y": "x"}), ["standard deviation of y = x is not possible"]),
        (lambda: ParameterChange("now"), ["ParameterChange: time = 'now' is not possible; needed: a number"]),
    ],
)
def test_what_is_not_a_number_is_named_all_at_once(make: Callable[[], object], faults: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        make()
    assert len(caught.value.faults) == len(faults)
    for fault, words in zip(caught.value.faults, faults, strict=True):
        assert words in fault


def test_signals_take_the_numbers_of_numpy() -> None:
    assert Steps(np.array([0.0, 1.0]), np.array([1, 2])).at(np.array([1.5]))[0] == 2.0
    assert Constant(np.float32(1.5)).at(np.zeros(1))[0] == 1.5
