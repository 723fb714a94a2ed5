"""Linear-quadratic regulator with integral action and a Kalman filter.

    u = u_0 - K_x x^ - K_z z,   z+ = z + y - r,

K minimises the sum of ``|y - y_0|_Q^2 + |z|_Qi^2 + |u - u_0|_R^2`` for the sampled model (K. J. Astrom,
R. M. Murray, Feedback Systems, 2nd ed., sections 7.4 and 8.4). Where an input reaches its limit, the sums z
are set back to what the limited input agrees with, so that they do not wind up.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ddpc_controllers.control_api import regulator_gain
from ddpc_controllers.identification import Identified
from ddpc_controllers.models import ModelSource, source_faults
from ddpc_controllers.observer import LOST_MEASUREMENT, Noise, Observer
from ddpc_controllers.recorded import resting_input
from ddpc_controllers.validation import check_settings_and, weight_matrices
from ddpc_cosim import Action, ConfigError, Controller, FloatArray, Loop, Sample, Weight, setting


@dataclass(kw_only=True)
class LQR(Controller):
    """Linear-quadratic regulator with integral action and a Kalman filter.

    A measurement that is not finite is replaced by the model's prediction; before the first finite one the
    inputs stay at rest. Either is a status.
    """

    model: ModelSource = setting(default_factory=Identified, doc="where the linear model comes from")
    output_weight: Weight = setting(1.0, low=0.0, doc="Q: outputs off the operating point")
    integral_weight: Weight = setting(1.0, above=0.0, doc="Qi: sums of the control errors")
    input_weight: Weight = setting(0.1, above=0.0, doc="R: inputs off the operating point")
    process_noise: float = setting(
        1.0, above=0.0, doc="filter: standard deviation of what adds to the inputs"
    )
    measurement_noise: float = setting(0.1, above=0.0, doc="filter: standard deviation of the measurements")

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)

    accepts_missing: ClassVar[bool] = True

    @property
    def uses_recording(self) -> bool:  # type: ignore[override]  # its model decides
        """Whether ``start`` needs a recording."""
        return self.model.uses_recording

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return the fewest samples that the model's identification can work with."""
        return self.model.recording_length(inputs, outputs)

    def start(self, loop: Loop) -> None:
        """Get the model and solve the two Riccati equations.

        Raises
        ------
        DataError
            The recording cannot serve the model's identification.
        ConfigError
            The model or a weight does not fit the loop, or there is no stabilising gain.
        """
        model = self.model.model(loop)
        n, m, p = len(model.a), len(loop.inputs), len(loop.outputs)
        if p > m:
            raise ConfigError(
                f"LQR: {m} input(s) cannot hold {p} outputs at their references: control fewer outputs"
            )
        q, qi, r = weight_matrices(
            output_weight=(self.output_weight, p),
            integral_weight=(self.integral_weight, p),
            input_weight=(self.input_weight, m),
        )
        weight = np.block([[model.c.T @ q @ model.c, np.zeros((n, p))], [np.zeros((p, n)), qi]])
        gain = regulator_gain(model.a, model.b, weight, r, model.c)
        self._state_gain, self._sum_gain = gain[:, :n], gain[:, n:]
        self._sums_of_inputs = np.linalg.pinv(self._sum_gain)
        self._bounds, self._u_0 = loop.bounds, model.u_0
        # The sums take up what does not change, so the filter estimates no disturbance.
        noise = Noise(self.process_noise, 0.0, self.measurement_noise)
        self._observer = Observer(model, "none", noise)
        self._sum: FloatArray | None = None
        self._u = resting_input(loop)
        self._resting = True
        if loop.continues_recording and loop.recording is not None:
            self._observer.follow(loop.recording.u, loop.recording.y)
            self._u, self._resting = loop.recording.u[-1], False

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs that the gain asks for, within their limits."""
        observer = self._observer
        lost = not np.isfinite(sample.y).all()
        if self._resting:
            if lost:
                return Action(self._u.copy(), LOST_MEASUREMENT)
            observer.rest(self._u, sample.y)
            self._resting = False
        observer.correct(sample.y)
        y = np.where(np.isfinite(sample.y), sample.y, observer.c @ observer.state)
        feedback = self._u_0 - self._state_gain @ observer.state[:-1]
        if self._sum is None:  # the loop closes without a bump
            self._sum = self._sums_of_inputs @ (feedback - self._u)
        total = self._sum + y - sample.reference[0]
        wanted = feedback - self._sum_gain @ total
        u: FloatArray = np.clip(wanted, self._bounds.u_min, self._bounds.u_max)
        self._sum = total - self._sums_of_inputs @ (u - wanted)
        observer.predict(u)
        return Action(u, LOST_MEASUREMENT) if lost else u

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model."""
        return {"model_order": float(len(self._observer.state) - 1)}

    def _faults_between_settings(self) -> list[str]:
        return source_faults(self.model, "LQR")
