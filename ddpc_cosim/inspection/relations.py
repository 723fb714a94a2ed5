"""What a log says of how its signals act on each other: dead times, gains, and whether a loop was closed.

Dead times and gains are those of an autoregressive model with inputs for each output (L. Ljung, *System
Identification*, 2nd edition, 1999, section 4.2), fitted by least squares. A gain's interval is that of E. C.
Fieller, *Some problems in interval estimation*, Journal of the Royal Statistical Society B 16(2), 1954: it
has no end where the data do not tell whether the output settles at all.

A loop was closed where past outputs say something of an input that its own past and the known disturbances do
not (C. W. J. Granger, *Investigating causal relations by econometric models and cross-spectral methods*,
Econometrica 37(3), 1969).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.variables import FloatArray
from ddpc_cosim.windows import window_starts

_MOST_DELAY = 40
_ORDERS = (1, 2, 3, 4, 6, 8)
# Samples for each coefficient that is fitted; with fewer, none of it is told.
_EQUATIONS = 5
_LEVEL = 0.05
# Feedback that explains less of an input hardly biases anything.
_SIGNIFICANT, _SHARE = 0.01, 0.02
_NEGLIGIBLE = 1e-9
_SWEEPS = 4
_SETTLED = 0.95
_LONGEST_RESPONSE = 2000


@dataclass(frozen=True, slots=True)
class Pair:
    """How one input acts on one output.

    Parameters
    ----------
    input, output : str
        The signals.
    dead_time : int
        After how many samples the input begins to show; at least 1.
    earliest, latest : int
        The ends of its 95 % interval.
    gain, low, high : float
        How far the output goes for each unit of the input once it has settled, and the ends of its 95 %
        interval, infinite where the data do not tell whether it settles.
    chance : float
        How probable it is that an input that does nothing seems to explain as much (F-test).
    """

    input: str
    output: str
    dead_time: int
    earliest: int
    latest: int
    gain: float
    low: float
    high: float
    chance: float

    @property
    def acts(self) -> bool:
        """Whether the input shows in the output at all."""
        return self.chance < _SIGNIFICANT

    @property
    def settles(self) -> bool:
        """Whether the data tell that the output settles."""
        return bool(np.isfinite(self.low) and np.isfinite(self.high))


@dataclass(frozen=True, slots=True)
class Feedback:
    """Whether an input was driven by what the outputs did before.

    Parameters
    ----------
    input : str
        The input.
    chance : float
        How probable it is that past outputs seem to explain as much of an input that does not depend on them
        (F-test).
    share : float
        How much of what its own past leaves open the past outputs explain, from 0 to 1.
    outputs : tuple of str
        Which outputs alone explain something.
    is_closed : bool
        Whether the loop was closed: less probable than 1 % over all inputs, and a share of 2 % at least.
    """

    input: str
    chance: float
    share: float
    outputs: tuple[str, ...]
    is_closed: bool


@dataclass(frozen=True, slots=True)
class Relations:
    """How signals act on each other.

    Parameters
    ----------
    pairs : tuple of Pair
        Of each input and output.
    feedback : tuple of Feedback
        Of each input.
    order : int
        The largest order of the models.
    answer : int
        After how many samples 95 % of the slowest response that settles have passed; 0 where none settles.
    samples : int
        How many samples this rests on.
    """

    pairs: tuple[Pair, ...] = ()
    feedback: tuple[Feedback, ...] = ()
    order: int = 0
    answer: int = 0
    samples: int = 0


class _Lags:
    """Signals with their past, as the triangular factor of all regressors.

    Parameters
    ----------
    signals : array, shape (T, n)
        The signals, off their means and in parts of their deviations.
    most : int
        The longest past.
    seams : sequence of int
        The first sample of every piece but the first.
    """

    def __init__(self, signals: FloatArray, most: int, seams: Sequence[int]) -> None:
        now = window_starts(len(signals), most + 1, seams) + most
        self.samples, self._count = len(now), signals.shape[1]
        columns = [np.ones((len(now), 1)), *(signals[now - lag] for lag in range(most + 1))]
        self._factor = np.asarray(np.linalg.qr(np.hstack(columns), mode="r"))

    def at(self, signal: int, lags: Sequence[int] | range) -> list[int]:
        """Return the columns of a signal so many samples before."""
        return [1 + lag * self._count + signal for lag in lags]

    def fit(self, known: Sequence[int], wanted: int) -> tuple[FloatArray, FloatArray, float]:
        """Return coefficients, the inverse of their information, and the sum of squares that is left."""
        a, b = self._factor[:, [0, *known]], self._factor[:, wanted]
        u, s, vt = np.linalg.svd(a, full_matrices=False)
        kept = s > _NEGLIGIBLE * s[0]
        inverse = vt[kept].T / s[kept]
        x = inverse @ (u[:, kept].T @ b)
        left = float(np.square(b - a @ x).sum())
        return x, inverse @ inverse.T, max(left, np.finfo(float).tiny)

    def profile(self, known: Sequence[int], lags_of: Sequence[int], width: int, wanted: int) -> FloatArray:
        """Return the sums of squares that are left with ``width`` neighbours of some more columns each.

        By the normal equations, which are faster and less exact than :meth:`fit`.
        """
        gram, chosen, more = self._gram, [0, *known], [*lags_of, wanted]
        a = gram[np.ix_(chosen, chosen)]
        a = a + _NEGLIGIBLE * np.trace(a) / len(chosen) * np.eye(len(chosen))
        b = gram[np.ix_(chosen, more)]
        rest = gram[np.ix_(more, more)] - b.T @ np.linalg.solve(a, b)
        ridge = _NEGLIGIBLE * max(float(np.trace(gram[np.ix_(lags_of, lags_of)])) / len(lags_of), 1e-300)
        places = np.arange(len(lags_of) - width + 1)[:, np.newaxis] + np.arange(width)
        blocks = rest[places[:, :, np.newaxis], places[:, np.newaxis, :]] + ridge * np.eye(width)
        sides = rest[places, -1]
        explained = (sides * np.linalg.solve(blocks, sides[..., np.newaxis])[..., 0]).sum(axis=1)
        return np.asarray(np.maximum(rest[-1, -1] - explained, np.finfo(float).tiny))

    def beyond(self, known: Sequence[int]) -> FloatArray:
        """Return all regressors less what some of them explain, as the rows of a factor."""
        u, s, _ = np.linalg.svd(self._factor[:, [0, *known]], full_matrices=False)
        u = u[:, s > _NEGLIGIBLE * s[0]]
        return np.asarray(self._factor - u @ (u.T @ self._factor))

    @cached_property
    def _gram(self) -> FloatArray:
        return np.asarray(self._factor.T @ self._factor)


def relations(
    u: FloatArray,
    y: FloatArray,
    d: FloatArray,
    names: tuple[Sequence[str], Sequence[str]],
    seams: Sequence[int] = (),
) -> Relations:
    """Return how inputs and outputs act on each other.

    Parameters
    ----------
    u, y, d : array, shapes (T, m), (T, p), (T, n_d)
        Inputs, outputs and known disturbances, time along axis 0: row i is measured before u[i] is applied.
    names : (sequence of str, sequence of str)
        Those of the inputs and the outputs.
    seams : sequence of int
        The first sample of every piece but the first.
    """
    m, p, n_d = u.shape[1], y.shape[1], d.shape[1]
    signals = np.hstack([u, y, d])
    moving = signals.std(axis=0) > _NEGLIGIBLE * np.maximum(np.abs(signals).max(axis=0, initial=0.0), 1e-300)
    deviations = np.where(moving, signals.std(axis=0), 1.0)
    standard = (signals - signals.mean(axis=0)) / deviations
    most = min(_MOST_DELAY + max(_ORDERS), (len(u) // _EQUATIONS - 1) // (m + p + n_d + 1))
    while most >= 2 and _windows(len(u), most, seams) < _EQUATIONS * (1 + most):
        most -= 1
    if most < 2 or not (moving[:m].any() and moving[m : m + p].any()):
        return Relations()
    lags = _Lags(standard, most, seams)
    others = tuple(m + p + i for i in range(n_d) if moving[m + p + i])
    pairs, answers, orders = list[Pair](), [0], [0]
    driven = [i for i in range(m) if moving[i]]
    for j in (j for j in range(p) if moving[m + j]):
        model = _Model(lags, driven, m + j, others, most)
        answers.append(model.answer())
        orders.append(model.order)
        for i in driven:
            scale = float(deviations[m + j] / deviations[i])
            gain, low, high = (scale * value for value in model.gain(i))
            pairs.append(
                Pair(names[0][i], names[1][j], *model.dead_time(i), gain, low, high, model.chance(i))
            )
    measured = [m + j for j in range(p) if moving[m + j]]
    feedback = _feedback(lags, driven, measured, others, names, m, most)
    return Relations(tuple(pairs), feedback, max(orders), max(answers), lags.samples)


def _windows(samples: int, most: int, seams: Sequence[int]) -> int:
    lengths: NDArray[np.intp] = np.diff((0, *seams, samples))
    return int(np.maximum(lengths - most, 0).sum())


class _Model:
    """An autoregressive model of one output: n past outputs, and n inputs from each dead time on."""

    def __init__(
        self, lags: _Lags, inputs: Sequence[int], output: int, others: Sequence[int], most: int
    ) -> None:
        self._lags, self._inputs, self._output, self._others = lags, inputs, output, others
        self._wanted = lags.at(output, [0])[0]
        self._delays, self.order = dict.fromkeys(inputs, 1), 2
        self._most = most
        orders = [n for n in _ORDERS if n < most]
        if not orders:
            orders = [1]
        self.order = orders[min(1, len(orders) - 1)]
        self._settle()
        # Of the orders that of the smallest information criterion of Schwarz, then delays anew with it.
        n = lags.samples
        criteria = []
        for order in orders:
            self.order = order
            known = self._known()
            left = lags.fit(known, self._wanted)[2]
            criteria.append(n * np.log(left) + (1 + len(known)) * np.log(n))
        self.order = orders[int(np.argmin(criteria))]
        self._settle()
        known = self._known()
        self._x, inverse, left = lags.fit(known, self._wanted)
        self._free = max(n - 1 - len(known), 1)
        self._covariance = inverse * left / self._free

    def _known(self, without: int = -1) -> list[int]:
        """Return the columns of past outputs, of inputs from their delays on but for one, of disturbances."""
        n = self.order
        columns = self._lags.at(self._output, range(1, n + 1))
        for i in self._inputs:
            if i != without:
                first = min(self._delays[i], self._most - n + 1)
                columns += self._lags.at(i, range(first, first + n))
        for i in self._others:
            columns += self._lags.at(i, range(n + 1))
        return columns

    def _settle(self) -> None:
        """Choose the delays by turns, each as the one that leaves least."""
        for _ in range(_SWEEPS):
            before = dict(self._delays)
            for i in self._inputs:
                self._delays[i] = 1 + int(np.argmin(self._profile(i)))
            if self._delays == before:
                break

    def _profile(self, i: int) -> FloatArray:
        """Return what is left for every delay of an input, from 1 on, the others as they are."""
        columns = self._lags.at(i, range(1, self._most + 1))
        return self._lags.profile(self._known(without=i), columns, self.order, self._wanted)

    def dead_time(self, i: int) -> tuple[int, int, int]:
        """Return the dead time of an input, and the ends of its interval.

        Of the model's coefficients the first are left out as long as that is no worse by Schwarz's criterion:
        the input begins to show with the first that is left. The interval goes from the earliest delay that
        is nearly as likely as the best one to the latest before which no coefficient is significant.
        """
        from scipy.special import chdtri

        n, samples = self.order, self._lags.samples
        left, best = self._profile(i), self._delays[i]
        likely = 1 + np.flatnonzero(samples * np.log(left / left.min()) <= chdtri(1, _LEVEL))
        first, last = max(1, best - n), best + n - 1
        known, begins = self._known(without=i), np.arange(first, last + 1)
        logs = samples * np.log(
            [self._lags.fit([*known, *self._lags.at(i, range(d, last + 1))], self._wanted)[2] for d in begins]
        )
        dead_time = int(begins[np.argmin(logs + (last - begins) * np.log(samples))])
        worse = logs[1:] - logs[0] > chdtri(begins[1:] - first, _LEVEL)
        latest = int(begins[np.argmax(worse)]) if worse.any() else int(begins[-1])
        return dead_time, min(dead_time, int(likely[0])), max(dead_time, latest)

    def _of(self, i: int) -> NDArray[np.intp]:
        """Return the places of an input's coefficients."""
        n = self.order
        begin = 1 + n + self._inputs.index(i) * n
        return np.arange(begin, begin + n)

    def gain(self, i: int) -> tuple[float, float, float]:
        """Return the gain B / A of an input, B = sum b and A = 1 - sum a, and the ends of its interval."""
        from scipy.special import stdtrit

        past, of_input = np.arange(1, 1 + self.order), self._of(i)
        a, b = 1.0 - float(self._x[past].sum()), float(self._x[of_input].sum())
        v_a = float(self._covariance[np.ix_(past, past)].sum())
        v_b = float(self._covariance[np.ix_(of_input, of_input)].sum())
        v_ab = -float(self._covariance[np.ix_(past, of_input)].sum())
        # (b - g a)^2 <= t^2 Var(b - g a): what is between the roots of a quadratic in g.
        t = float(stdtrit(self._free, 1.0 - _LEVEL / 2.0))
        q_2, q_1, q_0 = a**2 - t**2 * v_a, a * b - t**2 * v_ab, b**2 - t**2 * v_b
        root = q_1**2 - q_2 * q_0
        gain = b / a if a else np.inf
        if q_2 <= 0.0 or root < 0.0 or a <= 0.0:
            return gain, -np.inf, np.inf
        return gain, (q_1 - np.sqrt(root)) / q_2, (q_1 + np.sqrt(root)) / q_2

    def chance(self, i: int) -> float:
        """Return how probable it is that an input without effect explains as much."""
        from scipy.special import fdtrc

        places = self._of(i)
        x, covariance = self._x[places], self._covariance[np.ix_(places, places)]
        wald = float(x @ np.linalg.pinv(covariance, hermitian=True) @ x)
        # The delay was chosen among several, of which each could have been the best by chance.
        tried = self._most - self.order + 1
        return min(1.0, tried * float(fdtrc(self.order, self._free, wald / self.order)))

    def answer(self) -> int:
        """Return when 95 % of the slowest step response have passed, in samples; 0 if none settles."""
        from scipy.signal import lfilter

        latest = 0
        a = np.concatenate([[1.0], -self._x[1 : 1 + self.order]])
        for i in self._inputs:
            gain, low, high = self.gain(i)
            if self.chance(i) >= _SIGNIFICANT or not np.isfinite([low, high]).all():
                continue
            step = np.arange(_LONGEST_RESPONSE) >= self._delays[i]
            response = lfilter(self._x[self._of(i)], a, step.astype(np.float64))
            off = np.abs(response - gain) > (1.0 - _SETTLED) * abs(gain)
            if not off[-1]:
                latest = max(latest, int(np.flatnonzero(off)[-1]) + 1)
        return latest


