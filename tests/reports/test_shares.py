"""Reference points in the page: shown as what they are, never first; shares follow from the cases."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.files.tables import Table
from ddpc_cosim.study.file_format.sections import StudyHead
from ddpc_cosim.study.problems import WholeStudy
from ddpc_reports import sections
from ddpc_reports.across_problems import overall, overall_statements, overall_table
from ddpc_reports.certainty import certainty_tables
from ddpc_reports.comparison import Condition, conditions
from ddpc_reports.distances import distance_maps
from ddpc_reports.fairness import fairness_statements
from ddpc_reports.page import render_page
from ddpc_reports.shares import share_statements
from ddpc_reports.verdict import Statement

from .synthetic import MakeResults, findings_of, make_trace, ranked

KEY = "mean_abs_error.angle [deg]"
LAGS = {"ideal": 0.1, "good": 0.3, "fair": 0.8, "poor": 30.0, "rest": 10.0}
FIVE = {key: {"type": key, "label": key.capitalize()} for key in LAGS}
POINTS = {"reference_points": {"zero": "rest", "full": "ideal"}}


def run_of(key: str, seed: int) -> Trace:
    return make_trace(
        LAGS[key] * (1 + seed / 100), noise_seed=seed, step_time=1e-6 if key == "rest" else 1e-5
    )


def texts(statements: list[Statement]) -> dict[str, str]:
    return {topic: re.sub("<[^>]*>", "", str(text)).replace("\u00a0", " ") for topic, text in statements}


def cells(table: Table | None, words: str) -> dict[str, str]:
    assert table
    place = [heading.words.replace("\u00a0", " ") for heading in table.headings[1:]].index(words)
    return {row.key: row.cells[place].text.strip() for row in table.rows}


@pytest.fixture
def results(make_results: MakeResults) -> StudyResults:
    return make_results(run_of, FIVE, seeds=[*range(8)], report=POINTS)


@pytest.fixture
def seen(results: StudyResults) -> Condition:
    (only,) = conditions(results)
    return only


def test_shares_are_those_of_the_metrics_file(results: StudyResults, seen: Condition) -> None:
    errors = results.frame().pivot(index="seed", columns="controller", values=KEY)
    share = (errors["rest"] - errors["good"]) / (errors["rest"] - errors["ideal"])
    assert seen.shares(KEY)["good"].median == pytest.approx(np.median(share))
    shown = cells(ranked(seen), "share of the way median (%)")
    # Whose runs failed is told so; the reference points are the ends of the scale.
    assert shown == {"good": f"{100 * np.median(share):.0f}", "fair": shown["fair"], "poor": "failed"} | {
        "ideal": "100",
        "rest": "0",
    }
    assert 0 < int(shown["fair"]) < int(shown["good"]) < 100
    sure = certainty_tables(seen, "")[0]
    of_errors = replace(sure, rows=sure.rows[:5])
    assert cells(of_errors, "share of the way median (%)") == shown
    low, _, high = cells(of_errors, "share of the way interval (%)")["good"].partition(" … ")
    assert float(low) <= 100 * np.median(share) <= float(high)


def test_a_reference_point_that_is_run_once_has_its_place_beside_all_seeds(
    make_results: MakeResults, results: StudyResults
) -> None:
    once = FIVE | {"ideal": FIVE["ideal"] | {"seeds": "first"}}
    (only,) = conditions(make_results(run_of, once, seeds=[*range(8)], report=POINTS))
    errors = results.frame().pivot(index="seed", columns="controller", values=KEY)
    share = (errors["rest"] - errors["good"]) / (errors["rest"] - errors["ideal"][0])
    assert only.shares(KEY)["good"].median == pytest.approx(np.median(share))
    terms = texts(fairness_statements(only.results, [only]))
    assert terms["Seeds"] == (
        "Ideal (100 %) is run with seed 0 alone, beside which runs of all seeds are set; all others with "
        "seeds 0\N{EN DASH}7."
    )
    everyone = fairness_statements(results, conditions(results))
    assert "Seeds" not in texts(everyone)


def test_reference_points_are_named_and_never_ranked(seen: Condition) -> None:
    assert [controller.label.replace("\u00a0", " ") for controller in seen.controllers] == [
        *("Good", "Fair", "Poor"),
        *("Ideal (100 %)", "Rest (0 %)"),
    ]
    assert [controller.key for _, controller in seen.ranking(KEY)] == ["good", "fair"]
    assert seen.compared(KEY).order == ("good", "fair")
    assert [controller.key for controller in seen.not_ranked] == ["poor"]
    statements = texts([*share_statements(seen), *findings_of(seen)])
    assert statements["Distance"].startswith(
        "Of the way from Rest (0 %) to Ideal (100 %), which do not compete: Good "
    )
    assert statements["Distance"].endswith("; worse than at 0 %, or failed: Poor.")
    assert statements["Tracking"].startswith("On seed 0, Good tracks best")
    assert "failed: Poor 8 of 8." in statements["Completed"]
    assert "Rest" not in statements["Step time"].partition("No step")[0]
    marks = {row.key for row in ranked(seen).rows if any(cell.best for cell in row.cells)}
    assert not marks & {"ideal", "rest"}


@pytest.mark.parametrize(
    ("falling", "words"),
    [
        ("rest", "there is no way to go: Rest (0 %) did not complete."),
        ("ideal", "there is no way to go: every run of Ideal (100 %) failed."),
        ("in turn", "no seed on which Rest (0 %) completed and Ideal (100 %) did not fail."),
        ("equal", "Ideal (100 %) is not better than Rest (0 %) by more than 1 % on any seed."),
    ],
)
def test_without_a_way_to_go_the_page_says_why(make_results: MakeResults, falling: str, words: str) -> None:
    def fallen(key: str, seed: int) -> Trace:
        if falling == "equal" and key == "rest":
            return run_of("ideal", seed)
        falls = key == ("rest", "ideal")[seed] if falling == "in turn" else key == falling
        return make_trace(1.0, outcome=Outcome.DIVERGED, reason="NaN") if falls else run_of(key, seed)

    (seen,) = conditions(make_results(fallen, FIVE, seeds=[0, 1], report=POINTS))
    assert texts(share_statements(seen))["Distance"].endswith(words)
    assert "share of the way" not in [heading.group for heading in ranked(seen).headings]


def test_over_problems_ranks_distances_and_costs(make_results: MakeResults) -> None:
    def failing_in_the_third(n: int, key: str, seed: int) -> Trace:
        return make_trace(30.0 if (n, key) == (2, "fair") else LAGS[key] * (1 + n / 10), noise_seed=seed)

    problems = [
        make_results(
            lambda key, seed, n=n: failing_in_the_third(n, key, seed),
            FIVE,
            name=f"p{n}",
            seeds=[0, 1],
            report=POINTS,
        )
        for n in range(3)
    ]
    comparison = overall(problems)
    assert comparison
    assert comparison.distances
    assert list(comparison.findings.ranks.ranks) == ["good", "fair", "poor"]
    statements = texts(overall_statements(comparison))
    good = [100 * comparison.distances.problems[name]["good"].median for name in ("p0", "p1", "p2")]
    assert f"in the median of 3 problems: Good {sorted(good)[1]:.0f} % (from" in statements["Distance"]
    assert "; Fair 83 % (from failed in p2 to 84 % in p0); Poor failed." in statements["Distance"]
    assert statements["Which where"].startswith("p0: Good")
    assert "Good a median step time of 40.0 µs, no recording, 1" in statements["Needs"]
    table = overall_table(comparison, "")
    assert [row.key for row in table.rows] == ["good", "fair", "poor", "ideal", "rest"]
    assert cells(table, "average rank")["ideal"] == "\N{EN DASH}"
    assert cells(table, "share of the way least (%)")["fair"] == "failed"
    where = distance_maps(comparison.distances, "")[0]
    assert cells(where, "p2") == {"good": f"{good[2]:.0f}", "fair": "failed", "poor": "failed"}


def test_who_ran_in_some_problems_has_no_share_over_all(make_results: MakeResults) -> None:
    """A guest is the best, but in one problem only, in which no controller settles."""

    def run(n: int, key: str) -> Trace:
        slow = {"guest": 1.8, "ideal": 2.0, "good": 2.2, "fair": 2.4}
        return make_trace(slow.get(key, LAGS.get(key, 1.0)) if n == 2 else LAGS[key])

    guest = FIVE | {"guest": {"type": "guest", "label": "Guest"}}
    comparison = overall(
        [
            make_results(
                lambda key, seed, n=n: run(n, key), guest if n == 2 else FIVE, name=f"p{n}", report=POINTS
            )
            for n in range(3)
        ]
    )
    assert comparison
    assert comparison.distances
    assert comparison.left_out == []
    assert "guest" in comparison.distances.problems["p2"]
    assert list(comparison.distances.overall) == ["good", "fair", "poor"]
    statements = texts(overall_statements(comparison))
    assert "in the median of 3 problems: Good" in statements["Distance"]
    assert "Guest" not in statements["Distance"]
    assert "p2: Guest 1" in statements["Which where"]
    table = overall_table(comparison, "")
    assert cells(table, "share of the way median (%)")["guest"] == "\N{EN DASH}"
    assert cells(table, "share of the way most (%)")["guest"] != "\N{EN DASH}"


def test_the_largest_median_is_not_ahead_where_the_pairs_say_otherwise(make_results: MakeResults) -> None:
    """Good has the better median, and Fair the better run with all seeds but one."""
    lags = {"good": range(1, 10), "fair": [0.5, 1.5, 2.5, 3.5, 5.05, 5.1, 5.1, 5.1, 5.1]}

    def run(key: str, seed: int) -> Trace:
        return make_trace(0.4 + 0.02 * lags[key][seed] if key in lags else LAGS[key])

    comparison = overall(
        [make_results(run, FIVE, name=name, seeds=[*range(9)], report=POINTS) for name in ("p0", "p1")]
    )
    assert comparison
    sentence = texts(overall_statements(comparison))["Which where"]
    assert "which the seeds do not show to be ahead of Fair." in sentence
    assert "Poor" not in sentence


def test_an_interval_of_failed_runs_alone_is_not_said_to_be_exact(make_results: MakeResults) -> None:
    """Seven of eight runs failed: the interval of the median is one point, though the seeds differ."""

    def run(key: str, seed: int) -> Trace:
        return make_trace(30.0 if key == "fair" and seed else LAGS[key])

    (seen,) = conditions(make_results(run, FIVE, seeds=[*range(8)], report=POINTS))
    sure = certainty_tables(seen, "")[0]
    shown = cells(replace(sure, rows=sure.rows[:5]), "share of the way interval (%)")
    assert shown["fair"] == "< \N{MINUS SIGN}100"


def test_a_page_of_many_problems_keeps_what_is_over_all(
    make_results: MakeResults, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = [make_results(run_of, FIVE, name=f"p{n}", report=POINTS) for n in range(2)]
    cases = tuple(replace(case, problem=part.study.name) for part in parts for case in part.cases)
    whole = WholeStudy(StudyHead(name="both"), {part.study.name: part.study for part in parts})
    both = StudyResults(parts[0].folder, whole, cases, {})
    page = render_page([both])
    assert all(
        text in page for text in ("Every case (5)", "Step response, per controller", "Responses at seed")
    )
    for limit in ("_MOST_LINES", "_MOST_SKETCHED", "_MOST_ROWS", "_MOST_CASES"):
        monkeypatch.setattr(sections, limit, 9)
    small = render_page([both])
    assert not any(
        text in small for text in ("Every case (5)", "Step response, per controller", "Responses at seed")
    )
    assert "Which method where: share of the way, %" in small
    assert "these scenarios have no tables of their own: nominal." in small
    assert len(small) < len(page)
