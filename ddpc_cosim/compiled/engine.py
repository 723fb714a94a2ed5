"""The compiled engine: the samples of a loop in C, where all that acts in it is known there."""

import ctypes
from collections.abc import Mapping, Sequence
from ctypes import c_double, c_int64, c_void_p
from dataclasses import fields, is_dataclass, replace
from itertools import accumulate
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.compiled.program import NO_CONTROLLER, Program, effect_numbers, program_of
from ddpc_cosim.conditions import HELD, all_conditions
from ddpc_cosim.conditions.condition import Condition
from ddpc_cosim.controller import OK, Controller, ControllerCode, Loop, further_arguments
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.co_simulation import StepInC
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.loop.master import ExcitingController, NeedsPythonError, Run, Stretch
from ddpc_cosim.loop.safe_calls import loadable_controller_code, require_finite, start_controller
from ddpc_cosim.variables import FloatArray, names

_DONE, _PLANT_FAILED = 0, 1
_OLDER = 1 << 31
"""The bit of a status that the loop has besides those of the controller, as loop.h has it."""


class _PlantCalls(ctypes.Structure):
    _fields_ = [
        ("version", c_int64),
        ("set_values", c_void_p),
        ("do_step", c_void_p),
        ("get_values", c_void_p),
        ("instance", c_void_p),
        ("inputs", c_void_p),
        ("outputs", c_void_p),
        ("n_inputs", c_int64),
        ("n_outputs", c_int64),
        ("base_time", c_double),
        ("step_size", c_double),
        ("steps", c_int64),
        ("steps_at_once", c_int64),
    ]


class _Effect(ctypes.Structure):
    _fields_ = [("kind", c_int64), ("signal", c_int64), ("given", c_double), ("memory", c_void_p)]


class _Loop(ctypes.Structure):
    _fields_ = [
        ("plant", _PlantCalls),
        *((name, c_int64) for name in ("begin", "end", "first", "holds_last", "p", "q", "m")),
        *((name, c_void_p) for name in ("outputs", "measured", "others")),
        ("n_others", c_int64),
        *((name, c_void_p) for name in ("driven", "changed")),
        ("n_changed", c_int64),
        ("actuators", c_void_p),
        ("n_actuators", c_int64),
        *((name, c_void_p) for name in ("input_disturbance", "own_inputs", "own")),
        ("n_own", c_int64),
        ("n_sensed", c_int64),
        *((name, c_void_p) for name in ("courses", "output_disturbance", "before_noise")),
        ("n_before_noise", c_int64),
        ("noise", c_void_p),
        ("n_noise", c_int64),
        ("after_noise", c_void_p),
        ("n_after_noise", c_int64),
        ("loses", c_int64),
        *((name, c_void_p) for name in ("commands", "controller", "reference")),
        *((name, c_int64) for name in ("preview", "band")),
        ("further", c_void_p),
        ("n_further", c_int64),
        ("disturbances", c_void_p),
        ("n_disturbances", c_int64),
        *((name, c_void_p) for name in ("lags", "told")),
        ("n_told", c_int64),
        *((name, c_void_p) for name in ("low", "high")),
        ("readings", c_int64),
        ("read", c_void_p),
        ("n_read", c_int64),
        *((name, c_void_p) for name in ("plant_outputs", "last_seen", "scratch")),
        *((name, c_void_p) for name in ("y", "seen", "measurements", "u", "applied")),
        *((name, c_void_p) for name in ("d", "actual", "between", "given", "status")),
    ]


class _Progress(ctypes.Structure):
    _fields_ = [("rows", c_int64), ("steps", c_int64), ("plant_status", c_int64)]


