"""Dictionaries: each function as written on paper, centres where they are asked for, and what is refused."""

import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_controllers.data.dictionaries import (
    Combined,
    Constant,
    Delays,
    Dictionary,
    Gaussian,
    Identity,
    OwnFunction,
    Polynomials,
    ThinPlate,
    embed,
)
from ddpc_controllers.published import PublishedWKPC
from ddpc_cosim import ConfigError, DataError, FloatArray, PluginError, Recording
from ddpc_cosim.settings import to_plain

from ..full_problem import FullWKPC
from ..loops import ANGLE, before, close_loop, paper_reference, pendulum_loop, printed_wkpc, quick_pendulum


def sine_and_cosine(states: FloatArray) -> FloatArray:
    """An observable of a user's own."""
    return np.stack([np.sin(states[..., 0]), np.cos(states[..., 0])], axis=-1)


def one_number(states: FloatArray) -> FloatArray:
    """What an own function must not return."""
    return np.zeros(3)


OWN = OwnFunction(function=f"{__name__}:sine_and_cosine")
NO_DICTIONARY: Any = [ThinPlate(), 3]
ALL: list[Dictionary] = [
    ThinPlate(),
    ThinPlate(centres="k-means"),
    Gaussian(count=4, centres="data"),
    Polynomials(degree=3),
    Constant(),
    OWN,
    Delays(samples=2),
    Delays(samples=1, dictionary=Gaussian(count=3)),
    Identity(),
    Combined(dictionaries=[Polynomials(), Delays(samples=2), Constant()]),
]


@pytest.fixture
def states() -> FloatArray:
    """Forty recorded samples of two signals."""
    return np.random.default_rng(1).normal(size=(40, 2))


def drawn(dictionary: Any, samples: FloatArray, seed: int = 0) -> tuple[Any, FloatArray]:
    """Return the functions and the states that they are applied to."""
    states = embed(samples, getattr(dictionary, "memory", 0))
    return dictionary.draw(states, np.random.default_rng(seed)), states


@pytest.mark.parametrize("dictionary", ALL, ids=repr)
def test_it_has_as_many_functions_as_it_says_and_draws_them_by_seed(
    dictionary: Dictionary, states: FloatArray
) -> None:
    lift, embedded = drawn(dictionary, states)
    again, _ = drawn(dictionary, states)
    values = lift(embedded)
    assert values.shape == (len(embedded), dictionary.functions(2))
    assert np.array_equal(again(embedded), values)
    assert np.array_equal(pickle.loads(pickle.dumps(lift))(embedded), values)
    assert np.allclose(lift(embedded[3]), values[3], rtol=0.0, atol=1e-15)


def test_radial_functions_say_their_settings_in_the_order_of_their_formula() -> None:
    names = [list(to_plain(dictionary)) for dictionary in (ThinPlate(), Gaussian())]
    assert names == [
        ["type", "count", "low", "high", "centres"],
        ["type", "count", "width", "low", "high", "centres"],
    ]


def test_gaussians_are_one_at_their_centres_and_fall_as_written(states: FloatArray) -> None:
    lift, _ = drawn(Gaussian(count=5, width=0.7, centres="data"), states)
    centre = lift.centres[2]
    assert lift(centre)[2] == 1.0
    assert lift(centre + np.array([0.7, 0.0]))[2] == pytest.approx(np.exp(-0.5), abs=1e-15)


def test_monomials_of_degree_two_and_three_of_two_variables() -> None:
    lift, _ = drawn(Polynomials(degree=3), np.zeros((1, 2)))
    a, b = 2.0, -3.0
    expected = [a * a, a * b, b * b, a**3, a * a * b, a * b * b, b**3]
    assert lift(np.array([a, b])) == pytest.approx(expected)


@given(st.integers(1, 5), st.integers(2, 5))
def test_the_number_of_monomials_is_counted_right(size: int, degree: int) -> None:
    dictionary = Polynomials(degree=degree)
    lift, _ = drawn(dictionary, np.zeros((1, size)))
    assert lift(np.ones(size)).shape == (dictionary.functions(size),)


