"""What the programs that the paper's authors published do and equations (8) and (10)-(12) do not.

Subclasses, so that no setting of a method serves only them. Their trajectories are those of the programs.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import numpy as np

from ddpc_controllers.checks import all_finite
from ddpc_controllers.data.dictionaries import Lift, ThinPlate
from ddpc_controllers.data.hankel import ONE, hankel_matrix
from ddpc_controllers.deepc import DeePC, Regulariser
from ddpc_controllers.export.code import Code
from ddpc_controllers.optimisation.condensing import condense
from ddpc_controllers.optimisation.qp import ParametricQP
from ddpc_controllers.wkpc import WKPC
from ddpc_cosim import Action, ConfigError, DataError, FloatArray, Loop, Recording, Sample, setting


def padded_with_zeros(recording: Recording, samples: int) -> Recording:
    """Append samples of zero to inputs and outputs, and drop as many in front.

    Raises
    ------
    DataError
        There are several experiments, which the programs do not know.
    """
    if recording.seams:
        raise DataError(
            f"the published programs learn from one experiment; there are {len(recording.pieces)}"
        )

    def pad(signal: FloatArray) -> FloatArray:
        return np.vstack([signal, np.zeros((samples, signal.shape[1]))])[samples:]

    u, y, d = map(pad, (recording.u, recording.y, recording.d))
    return Recording(u, y, recording.measured, recording.sampling_time, d=d)


@dataclass(kw_only=True)
class PublishedDeePC(DeePC):
    """DeePC as the published program has it.

    It appends ``initial_length`` samples of zero to the recording before it builds the Hankel matrices, which
    plants a jump in the data, and requires that the first N entries of g alone sum to 1.
    """

    regulariser: Regulariser = setting(
        "ridge", choices=get_args(Regulariser), doc="what lambda_g weighs of g: see DeePC"
    )
    terminal_equality: bool = setting(
        True, doc="the last initial_length predicted samples equal the artificial setpoint"
    )
    instruments: Literal["none"] = setting("none", choices=("none",), doc="the program averages nothing")
    affine_sum: str = setting(
        "first-horizon", choices=("first-horizon",), doc="which entries of g sum to 1: the first N"
    )

    def _faults_between_settings(self) -> list[str]:
        faults = super()._faults_between_settings()
        if self.online_data != "frozen":
            faults.append(
                "PublishedDeePC: the first N entries of g belong to windows of the recording, which "
                "online_data replaces; use deepc with affine_sum = 'all'"
            )
        return faults

    def prediction_errors(self, recording: Recording) -> None:
        """Return None: errors on samples of which some are made up compare with nobody else's."""

    def _stack(self, recording: Recording) -> FloatArray:
        data = super()._stack(padded_with_zeros(recording, self.initial_length))
        data[self._rows_of(ONE, recording), self.horizon :] = 0.0
        return data


@dataclass(kw_only=True)
class PublishedWKPC(WKPC):
    """WKPC as the published program has it.

    The recorded inputs and outputs are padded with zeros as in :class:`PublishedDeePC`. Instead of (12), one
    new centre is drawn at every evaluation and used for all functions, which makes them equal and no function
    of the state, and the logarithm is multiplied by the square of the distance. The lifted recording is a
    memory that grows by two samples a step, the last state and the new one, each lifted anew; the lifted
    Hankel matrix is rebuilt from its last T samples but the last N, while those of inputs and outputs stay.
    """

    regulariser: Literal["ridge", "projection"] = setting(
        "ridge", choices=("ridge", "projection"), doc="what lambda_g weighs of g: see WKPC"
    )
    dictionary: ThinPlate = setting(
        default_factory=ThinPlate, doc="number of functions, and box of their centres"
    )

    def _faults_between_settings(self) -> list[str]:
        faults = super()._faults_between_settings()
        if not isinstance(self.dictionary, ThinPlate):
            faults.append(f"PublishedWKPC: dictionary = {self.dictionary!r} is not a ThinPlate")
        if self.online_data != "frozen":
            faults.append("PublishedWKPC: the program leaves no data that online_data could update")
        return faults

    def _draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        return partial(_redrawn, plates=self.dictionary, rng=rng)

    def prediction_errors(self, recording: Recording) -> None:
        """Return None: errors on samples of which some are made up compare with nobody else's."""

    def _stack(self, recording: Recording, lifted: FloatArray) -> FloatArray:
        return super()._stack(padded_with_zeros(recording, self.initial_length), lifted)

    def restart(self, loop: Loop) -> None:
        """Begin anew, the lifted memory included, which has grown."""
        self.start(loop)

    def _begin(self, loop: Loop, recording: Recording) -> None:
        super()._begin(loop, recording)
        self._lifted, self._last_state = self._recorded.copy(), np.empty(0)

    def _step(self, sample: Sample) -> FloatArray | Action:
        if all_finite(sample.y) and all_finite(sample.measured):
            self._shift(self._last.take(sample.measured))
        elif not self._resting:
            self._shift(self._last.complete(sample.measured))
        return super()._step(sample)

    def _c_step(self, code: Code, loop: Loop) -> str:
        raise ConfigError(
            "PublishedWKPC cannot be exported: the program draws random centres and condenses its problem "
            "anew at every sample: use WKPC"
        )

    def _rest(self, sample: Sample) -> None:
        """Start from rest, but with the lifted memory of the recording."""
        self._resting = False
        self._parameters.fill("y_ini", sample.y)
        self._outlook.begin(self._parameters, sample.disturbance / self._scales.d)

    def _append_state(self, state: FloatArray) -> None:
        """Do nothing: the lifted past is that of the memory."""

    def _shift(self, state: FloatArray) -> None:
        """Take a new state, shape (q,), and condense the problem on the shifted memory."""
        last, self._last_state = self._last_state, state.copy()
        past = self.initial_length
        if last.size:
            self._lifted[:-2] = self._lifted[2:]
            self._lifted[-2], self._lifted[-1] = self._lift(last), self._lift(state)
            hankel = hankel_matrix(self._lifted[: -self.horizon], past)
            self._data[: len(hankel)] = hankel
            if isinstance(self._law, ParametricQP):
                self._law.replace(condense(self._problem, self._data))
        self._parameters.fill("z_ini", self._lifted[-past:])


def _redrawn(states: FloatArray, plates: ThinPlate, rng: np.random.Generator) -> FloatArray:
    """Return ``d^2 log10(d)`` for all functions, d the distance to one centre drawn anew for every state."""
    distance = np.sqrt(np.square(states - rng.uniform(plates.low, plates.high, states.shape)).sum(axis=-1))
    logarithm = np.log10(distance, out=np.zeros_like(distance), where=distance > 0.0)
    return np.repeat((distance**2 * logarithm)[..., np.newaxis], plates.count, axis=-1)
