"""All that the page says as data: the answer, the tables, rankings, statistics and where they come from."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Table
from ddpc_cosim.files.texts import encodable, printable, without_folders
from ddpc_cosim.study.verdicts.findings import findings_of
from ddpc_cosim.study.verdicts.requirements import RequirementFindings
from ddpc_reports.comparison import labels
from ddpc_reports.sections import StudyPart, gather, one_by_one
from ddpc_reports.tidy import COLUMNS, tidy_rows

SCHEMA_VERSION = 2
"""Grows with every change by which what was read before is read wrongly or not at all."""


def json_text(results: Sequence[StudyResults]) -> str:
    """Return the report as JSON, keys in a fixed order; numbers that are not finite are null.

    Raises
    ------
    ValueError
        There are no results at all.
    """
    gathered = gather(results)
    content = {
        "schema_version": SCHEMA_VERSION,
        "title": gathered.title,
        "parts": [_part(part) for part in gathered.parts],
        "results": [_results(study_results) for study_results in results],
        "statistics": {"columns": COLUMNS, "rows": tidy_rows(results)},
    }
    text = json.dumps(_plain(content), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return encodable(text) + "\n"


def _part(part: StudyPart) -> dict[str, Any]:
    return {
        "title": part.title,
        "answer": part.answer,
        "warnings": part.warnings,
        "remarks": part.remarks,
        "facts": part.facts,
        "comment": part.comment,
        "summary": part.summary,
        "source": part.source,
        "first": [_block(*block) for block in part.first if block[0] != "baseline"],
        "sections": [
            {"title": section.title, "blocks": [_block(*block) for block in one_by_one(section.blocks)]}
            for section in part.sections
        ],
    }


def _block(kind: str, content: Any) -> dict[str, Any]:
    if kind == "table":
        return {"kind": kind, **_table(content)}
    if kind == "figure":
        figure, _ = content
        return {"kind": kind, "title": figure.title, "caption": figure.caption}
    if kind == "statements":
        statements = [{"topic": statement.topic, "text": statement.text} for statement in content]
        return {"kind": kind, "statements": statements}
    return {"kind": kind, "texts": content} if kind == "notes" else {"kind": kind, "text": content}


def _table(table: Table) -> dict[str, Any]:
    grouped = any(row.group for row in table.rows)
    return {
        "id": table.id,
        "caption": table.caption,
        "columns": [
            {
                "title": heading.title,
                "detail": heading.detail,
                "group": heading.group,
                "numeric": heading.numeric,
            }
            for heading in table.headings
        ],
        "rows": [
            {
                **({"group": row.group} if grouped else {}),
                **({"controller": row.key} if row.key else {}),
                "header": row.header,
                "cells": [_cell(cell) for cell in row.cells],
            }
            for row in table.rows
        ],
        "notes": table.notes,
    }


def _cell(cell: Cell) -> dict[str, Any]:
    """Return the text, the value behind it, and the marks that there are."""
    texts = {"detail": cell.detail, "failures": cell.failures}
    marks = {"best": cell.best, "failed": cell.failed, "differs": cell.differs}
    more = {name: value for name, value in (texts | marks).items() if value}
    return {"text": cell.text.strip(), "value": None if cell.raw == "" else cell.raw, **more}


def _results(results: StudyResults) -> dict[str, Any]:
    return {
        "study": results.whole.head.name,
        "folder": results.folder.name,
        "provenance": {name: without_folders(fact) for name, fact in results.provenance.items()},
        "damaged": {name: without_folders(why) for name, why in results.damaged.items()},
        "rankings": [_ranking(part) for part in results.problems()],
    }


def _ranking(part: StudyResults) -> dict[str, Any]:
    findings, names = findings_of(part.study, part.cases), labels(part)
    ranking = findings.standings
    return {
        "problem": part.study.name,
        "metrics": ranking.keys,
        "lead": findings.lead.value,
        "leaders": findings.leaders,
        "leaders_are_sure": findings.is_sure,
        **_required(findings.requirements),
        "leaders_by_scenario": ranking.leaders_by_scenario,
        "relevant_differences": [ranking.relevant_differences[key] for key in ranking.keys],
        "seeds": ranking.seeds,
        "told_apart_by_seeds": ranking.tested,
        "scenarios_left_out": ranking.left_out,
        "order": [
            {
                "controller": standing.controller,
                "label": names[standing.controller],
                "rank": standing.rank if standing.shown else None,
                "worst_rank": standing.worst if standing.shown else None,
                "failed": standing.failed,
                "runs": standing.runs,
                "medians": [sample.median for sample in samples],
                "intervals": [[sample.low, sample.high] for sample in samples],
            }
            for standing in ranking.order
            for samples in [[ranking.samples[key][standing.controller] for key in ranking.keys]]
        ],
    }


def _required(findings: RequirementFindings | None) -> dict[str, Any]:
    """Return who meets what the study requires; nothing where it requires nothing."""
    if findings is None:
        return {}
    requirements = [
        {
            "metric": requirement.key,
            "min": requirement.min,
            "max": requirement.max,
            "unit": requirement.unit,
            "share": requirement.share,
            "controllers": [
                {
                    "controller": tally.controller,
                    "scenario": tally.scenario,
                    "is_met": tally.is_met,
                    "met": tally.met,
                    "runs": tally.runs,
                    "failed": tally.failed,
                    "without_a_value": tally.unknown,
                }
                for tally in findings.tallies
                if tally.requirement == requirement
            ],
        }
        for requirement in findings.requirements
    ]
    return {
        "requirements": {
            "passed": findings.passed,
            "controllers": findings.named,
            "met_by": findings.meeting,
            "each": requirements,
        }
    }


def _plain(value: Any) -> Any:
    """Return what JSON has: texts without marks in which nothing acts, and null for what is not finite."""
    if isinstance(value, Markup):
        return printable(value.striptags())
    if isinstance(value, str):
        return printable(str(value), keep="\n")
    if isinstance(value, bool) or value is None or isinstance(value, int):
        return value
    if isinstance(value, Mapping):
        return {printable(str(key)): _plain(entry) for key, entry in value.items()}
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return [_plain(entry) for entry in value]
