"""The leaderboard: the results of several submissions to a benchmark as those of one study."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

from ddpc_cosim.benchmarking.submission import RESULTS_FOLDER, Entry
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.results import StudyResults, load_results
from ddpc_cosim.study.verdicts.changes import settings_between


def leaderboard(folders: Sequence[Path]) -> StudyResults:
    """Return the results of submissions as those of one study, each of whose controllers is one of them.

    Reference points are those of the first submission that has a problem. Where two submissions are called
    alike, each is called after its folder too.

    Raises
    ------
    ConfigError
        One is no submission, or two are not of the same benchmark: all reasons.
    """
    entries = [Entry.read(folder) for folder in folders]
    results = [load_results(folder / RESULTS_FOLDER) for folder in folders]
    labels = [entry.controller.get("label") or entry.name for entry in entries]
    problems: dict[str, Study] = {}
    cases, resting, damaged, faults = [], [], dict[str, str](), list[str]()
    for folder, entry, submitted, label in zip(folders, entries, results, labels, strict=True):
        is_alone = [other.name for other in entries].count(entry.name) == 1
        name = entry.name if is_alone else f"{entry.name}-{folder.resolve().name}"
        shown = label if labels.count(label) == 1 else f"{label} ({folder.resolve().name})"
        head = submitted.whole.head
        for key, study in submitted.whole.problems.items():
            problem = head.based_on[0] if submitted.whole.is_flat else key
            section = replace(study.controllers[entry.name], label=shown)
            points = {other: study.controllers[other] for other in study.controllers if other != entry.name}
            terms = replace(
                study, name=problem, title=study.title if not submitted.whole.is_flat else problem
            )
            is_first = problem not in problems
            before = problems.setdefault(problem, replace(terms, controllers=points))
            for path in settings_between(_terms(before, points), _terms(terms, points)):
                faults.append(f"{folder}: not of the benchmark of {folders[0]}: {path} of {problem} differs")
            problems[problem] = replace(before, controllers=before.controllers | {name: section})
            of_problem = [case for case in submitted.cases if case.problem == key]
            cases += [
                replace(case, problem=problem, controller=name, label=shown)
                if case.controller == entry.name
                else replace(case, problem=problem)
                for case in of_problem
                if is_first or case.controller == entry.name
            ]
            if is_first:
                resting += [
                    replace(case, problem=problem) for case in submitted.resting if case.problem == key
                ]
        damaged |= submitted.damaged
    if faults:
        raise ConfigError(faults)
    count = "1 submission" if len(folders) == 1 else f"{len(folders)} submissions"
    benchmark = results[0].whole.head.based_on[0]
    head = replace(
        results[0].whole.head,
        name=f"{benchmark}-leaderboard",
        title=f"Leaderboard: {benchmark}",
        summary=f"{count}: {', '.join(labels)}. Each was tuned and run by whoever entered it; "
        "`ddpc-cosim benchmark verify` checks one.",
    )
    whole = WholeStudy(head, problems)
    if len(problems) == 1:
        only = next(iter(problems.values()))
        whole = WholeStudy.of(replace(only, name=head.name, title=head.title, summary=head.summary))
        cases, resting = ([replace(case, problem=head.name) for case in some] for some in (cases, resting))
    return StudyResults(folders[0], whole, tuple(cases), {}, tuple(resting), damaged)


def _terms(study: Study, points: Collection[str]) -> WholeStudy:
    """Return what a problem asks, whoever is asked."""
    controllers = {name: section for name, section in study.controllers.items() if name in points}
    return WholeStudy.of(replace(study, controllers=controllers, name="", title="", summary="", based_on=[]))
