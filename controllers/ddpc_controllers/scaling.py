"""Signals in parts of their nominal values: weights that mean the same on every plant.

A weight of 1 weighs an error as large as the signal's nominal value (the ``nominal`` of its variable, 1 where
a plant declares none), whether that is 1 rad or 1e5 Pa. Limits stay in the units of the plant.

The methods that weigh errors are :class:`ScaledSignals`; :class:`Scaled` does the same for any controller.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from ddpc_controllers.data.quality import Judgement
from ddpc_controllers.export.code import Code, Exportable, inner_step
from ddpc_controllers.optimisation.limits import InputLimits
from ddpc_controllers.wrapper import SingleWrapper
from ddpc_cosim import (
    Action,
    Bounds,
    ConfigError,
    FloatArray,
    Loop,
    Sample,
    Variable,
    setting,
)

ScaleBy = Literal["nominal", "range", "none"]
# A signal's largest value in parts of its scale. Beyond, a weight on it counts for nothing, or for all.
_SMALLEST, _LARGEST = 1e-3, 1e3
SCALES: tuple[str, ...] = get_args(ScaleBy)


class Scales:
    """A loop in scaled signals.

    Parameters
    ----------
    loop : Loop
        The loop; the range of an input or an output is that of the loop's bounds.
    by : {"nominal", "range", "none"}
        What one unit of a scaled signal is: its nominal value; half its range, where it has none the nominal
        value; or its unit.

    Attributes
    ----------
    u, y, measured : array, shapes (m,), (p,), (q,)
        Scales of inputs, outputs and measurements, in the signals' own units; positive.
    loop : Loop
        The loop in scaled signals; the loop itself if they are the signals.

    Raises
    ------
    ConfigError
        Every signal whose nominal value cannot be a scale.
    """

    def __init__(self, loop: Loop, by: ScaleBy) -> None:
        self.u, self.y, self.measured = _scales_of(loop, by)
        self._by = by
        self._variables = loop.inputs, loop.outputs
        self._trivial = all(bool(np.all(scale == 1.0)) for scale in (self.u, self.y, self.measured))
        self._limits = InputLimits(loop.bounds.u_min, loop.bounds.u_max)
        self.loop = loop if self._trivial else self._scaled(loop)

    def step(self, step: Callable[[Sample], FloatArray | Action], sample: Sample) -> FloatArray | Action:
        """Return what a step in scaled signals answers to a sample, the inputs in their own units."""
        if self._trivial:
            return step(sample)
        answer = step(
            sample._replace(
                y=sample.y / self.y,
                measured=sample.measured / self.measured,
                reference=sample.reference / self.y,
                setpoint=sample.setpoint / self.y,
            )
        )
        if isinstance(answer, Action):
            return answer._replace(u=self._in_units(answer.u))
        return self._in_units(answer)

    def c_step(self, code: Code, step: Callable[[Code, Loop], str], horizon: int) -> str:
        """Add a step in scaled signals around the one that ``step`` adds, whose horizon is given."""
        inside = step(code, self.loop)
        if self._trivial:
            return inside
        code.kernel("scaled")
        p, q, m = len(self.y), len(self.measured), len(self.u)
        limits = self._limits.tables()
        scaled = code.constant(
            "Scaled",
            p=p,
            q=q,
            m=m,
            horizon=horizon,
            y=code.doubles(self.y),
            measured=code.doubles(self.measured),
            u=code.doubles(self.u),
            **{name: code.doubles(values) for name, values in limits.items()},
        )
        memory = code.memory(np.zeros(2 * p + q + horizon * p))
        return code.step(
            f"const Sample inside = scale_sample(&{scaled}, sample, {memory});\n"
            f"{inside}(memory, &inside, u, told);\n"
            f"unscale_inputs(&{scaled}, u);"
        )

    def misfits(self) -> list[str]:
        """Return which inputs and outputs are far from their scale, as the limits or the recording tell."""
        bounds, recording = self.loop.bounds, self.loop.recording
        u, y = (None, None) if recording is None else (recording.u, recording.y)
        known = {
            "input": (self._variables[0], self.u, bounds.u_min, bounds.u_max, u),
            "output": (self._variables[1], self.y, bounds.y_min, bounds.y_max, y),
        }
        return [
            f'the {what} "{variable.name}" is {_times(size)} {self._unit_of(variable, scale)}'
            for what, (variables, scales, low, high, values) in known.items()
            for variable, scale, size in zip(variables, scales, _largest(low, high, values), strict=True)
            if not (_SMALLEST <= size <= _LARGEST)
        ]

    def _unit_of(self, variable: Variable, scale: float) -> str:
        """Say what one unit of a scaled signal is, and how to choose another."""
        worth = f"{scale:g} {variable.unit}".rstrip()
        if self._by == "none":
            return 'its unit, on which the weights rest: choose scaling = "nominal" or "range"'
        if scale == abs(variable.nominal):
            other = "bounds" if self._by == "range" else 'scaling = "range"'
            return f"its nominal value of {worth}, on which the weights rest: set it, or {other}"
        return (
            f"half its range, {worth}, on which the weights rest: set bounds that it comes close to, or "
            'scaling = "nominal"'
        )

    def _in_units(self, u: FloatArray) -> FloatArray:
        inputs: FloatArray = u * self.u
        # The product can round to beside a limit that the scaled input is at.
        self._limits.reach(inputs)
        self._limits.hold(inputs)
        return inputs

    def _scaled(self, loop: Loop) -> Loop:
        bounds, recording = loop.bounds, loop.recording
        return replace(
            loop,
            inputs=_scaled(loop.inputs, self.u),
            outputs=_scaled(loop.outputs, self.y),
            measurements=_scaled(loop.measurements, self.measured),
            bounds=Bounds(
                bounds.u_min / self.u, bounds.u_max / self.u, bounds.y_min / self.y, bounds.y_max / self.y
            ),
            recording=recording
            and replace(
                recording,
                u=recording.u / self.u,
                y=recording.y / self.y,
                measured=recording.measured / self.measured,
            ),
        )


def _largest(low: FloatArray, high: FloatArray, values: FloatArray | None) -> FloatArray:
    """Return the largest size of scaled signals: recorded, or else in their limits; 1 where nothing tells."""
    if values is not None:
        return np.asarray(np.abs(values).max(axis=0))
    limits = np.abs([low, high])
    largest = np.where(np.isfinite(limits), limits, 0.0).max(axis=0)
    return np.where(largest > 0.0, largest, 1.0)


def _times(size: float) -> str:
    """Return a ratio in words."""
    return f"{size:.2g} times" if size >= 1.0 else f"1/{1.0 / size:.2g} of" if size > 0.0 else "0 times"


def _scales_of(loop: Loop, by: ScaleBy) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the scales of inputs, outputs and measurements."""
    if by == "none":
        return np.ones(len(loop.inputs)), np.ones(len(loop.outputs)), np.ones(len(loop.measurements))
    bounds, faults = loop.bounds, list[str]()
    u = _sizes(loop.inputs, bounds.u_min, bounds.u_max, by, faults)
    y = _sizes(loop.outputs, bounds.y_min, bounds.y_max, by, faults)
    low, high = (np.array([getattr(v, end) for v in loop.measurements]) for end in ("min", "max"))
    scales = _sizes(loop.measurements, low, high, by, [])
    if faults:
        raise ConfigError(faults)
    # An output has one scale, also where it is measured.
    of_outputs = {variable.name: scale for variable, scale in zip(loop.outputs, y, strict=True)}
    measured = [of_outputs.get(v.name, scale) for v, scale in zip(loop.measurements, scales, strict=True)]
    return u, y, np.array(measured)


