"""The report as one tidy table in CSV: a row for each metric of a controller in a scenario."""

import math
from collections.abc import Iterator, Sequence

from ddpc_cosim import CaseResult, StudyResults
from ddpc_cosim.files.tables import table_text
from ddpc_cosim.files.texts import encodable
from ddpc_cosim.metrics import metric_of, split_key
from ddpc_cosim.study.file_format.sweeps import variant_words
from ddpc_cosim.study.verdicts.standings import standings, summed
from ddpc_cosim.study.verdicts.statistics import describe
from ddpc_reports.comparison import conditions

COLUMNS = (
    *("study", "problem", "variant", "plant", "scenario", "controller", "label", "rank", "failed", "runs"),
    *("metric", "signal", "unit", "better", "value"),
    *("median", "low", "high", "interval_low", "interval_high"),
)


Value = str | int | float


def tidy_table(results: Sequence[StudyResults]) -> str:
    """Return the table as CSV; numbers in full, and an empty cell where there is none."""
    return encodable(table_text(COLUMNS, tidy_rows(results)))


def tidy_rows(results: Sequence[StudyResults]) -> Iterator[tuple[Value, ...]]:
    """Yield the rows; a rank that there is not is empty, a missing number NaN."""
    for study_results in results:
        names = study_results.whole.problems
        views = {part.study.name: part for part in study_results.problems()}
        views |= {part.study.name: part for name in names for part in study_results.variants(name)}
        yield from (row for part in views.values() for row in _rows(study_results, part))


def _rows(results: StudyResults, part: StudyResults) -> Iterator[tuple[Value, ...]]:
    """Yield the rows of one problem, or of a variant of one by the study's sweep."""
    study = part.study
    order = standings(study, part.cases).order
    ranks = {standing.controller: standing.rank for standing in order if standing.shown}
    words = variant_words(study.varied)
    for condition in conditions(part):
        for controller in (*condition.controllers, *condition.variants):
            of_whom = (results.whole.head.name, study.variant_of or study.name, words, study.plant.label)
            of_run = (
                condition.scenario,
                controller.key,
                controller.label,
                ranks.get(controller.key, ""),
                controller.failed,
                len(controller.cases),
            )
            for key in dict.fromkeys(key for case in controller.cases for key in case.metrics):
                yield *of_whom, *of_run, *_of_metric(key, controller.cases)


def _of_metric(key: str, cases: Sequence[CaseResult]) -> tuple[Value, ...]:
    """Return the cells of a metric: its value as the page sums it up, and over runs that did not fail."""
    runs = [(case.seed, case.metrics.get(key, math.nan) if not case.failed else math.nan) for case in cases]
    known = [value for _, value in runs if not math.isnan(value)]
    sample = describe({("", seed): value for seed, value in runs})
    ends = (min(known), max(known)) if known else (math.nan, math.nan)
    values = (summed(cases, key), sample.median, *ends, sample.low, sample.high)
    return *split_key(key), metric_of(key).better, *map(float, values)
