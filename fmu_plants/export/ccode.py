"""C code of a plant: `model.c`, which fills the interface of `runtime/model.h`."""

import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files as package_files

import sympy
from sympy.codegen.rewriting import create_expand_pow_optimization
from sympy.printing.c import C99CodePrinter

from fmu_plants.equations import Partial, SymbolicModel
from fmu_plants.export.description import Scalar, c_number, c_text, scalars, variable_table
from fmu_plants.model import TIME, InputTable, ModelError, PlantModel, Variable

LARGEST_WRITTEN_OUT_POWER = 4  # x*x*x*x is faster than pow(x, 4) and just as exact
_INLINE_FUNCTIONS = frozenset({"ceil", "fabs", "floor", "fma", "fmax", "fmin"})  # few instructions, no import
_IMPORTED_FUNCTION = re.compile(r"^IMPORTED_\d\((\w+)\);", re.MULTILINE)
_CALL = re.compile(r"\b([A-Za-z_]\w*)\(")
_expand_powers = create_expand_pow_optimization(LARGEST_WRITTEN_OUT_POWER)


def _written_out(expression: sympy.Expr) -> sympy.Expr:
    """Write small powers as products; not where SymPy then takes an argument of Max or Min for not real."""
    try:
        return _expand_powers(expression)
    except (TypeError, ValueError):  # "invalid comparison of non-real", "not comparable"
        return expression


@cache
def callable_functions() -> frozenset[str]:
    """Return the C functions that equations can call on every platform, as `runtime/windows_math.h` lists."""
    windows = (package_files("fmu_plants") / "runtime" / "windows_math.h").read_text(encoding="utf-8")
    return _INLINE_FUNCTIONS | frozenset(_IMPORTED_FUNCTION.findall(windows))


class _UnavailableError(Exception):
    """An expression needs a function of this name, which the FMU does not have."""


class _CPrinter(C99CodePrinter):  # type: ignore[misc]  # SymPy has no types
    """Prints expressions of doubles, with the variables of the model as elements of arrays."""

    def __init__(self, names: Mapping[sympy.Symbol, str]) -> None:
        # SymPy has C's abs for integers, which is a function of int.
        super().__init__({"human": False, "math_macros": {}, "user_functions": {"Abs": "fabs"}})
        self._names = names

    def c_text(self, expression: sympy.Expr) -> str:
        """Return the expression in C.

        Raises
        ------
        _UnavailableError
            It needs a function that C does not have, or not on every platform.
        """
        text: str
        _, unsupported, text = self.doprint(_written_out(expression))
        missing = {type(part).__name__ for part in unsupported} or {
            *_CALL.findall(text)
        } - callable_functions()
        if missing:
            raise _UnavailableError(min(missing))
        return text

    def _print_Symbol(self, expr: sympy.Symbol) -> str:  # noqa: N802 (names are SymPy's)
        return self._names.get(expr, expr.name)

    def _print_Integer(self, expr: sympy.Integer) -> str:  # noqa: N802
        return f"{expr.p}.0"  # an int would overflow, or divide as one

    def _print_Float(self, expr: sympy.Float) -> str:  # noqa: N802
        return repr(float(expr))

    def _print_NumberSymbol(self, expr: sympy.NumberSymbol) -> str:  # noqa: N802
        return repr(float(expr))

    def _print_Mod(self, expr: sympy.Mod) -> str:  # noqa: N802
        # SymPy's remainder has the sign of the divisor, that of C's fmod the sign of the dividend.
        dividend, divisor = (self._print(argument) for argument in expr.args)
        return f"(({dividend}) - ({divisor})*floor(({dividend})/({divisor})))"


def model_source(
    model: PlantModel, symbolic: SymbolicModel, relative_tolerance: float, absolute_tolerance: float
) -> str:
    """Return the text of `model.c`, with an empty GUID.

    Raises
    ------
    ModelError
        An expression uses a function that FMUs do not have on every platform.
    """
    layout = scalars(model)
    elements = symbolic.partials()
    functions = {
        "derivatives": symbolic.derivatives,
        "outputs": symbolic.outputs,
        "jacobian": {f"d {e.unknown} / d {e.known}": e.expression for e in elements},
    }
    if model.control:
        functions["control"] = {f"rule of {name}": rule for name, rule in symbolic.rules.items()}
    named = [f"    .{name} = {name}," for name in functions]
    return "\n".join(
        [
            f"/* {model.name}: generated from its equations. */",
            '#include "integration.h"' if model.has_events else '#include "model.h"',
            "",
            "#include <math.h>",
            "",
            variable_table(layout),
            "",
            *_partial_table(elements, layout),
            *_legend(model),
            *(line for name, results in functions.items() for line in (_function(model, name, results), "")),
            *(_events(model, named) if model.has_events else ()),
            "const Model model = {",
            f'    .identifier = "{model.name}",',
            '    .guid = "",',
            f"    .n_variables = {len(layout)},",
            f"    .n_states = {len(model.states)},",
            f"    .n_inputs = {len(model.all_inputs)},",
            f"    .n_outputs = {len(model.computed_outputs)},",
            f"    .n_partials = {len(elements)},",
            "    .variables = variables,",
            f"    .partials = {'partials' if elements else '0'},",
            f"    .relative_tolerance = {c_number(relative_tolerance)},",
            f"    .absolute_tolerance = {c_number(absolute_tolerance)},",
            *(() if model.has_events else named),
            "};",
            "",
        ]
    )


