"""What the page shows of each study: the answer and its table first, then section by section."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import islice, zip_longest
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from ddpc_cosim import Outcome, ReportSection, StudyResults
from ddpc_cosim.files.tables import Table
from ddpc_cosim.files.texts import clipped, without_folders
from ddpc_cosim.metrics import metric_of
from ddpc_cosim.study.verdicts.findings import Findings, findings_of
from ddpc_cosim.study.verdicts.reliability import Reliability, reliability
from ddpc_cosim.study.verdicts.standings import Standings
from ddpc_reports.across_problems import (
    RANKS_NOTE,
    Overall,
    first_columns,
    overall,
    overall_answer,
    overall_figures,
    overall_statements,
    overall_table,
)
from ddpc_reports.against import Baselines, OverallBaselines, baselines_of
from ddpc_reports.answer import answer
from ddpc_reports.certainty import certainty_tables
from ddpc_reports.comparison import Condition, ControllerResults, conditions, on_one_page
from ddpc_reports.distances import distance_maps
from ddpc_reports.embedding import Packed, pack
from ddpc_reports.fairness import fairness_statements
from ddpc_reports.figures.figure import (
    Entry,
    Figure,
    entry,
    in_its_place,
    spread_figures,
    step_time_figure,
)
from ddpc_reports.figures.over_time import Kind, TimeFigures, time_figures
from ddpc_reports.figures.planes import plane_figure
from ddpc_reports.figures.promises import promise_figures, promise_table
from ddpc_reports.figures.trade import trade_figure
from ddpc_reports.numbers import given_time
from ddpc_reports.reliability import (
    association_table,
    reliability_statements,
    reliability_table,
    tail_figures,
)
from ddpc_reports.requirements import overall_words, requirements_table, requirements_words
from ddpc_reports.sensitivity import (
    effects_table,
    sensitivity_figures,
    sweep_statements,
    variants_table,
    worth_table,
)
from ddpc_reports.shares import share_statements
from ddpc_reports.tables.cases import cases_table, step_time_table
from ddpc_reports.tables.controllers import (
    claims_table,
    key_figures_table,
    limits_table,
    reproduction_statements,
    reproduction_table,
    response_table,
)
from ddpc_reports.tables.diagnostics import diagnostics_tables
from ddpc_reports.tables.failures import failures_table
from ddpc_reports.tables.ranking import (
    Place,
    in_order,
    matrix_table,
    rank_columns,
    rank_notes,
    ranking_table,
)
from ddpc_reports.tables.reproduce import reproduce_tables
from ddpc_reports.tables.settings import compact_seeds, family_tables, settings_tables, slug
from ddpc_reports.third_parties import own_blocks, own_sections
from ddpc_reports.tuning import front_figures, trials_tables
from ddpc_reports.verdict import Statement, across_statements, findings, limitations
from ddpc_reports.why import why_statements

_LONGEST_TITLE = 120
_MOST_DRAWN = 4
"""Scenarios of a problem with figures over time: each costs some 300 kB of page."""
_MOST_LINES, _MOST_SKETCHED, _MOST_ROWS, _MOST_CASES = 30, 160, 100, 1000
"""Of all scenarios, controllers with figures, with responses, with tables; cases of several problems."""

_USUAL_SAMPLES = 500
_MOST_LISTED = 20
Block = tuple[str, Any]
"""A part of a section: its kind, which chooses how it is set, and what it is."""


@dataclass(frozen=True)
class OfScenario:
    """What a section says of one of several scenarios: the page shows one of them at a time.

    Parameters
    ----------
    name, label : str
        Of the scenario, in the study and for people.
    blocks : list of Block
        What stands below its label.
    """

    name: str
    label: str
    blocks: list[Block]


def one_by_one(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield blocks, those of a scenario below its label, as formats have them that show all scenarios."""
    for kind, content in blocks:
        if kind == "scenario":
            yield "condition", content.label
            yield from content.blocks
        else:
            yield kind, content


