"""docs/benchmark.md and the summary of its study say what the tables say that a script writes from a run."""

import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import median
from typing import NamedTuple

import pytest

from ddpc_cosim import studies
from ddpc_cosim.study.reading import read_study

PAGE = (Path(__file__).parents[1] / "docs" / "benchmark.md").read_text(encoding="utf-8")
STUDY = read_study("benchmark")
FAILED = -100
"""What a problem counts in a median in which at least half of a method's runs failed."""
OSCILLATOR, BOILER = "van-der-pol", "boiler-turbine"


class Method(NamedTuple):
    """A row of the first table, and its row of the second."""

    rank: float
    share: int
    failed: int
    runs: int
    step: int
    samples: int
    by_problem: Mapping[str, int]


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
    methods = {}
    for label, rank, share, failed, step, samples in table("methods")[1:]:
        missed, _, runs = failed.partition(" of ")
        numbers = number(share), int(missed), int(runs), number(step), number(samples)
        methods[label] = Method(float(rank), *numbers, by_problem[label])
    return methods


METHODS = read_methods()


def listed(labels: Iterable[str]) -> str:
    """Return labels as a sentence has them."""
    words = [label.replace("Gamma", "gamma").replace("Intelligent", "intelligent") for label in labels]
    return f"{', '.join(words[:-1])} and {words[-1]}"


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
    scenarios = {len(of.study.scenarios) for of in STUDY.problems.values()}
    assert len(scenarios) == 1
    runs = len(STUDY.problems) * scenarios.pop() * len(problem.seeds)
    assert {method.runs for method in METHODS.values()} == {runs}
    cases = f"{runs * len(labels):,}".replace(",", " ")
    assert f"of {cases} runs." in plain(PAGE)
    assert re.search(rf"run benchmark +# {cases} cases:", PAGE)


@pytest.mark.parametrize("label", METHODS)
def test_a_share_over_all_problems_is_the_median_of_theirs(label: str) -> None:
    method = METHODS[label]
    assert abs(median(method.by_problem.values()) - method.share) <= 1


def sentences() -> list[str]:
    """Return what is to be read between the tables, with the numbers of these."""
    leading = [label for label, method in METHODS.items() if method.share >= 99]
    apart = {
        problem: sorted({METHODS[label].by_problem[problem] for label in leading})
        for problem in STUDY.problems
    }
    apart = {problem: shares for problem, shares in apart.items() if shares[-1] - shares[0] > 1}
    assert apart.keys() == {OSCILLATOR, BOILER}
    *others, ahead, best = apart[OSCILLATOR]
    assert len(others) == 1
    alike = ("DeePC", "SPC", "Gamma-DDPC")
    for problem in STUDY.problems:
        shares = [METHODS[label].by_problem[problem] for label in alike]
        assert max(shares) - min(shares) <= 2
    by_failures = sorted(METHODS, key=lambda label: METHODS[label].failed)
    fewest, second, third = (METHODS[label] for label in by_failures[:3])
    without = {label: method.by_problem for label, method in METHODS.items() if not method.samples}
    intelligent = without["Intelligent PID"].values()
    assert min(intelligent) > 0
    good = ["cart-pendulum", "cstr", "building", "quadruple-tank"]
    reached = [without[label][problem] for label in ("MFAPC", "MFAC") for problem in good]
    for label in ("MFAPC", "MFAC"):
        assert without[label][OSCILLATOR] <= 0
    failing = {label for label, method in METHODS.items() if method.by_problem[BOILER] == FAILED}
    assert failing == {"MFAC", "PID", "SPSA-tuned PID"}
    assert METHODS["LQR"].share == METHODS["WKPC"].share
    return [
        f"**With a recording of a hundred samples**, {listed(leading)} come 99 % far or more in the median "
        f"over the problems; they part on two of them, the unstable oscillator ({ahead} and {best} % of the "
        f"way against {others[0]} %) and the boiler.",
        "DeePC, SPC and gamma-DDPC are nearly the same method here: with the same budget none of them is "
        "far from another, on any problem.",
        f"**{by_failures[0]} has the fewest failed runs**, {fewest.failed} of {fewest.runs}, then "
        f"{by_failures[1]} with {second.failed} and {by_failures[2]} with {third.failed}.",
        f"**Without a recording** intelligent PID comes {span(intelligent)} % far on every problem.",
        f"MFAPC and MFAC reach {span(reached)} % on `{'`, `'.join(good[:-1])}` and `{good[-1]}`, and do next "
        "to nothing or fail on the oscillator; MFAC, PID and its tuning by SPSA fail on the boiler.",
        f"**LQR and WKPC** come {METHODS['LQR'].share} % far; WKPC is at "
        f"{METHODS['WKPC'].by_problem[OSCILLATOR]} % on the oscillator.",
    ]


@pytest.mark.parametrize("sentence", sentences())
def test_a_sentence_says_what_the_tables_say(sentence: str) -> None:
    assert sentence in plain(PAGE)


def test_no_other_sentence_has_a_number() -> None:
    begin, end = PAGE.index("How to read it, for a choice:"), PAGE.index("What tuning chose, where")
    rest = plain(PAGE[begin:end])
    for sentence in sentences():
        rest = rest.replace(sentence, "")
    assert not re.search(r"\d", rest), rest


def test_the_summary_of_the_study_says_what_the_tables_say() -> None:
    leading = [label for label, method in METHODS.items() if method.share >= 99]
    shares = [METHODS[label].share for label in leading]
    steps = [METHODS[label].step for label in (*leading, "LQR", "WKPC")]
    assert all(10 <= step <= 100 for step in steps)
    intelligent = METHODS["Intelligent PID"]
    rest = [METHODS[label] for label in ("PID", "SPSA-tuned PID", "MFAC", "MFAPC")]
    assert all(FAILED in (method.by_problem[OSCILLATOR], method.by_problem[BOILER]) for method in rest)
    assert METHODS["LQR"].share == METHODS["WKPC"].share
    best = METHODS["Koopman MPC"]
    assert best.failed == min(method.failed for method in METHODS.values())
    said = (
        "Ten problems, six scenarios, 20 seeds; every method is tuned with the same budget of 48 trials. On "
        "the way from doing nothing to a nonlinear MPC that knows the plant's equations, "
        f"{listed(leading)} come {span(shares)} % far in the median over the problems, LQR and WKPC "
        f"{METHODS['LQR'].share} %, with a recording of about a hundred samples and some tens of "
        "microseconds a step. Intelligent PID, which needs no recording, comes "
        f"{intelligent.share} % far and {min(intelligent.by_problem.values())} % at least; PID, SPSA, MFAC "
        f"and MFAPC come {span(method.share for method in rest)} % far, and each of these four fails in "
        f"{span(method.failed for method in rest)} of {best.runs} runs, in at least half of those on the "
        f"boiler or on the unstable oscillator. Koopman MPC fails in {best.failed} of {best.runs} runs. No "
        "method is the best everywhere: the report says which one where."
    )
    assert plain(tomllib.loads(studies.benchmark.read_text(encoding="utf-8"))["summary"]) == said
