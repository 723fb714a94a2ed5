"""The section on how often controllers fail: when it is there, and what it says of made-up results."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ddpc_cosim import StudyResults, Trace
from ddpc_cosim.files.tables import Table
from ddpc_cosim.study.verdicts.reliability import reliability
from ddpc_reports.comparison import Condition, conditions
from ddpc_reports.data import json_text
from ddpc_reports.page import render_page
from ddpc_reports.reliability import (
    association_table,
    reliability_statements,
    reliability_table,
    tail_figures,
)
from ddpc_reports.sections import gather

from .synthetic import MakeResults, make_trace

SOUND = {key: {"type": key} for key in ("quick", "slow")}
TITLE = "How often it fails"
MASS = "mass [kg]"


def trace_of(key: str, seed: int) -> Trace:
    return make_trace({"quick": 0.5, "slow": 1.0}[key] + 0.01 * seed, noise_seed=seed)


def drawn_results(results: StudyResults, mass: dict[int, float]) -> StudyResults:
    cases = tuple(replace(case, drawn={MASS: mass[case.seed]}) for case in results.cases)
    return replace(results, cases=cases)


@pytest.fixture
def results(make_results: MakeResults) -> StudyResults:
    """Twenty seeds, of which the slow controller fails on the last three."""
    made = make_results(trace_of, SOUND, seeds=list(range(20)))
    cases = tuple(replace(c, failed=c.failed or (c.controller == "slow" and c.seed > 16)) for c in made.cases)
    return replace(made, cases=cases)


def parts_of(results: StudyResults) -> tuple[Condition, list[str], Table]:
    (condition,) = conditions(results)
    items = reliability(results.study, results.cases)
    texts = [re.sub("<[^>]*>", "", str(text)) for _, text in reliability_statements(condition, items)]
    table = reliability_table(condition, items, "")
    assert table is not None
    return condition, texts, table


def titles(results: StudyResults) -> list[str]:
    return [section.title for section in gather([results]).parts[0].sections]


def test_it_is_there_from_twenty_seeds_on_or_where_plants_are_drawn(
    results: StudyResults, make_results: MakeResults
) -> None:
    few = make_results(trace_of, SOUND, seeds=list(range(3)))
    assert TITLE in titles(results)
    assert TITLE not in titles(few)
    assert TITLE in titles(drawn_results(few, dict.fromkeys(range(3), 1.0)))


def test_the_sentence_and_the_table_count_seeds(results: StudyResults) -> None:
    _, (text,), table = parts_of(results)
    assert "quick on none of 20 seeds (up to 17\u00a0%)" in text
    assert "slow on 3 of 20 seeds (15\u00a0%, from 3.2 to 38\u00a0%)" in text
    rows = {row.header: row.cells for row in table.rows}
    assert [cell.text for cell in rows["slow"][:3]] == ["3 of 20", "15", "3.2 … 38"]
    assert "that of 90\u00a0% takes 36" in table.notes[0]


def test_a_quantile_among_failed_runs_is_failed(results: StudyResults) -> None:
    cases = tuple(replace(c, failed=c.controller == "slow" and c.seed > 8) for c in results.cases)
    _, _, table = parts_of(replace(results, cases=cases))
    slow = next(row for row in table.rows if row.header == "slow")
    assert slow.cells[3].text == "failed"
    assert slow.cells[4].text.endswith("… failed")


def test_the_tail_ends_above_the_runs_that_failed(results: StudyResults) -> None:
    condition = conditions(results)[0]
    (figure,) = tail_figures(condition, reliability(results.study, results.cases), "")
    rows = figure.views[0].spec["data"]["values"]
    last = {row["label"]: row["share"] for row in rows}
    assert last == {"quick": 1 / 20, "slow": 4 / 20}


def test_parameters_that_go_with_nothing_are_not_said_to_have_no_effect(results: StudyResults) -> None:
    mass = dict(enumerate(np.random.default_rng(0).permutation(20).tolist()))
    given = drawn_results(results, mass)
    condition, (_, text), _ = parts_of(given)
    assert text == "Of the parameters that seeds draw, none stands out in 2 comparisons."
    table = association_table(condition, reliability(given.study, given.cases), "")
    assert table is not None
    assert {row.cells[-1].text for row in table.rows} == {"no"}


def test_a_parameter_that_stands_out_is_named_as_an_association(results: StudyResults) -> None:
    _, (_, text), _ = parts_of(drawn_results(results, {seed: 1.0 + seed for seed in range(20)}))
    assert "In runs of quick, worse mean absolute error of angle goes with a larger mass" in text
    assert "These are associations" in text


def test_spread_evenly_the_interval_is_not_called_exact_alone(results: StudyResults) -> None:
    (name,) = results.whole.problems
    study = results.study
    evenly = replace(study, plant=replace(study.plant, sampling="sobol"))
    whole = replace(results.whole, problems={name: evenly})
    _, (text, *_), _ = parts_of(replace(results, whole=whole))
    assert "too wide as a rule, and not exact" in text


def test_page_and_data_have_it(results: StudyResults) -> None:
    given = drawn_results(results, {seed: 1.0 + seed for seed in range(20)})
    assert f">{TITLE} <" in render_page([given])
    assert f'"title":"{TITLE}"' in json_text([given])
