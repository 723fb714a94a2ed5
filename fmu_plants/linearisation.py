"""Linear models of a plant about an operating point, from the derivatives of its equations."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray

from fmu_plants.errors import ModelError
from fmu_plants.jacobian import partials
from fmu_plants.layout import derivative_name
from fmu_plants.model import PlantModel, Variable
from fmu_plants.symbolic import resolve
from fmu_plants.validation import TIME


class LinearModel(NamedTuple):
    """dx' = A dx + B du, dy = C dx + D du for small deviations from the operating point."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]


def linearise(
    model: PlantModel,
    x: ArrayLike | None = None,
    u: ArrayLike | None = None,
    parameters: Mapping[str, float] | None = None,
    time: float = 0.0,
) -> LinearModel:
    """Return the linear model of a plant about an operating point, which need not be an equilibrium.

    Parameters
    ----------
    model : PlantModel
    x : array, shape (n,), optional
        States in the order and units of the model; the start values by default.
    u : array, shape (m,), optional
        Inputs, likewise.
    parameters : mapping of str to float, optional
        Values that differ from the model's defaults.
    time : float
        Time of the operating point [s].

    Returns
    -------
    LinearModel
        Matrices A (n, n), B (n, m), C (p, n) and D (p, m); a tuple of four.

    Raises
    ------
    ModelError
        A shape or a parameter does not fit the model, or a derivative is not finite there.
    """
    parameters = parameters or {}
    point = np.concatenate(
        [
            [time],
            _values(model, "states", model.states, x),
            _values(model, "inputs", model.inputs, u),
            _parameter_values(model, parameters),
        ]
    )
    evaluate, places = _jacobian(model)
    n, m = len(model.states), len(model.inputs)
    matrix = np.zeros((n + len(model.outputs), n + m))
    states = {state.name: index for index, state in enumerate(model.states)}
    for row, output in enumerate(model.outputs, n):
        if output.name in states:
            matrix[row, states[output.name]] = 1.0
    with np.errstate(all="ignore"):
        for place, value in zip(places, evaluate(*point), strict=True):
            matrix[place] = value
    if not np.isfinite(matrix).all():
        raise ModelError(f"model {model.name!r}: a derivative is not finite at the operating point")
    return LinearModel(matrix[:n, :n], matrix[:n, n:], matrix[n:, :n], matrix[n:, n:])


@lru_cache(maxsize=32)
def _jacobian(model: PlantModel) -> tuple[Callable[..., list[Any]], list[tuple[int, int]]]:
    """Return a function of time, states, inputs and parameters, and where its results belong."""
    n = len(model.states)
    columns = {variable.name: index for index, variable in enumerate((*model.states, *model.inputs))}
    rows = {derivative_name(state.name): index for index, state in enumerate(model.states)}
    rows |= {output.name: index for index, output in enumerate(model.outputs, n)}
    elements = [element for element in partials(model, resolve(model)) if element.known in columns]
    names = [TIME, *(v.name for v in (*model.states, *model.inputs, *model.parameters))]
    symbols = [sympy.Symbol(name, real=True) for name in names]
    # Dummies: a variable may have the name of a Python keyword or of a function.
    arguments = [sympy.Dummy(real=True) for _ in symbols]
    replaced = dict(zip(symbols, arguments, strict=True))
    expressions = [element.expression.xreplace(replaced) for element in elements]
    evaluate = sympy.lambdify(arguments, expressions, modules="numpy", cse=True)
    return evaluate, [(rows[element.unknown], columns[element.known]) for element in elements]


def _values(
    model: PlantModel, what: str, variables: tuple[Variable, ...], given: ArrayLike | None
) -> NDArray[np.float64]:
    if given is None:
        return np.array([variable.start for variable in variables])
    values = np.asarray(given, dtype=float)
    if values.shape != (len(variables),):
        names = ", ".join(variable.name for variable in variables)
        raise ModelError(
            f"model {model.name!r}: {what} must have the shape ({len(variables)},) ({names}), "
            f"not {values.shape}"
        )
    return values


def _parameter_values(model: PlantModel, given: Mapping[str, float]) -> NDArray[np.float64]:
    known = [parameter.name for parameter in model.parameters]
    if unknown := [name for name in given if name not in known]:
        raise ModelError(
            f"model {model.name!r} has no parameters {', '.join(map(repr, unknown))}; "
            f"it has: {', '.join(known) or 'none'}"
        )
    return np.array([given.get(parameter.name, parameter.start) for parameter in model.parameters])
