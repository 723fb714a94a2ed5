"""Which changes of the outputs the free inputs can bring about, as far as a recording tells.

With fewer free inputs than outputs, the outputs can follow in as many directions as inputs are free: those of
their columns in the plant's gain.
"""

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.identification import fit_arx, markov_parameters
from ddpc_cosim import FloatArray, Recording

_FEWEST_SAMPLES = 20
_NEGLIGIBLE = 0.01


def step_gain(recording: Recording, samples: int) -> FloatArray:
    """Return how the outputs answer to a step of each input, shape (p, m), in parts of their recorded spread.

    Parameters
    ----------
    recording : Recording
        The experiment.
    samples : int
        After how many of them, 20 at least; longer than the dead time.
    """
    m, p = recording.u.shape[1], recording.y.shape[1]
    samples = max(samples, _FEWEST_SAMPLES)
    # Twice as many equations as coefficients.
    lags = max(1, min(samples, len(recording) // (2 * (m + p) + 1)))
    gain = markov_parameters(fit_arx(recording, lags).state_space(), samples).sum(axis=0)
    return np.asarray(gain * recording.u.std(axis=0) / spread(recording)[:, np.newaxis])


def spread(recording: Recording) -> FloatArray:
    """Return the standard deviation of each output; 1 where it did not move."""
    deviation = recording.y.std(axis=0)
    return np.where(deviation > 0.0, deviation, 1.0)


def projector(gain: FloatArray, free: NDArray[np.bool_]) -> FloatArray:
    """Return the orthogonal projector onto what the free inputs do, shape (p, p).

    Parameters
    ----------
    gain : array, shape (p, m)
        How the outputs answer to the inputs; what is below a hundredth of its norm counts as none.
    free : array of bool, shape (m,)
        The inputs that are free.
    """
    directions, sizes, _ = np.linalg.svd(gain[:, free], full_matrices=False)
    reached = directions[:, sizes > _NEGLIGIBLE * np.linalg.norm(gain)]
    return np.asarray(reached @ reached.T)
