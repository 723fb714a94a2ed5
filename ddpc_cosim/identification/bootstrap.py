"""How sure a model is: models of data that might have been recorded as well.

One-step errors are drawn with replacement, and run through the model with the inputs as they were recorded
they give another recording that might have been, of which a model is made as of the first (B. Efron, R.
Tibshirani, An Introduction to the Bootstrap, 1993, chapter 8). Where the model is true they are white; where
something slow acts on the plant that no model of few coefficients explains they are not, and blocks of them
are drawn, which keep what neighbours have in common (R. Brueggemann, C. Jentsch, C. Trenkler, J.
Econometrics 191(1), 2016, doi:10.1016/j.jeconom.2015.10.004). What an
unstable plant does with inputs that were decided for other noise says nothing: there other errors come to the
same past (S. Goncalves, L. Kilian, J. Econometrics 123(1), 2004, doi:10.1016/j.jeconom.2003.10.030: the
fixed-design bootstrap), and the model follows to first order.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import DataError
from ddpc_cosim.identification.candidates import Candidate, most_moving
from ddpc_cosim.identification.innovation import PlantModel, rows_of
from ddpc_cosim.identification.koopman import MOST_ROWS, KoopmanFit, LiftedModel
from ddpc_cosim.identification.prediction_error import refine
from ddpc_cosim.identification.predictor import Predictor, Samples, scan
from ddpc_cosim.identification.stability import projected
from ddpc_cosim.variables import FloatArray
from ddpc_cosim.windows import window_starts

_FEW_STEPS = 5  # from the model of the recording to that of one like it
_TRIES = 3  # of a Koopman model that does not run away
_GROWTH = 10.0  # over the longest stretch, above which errors of long ago decide everything
_INTEGRATES = 1e-4
_FORGOTTEN = 0.1  # after a sample: poles below are of no account
_APART = 0.9
_NEGLIGIBLE = _ROUNDING = 1e-9


def ensemble(
    recording: Recording, candidate: Candidate, members: int, rng: np.random.Generator
) -> tuple[PlantModel, ...]:
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
    fit, recording = candidate.fit, most_moving(recording)
    if isinstance(fit, KoopmanFit):
        return _lifted_ensemble(fit, rows_of(recording, slice(MOST_ROWS)), members, rng)
    samples = fit.samples(recording)
    predictor = fit.predictor(samples)
    errors = _centred(predictor.errors(samples), fit.spent(samples))
    longest = max(rows.stop - rows.start for rows in samples.stretches)
    radius = np.abs(np.linalg.eigvals(predictor.plant())).max()
    follows = longest * np.log(max(radius, 1e-9)) < np.log(_GROWTH)
    linearised = None if follows else fit.linearised(predictor, samples)
    stable = np.abs(np.linalg.eigvals(candidate.model.linear_part()[0])).max() <= 1.0 + _ROUNDING
    models = list[PlantModel]()
    for _ in range(members):
        drawn = _drawn(errors, samples.stretches, rng)
        if linearised:
            member = linearised(drawn)
        else:
            again = samples.with_outputs(_outputs(predictor, samples, drawn))
            refined = fit.method in ("armax", "hammerstein-wiener")
            member = refine(predictor, again, _FEW_STEPS) if refined else fit.predictor(again)
        models.append(fit.model(projected(member) if stable else member, samples))
    return tuple(models)


def _lifted_ensemble(
    fit: KoopmanFit, recording: Recording, members: int, rng: np.random.Generator
) -> tuple[LiftedModel, ...]:
    """Return Koopman models of data that might have been recorded as well, none of which runs away.

    Raises
    ------
    DataError
        Most of them do.
    """
    model = fit(recording)
    # The errors of the first rows are those of an initial state that was made for them.
    known = window_starts(len(recording), fit.order + 1, recording.seams) + fit.order
    errors = _centred(model.one_step_errors(recording)[known], len(fit.lift.factors))
    starts = [model.first_state(piece) for piece in recording.pieces]
    models = list[LiftedModel]()
    for _ in range(_TRIES * members):
        if len(models) == members:
            break
        y = [
            model.simulate(piece.u, piece.d, _in_blocks(errors, len(piece), rng), start)
            for piece, start in zip(recording.pieces, starts, strict=True)
        ]
        again = replace(recording, y=np.vstack(y), measured=np.vstack(y))
        member = fit(again)
        if not member.runs_away(again):
            models.append(member)
    if len(models) < members:
        raise DataError(
            "most Koopman models of data like these run away when they are simulated: log more, or take "
            "another method"
        )
    return tuple(models)


def _centred(errors: FloatArray, spent: float) -> FloatArray:
    """Return errors off their mean, and as large as before coefficients have explained some of them."""
    spread = np.sqrt(len(errors) / max(len(errors) - spent, 1.0))
    return np.asarray(spread * (errors - errors.mean(axis=0)))


def _drawn(errors: FloatArray, stretches: Sequence[slice], rng: np.random.Generator) -> FloatArray:
    """Return errors in blocks with replacement, of each stretch from those of the stretch."""
    return np.concatenate([_in_blocks(errors[rows], rows.stop - rows.start, rng) for rows in stretches])


def _in_blocks(errors: FloatArray, rows: int, rng: np.random.Generator) -> FloatArray:
    """Return so many rows of blocks that begin anywhere; the first row follows on the last.

    Their length is of the order that suits a variance best (P. Hall, J. Horowitz, B.-Y. Jing, Biometrika
    82(3), 1995).
    """
    length = math.ceil(len(errors) ** (1.0 / 3.0))
    begins = rng.integers(0, len(errors), -(-rows // length))
    places = (begins[:, np.newaxis] + np.arange(length)).ravel()[:rows]
    return np.asarray(errors[places % len(errors)])


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


def gains(model: PlantModel) -> FloatArray:
    """Return by how much outputs change in the end per unit of an input, shape (p, m); NaN if it integrates.

    For a model with nonlinearities: those of its linear part.
    """
    a, b, c = model.linear_part()
    if np.abs(np.linalg.eigvals(a) - 1.0).min() < _INTEGRATES:
        return np.full((len(c), b.shape[1]), np.nan)
    return np.asarray(c @ np.linalg.solve(np.eye(model.order) - a, b))


def gain_intervals(models: Sequence[PlantModel], level: float = 0.9) -> tuple[FloatArray, FloatArray]:
    """Return the ends of intervals of gains, low and high, shape (p, m) each, from an ensemble."""
    return interval(np.array([gains(model) for model in models]), level)


def interval(values: FloatArray, level: float = 0.9) -> tuple[FloatArray, FloatArray]:
    """Return the ends of an interval that holds the true value in this share of recordings.

    Models of drawn data are off the model that drew them as that one is off the plant, in bias too: their
    quantiles are turned about it (A. Davison, D. Hinkley, Bootstrap Methods and their Application, 1997,
    section 5.2.1). A quantile has its rank in one value more than there are, since with the order statistics'
    own ranks those of few models lie too far inside.

    Parameters
    ----------
    values : array, shape (models, ...)
        A quantity of the model of all data, then of each of the others.
    level : float
        The share.

    Returns
    -------
    low, high : array, shape of a value
        Not finite where more models than are left out are infinite; NaN without other models, or where one is
        not known.
    """
    estimate, others = values[0], values[1:]
    if not len(others):
        return np.full_like(estimate, np.nan), np.full_like(estimate, np.nan)
    with np.errstate(invalid="ignore"):
        near, far = np.quantile(others, [(1.0 - level) / 2.0, (1.0 + level) / 2.0], axis=0, method="weibull")
        return np.asarray(2.0 * estimate - far), np.asarray(2.0 * estimate - near)


def matched_poles(
    models: Sequence[PlantModel], most: int
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the slowest poles of the first model, and those of every model that belong to them.

    Of a complex pair it is the one of positive angle. Each pole of a model belongs to one of the first's, so
    that all together are as near as can be.

    Returns
    -------
    poles : complex array, shape (at most ``most``,)
        The slowest first.
    others : complex array, shape (models, poles)
        NaN for a pole that is not told apart: whose counterpart is nearer to another pole of the first model,
        or makes a complex pair of a real pole, in more than a tenth of the models.
    """
    from scipy.optimize import linear_sum_assignment  # most commands do without

    every = [np.linalg.eigvals(model.linear_part()[0]) for model in models]
    first = every[0]
    # Dead times are poles at zero, which are known.
    shown = np.flatnonzero((first.imag >= 0.0) & (np.abs(first) > _FORGOTTEN))
    shown = shown[np.argsort(-np.abs(first[shown]))][:most]
    others = np.empty((len(models), len(shown)), dtype=np.complex128)
    apart = np.empty(others.shape, dtype=bool)
    for i, poles in enumerate(every):
        distances = np.abs(first[:, np.newaxis] - poles)
        partner = np.empty(len(first), dtype=int)
        rows, columns = linear_sum_assignment(distances)
        partner[rows] = columns
        others[i] = poles[partner[shown]]
        nearest = np.abs(first[:, np.newaxis] - others[i]).argmin(axis=0)
        apart[i] = (nearest == shown) & ((others[i].imag == 0.0) == (first[shown].imag == 0.0))
    others[:, apart.mean(axis=0) < _APART] = np.nan
    return np.asarray(first[shown], dtype=np.complex128), others
