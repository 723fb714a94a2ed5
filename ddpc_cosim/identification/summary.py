"""What is to be said of a plant that was identified: which model, how good, how sure."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ddpc_cosim.files.durations import in_words
from ddpc_cosim.identification.bootstrap import gain_intervals, gains, interval, matched_poles
from ddpc_cosim.identification.candidates import HORIZON
from ddpc_cosim.identification.innovation import PlantModel
from ddpc_cosim.identification.specification import IdentifiedSpec
from ddpc_cosim.variables import FloatArray, names

_LEVEL = 0.9
_MOST_POLES = 4


def identified_data(spec: IdentifiedSpec) -> dict[str, Any]:
    """Return what was found, as plain values.

    Parameters
    ----------
    spec : IdentifiedSpec
        The plant, which is built.

    Returns
    -------
    data : dict
        ``model``; ``candidates`` with ``model`` and ``error``; ``fit`` by output [%]; ``gains`` by output and
        input with ``value``, ``low`` and ``high`` (None where a model integrates); ``time_constant`` [s],
        that of the slowest pole, likewise; ``poles``, the slowest, with ``time_constant`` [s] and ``period``
        [s] (None: a real one) likewise, without ends where the models do not tell it from others; ``noise``,
        the standard deviation of each output's innovations; ``ranges``; ``members``, and how many of them are
        ``unstable``.
    """
    ensemble = spec.ensemble
    assert ensemble is not None
    best, models = ensemble.models[0], ensemble.models
    low, high = gain_intervals(models, _LEVEL)
    outputs, inputs = names(ensemble.outputs), names(ensemble.inputs)[: len(best.u_0)]
    constants = [_time_constant(model) for model in models]
    ends = interval(np.array(constants), _LEVEL)
    return {
        "files": list(spec.identification.file),
        "samples": ensemble.samples,
        "sampling_time": best.sampling_time,
        "model": ensemble.tried[0][0],
        "candidates": [{"model": words, "error": error} for words, error in ensemble.tried],
        "horizon": HORIZON,
        "fit": dict(ensemble.held_out),
        "gains": {
            output: {
                name: _interval(gains(best)[i, j], low[i, j], high[i, j]) for j, name in enumerate(inputs)
            }
            for i, output in enumerate(outputs)
        },
        "time_constant": _positive(constants[0], *ends),
        "poles": _poles(models),
        "noise": dict(zip(outputs, np.sqrt(np.diag(best.covariance)).tolist(), strict=True)),
        "ranges": {name: list(ends) for name, ends in ensemble.ranges.items()},
        "members": len(models),
        "unstable": int(np.isinf(constants).sum()),
    }


def identified_lines(spec: IdentifiedSpec, data: dict[str, Any]) -> Iterator[str]:
    """Yield the same in words, line by line."""
    ensemble = spec.ensemble
    assert ensemble is not None
    units = {variable.name: variable.unit for variable in (*ensemble.inputs, *ensemble.outputs)}
    yield f"{spec.label}: {data['samples']} samples, {in_words(data['sampling_time'])} apart"
    yield from ensemble.treatments
    yield f"model: {data['model']}"
    for candidate in data["candidates"][1:]:
        worse = candidate["error"] / data["candidates"][0]["error"]
        yield f"  instead of {candidate['model']}: {worse:.3g} times its error on data held out"
    for name, fit in data["fit"].items():
        where = (
            f"up to {data['horizon']} samples ahead, on the last quarter of the data, which it had not seen"
        )
        yield f"{name}: {fit:.3g} % explained {where}; noise {_number(data['noise'][name], units[name])}"
    for output, by_input in data["gains"].items():
        for name, gain in by_input.items():
            unit = f"{units[output] or '1'}/{units[name] or '1'}"
            yield f"gain from {name} to {output}: {_range(gain, unit, 'it integrates')}"
    yield f"slowest time constant: {_range(data['time_constant'], 's', 'it integrates, or is unstable')}"
    for pole in data["poles"][1:]:
        period = pole["period"]
        swings = f", period {_range(period, 's', 'none')}" if period else ""
        unsure = "" if pole["time_constant"]["low"] is not None else "; the models do not tell it from others"
        yield f"further time constant: {_range(pole['time_constant'], 's', 'it integrates')}{swings}{unsure}"
    if data["unstable"]:
        yield f"{data['unstable']} of the {data['members']} models do not come to rest by themselves"
    for name, (low, high) in data["ranges"].items():
        yield f"{name} was recorded from {low:.4g} to {_number(high, units[name])}: beyond, nothing is known"


def _poles(models: Sequence[PlantModel]) -> list[dict[str, Any]]:
    """Return time constants and periods of the slowest poles, and between what those of most models lie."""
    h, time_scales = models[0].sampling_time, list[dict[str, Any]]()
    poles, others = matched_poles(models, _MOST_POLES)
    with np.errstate(divide="ignore", invalid="ignore"):
        for pole, cloud in zip(poles, others.T, strict=True):
            every = np.concatenate([[pole], cloud])
            radius, angle = np.minimum(np.abs(every), 1.0), np.abs(np.angle(every))
            kinds = {"time_constant": -h / np.log(radius), "period": 2.0 * np.pi * h / angle}
            # The first of the cloud is the pole itself.
            intervals = {
                kind: _positive(values[0], *interval(values[1:], _LEVEL)) for kind, values in kinds.items()
            }
            time_scales.append({**intervals, "period": intervals["period"] if pole.imag else None})
    return time_scales


def _time_constant(model: PlantModel) -> float:
    """Return that of the slowest pole [s]; infinite of one that does not decay."""
    radius = float(np.abs(np.linalg.eigvals(model.linear_part()[0])).max())
    return np.inf if radius >= 1.0 else -model.sampling_time / np.log(max(radius, np.finfo(float).tiny))


def _positive(value: float, low: FloatArray, high: FloatArray) -> dict[str, float | None]:
    # Where some models do not come to rest, the data do not tell where the interval begins.
    return _interval(value, max(float(low), 0.0) if np.isfinite(low) else np.nan, float(high))


def _interval(value: float, low: float, high: float) -> dict[str, float | None]:
    ends = {"value": value, "low": low, "high": high}
    return {key: float(end) if np.isfinite(end) else None for key, end in ends.items()}


def _range(interval: dict[str, float | None], unit: str, otherwise: str) -> str:
    value, low, high = interval["value"], interval["low"], interval["high"]
    if value is None:
        return otherwise
    between = "" if low is None or high is None else f" (90 % interval: {low:.4g} to {high:.4g})"
    return f"{_number(value, unit)}{between}"


def _number(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()
