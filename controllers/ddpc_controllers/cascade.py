"""A cascade: an inner controller stabilises the plant, an outer one gives it its reference.

S. Liu, Z. Hou and J. Zheng, Attitude adjustment of quadrotor aircraft platform via a data-driven model free
adaptive control cascaded with intelligent PID, Chinese Control and Decision Conference, 2016, pages
4971-4976, reference [18] of the paper: data models in the compact and the partial form are for stable plants
(section III), and what an i-PID controller has stabilised is one.
"""

from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, ClassVar

import numpy as np

from ddpc_controllers.data.hankel import resting_input
from ddpc_controllers.export.code import Code, inner_step
from ddpc_controllers.ipid import IPID
from ddpc_controllers.mfac import MFAPC
from ddpc_controllers.wrapper import Inner, Wrapper, controller_faults, joined, joined_prior_info
from ddpc_cosim import Action, Bounds, ConfigError, Controller, FloatArray, Loop, Sample, setting

_UNKNOWN_INSIDE, _UNKNOWN_OUTSIDE = (
    {name: Sample._field_defaults[name] for name in names}
    for names in (("band_now", "band", "output_limits"), ("price", "input_limits", "output_limits"))
)


@dataclass(kw_only=True)
class Cascade(Wrapper):
    """An inner and an outer controller; by default i-PID and MFAPC, as in [18].

    The inner controller drives the plant's inputs. It controls the controlled outputs, or other measurements
    named in ``inner_outputs``; their references are the inputs of the outer controller, for which plant and
    inner loop are one plant, and have the limits of the outputs they are for. They begin where the first
    sample finds these outputs, so that a plant at rest is left alone. The outer controller takes one sample
    for ``outer_period`` of the inner one, which does not know its references ahead. Bands are the outer
    one's, input limits that move and prices the inner one's; both are told of known disturbances. Neither may
    learn from a recording, because there is none of the inner loop; an inner one may take over where the
    recording ended.

    A status of either is passed on with its name.
    """

    _known_in_c: ClassVar[Collection[str]] = ()

    inner: Controller = setting(default_factory=IPID, doc="the controller that drives the plant")
    outer: Controller = setting(default_factory=MFAPC, doc="the controller that sets its reference")
    inner_outputs: Sequence[str] = setting(
        (), doc="measurements that the inner loop controls; empty: the controlled outputs"
    )
    outer_period: int = setting(1, low=1, doc="samples of the inner loop for one of the outer")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.horizon = self.outer.horizon * self.outer_period

    def start(self, loop: Loop) -> None:
        """Start both controllers, each with a loop of its own.

        Raises
        ------
        ConfigError
            ``inner_outputs`` are not among the measurements, or a controller refuses its loop.
        """
        self._chosen = self._choose(loop)
        inner = self._inner_loop(loop)
        self._inner, self._outer = Inner(self.inner, "inner"), Inner(self.outer, "outer")
        self._running = (self._inner, self._outer)
        self._inner.start(replace(inner, preview=0))
        bounds = Bounds(inner.bounds.y_min, inner.bounds.y_max, loop.bounds.y_min, loop.bounds.y_max)
        self._outer_loop = replace(
            loop,
            sampling_time=loop.sampling_time * self.outer_period,
            inputs=inner.outputs,
            bounds=bounds,
            recording=None,
            preview=loop.preview // self.outer_period,
            continues_recording=False,
            moving_limits=(),
            charges=(),
            past=None,
        )
        self._begun = False
        self._start_outer()  # refused here, not at the first sample

    def step(self, sample: Sample) -> Action:
        """Return what the inner controller does about the outer one's latest reference."""
        actions = []
        y = sample.y if self._chosen is None else sample.measured[self._chosen]
        if not self._begun:
            self._begin_at(y)
        if sample.k % self.outer_period == 0:
            # What is known of the outer loop's future is what is known of the whole one's.
            later = sample.reference[self.outer_period - 1 :: self.outer_period]
            slow = sample._replace(
                k=sample.k // self.outer_period,
                reference=later,
                forecast=sample.forecast[self.outer_period - 1 :: self.outer_period],
                band=sample.band[self.outer_period - 1 :: self.outer_period],
                **_UNKNOWN_OUTSIDE,
            )
            actions.append(self._outer.step(slow))
            self._target = actions[0].u
        held = np.tile(self._target, (self.inner.horizon, 1))
        within = sample._replace(y=y, reference=held, setpoint=self._target.copy(), **self._ahead(sample))
        actions.append(self._inner.step(within))
        return joined(actions[-1].u, actions)

    def _ahead(self, sample: Sample) -> dict[str, Any]:
        """Return what the inner controller knows ahead; beyond that the last of it lasts."""
        rows = {"forecast": self.inner.horizon, "price": self.inner.horizon + 1}
        rows["input_limits"] = self.inner.horizon + 1
        known = {name: getattr(sample, name) for name in rows}
        return _UNKNOWN_INSIDE | {
            name: values[np.minimum(np.arange(rows[name]), len(values) - 1)]
            for name, values in known.items()
            if values.size
        }

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add both controllers.

        Raises
        ------
        ConfigError
            One of them cannot be exported.
        """
        code.kernel("parts")
        first = code.remembered
        outer = inner_step(self._outer.controller, code, self._outer_loop)
        inner = inner_step(self._inner.controller, code, self._inner_loop(loop))
        p, targets = len(loop.outputs), len(self._outer_loop.inputs)
        horizons = self.outer.horizon, self.inner.horizon
        slopes = self._slopes_of_start()
        cells = np.flatnonzero(slopes.any(axis=1)).tolist()
        bounds = self._outer_loop.bounds
        cascade = code.constant(
            "Cascade",
            p=p,
            period=self.outer_period,
            horizon=horizons[0],
            targets=targets,
            inner_horizon=horizons[1],
            chosen="NULL" if self._chosen is None else code.sizes(self._chosen),
            cells=len(cells),
            places=code.sizes([first + cell for cell in cells]),
            slopes=code.doubles(slopes[cells]),
            low=code.doubles(bounds.u_min),
            high=code.doubles(bounds.u_max),
            rest=code.doubles(resting_input(self._outer_loop)),
        )
        target = code.memory(np.zeros(targets))
        of_a_step = (np.zeros(size) for size in (targets, horizons[0] * p, horizons[1] * targets))
        return code.step(
            f"{code.held('CascadeMemory', [-1.0], target, *of_a_step)}"
            f"if (take_sample(&{cascade}, &held, sample, memory)) {{\n"
            f"    const Sample later = outer_sample(&{cascade}, &held, sample);\n"
            f"    {outer}(memory, &later, {target}, told);\n"
            "}\n"
            f"const Sample inside = inner_sample(&{cascade}, &held, sample);\n"
            f"{inner}(memory, &inside, u, told);"
        )

    def _slopes_of_start(self) -> FloatArray:
        """Return how what the outer controller remembers at its start changes with its resting inputs.

        Found by starting it: shape (numbers, inputs).

        Raises
        ------
        ConfigError
            It does not change linearly, or not in what it remembers alone.
        """
        loop, bounds = self._outer_loop, self._outer_loop.bounds
        rest = resting_input(loop)
        upwards = bounds.u_max - rest >= rest - bounds.u_min
        room = np.where(upwards, bounds.u_max - rest, bounds.u_min - rest)
        steps = np.where(np.isfinite(room), room, 1.0)

        def started(moved: FloatArray) -> tuple[list[str], FloatArray]:
            starts = (rest + moved).tolist()
            inputs = tuple(replace(v, start=start) for v, start in zip(loop.inputs, starts, strict=True))
            outer, code = Inner(self.outer), Code()
            outer.start(replace(loop, inputs=inputs, rng=deepcopy(loop.rng)))
            inner_step(outer.controller, code, loop)
            return code.texts(), code.start

        constants, start = started(np.zeros(len(rest)))
        slopes = np.zeros((len(start), len(rest)))
        for j in np.flatnonzero(steps):
            moved = started(steps * np.eye(len(rest))[j])[1]
            np.subtract(moved, start, out=slopes[:, j], where=moved != start)  # a limit can be infinite
            slopes[:, j] /= steps[j]
        others, halfway = started(steps / 2.0)
        if others != constants or not np.allclose(halfway, start + slopes @ steps / 2.0, 1e-12, 1e-12):
            raise ConfigError(
                f"Cascade: {type(self.outer).__name__} cannot be exported as the outer controller: where its "
                "inputs begin, known at the first sample only, changes its law, or its memory not linearly; "
                "PID and MFAPC can be"
            )
        return slopes

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        inner = self._inner.controller.knowledge(self._inner_loop(loop))
        outer = self._outer.controller.knowledge(self._outer_loop)
        return joined_prior_info({"inner": inner, "outer": outer})

    @property
    def _held(self) -> Sequence[Controller]:
        return self.inner, self.outer

    def _begin_at(self, y: FloatArray) -> None:
        """Let the outer controller's inputs begin where the inner outputs are, if these are known."""
        self._begun = True
        inputs = tuple(
            replace(variable, start=value) if isfinite(value) else variable
            for variable, value in zip(self._outer_loop.inputs, y.tolist(), strict=True)
        )
        if inputs != self._outer_loop.inputs:
            self._outer_loop = replace(self._outer_loop, inputs=inputs)
            self._start_outer()

    def _start_outer(self) -> None:
        # A copy of the stream: a second start draws the same numbers.
        self._outer.start(replace(self._outer_loop, rng=deepcopy(self._outer_loop.rng)))

    def _choose(self, loop: Loop) -> list[int] | None:
        """Return where the inner outputs stand among the measurements; None for the controlled outputs."""
        if not self.inner_outputs:
            return None
        known = [variable.name for variable in loop.measurements]
        unknown = [name for name in self.inner_outputs if name not in known]
        if unknown:
            raise ConfigError(
                [
                    f'Cascade: inner_outputs: no measurement "{name}"; there are {", ".join(known)}'
                    for name in unknown
                ]
            )
        return [known.index(name) for name in self.inner_outputs]

    def _inner_loop(self, loop: Loop) -> Loop:
        chosen, inputs = self._chosen, {variable.name for variable in loop.inputs}
        moving = tuple(name for name in loop.moving_limits if name in inputs)
        loop = replace(loop, bands=(), moving_limits=moving)
        if chosen is None:
            return loop
        outputs = tuple(loop.measurements[i] for i in chosen)
        low, high = np.array([(v.min, v.max) for v in outputs]).T
        recording, past = (
            rows and replace(rows, y=rows.measured[:, chosen]) for rows in (loop.recording, loop.past)
        )
        bounds = Bounds(loop.bounds.u_min, loop.bounds.u_max, low, high)
        return replace(loop, outputs=outputs, bounds=bounds, recording=recording, past=past)

    def _faults_between_settings(self) -> list[str]:
        faults = controller_faults("Cascade", inner=self.inner, outer=self.outer)
        return faults or [
            f"Cascade: {name}: {type(controller).__name__} learns from a recording of its own"
            for name, controller in (("inner", self.inner), ("outer", self.outer))
            if controller.uses_recording
        ]
