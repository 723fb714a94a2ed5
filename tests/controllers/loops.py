"""A loop closed by hand on the paper's pendulum, and on linear plants: no FMU, no co-simulation master."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag

from ddpc_controllers import SPC, WKPC, DeePC, GammaDDPC, ThinPlate
from ddpc_cosim import Action, Bounds, Controller, FloatArray, Loop, Recording, Sample, Variable

DATA = Path(__file__).parent.parent / "data"
DEGREE = math.pi / 180.0
SAMPLING_TIME = 0.1
REGULATION: dict[str, Any] = {"artificial_setpoint": False, "terminal_equality": False}
"""Settings that make (8) track the reference itself."""

PRINTED: dict[str, Any] = {"regulariser": "ridge", "terminal_equality": True}
"""Settings that make DeePC's problem the printed (8)."""

Advance = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass
class Run:
    """What a closed loop leaves behind: time along axis 0."""

    y: FloatArray
    u: FloatArray
    reference: FloatArray
    status: list[str]
    samples: list[Sample] = field(repr=False)

    @property
    def absolute_error(self) -> float:
        """Sum of the absolute error over the rows [deg]."""
        return float(np.abs(self.reference[: len(self.y)] - self.y).sum() / DEGREE)


def pendulum(state: FloatArray, torque: FloatArray) -> FloatArray:
    """Hold the torque over one sample of (22), integrated to rounding."""

    def slope(_: float, x: FloatArray) -> list[float]:
        return [x[1], -9.81 / 0.2 * math.sin(x[0]) - 0.4 / 0.2 * x[1] + torque[0] / 0.2]

    solution = solve_ivp(slope, (0.0, SAMPLING_TIME), state, method="DOP853", rtol=1e-11, atol=1e-13)
    return np.asarray(solution.y[:, -1])


def quick_pendulum(state: FloatArray, torque: FloatArray) -> FloatArray:
    """The same by Runge-Kutta in steps of 5 ms, for many seeds: right to 1e-7 rad over one sample."""

    def slope(angle: float, velocity: float) -> tuple[float, float]:
        return velocity, -9.81 / 0.2 * math.sin(angle) - 0.4 / 0.2 * velocity + push

    angle, velocity, push, h = float(state[0]), float(state[1]), float(torque[0]) / 0.2, 0.005
    for _ in range(20):
        a1, v1 = slope(angle, velocity)
        a2, v2 = slope(angle + h / 2 * a1, velocity + h / 2 * v1)
        a3, v3 = slope(angle + h / 2 * a2, velocity + h / 2 * v2)
        a4, v4 = slope(angle + h * a3, velocity + h * v3)
        angle += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        velocity += h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
    return np.array([angle, velocity])


@dataclass(frozen=True)
class LinearPlant:
    """x+ = A x + B u, y = C x."""

    a: FloatArray
    b: FloatArray
    c: FloatArray

    @classmethod
    def lag(cls, pole: float, gain: float) -> "LinearPlant":
        """Return a plant of first order, its output its state."""
        return cls(np.array([[pole]]), np.array([[gain]]), np.eye(1))

    @classmethod
    def random(cls, rng: np.random.Generator, order: int, inputs: int, outputs: int) -> "LinearPlant":
        """Return a stable plant."""
        a = rng.standard_normal((order, order))
        a *= 0.9 / np.abs(np.linalg.eigvals(a)).max()
        return cls(a, rng.standard_normal((order, inputs)), rng.standard_normal((outputs, order)))

    def advance(self, state: FloatArray, u: FloatArray) -> FloatArray:
        """Return the next state."""
        return self.a @ state + self.b @ u


def experiment(advance: Advance, u: FloatArray, order: int, output: FloatArray) -> Recording:
    """Record a plant from rest; all states are measured."""
    states = np.zeros((len(u), order))
    for k in range(1, len(u)):
        states[k] = advance(states[k - 1], u[k - 1])
    return Recording(u, states @ output.T, states, SAMPLING_TIME)


def uniform_torque(seed: int, samples: int = 200, limit: float = 3.5) -> FloatArray:
    """Return the paper's excitation: MATLAB's uniform stream, shape (samples, 1)."""
    return limit * (2.0 * np.random.RandomState(seed).random_sample((samples, 1)) - 1.0)


def pendulum_experiment(seed: int, advance: Advance = quick_pendulum) -> Recording:
    """Record the pendulum under the paper's excitation; angle and velocity are measured."""
    return experiment(advance, uniform_torque(seed), 2, np.array([[1.0, 0.0]]))


