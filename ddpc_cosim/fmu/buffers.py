"""Values of an FMU's variables: moved every step through preallocated buffers, and set at the start of a run.

The memory of a port is seen by C and by NumPy. Start values are checked, and set in the state that the
standard wants: structural parameters in configuration mode, everything else after the instantiation and
before the initialisation (FMI 2.0 section 4.2.4, FMI 3.0 section 2.3.2), tunable parameters and inputs also
during a run. A value that the FMU refuses, or does not take, is an error.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.description import (
    Declarations,
    DescribedVariable,
    PlantSignal,
    Values,
    elements_of,
    flat_index,
)
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.description.variable_types import integer_range
from ddpc_cosim.fmu.instance import Instance, ValueType, reference_array
from ddpc_cosim.fmu.status import SUCCESS, CallError, failed_call
from ddpc_cosim.plant import ParameterValue as Value
from ddpc_cosim.variables import FloatArray
from fmu_plants.spelling import did_you_mean

Shapes = Mapping[str, tuple[int, ...]]
"""The sizes of array variables by name, where structural parameters have changed them."""


class BlockLayout(NamedTuple):
    """How the variables of one FMI type lie in a port: what all instances of an FMU have in common.

    Parameters
    ----------
    type : str
        The name of the type.
    kind : str
        What the variables' values are: real, integer or boolean.
    variables : tuple of str
        The names of the variables, by entry.
    references : ctypes array
        Their value references, each once.
    size : int
        Numbers in the memory that C sees.
    positions, elements : array of int
        The port's entries ``positions`` are the memory's elements ``elements``.
    negated : array of bool or None
        Which of the port's entries are the opposite of what is in memory (FMI 1.0).
    is_in_order : bool
        Whether the memory has the port's entries as they are, if the port has no other block.
    """

    type: str
    kind: Values
    variables: tuple[str, ...]
    references: Any
    size: int
    positions: NDArray[np.intp]
    elements: NDArray[np.intp]
    negated: NDArray[np.bool_] | None
    is_in_order: bool


def block_layouts(signals: Sequence[PlantSignal], shapes: Shapes) -> list[BlockLayout]:
    """Return how signals lie in a port, in their order: a block of each FMI type.

    Raises
    ------
    ConfigError
        A signal is outside its array.
    """
    by_type: dict[str, list[int]] = {}
    for i, signal in enumerate(signals):
        by_type.setdefault(signal.source.type, []).append(i)
    return [
        _block_layout([signals[i] for i in positions], positions, shapes) for positions in by_type.values()
    ]


def _block_layout(signals: Sequence[PlantSignal], positions: list[int], shapes: Shapes) -> BlockLayout:
    """Return the layout of signals of one FMI type."""
    references, size, elements = layout(signals, shapes)
    negated = np.array([signal.source.negated for signal in signals])
    return BlockLayout(
        type=signals[0].source.type,
        kind=signals[0].source.values,
        variables=tuple(signal.variable.name for signal in signals),
        references=reference_array(references),
        size=size,
        positions=np.array(positions, dtype=np.intp),
        elements=np.array(elements, dtype=np.intp),
        negated=negated if negated.any() else None,
        is_in_order=elements == list(range(size)) and not negated.any(),
    )


class Block:
    """All variables of one FMI type in a port of an instance: one call moves them.

    Parameters
    ----------
    instance : Instance
        The FMU.
    layout : BlockLayout
        How they lie in memory.

    Attributes
    ----------
    names : ValueType
        The names of the calls.
    values : array
        The memory that C sees.
    """

    def __init__(self, instance: Instance, layout: BlockLayout) -> None:
        self.layout, self.names = layout, instance.types[layout.type]
        memory = (self.names.c_type * layout.size)()
        self.values: NDArray[Any] = np.asarray(memory)
        arguments = instance.value_arguments(layout.references, layout.size, memory)
        self._get = partial(instance.function(self.names.get), instance.component, *arguments)
        self._set = partial(instance.function(self.names.set), instance.component, *arguments)

    def write(self) -> None:
        """Pass the memory to the FMU."""
        status = self._set()
        if status not in SUCCESS:
            raise failed_call(self.names.set, status)

    def read(self) -> None:
        """Let the FMU fill the memory."""
        status = self._get()
        if status not in SUCCESS:
            raise failed_call(self.names.get, status)

    def accept(self, u: FloatArray) -> None:
        """Convert the port's numbers to the block's type: integers are rounded, booleans are u >= 0.5."""
        chosen = self._with_signs(u[self.layout.positions])
        if self.layout.kind == "boolean":
            self.values[self.layout.elements] = chosen >= 0.5
        elif self.layout.kind == "real":
            self.values[self.layout.elements] = chosen
        else:
            rounded, limits = np.rint(chosen), np.iinfo(self.values.dtype)
            # A float can be the number above the largest one: a power of two.
            fits = (rounded >= limits.min) & (rounded < float(limits.max + 1))
            if not fits.all():  # it would become another number
                wrong = int(np.argmin(fits))
                what = f"{self.layout.variables[wrong]} = {chosen[wrong]:g} is outside what its type can be"
                raise CallError(f"{what}: [{limits.min}, {limits.max}]")
            self.values[self.layout.elements] = rounded

    def numbers(self) -> NDArray[Any]:
        """Return the port's entries in the memory."""
        return self._with_signs(self.values[self.layout.elements])

    def _with_signs(self, numbers: NDArray[Any]) -> NDArray[Any]:
        negated = self.layout.negated
        if negated is None:
            return numbers
        opposite = 1 - numbers if self.layout.kind == "boolean" else -numbers
        return np.where(negated, opposite, numbers)


