"""Signals in parts of their nominal values: weights that mean the same on every plant.

A weight of 1 weighs an error as large as the signal's nominal value (the ``nominal`` of its variable, 1 where
a plant declares none), whether that is 1 rad or 1e5 Pa. Limits stay in the units of the plant.

The methods that weigh errors are :class:`ScaledSignals`; :class:`Scaled` does the same for any controller.
"""

from abc import abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import ClassVar, Literal, get_args

import numpy as np

from ddpc_controllers.checks import prior_info
from ddpc_controllers.data.quality import Judgement, stands_still
from ddpc_controllers.export.code import ALL_AHEAD, Code, Exportable, inner_step
from ddpc_controllers.optimisation.limits import InputLimits
from ddpc_controllers.optimisation.outlook import Foresight
from ddpc_controllers.wrapper import SingleWrapper
from ddpc_cosim import (
    Action,
    Bounds,
    ConfigError,
    FloatArray,
    Loop,
    Recording,
    Sample,
    Variable,
    setting,
)

ScaleAhead = Literal["there", "all", "none"]
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
    ahead : {"there", "all", "none"}
        What a sample says besides, disturbances, bands, limits that move: scale what there is in this loop,
        so that the rest costs no time; all of it; or leave it in the units of the plant.

    Attributes
    ----------
    u, y, measured, d : array, shapes (m,), (p,), (q,), (n_d,)
        Scales of inputs, outputs, measurements and disturbances, in the signals' own units; positive.
    loop : Loop
        The loop in scaled signals; the loop itself if they are the signals.

    Raises
    ------
    ConfigError
        Every signal whose nominal value cannot be a scale.
    """

    def __init__(self, loop: Loop, by: ScaleBy, ahead: ScaleAhead = "there") -> None:
        self.u, self.y, self.measured, self.d = scales = _scales_of(loop, by)
        self._by = by
        self._variables = loop.inputs, loop.outputs
        self._trivial = all(bool((scale == 1.0).all()) for scale in scales)
        self._limits_move = bool({variable.name for variable in loop.inputs} & {*loop.moving_limits})
        self._limits = InputLimits(loop.bounds.u_min, loop.bounds.u_max)
        self._further = self._fields_of(loop, ahead)
        self.loop = loop if self._trivial else self._scaled(loop)

    def step(self, step: Callable[[Sample], FloatArray | Action], sample: Sample) -> FloatArray | Action:
        """Return what a step in scaled signals answers to a sample, the inputs in their own units."""
        if self._trivial:
            return step(sample)
        if self._limits_move:
            self._limits.move(sample.input_limits)
        answer = step(
            sample._replace(
                y=sample.y / self.y,
                measured=sample.measured / self.measured,
                reference=sample.reference / self.y,
                setpoint=sample.setpoint / self.y,
                **{
                    name: values / scale
                    for name, scale in self._further
                    if (values := getattr(sample, name)).size
                },
            )
        )
        if isinstance(answer, Action):
            return answer._replace(u=self._in_units(answer.u))
        return self._in_units(answer)

    def c_step(self, code: Code, step: Callable[[Code, Loop], str], horizon: int) -> str:
        """Add a step in scaled signals around the one that ``step`` adds, whose horizon is given."""
        ahead = code.ahead
        every = self._fields_of(self.loop, "all")
        there = [pair for pair in every if ahead and getattr(ahead.places, pair[0]).size]
        with code.seeing(ahead and ahead.scaled(there)):
            inside = step(code, self.loop)
        if self._trivial:
            return inside
        code.kernel("scaled")
        p, q, m = len(self.y), len(self.measured), len(self.u)
        limits, keep, within = self._limits.tables(), "", ""
        if ahead and self._limits_move:
            held = code.memory(np.zeros(2 * m))
            keep = ahead.limits(code, 1, held)
            within = f"keep_limits(u, {held}, {m}, {code.doubles(self._limits.near)}, {m});\n"
            limits = InputLimits(np.full(m, -np.inf), np.full(m, np.inf)).tables()
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
        memory = code.memory(np.zeros(2 * p + q + horizon * p + m))
        return code.step(
            f"{keep}const Sample inside = scale_sample(&{scaled}, sample, {memory});\n"
            f"{inside}(memory, &inside, u, told);\n"
            f"unscale_inputs(&{scaled}, u);\n{within}"
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

    def _fields_of(self, loop: Loop, ahead: ScaleAhead) -> tuple[tuple[str, FloatArray], ...]:
        """Return what else a sample says, field by field, and its scale."""
        of_u, of_y = self.u[:, np.newaxis], self.y[:, np.newaxis]
        fields = [
            ((("disturbance", self.d), ("forecast", self.d)), loop.disturbances),
            ((("band_now", of_y), ("band", of_y)), loop.bands),
            ((("input_limits", of_u), ("output_limits", of_y)), loop.moving_limits),
        ]
        if ahead == "none":
            return ()
        return tuple(field for pair, there in fields for field in pair if there or ahead == "all")

    def _scaled(self, loop: Loop) -> Loop:
        bounds = loop.bounds
        signals = (*loop.measurements, *loop.outputs, *loop.inputs)
        sizes = dict(zip((v.name for v in signals), (*self.measured, *self.y, *self.u), strict=True))
        return replace(
            loop,
            inputs=_scaled(loop.inputs, self.u),
            outputs=_scaled(loop.outputs, self.y),
            measurements=_scaled(loop.measurements, self.measured),
            bounds=Bounds(
                bounds.u_min / self.u, bounds.u_max / self.u, bounds.y_min / self.y, bounds.y_max / self.y
            ),
            recording=self.of_recording(loop.recording),
            past=self.of_recording(loop.past),
            disturbances=_scaled(loop.disturbances, self.d),
            charges=tuple(c._replace(rate=c.rate * float(sizes.get(c.signal, 1.0))) for c in loop.charges),
        )

    def of_recording(self, recording: Recording | None) -> Recording | None:
        """Return a recording in scaled signals."""
        if self._trivial or recording is None:
            return recording
        return replace(
            recording,
            u=recording.u / self.u,
            y=recording.y / self.y,
            measured=recording.measured / self.measured,
            d=recording.d / self.d if recording.d.shape[1] == len(self.d) else recording.d,
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


def _scales_of(loop: Loop, by: ScaleBy) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the scales of inputs, outputs, measurements and disturbances."""
    if by == "none":
        inputs, outputs, measurements, disturbances = map(
            len, (loop.inputs, loop.outputs, loop.measurements, loop.disturbances)
        )
        return np.ones(inputs), np.ones(outputs), np.ones(measurements), np.ones(disturbances)
    bounds, faults = loop.bounds, list[str]()
    u = _sizes(loop.inputs, bounds.u_min.tolist(), bounds.u_max.tolist(), by, faults)
    y = _sizes(loop.outputs, bounds.y_min.tolist(), bounds.y_max.tolist(), by, faults)
    scales, d = (
        _sizes(signals, [v.min for v in signals], [v.max for v in signals], by, unfit)
        for signals, unfit in ((loop.measurements, list[str]()), (loop.disturbances, faults))
    )
    if faults:
        raise ConfigError(faults)
    # An output has one scale, also where it is measured.
    of_outputs = {variable.name: scale for variable, scale in zip(loop.outputs, y, strict=True)}
    measured = [of_outputs.get(v.name, scale) for v, scale in zip(loop.measurements, scales, strict=True)]
    sized = [np.array(sizes, dtype=np.float64) for sizes in (u, y, measured, d)]
    return sized[0], sized[1], sized[2], sized[3]


