"""Whom seeing more of the reference makes worse: scenarios that differ in nothing else, side by side."""

import math
from collections.abc import Iterable, Iterator
from itertools import permutations
from typing import TYPE_CHECKING, NamedTuple

from ddpc_cosim.metrics import headline, metric_of
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.statistics import Difference, Runs, Sample, compare_pairs, describe

if TYPE_CHECKING:
    from ddpc_cosim.study.file_format.sections import Study

_RELEVANT = 0.01
"""Of the median with less preview: a smaller difference does not matter."""


class WorsePreview(NamedTuple):
    """A controller that is worse where it sees more of the reference.

    Parameters
    ----------
    controller : str
        Its name in the study.
    key : str
        The metric that is ranked by.
    more, less : str
        The scenarios in which it sees more, and less.
    with_more, with_less : Sample
        What its runs come to in the two.
    difference : Difference
        With more less with less, in pairs of the same seed.
    """

    controller: str
    key: str
    more: str
    less: str
    with_more: Sample
    with_less: Sample
    difference: Difference


def worse_previews(study: "Study", cases: Iterable[CaseResult]) -> list[WorsePreview]:
    """Return the controllers of a study of one problem that the seeds tell to be worse with more preview.

    Compared are scenarios that differ in their preview alone; the controllers of two such scenarios are one
    family of tests. Runs that failed are in no pair.
    """
    runs: dict[tuple[str, str, str], dict[int, float]] = {}
    everything = [case for case in cases if not case.failed]
    keys = headline(dict.fromkeys(key for case in everything for key in case.metrics))
    for case in everything:
        for key in keys:
            value = case.metrics.get(key, math.nan)
            runs.setdefault((key, case.scenario, case.controller), {})[case.seed] = value
    return [
        one
        for more, less in _pairs(study)
        for key in keys
        for one in _worse(key, more, less, {k[1:]: own for k, own in runs.items() if k[0] == key})
    ]


def _pairs(study: "Study") -> Iterator[tuple[str, str]]:
    """Yield the scenarios that differ in their preview alone, the one with more of it first."""
    for more, less in permutations(study.scenarios, 2):
        one, other = study.scenarios[more], study.scenarios[less]
        seen, unseen = study.loop.preview_of(one), study.loop.preview_of(other)
        alike = {"label": "", "preview": None}
        if one.model_copy(update=alike) != other.model_copy(update=alike) or unseen is None:
            continue
        if seen is None or seen > unseen:
            yield more, less


def _worse(
    key: str, more: str, less: str, runs: dict[tuple[str, str], dict[int, float]]
) -> Iterator[WorsePreview]:
    names = [name for scenario, name in runs if scenario == more and (less, name) in runs]
    better = metric_of(key).better
    table: dict[str, Runs] = {
        f"{scenario}\n{name}": {("", seed): value for seed, value in runs[scenario, name].items()}
        for name in names
        for scenario in (more, less)
    }
    found = compare_pairs(table, [(f"{more}\n{name}", f"{less}\n{name}") for name in names], better)
    for name, difference in zip(names, found.values(), strict=True):
        seen, unseen = (describe(table[f"{scenario}\n{name}"]) for scenario in (more, less))
        if difference.told_worse and abs(difference.median) > _RELEVANT * abs(unseen.median):
            yield WorsePreview(name, key, more, less, seen, unseen, difference)
