"""Derivatives of an FMU for Model Exchange by differences of what it computes beside a point."""

from collections.abc import Sequence
from ctypes import c_double

import numpy as np

from ddpc_cosim.fmu.instance import Model
from ddpc_cosim.fmu.model_description import Signal
from ddpc_cosim.fmu.ports import Port, Shapes
from ddpc_cosim.variables import FloatArray

# Where rounding and curvature weigh the same in a central difference (W. H. Press et al., Numerical Recipes,
# 3rd ed., section 5.7).
_STEP = float(np.finfo(float).eps) ** (1.0 / 3.0)


class Surroundings:
    """The point at which a model is, and what it computes beside it.

    Parameters
    ----------
    model : Model
        The instance, in continuous-time mode.
    inputs, outputs : sequence of Signal
        Real numbers to change and to read.
    shapes : mapping of str to tuple of int
        Sizes of arrays that differ from the description's.

    Attributes
    ----------
    x_0, u_0, y_0, rate : array, shapes (n,), (m,), (p,) and (n,)
        States, inputs, outputs and derivatives of the states at the point.
    scale : array, shape (n + m,)
        Typical magnitudes of states and inputs.
    low, high : array, shape (n + m,)
        Limits of states and inputs; infinite for states.
    """

    def __init__(
        self, model: Model, inputs: Sequence[Signal], outputs: Sequence[Signal], shapes: Shapes
    ) -> None:
        self._model, self._n = model, model.sizes()[0]
        self._inputs, self._outputs = Port(model, inputs, shapes), Port(model, outputs, shapes)
        self._memory = (c_double * self._n)()
        model.get_states(self._memory, self._n)
        self.x_0, self.u_0 = np.array(self._memory), self._inputs.read()
        self.rate, self.y_0 = self._rate(), self._outputs.read()
        model.get_nominals(self._memory, self._n)
        typical = np.array([*self._memory, *(signal.variable.nominal for signal in inputs)])
        usable = np.isfinite(typical) & (typical != 0.0)
        self.scale = np.maximum(np.where(usable, np.abs(typical), 1.0), np.abs([*self.x_0, *self.u_0]))
        free = [np.inf] * self._n
        self.low = np.array([*(-x for x in free), *(signal.variable.min for signal in inputs)])
        self.high = np.array([*free, *(signal.variable.max for signal in inputs)])

    def at(self, point: FloatArray) -> FloatArray:
        """Go to states and inputs, shape (n + m,); return rates and outputs there, shape (n + p,)."""
        self._memory[:] = point[: self._n].tolist()
        self._model.set_states(self._memory, self._n)
        self._inputs.write(point[self._n :])
        return np.concatenate([self._rate(), self._outputs.read()])

    def _rate(self) -> FloatArray:
        self._model.get_derivatives(self._memory, self._n)
        return np.array(self._memory)


def central_differences(around: Surroundings) -> FloatArray:
    """Return the derivatives of rates and outputs by states and inputs, shape (n + p, n + m).

    The steps follow the nominal values. An input at its limit is changed to one side only.
    """
    here = np.concatenate([around.x_0, around.u_0])
    step = _STEP * around.scale
    below, above = np.maximum(here - step, around.low), np.minimum(here + step, around.high)
    stuck = ~(above > below)
    below, above = np.where(stuck, here - step, below), np.where(stuck, here + step, above)
    columns = []
    for i in range(len(here)):
        beside = [here.copy(), here.copy()]
        beside[0][i], beside[1][i] = below[i], above[i]
        low, high = (around.at(point) for point in beside)
        with np.errstate(over="ignore", invalid="ignore"):  # the caller says what is not finite
            columns.append((high - low) / (above[i] - below[i]))
    around.at(here)
    return np.stack(columns, axis=1)
