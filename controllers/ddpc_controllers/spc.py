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
from typing import Any, Literal, get_args

import numpy as np

from ddpc_controllers.checks import weight_matrices
from ddpc_controllers.data.causal import predict_causally, uncertainty_cost
from ddpc_controllers.data.hankel import matching_recording, signals_of, window_starts
from ddpc_controllers.data.instruments import predict_all_at_once
from ddpc_controllers.deepc import BehavioralTracking, DeePC
from ddpc_controllers.optimisation.problem import Blocks, Problem
from ddpc_cosim import (
    Controller,
    FloatArray,
    Log,
    Loop,
    Recording,
    setting,
)

PredictorName = Literal["least-squares", "causal", "transient"]

_INFINITE = 1e8
"""Stands for an infinite weight, in parts of the largest weight of the tracking errors."""


@dataclass(kw_only=True)
class SPC(BehavioralTracking):
    """Subspace predictive control: the past is met exactly, the outputs are the least-squares prediction.

    By default inputs and outputs are weighed from the artificial setpoint of (8), so that no input is pulled
    to where it rests; without it they track the reference itself. A past that no combination of the recorded
    windows has (noise on a recording without noise) is a counted status; the nearest past is used.

    Neither ``predictor`` nor ``uncertainty`` is a weight: the one leaves out of the prediction what is noise
    for certain, the other puts the expected cost in place of that of the prediction, as far as the recording
    says how uncertain it is. See :mod:`~ddpc_controllers.data.causal`.
    """

    use_current_output: bool = setting(
        True,
        doc="the output measured now ends the past window and the next is the first predicted; otherwise the "
        "sample before does, and what is measured now is held against the next reference",
    )
    predictor: PredictorName = setting(
        "least-squares",
        choices=get_args(PredictorName),
        doc="what an output is predicted from, beside the past: all inputs of the horizon; those before it; "
        "these and the outputs before it, one sample ahead at a time",
    )
    uncertainty: bool = setting(
        False,
        doc="add to the cost what the recording leaves uncertain of the predictor, as it is expected to be",
    )

    def _faults_between_settings(self) -> list[str]:
        faults = super()._faults_between_settings()
        if self.instruments != "none" and (self.predictor != "least-squares" or self.uncertainty):
            faults.append(
                f"{type(self).__name__}: instruments = {self.instruments!r} make a predictor of their own: "
                "use predictor = 'least-squares' and uncertainty = false, or instruments = 'none'"
            )
        return faults

    @property
    def _has_predictor(self) -> bool:
        return super()._has_predictor or self.predictor != "least-squares"

    def _predictor(self, data: FloatArray, recording: Recording, windows: int | None = None) -> FloatArray:
        if self.instruments != "none":
            return super()._predictor(data, recording, windows)
        widths = {name: values.shape[1] for name, values in signals_of(recording).items()}
        if self.predictor == "least-squares":
            return predict_all_at_once(data[:, :windows], self.horizon * widths["y"])
        transient = self.predictor == "transient"
        return predict_causally(data[:, :windows], self._layout, widths, transient=transient)

    def _write_down(self, loop: Loop) -> Problem:
        """Write down the problem over gamma_2 and gamma_3; gamma_1 follows from the past."""
        problem = self._tracking_problem(loop, prefer_rest=True)
        past_y = np.eye(self._parameters.sizes["y_ini"])
        problem.equate({"y_ini": past_y}, {"y_ini": past_y})
        problem.regularise(dict(zip("uy", self._weights(), strict=True)))
        if self.uncertainty:
            problem.penalise(np.eye(1), self._uncertainty(loop, problem), {})
        return problem

    def _uncertainty(self, loop: Loop, problem: Problem) -> Blocks:
        """Return what the squares of are added to the cost, by the rows that outputs are predicted from."""
        recording, followed = matching_recording(loop, type(self).__name__), self._outlook.followed
        (weight,) = weight_matrices(output_weight=(self.output_weight, self._method_loop.controlled))
        of_all = np.zeros((self._outputs, self._outputs))
        of_all[np.ix_(followed, followed)] = weight[np.ix_(followed, followed)]
        data = self._layout.stack(signals_of(recording), recording.seams)
        cost = uncertainty_cost(
            data,
            self._predictor(data, recording),
            of_all,
            self._layout,
            {name: values.shape[1] for name, values in signals_of(recording).items()},
            window_starts(len(recording), self._layout.depth, recording.seams),
            causal=self.predictor != "least-squares",
        )
        *given, _ = problem.rows
        ends = np.cumsum([problem.rows[name] for name in given])[:-1]
        return dict(zip(given, np.split(cost, ends, axis=1), strict=True))

    def settings_as(
        self, other: type[Controller], inputs: int, outputs: int, samples: int
    ) -> Mapping[str, Any] | None:
        """Return the settings with which gamma-DDPC and DeePC do the same; what is derived may do another."""
        if type(self) not in (SPC, GammaDDPC):
            return None
        shared = {field.name: getattr(self, field.name) for field in fields(SPC)}
        windows = samples - self._layout.depth + 1
        heavy = _INFINITE * float(np.max(np.abs(self.output_weight)))
        beta_2, beta_3 = self._betas()
        if other is GammaDDPC:
            return shared | {"beta_2": beta_2, "beta_3": min(beta_3, heavy / max(windows, 1))}
        # DeePC has one predictor, no price on gamma_2, nor a preference among setpoints alike in cost.
        alike = self.artificial_setpoint and inputs > outputs
        plain = self.predictor == "least-squares" and not self.uncertainty
        if other is DeePC and plain and not beta_2 and not alike:
            shared = {name: shared[name] for name in (field.name for field in fields(BehavioralTracking))}
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

    @property
    def _leaves_outputs_open(self) -> bool:
        return not self._has_predictor

    def _betas(self) -> tuple[float, float]:
        return self.beta_2, self.beta_3
