"""How a model is made of a recording: the methods, by name."""

from dataclasses import dataclass, replace

import numpy as np

from ddpc_cosim.controller import Recording
from ddpc_cosim.identification.arx import MOST_LAGS, choose_lags, fit_arx, linearised_arx, most_lags
from ddpc_cosim.identification.innovation import InnovationModel, StaticMap
from ddpc_cosim.identification.nonlinear import inverse
from ddpc_cosim.identification.prediction_error import linearised, refine
from ddpc_cosim.identification.predictor import Predictor, Refit, Samples
from ddpc_cosim.identification.stability import settled
from ddpc_cosim.identification.subspace import from_states, state_sequence
from ddpc_cosim.variables import FloatArray

METHODS = {
    "arx": "ARX",
    "armax": "ARMAX in state space",
    "subspace": "subspace",
    "hammerstein-wiener": "Hammerstein-Wiener",
    "koopman": "Koopman",
}
"""Names of methods in study files, and for people."""
MOST_STATES = 10
"""The most states that are tried."""


@dataclass(frozen=True, slots=True)
class Fit:
    """How a model is made of a recording: by which method, how large, with which dead times.

    Parameters
    ----------
    method : str
        One of :data:`METHODS`, but for ``"koopman"``.
    order : int
        Lags of an autoregressive model, states of the others.
    delays : tuple of int
        Dead time of every input, in samples; none: 0.
    input_map, output_map : StaticMap, optional
        The nonlinearities of a Hammerstein-Wiener model, which are held where the linear part is made anew.
    """

    method: str
    order: int
    delays: tuple[int, ...] = ()
    input_map: StaticMap | None = None
    output_map: StaticMap | None = None

    def __call__(self, recording: Recording) -> InnovationModel:
        """Return the model of a recording.

        Raises
        ------
        DataError
            It is too short.
        """
        samples = self.samples(recording)
        return self.model(self.settled(self.predictor(samples), samples)[0], samples)

    def samples(self, recording: Recording) -> Samples:
        """Return a recording as the linear part sees it."""
        if self.input_map:
            recording = replace(recording, u=self.input_map(recording.u))
        if self.output_map:
            recording = replace(recording, y=inverse(self.output_map)(recording.y))
        return Samples.of(recording, self.delays)

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

    def settled(self, predictor: Predictor, samples: Samples) -> tuple[Predictor, tuple[str, ...]]:
        """Return a predictor without poles that are unstable only by chance, and what was done."""
        return settled(predictor, samples, self.linearised, predictor.errors(samples))

    def model(self, predictor: Predictor, samples: Samples) -> InnovationModel:
        """Return a predictor that was found by this method as a model."""
        model = predictor.model(samples, self.method, self.spent(samples))
        if self.output_map:
            # Errors are those of the outputs: as large as the map is steep.
            slopes = [
                np.ptp(values) / np.ptp(points)
                for points, values in zip(self.output_map.points, self.output_map.values, strict=True)
            ]
            covariance = model.covariance * np.outer(slopes, slopes)
            model = replace(model, k=model.k / slopes, covariance=covariance, output_map=self.output_map)
        return replace(model, input_map=self.input_map)

    def spent(self, samples: Samples) -> float:
        """Return how many coefficients each output has, with those of initial states."""
        m, n_d, p = samples.counts
        if self.method == "arx":
            return self.order * (m + n_d + p) + 1 + self.order * len(samples.stretches)
        return self.order * (m + n_d + 2 * p + len(samples.stretches)) / p + 1

    @property
    def is_nonlinear(self) -> bool:
        """Whether it has nonlinearities."""
        return self.input_map is not None or self.output_map is not None

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