@dataclass(frozen=True)
class Section:
    """One section of the page; one that is folded opens by a click."""

    anchor: str
    title: str
    blocks: list[Block]
    folded: bool = False


@dataclass(frozen=True)
class LegendEntry:
    """A controller in the legend of the page.

    Parameters
    ----------
    key : str
        Of the controller, by which the address of the page names it.
    line : Entry
        How it is drawn, and its label.
    notes : dict of str to str
        By scenario how its first seed ended, where that was not as it should be.
    """

    key: str
    line: Entry
    notes: dict[str, str]


@dataclass(frozen=True)
class StudyPart:
    """What the page shows of one study.

    Parameters
    ----------
    id : str
        What the names of all its parts in the page begin with.
    number : int
        Its place in the page, from one.
    title : str
        Of the study.
    warnings : list of str
        What must be known before anything is read.
    facts : dict of str to str
        Plant, times, seeds and cases, in a line.
    answer : Markup
        Who is ahead, and how sure that is.
    first : list of Block
        The table of the first screen, and what belongs to it.
    sections : list of Section
        All the rest, in its order.
    summary, source : str
        What the study says of itself.
    remarks : list of str
        What the ranking does not say.
    comment : str
        What its author says of the results.
    name : str
        What the address of the page calls it.
    scenarios : dict of str to str
        Labels of the scenarios of which one is shown at a time, by name; empty where there is only one.
    chosen : str
        The scenario that is shown first.
    legend : list of LegendEntry
        The controllers that are drawn, in the order of their ranks.
    """

    id: str
    number: int
    title: str
    warnings: list[str]
    facts: dict[str, str]
    answer: Markup
    first: list[Block]
    sections: list[Section]
    summary: str = ""
    source: str = ""
    remarks: list[str] = field(default_factory=list)
    comment: str = ""
    name: str = ""
    scenarios: dict[str, str] = field(default_factory=dict)
    chosen: str = ""
    legend: list[LegendEntry] = field(default_factory=list)


@dataclass(frozen=True)
class Gathered:
    """The parts of a page, and the samples that its figures draw."""

    title: str
    parts: list[StudyPart]
    data: dict[str, dict[str, Packed]]


