"""What the study's source claims, and in how many runs it is so."""

from ddpc_cosim import StudyResults
from ddpc_cosim.metrics import metric_name
from ddpc_cosim.study.file_format.sections import ClaimSection
from ddpc_cosim.study.verdicts.claims import check_claims
from ddpc_cosim.tables import Cell, Heading, Row, Table
from ddpc_reports.comparison import labels, metric_signal
from ddpc_reports.numbers import MISSING, as_given


def claims_table(results: StudyResults, prefix: str) -> Table | None:
    """Return a row per claim: whether it holds, and in how many runs of each scenario; None without any."""
    study = results.study
    checked = check_claims(study, results.cases)
    if not checked:
        return None
    ran = [name for name in study.scenarios if any(name in one.runs for one in checked)]
    rows = []
    for claim, one in zip(study.report.claims, checked, strict=True):
        counts = [one.runs.get(name, (0, 0)) for name in ran]
        cells = [Cell(f"{true} of {judged}" if judged else MISSING, true) for true, judged in counts]
        verdict = Cell(one.verdict, failed=one.judged > 0 and not one.true)
        rows.append(Row(one.text, (verdict, Cell(_checked_by(claim, results)), *cells)))
    titles = [study.scenarios[name].label or name for name in ran] if len(ran) > 1 else ["runs"]
    headings = (
        Heading("Claim", numeric=False),
        Heading("here it", numeric=False),
        Heading("checked by", numeric=False),
        *(Heading(title, "runs" if len(ran) > 1 else "") for title in titles),
    )
    source = f"What is claimed in {study.source}" if study.source else "What is claimed"
    notes = (
        "A claim is checked on each seed of a scenario. It is not so where a controller that it is of "
        "failed, and cannot be judged where only another failed, or has no such figure.",
    )
    return Table(f"{prefix}claims", source, headings, tuple(rows), notes, download="claims.csv")


def _checked_by(claim: ClaimSection, results: StudyResults) -> str:
    """Say what has to be so for a claim to be so."""
    name = labels(results)
    what = " of ".join(filter(None, (metric_name(claim.metric), metric_signal(claim.metric))))
    if claim.order:
        return f"{what}: {' < '.join(name.get(one, one) for one in claim.order)}"
    if claim.alike:
        who = name.get(claim.alike, claim.alike)
        return f"{what}: no more than {as_given(claim.within)} % apart over the sweep of {who}"
    kind, who = ("lowest", claim.lowest) if claim.lowest else ("highest", claim.highest)
    return f"{what}: {kind} with {name.get(who, who)}"
