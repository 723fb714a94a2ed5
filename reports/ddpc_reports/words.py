"""What the sentences of the verdict are made of: lists, names, figures with their units."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from markupsafe import Markup

from ddpc_reports.comparison import Competitor, Spread, metric_unit
from ddpc_reports.numbers import integer, significant, with_unit


class Statement(NamedTuple):
    """One finding: what it is about, and the sentences."""

    topic: str
    text: Markup


def listed(parts: Sequence[str | Markup]) -> Markup:
    """Join parts as in a sentence: ``a, b and c``."""
    *head, last = parts
    return Markup("{} and {}").format(Markup(", ").join(head), last) if head else Markup("{}").format(last)


def names(competitors: Sequence[Competitor]) -> list[Markup]:
    """Set names in italics: a label may itself hold commas."""
    return [Markup("<i>{}</i>").format(one.label) for one in competitors]


def by_signal(lines: Sequence[tuple[str, Markup]]) -> Markup:
    """Set one line for each signal; the line alone where there is one signal."""
    if len(lines) == 1:
        return lines[0][1]
    entry = Markup("<li><span class='signal'>{}:</span> {}</li>")
    return Markup("<ul class='signals'>{}</ul>").format(
        Markup(" ").join(entry.format(*line) for line in lines)
    )


def counted(count: float, noun: str) -> str:
    """Write a count and its noun: ``1 step``, ``2 steps``."""
    return f"{integer(count)} {noun}" if count == 1 else f"{integer(count)} {noun}s"


def median_and_range(figure: Spread, key: str) -> str:
    """Write a median and, where the cases differ, their range in brackets."""
    show = shower(key)
    if not figure.varies:
        return show(figure.median)
    return f"{show(figure.median)} [{significant(figure.low)} … {significant(figure.high)}]"


def shower(key: str, digits: int = 4) -> Callable[[float], str]:
    """Return the function that writes a value of this metric with its unit."""
    return lambda value: with_unit(significant(value, digits), metric_unit(key))
