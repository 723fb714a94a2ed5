"""Linear models from a recording: an autoregressive model by least squares, realised in state space.

    y_k = sum_i A_i y_k-i + B_i u_k-i + c,   i = 1 ... lags

fits noise-free data of a linear plant exactly where ``lags`` reaches the plant's lag (L. Ljung, System
Identification, 2nd ed., section 7.3). The model can be reduced to fewer states by a balanced realisation
of its impulse response (J.-N. Juang, R. S. Pappa, J. Guidance 8(5), 1985, doi:10.2514/3.20031).
"""

from dataclasses import dataclass

import numpy as np

from ddpc_controllers.control_api import realise
from ddpc_controllers.models import SampledModel
from ddpc_controllers.recorded import matching_recording
from ddpc_cosim import DataError, FloatArray, Loop, Recording, check_settings, setting

_AT_REST = 1e-8
_NEGLIGIBLE = 1e-10


@dataclass(frozen=True, kw_only=True)
class Identified:
    """A model identified from the loop's recording."""

    lags: int = setting(4, low=1, doc="past samples that the outputs are explained by")
    order: int = setting(0, low=0, doc="states kept by balanced reduction; 0: all, lags x outputs")
    ridge: float = setting(0.0, low=0.0, doc="weight of the squared coefficients in the least squares")

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def uses_recording(self) -> bool:
        """Whether the loop needs a recording: it does."""
        return True

    def recording_length(self, inputs: int, outputs: int) -> int:
        """Return the samples at which there are as many equations as coefficients."""
        return self.lags + self.lags * (inputs + outputs) + 1

    def model(self, loop: Loop) -> SampledModel:
        """Identify the model; see :class:`~ddpc_controllers.models.ModelSource`."""
        recording = matching_recording(loop, "Identified")
        needed = self.recording_length(recording.u.shape[1], recording.y.shape[1])
        if len(recording) < needed:
            raise DataError(
                f"Identified: the recording has {len(recording)} samples; {self.lags} lags take at least "
                f"{needed}: record longer, or lower lags"
            )
        arx = fit_arx(recording, self.lags, self.ridge)
        model = arx.state_space()
        return reduced(model, self.order)


@dataclass(frozen=True, slots=True)
class ARX:
    """An autoregressive model with inputs.

    Parameters
    ----------
    past_y : array, shape (lags, p, p)
        A_1, A_2, ...
    past_u : array, shape (lags, p, m)
        B_1, B_2, ...
    constant : array, shape (p,)
        c.
    error : array, shape (p,)
        Root mean square of the one-step prediction errors.
    """

    past_y: FloatArray
    past_u: FloatArray
    constant: FloatArray
    error: FloatArray

    def state_space(self) -> SampledModel:
        """Return the model in observer form, about an operating point at which it rests."""
        lags, p, m = self.past_u.shape
        a = np.zeros((lags * p, lags * p))
        a[:, :p] = self.past_y.reshape(lags * p, p)
        a[:-p, p:] = np.eye((lags - 1) * p)
        b = self.past_u.reshape(lags * p, m)
        u_0, y_0 = self._operating_point()
        return SampledModel(a, b, np.eye(p, lags * p), u_0, y_0)

    def _operating_point(self) -> tuple[FloatArray, FloatArray]:
        """Return inputs and outputs, the nearest to zero, at which the model with its constant rests."""
        p, m = self.past_u.shape[1:]
        gain = np.hstack([-self.past_u.sum(axis=0), np.eye(p) - self.past_y.sum(axis=0)])
        rest, *_ = np.linalg.lstsq(gain, self.constant, rcond=_AT_REST)
        return rest[:m], rest[m:]


def fit_arx(recording: Recording, lags: int, ridge: float = 0.0) -> ARX:
    """Fit an autoregressive model to a recording by regularised least squares.

    Parameters
    ----------
    recording : Recording
        The experiment.
    lags : int
        Number of past samples.
    ridge : float
        Weight of the squared coefficients, for signals scaled to unit size; the constant goes free.
    """
    u, y = recording.u, recording.y
    m, p, rows = u.shape[1], y.shape[1], len(u) - lags
    means = np.concatenate([y.mean(axis=0), u.mean(axis=0)])
    size = np.maximum(np.concatenate([y.std(axis=0), u.std(axis=0)]), np.finfo(float).tiny)
    size[size < _NEGLIGIBLE * np.maximum(np.abs(means), 1.0)] = 1.0
    signals = (np.hstack([y, u]) - means) / size
    past = np.hstack([signals[lags - i : lags - i + rows] for i in range(1, lags + 1)] + [np.ones((rows, 1))])
    penalty = np.sqrt(ridge) * np.eye(past.shape[1] - 1, past.shape[1])
    system = np.vstack([past, penalty])
    target = np.vstack([signals[lags:, :p], np.zeros((len(penalty), p))])
    # Least norm: data of a plant with fewer lags leave coefficients free.
    solution, *_ = np.linalg.lstsq(system, target, rcond=_NEGLIGIBLE)
    error = (past @ solution - target[:rows]) * size[:p]

    coefficients = solution[:-1].reshape(lags, p + m, p).transpose(0, 2, 1)  # lag, output, signal
    coefficients = coefficients * size[:p, np.newaxis] / size
    constant = means[:p] + solution[-1] * size[:p] - (coefficients @ means).sum(axis=0)
    return ARX(
        past_y=coefficients[..., :p],
        past_u=coefficients[..., p:],
        constant=constant,
        error=np.sqrt(np.square(error).mean(axis=0)),
    )


def markov_parameters(model: SampledModel, count: int) -> FloatArray:
    """Return ``C A^i B`` for i = 0 ... count - 1, shape (count, p, m)."""
    response = np.empty((count, len(model.c), model.b.shape[1]))
    states = model.b
    for i in range(count):
        response[i] = model.c @ states
        states = model.a @ states
    return response


def reduced(model: SampledModel, order: int) -> SampledModel:
    """Return the balanced model of an impulse response with ``order`` states; 0: the model as it is.

    States that the inputs do not reach or the outputs do not show are the first to go.
    """
    if not 0 < order < len(model.a):
        return model
    response = markov_parameters(model, 2 * len(model.a) + 1)
    a, b, c = realise(response, order)
    return SampledModel(a, b, c, model.u_0, model.y_0)
