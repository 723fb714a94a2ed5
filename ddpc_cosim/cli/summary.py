"""The result table that ``run`` prints."""

import math
from statistics import median

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from ddpc_cosim.metrics import split_key
from ddpc_cosim.results import CaseResult, StudyResults
from ddpc_cosim.trace import Outcome

_SHOWN = {"sum_abs_error": "sum |error|", "settled_error": "settled", "max_abs_input": "max |input|"}


def summary_table(results: StudyResults) -> Table:
    """Return a table with one row per controller and scenario: the first seed, and the range over all."""
    first = results.cases[0]
    keys = [key for key in first.metrics if split_key(key)[0] in _SHOWN]
    several = len({case.scenario for case in results.cases}) > 1
    table = Table(
        box=SIMPLE_HEAD, pad_edge=False, title=_title(results), title_justify="left", title_style="bold"
    )
    table.add_column("\ncontroller", no_wrap=True)
    if several:
        table.add_column("\nscenario", no_wrap=True)
    for key in keys:
        table.add_column(_heading(key), justify="right", no_wrap=True)
        if key == keys[0]:
            table.add_column("over the seeds:\nmedian, range", justify="right", no_wrap=True)
    table.add_column("median\nstep", justify="right", no_wrap=True)
    table.add_column("cases\ndone", justify="right", no_wrap=True)
    groups: dict[tuple[str, str], list[CaseResult]] = {}
    for case in results.cases:
        groups.setdefault((case.controller, case.scenario), []).append(case)
    for (_, scenario), cases in groups.items():
        shown = cases[0].metrics if cases[0].outcome is Outcome.COMPLETED else {}
        figures = [_number(shown.get(key, math.nan)) for key in keys]
        figures.insert(1, _spread(cases, keys[0]))
        step = _micro(cases[0].metrics["solve_time_median [s]"])
        name = [Text(cases[0].label), *([Text(scenario)] if several else [])]
        table.add_row(*name, *figures, step, _completed(cases))
    return table


def _title(results: StudyResults) -> Text:
    return Text(f"{results.study.title or results.study.name} (seed {results.cases[0].seed})")


def _heading(key: str) -> Text:
    name, signal, unit = split_key(key)
    return Text(f"{_SHOWN[name]}\n{signal} [{unit}]")


def _spread(cases: list[CaseResult], key: str) -> str:
    values = [case.metrics[key] for case in cases if case.outcome is Outcome.COMPLETED]
    if not values:
        return "-"
    return f"{_number(median(values))}, {_number(min(values))} .. {_number(max(values))}"


def _completed(cases: list[CaseResult]) -> str:
    return f"{sum(case.outcome is Outcome.COMPLETED for case in cases)}/{len(cases)}"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _micro(seconds: float) -> str:
    return "-" if math.isnan(seconds) else f"{1e6 * seconds:.0f} us"
