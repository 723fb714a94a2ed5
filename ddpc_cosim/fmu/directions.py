"""Derivatives that an FMU tells itself, one direction after the other.

``fmi2GetDirectionalDerivative`` (FMI 2.0, section 2.1.9) and ``fmi3GetDirectionalDerivative`` (FMI 3.0,
section 2.2.11).
"""

from collections.abc import Iterable, Sequence
from ctypes import c_double
from itertools import product

import numpy as np

from ddpc_cosim.fmu.instance import Model, reference_array
from ddpc_cosim.fmu.model_description import FMUDescription, Signal, element
from ddpc_cosim.fmu.ports import Shapes, layout
from ddpc_cosim.variables import FloatArray


def scalars(description: FMUDescription, names: Iterable[str], shapes: Shapes) -> list[Signal]:
    """Return the numbers that variables consist of, arrays element by element."""
    found = []
    for name in names:
        variable = description.variables[name]
        sizes = shapes.get(name, variable.shape)
        found += [element(variable, indices) for indices in product(*(range(1, size + 1) for size in sizes))]
    return found


def directional_derivatives(
    model: Model, unknowns: Sequence[Signal], knowns: Sequence[Signal], shapes: Shapes
) -> FloatArray:
    """Return the derivatives of unknowns by knowns, shape (unknowns, knowns).

    Raises
    ------
    CallError
        The FMU does not tell one.
    """
    rows = layout(unknowns, shapes)
    references, sensitivity = reference_array(rows.references), (c_double * rows.size)()
    matrix = np.empty((len(unknowns), len(knowns)))
    for column, known in enumerate(knowns):
        direction = layout([known], shapes)
        seed = (c_double * direction.size)()
        seed[direction.elements[0]] = 1.0
        model.get_directional_derivative(references, reference_array(direction.references), seed, sensitivity)
        matrix[:, column] = np.array(sensitivity)[rows.elements]
    return matrix
