"""How a model is made of a recording: the methods, by name."""

from dataclasses import dataclass

from ddpc_cosim.controller import Recording
from ddpc_cosim.identification.arx import MOST_LAGS, choose_lags, fit_arx, linearised_arx, most_lags
from ddpc_cosim.identification.innovation import InnovationModel
from ddpc_cosim.identification.prediction_error import linearised, refine
from ddpc_cosim.identification.predictor import Predictor, Refit, Samples
from ddpc_cosim.identification.subspace import from_states, state_sequence
from ddpc_cosim.variables import FloatArray

METHODS = {"arx": "ARX", "armax": "ARMAX in state space", "subspace": "subspace"}
"""Names of methods in study files, and for people."""
MOST_STATES = 10
"""The most states that are tried."""


@dataclass(frozen=True, slots=True)
class Fit:
    """How a model is made of a recording: by which method, how large, with which dead times.

    Parameters
    ----------
    method : str
        One of :data:`METHODS`.
    order : int
        Lags of an autoregressive model, states of the others.
    delays : tuple of int
        Dead time of every input, in samples; none: the method looks for none.
    """

    method: str
    order: int
    delays: tuple[int, ...] = ()

    def __call__(self, recording: Recording) -> InnovationModel:
        """Return the model of a recording.

        Raises
        ------
        DataError
            It is too short.
        """
        samples = Samples.of(recording, self.delays)
        return self.model(self.predictor(samples), samples)

    def predictor(self, samples: Samples) -> Predictor:
        """Return the predictor that explains samples best."""
        if self.method == "arx":
            return fit_arx(samples, self.order)
        return self.from_sequence(samples, *sequence(samples, self.order))

    def from_sequence(self, samples: Samples, states: FloatArray, lags: int) -> Predictor:
        """Return the same of the states that precede it; see :func:`state_sequence`."""
        start = from_states(samples, states[:, : self.order], lags)
        return start if self.method == "subspace" else refine(start, samples)

    def linearised(self, predictor: Predictor, samples: Samples) -> Refit:
        """Return what a predictor becomes where other errors had come to the same past."""
        of = linearised_arx if self.method == "arx" else linearised
        return of(predictor, samples)

    def model(self, predictor: Predictor, samples: Samples) -> InnovationModel:
        """Return a predictor that was found by this method as a model."""
        return predictor.model(samples, self.method, self.spent(samples))

    def spent(self, samples: Samples) -> float:
        """Return how many coefficients each output has, with those of initial states."""
        m, n_d, p = samples.counts
        if self.method == "arx":
            return self.order * (m + n_d + p) + 1 + self.order * len(samples.stretches)
        return self.order * (m + n_d + 2 * p + len(samples.stretches)) / p + 1

    @property
    def words(self) -> str:
        """Method, order and dead times for people."""
        size = "lag" if self.method == "arx" else "state"
        dead = f", dead times of {list(self.delays)} samples" if any(self.delays) else ""
        return f"{METHODS[self.method]}, {self.order} {size}{'' if self.order == 1 else 's'}{dead}"


def sequence(samples: Samples, order: int) -> tuple[FloatArray, int]:
    """Return the states of a subspace method, shape (rows, at least order), and the lags they come from."""
    lags = max(choose_lags(samples), -(-order // samples.counts[2]), min(MOST_STATES, most_lags(samples)))
    return state_sequence(samples, min(lags, MOST_LAGS))[0], min(lags, MOST_LAGS)
