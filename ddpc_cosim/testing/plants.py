"""What the plant contract demands, as checks of plants of which nothing else is known."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.plain_data import from_bytes, to_bytes
from ddpc_cosim.plant import Plant
from ddpc_cosim.suggestion.design import input_bounds, working_range
from ddpc_cosim.testing.check_results import CheckFailedError, NotApplicableError
from ddpc_cosim.variables import FloatArray, Variable, names

_UNKNOWN = "no such parameter"


@dataclass(frozen=True, slots=True)
class PlantUnderTest:
    """A plant that is checked, and how.

    Parameters
    ----------
    make_plant : callable
        Returns a new plant at every call.
    sampling_time : float
        Communication step size [s].
    steps : int
        Steps of one run.
    tolerance : float
        How far outputs may differ where they need not agree to the last bit, in shares of their span.
    """

    make_plant: Callable[[], Plant]
    sampling_time: float = 0.1
    steps: int = 20
    tolerance: float = 1e-3

    @contextmanager
    def plant(self) -> Iterator[Plant]:
        """Open a plant for one check."""
        plant = self.make_plant()
        try:
            yield plant
        finally:
            plant.close()

    def inputs(self, plant: Plant, seed: int = 0) -> FloatArray:
        """Return random inputs within the plant's ranges, shape (steps, m)."""
        working = working_range(plant.inputs, input_bounds(plant.inputs))
        unit = np.random.default_rng(seed).random((self.steps, len(plant.inputs)))
        u: FloatArray = working.low + (working.high - working.low) * unit
        return u

    def run(self, plant: Plant, inputs: FloatArray) -> FloatArray:
        """Reset the plant and step it; return the outputs, shape (steps + 1, p)."""
        rows = [self.reset(plant)]
        rows += [plant.step(u, self.sampling_time) for u in inputs]
        return np.array(rows)

    def reset(self, plant: Plant, share: float = 1.0) -> FloatArray:
        """Plan steps of a fraction of the sampling time for the plant, and reset it."""
        plant.plan(share * self.sampling_time, self.steps * self.sampling_time)
        return plant.reset()


def declares_its_signals(subject: PlantUnderTest) -> None:
    """Require tuples of variables with names of their own."""
    with subject.plant() as plant:
        for what, variables in (("inputs", plant.inputs), ("outputs", plant.outputs)):
            if not isinstance(variables, tuple) or not all(isinstance(v, Variable) for v in variables):
                raise CheckFailedError(f"{what} is {variables!r}; needed: a tuple of Variable")
            repeated = sorted({name for name in names(variables) if names(variables).count(name) > 1})
            if repeated:
                raise CheckFailedError(f"{what} has several of the name {', '.join(repeated)}")
        if not plant.outputs:
            raise CheckFailedError("outputs is empty: there is nothing to control or to measure")


def returns_arrays_of_the_right_shape(subject: PlantUnderTest) -> None:
    """Require new float64 arrays of shape (p,) from ``reset`` and ``step``."""
    with subject.plant() as plant:
        earlier = [subject.reset(plant)]
        copies: list[FloatArray] = []
        for what, u in zip(("step 1", "step 2"), subject.inputs(plant), strict=False):
            _require_shape("reset" if not copies else what, earlier[-1], len(plant.outputs))
            copies.append(earlier[-1].copy())
            earlier.append(plant.step(u, subject.sampling_time))
        for kept, copy in zip(earlier, copies, strict=False):
            if not np.array_equal(kept, copy, equal_nan=True):
                raise CheckFailedError("step changed an array that it had returned before; return a new one")


def _require_shape(what: str, y: object, outputs: int) -> None:
    if not isinstance(y, np.ndarray) or y.dtype != np.float64 or y.shape != (outputs,):
        returned = f"{type(y).__name__}"
        if isinstance(y, np.ndarray):
            returned = f"an array of {y.dtype}, shape {y.shape}"
        raise CheckFailedError(f"{what} returned {returned}; needed: an array of float64, shape ({outputs},)")


def returns_finite_numbers(subject: PlantUnderTest) -> None:
    """Require finite outputs while the inputs stay in their ranges."""
    with subject.plant() as plant:
        y = subject.run(plant, subject.inputs(plant))
        if not np.isfinite(y).all():
            k, j = (int(index) for index in np.argwhere(~np.isfinite(y))[0])
            raise CheckFailedError(
                f"{plant.outputs[j].name} is {y[k, j]} at t = {k * subject.sampling_time:g} s"
            )


