"""Data-enabled predictive control, equation (8), with the regularisers and the data updates of its family.

Sources beside the paper's [8] and [9]: the projection regulariser is that of F. Doerfler, J. Coulson and
I. Markovsky, *Bridging direct and indirect data-driven control formulations via regularizations and
relaxations*, IEEE TAC 68(2), 2023, doi:10.1109/TAC.2022.3148374 (arXiv:2101.01273).
"""

import copy
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ddpc_controllers.adaptive_qp import AdaptiveQP
from ddpc_controllers.backends import make_backend
from ddpc_controllers.behavioral_tracking import AffineSum, BehavioralTracking, Solver
from ddpc_controllers.condensing import Condenser
from ddpc_controllers.learning import OnlineLearning
from ddpc_controllers.problem import Problem
from ddpc_controllers.regularisation import Regularisation
from ddpc_cosim import FloatArray, Loop, Recording, setting

Regulariser = Literal["ridge", "shifted-ridge", "projection", "l1"]


@dataclass(kw_only=True)
class DeePC(OnlineLearning, BehavioralTracking):
    """Data-enabled predictive control, equation (8).

    The defaults are those of Table 1 and the problem is the printed one. ``artificial_setpoint`` and
    ``terminal_equality`` off give the regulation form of [8]. ``affine_sum = "first-horizon"`` and
    ``zero_padding`` do what the paper's published program does and equation (8) does not.

    ``regulariser`` is what ``lambda_g`` weighs: ``"ridge"`` |g|^2; ``"shifted-ridge"`` |g - g'|^2, g' being
    the last plan's combination, which leaves no bias at rest; ``"projection"`` |(I - Pi) g|^2, only what goes
    beyond the least-squares prediction; ``"l1"`` |g|_1, for which no condensed form is known: the full
    problem is solved by PIQP's sparse backend at every sample, at a cost that grows with the recording, and
    where that fails the last input is held.

    ``online_data`` lets the data follow the plant: see
    :class:`~ddpc_controllers.learning.OnlineLearning`.
    """

    regulariser: Regulariser = setting(
        "ridge", choices=get_args(Regulariser), doc="what lambda_g weighs of g: see the class"
    )
    lambda_g: float = setting(50.0, above=0.0, doc="weight of the regulariser, of |g|^2 with the ridge")
    slack: bool = setting(True, doc="past outputs may be missed by sigma_y; otherwise they are met exactly")
    lambda_sigma: float = setting(1e7, above=0.0, doc="weight of |sigma_y|^2, the misfit of the past outputs")
    affine_sum: AffineSum = setting("none", choices=get_args(AffineSum), doc="which entries of g sum to 1")

    def _faults_between_settings(self) -> list[str]:
        faults = super()._faults_between_settings()
        if self.online_data != "frozen":
            if self.regulariser == "l1":
                faults.append(
                    "DeePC: regulariser = 'l1' has no condensed form to update; use another regulariser or "
                    "online_data = 'frozen'"
                )
            if self.affine_sum == "first-horizon":
                faults.append(
                    "DeePC: affine_sum = 'first-horizon' counts windows of the recording, which online_data "
                    "replaces; use affine_sum = 'all'"
                )
        return faults + self._online_faults("DeePC")

    @property
    def _affine_sum(self) -> AffineSum:
        return self.affine_sum

    @property
    def _remembers_plan(self) -> bool:
        return self.regulariser == "shifted-ridge"

    def _write_down(self, loop: Loop) -> Problem:
        """Write down (8), the slack sigma_y = Y_p g - y_ini eliminated."""
        problem = self._tracking_problem(loop)
        past_y = np.eye(self._parameters.sizes["y_ini"])
        if self.slack:
            weight = self.lambda_sigma * np.eye(len(loop.outputs))
            problem.penalise(weight, {"y_ini": past_y}, {"y_ini": past_y})
        else:
            problem.equate({"y_ini": past_y}, {"y_ini": past_y})
        if self.regulariser == "projection":
            predicted = problem.rows["y"]
            sizes = sum(problem.rows.values()) - predicted, predicted
            problem.regularise(Regularisation(sizes, (0.0, self.lambda_g)))
        else:
            problem.regularise(self.lambda_g, about="h_previous" if self._remembers_plan else "")
        return problem

    def _make_solver(
        self, loop: Loop, recording: Recording, condenser: Condenser, data: FloatArray
    ) -> Solver:
        if self.regulariser == "l1":
            from ddpc_controllers.uncondensed import UncondensedSolver

            return UncondensedSolver(self, recording, loop, self.apply_steps)
        if self.online_data == "frozen":
            return super()._make_solver(loop, recording, condenser, data)
        condenser.condense(data)  # says so if the weights leave the optimum undetermined
        signals = {"u": recording.u, "y": recording.y}
        self._learner = self._make_learner(
            condenser, data, self._layout, signals, loop.continues_recording, copy.deepcopy(loop.rng)
        )
        limits = self._planned_limits()
        return AdaptiveQP(condenser, self._learner.data, *limits, make_backend(self.backend))
