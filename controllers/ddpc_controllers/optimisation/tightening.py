"""Output limits drawn in by what predictions were off: limits that are kept as often as promised.

Of predictions i samples ahead, n residuals ``e = y - y^`` are known on samples that no predictor was fitted
to. One more that is exchangeable with them is above the k-th smallest with a probability of at most
``1 - k / (n + 1)``, whatever its distribution (V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a
Random World, 2005; J. Lei, M. G'Sell, A. Rinaldo, R. J. Tibshirani, L. Wasserman, *Distribution-free
predictive inference for regression*, JASA 113(523), 2018, doi:10.1080/01621459.2017.1307116). So a predicted
output that keeps

    y^_i <= y_max - q_i,   q_i = max(0, the k-th smallest of e_i),   k = ceil((n + 1) satisfaction),

is measured below its limit with the probability that is asked for, and likewise above the lower one.
"""

import math
from dataclasses import dataclass

import numpy as np

from ddpc_controllers.data.quality import Judgement
from ddpc_controllers.optimisation.problem import Blocks
from ddpc_cosim import DataError, FloatArray, Loop, setting


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

    def _drawn_in_by(self, loop: Loop, samples: int) -> FloatArray | None:
        """Return by how much limits are drawn in over a horizon, shape (N, p, 2); None where nothing is.

        It goes by the held-out residuals of ``_judgement``, to which it adds a warning where they leave no
        room between the limits.

        Parameters
        ----------
        loop : Loop
            The loop that the method sees.
        samples : int
            N.

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
        margins = margins_of(residuals[:, :samples], self.satisfaction)
        crossed = (margins.sum(axis=-1) > loop.bounds.y_max - loop.bounds.y_min).any(axis=0)
        crowded = tuple(
            f'{who} leaves no room between the limits of "{output.name}", so far off are predictions; a '
            "point is left: promise less, predict fewer samples ahead, or record more"
            for output, no_room in zip(loop.outputs, crossed.tolist(), strict=True)
            if no_room
        )
        self._judgement = self._judgement._replace(warnings=(*self._judgement.warnings, *crowded))
        return margins


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
    margins: FloatArray | None,
    moving: tuple[Blocks, Blocks] | None = None,
) -> tuple[FloatArray, FloatArray, tuple[Blocks, Blocks] | None]:
    """Return limits over a horizon, drawn in by margins: what :meth:`Problem.bound` takes.

    Where two margins are more than what is between the limits, both are shortened in proportion, so that a
    point is left.

    Parameters
    ----------
    lower, upper : array, shape (p,)
        The limits; of those that move the outermost.
    margins : array, shape (N, p, 2), or None
        See :func:`margins_of`; of samples whose limits do not count minus infinity. None: nothing is drawn
        in.
    moving : (blocks, blocks), optional
        Limits that move, as combinations of parameters.

    Returns
    -------
    lower, upper : array, shape (N p,)
        The limits of every sample; as they were where nothing is drawn in.
    moving : (blocks, blocks) or None
        Those that move.
    """
    if margins is None:
        return lower, upper, moving
    total, room = margins.sum(axis=-1), upper - lower
    share = np.ones_like(total)
    np.divide(room, total, out=share, where=total > room)
    up, down = (share * margins[..., 0]).ravel(), (share * margins[..., 1]).ravel()
    samples = len(margins)
    if moving:
        low, high = moving
        moving = (
            {**low, "one": low["one"] + up[:, np.newaxis]},
            {**high, "one": high["one"] - down[:, np.newaxis]},
        )
    return np.tile(lower, samples) + up, np.tile(upper, samples) - down, moving


def without_present(margins: FloatArray | None) -> FloatArray | None:
    """Return margins of a horizon whose first output is the present one, whose limits do not count.

    No input changes it any more: a limit there that is drawn in would only make steps that no inputs solve.
    """
    if margins is not None:
        margins[0] = -np.inf
    return margins