class Port:
    """A vector of numbers that are moved together.

    Parameters
    ----------
    instance : Instance
        The FMU.
    layouts : sequence of BlockLayout
        How the numbers lie in memory, as :func:`block_layouts` gives it.
    """

    def __init__(self, instance: Instance, layouts: Sequence[BlockLayout]) -> None:
        self._length = sum(len(layout.positions) for layout in layouts)
        self._blocks = [Block(instance, layout) for layout in layouts]
        only = self._blocks[0] if len(self._blocks) == 1 else None
        # The usual FMU has real inputs and outputs: memory and vector are the same, nothing has to be sorted.
        is_vector = only is not None and only.layout.is_in_order and only.values.dtype == np.float64
        self._whole = only if is_vector else None

    def write(self, u: FloatArray) -> None:
        """Write the numbers u, shape (n,)."""
        if self._whole is not None:
            self._whole.values[:] = u
            self._whole.write()
            return
        vector = np.asarray(u, dtype=np.float64)
        for block in self._blocks:
            block.accept(vector)
            block.write()

    def read(self) -> FloatArray:
        """Read the numbers into a new array, shape (n,)."""
        if self._whole is not None:
            self._whole.read()
            return self._whole.values.copy()
        y = np.empty(self._length)
        for block in self._blocks:
            block.read()
            y[block.layout.positions] = block.numbers()
        return y

    def references(self, function: str) -> NDArray[np.uint32] | None:
        """Return the value references of numbers that a getter or setter of this name moves, one each.

        None: it takes more than a call of that, or they lie otherwise.
        """
        block = self._whole
        if block is None or function not in (block.names.get, block.names.set):
            return None
        references = np.frombuffer(block.layout.references, dtype=np.uint32)
        return references if len(references) == block.layout.size else None

    def fetch(self) -> None:
        """Read what the FMU has, so that elements of arrays that are not written keep their values."""
        for block in self._blocks:
            if len(block.layout.elements) < block.layout.size:
                block.read()


class Layout(NamedTuple):
    """How signals lie in the memory that a call of C moves: whole variables, one after the other.

    Parameters
    ----------
    references : list of int
        Value references of the variables, each once.
    size : int
        Numbers in the memory.
    elements : list of int
        Where each signal is.
    """

    references: list[int]
    size: int
    elements: list[int]


def layout(signals: Sequence[PlantSignal], shapes: Shapes) -> Layout:
    """Return how signals lie in memory.

    Raises
    ------
    ConfigError
        A signal is outside its array.
    """
    variables = {signal.source.reference: signal.source for signal in signals}
    offsets, size = {}, 0
    for reference, variable in variables.items():
        offsets[reference] = size
        size += prod(shapes.get(variable.name, variable.shape))
    elements = [offsets[s.source.reference] + _place(s, shapes) for s in signals]
    return Layout(list(variables), size, elements)


