"""Models of a recording by several methods, each judged on a stretch that it has not seen.

Of every method, the few orders that Schwarz's criterion likes best are judged by how well they predict up
to a horizon. That is asked of blocks of the held-out stretch, so that what one model is better than another
can be told from chance: a model that is not clearly better than a smaller one comes after it (T. Hastie, R.
Tibshirani, J. Friedman, The Elements of Statistical Learning, 2nd ed., section 7.10: the rule of one
standard error).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.identification.arx import choose_delays, choose_lags, most_lags, schwarz
from ddpc_cosim.identification.fits import METHODS, MOST_STATES, Fit, sequence
from ddpc_cosim.identification.innovation import PlantModel, rows_of
from ddpc_cosim.identification.koopman import MOST_ROWS as MOST_LIFTED, KoopmanFit, koopman_models
from ddpc_cosim.identification.nonlinear import input_map_of, output_map_of
from ddpc_cosim.identification.prediction_error import refine, used_rows
from ddpc_cosim.identification.predictor import Predictor, Samples
from ddpc_cosim.variables import FloatArray
from fmu_plants.spelling import did_you_mean

HELD_OUT = 0.25
"""The last part of the data, on which models of the rest are judged."""
HORIZON = 20
"""How many samples ahead models are judged."""
_MOST_JUDGED = 3000  # rows of the held-out stretch
_SHORTLIST = 3
_BLOCKS = 8
_EXACT = 1e-9
_NEEDED = (1.0, 2.0, 3.5)  # standard errors, by kind; the last: 99.5 % of Student's t over eight blocks
_MOST_MAPPED = 3000  # rows
MOST_ROWS = 10_000
"""The most rows that models are made of: the block in which the inputs move most."""
_HASTE = 2  # rounds


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A method with its order, its model of all data, and how a model of the first part did on the rest.

    Parameters
    ----------
    fit : Fit
        Makes its model of other data, by the same method, of the same order.
    model : InnovationModel
        Its model of all data.
    errors : array, shape (horizon, p)
        Root mean square error on the held-out stretch, of what is predicted 1 ... horizon samples ahead.
    held_out : array, shape (p,)
        ``100 (1 - error / standard deviation)`` of each output there [%], over all of the horizon: 100 is all
        explained, 0 as much as the mean explains.
    by_block : array, shape (blocks,)
        Error in blocks of the held-out stretch: geometric mean over horizon and outputs, in parts of the
        outputs' standard deviations.
    rows : int
        Samples that a search for coefficients has used; the others are in the data, and left out of it.
    notes : tuple of str
        What a reader should know of the model: poles that were moved.
    """

    fit: Fit | KoopmanFit
    model: PlantModel
    errors: FloatArray
    held_out: FloatArray
    by_block: FloatArray
    rows: int
    notes: tuple[str, ...] = ()

    @property
    def method(self) -> str:
        """Its name in study files: ``"arx"``."""
        return self.fit.method

    @property
    def order(self) -> int:
        """What its size is told by: lags, or states."""
        return self.fit.order

    @property
    def is_nonlinear(self) -> bool:
        """Whether it has nonlinearities."""
        return self.kind > 0

    @property
    def kind(self) -> int:
        """What it is: linear, linear between nonlinearities of each signal, or with products of signals."""
        return 2 if isinstance(self.fit, KoopmanFit) else int(self.fit.is_nonlinear)

    @property
    def error(self) -> float:
        """Geometric mean of the errors in blocks."""
        return float(np.exp(np.log(self.by_block).mean()))

    @property
    def words(self) -> str:
        """Method and order for people."""
        return self.fit.words

    def excess(self, other: "Candidate") -> tuple[float, float]:
        """Return by how much its error is larger, as a logarithm, and the standard error of that.

        That is infinite where the stretch is too short to be parted: then no difference is more than chance.
        """
        differences = np.log(self.by_block / other.by_block)
        blocks = len(differences)
        spread = differences.std(ddof=1) if blocks > 1 else np.inf
        return float(differences.mean()), float(spread / np.sqrt(blocks))


