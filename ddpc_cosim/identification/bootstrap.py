"""How sure a model is: models of data that might have been recorded as well.

One-step errors are white where the model is true: drawn with replacement, and run through the model with
the inputs as they were recorded, they give another recording that might have been, of which a model is made
as of the first (B. Efron, R. Tibshirani, An Introduction to the Bootstrap, 1993, chapter 8). What an
unstable plant does with inputs that were decided for other noise says nothing: there other errors come to the
same past (S. Goncalves, L. Kilian, J. Econometrics 123(1), 2004, doi:10.1016/j.jeconom.2003.10.030: the
fixed-design bootstrap), and the model follows to first order.
"""

from collections.abc import Sequence

import numpy as np

from ddpc_cosim.controller import Recording
from ddpc_cosim.identification.candidates import Candidate, most_moving
from ddpc_cosim.identification.innovation import InnovationModel
from ddpc_cosim.identification.prediction_error import refine
from ddpc_cosim.identification.predictor import Predictor, Samples, scan
from ddpc_cosim.identification.stability import projected
from ddpc_cosim.variables import FloatArray

_FEW_STEPS = 5  # from the model of the recording to that of one like it
_GROWTH = 10.0  # over the longest stretch, above which errors of long ago decide everything
_INTEGRATES = 1e-4
_NEGLIGIBLE = _ROUNDING = 1e-9


def ensemble(
    recording: Recording, candidate: Candidate, members: int, rng: np.random.Generator
) -> tuple[InnovationModel, ...]:
    """Return models of data that might have been recorded as well; see the module.

    Parameters
    ----------
    recording : Recording
        The data.
    candidate : Candidate
        How models are made.
    members : int
        How many.
    rng : numpy.random.Generator
        Draws the errors: of each stretch of a mosaic from those of the stretch.
    """
    fit = candidate.fit
    samples = fit.samples(most_moving(recording))
    predictor = fit.predictor(samples)
    errors = predictor.errors(samples)
    spread = np.sqrt(len(samples) / max(len(samples) - fit.spent(samples), 1.0))
    errors = spread * (errors - errors.mean(axis=0))
    stretches = samples.stretches
    longest = max(rows.stop - rows.start for rows in stretches)
    radius = np.abs(np.linalg.eigvals(predictor.plant())).max()
    follows = longest * np.log(max(radius, 1e-9)) < np.log(_GROWTH)
    linearised = None if follows else fit.linearised(predictor, samples)
    stable = np.abs(np.linalg.eigvals(candidate.model.a)).max() <= 1.0 + _ROUNDING
    models = list[InnovationModel]()
    for _ in range(members):
        drawn = np.concatenate(
            [
                errors[rng.integers(rows.start, rows.stop, rows.stop - rows.start)]
                for rows in samples.stretches
            ]
        )
        if linearised:
            member = linearised(drawn)
        else:
            again = samples.with_outputs(_outputs(predictor, samples, drawn))
            refined = fit.method in ("armax", "hammerstein-wiener")
            member = refine(predictor, again, _FEW_STEPS) if refined else fit.predictor(again)
        models.append(fit.model(projected(member) if stable else member, samples))
    return tuple(models)


def _outputs(predictor: Predictor, samples: Samples, errors: FloatArray) -> FloatArray:
    """Return the outputs that a model has with given one-step errors, shape (T, p)."""
    p = len(predictor.c)
    driven = samples.z[:, : -1 - p] @ predictor.g[:, : -1 - p].T + predictor.g[:, -1]
    driven += (errors + predictor.y_0) @ predictor.gain().T
    explained = samples.y - predictor.errors(samples)
    states = scan(predictor.plant(), driven, samples.stretches)
    for rows in samples.stretches:
        # The initial state is that of the recording, as its first predictions show it.
        length = rows.stop - rows.start
        passive = scan(predictor.a, samples.z[rows] @ predictor.g.T, [slice(0, length)])
        left = explained[rows] - predictor.y_0 - passive @ predictor.c.T
        effect = predictor.initial_effect(length)
        first = np.asarray(np.linalg.lstsq(effect, left.ravel(), rcond=_NEGLIGIBLE)[0], dtype=np.float64)
        states[rows] += scan(predictor.plant(), np.zeros((length, len(first))), [slice(0, length)], first)
    return states @ predictor.c.T + predictor.y_0 + errors


def gains(model: InnovationModel) -> FloatArray:
    """Return by how much outputs change in the end per unit of an input, shape (p, m); NaN if it integrates.

    For a model with static nonlinearities: those of its linear part.
    """
    if np.abs(np.linalg.eigvals(model.a) - 1.0).min() < _INTEGRATES:
        return np.full((len(model.c), model.b.shape[1]), np.nan)
    return np.asarray(model.c @ np.linalg.solve(np.eye(model.order) - model.a, model.b))


def gain_intervals(models: Sequence[InnovationModel], level: float = 0.9) -> tuple[FloatArray, FloatArray]:
    """Return between what gains lie for this share of an ensemble: low and high, shape (p, m) each."""
    every = np.array([gains(model) for model in models])
    low, high = np.quantile(every, [(1.0 - level) / 2.0, (1.0 + level) / 2.0], axis=0)
    return low, high
