"""Linear models of an FMU for Model Exchange about its operating point.

    dx' = A dx + B du,   dy = C dx + D du

The derivatives are the FMU's own where it has them (``fmi2GetDirectionalDerivative``, FMI 2.0 section 2.1.9;
``fmi3GetDirectionalDerivative``, FMI 3.0 section 2.2.11), else central differences of what it computes around
the point. What discrete states do at later events is in neither.
"""

from collections.abc import Iterable, Sequence
from ctypes import c_double
from dataclasses import dataclass
from itertools import product
from typing import Literal, get_args

import numpy as np

from ddpc_cosim.description import PlantSignal, element
from ddpc_cosim.fmu.buffers import Port, Shapes, block_layouts, layout
from ddpc_cosim.fmu.description import FMUDescription
from ddpc_cosim.fmu.instance import Instance, Model, reference_array
from ddpc_cosim.fmu.status import FATAL, CallError
from ddpc_cosim.variables import FloatArray

Derivatives = Literal["auto", "directional", "differences"]
DERIVATIVES: tuple[str, ...] = get_args(Derivatives)


@dataclass(frozen=True, slots=True)
class LinearModel:
    """A linear model of an FMU about an operating point: dx' = A dx + B du, dy = C dx + D du.

    Parameters
    ----------
    a, b, c, d : array, shapes (n, n), (n, m), (p, n) and (p, m)
        The matrices, in the units of the FMU's variables, and seconds.
    x_0, u_0, y_0 : array, shapes (n,), (m,) and (p,)
        The operating point.
    rate : array, shape (n,)
        Derivatives of the states there [per s]; zero at an equilibrium.
    states : tuple of str
        Names of the states; empty where the FMU does not say.
    derivatives : str
        Where A and B come from: ``"directional"`` derivatives of the FMU, or ``"differences"``.
    warnings : tuple of str
        What the FMU says and does not hold.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    x_0: FloatArray
    u_0: FloatArray
    y_0: FloatArray
    rate: FloatArray
    states: tuple[str, ...]
    derivatives: str
    warnings: tuple[str, ...] = ()


def scalars(description: FMUDescription, names: Iterable[str], shapes: Shapes) -> list[PlantSignal]:
    """Return the numbers that variables consist of, arrays element by element."""
    items = []
    for name in names:
        variable = description.variables[name]
        sizes = shapes.get(name, variable.shape)
        items += [element(variable, indices) for indices in product(*(range(1, size + 1) for size in sizes))]
    return items


def directional_derivatives(
    instance: Instance, unknowns: Sequence[PlantSignal], knowns: Sequence[PlantSignal], shapes: Shapes
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
        instance.get_directional_derivative(
            references, reference_array(direction.references), seed, sensitivity
        )
        matrix[:, column] = np.array(sensitivity)[rows.elements]
    return matrix


# Where rounding and curvature weigh the same in a central difference (W. H. Press et al., Numerical Recipes,
# 3rd ed., section 5.7).
_STEP = float(np.finfo(float).eps) ** (1.0 / 3.0)


class OperatingPoint:
    """The point at which a model is, and what it computes around it.

    Parameters
    ----------
    model : Model
        The instance, in continuous-time mode.
    inputs, outputs : sequence of PlantSignal
        Real numbers to change and to read.
    shapes : mapping of str to tuple of int
        Sizes of arrays that differ from the description's.

    Attributes
    ----------
    x_0, u_0, y_0, rate : array, shapes (n,), (m,), (p,) and (n,)
        States, inputs, outputs and derivatives of the states at the point.
    scale : array, shape (n + m,)
        Typical magnitudes of states and inputs.
    low, high : array, shape (n + m,)
        Limits of states and inputs; infinite for states.
    """

    def __init__(
        self, model: Model, inputs: Sequence[PlantSignal], outputs: Sequence[PlantSignal], shapes: Shapes
    ) -> None:
        self._model, self._n = model, model.sizes()[0]
        self._inputs, self._outputs = (
            Port(model, block_layouts(signals, shapes)) for signals in (inputs, outputs)
        )
        self._memory = (c_double * self._n)()
        model.get_states(self._memory, self._n)
        self.x_0, self.u_0 = np.array(self._memory), self._inputs.read()
        self.rate, self.y_0 = self._rate(), self._outputs.read()
        model.get_nominals(self._memory, self._n)
        typical = np.array([*self._memory, *(signal.variable.nominal for signal in inputs)])
        usable = np.isfinite(typical) & (typical != 0.0)
        self.scale = np.maximum(np.where(usable, np.abs(typical), 1.0), np.abs([*self.x_0, *self.u_0]))
        free = [np.inf] * self._n
        self.low = np.array([*(-x for x in free), *(signal.variable.min for signal in inputs)])
        self.high = np.array([*free, *(signal.variable.max for signal in inputs)])

    def at(self, point: FloatArray) -> FloatArray:
        """Go to states and inputs, shape (n + m,); return rates and outputs there, shape (n + p,)."""
        self._memory[:] = point[: self._n].tolist()
        self._model.set_states(self._memory, self._n)
        self._inputs.write(point[self._n :])
        return np.concatenate([self._rate(), self._outputs.read()])

    def _rate(self) -> FloatArray:
        self._model.get_derivatives(self._memory, self._n)
        return np.array(self._memory)


def central_differences(around: OperatingPoint) -> FloatArray:
    """Return the derivatives of rates and outputs by states and inputs, shape (n + p, n + m).

    The steps follow the nominal values. An input at its limit is changed to one side only.
    """
    here = np.concatenate([around.x_0, around.u_0])
    step = _STEP * around.scale
    below, above = np.maximum(here - step, around.low), np.minimum(here + step, around.high)
    stuck = ~(above > below)
    below, above = np.where(stuck, here - step, below), np.where(stuck, here + step, above)
    columns = []
    for i in range(len(here)):
        points = [here.copy(), here.copy()]
        points[0][i], points[1][i] = below[i], above[i]
        low, high = (around.at(point) for point in points)
        with np.errstate(over="ignore", invalid="ignore"):  # the caller says what is not finite
            columns.append((high - low) / (above[i] - below[i]))
    around.at(here)
    return np.stack(columns, axis=1)


def linearisation_faults(
    description: FMUDescription, inputs: Sequence[PlantSignal], outputs: Sequence[PlantSignal]
) -> list[str]:
    """Return why an FMU cannot be linearised between some inputs and outputs; empty if it can."""
    if "model-exchange" not in description.interfaces:
        return ["the FMU is not for Model Exchange: it does not tell the derivatives of its states"]
    faults = [] if description.continuous_states else ["the FMU has no continuous states"]
    for what, signals in (("input", inputs), ("output", outputs)):
        for signal in signals:
            if signal.source.values != "real":
                faults.append(
                    f'the {what} "{signal.variable.name}" is of type {signal.source.type}, not a real number'
                )
            elif what == "input" and signal.source.variability != "continuous":
                faults.append(f'the input "{signal.variable.name}" is {signal.source.variability}')
    return faults


def has_directional_derivatives(model: Model, description: FMUDescription, shapes: Shapes) -> bool:
    """Whether an FMU has directional derivatives: it says so, its library has them, its states have names."""
    return (
        description.interfaces["model-exchange"].provides_directional_derivatives
        and model.has_directional_derivatives
        and len(scalars(description, description.state_order, shapes)) == model.sizes()[0]
    )


def linearise(
    model: Model,
    inputs: Sequence[PlantSignal],
    outputs: Sequence[PlantSignal],
    shapes: Shapes,
    description: FMUDescription,
    *,
    directional: bool,
) -> LinearModel:
    """Return the linear model about the point at which a model is; it stays there.

    Parameters
    ----------
    model : Model
        The instance, in continuous-time mode.
    inputs, outputs : sequence of PlantSignal
        The real numbers between which it is linearised.
    shapes : mapping of str to tuple of int
        Sizes of arrays that differ from the description's.
    description : FMUDescription
        What the FMU says about itself.
    directional : bool
        Whether the FMU is asked for its directional derivatives; it must have them.

    Raises
    ------
    CallError
        The FMU fails near the point, or a derivative is not finite.
    """
    around = OperatingPoint(model, inputs, outputs, shapes)
    n = len(around.x_0)
    states = scalars(description, description.state_order, shapes)
    names = tuple(state.variable.name for state in states) if len(states) == n else ()
    # The standard knows derivatives of declared outputs; any other variable can be read here as an output.
    declared = [directional and signal.source.causality == "output" for signal in outputs]
    rows = [directional] * n + declared
    matrix = np.empty((len(rows), n + len(inputs)))
    warnings: tuple[str, ...] = ()
    if not all(rows):
        matrix[:] = central_differences(around)
    if directional:
        unknowns = scalars(description, description.derivatives, shapes)
        unknowns += [signal for signal, is_declared in zip(outputs, declared, strict=True) if is_declared]
        matrix[rows] = directional_derivatives(model, unknowns, [*states, *inputs], shapes)
        _place_states(matrix[n:], states, outputs)
        labels = [*(f"der({name})" for name in names), *(signal.variable.name for signal in outputs)]
        is_single = any(signal.source.type == "Float32" for signal in (*states, *inputs, *outputs))
        try:
            wrong = [labels[row] for row in contradicted(around, matrix, is_single)]
        except CallError as error:  # beside the point, where nothing has to be known
            if error.code == FATAL:
                raise
            around.at(np.concatenate([around.x_0, around.u_0]))
            wrong = []
            warnings = (f"the FMU's directional derivatives could not be checked near the point: {error}",)
        if wrong:
            matrix[:], directional = central_differences(around), False
            warnings = (
                f"the FMU's directional derivatives of {', '.join(wrong)} are not those of its values: "
                "differences were taken instead",
            )
    _require_finite(matrix, names or [f"state {i + 1}" for i in range(n)], inputs, outputs)
    return LinearModel(
        a=matrix[:n, :n],
        b=matrix[:n, n:],
        c=matrix[n:, :n],
        d=matrix[n:, n:],
        x_0=around.x_0,
        u_0=around.u_0,
        y_0=around.y_0,
        rate=around.rate,
        states=names,
        derivatives="directional" if directional else "differences",
        warnings=warnings,
    )


def _place_states(rows: FloatArray, states: Sequence[PlantSignal], outputs: Sequence[PlantSignal]) -> None:
    """Write the rows of outputs that are states, by value reference: some FMUs say 0 of them."""
    place = {(state.source.reference, state.indices): i for i, state in enumerate(states)}
    for row, signal in zip(rows, outputs, strict=True):
        column = place.get((signal.source.reference, signal.indices))
        if column is not None and signal.source.values == "real":
            row[:] = 0.0
            row[column] = 1.0


# Large enough for the noise of algebraic loops that the FMU solves, small enough to see a share of 1 in 1000.
_PROBE = 1e-4
# What counts as wrong, in parts of the change, and as noise, in parts of the value; single precision rounds
# values to 6e-8 of them, and so the step itself to 1e-3.
_WRONG, _NOISE = 1e-3, 1e-8
_WRONG_OF_SINGLES, _NOISE_OF_SINGLES = 1e-2, 1e-6


def contradicted(around: OperatingPoint, derivatives: FloatArray, is_single: bool = False) -> list[int]:
    """Return the rows of a matrix of derivatives, shape (n + p, n + m), that a small change contradicts.

    All states and inputs change at once, to either side. The derivative of a curved function is between what
    both sides show, that of a kink may be what one side shows: it is wrong above both, and below both.
    """
    here = np.concatenate([around.x_0, around.u_0])
    # Sizes that do not let two columns cancel each other.
    step = _PROBE * around.scale * np.random.default_rng(0).uniform(0.5, 1.0, len(here))
    low, high = around.low + step, around.high - step
    # An input at its limit is changed about the nearest place that has room on both sides.
    has_room = (low <= high) & (around.low <= here) & (here <= around.high)
    middle = np.where(has_room, here.clip(low, high), here)
    with np.errstate(over="ignore", invalid="ignore"):  # the caller says what is not finite
        start = around.at(middle)
        wrong, noise = (_WRONG_OF_SINGLES, _NOISE_OF_SINGLES) if is_single else (_WRONG, _NOISE)
        allowed = wrong * (np.abs(derivatives) @ step) + noise * np.abs(start)
        above, below = (around.at(middle + h) - start - derivatives @ h for h in (step, -step))
    around.at(here)
    is_wrong = (above * below < 0.0) & (np.minimum(np.abs(above), np.abs(below)) > allowed)
    return [int(row) for row in np.flatnonzero(is_wrong)]


def _require_finite(
    matrix: FloatArray, states: Sequence[str], inputs: Sequence[PlantSignal], outputs: Sequence[PlantSignal]
) -> None:
    wrong = np.argwhere(~np.isfinite(matrix))
    if wrong.size:
        row, column = wrong[0]
        changed = [*(f"the derivative of {name}" for name in states), *(s.variable.name for s in outputs)]
        by = [*states, *(s.variable.name for s in inputs)]
        raise CallError(
            f"the linear model is not finite: {changed[row]} by {by[column]} is {matrix[row, column]:g}; "
            "choose another operating point"
        )
