"""What a study's source claims of its controllers, checked run by run: in how many it is so."""

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from ddpc_cosim.metrics import split_key
from ddpc_cosim.study.case_files import CaseResult

if TYPE_CHECKING:
    from ddpc_cosim.study.file_format.sections import ClaimSection, Study


class CheckedClaim(NamedTuple):
    """A claim, and in how many runs it is so.

    Parameters
    ----------
    text : str
        The claim.
    runs : dict of str to (int, int)
        By scenario: seeds on which it is so, and seeds on which it can be judged, as every controller that
        it is about has a value.
    """

    text: str
    runs: dict[str, tuple[int, int]]

    @property
    def true(self) -> int:
        """In how many runs it is so."""
        return sum(true for true, _ in self.runs.values())

    @property
    def judged(self) -> int:
        """In how many runs it can be judged."""
        return sum(judged for _, judged in self.runs.values())

    @property
    def verdict(self) -> str:
        """Whether it holds: in every run, in none, or in some."""
        if not self.judged:
            return "cannot be judged"
        return "holds" if self.true == self.judged else "does not hold" if not self.true else "holds in part"


def check_claims(study: "Study", cases: Iterable[CaseResult]) -> list[CheckedClaim]:
    """Return the claims of a study of one problem, checked on the seeds of each of its scenarios."""
    runs: dict[str, dict[int, dict[str, CaseResult]]] = {}
    for case in cases:
        runs.setdefault(case.scenario, {}).setdefault(case.seed, {})[case.controller] = case
    checked = []
    for claim in study.report.claims:
        about = controllers_of(claim, study)
        found = {}
        for scenario, seeds in runs.items():
            values = [[_value(own.get(name), claim.metric) for name in about] for own in seeds.values()]
            known = [dict(zip(about, one, strict=True)) for one in values if not any(map(math.isnan, one))]
            found[scenario] = (sum(_is_so(claim, one) for one in known), len(known))
        checked.append(CheckedClaim(claim.text, found))
    return checked


def controllers_of(claim: "ClaimSection", study: "Study") -> list[str]:
    """Return the controllers that a claim compares: those it orders, one and its variants, or all."""
    if claim.order:
        return claim.order
    sections = study.controllers
    if claim.alike:
        return [claim.alike, *(name for name, one in sections.items() if one.variant_of == claim.alike)]
    points = study.report.reference_points
    aside = {points.zero, points.full} if points else set()
    return [name for name, one in sections.items() if not one.variant_of and name not in aside]


def _value(case: CaseResult | None, metric: str) -> float:
    """Return a metric by its name and signal; of a failed run there is none."""
    if case is None or case.failed:
        return math.nan
    named = {".".join(filter(None, split_key(key)[:2])): value for key, value in case.metrics.items()}
    return named.get(metric, math.nan)


def _is_so(claim: "ClaimSection", values: Mapping[str, float]) -> bool:
    if claim.order:
        return all(low < high for low, high in pairwise(values.values()))
    least, most = min(values.values()), max(values.values())
    if claim.alike:
        return most - least <= claim.within / 100.0 * least
    others = [value for name, value in values.items() if name not in (claim.lowest, claim.highest)]
    if claim.lowest:
        return all(values[claim.lowest] < other for other in others)
    return all(values[claim.highest] > other for other in others)