def resets_to_the_same_trajectory(subject: PlantUnderTest) -> None:
    """Require that a run after a reset repeats the first one to the last bit."""
    with subject.plant() as plant:
        inputs = subject.inputs(plant)
        first = subject.run(plant, inputs)
        subject.run(plant, subject.inputs(plant, seed=1))
        _require_equal(plant, first, subject.run(plant, inputs), "after a reset")


def _require_equal(plant: Plant, first: FloatArray, second: FloatArray, when: str) -> None:
    if not np.array_equal(first, second, equal_nan=True):
        differ = ~((first == second) | (np.isnan(first) & np.isnan(second)))
        k, j = (int(index) for index in np.argwhere(differ)[0])
        raise CheckFailedError(
            f"{plant.outputs[j].name} differs {when}: {first[k, j]!r} and {second[k, j]!r} after {k} steps"
        )


def holds_its_inputs(subject: PlantUnderTest) -> None:
    """Require that ``step`` neither changes the inputs that it is given nor looks at them later."""
    with subject.plant() as plant:
        inputs = subject.inputs(plant)
        expected = subject.run(plant, inputs)
        rows = [subject.reset(plant)]
        for u in inputs:
            given = u.copy()
            rows.append(plant.step(given, subject.sampling_time))
            if not np.array_equal(given, u):
                raise CheckFailedError("step changed the array of inputs that it was given")
            given[:] = np.nan
        _require_equal(plant, expected, np.array(rows), "when the caller reuses its array of inputs")


def does_not_depend_on_the_step_size(subject: PlantUnderTest) -> None:
    """Require that one step and two half steps with the same inputs end at the same outputs."""
    with subject.plant() as plant:
        inputs = subject.inputs(plant)
        whole = subject.run(plant, inputs)
        try:
            rows = [subject.reset(plant, share=0.5)]
            for u in inputs:
                plant.step(u, subject.sampling_time / 2)
                rows.append(plant.step(u, subject.sampling_time / 2))
        except ConfigError as error:
            raise NotApplicableError(str(error)) from error
        _require_close(plant, whole, np.array(rows), subject.tolerance, "with half the step size")


def _require_close(plant: Plant, first: FloatArray, second: FloatArray, tolerance: float, when: str) -> None:
    span = np.maximum(np.ptp(first, axis=0), 1e-6 * np.max(np.abs(first), axis=0))
    error = np.max(np.abs(first - second), axis=0)
    wrong = np.flatnonzero(~(error <= tolerance * span + np.finfo(float).tiny))
    if wrong.size:
        j = int(wrong[0])
        raise CheckFailedError(
            f"{plant.outputs[j].name} differs {when}: by {error[j]:.3g}, while it spans {span[j]:.3g}"
        )


def two_instances_are_independent(subject: PlantUnderTest) -> None:
    """Require that what one instance does changes nothing for another."""
    with subject.plant() as plant:
        if _only_one_instance(plant):
            raise NotApplicableError("the FMU allows one instance per process only")
        inputs, others = subject.inputs(plant), subject.inputs(plant, seed=1)
        alone = subject.run(plant, inputs)
        with subject.plant() as other:
            subject.reset(other)
            rows = [subject.reset(plant)]
            for u, u_other in zip(inputs, others, strict=True):
                rows.append(plant.step(u, subject.sampling_time))
                other.step(u_other, subject.sampling_time)
        _require_equal(plant, alone, np.array(rows), "beside another instance")


def _only_one_instance(plant: Plant) -> bool:
    description = getattr(plant, "description", None)  # FMUs have one
    return description is not None and any(i.only_one_instance for i in description.interfaces.values())


def restores_a_saved_state(subject: PlantUnderTest) -> None:
    """Require that a run which goes on from a saved state repeats itself."""
    with subject.plant() as plant:
        if not plant.can_save_state:
            raise NotApplicableError("the plant does not say that its state can be saved")
        before, after = np.array_split(subject.inputs(plant), 2)
        subject.run(plant, before)
        state = plant.save_state()
        first = np.array([plant.step(u, subject.sampling_time) for u in after])
        plant.restore_state(state)
        second = np.array([plant.step(u, subject.sampling_time) for u in after])
        _require_close(plant, first, second, subject.tolerance, "after its state was restored")


