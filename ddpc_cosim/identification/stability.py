"""Poles that noise has put outside the unit circle.

An estimated pole at 1.002 may belong to a plant that integrates, or hardly damps an oscillation: its model
ends in infinity all the same. How sure a pole is, other errors that come to the same past say; one whose
interval reaches the unit circle is put on it if it is real, which keeps an integrator one, and else
mirrored into it, which keeps the shape of the frequency response. Poles that are outside for sure stay
where they are, as does every pole where the log itself runs away.
"""

from collections.abc import Callable

import numpy as np

from ddpc_cosim.identification.predictor import Predictor, Refit, Samples
from ddpc_cosim.variables import FloatArray

_DRAWS = 40
_SEED = 1
_SURE = 2.0  # standard deviations
_ROUNDING = 1e-9
_RUNS_AWAY = 3.0  # how much larger the end of a log is than what was before it


def settled(
    predictor: Predictor,
    samples: Samples,
    linearised: Callable[[Predictor, Samples], Refit],
    errors: FloatArray,
) -> tuple[Predictor, tuple[str, ...]]:
    """Return a predictor without poles that are unstable only by chance, and what was done.

    Parameters
    ----------
    predictor : Predictor
        The estimate.
    samples : Samples
        What it was estimated from.
    linearised : callable
        Says what it becomes with other errors; asked only where a pole is outside.
    errors : array, shape (T, p)
        Its one-step errors.
    """
    poles = np.linalg.eigvals(predictor.plant())
    outside = poles[np.abs(poles) > 1.0 + _ROUNDING]
    if not outside.size or _runs_away(samples):
        return predictor, ()
    refit, rng = linearised(predictor, samples), np.random.default_rng(_SEED)
    draws = [refit(rng.permutation(errors)).plant() for _ in range(_DRAWS)]
    others = np.array([np.linalg.eigvals(draw) for draw in draws])
    nearest = [others[np.arange(_DRAWS), np.abs(others - pole).argmin(axis=1)] for pole in outside]
    spreads = np.abs(nearest).std(axis=1)
    if (np.abs(outside) - _SURE * spreads > 1.0).any():
        return predictor, ()
    new = projected(predictor)
    notes = [
        f"a pole was estimated at radius {abs(pole):.4f} +- {spread:.4f}, which includes the unit circle, "
        f"and the log stays within bounds: it was {'put on it' if _is_real(pole) else 'mirrored into it'}"
        for pole, spread in zip(outside, spreads, strict=True)
        if pole.imag >= 0.0
    ]
    return new, tuple(notes) if new is not predictor else ()


def projected(predictor: Predictor) -> Predictor:
    """Return a predictor without poles outside the unit circle; itself, where it would not stay stable."""
    poles, modes = np.linalg.eig(predictor.plant())
    outside = np.abs(poles) > 1.0 + _ROUNDING
    if not outside.any():
        return predictor
    inside = np.array([1.0 if _is_real(pole) and pole.real > 0.0 else 1.0 / np.conj(pole) for pole in poles])
    plant = ((modes * np.where(outside, inside, poles)) @ np.linalg.inv(modes)).real
    new = Predictor(plant - predictor.gain() @ predictor.c, predictor.g, predictor.c, predictor.y_0)
    return new if new.is_stable() else predictor


def _is_real(pole: complex) -> bool:
    return abs(pole.imag) <= _ROUNDING * abs(pole)


def _runs_away(samples: Samples) -> bool:
    """Return whether the end of the longest stretch is far beyond what came before it."""
    longest = max(samples.stretches, key=lambda rows: rows.stop - rows.start)
    size = np.abs(samples.y[longest] - samples.y[longest].mean(axis=0))
    end = max(len(size) // 4, 1)
    before = size[:-end].max(axis=0, initial=0.0)
    return bool((size[-end:].max(axis=0) > _RUNS_AWAY * before).any())