def gather(results: Sequence[StudyResults]) -> Gathered:
    """Return what is to be said about the results of one or several studies.

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
        for study_results in results:
            problems = study_results.problems()
            seen = [conditions(part) for part in problems]
            by_need = [_chosen_first(of_part) for of_part in seen]
            drawn = _first(by_need, _MOST_LINES, _MOST_DRAWN, _lines)
            detailed = _first(by_need, _MOST_ROWS)
            spread = drawn if len(problems) > 1 else detailed
            sketched = {*drawn, *_first(by_need, _MOST_SKETCHED)}
            every_case = len(problems) == 1 or len(study_results.cases) <= _MOST_CASES
            budget = _PageBudget(drawn, sketched, spread, detailed, every_case)
            number = len(parts) + 1
            if len(problems) > 1:
                parts.append(_overall_part(study_results, problems, seen, number, budget))
            for part, of_part in zip(problems, seen, strict=True):
                variants = study_results.variants(part.study.name)
                alone = len(problems) == 1
                parts.append(_study_part(part, of_part, len(parts) + 1, data, budget, variants, alone=alone))
    head = results[0].whole.head
    several = f"{len(results)} studies compared"
    title = clipped(head.title or head.name, _LONGEST_TITLE) if len(results) == 1 else several
    return Gathered(title, parts, data)


class _PageBudget(NamedTuple):
    """What of a study the page shows, so that it stays small.

    Parameters
    ----------
    drawn, sketched, spread, detailed : collection of Condition
        Scenarios with figures over time, with responses at least, with figures over the seeds, and with
        tables of their own.
    cases : bool
        Whether there are tables of all cases.
    """

    drawn: Collection[Condition]
    sketched: Collection[Condition]
    spread: Collection[Condition]
    detailed: Collection[Condition]
    cases: bool

    def left_out(self, seen: Sequence[Condition]) -> list[str]:
        """Say what of a problem is left out to keep the page small, and where it is found."""
        kinds = {
            "figures over time": self.sketched,
            "figures of errors and control signals": self.drawn,
            "figures over the seeds": self.spread,
            "tables of their own": self.detailed,
        }
        missing = {
            what: tuple(condition.label for condition in seen if condition not in shown)
            for what, shown in kinds.items()
        }
        sentences = [
            f"To keep the page small, these scenarios have no {what}: {'; '.join(labels)}."
            for what, labels in missing.items()
            if labels
        ]
        if sentences and len(missing["figures of errors and control signals"]) == len(seen):
            sentences.append("With run --only and the name of a problem, a report has room for all of this.")
        if seen and not any(condition in self.detailed for condition in seen):
            sentences.append("Every setting of every controller, defaults filled in, is in study.toml.")
        if not self.cases:
            sentences.append("The cases are too many for a table: see metrics.csv.")
        return sentences


def _chosen_first(seen: Sequence[Condition]) -> list[Condition]:
    """Return the scenarios of a problem, the one that is shown first before all others.

    It is that of the study, or the one in which the most runs fail, of those the one with the worst figures.
    """
    named = [condition for condition in seen if condition.scenario == condition.results.study.report.scenario]
    first = max(named or seen, key=_hardship, default=None)
    return sorted(seen, key=lambda condition: condition is not first)


def _hardship(condition: Condition) -> tuple[float, float]:
    """Return the share of failed runs, and the median of what controllers are ranked by, larger if worse."""
    failed = [case.failed for controller in condition.contenders for case in controller.cases]
    ranks = [
        metric_of(key).rank(value) for key in condition.headline[:1] for value, _ in condition.ranking(key)
    ]
    return sum(failed) / max(len(failed), 1), median(ranks) if ranks else -math.inf


def _rows(condition: Condition) -> float:
    """Return how many rows the tables of a scenario have."""
    return len(condition.controllers)


def _lines(condition: Condition) -> float:
    """Return how many lines of a usual length the figures over time of a scenario have."""
    loop = condition.results.study.loop
    return len(condition.controllers) * max(loop.duration / loop.sampling_time / _USUAL_SAMPLES, 1.0)


def _first(
    problems: Sequence[Sequence[Condition]],
    most: int,
    places: int | None = None,
    size: Callable[[Condition], float] = _rows,
) -> list[Condition]:
    """Return the first scenarios of the problems, as many of each as there is room for.

    The first of the only problem is always among them.
    """
    chosen: list[Condition] = []
    for of_place in islice(zip_longest(*problems), places):
        level = [condition for condition in of_place if condition]
        full = sum(map(size, [*chosen, *level])) > most
        if full and (chosen or len(problems) > 1):
            break
        chosen += level
    return chosen


def _overall_part(
    results: StudyResults,
    problems: Sequence[StudyResults],
    seen: Sequence[Sequence[Condition]],
    number: int,
    budget: _PageBudget,
) -> StudyPart:
    """Return what is to be said over all problems of a study."""
    prefix, head = f"s{number}-", results.whole.head
    comparison = in_its_place("Ranks", lambda: overall(problems))
    answered, first, sections = Markup(""), list[Block](), list[Section]()
    rows = _rows_over_problems(comparison if isinstance(comparison, Overall) else None, seen)
    if isinstance(comparison, Overall):
        places = [
            place
            for i, (part, of_part) in enumerate(zip(problems, seen, strict=True), start=number + 1)
            for place in _places(part, of_part, f"s{i}-", budget)
        ]
        answered = overall_answer(comparison)
        baselines = OverallBaselines(
            [
                baselines_of(standing, part.cases, rows, part.study.report.baseline)
                for standing, part in zip(comparison.findings.standings, problems, strict=True)
            ],
            rows,
        )
        matrix = partial(_overall_matrix, comparison, places, baselines, prefix)
        first = _in_their_place("Matrix", matrix)
        what = "Performance profile and critical differences"
        blocks = partial(_overall_blocks, comparison, prefix)
        sections = [Section("problems", what, _in_their_place(what, blocks))]
    else:
        few = "Fewer than two problems have controllers in common that do not all fail."
        first = [("notes", [comparison or few])]
    if words := overall_words(problems):
        first = [("paragraph", words), *first]
    how = "How to reproduce"
    made = _in_their_place(how, lambda: _tables(*reproduce_tables(results, prefix)))
    sections.append(Section("provenance", how, made, folded=True))
    facts = {"Problems": str(len(problems))} | _counts(results) | _author(problems[0])
    title = (
        "All problems" if number == 1 else f"{clipped(head.title or head.name, _LONGEST_TITLE)}: all problems"
    )
    return StudyPart(
        prefix,
        number,
        title,
        [],
        facts,
        answered,
        first,
        sections,
        head.summary.strip(),
        name="all" if number == 1 else f"{head.name}-all",
        legend=[LegendEntry(row.key, entry(row, of_first=False), {}) for row in rows],
    )


def _overall_blocks(comparison: Overall, prefix: str) -> list[Block]:
    maps = distance_maps(comparison.distances, prefix) if comparison.distances else []
    return [
        *_figures(overall_figures(comparison, prefix), prefix),
        *_statements(overall_statements(comparison)),
        *_tables(overall_table(comparison, prefix), *maps),
    ]


def _rows_over_problems(
    comparison: Overall | None, seen: Sequence[Sequence[Condition]]
) -> list[ControllerResults]:
    """Return the controllers of all problems, first those that are ranked over all, in that order."""
    members = {
        controller.key: controller
        for of_part in seen
        for condition in of_part
        for controller in condition.controllers
    }
    ranked = comparison.controllers if comparison else ()
    order = [*ranked, *(key for key in members if key not in ranked)]
    return [members[key] for key in order if key in members]


def _overall_matrix(
    comparison: Overall, places: Sequence[Place], baselines: OverallBaselines, prefix: str
) -> list[Block]:
    columns, notes = first_columns(comparison, baselines), [RANKS_NOTE, *baselines.notes()]
    table = matrix_table(places, baselines.order, columns, notes, prefix)
    return [*_tables(table), *_baseline(baselines.choice(f"{prefix}matrix"))]


def _baseline(choice: dict[str, Any] | None) -> list[Block]:
    """Return what lets the reader choose a baseline; other formats than the page leave it out."""
    return [("baseline", choice)] if choice else []


def _places(
    results: StudyResults, seen: Sequence[Condition], prefix: str, budget: _PageBudget
) -> list[Place]:
    """Return the scenarios of a problem, each with where the page has its figures, or its problem's part."""
    title = clipped(results.study.title or results.study.name, _LONGEST_TITLE)
    return [
        Place(
            title,
            condition,
            f"#{prefix}{number}-responses" if condition in budget.sketched else f"#{prefix}study",
        )
        for number, condition in enumerate(seen, start=1)
        if condition.controllers
    ]


