"""Plants given by state-space matrices, x' = A x + B u, y = C x + D u, and such matrices of any plant."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray

from fmu_plants.equations import resolve
from fmu_plants.model import (
    TIME,
    Equations,
    ModelError,
    PlantModel,
    Symbols,
    Variable,
    derivative_name,
    identifier,
)

_MATRICES = ("A", "B", "C", "D")


class StateSpaceMatrices(Protocol):
    """What is used of a `control.StateSpace`; anything with these matrices will do."""

    A: Any
    B: Any
    C: Any
    D: Any


def state_space_model(
    system: StateSpaceMatrices,
    name: str,
    *,
    inputs: Sequence[Variable] | None = None,
    outputs: Sequence[Variable] | None = None,
    states: Sequence[Variable] | None = None,
    description: str = "Linear state-space model",
    source: str = "",
    step_size: float = 0.1,
    stop_time: float = 10.0,
) -> PlantModel:
    """Return a plant model of a linear system in continuous time.

    Parameters
    ----------
    system : control.StateSpace
        Or anything with matrices A (n, n), B (n, m), C (p, n) and D (p, m). Labels of its signals become
        names: ``u[0]`` becomes ``u_0``.
    name : str
        A C identifier; names the FMU and its library.
    inputs, outputs, states : sequence of Variable, optional
        Names, units, ranges and start values, in the order of the matrices; by default the labels of the
        system, without units.
    description, source, step_size, stop_time
        See `PlantModel`.

    Raises
    ------
    ModelError
        The matrices do not fit each other or the variables, are not finite, or the time is discrete.
    """
    a, b, c, d = _matrices(system, name)
    dimensions = {"states": len(a), "inputs": b.shape[1], "outputs": len(c)}
    x = _variables(system, "state", "x", dimensions["states"], states)
    u = _variables(system, "input", "u", dimensions["inputs"], inputs)
    y = _variables(system, "output", "y", dimensions["outputs"], outputs)
    given = {"states": x, "inputs": u, "outputs": y}
    errors = [
        f"{len(given[what])} {what} are given, the matrices have {number}"
        for what, number in dimensions.items()
        if len(given[what]) != number
    ]
    if errors:
        raise ModelError.listing(name, errors)
    if states is None:
        x = _apart_from(x, {variable.name for variable in (*u, *y)})

    def equations(v: Symbols) -> Equations:
        return Equations(
            {state.name: _row(v, a[i], x) + _row(v, b[i], u) for i, state in enumerate(x)},
            {output.name: _row(v, c[i], x) + _row(v, d[i], u) for i, output in enumerate(y)},
        )

    return PlantModel(
        name=name,
        description=description,
        source=source,
        states=x,
        inputs=u,
        outputs=y,
        equations=equations,
        step_size=step_size,
        stop_time=stop_time,
    )


def _matrices(system: Any, name: str) -> list[NDArray[np.float64]]:
    missing = [matrix for matrix in _MATRICES if not hasattr(system, matrix)]
    if missing:
        raise ModelError(
            f"{name}: {type(system).__name__} is neither a PlantModel nor a state-space model "
            f"(it has no {', '.join(missing)})"
        )
    # A sampling time of 0 or None is continuous time.
    if getattr(system, "dt", None):
        raise ModelError(f"{name}: the system is in discrete time (dt = {system.dt}); FMUs are continuous")
    a, b, c, d = (np.atleast_2d(np.asarray(getattr(system, matrix), dtype=float)) for matrix in _MATRICES)
    n, (p, m) = a.shape[0] if a.size else 0, d.shape
    expected = {"A": (n, n), "B": (n, m), "C": (p, n)}
    errors = [
        f"{matrix} has the shape {values.shape}, expected {expected[matrix]}"
        for matrix, values in zip(expected, (a, b, c), strict=False)
        if values.size != np.prod(expected[matrix]) or (n and values.shape != expected[matrix])
    ]
    errors += [
        f"{matrix} has elements that are not finite"
        for matrix, values in zip(_MATRICES, (a, b, c, d), strict=True)
        if not np.isfinite(values).all()
    ]
    if errors:
        raise ModelError.listing(name, errors)
    return [a.reshape(n, n), b.reshape(n, m), c.reshape(p, n), d]


def _variables(
    system: Any, kind: str, letter: str, number: int, given: Sequence[Variable] | None
) -> tuple[Variable, ...]:
    if given is not None:
        return tuple(given)
    labels = getattr(system, f"{kind}_labels", None) or [f"{letter}[{i}]" for i in range(number)]
    return tuple(Variable(identifier(label)) for label in labels)


def _apart_from(states: Sequence[Variable], taken: set[str]) -> tuple[Variable, ...]:
    """Rename states that have the name of an input or output, which python-control allows."""
    return tuple(Variable(f"state_{v.name}") if v.name in taken else v for v in states)


def _row(v: Symbols, coefficients: NDArray[np.float64], variables: Sequence[Variable]) -> Any:
    terms = zip(coefficients, variables, strict=True)
    return sum(float(factor) * v[variable.name] for factor, variable in terms if factor)


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
        Inputs, likewise; of a plant with a control of its own those of its FMU: actuators whose overrides are
        not switched on rest at their start values.
    parameters : mapping of str to float, optional
        Values that differ from the model's defaults.
    time : float
        Time of the operating point [s], at which tables are read.

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
    inputs = _values(model, "inputs", model.all_inputs, u)
    point = np.concatenate(
        [
            [time],
            _values(model, "states", model.states, x),
            inputs,
            _parameter_values(model, parameters),
            *(table.at(np.array([time]))[0] for table in model.tables),
            _acting(model, inputs),
        ]
    )
    evaluate, places = _jacobian(model)
    n, m = len(model.states), len(inputs)
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


def _acting(model: PlantModel, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what acts as the actuators: overrides that are switched on, otherwise start values."""
    start = np.array([actuator.start for actuator in model.actuators])
    overrides = inputs[len(model.inputs) :]
    return np.where(overrides[1::2] > 0.5, overrides[::2], start)


@lru_cache(maxsize=32)
def _jacobian(model: PlantModel) -> tuple[Callable[..., list[Any]], list[tuple[int, int]]]:
    """Return a function of all that the equations are functions of, and where its results belong."""
    n = len(model.states)
    columns = {variable.name: index for index, variable in enumerate((*model.states, *model.all_inputs))}
    rows = {derivative_name(state.name): index for index, state in enumerate(model.states)}
    rows |= {output.name: index for index, output in enumerate(model.outputs, n)}
    elements = [element for element in resolve(model).partials() if element.known in columns]
    known = (*model.states, *model.all_inputs, *model.parameters, *model.columns, *model.actuators)
    names = [TIME, *(variable.name for variable in known)]
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
