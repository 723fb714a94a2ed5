"""Scaled signals: a controller that sees every signal in parts of its range.

Weights then mean the same on every plant: 1 weighs an error of half the range, whatever its unit. It is a
wrapper and no default of the methods, because the weights that a publication prints hold for its physical
units: in scaled signals they would be other weights, and its results could not be reproduced. Studies made
for a plant that nobody has tuned yet are where it belongs.
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

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

ScaleBy = Literal["range", "nominal"]


@dataclass(kw_only=True)
class Scaled(Controller):
    """A controller in scaled signals. The origin stays where it is: linear methods stay linear."""

    controller: Controller = setting(doc="the controller that sees scaled signals")
    scale_by: ScaleBy = setting(
        "range",
        choices=("range", "nominal"),
        doc="unit of a signal: half its range where it has one, else its nominal value; or always the latter",
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if not isinstance(self.controller, Controller):
            raise ConfigError(f"Scaled: controller = {self.controller!r} is no controller")
        self.horizon = self.controller.horizon

    @property
    def uses_recording(self) -> bool:  # type: ignore[override]  # its controller decides
        """Whether the controller needs a recording."""
        return self.controller.uses_recording

    @property
    def accepts_missing(self) -> bool:  # type: ignore[override]  # its controller decides
        """Whether the controller goes on when a measurement is lost."""
        return self.controller.accepts_missing

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return what the controller needs."""
        return self.controller.recording_length(inputs, outputs, measurements)

    def start(self, loop: Loop) -> None:
        """Start the controller on the scaled loop.

        Raises
        ------
        ConfigError
            A signal has neither a range nor a nominal value.
        CosimError
            The controller does not start.
        """
        bounds = loop.bounds
        self._bounds = bounds
        self._u = self._units(loop.inputs, bounds.u_min, bounds.u_max)
        self._y = self._units(loop.outputs, bounds.y_min, bounds.y_max)
        self._measured = self._units_of_measurements(loop)
        self._inner = copy.deepcopy(self.controller)
        self._inner.start(self._scaled_loop(loop))

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the controller's inputs in their own units."""
        answer = self._inner.step(
            sample._replace(
                y=sample.y / self._y,
                measured=sample.measured / self._measured,
                reference=sample.reference / self._y,
            )
        )
        if isinstance(answer, Action):
            return answer._replace(u=self._in_own_units(answer.u))
        return self._in_own_units(answer)

    def diagnostics(self) -> Mapping[str, float]:
        """Return the controller's figures."""
        return self._inner.diagnostics()

    def _in_own_units(self, u: FloatArray) -> FloatArray:
        # The product can round to beyond a limit.
        return np.clip(u * self._u, self._bounds.u_min, self._bounds.u_max)

    def _units(self, variables: tuple[Variable, ...], low: FloatArray, high: FloatArray) -> FloatArray:
        nominal = np.array([abs(variable.nominal) for variable in variables])
        half = np.full(len(variables), np.inf)
        np.subtract(high / 2, low / 2, out=half, where=np.isfinite(low) & np.isfinite(high))
        use_range = (self.scale_by == "range") & np.isfinite(half) & (half > 0.0)
        units: FloatArray = np.where(use_range, half, nominal)
        faults = [
            f'Scaled: "{variable.name}" has neither a range nor a nominal value; give it bounds'
            for variable, unit in zip(variables, units, strict=True)
            if not (np.isfinite(unit) and unit > 0.0)
        ]
        if faults:
            raise ConfigError(faults)
        return units

    def _units_of_measurements(self, loop: Loop) -> FloatArray:
        """Return the units of what is measured: those of the outputs where it is one."""
        variables = loop.measurements
        low, high = (np.array([getattr(v, end) for v in variables]) for end in ("min", "max"))
        units = self._units(variables, low, high)
        outputs = {variable.name: unit for variable, unit in zip(loop.outputs, self._y, strict=True)}
        return np.array([outputs.get(v.name, unit) for v, unit in zip(variables, units, strict=True)])

    def _scaled_loop(self, loop: Loop) -> Loop:
        bounds, recording = loop.bounds, loop.recording
        return replace(
            loop,
            inputs=_scaled(loop.inputs, self._u),
            outputs=_scaled(loop.outputs, self._y),
            measurements=_scaled(loop.measurements, self._measured),
            bounds=Bounds(
                bounds.u_min / self._u,
                bounds.u_max / self._u,
                bounds.y_min / self._y,
                bounds.y_max / self._y,
            ),
            recording=recording
            and Recording(
                recording.u / self._u,
                recording.y / self._y,
                recording.measured / self._measured,
                recording.sampling_time,
            ),
        )


def _scaled(variables: tuple[Variable, ...], units: FloatArray) -> tuple[Variable, ...]:
    return tuple(
        replace(
            variable,
            unit="",
            display_unit=None,
            min=variable.min / unit,
            max=variable.max / unit,
            nominal=variable.nominal / unit,
            start=variable.start / unit,
        )
        for variable, unit in zip(variables, units.tolist(), strict=True)
    )
