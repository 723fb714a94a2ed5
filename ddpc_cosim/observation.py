"""What a controller sees at a sample as one vector: inputs of its FMU, of a policy, of an environment."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from math import prod

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import Loop, Sample, further_arguments
from ddpc_cosim.variables import FloatArray, Variable, names

_KINDS = {
    "setpoint": "Reference",
    "reference": "Reference",
    "disturbance": "Measured value",
    "forecast": "Forecast",
    "lower": "Lower edge of the band",
    "upper": "Upper edge of the band",
    "price": "Price",
    "min": "Lower limit",
    "max": "Upper limit",
}
_AHEAD = ("now", "at the next sample")
_LIMITS = ("input_limits", "output_limits")


class Observation:
    """The numbers that are seen at a sample, one after another, and what they are.

    They are the controlled outputs as measured, the other measurements, the reference now and in the next
    samples as far as the loop's preview and the horizon go, and of what :func:`further_signals` lists
    disturbances and forecasts, edges of bands, prices, and limits that move and are finite.

    Parameters
    ----------
    loop : Loop
        The loop.
    horizon : int
        How many samples ahead are seen.

    Attributes
    ----------
    measurements, references, further : tuple of Variable
        The three parts of them, with all limits: called as the measured signals; ``setpoint.NAME`` for the
        reference now and ``reference.NAME[k]`` for that in k samples; as :func:`further_signals` calls them.
    variables : tuple of Variable
        All of them, n names and units.
    """

    def __init__(self, loop: Loop, horizon: int) -> None:
        controlled = names(loop.outputs)
        others = [i for i, v in enumerate(loop.measurements) if v.name not in controlled]
        self._others = np.array(others, dtype=np.intp)
        self._preview = min(loop.preview, horizon)
        shapes = further_arguments(loop, horizon)
        self._further = [(name, shape[0]) for name, shape in shapes.items()]
        self.measurements = (*loop.outputs, *(loop.measurements[i] for i in others))
        self.references = tuple(
            _ahead_of(variable, "reference" if k else "setpoint", k)
            for k in range(self._preview + 1)
            for variable in loop.outputs
        )
        self.further = tuple(further_signals(loop, horizon))
        every = (*self.measurements, *self.references, *self.further)
        # A limit that does not move says nothing, and what is infinite cannot be calculated with.
        is_seen = {
            name: _seen_limits(loop, name, shape[0]) if name in _LIMITS else np.ones(prod(shape), dtype=bool)
            for name, shape in shapes.items()
        }
        first = np.ones(len(every) - len(self.further), dtype=bool)
        self.variables = tuple(compress(every, np.concatenate([first, *is_seen.values()])))
        self._further_seen = [(name, rows) for name, rows in self._further if is_seen[name].any()]
        seen = np.concatenate([first, *(is_seen[name] for name, _ in self._further_seen)])
        self._seen = None if seen.all() else seen

    def of(self, sample: Sample) -> FloatArray:
        """Return them at a sample, in their units, shape (n,)."""
        whole = self._numbers(sample, self._further_seen)
        return whole if self._seen is None else whole[self._seen]

    def with_all_limits(self, sample: Sample) -> FloatArray:
        """Return them with limits that do not move, infinite ones too, as code in C is given them."""
        return self._numbers(sample, self._further)

    def _numbers(self, sample: Sample, further: Sequence[tuple[str, int]]) -> FloatArray:
        """Return them with so many rows of further fields of the sample."""
        parts = [sample.y, sample.measured[self._others]] if self._others.size else [sample.y]
        parts.append(sample.setpoint)
        if self._preview:
            parts.append(sample.reference[: self._preview].ravel())
        for name, rows in further:
            part = getattr(sample, name)
            parts.append((part if len(part) == rows else part[:rows]).ravel())
        return np.concatenate(parts)


def _seen_limits(loop: Loop, field: str, rows: int) -> NDArray[np.bool_]:
    """Return which entries of so many rows of limits move and are finite."""
    bounds = loop.bounds
    variables, ends = (
        (loop.inputs, (bounds.u_min, bounds.u_max))
        if field == "input_limits"
        else (loop.outputs, (bounds.y_min, bounds.y_max))
    )
    moves = np.array([[variable.name in loop.moving_limits] for variable in variables])
    return np.tile((moves & np.isfinite(np.stack(ends, axis=1))).ravel(), rows)


def further_signals(loop: Loop, horizon: int) -> list[Variable]:
    """Return the inputs of the FMU that :func:`ddpc_cosim.further_arguments` lists, one after another.

    They are called ``disturbance.NAME`` and ``forecast.NAME[k]``, that in k samples; ``lower.NAME`` and
    ``upper.NAME`` of a band, ``price.NAME``, and ``min.NAME`` and ``max.NAME`` of limits, now, and with
    ``[k]`` in k samples. What is ahead starts as NaN, which is not known: where it is not connected the row
    before holds.

    Parameters
    ----------
    loop : Loop
        The loop that the controller was started with.
    horizon : int
        The controller's.
    """
    prices = [Variable(c.name, f"{c.unit}/{c.amount}", description="Price") for c in loop.charges]
    bounds, standing = loop.bounds, {"price": np.zeros((len(prices), 1))}
    standing["disturbance"] = np.array([[variable.start] for variable in loop.disturbances])
    standing["input_limits"] = np.stack([bounds.u_min, bounds.u_max], axis=1)
    standing["output_limits"] = np.stack([bounds.y_min, bounds.y_max], axis=1)
    of_field: dict[str, tuple[Sequence[Variable], Sequence[str], int]] = {
        "disturbance": (loop.disturbances, ("disturbance",), 0),
        "forecast": (loop.disturbances, ("forecast",), 1),
        "band_now": (loop.outputs, ("lower", "upper"), 0),
        "band": (loop.outputs, ("lower", "upper"), 1),
        "price": (prices, ("price",), 0),
        "input_limits": (loop.inputs, ("min", "max"), 0),
        "output_limits": (loop.outputs, ("min", "max"), 1),
    }
    signals = []
    for field, shape in further_arguments(loop, horizon).items():
        variables, kinds, first = of_field[field]
        rows = 1 if field in ("disturbance", "band_now") else shape[0]
        for row in range(rows):
            for number, variable in enumerate(variables):
                for side, kind in enumerate(kinds):
                    start = float(standing[field][number, side]) if field in standing and not row else np.nan
                    signal = _ahead_of(variable, kind, row + first)
                    start = start if np.isfinite(start) else np.nan
                    signals.append(replace(signal, min=-np.inf, max=np.inf, start=start))
    return signals


def _ahead_of(variable: Variable, kind: str, k: int) -> Variable:
    """Return what is known of a signal in k samples as a variable of its own."""
    when = f"{k} samples ahead" if k > 1 else _AHEAD[k]
    name = f"{kind}.{variable.name}[{k}]" if k else f"{kind}.{variable.name}"
    return replace(variable, name=name, description=f"{_KINDS[kind]} of {variable.name} {when}")
