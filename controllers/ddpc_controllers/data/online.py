"""Data that follow the plant: the Gram matrix of the recorded windows, updated sample by sample.

Every quadratic problem sees the data M through ``M M'`` alone. In the coordinates c of a factor of the
recording, ``M = B C``, it is ``B K B'`` with ``K = C C'``, the identity at first. A new window adds ``c c'``
to K; the window that it replaces is taken off (sliding window), or everything older is scaled down
(forgetting). K stays as small as M has rows, whatever the recording's length, and as it is taken relative to
the recording, squaring the data does not square their condition. Its Cholesky factor is taken anew from it:
for the tens of rows of these problems LAPACK does so in less time than rotations take to update one.

A window with a component outside the range of B (after a change of the plant), and a direction of B that the
data do not have any more, call for a new factor, from the window's data or, with forgetting, from K. So does
the accumulated rounding after as many updates as there are windows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.typing import NDArray

from ddpc_controllers.checks import per_signal
from ddpc_controllers.data.hankel import WindowBuffer, WindowLayout
from ddpc_controllers.optimisation.condensing import RowFactor, factorise
from ddpc_controllers.optimisation.problem import Problem
from ddpc_cosim import FloatArray, Weight, setting

OnlineMode = Literal["frozen", "sliding-window", "forgetting"]
ONLINE_MODES: tuple[str, ...] = get_args(OnlineMode)

_OUTSIDE = 1e-9
_VANISHING = 1e-12


class Excitation:
    """How much the inputs of the windows excite, relative to the recording.

    The measure is the harmonic mean, over all directions of an input window, of the information ``U U'`` that
    the windows hold relative to the recording's: 1 at first, near 0 as soon as one direction is lost. It
    lies between the smallest of these ratios and its multiple by the number of directions.

    Parameters
    ----------
    windows : array, shape (rows, columns)
        The rows of M that hold inputs.
    """

    def __init__(self, windows: FloatArray) -> None:
        factor = np.linalg.cholesky(windows @ windows.T)
        self._whitening = np.asarray(scipy.linalg.lapack.dtrtri(factor, lower=1)[0])
        self._gram = np.eye(len(windows))
        self.value = 1.0

    def after(self, new: FloatArray, old: FloatArray | None, keep: float) -> tuple[FloatArray, float]:
        """Return the whitened Gram matrix, and the measure, with one window more and one less."""
        whitened_old = None if old is None else self._whitening @ old
        gram = _updated(self._gram, self._whitening @ new, whitened_old, keep)
        factor, info = scipy.linalg.lapack.dpotrf(gram, lower=1)
        if info:
            return gram, 0.0
        inverse, info = scipy.linalg.lapack.dtrtri(factor, lower=1)
        return gram, 0.0 if info else len(gram) / float(np.vdot(inverse, inverse))

    def accept(self, gram: FloatArray, value: float) -> None:
        """Adopt the result of :meth:`after`."""
        self._gram, self.value = gram, value

    def refresh(self, windows: FloatArray) -> None:
        """Remove the rounding of the updates, given the rows of all windows that hold inputs."""
        whitened = self._whitening @ windows
        self._gram = whitened @ whitened.T


class OnlineData:
    """The data of a predictive controller while it runs.

    A window after which the inputs excite less than a floor, and less than before, is refused: neither is it
    learned nor is anything forgotten for it, so that a quiet loop keeps the data that it has. The next window
    that excites is learned again.

    Parameters
    ----------
    data : array, shape (rows, columns)
        M of the recording.
    weights : sequence of (int, float)
        What g costs: see :func:`~ddpc_controllers.optimisation.condensing.factorise`.
    input_rows : array of int, shape (inputs and disturbances in a window,)
        Which rows hold inputs and disturbances.
    keep : float
        What remains of older windows at every new one: 1 for a sliding window, the forgetting factor
        otherwise.
    floor : float
        The floor of :class:`Excitation`.

    Attributes
    ----------
    factor : RowFactor
        B; another object when it changed.
    gram : array, shape (rank, rank)
        K.
    """

    def __init__(
        self,
        data: FloatArray,
        weights: Sequence[tuple[int, float]],
        input_rows: NDArray[np.intp],
        keep: float,
        floor: float,
    ) -> None:
        self._weights, self._input_rows = weights, input_rows
        self._keep, self._floor = keep, floor
        self._windows = data.T.copy()
        self._oldest = 0
        self._excitation = Excitation(data[input_rows])
        self.gram: FloatArray
        self._taken = self._refused = self._factorised = 0
        self._factorise(data)

    def learn(self, window: FloatArray) -> bool:
        """Take a new window, shape (rows,), unless the data would excite too little; return whether."""
        old = self._windows[self._oldest] if self._slides else None
        inputs = None if old is None else old[self._input_rows]
        gram, excitation = self._excitation.after(window[self._input_rows], inputs, self._keep)
        enough = excitation >= min(self._floor, self._excitation.value)
        if not (enough and np.isfinite(window).all()):
            self._refused += 1
            return False
        self._excitation.accept(gram, excitation)
        self._taken += 1
        self._update(window, old)
        return True

    def renew(self) -> None:
        """Factorise the data anew: K has become singular in the present coordinates."""
        self._factorise(self._equivalent_data())

    def counts(self) -> Mapping[str, float]:
        """Return what happened so far, for diagnostics."""
        return {
            "online_windows_taken": float(self._taken),
            "online_windows_refused": float(self._refused),
            "online_factorisations": float(self._factorised),
            "online_excitation": self._excitation.value,
        }

    @property
    def _slides(self) -> bool:
        return self._keep == 1.0

    def _update(self, window: FloatArray, old: FloatArray | None) -> None:
        c = self._coordinates @ window
        inside = np.abs(window - self.factor.basis @ c).max() <= _OUTSIDE * np.abs(window).max()
        if inside:
            self.gram = _updated(self.gram, c, None if old is None else self._coordinates @ old, self._keep)
        if old is None:
            if not inside:
                older = np.sqrt(self._keep) * self._equivalent_data()
                self._factorise(np.column_stack([older, window]))
            return
        old[...] = window  # a view of the oldest window: the newest takes its place
        self._oldest = (self._oldest + 1) % len(self._windows)
        if not inside:
            self._factorise(self._windows.T)
        elif self._oldest == 0:
            self._refresh()

    def _equivalent_data(self) -> FloatArray:
        """Return data with the same ``M M'``: the window's, or as many columns as K has."""
        if self._slides:
            return self._windows.T
        values, vectors = np.linalg.eigh(self.gram)
        kept = values > _VANISHING * values[-1]
        return np.asarray(self.factor.basis @ (vectors[:, kept] * np.sqrt(values[kept])))

    def _factorise(self, data: FloatArray) -> None:
        self.factor: RowFactor = factorise(data, self._weights)
        self._coordinates = np.linalg.pinv(self.factor.basis)
        self.gram = np.eye(self.factor.basis.shape[1])
        self._factorised += 1

    def _refresh(self) -> None:
        """Remove the rounding of the updates."""
        coordinates = self._coordinates @ self._windows.T
        self.gram = coordinates @ coordinates.T
        self._excitation.refresh(self._windows[:, self._input_rows].T)


def _updated(gram: FloatArray, new: FloatArray, old: FloatArray | None, keep: float) -> FloatArray:
    """Return the Gram matrix with one column more, and one less or all others scaled down."""
    if old is None:
        return keep * gram + np.outer(new, new)
    # One product for both: (new - old) and (new + old) are the downdate and the update in turn.
    change = np.outer(new - old, new + old)
    return gram + 0.5 * (change + change.T)


@dataclass(kw_only=True)
class OnlineSettings:
    """The settings of controllers whose data can follow the plant.

    ``"sliding-window"`` replaces the oldest window by the newest, ``"forgetting"`` weighs all windows down by
    ``forgetting_factor`` per sample. In a quiet loop both would end up with data that predict nothing. A
    window after which the inputs excited less than ``excitation_floor`` times what the recording's do, and
    less than before, is therefore refused: the data stay as they are until the loop moves again. What is
    kept may be out of date: after a change of the plant a sliding window can stick with it, in a loop that
    stands still at an input limit for example. ``dither``, a uniform random signal on the inputs, keeps the
    windows coming; with it a sliding window has replaced its recording after T samples.
    """

    online_data: OnlineMode = setting("frozen", choices=ONLINE_MODES, doc="how the data follow the plant")
    forgetting_factor: float = setting(
        0.99, above=0.0, high=1.0, doc="what remains per sample of a window's weight, with forgetting"
    )
    excitation_floor: float = setting(
        0.005, low=0.0, high=1.0, doc="share of the recording's excitation below which the data are kept"
    )
    dither: Weight = setting(
        0.0, low=0.0, doc="amplitude of the random signal added to each input, in its unit; online data only"
    )

    def online_faults(self) -> list[str]:
        """Return how the settings contradict each other."""
        who, faults = type(self).__name__, []
        if self.online_data == "forgetting" and self.forgetting_factor == 1.0:
            faults.append(f"{who}: forgetting_factor = 1 forgets nothing; use 0.9 to 0.9999")
        if self.online_data == "frozen" and np.any(self.dither):
            faults.append(f"{who}: dither = {self.dither!r} excites for online_data, which is 'frozen'")
        return faults


class Learner:
    """How a predictive controller feeds its own loop's samples to its data (Remarks 1 and 2).

    Parameters
    ----------
    settings : OnlineSettings
        How the data follow the plant.
    problem : Problem
        The problem that they meet.
    data : array, shape (rows, columns)
        The recording's stacked data M.
    layout, signals
        How the recorded signals, shape (T, width) each, make up these data.
    input_scales : array, shape (m,)
        What one unit of each input is, in the unit of the dither.
    continues : bool
        The loop's first sample follows the recording's last.
    rng : numpy.random.Generator
        Where the dither comes from.

    Attributes
    ----------
    data : OnlineData
        The data as they are now.

    Raises
    ------
    ConfigError
        ``dither`` does not fit the number of inputs.
    """

    def __init__(
        self,
        settings: OnlineSettings,
        problem: Problem,
        data: FloatArray,
        layout: WindowLayout,
        signals: Mapping[str, FloatArray],
        input_scales: FloatArray,
        continues: bool,
        rng: np.random.Generator,
    ) -> None:
        widths = {name: values.shape[1] for name, values in signals.items()}
        self._amplitude = per_signal("dither", settings.dither, widths["u"]) / input_scales
        self._dithers, self._rng = bool(self._amplitude.any()), rng
        keep = settings.forgetting_factor if settings.online_data == "forgetting" else 1.0
        rows = np.concatenate([layout.rows_of(name, widths) for name in ("u", "d") if name in widths])
        self.data = OnlineData(data, problem.weights, rows, keep, settings.excitation_floor)
        self._buffer = WindowBuffer(layout, signals, continues)

    def learn(self, **samples: FloatArray) -> None:
        """Take the loop's samples of all signals, shape (width,) each; learn the window they complete."""
        self._buffer.append(samples)
        window = self._buffer.column()
        if window is not None:
            self.data.learn(window)

    def add_dither(self, plan: FloatArray) -> None:
        """Add the dither to inputs, shape (samples, m), in place."""
        if self._dithers:
            plan += self._amplitude * self._rng.uniform(-1.0, 1.0, plan.shape)
