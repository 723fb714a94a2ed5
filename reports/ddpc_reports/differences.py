"""Two runs of a study as a page: before, after and change, what changed in the study, cases of one alone."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Row, Table, text_headings
from ddpc_cosim.files.texts import clipped, without_folders
from ddpc_cosim.study.verdicts.baselines import Verdict
from ddpc_cosim.study.verdicts.changes import Change, Changes, changes_between
from ddpc_reports.comparison import metric_signal, metric_unit, metric_words
from ddpc_reports.numbers import MINUS, MISSING, fixed, significant, with_unit
from ddpc_reports.page import set_page
from ddpc_reports.sections import Section, StudyPart
from ddpc_reports.tables.table import interval_texts, number_cells

_MOST_ROWS, _MOST_LISTED, _NAMED, _LONGEST = 400, 200, 3, 300
_TONES = {Verdict.BETTER: "versus met", Verdict.WORSE: "versus missed"}
_NOTES = (
    "Before and after: medians over the seeds that both runs have, of runs that did not fail. Change: the "
    "median of after less before, in pairs of the same seed, with its 95\u00a0% bootstrap interval, from six "
    "seeds on; in % of the median before, where that is not next to nothing.",
    "Better and worse are told at 5\u00a0% by one step-down sign-flip max-T test of all controllers and "
    "scenarios of a metric; too small to matter: below the smallest relevant difference of the study before. "
    "With fewer than six seeds nothing is tested, and medians decide.",
)


class _Place(NamedTuple):
    """What a row of a table is of besides its controller."""

    problem: str
    scenario: str
    key: str


def differences_page(before: StudyResults, after: StudyResults, verdict: str, lines: Sequence[str]) -> str:
    """Return the page.

    Parameters
    ----------
    before, after : StudyResults
        The results of both runs.
    verdict : str
        How many of their cases agree.
    lines : sequence of str
        Of each case that does not, how it differs.
    """
    changes = changes_between(before, after)
    names = [clipped(results.folder.name or str(results.folder)) for results in (before, after)]
    others = [change for change in changes.changes if change.key not in changes.ranked_by]
    sections = [
        Section("study", "What changed in the study", _settings_blocks(changes)),
        Section("metrics", "Other metrics", _others_blocks(others)),
        Section("cases", "Cases that differ", _cases_blocks(changes, verdict, lines), folded=True),
    ]
    head = after.whole.head
    part = StudyPart(
        "s1-",
        1,
        f"{clipped(head.title or head.name, 100)}: {names[0]} against {names[1]}",
        [],
        {"Before": names[0], "After": names[1], "Cases": verdict.partition(" within")[0]},
        _answer(changes),
        _first_blocks(changes),
        sections=[section for section in sections if section.blocks],
    )
    return set_page([part], {})


def _answer(changes: Changes) -> Markup:
    """Say who is better and who is worse than before in what is ranked by, and whether the study differs."""
    if not changes.ranked:
        return Markup("The two runs have no case in common whose figures can be compared.")
    parts = []
    for verdict in (Verdict.BETTER, Verdict.WORSE):
        some = [change for change in changes.ranked if change.verdict is verdict]
        if some:
            parts.append(Markup("{}: {}").format(str(verdict), _some(some)))
    rest = len(changes.ranked) - sum(change.verdict in _TONES for change in changes.ranked)
    same = sum(change.verdict is Verdict.SAME for change in changes.ranked)
    if not parts:
        every = "are the same" if same == rest else "are neither told to be better nor worse than before"
        text = Markup("All {} figures that controllers are ranked by {}.").format(rest, every)
    else:
        text = Markup("{}{}.").format(Markup("; ").join(parts)[:1].upper(), Markup("; ").join(parts)[1:])
        text += Markup(" {} of {} figures are the same.").format(same, len(changes.ranked)) if same else ""
    if not changes.settings:
        return text + " The two studies say the same."
    noun = "setting" if len(changes.settings) == 1 else "settings"
    return text + f" The studies differ in {len(changes.settings)} {noun}."


def _some(changes: Sequence[Change]) -> Markup:
    said = [
        Markup("<b>{}</b> {}{}").format(
            change.label, _size(change), f" in {_where(change)}" * bool(_where(change))
        )
        for change in changes[:_NAMED]
    ]
    more = len(changes) - _NAMED
    return Markup(", ").join([*said, *([f"and {more} more"] if more > 0 else [])])


def _where(change: Change) -> str:
    signal = metric_signal(change.key)
    scenario = "" if change.scenario == "nominal" else change.scenario
    return ", ".join(filter(None, (change.problem, scenario, signal)))


def _first_blocks(changes: Changes) -> list[tuple[str, object]]:
    table = _table("s1-changes", "Before and after", changes.ranked, changes.ranked_by)
    return [("table", table)] if changes.ranked else []


def _others_blocks(changes: Sequence[Change]) -> list[tuple[str, object]]:
    """Return the metrics of which something changed; those that are the same are counted."""
    changed = [change for change in changes if change.verdict is not Verdict.SAME]
    shown = changed[:_MOST_ROWS]
    keys = tuple(dict.fromkeys(change.key for change in shown))
    notes = [f"{len(changes) - len(changed)} of {len(changes)} figures are the same, and not shown."]
    if len(changed) > len(shown):
        notes.append(f"{len(changed) - len(shown)} more changed, which the files metrics.csv have.")
    table = _table("s1-other", "Other metrics that changed", shown, keys)
    return [*([("table", table)] if shown else []), ("notes", notes)] if changes else []


def _table(name: str, caption: str, changes: Sequence[Change], keys: Sequence[str]) -> Table:
    """Return a row per controller, in groups of a problem, a scenario and a metric."""
    places: dict[_Place, list[Change]] = {}
    for key in keys:
        for change in changes:
            if change.key == key:
                places.setdefault(_Place(change.problem, change.scenario, key), []).append(change)
    any_failed = any(any(change.failed) for change in changes)
    has_several = len({change.scenario for change in changes}) > 1
    rows = [
        row
        for place, of_place in places.items()
        for row in _rows(place if has_several else place._replace(scenario=""), of_place, any_failed)
    ]
    headings = (
        Heading("Controller", numeric=False),
        Heading("verdict", "of before"),
        Heading("before"),
        Heading("after"),
        Heading("change"),
        Heading("interval", "95\u00a0%"),
        *([Heading("failed", "before, after")] if any_failed else []),
    )
    return Table(name, caption, headings, tuple(rows), _NOTES, kind="grouped", download=f"{name[3:]}.csv")


def _rows(place: _Place, changes: Sequence[Change], any_failed: bool) -> Iterable[Row]:
    before, after = (number_cells(values) for values in zip(*_medians(changes), strict=True))
    ends = [(change.difference.low, change.difference.high) for change in changes]
    intervals = interval_texts([(low, high) if low != high else (math.nan, math.nan) for low, high in ends])
    unit = metric_unit(place.key)
    what = f"{metric_words(place.key)}{f' [{unit}]' if unit else ''}"
    group = ", ".join(filter(None, (place.problem, place.scenario, what)))
    for i, change in enumerate(changes):
        verdict = str(change.verdict)
        if change.verdict in (*_TONES, Verdict.OTHER) and not change.tested:
            verdict += ", untested"
        tone = _TONES.get(change.verdict, "") if change.tested else ""
        percent = _in_percent(change) if change.verdict is not Verdict.SAME else ""
        cells = [
            Cell(f"{percent} {verdict}".strip(), change.percent, tone=tone),
            before[i],
            after[i],
            Cell(_in_unit(change, ""), change.difference.median),
            Cell(intervals[i]),
        ]
        if any_failed:
            old, new = change.failed
            cells.append(Cell(f"{old}, {new}", new - old, failed=new > old))
        yield Row(change.label, tuple(cells), change.controller, group=group)


def _medians(changes: Sequence[Change]) -> list[tuple[float, float]]:
    return [(change.before.median, change.after.median) for change in changes]


def _size(change: Change) -> str:
    """Write a change with its sign: in percent, or in the unit of the metric where that says little."""
    return _in_percent(change) or _in_unit(change, metric_unit(change.key))


def _in_percent(change: Change) -> str:
    size = change.percent
    if math.isnan(size):
        return ""
    return f"{_sign(size)}{fixed(abs(size), 0 if size == 0 or abs(size) >= 9.95 else 1)}\u00a0%"


def _in_unit(change: Change, unit: str) -> str:
    size = change.difference.median
    return MISSING if math.isnan(size) else _sign(size) + with_unit(significant(abs(size), 3), unit)


def _sign(size: float) -> str:
    return MINUS if size < 0 else "+" if size > 0 else ""


def _settings_blocks(changes: Changes) -> list[tuple[str, object]]:
    blocks: list[tuple[str, object]] = []
    for name, caption, said in (
        ("s1-settings", "Settings that differ", changes.settings),
        ("s1-provenance", "What they ran with", changes.provenance),
    ):
        rows = tuple(
            Row(clipped(path, _LONGEST), (_said(old), _said(new))) for path, (old, new) in said.items()
        )
        headings = text_headings("where", "before", "after")
        if rows:
            blocks.append(
                ("table", Table(name, caption, headings, rows, kind="wordy", download=f"{name[3:]}.csv"))
            )
    return blocks


def _said(value: str | None) -> Cell:
    return (
        Cell(MISSING, title="not said") if value is None else Cell(clipped(without_folders(value), _LONGEST))
    )


def _cases_blocks(changes: Changes, verdict: str, lines: Sequence[str]) -> list[tuple[str, object]]:
    alone = {"Only before": changes.only_before, "Only after": changes.only_after}
    notes = [f"{verdict}."]
    notes += [f"{when}: {len(ids)}." for when, ids in alone.items() if ids]
    notes += [clipped(without_folders(line), _LONGEST) for line in lines[:_MOST_LISTED]]
    more = len(lines) - _MOST_LISTED
    return [("notes", [*notes, *([f"and {more} more"] if more > 0 else [])])]