def _sizes(
    variables: tuple[Variable, ...],
    low: Sequence[float],
    high: Sequence[float],
    by: ScaleBy,
    faults: list[str],
) -> list[float]:
    """Return the scale of each variable; add those that cannot be scaled to the faults."""
    scales = []
    for variable, least, most in zip(variables, low, high, strict=True):
        half = most / 2 - least / 2
        scale = half if by == "range" and 0.0 < half < inf else abs(variable.nominal)
        scales.append(scale)
        if not 0.0 < scale < inf:
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


class Predicted:
    """A loop as a predictive method sees it.

    Measurements that are paid for, and neither inputs nor outputs, are outputs that it predicts, the last
    ones, without a reference. Disturbances that never moved in the recording are not there: the data do not
    have their effect.

    Parameters
    ----------
    loop : Loop
        The loop.
    foresight : Foresight or None
        What the method does with prices; None: it sees the loop as it is.
    learns : bool
        Whether it knows the plant by the recording alone.

    Attributes
    ----------
    loop : Loop
        The loop that it sees: the same where there is nothing of the kind.
    controlled : int
        How many of the outputs are controlled.
    paid : tuple of Variable
        The other outputs.
    warnings : list of str
        Which disturbances never moved.
    """

    def __init__(self, loop: Loop, foresight: Foresight | None, learns: bool) -> None:
        self.loop, self.controlled, self.warnings = loop, len(loop.outputs), list[str]()
        names = [variable.name for variable in loop.measurements]
        others = {variable.name for variable in (*loop.inputs, *loop.outputs)}
        paid = {c.signal for c in loop.charges} - others if foresight and foresight.price_weight else set()
        self._rows = [names.index(name) for name in names if name in paid]
        self.paid = tuple(loop.measurements[row] for row in self._rows)
        self._kept = list(range(len(loop.disturbances)))
        if foresight and learns:
            self._leave_out_what_stood_still(loop)
        self._trivial = not self._rows and len(self._kept) == len(loop.disturbances)
        if not self._trivial:
            self.loop = self._seen(loop)

    def sample(self, sample: Sample) -> Sample:
        """Return what the method sees of a sample."""
        if self._trivial:
            return sample
        if len(self._kept) < sample.disturbance.size:
            disturbance, forecast = sample.disturbance[self._kept], sample.forecast[:, self._kept]
            sample = sample._replace(disturbance=disturbance, forecast=forecast)
        if not self._rows:
            return sample
        more = len(self._rows)
        return sample._replace(
            y=np.concatenate([sample.y, sample.measured[self._rows]]),
            reference=np.pad(sample.reference, ((0, 0), (0, more))),
            setpoint=np.pad(sample.setpoint, (0, more)),
            band_now=_padded(sample.band_now, more),
            band=_padded(sample.band, more),
            output_limits=_padded(sample.output_limits, more),
        )

    def c_step(self, code: Code, inside: str, horizon: int) -> str:
        """Add what the method sees of a sample around its step, which is given, to code in C."""
        if not self._rows:
            return inside
        code.kernel("paid")
        p, more = self.controlled, len(self._rows)
        paid = code.constant("Paid", p=p, more=more, horizon=horizon, measured=code.sizes(self._rows))
        memory = code.memory(np.zeros((2 + horizon) * (p + more)))
        return code.step(
            f"const Sample inside = with_paid(&{paid}, sample, {memory});\n"
            f"{inside}(memory, &inside, u, told);"
        )

    def _leave_out_what_stood_still(self, loop: Loop) -> None:
        """Leave disturbances out that never moved in the recording."""
        recording = loop.recording
        if recording is None or not loop.disturbances or recording.d.shape[1] != len(loop.disturbances):
            return
        still = stands_still(recording.d)
        self._kept = np.flatnonzero(~still).tolist()
        for i in np.flatnonzero(still).tolist():
            variable = loop.disturbances[i]
            value = f"{recording.d[0, i]:g} {variable.unit}".rstrip()
            self.warnings.append(
                f"{variable.name} never moved in the recording (it was {value}), so its effect is not in the "
                "data and is left out: let it move in the experiment "
                f"(recording.disturbances.{variable.name})"
            )

    def _seen(self, loop: Loop) -> Loop:
        bounds, endless = loop.bounds, np.full(len(self._rows), np.inf)
        return replace(
            loop,
            outputs=(*loop.outputs, *self.paid),
            bounds=Bounds(
                bounds.u_min,
                bounds.u_max,
                np.append(bounds.y_min, -endless),
                np.append(bounds.y_max, endless),
            ),
            disturbances=tuple(loop.disturbances[i] for i in self._kept),
            recording=self.of_recording(loop.recording),
            past=self.of_recording(loop.past),
        )

    def of_recording(self, recording: Recording | None) -> Recording | None:
        """Return what the method sees of a recording."""
        if self._trivial or recording is None:
            return recording
        return replace(
            recording,
            y=np.hstack([recording.y, recording.measured[:, self._rows]]),
            d=recording.d[:, self._kept],
        )