@dataclass(frozen=True)
class _Part:
    """One problem while its part of the page is made."""

    results: StudyResults
    seen: Sequence[Condition]
    prefix: str
    data: dict[str, dict[str, Packed]]
    budget: _PageBudget
    variants: Sequence[StudyResults]
    alone: bool
    _over_time: dict[str, TimeFigures] = field(default_factory=dict)

    @cached_property
    def findings(self) -> Findings:
        """What the results show, over all scenarios."""
        return findings_of(self.results.study, self.results.cases)

    @property
    def standings(self) -> Standings:
        """Where the controllers stand, over all scenarios."""
        return self.findings.standings

    def each(
        self,
        what: str,
        blocks_of: Callable[[Condition, str], list[Block]],
        shown: Collection[Condition] | None = None,
    ) -> list[Block]:
        """Return the blocks of every condition that has any, below its label where there are several."""
        collected: list[Block] = []
        shown = self.budget.detailed if shown is None else shown
        for place, condition in enumerate(self.seen, start=1):
            if condition not in shown:
                continue
            if blocks := _in_their_place(what, partial(blocks_of, condition, f"{self.prefix}{place}-")):
                several = len(self.seen) > 1
                part = OfScenario(condition.scenario, condition.label, blocks)
                collected += [("scenario", part)] if several else blocks
        return collected

    def over_time(self, kind: Kind, condition: Condition, place: str) -> list[Block]:
        """Return the figures over time of a kind; they are made together, and their samples kept."""
        if not condition.controllers:
            return []
        if place not in self._over_time:
            sketched = condition not in self.budget.drawn
            figures = self._over_time[place] = time_figures(condition, place, sketched=sketched)
            for name, columns in figures.samples.items():
                self.data[name] = {key: pack(column) for key, column in columns.items()}
        return _figures(self._over_time[place].figures[kind], place)

    def table(self) -> list[Block]:
        """Return the table of the first screen: of one scenario its ranking, of several a matrix."""
        shown = [condition for condition in self.seen if condition.controllers]
        if len(shown) == 1:
            return [
                *_tables(ranking_table(shown[0], self.standings, self.prefix)),
                *self._choice("ranking", in_order(shown[0].controllers, self.standings)),
            ]
        if not shown:
            return []
        members = {controller.key: controller for condition in shown for controller in condition.controllers}
        order = in_order([*members.values()], self.standings)
        labels = {condition.scenario: condition.label for condition in self.seen}
        baselines = self._baselines(order)
        return [
            *_tables(
                matrix_table(
                    _places(self.results, self.seen, self.prefix, self.budget),
                    order,
                    rank_columns(self.standings, baselines),
                    [*rank_notes(self.standings, labels), *baselines.notes()],
                    self.prefix,
                )
            ),
            *self._choice("matrix", order),
        ]

    def _baselines(self, order: Sequence[ControllerResults]) -> Baselines:
        results = self.results
        return baselines_of(self.standings, results.cases, order, results.study.report.baseline)

    def _choice(self, table: str, order: Sequence[ControllerResults]) -> list[Block]:
        return _baseline(self._baselines(order).choice(f"{self.prefix}{table}"))

    def first(self) -> list[Block]:
        """Return what stands below the answer: the table, what settings of sweeps and tuning are worth."""
        return [
            *_in_their_place("Requirements", self._decision),
            *_in_their_place("Ranking", self.table),
            *_in_their_place("Requirements", self._required),
            *_in_their_place("Comfort against money", self._trade),
            *_in_their_place("Claims", lambda: _tables(claims_table(self.results, self.prefix))),
            *_in_their_place("Sweeps", self._swept),
            *_in_their_place("Tuning", self._tuned),
        ]

    def _decision(self) -> list[Block]:
        words = requirements_words(self.findings.requirements)
        return [("paragraph", words)] if words else []

    def _required(self) -> list[Block]:
        members = {member.key: member for condition in self.seen for member in condition.controllers}
        members |= {member.key: member for condition in self.seen for member in condition.variants}
        order = in_order([*members.values()], self.standings)
        return _tables(requirements_table(self.findings.requirements, order, self.prefix))

    def _trade(self) -> list[Block]:
        shown = [condition for condition in self.seen if condition in self.budget.spread]
        return _figures([trade_figure(shown, self.prefix)], self.prefix)

    def _swept(self) -> list[Block]:
        places = [(condition, f"{self.prefix}{i}-") for i, condition in enumerate(self.seen, start=1)]
        worth = [worth_table(*place) for place in places]
        return _tables(
            *worth, *(variants_table(condition, self.variants, place) for condition, place in places[:1])
        )

    def _tuned(self) -> list[Block]:
        fronts = _figures(front_figures(self.results, self.prefix), self.prefix)
        return [*_tables(*trials_tables(self.results, self.prefix)), *fronts]

    def sections(self) -> list[Section]:
        """Return the sections in their order, those without anything to show left out."""
        parts: list[tuple[str, str, Callable[[str], list[Block]]]] = [
            ("responses", "Responses", self._figures_over_time("responses")),
            ("errors", "Errors", self._figures_over_time("errors")),
            ("control", "Control signals", self._figures_over_time("inputs")),
            ("planes", "Phase plane", self._each(self._planes)),
            ("why", "Why they lost", self._each(_why_blocks)),
            ("distribution", "Distribution over seeds and paired differences", self._distribution),
            ("reliability", "How often it fails", self._each(self._reliability)),
            ("response", "Step response", self._each(_response_blocks)),
            ("limits", "Limits and actuators", self._each(_limits_blocks)),
            ("key-figures", "Key figures", self._each(_key_figures_blocks)),
            ("time", "Computation time", self._each(self._step_times)),
            ("reproduction", "Reproduction", lambda _: self._reproduction()),
            ("sensitivity", "Sensitivity", self._each(_sensitivity_blocks)),
            ("data", "Data diagnostics", lambda _: self._diagnostics()),
            ("failures", "Failures and fallbacks", self._failures),
            ("fairness", "Fairness and known limitations", lambda _: self._fairness()),
            ("settings", "Settings", lambda _: self._settings()),
            ("cases", "Every case", lambda _: self._cases()),
            ("provenance", "How to reproduce", lambda _: self._how_to_reproduce()),
        ]
        for name, report_section in own_sections().items():
            titles = [title for _, title, _ in parts]
            after = report_section.after
            place = titles.index(after) + 1 if after in titles else titles.index(_LAST)
            anchor = f"own-{slug(name)}"
            parts.insert(place, (anchor, str(report_section.title), self._own(report_section, anchor)))
        made = [
            Section(anchor, title, _in_their_place(title, partial(blocks_of, title)), anchor in _FOLDED)
            for anchor, title, blocks_of in parts
        ]
        return [section for section in made if section.blocks]

    def legend(self) -> list[LegendEntry]:
        """Return the controllers in the order of their ranks, and where the first run of each failed."""
        by_key: dict[str, ControllerResults] = {}
        notes: dict[str, dict[str, str]] = {}
        for condition in self.seen:
            for controller in condition.controllers:
                by_key.setdefault(controller.key, controller)
                if note := entry(controller).note:
                    notes.setdefault(controller.key, {})[condition.scenario] = note
        order = in_order([*by_key.values()], self.standings)
        return [
            LegendEntry(controller.key, entry(controller, of_first=False), notes.get(controller.key, {}))
            for controller in order
        ]

    def _how_to_reproduce(self) -> list[Block]:
        """Return what was run; of one of several problems that stands with what is said over all of them."""
        return _tables(*reproduce_tables(self.results, self.prefix)) if self.alone else []

    def _own(self, report_section: ReportSection, anchor: str) -> Callable[[str], list[Block]]:
        return lambda _: own_blocks(report_section, self.results, f"{self.prefix}{anchor}-")

    def _figures_over_time(self, kind: Kind) -> Callable[[str], list[Block]]:
        return lambda title: self.each(title, partial(self.over_time, kind), self.budget.sketched)

    def _each(self, blocks_of: Callable[[Condition, str], list[Block]]) -> Callable[[str], list[Block]]:
        return lambda title: self.each(title, blocks_of)

    def _distribution(self, title: str) -> list[Block]:
        return [*_statements(across_statements(self.seen)), *self.each(title, self._spread)]

    def _spread(self, condition: Condition, prefix: str) -> list[Block]:
        said = [*share_statements(condition), *findings(condition, "distribution")]
        figures = spread_figures(condition, prefix) if condition in self.budget.spread else []
        return [
            *_figures([*figures[:1], *(replace(figure, folded=True) for figure in figures[1:])], prefix),
            *_statements(said),
            *_tables(*certainty_tables(condition, prefix)),
        ]

    @cached_property
    def reliabilities(self) -> list[Reliability]:
        """How each controller does over the seeds of each scenario."""
        return reliability(self.results.study, self.results.cases)

    def _reliability(self, condition: Condition, prefix: str) -> list[Block]:
        shown = [item for item in self.reliabilities if item.scenario == condition.scenario]
        shown.sort(key=lambda item: [*condition.by_key].index(item.controller))
        if not shown:
            return []
        figures = tail_figures(condition, shown, prefix) if condition in self.budget.spread else []
        return [
            *_statements(reliability_statements(condition, shown)),
            *_tables(reliability_table(condition, shown, prefix)),
            *_figures(figures, prefix),
            *_tables(association_table(condition, shown, prefix)),
        ]

    def _planes(self, condition: Condition, prefix: str) -> list[Block]:
        return _figures([plane_figure(condition, prefix)] if condition in self.budget.drawn else [], prefix)

    def _step_times(self, condition: Condition, prefix: str) -> list[Block]:
        if not condition.controllers:
            return []
        figure = step_time_figure(condition, prefix) if condition in self.budget.spread else None
        return [
            *_statements(findings(condition, "time")),
            *_tables(step_time_table(condition, prefix)),
            *_figures([figure and replace(figure, folded=True)], prefix),
        ]

    def _reproduction(self) -> list[Block]:
        reproduction = self.results.study.report.reproduction if self.seen else None
        if not reproduction:
            return []
        return [
            *_tables(reproduction_table(self.seen[0], reproduction, self.prefix)),
            *_statements(reproduction_statements(self.seen[0], reproduction)),
            *([("notes", reproduction.notes)] if reproduction.notes else []),
        ]

    def _failures(self, title: str) -> list[Block]:
        return [
            *self.each(title, lambda condition, _: _statements(findings(condition, "failures"))),
            *_tables(failures_table(self.results, self.prefix)),
        ]

    def _diagnostics(self) -> list[Block]:
        detailed = [condition for condition in self.seen if condition in self.budget.detailed]
        treated = self.results.provenance.get("logged data")
        said = f"What was done to the logged data before controllers learned from them: {treated}."
        return [
            *_tables(*diagnostics_tables(detailed, self.prefix)),
            *([("notes", [said])] if treated else []),
        ]

    def _fairness(self) -> list[Block]:
        notes = [*limitations(self.seen), *self.budget.left_out(self.seen)]
        return [*_statements(fairness_statements(self.results, self.seen)), ("notes", notes)]

    def _settings(self) -> list[Block]:
        first = self.seen[0] if self.seen else None
        detailed = [condition for condition in self.seen if condition in self.budget.detailed]
        families = family_tables(detailed[0], self.prefix) if detailed else []
        reproduction = self.results.study.report.reproduction if first else None
        return [
            *_tables(*settings_tables(self.results, first, self.prefix)),
            *([("condition", reproduction.parameters)] if reproduction else []),
            *_tables(*families),
        ]

    def _cases(self) -> list[Block]:
        return _tables(cases_table(self.results, self.seen, self.prefix) if self.budget.cases else None)


