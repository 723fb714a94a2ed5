"""Linear model predictive control without offset: a Kalman filter and the tracking problem of its model.

Cost, horizon and limits are those of the data-driven methods, so that what differs is the model alone: with
the true model of a linear plant it does what DeePC (8) does with its noise-free recording. A constant
disturbance, estimated beside the states, removes the offset (G. Pannocchia, J. B. Rawlings, AIChE J. 49(2),
2003, doi:10.1002/aic.690490213).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ddpc_controllers.identification import Identified
from ddpc_controllers.model_prediction import Predictor, TrackingSettings
from ddpc_controllers.models import ModelSource, source_faults
from ddpc_controllers.observer import DISTURBANCES, LOST_MEASUREMENT, Disturbance, Noise, Observer
from ddpc_controllers.recorded import resting_input
from ddpc_controllers.validation import check_settings_and
from ddpc_cosim import Action, Controller, FloatArray, Loop, Sample, setting


@dataclass(kw_only=True)
class MPC(TrackingSettings, Controller):
    """Linear model predictive control with an estimated disturbance.

    A measurement that is not finite is replaced by the model's prediction; before the first finite one the
    inputs stay at rest. Either is a status.
    """

    model: ModelSource = setting(default_factory=Identified, doc="where the linear model comes from")
    disturbance: Disturbance = setting(
        "output", choices=DISTURBANCES, doc="what carries the constant disturbance that is estimated"
    )
    process_noise: float = setting(
        1.0, above=0.0, doc="filter: standard deviation of what adds to the inputs"
    )
    disturbance_noise: float = setting(
        1.0, above=0.0, doc="filter: standard deviation of the disturbance's change per sample"
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
        """Get the model, and condense its tracking problem.

        Raises
        ------
        DataError
            The recording cannot serve the model's identification.
        ConfigError
            The model or a weight does not fit the loop, or the disturbance cannot be estimated.
        """
        noise = Noise(self.process_noise, self.disturbance_noise, self.measurement_noise)
        self._observer = Observer(self.model.model(loop), self.disturbance, noise)
        self._predictor = Predictor(self._observer.a, self._observer.b, self._observer.c, self, loop.bounds)
        self._u = resting_input(loop)
        self._resting = True
        if loop.continues_recording and loop.recording is not None:
            self._observer.follow(loop.recording.u, loop.recording.y)
            self._u, self._resting = loop.recording.u[-1], False

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the first optimal inputs of the horizon."""
        observer = self._observer
        lost = "" if np.isfinite(sample.y).all() else LOST_MEASUREMENT
        if self._resting:
            if lost:
                return Action(self._u.copy(), lost)
            observer.rest(self._u, sample.y)
            self._resting = False
        observer.correct(sample.y)
        u, fault = self._predictor.solve(observer.state, self._u, sample.reference)
        observer.predict(u)
        self._u = u.copy()
        return Action(u, fault or lost) if fault or lost else u

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model with its disturbances, and its slowest or most unstable pole."""
        a = self._observer.a[:-1, :-1]
        return {"model_order": float(len(a)), "spectral_radius": float(np.abs(np.linalg.eigvals(a)).max())}

    def _faults_between_settings(self) -> list[str]:
        return source_faults(self.model, "MPC") + self.tracking_faults()
