"""The page: studies gathered, tables and figures made, templates filled."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice, zip_longest
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ddpc_cosim import Outcome, StudyResults
from ddpc_cosim.study.file_format.sections import Reproduction
from ddpc_cosim.study.following import following_lines
from ddpc_cosim.texts import printable
from ddpc_reports.across_problems import overall, overall_figures, overall_statements, overall_table
from ddpc_reports.certainty import certainty_statements, certainty_table
from ddpc_reports.comparison import Condition, conditions, on_one_page
from ddpc_reports.distances import distance_maps
from ddpc_reports.embedding import (
    Packed,
    chart_library,
    content_policy,
    drawable,
    json_for_script,
    pack,
    page_script,
    stylesheet,
)
from ddpc_reports.fairness import fairness_statements
from ddpc_reports.figures.charts import COLOURS, CONFIG
from ddpc_reports.figures.figure import Figure, in_its_place, spread_figures, step_time_figure, time_figures
from ddpc_reports.numbers import as_given, with_unit
from ddpc_reports.sensitivity import effects_table, sensitivity_figures, sweep_statements, variants_table
from ddpc_reports.shares import share_statements
from ddpc_reports.tables.cases import cases_table, step_time_table
from ddpc_reports.tables.controllers import (
    across_table,
    reproduction_statements,
    reproduction_table,
    response_table,
    step_time_order,
    verdict_table,
)
from ddpc_reports.tables.diagnostics import diagnostics_tables
from ddpc_reports.tables.failures import failures_table
from ddpc_reports.tables.reproduce import reproduce_tables
from ddpc_reports.tables.settings import compact_seeds, family_tables, settings_tables
from ddpc_reports.tables.table import Table
from ddpc_reports.tuning import front_figures, trials_tables
from ddpc_reports.verdict import Statement, across_statements, limitations, verdict

_MOST_DRAWN = 4
"""Scenarios of a problem with figures over time: each costs some 300 kB of page."""
_MOST_LINES, _MOST_ROWS, _MOST_CASES = 45, 100, 1000
"""Of all scenarios, controllers with figures and with tables of their own; cases of several problems."""

_MOST_LISTED = 20
Block = tuple[str, Any]
"""A part of a section: its kind, which chooses how the template sets it, and what it is."""


@dataclass(frozen=True)
class Section:
    """One section of the page."""

    anchor: str
    title: str
    blocks: list[Block]


@dataclass(frozen=True)
class StudyPart:
    """What the page shows of one study."""

    id: str
    number: int
    title: str
    warnings: list[str]
    facts: dict[str, str]
    sections: list[Section]
    summary: str = ""
    source: str = ""


def render_page(results: Sequence[StudyResults]) -> str:
    """Return the page as HTML.

    Raises
    ------
    ValueError
        There are no results at all.
    """
    if not results:
        raise ValueError("a report needs the results of at least one study")
    results = on_one_page(results)
    data: dict[str, dict[str, Packed]] = {}
    parts: list[StudyPart] = []
    with np.errstate(over="ignore", invalid="ignore"):  # a run can have values of any size
        for one in results:
            if len(problems := one.problems()) > 1:
                parts.append(_overall_part(one, problems, len(parts) + 1))
            seen = [conditions(part) for part in problems]
            drawn, detailed = _first(seen, _MOST_LINES, _MOST_DRAWN), _first(seen, _MOST_ROWS)
            spread = drawn if len(problems) > 1 else detailed
            room = _Room(drawn, spread, detailed, len(problems) == 1 or len(one.cases) <= _MOST_CASES)
            for part, of_part in zip(problems, seen, strict=True):
                variants = one.variants(part.study.name)
                parts.append(_study_part(part, of_part, len(parts) + 1, data, room, variants))
    head = results[0].whole.head
    return set_page(parts, data, (head.title or head.name) if len(results) == 1 else "")


def set_page(studies: Sequence[StudyPart], data: Mapping[str, dict[str, Packed]], title: str = "") -> str:
    """Return the page of studies, or of what is set like one, with the samples that their figures draw."""
    scripts = [chart_library(), page_script()]
    environment = Environment(
        loader=PackageLoader("ddpc_reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=_shown,
    )
    return environment.get_template("page.html.jinja").render(
        studies=studies,
        title=title or (studies[0].title if len(studies) == 1 else f"{len(studies)} studies compared"),
        style=Markup(stylesheet()),
        scripts=[_Script(script) for script in scripts],
        policy=content_policy(scripts),
        data=Markup(json_for_script(_data(studies, data))),
        colours=COLOURS,
    )


class _Script(Markup):
    """A script: the page's policy has a hash of it, so that it must stay as it is."""