_FOLDED = ("data", "settings", "cases", "provenance")
_LAST = "Fairness and known limitations"
"""The title before which sections of third parties stand that do not say where."""


def _study_part(
    results: StudyResults,
    seen: Sequence[Condition],
    number: int,
    data: dict[str, dict[str, Packed]],
    budget: _PageBudget,
    variants: Sequence[StudyResults],
    *,
    alone: bool,
) -> StudyPart:
    prefix = f"s{number}-"
    part = _Part(results, seen, prefix, data, budget, variants, alone)
    said = in_its_place("Answer", lambda: answer(results, seen, part.findings))
    remarks = part.findings.remarks
    legend = in_its_place("Legend", part.legend)
    several = {condition.scenario: condition.label for condition in seen} if len(seen) > 1 else {}
    return StudyPart(
        prefix,
        number,
        results.study.title or results.study.name,
        [remark.text for remark in remarks if remark.is_failure],
        _facts(results),
        said if isinstance(said, Markup) else Markup.escape(said),
        [*_damaged_blocks(results), *part.first()],
        part.sections(),
        results.study.summary.strip(),
        results.study.source,
        [remark.text for remark in remarks if not remark.is_failure],
        comment=results.study.report.comment.strip(),
        name=results.study.name,
        scenarios=several,
        chosen=_chosen_first(seen)[0].scenario if several else "",
        legend=[] if isinstance(legend, str) else legend,
    )