def _padded(pairs: FloatArray, more: int) -> FloatArray:
    """Return lower and upper values, shape (..., p, 2), with so many signals more that have none."""
    shape = (*pairs.shape[:-2], more, 2)
    return np.concatenate([pairs, np.broadcast_to([-np.inf, np.inf], shape)], axis=-2)


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
    _follows_in_c: ClassVar[bool] = True

    _judgement = Judgement()
    _scales_ahead: ClassVar[ScaleAhead] = "there"

    def start(self, loop: Loop) -> None:
        """Start the method on the loop in scaled signals.

        Raises
        ------
        DataError
            The recording cannot serve.
        ConfigError
            A setting does not fit the loop, or a nominal value cannot be a scale.
        """
        self._see(loop)
        self._start_scaled()

    def _again(self, loop: Loop) -> Loop:
        """Return the scaled loop that the method was started in, with another past."""
        past = self._scales.of_recording(self._method_loop.of_recording(loop.past))
        return replace(self._scales.loop, past=past)

    def _see(self, loop: Loop) -> Loop:
        """Return the loop that the method sees, in the units of the plant; set its scales."""
        foresight = self if isinstance(self, Foresight) else None
        self._method_loop = Predicted(loop, foresight, self.uses_recording)
        self._scales = Scales(self._method_loop.loop, self.scaling, self._scales_ahead)
        return self._method_loop.loop

    def _start_scaled(self) -> None:
        """Start the method; where a setting does not fit, signals of another size may be the cause."""
        try:
            self._start(self._scales.loop)
        except ConfigError as error:
            if misfits := self._scales.misfits():
                raise ConfigError([*error.faults, *misfits]) from error
            raise

    def prediction_errors(self, recording: Recording) -> FloatArray | None:
        """Return the errors on the recording's last quarter of a predictor fitted to the rest."""
        if not self.uses_recording:
            return None
        self.start(_without_limits(recording))
        return self._judgement.errors

    def warnings(self) -> Sequence[str]:
        """Return what speaks against the recording: its signals' size, dead time, a poor prediction."""
        return [*self._scales.misfits(), *self._method_loop.warnings, *self._judgement.warnings]

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs that the method finds, in their units."""
        return self._scales.step(self._step, self._method_loop.sample(sample))

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the method, in scaled signals."""
        ahead = code.ahead
        with code.seeing(ahead and ahead.through(self._method_loop.sample)):
            inside = self._scales.c_step(code, self._c_step, self.horizon)
        return self._method_loop.c_step(code, inside, self.horizon)

    def _facts(self, plant: str, *signals: Sequence[Variable]) -> dict[str, str]:
        """Return the facts of :meth:`knowledge` as :func:`prior_info`, with forecasts and prices it uses."""
        seen = self._method_loop
        facts = prior_info(plant, *signals, seen.paid)
        if isinstance(self, Foresight):
            if seen.loop.disturbances:
                names = ", ".join(variable.name for variable in seen.loop.disturbances)
                facts["forecast"] = names if self.use_forecast is True else "measured only"
            if seen.loop.charges and self.price_weight:
                facts["prices"] = ", ".join(charge.name for charge in seen.loop.charges)
        return facts

    def _c_step(self, code: Code, loop: Loop) -> str:
        """Add the method to the code, for a loop in scaled signals; return its step function."""
        return super().c_step(code, loop)

    @abstractmethod
    def _start(self, loop: Loop) -> None:
        """Start on a loop in scaled signals."""

    @abstractmethod
    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return scaled inputs for a sample of scaled signals."""


def _without_limits(recording: Recording) -> Loop:
    """Return a loop to learn from a recording in: its signals have no limits, their size is as recorded."""

    def variables(kind: str, values: FloatArray) -> tuple[Variable, ...]:
        sizes = np.where(stands_still(values), 1.0, values.std(axis=0)).tolist()
        return tuple(Variable(f"{kind}{i}", nominal=size) for i, size in enumerate(sizes))

    unlimited = [np.full(signals.shape[1], np.inf) for signals in (recording.u, recording.y)]
    return Loop(
        sampling_time=recording.sampling_time,
        inputs=variables("u", recording.u),
        outputs=variables("y", recording.y),
        measurements=variables("x", recording.measured),
        bounds=Bounds(-unlimited[0], unlimited[0], -unlimited[1], unlimited[1]),
        recording=recording,
        rng=np.random.default_rng(0),
        disturbances=variables("d", recording.d),
    )


@dataclass(kw_only=True)
class Scaled(SingleWrapper):
    """A controller in scaled signals. The origin stays where it is: linear methods stay linear.

    For controllers whose gains are in the units of the plant (PID), and for those of others; the methods that
    weigh errors scale them by their own ``scaling``.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

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
        self._scales = Scales(loop, self.scale_by, "all")
        self._start_inside(self._scales.loop)

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the controller's inputs in their own units."""
        return self._scales.step(self._inner.step, sample)

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the controller, in scaled signals."""
        inside = self._inner.controller
        return self._scales.c_step(code, partial(inner_step, inside), inside.horizon)
