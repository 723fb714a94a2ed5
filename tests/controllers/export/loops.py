"""Closed loops with noise, missing measurements and a limited preview, in which C code runs beside Python."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddpc_cosim import Bounds, Controller, FloatArray, Loop, Recording, Sample, Variable

from ..loops import quick_pendulum
from .compiled import Beside

TANKS = np.array([[0.93, 0.04, 0.0], [0.0, 0.88, 0.05], [0.03, 0.0, 0.9]])
PIPES = np.array([[0.5, 0.02], [0.03, 0.4], [0.0, 0.1]])


@dataclass(frozen=True)
class Bench:
    """A plant whose states are measured, the first of them its controlled outputs.

    Parameters
    ----------
    advance : callable
        From a state and inputs to the next state.
    nominal, limits : arrays, shapes (q,) and (m, 2)
        Sizes of the states, and limits of the inputs.
    outputs : int
        How many are controlled.
    rest : array, shape (m,)
        Inputs at rest.
    """

    advance: Callable[[FloatArray, FloatArray], FloatArray]
    nominal: FloatArray
    limits: FloatArray
    outputs: int
    rest: FloatArray

    def loop(self, samples: int = 240, **changes: object) -> tuple[Loop, FloatArray]:
        """Return a loop with a recording, and the state after it if it goes on there, else at rest."""
        rng, q = np.random.default_rng(5), len(self.nominal)
        low, high = self.limits.T
        u = self.rest + (low + rng.uniform(size=(samples, len(low))) * (high - low) - self.rest) * 0.9
        states = [self._at_rest()]
        for held in u:
            states.append(self.advance(states[-1], held))
        measured = np.array(states[:-1]) + 1e-3 * self.nominal * rng.standard_normal((samples, q))
        free = np.full(self.outputs, np.inf)
        names = tuple(Variable(f"x{i}", nominal=size) for i, size in enumerate(self.nominal.tolist()))
        loop = Loop(
            sampling_time=0.1,
            inputs=tuple(
                Variable(f"u{i}", nominal=size, start=start)
                for i, (size, start) in enumerate(
                    zip(((high - low) / 2).tolist(), self.rest.tolist(), strict=True)
                )
            ),
            outputs=names[: self.outputs],
            measurements=names[::-1],
            bounds=Bounds(low, high, -free, free),
            recording=Recording(u, measured[:, : self.outputs], measured[:, ::-1], 0.1),
            rng=np.random.default_rng(1),
            preview=4,
        )
        loop = replace(loop, **changes)  # type: ignore[arg-type]
        return loop, states[-1] if loop.continues_recording else self._at_rest()

    def close(
        self,
        controller: Controller,
        steps: int = 150,
        lost: Sequence[int] = (0, 1, 31, 32, 33, 70),
        unknown: Sequence[int] = (60,),
        reach: float = 1.0,
        **changes: object,
    ) -> Beside:
        """Close the loop; some samples lose measurements, and some references are unknown.

        ``reach`` is the size of the references, in parts of the outputs' nominal values.
        """
        loop, state = self.loop(**changes)
        beside, rng = Beside(controller=controller), np.random.default_rng(9)
        beside.start(loop)
        p = self.outputs
        levels = self.nominal[:p] * reach * rng.uniform(-1.0, 1.0, (steps // 25 + 3, p))
        reference = np.repeat(levels, 25, axis=0)
        reference[list(unknown), -1] = np.nan
        for k in range(steps):
            measured = state + 1e-3 * self.nominal * rng.standard_normal(len(state))
            if k in lost:
                measured[rng.permutation(len(state))[: 1 + k % len(state)]] = np.nan
            ahead = np.minimum(np.arange(1, controller.horizon + 1), loop.preview) + k
            u = beside.step(
                Sample(k, 0.1 * k, measured[:p], measured[::-1], reference[ahead], reference[k])
            ).u
            state = self.advance(state, np.clip(u, loop.bounds.u_min, loop.bounds.u_max))
        return beside

    def _at_rest(self) -> FloatArray:
        state = np.zeros(len(self.nominal))
        for _ in range(300):
            state = self.advance(state, self.rest)
        return state


PENDULUM = Bench(
    quick_pendulum,
    nominal=np.array([0.5, 2.0]),
    limits=np.array([[-3.5, 3.5]]),
    outputs=1,
    rest=np.zeros(1),
)
"""The built-in pendulum: angle and velocity, torque."""

COUPLED = Bench(
    lambda state, u: TANKS @ state + PIPES @ u,
    nominal=np.array([20.0, 10.0, 5.0]),
    limits=np.array([[0.0, 6.0], [-1.0, 4.0]]),
    outputs=2,
    rest=np.array([2.0, 1.0]),
)
"""A linear plant with two inputs, two outputs and one more measurement, about an operating point."""


def limited_loop(rng: np.random.Generator, inputs: int, preview: int) -> Loop:
    """Return the loop of the coupled plant with so many inputs, whose limits are drawn."""
    loop, _ = COUPLED.loop(recording=None, preview=preview)
    limits, free = rng.uniform(0.2, 2.0, inputs), np.full(2, np.inf)
    variables = tuple(Variable(f"u{j}") for j in range(inputs))
    return replace(loop, inputs=variables, bounds=Bounds(-limits, limits, -free, free))


def ask_at_random(beside: Beside, loop: Loop, rng: np.random.Generator) -> Iterator[int]:
    """Start a controller anew ten times, ask it eight times, and yield at how many samples limits are active.

    What adapts to noise is not stable, and roundings grow in it.
    """
    for _ in range(10):
        beside.start(loop)
        active = 0
        for k in range(8):
            y, r = rng.normal(size=2), 2.0 * rng.normal(size=(beside.horizon + 1, 2))
            beside.step(Sample(k, 0.1 * k, y, np.append(0.0, y[::-1]), r[1:], r[0]))
            active += beside.c.last_step[2] > 0
        yield active