def _sizes(
    variables: tuple[Variable, ...], low: FloatArray, high: FloatArray, by: ScaleBy, faults: list[str]
) -> FloatArray:
    """Return the scale of each variable; add those that cannot be scaled to the faults."""
    nominal = np.array([abs(variable.nominal) for variable in variables])
    half = np.full(len(variables), np.inf)
    np.subtract(high / 2, low / 2, out=half, where=np.isfinite(low) & np.isfinite(high))
    use_range = (by == "range") & np.isfinite(half) & (half > 0.0)
    scales: FloatArray = np.where(use_range, half, nominal)
    for variable, scale in zip(variables, scales, strict=True):
        if not (np.isfinite(scale) and scale > 0.0):
            faults.append(
                f'"{variable.name}" cannot be scaled: its nominal value is {variable.nominal:g}; give it one '
                "above 0, or bounds and scale by range"
            )
    return scales


def _scaled(variables: tuple[Variable, ...], scales: FloatArray) -> tuple[Variable, ...]:
    # Scaled once: what was the nominal value is 1 now.
    return tuple(
        replace(
            variable,
            unit="",
            display_unit=None,
            min=variable.min / scale,
            max=variable.max / scale,
            nominal=1.0,
            start=variable.start / scale,
        )
        for variable, scale in zip(variables, scales.tolist(), strict=True)
    )


