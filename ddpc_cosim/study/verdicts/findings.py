"""What the results of one problem show, as data: who is ahead, how sure that is, does it matter, who failed.

Page, terminal, files and Python ask here, and put it into their own words.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

from ddpc_cosim.metrics import metric_name, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.judgement import (
    LONGEST_LABEL,
    Remark,
    scenario_labels,
    scenario_remarks,
    unsettled,
)
from ddpc_cosim.study.verdicts.previews import WorsePreview, worse_previews
from ddpc_cosim.study.verdicts.standings import Standing, Standings, standings
from ddpc_cosim.texts import printable


class Lead(StrEnum):
    """In which way controllers lead."""

    NOBODY = "nobody competes"
    ONLY_ONE = "there is nobody to compare it with"
    ALL_FAIL = "each has failed runs"
    ONLY_SOUND = "it alone has no failed run"
    BY_SCENARIO = "scenarios disagree"
    AHEAD = "it is ahead of all others"
    BEST_MEDIAN = "it has the best median, and the seeds are too few for a test"
    LEVEL = "no controller is significantly better by enough to matter"
    ALIKE = "no difference between them matters"


@dataclass(frozen=True)
class Findings:
    """What the results of one problem show.

    Parameters
    ----------
    standings : Standings
        Ranks, tests and figures.
    lead : Lead
        In which way the leaders lead.
    leaders : tuple of str
        The controllers of the first rank; none where scenarios disagree, or all have failed runs.
    following : str
        The best of those behind without a failed run; empty: there is none.
    failing : tuple of Standing
        The controllers with failed runs, those with the fewest first.
    worse_previews : tuple of WorsePreview
        Whom seeing more of the reference makes worse.
    remarks : tuple of Remark
        What is to be known of scenarios besides ranks.
    """

    standings: Standings
    lead: Lead
    leaders: tuple[str, ...]
    following: str
    failing: tuple[Standing, ...]
    worse_previews: tuple[WorsePreview, ...]
    remarks: tuple[Remark, ...]

    @property
    def is_sure(self) -> bool:
        """Whether by the seeds no controller is better than the leaders: only then are they set in bold."""
        sure = (Lead.AHEAD, Lead.LEVEL, Lead.ALIKE, Lead.ONLY_SOUND, Lead.BY_SCENARIO)
        return self.lead in sure and (self.standings.tested or self.lead is Lead.ONLY_SOUND)

    @property
    def tells_leaders_apart(self) -> bool:
        """Whether the seeds tell two of the leaders apart, by however little."""
        pairs = combinations(self.leaders, 2)
        found = (self.standings.difference(key, *pair) for pair in pairs for key in self.standings.keys)
        return any(difference is not None and difference.told_apart for difference in found)

    @property
    def scenarios_led(self) -> int:
        """In how many scenarios one of the leaders leads."""
        return sum(bool({*names} & {*self.leaders}) for names in self.standings.leaders_by_scenario.values())

    @property
    def leads_elsewhere(self) -> dict[str, int]:
        """By controller, in how many scenarios it leads that none of the leaders lead, the most first."""
        others = Counter(
            name
            for leaders in self.standings.leaders_by_scenario.values()
            if not {*leaders} & {*self.leaders}
            for name in leaders
        )
        return dict(others.most_common())


def findings_of(study: Study, cases: Iterable[CaseResult]) -> Findings:
    """Return what cases of one problem show."""
    everything = [*cases]
    found = standings(study, everything)
    worse = tuple(worse_previews(study, found))
    return Findings(
        found,
        _lead(found),
        found.leaders,
        next((one.controller for one in found.order if not one.failed and one.rank > 1), ""),
        tuple(one for one in found.order if one.failed),
        worse,
        tuple(_remarks(study, everything, worse)),
    )


def _remarks(study: Study, cases: Sequence[CaseResult], worse: Iterable[WorsePreview]) -> Iterator[Remark]:
    yield from scenario_remarks(study, cases)
    if text := unsettled(study, cases):
        yield Remark(text, is_failure=False)
    labels = {case.controller: printable(case.label, LONGEST_LABEL) for case in cases}
    scenarios = scenario_labels(study)
    for one in worse:
        name, signal, unit = split_key(one.key)
        what = " of ".join(filter(None, (metric_name(name), printable(signal))))
        values = f"{one.with_more.median:.3g} against {one.with_less.median:.3g} {printable(unit)}"
        more, less = scenarios[one.more], scenarios[one.less]
        text = f'{labels[one.controller]} is worse in "{more}" than in "{less}", where it sees less ahead'
        yield Remark(f"{text}: {what} {values}", is_failure=False)
    yield from (Remark(text, is_failure=False) for text in _mixed_versions(cases))


def _mixed_versions(cases: Iterable[CaseResult]) -> Iterator[str]:
    """Yield of what cases had different versions, which may tell in their figures."""
    counts: dict[str, Counter[str]] = {}
    for case in cases:
        for name, version in case.versions.items():
            counts.setdefault(name, Counter())[version] += 1
    for name, found in counts.items():
        if len(found) > 1:
            told = ", ".join(f"{printable(version)} ({count})" for version, count in found.most_common())
            different = f"Cases ran with different versions of {printable(name)}: {told}"
            yield f"{different}; a run with --fresh has one"


def _lead(found: Standings) -> Lead:
    sound = [one for one in found.order if not one.failed]
    if not found.order:
        return Lead.NOBODY
    if not sound:
        return Lead.ALL_FAIL
    if len(found.order) == 1:
        return Lead.ONLY_ONE
    if found.disagreements:
        return Lead.BY_SCENARIO
    if len(sound) == 1:
        return Lead.ONLY_SOUND
    if len(found.leaders) > 1:
        alike = found.tested and all(found.is_surely_small(*pair) for pair in combinations(found.leaders, 2))
        return Lead.ALIKE if alike else Lead.LEVEL
    if found.tested and found.order[0].worst > 1:  # others are behind others, but none behind it
        return Lead.LEVEL
    return Lead.AHEAD if found.tested or found.seeds < 2 else Lead.BEST_MEDIAN
