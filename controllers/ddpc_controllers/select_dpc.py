"""Select-DPC: subspace predictive control on the recorded windows nearest to what is happening.

J. Naef, K. Moffat, J. Eising, F. Doerfler, *Choose wisely: data-driven predictive control for nonlinear
systems using online data selection*, 2025 (arXiv:2503.18845). At every sample the recorded windows w_j of
past and future inputs and outputs are sorted by their distance from the window expected now,
w = (u_ini, y_ini, u, y), u and y being what was planned last; the nearest of them predict, affinely:

    ( U_p; Y_p; 1'; U_f; Y_f ) g = ( u_ini; y_ini; 1; u; y ),   columns with the smallest |D^-1 (w_j - w)|,

which linearises the plant about that window. Solved and chosen again a few times it follows the plan, as
sequential quadratic programming does. D has the standard deviation of every row: units decide nothing. Of two
windows equally near the earlier is taken. The first plan expected is that inputs and outputs stay. The
distance may be that of the outputs alone: recorded inputs that jump from sample to sample make all windows
alike far away, and it is the plant's state that its linearisation depends on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Literal, get_args

import numpy as np

from ddpc_controllers.deepc import BehavioralTracking
from ddpc_controllers.export.code import Code
from ddpc_controllers.optimisation.backends import make_backend
from ddpc_controllers.optimisation.limits import InputLimits
from ddpc_controllers.optimisation.problem import Problem
from ddpc_controllers.optimisation.qp import Law, Move, StepInfo, make_law
from ddpc_cosim import Choice, ConfigError, FloatArray, Integer, Log, Loop, Recording, setting

Compared = Literal["all", "outputs"]


@dataclass(kw_only=True)
class SelectDPC(BehavioralTracking):
    """Subspace predictive control on the recorded windows nearest to what is happening, for nonlinear plants.

    With all windows chosen it is SPC whose entries of g sum to 1. A step factorises the chosen windows anew.
    """

    use_current_output: bool = setting(
        True,
        doc="the output measured now ends the past window and the next is the first predicted; otherwise the "
        "sample before does, and what is measured now is held against the next reference",
    )
    windows_per_row: float = setting(
        3.0,
        low=1.0,
        doc="windows chosen at every sample, in parts of the rows that outputs are predicted from",
        search=Log(1.5, 20.0),
    )
    compared: Compared = setting(
        "all",
        choices=get_args(Compared),
        doc="what windows are near in: all their signals, or their outputs, past and planned",
        search=Choice(get_args(Compared)),
    )
    rounds: int = setting(1, low=1, doc="how often a sample chooses and plans", search=Integer(1, 3))

    def _faults_between_settings(self) -> list[str]:
        faults = super()._faults_between_settings()
        if self.instruments != "none":
            faults.append(
                f"SelectDPC: instruments = {self.instruments!r} make one predictor of all windows: "
                "use instruments = 'none'"
            )
        return faults

    @property
    def _sums_g(self) -> bool:
        return True

    def _write_down(self, loop: Loop) -> Problem:
        """Write down SPC's problem."""
        problem = self._tracking_problem(loop, prefer_rest=True)
        past_y = np.eye(self._parameters.sizes["y_ini"])
        problem.equate({"y_ini": past_y}, {"y_ini": past_y})
        problem.regularise({"u": 0.0, "y": inf})
        return problem

    def _make_law(self, problem: Problem, data: FloatArray) -> Law:
        problem.ask(u=problem.rows["u"], y=problem.rows["y"])
        self._selecting = SelectingLaw(self, problem, data, self._limits)
        return self._selecting

    def _begin(self, loop: Loop, recording: Recording) -> None:
        super()._begin(loop, recording)
        self._selecting.forget()

    def _c_step(self, code: Code, loop: Loop) -> str:
        raise ConfigError(
            "SelectDPC cannot be exported: it factorises the windows that it chooses while the loop runs, "
            "with decisions on their rank, and takes as much memory as the recording: use SPC"
        )


