"""Excitations: what their laws say of them, found by other means than those that made them."""

from math import inf, pi
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers import persistency_of_excitation
from ddpc_cosim import (
    PRBS,
    Chirp,
    ConfigError,
    Excitation,
    MixedExcitation,
    Multisine,
    Ramp,
    SignalExcitation,
    Steps,
    UniformRandom,
)
from ddpc_cosim.signals.excitations import _TAPS, maximum_length_sequence

SEEDS = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("taps", [taps for taps in _TAPS if taps[0] <= 14], ids=lambda taps: str(taps[0]))
def test_a_register_runs_through_all_its_states_but_one(taps: tuple[int, ...]) -> None:
    period = 2 ** taps[0] - 1
    sequence = maximum_length_sequence(taps, 1, 2 * period)
    assert np.array_equal(sequence[:period], sequence[period:])
    windows = {tuple(np.roll(sequence[:period], -i)[: taps[0]].tolist()) for i in range(period)}
    assert len(windows) == period
    assert int(sequence[:period].sum()) == (period + 1) // 2


def polynomial_power(taps: tuple[int, ...], exponent: int) -> int:
    """Return x^exponent modulo the register's polynomial over GF(2), coefficients as bits."""
    degree = taps[0]
    modulus = 1 | sum(1 << tap for tap in taps)

    def product(a: int, b: int) -> int:
        total = 0
        while b:
            if b & 1:
                total ^= a
            b >>= 1
            a <<= 1
            if a >> degree & 1:
                a ^= modulus
        return total

    result, base = 1, 2 if degree > 1 else 2 ^ modulus
    while exponent:
        if exponent & 1:
            result = product(result, base)
        base = product(base, base)
        exponent >>= 1
    return result


