"""A plant has diverged where an output is not finite any more."""

from collections.abc import Sequence

import numpy as np

from ddpc_cosim.variables import FloatArray, Variable


class NotFiniteError(Exception):
    """The plant returned a value that is not finite."""


def require_finite(y_plant: FloatArray, outputs: Sequence[Variable]) -> None:
    """Raise NotFiniteError if an output is not finite."""
    if not np.isfinite(y_plant).all():
        bad = int(np.flatnonzero(~np.isfinite(y_plant))[0])
        raise NotFiniteError(f"output {outputs[bad].name} is {y_plant[bad]}")
