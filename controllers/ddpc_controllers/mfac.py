"""Model-free adaptive control, one step ahead, on the three forms of the data model.

Z. Hou and S. Jin, Model Free Adaptive Control: Theory and Applications, CRC Press, 2013, chapter 4; Z. Hou
and S. Jin, IEEE Transactions on Neural Networks 22(12), 2011, doi:10.1109/TNN.2011.2176141 (several inputs
and outputs).
"""

from dataclasses import dataclass

import numpy as np

from ddpc_controllers.change_limits import ChangeLimits, rate_limits
from ddpc_controllers.data_model import Form
from ddpc_controllers.linearised_prediction import LinearisedPrediction
from ddpc_controllers.model_free_adaptive import ModelFreeAdaptive
from ddpc_cosim import Loop, Sample, setting


@dataclass(kw_only=True)
class MFAC(ModelFreeAdaptive):
    """Model-free adaptive control: the change of the inputs that serves the next sample best.

    With one input and one output and all of the book's step factors rho_i equal to ``step_factor``, these
    are its laws. With several, the book divides by ``lambda + |Phi|^2``; here the one-step cost is minimised
    exactly, so that channels that do not act on each other do not slow each other down.
    """

    step_factor: float = setting(0.5, above=0.0, high=1.0, doc="step factor rho of the control law")

    def _prepare(self, loop: Loop, form: Form) -> None:
        self._prediction = LinearisedPrediction(form.regressors(), form.inputs, 1, 1)
        self._ridge = self.lambda_u * np.eye(form.inputs)
        rates = rate_limits(self.rate_bounds, form.inputs) / self._scales.u
        self._limits = ChangeLimits(loop.bounds, rates, 1, optimise=False)

    def _decide(self, sample: Sample) -> tuple[list[float], str]:
        gradients = [phi for gradient in self._model.gradients for phi in gradient.value]
        # y_k+1 = y_k + f + A du_k
        a, f = self._prediction(gradients, self._model.known)
        error = sample.reference[0] - sample.y - f
        hessian, slope = a.T @ a + self._ridge, a.T @ error
        # The cost |y*_k+1 - y_k+1|^2 + lambda |du_k|^2 has its minimum where hessian @ du = slope.
        changes = self.step_factor * self._unlimited(a, error, hessian, slope)
        return self._limits.apply(self._u, changes, hessian, slope)