class CompiledEngine:
    """Takes up the runs of cases, of one controller, whose samples can be computed in C.

    A controller that is to be started in the same loop again, and does not look at its random numbers, is as
    it was: nothing of it runs in Python in between.

    Attributes
    ----------
    used : str
        What has computed the samples of the last run: ``"compiled"``, or ``"python: "`` and why.
    experiment : Stretch or None
        As of :class:`ddpc_cosim.loop.master.Engine`.
    """

    used = ""
    experiment: Stretch | None = None

    def __init__(self) -> None:
        self._started: tuple[Controller, Loop] | None = None
        self._code: ControllerCode | None = None

    def start(self, controller: Controller, loop: Loop) -> None:
        """Start a controller, unless it still is as this would make it; errors as its own."""
        if self._started and controller is self._started[0] and _are_same(loop, self._started[1]):
            return
        self._started = self._code = None
        rng = _WatchedGenerator(loop.rng.bit_generator)
        start_controller(controller, replace(loop, rng=rng))
        if not rng.is_used:
            self._started = controller, loop

    def __call__(self, run: Run) -> "CompiledRun | None":
        """Return a run that is ready to be advanced; None: something in it is known in Python only.

        Raises
        ------
        NeedsPythonError
            The controller has no C code, or there is no compiler.
        """
        reason = reason_against(run)
        self.used = f"python: {reason}" if reason else "compiled"
        if reason:
            self._started = None
            return None
        if isinstance(run.controller, ExcitingController):
            return self._experiment(run, run.controller.stabiliser)
        code = self._code or _code_of(run.controller, run.loop)
        if self._started:
            self._code = code
        return CompiledRun(run, code)

    def _experiment(self, run: Run, stabiliser: Controller | None) -> "CompiledRun | None":
        """Return one that records; None: its stabilising controller has no code, which its loop may have."""
        if stabiliser is None:
            return CompiledRun(run, NO_CONTROLLER)
        try:
            code = _code_of(stabiliser, run.loop)
        except NeedsPythonError:
            return None
        return CompiledRun(run, code)


def reason_against(run: Run) -> str:
    """Return what a run has that the compiled loop does not know; empty for nothing."""
    setup, loop = run.setup, run.loop
    if not isinstance(setup.plant, FMUPlant):
        return f"{type(setup.plant).__name__} is a plant in Python"
    known, kinds = effect_numbers(), all_conditions()
    reasons = [name for name in setup.effects if name not in known]
    if run.first or loop.continues_recording or loop.past:
        remembered = [name for name in setup.effects if kinds[name].in_c is not Condition.in_c]
        remembered += ["disturbances that are measured late"] if any(setup.disturbances.lags) else []
        reasons += [f"{name}: C does not know what was before the run" for name in remembered]
    return ", ".join(reasons)


class _WatchedGenerator(np.random.Generator):
    """Random numbers that know whether anybody has looked at them, or has copied them."""

    is_used = False

    def __getattribute__(self, name: str) -> Any:
        if name != "is_used":
            self.is_used = True
        return super().__getattribute__(name)


def _are_same(value: Any, other: Any) -> bool:
    """Whether two loops, or what they consist of, are the same to a controller, random numbers aside."""
    if value is other:
        return True
    if isinstance(value, np.ndarray):
        return isinstance(other, np.ndarray) and np.array_equal(value, other)
    if is_dataclass(value) and type(value) is type(other):
        # From the last one on: a recording, by which loops of a study differ, stands behind what they share.
        names_of = (field.name for field in reversed(fields(value)) if field.name != "rng")
        return all(_are_same(getattr(value, name), getattr(other, name)) for name in names_of)
    return bool(value == other)