def _shown(value: Any) -> Any:
    """Return what the page has of a value: in texts, sentences and drawings nothing acts unseen."""
    return value if not isinstance(value, str) or isinstance(value, _Script) else printable(value, keep="\n")


class _Room(NamedTuple):
    """What of a study the page has room for.

    Parameters
    ----------
    drawn, spread, detailed : collection of Condition
        Scenarios with figures over time, with figures over the seeds, and with tables of their own.
    cases : bool
        Whether there are tables of all cases.
    """

    drawn: Collection[Condition]
    spread: Collection[Condition]
    detailed: Collection[Condition]
    cases: bool

    def left_out(self, seen: Sequence[Condition]) -> list[str]:
        """Say what of a problem is left out to keep the page small, and where it is found."""
        kinds = {
            "figures over time": self.drawn,
            "figures over the seeds": self.spread,
            "tables of their own": self.detailed,
        }
        missing = {
            what: tuple(one.label for one in seen if one not in shown) for what, shown in kinds.items()
        }
        found = [
            f"To keep the page small, these scenarios have no {what}: {', '.join(labels)}."
            for what, labels in missing.items()
            if labels
        ]
        if found and len(missing["figures over time"]) == len(seen):
            found.append("With run --only and the name of a problem, a report has room for all of this.")
        if seen and seen[0] not in self.detailed:
            found.append("Every setting of every controller, defaults filled in, is in study.toml.")
        return found if self.cases else [*found, "The cases are too many for a table: see metrics.csv."]


def _first(problems: Sequence[Sequence[Condition]], most: int, places: int | None = None) -> list[Condition]:
    """Return the first scenarios of the problems, as many of each as there is room for their controllers.

    The first of the only problem is always among them.
    """
    chosen: list[Condition] = []
    for of_place in islice(zip_longest(*problems), places):
        level = [condition for condition in of_place if condition]
        full = sum(len(one.controllers) for one in [*chosen, *level]) > most
        if full and (chosen or len(problems) > 1):
            break
        chosen += level
    return chosen


def _overall_part(results: StudyResults, problems: Sequence[StudyResults], number: int) -> StudyPart:
    """Return what is to be said over all problems of a study."""
    prefix, head = f"s{number}-", results.whole.head

    def blocks() -> list[Block]:
        found = overall(problems)
        if found is None:
            return [
                ("notes", ["Fewer than two problems have controllers in common that follow their reference."])
            ]
        figures = _figures(overall_figures(found, prefix), prefix)
        maps = distance_maps(found.distances, prefix) if found.distances else []
        return [
            *_statements(overall_statements(found)),
            *_tables(overall_table(found, prefix), *maps),
            *figures,
        ]

    what = "Ranks and profiles"
    sections = [Section("problems", what, _in_their_place(what, blocks))]
    facts = {"Problems": str(len(problems))} | _counts(results)
    title = f"{head.title or head.name}: all problems"
    return StudyPart(prefix, number, title, [], facts, sections, head.summary.strip())


