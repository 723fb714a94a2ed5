"""Signals in parts of their nominal values: weights that mean the same on every plant.

A weight of 1 weighs an error as large as the signal's nominal value (the ``nominal`` of its variable, 1 where
a plant declares none), whether that is 1 rad or 1e5 Pa. Limits stay in the units of the plant.

:class:`Scaled` scales the signals of any controller that does not scale them by itself.
"""

import copy
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from ddpc_controllers.optimisation.limits import InputLimits
from ddpc_cosim import (
    Action,
    Bounds,
    ConfigError,
    Controller,
    FloatArray,
    Loop,
    Recording,
    Sample,
    Variable,
    check_settings,
    setting,
)

ScaleBy = Literal["nominal", "range", "none"]
SCALES: tuple[str, ...] = get_args(ScaleBy)


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """What one unit of each scaled signal is.

    Parameters
    ----------
    u, y, measured : array, shapes (m,), (p,), (q,)
        Scales of inputs, outputs and measurements, in the signals' own units; positive.
    """

    u: FloatArray
    y: FloatArray
    measured: FloatArray

    @classmethod
    def of(cls, loop: Loop, by: ScaleBy) -> "Scales":
        """Return the scales of a loop's signals.

        Parameters
        ----------
        loop : Loop
            The loop; the range of an input or an output is that of the loop's bounds.
        by : {"nominal", "range", "none"}
            Nominal values; half the ranges, where there is none the nominal value; or the units themselves.

        Raises
        ------
        ConfigError
            Every signal whose nominal value cannot be a scale.
        """
        sizes = len(loop.inputs), len(loop.outputs), len(loop.measurements)
        if by == "none":
            return cls(*(np.ones(size) for size in sizes))
        bounds, faults = loop.bounds, list[str]()
        u = _scales(loop.inputs, bounds.u_min, bounds.u_max, by, faults)
        y = _scales(loop.outputs, bounds.y_min, bounds.y_max, by, faults)
        low, high = (np.array([getattr(v, end) for v in loop.measurements]) for end in ("min", "max"))
        own = _scales(loop.measurements, low, high, by, [])
        if faults:
            raise ConfigError(faults)
        # An output has one scale, also where it is measured.
        of_outputs = {variable.name: scale for variable, scale in zip(loop.outputs, y, strict=True)}
        measured = [of_outputs.get(v.name, scale) for v, scale in zip(loop.measurements, own, strict=True)]
        return cls(u, y, np.array(measured))

    @property
    def trivial(self) -> bool:
        """Whether scaled signals are the signals."""
        return all(bool(np.all(scale == 1.0)) for scale in (self.u, self.y, self.measured))

    def scaled_loop(self, loop: Loop) -> Loop:
        """Return the loop in scaled signals; the loop itself if they are the signals."""
        if self.trivial:
            return loop
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
            and Recording(
                recording.u / self.u,
                recording.y / self.y,
                recording.measured / self.measured,
                recording.sampling_time,
            ),
        )

    def scaled_sample(self, sample: Sample) -> Sample:
        """Return what is known at a sample in scaled signals."""
        return sample._replace(
            y=sample.y / self.y,
            measured=sample.measured / self.measured,
            reference=sample.reference / self.y,
        )

    def in_units(self, answer: FloatArray | Action, limits: InputLimits) -> FloatArray | Action:
        """Return a controller's answer with inputs in their units, within their limits."""
        if isinstance(answer, Action):
            return answer._replace(u=self._inputs(answer.u, limits))
        return self._inputs(answer, limits)

    def _inputs(self, u: FloatArray, limits: InputLimits) -> FloatArray:
        inputs: FloatArray = u * self.u
        # The product can round to beside a limit that the scaled input is at.
        limits.reach(inputs)
        limits.hold(inputs)
        return inputs


@dataclass(kw_only=True)
class ScaledSignals(Controller):
    """Base of the controllers that weigh errors: the method itself sees scaled signals only.

    Weights, noise and gains among the settings of a subclass are for scaled signals. Limits and amplitudes
    are in the units of the plant; subclasses divide them by ``self._scales``.
    """

    scaling: ScaleBy = setting(
        "nominal",
        choices=SCALES,
        doc="what weighs 1: the signal's nominal value, half its range (else the nominal value), or its unit",
    )

    def start(self, loop: Loop) -> None:
        """Start the method on the loop in scaled signals.

        Raises
        ------
        DataError
            The recording cannot serve.
        ConfigError
            A setting does not fit the loop, or a nominal value cannot be a scale.
        """
        self._scales = Scales.of(loop, self.scaling)
        self._as_it_is = self._scales.trivial
        self._limits_in_units = InputLimits(loop.bounds.u_min, loop.bounds.u_max)
        self._start(self._scales.scaled_loop(loop))

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs that the method finds, in their units."""
        if self._as_it_is:
            return self._step(sample)
        return self._scales.in_units(self._step(self._scales.scaled_sample(sample)), self._limits_in_units)

    @abstractmethod
    def _start(self, loop: Loop) -> None:
        """Start on a loop in scaled signals."""

    @abstractmethod
    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return scaled inputs for a sample of scaled signals."""


def _scales(
    variables: tuple[Variable, ...], low: FloatArray, high: FloatArray, by: ScaleBy, faults: list[str]
) -> FloatArray:
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
class Wrapper(Controller):
    """Base of the controllers that change what another one sees; what that needs, they need."""

    controller: Controller = setting(doc="the controller inside")

    def __post_init__(self) -> None:
        check_settings(self)
        if not isinstance(self.controller, Controller):
            raise ConfigError(
                f"{type(self).__name__}: controller = {self.controller!r} is no controller; "
                "an example is PID()"
            )
        self.horizon = self.controller.horizon

    @property
    def uses_recording(self) -> bool:
        """Whether the controller needs a recording."""
        return self.controller.uses_recording

    @property
    def accepts_missing(self) -> bool:
        """Whether the controller goes on when a measurement is lost."""
        return self.controller.accepts_missing

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return what the controller needs."""
        return self.controller.recording_length(inputs, outputs, measurements)

    def diagnostics(self) -> Mapping[str, float]:
        """Return the controller's figures."""
        return self._inner.diagnostics()

    def _start_inside(self, loop: Loop) -> None:
        """Start a copy of the controller: the setting stays as it was given."""
        self._inner = copy.deepcopy(self.controller)
        self._inner.start(loop)


@dataclass(kw_only=True)
class Scaled(Wrapper):
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
        self._scales = Scales.of(loop, self.scale_by)
        self._limits = InputLimits(loop.bounds.u_min, loop.bounds.u_max)
        self._start_inside(self._scales.scaled_loop(loop))

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the controller's inputs in their own units."""
        return self._scales.in_units(self._inner.step(self._scales.scaled_sample(sample)), self._limits)