def _events(model: PlantModel, functions: Sequence[str]) -> list[str]:
    """Return the tables of a plant, and the description of what else a plant with events has."""
    heads = [
        f"static const char *const heads_{number}[] = {{{', '.join(map(c_text, table.heads))}}};"
        for number, table in enumerate(model.tables)
    ]
    sources = [_table_source(number, table) for number, table in enumerate(model.tables)]
    tables = [*heads, "static const TableSource tables[] = {", *sources, "};", ""] if sources else []
    return [
        *tables,
        "const Events events = {",
        f"    .n_parameters = {len(model.parameters)},",
        f"    .n_memory = {len(model.memory)},",
        f"    .n_actuators = {len(model.actuators)},",
        f"    .n_columns = {len(model.columns)},",
        f"    .n_tables = {len(model.tables)},",
        *(["    .tables = tables,"] if sources else []),
        f"    .sampling_time = {c_number(model.control.sampling_time if model.control else 0.0)},",
        *functions,
        "};",
        "",
    ]


def _table_source(number: int, table: InputTable) -> str:
    held = "true" if table.interpolation == "hold" else "false"
    period = c_number(table.period or 0.0)
    return f"    {{{c_text(table.file)}, {len(table.variables)}, heads_{number}, {held}, {period}}},"


def _partial_table(elements: Sequence[Partial], layout: Sequence[Scalar]) -> list[str]:
    """Return the positions of the Jacobian's elements; C has no empty arrays."""
    if not elements:
        return []
    reference = {scalar.variable.name: position for position, scalar in enumerate(layout)}
    rows = [f"    {{{reference[e.unknown]}, {reference[e.known]}}}," for e in elements]
    return ["static const Partial partials[] = {", *rows, "};", ""]


def _legend(model: PlantModel) -> list[str]:
    """Say which variable is which array element, for readers of the C code."""
    groups = {
        **_arrays(model),
        "result of derivatives": model.states,
        "result of outputs": model.computed_outputs,
        "result of control": (*model.memory, *model.actuators),
    }
    return [
        f"/* {array}: {', '.join(variable.name for variable in variables)} */"
        for array, variables in groups.items()
        if variables
    ]


def _arrays(model: PlantModel) -> dict[str, tuple[Variable, ...]]:
    """Return the variables that functions of the C code are given, by array."""
    arrays = {"x": model.states, "u": model.all_inputs, "p": model.parameters}
    if model.has_events:
        arrays |= {"s": (*model.memory, *model.actuators), "c": model.columns}
    return arrays


def _element_names(model: PlantModel) -> dict[sympy.Symbol, str]:
    elements = {
        sympy.Symbol(variable.name, real=True): f"{array}[{index}]"
        for array, variables in _arrays(model).items()
        for index, variable in enumerate(variables)
    }
    return elements | {sympy.Symbol(TIME, real=True): TIME}


def _function(model: PlantModel, name: str, results: Mapping[str, sympy.Expr]) -> str:
    """Return a function that evaluates the expressions, by what they are, common subexpressions once."""
    printer = _CPrinter(_element_names(model))
    # A variable may be called t0, too: variables are printed as elements of arrays, never by name.
    common, reduced = sympy.cse(list(results.values()), symbols=sympy.numbered_symbols("t"), list=True)
    try:
        lines = [f"    const double {symbol} = {printer.c_text(part)};" for symbol, part in common]
        lines += [f"    result[{index}] = {printer.c_text(part)};" for index, part in enumerate(reduced)]
    except _UnavailableError:
        raise _unavailable(model, results, printer) from None
    body = "\n".join(lines)
    arrays = _arrays(model)
    arguments = (TIME, *arrays, "result")
    unused = [f"    (void){argument};" for argument in arguments if not re.search(rf"\b{argument}\b", body)]
    given = ", ".join(f"const double {array}[]" for array in arrays)
    signature = f"double time, {given}, double result[]"
    return "\n".join([f"static void {name}({signature})", "{", *unused, *lines, "}"])


def _unavailable(model: PlantModel, results: Mapping[str, sympy.Expr], printer: _CPrinter) -> ModelError:
    """Return the error that names the first result with a function that FMUs do not have."""
    for what, expression in results.items():
        try:
            printer.c_text(expression)
        except _UnavailableError as error:
            return ModelError(
                f"model {model.name!r}: {what} uses the function {error}, which FMUs do not have on every "
                f"platform: {expression}\n"
                f"Write it in terms of these C functions: {', '.join(sorted(callable_functions()))}"
            )
    raise AssertionError("what is written once is written in full, too")