def _why_blocks(condition: Condition, prefix: str) -> list[Block]:
    return _statements(why_statements(condition))


def _response_blocks(condition: Condition, prefix: str) -> list[Block]:
    if not condition.controllers:
        return []
    return [*_statements(findings(condition, "response")), *_tables(response_table(condition, prefix))]


def _limits_blocks(condition: Condition, prefix: str) -> list[Block]:
    if not condition.controllers:
        return []
    return [
        *_statements(findings(condition, "limits")),
        *_figures(promise_figures(condition, prefix), prefix),
        *_tables(promise_table(condition, prefix), limits_table(condition, prefix)),
    ]


def _key_figures_blocks(condition: Condition, prefix: str) -> list[Block]:
    return _tables(key_figures_table(condition, prefix)) if condition.controllers else []


def _sensitivity_blocks(condition: Condition, prefix: str) -> list[Block]:
    return [
        *_statements(sweep_statements(condition)),
        *_figures(sensitivity_figures(condition, prefix), prefix),
        *_tables(effects_table(condition, prefix)),
    ]


def _damaged_blocks(results: StudyResults) -> list[Block]:
    """Say which cases are left out because their files are not what the run wrote."""
    if not results.damaged:
        return []
    damaged = [*map(without_folders, results.damaged.values())]
    total = len(damaged) + len(results.cases) + len(results.resting)
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