def make_loop(
    recording: Recording | None, u_limit: FloatArray, y_limit: FloatArray, **changes: object
) -> Loop:
    """Return a loop with symmetric limits, infinite where there is none."""
    m, p = len(u_limit), len(y_limit)
    q = recording.measured.shape[1] if recording is not None else p
    loop = Loop(
        sampling_time=SAMPLING_TIME,
        inputs=tuple(Variable(f"u{i}") for i in range(m)),
        outputs=tuple(Variable(f"y{i}") for i in range(p)),
        measurements=tuple(Variable(f"x{i}") for i in range(q)),
        bounds=Bounds(-u_limit, u_limit, -y_limit, y_limit),
        recording=recording,
        rng=np.random.default_rng(0),
    )
    return replace(loop, **changes)  # type: ignore[arg-type]


def pendulum_loop(
    recording: Recording | None, torque: float = 3.5, degrees: float = 70.0, seed: int = 0
) -> Loop:
    """Return the loop of the paper's comparison."""
    limits = np.array([torque]), np.array([degrees * DEGREE])
    return make_loop(recording, *limits, rng=np.random.default_rng(seed))


def paper_reference(extra: int = 20) -> FloatArray:
    """Return r_0, r_1, ... of the comparison [rad], shape (400 + extra, 1)."""
    steps = np.repeat(np.array([20.0, -10.0, 10.0, -20.0]) * DEGREE, 100)
    return np.concatenate([steps, np.full(extra, steps[-1])])[:, np.newaxis]


def before(history: FloatArray, rest: FloatArray, k: int, length: int) -> FloatArray:
    """Return the ``length`` samples before sample k of a loop that starts from rest."""
    return np.vstack([np.tile(rest, (length, 1)), history])[k : k + length]


def close_loop(
    controller: Controller,
    loop: Loop,
    advance: Advance,
    output: FloatArray,
    reference: FloatArray,
    steps: int = 400,
    start: FloatArray | None = None,
) -> Run:
    """Start a controller and close the loop on a plant at rest in the origin, or in a given state."""
    controller.start(loop)
    state = np.zeros(output.shape[1]) if start is None else start
    everything = np.eye(len(state))
    measure = everything if len(loop.measurements) == len(state) else output
    run = Run(np.zeros((steps, len(output))), np.zeros((steps, len(loop.inputs))), reference, [], [])
    for k in range(steps):
        future = reference[k + 1 : k + 1 + controller.horizon]
        sample = Sample(k, k * SAMPLING_TIME, output @ state, measure @ state, future, reference[k])
        answer = controller.step(sample)
        action = answer if isinstance(answer, Action) else Action(answer)
        run.y[k], run.u[k] = sample.y, action.u
        run.status.append(action.status)
        run.samples.append(sample)
        state = advance(state, action.u)
    return run


def together_and_alone(
    method: Callable[[list[int]], Controller],
    plants: Sequence[LinearPlant],
    limit: float,
    reference: FloatArray,
    steps: int,
) -> tuple[FloatArray, FloatArray]:
    """Close the loop on plants that do not touch, on all at once and on each alone; return both inputs.

    The method is asked for a controller of the plants whose numbers it is given, each with one input and one
    output.
    """

    def inputs(chosen: list[int]) -> FloatArray:
        parts = [plants[i] for i in chosen]
        whole = LinearPlant(*(block_diag(*(getattr(part, name) for part in parts)) for name in "abc"))
        loop = make_loop(None, np.full(len(chosen), limit), np.full(len(chosen), np.inf))
        return close_loop(method(chosen), loop, whole.advance, whole.c, reference[:, chosen], steps).u

    everything = list(range(len(plants)))
    return inputs(everything), np.hstack([inputs([i]) for i in everything])


def printed_deepc(**settings: Any) -> DeePC:
    """Return DeePC with the printed problem (8), but for the settings given."""
    return DeePC(**{**PRINTED, **settings})


def printed_wkpc(**settings: Any) -> WKPC:
    """Return WKPC with the printed problem (11), but for the settings given."""
    return WKPC(**{"regulariser": "ridge", "dictionary": ThinPlate(), **settings})


def regulating_spc(**settings: Any) -> SPC:
    """Return SPC that tracks the reference itself, but for the settings given."""
    return SPC(**{"artificial_setpoint": False, **settings})


def regulating_gamma_ddpc(**settings: Any) -> GammaDDPC:
    """Return gamma-DDPC that tracks the reference itself, but for the settings given."""
    return GammaDDPC(**{"artificial_setpoint": False, **settings})


ANGLE = np.array([[1.0, 0.0]])
