"""Hankel matrices, persistency of excitation and what is said of a recording."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers import hankel_matrix, numerical_rank, persistency_of_excitation
from ddpc_controllers.data.hankel import diagnose, least_samples, require_length
from ddpc_cosim import DataError, FloatArray

signals = st.builds(
    lambda length, width, seed: np.random.default_rng(seed).standard_normal((length, width)),
    st.integers(3, 60),
    st.integers(1, 3),
    st.integers(0, 2**32 - 1),
)


@settings(deadline=None)
@given(signals, st.data())
def test_every_column_is_a_window_of_the_signal(w: FloatArray, data: st.DataObject) -> None:
    depth = data.draw(st.integers(1, len(w)))
    matrix = hankel_matrix(w, depth)
    assert matrix.shape == (depth * w.shape[1], len(w) - depth + 1)
    for column in range(matrix.shape[1]):
        assert np.array_equal(matrix[:, column], w[column : column + depth].ravel())


@settings(deadline=None)
@given(signals, st.data())
def test_a_block_row_further_down_is_the_same_a_column_later(w: FloatArray, data: st.DataObject) -> None:
    depth = data.draw(st.integers(1, len(w)))
    matrix, width = hankel_matrix(w, depth), w.shape[1]
    assert np.array_equal(matrix[width:, :-1], matrix[:-width, 1:])


@pytest.mark.parametrize("depth", [0, 11])
def test_a_depth_without_a_window_is_an_error_with_both_numbers(depth: int) -> None:
    with pytest.raises(DataError, match=f"depth {depth} needs at least .* there are 10"):
        hankel_matrix(np.zeros((10, 1)), depth)


@settings(deadline=None)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_a_sum_of_sinusoids_excites_up_to_twice_their_number(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Frequencies far enough apart that their windows differ by more than rounding.
    frequencies = 0.35 + 0.4 * np.arange(count) + rng.uniform(0.0, 0.1, count)
    phases = rng.uniform(0.0, 2.0 * np.pi, count)
    time = np.arange(120)[:, np.newaxis]
    u = np.sin(time * frequencies + phases).sum(axis=1, keepdims=True)
    assert persistency_of_excitation(u) == 2 * count


@settings(max_examples=30)
@given(st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_white_noise_excites_as_far_as_its_length_allows(inputs: int, seed: int) -> None:
    u = np.random.default_rng(seed).standard_normal((50, inputs))
    order = persistency_of_excitation(u)
    assert least_samples(order, inputs) <= 50 < least_samples(order + 1, inputs)


@settings(deadline=None)
@given(st.floats(1e-3, 1e3), st.integers(5, 40))
def test_a_constant_excites_to_order_one(value: float, length: int) -> None:
    assert persistency_of_excitation(np.full((length, 1), value)) == 1


def test_silence_does_not_excite() -> None:
    assert persistency_of_excitation(np.zeros((20, 1))) == 0


def test_two_equal_inputs_do_not_excite() -> None:
    u = np.random.default_rng(1).standard_normal((50, 1))
    assert persistency_of_excitation(np.hstack([u, u])) == 0


@settings(deadline=None)
@given(signals, st.floats(1e-6, 1e6))
def test_excitation_does_not_depend_on_units(u: FloatArray, unit: float) -> None:
    scale = np.where(np.arange(u.shape[1]) == 0, unit, 1.0)
    assert persistency_of_excitation(u * scale) == persistency_of_excitation(u)


@pytest.mark.parametrize("share", [1e-1, 1e-4, 1e-8, 1e-12])
def test_weak_parts_of_a_signal_excite_as_far_as_singular_values_tell(share: float) -> None:
    noise = np.random.default_rng(4).standard_normal((60, 1))
    u = np.sin(0.7 * np.arange(60.0))[:, np.newaxis] + share * noise
    u /= np.abs(u).max()
    orders = [order for order in range(1, 31) if numerical_rank(hankel_matrix(u, order)) == order]
    assert persistency_of_excitation(u) == max(orders)


def test_the_search_stops_where_it_is_told() -> None:
    u = np.random.default_rng(2).standard_normal((100, 1))
    assert persistency_of_excitation(u, at_most=7) == 7


@settings(deadline=None)
@given(st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_the_rank_of_a_product_is_its_inner_size(rank: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert numerical_rank(rng.standard_normal((6, rank)) @ rng.standard_normal((rank, 9))) == rank


def test_the_data_of_a_noise_free_linear_plant_have_the_rank_of_the_fundamental_lemma() -> None:
    rng = np.random.default_rng(3)
    u, y, state = rng.standard_normal((80, 1)), np.zeros((80, 1)), np.zeros(2)
    for k in range(80):
        y[k] = state[0]
        state = np.array([[0.8, 0.3], [-0.2, 0.6]]) @ state + np.array([0.0, 1.0]) * u[k]
    depth, order = 7, 2
    stacked = np.vstack([hankel_matrix(u, depth), hankel_matrix(y, depth)])
    quality = diagnose(stacked, u, depth + order)
    size_one = stacked / np.sqrt((stacked**2).mean(axis=1, keepdims=True))
    values = np.linalg.svd(size_one, compute_uv=False)
    assert (quality.data_rank, quality.data_rows, quality.data_columns) == (depth + order, 14, 74)
    assert quality.smallest_singular_value == pytest.approx(values[depth + order - 1])
    assert quality.condition == pytest.approx(values[0] / values[depth + order - 1])
    assert quality.pe_order >= quality.pe_order_needed == 9


def test_the_figures_do_not_depend_on_units() -> None:
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal((60, 1)), rng.standard_normal((60, 1))
    quality, elsewhere = (
        diagnose(np.vstack([hankel_matrix(a * u, 5), hankel_matrix(b * y, 5)]), a * u, 6)
        for a, b in ((1.0, 1.0), (1e6, 1e-6))
    )
    assert elsewhere.data_rank == quality.data_rank == 10
    assert elsewhere.as_dict() == pytest.approx(quality.as_dict(), rel=1e-9)


def test_a_recording_too_short_is_told_the_shortest_that_works() -> None:
    require_length(21, 11, 1, "DeePC")
    with pytest.raises(DataError, match=r"20 samples; persistency of excitation of order 11 .* at least 21"):
        require_length(20, 11, 1, "DeePC")