def _feedback(
    lags: _Lags,
    driven: Sequence[int],
    measured: Sequence[int],
    others: Sequence[int],
    names: tuple[Sequence[str], Sequence[str]],
    m: int,
    most: int,
) -> tuple[Feedback, ...]:
    """Test whether outputs up to now explain inputs beyond past inputs and the disturbances up to now."""
    from scipy.special import fdtrc

    signals = len(driven) + len(measured) + len(others)
    n = min(most, max(2, (lags.samples // _EQUATIONS - 1) // (signals + 1)))
    known = [column for j in driven for column in lags.at(j, range(1, n + 1))]
    known += [column for j in others for column in lags.at(j, range(n + 1))]
    open_ = lags.beyond(known)
    memory = min(n, max(_ORDERS))  # of a feedback: with fewer coefficients the test has more power

    def test(i: int, outputs: Sequence[int]) -> tuple[float, float]:
        past = [column for j in outputs for column in lags.at(j, range(memory + 1))]
        target = open_[:, lags.at(i, [0])[0]]
        left = float(np.square(target).sum())
        if left <= _NEGLIGIBLE * lags.samples:  # it follows from its own past
            return 1.0, 0.0
        solution = np.linalg.lstsq(open_[:, past], target, rcond=_NEGLIGIBLE)[0]
        rest = float(np.square(target - open_[:, past] @ solution).sum())
        free = max(lags.samples - 1 - len(known) - len(past), 1)
        gained = max(left - rest, 0.0)
        ratio = gained / len(past) * free / max(rest, np.finfo(float).tiny)
        return float(fdtrc(len(past), free, ratio)), gained / left

    every = []
    for i in driven:
        chance, share = test(i, measured)
        closed = chance < _SIGNIFICANT / len(driven) and share >= _SHARE
        alone = [j for j in measured if closed and test(i, [j])[0] < _SIGNIFICANT / len(measured)]
        every.append(Feedback(names[0][i], chance, share, tuple(names[1][j - m] for j in alone), closed))
    return tuple(every)
