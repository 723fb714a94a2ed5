"""Why a controller lost: the stretch is that of a formula, the causes are those that were planted."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import Outcome, Trace
from ddpc_reports.comparison import conditions
from ddpc_reports.why import at_limit, where_behind, why_statements

from .synthetic import SAMPLES, MakeResults, make_trace


def late(trace: Trace, rows: slice, by: float) -> Trace:
    """Return a run that is away from its reference over some samples."""
    y = trace.y.copy()
    y[rows] -= by
    return replace(trace, y=y)


def test_the_stretch_is_where_the_planted_error_is() -> None:
    best = make_trace(0.3)
    stretch = where_behind(late(best, slice(30, 41), 0.2), best)
    assert stretch is not None
    assert (stretch.first, stretch.last) == (30, 40)
    assert stretch.share == pytest.approx(1.0)
    assert where_behind(best, best) is None
    assert where_behind(best, late(best, slice(30, 41), 0.2)) is None


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=SAMPLES))
def test_no_other_neighbours_lose_more_above_the_mean(losses: list[float]) -> None:
    best = make_trace(0.3)
    away = np.zeros((SAMPLES, 1))
    away[: len(losses), 0] = losses
    worse = replace(best, y=best.reference - np.abs(best.reference - best.y) - np.abs(away))
    stretch = where_behind(worse, best)
    size = max(np.ptp(best.y), np.ptp(best.reference))
    lost = (np.abs(worse.reference - worse.y) - np.abs(best.reference - best.y))[:, 0] / size
    if not lost.sum() > 0:
        assert stretch is None
        return
    assert stretch is not None
    above = np.concatenate([[0.0], np.cumsum(lost - lost.mean())])
    most = max(above[b] - above[a] for a, b in itertools.combinations(range(SAMPLES + 1), 2))
    assert above[stretch.last + 1] - above[stretch.first] == pytest.approx(most, abs=1e-9)
    whole = lost[stretch.first : stretch.last + 1].sum() / lost.sum()
    assert stretch.share == pytest.approx(min(whole, 1.0))


def test_an_input_at_its_limit_counts_where_limits_move_too() -> None:
    trace = make_trace(0.3)
    u = np.linspace(-3.5, 3.5, SAMPLES)[:, None]
    trace = replace(trace, u=u, bounds=replace(trace.bounds, u_max=np.array([np.inf])))
    assert at_limit(trace).tolist() == [1.0] + [0.0] * (SAMPLES - 1)
    limits = np.stack([np.full_like(u, -9.0), u], axis=-1)
    limits[10:, 0, 1] = 9.0
    assert at_limit(replace(trace, input_limits=limits)).tolist() == [1.0] * 10 + [0.0] * (SAMPLES - 10)


def test_the_last_is_told_where_and_why(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        trace = make_trace(0.3, noise_seed=seed)
        if key == "quick":
            return trace
        trace = late(trace, slice(30, 41), 0.2)
        u, status = trace.u.copy(), list(trace.status)
        u[30:41] = 3.5
        status[30:41] = ["infeasible"] * 11
        poor = {"prediction_error": 0.8, "prediction_error_fitted": 0.7}
        return replace(trace, u=u, status=tuple(status), diagnostics=poor)

    event = {"time": 2.9, "parameters": {"mass": 2.0}}
    results = make_results(
        trace_of, seeds=list(range(6)), scenarios={"heavier": {"events": [event]}, "calm": {}}
    )
    heavier, calm = (why_statements(condition) for condition in conditions(results))
    (statement,) = heavier
    assert statement.topic == "slow"
    words = statement.text.striptags()
    for blank in ("\N{NO-BREAK SPACE}", "\N{NARROW NO-BREAK SPACE}"):
        words = words.replace(blank, " ")
    assert words.startswith("Seed 0: from 3.00 s to 4.00 s it loses 100 % of what it loses to quick; ")
    for cause in (
        "mass = 2 acts from 2.90 s on",
        "its input is at a limit in 100 % of these samples (the best in 0 %)",
        "it falls back in 11 of these samples (infeasible)",
        "its model is poor: off by 80 % of the standard deviation of samples that were held out",
    ):
        assert cause in words
    assert "mass" not in calm[0].text


def test_those_that_fail_are_told_even_where_nobody_is_sound(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        return make_trace(0.3, outcome=Outcome.CRASHED, reason=f"{key} is gone", noise_seed=seed)

    (condition,) = conditions(make_results(trace_of))
    said = {statement.topic: statement.text.striptags() for statement in why_statements(condition)}
    assert {*said} == {"quick", "slow"}
    assert "quick is gone" in said["quick"]


def test_one_that_is_level_with_the_first_has_not_lost(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results(lambda key, seed: make_trace(0.3, noise_seed=seed)))
    assert why_statements(condition) == []
