"""The page: studies gathered, tables and figures made, templates filled."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ddpc_cosim import Outcome, StudyResults
from ddpc_reports.case_tables import (
    cases_table,
    failures_table,
    fallbacks_table,
    provenance_table,
    step_time_table,
)
from ddpc_reports.charts import COLOURS, CONFIG
from ddpc_reports.comparison import Condition, conditions
from ddpc_reports.comparison_tables import across_table, reproduction_table, verdict_table
from ddpc_reports.embedding import (
    chart_library,
    content_policy,
    json_for_script,
    pack,
    page_script,
    stylesheet,
)
from ddpc_reports.figures import Figure, spread_figures, step_time_figure, time_figures
from ddpc_reports.numbers import as_given, with_unit
from ddpc_reports.samples import Column
from ddpc_reports.sensitivity import sensitivity_figures, sweep_statements
from ddpc_reports.settings_tables import (
    compact_seeds,
    diagnostics_table,
    family_tables,
    settings_tables,
)
from ddpc_reports.table import Table
from ddpc_reports.verdict import Statement, across_statements, limitations, verdict

_MOST_DRAWN = 4
"""Scenarios of a study with figures over time: each costs some 300 kB of page."""


@dataclass(frozen=True)
class ConditionPart:
    """What the page shows of one condition."""

    id: str
    label: str
    statements: list[Statement]
    verdict: Table | None
    time_figures: list[Figure]
    spread_figures: list[Figure]
    sensitivity_figures: list[Figure]
    step_time_figure: Figure | None
    step_times: Table | None
    diagnostics: Table | None


@dataclass(frozen=True)
class StudyPart:
    """What the page shows of one study."""

    id: str
    number: int
    results: StudyResults
    title: str
    facts: dict[str, str]
    conditions: list[ConditionPart]
    across_statements: list[Statement]
    across: Table | None
    fallbacks: Table | None
    reproduction: Table | None
    families: list[Table]
    settings: list[Table]
    limitations: list[str]
    failures: Table | None
    cases: Table
    provenance: Table

    @property
    def sections(self) -> dict[str, str]:
        """The contents: titles by anchor."""
        titles = {
            "verdict": "Verdict",
            "reproduction": "Reproduction" if self.reproduction else "",
            "figures": "Figures" if self._has("time_figures") else "",
            "spread": "Spread over seeds" if self._has("spread_figures") else "",
            "sensitivity": "Sensitivity" if self._has("sensitivity_figures") else "",
            "time": "Computation time",
            "data": "Data diagnostics" if self._has("diagnostics") else "",
            "settings": "Settings",
            "limitations": "Known limitations",
            "cases": "Every case",
            "provenance": "Provenance",
        }
        return {f"{self.id}{anchor}": title for anchor, title in titles.items() if title}

    def _has(self, what: str) -> bool:
        return any(getattr(part, what) for part in self.conditions)


def render_page(results: Sequence[StudyResults]) -> str:
    """Return the page as HTML.

    Raises
    ------
    ValueError
        There are no results at all.
    """
    if not results:
        raise ValueError("a report needs the results of at least one study")
    data: dict[str, dict[str, Column]] = {}
    studies = [_study_part(one, number, data) for number, one in enumerate(results, start=1)]
    scripts = [chart_library(), page_script()]
    environment = Environment(
        loader=PackageLoader("ddpc_reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("page.html.jinja").render(
        studies=studies,
        title=studies[0].title if len(studies) == 1 else f"{len(studies)} studies compared",
        style=Markup(stylesheet()),
        scripts=[Markup(script) for script in scripts],
        policy=content_policy(scripts),
        data=Markup(json_for_script(_data(studies, data))),
        colours=COLOURS,
    )


def _study_part(results: StudyResults, number: int, data: dict[str, dict[str, Column]]) -> StudyPart:
    prefix = f"s{number}-"
    seen = conditions(results)
    study = results.study
    parts = [
        _condition_part(condition, f"{prefix}{place}-", data, drawn=place <= _MOST_DRAWN)
        for place, condition in enumerate(seen, start=1)
    ]
    reproduction = study.report.reproduction
    families = family_tables(seen[0], prefix) if seen else []
    first = seen[0] if seen else None
    return StudyPart(
        id=prefix,
        number=number,
        results=results,
        title=study.title or study.name,
        facts=_facts(results),
        conditions=parts,
        across_statements=across_statements(seen),
        across=across_table(seen, prefix),
        fallbacks=fallbacks_table(seen, prefix),
        reproduction=reproduction_table(seen[0], reproduction, prefix) if reproduction and seen else None,
        families=families,
        settings=settings_tables(results, first, prefix),
        limitations=limitations(seen, _MOST_DRAWN),
        failures=failures_table(results, prefix),
        cases=cases_table(results, seen, prefix),
        provenance=provenance_table(results, prefix),
    )


def _condition_part(
    condition: Condition, prefix: str, data: dict[str, dict[str, Column]], *, drawn: bool
) -> ConditionPart:
    # With `run --only` there may be variants of a sweep alone.
    rivals = bool(condition.controllers)
    figures, samples = time_figures(condition, prefix) if drawn and rivals else ([], {})
    data.update(samples)
    return ConditionPart(
        id=prefix,
        label=condition.label,
        statements=(verdict(condition) if rivals else []) + sweep_statements(condition),
        verdict=verdict_table(condition, prefix) if rivals else None,
        time_figures=figures,
        spread_figures=spread_figures(condition, prefix),
        sensitivity_figures=sensitivity_figures(condition, prefix),
        step_time_figure=step_time_figure(condition, prefix),
        step_times=step_time_table(condition, prefix) if rivals else None,
        diagnostics=diagnostics_table(condition, prefix),
    )


def _facts(results: StudyResults) -> dict[str, str]:
    """Return the strip of key facts under the title."""
    study, total = results.study, len(results.cases)
    done = sum(case.outcome is Outcome.COMPLETED for case in results.cases)
    facts = {
        "Plant": study.plant.name or study.plant.fmu,
        "Sampling time": with_unit(as_given(study.loop.sampling_time), "s"),
        "Duration": with_unit(as_given(study.loop.duration), "s"),
        "Controllers": _controllers_words(results),
        "Scenarios": str(len({case.scenario for case in results.cases})),
        "Seeds": compact_seeds(list(dict.fromkeys(case.seed for case in results.cases))),
        "Cases completed": f"{done} of {total}",
    }
    if facts["Scenarios"] == "1":
        del facts["Scenarios"]
    return facts


def _controllers_words(results: StudyResults) -> str:
    sections = results.study.controllers
    names = {case.controller for case in results.cases}
    varied = {name for name in names if name in sections and sections[name].variant_of}
    settings = f"{len(varied)} {'setting' if len(varied) == 1 else 'settings'} in sweeps"
    own = str(len(names - varied))
    return f"{own}, and {settings}" if varied and names - varied else settings if varied else own


def _data(studies: Sequence[StudyPart], data: dict[str, dict[str, Column]]) -> dict[str, Any]:
    """Return what the script draws from: samples once, and a specification for each chart."""
    views = {}
    for study in studies:
        for part in study.conditions:
            single = [part.step_time_figure] if part.step_time_figure else []
            for figure in (*part.time_figures, *part.spread_figures, *part.sensitivity_figures, *single):
                labels = {entry.name: entry.label for entry in figure.legend}
                for view in figure.views:
                    views[view.id] = {
                        "group": part.id,
                        "figure": figure.id,
                        "spec": view.spec,
                        "data": view.data,
                        "lines": {name: labels[name] for name in view.names},
                        "unit": view.unit,
                        "scaled": list(view.scaled_by),
                        "limits": list(view.limits),
                    }
    packed = {name: {key: pack(column) for key, column in columns.items()} for name, columns in data.items()}
    return {"config": CONFIG, "colours": COLOURS, "data": packed, "views": views}
