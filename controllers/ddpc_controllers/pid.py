"""PID control in parallel form, one loop for every pair of an output and an input.

    v = K_p (b r - y) + I + D,   u = v within its limits
    I = I + h K_i (r - y) + min(h / T_t, 1) (u - v)    (back-calculation), or
    I = I + h K_i (r - y) unless that drives v further beyond its limit (clamping)
    D = (T_f D - K_d (y - y_before)) / (T_f + t)        (backward difference of K_d s / (T_f s + 1))

after K. J. Astrom, T. Hagglund, Advanced PID Control, ISA 2006, sections 3.4, 3.5 and 13.2. The integral is
the backward difference too, so that v of a sample contains its error; without integral action, K_i = 0, it
is a constant. The time t since y_before is h, and longer after samples that were lost. As r the loop takes
the reference of the next sample: the first that this input can reach.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ddpc_controllers.pid_tuning import Gains, least_test_samples, tune_from_recording
from ddpc_controllers.recorded import matching_recording, resting_input
from ddpc_cosim import (
    Action,
    ConfigError,
    Controller,
    FloatArray,
    Loop,
    Sample,
    Weight,
    check_settings,
    setting,
)

Tuning = Literal["manual", "step-test"]
AntiWindup = Literal["back-calculation", "clamping"]

_LOST_MEASUREMENT = "a measurement is not finite: inputs held"
_NO_REFERENCE = "a reference is not finite: inputs held"


@dataclass(kw_only=True)
class PID(Controller):
    """PID control with anti-windup, derivative filter and setpoint weight.

    A gain is a number for all loops or one per loop. Output i is controlled by input ``pairing[i]``. While a
    measurement or a reference is not finite the inputs are held, which is a status.
    """

    tuning: Tuning = setting(
        "manual", choices=("manual", "step-test"), doc="gains as given, or by SIMC from the recording"
    )
    proportional: Weight = setting(1.0, doc="K_p")
    integral: Weight = setting(0.0, doc="K_i [1/s]")
    derivative: Weight = setting(0.0, doc="K_d [s]")
    filter_time: float = setting(0.0, low=0.0, unit="s", doc="T_f of the derivative filter; 0: none")
    setpoint_share: float = setting(
        1.0, low=0.0, high=1.0, doc="b: share of the reference in the proportional part"
    )
    anti_windup: AntiWindup = setting(
        "back-calculation", choices=("back-calculation", "clamping"), doc="what holds the integral at a limit"
    )
    tracking_time: float = setting(
        0.0, low=0.0, unit="s", doc="T_t of the back-calculation; 0: one sample, the fastest"
    )
    closed_loop_time: float = setting(
        0.0,
        low=0.0,
        unit="s",
        doc="step-test: time constant asked of the closed loop; 0: SIMC's, or four samples",
    )
    pairing: Sequence[int] = setting((), doc="number of the input for each output; empty: in their order")

    def __post_init__(self) -> None:
        check_settings(self)

    accepts_missing: ClassVar[bool] = True

    @property
    def uses_recording(self) -> bool:  # type: ignore[override]  # its tuning decides
        """Whether ``start`` needs a recording."""
        return self.tuning == "step-test"

    def start(self, loop: Loop) -> None:
        """Tune the loops, or take the gains as given.

        Raises
        ------
        DataError
            The recording cannot serve the tuning.
        ConfigError
            The pairing or a gain does not fit the number of signals.
        """
        self._pairs = self._checked_pairs(len(loop.inputs), len(loop.outputs))
        self._gains = self._tuned(loop) if self.tuning == "step-test" else self._given()
        h = loop.sampling_time
        self._sampling_time = self._elapsed = h
        # A loop without integral action has nothing that winds up, and would not get its bias back.
        self._tracking = np.where(self._gains.integral != 0.0, h / max(self.tracking_time, h), 0.0)
        self._u = resting_input(loop)
        self._low, self._high = loop.bounds.u_min[self._pairs], loop.bounds.u_max[self._pairs]
        self._derivative = np.zeros(len(self._pairs))
        self._integral: FloatArray | None = None
        self._y: FloatArray | None = None
        if loop.continues_recording and loop.recording is not None:
            self._u, self._y = loop.recording.u[-1].copy(), loop.recording.y[-1]

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs of all loops, within their limits."""
        gains, h, y, r = self._gains, self._sampling_time, sample.y, sample.reference[0]
        if not np.isfinite(y).all():
            return self._hold(_LOST_MEASUREMENT)
        if not np.isfinite(r).all():
            return self._hold(_NO_REFERENCE)
        before = y if self._y is None else self._y
        proportional = gains.proportional * (self.setpoint_share * r - y)
        self._derivative = (gains.filter_time * self._derivative - gains.derivative * (y - before)) / (
            gains.filter_time + self._elapsed
        )
        if self._integral is None:  # as if the loop had held the output where it is
            self._integral = self._u[self._pairs] + gains.proportional * (1.0 - self.setpoint_share) * y
        increment = h * gains.integral * (r - y)
        wanted = proportional + self._integral + increment + self._derivative
        limited = np.clip(wanted, self._low, self._high)
        self._integral = self._integral + self._kept(increment, limited - wanted)
        self._y, self._elapsed = y.copy(), h
        self._u[self._pairs] = limited
        return self._u.copy()

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return the fewest samples that a step test can be read from; 0 with manual tuning."""
        return least_test_samples(inputs) if self.tuning == "step-test" else 0

    def diagnostics(self) -> Mapping[str, float]:
        """Return the gains in use."""
        gains = self._gains._asdict()
        return {
            f"{name}[{i}]": float(value)
            for name, values in gains.items()
            for i, value in enumerate(np.broadcast_to(values, len(self._pairs)))
        }

    def _hold(self, why: str) -> Action:
        """Return the last inputs; the next change of the outputs spans a sample more."""
        self._elapsed += self._sampling_time
        return Action(self._u.copy(), why)

    def _kept(self, increment: FloatArray, excess: FloatArray) -> FloatArray:
        """Return by how much the integral changes, given by how much the limits changed the inputs."""
        if self.anti_windup == "clamping":
            return np.where(increment * excess < 0.0, 0.0, increment)
        return increment + self._tracking * excess

    def _checked_pairs(self, inputs: int, outputs: int) -> list[int]:
        pairs = list(self.pairing) or list(range(outputs))
        if len(pairs) != outputs or sorted({*pairs} & {*range(inputs)}) != sorted(pairs):
            raise ConfigError(
                f"PID: pairing = {pairs} does not give each of {outputs} output(s) an input of its own, "
                f"of 0 ... {inputs - 1}"
            )
        return pairs

    def _given(self) -> Gains:
        loops = len(self._pairs)
        faults, values = [], []
        for name in ("proportional", "integral", "derivative"):
            gain = np.asarray(getattr(self, name), dtype=np.float64)
            if gain.shape not in ((), (loops,)):
                faults.append(f"PID: {name} has shape {gain.shape}; needed: a number, or {loops} numbers")
            values.append(np.broadcast_to(gain, loops) if gain.ndim == 0 else gain)
        if faults:
            raise ConfigError(faults)
        proportional, integral, derivative = values
        return Gains(proportional, integral, derivative, np.full(loops, self.filter_time))

    def _tuned(self, loop: Loop) -> Gains:
        recording = matching_recording(loop, "PID")
        return tune_from_recording(recording, self._pairs, self.closed_loop_time)
