"""N steps of the data model at once against the recursion, sample by sample, and the printed matrices."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers.models.data_model import Form
from ddpc_controllers.models.data_model_prediction import LinearisedPrediction
from ddpc_cosim import FloatArray

forms = st.builds(
    Form,
    outputs=st.integers(1, 3),
    inputs=st.integers(1, 3),
    output_length=st.integers(0, 3),
    input_length=st.integers(1, 4),
)


def simulate(form: Form, gradients: FloatArray, known: FloatArray, du: FloatArray) -> FloatArray:
    """Run dy_k+1 = Phi_k H_k; return the sums of dy, shape (N, p)."""
    p, m, ly = form.outputs, form.inputs, form.output_length
    newest_dy = list(known[: ly * p].reshape(-1, p))
    newest_du = list(known[ly * p :].reshape(-1, m))
    sums, total = [], np.zeros(p)
    for phi, change in zip(gradients, du, strict=True):
        newest_du.insert(0, change)
        h = np.concatenate([*newest_dy[:ly], *newest_du[: form.input_length]])
        newest_dy.insert(0, phi @ h)
        total = total + newest_dy[0]
        sums.append(total)
    return np.array(sums)


@settings(deadline=None, max_examples=200)
@given(forms, st.integers(1, 6), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_it_is_the_recursion(form: Form, horizon: int, moves: int, seed: int) -> None:
    moves = min(moves, horizon)
    rng = np.random.default_rng(seed)
    gradients = rng.uniform(-0.5, 0.5, (horizon, form.outputs, form.terms))
    known = rng.uniform(-1.0, 1.0, form.terms - form.inputs)
    du = np.zeros((horizon, form.inputs))
    du[:moves] = rng.uniform(-1.0, 1.0, (moves, form.inputs))

    prediction = LinearisedPrediction(form.regressors(), form.inputs, horizon, moves)
    a, f = prediction(gradients.transpose(1, 0, 2).ravel().tolist(), known.tolist())

    expected = simulate(form, gradients, known, du).ravel()
    assert np.abs(a @ du[:moves].ravel() + f - expected).max() < 1e-12 * max(1.0, np.abs(expected).max())


@given(st.lists(st.floats(0.01, 2.0), min_size=1, max_size=7))
def test_the_compact_form_is_the_matrix_that_the_paper_prints(phi: list[float]) -> None:
    form, n = Form(1, 1, 0, 1), len(phi)
    a, f = LinearisedPrediction(form.regressors(), 1, n, n)(phi, [])
    assert np.array_equal(a, np.tril(np.tile(phi, (n, 1))))
    assert not f.any()


@settings(deadline=None)
@given(st.integers(1, 4), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_the_partial_form_is_the_sum_over_its_gradients(lu: int, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    phi, past = rng.uniform(-1.0, 1.0, (n, lu)), rng.uniform(-1.0, 1.0, lu - 1)
    a, f = LinearisedPrediction(Form(1, 1, 0, lu).regressors(), 1, n, n)(phi.ravel().tolist(), past.tolist())
    for j in range(n):
        for column in range(n):
            # du_k+column acts on dy_k+i+1 through the coefficient i - column of Phi_k+i.
            terms = [phi[i, i - column] for i in range(column, j + 1) if i - column < lu]
            assert a[j, column] == pytest.approx(sum(terms), abs=1e-12)
        known = [phi[i, lag] * past[lag - i - 1] for i in range(j + 1) for lag in range(i + 1, lu)]
        assert f[j] == pytest.approx(sum(known), abs=1e-12)


def test_a_diagonal_form_is_one_system_for_each_pair() -> None:
    rng = np.random.default_rng(1)
    both, alone = Form(2, 2, 2, 2, diagonal=True), Form(1, 1, 2, 2)
    phi = rng.uniform(-0.5, 0.5, (2, 5, 4))
    known = rng.uniform(-1.0, 1.0, (2, 3))  # of each channel: dy_k, dy_k-1, du_k-1
    a, f = LinearisedPrediction(both.regressors(), 2, 5, 3)(phi.ravel().tolist(), known.T.ravel().tolist())
    for i in range(2):
        prediction = LinearisedPrediction(alone.regressors(), 1, 5, 3)
        of_pair, known_one = prediction(phi[i].ravel().tolist(), known[i].tolist())
        assert a[i::2, i::2] == pytest.approx(of_pair, abs=1e-15)
        assert f[i::2] == pytest.approx(known_one, abs=1e-15)
        assert not a[i::2, 1 - i :: 2].any()
