"""What is taken from python-control, and nothing else of it: arrays in, arrays out.

python-control is imported inside the functions: its import costs a second and more, which only those pay
whose controller needs it, and only once per run. The filter of every controller on a model goes straight to
the Riccati solver that python-control calls.
"""

from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are first used

from ddpc_cosim import ConfigError, FloatArray


def discretise(a: FloatArray, b: FloatArray, sampling_time: float) -> tuple[FloatArray, FloatArray]:
    """Return A and B of a continuous plant whose inputs are held between samples (``control.c2d``)."""
    import control

    c = np.zeros((1, len(a)))
    sampled = control.c2d(control.ss(a, b, c, np.zeros((1, b.shape[1]))), sampling_time, method="zoh")
    return np.asarray(sampled.A), np.asarray(sampled.B)


def regulator_gain(
    a: FloatArray, b: FloatArray, q: FloatArray, r: FloatArray, integrated: FloatArray
) -> FloatArray:
    """Return K of ``u = -K (x, z)`` with ``z+ = z + integrated @ x`` (``control.dlqr``).

    Parameters
    ----------
    a, b : array, shapes (n, n) and (n, m)
        The sampled plant.
    q : array, shape (n + p, n + p)
        Weight of (x, z).
    r : array, shape (m, m)
        Weight of u.
    integrated : array, shape (p, n)
        What is summed up.

    Raises
    ------
    ConfigError
        There is no stabilising gain.
    """
    import control

    # Inputs of unit cost: in their own units R may be all but singular.
    unit = 1.0 / np.sqrt(np.diag(r))
    weights = _symmetric(q), _symmetric(r * unit * unit[:, np.newaxis])
    gain = _riccati(
        "linear-quadratic regulator: the plant with its integrators cannot be stabilised",
        lambda: control.dlqr(a, b * unit, *weights, integral_action=integrated)[0],
    )
    return gain * unit[:, np.newaxis]


def estimator_covariance(a: FloatArray, c: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    """Return the covariance P of the prediction error of the steady Kalman filter, as ``control.dlqe`` does.

    Parameters
    ----------
    a, c : array, shapes (n, n) and (p, n)
        The sampled plant.
    q, r : array, shapes (n, n) and (p, p)
        Covariances of what drives the states and of the measurement noise.

    Raises
    ------
    ConfigError
        There is no stable filter.
    """
    return _riccati(
        "Kalman filter: the model has a mode that is not stable and that the outputs do not show",
        lambda: scipy.linalg.solve_discrete_are(a.T, c.T, _symmetric(q), _symmetric(r)),
    )


def realise(markov: FloatArray, order: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B and C of the balanced model of an impulse response (``control.eigensys_realization``).

    Parameters
    ----------
    markov : array, shape (L, p, m)
        ``C A^i B`` for i = 0 ... L - 1, with L at least 2 order + 1.
    order : int
        Number of states to keep; at most the rank of the response.
    """
    import control

    response = np.concatenate([np.zeros((1, *markov.shape[1:])), markov]).transpose(1, 2, 0)  # y, u, time
    depth = len(markov) // 2
    model, _ = control.eigensys_realization(response, order, m=depth, n=depth)
    return np.asarray(model.A), np.asarray(model.B), np.asarray(model.C)


def _symmetric(matrix: FloatArray) -> FloatArray:
    """Take away what rounding leaves between a matrix and its transpose: in mixed units it can be large."""
    return np.asarray((matrix + matrix.T) / 2.0, dtype=np.float64)


def _riccati(failure: str, solve: Any) -> FloatArray:
    try:
        solution = np.asarray(solve(), dtype=np.float64)
    except (
        np.linalg.LinAlgError,
        TypeError,
        ValueError,
    ) as error:  # python-control's own are of these classes
        raise ConfigError(f"{failure} ({error})") from error
    if not np.isfinite(solution).all():
        raise ConfigError(failure)
    return solution
