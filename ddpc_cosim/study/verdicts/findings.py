"""What results show, as data: who is ahead, how sure that is, does it matter, who failed.

Page, terminal, files and Python ask here: of one problem, and over all problems of a study.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from itertools import combinations
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from ddpc_cosim.files.texts import printable
from ddpc_cosim.metrics import metric_name, metric_of, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.judgement import (
    LONGEST_LABEL,
    Remark,
    scenario_labels,
    scenario_remarks,
    set_aside,
    unsettled,
)
from ddpc_cosim.study.verdicts.knowing import Knowing, knowing
from ddpc_cosim.study.verdicts.previews import WorsePreview, worse_previews
from ddpc_cosim.study.verdicts.ranks import (
    RANKED,
    AverageRanks,
    Profile,
    problems_frame,
    profile_frame,
    ranks_frame,
)
from ddpc_cosim.study.verdicts.requirements import RequirementFindings, requirement_findings
from ddpc_cosim.study.verdicts.standings import Standing, Standings, known_values, standings
from ddpc_cosim.study.verdicts.statistics import Comparisons, Runs, compare_all

if TYPE_CHECKING:
    import pandas as pd

_SETTLED_ERROR = "settled_error"
_MUCH_LESS = 0.5
"""From this part of a leader's on, a value of another is worth a word."""


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
    FRONT = "no controller is both cheaper and no less comfortable than one of them"


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
        The controllers that are worse where they see more of the reference.
    remarks : tuple of Remark
        What is to be known of scenarios besides ranks.
    knowing : Knowing or None
        What knowing the disturbances is worth, where scenarios differ in it alone.
    requirements : RequirementFindings or None
        Who meets what the study requires, where it requires anything.
    """

    standings: Standings
    lead: Lead
    leaders: tuple[str, ...]
    following: str
    failing: tuple[Standing, ...]
    worse_previews: tuple[WorsePreview, ...]
    remarks: tuple[Remark, ...]
    knowing: Knowing | None = None
    requirements: RequirementFindings | None = None

    @property
    def is_sure(self) -> bool:
        """Whether by the seeds no controller is better than the leaders: only then are they set in bold."""
        sure = (Lead.AHEAD, Lead.LEVEL, Lead.ALIKE, Lead.FRONT, Lead.ONLY_SOUND, Lead.BY_SCENARIO)
        return self.lead in sure and (self.standings.tested or self.lead is Lead.ONLY_SOUND)

    @property
    def tells_leaders_apart(self) -> bool:
        """Whether the seeds tell two of the leaders apart, by however little."""
        pairs = combinations(self.leaders, 2)
        differences = (self.standings.difference(key, *pair) for pair in pairs for key in self.standings.keys)
        return any(difference is not None and difference.told_apart for difference in differences)

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


@dataclass(frozen=True, eq=False)
class ScenarioFindings:
    """What the runs of one scenario show, metric by metric.

    Parameters
    ----------
    study : Study
        The study, of one problem.
    cases : sequence of CaseResult
        The runs.
    """

    study: Study
    cases: Sequence[CaseResult]
    _compared: dict[str, Comparisons] = field(default_factory=dict)

    @cached_property
    def standings(self) -> Standings:
        """Where the controllers stand in it."""
        return standings(self.study, self.cases)

    @cached_property
    def sound(self) -> dict[str, list[CaseResult]]:
        """The runs of those that compete and of which none failed: only these may be the best."""
        aside, runs = set_aside(self.study), dict[str, list[CaseResult]]()
        for case in self.cases:
            if case.controller not in aside:
                runs.setdefault(case.controller, []).append(case)
        return {name: cases for name, cases in runs.items() if not any(case.failed for case in cases)}

    def medians(self, key: str) -> dict[str, float]:
        """Return the medians of those that may be the best, the best first; equal ones as in the study."""
        values = {name: known_values(cases, key) for name, cases in self.sound.items()}
        medians = {name: median(known) for name, known in values.items() if known}
        return dict(sorted(medians.items(), key=lambda item: metric_of(key).rank(item[1])))

    def compared(self, key: str) -> Comparisons:
        """Return those that may be the best, compared each with each over the seeds."""
        if key in self.standings.compared:
            return self.standings.compared[key]
        if key not in self._compared:
            runs: dict[str, Runs] = {
                name: {(case.scenario, case.seed): case.metrics.get(key, math.nan) for case in cases}
                for name, cases in self.sound.items()
            }
            self._compared[key] = compare_all(runs, metric_of(key).better)
        return self._compared[key]


class Offer(NamedTuple):
    """What a controller behind the leaders offers that none of them does.

    Parameters
    ----------
    controller : str
        Its name in the study.
    needs_no_recording : bool
        Whether it learns from no recording, where every leader does.
    key : str
        The metric of what is left of a step, where it leaves half of what each leader leaves, or less; empty:
        it does not.
    left, least : float
        That of the controller, and the least of a leader.
    """

    controller: str
    needs_no_recording: bool
    key: str = ""
    left: float = math.nan
    least: float = math.nan


@dataclass(frozen=True)
class OverallFindings:
    """What the results of several problems show of their controllers over all of them.

    Parameters
    ----------
    standings : tuple of Standings
        Of each problem.
    cases : dict of str to list of CaseResult
        By controller, in the scenarios that count: variants and reference points too.
    ranks : AverageRanks
        Average ranks, of two controllers or more.
    frame : pandas.DataFrame
        The runs that these are of.
    knowing : tuple of Knowing or None
        What knowing the disturbances is worth in each problem.
    """

    standings: tuple[Standings, ...]
    cases: dict[str, list[CaseResult]]
    ranks: AverageRanks
    frame: "pd.DataFrame"
    knowing: tuple[Knowing | None, ...]

    @cached_property
    def profile(self) -> Profile:
        """Performance profile."""
        return profile_frame(self.frame, RANKED)

    @property
    def failed(self) -> dict[str, tuple[int, int]]:
        """By controller, the runs that failed, and all runs."""
        return {name: (sum(case.failed for case in runs), len(runs)) for name, runs in self.cases.items()}


def findings_of(study: Study, cases: Iterable[CaseResult]) -> Findings:
    """Return what cases of one problem show."""
    everything = [*cases]
    ranking = standings(study, everything)
    worse = tuple(worse_previews(study, ranking))
    behind = (standing.controller for standing in ranking.order if not standing.failed and standing.rank > 1)
    return Findings(
        ranking,
        _lead(ranking),
        ranking.leaders,
        next(behind, ""),
        tuple(standing for standing in ranking.order if standing.failed),
        worse,
        tuple(_remarks(study, everything, worse)),
        knowing(study, ranking),
        requirement_findings(study, everything),
    )


def offers_of(study: Study, cases: Sequence[CaseResult], findings: Findings) -> list[Offer]:
    """Return what the best of those behind offer that the leaders do not, each controller once.

    Of several outputs, and where no controller leads or none is behind, the list is empty.
    """
    ranking, leaders = findings.standings, findings.leaders
    rest = [standing.controller for standing in ranking.order if not standing.failed and standing.rank > 1]
    if not leaders or not rest or len(ranking.keys) > 1:
        return []
    offers: dict[str, Offer] = {}
    learned = {case.controller for case in cases if case.recorded_samples}
    if learned >= {*leaders} and (name := next((name for name in rest if name not in learned), "")):
        offers[name] = Offer(name, needs_no_recording=True)
    counting = [case for case in cases if case.scenario not in ranking.left_out]
    only = ScenarioFindings(study, counting) if len({case.scenario for case in counting}) == 1 else None
    if only and (closest := _settles_closest(only, leaders, rest)):
        name = closest.controller
        offers[name] = closest._replace(needs_no_recording=name in offers)
    return [*offers.values()]


def _settles_closest(
    scenario_findings: ScenarioFindings, leaders: Sequence[str], rest: Sequence[str]
) -> Offer | None:
    """Return who of the rest settles significantly closer than each leader, at half its error or less."""
    every = dict.fromkeys(key for case in scenario_findings.cases for key in case.metrics)
    keys = [key for key in every if split_key(key)[0] == _SETTLED_ERROR]
    if len(keys) != 1:
        return None
    (key,) = keys
    medians = scenario_findings.medians(key)
    known = [name for name in rest if name in medians]
    if not known:
        return None
    name = min(known, key=medians.__getitem__)
    least = min((medians.get(leader, math.nan) for leader in leaders), default=math.nan)
    differences = [scenario_findings.compared(key).differences.get((name, leader)) for leader in leaders]
    sure = all(difference and difference.told_apart for difference in differences)
    if not sure or not medians[name] <= _MUCH_LESS * least:
        return None
    return Offer(name, needs_no_recording=False, key=key, left=medians[name], least=least)


def overall_findings(problems: Iterable[tuple[Study, Sequence[CaseResult]]]) -> OverallFindings | None:
    """Return what several problems show over all; None where fewer than two of either can be compared.

    Raises
    ------
    ConfigError
        In a problem, the controllers share no run.
    """
    everything = [*problems]
    rankings = tuple(standings(study, cases) for study, cases in everything)
    frame = problems_frame(rankings)
    if frame is None:
        return None
    ranks = ranks_frame(frame, RANKED)
    if len(ranks.ranks) < 2:
        return None
    by_controller: dict[str, list[CaseResult]] = {}
    for (_, cases), of_problem in zip(everything, rankings, strict=True):
        for case in cases:
            if case.scenario not in of_problem.left_out:
                by_controller.setdefault(case.controller, []).append(case)
    studies = (study for study, _ in everything)
    worth = tuple(knowing(study, ranking) for study, ranking in zip(studies, rankings, strict=True))
    return OverallFindings(rankings, by_controller, ranks, frame, worth)


def _remarks(study: Study, cases: Sequence[CaseResult], worse: Iterable[WorsePreview]) -> Iterator[Remark]:
    yield from scenario_remarks(study, cases)
    if text := unsettled(study, cases):
        yield Remark(text, is_failure=False)
    labels = {case.controller: printable(case.label, LONGEST_LABEL) for case in cases}
    scenarios = scenario_labels(study)
    for preview in worse:
        name, signal, unit = split_key(preview.key)
        what = " of ".join(filter(None, (metric_name(name), printable(signal))))
        values = f"{preview.with_more.median:.3g} against {preview.with_less.median:.3g} {printable(unit)}"
        more, less = scenarios[preview.more], scenarios[preview.less]
        text = f'{labels[preview.controller]} is worse in "{more}" than in "{less}", where it sees less ahead'
        yield Remark(f"{text}: {what} {values}", is_failure=False)
    yield from (Remark(text, is_failure=False) for text in _mixed_versions(cases))


def _mixed_versions(cases: Iterable[CaseResult]) -> Iterator[str]:
    """Yield of what cases had different versions, which may tell in their figures."""
    counts: dict[str, Counter[str]] = {}
    for case in cases:
        for name, version in case.versions.items():
            counts.setdefault(name, Counter())[version] += 1
    for name, by_version in counts.items():
        if len(by_version) > 1:
            versions = (f"{printable(version)} ({count})" for version, count in by_version.most_common())
            different = f"Cases ran with different versions of {printable(name)}: {', '.join(versions)}"
            yield f"{different}; a run with --fresh has one"


def _lead(ranking: Standings) -> Lead:
    sound = [standing for standing in ranking.order if not standing.failed]
    if not ranking.order:
        return Lead.NOBODY
    if not sound:
        return Lead.ALL_FAIL
    if len(ranking.order) == 1:
        return Lead.ONLY_ONE
    if ranking.disagreements:
        return Lead.BY_SCENARIO
    if len(sound) == 1:
        return Lead.ONLY_SOUND
    if len(ranking.leaders) > 1 and ranking.is_pareto:
        return Lead.FRONT
    if len(ranking.leaders) > 1:
        pairs = combinations(ranking.leaders, 2)
        alike = ranking.tested and all(ranking.is_surely_small(*pair) for pair in pairs)
        return Lead.ALIKE if alike else Lead.LEVEL
    if ranking.tested and ranking.order[0].worst > 1:  # others are behind others, but none behind it
        return Lead.LEVEL
    return Lead.AHEAD if ranking.tested or ranking.seeds < 2 else Lead.BEST_MEDIAN
