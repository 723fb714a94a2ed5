"""The full problem online, where there is no condensed form: the route of the L1 regulariser."""

from typing import Any

import numpy as np

from ddpc_controllers.deepc import DeePC
from ddpc_controllers.full_problem import FullDeePC
from ddpc_controllers.qp import NOT_FINITE, Move
from ddpc_controllers.recorded import resting_input
from ddpc_cosim import FloatArray, Loop, Recording

L1_TOLERANCE, L1_RELAXED = 1e-9, 1e-7
"""Tolerances of PIQP in a closed loop; the L1 problem is too degenerate for the tightest one."""


class UncondensedSolver:
    """The full problem where the condensed one would stand; only its vectors change from step to step.

    Parameters
    ----------
    settings : DeePC
        Where the settings come from.
    recording : Recording
        The open-loop experiment.
    loop : Loop
        The loop's signals and limits.
    planned : int
        How many inputs of the horizon are applied.
    """

    def __init__(self, settings: DeePC, recording: Recording, loop: Loop, planned: int) -> None:
        self._settings, self._recording, self._loop, self._planned = settings, recording, loop, planned
        self._full: FullDeePC | None = self._set_up()

    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal inputs and their outputs; where PIQP fails, the last ones for all, and why."""
        loop, past, horizon = self._loop, self._settings.initial_length, self._settings.horizon
        m, p = len(loop.inputs), len(loop.outputs)
        ends = np.cumsum([past * m, (past + self._settings.use_current_output) * p, horizon * p])
        u_ini, y_ini, r, _ = np.split(parameters, ends)
        u_ini, y_ini, r = u_ini.reshape(-1, m), y_ini.reshape(-1, p), r.reshape(-1, p)
        u, y = np.tile(u_ini[-1], (self._planned, 1)), np.tile(y_ini[-1], (self._planned, 1))
        fault = NOT_FINITE
        if np.isfinite(parameters).all():
            self._full = self._full or self._set_up()
            solution = self._full.solve(u_ini, y_ini, r)
            fault = f"PIQP on the full problem: {solution.failure}; the last input is held"
            if solution.solved:
                u, y, fault = solution.u[: self._planned], solution.y[: self._planned], ""
        u = np.clip(u, loop.bounds.u_min, loop.bounds.u_max)
        return Move(np.concatenate([u.ravel(), y.ravel()]), fault)

    def _set_up(self) -> FullDeePC:
        rest, bounds = resting_input(self._loop), self._loop.bounds
        return FullDeePC(self._settings, self._recording, bounds, L1_TOLERANCE, rest, relaxed=L1_RELAXED)

    def __getstate__(self) -> dict[str, Any]:
        """Leave PIQP's workspace behind: it is set up again when it is needed."""
        return {**self.__dict__, "_full": None}
