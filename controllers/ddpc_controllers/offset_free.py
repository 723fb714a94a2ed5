"""Offset-free tracking for any predictive controller: its reference is shifted by an estimated disturbance.

What a controller leaves between reference and output in the steady state (model error, disturbance, a
regulariser's pull) is taken for a constant disturbance d at the output of the closed loop, which otherwise
is a lag of first order and gain one from the shifted reference r - d to the output:

    y^_k+1 = phi y^_k + (1 - phi) (r_k+1 - d_k),   d_k = d_k-1 + gain (y_k - y^_k - d_k-1).

It rests only where y = r (internal model control: C. E. Garcia, M. Morari, Ind. Eng. Chem. Process Des.
Dev. 21(2), 1982, doi:10.1021/i200016a007; the estimate: G. Pannocchia, J. B. Rawlings, AIChE J. 49(2), 2003,
doi:10.1002/aic.690490213). The shifted reference stays within the output limits, and d does not grow where
they cut it off.

A dead time of n samples, which the lag does not know, is taken for a disturbance until it is over: what d
sees of itself at the frequency w per sample is |1 - exp(-i n w)| <= n w, of which the estimate passes on
about gain / sqrt(gain^2 + w^2). With gain <= 1 / n that is less than d at every frequency, and the loop is
stable (small gain theorem). A controller's horizon is longer than the dead time, or it could not control.

Where inputs are at a limit, what is off has another reason. Both d and the lag then move only in those
directions of the outputs in which the free inputs can move them; in the others d is held and the lag follows
the output. The directions are read from the recording. Where there is none, all are held while there are
fewer free inputs than outputs. An input whose limits leave it no room is as good as none. The outputs
can follow in as many directions as inputs are free: those of their columns in the plant's gain.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.export.code import Code, inner_step
from ddpc_controllers.models.identification import fit_arx, markov_parameters
from ddpc_controllers.wrapper import SingleWrapper
from ddpc_cosim import Action, Bounds, ConfigError, FloatArray, Loop, Recording, Sample, setting

_FEWEST_SAMPLES = 20
_NEGLIGIBLE = 0.01


def step_gain(recording: Recording, samples: int) -> FloatArray:
    """Return how the outputs answer to a step of each input, shape (p, m), in parts of their recorded spread.

    Parameters
    ----------
    recording : Recording
        The experiment.
    samples : int
        After how many of them, 20 at least; longer than the dead time.
    """
    m, p, n_d = recording.u.shape[1], recording.y.shape[1], recording.d.shape[1]
    samples = max(samples, _FEWEST_SAMPLES)
    # Twice as many equations as coefficients.
    lags = max(1, min(samples, len(recording) // (2 * (m + p + n_d) + 1)))
    gain = markov_parameters(fit_arx(recording, lags), samples).sum(axis=0)
    return np.asarray(gain * recording.u.std(axis=0) / spread(recording)[:, np.newaxis])


def spread(recording: Recording) -> FloatArray:
    """Return the standard deviation of each output; 1 where it did not move."""
    deviation = recording.y.std(axis=0)
    return np.where(deviation > 0.0, deviation, 1.0)


def projector(gain: FloatArray, free: NDArray[np.bool_]) -> FloatArray:
    """Return the orthogonal projector onto what the free inputs do, shape (p, p).

    Parameters
    ----------
    gain : array, shape (p, m)
        How the outputs answer to the inputs; what is below a hundredth of its norm counts as none.
    free : array of bool, shape (m,)
        The inputs that are free.
    """
    directions, sizes, _ = np.linalg.svd(gain[:, free], full_matrices=False)
    reached = directions[:, sizes > _NEGLIGIBLE * np.linalg.norm(gain)]
    return np.asarray(reached @ reached.T)


_LARGEST_GAIN = 0.2
_AT_A_LIMIT = 1e-9
_LARGEST_TABLE = 4096


@dataclass(kw_only=True)
class OffsetFree(SingleWrapper):
    """A controller whose reference is shifted until there is no offset."""

    _known_in_c: ClassVar[Collection[str]] = ()

    gain: float = setting(
        0.0,
        low=0.0,
        high=1.0,
        doc="share of a new difference that the estimate of the disturbance takes up; 0: one over the "
        "controller's horizon, at most 0.2",
    )
    response_time: float = setting(
        0.0, low=0.0, unit="s", doc="time constant of the closed loop; 0: two samples"
    )

    def start(self, loop: Loop) -> None:
        """Start the controller; there is no disturbance yet."""
        self._bounds, self._banded = loop.bounds, bool(loop.bands)
        self._low, self._high = _just_within(loop.bounds)
        self._phi = float(np.exp(-loop.sampling_time / (self.response_time or 2.0 * loop.sampling_time)))
        self._gain = self.gain or min(_LARGEST_GAIN, 1.0 / max(1, self.horizon))
        self._disturbance = np.zeros(len(loop.outputs))
        self._largest: FloatArray | None = None
        self._clipped = np.zeros(len(loop.outputs), dtype=bool)
        self._expected: FloatArray | None = None
        self._start_inside(loop)
        self._start_directions(loop)
        self._reachable = self._directions(self._high > self._low)

    def step(self, sample: Sample) -> Action:
        """Return the controller's inputs for the shifted reference."""
        expected = self._expected
        if np.isfinite(sample.y).all():
            if expected is None:  # nothing to compare with
                expected = sample.y - self._disturbance
            off = sample.y - expected - self._disturbance
            correctable = self._reachable @ off
            correctable[self._clipped & (correctable * self._disturbance > 0.0)] = 0.0
            self._disturbance = self._disturbance + self._gain * correctable
            size = np.abs(self._disturbance)
            self._largest = size if self._largest is None else np.maximum(self._largest, size)
            expected = expected + (off - correctable)
        elif expected is None:
            expected = sample.setpoint
        wanted = np.vstack([sample.setpoint, sample.reference]) - self._disturbance
        shifted = np.clip(wanted, self._bounds.y_min, self._bounds.y_max)
        target = min(1, self.horizon)  # the first that the controller is to reach
        self._clipped = shifted[target] != wanted[target]
        expected = self._phi * expected + (1.0 - self._phi) * shifted[target]
        # Without a reference nothing is expected of the next sample.
        self._expected = expected if np.isfinite(expected).all() else None
        inside = sample._replace(reference=shifted[1:], setpoint=shifted[0])
        if self._banded:
            moved = self._disturbance[:, np.newaxis]
            inside = inside._replace(band_now=sample.band_now - moved, band=sample.band - moved)
        action = self._inner.step(inside)
        self._reachable = self._directions((action.u > self._low) & (action.u < self._high))
        return action

    def diagnostics(self) -> Mapping[str, float]:
        """Return the controller's values, and the largest disturbance of each output, in its unit."""
        # The compiled engine makes no step here: nothing is known of what C has estimated.
        largest = [] if self._largest is None else self._largest.tolist()
        return {
            **super().diagnostics(),
            **{f"largest_disturbance[{i}]": value for i, value in enumerate(largest)},
        }

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the controller, and what shifts its reference."""
        inside = self._inner.controller
        step = inner_step(inside, code, loop)
        code.kernel("offset_free")
        p, m, n = len(loop.outputs), len(loop.inputs), inside.horizon
        wrapper = code.constant(
            "OffsetFree",
            p=p,
            m=m,
            horizon=n,
            phi=self._phi,
            gain=self._gain,
            y_min=code.doubles(self._bounds.y_min),
            y_max=code.doubles(self._bounds.y_max),
            low=code.doubles(self._low),
            high=code.doubles(self._high),
            directions=code.doubles(self._all_directions(m, p)),
        )
        free = int((self._high > self._low) @ (1 << np.arange(m)))
        held = code.held("OffsetFreeMemory", [0.0], [free], *np.zeros((5, p)), np.zeros((1 + n, p)))
        return code.step(
            f"{held}const Sample inside = shift_references(&{wrapper}, &held, sample);\n"
            f"{step}(memory, &inside, u, told);\n"
            f"if (sample->applied == NULL) remember_free(&{wrapper}, &held, u);"
        )

    def _all_directions(self, m: int, p: int) -> FloatArray:
        """Return the directions for every set of free inputs, shape (2^m, p, p): bit i is input i."""
        size = 2**m * p**2
        if size > _LARGEST_TABLE:
            raise ConfigError(
                f"OffsetFree cannot be exported for {m} inputs and {p} outputs: what a set of free inputs "
                f"can do is a table of {size} numbers, more than {_LARGEST_TABLE}: wrap the controllers of a "
                "Decentralised one by one"
            )
        sets = (np.arange(2**m)[:, np.newaxis] >> np.arange(m)) & 1
        return np.array([self._directions(free == 1) for free in sets])

    def _start_directions(self, loop: Loop) -> None:
        """Learn how the inputs move the outputs, where it matters and there is a recording."""
        p, recording = len(loop.outputs), loop.recording
        self._all = np.eye(p)
        # A single output is reached by whatever input is free.
        self._needed = min(p, max(1, int((self._high > self._low).sum())))
        self._plant: tuple[FloatArray, FloatArray] | None = None
        if p > 1 and recording is not None:
            self._plant = step_gain(recording, max(1, self.horizon)), spread(recording)

    def _directions(self, free: NDArray[np.bool_]) -> FloatArray:
        """Return what part of a change of the outputs the free inputs can bring about, shape (p, p)."""
        if free.all() and len(free) >= len(self._all):
            return self._all
        if self._plant is not None:
            gain, unit = self._plant
            return np.asarray(unit[:, np.newaxis] * projector(gain, free) / unit)
        return self._all if free.sum() >= self._needed else np.zeros_like(self._all)


def _just_within(bounds: Bounds) -> tuple[FloatArray, FloatArray]:
    """Return the input limits, drawn in by what a solver leaves between its answer and an active limit."""
    low, high = bounds.u_min, bounds.u_max
    span = high - low
    one_sided = np.where(np.isfinite(low), np.abs(low), np.where(np.isfinite(high), np.abs(high), 0.0))
    room = _AT_A_LIMIT * np.where(np.isfinite(span), span, one_sided)
    return low + room, high - room