def _study_part(
    results: StudyResults,
    seen: Sequence[Condition],
    number: int,
    data: dict[str, dict[str, Packed]],
    room: _Room,
    variants: Sequence[StudyResults] = (),
) -> StudyPart:
    prefix = f"s{number}-"
    first = seen[0] if seen else None
    detailed = [condition for condition in seen if condition in room.detailed]
    reproduction = results.study.report.reproduction if seen else None

    def each(what: str, blocks_of: Callable[[Condition, str], list[Block]]) -> list[Block]:
        """Return the blocks of every condition that has any, below its label where there are several."""
        found: list[Block] = []
        for place, condition in enumerate(seen, start=1):
            if condition not in room.detailed:
                continue
            if blocks := _in_their_place(what, partial(blocks_of, condition, f"{prefix}{place}-")):
                found += [("condition", condition.label)] if len(seen) > 1 else []
                found += blocks
        return found

    def time_blocks(condition: Condition, place: str) -> list[Block]:
        if not condition.controllers or condition not in room.drawn:
            return []
        figures, samples = time_figures(condition, place)
        packed = {name: {key: pack(column) for key, column in s.items()} for name, s in samples.items()}
        data.update(packed)
        return _figures(figures, place)

    def overview() -> list[Block]:
        return [*_statements(across_statements(seen)), *_tables(across_table(seen, prefix))]

    def settings() -> list[Block]:
        families = family_tables(first, prefix) if first and first in room.detailed else []
        parameters = [("see parameters", reproduction.parameters)] if reproduction else _tables(*families)
        return [*_tables(*settings_tables(results, first, prefix)), *parameters]

    parts: dict[tuple[str, str], Callable[[str], list[Block]]] = {
        ("damaged", "Damaged cases"): lambda _: _damaged_blocks(results),
        ("verdict", "Verdict"): lambda title: [
            *_in_their_place(title, overview),
            *each(title, _verdict_blocks),
            *_in_their_place("Failures and fallbacks", lambda: _tables(failures_table(results, prefix))),
        ],
        ("tuning", "Tuning"): lambda _: [
            *_tables(*trials_tables(results, prefix)),
            *_figures(front_figures(results, prefix), prefix),
        ],
        ("sure", "How sure"): lambda title: each(title, _certainty_blocks),
        ("fairness", "Fairness"): lambda _: _statements(fairness_statements(results, seen)),
        ("reproduction", "Reproduction"): lambda _: _reproduction_blocks(first, reproduction, prefix),
        ("figures", "Figures"): lambda title: [("help", ""), *each(title, time_blocks)],
        ("spread", "Spread over seeds"): lambda title: each(
            title, lambda *one: _figures(spread_figures(*one) if one[0] in room.spread else [], one[1])
        ),
        ("sensitivity", "Sensitivity"): lambda title: each(
            title,
            lambda *one: [*_figures(sensitivity_figures(*one), one[1]), *_tables(effects_table(*one))],
        ),
        ("sweep", "Sweep of the study"): lambda title: each(
            title, lambda condition, place: _tables(variants_table(condition, variants, place))
        ),
        ("time", "Computation time"): lambda title: each(
            title, lambda *one: _step_time_blocks(*one, drawn=one[0] in room.spread)
        ),
        ("data", "Data diagnostics"): lambda _: _tables(*diagnostics_tables(detailed, prefix)),
        ("settings", "Settings"): lambda _: settings(),
        ("limitations", "Known limitations"): lambda _: [
            ("notes", [*limitations(seen), *room.left_out(seen)])
        ],
        ("cases", "Every case"): lambda _: _tables(
            cases_table(results, seen, prefix) if room.cases else None
        ),
        ("provenance", "How to reproduce"): lambda _: _tables(*reproduce_tables(results, prefix)),
    }
    sections = [
        Section(anchor, title, _in_their_place(title, partial(blocks_of, title)))
        for (anchor, title), blocks_of in parts.items()
    ]
    title = results.study.title or results.study.name
    shown = [section for section in sections if any(kind != "help" for kind, _ in section.blocks)]
    first_lines = following_lines(results.study, results.cases)
    summary, source = results.study.summary.strip(), results.study.source
    return StudyPart(prefix, number, title, first_lines, _facts(results), shown, summary, source)


def _damaged_blocks(results: StudyResults) -> list[Block]:
    """Say which cases are left out because their files are not what the run wrote."""
    if not results.damaged:
        return []
    damaged, total = list(results.damaged.values()), len(results.damaged) + len(results.cases)
    first = (
        f"{len(damaged)} of {total} cases are damaged and left out: all that follows is of the others. "
        "Run the study again with the same folder of results: only they are run."
    )
    more = len(damaged) - _MOST_LISTED
    rest = [f"and {more} more"] if more > 0 else []
    return [("notes", [first, *damaged[:_MOST_LISTED], *rest])]


def _tables(*tables: Table | None) -> list[Block]:
    return [("table", table) for table in tables if table]


def _statements(statements: list[Statement]) -> list[Block]:
    return [("statements", statements)] if statements else []


