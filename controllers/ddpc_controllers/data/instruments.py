"""Predictors that recorded noise does not bias: the data correlated with what the noise does not reach.

With instruments Z, rows of recorded signals that the noise of what is predicted does not reach, ``M g``
becomes ``M Z' g``, and the noise averages out. J.-W. van Wingerden, S. P. Mulders, R. Dinkla, T. Oomen,
M. Verhaegen, *Data-enabled predictive control with instrumental variables: the direct equivalence with
subspace predictive control*, IEEE CDC 2022 (arXiv:2209.05210), take past inputs, outputs and future inputs,
``Z = (U_p, Y_p, U_f)``: then past and inputs determine g, and DeePC is subspace predictive control. In closed
loop U_f is no such row: the controller that was running has made the inputs from the noise.

R. Dinkla, T. Oomen, S. P. Mulders, J.-W. van Wingerden, *Closed-loop data-enabled predictive control and its
equivalence with closed-loop subspace predictive control*, Automatica 183, 2026,
doi:10.1016/j.automatica.2025.112556 (arXiv:2402.14374), predict one sample with ``Z = (U_p, Y_p, u_k)``, that
was all there before the noise of the predicted sample: it keeps what data say, (11), and is not correlated
with that noise, (12) and (20), so that the predictor (14), (22) is consistent as past and data grow, (16). It
is applied sample after sample, to measured outputs and to those that it has predicted, (23) to (27), which is
closed-loop subspace predictive control, (28) to (34). The numbers are those of the authors' manuscript
of January 2024.

Past outputs have noise too. Coefficients of noisy regressors are too small, and predictions are drawn to
where the plant was recorded, unless the past is so long that what it leaves out does not matter. Where it is
known what moved the loop from outside, what was added to the controller's inputs or its setpoints, samples of
that up to the predicted one are instruments for past outputs and inputs alike: no noise reaches them,
whatever its colour, and what is left is the plant's own relation of inputs and outputs, with a past as short
as its order (T. Soederstroem, P. Stoica, *System Identification*, 1989, chapter 8; M. Gilson, P. Van den Hof,
*Instrumental variable methods for closed-loop system identification*, Automatica 41(2), 2005,
doi:10.1016/j.automatica.2004.09.016). There are more of them than coefficients, so these are found in two
stages: the regressors' least-squares prediction from the instruments first, then the outputs from that. For
predictive control Y. Wang, Y. Qiu, M. Sader, D. Huang, C. Shang, *Data-driven predictive control using
closed-loop data: an instrumental variable approach*, IEEE L-CSS 7, 2023 (arXiv:2309.05916), have excitation
as instruments too, of a whole horizon at once.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import scipy  # whose parts are imported when they are first used

from ddpc_controllers.data.hankel import (
    ONE,
    WindowLayout,
    require_informative,
    signals_of,
    window_starts,
)
from ddpc_cosim import DataError, FloatArray, Recording

Instruments = Literal["none", "open-loop", "closed-loop", "excitation"]

_RANK = 1e-9
_INSTRUMENTS = 2
"""How many samples of the excitation are instruments, in parts of what is predicted from."""
_WINDOWS = 2  # of a recording, per instrument, at least
_CHANCE = 1e-3
"""The probability from which on an input may follow the excitation by chance."""


def predict_all_at_once(data: FloatArray, future: int) -> FloatArray:
    """Return the least-squares predictor, shape (future, rows - future), of the last rows of stacked data."""
    return _least_squares(data[:-future], data[-future:])


def predict_one_by_one(
    signals: Mapping[str, FloatArray],
    seams: Sequence[int],
    layout: WindowLayout,
    known: int,
    by_excitation: bool = False,
) -> FloatArray:
    """Return the predictor of one sample applied sample after sample, to measured and predicted outputs.

    Parameters
    ----------
    signals : mapping of str to array, shape (T, width)
        The recorded inputs "u", outputs "y" and disturbances "d", time along axis 0; "w", what excited them
        from outside, if that is what the instruments are made of.
    seams : sequence of int
        The first sample of every piece of the recording but the first.
    layout : WindowLayout
        How windows are stacked, the predicted outputs in the last block.
    known : int
        How many samples the next one is predicted from: those of a window's known outputs.
    by_excitation : bool
        Whether the instruments are what excited the loop from outside; otherwise what it is predicted from.

    Returns
    -------
    predictor : array, shape (horizon * p, rows above the predicted outputs)
        Its coefficients, in the order of the layout.
    """
    widths = {name: values.shape[1] for name, values in signals.items()} | {ONE: 1}
    *_, (_, _, horizon) = layout.blocks
    rows = sum(length * widths[name] for name, _, length in layout.blocks[:-1])
    # Every sample of a window as a function of the rows that are known of it.
    window = {
        name: np.eye(rows + horizon * widths["y"])[layout.rows_of(name, widths), :rows] for name in widths
    }
    window["y"] = window["y"][: known * widths["y"]]
    coefficients = dict[int, FloatArray]()
    for first in range(horizon):
        # Disturbances act from outside: where that of the predicted sample is there, it is an instrument too.
        disturbances = min(known + 1, len(window["d"]) // widths["d"] - first) if widths["d"] else 0
        if disturbances not in coefficients:
            coefficients[disturbances] = _of_one_sample(
                signals, seams, layout, known, disturbances, by_excitation
            )
        lengths = {"u": known, "y": known, "d": disturbances}
        past = [window[name][first * widths[name] :][: k * widths[name]] for name, k in lengths.items()]
        window["y"] = np.vstack([window["y"], coefficients[disturbances] @ np.vstack([*past, window[ONE]])])
    return window["y"][known * widths["y"] :]


def predict_from_head(
    recording: Recording,
    layout: WindowLayout,
    known: int,
    who: str,
    windows: int | None = None,
    *,
    by_excitation: bool = False,
) -> FloatArray:
    """Return :func:`predict_one_by_one` of the samples of the first windows of a recording, or of all of it.

    Raises
    ------
    DataError
        The newest input follows from all else: see :func:`require_free_inputs`; or it does not follow from
        the excitation that is to be the instrument: see :func:`require_excited_inputs`. It is asked of all
        of the recording.
    """
    signals, seams, end = signals_of(recording), recording.seams, len(recording)
    if by_excitation:
        signals |= {"w": recording.excitation}
        require_excited_inputs(signals, seams, known, who)
    elif windows is None:
        require_free_inputs(signals, seams, known, who)
    if windows is not None:
        end = int(window_starts(end, layout.depth, seams)[windows - 1]) + layout.depth
    head = {name: values[:end] for name, values in signals.items()}
    return predict_one_by_one(head, [seam for seam in seams if seam < end], layout, known, by_excitation)


def require_free_inputs(
    signals: Mapping[str, FloatArray], seams: Sequence[int], known: int, who: str
) -> None:
    """Check that the newest of ``known`` recorded inputs does not follow from all else up to its sample.

    Raises
    ------
    DataError
        It does: a controller without excitation made the recording.
    """
    inputs = signals["u"].shape[1]
    layout = WindowLayout(("u", known - 1, 1), ("u", 0, known - 1), ("y", 0, known), ("d", 0, known))
    samples = layout.stack(signals, seams).T
    require_informative(samples[:, :inputs], samples[:, inputs:], who)


def require_excited_inputs(
    signals: Mapping[str, FloatArray], seams: Sequence[int], known: int, who: str
) -> None:
    """Check that what excited the loop from outside is known, and explains what every input did.

    Raises
    ------
    DataError
        It is not known, has fewer signals than there are inputs, is not recorded for long enough, or an
        input did not follow it beyond chance: see :data:`_CHANCE`.
    """
    (_, m), (samples, excited) = signals["u"].shape, signals["w"].shape
    instead = "or use instruments = 'closed-loop'"
    if excited < m:
        what = f"{excited} signal(s) for {m} input(s)" if excited else "none"
        raise DataError(
            f"{who}: instruments = 'excitation' need what moved each input from outside, such as what was "
            f"added to it, and the recording knows {what}: record around recording.controller, name its "
            f"columns in recording.excitation_columns, {instead}"
        )
    back = _samples_back(signals, known)
    stacked = WindowLayout(("w", 0, back), ("u", back - 1, 1)).stack(signals, seams)
    instruments, windows = len(stacked) - m, stacked.shape[1]
    if windows <= _WINDOWS * instruments:
        raise DataError(
            f"{who}: instruments = 'excitation' with {known} samples of the past are {instruments}, and take "
            f"more than {_WINDOWS * instruments} windows; the recording of {samples} samples has {windows}: "
            f"record longer, shorten initial_length, {instead}"
        )
    moves = stacked - stacked.mean(axis=1, keepdims=True)
    size = np.maximum(np.sqrt(np.mean(np.square(moves), axis=1)), np.finfo(float).tiny)
    factor = np.asarray(np.linalg.qr((moves / size[:, np.newaxis]).T, mode="r"))[:, instruments:]
    explained, left = (np.square(part).sum(axis=0) for part in np.split(factor, [instruments]))
    freedom = windows - instruments - 1
    with np.errstate(divide="ignore"):
        chances = scipy.special.fdtrc(instruments, freedom, explained / instruments / (left / freedom))
    for i in np.flatnonzero(~(chances < _CHANCE)):
        share = 100.0 * explained[i] / (explained[i] + left[i])
        raise DataError(
            f"{who}: input {i + 1} of the recording does not follow what is said to have moved it from "
            f"outside ({share:.2g} % of what it did is explained by that, by chance with probability "
            f"{chances[i]:.2g}): name the signals that moved it, {instead}"
        )


def _samples_back(signals: Mapping[str, FloatArray], known: int) -> int:
    """Return over how many samples the excitation is an instrument."""
    m, p, excited = (int(signals[name].shape[1]) for name in "uyw")
    return math.ceil(_INSTRUMENTS * known * (m + p) / excited)


def _of_one_sample(
    signals: Mapping[str, FloatArray],
    seams: Sequence[int],
    layout: WindowLayout,
    known: int,
    disturbances: int,
    by_excitation: bool,
) -> FloatArray:
    """Return the coefficients of u, y, d and, where the layout has it, 1 in the next output."""
    one = [block for block in layout.blocks if block[0] == ONE]
    back = _samples_back(signals, known) if by_excitation else known
    first, p = back - known, signals["y"].shape[1]
    of_d = [("d", first, disturbances)] if disturbances else []
    given = [("u", first, known), ("y", first, known), *of_d, *one]
    if not by_excitation:
        return predict_all_at_once(WindowLayout(*given, ("y", known, 1)).stack(signals, seams), p)
    d_until = [("d", 0, first + disturbances)] if disturbances else []
    instruments = [("w", 0, back), *d_until, (ONE, 0, 1)]
    widths = {name: values.shape[1] for name, values in signals.items()} | {ONE: 1}
    count = sum(length * widths[name] for name, _, length in instruments)
    stacked = WindowLayout(*instruments, *given, ("y", back, 1)).stack(signals, seams)
    return _in_two_stages(stacked[:count], stacked[count:-p], stacked[-p:])


def _least_squares(given: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the coefficients, smallest where the data leave them open, of rows in other rows."""
    size = np.maximum(np.sqrt(np.mean(np.square(given), axis=1)), np.finfo(float).tiny)
    # The triangular factor has all that least squares need, in a few rows.
    factor = np.asarray(np.linalg.qr(np.vstack([given / size[:, np.newaxis], wanted]).T, mode="r"))
    split = len(given)
    solution = np.linalg.lstsq(factor[:, :split], factor[:, split:], rcond=_RANK)[0]
    return np.asarray(solution.T / size)


def _in_two_stages(instruments: FloatArray, given: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the coefficients of rows in other rows as instruments show them: two-stage least squares."""
    rows = np.vstack([instruments, given, wanted])
    size = np.maximum(np.sqrt(np.mean(np.square(rows), axis=1)), np.finfo(float).tiny)
    # What instruments predict of the other rows is, in coordinates of theirs, the top of the factor.
    factor = np.asarray(np.linalg.qr((rows / size[:, np.newaxis]).T, mode="r"))
    explained = factor[: len(instruments), len(instruments) :]
    split, of = len(given), size[len(instruments) :]
    solution = np.linalg.lstsq(explained[:, :split], explained[:, split:], rcond=_RANK)[0]
    return np.asarray(solution.T * of[split:, np.newaxis] / of[:split])
