"""Output limits drawn in by what predictions were off: limits that are kept as often as promised.

Of predictions i samples ahead, n residuals ``e = y - y^`` are known on samples that no predictor was fitted
to. One more that is exchangeable with them is above the k-th smallest with a probability of at most
``1 - k / (n + 1)``, whatever its distribution (V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a
Random World, 2005; J. Lei, M. G'Sell, A. Rinaldo, R. J. Tibshirani, L. Wasserman, *Distribution-free
predictive inference for regression*, JASA 113(523), 2018, doi:10.1080/01621459.2017.1307116). So a predicted
output that keeps

    y^_i <= y_max - q_i,   q_i = max(0, the k-th smallest of e_i),   k = ceil((n + 1) satisfaction),

is measured below its limit with the probability that is asked for, and likewise above the lower one.

Errors in the loop are not always exchangeable with those: a recording does not have the sun of another day,
nor gains that grow. So the same is asked of the last residuals in the loop, of which the second largest
counts, and the larger margin holds. With a window of n of them, weights that are 1 within and 0 before, the
probability is at least

    satisfaction - sum_i d_TV(i) / (n + 1),

d_TV(i) being by how much, in total variation, it matters to exchange the residual to come with the i-th of
the window (R. F. Barber, E. J. Candes, A. Ramdas, R. J. Tibshirani, *Conformal prediction beyond
exchangeability*, Annals of Statistics 51(2), 2023, doi:10.1214/23-AOS2276): little if what drifts does so
slowly, and the shorter the window the less. There the limited outputs are the least-squares prediction, as
the held-out ones: a regulariser would let planned outputs go below a limit that is drawn in, at a cost, in
place of the inputs, and margins would run away from them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ddpc_controllers.data.quality import Judgement
from ddpc_controllers.optimisation.problem import Blocks, sample_by_sample
from ddpc_cosim import ConfigError, DataError, FloatArray, Loop, setting

MARGINS = "margins"
"""The parameter of a problem that has margins which follow the loop."""

_ROUNDED = 1e-9


@dataclass(kw_only=True)
class Promise:
    """How often a predictive method is to keep the limits of the outputs."""

    satisfaction: float = setting(
        0.0,
        low=0.0,
        high=0.999,
        doc="share of the samples in which each limit of an output is to be kept: limits are drawn in by "
        "this quantile of the prediction's errors on held-out samples; 0: they stay as they are",
    )
    _judgement = Judgement()

    def promised(self) -> dict[str, float]:
        """Return the diagnostic that says what is promised; empty where nothing is."""
        return {"promised_satisfaction": self.satisfaction} if self.satisfaction else {}

    def _drawn_in_by(self, loop: Loop, samples: int, first: int = 1) -> "Margins | None":
        """Return by what limits are drawn in over a horizon; None where nothing is promised.

        It goes by the held-out residuals of ``_judgement``, to which it adds a warning where they leave no
        room between the limits.

        Parameters
        ----------
        loop : Loop
            The loop that the method sees.
        samples : int
            N.
        first : int
            How many samples ahead the first prediction is: 0, the present output, or 1.

        Raises
        ------
        DataError
            Something is promised, and no samples are held out.
        """
        if not self.satisfaction:
            return None
        who, residuals = (
            f"{type(self).__name__}: satisfaction = {self.satisfaction:g}",
            self._judgement.residuals,
        )
        if residuals is None:
            raise DataError(
                f"{who} goes by what predictions are off on held-out samples, and a recording that short "
                "leaves none, nor does a model that is not identified from one: record more, predict fewer "
                "samples ahead, or set it to 0"
            )
        held_out = margins_of(residuals[:, :samples], self.satisfaction)
        room = loop.bounds.y_max - loop.bounds.y_min
        crossed = (held_out.sum(axis=-1) > room).any(axis=0)
        crowded = tuple(
            f'{who} leaves no room between the limits of "{output.name}", so far off are predictions; a '
            "point is left: promise less, predict fewer samples ahead, or record more"
            for output, no_room in zip(loop.outputs, crossed.tolist(), strict=True)
            if no_room
        )
        self._judgement = self._judgement._replace(warnings=(*self._judgement.warnings, *crowded))
        if not first:  # no input changes it any more: its limit would only make steps that no inputs solve
            held_out[0] = -np.inf
        return self._margins_of(held_out, first, room)

    def _margins_of(self, held_out: FloatArray, first: int, room: FloatArray) -> "Margins":
        return Margins(held_out)


@dataclass(kw_only=True)
class OnlinePromise(Promise):
    """How often a method that keeps to its plan is to keep the limits of the outputs."""

    online_margins: bool = setting(
        True,
        doc="with satisfaction, draw limits in by the errors of the last predictions in the loop too, where "
        "these are larger; otherwise held-out samples alone tell",
    )

    def _margins_of(self, held_out: FloatArray, first: int, room: FloatArray) -> "Margins":
        if self.online_margins:
            return OnlineMargins(held_out, first, self.satisfaction, room)
        return super()._margins_of(held_out, first, room)


class Margins:
    """By how much the limits of predicted outputs are drawn in over a horizon, once and for all.

    Parameters
    ----------
    held_out : array, shape (N, p, 2)
        See :func:`margins_of`; of samples whose limits do not count minus infinity.
    """

    windows: Mapping[str, tuple[int, int]] = {}
    """What parameters of a problem there are for it: see :class:`ParameterVector`."""

    def __init__(self, held_out: FloatArray) -> None:
        self._held_out = held_out

    @property
    def online(self) -> "OnlineMargins | None":
        """They themselves where they follow the loop, None where they stay."""
        return None

    def draw_in(
        self, lower: FloatArray, upper: FloatArray, samples: slice, moving: tuple[Blocks, Blocks] | None
    ) -> tuple[FloatArray, FloatArray, tuple[Blocks, Blocks] | None]:
        """Return the limits of some samples of the horizon, drawn in: see :func:`tightened`."""
        return tightened(lower, upper, self._held_out[samples], moving)

    def require_fixed(self) -> None:
        """Check that they stay what they are, as code in C has them.

        Raises
        ------
        ConfigError
            They follow the loop.
        """


class OnlineMargins(Margins):
    """Margins that follow what predictions are off in the loop; never smaller than the held-out ones.

    Each output predicted i samples ahead is compared with what is then measured. Of the last residuals as
    many are remembered as it takes for the second largest to say it, so that one alone counts only while
    there are fewer.

    Parameters
    ----------
    held_out : array, shape (N, p, 2)
        See :class:`Margins`.
    first : int
        How many samples ahead the first prediction is.
    satisfaction : float
        The share that is promised.
    room : array, shape (p,)
        What is between the limits, of those that move the outermost.

    Attributes
    ----------
    values : array, shape (2, N p)
        The parameter of the problem: the margins of lower and of upper limits.
    """

    values: FloatArray

    def __init__(self, held_out: FloatArray, first: int, satisfaction: float, room: FloatArray) -> None:
        super().__init__(held_out)
        n, p, _ = held_out.shape
        self.windows = {MARGINS: (2, n * p)}
        self._room = room
        self._rows, self._ages = np.arange(n), np.arange(first, first + n)
        self._predictions = np.empty((n + first, n, p))
        self._residuals = np.empty((math.ceil(2.0 / (1.0 - satisfaction) - _ROUNDED) - 1, n, p, 2))
        self.begin()

    @property
    def online(self) -> "OnlineMargins":
        """They themselves."""
        return self

    def begin(self) -> None:
        """Forget the loop so far."""
        self._now = 0
        self._predictions[:] = np.nan
        self._residuals[:] = -np.inf
        self._counts = np.zeros(len(self._rows), dtype=np.intp)
        self._update()

    def measured(self, y: FloatArray) -> None:
        """Go on to the next sample, and compare its outputs, shape (p,), with what was predicted of them."""
        self._now += 1
        self._predictions[self._now % len(self._predictions)] = np.nan
        made = self._predictions[(self._now - self._ages) % len(self._predictions), self._rows]
        off = y - made
        known = np.flatnonzero(np.isfinite(off).all(axis=1))
        if known.size:
            places = self._counts[known] % len(self._residuals)
            self._residuals[places, known] = np.stack([-off[known], off[known]], axis=-1)
            self._counts[known] += 1
            self._update()

    def predicted(self, y: FloatArray) -> None:
        """Remember what is predicted at this sample, shape (N p,)."""
        self._predictions[self._now % len(self._predictions)] = y.reshape(len(self._rows), -1)

    def draw_in(
        self, lower: FloatArray, upper: FloatArray, samples: slice, moving: tuple[Blocks, Blocks] | None
    ) -> tuple[FloatArray, FloatArray, tuple[Blocks, Blocks] | None]:
        """Return the limits of some samples of the horizon, which move with the margins."""
        width, rows = upper - lower, np.eye(len(self._rows))[samples]
        # Limits closer together than those of the outputs have as much less of the margins.
        share = np.ones_like(width)
        np.divide(width, self._room, out=share, where=np.isfinite(width) & (self._room > 0.0))
        chosen = sample_by_sample(rows, np.diag(share))
        absent = np.isneginf(self._held_out[samples, :, 0]).ravel()
        low = np.where(absent, -np.inf, np.tile(lower, len(rows)))
        high = np.where(absent, np.inf, np.tile(upper, len(rows)))
        standing = [{"one": np.where(np.isfinite(limit), limit, 0.0)[:, np.newaxis]} for limit in (low, high)]
        of_low, of_high = moving or standing
        none = np.zeros_like(chosen)
        return (
            low,
            high,
            (
                {**of_low, MARGINS: np.hstack([chosen, none])},
                {**of_high, MARGINS: np.hstack([none, -chosen])},
            ),
        )

    def require_fixed(self) -> None:
        """Refuse.

        Raises
        ------
        ConfigError
            Always.
        """
        raise ConfigError(
            "online_margins cannot be exported: the code in C has limits that are drawn in once and for all: "
            "use online_margins = false, or satisfaction = 0"
        )

    def _update(self) -> None:
        second, largest = np.partition(self._residuals, (-2, -1), axis=0)[-2:]
        enough = self._counts >= len(self._residuals)
        of_loop = np.where(enough[:, np.newaxis, np.newaxis], second, largest)
        margins = shortened(np.maximum(self._held_out, of_loop), self._room)
        margins[np.isneginf(self._held_out)] = 0.0
        self.values = margins.transpose(2, 0, 1).reshape(2, -1)


def margins_of(residuals: FloatArray, satisfaction: float) -> FloatArray:
    """Return by how much limits are drawn in so that a share of predictions ends within them.

    Parameters
    ----------
    residuals : array, shape (n, N, p)
        Outputs less their predictions, row i of the horizon of each, on held-out samples.
    satisfaction : float
        The share; beyond n / (n + 1) the largest residual is all that they can say.

    Returns
    -------
    margins : array, shape (N, p, 2)
        Of lower and upper limits; none is negative.
    """
    samples = len(residuals)
    place = min(math.ceil((samples + 1) * satisfaction), samples) - 1
    ordered = [np.sort(off, axis=0)[place] for off in (-residuals, residuals)]
    return np.asarray(np.maximum(np.stack(ordered, axis=-1), 0.0))


def tightened(
    lower: FloatArray,
    upper: FloatArray,
    margins: FloatArray,
    moving: tuple[Blocks, Blocks] | None = None,
) -> tuple[FloatArray, FloatArray, tuple[Blocks, Blocks] | None]:
    """Return limits over a horizon, drawn in by margins: what :meth:`Problem.bound` takes.

    Where two margins are more than what is between the limits, both are shortened in proportion, so that a
    point is left.

    Parameters
    ----------
    lower, upper : array, shape (p,)
        The limits; of those that move the outermost.
    margins : array, shape (N, p, 2)
        See :func:`margins_of`; of samples whose limits do not count minus infinity.
    moving : (blocks, blocks), optional
        Limits that move, as combinations of parameters.

    Returns
    -------
    lower, upper : array, shape (N p,)
        The limits of every sample.
    moving : (blocks, blocks) or None
        Those that move.
    """
    up, down = np.moveaxis(shortened(margins, upper - lower), -1, 0).reshape(2, -1)
    samples = len(margins)
    if moving:
        low, high = moving
        moving = (
            {**low, "one": low["one"] + up[:, np.newaxis]},
            {**high, "one": high["one"] - down[:, np.newaxis]},
        )
    return np.tile(lower, samples) + up, np.tile(upper, samples) - down, moving


def shortened(margins: FloatArray, room: FloatArray) -> FloatArray:
    """Return margins, shape (N, p, 2), shortened in proportion where two are more than the room, (p,)."""
    total = margins.sum(axis=-1)
    share = np.ones_like(total)
    np.divide(room, total, out=share, where=total > room)
    return np.asarray(share[..., np.newaxis] * margins)
