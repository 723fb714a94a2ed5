"""Koopman models from data: extended dynamic mode decomposition with control.

    z+ = A z + B u,   y = C z,   z = (x, psi_1(x), ..., psi_np(x))

by regularised least squares over the recorded samples (M. Korda, I. Mezic, Linear predictors for nonlinear
dynamical systems: Koopman operator meets model predictive control, Automatica 93, 2018,
doi:10.1016/j.automatica.2018.03.046). Without observables z = x: dynamic mode decomposition with control
(J. L. Proctor, S. L. Brunton, J. N. Kutz, SIAM J. Applied Dynamical Systems 15(1), 2016,
doi:10.1137/15M1013857).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ddpc_controllers.dictionaries import Dictionary, embed, memory_of
from ddpc_controllers.informative import require_informative
from ddpc_controllers.lifting import StateWindow
from ddpc_cosim import DataError, FloatArray, Recording

StateKind = Literal["measured", "delays"]
STATE_KINDS = ("measured", "delays")

_NEGLIGIBLE = 1e-12


@dataclass(frozen=True, slots=True)
class LiftedModel:
    """A linear model of lifted states.

    Parameters
    ----------
    a, b, c : array, shapes (n_z, n_z), (n_z, m), (p, n_z)
        The matrices.
    error : array, shape (n_z,)
        Root mean square of the one-step prediction errors over the recording.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    error: FloatArray


def fit_lifted_model(z: FloatArray, u: FloatArray, y: FloatArray, ridge: float = 0.0) -> LiftedModel:
    """Fit ``z+ = A z + B u`` by regularised least squares, and ``y = C z``.

    C reads off the outputs that are among the lifted states, and is fitted to others.

    Parameters
    ----------
    z, u, y : array, shapes (T, n_z), (T, m), (T, p)
        Lifted states, inputs and outputs, time along axis 0.
    ridge : float
        Weight of the squared coefficients, for observables and inputs scaled to unit size.

    Raises
    ------
    DataError
        The inputs do not tell their own effect from that of the state.
    """
    require_informative(u[:-1], z[:-1], "EDMD")
    size = _root_mean_square(np.hstack([z, u]))
    scaled = np.hstack([z, u]) / size
    n_z = z.shape[1]
    dynamics = _least_squares(scaled[:-1], z[1:] / size[:n_z], ridge)
    shown = _least_squares(scaled[:, :n_z], y, 0.0).T / size[:n_z]
    both = (dynamics.T / size) * size[:n_z, np.newaxis]
    model = both[:, :n_z], both[:, n_z:], _reading_off(shown, z, y)
    errors = z[1:] - np.hstack([z, u])[:-1] @ both.T
    return LiftedModel(*model, error=_root_mean_square(errors))


class LiftedState:
    """The lifted state z of a loop: what is measured, or outputs and inputs with their past, and observables.

    Parameters
    ----------
    kind : {"measured", "delays"}
        The state x is all that is measured, or ``(y_k ... y_k-d, u_k-1 ... u_k-d)``.
    delays : int
        The d of the latter.
    dictionary : Dictionary
        Observables of x.
    recording : Recording
        The experiment; the window of past samples begins at its end.
    rng : numpy.random.Generator
        Where random parameters of the observables come from.

    Attributes
    ----------
    recorded : array, shape (T - lost, n_z)
        The lifted recording, time along axis 0.
    lost : int
        Number of first samples of the recording that have no past.
    """

    def __init__(
        self,
        kind: StateKind,
        delays: int,
        dictionary: Dictionary,
        recording: Recording,
        rng: np.random.Generator,
    ) -> None:
        self._kind = kind
        delays = delays if kind == "delays" else 0
        memory = memory_of(dictionary)
        states = recording.measured
        if kind == "delays":
            before = np.vstack([recording.u[:1], recording.u[:-1]])
            u_past = embed(before, delays - 1)[-(len(recording) - delays) :]
            states = np.hstack([embed(recording.y, delays), u_past])
            self._y = StateWindow(recording.y[-1 - delays :])
            self._u = StateWindow(before[-delays:])
        self._size = states.shape[1]
        self._states = StateWindow(states[-1 - memory :])
        embedded = embed(states, memory)
        self._observables = dictionary.draw(embedded, rng)
        self.recorded = self._lift(embedded)
        self.lost = delays + memory

    def rest(self, y: FloatArray, measured: FloatArray, u: FloatArray) -> FloatArray:
        """Suppose that y, shape (p,), measured, (q,), and u, (m,), have always been so; return z."""
        if self._kind == "measured":
            return self._lift(self._states.fill(measured))
        return self._lift(self._states.fill(np.concatenate([self._y.fill(y), self._u.fill(u)])))

    def follow(self, y: FloatArray, measured: FloatArray, last_u: FloatArray) -> FloatArray:
        """Take the next sample and the inputs applied before it; return z, shape (n_z,)."""
        if self._kind == "measured":
            return self._lift(self._states.append(measured))
        return self._lift(self._states.append(np.concatenate([self._y.append(y), self._u.append(last_u)])))

    def _lift(self, states: FloatArray) -> FloatArray:
        newest = states[..., : self._size]
        return np.concatenate([newest, self._observables(states)], axis=-1)


def require_samples(samples: int, unknowns: int, who: str) -> None:
    """Check that a least-squares problem has as many equations as unknowns.

    Raises
    ------
    DataError
        The numbers there and needed.
    """
    if samples < unknowns:
        raise DataError(
            f"{who}: {samples} samples are left of the recording for a model of {unknowns} lifted states and "
            "inputs: record longer, or take fewer observables or delays"
        )


def _reading_off(c: FloatArray, z: FloatArray, y: FloatArray) -> FloatArray:
    """Return C with every output that is a lifted state itself read off it.

    Least squares over states that depend on each other, as those of delays do over the recording, would leave
    ``C z`` different from y as soon as a disturbance parts them: an offset.
    """
    for row, output in zip(c, y.T, strict=True):
        same = np.flatnonzero((output == z.T).all(axis=1))
        if same.size:
            row[:] = 0.0
            row[same[0]] = 1.0
    return c


def _least_squares(known: FloatArray, wanted: FloatArray, ridge: float) -> FloatArray:
    size = known.shape[1]
    system = np.vstack([known, np.sqrt(ridge) * np.eye(size)])
    target = np.vstack([wanted, np.zeros((size, wanted.shape[1]))])
    # Least norm: observables that others repeat leave coefficients free.
    solution: FloatArray = np.linalg.lstsq(system, target, rcond=_NEGLIGIBLE)[0]
    return solution


def _root_mean_square(values: FloatArray) -> FloatArray:
    size: FloatArray = np.sqrt(np.square(values).mean(axis=0))
    return np.where(size > 0.0, size, 1.0)
