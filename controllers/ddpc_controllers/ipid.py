"""Intelligent PID control: what acts on the plant besides the input is estimated and cancelled.

M. Fliess and C. Join, Model-free control, International Journal of Control 86(12), 2013,
doi:10.1080/00207179.2013.810345. With the ultra-local model ``y^(nu) = F + alpha u`` and e = y* - y,

    u = alpha^-1 (-F + y*^(nu) + Kp e + Ki int e + Kd e')

leaves the error dynamics ``e^(nu) + Kd e' + Kp e + Ki int e = 0`` wherever F is estimated well.

They estimate F over a short window in which it is taken as constant. Here the
solutions of the model under the inputs held between the samples,

    y(t) - alpha w(t) = y_k + y'_k t + ... + F t^nu / nu!,   w^(nu) = u,   w = w' = ... = 0 now,

are fitted to the window by least squares: exact where F is constant, and linear in the samples, so that the
estimates are a few inner products with weights known in advance.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import factorial
from typing import ClassVar

import numpy as np

from ddpc_controllers.checks import check_settings_and, per_signal, prior_info, without_forecast
from ddpc_controllers.data.hankel import resting_input, running_past
from ddpc_controllers.export.code import ALL_AHEAD, Code, Exportable
from ddpc_controllers.optimisation.limits import AT_REST, EXPECTED, HELD_WITHOUT_REFERENCE
from ddpc_cosim import (
    Action,
    ConfigError,
    Factor,
    FloatArray,
    Integer,
    Loop,
    Sample,
    Weight,
    setting,
)


class UltraLocalModel:
    """One such model for each of p outputs, sharing order and window.

    Parameters
    ----------
    order : int
        nu, 1 or 2.
    samples : int
        Sampling intervals in the window, at least nu.
    sampling_time : float
        Time between samples [s].
    alpha : array, shape (p, m)
        How the inputs act.
    """

    def __init__(self, order: int, samples: int, sampling_time: float, alpha: FloatArray) -> None:
        self._order, self._h, self._alpha = order, sampling_time, alpha
        # Times in samples, oldest first, 0 is now: powers of seconds can be too unlike for one matrix.
        times = -np.arange(samples, -1.0, -1.0)
        powers = np.array([times**i / factorial(i) for i in range(order + 1)]).T
        derivatives = sampling_time ** np.arange(order + 1)[:, np.newaxis]
        self._of_outputs = np.linalg.pinv(powers) / derivatives
        self._of_inputs = self._of_outputs @ _response(order, samples, sampling_time)
        self._y = np.zeros((samples + 1, len(alpha)))
        self._u = np.zeros((samples, alpha.shape[1]))

    def start(self, y: FloatArray, u: FloatArray) -> None:
        """Fill the window with a plant at rest: outputs of shape (p,), inputs of shape (m,)."""
        self._y[...] = y
        self._u[...] = u

    def append(self, u: FloatArray, y: FloatArray) -> None:
        """Take the inputs held since the last sample and the outputs now."""
        self._u[:-1] = self._u[1:]
        self._u[-1] = u
        self._y[:-1] = self._y[1:]
        self._y[-1] = y

    def estimates(self) -> FloatArray:
        """Return y, its derivatives and, in the last row, F; shape (nu + 1, p)."""
        answer: FloatArray = self._of_outputs @ self._y - self._of_inputs @ self._u @ self._alpha.T
        return answer

    def ahead(self, u: FloatArray) -> FloatArray:
        """Return the outputs that the model expects one sample later under inputs u, shape (p,)."""
        state = self.estimates()
        state[-1] += self._alpha @ u
        expected: FloatArray = sum(row * self._h**i / factorial(i) for i, row in enumerate(state))
        return expected

    def tables(self) -> dict[str, FloatArray]:
        """Return the weights of the estimates, for code in C."""
        return {"of_outputs": self._of_outputs, "of_inputs": self._of_inputs, "alpha": self._alpha}

    def window(self) -> tuple[FloatArray, FloatArray]:
        """Return the outputs and the inputs of the window, oldest first."""
        return self._y, self._u


def _response(order: int, samples: int, h: float) -> FloatArray:
    """Return w at the times of the window for a unit input held over each interval; oldest first.

    Backwards from now, w(-tau) is the integral of -u(s) over s from -tau to 0; for order 2 of (s + tau) u(s).
    """
    response = np.zeros((samples + 1, samples))
    for back in range(1, samples + 1):
        for interval in range(back):  # from -(interval + 1) h to -interval h
            weight = -h if order == 1 else h * h * (back - interval - 0.5)
            response[samples - back, samples - 1 - interval] = weight
    return response


@dataclass(kw_only=True)
class IPID(Exportable):
    """Intelligent PID control; needs no recording and as many inputs as outputs.

    The reference counts as constant, so that its derivatives are not followed. What enters the estimation are
    the inputs within their limits, so that a limit does not wind it up; the integral of an output stands
    still while an input that it moves is at a limit. A measurement that is not finite is replaced by what the
    model expects, which is a status.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD
    _follows_in_c: ClassVar[bool] = True

    accepts_missing: ClassVar[bool] = True

    order: int = setting(1, choices=(1, 2), doc="nu, order of the ultra-local model")
    alpha: Weight = setting(
        1.0,
        doc="how the inputs act on the outputs' derivative of that order: a number, a list, or p x m",
        search=Factor(0.03, 30.0),
    )
    kp: float = setting(1.0, low=0.0, doc="proportional gain [1/s^nu]", search=Factor(0.03, 30.0))
    ki: float = setting(0.0, low=0.0, doc="integral gain [1/s^(nu+1)]", search=Factor(0.03, 30.0))
    kd: float = setting(0.0, low=0.0, doc="derivative gain [1/s^(nu-1)]", search=Factor(0.03, 30.0))
    window: int = setting(
        4, low=1, doc="sampling intervals over which F is estimated, at least nu", search=Integer(2, 25)
    )

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults)

    def start(self, loop: Loop) -> None:
        """Forget what was estimated.

        Raises
        ------
        ConfigError
            ``alpha`` does not fit the number of signals, or cannot be inverted.
        """
        alpha = self._alpha_matrix(len(loop.outputs), len(loop.inputs))
        self._inverse = np.linalg.inv(alpha)
        self._moves = (self._inverse != 0.0).T.astype(float)  # which inputs an output's error moves
        self._model = UltraLocalModel(self.order, self.window, loop.sampling_time, alpha)
        self._h, self._bounds = loop.sampling_time, loop.bounds
        self._u = resting_input(loop)
        self._integral = np.zeros(len(loop.outputs))
        self._started = False
        self._moving = bool({variable.name for variable in loop.inputs} & {*loop.moving_limits})
        self._taken_over = False
        if past := running_past(loop):
            self._take_over(past.u, past.y)
            self._taken_over = not loop.continues_recording

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs that cancel F and correct the error."""
        y, fault = sample.y, ""
        if not np.isfinite(y).all():
            if not self._started:
                return Action(self._u.copy(), AT_REST)
            y = np.where(np.isfinite(y), y, self._model.ahead(self._u))
            fault = EXPECTED
        if self._taken_over:  # the last inputs were its own, for the reference of this sample
            self._integral = self._integral_before(sample.setpoint)
            self._taken_over = False
        self._observe(y)
        if not np.isfinite(sample.reference).all():
            return Action(self._u.copy(), HELD_WITHOUT_REFERENCE)
        error = sample.reference[0] - y
        estimates = self._model.estimates()
        integral = self._integral + self._h * error
        correction = self.kp * error + self.ki * integral - estimates[-1]
        if self.order > 1:
            correction -= self.kd * estimates[1]
        wanted = self._inverse @ correction
        low, high = sample.input_limits[0].T if self._moving else (self._bounds.u_min, self._bounds.u_max)
        u: FloatArray = np.clip(wanted, low, high)
        limited = self._moves @ (u != wanted) > 0
        self._integral = np.where(limited, self._integral, integral)
        self._u = u
        return Action(u.copy(), fault) if fault else u.copy()

    @property
    def past_length(self) -> int:
        """How many samples of a running plant its window has."""
        return self.window + 1

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the law, with the window as it is."""
        code.kernel("ipid")
        p = len(self._u)
        ipid = code.constant(
            "IPID",
            p=p,
            order=self.order,
            samples=self.window,
            sampling_time=self._h,
            kp=self.kp,
            ki=self.ki,
            kd=self.kd,
            **{name: code.doubles(values) for name, values in self._model.tables().items()},
            inverse=code.doubles(self._inverse),
        )
        of_a_step = np.zeros((self.order + 1, p)), np.zeros(p), np.zeros(p)
        begun = -1.0 if self._taken_over else float(self._started)
        limits = code.memory([self._bounds.u_min, self._bounds.u_max])
        look = code.ahead.limits(code, 1, limits) if self._moving and code.ahead else ""
        learned = *self._model.window(), self._u, self._integral
        held = code.held("IPIDMemory", begun, *learned, limits, *of_a_step)
        return code.step(f"{look}{held}ipid_step(&{ipid}, &held, sample, u, told);")

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        return without_forecast(prior_info("a rough gain of the inputs, alpha", loop.outputs), loop)

    def _integral_before(self, r: FloatArray) -> FloatArray:
        """Return the integral with which the last inputs follow from the window as it is, shape (p,)."""
        estimates, y = self._model.estimates(), self._model.window()[0][-1]
        if not self.ki or not np.isfinite(r).all():
            return self._integral
        rest = np.linalg.solve(self._inverse, self._u) + estimates[-1] - self.kp * (r - y)
        if self.order > 1:
            rest += self.kd * estimates[1]
        return np.asarray(rest / self.ki)

    def _observe(self, y: FloatArray) -> None:
        if self._started:
            self._model.append(self._u, y)
        else:
            self._model.start(y, self._u)
            self._started = True

    def _take_over(self, u: FloatArray, y: FloatArray) -> None:
        """Go on where a recording ended."""
        self._model.start(y[0], u[0])
        for held, measured in zip(u[:-1], y[1:], strict=True):
            self._model.append(held, measured)
        self._u, self._started = u[-1].copy(), True

    def _alpha_matrix(self, p: int, m: int) -> FloatArray:
        """Return alpha, shape (p, m), p = m."""
        if p != m:
            raise ConfigError(f"IPID needs as many inputs as outputs; there are {m} inputs, {p} outputs")
        given = np.asarray(self.alpha, dtype=float)
        alpha = np.diag(per_signal("alpha", self.alpha, p)) if given.ndim < 2 else given
        if alpha.shape != (p, p):
            raise ConfigError(
                f"IPID: alpha has shape {given.shape}; needed: a number, {p} numbers, or {p} x {p}"
            )
        if np.linalg.matrix_rank(alpha) < p:
            raise ConfigError(
                f"alpha = {given.tolist()} has no inverse: inputs that act on the outputs alike"
            )
        return alpha

    def _faults(self) -> list[str]:
        faults = []
        if self.window < self.order:
            faults.append(f"IPID: window = {self.window} is shorter than order = {self.order}")
        if self.order == 1 and self.kd > 0.0:
            faults.append(
                f"IPID: kd = {self.kd:g} needs order = 2: a first-order model estimates no derivative"
            )
        return faults
