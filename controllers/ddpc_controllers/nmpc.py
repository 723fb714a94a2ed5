"""Nonlinear model predictive control on the plant's own equations: what is possible at all.

    min  sum_k |h(x_k) - r_k|_Q^2 + |u_k-1 - u_k-2|_R^2,   x_k+1 = F(x_k, u_k + d, t_k, w_k),   u_k in limits

by direct collocation at Radau points (L. T. Biegler, Comput. Chem. Eng. 8, 1984,
doi:10.1016/0098-1354(84)87012-X), where poles are too fast for it by multiple shooting (H. G. Bock, K. J.
Plitt, IFAC World Congress 1984), and IPOPT (A. Waechter, L. T. Biegler, Math. Program. 106, 2006,
doi:10.1007/s10107-004-0559-y), both by way of CasADi (J. A. E. Andersson et al., Math. Program. Comput. 11,
2019, doi:10.1007/s12532-018-0139-4). Each begins from the plan before, moved on by a sample, and its
multipliers. States and a constant disturbance d are estimated by an extended Kalman filter that starts from
the model's own start values.

Known disturbances w are what is measured of them now and their forecast. Of an output b in a band [l, h] it
is ``q_b (max(0, h_b(x_k) - h_k)^2 + max(0, l_k - h_b(x_k))^2)`` that counts, q_b being its element of Q's
diagonal, and what is paid adds ``price_weight sum_k price_k rate signal_k sampling_time``; the changes of the
inputs keep the optimum determined. Limits that move are limits of the plan.

It is a reference point, not a contender: equations, parameters and tables, such as weather, are those that
the plant is made of. It is not told what else acts on the plant: unknown disturbances, or parameters that
change in a scenario.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from ddpc_controllers.checks import check_settings_and, prior_info, weight_matrices
from ddpc_controllers.data.hankel import resting_input, running_past
from ddpc_controllers.export.code import Code, Exportable
from ddpc_controllers.models.plant_equations import (
    ExtendedKalmanFilter,
    PlantEquations,
    casadi,
    find_model,
    measured_signals,
)
from ddpc_controllers.optimisation.limits import HELD_WITHOUT_REFERENCE, LAST_HELD, PREDICTED
from ddpc_controllers.optimisation.outlook import Foresight
from ddpc_cosim import (
    OK,
    Action,
    ConfigError,
    FloatArray,
    Integer,
    Log,
    Loop,
    Recording,
    Sample,
    Weight,
    setting,
)

_PRECISE = {"tol": 1e-11, "compl_inf_tol": 1e-11, "acceptable_tol": 1e-8, "bound_relax_factor": 0.0}
"""Of IPOPT where slopes can be small beside the squares: of prices, and of outputs just outside a band."""
_EXCEEDED = 1e4
"""Weight of what predicted outputs exceed their bounds by, in parts of their nominal values."""
_ROUNDING = 1e-8
"""What may be left of the conditions of an optimum where rounding ends the search."""
_ENDLESS = 1e18
"""Stands for an edge or a limit that there is not."""


def preload() -> None:
    """Import what takes a second, once for all workers of a study."""
    casadi()
    import_module("sympy")


@dataclass(kw_only=True)
class NMPC(Foresight, Exportable):
    """Nonlinear model predictive control on the plant's own equations.

    A measurement that is not finite is replaced by the model's prediction. Where IPOPT finds no optimum
    within its iterations, the next inputs of the last plan are applied, without a plan the last inputs held.
    Each is a status.
    """

    accepts_missing: ClassVar[bool] = True

    model: str = setting(
        "",
        plant=True,
        doc="the plant: its name, module:MODEL or file.py:MODEL; empty: that of the study, else the "
        "installed one that `fmu` was exported from",
    )
    fmu: str = setting(
        "{plant}", file=True, doc='path of an FMU; in a study, "{plant}" is the FMU it controls'
    )
    parameters: Mapping[str, float] = setting(
        default_factory=dict, doc="parameters, and inputs that are not driven, that differ from the model's"
    )
    horizon: int = setting(20, low=1, doc="prediction horizon N, samples", search=Integer(5, 25))
    output_weight: Weight = setting(1.0, low=0.0, doc="Q: outputs off the reference, in nominal values")
    change_weight: Weight = setting(
        1e-3, above=0.0, doc="R: changes of the inputs, in nominal values", search=Log(1e-7, 1e-1)
    )
    process_noise: float = setting(
        0.3, above=0.0, doc="filter: standard deviation of what adds to the inputs, in nominal values"
    )
    disturbance_noise: float = setting(
        0.3,
        above=0.0,
        doc="filter: standard deviation of the disturbance's change per sample",
        search=Log(1e-3, 1e1),
    )
    measurement_noise: float = setting(
        0.1, above=0.0, doc="filter: standard deviation of the measurements", search=Log(1e-4, 1e1)
    )
    iterations: int = setting(100, low=1, doc="most iterations of IPOPT in a sample")
    use_forecast: bool = setting(  # it learns from no recording how disturbances go on
        True, doc="predict with the forecasts of known disturbances; otherwise what is measured now is held"
    )

    def __post_init__(self) -> None:
        check_settings_and(self, lambda: [])
        casadi()

    def start(self, loop: Loop) -> None:
        """Find the equations, and set up the filter and the nonlinear program.

        Raises
        ------
        ConfigError
            The plant is not found or has no such signals, or a weight does not fit.
        """
        model = find_model(self.model, self.fmu)
        plant = PlantEquations(model, loop, self.parameters)
        self._named, self._plant, self._past = model.name, plant, running_past(loop)
        self._filter = ExtendedKalmanFilter(
            plant, loop, self.process_noise, self.disturbance_noise, self.measurement_noise
        )
        self._u, self._u_min, self._u_max = resting_input(loop), loop.bounds.u_min, loop.bounds.u_max
        controlled = [variable.name for variable in loop.outputs]
        self._further = [i for i, v in enumerate(loop.measurements) if v.name not in controlled]
        self._program(plant, loop)
        self._w: FloatArray | None = None
        self._sampling_time = loop.sampling_time
        self._guess, self._multipliers = self._held(), dict[str, FloatArray]()
        self._planned = False

    def _program(self, plant: PlantEquations, loop: Loop) -> None:
        """Set up the nonlinear program, in parts of nominal values: states first, then inputs."""
        ca = casadi()
        n, m, p, steps = len(plant.start), len(loop.inputs), len(loop.outputs), self.horizon
        signals = [variable.name for variable in measured_signals(loop)]
        self._in_band = [i for i in range(p) if signals[i] in loop.bands]
        self._moving = [i for i in range(p) if signals[i] in loop.moving_limits]
        self._inputs_move = any(variable.name in loop.moving_limits for variable in loop.inputs)
        self._charged = bool(loop.charges and self.price_weight)
        q, r = weight_matrices(output_weight=(self.output_weight, p), change_weight=(self.change_weight, m))
        u_unit = np.abs([variable.nominal for variable in loop.inputs])
        y_unit = np.abs([variable.nominal for variable in loop.outputs])
        self._u_unit = u_unit
        states, inputs = ca.MX.sym("x", n * plant.points, steps), ca.MX.sym("u", m, steps)
        known = {
            name: ca.MX.sym(name, *shape)
            for name, shape in {
                "x": (n, 1),
                "d": (plant.disturbances, 1),
                "u": (m, 1),
                "r": (p, steps),
                "t": (1, 1),
                "w": (plant.acting, steps),
                "band": (2 * len(self._in_band), steps),
                "limits": (2 * len(self._moving), steps),
                "price": (len(loop.charges) if self._charged else 0, steps + 1),
            }.items()
        }
        start, unit = np.tile(plant.start, plant.points), np.tile(plant.nominal, plant.points)
        z = ca.repmat(start, 1, steps) + states * ca.repmat(unit, 1, steps)
        x = z[-n:, :]
        u = inputs * ca.repmat(u_unit, 1, steps)
        d, times = ca.repmat(known["d"], 1, steps), known["t"] + loop.sampling_time * ca.DM(range(steps)).T
        before = ca.horzcat(known["x"], x[:, :-1])
        w = [known["w"]] if plant.acting else []
        left = plant.defects.map(steps)(ca.reshape(z, n, -1), before, u, d, times, *w)
        defects = ca.reshape(left, n * plant.points, steps) / ca.repmat(unit, 1, steps)
        seen = plant.output.map(steps)(x, u, d, times + loop.sampling_time, *w)
        y = seen[:p, :]
        errors = (y - known["r"]) / ca.repmat(y_unit, 1, steps)
        if self._in_band:  # what follows a reference counts as it is, the rest where it is outside
            followed = [i for i in range(p) if i not in self._in_band]
            errors, q_followed = errors[followed, :], q[np.ix_(followed, followed)]
        else:
            q_followed = q
        changes = inputs - ca.horzcat(known["u"] / u_unit, inputs[:, :-1])
        cost = ca.dot(errors, q_followed @ errors) + ca.dot(changes, r @ changes)
        edges = ca.vertsplit(known["band"]) if self._in_band else []
        for i, low, high in zip(self._in_band, edges[::2], edges[1::2], strict=True):
            cost += q[i, i] * _outside(ca, y[i, :] / y_unit[i], low / y_unit[i], high / y_unit[i])
        moved = ca.vertsplit(known["limits"]) if self._moving else []
        for i, low, high in zip(self._moving, moved[::2], moved[1::2], strict=True):
            cost += _EXCEEDED * _outside(ca, y[i, :] / y_unit[i], low / y_unit[i], high / y_unit[i])
        for sign, limits in ((1.0, loop.bounds.y_max), (-1.0, loop.bounds.y_min)):
            for i in np.flatnonzero(np.isfinite(limits)).tolist():
                if i not in self._moving:
                    excess = ca.fmax(sign * (y[i, :] - limits[i]) / y_unit[i], 0.0)
                    cost += _EXCEEDED * ca.sumsqr(excess)
        for number, charge in enumerate(loop.charges if self._charged else ()):
            amount, price = self.price_weight * charge.rate * loop.sampling_time, known["price"][number, :]
            driven = [variable.name for variable in loop.inputs]
            if charge.signal in driven:
                cost += amount * ca.dot(price[:, :-1], u[driven.index(charge.signal), :])
            elif charge.signal in signals:
                cost += amount * ca.dot(price[:, 1:], seen[signals.index(charge.signal), :])
        self._low, self._high = (
            np.concatenate([np.full(n * plant.points * steps, side), np.tile(bound / u_unit, steps)])
            for side, bound in ((-np.inf, loop.bounds.u_min), (np.inf, loop.bounds.u_max))
        )
        options = {
            "expand": True,
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": self.iterations,
                "tol": 1e-8,
                "warm_start_init_point": "yes",
                "mu_init": 1e-6,
                **(_PRECISE if self._charged or self._in_band or loop.moving_limits else {}),
            },
        }
        program = {
            "x": ca.veccat(states, inputs),
            "f": cost,
            "g": ca.vec(defects),
            "p": ca.veccat(*known.values()),
        }
        self._solver: Any = ca.nlpsol("nmpc", "ipopt", program, options)

    def _signals(self, y: FloatArray, measured: FloatArray) -> FloatArray:
        """Return the outputs, then the measurements that are not outputs."""
        return np.concatenate([y, measured[self._further]])

    def step(self, sample: Sample) -> Action:
        """Return the first inputs of the optimal plan, shape (m,)."""
        if self._past is not None:
            self._catch_up(self._past, sample.time)
        signals = self._signals(sample.y, sample.measured)
        now = self._acting(self._disturbances(sample), sample.time)
        before = now[0] if self._w is None else self._w
        self._filter.correct(signals, self._u, before, sample.time)
        u, status, iterations = self._solve(sample, now)
        self._filter.predict(u, now[0], sample.time)
        self._u, self._w = u, now[0]
        missing = OK if np.isfinite(signals).all() else PREDICTED
        return Action(u.copy(), status or missing, {"iterations": iterations})

    def _catch_up(self, past: Recording, now: float) -> None:
        """Estimate the state from the samples before this one."""
        began = now - len(past) * self._sampling_time
        acting = self._acting(past.d, began)
        for k, (u, y, measured, w) in enumerate(zip(past.u, past.y, past.measured, acting, strict=True)):
            time = began + k * self._sampling_time
            before = w if self._w is None else self._w
            self._filter.correct(self._signals(y, measured), self._u, before, time)
            self._filter.predict(u, w, time)
            self._u, self._w = u, w
        self._guess, self._multipliers, self._past = self._held(), {}, None

    def _held(self) -> tuple[FloatArray, FloatArray]:
        """Return a guess of the plan: states at their start, and inputs held, in parts of nominal values."""
        inputs = np.tile((self._u / self._u_unit)[:, np.newaxis], self.horizon)
        return np.zeros((len(self._plant.start) * self._plant.points, self.horizon)), inputs

    def _acting(self, disturbances: FloatArray, begin: float) -> FloatArray:
        """Return what acts over samples from a time on [s], shape (samples, n_w), of tables midway."""
        midway = begin + (np.arange(len(disturbances), dtype=np.float64) + 0.5) * self._sampling_time
        return self._plant.of_acting(disturbances, midway)

    def _disturbances(self, sample: Sample) -> FloatArray:
        """Return the known disturbances over the horizon, shape (N, n_d)."""
        lasting = np.repeat(sample.disturbance[np.newaxis], self.horizon, axis=0)
        if self.use_forecast and lasting.size:
            lasting[1:] = sample.forecast[: self.horizon - 1]
        return lasting

    def _limits_now(self, sample: Sample) -> tuple[FloatArray, FloatArray]:
        """Return the limits of states and inputs over the horizon."""
        if not self._inputs_move:
            return self._low, self._high
        limits = sample.input_limits[: self.horizon] / self._u_unit[:, np.newaxis]
        self._u_min, self._u_max = sample.input_limits[0].T
        states = slice(0, len(self._low) - limits[..., 0].size)
        return (
            np.append(self._low[states], limits[..., 0].ravel()),
            np.append(self._high[states], limits[..., 1].ravel()),
        )

    def _solve(self, sample: Sample, w: FloatArray) -> tuple[FloatArray, str, float]:
        """Return the next inputs, why they are not the optimum, and the iterations that they took."""
        if not np.isfinite(sample.reference).all():
            return self._u, HELD_WITHOUT_REFERENCE, 0.0
        states, inputs = self._guess
        shapes = states.shape, inputs.shape
        known = [self._filter.x, self._filter.d, self._u, sample.reference.ravel(), np.array([sample.time])]
        known.append(w.ravel())
        if self._in_band:
            known.append(np.clip(sample.band[:, self._in_band].ravel(), -_ENDLESS, _ENDLESS))
        if self._moving:
            known.append(np.clip(sample.output_limits[:, self._moving].ravel(), -_ENDLESS, _ENDLESS))
        if self._charged:
            known.append(sample.price[: self.horizon + 1].ravel())
        low, high = self._limits_now(sample)
        solution = self._solver(
            x0=_joined(self._guess),
            **self._multipliers,
            p=np.concatenate(known),
            lbx=low,
            ubx=high,
            lbg=0.0,
            ubg=0.0,
        )
        statistics = self._solver.stats()
        if _is_optimal(statistics):
            states, inputs = _parts(solution["x"], *shapes)
            of_bounds, of_states = _parts(solution["lam_x"], *shapes), _parts(solution["lam_g"], shapes[0])
            self._multipliers = {
                "lam_x0": _joined(map(_next, of_bounds)),
                "lam_g0": _joined(map(_next, of_states)),
            }
            self._planned, status = True, ""
        else:
            instead = "the next inputs of the last plan are applied" if self._planned else LAST_HELD
            status = f"{statistics['return_status']}: {instead}"
            self._multipliers = {}
        u = np.clip(inputs[:, 0] * self._u_unit, self._u_min, self._u_max)
        self._guess = _next(states), _next(inputs)
        return u, status, float(statistics["iter_count"])

    def diagnostics(self) -> Mapping[str, float]:
        """Return the number of states, and of Runge-Kutta steps in a sample."""
        return {"model_order": float(len(self._filter.x)), "steps_per_sample": float(self._plant.steps)}

    def c_step(self, code: Code, loop: Loop) -> str:
        """Refuse: IPOPT iterates on equations of any plant.

        Raises
        ------
        ConfigError
            Always, with the remedy.
        """
        raise ConfigError(
            "NMPC cannot be exported: it solves a nonlinear program at every sample, which takes IPOPT; "
            "use mpc or koopman-mpc"
        )

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return that it has the plant's own equations."""
        tables = ", tables" * bool(self._plant.tables)
        prior = f"everything: the equations, parameters{tables} and start values of {self._named}"
        facts = prior_info(prior, loop.outputs, loop.measurements)
        if loop.disturbances:
            names = ", ".join(variable.name for variable in loop.disturbances)
            facts["forecast"] = names if self.use_forecast else "measured only"
        if self._charged:
            facts["prices"] = ", ".join(charge.name for charge in loop.charges)
        return facts


