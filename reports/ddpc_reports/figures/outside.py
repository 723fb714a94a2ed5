"""What acts on a plant from outside, over time: known disturbances with their forecasts, and prices."""

from collections.abc import Iterable, Mapping
from itertools import pairwise

import numpy as np

from ddpc_cosim import FloatArray, Trace, Variable
from ddpc_reports.comparison import Condition
from ddpc_reports.figures.clock import Clock
from ddpc_reports.figures.samples import clock_of, first_runs, level_title, trusted
from ddpc_reports.figures.signal import Column, Given, Signal, rounded, times
from ddpc_reports.numbers import unit_symbol

ACTS, MEASURED, FORECAST = "x", "m", "f"
"""Columns: what acts, as it is measured, and what begins the names of those of forecasts."""


def disturbance_signals(condition: Condition, prefix: str) -> list[Signal]:
    """Return the known disturbances that the study names, as far as a run tells of them.

    What acts is told of inputs of the plant, what is measured of all that controllers are told; forecasts are
    those of the controller that looks ahead farthest, of which others are told the beginning.
    """
    traces = first_runs(condition)
    declared = condition.results.study.disturbances
    return disturbances_of(traces, declared, clock_of(condition), prefix) if traces else []


def disturbances_of(
    traces: Mapping[str, Trace], declared: Iterable[str], clock: Clock, prefix: str
) -> list[Signal]:
    """Return disturbances of runs, by their names, as far as the runs tell of them."""
    longest = max(traces.values(), key=len)
    farthest = max(traces.values(), key=lambda trace: np.count_nonzero(np.isfinite(trace.forecast)))
    held = [variable.name for variable in longest.changed_inputs]
    known = [variable.name for variable in longest.disturbances]
    variables = {v.name: v for v in (*longest.disturbances, *longest.changed_inputs)}
    signals = []
    for i, variable in enumerate(variables[name] for name in declared if name in variables):
        name = variable.name
        acts = longest.applied[:, held.index(name)] if name in held else None
        measured = longest.d[:, known.index(name)] if name in known else None
        expected = _issued(farthest, known.index(name)) if measured is not None else []
        signals.append(_disturbance(variable, f"{prefix}o{i}", clock, longest.time, acts, measured, expected))
    return signals


def _disturbance(
    variable: Variable,
    name: str,
    clock: Clock,
    time: FloatArray,
    acts: FloatArray | None,
    measured: FloatArray | None,
    expected: list[FloatArray],
) -> Signal:
    unit, is_held = variable.shown_in, acts is not None
    columns: dict[str, Column] = {"t": times(time, clock)}
    given = list[Given]()
    if acts is not None:
        columns[ACTS] = rounded(unit.from_unit(acts))
        given.append(Given((ACTS,), "what acts", width=1.4))
    if measured is not None and (acts is None or not np.array_equal(acts, measured)):
        columns[MEASURED] = rounded(unit.from_unit(measured))
        look = {"dashes": (2.0, 2.0), "width": 1.0} if is_held else {"width": 1.4}
        given.append(Given((MEASURED,), "as measured", held=is_held, **look))
    if expected:
        lines = {f"{FORECAST}{n}": rounded(unit.from_unit(line)) for n, line in enumerate(expected)}
        columns |= lines
        given.append(Given(tuple(lines), "", "var(--accent)", (), 1.3, held=is_held))
    symbol = unit_symbol(unit.name)
    return Signal(name, level_title(variable, symbol), symbol, columns, (), clock=clock, given=tuple(given))


def _issued(trace: Trace, i: int) -> list[FloatArray]:
    """Return each forecast that is kept as a line from what was measured when it was issued, shape (K,)."""
    if not trace.forecast.size:
        return []
    expected, lines = trace.forecast[:, i], list[FloatArray]()
    is_told = np.isfinite(expected)
    starts = [k for k, (before, after) in enumerate(pairwise(is_told)) if after and not before]
    for begin in starts:
        end = next((k for k in range(begin + 1, len(expected)) if not is_told[k]), len(expected))
        line = np.full(len(expected), np.nan)
        line[begin] = trace.d[begin, i]
        line[begin + 1 : end] = expected[begin + 1 : end]
        lines.append(line)
    return lines


def price_signals(condition: Condition, prefix: str) -> list[Signal]:
    """Return the prices over time, as controllers learn them."""
    traces = first_runs(condition)
    return prices_of(traces, clock_of(condition), prefix) if traces else []


def prices_of(traces: Mapping[str, Trace], clock: Clock, prefix: str) -> list[Signal]:
    """Return the prices of runs of one loop over time."""
    longest = max(traces.values(), key=len)
    signals = []
    for i, charge in enumerate(longest.charges):
        unit = unit_symbol(f"{charge.unit}/{charge.amount}")
        columns = {"t": times(longest.time, clock), ACTS: rounded(longest.price[:, i])}
        given = (Given((ACTS,), "price", width=1.4),)
        title = level_title(Variable(f"price of {charge.name}"), unit)
        signals.append(Signal(f"{prefix}p{i}", title, unit, columns, (), clock=clock, given=given))
    return signals


def charged_signals(condition: Condition, prefix: str) -> list[Signal]:
    """Return the signals that are paid for and are neither inputs nor controlled outputs of the loop."""
    traces = first_runs(condition)
    if not traces:
        return []
    longest, clock = max(traces.values(), key=len), clock_of(condition)
    drawn = {variable.name for variable in (*longest.inputs, *longest.outputs)}
    drawn |= {*condition.results.study.disturbances}
    seen = {variable.name: variable for variable in (*longest.measurements, *longest.changed_inputs)}
    held = {variable.name for variable in longest.changed_inputs}
    signals = dict[str, Signal]()
    for i, charge in enumerate(longest.charges):
        if charge.signal in drawn or charge.signal in signals:
            continue
        variable = seen.get(charge.signal, Variable(charge.signal))
        unit = variable.shown_in
        columns = {"t": times(longest.time, clock)}
        columns |= {key: rounded(unit.from_unit(trace.charged[:, i])) for key, trace in traces.items()}
        symbol = unit_symbol(unit.name)
        signals[charge.signal] = Signal(
            f"{prefix}q{i}",
            level_title(variable, symbol),
            symbol,
            columns,
            trusted(traces),
            held=charge.signal in held,
            clock=clock,
        )
    return [*signals.values()]