def _facts(results: StudyResults) -> dict[str, str]:
    """Return the strip of key facts under the title."""
    study = results.study
    facts = {
        "Plant": clipped(study.plant.label),
        "Sampling time": given_time(study.loop.sampling_time),
        "Duration": given_time(study.loop.duration),
        "Controllers": _controllers_words(results),
        "Scenarios": str(len({case.scenario for case in results.cases})),
        **_counts(results),
        **_author(results),
    }
    if facts["Scenarios"] == "1":
        del facts["Scenarios"]
    return facts


def _author(results: StudyResults) -> dict[str, str]:
    author = results.study.report.author.strip()
    return {"Author": author} if author else {}


def _counts(results: StudyResults) -> dict[str, str]:
    """Return the seeds, and how many cases there are and came to something."""
    total = len(results.cases)
    done = sum(case.outcome is Outcome.COMPLETED for case in results.cases)
    failed = sum(case.failed for case in results.cases)
    facts = {
        "Seeds": compact_seeds(list(dict.fromkeys(case.seed for case in results.cases))),
        "Cases completed": f"{done} of {total}",
    }
    return facts | ({"Failed": f"{failed} of {total}"} if failed else {})


def _controllers_words(results: StudyResults) -> str:
    sections = results.study.controllers
    names = {case.controller for case in results.cases}
    varied = {name for name in names if name in sections and sections[name].variant_of}
    settings = f"{len(varied)} {'setting' if len(varied) == 1 else 'settings'} in sweeps"
    unvaried = str(len(names - varied))
    return f"{unvaried}, and {settings}" if varied and names - varied else settings if varied else unvaried
