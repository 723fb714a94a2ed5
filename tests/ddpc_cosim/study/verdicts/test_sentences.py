"""What the findings say is one clause, whoever prints it."""

from typing import Any

import numpy as np
import pytest

from ddpc_cosim.study.verdicts.ranks import average_ranks
from ddpc_cosim.study.verdicts.sentences import (
    ahead_in_pairs_clause,
    best_rank_clause,
    elsewhere_sentence,
    failed_runs,
    join_words,
    lead_clause,
    level_clause,
    not_counted_sentence,
    over_words,
    ranks_differ_clause,
    sentence,
    some_of,
    too_few_seeds_clause,
    untested_sentence,
)

from .test_findings import findings_at

LABELS = {name: name.upper() for name in "abc"}
SCENARIOS = {name: name for name in ("nominal", "x", "y")}
IN_TWO = {"a": {"x": 1.0, "y": 2.0}, "b": {"x": 2.0, "y": 1.0}}


@pytest.mark.parametrize(
    ("levels", "how", "clause"),
    [
        ({"a": 1.0, "b": 2.0}, {}, "<b>A</b> is ahead over 8 seeds"),
        ({"a": 1.0, "b": 2.0}, {"seeds": 4}, "<i>A</i> has the best median over 4 seeds"),
        ({"a": 1.0, "b": 2.0}, {"seeds": 1}, "<i>A</i> is ahead on the one seed that was run"),
        (
            {"a": 1.0, "b": 1.002},
            {"seeds": 1, "jitter": 0.0},
            "<b>A</b> and <b>B</b> have the best medians on the one seed that was run, which differ by too "
            "little to matter",
        ),
        ({"a": 1.0}, {}, "there is nothing to compare <i>A</i> with"),
        ({"a": 1.0, "b": 2.0}, {"failed": {"a": 1}}, "<b>B</b> alone has no failed run, over 8 seeds"),
        (
            {"a": 1.0, "b": 2.0},
            {"failed": {"a": 1, "b": 2}},
            "no controller is without a failed run. Fewest failed: <i>A</i> 1 of 8 runs",
        ),
        (
            {"a": 1.0, "b": 2.0},
            {"failed": {"a": 8, "b": 8}},
            "no controller competes here, so nothing is ranked",
        ),
        (
            {"a": 1.0, "b": 1.002},
            {"jitter": 0.0001},
            "<b>A</b> and <b>B</b> lead over 8 seeds, and no difference between them matters",
        ),
        (
            IN_TWO,
            {},
            "the scenarios disagree, so there is no overall rank: <b>A</b> leads in <i>x</i>; "
            "<b>B</b> leads in <i>y</i>",
        ),
    ],
)
def test_who_leads_and_in_which_way(levels: dict[str, Any], how: dict[str, Any], clause: str) -> None:
    assert lead_clause(findings_at(levels, **how), LABELS, SCENARIOS) == clause


def test_those_that_lead_together_are_not_told_apart_or_not_by_enough() -> None:
    level = findings_at({"a": 1.0, "b": 1.05, "c": 9.0}, jitter=0.3)
    assert lead_clause(level, LABELS, SCENARIOS).endswith(" lead over 8 seeds and are not told apart")
    near = findings_at({"a": 1.0, "b": 1.1}, metrics={"relevant": {"absolute": 0.112}})
    assert near.tells_leaders_apart
    assert "none of them is significantly better by enough to matter" in lead_clause(near, LABELS, SCENARIOS)


def test_medians_are_over_scenarios_and_seeds() -> None:
    assert over_words(findings_at(IN_TWO).standings) == "over 2 scenarios and 8 seeds"
    assert over_words(findings_at(IN_TWO, seeds=1).standings) == "over 2 scenarios, on one seed"


def test_too_few_seeds_are_told_with_how_many_it_takes() -> None:
    few = findings_at({"a": 1.0, "b": 2.0, "c": 3.0}, seeds=5).standings.compared.values()
    words = "5 seeds are too few to test 3 controllers against each other: it takes 6"
    assert too_few_seeds_clause(few) == words
    assert too_few_seeds_clause(findings_at({"a": 1.0, "b": 2.0}).standings.compared.values()) == ""


def test_what_could_not_be_tested_is_told_with_the_reason() -> None:
    assert untested_sentence(findings_at({"a": 1.0, "b": 2.0})) == ""
    few = findings_at({"a": 1.0, "b": 2.0}, seeds=5)
    assert untested_sentence(few).endswith(
        "are too few to test 2 controllers against each other: it takes 6."
    )
    alone = "How much that depends on the seed is not known."
    assert untested_sentence(findings_at({"a": 1.0, "b": 2.0}, seeds=1)) == alone
    assert untested_sentence(findings_at({"a": 1.0}, seeds=1)) == ""


def test_scenarios_that_the_leader_does_not_lead_are_counted() -> None:
    levels = {"a": {"x": 1.0, "y": 2.0}, "b": {"x": 9.0, "y": 1.9}}
    findings = findings_at(levels, seeds=1)
    assert findings.leaders == ("a",)
    assert elsewhere_sentence(findings, LABELS) == (
        "Scenario by scenario it leads in 1 of 2; in the others <i>B</i> (1) does."
    )
    assert elsewhere_sentence(findings_at({"a": 1.0, "b": 2.0}), LABELS) == ""


def test_who_failed_and_what_does_not_count_are_named() -> None:
    assert failed_runs("<", 1, 3) == "<b>&lt;</b> 1 of 3 runs"
    assert not_counted_sentence(["x", "y"]) == (
        "Not counted, as every controller fails there: <i>x</i> and <i>y</i>."
    )
    assert not_counted_sentence([]) == ""


def test_who_is_level_with_the_first_or_ahead_of_it_in_pairs() -> None:
    first, two = join_words(["A"]), join_words(["B"])
    assert level_clause([first, two]) == "the seeds do not tell it apart from A and B"
    assert ahead_in_pairs_clause([first]) == "in pairs of the same seed A is ahead of it"
    assert ahead_in_pairs_clause([first, two]) == "in pairs of the same seed A and B are ahead of it"


def test_of_average_ranks_the_best_and_who_may_be_as_good() -> None:
    ranks = average_ranks(["a", "b", "c"], np.tile([1.0, 2.0, 3.0], (8, 1)))
    assert ranks.level_with_first == ("b",)
    assert best_rank_clause(ranks, LABELS, "1.0") == (
        "over 8 problems, <i>A</i> has the best average rank, 1.0; the problems do not tell it apart from "
        "<i>B</i>"
    )
    assert ranks_differ_clause(ranks, "{:.3g}".format) == "ranks that are 1.17 or more apart differ"
    level = average_ranks(["a", "b", "c"], np.ones((8, 3)))
    assert ranks_differ_clause(level, "{:.3g}".format) == "none is found to differ"


def test_labels_are_text_and_a_sentence_begins_with_a_capital() -> None:
    findings = findings_at({"a": 1.0, "b": 2.0})
    assert "&lt;b&gt;" in lead_clause(findings, LABELS | {"a": "<b>"}, SCENARIOS)
    assert sentence(lead_clause(findings, LABELS, SCENARIOS)).startswith("<b>A</b> is")
    assert sentence(lead_clause(findings_at(IN_TWO), LABELS, SCENARIOS)).startswith("The scenarios disagree")


def test_of_many_the_first_are_named() -> None:
    parts = [join_words([name]) for name in "abcde"]
    assert some_of(parts) == "a, b, c and 2 more"
    assert join_words(["<", "b"]) == "&lt; and b"