def _place(signal: PlantSignal, shapes: Shapes) -> int:
    if not signal.indices:
        return 0
    shape = shapes.get(signal.source.name, signal.source.shape)
    if any(index > size for index, size in zip(signal.indices, shape, strict=True)):
        raise ConfigError(
            f"{signal.variable.name} is outside the array {signal.source.name} of size {list(shape)}"
        )
    return flat_index(signal.indices, shape)


# The coarsest type that values are stored in: Float32.
_SAME = 1e-6


class StartValues:
    """The values that a user gives for variables of an FMU.

    Parameters
    ----------
    description : Declarations
        The FMU, or another plant.
    label : str
        What it is called, for errors.
    values : mapping of str to number or str
        By name; elements of arrays as ``x[2]``.
    driven : sequence of PlantSignal
        The inputs that are driven: they cannot be given.
    tunable_only : bool
        Whether the run has begun.

    Raises
    ------
    ConfigError
        A variable is unknown or its value impossible; all faults at once.
    """

    def __init__(
        self,
        description: Declarations,
        label: str,
        values: Mapping[str, Value],
        driven: Sequence[PlantSignal],
        *,
        tunable_only: bool = False,
    ) -> None:
        self._description = description
        self._driven = {signal.variable.name for signal in driven}
        self._tunable_only = tunable_only
        faults: list[str] = []
        self._values: list[tuple[PlantSignal, Value]] = []
        for name, value in values.items():
            try:
                self._values.append(self._checked(name, value))
            except ValueError as error:
                faults.append(f"{label}: {error}")
        if faults:
            raise ConfigError(faults)
        self.shapes = self._shapes()

    def set_structural(self, instance: Instance) -> None:
        """Set structural parameters, which size arrays, if there are any."""
        structural = self._chosen(lambda variable: variable.is_structural)
        if structural:
            instance.configure()
            self._set(instance, structural)
            instance.complete_configuration()

    def set_before_initialization(self, instance: Instance) -> None:
        """Set everything else."""
        self._set(instance, self._chosen(lambda variable: not variable.is_structural))

    def set_during_run(self, instance: Instance) -> None:
        """Set values that may change during a run."""
        self._set(instance, self._values)

    def check_taken(self, instance: Instance) -> None:
        """Compare what the FMU has after the initialisation with what it was given.

        Raises
        ------
        CallError
            A parameter has another value: the FMU has ignored it.
        """
        for signal, value in self._chosen(lambda v: v.causality in ("parameter", "structuralParameter")):
            initial = self._read(instance, signal)
            if initial is not None and not _same(initial, _number(signal.source, value)):
                name = signal.variable.name
                raise CallError(f"the FMU ignores {name} = {_text(value)}: initialised, it has {initial:g}")

    def _checked(self, name: str, value: Value) -> tuple[PlantSignal, Value]:
        signal, variable = self._description.signal(name), self._description.variables.get(name)
        if signal is None and variable is not None and variable.shape:
            raise ValueError(f'"{name}" is an array; set its elements: {elements_of(variable)}')
        if signal is None:
            known = [v.name for v in self._description.variables.values() if not self._fault(v)]
            raise ValueError(f'no parameter "{name}"; {did_you_mean(name, known)}')
        source = signal.source
        fault = self._fault(source)
        if fault:
            raise ValueError(fault)
        if name in self._driven:
            raise ValueError(f'"{name}" is an input that is driven; its value cannot be given')
        if source.values != "text":
            _check_range(signal, _number(source, value))
        elif not isinstance(value, str):
            raise ValueError(f"parameter {name} = {value!r} must be a text")
        return signal, value

    def _fault(self, variable: DescribedVariable) -> str:
        """Return why a variable cannot be given a value now; empty if it can."""
        if not variable.is_settable:
            why = "it is constant" if variable.variability == "constant" else "the FMU calculates it"
            return f'no parameter "{variable.name}": {why}'
        if self._tunable_only and not (variable.is_tunable or variable.causality == "input"):
            tunable = [v.name for v in self._description.variables.values() if v.is_tunable]
            names = ", ".join(tunable) or "none"
            return f'parameter "{variable.name}" cannot change during a run; tunable: {names}'
        return ""

    def _chosen(self, wanted: Any) -> list[tuple[PlantSignal, Value]]:
        return [(signal, value) for signal, value in self._values if wanted(signal.source)]

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the sizes of the arrays that follow structural parameters given here."""
        sizes = {s.source.name: _number(s.source, v) for s, v in self._values if s.source.is_structural}
        if not sizes:
            return {}
        return {
            variable.name: tuple(
                int(sizes.get(dimension, size)) if isinstance(dimension, str) else dimension
                for dimension, size in zip(variable.dimensions, variable.shape, strict=True)
            )
            for variable in self._description.variables.values()
            if variable.shape
        }

    def _set(self, instance: Instance, values: Iterable[tuple[PlantSignal, Value]]) -> None:
        for signal, value in values:
            try:
                self._set_one(instance, signal, value)
            except CallError as error:
                raise CallError(
                    f"the FMU refuses {signal.variable.name} = {_text(value)}: {error}", error.code
                ) from error

    def _set_one(self, instance: Instance, signal: PlantSignal, value: Value) -> None:
        names, memory, place, arguments = self._cell(instance, signal)
        if len(memory) > 1:  # the other elements keep their values
            instance.call(names.get, *arguments)
        memory[place] = _stored(signal.source, value)
        instance.call(names.set, *arguments)

    def _read(self, instance: Instance, signal: PlantSignal) -> float | None:
        """Return the value that the FMU has; None for a text, and where it does not tell."""
        if signal.source.values == "text":
            return None
        names, memory, place, arguments = self._cell(instance, signal)
        try:
            instance.call(names.get, *arguments)
        except CallError:
            return None
        return _opposite(signal.source, float(memory[place]))

    def _cell(self, instance: Instance, signal: PlantSignal) -> tuple[ValueType, Any, int, tuple[Any, ...]]:
        """Return how a value is moved: the calls, memory for its variable, its place there, and arguments."""
        source, value_type = signal.source, instance.types[signal.source.type]
        size = prod(self.shapes.get(source.name, source.shape))
        memory = (value_type.c_type * size)()
        arguments = instance.value_arguments(reference_array([source.reference]), size, memory)
        return value_type, memory, _place(signal, self.shapes), arguments


def _stored(variable: DescribedVariable, value: Value) -> Any:
    """Return what is put in the memory of C for a value that has been checked."""
    if variable.values == "text":
        return str(value).encode("utf-8")
    number = _opposite(variable, _number(variable, value))
    return number if variable.values == "real" else int(number)


def _opposite(variable: DescribedVariable, number: float) -> float:
    """Return what a number in memory is as a value, and the other way round (FMI 1.0)."""
    if not variable.negated:
        return number
    return 1.0 - number if variable.values == "boolean" else -number


def _number(variable: DescribedVariable, value: Value) -> float:
    """Return a value as a number; values of enumerations by their name too."""
    if not isinstance(value, str):
        try:
            number = float(value)
        except (TypeError, OverflowError):  # it is anything but a number, or one too large
            pass
        else:
            if isinstance(value, int) and variable.values == "integer" and int(number) != value:
                raise ValueError(
                    f"parameter {variable.name} = {value} is not a number of double precision, in which "
                    f"integers are set; the nearest is {int(number)}"
                )
            return number
    elif value in variable.items:
        return float(variable.items[value])
    elif variable.values == "boolean" and value.lower() in ("true", "false"):
        return float(value.lower() == "true")
    allowed = f"; allowed: {', '.join(variable.items)}" if variable.items else ""
    raise ValueError(f"parameter {variable.name} = {value!r} must be a number{allowed}")


def _check_range(signal: PlantSignal, number: float) -> None:
    variable, values = signal.variable, signal.source.values
    if not variable.min <= number <= variable.max or not math.isfinite(number):
        raise ValueError(
            f"parameter {variable.name} = {number:g} is outside [{variable.min:g}, {variable.max:g}]"
        )
    if values == "integer":
        low, high = integer_range(signal.source.type)
        if not low <= number <= high:
            kind = f"what an integer of type {signal.source.type} can be: [{low}, {high}]"
            raise ValueError(f"parameter {variable.name} = {number:g} is outside {kind}")
    if values != "real" and number != round(number):
        kind = "a boolean (0 or 1)" if values == "boolean" else f"an integer ({signal.source.type})"
        raise ValueError(f"parameter {variable.name} = {number:g} must be {kind}")


def _same(read: float, given: float) -> bool:
    return math.isclose(read, given, rel_tol=_SAME, abs_tol=0.0)


def _text(value: Value) -> str:
    return f"{value:g}" if isinstance(value, float) else repr(value)
