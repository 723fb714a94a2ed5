"""docs/benchmark.md and the summary of its study say what the tables say that a script writes from a run."""

import importlib.util
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import pytest
from scipy.stats import spearmanr

from ddpc_cosim import studies
from ddpc_cosim.study.reading import read_study

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "benchmark.md").read_text(encoding="utf-8")
STUDY = read_study("benchmark")
FAILED = -100
"""What a problem counts in a median in which at least half of a method's runs failed."""
NO_CODE = "no C"
LITTLE = 5.0
"""Memory in kB below which a method is said to take little."""


class Method(NamedTuple):
    """A row of the first table, and its rows of those by problem; memory in kB."""

    rank: float
    share: int
    regret: int
    failed: int
    runs: int
    step: int
    samples: int
    by_problem: Mapping[str, int]
    memory: str
    memory_by_problem: Mapping[str, tuple[float, ...]]


def table(name: str) -> list[list[str]]:
    """Return the cells of a table of the page, its head first."""
    match = re.search(rf"<!-- table: {name} -->\n(.*?)<!-- end -->", PAGE, re.DOTALL)
    assert match, name
    lines = [line for line in match[1].splitlines() if not line.startswith("|---")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def number(text: str) -> int:
    """Return the first number of a cell; of a word 0."""
    digits = re.match(r"-?\d+", text)
    return int(digits[0]) if digits else 0


def read_methods() -> dict[str, Method]:
    (_, *problems), *shares = table("problems")
    by_problem = {
        label: {
            problem: FAILED if cell == "failed" else number(cell)
            for problem, cell in zip(problems, cells, strict=True)
        }
        for label, *cells in shares
    }
    (_, *problems), *parts = table("memory")
    memory_by_problem = {
        label: {
            problem: tuple(map(float, cell.split(" + ")))
            for problem, cell in zip(problems, cells, strict=True)
            if cell != NO_CODE
        }
        for label, *cells in parts
    }
    methods = {}
    for label, rank, share, regret, failed, step, memory, samples in table("methods")[1:]:
        missed, _, runs = failed.partition(" of ")
        numbers = number(share), number(regret), int(missed), int(runs), number(step), number(samples)
        by = by_problem[label], memory, memory_by_problem[label]
        methods[label] = Method(float(rank), *numbers, *by)
    return methods


METHODS = read_methods()


def listed(labels: Iterable[str]) -> str:
    """Return labels as a sentence has them."""
    words = [label.replace("Gamma", "gamma").replace("Intelligent", "intelligent") for label in labels]
    return f"{', '.join(words[:-1])} and {words[-1]}" if words[1:] else words[0]


def span(values: Iterable[int]) -> str:
    """Return from the least to the largest."""
    low, *_, high = sorted(values)
    return f"{low} to {high}"


def plain(text: str) -> str:
    """Return a text on one line."""
    return " ".join(text.split())


def test_the_tables_are_of_this_study() -> None:
    problem = STUDY.problems["pendulum"].study
    labels = {section.label for section in problem.controllers.values()}
    points = {problem.controllers[name].label for name in ("idle", "nmpc")}
    assert METHODS.keys() == labels - points
    for method in METHODS.values():
        assert method.by_problem.keys() == STUDY.problems.keys()
    runs = sum(len(of.study.scenarios) for of in STUDY.problems.values()) * len(problem.seeds)
    assert {method.runs for method in METHODS.values()} == {runs}
    count = sum(
        len(of.study.scenarios) * (1 if section.seeds == "first" else len(problem.seeds))
        for of in STUDY.problems.values()
        for section in of.study.controllers.values()
    )
    cases = f"{count:,}".replace(",", " ")
    assert f"of {cases} runs." in plain(PAGE)
    assert re.search(rf"run benchmark +# {cases} cases:", PAGE)


@pytest.mark.parametrize("label", METHODS)
def test_a_share_over_all_problems_is_the_median_of_theirs(label: str) -> None:
    method = METHODS[label]
    assert abs(median(method.by_problem.values()) - method.share) <= 1


@pytest.mark.parametrize("label", METHODS)
def test_memory_over_all_problems_is_the_median_of_theirs(label: str) -> None:
    method = METHODS[label]
    sums = [sum(parts) for parts in method.memory_by_problem.values()]
    if not sums:
        assert method.memory == NO_CODE
        return
    said = re.fullmatch(r"([\d.]+) kB \[([\d.]+) … ([\d.]+)\]", method.memory)
    assert said
    wanted = [median(sums), min(sums), max(sums)]
    assert list(map(float, said.groups())) == pytest.approx(wanted, rel=0.08, abs=0.15)  # of rounded parts


def test_memory_is_what_the_code_of_today_takes() -> None:
    spec = importlib.util.spec_from_file_location(
        "benchmark_tables", DOCS / "scripts" / "benchmark_tables.py"
    )
    assert spec
    assert spec.loader
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    problem = STUDY.problems["pendulum"]
    alone = replace(STUDY, problems={"pendulum": problem})
    labels = {key: section.label for key, section in problem.study.controllers.items()}
    taken = tables.footprints(alone, [key for key, label in labels.items() if label in METHODS])
    measured = {labels[key]: tables.footprint_words(of["pendulum"]) for key, of in taken.items()}
    (_, *problems), *parts = table("memory")
    assert measured == {label: cells[problems.index("pendulum")] for label, *cells in parts}


def test_memory_grows_with_the_inputs_that_are_planned() -> None:
    """Of each method that plans, over the problems, by Spearman's rank correlation."""
    in_c = [label for label, method in METHODS.items() if method.memory != NO_CODE]
    planning = [label for label in in_c if "horizon" in settings_of(label)]
    assert len(planning) >= 8
    for label in planning:
        memory = METHODS[label].memory_by_problem
        planned = [
            settings_of(label, where)["horizon"] * len(STUDY.problems[where].inputs) for where in memory
        ]
        assert spearmanr(planned, [sum(parts) for parts in memory.values()]).statistic > 0.6


def settings_of(label: str, problem: str = "pendulum") -> Mapping[str, Any]:
    """Return the settings of a method; within a band's edge, those of the controller inside."""
    controllers = STUDY.problems[problem].study.controllers.values()
    settings = next(section.settings for section in controllers if section.label == label)
    inside: Mapping[str, Any] = settings.get("controller", settings)
    return inside


def by_memory() -> tuple[list[str], list[str]]:
    """Return the methods that have C code by memory, the least first: who takes little, and the others."""
    in_c = {label: kilobytes(label) for label, method in METHODS.items() if method.memory != NO_CODE}
    labels = sorted(in_c, key=in_c.__getitem__)
    return [of for of in labels if in_c[of] < LITTLE], [of for of in labels if in_c[of] >= LITTLE]


def kilobytes(label: str) -> float:
    """Return how much memory a method takes in the median."""
    return float(METHODS[label].memory.partition(" ")[0])


def of_memory() -> str:
    """Return which methods take little memory and which much."""
    little, much = by_memory()
    spans = [f"{kilobytes(of[0]):g} to {kilobytes(of[-1]):g} kB" for of in (little, much)]
    sums = {
        (label, problem): sum(parts)
        for label, method in METHODS.items()
        for problem, parts in method.memory_by_problem.items()
    }
    most, where = max(sums, key=sums.__getitem__)
    without = [label for label, method in METHODS.items() if method.memory == NO_CODE]
    assert all(METHODS[of].memory_by_problem.keys() == STUDY.problems.keys() for of in (*little, *much))
    return (
        f"**Memory in C** is {spans[0]} for {listed(little)}, and {spans[1]} for {listed(much)}; the most is "
        f"{METHODS[most].memory.rstrip(']').rpartition(' ')[2]} kB, of {most} on {coded([where])}. "
        f"{listed(without)} has no C code, all others have it on every problem."
    )


def of_many() -> str:
    """Return what a hundred seeds show that twenty do not."""
    (_, *head), *lines = table("many")
    scenarios = head[: head.index("most often")]
    cells = [dict(zip(head, cells, strict=True)) | {"method": label} for label, *cells in lines]
    count = sum(int(cell[scenario]) for cell in cells for scenario in scenarios)
    rare = [(*found[0], cell["method"]) for cell in cells if (found := _RARE.findall(cell["most often"]))]
    problem, scenario, failed, label = max(rare, key=lambda one: int(one[2]))
    (few, few_open), (many, many_open) = (
        [sum(int(row[place]) for row in table("pairs")[1:] if row[2] == seeds) for place in (3, 6)]
        for seeds in ("20", "100")
    )
    assert many < few
    return (
        f"In {count} cases of a method on a problem in a scenario none of 20 runs failed and 1 to {failed} "
        f"of 100 did, most often {label} on `{problem}` under `{scenario}`. Of {few} pairs 20 seeds leave "
        f"{few_open} open, of {many} 100 seeds {many_open}: fewer pairs, as more methods have a failed run."
    )


_RARE = re.compile(r"([\w-]+) under `([\w-]+)` (\d+) of 100")


def coded(problems: Iterable[str]) -> str:
    """Return names of problems as a sentence has them."""
    words = [f"`{problem}`" for problem in problems]
    return f"{', '.join(words[:-1])} and {words[-1]}" if words[1:] else words[0]


def shares_by(name: str) -> dict[str, dict[str, int]]:
    """Return a table's shares by its first column, then by its head."""
    (_, *head), *lines = table(name)
    return {label: dict(zip(head, map(number, cells), strict=True)) for label, *cells in lines}


def failing(label: str) -> list[str]:
    """Return the problems in which at least half of a method's runs failed."""
    return [problem for problem, share in METHODS[label].by_problem.items() if share == FAILED]


def sentences() -> list[str]:
    """Return what is to be read between the tables, with the numbers of these."""
    problems = [*STUDY.problems]
    leading = [label for label, method in METHODS.items() if method.share >= 98]
    assert all(METHODS[label].samples for label in leading)
    apart = {problem: [METHODS[label].by_problem[problem] for label in leading] for problem in problems}
    apart = {problem: shares for problem, shares in apart.items() if max(shares) - min(shares) > 5}
    alike = ("DeePC", "SPC", "Gamma-DDPC")
    unlike = [
        problem
        for problem in problems
        if max(shares := [METHODS[label].by_problem[problem] for label in alike]) - min(shares) > 2
    ]
    by_failures = sorted(METHODS, key=lambda label: METHODS[label].failed)
    few, many = by_failures[:3], by_failures[:-4:-1]
    runs = METHODS["PID"].runs
    without = [label for label, method in METHODS.items() if not method.samples]
    assert {*without} == {"Intelligent PID", "MFAPC", "SPSA-tuned PID", "MFAC"}
    intelligent = METHODS["Intelligent PID"].by_problem.values()
    assert min(intelligent) > 0
    good = [
        problem
        for problem in problems
        if min(METHODS[a].by_problem[problem] for a in ("MFAPC", "MFAC")) >= 90
    ]
    alone = [
        problem
        for problem in problems
        if METHODS["GPC"].by_problem[problem]
        > max(method.by_problem[problem] for label, method in METHODS.items() if label != "GPC")
    ]
    scenarios, hard = shares_by("scenarios"), shares_by("hard")
    lost = {label: of["nominal"] - of["drift"] for label, of in scenarios.items()}
    most = max(lost, key=lost.__getitem__)
    ahead = [
        f"{what.rpartition(' (')[0]} {listed(best)} ({max(of.values())} %)"
        for what, of in hard.items()
        for best in [[label for label, share in of.items() if share == max(of.values())]]
    ]
    return [
        f"**With a recording**, {listed(leading)} come {span(METHODS[label].share for label in leading)} % "
        f"far in the median over the problems; they part by more than five points on {coded(apart)}.",
        f"DeePC, SPC and gamma-DDPC are within two points of each other on {len(problems) - len(unlike)} of "
        f"{len(problems)} problems, but not on {coded(unlike)}.",
        f"**{few[0]} has the fewest failed runs**, {METHODS[few[0]].failed} of {runs}, then {few[1]} with "
        f"{METHODS[few[1]].failed} and {few[2]} with {METHODS[few[2]].failed}; {many[0]} has the most, "
        f"{METHODS[many[0]].failed}.",
        f"**Without a recording** intelligent PID comes {span(intelligent)} % far on every problem.",
        f"MFAPC and MFAC both reach at least 90 % on {coded(good)}; MFAPC fails on "
        f"{coded(failing('MFAPC'))}, MFAC on {coded(failing('MFAC'))}, PID on {coded(failing('PID'))}, its "
        f"tuning by SPSA on {coded(failing('SPSA-tuned PID'))}.",
        "**GPC**, which learns on from the same recording, has the largest share alone on "
        f"{coded(alone)}; it comes {METHODS['GPC'].share} % far over all.",
        f"**Under drift** {most} loses the most of its median share in `nominal`, {lost[most]} points; of "
        f"{listed(leading)} none loses more than {max(lost[label] for label in leading)}.",
        of_memory(),
        f"**Who is ahead by what is hard**: {'; '.join(ahead)}.",
    ]


@pytest.mark.parametrize("sentence", sentences())
def test_a_sentence_says_what_the_tables_say(sentence: str) -> None:
    assert sentence in plain(PAGE)


def test_what_a_hundred_seeds_show_is_what_their_tables_say() -> None:
    assert of_many() in plain(PAGE)
    for _, _, _, *numbers in table("pairs")[1:]:
        total, *parts = map(int, numbers)
        assert sum(parts) == total
    for _, *cells in table("many")[1:]:
        assert (cells[-3] == "none") == (not any(map(int, cells[:-3])))


def test_what_second_tunings_moved_is_what_their_table_says() -> None:
    moved = {problem: (float(tau), cells) for problem, tau, cells in table("again")[1:]}
    assert list(moved) == list(STUDY.problems)
    least = min(moved, key=lambda problem: moved[problem][0])
    others = [tau for problem, (tau, _) in moved.items() if problem != least]
    money = [float(value) for value in re.findall(r" (\d[\d.]*)", moved[least][1])]
    assert (
        f"It is {min(others):.2f} to {max(others):.2f}, but {moved[least][0]:.2f} on {coded([least])}. "
        f"There the figure is money, and those that change places pay {min(money):g} to {max(money):g} EUR."
    ) in plain(PAGE)


def test_no_other_sentence_has_a_number() -> None:
    begin, end = PAGE.index("How to read it, for a choice:"), PAGE.index("What tuning chose, where")
    rest = plain(PAGE[begin:end])
    for sentence in sentences():
        rest = rest.replace(sentence, "")
    assert not re.search(r"\d", rest), rest


def test_the_summary_of_the_study_says_what_the_tables_say() -> None:
    leading = [label for label, method in METHODS.items() if method.share >= 98]
    intelligent = METHODS["Intelligent PID"]
    rest = [METHODS[label] for label in ("PID", "SPSA-tuned PID", "MFAC", "MFAPC", "WKPC")]
    best = min(METHODS.values(), key=lambda method: method.failed)
    (label,) = [label for label, method in METHODS.items() if method is best]
    said = (
        "Seventeen problems, up to seven scenarios, 20 seeds; every method is tuned with the same budget of "
        "48 trials. On the way from doing nothing to a nonlinear MPC that knows the plant's equations, "
        f"{listed(leading)} come {span(METHODS[label].share for label in leading)} % far in the median over "
        f"the problems, with a recording of about {METHODS['DeePC'].samples} samples, LQR "
        f"{METHODS['LQR'].share} %. Intelligent PID, which needs no recording, comes {intelligent.share} % "
        f"far; PID, SPSA, MFAC, MFAPC and WKPC come "
        f"{span(method.share for method in rest)} % far, and each of these five fails in "
        f"{span(method.failed for method in rest)} of {best.runs} runs. {label} fails in {best.failed}. No "
        "method is the best everywhere: the report says which one where."
    )
    assert plain(tomllib.loads(studies.benchmark.read_text(encoding="utf-8"))["summary"]) == said