def _is_optimal(statistics: Mapping[str, Any]) -> bool:
    """Return whether IPOPT ended at an optimum, or as near to one as rounding lets it come."""
    if statistics["success"] or statistics["return_status"] != "Search_Direction_Becomes_Too_Small":
        return bool(statistics["success"])
    left = statistics["iterations"]
    return all(left[of][-1] <= _ROUNDING for of in ("inf_pr", "inf_du", "mu"))


def _outside(ca: Any, y: Any, low: Any, high: Any) -> Any:
    """Return the squares of what is outside of two edges."""
    return ca.sumsqr(ca.fmax(y - high, 0.0)) + ca.sumsqr(ca.fmax(low - y, 0.0))


def _joined(parts: Iterable[FloatArray]) -> FloatArray:
    """Return matrices of a column per sample as one vector, as the nonlinear program has them."""
    return np.concatenate([part.ravel("F") for part in parts])


def _parts(vector: Any, *shapes: tuple[int, int]) -> list[FloatArray]:
    """Return the matrices that a vector of CasADi's is made of."""
    ends = np.cumsum([rows * columns for rows, columns in shapes])
    parts = np.split(vector.full()[:, 0], ends[:-1])
    return [part.reshape(shape, order="F") for part, shape in zip(parts, shapes, strict=True)]


def _next(plan: FloatArray) -> FloatArray:
    """Return a plan from its second sample on, the last one repeated."""
    return np.hstack([plan[:, 1:], plan[:, -1:]])