class CompiledRun:
    """A run whose samples are computed in C, a stretch of rows after the other.

    Parameters
    ----------
    run : Run
        The run.
    code : ControllerCode
        That of its controller, or what stands in its place where inputs are given.

    Raises
    ------
    NeedsPythonError
        The controller has no C code, or there is no compiler.
    """

    def __init__(self, run: Run, code: ControllerCode) -> None:
        self._run, setup, store, loop = run, run.setup, run.store, run.loop
        rows = len(store.y)
        commands = run.controller.excitation if isinstance(run.controller, ExcitingController) else None
        self._code = code
        try:
            self._program: Program = program_of(self._code)
        except ConfigError as error:
            raise NeedsPythonError(str(error)) from error
        actuators, sensors = setup.actuators.tables(), setup.sensor_tables(rows)
        outputs, measured = setup.places
        controlled = names(setup.outputs)
        others = [i for i, v in enumerate(setup.measurements) if v.name not in controlled]
        self.plant_outputs = np.array(run.y_plant, dtype=np.float64)
        disturbances, n = setup.disturbances, len(setup.disturbances.sensed)
        self._further = _Further(run, rows, is_controlled=code is not NO_CONTROLLER)
        self._status: NDArray[np.uint32] = np.zeros(rows, np.uint32)
        self._keep: list[Any] = []
        ahead = (1 + loop.preview) * len(outputs) + self._further.width
        if "intersample" in store.more:
            store.more["intersample"][:] = np.nan
        limits = run.outlook.limits.table[:rows, : len(setup.inputs)]
        self._loop = _Loop(
            first=run.first,
            p=len(outputs),
            q=len(measured),
            m=len(setup.inputs),
            outputs=self._address(outputs, np.int64),
            measured=self._address(measured, np.int64),
            others=self._address(others, np.int64),
            n_others=len(others),
            driven=self._address(actuators.driven, np.int64),
            changed=self._address(actuators.changed, np.int64),
            n_changed=len(actuators.changed),
            **self._effects("actuators", actuators.effects),
            input_disturbance=self._address(actuators.added),
            own_inputs=self._address(actuators.own),
            own=self._address(actuators.others, np.int64),
            n_own=len(actuators.others),
            n_sensed=n,
            courses=self._address(disturbances.courses) if disturbances.inputs else None,
            output_disturbance=self._address(sensors.added),
            **self._effects("before_noise", sensors.before_noise),
            noise=self._address(sensors.noise),
            n_noise=0 if sensors.noise is None else sensors.noise.shape[1],
            **self._effects("after_noise", sensors.after_noise),
            loses=(2 if sensors.holds else 1) if sensors.loses else 0,
            commands=self._address(commands),
            reference=self._address(run.outlook.wish.reference),
            preview=loop.preview,
            band=self._further.band,
            further=self._address(self._further.table),
            n_further=self._further.width,
            disturbances=self._address(disturbances.places, np.int64),
            n_disturbances=len(disturbances.places),
            lags=self._address(disturbances.lags, np.int64),
            told=self._address(disturbances.told_places, np.int64),
            n_told=len(disturbances.told_places),
            low=self._address(limits[..., 0]),
            high=self._address(limits[..., 1]),
            readings=setup.substeps,
            read=self._address(setup.intersample, np.int64),
            n_read=len(setup.intersample),
            plant_outputs=self._address(self.plant_outputs),
            last_seen=self._address(np.full(n, np.nan)),
            scratch=self._address(np.empty(3 * n + len(setup.plant.inputs) + ahead)),
            y=self._address(store.y),
            seen=self._address(run.seen),
            measurements=self._address(store.measured),
            u=self._address(store.u),
            applied=self._address(store.applied),
            d=self._address(self._further.d) if disturbances.declared else None,
            actual=self._address(self._further.actual),
            between=self._address(store.more.get("intersample")),
            given=self._address(self._further.given),
            status=self._address(self._status, np.uint32),
        )
        if code is not NO_CONTROLLER:
            state = self._program.started(self._code.numbers)
            self._keep.append(state)
            self._loop.controller = ctypes.addressof(state)

    def advance(self, begin: int, end: int, *, hold_last: bool) -> FloatArray:
        """Run rows from ``begin`` up to and without ``end``; return the plant's outputs then.

        Raises
        ------
        NotFiniteError
            An output is not finite; the rows up to there are written.
        NeedsPythonError
            The plant does not make a step: what it says is told by a run in Python.
        """
        plant, store = self._run.setup.plant, self._run.store
        assert isinstance(plant, FMUPlant)
        loop, progress = self._loop, _Progress()
        loop.begin, loop.end, loop.holds_last = begin, end, hold_last

        def run(step: StepInC) -> tuple[int, int]:
            loop.plant = _PlantCalls(
                *step[:5],
                self._address(step.inputs, np.uint32),
                self._address(step.outputs, np.uint32),
                len(step.inputs),
                len(step.outputs),
                *step[7:],
            )
            ended = self._program.run(ctypes.addressof(loop), ctypes.addressof(progress))
            return ended, progress.steps

        ended = plant.in_c(self._run.setup.communication_step, run)
        if ended is None or ended == _PLANT_FAILED:
            raise NeedsPythonError("the plant is not stepped from C")
        self._further.take(begin, progress.rows)
        if isinstance(controller := self._run.controller, ExcitingController):
            controller.fallbacks += int(np.count_nonzero(self._status[begin : progress.rows]))
        store.take(begin, progress.rows, self._status[begin : progress.rows], self._words)
        if ended != _DONE:
            require_finite(self.plant_outputs, plant)
        return self.plant_outputs.copy()

    def _words(self, status: int) -> str:
        """Return the words of a status."""
        known = {**self._code.statuses, _OLDER: HELD}
        return "; ".join(text for bit, text in known.items() if status & bit) or OK

    def _effects(self, name: str, effects: Sequence[Condition]) -> dict[str, int | None]:
        """Return the members of a list of what conditions do to signals."""
        if not effects:
            return {name: None, f"n_{name}": 0}
        numbers = {all_conditions()[name]: number for name, number in effect_numbers().items()}
        listed = []
        for effect in effects:
            given, memory = effect.in_c()
            memory = np.ascontiguousarray(memory, dtype=np.float64)
            self._keep.append(memory)
            for signal in np.flatnonzero(effect.setup.values != effect.neutral).tolist():
                address = memory[signal].ctypes.data if memory.shape[1] else None
                listed.append(_Effect(numbers[type(effect)], signal, given[signal], address))
        table = (_Effect * len(listed))(*listed)
        self._keep.append(table)
        return {name: ctypes.addressof(table), f"n_{name}": len(listed)}

    def _address(self, values: Any, kind: type[Any] = np.float64) -> int | None:
        """Return the address of values, in memory that stays as long as the run; None of none."""
        if values is None or not len(values):
            return None
        table = np.ascontiguousarray(values, dtype=kind)
        self._keep.append(table)
        return table.ctypes.data


