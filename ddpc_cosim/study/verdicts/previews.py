"""Controllers that are worse with more preview: scenarios that differ in nothing else, side by side."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import permutations
from typing import TYPE_CHECKING, NamedTuple

from ddpc_cosim.metrics import metric_of
from ddpc_cosim.study.verdicts.standings import Standings
from ddpc_cosim.study.verdicts.statistics import Difference, Runs, Sample, compare_pairs, describe

if TYPE_CHECKING:
    from ddpc_cosim.study.file_format.sections import Study


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


def worse_previews(study: "Study", ranking: Standings) -> list[WorsePreview]:
    """Return the controllers of a study of one problem that the seeds tell to be worse with more preview.

    Compared are scenarios that differ in their preview alone; the controllers of two such scenarios are one
    family of tests. Runs that failed are in no pair.
    """
    return [
        preview
        for more, less in _pairs(study)
        for key in ranking.keys
        for preview in _worse(key, more, less, ranking.runs[key], ranking.relevant_differences[key])
    ]


def _pairs(study: "Study") -> Iterator[tuple[str, str]]:
    """Yield the scenarios that differ in their preview alone, the one with more of it first."""
    for more, less in permutations(study.scenarios, 2):
        scenario, other = study.scenarios[more], study.scenarios[less]
        seen, unseen = study.loop.preview_of(scenario), study.loop.preview_of(other)
        if replace(scenario, label=other.label, preview=other.preview) != other or unseen is None:
            continue
        if seen is None or seen > unseen:
            yield more, less


def _worse(
    key: str, more: str, less: str, runs: Mapping[str, Runs], relevant: float
) -> Iterator[WorsePreview]:
    def within(scenario: str, values: Runs) -> Runs:
        return {
            ("", seed): value
            for (where, seed), value in values.items()
            if where == scenario and value == value
        }

    pairs = {name: (within(more, values), within(less, values)) for name, values in runs.items()}
    names = [name for name, both in pairs.items() if all(both)]
    table = {side + name: pairs[name][at] for name in names for at, side in enumerate(("more ", "less "))}
    differences = compare_pairs(
        table, [(f"more {name}", f"less {name}") for name in names], metric_of(key).better
    )
    for name, difference in zip(names, differences.values(), strict=True):
        if difference.told_worse and abs(difference.median) >= relevant:
            seen, unseen = map(describe, pairs[name])
            yield WorsePreview(name, key, more, less, seen, unseen, difference)
