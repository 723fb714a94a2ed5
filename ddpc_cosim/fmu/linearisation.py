"""Linear models of an FMU for Model Exchange about the point at which it is.

    dx' = A dx + B du,   dy = C dx + D du

The derivatives are the FMU's own where it has them, else central differences of what it computes beside the
point. What discrete states do at later events is in neither.
"""

from collections.abc import Sequence

import numpy as np

from ddpc_cosim.fmu.calls import CallError
from ddpc_cosim.fmu.differences import Surroundings, central_differences
from ddpc_cosim.fmu.directions import directional_derivatives, scalars
from ddpc_cosim.fmu.instance import Model
from ddpc_cosim.fmu.linear_model import LinearModel
from ddpc_cosim.fmu.model_description import REAL_TYPES, FMUDescription, Signal
from ddpc_cosim.fmu.ports import Shapes
from ddpc_cosim.variables import FloatArray


def linearisation_faults(
    description: FMUDescription, inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> list[str]:
    """Return why an FMU cannot be linearised between some inputs and outputs; empty if it can."""
    if "model-exchange" not in description.interfaces:
        return ["the FMU is not for Model Exchange: it does not tell the derivatives of its states"]
    faults = [] if description.continuous_states else ["the FMU has no continuous states"]
    for what, signals in (("input", inputs), ("output", outputs)):
        for signal in signals:
            if signal.source.type not in REAL_TYPES:
                faults.append(
                    f'the {what} "{signal.variable.name}" is of type {signal.source.type}, no real number'
                )
            elif what == "input" and signal.source.variability != "continuous":
                faults.append(f'the input "{signal.variable.name}" is {signal.source.variability}')
    return faults


def has_directions(model: Model, description: FMUDescription, shapes: Shapes) -> bool:
    """Whether an FMU has directional derivatives: it says so, its library has them, its states have names."""
    return (
        description.interfaces["model-exchange"].provides_directional_derivatives
        and model.has_directional_derivatives
        and len(scalars(description, description.state_order, shapes)) == model.sizes()[0]
    )


def linearise(
    model: Model,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
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
    inputs, outputs : sequence of Signal
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
        The FMU fails beside the point, or a derivative is not finite.
    """
    around = Surroundings(model, inputs, outputs, shapes)
    n = len(around.x_0)
    states = scalars(description, description.state_order, shapes)
    names = tuple(state.variable.name for state in states) if len(states) == n else ()
    # The standard knows derivatives of declared outputs; any other variable can be read here as an output.
    declared = [directional and signal.source.causality == "output" for signal in outputs]
    rows = [directional] * n + declared
    matrix = np.empty((len(rows), n + len(inputs)))
    if not all(rows):
        matrix[:] = central_differences(around)
    if directional:
        unknowns = scalars(description, description.derivatives, shapes)
        unknowns += [signal for signal, is_declared in zip(outputs, declared, strict=True) if is_declared]
        matrix[rows] = directional_derivatives(model, unknowns, [*states, *inputs], shapes)
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
    )


def _require_finite(
    matrix: FloatArray, states: Sequence[str], inputs: Sequence[Signal], outputs: Sequence[Signal]
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
