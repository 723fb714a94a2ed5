"""Whether recorded inputs tell their own effect from that of everything else in the recording."""

import numpy as np

from ddpc_controllers.behavioral import RANK_TOLERANCE, persistency_of_excitation
from ddpc_cosim import DataError, FloatArray


def require_informative(u: FloatArray, known: FloatArray, who: str) -> None:
    """Check that every input does something that what went before it does not foretell.

    Inputs that stand still do not, nor do those of a bare feedback; with an excitation added to it they do.

    Parameters
    ----------
    u : array, shape (N, m)
        Inputs, time along axis 0.
    known : array, shape (N, k)
        What the model explains beside them: outputs measured before each of them, and the inputs before it.
    who : str
        Who asks.

    Raises
    ------
    DataError
        How many inputs do, and by how much the weakest does.
    """
    size, m = len(u), u.shape[1]
    moves = u - u.mean(axis=0)
    length = np.linalg.norm(moves, axis=0)
    still = length <= RANK_TOLERANCE * np.linalg.norm(u, axis=0)
    moves = np.where(still, 0.0, moves / np.where(still, 1.0, length))
    factor = np.asarray(np.linalg.qr(np.hstack([np.ones((size, 1)), known, moves]), mode="r"))
    own = np.linalg.svd(factor[-m:, -m:], compute_uv=False)
    rank = int(np.count_nonzero(own > RANK_TOLERANCE))
    if rank < m:
        order = persistency_of_excitation(np.where(still, 0.0, u - u.mean(axis=0)))
        raise DataError(
            f"{who}: the recorded inputs do not show what they do: they follow from the samples before them, "
            f"or from each other (rank {rank} of {m}, smallest singular value {own[-1]:.1e}; off their means "
            f"they are persistently exciting of order {order}): record with a richer input; in closed loop, "
            "add an excitation to the controller's"
        )
