"""Koopman model predictive control: an EDMD model in place of WKPC's recording.

The lifted state is measured, so it needs no observer; what the model gets wrong about it is low-pass filtered
and taken for a constant disturbance, ``z+ = A z + B u + w``, which leaves no offset (U. Maeder, F. Borrelli,
M. Morari, Linear offset-free model predictive control, Automatica 45(10), 2009,
doi:10.1016/j.automatica.2009.06.005). For the model see :mod:`ddpc_controllers.edmd`; cost, horizon and
limits are those of (11).
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ddpc_controllers.dictionaries import Dictionary, ThinPlate, memory_of, require_dictionary
from ddpc_controllers.edmd import STATE_KINDS, LiftedState, StateKind, fit_lifted_model, require_samples
from ddpc_controllers.model_prediction import Predictor, TrackingSettings
from ddpc_controllers.observer import LOST_MEASUREMENT
from ddpc_controllers.recorded import matching_recording, resting_input
from ddpc_controllers.scaling import ScaledSignals
from ddpc_controllers.validation import check_settings_and
from ddpc_cosim import Action, FloatArray, Loop, Sample, setting


@dataclass(kw_only=True)
class KoopmanMPC(TrackingSettings, ScaledSignals):
    """Model predictive control with an EDMD model.

    Where what is lifted is not finite, the model's prediction replaces it; before the first finite sample the
    inputs stay at rest. Either is a status.
    """

    uses_recording: ClassVar[bool] = True
    accepts_missing: ClassVar[bool] = True

    state: StateKind = setting(
        "measured",
        choices=STATE_KINDS,
        doc="state that is lifted: all measured, or outputs and inputs with past",
    )
    delays: int = setting(2, low=1, doc='past samples in the state, with state = "delays"')
    dictionary: Dictionary = setting(
        default_factory=ThinPlate, doc="observables that lift the state; with Identity the model is DMD's"
    )
    ridge: float = setting(1e-8, low=0.0, doc="weight of the squared coefficients in the least squares")
    disturbance_gain: float = setting(
        0.5, low=0.0, high=1.0, doc="share of a new one-step error that is believed; 0: no disturbance"
    )

    def __post_init__(self) -> None:
        check_settings_and(self, self.tracking_faults)
        require_dictionary(self.dictionary, "KoopmanMPC: dictionary")

    def _start(self, loop: Loop) -> None:
        """Lift the loop's recording, fit the model and condense its tracking problem."""
        recording = matching_recording(loop, "KoopmanMPC")
        # A copy of the stream: another start draws the same centres.
        rng = copy.deepcopy(loop.rng)
        self._lifted = LiftedState(self.state, self.delays, self.dictionary, recording, rng)
        z, used = self._lifted.recorded, slice(self._lifted.lost, None)
        n_z, m = z.shape[1], len(loop.inputs)
        require_samples(len(z) - 1, n_z + m, "KoopmanMPC")
        self._model = model = fit_lifted_model(z, recording.u[used], recording.y[used], self.ridge)
        # The state of the problem is (z, w).
        a = np.block([[model.a, np.eye(n_z)], [np.zeros((n_z, n_z)), np.eye(n_z)]])
        b, c = np.vstack([model.b, np.zeros((n_z, m))]), np.hstack([model.c, np.zeros_like(model.c)])
        self._disturbance = np.zeros(n_z)
        self._predicted: FloatArray | None = None
        self._u = resting_input(loop)
        self._predictor = Predictor(a, b, c, self, loop.bounds, self._scales.u, self._u)
        if loop.continues_recording:
            self._u = recording.u[-1].copy()
            self._predicted = model.a @ z[-1] + model.b @ self._u

    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return the first optimal inputs of the horizon."""
        lifted = sample.y if self.state == "delays" else sample.measured
        lost = "" if np.isfinite(lifted).all() else LOST_MEASUREMENT
        if lost and self._predicted is None:
            return Action(self._u.copy(), lost)
        z = self._state(sample, bool(lost))
        u, fault = self._predictor.solve(np.concatenate([z, self._disturbance]), self._u, sample.reference)
        self._predicted = self._model.a @ z + self._model.b @ u + self._disturbance
        self._u = u.copy()
        return Action(u, fault or lost) if fault or lost else u

    def _state(self, sample: Sample, lost: bool) -> FloatArray:
        """Return z, and learn from what was predicted of it."""
        predicted = self._predicted
        if predicted is None:
            return self._lifted.rest(sample.y, sample.measured, self._u)
        if lost:
            return self._lifted.follow(self._model.c @ predicted, predicted[: len(sample.measured)], self._u)
        z = self._lifted.follow(sample.y, sample.measured, self._u)
        self._disturbance += self.disturbance_gain * (z - predicted)
        return z

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return the samples at which there are as many equations as coefficients."""
        size, lost = measurements, 0
        if self.state == "delays":
            size, lost = (self.delays + 1) * outputs + self.delays * inputs, self.delays
        lifted = size + self.dictionary.functions(size)
        return lost + memory_of(self.dictionary) + lifted + inputs + 1

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model, its slowest or most unstable pole, and its worst one-step error."""
        return {
            "model_order": float(len(self._model.a)),
            "spectral_radius": float(np.abs(np.linalg.eigvals(self._model.a)).max()),
            "one_step_error": float(self._model.error.max()),
        }