@dataclass(kw_only=True)
class ScaledSignals(Exportable):
    """Base of the controllers that weigh errors: the method itself sees scaled signals only.

    Weights, noise and gains among the settings of a subclass are for scaled signals. Limits and amplitudes
    are in the units of the plant; subclasses divide them by ``self._scales``.
    """

    scaling: ScaleBy = setting(
        "nominal",
        choices=SCALES,
        doc="what weighs 1: the signal's nominal value, half its range (else the nominal value), or its unit",
    )
    _judgement = Judgement()

    def start(self, loop: Loop) -> None:
        """Start the method on the loop in scaled signals.

        Raises
        ------
        DataError
            The recording cannot serve.
        ConfigError
            A setting does not fit the loop, or a nominal value cannot be a scale.
        """
        self._scales = Scales(loop, self.scaling)
        self._start_scaled()

    def _start_scaled(self) -> None:
        """Start the method; where a setting does not fit, signals of another size may be the cause."""
        try:
            self._start(self._scales.loop)
        except ConfigError as error:
            if misfits := self._scales.misfits():
                raise ConfigError([*error.faults, *misfits]) from error
            raise

    def warnings(self) -> Sequence[str]:
        """Return what speaks against the recording: its signals' size, dead time, a poor prediction."""
        return [*self._scales.misfits(), *self._judgement.warnings]

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs that the method finds, in their units."""
        return self._scales.step(self._step, sample)

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the method, in scaled signals."""
        return self._scales.c_step(code, self._c_step, self.horizon)

    def _c_step(self, code: Code, loop: Loop) -> str:
        """Add the method to the code, for a loop in scaled signals; return its step function."""
        return super().c_step(code, loop)

    @abstractmethod
    def _start(self, loop: Loop) -> None:
        """Start on a loop in scaled signals."""

    @abstractmethod
    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return scaled inputs for a sample of scaled signals."""


@dataclass(kw_only=True)
class Scaled(SingleWrapper):
    """A controller in scaled signals. The origin stays where it is: linear methods stay linear.

    For controllers whose gains are in the units of the plant (PID), and for those of others; the methods that
    weigh errors scale them by their own ``scaling``.
    """

    scale_by: ScaleBy = setting(
        "range",
        choices=("range", "nominal"),
        doc="unit of a signal: half its range where it has one, else its nominal value; or always the latter",
    )

    def start(self, loop: Loop) -> None:
        """Start the controller on the scaled loop.

        Raises
        ------
        ConfigError
            A signal has neither a range nor a nominal value.
        CosimError
            The controller does not start.
        """
        self._scales = Scales(loop, self.scale_by)
        self._start_inside(self._scales.loop)

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the controller's inputs in their own units."""
        return self._scales.step(self._inner.step, sample)

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the controller, in scaled signals."""
        inside = self._inner.controller
        return self._scales.c_step(code, partial(inner_step, inside), inside.horizon)
