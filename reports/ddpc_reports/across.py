"""Scenarios beside each other: how each controller's figures change from one to the next."""

from collections.abc import Sequence

from markupsafe import Markup

from ddpc_reports.comparison import TRACKING, Competitor, Condition, metric_signal, metric_unit, ranked
from ddpc_reports.table import Cell, Heading, Row, Table, number_cells
from ddpc_reports.words import Statement, by_signal, listed

_COMPARED = {
    TRACKING: "tracking cost",
    "settled_error": "settled error",
    "total_variation": "actuator travel",
}


def across_statements(conditions: Sequence[Condition]) -> list[Statement]:
    """Return who tracks best in which scenario; nothing for a single one."""
    if len(conditions) < 2:
        return []
    lines = [(metric_signal(key), _winners(conditions, key)) for key in _keys(conditions, TRACKING)]
    return [Statement("Tracking", by_signal(lines))] if lines else []


def _winners(conditions: Sequence[Condition], key: str) -> Markup:
    """Say in which scenarios each winner has the smallest median."""
    won: dict[str, list[Markup]] = {}
    for condition in conditions:
        complete = [one for one in condition.competitors if one.completed_all]
        order = ranked(complete, [one.over_seeds(key).median for one in complete])
        if len(order) > 1:
            won.setdefault(order[0][1].label, []).append(Markup("<i>{}</i>").format(condition.label))
    if not won:
        return Markup("There is no scenario in which two controllers completed every case.")
    claims = [" has the smallest tracking cost", *[""] * (len(won) - 1)]
    parts = [
        Markup("<b>{}</b>{} in {}").format(label, claim, listed(where))
        for (label, where), claim in zip(won.items(), claims, strict=True)
    ]
    return Markup("{}.").format(Markup("; ").join(parts))


def across_table(conditions: Sequence[Condition], prefix: str) -> Table | None:
    """Return medians of the main figures, a row per controller and a column per scenario; None for one."""
    if len(conditions) < 2:
        return None
    rows = [
        row
        for name, title in _COMPARED.items()
        for key in _keys(conditions, name)
        for row in _rows(conditions, key, _title(key, title))
    ]
    headings = (Heading("Controller", numeric=False), *(Heading(one.label) for one in conditions))
    over = max(len(condition.seeds) for condition in conditions)
    notes = (
        "Bold and tinted: the smallest in a scenario, among controllers that completed every case.",
        *((f"Medians over {over} seeds.",) if over > 1 else ()),
    )
    return Table(
        f"{prefix}across",
        "Scenarios beside each other",
        headings,
        tuple(rows),
        notes,
        kind="grouped",
        download="scenarios.csv",
    )


def _rows(conditions: Sequence[Condition], key: str, group: str) -> list[Row]:
    by_key = [{one.key: one for one in condition.competitors} for condition in conditions]
    everybody = {one.key: one for members in by_key for one in members.values()}
    columns = [_column([members.get(name) for name in everybody], key) for members in by_key]
    return [
        Row(one.label, tuple(cells[i] for cells in columns), one.key, one.index, group)
        for i, one in enumerate(everybody.values())
    ]


def _column(members: Sequence[Competitor | None], key: str) -> list[Cell]:
    values = [one.over_seeds(key).median if one else float("nan") for one in members]
    return number_cells(values, eligible=[bool(one and one.completed_all) for one in members])


def _keys(conditions: Sequence[Condition], name: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(key for condition in conditions for key in condition.keys(name)))


def _title(key: str, words: str) -> str:
    signal = metric_signal(key)
    return " / ".join(filter(None, (f"{words} of {signal}" if signal else words, metric_unit(key))))