def test_a_state_with_its_past_comes_newest_first() -> None:
    samples = np.array([[1.0], [2.0], [3.0], [4.0]])
    assert embed(samples, 2).tolist() == [[3.0, 2.0, 1.0], [4.0, 3.0, 2.0]]
    lift, embedded = drawn(Delays(samples=2), samples)
    assert lift(embedded).tolist() == [[2.0, 1.0], [3.0, 2.0]]


def test_combined_dictionaries_stand_side_by_side(states: FloatArray) -> None:
    lift, embedded = drawn(Combined(dictionaries=[OWN, Delays(samples=1)]), states)
    assert np.array_equal(lift(embedded)[:, :2], sine_and_cosine(states[1:]))
    assert np.array_equal(lift(embedded)[:, 2:], states[:-1])


def test_centres_from_data_are_recorded_states_and_differ(states: FloatArray) -> None:
    lift, _ = drawn(ThinPlate(count=12, centres="data"), states)
    recorded = {tuple(row) for row in states.tolist()}
    chosen = {tuple(row) for row in lift.centres.tolist()}
    assert len(chosen) == 12
    assert chosen <= recorded


def test_k_means_finds_the_clusters() -> None:
    rng = np.random.default_rng(2)
    middles = np.array([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]])
    samples = np.vstack([middle + 0.1 * rng.normal(size=(30, 2)) for middle in middles])
    lift, _ = drawn(ThinPlate(count=3, centres="k-means"), samples)
    distance = np.linalg.norm(lift.centres[:, np.newaxis] - middles, axis=-1)
    assert distance.min(axis=0).max() < 0.1


@pytest.mark.parametrize("rule", ["data", "k-means"])
def test_too_few_different_states_for_the_centres_are_told(rule: Any) -> None:
    with pytest.raises(DataError, match="10 centres need as many different states; the recording has 2"):
        drawn(ThinPlate(centres=rule), np.repeat(np.eye(2), 20, axis=0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Gaussian(low=2.0), "Gaussian: low = 2 is above high = 1"),
        (lambda: Polynomials(degree=1), "degree = 1 is not possible"),
        (lambda: Combined(dictionaries=[]), "dictionaries is empty"),
        (lambda: Combined(dictionaries=NO_DICTIONARY), r"dictionaries\[1\] = 3 lacks draw"),
        (lambda: Delays(dictionary=Delays()), "looks back itself"),
        (lambda: PublishedWKPC(dictionary=Delays()), "is not a ThinPlate"),
    ],
)
def test_impossible_dictionaries_are_refused(make: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make()


def test_an_own_function_that_is_not_there_or_returns_the_wrong_shape(states: FloatArray) -> None:
    with pytest.raises(PluginError, match="no_such_function"):
        OwnFunction(function=f"{__name__}:no_such_function")
    with pytest.raises(ConfigError, match=r"returned shape \(3,\) for 40 states; needed: \(40, n_p\)"):
        drawn(OwnFunction(function=f"{__name__}:one_number"), states)


def test_a_recording_shorter_than_the_memory_is_refused() -> None:
    with pytest.raises(DataError, match="a memory of 5 samples needs a longer recording than 4"):
        embed(np.zeros((4, 1)), 5)


def test_wkpc_with_a_dictionary_that_looks_back_solves_the_printed_problem(
    state_recording: Recording,
) -> None:
    dictionary = Combined(dictionaries=[OWN, Delays(samples=1)])
    controller = printed_wkpc(dictionary=dictionary)
    loop = pendulum_loop(state_recording, 2.5, 170.0)
    here = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 40)

    def lifted(samples: FloatArray) -> FloatArray:
        return np.hstack([samples[1:], sine_and_cosine(samples[1:]), samples[:-1]])

    recorded = Recording(
        state_recording.u[1:], state_recording.y[1:], state_recording.measured[1:], loop.sampling_time
    )
    full = FullWKPC(controller, lifted(state_recording.measured), recorded, loop.bounds)
    measured = np.array([sample.measured for sample in here.samples])
    z = lifted(np.vstack([measured[:1], measured]))
    for k, sample in enumerate(here.samples):
        past = before(z, z[0], k, 2), before(here.u, np.zeros(1), k, 2), before(here.y, here.y[0], k, 2)
        assert np.abs(full.solve(*past, sample.reference).u[0] - here.u[k]).max() < 1e-6
    assert set(here.status) == {"ok"}
