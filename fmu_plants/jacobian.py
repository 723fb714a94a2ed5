"""Partial derivatives of a plant's right-hand side."""

from dataclasses import dataclass
from typing import Any

import sympy

from fmu_plants.layout import derivative_name
from fmu_plants.model import PlantModel
from fmu_plants.symbolic import SymbolicModel


@dataclass(frozen=True, slots=True)
class Partial:
    """An element of the Jacobian that is not zero everywhere: d unknown / d known."""

    unknown: str
    known: str
    expression: sympy.Expr


def partials(model: PlantModel, symbolic: SymbolicModel) -> tuple[Partial, ...]:
    """Return the derivatives of state derivatives and computed outputs, by whatever they are functions of.

    Functions with jumps count as constant between their jumps; at a corner of a minimum, maximum or
    absolute value, the mean of both sides is taken.
    """
    unknowns = [derivative_name(state.name) for state in model.states]
    unknowns += [output.name for output in model.computed_outputs]
    elements = []
    for unknown, expression in zip(unknowns, (*symbolic.derivatives, *symbolic.outputs), strict=True):
        held, jumps = _hold_jumps(expression)
        for symbol in sorted(expression.free_symbols, key=str):
            derivative = _spell_out_steps(held.diff(symbol)).xreplace(jumps)
            if derivative != 0:
                elements.append(Partial(unknown, symbol.name, derivative))
    return tuple(elements)


def _hold_jumps(expression: sympy.Expr) -> tuple[sympy.Expr, dict[Any, Any]]:
    """Replace functions with jumps by symbols; return what to put back for each of them.

    SymPy has their derivatives in terms of Dirac's impulses, or not at all.
    """
    jumping = expression.replace(sympy.Abs, lambda x: x * sympy.sign(x))
    jumping = jumping.replace(sympy.Mod, lambda x, divisor: x - divisor * sympy.floor(x / divisor))
    jumps = jumping.atoms(sympy.floor, sympy.ceiling, sympy.sign)
    symbols = {jump: sympy.Dummy(real=True) for jump in sorted(jumps, key=sympy.default_sort_key)}
    return jumping.xreplace(symbols), {symbol: jump for jump, symbol in symbols.items()}


def _spell_out_steps(expression: sympy.Expr) -> sympy.Expr:
    """Write Heaviside's steps, the derivatives of minimum and maximum, as C can have them."""

    def step(x: Any, *_: Any) -> Any:
        return sympy.Piecewise((1, x > 0), (0, x < 0), (sympy.Rational(1, 2), True))

    return expression.replace(sympy.Heaviside, step)
