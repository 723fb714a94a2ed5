"""The prediction-error method: the predictor in state space with the smallest errors.

Small is their generalised variance, the determinant of the covariance. All coefficients are free, so that
no canonical form has to be chosen for several outputs; ARMAX models are among those that are searched.
Along changes of coordinates the errors stay what they are: there the damping of Levenberg and Marquardt
keeps the coefficients where they are (T. McKelvey, A. Helmersson, T. Ribarits, Automatica 40(9), 2004,
doi:10.1016/j.automatica.2004.04.006). Initial states are eliminated, one per stretch of a mosaic (G. Golub,
V. Pereyra, SIAM J. Numer. Anal. 10(2), 1973). Where the model is true and the noise is Gaussian, this is
maximum likelihood, for data of a closed loop too (L. Ljung, System Identification, 2nd ed., section 13.4).
"""

from dataclasses import dataclass

import numpy as np

from ddpc_cosim.identification.predictor import Predictor, Refit, Samples, scan
from ddpc_cosim.variables import FloatArray

_EXACT = 1e-9  # of a signal's size: errors that small are rounding
_STEPS = 25
_SETTLED = 1e-3  # the improvement of twice the log-likelihood after which the search ends
_DAMPING = (1e-4, 1e8)  # at the beginning, and where no step helps any more
_MOST_ENTRIES = 1_500_000  # of the matrix of sensitivities
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True, slots=True)
class Sensitivities:
    """What one-step errors say of a predictor's coefficients, with the noise at unit size.

    Parameters
    ----------
    errors : array, shape (T, p)
        One-step errors with the best initial states.
    whiten : array, shape (p, p)
        What gives them covariance one.
    whitened : array, shape (T p,)
        The errors with covariance one.
    jacobian : array, shape (T p, coefficients)
        How predictions change with the coefficients (a and g side by side, c, y_0, each row by row), beyond
        what initial states can take back.
    """

    errors: FloatArray
    whiten: FloatArray
    whitened: FloatArray
    jacobian: FloatArray


def refine(start: Predictor, samples: Samples, steps: int = _STEPS) -> Predictor:
    """Return the predictor with the smallest generalised variance of one-step errors, near another.

    Parameters
    ----------
    start : Predictor
        Where the search begins; stable.
    samples : Samples
        What is to be explained; see :func:`used_rows`.
    steps : int
        Gauss-Newton steps at most.

    Returns
    -------
    predictor : Predictor
        No worse than ``start`` for these samples.
    """
    samples = samples.rows(used_rows(samples, len(start.a)))
    best, cost = start, generalised_variance(start.errors(samples))
    damping, end = _DAMPING
    for _ in range(steps):
        if cost <= 2.0 * len(start.c) * np.log(2.0 * _EXACT):
            break
        known = sensitivities(best, samples)
        information, slope = known.jacobian.T @ known.jacobian, known.jacobian.T @ known.whitened
        size = np.trace(information) / len(information)
        before = cost
        while damping < end:
            change = np.linalg.solve(information + damping * size * np.eye(len(slope)), slope)
            tried = changed(best, change)
            new = generalised_variance(tried.errors(samples)) if tried.is_stable() else np.inf
            if new < cost:
                best, cost, damping = tried, new, max(damping / 10.0, 1e-12)
                break
            damping *= 10.0
        if (before - cost) * len(samples) < _SETTLED:
            break
    return best


