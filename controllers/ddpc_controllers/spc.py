"""Subspace predictive control and gamma-DDPC: prediction by the least-squares factor of the data.

With the triangular factor of the stacked data, blocks past | u | y,

    past = L_11 gamma_1,   u = L_21 gamma_1 + L_22 gamma_2,   y = L_31 gamma_1 + L_32 gamma_2 + L_33 gamma_3,

gamma_1 is fixed by the past, gamma_2 is the choice of the inputs, and gamma_3 is what the least-squares
prediction leaves unexplained. Subspace predictive control (W. Favoreel, B. De Moor, M. Gevers, *SPC: Subspace
predictive control*, IFAC World Congress 1999, doi:10.1016/S1474-6670(17)56683-5) has gamma_3 = 0.
Gamma-DDPC (V. Breschi, A. Chiuso, S. Formentin, *Data-driven predictive control in a stochastic setting: a
unified framework*, Automatica 152, 2023, doi:10.1016/j.automatica.2023.110961) weighs both:
``beta_2 |gamma_2|^2 + beta_3 |gamma_3|^2``. As there, the stacked data are divided by the root of the number
of windows, so that a weight means the same for a recording of any length.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ddpc_controllers.deepc import BehavioralTracking, DeePC
from ddpc_controllers.optimisation.problem import Problem
from ddpc_cosim import (
    Controller,
    Log,
    Loop,
    setting,
)

_INFINITE = 1e8
"""Stands for an infinite weight, in parts of the largest weight of the tracking errors."""


@dataclass(kw_only=True)
class SPC(BehavioralTracking):
    """Subspace predictive control: the past is met exactly, the outputs are the least-squares prediction.

    By default inputs and outputs are weighed from the artificial setpoint of (8), so that no input is pulled
    to where it rests; without it they track the reference itself. A past that no combination of the recorded
    windows has (noise on a recording without noise) is a counted status; the nearest past is used.
    """

    use_current_output: bool = setting(
        True,
        doc="the output measured now ends the past window and the next is the first predicted; otherwise the "
        "sample before does, and what is measured now is held against the next reference",
    )

    def _write_down(self, loop: Loop) -> Problem:
        """Write down the problem over gamma_2 and gamma_3; gamma_1 follows from the past."""
        problem = self._tracking_problem(loop, prefer_rest=True)
        past_y = np.eye(self._parameters.sizes["y_ini"])
        problem.equate({"y_ini": past_y}, {"y_ini": past_y})
        problem.regularise(dict(zip("uy", self._weights(), strict=True)))
        return problem

    def settings_as(
        self, other: type[Controller], inputs: int, outputs: int, samples: int
    ) -> Mapping[str, Any] | None:
        """Return the settings with which gamma-DDPC and DeePC do the same; what is derived may do another."""
        if type(self) not in (SPC, GammaDDPC):
            return None
        shared = {field.name: getattr(self, field.name) for field in fields(BehavioralTracking)}
        windows = samples - self._layout.depth + 1
        heavy = _INFINITE * float(np.max(np.abs(self.output_weight)))
        beta_2, beta_3 = self._betas()
        if other is GammaDDPC:
            return shared | {"beta_2": beta_2, "beta_3": min(beta_3, heavy / max(windows, 1))}
        # DeePC has no price on gamma_2, nor a preference among setpoints alike in cost.
        alike = self.artificial_setpoint and inputs > outputs
        if other is DeePC and not beta_2 and not alike:
            fixed = {"regulariser": "projection", "slack": False, "affine_sum": "none"}
            return shared | fixed | {"lambda_g": min(windows * beta_3, heavy)}
        return None

    def _betas(self) -> tuple[float, float]:
        """Return the weights of |gamma_2|^2 and |gamma_3|^2, the stacked data divided as above."""
        return 0.0, math.inf

    def _weights(self) -> tuple[float, float]:
        """Return the weights of |gamma_2|^2 and |gamma_3|^2 for the factor of the data as they are."""
        # It has the coordinates gamma / sqrt(windows).
        windows = self._diagnostics.data_columns
        beta_2, beta_3 = self._betas()
        return windows * beta_2, windows * beta_3


@dataclass(kw_only=True)
class GammaDDPC(SPC):
    """Gamma-DDPC: subspace prediction with a price on inputs away from the data, and on what it leaves open.

    Very large ``beta_3`` gives SPC back.
    """

    beta_2: float = setting(0.0, low=0.0, doc="weight of |gamma_2|^2: inputs unlike those of the recording")
    beta_3: float = setting(
        5.0, above=0.0, doc="weight of |gamma_3|^2: outputs off their prediction", search=Log(1e-1, 1e4)
    )

    def _betas(self) -> tuple[float, float]:
        return self.beta_2, self.beta_3