def candidates(
    recording: Recording, method: str = "auto", order: int = 0, horizon: int = HORIZON
) -> tuple[Candidate, ...]:
    """Return models of a recording, that which predicts best on the held-out stretch first.

    Parameters
    ----------
    recording : Recording
        The data.
    method : str
        One of :data:`METHODS`, or ``"auto"``: all.
    order : int
        Lags or states; 0: by the data.
    horizon : int
        How many samples ahead they are judged.

    Raises
    ------
    ConfigError
        There is no such method.
    DataError
        There are not enough data, or an output does not move where models are judged.
    """
    if method not in (*METHODS, "auto"):
        raise ConfigError(f'method: "{method}" is unknown; {did_you_mean(method, ["auto", *METHODS])}')
    first, rest = parted(recording)
    rest = rows_of(rest, slice(_MOST_JUDGED))
    if not rest.y.std(axis=0).all():
        raise DataError(
            "an output never moves on the last quarter of the data, so no model can be judged there"
        )
    first = most_moving(first)
    samples = Samples.of(first)
    samples = Samples.of(first, choose_delays(samples))
    tried: dict[str, list[tuple[Fit, Predictor, Samples]]] = {}
    best = list[Candidate]()
    for name in METHODS if method == "auto" else [method]:
        models: Sequence[tuple[Fit | KoopmanFit, PlantModel]]
        if name == "koopman":
            models = koopman_models(first, samples.delays, order, wanted=method != "auto")
        else:
            if name == "hammerstein-wiener":
                linear = tried.get("armax") or _linear_fits("armax", samples, order)
                tried[name] = _nonlinear_fits(first, linear, wanted=method != "auto")
            else:
                tried[name] = _linear_fits(name, samples, order)
            models = [
                (fit, fit.model(fit.settled(predictor, seen)[0], seen))
                for fit, predictor, seen in tried[name]
            ]
        judged = [_judged(fit, model, rest, horizon) for fit, model in models]
        best += ranked(judged)[:1] if judged else []
    if not best:
        raise DataError(
            "every Koopman model of the data runs away when it is simulated: log more, or take another method"
        )
    return ranked([_of_all(candidate, recording) for candidate in best])


