"""Models of a recording by several methods, each judged on a stretch that it has not seen."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import DataError
from ddpc_cosim.identification.arx import choose_lags, fit_arx
from ddpc_cosim.identification.innovation import InnovationModel, rows_of
from ddpc_cosim.variables import FloatArray

HELD_OUT = 0.25
"""The last part of the data, on which models of the rest are judged."""
_SHORTEST_BLOCK = 4
"""Of a bootstrap, in numbers of states."""

Fit = Callable[[Recording], InnovationModel]


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A method with its order, its model of all data, and how a model of the first part did on the rest.

    Parameters
    ----------
    method : str
        Its name in study files: ``"arx"``.
    order : int
        What its size is told by: lags, or states.
    model : InnovationModel
        Its model of all data.
    fit : Fit
        Makes its model of other data, of the same order.
    held_out : array, shape (p,)
        Share of each output's variance [%] on the held-out stretch that the simulation from its first state
        explains: 100 is all, 0 what the mean explains.
    error : float
        Root of the mean over the outputs of what is not explained, by which candidates are ordered.
    """

    method: str
    order: int
    model: InnovationModel
    fit: Fit
    held_out: FloatArray
    error: float

    @property
    def words(self) -> str:
        """Method and order for people."""
        return f"ARX, {self.order} {'lag' if self.order == 1 else 'lags'}"


def candidates(recording: Recording, method: str = "auto", order: int = 0) -> tuple[Candidate, ...]:
    """Return models of a recording, that with the smallest error on the held-out stretch first.

    Parameters
    ----------
    recording : Recording
        The data.
    method : str
        One of the methods, or ``"auto"``: all.
    order : int
        Lags or states; 0: by the data.

    Raises
    ------
    DataError
        No method has enough data.
    """
    lags = order or choose_lags(recording)
    return (_candidate(recording, "arx", lags, lambda data: fit_arx(data, lags)),)


def ensemble(
    recording: Recording, candidate: Candidate, members: int, rng: np.random.Generator
) -> tuple[InnovationModel, ...]:
    """Return models of data that might have been recorded as well: how sure the candidate's model is.

    Blocks of the recording are drawn with replacement until there are as many samples (moving blocks: H. R.
    Kuensch, Annals of Statistics 17(3), 1989, doi:10.1214/aos/1176347265). Blocks keep whatever relation the
    inputs had to the outputs, so data that were recorded in closed loop are as good.

    Parameters
    ----------
    recording : Recording
        The data.
    candidate : Candidate
        How models are made.
    members : int
        How many.
    rng : numpy.random.Generator
        Draws the blocks.
    """
    length = max(round(np.sqrt(len(recording)) * 2), _SHORTEST_BLOCK * candidate.model.order + 1)
    pieces = [piece for piece in recording.pieces if len(piece) > candidate.model.order]
    models = list[InnovationModel]()
    for _ in range(members):
        drawn, samples = list[Recording](), 0
        weights = np.array([len(piece) for piece in pieces], dtype=np.float64)
        while samples < len(recording):
            piece = pieces[rng.choice(len(pieces), p=weights / weights.sum())]
            first = int(rng.integers(max(len(piece) - length, 0) + 1))
            block = rows_of(piece, slice(first, first + length))
            drawn.append(block)
            samples += len(block)
        models.append(candidate.fit(Recording.join(drawn)))
    return tuple(models)


def parted(recording: Recording) -> tuple[Recording, Recording]:
    """Return the first part of a recording, and the stretch that is held out."""
    seen = len(recording) - max(round(HELD_OUT * len(recording)), 1)
    first, rest, done = list[Recording](), list[Recording](), 0
    for piece in recording.pieces:
        until = min(max(seen - done, 0), len(piece))
        first += [rows_of(piece, slice(0, until))] if until else []
        rest += [rows_of(piece, slice(until, len(piece)))] if until < len(piece) else []
        done += len(piece)
    return Recording.join(first), Recording.join(rest)


def _candidate(recording: Recording, method: str, order: int, fit: Fit) -> Candidate:
    first, rest = parted(recording)
    left, total = np.zeros(recording.y.shape[1]), np.zeros(recording.y.shape[1])
    model = fit(first)
    for piece in rest.pieces:
        simulated = model.simulate(piece.u, piece.d, x=model.first_state(piece))
        left += np.square(piece.y - simulated).sum(axis=0)
        total += np.square(piece.y - rest.y.mean(axis=0)).sum(axis=0)
    if not total.all():
        raise DataError("an output never moves on the last quarter of the data: no model can be judged there")
    held_out = 100.0 * (1.0 - left / total)
    error = float(np.sqrt((left / total).mean()))
    return Candidate(method, order, fit(recording), fit, held_out, error)
