"""Linear model predictive control without offset: a Kalman filter and the tracking problem of its model.

Cost, horizon and limits are those of the data-driven methods, so that what differs is the model alone: with
the true model of a linear plant it does what DeePC (8) does with its noise-free recording. A constant
disturbance, estimated beside the states, removes the offset (G. Pannocchia, J. B. Rawlings, AIChE J. 49(2),
2003, doi:10.1002/aic.690490213).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ddpc_controllers.model_based import ModelBased
from ddpc_controllers.model_prediction import Predictor, TrackingSettings
from ddpc_controllers.observer import DISTURBANCES, LOST_MEASUREMENT, Disturbance
from ddpc_controllers.recorded import resting_input
from ddpc_cosim import Action, FloatArray, Loop, Sample, setting


@dataclass(kw_only=True)
class MPC(TrackingSettings, ModelBased):
    """Linear model predictive control with an estimated disturbance.

    A measurement that is not finite is replaced by the model's prediction; before the first finite one the
    inputs stay at rest. Either is a status.
    """

    disturbance: Disturbance = setting(
        "auto",
        choices=DISTURBANCES,
        doc="what carries the constant disturbance estimated; auto: the outputs, the inputs of a plant "
        "that integrates, or is too slow to tell",
    )
    disturbance_noise: float = setting(
        1.0, above=0.0, doc="filter: standard deviation of the disturbance's change per sample"
    )

    def _start(self, loop: Loop) -> None:
        """Set up the filter, and condense the model's tracking problem."""
        self._observe(loop, self.disturbance, self.disturbance_noise)
        model = self._observer
        self._predictor = Predictor(
            model.a, model.b, model.c, self, loop.bounds, self._scales.u, resting_input(loop)
        )

    def _step(self, sample: Sample) -> FloatArray | Action:
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
        """Return the order of the model with its disturbances, its slowest or most unstable pole, its fit."""
        a = self._observer.a[:-1, :-1]
        figures = {"model_order": float(len(a)), "spectral_radius": float(np.abs(np.linalg.eigvals(a)).max())}
        return figures | self._model.fit

    def _faults_between_settings(self) -> list[str]:
        return super()._faults_between_settings() + self.tracking_faults()
