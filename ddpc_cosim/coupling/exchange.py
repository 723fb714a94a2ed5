"""What coupled parts exchange, and when: all values, and how they go from one instant to the next.

With linear extrapolation every value has a slope: how fast it changed over the last step of its part. A part
that holds its inputs over a step takes them from that line in the middle of the step, which is exact to
second order: beyond the last value (extrapolation), or, where the part that it comes from has gone ahead,
between two (interpolation).
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ddpc_cosim.coupling.graph import Evaluation, Graph
from ddpc_cosim.coupling.loops import AlgebraicLoop
from ddpc_cosim.coupling.parts import Part
from ddpc_cosim.coupling.wiring import Wiring
from ddpc_cosim.errors import ConfigError, FMUStepError, StepStatus
from ddpc_cosim.loop.safe_calls import announce_call_of_plant, calls_are_watched
from ddpc_cosim.variables import FloatArray


class OutputUpdate(NamedTuple):
    """Parts, and what brings their outputs up to date at a time [s] without a step."""

    parts: tuple[Part, ...]
    do: Callable[[float], None]


class Interval(NamedTuple):
    """What happens in one communication interval: parts that begin a step, parts that end one, updates."""

    due: Sequence[Part]
    ended: Sequence[Part]
    updates: Sequence[OutputUpdate]


class Exchange:
    """The values that parts exchange.

    Parameters
    ----------
    parts : sequence of Part
        The parts in the order in which they are stepped.
    wiring : Wiring
        How inputs follow from values.
    graph : Graph
        What depends on what.
    sequential : bool
        Whether a part has the newest values of those before it (Gauss-Seidel), or those that were there when
        its step began (Jacobi).
    linear : bool
        Whether values are extrapolated.
    loop_tolerance : float
        How exactly algebraic loops are solved.

    Attributes
    ----------
    memory : array
        All that the exchange remembers between two samples.
    values : array
        All values, in the order of the wiring.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        wiring: Wiring,
        graph: Graph,
        *,
        sequential: bool,
        linear: bool,
        loop_tolerance: float,
    ) -> None:
        self._parts, self._sequential, self._linear = parts, sequential, linear
        self._wiring, self._graph, self._loop_tolerance = wiring, graph, loop_tolerance
        self.memory = np.zeros((4, len(wiring.values)))
        self.values, self._slopes, self._stamps, self._before = self.memory
        self._inputs = len(wiring.inputs)
        self._driven = self.values[: self._inputs]
        self._calls = [(p, p.plant.step, p.sources, p.output_slice, p.size, p.is_scaled) for p in parts]
        self._arriving: dict[Part, FloatArray] = {}
        self._schedule: Sequence[Interval] = ()
        self._is_plain, self._is_simple, self._is_watched = True, True, False
        driven, outputs = range(graph.outputs.start), graph.outputs
        self._all = self._updates(range(len(wiring.values)))
        self._all_after_steps = self._updates(outputs)
        fed = {source for part in parts for source in part.sources.tolist()}
        self._after_inputs = self._updates(driven) if fed & graph.reached(driven) else []
        # Their outputs at the end of a step are other ones than those with inputs that were held over it.
        self._estimated = {part for update in self._all_after_steps for part in update.parts}

    def reset(self, time: float) -> None:
        """Forget everything before a time [s]."""
        self.memory[:] = 0.0
        self._stamps[:] = time
        self.values[:] = self._wiring.start

    def schedule(self, intervals: int) -> None:
        """Lay down what happens in so many intervals, after which all parts are at one instant."""
        self._is_watched = calls_are_watched()
        is_multirate = any(part.every > 1 for part in self._parts)
        after_steps = self._all_after_steps if is_multirate else self._needed(self._all_after_steps)
        self._is_plain = not self._linear and all(part.every * part.substeps == 1 for part in self._parts)
        if not is_multirate:
            self._schedule = [Interval(self._parts, self._parts, after_steps)] * intervals
            self._is_simple = self._is_plain and not after_steps
            return
        self._is_simple = False
        schedule = []
        for i in range(intervals):
            due = [part for part in self._parts if i % part.every == 0]
            ended = [part for part in self._parts if (i + 1) % part.every == 0]
            updates = [update for update in after_steps if set(update.parts) <= set(ended)]
            schedule.append(Interval(due, ended, updates))
        self._schedule = schedule

    def refresh(self, time: float, changed: Iterable[Part] = ()) -> None:
        """Bring outputs up to date at a time [s] at which all parts are; all of parts that changed."""
        for part in changed:
            if part.plant.can_give_outputs:
                self._evaluate(part, time)
        for update in self._all:
            update.do(time)

    def set_inputs(self, u: FloatArray, time: float) -> None:
        """Set the system's inputs, shape (m,), at a time [s]; update what depends on them without delay."""
        if not self._after_inputs:
            self.hold(u)
        elif len(u) != self._inputs or (self._driven != u).any():
            self.hold(u)
            for update in self._after_inputs:
                update.do(time)

    def hold(self, u: FloatArray) -> None:
        """Hold the system's inputs u, shape (m,), from now on."""
        if len(u) != self._inputs:
            raise ConfigError(f"u has {len(u)} numbers; needed: {self._inputs}")
        self._driven[:] = u

    @property
    def advance_once(self) -> Callable[[float, float], FMUStepError | None]:
        """The quickest way to :meth:`advance` by one interval."""
        return self._hold if self._is_simple else self.advance

    def advance(self, h: float, time: float) -> FMUStepError | None:
        """Advance by the intervals, of h [s] each, from a time [s] at which all parts are.

        A part may come to its end with the last interval: then the outputs are as the steps left them, and
        what the part says about it is returned.
        """
        if self._is_simple:
            for i in range(len(self._schedule)):
                self._hold(h, time + i * h)
            return None
        for i, interval in enumerate(self._schedule):
            if self._is_plain:
                self._hold(h, time + i * h)
            else:
                self._step(interval, h, time + i * h)
            if not interval.updates:
                continue
            end = time + (i + 1) * h
            try:
                for update in interval.updates:
                    update.do(end)
            except FMUStepError as error:
                if error.status is StepStatus.TERMINATED and i + 1 == len(self._schedule):
                    return error
                raise
            if self._linear:
                self._draw_lines(interval.ended, end, h)
        return None

    def _hold(self, h: float, now: float) -> FMUStepError | None:
        """Step all parts once, with values that are held: most runs are here most of the time."""
        old = new = self.values
        if not self._sequential:
            old = old.copy()
        y: FloatArray | None = None
        is_watched = self._is_watched
        try:
            for part, step, sources, output_slice, size, is_scaled in self._calls:
                y = None
                u = old[sources]
                if is_scaled:
                    u *= part.factor
                    u += part.offset
                if is_watched:
                    announce_call_of_plant(part.in_step, now)
                y = step(u, h)
                if len(y) != size:  # one number would be taken for all
                    raise ValueError
                new[output_slice] = y
        except (Exception, SystemExit) as error:
            raise part.failure("step", error, now, y) from error
        return None

    def _step(self, interval: Interval, h: float, now: float) -> None:
        """Step the parts that are due."""
        values = self.values
        for part in interval.due:
            self._before[part.output_slice] = values[part.output_slice]
            y = self._substeps(part, h, now)
            if self._sequential:
                values[part.output_slice] = y
                self._draw_lines([part], now + part.every * h, h)
            else:
                self._arriving[part] = y
        if not self._sequential:
            for part in interval.ended:
                values[part.output_slice] = self._arriving[part]
            self._draw_lines(interval.ended, now + h, h)

    def _substeps(self, part: Part, h: float, now: float) -> FloatArray:
        """Let a part do its step from a time [s] on; return its outputs at the end."""
        length = part.every * h / part.substeps
        ahead = 0.0 if part.plant.is_sampled else length / 2.0
        for i in range(part.substeps):
            begin = now + i * length
            y = part.step(self._taken(part, begin + ahead), length, begin)
        end = now + part.every * h
        if self._linear and self._sequential and part in self._estimated and not part.plant.is_sampled:
            y = part.outputs_at(self._taken(part, end), end)
        return y

    def _taken(self, part: Part, time: float) -> FloatArray:
        """Return the values that a part takes at a time [s], shape (m,)."""
        if not self._linear:
            return self.values[part.sources]
        return (self.values + self._slopes * (time - self._stamps))[part.sources]

    def _draw_lines(self, parts: Iterable[Part], end: float, h: float) -> None:
        """Note when and how fast the outputs of parts changed in a step that ends at a time [s]."""
        for part in parts:
            rows = part.output_slice
            held = part.plant.is_sampled
            self._slopes[rows] = 0.0 if held else (self.values[rows] - self._before[rows]) / (part.every * h)
            self._stamps[rows] = end

    def _updates(self, changed: Iterable[int]) -> list[OutputUpdate]:
        """Return the updates of everything that depends on some values, where parts can give outputs."""
        by_name = {part.name: part for part in self._parts}

        def update(evaluation: Evaluation) -> OutputUpdate:
            parts = tuple(by_name[name] for name in evaluation.parts)
            if not evaluation.loop:
                return OutputUpdate(parts, lambda time: self._evaluate(parts[0], time))
            loop = AlgebraicLoop(
                parts,
                evaluation.loop,
                self.values,
                self._wiring.scale,
                self._loop_tolerance,
                self._wiring.values,
                self._taken,
            )
            return OutputUpdate(parts, loop.solve)

        updates = map(update, self._graph.evaluations(changed))
        return [update for update in updates if all(part.plant.can_give_outputs for part in update.parts)]

    def _needed(self, updates: Sequence[OutputUpdate]) -> list[OutputUpdate]:
        """Return the updates after a step of all parts that change something.

        Where values are held, and a part takes all that its outputs depend on directly from parts before it,
        it has taken them in the step already.
        """
        if self._linear or not self._sequential:
            return list(updates)
        place = {part.name: i for i, part in enumerate(self._parts)}
        needed: dict[str, None] = {}
        chosen = []
        for update in updates:
            for part in update.parts:
                owners = self._graph.directly_before(part.places)
                if any(owner in needed or place[owner] >= place[part.name] for owner in owners):
                    needed.update((other.name, None) for other in update.parts)
            if any(part.name in needed for part in update.parts):
                chosen.append(update)
        return chosen

    def _evaluate(self, part: Part, time: float) -> None:
        self.values[part.output_slice] = part.outputs_at(self._taken(part, time), time)
