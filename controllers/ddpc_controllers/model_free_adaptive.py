"""What MFAC and MFAPC share: a data model and its settings."""

from abc import abstractmethod
from dataclasses import dataclass
from math import isfinite, sqrt
from operator import sub
from typing import ClassVar

import numpy as np
from scipy.linalg.lapack import dposv

from ddpc_controllers.change_limits import NOT_FINITE
from ddpc_controllers.data_model import DataModel, Form
from ddpc_controllers.pseudo_jacobian import Estimation
from ddpc_controllers.recorded import resting_input
from ddpc_controllers.scaling import ScaledSignals
from ddpc_cosim import Action, FloatArray, Loop, Sample, Weight, setting


@dataclass(kw_only=True)
class ModelFreeAdaptive(ScaledSignals):
    """Base of the controllers on a data model (14); not a controller by itself.

    Needs no recording: it estimates how the outputs follow the inputs while it controls. A measurement that
    is not finite is a counted failure: the inputs are held, nothing is learned, and the signals before it
    are forgotten, but not the estimates.
    """

    uses_recording: ClassVar[bool] = False
    accepts_missing: ClassVar[bool] = True

    form: str = setting(
        "cfdl", choices=("cfdl", "pfdl", "ffdl"), doc="data model: compact, partial or full form"
    )
    input_length: int = setting(3, low=1, doc="Lu: input changes in the partial and the full form, samples")
    output_length: int = setting(1, low=1, doc="Ly: output changes in the full form, samples")
    structure: str = setting(
        "full",
        choices=("full", "diagonal"),
        doc="whether each output follows all inputs, or only its own (and its own past)",
    )
    lambda_u: float = setting(0.37, above=0.0, doc="weight of the input changes, lambda in (19)")
    eta: float = setting(1.0, above=0.0, high=2.0, doc="step factor of the estimation (16)")
    mu: float = setting(1.0, above=0.0, doc="damping of the estimation (16)")
    epsilon: float = setting(1e-5, above=0.0, doc="smallest change and gradient that are believed (17)")
    assume_sign: bool = setting(
        True,
        doc="hold the direction of control against the estimates (17), Remark 1; otherwise they may change "
        "their sign, and a quiet loop keeps its last one",
    )
    initial_gradient: Weight = setting(
        0.1,
        doc="phi_1 with the sign of the control direction: a number or a list for the diagonal, p x m for "
        "the latest input changes, or p x (p Ly + m Lu) in the order of the data model",
    )
    rate_bounds: Weight = setting(
        (), above=0.0, doc="largest change of each input per sample, in its unit; empty: none"
    )

    def _start(self, loop: Loop) -> None:
        """Forget what was learned."""
        ly = self.output_length if self.form == "ffdl" else 0
        lu = self.input_length if self.form != "cfdl" else 1
        form = Form(len(loop.outputs), len(loop.inputs), ly, lu, self.structure == "diagonal")
        constants = Estimation(eta=self.eta, mu=self.mu, epsilon=self.epsilon, assume_sign=self.assume_sign)
        self._model = DataModel(form, form.initial_gradients(self.initial_gradient), constants)
        self._u: list[float] = resting_input(loop).tolist()
        if loop.continues_recording and loop.recording is not None:
            self._u = loop.recording.u[-1].tolist()
            self._model.resume(loop.recording)
        self._prepare(loop, form)

    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return the last inputs plus the change that the method finds."""
        y: list[float] = sample.y.tolist()
        if not isfinite(sum(y)):
            self._model.pause()
            return Action(np.array(self._u), NOT_FINITE)
        self._model.observe(y)
        u, fault = self._decide(sample)
        self._model.apply(list(map(sub, u, self._u)))
        self._u = u
        return Action(np.array(u), fault) if fault else np.array(u)

    def _unlimited(
        self, a: FloatArray, error: FloatArray, hessian: FloatArray, slope: FloatArray
    ) -> FloatArray:
        """Return the changes that minimise ``|error - a dU|^2 + lambda_u |dU|^2``, limits aside.

        Their normal equations ``hessian dU = slope`` are the fast way. Where lambda_u is lost in the rounding
        of a'a the factorisation fails, and the least squares that they come from are solved instead.
        """
        _, changes, fault = dposv(hessian, slope)
        if fault and isfinite(hessian.sum() + slope.sum()):
            n = len(slope)
            stacked = np.vstack([a, sqrt(self.lambda_u) * np.eye(n)])
            changes = np.linalg.lstsq(stacked, np.append(error, np.zeros(n)))[0]
        answer: FloatArray = changes
        return answer

    @abstractmethod
    def _prepare(self, loop: Loop, form: Form) -> None:
        """Set up what the method needs besides the data model."""

    @abstractmethod
    def _decide(self, sample: Sample) -> tuple[list[float], str]:
        """Return the next inputs, within their limits, and why they are a fallback; empty if they are not."""
