"""What a sample says of the time ahead besides the reference, as parameters of the tracking problem.

Known disturbances, the edges of bands, limits that move and prices change from sample to sample. All of them
are parameters p of the problem that is condensed once: right-hand sides and linear terms, so that nothing is
factorised anew. Row i of the horizon belongs to the input u_i, held over [t_k+i, t_k+i+1): it meets the
disturbance, the limits and the price of that interval. Predicted outputs meet band, limits and price of their
own time, t_k+i or t_k+i+1, whichever the method's first one is.

Where there is no forecast worth the name, a recording says how a disturbance goes on from what is measured of
it: as the best predictor of an autoregressive process of first order does (G. E. P. Box, G. M. Jenkins,
G. C. Reinsel, G. M. Ljung, Time Series Analysis, 5th ed., 2015, chapter 5),

    d_k+i = m + r^i (d_k - m),   r = sum_t (d_t - m)(d_t+1 - m) / sum_t (d_t - m)^2,

m and r being the mean and the autocorrelation over one sample of the recording. White noise goes back to its
mean at once, what hardly changes stays.
"""

from dataclasses import dataclass
from itertools import accumulate
from math import isfinite, prod
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.export.code import Code
from ddpc_controllers.optimisation.limits import InputLimits
from ddpc_controllers.optimisation.problem import Blocks, ParameterVector, sample_by_sample
from ddpc_cosim import Bounds, ConfigError, FloatArray, Loop, Sample, setting

D, BAND, INPUT_LIMITS, OUTPUT_LIMITS, PRICE = "d", "band", "u_limits", "y_limits", "price"

ENDLESS = 1e9
"""Stands for a band without an edge on one side, in parts of the output's scale."""


@dataclass(kw_only=True)
class Foresight:
    """What a predictive method does with forecasts and prices."""

    use_forecast: bool | Literal["identified"] = setting(
        True,
        choices=(True, False, "identified"),
        doc="predict with the forecasts of known disturbances; otherwise what is measured now is held, or, "
        "identified, goes on as it did in the recording",
    )
    price_weight: float = setting(
        1.0, low=0.0, doc="cost of a unit of money paid over the horizon, beside the squared errors"
    )


class Paid(NamedTuple):
    """What is paid for over the horizon.

    Parameters
    ----------
    price : int
        Column of the prices.
    signal : {"u", "y"}
        Whether it is an input or a predicted output.
    number : int
        Number of the input or output.
    amount : float
        What one unit of it, held over one sampling time, comes to, in units of the cost per unit of money.
    """

    price: int
    signal: str
    number: int
    amount: float


def expected_course(settings: Foresight, loop: Loop, past: int, ahead: int) -> Blocks:
    """Return what disturbances a method predicts with, of its parameter ``"d"`` and the 1.

    Parameters
    ----------
    settings : Foresight
        What the method does with forecasts.
    loop : Loop
        The loop of the method's signals.
    past, ahead : int
        How many samples of the parameter are before this one, and how many are of this one and later.

    Returns
    -------
    blocks : dict of str to array, shapes (samples n_d, samples n_d) and (samples n_d, 1)
        The parameter as it is; or, where it is identified and the rows of later samples have what is measured
        now, what is expected of these.

    Raises
    ------
    ConfigError
        There is no recording of the disturbances to identify it from.
    """
    n_d = len(loop.disturbances)
    if settings.use_forecast != "identified":
        return {D: np.eye((past + ahead) * n_d)}
    recording = loop.recording
    if recording is None or recording.d.shape[1] != n_d:
        raise ConfigError(
            'use_forecast = "identified" needs a recording of the disturbances; false holds what is measured'
        )
    off = recording.d - recording.d.mean(axis=0)
    follows = np.delete(np.arange(1, len(off)), np.array(recording.seams, dtype=np.intp) - 1)
    square = (off**2).sum(axis=0)
    moved = square > 0.0
    ratio = np.ones(len(square))  # what never moved stays
    ratio[moved] = (off[follows] * off[follows - 1]).sum(axis=0)[moved] / square[moved]
    lasting = np.vstack([np.ones((past, len(ratio))), ratio ** np.arange(ahead)[:, np.newaxis]])
    constant = (1.0 - lasting) * recording.d.mean(axis=0)
    return {D: np.diag(lasting.ravel()), "one": constant.reshape(-1, 1)}


