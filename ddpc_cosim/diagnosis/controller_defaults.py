"""Settings of the built-in controllers for a plant whose gains and ranges are known.

The controllers scale signals by their nominal values, which the study gives: weights are for signals of size
one.
"""

from dataclasses import dataclass

import numpy as np

from ddpc_cosim.diagnosis.proposal import Competitor
from ddpc_cosim.plugins import plugin_names
from ddpc_cosim.variables import FloatArray

_HORIZON, _INITIAL_LENGTH = 15, 5
_OUTPUT_WEIGHT, _SETPOINT_WEIGHT, _INPUT_WEIGHT = 10.0, 30.0, 0.1
_DAMPING = 5.0


@dataclass(frozen=True, slots=True)
class ScaledGains:
    """How the outputs follow the inputs, all signals in parts of their nominal values.

    Parameters
    ----------
    first : array, shape (p, m)
        Change of the outputs one sample after a step of one unit.
    lasting : array, shape (p, m)
        Change in the end.
    """

    first: FloatArray
    lasting: FloatArray


def competitors(gains: ScaledGains, *, may_record: bool) -> dict[str, Competitor]:
    """Return the installed controllers that settings are known for, by key.

    Parameters
    ----------
    gains : ScaledGains
        The plant's.
    may_record : bool
        Whether the plant can be recorded in open loop.
    """
    installed = plugin_names("controllers")
    suggested = [_mfapc(gains)]
    if may_record:
        suggested += [_deepc(), _mpc(), *_pid(gains)]
    return {competitor.type: competitor for competitor in suggested if competitor.type in installed}


def _deepc() -> Competitor:
    settings = {
        "initial_length": _INITIAL_LENGTH,
        "horizon": _HORIZON,
        "output_weight": _OUTPUT_WEIGHT,
        "setpoint_weight": _SETPOINT_WEIGHT,
        "input_weight": _INPUT_WEIGHT,
        "lambda_g": 1.0,
        "lambda_sigma": 1e5,
        "affine_sum": "all",
    }
    return Competitor(
        "deepc",
        "DeePC",
        settings,
        'affine_sum = "all" admits an operating point other than zero; '
        "lambda_g up: calmer with noise and nonlinear plants, down: faster",
    )


def _mfapc(gains: ScaledGains) -> Competitor:
    gradient = gains.first
    strength = float(np.mean(np.sum(gradient**2, axis=0)))
    settings = {
        "horizon": _HORIZON,
        "lambda_u": _significant(_DAMPING * _HORIZON * strength),
        "mu": 0.25,
        "epsilon": _significant(1e-5 * min(1.0, _smallest(gradient))),
        "initial_gradient": [[_significant(float(entry)) for entry in row] for row in gradient],
    }
    return Competitor(
        "mfapc",
        "MFAPC-CFDL",
        settings,
        "initial_gradient: change of the outputs one sample after a unit step, in parts of nominal values; "
        "lambda_u up: calmer, down: faster",
    )


def _mpc() -> Competitor:
    settings = {"horizon": _HORIZON, "output_weight": _OUTPUT_WEIGHT, "input_weight": _INPUT_WEIGHT}
    return Competitor(
        "mpc",
        "MPC, model identified",
        settings,
        "the model is identified from the recording; input_weight up: calmer, down: faster",
    )


def _pid(gains: ScaledGains) -> list[Competitor]:
    """Return PID loops, each output with the input that moves it most; none if inputs are too few."""
    outputs, inputs = gains.lasting.shape
    if outputs > inputs:
        return []
    from scipy.optimize import linear_sum_assignment

    _, pairing = linear_sum_assignment(np.abs(gains.lasting), maximize=True)
    settings = {"tuning": "step-test", "pairing": pairing.tolist()}
    return [
        Competitor(
            "pid",
            "PID, step test",
            settings,
            "gains from a step test on the recording; pairing: number of the input for each output",
        )
    ]


def _smallest(gradient: FloatArray) -> float:
    magnitudes = np.abs(gradient[gradient != 0.0])
    return float(magnitudes.min()) if magnitudes.size else 1.0


def _significant(value: float) -> float:
    return float(f"{value:.3g}")


def recording_length(competitor: Competitor, inputs: int, outputs: int, measurements: int) -> int:
    """Return the fewest samples of a recording that a competitor can learn from."""
    from ddpc_cosim.config import ControllerSection
    from ddpc_cosim.study_controllers import make_controller

    section = ControllerSection(type=competitor.type, settings=dict(competitor.settings))
    return make_controller(section).recording_length(inputs, outputs, measurements)