def used_rows(samples: Samples, order: int) -> slice:
    """Return the rows that a search uses: a block in which the inputs move most, all where memory allows."""
    m, n_d, p = samples.counts
    coefficients = order * (order + m + n_d + 2 * p + 1) + p
    most = max(1000, _MOST_ENTRIES // (p * coefficients))
    if len(samples) <= most:
        return slice(0, len(samples))
    moves = np.square(np.diff(samples.z[:, : m + n_d], axis=0)).sum(axis=1)
    moved = np.concatenate([[0.0], np.cumsum(moves)])
    first = int(np.argmax(moved[most - 1 :] - moved[: len(moved) - most + 1]))
    return slice(first, first + most)


def linearised(predictor: Predictor, samples: Samples) -> Refit:
    """Return what a predictor becomes, to first order, where other errors had come to the same past."""
    used = used_rows(samples, len(predictor.a))
    known = sensitivities(predictor, samples.rows(used))
    values, vectors = np.linalg.eigh(known.jacobian.T @ known.jacobian)
    seen = values > _NEGLIGIBLE * values[-1]

    def refit(errors: FloatArray) -> Predictor:
        slope = known.jacobian.T @ (errors[used] @ known.whiten.T).ravel()
        change = vectors[:, seen] @ ((vectors[:, seen].T @ slope) / values[seen])
        while not (new := changed(predictor, change)).is_stable():
            change /= 2.0
        return new

    return refit


def generalised_variance(errors: FloatArray) -> float:
    """Return the logarithm of the determinant of the errors' covariance."""
    covariance = errors.T @ errors / len(errors)
    return float(np.linalg.slogdet(covariance + _EXACT**2 * np.eye(len(covariance)))[1])


def sensitivities(predictor: Predictor, samples: Samples) -> Sensitivities:
    """Return one-step errors and how they change with a predictor's coefficients.

    The transposed filter (``a'``, driven by every signal along every row of c) gives at once what an addition
    to any of the states does to the outputs: n equations per output and signal, not n per coefficient.
    """
    errors = predictor.errors(samples)
    (p, n), stretches = predictor.c.shape, samples.stretches
    states = predictor.states(samples)
    # With the initial states that `errors` has found, the states that its predictions are made of.
    for rows in stretches:
        left = samples.y[rows] - errors[rows] - predictor.y_0 - states[rows] @ predictor.c.T
        effect = predictor.initial_effect(len(left))
        first = np.asarray(np.linalg.lstsq(effect, left.ravel(), rcond=_NEGLIGIBLE)[0], dtype=np.float64)
        zeros = np.zeros((len(left), n))
        states[rows] += scan(predictor.a, zeros, [slice(0, len(left))], first)
    driven = np.hstack([states, samples.z])
    entries = (predictor.c.T[:, :, np.newaxis] * driven[:, np.newaxis, np.newaxis, :]).reshape(
        len(driven), n, -1
    )
    shown = scan(predictor.a.T, entries, stretches).reshape(len(driven), n, p, -1)
    by_state = shown.transpose(0, 2, 1, 3).reshape(len(driven), p, -1)
    eye = np.eye(p)
    by_c = np.einsum("ij,tk->tijk", eye, states).reshape(len(driven), p, -1)
    constant = np.broadcast_to(eye, (len(driven), p, p))
    jacobian = np.concatenate([by_state, by_c, constant], axis=2)
    covariance = errors.T @ errors / len(errors) + _EXACT**2 * eye
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    jacobian, whitened = np.einsum("ij,tjk->tik", whiten, jacobian), errors @ whiten.T
    for rows in stretches:
        effect = np.einsum("ij,tjk->tik", whiten, predictor.initial_response(rows.stop - rows.start))
        vectors, values, _ = np.linalg.svd(effect.reshape(-1, n), full_matrices=False)
        vectors = vectors[:, values > _NEGLIGIBLE * values[0]]
        for of_stretch in (jacobian[rows], whitened[rows]):
            flat = of_stretch.reshape(len(effect) * p, -1)
            of_stretch -= (vectors @ (vectors.T @ flat)).reshape(of_stretch.shape)
    return Sensitivities(errors, whiten, whitened.ravel(), jacobian.reshape(len(driven) * p, -1))


def changed(predictor: Predictor, change: FloatArray) -> Predictor:
    """Return a predictor with something added to its coefficients, in the order of the sensitivities."""
    n, p = len(predictor.a), len(predictor.c)
    onward = np.hstack([predictor.a, predictor.g])
    sizes = np.cumsum([onward.size, predictor.c.size])
    of_onward, of_c, of_y_0 = np.split(change, sizes)
    onward = onward + of_onward.reshape(onward.shape)
    c = predictor.c + of_c.reshape(p, n)
    return Predictor(onward[:, :n], onward[:, n:], c, predictor.y_0 + of_y_0)
