"""What a log is good for as a page in the manner of the report: verdict, next experiment, figures, tables."""

from collections.abc import Sequence
from dataclasses import replace

from markupsafe import Markup

from ddpc_cosim import LogSummary
from ddpc_cosim.files.tables import Table
from ddpc_cosim.files.texts import clipped, without_folders
from ddpc_reports.embedding import Drawing
from ddpc_reports.figures.charts import Spec, chosen_by, colour, dash, dashes, field, layer
from ddpc_reports.figures.figure import Figure, Key, one_chart
from ddpc_reports.page import set_page
from ddpc_reports.sections import Section, StudyPart

_LONGEST = 1000
_MOST_DRAWN = 8
_WIDTH, _HEIGHT = 1000, 260
_NAIVE = ("var(--ink-soft)", (6.0, 3.0)), ("var(--ink-soft)", (2.0, 3.0))


def log_page(summary: LogSummary) -> str:
    """Return the page."""
    tables = {table.id: replace(table, id=f"s1-{table.id}") for table in summary.tables}
    figure = _errors_figure(summary)
    drawn = [("figure", (figure, figure.id))] if figure else []
    sections = [
        Section("next", "What to do next", _texts(summary.advice)),
        Section("predictions", "How far ahead methods predict", [*drawn, *_table(tables, "predictions")]),
        Section("pairs", "Dead times and gains", _table(tables, "pairs")),
        Section("loop", "Closed loop or open", _table(tables, "feedback")),
        Section("inputs", "How inputs moved", _table(tables, "movement")),
        Section("columns", "Columns", _table(tables, "columns")),
        Section("notes", "What this rests on", _texts(summary.notes)),
    ]
    part = StudyPart(
        "s1-",
        1,
        f"Is it good enough? {clipped(summary.title)}",
        [],
        {name.capitalize(): fact for name, fact in summary.facts.items()},
        Markup("{}").format(summary.verdict),
        _texts(summary.reservations),
        [section for section in sections if section.blocks],
    )
    return set_page([part], {})


def _texts(texts: Sequence[str]) -> list[tuple[str, object]]:
    said = [clipped(without_folders(text), _LONGEST) for text in texts]
    return [("notes", [text[:1].upper() + text[1:] for text in said])] if said else []


def _table(tables: dict[str, Table], name: str) -> list[tuple[str, object]]:
    return [("table", tables[name])] if name in tables else []


def _errors_figure(summary: LogSummary) -> Figure | None:
    """Return the errors of methods over the horizon, beside those of the naive predictors."""
    predictions = summary.evidence.predictions
    curves = [(method.name, method.errors) for method in predictions.methods if method.errors][:_MOST_DRAWN]
    if not curves:
        return None
    looks = [(colour(i), dash(i)) for i in range(len(curves))] + [*_NAIVE]
    curves += [("last value held", predictions.hold), ("mean", predictions.mean)]
    rows = [
        {"key": name, "value": float(f"{error:.4g}"), "step": k}
        for name, errors in curves
        for k, error in enumerate(errors, 1)
    ]
    names = [name for name, _ in curves]
    highest = 1.1 * max(1.0, *(error for _, errors in curves[: len(curves) - 2] for error in errors))
    y = field("value", "error / standard deviation of the output")
    encoding: Spec = {
        "x": field("step", "samples ahead"),
        "y": y | {"scale": {"domain": [0, highest]}},
        "color": chosen_by("key", names, [hue for hue, _ in looks]),
        "strokeDash": chosen_by("key", names, [list(pattern) for _, pattern in looks]),
    }
    bound = {"type": "rule", "strokeWidth": 1, "color": "var(--ink)", "strokeDash": [1, 2]}
    spec: Spec = {
        "data": {"values": rows},
        "width": _WIDTH,
        "height": _HEIGHT,
        "layer": [
            layer({"type": "line", "strokeWidth": 1.8, "clip": True}, encoding),
            layer(bound, {"y": {"datum": 0.5}}),
        ],
    }
    keys = tuple(
        Key(name, hue, dashes(i) if i < len(curves) - 2 else " ".join(f"{part:g}" for part in pattern))
        for i, (name, (hue, pattern)) in enumerate(zip(names, looks, strict=True))
    )
    caption = (
        "Errors of predictions on held-out samples over the horizon, of the output that is predicted worst. "
        "Below the dotted line a prediction is good enough."
    )
    figure = one_chart("s1-errors", "Prediction errors over the horizon", caption, spec, keys=keys)
    (view,) = figure.views
    return replace(figure, views=(replace(view, drawing=Drawing(view.drawing.svg, view.drawing.height)),))
