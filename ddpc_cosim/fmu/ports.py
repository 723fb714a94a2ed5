"""Preallocated buffers through which the numbers of an FMU are written and read, seen by C and by NumPy."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.calls import WARNING, failed_call
from ddpc_cosim.fmu.instance import Instance, ValueType, reference_array
from ddpc_cosim.fmu.model_description import REAL_TYPES, Signal, flat_index
from ddpc_cosim.variables import FloatArray

Shapes = Mapping[str, tuple[int, ...]]
"""The sizes of array variables by name, where structural parameters have changed them."""


@dataclass(frozen=True, slots=True)
class Block:
    """All variables of one FMI type in a port: one call moves them.

    Parameters
    ----------
    get, set : callable
        The calls, with all arguments bound; they return an FMI status.
    names : ValueType
        The names of the calls.
    values : array
        The memory that C sees.
    positions, elements : array of int
        The port's entries ``positions`` are the memory's elements ``elements``.
    fmi_type : str
        The variables' type.
    negated : array of bool, optional
        Which of the port's entries are the opposite of what is in memory (FMI 1.0).
    """

    get: Callable[[], int]
    set: Callable[[], int]
    names: ValueType
    values: NDArray[Any]
    positions: NDArray[np.intp]
    elements: NDArray[np.intp]
    fmi_type: str
    negated: NDArray[np.bool_] | None = None

    def write(self) -> None:
        """Pass the memory to the FMU."""
        status = self.set()
        if status > WARNING:
            raise failed_call(self.names.set, status)

    def read(self) -> None:
        """Let the FMU fill the memory."""
        status = self.get()
        if status > WARNING:
            raise failed_call(self.names.get, status)

    def accept(self, u: FloatArray) -> None:
        """Convert the port's numbers to the block's type: integers are rounded, booleans are u >= 0.5."""
        chosen = self._with_signs(u[self.positions])
        if self.fmi_type == "Boolean":
            self.values[self.elements] = chosen >= 0.5
        elif self.fmi_type in REAL_TYPES:
            self.values[self.elements] = chosen
        else:
            self.values[self.elements] = np.rint(chosen)

    def numbers(self) -> NDArray[Any]:
        """Return the port's entries in the memory."""
        return self._with_signs(self.values[self.elements])

    def _with_signs(self, numbers: NDArray[Any]) -> NDArray[Any]:
        if self.negated is None:
            return numbers
        opposite = 1 - numbers if self.fmi_type == "Boolean" else -numbers
        return np.where(self.negated, opposite, numbers)


class Port:
    """A vector of numbers that are moved together.

    Parameters
    ----------
    instance : Instance
        The FMU.
    signals : sequence of Signal
        The numbers, in the vector's order.
    shapes : mapping of str to tuple of int
        Sizes of arrays that differ from the description's.
    """

    def __init__(self, instance: Instance, signals: Sequence[Signal], shapes: Shapes) -> None:
        self._length = len(signals)
        by_type: dict[str, list[int]] = {}
        for i, signal in enumerate(signals):
            by_type.setdefault(signal.source.type, []).append(i)
        self._blocks = [
            _block(instance, name, [signals[i] for i in positions], positions, shapes)
            for name, positions in by_type.items()
        ]
        self.plain = self._plain()
        """The only call that moves the vector, if its memory is the vector: nothing has to be sorted."""

    def _plain(self) -> Block | None:
        if len(self._blocks) != 1:
            return None
        block = self._blocks[0]
        in_order = np.array_equal(block.elements, np.arange(len(block.values)))
        is_plain = in_order and block.negated is None and block.values.dtype == np.float64
        return block if is_plain else None

    def write(self, u: FloatArray) -> None:
        """Write the numbers u, shape (n,)."""
        vector = np.asarray(u, dtype=np.float64)
        for block in self._blocks:
            block.accept(vector)
            block.write()

    def read(self) -> FloatArray:
        """Read the numbers into a new array, shape (n,)."""
        y = np.empty(self._length)
        for block in self._blocks:
            block.read()
            y[block.positions] = block.numbers()
        return y

    def fetch(self) -> None:
        """Read what the FMU has, so that elements of arrays that are not written keep their values."""
        for block in self._blocks:
            if len(block.elements) < len(block.values):
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


def layout(signals: Sequence[Signal], shapes: Shapes) -> Layout:
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


def _block(
    instance: Instance, fmi_type: str, signals: Sequence[Signal], positions: list[int], shapes: Shapes
) -> Block:
    value_type = instance.types[fmi_type]
    references, size, elements = layout(signals, shapes)
    memory = (value_type.c_type * size)()
    arguments = (
        instance.component,
        *instance.value_arguments(reference_array(references), size, memory),
    )
    return Block(
        get=partial(instance.function(value_type.get), *arguments),
        set=partial(instance.function(value_type.set), *arguments),
        names=value_type,
        values=np.ctypeslib.as_array(memory),
        positions=np.array(positions, dtype=np.intp),
        elements=np.array(elements, dtype=np.intp),
        fmi_type=fmi_type,
        negated=negated if (negated := np.array([s.source.negated for s in signals])).any() else None,
    )


def _place(signal: Signal, shapes: Shapes) -> int:
    shape = shapes.get(signal.source.name, signal.source.shape)
    if any(index > size for index, size in zip(signal.indices, shape, strict=True)):
        raise ConfigError(
            f"{signal.variable.name} is outside the array {signal.source.name} of size {list(shape)}"
        )
    return flat_index(signal.indices, shape)
