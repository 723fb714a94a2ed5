"""How far ahead a log lets methods predict: errors on samples that they held out, beside naive predictors."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ddpc_cosim.errors import CosimError
from ddpc_cosim.plugins import Plugin, installed
from ddpc_cosim.settings import declared_settings, is_required
from ddpc_cosim.variables import FloatArray
from ddpc_cosim.windows import FAIR, window_starts

_HELD_OUT = 0.25
_MEMORY = ("initial_length", "delays")
"""How methods call the settings for the samples of the past that they predict from."""


@dataclass(frozen=True, slots=True)
class Method:
    """How far off one method is.

    Parameters
    ----------
    name : str
        What a study calls it.
    errors : tuple of float
        Of predictions 1, 2, ... samples after the last known output: root mean square over the recording's
        last quarter, held out, of the output that is predicted worst, in parts of its standard deviation.
    reason : str
        Why there are none.
    """

    name: str
    errors: tuple[float, ...] = ()
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Predictions:
    """How far ahead a recording lets methods predict.

    Parameters
    ----------
    methods : tuple of Method
        Those that predict, the one that stays good longest first.
    hold, mean : tuple of float
        Errors, as of a method, if the last known output stays; if it is the mean of the samples not held out.
    memory : int
        Samples of the past that methods predict from, where they have a setting for it; 0: their defaults.
    samples : int
        How many samples this rests on.
    """

    methods: tuple[Method, ...] = ()
    hold: tuple[float, ...] = ()
    mean: tuple[float, ...] = ()
    memory: int = 0
    samples: int = 0

    def good_up_to(self, method: Method) -> int:
        """Return up to how many samples ahead a method is good.

        That is as long as its error stays below half of the output's standard deviation, and no further than
        where it is less than that of holding the last value.
        """
        steps = 0
        for k, (error, hold) in enumerate(zip(method.errors, self.hold, strict=False), 1):
            if error > FAIR:
                break
            steps = k if error < hold else steps
        return steps

    @property
    def best(self) -> Method | None:
        """The method that stays good longest; None: none is good one sample ahead."""
        first = self.methods[0] if self.methods else None
        return first if first and self.good_up_to(first) else None


def predictions(recording: Any, horizon: int, memory: int) -> Predictions:
    """Return how far ahead the methods that are installed predict.

    Parameters
    ----------
    recording : Recording
        The experiment.
    horizon : int
        How many samples ahead.
    memory : int
        From how many past samples at least, where a method has a setting for it.
    """
    hold, mean = _naive(recording.y, recording.seams, horizon)
    if not hold:
        return Predictions()
    every = Predictions((), hold, mean, memory, len(recording))
    methods = [
        method
        for plugin in installed("controllers")
        for method in _tested(plugin, recording, horizon, memory)
    ]
    methods.sort(
        key=lambda m: (not m.errors, -every.good_up_to(m), sum(m.errors) / max(len(m.errors), 1), m.name)
    )
    return Predictions(tuple(methods), hold, mean, memory, len(recording))


def _tested(plugin: Plugin, recording: Any, horizon: int, memory: int) -> Iterator[Method]:
    """Yield a plug-in's errors, or why it has none; nothing of one that does not predict by itself."""
    known = declared_settings(plugin.value) if isinstance(plugin.value, type) else {}
    if "horizon" not in known or any(is_required(plugin.value, name) for name in known):
        return
    try:
        controller = plugin.value(horizon=horizon)
        longer = {n: memory for n in _MEMORY if n in known and getattr(controller, n) < memory}
        controller = plugin.value(horizon=horizon, **longer)
        errors = controller.prediction_errors(recording)
        if errors is None:
            return
        worst = np.asarray(errors, dtype=np.float64).max(axis=1)
        if np.isfinite(worst).all():
            yield Method(plugin.name, tuple(worst.tolist()))
        else:
            yield Method(plugin.name, reason="its predictions are not finite")
    except CosimError as error:
        yield Method(plugin.name, reason=str(error))
    except Exception as error:  # a third party's method can fail in any way
        yield Method(plugin.name, reason=f"{type(error).__name__}: {error}")


def _naive(y: FloatArray, seams: Sequence[int], horizon: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the errors over the last quarter if the last value holds, and if it is the mean of the rest."""
    head = len(y) - max(1, round(_HELD_OUT * len(y)))
    size = np.where(y.std(axis=0) > 0.0, y.std(axis=0), 1.0)
    held = []
    for k in range(1, horizon + 1):
        lengths = np.diff((0, *seams, len(y)))
        if lengths.max(initial=0) <= k:
            break
        first = window_starts(len(y), k + 1, seams)
        first = first[first >= head]
        if not len(first):
            break
        errors = np.square(y[first + k] - y[first]).mean(axis=0)
        held.append(float((np.sqrt(errors) / size).max()))
    of_mean = float((np.sqrt(np.square(y[head:] - y[:head].mean(axis=0)).mean(axis=0)) / size).max())
    return tuple(held), (of_mean,) * len(held)
