"""A stabiliser that tunes its own gains by simultaneous-perturbation stochastic approximation (SPSA).

J. C. Spall, Multivariate stochastic approximation using a simultaneous perturbation gradient approximation,
IEEE Transactions on Automatic Control 37(3), 1992, doi:10.1109/9.119632; for controllers without a model of
the plant: J. C. Spall and J. A. Cristion, Model-free control of nonlinear stochastic systems with
discrete-time measurements, ibid. 43(9), 1998, doi:10.1109/9.718605. The paper names it in section III as a
way to make unstable plants fit for model-free adaptive control.

All gains theta are perturbed at once, theta + c_k D and theta - c_k D, D of independent signs, each for a
window of samples; from the losses L of the two windows

    theta <- theta - a_k (L+ - L-) / (2 c_k) D,   a_k = a / (k + 1 + A)^0.602,   c_k = c / (k + 1)^0.101.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from math import log
from typing import ClassVar

import numpy as np

from ddpc_controllers.checks import per_signal, prior_info, without_forecast
from ddpc_controllers.data.hankel import resting_input
from ddpc_controllers.export.code import Code, Exportable
from ddpc_controllers.optimisation.limits import HELD
from ddpc_cosim import (
    Action,
    ConfigError,
    Factor,
    FloatArray,
    Log,
    Loop,
    Sample,
    Weight,
    setting,
)

_STEP_DECAY, _PERTURBATION_DECAY = 0.602, 0.101  # the values that Spall recommends


@dataclass(kw_only=True)
class SPSA(Exportable):
    """PID gains of pairs of inputs and outputs, tuned by SPSA while they control.

    A pair's loss is the growth of ``e^2 + (t e')^2`` over a window of length t, as a logarithm: it does not
    depend on how large the error is already, so that the two windows of an unstable plant compare. Gains
    are perturbed in parts of their initial values; a gain that starts at 0 stays there. The first gains
    need not stabilise the plant, but keep it long enough for a few windows.

    A measurement or reference that is not finite is a fallback: the inputs are held, and the windows of this
    perturbation begin anew.
    """

    accepts_missing: ClassVar[bool] = True

    kp: Weight = setting(
        1.0,
        doc="initial proportional gain, with the sign of the control direction; a list: of each pair",
        search=Factor(0.03, 30.0),
    )
    kd: Weight = setting(
        0.0, doc="initial derivative gain [s]; a list: of each pair", search=Factor(0.03, 30.0)
    )
    integral_time: float = setting(
        0.0,
        low=0.0,
        unit="s",
        doc="kp / ki, which is not tuned; 0: no integral action",
        search=Factor(0.03, 30.0),
    )
    window: int = setting(10, low=2, doc="samples for which a perturbation is tried")
    step_size: float = setting(
        1.0, low=0.0, doc="a: step size of the gains, in parts of the initial ones", search=Log(1e-2, 10.0)
    )
    stability: float = setting(0.0, low=0.0, doc="A: steps before the step size decays")
    perturbation: float = setting(
        0.2,
        above=0.0,
        high=1.0,
        doc="c: perturbation, in parts of the initial gains",
        search=Log(1e-3, 0.5),
    )
    largest_step: float = setting(0.2, above=0.0, doc="longest step of a gain, in parts of the initial one")
    resolution: float = setting(1e-3, above=0.0, doc="error that is too small to learn from, in output units")

    def start(self, loop: Loop) -> None:
        """Go back to the initial gains.

        Raises
        ------
        ConfigError
            There are not as many inputs as outputs, or not as many gains.
        """
        m, p = len(loop.inputs), len(loop.outputs)
        if m != p:
            raise ConfigError(f"SPSA pairs each output with an input; there are {m} inputs and {p} outputs")
        # A copy: a second start draws the same signs. One stream for each pair: they tune by themselves.
        streams = deepcopy(loop.rng).spawn(p)
        gains = np.column_stack([per_signal("kp", self.kp, p), per_signal("kd", self.kd, p)])
        self._pairs = [
            _Pair(self, of_pair, loop.sampling_time, stream)
            for of_pair, stream in zip(gains, streams, strict=True)
        ]
        self._rest = resting_input(loop)
        if loop.past and not loop.continues_recording:
            self._rest = loop.past.u[-1]
        self._u, self._bounds = self._rest.copy(), loop.bounds
        self._moving = bool({variable.name for variable in loop.inputs} & {*loop.moving_limits})

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        return without_forecast(prior_info("gains to begin with", loop.outputs), loop)

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return PID control with the gains that are being tried."""
        error = sample.reference[0] - sample.y
        if not np.isfinite(error).all():
            for pair in self._pairs:
                pair.pause()
            return Action(self._u.copy(), HELD)
        wanted = self._rest + [
            pair.step(e, y) for pair, e, y in zip(self._pairs, error.tolist(), sample.y.tolist(), strict=True)
        ]
        low, high = sample.input_limits[0].T if self._moving else (self._bounds.u_min, self._bounds.u_max)
        u: FloatArray = np.clip(wanted, low, high)
        for pair, free in zip(self._pairs, (u == wanted).tolist(), strict=True):
            pair.settle(free)
        self._u = u
        return Action(u.copy(), info=self._gains())

    def c_step(self, code: Code, loop: Loop) -> str:
        """Refuse: random perturbations go on for as long as it runs.

        Raises
        ------
        ConfigError
            Always, with the remedy.
        """
        raise ConfigError(
            "SPSA cannot be exported: it draws random perturbations of its gains for as long as it runs; "
            "export a PID with the gains it ends with (kp and kd of its signals)"
        )

    def _gains(self) -> dict[str, float]:
        return {
            f"{name}[{i}]": gain
            for i, pair in enumerate(self._pairs)
            for name, gain in zip(("kp", "kd"), pair.gains, strict=True)
        }


