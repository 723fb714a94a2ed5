"""The equations of a plant as SymPy expressions: checked against its variables, and their derivatives."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy

from fmu_plants.model import (
    TIME,
    Equations,
    ModelError,
    PlantModel,
    Rules,
    Variable,
    derivative_name,
    override_name,
    switch_name,
)
from fmu_plants.spelling import did_you_mean


class UnknownNameError(ModelError, AttributeError):
    """The equations use a name that the model does not declare."""


class _SymbolTable:
    """The symbols that equations or rules are given; see `fmu_plants.model.Symbols`."""

    def __init__(self, model: PlantModel, what: str, variables: Iterable[Variable]) -> None:
        known = (*model.states, *model.inputs, *model.parameters, *model.columns, *variables)
        names = [TIME, *(v.name for v in known)]
        self._model, self._what = model.name, what
        self._symbols = {name: sympy.Symbol(name, real=True) for name in names}

    def __getitem__(self, name: str) -> sympy.Symbol:
        if name in self._symbols:
            return self._symbols[name]
        hint = did_you_mean(name, self._symbols)
        raise UnknownNameError(f"model {self._model!r}: the {self._what} use an unknown {name!r}; {hint}")

    def __getattr__(self, name: str) -> sympy.Symbol:
        if name.startswith("__"):
            raise AttributeError(name)  # protocols of Python (copying, for one) ask for such names
        return self[name]

    def values(self) -> set[sympy.Symbol]:
        return set(self._symbols.values())


@dataclass(frozen=True, slots=True)
class Partial:
    """An element of the Jacobian that is not zero everywhere: d unknown / d known."""

    unknown: str
    known: str
    expression: sympy.Expr


@dataclass(frozen=True, slots=True)
class SymbolicModel:
    """A plant's right-hand side, and the rules of its embedded control.

    Parameters
    ----------
    derivatives : mapping of str to expression
        By the name of the derivative, ``der(x)``, in the order of the states.
    outputs : mapping of str to expression
        The computed outputs by name, in their order.
    rules : mapping of str to expression
        What the control remembers, then what it commands, by name, in their order; of its outputs, those
        that are computed are replaced by their expressions.
    columns, actuators : frozenset of str
        Names of the columns of tables, which depend on time, and of actuators, which depend on overrides.
    """

    derivatives: Mapping[str, sympy.Expr]
    outputs: Mapping[str, sympy.Expr]
    rules: Mapping[str, sympy.Expr] = field(default_factory=dict)
    columns: frozenset[str] = frozenset()
    actuators: frozenset[str] = frozenset()

    def dependencies(self) -> dict[str, frozenset[str]]:
        """Return the names of the variables that each derivative and computed output is a function of."""
        return {
            name: frozenset(
                known for symbol in expression.free_symbols for known in self._variables(symbol.name)
            )
            for name, expression in {**self.derivatives, **self.outputs}.items()
        }

    def _variables(self, symbol: str) -> tuple[str, ...]:
        """Return the variables of the FMU that a symbol of the equations is a function of."""
        if symbol in self.actuators:
            return override_name(symbol), switch_name(symbol)
        return (TIME,) if symbol in self.columns else (symbol,)

    def partials(self) -> list[Partial]:
        """Return the derivatives of everything that is computed, by everything that it is a function of.

        Functions with jumps count as constant between their jumps; at a corner of a minimum, maximum or
        absolute value, the mean of both sides is taken. Columns of tables count as constant, and so does what
        an embedded control commands; where it is overridden, the override is what there is a derivative by.
        """
        elements = []
        for name, expression in {**self.derivatives, **self.outputs}.items():
            held, jumps = _hold_jumps(expression)
            for symbol in sorted(expression.free_symbols, key=str):
                derivative = _spell_out_steps(held.diff(symbol)).xreplace(jumps)
                if derivative != 0 and symbol.name not in self.columns:
                    elements.append(self._partial(name, symbol.name, derivative))
        return elements

    def _partial(self, unknown: str, symbol: str, derivative: sympy.Expr) -> Partial:
        if symbol not in self.actuators:
            return Partial(unknown, symbol, derivative)
        is_on = sympy.Symbol(switch_name(symbol), real=True) > 0.5
        return Partial(unknown, override_name(symbol), sympy.Piecewise((derivative, is_on), (0, True)))


def resolve(model: PlantModel) -> SymbolicModel:
    """Evaluate the equations of the model, and the rules of its control, with symbols.

    Raises
    ------
    ModelError
        The equations do not give every derivative and computed output, or the rules not every memory and
        actuator, or something other than a real expression in the model's own symbols; all errors at once.
    """
    symbols = _SymbolTable(model, "equations", model.actuators)
    given = model.equations(symbols)
    if not isinstance(given, Equations):
        raise ModelError(f"model {model.name!r}: its equations must return Equations, not {given!r}")
    states = [state.name for state in model.states]
    outputs = [output.name for output in model.computed_outputs]
    errors = [
        *_errors("equations", "derivative of state", states, given.derivatives, symbols),
        *_errors("equations", "output", outputs, given.outputs, symbols),
    ]
    rules, of_rules = _rules(model)
    if errors := [*errors, *of_rules]:
        raise ModelError.listing(model.name, errors)
    computed = {output: sympy.sympify(given.outputs[output]) for output in outputs}
    seen = {sympy.Symbol(output, real=True): expression for output, expression in computed.items()}
    return SymbolicModel(
        {derivative_name(state): sympy.sympify(given.derivatives[state]) for state in states},
        computed,
        {name: sympy.sympify(rule).xreplace(seen) for name, rule in rules.items()},
        frozenset(column.name for column in model.columns),
        frozenset(actuator.name for actuator in model.actuators),
    )


def _rules(model: PlantModel) -> tuple[dict[str, Any], list[str]]:
    """Return the next memory and the commands by name, in the order of the model, and what is wrong."""
    if model.control is None:
        return {}, []
    symbols = _SymbolTable(model, "rules of the control", (*model.memory, *model.computed_outputs))
    given = model.control.rules(symbols)
    if not isinstance(given, Rules):
        raise ModelError(f"model {model.name!r}: the rules of its control must return Rules, not {given!r}")
    memory, actuators = ([v.name for v in group] for group in (model.memory, model.actuators))
    errors = [
        *_errors("rules", "memory", memory, given.memory, symbols),
        *_errors("rules", "actuator", actuators, given.actuators, symbols),
    ]
    both = {**given.memory, **given.actuators}
    return {name: both[name] for name in (*memory, *actuators) if name in both}, errors


def _errors(
    source: str, what: str, names: list[str], given: Mapping[str, Any], symbols: _SymbolTable
) -> Iterator[str]:
    for name in given:
        if name not in names:
            yield f"{source} give an unknown {what} {name!r}; expected: {', '.join(names) or 'none'}"
    for name in names:
        if name not in given:
            yield f"{source} do not give the {what} {name!r}"
        else:
            yield from _expression_errors(f"{what} {name!r}", given[name], symbols.values())


def _expression_errors(where: str, given: Any, symbols: set[sympy.Symbol]) -> Iterator[str]:
    try:
        expression = sympy.sympify(given, strict=True)
    except sympy.SympifyError:
        yield f"{where} is not a SymPy expression: {given!r}"
        return
    if not isinstance(expression, sympy.Expr):
        yield f"{where} is not a scalar expression: {given!r}"
        return
    if foreign := expression.free_symbols - symbols:
        yield f"{where} uses symbols that the model does not declare: {', '.join(sorted(map(str, foreign)))}"
    if expression.has(sympy.I, sympy.nan, sympy.zoo, sympy.oo, -sympy.oo):
        yield f"{where} is not a finite real expression: {expression}"


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
