"""One sentence says where no controller follows its reference, and none where that cannot be judged."""

import math
from pathlib import Path

import pytest
from ddpc_cosim.study.following import WHY, following_lines, left_by, none_follows

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.study.file_format.sections import Study


def case(
    controller: str,
    *shares: float,
    outcome: Outcome = Outcome.COMPLETED,
    holds: bool = True,
    scenario: str = "nominal",
    at_limits: float = 0.0,
    warnings: tuple[str, ...] = (),
) -> CaseResult:
    """Return a case of one output per share, and how long [s] of 10 s its input was at its limits."""
    metrics = {f"settled_share.y{n} [%]": share for n, share in enumerate(shares)}
    metrics["time_at_bounds.u [s]"] = at_limits
    head = ("id", controller, controller, scenario, 0, outcome, "", holds)
    return CaseResult(*head, metrics, {}, {}, warnings, Path())


@pytest.mark.parametrize(
    ("cases", "sentence"),
    [
        ([case("a", 4.9), case("b", 60.0, holds=False)], ""),
        (
            [case("a", 42.0), case("b", 60.0, holds=False)],
            "No controller follows the reference; the best leaves 42 % of its change",
        ),
        # Of several outputs the worst counts; one whose reference has no steps does not.
        (
            [case("a", 1.0, 7.25)],
            "No controller follows the reference; the best leaves 7.2 % of its change",
        ),
        ([case("a", 1.0, math.nan)], ""),
        ([case("a", math.nan)], ""),  # regulation: nothing to size an error by
        # Over the seeds it is the median.
        ([case("a", 3.0), case("a", 90.0), case("a", 4.0)], ""),
        (
            [case("a", 3.0), case("a", 90.0), case("a", 80.0)],
            "No controller follows the reference; the best leaves 80 % of its change",
        ),
        (
            [case("a", 1.0, outcome=Outcome.DIVERGED, holds=False), case("b", 2.0, holds=False)],
            "No controller follows the reference; no run completes within its limits",
        ),
        # A run that ends before its first window leaves no figure, and yet does not follow.
        (
            [case("a", 3.0), *2 * [case("a", outcome=Outcome.CRASHED, holds=False)], case("b", 30.0)],
            "No controller follows the reference; the best leaves 30 % of its change",
        ),
        (
            [case("a", 3.0), *2 * [case("a", outcome=Outcome.CRASHED, holds=False)]],
            "No controller follows the reference; none completes most of its runs within its limits",
        ),
        (
            [case("a", outcome=Outcome.CRASHED, holds=False)],
            "No controller follows the reference; no run completes within its limits",
        ),
        # Regulation, which some fail and some do not: what is left cannot be sized.
        ([*2 * [case("a", outcome=Outcome.DIVERGED, holds=False)], case("a", math.nan)], ""),
        (
            [case("a", 480.0, holds=False)],
            "No controller follows the reference; the best ends further from it than it began",
        ),
        ([], ""),
    ],
)
def test_the_sentence_is_said_where_it_is_true(cases: list[CaseResult], sentence: str) -> None:
    assert none_follows(cases) == sentence


def test_a_run_that_fell_out_of_its_limits_leaves_more_than_any_number() -> None:
    assert left_by(case("a", 1.0, holds=False)) == math.inf
    assert left_by(case("a", 70.0, holds=False)) == 70.0


def study_of_three(limitations: list[str]) -> Study:
    return Study.model_validate(
        {
            "name": "s",
            "seeds": [0],
            "plant": {"name": "pendulum"},
            "loop": {"sampling_time": 0.1, "duration": 10.0},
            "reference": {"angle": {"kind": "constant", "value": 1.0}},
            "controllers": {"a": {"type": "pid"}},
            "report": {"limitations": limitations},
            "scenarios": {"calm": {}, "storm": {"label": "in a storm"}, "blind": {}},
        }
    )


def test_scenarios_are_told_apart_and_a_likely_reason_is_named() -> None:
    study = study_of_three(["One seed only."])
    cases = [case("a", 1.0, scenario="calm"), case("a", 30.0, scenario="storm", at_limits=8.0)]
    cases.append(case("a", 30.0, scenario="blind", warnings=("the recording is poor", "the model too")))
    assert following_lines(study, cases) == [
        "in a storm: No controller follows the reference; the best leaves 30 % of its change; "
        "at its limits: u 80 % of the time",
        "blind: No controller follows the reference; the best leaves 30 % of its change; "
        "the recording is poor",
    ]


def test_the_reason_that_the_study_gives_comes_before_what_was_warned_of() -> None:
    study = study_of_three([f"{WHY}y does not go above 12"])
    cases = [case("a", 30.0, scenario="blind", warnings=("the recording is poor",))]
    sentence = (
        "No controller follows the reference; the best leaves 30 % of its change; y does not go above 12"
    )
    assert following_lines(study, cases) == [sentence]
    assert following_lines(study, [case("a", 3.0, scenario="blind")]) == []
