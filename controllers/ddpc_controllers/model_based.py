"""What the controllers on a linear model share: where it comes from, and a Kalman filter on it."""

from dataclasses import dataclass, replace
from typing import ClassVar

from ddpc_controllers.identification import Identified
from ddpc_controllers.models import ModelSource, SampledModel, source_faults
from ddpc_controllers.observer import Disturbance, Noise, Observer
from ddpc_controllers.recorded import resting_input
from ddpc_controllers.scaling import ScaledSignals, Scales
from ddpc_controllers.validation import check_settings_and
from ddpc_cosim import FloatArray, Loop, setting


@dataclass(kw_only=True)
class ModelBased(ScaledSignals):
    """Base of the controllers on a linear model.

    A measurement that is not finite is replaced by the model's prediction; before the first finite one the
    inputs stay at rest. Either is a status.
    """

    accepts_missing: ClassVar[bool] = True

    model: ModelSource = setting(default_factory=Identified, doc="where the linear model comes from")
    process_noise: float = setting(
        1.0, above=0.0, doc="filter: standard deviation of what adds to the inputs"
    )
    measurement_noise: float = setting(0.1, above=0.0, doc="filter: standard deviation of the measurements")

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)

    @property
    def uses_recording(self) -> bool:  # type: ignore[override]  # its model decides
        """Whether ``start`` needs a recording."""
        return self.model.uses_recording

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return the fewest samples that the model's identification can work with."""
        return self.model.recording_length(inputs, outputs)

    def start(self, loop: Loop) -> None:
        """Get the model, and start on the loop in scaled signals.

        Raises
        ------
        DataError
            The recording cannot serve the model's identification.
        ConfigError
            The model or a setting does not fit the loop.
        """
        self._model = self._scaled_model(loop)
        super().start(loop)

    def _scaled_model(self, loop: Loop) -> SampledModel:
        """Return the model of scaled signals: identified from them, or given for the signals themselves."""
        scales = Scales.of(loop, self.scaling)
        if self.model.uses_recording:
            return self.model.model(scales.scaled_loop(loop))
        given = self.model.model(loop)
        return replace(
            given,
            b=given.b * scales.u,
            c=given.c / scales.y[:, None],
            u_0=given.u_0 / scales.u,
            y_0=given.y_0 / scales.y,
        )

    def _observe(self, loop: Loop, disturbance: Disturbance, disturbance_noise: float) -> None:
        """Set up the filter, and have it at the recording's end if the loop goes on there."""
        noise = Noise(self.process_noise, disturbance_noise, self.measurement_noise)
        self._observer = Observer(self._model, disturbance, noise)
        self._u: FloatArray = resting_input(loop)
        self._resting = True
        if loop.continues_recording and loop.recording is not None:
            self._observer.follow(loop.recording.u, loop.recording.y)
            self._u, self._resting = loop.recording.u[-1], False

    def _faults_between_settings(self) -> list[str]:
        return source_faults(self.model, type(self).__name__)
