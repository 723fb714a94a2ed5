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
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from ddpc_controllers.data.hankel import (
    ONE,
    WindowLayout,
    require_informative,
    signals_of,
    window_starts,
)
from ddpc_cosim import FloatArray, Recording

Instruments = Literal["none", "open-loop", "closed-loop"]

_RANK = 1e-9


def predict_all_at_once(data: FloatArray, future: int) -> FloatArray:
    """Return the least-squares predictor, shape (future, rows - future), of the last rows of stacked data."""
    return _least_squares(data[:-future], data[-future:])


def predict_one_by_one(
    signals: Mapping[str, FloatArray], seams: Sequence[int], layout: WindowLayout, known: int
) -> FloatArray:
    """Return the predictor of one sample applied sample after sample, to measured and predicted outputs.

    Parameters
    ----------
    signals : mapping of str to array, shape (T, width)
        The recorded inputs "u", outputs "y" and disturbances "d", time along axis 0.
    seams : sequence of int
        The first sample of every piece of the recording but the first.
    layout : WindowLayout
        How windows are stacked, the predicted outputs in the last block.
    known : int
        How many samples the next one is predicted from: those of a window's known outputs.

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
            coefficients[disturbances] = _of_one_sample(signals, seams, layout, known, disturbances)
        lengths = {"u": known, "y": known, "d": disturbances}
        past = [window[name][first * widths[name] :][: k * widths[name]] for name, k in lengths.items()]
        window["y"] = np.vstack([window["y"], coefficients[disturbances] @ np.vstack([*past, window[ONE]])])
    return window["y"][known * widths["y"] :]


def predict_from_head(
    recording: Recording, layout: WindowLayout, known: int, who: str, windows: int | None = None
) -> FloatArray:
    """Return :func:`predict_one_by_one` of the samples of the first windows of a recording, or of all of it.

    Raises
    ------
    DataError
        The newest input follows from all else: see :func:`require_free_inputs`. It is asked of all of it.
    """
    signals, seams, end = signals_of(recording), recording.seams, len(recording)
    if windows is None:
        require_free_inputs(signals, seams, known, who)
    else:
        end = int(window_starts(end, layout.depth, seams)[windows - 1]) + layout.depth
    head = {name: values[:end] for name, values in signals.items()}
    return predict_one_by_one(head, [seam for seam in seams if seam < end], layout, known)


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


def _of_one_sample(
    signals: Mapping[str, FloatArray],
    seams: Sequence[int],
    layout: WindowLayout,
    known: int,
    disturbances: int,
) -> FloatArray:
    """Return the coefficients of u, y, d and, where the layout has it, 1 in the next output."""
    one = [block for block in layout.blocks if block[0] == ONE]
    given = [("u", 0, known), ("y", 0, known), *([("d", 0, disturbances)] if disturbances else []), *one]
    return predict_all_at_once(
        WindowLayout(*given, ("y", known, 1)).stack(signals, seams), signals["y"].shape[1]
    )


def _least_squares(given: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the coefficients, smallest where the data leave them open, of rows in other rows."""
    size = np.maximum(np.sqrt(np.mean(np.square(given), axis=1)), np.finfo(float).tiny)
    # The triangular factor has all that least squares need, in a few rows.
    factor = np.asarray(np.linalg.qr(np.vstack([given / size[:, np.newaxis], wanted]).T, mode="r"))
    split = len(given)
    solution = np.linalg.lstsq(factor[:, :split], factor[:, split:], rcond=_RANK)[0]
    return np.asarray(solution.T / size)