def goes_on_from_its_state_as_bytes(subject: PlantUnderTest) -> None:
    """Require that another instance goes on from a state that was saved as bytes as this one does."""
    with subject.plant() as plant:
        if not (plant.can_serialise_state or (plant.can_save_state and plant.state_is_data)):
            raise NotApplicableError("the plant does not say that its state can be saved as bytes")
        if _only_one_instance(plant):
            raise NotApplicableError("the FMU allows one instance per process only")
        before, after = np.array_split(subject.inputs(plant), 2)
        subject.run(plant, before)
        is_plain = not plant.can_serialise_state
        content = to_bytes(plant.save_state()) if is_plain else plant.serialise_state()
        first = np.array([plant.step(u, subject.sampling_time) for u in after])
        with subject.plant() as other:
            subject.reset(other)
            if is_plain:
                other.restore_state(from_bytes(content))
            else:
                other.deserialise_state(content)
            second = np.array([other.step(u, subject.sampling_time) for u in after])
        _require_close(
            plant, first, second, subject.tolerance, "in another instance, from its state as bytes"
        )


def tells_what_depends_on_inputs_at_once(subject: PlantUnderTest) -> None:
    """Require outputs without a step that are those of the last one, and follow the declared inputs only."""
    with subject.plant() as plant:
        if not plant.can_give_outputs:
            raise NotApplicableError("the plant's outputs follow its steps only")
        inputs, others = subject.inputs(plant), subject.inputs(plant, seed=1)
        stepped, now = [subject.reset(plant)], [plant.outputs_at(np.array([v.start for v in plant.inputs]))]
        for u, other in zip(inputs, others, strict=True):
            stepped.append(plant.step(u, subject.sampling_time))
            for i, known in enumerate(plant.inputs):
                beside = u.copy()
                beside[i] = other[i]
                follows = [known.name in plant.dependencies.get(v.name, ()) for v in plant.outputs]
                _require_unchanged(plant, known.name, stepped[-1], plant.outputs_at(beside), follows)
            now.append(plant.outputs_at(u))
        when = "when it is asked for without a step"
        _require_close(plant, np.array(stepped), np.array(now), subject.tolerance, when)


def _require_unchanged(
    plant: Plant, known: str, y: FloatArray, beside: FloatArray, follows: Sequence[bool]
) -> None:
    for output, before, after, may_change in zip(plant.outputs, y, beside, follows, strict=True):
        if not may_change and not np.isclose(after, before, rtol=1e-9, atol=0.0, equal_nan=True):
            raise CheckFailedError(f"{output.name} follows {known} at once, which is not declared")


def refuses_unknown_parameters(subject: PlantUnderTest) -> None:
    """Require a ConfigError for an unknown parameter, before and during a run."""
    with subject.plant() as plant:
        _require_refusal("reset", lambda: plant.reset({_UNKNOWN: 1.0}))
        subject.reset(plant)
        _require_refusal("set_parameters", lambda: plant.set_parameters({_UNKNOWN: 1.0}))


def _require_refusal(what: str, call: Callable[[], object]) -> None:
    try:
        call()
    except ConfigError:
        return
    raise CheckFailedError(f'{what} accepts the parameter "{_UNKNOWN}"; it has to raise ConfigError')


def can_be_closed_twice(subject: PlantUnderTest) -> None:
    """Require that ``close`` may be called again, and on a plant that was never reset."""
    with subject.plant() as plant:
        subject.reset(plant)
        plant.close()
    subject.make_plant().close()


PLANT_CHECKS: Mapping[str, Callable[[PlantUnderTest], None]] = {
    check.__name__.replace("_", " "): check
    for check in (
        declares_its_signals,
        returns_arrays_of_the_right_shape,
        returns_finite_numbers,
        resets_to_the_same_trajectory,
        holds_its_inputs,
        does_not_depend_on_the_step_size,
        two_instances_are_independent,
        restores_a_saved_state,
        goes_on_from_its_state_as_bytes,
        tells_what_depends_on_inputs_at_once,
        refuses_unknown_parameters,
        can_be_closed_twice,
    )
}
