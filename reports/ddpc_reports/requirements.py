"""What the study requires, on the first screen: who meets it, on how many of the seeds, and why not."""

from collections.abc import Iterable, Sequence

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Table
from ddpc_cosim.files.texts import clipped
from ddpc_cosim.study.verdicts.requirements import (
    Requirement,
    RequirementFindings,
    Tally,
    requirement_findings,
)
from ddpc_reports.comparison import ControllerResults
from ddpc_reports.numbers import unit_symbol
from ddpc_reports.tables.table import controller_table

_LONGEST = 60
MET, MISSED = "\N{CHECK MARK}", "\N{MULTIPLICATION X}"
_NOTES = (
    "A run meets a requirement if it did not fail and its metric is within the limits, both ends included; "
    "a metric without a value meets nothing. A controller meets it if enough of the seeds do, in each "
    "scenario in which it is required. What is required decides no result.",
)


def requirements_words(findings: RequirementFindings | None) -> Markup | None:
    """Return the verdict, who meets all that is required and who does not; None where nothing is.

    What is missed, and how often, stands in the table, but for those that have to meet it.
    """
    if findings is None:
        return None
    labels, required = findings.labels, findings.named
    missing = [name for name in findings.controllers if name not in findings.meeting]
    of_required = [name for name in missing if name in required]
    said = [f"{labels[name]} misses {'; '.join(findings.missed(name))}." for name in of_required]
    if findings.meeting:
        said.append(f"Met by {', '.join(labels[name] for name in findings.meeting)}.")
    if others := [labels[name] for name in missing if name not in required]:
        said.append(f"Missed by {', '.join(others)}: the table below says what, and how often.")
    mark = MET if findings.passed else MISSED
    return Markup("<b>{}\u00a0{}.</b> {}").format(mark, findings.verdict, " ".join(said))


def overall_words(problems: Iterable[StudyResults]) -> Markup | None:
    """Return which of several problems pass what they require; None where none requires anything."""
    verdicts: dict[bool, list[str]] = {True: [], False: []}
    for problem in problems:
        findings = requirement_findings(problem.study, problem.cases)
        if findings is not None:
            verdicts[findings.passed].append(clipped(problem.study.title or problem.study.name, _LONGEST))
    if not any(verdicts.values()):
        return None
    parts = [
        f"{word} in {', '.join(names)}"
        for word, names in (("not passed", verdicts[False]), ("passed", verdicts[True]))
        if names
    ]
    mark = MISSED if verdicts[False] else MET
    return Markup("<b>{}\u00a0Requirements:</b> {}.").format(mark, "; ".join(parts))


def requirements_table(
    findings: RequirementFindings | None, order: Sequence[ControllerResults], prefix: str
) -> Table | None:
    """Return a row per controller and a column per requirement; None where nothing is required.

    Parameters
    ----------
    findings : RequirementFindings, optional
        Who meets what.
    order : sequence of ControllerResults
        The controllers, the best first.
    prefix : str
        What the table's name in the page begins with.
    """
    if findings is None:
        return None
    rows = [controller for controller in order if controller.key in findings.controllers]
    named = [Cell("required" if controller.key in findings.named else "") for controller in rows]
    columns = [
        (Heading("all", numeric=False), [_of_all(findings, controller.key) for controller in rows]),
        *(
            (_heading(requirement), [_of_one(findings, controller.key, requirement) for controller in rows])
            for requirement in findings.requirements
        ),
        *([(Heading("has to", numeric=False), named)] if findings.named else []),
    ]
    return controller_table(
        f"{prefix}requirements",
        "Requirements: the runs that meet them",
        rows,
        columns,
        _NOTES,
        "requirements.csv",
        kind="requirements",
    )


def _heading(requirement: Requirement) -> Heading:
    limits = requirement.limits
    if requirement.unit not in ("", "1"):
        limits = limits.removesuffix(requirement.unit) + unit_symbol(requirement.unit)
    share = f" on {100 * requirement.share:.3g}\u00a0% of the seeds" if requirement.share < 1.0 else ""
    return Heading(requirement.words, f"{limits}{share}", numeric=False)


def _of_all(findings: RequirementFindings, controller: str) -> Cell:
    missed = sum(not findings.meets(controller, requirement) for requirement in findings.requirements)
    return _marked(not missed, "met" if not missed else f"{missed}\u00a0missed", missed)


def _of_one(findings: RequirementFindings, controller: str, requirement: Requirement) -> Cell:
    tallies = findings.of(controller, requirement)
    met, runs = sum(tally.met for tally in tallies), sum(tally.runs for tally in tallies)
    share = met / runs if runs else 0.0
    cell = _marked(findings.meets(controller, requirement), f"{met}\u00a0of\u00a0{runs}", share)
    where = [_why(findings, tally, several=len(tallies) > 1) for tally in tallies if tally.why]
    return Cell(cell.text, cell.raw, failed=cell.failed, tone=cell.tone, detail="; ".join(where))


def _why(findings: RequirementFindings, tally: Tally, *, several: bool) -> str:
    where = f"{findings.scenarios[tally.scenario]} {tally.met} of {tally.runs}: " if several else ""
    return where + tally.why


def _marked(is_met: bool, text: str, raw: float) -> Cell:
    return Cell(f"{MET if is_met else MISSED}\u00a0{text}", raw, failed=not is_met, tone="met" * is_met)
