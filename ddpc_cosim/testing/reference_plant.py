"""A plant that every controller ought to master: stable, well scaled, of unit gain, nearly decoupled."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddpc_cosim.controller import Action, Bounds, Controller, Loop, Recording, Sample
from ddpc_cosim.testing.check_results import CheckFailedError
from ddpc_cosim.variables import FloatArray, Variable

INPUT_LIMIT, OUTPUT_LIMIT = 1.0, 2.0
TARGET = np.array([0.5, -0.3])
_COUPLING = 0.1
_RECORDED = 200


@dataclass(frozen=True, slots=True)
class ReferencePlant:
    """x' = G u - x with one or two inputs ``u1``, ``u2`` and as many outputs ``y1``, ``y2``, at rest at zero.

    Parameters
    ----------
    size : int
        Number of inputs and of outputs, 1 or 2; two act on each other's output at a tenth of their gain.
    sampling_time : float
        Time between samples [s].
    input_limit : float
        Limit of the inputs, on both sides.
    """

    size: int
    sampling_time: float
    input_limit: float = INPUT_LIMIT

    def advance(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return the outputs one sample later, exactly; shape (size,)."""
        gain = np.full((self.size, self.size), _COUPLING) + (1 - _COUPLING) * np.eye(self.size)
        settled = gain @ u
        return np.asarray(settled + (x - settled) * np.exp(-self.sampling_time))

    def loop(self, samples: int | None, seed: int, preview: int = 1) -> Loop:
        """Return what a controller learns, with a recording of so many samples, or with none."""
        outputs = tuple(Variable(f"y{i + 1}", min=-OUTPUT_LIMIT, max=OUTPUT_LIMIT) for i in range(self.size))
        u_max, y_max = np.full(self.size, self.input_limit), np.full(self.size, OUTPUT_LIMIT)
        return Loop(
            sampling_time=self.sampling_time,
            inputs=tuple(
                Variable(f"u{i + 1}", min=-self.input_limit, max=self.input_limit) for i in range(self.size)
            ),
            outputs=outputs,
            measurements=outputs,
            bounds=Bounds(-u_max, u_max, -y_max, y_max),
            recording=None if samples is None else self._record(samples),
            rng=np.random.default_rng([seed, 2]),
            preview=preview,
        )

    def loop_for(self, controller: Controller, seed: int, preview: int | None = None) -> Loop:
        """Return a loop with as long a recording as the controller needs, if it uses one, and its preview."""
        preview = controller.horizon if preview is None else preview
        if not controller.uses_recording:
            return self.loop(None, seed, preview)
        needed = controller.recording_length(self.size, self.size, self.size)
        return self.loop(max(_RECORDED, needed), seed, preview)

    def target(self, scale: float = 1.0) -> FloatArray:
        """Return the value of a constant reference, shape (size,)."""
        target: FloatArray = scale * TARGET[: self.size]
        return target

    def mosaic(self, loop: Loop, *, turned: bool) -> Loop:
        """Return a loop with two recordings as long as its own, in one order or the other.

        The second one begins at the limits of the outputs, so that they jump between the two.
        """
        samples = len(loop.recording or ())
        pieces = [self._record(samples), self._record(samples, 1, OUTPUT_LIMIT)]
        return replace(loop, recording=Recording.join(pieces[::-1] if turned else pieces))

    def _record(self, samples: int, seed: int = 0, start: float = 0.0) -> Recording:
        u = np.random.default_rng(seed).uniform(-INPUT_LIMIT, INPUT_LIMIT, (samples, self.size))
        y = np.full_like(u, start)
        for k in range(1, samples):
            y[k] = self.advance(y[k - 1], u[k - 1])
        return Recording(u, y, y.copy(), self.sampling_time)


@dataclass(frozen=True, slots=True)
class LoopResult:
    """What a run leaves behind: inputs and outputs, shape (steps, size), and a status per sample."""

    u: FloatArray
    y: FloatArray
    status: Sequence[str]


class TestLoop:
    """A loop of the reference plant and a started controller, sample by sample.

    Parameters
    ----------
    plant : ReferencePlant
        The plant.
    controller : Controller
        Started already.
    scale : float
        Size of the reference.
    start : float
        The outputs at the first sample.
    reuse : bool
        Overwrite the arrays of a sample after it, as a master may.
    """

    __test__ = False  # not a class of tests

    def __init__(
        self,
        plant: ReferencePlant,
        controller: Controller,
        *,
        scale: float = 1.0,
        start: float = 0.0,
        reuse: bool = False,
    ) -> None:
        self.plant, self.controller, self._reuse = plant, controller, reuse
        self._setpoint = plant.target(scale)
        self._reference = np.tile(self._setpoint, (controller.horizon, 1))
        self._x = np.full(plant.size, start)
        self.rows: list[tuple[FloatArray, FloatArray, str]] = []

    def step(self, seen: FloatArray | None = None) -> FloatArray:
        """Take a sample, in which the controller sees the outputs or what is given; return the inputs."""
        k, y = len(self.rows), self._x if seen is None else seen
        reference, setpoint, plant = self._reference.copy(), self._setpoint.copy(), self.plant
        inputs, outputs = (
            np.tile([-limit, limit], (len(reference) + 1, plant.size, 1))
            for limit in (plant.input_limit, OUTPUT_LIMIT)
        )
        sample = Sample(
            *(k, k * plant.sampling_time, y.copy(), y.copy(), reference, setpoint),
            forecast=np.empty((len(reference), 0)),
            band_now=np.stack([setpoint, setpoint], axis=-1),
            band=np.stack([reference, reference], axis=-1),
            price=np.empty((len(reference) + 1, 0)),
            input_limits=inputs,
            output_limits=outputs[1:],
        )
        action = answer(self.controller, sample, plant.size)
        if self._reuse:
            for array in _arrays(sample).values():
                array[...] = np.nan
        self.rows.append((action.u.copy(), self._x, action.status))
        limit = self.plant.input_limit
        held = np.clip(action.u, -limit, limit)
        self._x = self.plant.advance(self._x, np.where(np.isfinite(held), held, 0.0))
        return self.rows[-1][0]

    def result(self) -> LoopResult:
        """Return the run so far."""
        u, y, status = zip(*self.rows, strict=True)
        return LoopResult(np.array(u), np.array(y), status)


def _arrays(sample: Sample) -> dict[str, FloatArray]:
    """Return the arrays of a sample by name; those without elements may be shared by all."""
    named = ((name, getattr(sample, name)) for name in sample._fields)
    return {name: array for name, array in named if isinstance(array, np.ndarray) and array.size}


def answer(controller: Controller, sample: Sample, inputs: int) -> Action:
    """Return a controller's answer; raise CheckFailedError if it is not of the contract's shape and type."""
    given = {name: array.copy() for name, array in _arrays(sample).items()}
    answered = controller.step(sample)
    for name, before in given.items():
        if not np.array_equal(getattr(sample, name), before, equal_nan=True):
            raise CheckFailedError(f"step changed sample.{name}, which other controllers are given too")
    action = answered if isinstance(answered, Action) else Action(answered)
    u: object = action.u
    if not isinstance(u, np.ndarray) or u.dtype != np.float64 or u.shape != (inputs,):
        shown = f"an array of {u.dtype}, shape {u.shape}" if isinstance(u, np.ndarray) else type(u).__name__
        raise CheckFailedError(f"step returned {shown}; needed: an array of float64, shape ({inputs},)")
    if not isinstance(action.status, str) or not action.status:
        raise CheckFailedError(f"step returned the status {action.status!r}; needed: a text, as 'ok'")
    return action