class _Further:
    """What a run has besides measurements, references and inputs.

    Parameters
    ----------
    run : Run
        The run.
    rows : int
        K, the number of its samples.
    is_controlled : bool
        Whether a controller looks at this.

    Attributes
    ----------
    table : array, shape (K, width), or None
        What follows the references in ``r`` of a step; NaN where C knows what was measured. None: nothing.
    width : int
        Its columns.
    band : int
        The first of them that is an edge of a band; -1: there is none.
    d : array, shape (K, disturbances)
        Where disturbances go as they are seen at each sample, though they may be told later.
    actual : array, shape (K, sensed), or None
        Where signals go as they are, if they are wanted.
    given : array, shape (K, inputs), or None
        Where all inputs of the plant go, if they are wanted.
    """

    def __init__(self, run: Run, rows: int, *, is_controlled: bool) -> None:
        self._run, self._more, setup = run, run.store.more, run.setup
        self._is_priced = bool(setup.charged.charges)
        wants_signals = self._is_priced or "monitored" in self._more
        self.actual = np.empty((rows, len(setup.disturbances.sensed))) if wants_signals else None
        self.given = np.empty((rows, len(setup.plant.inputs))) if self._is_priced else None
        self.d = np.empty_like(run.d)
        self._issues = dict[int, FloatArray]()
        shapes = further_arguments(run.loop, run.outlook.horizon) if is_controlled else {}
        starts = dict(zip(shapes, accumulate(map(prod, shapes.values()), initial=0), strict=False))
        self.band, self.width = starts.get("band_now", -1), sum(map(prod, shapes.values()))
        self.table = self._over(rows, shapes) if shapes else None

    def _over(self, rows: int, shapes: Mapping[str, tuple[int, ...]]) -> FloatArray:
        """Return the table; what is not measured yet is NaN, in place of which C has what is."""
        outlook, loop, table = self._run.outlook, self._run.loop, np.empty((rows, self.width))
        y, measured, told = (
            np.full(len(signals), np.nan) for signals in (loop.outputs, loop.measurements, loop.disturbances)
        )
        is_kept = "forecast" in self._more
        issues = self._run.setup.disturbances.issues(outlook.horizon, rows) if is_kept else ()
        for k in range(rows):
            sample = outlook.sample(k, 0.0, y, measured, told)
            parts = [getattr(sample, name)[: shape[0]].ravel() for name, shape in shapes.items()]
            table[k] = np.concatenate(parts)
            if k in issues:
                self._issues[k] = sample.forecast.copy()
        return table

    def take(self, begin: int, end: int) -> None:
        """Fill in the further tables of rows that have been run."""
        run, more, rows = self._run, self._more, slice(begin, end)
        setup, outlook = run.setup, run.outlook
        for i, lag in enumerate(setup.disturbances.lags):
            run.d[rows, i] = self.d[np.maximum(np.arange(begin, end) - lag, 0), i]
        if "d" in more:
            more["d"][rows] = told = run.d[rows, setup.disturbances.told_places]
            for k in self._issues.keys() & range(begin, end):
                expected = more["forecast"][k + 1 : k + 1 + len(self._issues[k])]
                foretold = self._issues[k][: len(expected)]
                expected[:] = np.where(np.isnan(foretold), told[k - begin], foretold)
        if self.actual is not None and "monitored" in more:
            more["monitored"][rows] = self.actual[rows, setup.monitored]
        if self.actual is not None and self.given is not None:
            for amounts, outputs, inputs in zip(
                more["charged"][rows], self.actual[rows], self.given[rows], strict=True
            ):
                setup.charged.keep_outputs(amounts, outputs)
                setup.charged.keep_inputs(amounts, inputs, controls_itself=False)
        if outlook.has_bands:
            for k in range(begin, end):
                run.store.reference[k] = outlook.nearest(k, run.store.y[k])


def _code_of(controller: Controller, loop: Loop) -> ControllerCode:
    """Return the code of a started controller.

    Raises
    ------
    NeedsPythonError
        There is none.
    """
    try:
        return loadable_controller_code(controller, loop)
    except ConfigError as error:
        raise NeedsPythonError(str(error)) from error