def ranked(judged: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Return candidates by their error; of those as good as the best but for chance, the smallest first.

    Nonlinearities have to be better than what has none by two standard errors, and products of signals better
    than both by 3.5: there are many of them, of which one fits the data that happen to be held out.
    """
    by_error = sorted(judged, key=lambda candidate: candidate.error)
    best = by_error[0]

    def place(candidate: Candidate) -> tuple[bool, float, float]:
        excess, chance = candidate.excess(best)
        needed = _NEEDED[best.kind if candidate.kind < best.kind else 0]
        if excess > needed * chance:
            return True, candidate.error, 0.0
        return False, candidate.kind, candidate.model.order

    return tuple(sorted(by_error, key=place))


def _linear_fits(method: str, samples: Samples, order: int) -> list[tuple[Fit, Predictor, Samples]]:
    """Return how models of a method are made, of the orders that seem best, their predictors, and of what."""
    if method == "arx":
        lags = [order] if order else sorted({choose_lags(samples), most_lags(samples)})
        fits = [Fit(method, n, samples.delays) for n in lags]
        return [(fit, fit.predictor(samples), samples) for fit in fits]
    states, lags_before = sequence(samples, order or MOST_STATES)
    orders = [order] if order else range(1, min(MOST_STATES, states.shape[1]) + 1)
    subspace = [Fit("subspace", n, samples.delays) for n in orders]
    predictors = [fit.from_sequence(samples, states, lags_before) for fit in subspace]
    criterion = [
        _criterion(fit, predictor, samples) for fit, predictor in zip(subspace, predictors, strict=True)
    ]
    best = int(np.argmin(criterion))
    near = range(max(best - _SHORTLIST // 2, 0), min(best + _SHORTLIST // 2 + 1, len(subspace)))
    if method == "subspace":
        return [(subspace[i], predictors[i], samples) for i in near]
    return [(replace(subspace[i], method=method), refine(predictors[i], samples), samples) for i in near]


def _nonlinear_fits(
    recording: Recording, linear: list[tuple[Fit, Predictor, Samples]], *, wanted: bool
) -> list[tuple[Fit, Predictor, Samples]]:
    """Return Hammerstein models about the linear one of smallest criterion, and with maps of outputs too.

    Where they are not wanted in any case: no map of the inputs, if one found in haste does not explain more
    than as many coefficients do by chance.
    """
    criterion = [_criterion(fit, predictor, samples) for fit, predictor, samples in linear]
    chosen, start, _ = linear[int(np.argmin(criterion))]
    recording = rows_of(recording, slice(_MOST_MAPPED))
    fit = replace(chosen, method="hammerstein-wiener")
    samples = fit.samples(recording)
    predictor = refine(start, samples)
    before = _criterion(fit, predictor, samples)
    curve, hasty = input_map_of(recording, predictor, fit.delays, _HASTE)
    bent = replace(fit, input_map=curve)
    spent = sum(map(len, curve.points)) * np.log(len(samples))
    fits = list[tuple[Fit, Predictor, Samples]]()
    if wanted or _criterion(bent, hasty, bent.samples(recording)) + spent < before:
        curve, predictor = input_map_of(recording, predictor, fit.delays)
        fit = replace(fit, input_map=curve)
        samples = fit.samples(recording)
        fits.append((fit, predictor, samples))
    if predictor.plant_is_stable():
        model = fit.model(predictor, samples)
        pieces = [model.simulate(part.u, part.d, x=model.first_state(part)) for part in recording.pieces]
        fit = replace(fit, output_map=output_map_of(recording, np.vstack(pieces)))
        samples = fit.samples(recording)
        fits.append((fit, refine(predictor, samples), samples))
    return fits


def _criterion(fit: Fit, predictor: Predictor, samples: Samples) -> float:
    coefficients = round(fit.spent(samples) * samples.counts[2])
    return schwarz(predictor.errors(samples), len(samples), coefficients)


def _judged(fit: Fit | KoopmanFit, model: PlantModel, rest: Recording, horizon: int) -> Candidate:
    squares = squares_ahead(model, rest, horizon)
    size = rest.y.std(axis=0)
    errors = np.sqrt(squares.mean(axis=0))
    held_out = 100.0 * (1.0 - np.sqrt(squares.mean(axis=(0, 1))) / size)
    blocks = [block.mean(axis=0) for block in np.array_split(squares, min(_BLOCKS, len(squares)))]
    by_block = [np.exp(np.log(np.sqrt(block) / size + _EXACT).mean()) for block in blocks]
    return Candidate(fit, model, errors, held_out, np.array(by_block), 0)


def _of_all(candidate: Candidate, recording: Recording) -> Candidate:
    """Return a candidate with its model of all data."""
    fit, recording = candidate.fit, most_moving(recording)
    if isinstance(fit, KoopmanFit):
        return replace(candidate, model=fit(recording), rows=min(len(recording), MOST_LIFTED))
    samples = fit.samples(recording)
    rows = len(samples)
    if fit.method in ("armax", "hammerstein-wiener"):
        used = used_rows(samples, fit.order)
        rows = used.stop - used.start
    predictor, notes = fit.settled(fit.predictor(samples), samples)
    return replace(candidate, model=fit.model(predictor, samples), rows=rows, notes=notes)


def squares_ahead(model: PlantModel, recording: Recording, horizon: int) -> FloatArray:
    """Return squared errors of predictions, shape (instants, horizon, p).

    Parameters
    ----------
    model : InnovationModel
        What predicts.
    recording : Recording
        Data that it has not seen.
    horizon : int
        Predicted are 1 ... horizon samples ahead, from every instant after which there are so many; fewer
        where no stretch is that long.
    """
    horizon = min(horizon, max(len(piece) for piece in recording.pieces))
    squares = list[FloatArray]()
    for piece in recording.pieces:
        if instants := max(len(piece) - horizon + 1, 0):
            states, driven = model.observed(piece)[:instants], model.driven(piece.u, piece.d)
            errors = list[FloatArray]()
            for i in range(horizon):
                errors.append(piece.y[i : i + instants] - model.output(states))
                states = model.onward(states, driven[i : i + instants])
            squares.append(np.square(np.stack(errors, axis=1)))
    return np.concatenate(squares)


def parted(recording: Recording) -> tuple[Recording, Recording]:
    """Return the first part of a recording, and the stretch that is held out."""
    seen = len(recording) - max(round(HELD_OUT * len(recording)), 1)
    return rows_of(recording, slice(seen)), rows_of(recording, slice(seen, None))


def most_moving(recording: Recording) -> Recording:
    """Return the rows that models are made of: where inputs move most, all where they are few."""
    if len(recording) <= MOST_ROWS:
        return recording
    signals = np.hstack([recording.u, recording.d])
    size = signals.std(axis=0)
    moves = np.square(np.diff(signals, axis=0) / np.where(size > 0.0, size, 1.0)).sum(axis=1)
    moved = np.concatenate([[0.0], np.cumsum(moves)])
    first = int(np.argmax(moved[MOST_ROWS - 1 :] - moved[: len(moved) - MOST_ROWS + 1]))
    return rows_of(recording, slice(first, first + MOST_ROWS))