@pytest.mark.parametrize("taps", _TAPS, ids=lambda taps: str(taps[0]))
def test_the_polynomial_of_a_register_is_primitive(taps: tuple[int, ...]) -> None:
    """The order of x is the whole 2^n - 1, and none of its proper divisors."""
    period = 2 ** taps[0] - 1
    left, primes, factor = period, set(), 2
    while factor * factor <= left:
        while left % factor == 0:
            primes.add(factor)
            left //= factor
        factor += 1
    primes |= {left} - {1}
    assert polynomial_power(taps, period) == 1
    assert all(polynomial_power(taps, period // prime) != 1 for prime in primes if prime != period)


@pytest.mark.parametrize("seed", range(5))
def test_a_binary_sequence_is_uncorrelated_with_itself_and_with_that_of_other_inputs(seed: int) -> None:
    """The autocorrelation of a whole period of N values is 1 at lag 0 and -1/N at every other."""
    u = PRBS(-1.0, 1.0, 1023, seed).draw(1)[:, 0]
    correlation = np.array([u @ np.roll(u, lag) for lag in range(1023)]) / 1023
    assert correlation[0] == pytest.approx(1.0, abs=1e-12)
    assert correlation[1:] == pytest.approx(np.full(1022, -1 / 1023), abs=1e-12)
    several = PRBS(-1.0, 1.0, 400, seed).draw(3)
    lagged = np.hstack([several[20 - lag : 400 - lag] for lag in range(20)])
    correlations = lagged.T @ lagged / len(lagged) - np.eye(lagged.shape[1])
    assert np.abs(correlations).max() < 0.25
    assert persistency_of_excitation(several) >= 80


@given(
    seed=SEEDS,
    samples=st.integers(1, 300),
    clock=st.integers(1, 20),
    inputs=st.integers(1, 4),
    low=st.floats(-9, 0),
)
def test_a_binary_sequence_has_two_levels_and_holds_them(
    seed: int, samples: int, clock: int, inputs: int, low: float
) -> None:
    u = PRBS(low, 1.0, samples, seed, clock_period=clock).draw(inputs)
    assert u.shape == (samples, inputs)
    assert np.isin(u, [(low + 1.0) / 2 - (1.0 - low) / 2, (low + 1.0) / 2 + (1.0 - low) / 2]).all()
    changes = np.flatnonzero(np.diff(u, axis=0).any(axis=1)) + 1
    assert (changes % clock == 0).all()


@settings(deadline=None)
@given(
    seed=SEEDS,
    samples=st.integers(40, 400),
    inputs=st.integers(1, 3),
    band=st.tuples(st.floats(0.0, 0.3), st.floats(0.4, 1.0)),
    phases=st.sampled_from(["schroeder", "random"]),
)
def test_a_multisine_has_the_lines_of_its_range_and_no_others(
    seed: int, samples: int, inputs: int, band: tuple[float, float], phases: Any
) -> None:
    """Read off by projections on cosine and sine; parts of the Nyquist frequency."""
    h, nyquist = 0.1, 5.0
    low, high = band[0] * nyquist, band[1] * nyquist
    excitation = Multisine(
        -1.0, 3.0, samples, seed, sampling_time=h, min_frequency=low, max_frequency=high, phases=phases
    )
    u = excitation.draw(inputs)
    assert u.min() >= -1.0 - 1e-12
    assert u.max() <= 3.0 + 1e-12
    assert np.abs(u - 1.0).max(axis=0) == pytest.approx(np.full(inputs, 2.0), abs=1e-12)
    t = np.arange(samples) * h
    lines = np.arange(1, (samples - 1) // 2 + 1)
    f = lines / (samples * h)
    angles = 2 * pi * np.outer(f, t)
    amplitudes = np.hypot(np.cos(angles) @ u, np.sin(angles) @ u) * 2 / samples
    wanted = (f >= low * (1 - 1e-12)) & (f <= high * (1 + 1e-12))
    expected = np.zeros((len(f), inputs))
    for i in range(inputs):
        expected[np.flatnonzero(wanted)[i::inputs], i] = 1.0
    sizes = amplitudes.max(axis=0)
    assert amplitudes / sizes == pytest.approx(expected, abs=1e-9)
    assert u.mean(axis=0) == pytest.approx(np.ones(inputs), abs=1e-9)


@pytest.mark.parametrize("samples", [100, 257, 1000])
def test_schroeder_s_phases_keep_peaks_low(samples: int) -> None:
    """A sine has a crest factor of 1.41, one of Schroeder's about 1.7; random phases exceed 2."""

    def crest(phases: Any, seed: int) -> float:
        u = Multisine(-1.0, 1.0, samples, seed, sampling_time=1.0, max_frequency=0.2, phases=phases).draw(1)
        return float(np.abs(u).max() / np.sqrt(np.mean(u**2)))

    crests = [crest("schroeder", seed) for seed in range(5)]
    assert max(crests) < 1.9
    assert max(crests) - min(crests) < 1e-9
    assert np.mean([crest("random", seed) for seed in range(20)]) > 2.0


@settings(max_examples=30)
@given(
    seed=SEEDS,
    ends=st.tuples(st.floats(0.02, 0.2), st.floats(0.02, 0.2)).filter(lambda f: abs(f[0] - f[1]) > 0.01),
    sweep=st.sampled_from(["linear", "logarithmic"]),
)
def test_the_frequency_of_a_chirp_is_that_of_its_sweep(
    seed: int, ends: tuple[float, float], sweep: Any
) -> None:
    """The instantaneous frequency is the slope of the analytic signal's phase."""
    samples, (first, last) = 2000, ends
    u = Chirp(
        -1.0, 1.0, samples, seed, sampling_time=1.0, from_frequency=first, to_frequency=last, sweep=sweep
    ).draw(1)[:, 0]
    spectrum = np.fft.fft(u)
    spectrum[1 : samples // 2] *= 2
    spectrum[samples // 2 + 1 :] = 0
    phase = np.unwrap(np.angle(np.fft.ifft(spectrum)))
    inside = np.arange(300, 1700)
    # Over 100 samples the ripple of the finite transform averages out.
    frequency = (phase[inside + 50] - phase[inside - 50]) / (2 * pi * 100)
    part = inside / samples
    wanted = first + (last - first) * part if sweep == "linear" else first * (last / first) ** part
    assert frequency == pytest.approx(wanted, abs=1.5e-3)


def test_the_inputs_of_a_chirp_never_share_a_frequency() -> None:
    """About 20 s into 120 s, counted in zero crossings."""
    chirp = Chirp(-1.0, 1.0, 1200, sampling_time=0.1, from_frequency=0.1, to_frequency=2.0)
    for i, u in enumerate(chirp.draw(3).T):
        crossings = np.flatnonzero(np.diff(np.sign(u[100:300]))) / 10.0
        wanted = 0.1 + 1.9 * (20.0 / 120.0 + i / 3)
        assert 1 / (2 * np.diff(crossings).mean()) == pytest.approx(wanted, rel=0.08)


EVERY: list[Excitation] = [
    UniformRandom(-1.0, 1.0, 60),
    PRBS(-1.0, 1.0, 60, clock_period=2),
    Multisine(-1.0, 1.0, 60, sampling_time=0.1),
    Multisine(-1.0, 1.0, 60, sampling_time=0.1, phases="random"),
    Chirp(-1.0, 1.0, 60, sampling_time=0.1, from_frequency=0.1, to_frequency=3.0),
]


@pytest.mark.parametrize("excitation", EVERY, ids=lambda signal: type(signal).__name__)
def test_every_excitation_is_drawn_from_its_seed(excitation: Excitation) -> None:
    first = excitation.with_seed(7)
    assert np.array_equal(first.draw(2), first.draw(2))
    assert not np.array_equal(first.draw(2), excitation.with_seed(8).draw(2))
    assert np.abs(first.draw(2)).max() <= 1.0 + 1e-12
    assert np.linalg.matrix_rank(first.draw(2)) == 2


def test_uniform_samples_are_those_of_matlab_to_the_last_bit() -> None:
    """rng(5489); rand(1, 3), as MATLAB prints it with format long."""
    drawn = UniformRandom(0.0, 1.0, 3, 5489).draw(1)[:, 0]
    assert drawn == pytest.approx([0.814723686393179, 0.905791937075619, 0.126986816293506], abs=1e-15)
    unit = np.random.RandomState(5489).random_sample((200, 1))
    assert np.array_equal(UniformRandom(-3.5, 3.5, 200, 5489).draw(1), 3.5 * (2.0 * unit - 1.0))


def test_ranges_are_those_of_each_input() -> None:
    for excitation in (PRBS((0.0, -5.0), (1.0, 5.0), 50), UniformRandom((0.0, -5.0), (1.0, 5.0), 50)):
        u = excitation.draw(2)
        assert (u.min(axis=0) >= [0.0, -5.0]).all()
        assert u[:, 0].max() <= 1.0
        assert 1.0 < u[:, 1].max() <= 5.0
        with pytest.raises(ConfigError, match="needed: a number, or 3"):
            excitation.draw(3)


def test_inputs_can_be_excited_in_different_ways() -> None:
    uniform, steps = (
        UniformRandom((-1.0, -2.0), (1.0, 2.0), 4),
        SignalExcitation((Steps((0.1,), (5.0,)),), 4, 0.1),
    )
    mixed = MixedExcitation(((uniform, (2, 0)), (steps, (1,))))
    u = mixed.with_seed(3).draw(3)
    assert np.array_equal(u[:, [2, 0]], uniform.with_seed(3).draw(2))
    assert u[:, 1].tolist() == [5.0] * 4
    with pytest.raises(ConfigError, match="needed: each of 2 once"):
        mixed.draw(2)
    ramp = SignalExcitation((Ramp(0.0, 3.0, 0.0, 0.3), Steps((0.0, 0.2), (1.0, 2.0))), 4, 0.1)
    assert ramp.draw(2) == pytest.approx(np.array([[0, 1], [1, 1], [2, 2], [3, 2]]))
    with pytest.raises(ConfigError, match="2 signals; needed: one for each of 1"):
        ramp.draw(1)


def test_all_that_is_wrong_with_signals_and_parts_is_told_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        SignalExcitation(3.0, "4", None)
    assert list(caught.value.faults) == [
        "excitation: samples = '4' is not possible; needed: an integer",
        "excitation: sampling_time = None is not possible; needed: a number",
        "excitation: signals = 3.0 is not possible; needed: a sequence of signals",
    ]
    with pytest.raises(ConfigError) as caught:
        SignalExcitation([Steps((0.0,), (1.0,)), 5.0], 0, -0.1)
    assert len(caught.value.faults) == 3
    part = (UniformRandom(-1.0, 1.0, 4), np.array([0]))
    with pytest.raises(ConfigError) as caught:
        MixedExcitation([part, (part[0], ["u"]), part[0], (None, (0,)), 1])
    assert len(caught.value.faults) == 4
    assert all(
        "needed: an excitation and the numbers of the inputs" in fault for fault in caught.value.faults
    )
    with pytest.raises(ConfigError, match="mixed excitation: None is not possible"):
        MixedExcitation(None)


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda: PRBS(1.0, 0.0, 10), r"PRBS excitation: low \(1.0\) must be below high \(0.0\)"),
        (
            lambda: PRBS(0.0, 1.0, 10, clock_period=0),
            "clock_period = 0 is not possible; allowed: an integer >= 1",
        ),
        (lambda: Multisine(0.0, 1.0, 10, sampling_time=0.0), "sampling_time = 0.0 s is not possible"),
        (
            lambda: Multisine(0.0, 1.0, 10, sampling_time=1.0, min_frequency=2.0, max_frequency=1.0),
            "min_frequency = 2 Hz and max_frequency = 1 Hz; needed: 0 <= min_frequency < max_frequency",
        ),
        (
            lambda: Multisine(0.0, 1.0, 10, sampling_time=1.0, min_frequency=0.45, max_frequency=inf).draw(1),
            "0 harmonics of the experiment's 0.1 Hz .* below 0.5 Hz; needed: one for each of 1 input",
        ),
        (
            lambda: Chirp(0.0, 1.0, 10, sampling_time=1.0, from_frequency=0.1, to_frequency=0.6),
            "to_frequency = 0.6 Hz is not possible; allowed: .* half the sampling frequency, 0.5 Hz",
        ),
        (
            lambda: Chirp(0.0, 1.0, 10, sampling_time=1.0, from_frequency=0.1, to_frequency=0.1),
            "from_frequency and to_frequency are both 0.1 Hz",
        ),
        (
            lambda: Chirp(
                0.0,
                1.0,
                10,
                sampling_time=1.0,
                from_frequency=0.1,
                to_frequency=0.2,
                sweep="square",  # type: ignore
            ),
            'sweep = "square" is not possible',
        ),
        (
            lambda: Multisine(0.0, 1.0, 10, sampling_time=1.0, phases="flat"),  # type: ignore
            'phases = "flat" is not possible',
        ),
    ],
)
def test_impossible_excitations(make: Any, fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        make()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PRBS("a", None, "10", clock_period="2"), ["samples = 10", "low (a)", "clock_period = 2"]),
        (
            lambda: Multisine(-1, 1, 10, sampling_time="x", min_frequency=None, max_frequency=1.0),
            ["sampling_time = 'x' is not possible; needed: a number", "min_frequency = None is not possible"],
        ),
        (
            lambda: Chirp(-1, 1, 10, sampling_time=0.1, from_frequency="1", to_frequency=[]),
            ["from_frequency = '1' is not possible; needed: a number", "to_frequency = [] is not possible"],
        ),
    ],
)
def test_what_is_not_a_number_is_named_all_at_once(make: Any, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        make()
    assert len(caught.value.faults) == len(words)
    for fault, part in zip(caught.value.faults, words, strict=True):
        assert part in fault