class _Sides:
    """Which limits of some signals move: pairs of signal and side, 0 the lower and 1 the upper."""

    def __init__(self, names: list[str], moving: tuple[str, ...], low: FloatArray, high: FloatArray) -> None:
        sides = [
            (number, side)
            for number, name in enumerate(names)
            for side, limit in enumerate((low, high))
            if name in moving and np.isfinite(limit[number])
        ]
        self.signals, self.sides = np.array(sides, dtype=np.intp).reshape(-1, 2).T
        self._width = len(names)

    def __len__(self) -> int:
        return len(self.signals)

    def of(self, limits: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return those of the limits that move, shape (rows, number), of all, shape (rows, signals, 2)."""
        return np.asarray(limits[:, self.signals, self.sides])

    def chosen(self, side: int) -> FloatArray:
        """Return the block, shape (signals, number), that has the moving limits of one side in its rows."""
        block = np.zeros((self._width, len(self)))
        numbers = np.flatnonzero(self.sides == side)
        block[self.signals[numbers], numbers] = 1.0
        return block

    def standing(self, side: int, limits: FloatArray, samples: int) -> FloatArray:
        """Return the limits of one side over samples, as a column: zero those that move, or are none."""
        standing = np.where(np.isfinite(limits), limits, 0.0)
        standing[self.signals[self.sides == side]] = 0.0
        return np.tile(standing, samples)[:, np.newaxis]


class Outlook:
    """What a method knows of the time ahead: the parameters, and which parts of the problem they bring.

    Parameters
    ----------
    loop : Loop
        The loop of the method's signals; its outputs are those that are predicted.
    settings : Foresight
        What the method does with forecasts and prices.
    horizon : int
        Prediction horizon N.
    past : int
        How many samples of the disturbances before this one the prediction rests on.
    first : {0, 1}
        How many samples from now the first predicted output is.
    controlled : int, optional
        How many of the outputs are controlled; the others, which come last, are predicted only. Default: all.
    units : (array, array, array), shapes (m,), (p,), (n_d,), optional
        What one of each input, output and disturbance of the loop is in the samples; default: the same.

    Attributes
    ----------
    windows : dict of str to (int, int)
        Length and width of the parameters' windows, which have to be the last ones; empty where there are no
        such things. ``"d"`` holds the disturbances d_k-past ... d_k+N-1.
    followed : array of int
        The outputs that follow a reference.
    bands : array of int
        Those that are wanted within a band.
    paid : list of Paid
        What is paid for.
    moves_inputs : bool
        Whether limits of inputs move.
    course : dict of str to array
        What it predicts with of the disturbances: see :func:`expected_course`; empty where there are none.
    """

    def __init__(
        self,
        loop: Loop,
        settings: Foresight,
        horizon: int,
        *,
        past: int = 0,
        first: int = 1,
        controlled: int | None = None,
        units: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    ) -> None:
        inputs, outputs = ([v.name for v in variables] for variables in (loop.inputs, loop.outputs))
        bounds, self.horizon = loop.bounds, horizon
        self.controlled = len(outputs) if controlled is None else controlled
        self._past, self._first = past, first
        in_band = np.array([name in loop.bands for name in outputs[: self.controlled]], dtype=bool)
        self.followed, self.bands = np.flatnonzero(~in_band), np.flatnonzero(in_band)
        self._u = _Sides(inputs, loop.moving_limits, bounds.u_min, bounds.u_max)
        self._y = _Sides(outputs, loop.moving_limits, bounds.y_min, bounds.y_max)
        self.paid = _paid(loop, inputs, outputs, settings.price_weight)
        self.disturbances = len(loop.disturbances)
        sizes = {
            D: (past + horizon, self.disturbances),
            BAND: (horizon, 2 * len(self.bands)),
            INPUT_LIMITS: (horizon, len(self._u)),
            OUTPUT_LIMITS: (horizon, len(self._y)),
            PRICE: (horizon + 1, len(loop.charges) if self.paid else 0),
        }
        self.windows = {name: size for name, size in sizes.items() if size[1]}
        self.moves_inputs = INPUT_LIMITS in self.windows
        self._holds_bands = BAND in self.windows
        self._passing = past > 0 and D in self.windows
        self.course = expected_course(settings, loop, past, horizon) if D in self.windows else {}
        self._arrange(loop, settings.use_forecast is True, units)

    def at_rest(self) -> dict[str, Blocks]:
        """Return the rows of disturbances that stay what they are at the end of the horizon."""
        if D not in self.windows:
            return {}
        length, width = self.windows[D]
        at_end = np.zeros((length, length))
        at_end[:, -1] = 1.0
        last = sample_by_sample(at_end, np.eye(width))
        return {D: {name: last @ block for name, block in self.course.items()}}

    def begin(self, parameters: ParameterVector, past: FloatArray) -> None:
        """Fill the disturbances before this sample, shape (past, n_d), or (n_d,) as if always so."""
        if D in self.windows:
            parameters.window(D)[: self._past] = past

    def fill(self, parameters: ParameterVector, sample: Sample) -> None:
        """Fill the parameters for this sample."""
        if not self._fields:
            return
        ahead = parameters.array[-1 - len(self._places) : -1]
        self._chosen_of(sample, ahead)
        if self._units is not None:
            ahead /= self._units
        if self._holds_bands and not isfinite(np.dot(ahead, ahead)):
            edges = parameters.window(BAND)
            np.clip(edges, -ENDLESS, ENDLESS, out=edges)

    def _chosen_of(self, sample: Sample, out: FloatArray | None = None) -> FloatArray:
        """Return what the parameters are of a sample, in its units."""
        values = np.concatenate([getattr(sample, field).ravel() for field in self._fields])
        return np.take(values, self._places, out=out, mode="clip")

    def now(self, parameters: ParameterVector) -> FloatArray:
        """Return the disturbances of this sample, shape (n_d,), after :meth:`fill`."""
        return parameters.window(D)[self._past] if D in self.windows else np.empty(0)

    @property
    def size(self) -> int:
        """How many parameters there are."""
        return sum(length * width for length, width in self.windows.values())

    def members(self, code: Code, limits: InputLimits) -> dict[str, object]:
        """Return the members of a structure in C that keeps the parameters after the references."""
        members: dict[str, object] = {}
        if self.windows:
            members |= {"disturbances": self.disturbances, "ahead": self.size}
        if self.moves_inputs:
            members["near"] = code.doubles(limits.near)
        return members

    def in_c(self, code: Code, first: str, steps: int) -> str:
        """Return statements in C that fill the parameters, and moving limits of so many samples after the 1.

        ``first`` is the place of the first parameter; those of the past stay.
        """
        if not self.windows or code.ahead is None:
            return ""
        past = self._past * self.disturbances
        look = code.ahead.chosen(code, self._chosen_of, f"{first} + {past}", ENDLESS)
        if self.moves_inputs:
            look += code.ahead.limits(code, steps, f"{first} + {self.size + 1}")
        return look

    def advance(self, parameters: ParameterVector) -> None:
        """Go on to the next sample: the disturbances of this one are of the past."""
        if self._passing:
            parameters.shift(D)

    def _arrange(
        self,
        loop: Loop,
        uses_forecast: bool,
        units: tuple[FloatArray, FloatArray, FloatArray] | None,
    ) -> None:
        """Note which entries of a sample the parameters are, in which units: they are copied at once."""
        n, m, p, n_d = self.horizon, len(loop.inputs), len(loop.outputs), self.disturbances
        shapes: dict[str, dict[str, tuple[int, ...]]] = {
            D: {"disturbance": (1, n_d), "forecast": (n, n_d)},
            BAND: {"band_now": (1, p, 2), "band": (n, p, 2)},
            INPUT_LIMITS: {"input_limits": (n + 1, m, 2)},
            OUTPUT_LIMITS: {"output_limits": (n, p, 2)},
            PRICE: {"price": (n + 1, len(loop.charges))},
        }
        fields = {field: shape for name in self.windows for field, shape in shapes[name].items()}
        ends = accumulate(map(prod, fields.values()))
        at = {
            field: np.arange(end - prod(shape), end).reshape(shape)
            for end, (field, shape) in zip(ends, fields.items(), strict=True)
        }
        of_u, of_y, of_d = units or (np.ones(m), np.ones(p), np.ones(n_d))
        later = slice(1, n + 1) if self._first else slice(n)
        chosen = list[tuple[NDArray[np.intp], FloatArray]]()
        if D in self.windows:
            rows = np.vstack([at["disturbance"], at["forecast"]])[:n]
            chosen.append((rows if uses_forecast else rows[np.zeros(n, dtype=np.intp)], of_d))
        if BAND in self.windows:
            edges = np.concatenate([at["band_now"], at["band"]])[later][:, self.bands]
            chosen.append((edges.reshape(n, -1), np.repeat(of_y[self.bands], 2)))
        if INPUT_LIMITS in self.windows:
            chosen.append((self._u.of(at["input_limits"][:n]), of_u[self._u.signals]))
        if OUTPUT_LIMITS in self.windows:  # those of now are not known, nor do inputs change what they hold
            rows = np.concatenate([at["output_limits"][:1], at["output_limits"]])[later]
            chosen.append((self._y.of(rows), of_y[self._y.signals]))
        if PRICE in self.windows:
            chosen.append((at["price"], np.ones(len(loop.charges))))
        self._fields = tuple(fields)
        self._places = np.concatenate([rows.ravel() for rows, _ in chosen] or [np.empty(0, dtype=np.intp)])
        sizes = [np.broadcast_to(unit, rows.shape).ravel() for rows, unit in chosen]
        self._units = np.concatenate(sizes) if units and sizes else None

    def moving(self, signal: str, bounds: Bounds) -> tuple[Blocks, Blocks] | None:
        """Return the limits of ``"u"``, ``"y"`` over the horizon, or of ``"u_s"``, ``"y_s"`` at its end.

        None where they do not move.
        """
        sides, name = (self._u, INPUT_LIMITS) if signal[0] == "u" else (self._y, OUTPUT_LIMITS)
        if name not in self.windows:
            return None
        n = self.horizon
        rows = np.eye(n)[-1:] if signal.endswith("_s") else np.eye(n)
        low, high = (bounds.u_min, bounds.u_max) if signal[0] == "u" else (bounds.y_min, bounds.y_max)
        lower, upper = (
            {
                name: sample_by_sample(rows, sides.chosen(side)),
                "one": sides.standing(side, limits, len(rows)),
            }
            for side, limits in enumerate((low, high))
        )
        return lower, upper

    def edges(self, side: int) -> FloatArray:
        """Return the block of the parameter ``"band"`` that has the lower (0) or the upper edges (1)."""
        pick = np.zeros((1, 2))
        pick[0, side] = 1.0
        return sample_by_sample(np.eye(self.horizon * len(self.bands)), pick)

    def amounts(self, signal: str, width: int) -> FloatArray:
        """Return what prices, (N + 1) n_prices, are multiplied by of a signal over the horizon, N width."""
        n, prices = self.horizon, self.windows[PRICE][1]
        late = self._first if signal == "y" else 0
        block = np.zeros((n + 1, prices, n, width))
        for paid in self.paid:
            if paid.signal == signal:
                block[np.arange(n) + late, paid.price, np.arange(n), paid.number] += paid.amount
        return block.reshape((n + 1) * prices, n * width)


def _paid(loop: Loop, inputs: list[str], outputs: list[str], weight: float) -> list[Paid]:
    """Return what is paid for of inputs and predicted outputs."""
    paid = []
    for number, charge in enumerate(loop.charges if weight else ()):
        amount = weight * charge.rate * loop.sampling_time
        if charge.signal in inputs:
            paid.append(Paid(number, "u", inputs.index(charge.signal), amount))
        elif charge.signal in outputs:
            paid.append(Paid(number, "y", outputs.index(charge.signal), amount))
    return paid