class _Pair:
    """One PID loop and the search for its gains."""

    def __init__(self, settings: SPSA, gains: FloatArray, h: float, rng: np.random.Generator) -> None:
        self._settings, self._initial, self._h, self._rng = settings, gains, h, rng
        self._relative = np.ones(2)
        self._per_integral_time = 1.0 / settings.integral_time if settings.integral_time else 0.0
        self._iteration = 0
        self._integral = self._next_integral = 0.0
        self._last: float | None = None
        self._perturb()

    @property
    def gains(self) -> list[float]:
        """The gains without their perturbation: kp, kd."""
        gains: list[float] = (self._initial * self._relative).tolist()
        return gains

    def step(self, error: float, y: float) -> float:
        """Return the control of one sample."""
        rate = 0.0 if self._last is None else (self._last - y) / self._h
        self._last = y
        self._judge(error, rate)
        self._next_integral = self._integral + self._h * error
        tried = self._initial * (self._relative + self._perturbation)
        return float(tried @ (error + self._per_integral_time * self._next_integral, rate))

    def settle(self, free: bool) -> None:
        """Integrate, unless the input is at a limit."""
        if free:
            self._integral = self._next_integral

    def pause(self) -> None:
        """Break off the perturbation that is being tried."""
        self._last = None
        self._perturb()

    def _perturb(self) -> None:
        """Draw a perturbation and begin with its positive side."""
        self._size = self._settings.perturbation / (self._iteration + 1) ** _PERTURBATION_DECAY  # c_k
        self._perturbation = self._size * self._rng.choice([-1.0, 1.0], 2)
        self._losses: list[float] = []
        self._samples, self._before = 0, 0.0

    def _judge(self, error: float, rate: float) -> None:
        """Compare the error at the end of a window with that at its beginning."""
        window = self._settings.window
        energy = error**2 + (window * self._h * rate) ** 2 + self._settings.resolution**2
        if self._samples == window:
            self._losses.append(log(energy / self._before))
            self._perturbation = -self._perturbation  # after the second window it is D again
            self._samples = 0
            if len(self._losses) == 2:
                self._improve()
        if self._samples == 0:
            self._before = energy
        self._samples += 1

    def _improve(self) -> None:
        settings = self._settings
        size = settings.step_size / (self._iteration + 1 + settings.stability) ** _STEP_DECAY  # a_k
        positive, negative = self._losses
        slope = (positive - negative) / (2.0 * self._size) * np.sign(self._perturbation)
        self._relative = self._relative - np.clip(size * slope, -settings.largest_step, settings.largest_step)
        self._iteration += 1
        self._perturb()
