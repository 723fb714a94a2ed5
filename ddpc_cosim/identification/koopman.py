"""Koopman models: past samples, lifted by a dictionary, say linearly what comes next.

    y_k = W psi(s_k) + eps_k,    s_k = (yf_k-1 ... yf_k-l, u_k-1 ... u_k-l, d_k-1 ... d_k-l)
    yf_k = W psi(s_k) + L eps_k

are extended dynamic mode decomposition with control, psi monomials, of a state of delays (M. Korda, I. Mezic,
Automatica 93, 2018, doi:10.1016/j.automatica.2018.03.046), of whose rows only that of the newest outputs has
to be estimated: the others are shifts. The state is lifted anew at every sample (P. van Goor, R. Mahony, M.
Schaller, K. Worthmann, Reprojection methods for Koopman-based modelling and prediction, IEEE CDC 2023,
arXiv:2307.16188); otherwise a run would be that of a linear model, only with more states. L is how far a
measurement is believed: 1 where noise acts on the plant, less where it is the measurement's.

The dictionary is chosen by the data: of all monomials that which explains most of what is left is added, as
long as it explains more than the best of so many would by chance (S. Chen, S. A. Billings, W. Luo, Int. J.
Control 50(5), 1989, doi:10.1080/00207178908953472; J. Chen, Z. Chen, Biometrika 95(3), 2008,
doi:10.1093/biomet/asn034). Beyond the range that was recorded past samples count as its end: so a run stays
bounded whatever drives it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import Recording
from ddpc_cosim.identification.arx import choose_lags, explained_rows, lagged, most_lags, schwarz
from ddpc_cosim.identification.innovation import PlantModel, rows_of
from ddpc_cosim.identification.predictor import Samples
from ddpc_cosim.monomials import Monomials
from ddpc_cosim.variables import FloatArray

MOST_ROWS = 3000
"""The most rows that a model is made of."""
_LAGS = (1, 2, 3, 4)
_DEGREES = (3, 2)
_MOST_MONOMIALS = 300
_BELIEVED = (1.0, 0.5, 0.25)
_SHORTLIST = 2
_ROUNDS = 4
_BEYOND = 0.25  # of the range on either side, within which past samples are still told apart
_RUNS_AWAY = 1.5  # of what the recording reached: a free run that goes further does not show the plant
_NEGLIGIBLE = 1e-10
_EXACT = 1e-8
_DEPENDENT = 1e-6  # of its size: what is left of an observable that the others give
_NEWTON = 50
_SLOPE = 1e-6
_AT_REST = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class LiftedModel(PlantModel):
    """A Koopman model as a plant; its state is ``(yf_k-1 ... yf_k-l, v_k-1 ... v_k-l-delay)``, v = (u, d).

    Parameters
    ----------
    w : array, shape (p, monomials)
        The outputs of the lifted state.
    lift : Monomials
        The dictionary.
    used : array of int, shape (q,)
        Which entries of the state are lifted.
    means, sizes : array, shape (q,)
        What is taken off those, and what they are divided by.
    low, high : array, shape (q,)
        Between what they are told apart.
    k : array, shape (n, p)
        L, for the newest outputs.
    u_0, d_0, y_0 : array, shapes (m,), (n_d,), (p,)
        Means of the recording, about which its linear part is taken.
    covariance : array, shape (p, p)
        Of the innovations.
    sampling_time : float
        Time between samples [s].
    lags : int
        Number of past outputs.
    """

    w: FloatArray
    lift: Monomials
    used: NDArray[np.intp]
    means: FloatArray
    sizes: FloatArray
    low: FloatArray
    high: FloatArray
    k: FloatArray
    u_0: FloatArray
    d_0: FloatArray
    y_0: FloatArray
    covariance: FloatArray
    sampling_time: float
    lags: int

    @property
    def is_affine(self) -> bool:
        """Whether outputs are affine in the state: they are not."""
        return False

    def driven(self, u: FloatArray, d: FloatArray) -> FloatArray:
        """Return inputs and disturbances side by side."""
        return np.concatenate([u, d], axis=-1)

    def output(self, x: FloatArray) -> FloatArray:
        """Return the outputs without noise, shape (..., p), in states of shape (..., n)."""
        seen = np.minimum(np.maximum(x[..., self.used], self.low), self.high)
        return self.lift((seen - self.means) / self.sizes) @ self.w.T

    def onward(self, x: FloatArray, driven: FloatArray) -> FloatArray:
        """Return the states one sample later without noise."""
        outputs, width = self.lags * len(self.w), driven.shape[-1]
        driven = np.broadcast_to(driven, (*x.shape[:-1], width))
        kept = x[..., : outputs - len(self.w)], x[..., outputs : x.shape[-1] - width]
        return np.concatenate([self.output(x), kept[0], driven, kept[1]], axis=-1)

    def rest(self, u: FloatArray, d: FloatArray) -> FloatArray:
        """Return the state in which it rests, by Newton's method from the mean of the recording."""

        def state(y: FloatArray) -> FloatArray:
            held = np.concatenate([u, d])
            inputs = np.tile(held, (self.order - self.lags * len(y)) // len(held))
            return np.concatenate([np.tile(y, self.lags), inputs])

        def left(y: FloatArray) -> FloatArray:
            return self.output(state(y)) - y

        y, size = self.y_0, np.maximum(np.abs(self.y_0), 1.0)
        for _ in range(_NEWTON):
            error = left(y)
            steps = _SLOPE * size * np.eye(len(y))
            slopes = np.stack([(left(y + step) - left(y - step)) / (2.0 * step.sum()) for step in steps]).T
            change = np.asarray(np.linalg.lstsq(slopes, -error, rcond=_NEGLIGIBLE)[0])
            while np.abs(left(y + change)).max() > np.abs(error).max() and np.abs(change).max() > _AT_REST:
                change = change / 2.0
            if (np.abs(change) <= _AT_REST * size).all():
                break
            y = y + change
        return state(y)

    def linear_part(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return A, B and C about the state in which it rests at its means."""
        x, (p, n) = self.rest(self.u_0, self.d_0), (len(self.w), self.order)
        steps = np.zeros((len(self.used), n))
        steps[np.arange(len(self.used)), self.used] = _SLOPE * self.sizes
        c = np.zeros((p, n))
        c[:, self.used] = (self.output(x + steps) - self.output(x - steps)).T / (2.0 * _SLOPE * self.sizes)
        width, outputs = len(self.u_0) + len(self.d_0), self.lags * p
        a = np.zeros((n, n))
        a[:p] = c
        a[p:outputs, : outputs - p] = np.eye(outputs - p)
        a[outputs + width :, outputs : n - width] = np.eye(n - outputs - width)
        return a, np.eye(n, len(self.u_0), -outputs), c

    def runs_away(self, recording: Recording) -> bool:
        """Return whether a free run over the inputs of a recording leaves what its outputs reached."""
        centre = (recording.y.max(axis=0) + recording.y.min(axis=0)) / 2.0
        reach = np.ptp(recording.y, axis=0) / 2.0
        runs = [self.simulate(part.u, part.d, x=self.first_state(part)) for part in recording.pieces]
        return bool((np.abs(np.vstack(runs) - centre) > _RUNS_AWAY * reach).any())


@dataclass(frozen=True, slots=True)
class KoopmanFit:
    """How a Koopman model is made of a recording.

    Parameters
    ----------
    order : int
        Past samples l.
    delays : tuple of int
        Dead time of every input, in samples.
    lift : Monomials
        The dictionary, of what precedes a sample as :func:`~ddpc_cosim.identification.arx.lagged` has it.
    believed : float
        L, of every output.
    """

    order: int
    delays: tuple[int, ...]
    lift: Monomials
    believed: float = 1.0
    method: str = "koopman"

    @property
    def words(self) -> str:
        """Method and size for people."""
        size = f"{self.order} lag{'' if self.order == 1 else 's'}"
        dead = f", dead times of {list(self.delays)} samples" if any(self.delays) else ""
        return f"Koopman, {size}, {sum(len(term) > 1 for term in self.lift.factors)} products of them{dead}"

    def __call__(self, recording: Recording) -> LiftedModel:
        """Return the model of a recording."""
        samples = Samples.of(rows_of(recording, slice(MOST_ROWS)), self.delays)
        filtered = samples.y
        for _ in range(_ROUNDS if self.believed < 1.0 else 1):
            model = self._fitted(samples, filtered)
            if self.believed < 1.0:
                filtered = samples.y - (1.0 - self.believed) * _errors(model, samples)
        return self._in_units(model, samples)

    def _fitted(self, samples: Samples, filtered: FloatArray) -> LiftedModel:
        """Return the model of standardised signals whose past outputs are filtered."""
        past, _ = lagged(samples.with_outputs(filtered), self.order)
        past, now = past[:, :-1], samples.y[explained_rows(samples, self.order)]
        low, high = past.min(axis=0), past.max(axis=0)
        low, high = low - _BEYOND * (high - low), high + _BEYOND * (high - low)
        lifted = self.lift(past)
        w = np.asarray(np.linalg.lstsq(lifted, now, rcond=_NEGLIGIBLE)[0].T)
        errors = now - lifted @ w.T
        covariance = errors.T @ errors / max(len(now) - lifted.shape[1], 1)
        m, n_d, p = samples.counts
        n = self.order * (p + m + n_d)
        return LiftedModel(
            w=w,
            lift=self.lift,
            used=_places(self.order, (0,) * m, n_d, p),
            means=np.zeros(n),
            sizes=np.ones(n),
            low=low,
            high=high,
            k=self.believed * np.eye(n, p),
            u_0=np.zeros(m),
            d_0=np.zeros(n_d),
            y_0=np.zeros(p),
            covariance=covariance,
            sampling_time=samples.sampling_time,
            lags=self.order,
        )

    def _in_units(self, model: LiftedModel, samples: Samples) -> LiftedModel:
        """Return a model of standardised signals in the recording's units, with its dead times."""
        m, n_d, p = samples.counts
        means, sizes = np.tile(samples.means, self.order), np.tile(samples.sizes, self.order)
        mean_y, size_y = samples.means[m + n_d :], samples.sizes[m + n_d :]
        w = model.w * size_y[:, np.newaxis]
        w[:, self.lift.factors.index([])] += mean_y
        return replace(
            model,
            w=w,
            used=_places(self.order, self.delays, n_d, p),
            means=means,
            sizes=sizes,
            low=means + sizes * model.low,
            high=means + sizes * model.high,
            k=self.believed * np.eye(self.order * p + (self.order + max(self.delays)) * (m + n_d), p),
            u_0=samples.means[:m],
            d_0=samples.means[m : m + n_d],
            y_0=mean_y,
            covariance=model.covariance * np.outer(size_y, size_y),
        )


def koopman_models(
    recording: Recording, delays: tuple[int, ...], order: int, *, wanted: bool
) -> list[tuple[KoopmanFit, LiftedModel]]:
    """Return the Koopman models of a recording that explain it best for their size.

    Parameters
    ----------
    recording : Recording
        The data.
    delays : tuple of int
        Dead time of every input, in samples.
    order : int
        Past samples; 0: by the data.
    wanted : bool
        Whether one is wanted in any case: otherwise there is none where no product of signals explains more
        than the best of so many would by chance. None that runs away is among them.
    """
    recording = rows_of(recording, slice(MOST_ROWS))
    samples = Samples.of(recording, delays)
    most = most_lags(samples)
    every = [order] if order else sorted({min(lags, most) for lags in (*_LAGS, choose_lags(samples))})
    dictionaries = sorted((_dictionary(samples, lags) for lags in every), key=lambda chosen: chosen[0])
    models = list[tuple[KoopmanFit, LiftedModel]]()
    for i, (_, lags, lift) in enumerate(dictionaries[:_SHORTLIST]):
        if wanted or any(len(term) > 1 for term in lift.factors):
            shares = _BELIEVED if i == 0 else _BELIEVED[:1]
            fits = [KoopmanFit(lags, samples.delays, lift, believed) for believed in shares]
            models += [(fit, fit(recording)) for fit in fits]
    return [(fit, model) for fit, model in models if not model.runs_away(recording)]


def _dictionary(samples: Samples, lags: int) -> tuple[float, int, Monomials]:
    """Return 1, the past samples, and products of them that explain more than by chance; see the module."""
    past, now = lagged(samples, lags)
    rows, size, p = len(past), past.shape[1] - 1, now.shape[1]
    linear = Monomials.between(size, 0, 1)
    products = next(
        (
            every
            for degree in _DEGREES
            if len((every := Monomials.between(size, 2, degree)).factors) <= _MOST_MONOMIALS
        ),
        Monomials([]),
    )
    q = np.linalg.qr(linear(past[:, :-1]))[0]
    open_, left = products(past[:, :-1]), now - q @ (q.T @ now)
    open_ -= q @ (q.T @ open_)
    sizes = np.square(open_).sum(axis=0)
    chosen, best = list(linear.factors), schwarz(left, rows, (size + 1) * p)
    for _ in range(len(products.factors)):
        now_sizes = np.square(open_).sum(axis=0)
        shares = np.square(open_.T @ (left / np.maximum(left.std(axis=0), _EXACT))).sum(axis=1)
        shares = np.where(
            now_sizes > _DEPENDENT * sizes, shares / np.where(now_sizes > 0.0, now_sizes, 1.0), 0.0
        )
        i = int(np.argmax(shares))
        unit = open_[:, i] / np.sqrt(now_sizes[i])
        left_then = left - np.outer(unit, unit @ left)
        searched = 2.0 * (len(chosen) - size) * np.log(len(products.factors))
        criterion = schwarz(left_then, rows, (len(chosen) + 1) * p) + searched
        if criterion >= best:
            break
        best, left = criterion, left_then
        chosen.append(products.factors[i])
        open_ -= np.outer(unit, unit @ open_)
    return best, lags, Monomials(chosen)


def _errors(model: LiftedModel, samples: Samples) -> FloatArray:
    """Return the one-step errors of a model of standardised signals; 0 where no past is known."""
    errors, lags = np.zeros(samples.y.shape), model.lags
    driven = samples.z[:, : -1 - samples.counts[2]]
    for rows in samples.stretches:
        y, v = samples.y[rows], driven[rows]
        if len(y) <= lags:
            continue
        x = np.concatenate([y[:lags][::-1].ravel(), v[:lags][::-1].ravel()])
        for i in range(lags, len(y)):
            error = y[i] - model.output(x)
            errors[rows.start + i] = error
            x = model.onward(x, v[i]) + model.k @ error
    return errors


def _places(lags: int, delays: tuple[int, ...], n_d: int, p: int) -> NDArray[np.intp]:
    """Return where in the state there is what precedes a sample, in the order of its rows."""
    m = len(delays)
    places = list[int]()
    for i in range(lags):
        shifted = [(i + delay) * (m + n_d) + j for j, delay in enumerate(delays)]
        known = [i * (m + n_d) + m + j for j in range(n_d)]
        places += [lags * p + place for place in (*shifted, *known)]
        places += [i * p + j for j in range(p)]
    return np.array(places, dtype=np.intp)