class SelectingLaw:
    """The law of a problem on the recorded windows that are nearest to the one expected.

    Parameters
    ----------
    settings : SelectDPC
        How they are chosen.
    problem : Problem
        The problem as printed, which is asked for all inputs and outputs of the plan last.
    data : array, shape (rows, windows)
        The stacked Hankel matrices M.
    limits : InputLimits
        Input limits, held exactly.
    """

    def __init__(self, settings: SelectDPC, problem: Problem, data: FloatArray, limits: InputLimits) -> None:
        self._problem, self._data, self._limits = problem, data, limits
        self._backend = make_backend(settings.backend)
        self._rounds, self._steps, self._horizon = settings.rounds, settings.apply_steps, settings.horizon
        above = problem.row_count - problem.rows["u"] - problem.rows["y"]
        equality, target = problem.equality
        fixed = ~equality[:, above:].any(axis=1)
        self._given = equality[fixed][:, :above].T @ target[fixed]
        wanted = round(settings.windows_per_row * (above + problem.rows["u"]))
        self._count = min(wanted, data.shape[1])
        names = np.repeat(list(problem.rows), list(problem.rows.values()))
        spread = data.std(axis=1)
        counts = np.isin(names, ("y_ini", "y")) | (settings.compared == "all")
        self._compared = np.flatnonzero(counts & (spread > 0.0))
        self._scale = spread[self._compared]
        self._windows = (data[self._compared] / self._scale[:, np.newaxis]).T.copy()
        # All windows: what weights leave undetermined is refused here, not in a step.
        self._on_all = make_law(problem, data, limits, self._backend, None)
        self._law: Law = self._on_all
        self.forget()

    def forget(self) -> None:
        """Expect nothing but that inputs and outputs stay."""
        self._plan: FloatArray | None = None

    def info(self, ends: Sequence[str], predicted: FloatArray, unit: FloatArray) -> StepInfo:
        """Return what the law on the windows chosen last says of its solution."""
        return self._law.info(ends, predicted, unit)

    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal move on the windows chosen now.

        Parameters
        ----------
        parameters : array, shape (parameters,)
            The parameter vector p; its last entry is 1.
        """
        given = self._given @ parameters
        plan = self._stays(given) if self._plan is None else self._plan
        for _ in range(self._rounds):
            self._law = self._law_about(np.concatenate([given, plan]))
            move = self._law.solve(parameters)
            if move.u is None:
                return move
            plan = move.u[-len(plan) :]
        self._plan = self._later(plan)
        return move

    def _law_about(self, window: FloatArray) -> Law:
        """Return the law on the windows nearest to one, shape (rows,)."""
        distance = np.square(self._windows - window[self._compared] / self._scale).sum(axis=1)
        chosen = np.sort(np.argsort(distance, kind="stable")[: self._count])
        try:
            return make_law(self._problem, self._data[:, chosen], self._limits, self._backend, None)
        except ConfigError:  # windows so much alike that they leave the optimum undetermined
            return self._on_all

    def _stays(self, given: FloatArray) -> FloatArray:
        """Return the plan of staying with the newest input and output of the past."""
        rows, horizon = self._problem.rows, self._horizon
        u_ini, y_ini, _ = np.split(given, np.cumsum([rows["u_ini"], rows["y_ini"]]))
        newest = u_ini[-rows["u"] // horizon :], y_ini[-rows["y"] // horizon :]
        return np.concatenate([np.tile(signal, horizon) for signal in newest])

    def _later(self, plan: FloatArray) -> FloatArray:
        """Return a plan as it is expected when the next one is made, its end staying."""
        samples = np.minimum(np.arange(self._horizon) + self._steps, self._horizon - 1)
        signals = np.split(plan, [self._problem.rows["u"]])
        return np.concatenate([signal.reshape(self._horizon, -1)[samples].ravel() for signal in signals])
