"""Offset-free tracking for any predictive controller: its reference is shifted by an estimated disturbance.

What a controller leaves between reference and output in the steady state (model error, disturbance, a
regulariser's pull) is taken for a constant disturbance d at the output of the closed loop, which otherwise
is a lag of first order and gain one from the shifted reference r - d to the output:

    y^_k+1 = phi y^_k + (1 - phi) (r_k+1 - d_k),   d_k = d_k-1 + gain (y_k - y^_k - d_k-1).

It rests only where y = r (internal model control: C. E. Garcia, M. Morari, Ind. Eng. Chem. Process Des.
Dev. 21(2), 1982, doi:10.1021/i200016a007; the estimate: G. Pannocchia, J. B. Rawlings, AIChE J. 49(2), 2003,
doi:10.1002/aic.690490213). While an input is at a limit, the estimate is held and the lag follows the
output: what is off has another reason. The shifted reference stays within the output limits.
"""

from dataclasses import dataclass

import numpy as np

from ddpc_controllers.wrapper import Wrapper
from ddpc_cosim import Action, FloatArray, Loop, Sample, setting


@dataclass(kw_only=True)
class OffsetFree(Wrapper):
    """A controller whose reference is shifted until there is no offset."""

    gain: float = setting(
        0.2,
        above=0.0,
        high=1.0,
        doc="share of a new difference that the estimate of the disturbance takes up",
    )
    response_time: float = setting(
        0.0, low=0.0, unit="s", doc="time constant of the closed loop; 0: two samples"
    )

    def start(self, loop: Loop) -> None:
        """Start the controller; there is no disturbance yet."""
        self._bounds = loop.bounds
        self._phi = float(np.exp(-loop.sampling_time / (self.response_time or 2.0 * loop.sampling_time)))
        self._disturbance = np.zeros(len(loop.outputs))
        self._expected: FloatArray | None = None
        self._limited = False
        self._start_inside(loop)

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the controller's inputs for the shifted reference."""
        expected = self._expected
        if np.isfinite(sample.y).all():
            if expected is None or self._limited:  # nothing to compare with
                expected = sample.y - self._disturbance
            self._disturbance += self.gain * (sample.y - expected - self._disturbance)
        elif expected is None:
            expected = sample.reference[0]
        shifted = np.clip(sample.reference - self._disturbance, self._bounds.y_min, self._bounds.y_max)
        self._expected = self._phi * expected + (1.0 - self._phi) * shifted[0]
        answer = self._inner.step(sample._replace(reference=shifted))
        u = answer.u if isinstance(answer, Action) else answer
        self._limited = bool((u <= self._bounds.u_min).any() or (u >= self._bounds.u_max).any())
        return answer
