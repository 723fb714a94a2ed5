"""The equations of a plant as SymPy expressions: checked against its variables, and their derivatives."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import sympy

from fmu_plants.model import TIME, Equations, ModelError, PlantModel, Variable, derivative_name


class UnknownNameError(ModelError, AttributeError):
    """The equations use a name that the model does not declare."""


class _SymbolTable:
    """The symbols that the equations are given; see `fmu_plants.model.Symbols`."""

    def __init__(self, model: PlantModel) -> None:
        names = [TIME, *(v.name for v in (*model.states, *model.inputs, *model.parameters))]
        self._model = model.name
        self._symbols = {name: sympy.Symbol(name, real=True) for name in names}

    def __getitem__(self, name: str) -> sympy.Symbol:
        if name in self._symbols:
            return self._symbols[name]
        close = get_close_matches(name, self._symbols, n=1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        known = ", ".join(sorted(self._symbols))
        raise UnknownNameError(
            f"model {self._model!r}: the equations use {name!r}{hint}; they can use: {known}"
        )

    def __getattr__(self, name: str) -> sympy.Symbol:
        if name.startswith("__"):
            raise AttributeError(name)  # protocols of Python (copying, for one) ask for such names
        return self[name]

    def values(self) -> set[sympy.Symbol]:
        return set(self._symbols.values())


@dataclass(frozen=True, slots=True)
class SymbolicModel:
    """A plant's right-hand side, in the order of its states and of its computed outputs."""

    derivatives: tuple[sympy.Expr, ...]
    outputs: tuple[sympy.Expr, ...]


def dependencies(model: PlantModel, symbolic: SymbolicModel) -> dict[str, frozenset[str]]:
    """Return the names of the variables that each derivative and each computed output is a function of."""
    unknowns = [
        *(derivative_name(state.name) for state in model.states),
        *(v.name for v in model.computed_outputs),
    ]
    expressions = [*symbolic.derivatives, *symbolic.outputs]
    return {
        unknown: frozenset(symbol.name for symbol in expression.free_symbols)
        for unknown, expression in zip(unknowns, expressions, strict=True)
    }


def resolve(model: PlantModel) -> SymbolicModel:
    """Evaluate the equations of the model with symbols.

    Raises
    ------
    ModelError
        The equations do not give every derivative and computed output, or give something that is no real
        expression in the model's own symbols; all faults at once.
    """
    symbols = _SymbolTable(model)
    equations = model.equations(symbols)
    if not isinstance(equations, Equations):
        raise ModelError(f"model {model.name!r}: its equations must return Equations, not {equations!r}")
    derivatives = _Block("derivative of state", model.states, equations.derivatives)
    outputs = _Block("output", model.computed_outputs, equations.outputs)
    faults = [*derivatives.faults(symbols.values()), *outputs.faults(symbols.values())]
    if faults:
        raise ModelError.from_faults(model.name, faults)
    return SymbolicModel(derivatives.expressions(), outputs.expressions())


@dataclass(frozen=True, slots=True)
class _Block:
    """What was given for a group of variables."""

    what: str
    variables: Sequence[Variable]
    given: Mapping[str, Any]

    def expressions(self) -> tuple[sympy.Expr, ...]:
        return tuple(sympy.sympify(self.given[variable.name]) for variable in self.variables)

    def faults(self, symbols: set[sympy.Symbol]) -> Iterator[str]:
        names = [variable.name for variable in self.variables]
        for name in self.given:
            if name not in names:
                expected = ", ".join(names) or "none"
                yield f"equations give a {self.what} {name!r}; expected: {expected}"
        for name in names:
            if name not in self.given:
                yield f"equations do not give the {self.what} {name!r}"
            else:
                yield from _expression_faults(f"{self.what} {name!r}", self.given[name], symbols)


def _expression_faults(where: str, given: Any, symbols: set[sympy.Symbol]) -> Iterator[str]:
    try:
        expression = sympy.sympify(given, strict=True)
    except sympy.SympifyError:
        yield f"{where} is no SymPy expression: {given!r}"
        return
    if not isinstance(expression, sympy.Expr):
        yield f"{where} is no scalar expression: {given!r}"
        return
    if foreign := expression.free_symbols - symbols:
        yield f"{where} uses symbols that the model does not declare: {', '.join(sorted(map(str, foreign)))}"
    if expression.has(sympy.I, sympy.nan, sympy.zoo, sympy.oo, -sympy.oo):
        yield f"{where} is not a finite real expression: {expression}"


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
