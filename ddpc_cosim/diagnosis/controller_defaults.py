"""Settings of the built-in controllers for a plant whose gains and ranges are known.

The controllers' own defaults are those of the publications, for signals of size one or so. Here weights are
divided by the squared size of what they weigh, so that the plant's units do not matter.
"""

from dataclasses import dataclass

import numpy as np

from ddpc_cosim.diagnosis.proposal import Competitor
from ddpc_cosim.plugins import plugin_names
from ddpc_cosim.variables import FloatArray

_HORIZON, _INITIAL_LENGTH = 15, 5
_DAMPING = 5.0
_UNEQUAL = 10.0


@dataclass(frozen=True, slots=True)
class Scales:
    """Sizes of the signals, and how the outputs follow the inputs.

    Parameters
    ----------
    inputs : array, shape (m,)
        How far each input goes from rest.
    outputs : array, shape (p,)
        How far each output's setpoints go from rest.
    first_gains : array, shape (p, m)
        Change of the outputs one sample after a step of one unit.
    """

    inputs: FloatArray
    outputs: FloatArray
    first_gains: FloatArray


def competitors(scales: Scales, *, may_record: bool) -> dict[str, Competitor]:
    """Return the installed controllers that settings are known for, by key.

    Parameters
    ----------
    scales : Scales
        Sizes and gains.
    may_record : bool
        Whether the plant can be recorded in open loop.
    """
    installed = plugin_names("controllers")
    suggested = {"mfapc": _mfapc(scales)} | ({"deepc": _deepc(scales)} if may_record else {})
    return {key: competitor for key, competitor in suggested.items() if competitor.type in installed}


def _deepc(scales: Scales) -> Competitor:
    per_output = 1.0 / scales.outputs**2
    settings = {
        "initial_length": _INITIAL_LENGTH,
        "horizon": _HORIZON,
        "output_weight": _plain(10.0 * per_output),
        "setpoint_weight": _plain(30.0 * per_output),
        "input_weight": _plain(0.1 / scales.inputs**2),
        "lambda_g": 1.0,
        "lambda_sigma": _significant(1e5 * float(np.max(per_output))),
        "affine_sum": "all",
    }
    return Competitor(
        "deepc",
        "DeePC",
        settings,
        "weights are divided by the squared size of the signals; "
        'affine_sum = "all" admits an operating point other than zero; '
        "lambda_g up: calmer with noise and nonlinear plants, down: faster",
    )


def _mfapc(scales: Scales) -> Competitor:
    gradient = scales.first_gains
    strength = float(np.mean(np.sum(gradient**2, axis=0)))
    settings = {
        "horizon": _HORIZON,
        "lambda_u": _significant(_DAMPING * _HORIZON * strength),
        "mu": _significant(float(np.min(scales.inputs) / 2) ** 2),
        "epsilon": _significant(1e-5 * min(1.0, _smallest(gradient), float(np.min(scales.inputs)))),
        "initial_gradient": [[_significant(float(entry)) for entry in row] for row in gradient],
    }
    remark = (
        "initial_gradient: change of the outputs one sample after a unit step; "
        "lambda_u up: calmer, down: faster"
    )
    if np.max(scales.outputs) > _UNEQUAL * np.min(scales.outputs):
        remark += "; it weighs all outputs alike in their units, so that the small ones count for little here"
    return Competitor("mfapc", "MFAPC-CFDL", settings, remark)


def _smallest(gradient: FloatArray) -> float:
    magnitudes = np.abs(gradient[gradient != 0.0])
    return float(magnitudes.min()) if magnitudes.size else 1.0


def _plain(weights: FloatArray) -> float | list[float]:
    """Return one number for one signal, a list for several."""
    values = [_significant(float(weight)) for weight in weights]
    return values[0] if len(values) == 1 else values


def _significant(value: float) -> float:
    return float(f"{value:.3g}")


def recording_length(competitor: Competitor, inputs: int, outputs: int, measurements: int) -> int:
    """Return the fewest samples of a recording that a competitor can learn from."""
    from ddpc_cosim.config import ControllerSection
    from ddpc_cosim.study_controllers import make_controller

    section = ControllerSection(type=competitor.type, settings=dict(competitor.settings))
    return make_controller(section).recording_length(inputs, outputs, measurements)
