"""What a study's source claims of its controllers, checked run by run: in how many it is so."""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from ddpc_cosim.metrics import split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.verdicts.judgement import set_aside

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
        it is about has a value, or the one that it is of failed.
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
        counts = {}
        for scenario, seeds in runs.items():
            so = [
                _is_so(claim, {name: by_controller[name] for name in about if name in by_controller}, about)
                for by_controller in seeds.values()
            ]
            counts[scenario] = (so.count(True), len(so) - so.count(None))
        checked.append(CheckedClaim(claim.text, counts))
    return checked


def controllers_of(claim: "ClaimSection", study: "Study") -> list[str]:
    """Return the controllers that a claim compares: those it orders, one and its variants, or all."""
    if claim.order:
        return claim.order
    sections = study.controllers
    if claim.alike:
        return [
            claim.alike,
            *(name for name, section in sections.items() if section.variant_of == claim.alike),
        ]
    aside = set_aside(study)
    return [name for name in sections if name not in aside]


def _value(case: CaseResult, metric: str) -> float:
    """Return a metric by its name and signal."""
    named = {".".join(filter(None, split_key(key)[:2])): value for key, value in case.metrics.items()}
    return named.get(metric, math.nan)


def _is_so(claim: "ClaimSection", cases: Mapping[str, CaseResult], about: Sequence[str]) -> bool | None:
    """Return whether a claim is so with one seed; None where that cannot be said.

    That is where one of those compared did not run, or has no such figure, or failed without being the one
    that the claim is of. Where that one failed it is not so.
    """
    subjects = claim.order or [claim.alike or claim.lowest or claim.highest]
    if any(cases[name].failed for name in subjects if name in cases):
        return False
    values = {name: _value(case, claim.metric) for name, case in cases.items() if not case.failed}
    if len(about) < 2 or values.keys() != {*about} or any(map(math.isnan, values.values())):
        return None
    if claim.order:
        return all(values[low] < values[high] for low, high in pairwise(claim.order))
    least, most = min(values.values()), max(values.values())
    if claim.alike:
        return most - least <= claim.within / 100.0 * least
    others = [value for name, value in values.items() if name not in (claim.lowest, claim.highest)]
    if claim.lowest:
        return all(values[claim.lowest] < other for other in others)
    return all(values[claim.highest] > other for other in others)