def _figures(figures: Iterable[Figure | str | None], group: str) -> list[Block]:
    """Return figures, and the sentences in the place of others."""
    return [
        ("notes", [figure]) if isinstance(figure, str) else ("figure", (figure, group))
        for figure in figures
        if figure
    ]


def _in_their_place(what: str, blocks_of: Callable[[], list[Block]]) -> list[Block]:
    blocks = in_its_place(what, blocks_of)
    return [("notes", [blocks])] if isinstance(blocks, str) else blocks


def _verdict_blocks(condition: Condition, prefix: str) -> list[Block]:
    # With `run --only` there may be variants of a sweep alone.
    if not condition.controllers:
        return _statements(sweep_statements(condition))
    statements = share_statements(condition) + verdict(condition) + sweep_statements(condition)
    return [
        *_statements(statements),
        *_tables(verdict_table(condition, prefix), response_table(condition, prefix)),
    ]


def _certainty_blocks(condition: Condition, prefix: str) -> list[Block]:
    return [*_statements(certainty_statements(condition)), *_tables(certainty_table(condition, prefix))]


def _step_time_blocks(condition: Condition, prefix: str, *, drawn: bool) -> list[Block]:
    if not condition.controllers:
        return []
    table = step_time_table(condition, prefix)
    return [
        *_statements(step_time_order(condition)),
        *_tables(table),
        *_figures([step_time_figure(condition, prefix)] if drawn else [], prefix),
    ]


def _reproduction_blocks(
    first: Condition | None, reproduction: Reproduction | None, prefix: str
) -> list[Block]:
    if not reproduction or not first:
        return []
    return [
        *_tables(reproduction_table(first, reproduction, prefix)),
        *_statements(reproduction_statements(first, reproduction)),
        *([("notes", reproduction.notes)] if reproduction.notes else []),
        ("parameters", reproduction.parameters),
        *_tables(*family_tables(first, prefix)),
    ]


def _facts(results: StudyResults) -> dict[str, str]:
    """Return the strip of key facts under the title."""
    study = results.study
    facts = {
        "Plant": study.plant.name or study.plant.fmu,
        "Sampling time": with_unit(as_given(study.loop.sampling_time), "s"),
        "Duration": with_unit(as_given(study.loop.duration), "s"),
        "Controllers": _controllers_words(results),
        "Scenarios": str(len({case.scenario for case in results.cases})),
        **_counts(results),
    }
    if facts["Scenarios"] == "1":
        del facts["Scenarios"]
    return facts


def _counts(results: StudyResults) -> dict[str, str]:
    """Return the seeds, and how many cases there are and came to something."""
    total = len(results.cases)
    done = sum(case.outcome is Outcome.COMPLETED for case in results.cases)
    held = sum(case.holds for case in results.cases)
    facts = {
        "Seeds": compact_seeds(list(dict.fromkeys(case.seed for case in results.cases))),
        "Cases completed": f"{done} of {total}",
        "Near the reference": f"{held} of {total}",
    }
    if held == total:
        del facts["Near the reference"]
    return facts


def _controllers_words(results: StudyResults) -> str:
    sections = results.study.controllers
    names = {case.controller for case in results.cases}
    varied = {name for name in names if name in sections and sections[name].variant_of}
    settings = f"{len(varied)} {'setting' if len(varied) == 1 else 'settings'} in sweeps"
    own = str(len(names - varied))
    return f"{own}, and {settings}" if varied and names - varied else settings if varied else own


def _data(studies: Sequence[StudyPart], data: Mapping[str, dict[str, Packed]]) -> dict[str, Any]:
    """Return what the script draws from: samples once, and a specification for each chart."""
    blocks = [block for study in studies for section in study.sections for block in section.blocks]
    views = {}
    for figure, group in (content for kind, content in blocks if kind == "figure"):
        labels = {entry.name: entry.label for entry in figure.legend}
        for view in figure.views:
            views[view.id] = {
                "group": group,
                "figure": figure.id,
                "spec": view.spec,
                "data": view.data,
                "lines": {name: labels[name] for name in view.names},
                "unit": view.unit,
                "scaled": list(view.scaled_by),
                "limits": list(view.limits),
            }
    return {"config": CONFIG, "colours": COLOURS, "data": data, "views": drawable(views)}
