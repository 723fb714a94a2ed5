"""What is found in logged data: planted faults, known gains and dead times, loops open and closed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_cosim import Controller, FloatArray, Loop, Recording, Sample, Variable
from ddpc_cosim.inspection import predictions as of_methods
from ddpc_cosim.inspection.columns import column_facts, sampling_facts, whole_pieces
from ddpc_cosim.inspection.predictions import Method, Predictions, predictions
from ddpc_cosim.inspection.relations import Relations, relations
from ddpc_cosim.plugins import Plugin

# What relations many loops have is found once, in one process.
pytestmark = pytest.mark.xdist_group("relations")

GAIN, POLE, DEAD_TIME = 2.0, 0.9, 4


def simulated(
    seed: int, feedback: float = 0.0, samples: int = 1000, noise: float = 0.1, hold: int = 10
) -> tuple[FloatArray, FloatArray]:
    """Return inputs and outputs of y+ = 0.9 y + 0.2 u(-3) + e, driven at random, perhaps with feedback."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(rng.uniform(-1.0, 1.0, samples // hold + 1), hold)[:samples]
    u, y = np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        before = u[k - DEAD_TIME] if k >= DEAD_TIME else 0.0
        y[k] = (POLE * y[k - 1] if k else 0.0) + GAIN * (1.0 - POLE) * before + noise * rng.normal()
        u[k] = levels[k] - feedback * y[k]
    return u[:, np.newaxis], y[:, np.newaxis]


def related(u: FloatArray, y: FloatArray, seams: tuple[int, ...] = ()) -> Relations:
    names = [f"u{i}" for i in range(u.shape[1])], [f"y{i}" for i in range(y.shape[1])]
    return relations(u, y, np.empty((len(u), 0)), names, seams)


def recorded(u: FloatArray, y: FloatArray) -> Recording:
    return Recording(u, y, y, 1.0)


def noise(samples: int = 1000, seed: int = 0) -> FloatArray:
    return np.asarray(np.random.default_rng(seed).normal(size=samples))


# --- columns ---------------------------------------------------------------------------------------------


def test_a_signal_of_noise_is_neither_stuck_nor_limited_nor_quantised() -> None:
    facts = column_facts("y", "K", "output", noise())
    assert (facts.stuck, facts.low, facts.high, facts.step, facts.missing) == ((), 0.0, 0.0, 0.0, 0)
    assert facts.deviation == pytest.approx(1.0, abs=0.1)


def test_a_planted_stretch_that_is_stuck_is_found_where_it_is() -> None:
    values = noise()
    values[300:360] = values[300]
    values[700:730] = values[700]
    facts = column_facts("y", "K", "output", values)
    assert [(s.first, s.samples) for s in facts.stuck] == [(300, 60), (700, 30)]
    assert facts.stuck[0].value == values[300]
    assert column_facts("u", "V", "input", values).stuck == ()  # an input is held by intent


def test_rows_of_a_stuck_stretch_are_counted_in_the_log_with_its_missing_cells() -> None:
    values = noise()
    values[300:360] = values[300]
    values[100:110] = np.nan
    facts = column_facts("y", "K", "output", values)
    assert (facts.missing, facts.first_missing) == (10, 100)
    assert [(s.first, s.samples) for s in facts.stuck] == [(300, 60)]


def test_a_saturated_signal_has_the_share_of_its_limit() -> None:
    slow = np.convolve(noise(2000), np.ones(20) / 20, mode="valid")
    limited = np.minimum(slow, 0.2)
    facts = column_facts("y", "K", "output", limited)
    assert facts.high == pytest.approx(np.mean(slow >= 0.2))
    assert facts.low == 0.0
    assert facts.first_at_limit == int(np.argmax(slow >= 0.2))
    assert facts.stuck == ()


@settings(max_examples=25, deadline=None)
@given(step=st.floats(1e-4, 10.0), offset=st.floats(-100.0, 100.0), seed=st.integers(0, 2**16))
def test_the_step_of_a_quantised_signal_is_found(step: float, offset: float, seed: int) -> None:
    levels = np.random.default_rng(seed).integers(0, 40, 500)
    facts = column_facts("y", "", "output", offset + step * levels)
    apart = np.gcd.reduce(np.diff(np.unique(levels)))
    assert facts.step == pytest.approx(step * apart, rel=1e-6)
    assert facts.is_coarse == (facts.step > 0.05 * facts.deviation)


def test_moves_are_counted() -> None:
    u = np.repeat([0.0, 1.0, 0.5, 0.5, 2.0], 10)
    assert column_facts("u", "V", "input", u).moves == 3


def test_an_empty_column_and_a_constant_one() -> None:
    empty = column_facts("y", "K", "output", np.full(10, np.nan))
    assert empty.empty
    assert empty.missing == 10
    assert column_facts("y", "K", "output", np.ones(10)).constant


def test_gaps_duplicates_and_jitter_of_times() -> None:
    time = np.arange(100) * 5.0
    time[50:] += 15.0
    time[70] = time[69]
    facts = sampling_facts(time)
    assert facts.sampling_time == 5.0
    assert (facts.gaps, facts.missing_rows, facts.first_gap) == (2, 4, 50)
    assert facts.longest_gap == 20.0
    assert (facts.duplicates, facts.first_duplicate) == (1, 70)
    assert sampling_facts(np.arange(100) * 5.0).is_even
    shifts = np.where(np.arange(100) % 2, 0.5, 0.0)
    # 50 times 5.5 s, which is the median, and 49 times 4.5 s.
    assert sampling_facts(np.arange(100) * 5.0 + shifts).jitter == pytest.approx(np.sqrt(49 / 99))


def test_whole_pieces_end_at_missing_cells_gaps_and_seams() -> None:
    values = np.ones((10, 2))
    values[3, 1] = np.nan
    time = np.arange(10.0)
    time[6:] += 5.0
    assert whole_pieces(time, values, [8]) == [slice(0, 3), slice(4, 6), slice(6, 8), slice(8, 10)]


# --- relations -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def of_open_loops() -> list[Relations]:
    return [related(*simulated(seed)) for seed in range(60)]


@pytest.fixture(scope="module")
def of_closed_loops() -> list[Relations]:
    return [related(*simulated(100 + seed, feedback=0.5)) for seed in range(30)]


def test_open_loops_are_seldom_taken_for_closed(of_open_loops: list[Relations]) -> None:
    # At a level of 1 %, more than 4 of 60 are as improbable as 1 in 3000.
    assert sum(r.feedback[0].is_closed for r in of_open_loops) <= 4


def test_closed_loops_are_seen(of_closed_loops: list[Relations]) -> None:
    assert sum(r.feedback[0].is_closed for r in of_closed_loops) >= 27
    assert all(r.feedback[0].outputs == ("y0",) for r in of_closed_loops if r.feedback[0].is_closed)


@pytest.mark.parametrize("loops", ["of_open_loops", "of_closed_loops"])
def test_intervals_of_gain_and_dead_time_cover_the_truth(loops: str, request: pytest.FixtureRequest) -> None:
    pairs = [r.pairs[0] for r in request.getfixturevalue(loops)]
    gains = np.mean([pair.low <= GAIN <= pair.high for pair in pairs])
    delays = np.mean([pair.earliest <= DEAD_TIME <= pair.latest for pair in pairs])
    # Of 95 %: four standard errors of a share of so many.
    least = 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / len(pairs))
    assert gains >= least
    assert delays >= least
    assert all(pair.acts and pair.settles for pair in pairs)


def test_the_settling_time_is_that_of_the_pole(of_open_loops: list[Relations]) -> None:
    answers = [r.answer for r in of_open_loops]
    assert np.median(answers) == pytest.approx(DEAD_TIME + np.log(0.05) / np.log(POLE), rel=0.15)


def test_an_input_without_effect_does_not_act() -> None:
    u, y = simulated(7)
    other = np.repeat(noise(100, seed=1), 10)[:, np.newaxis]
    first, second = related(np.hstack([u, other]), y).pairs
    assert first.acts
    assert not second.acts


def test_an_integrator_has_no_gain() -> None:
    u = np.repeat(noise(100), 10)
    y = np.cumsum(np.concatenate([[0.0], u[:-1]])) + 0.01 * noise(1000, seed=1)
    (pair,) = related(u[:, np.newaxis], y[:, np.newaxis]).pairs
    assert pair.acts
    assert not pair.settles


def test_the_same_gains_whatever_the_units_and_offsets() -> None:
    u, y = simulated(3)
    (pair,) = related(u, y).pairs
    (other,) = related(1e-3 * u - 7.0, 1e4 * y + 300.0).pairs
    assert other.gain == pytest.approx(1e7 * pair.gain, rel=1e-5)
    assert (other.dead_time, other.earliest, other.latest) == (pair.dead_time, pair.earliest, pair.latest)


def test_no_regressor_crosses_a_seam() -> None:
    u, y = simulated(5, samples=600)
    shifted = np.vstack([u, u]), np.vstack([y, y + 50.0])
    assert related(*shifted, seams=(600,)).samples == 2 * (600 - 48)


def test_a_recording_that_is_too_short_says_nothing() -> None:
    assert related(*simulated(0, samples=8)).pairs == ()


# --- predictions -----------------------------------------------------------------------------------------


class Falling(Controller):
    """Predicts with errors that are known."""

    horizon = 1

    def start(self, loop: Loop) -> None:
        raise AssertionError

    def step(self, sample: Sample) -> FloatArray:
        raise AssertionError


def test_naive_predictors_by_hand() -> None:
    y = np.array([[0.0], [1.0], [4.0], [2.0], [3.0], [5.0], [5.0], [7.0], [1.0], [2.0], [6.0], [4.0]])
    tested = predictions(recorded(np.zeros((12, 1)), y), 2, 3)
    size = y.std()
    assert tested.hold[0] == pytest.approx(np.sqrt(np.mean([4.0**2, 2.0**2])) / size)
    assert tested.hold[1] == pytest.approx(2.0 / size)
    tail = np.array([2.0, 6.0, 4.0]) - y[:9].mean()
    assert tested.mean == pytest.approx([np.sqrt(np.mean(tail**2)) / size] * 2)


def test_errors_of_methods_are_those_of_the_noise() -> None:
    # One step ahead nobody can do better than the noise, and the right model does as well.
    u, y = simulated(1, samples=3000)
    tested = predictions(recorded(u, y), 12, 5)
    by_name = {method.name: method for method in tested.methods}
    variances = 0.1**2 * np.cumsum(POLE ** (2 * np.arange(12)))
    wanted = np.sqrt(variances) / y.std()
    assert {"deepc", "spc", "koopman-mpc", "mpc"} <= by_name.keys()
    for name in ("mpc", "koopman-mpc"):
        assert by_name[name].errors == pytest.approx(wanted, rel=0.15), name
    assert by_name["spc"].errors[:3] == pytest.approx(wanted[:3], rel=0.25)


def test_predictions_of_spc_are_the_least_squares_of_windows() -> None:
    u, y = simulated(2, samples=600)
    steps, past = 4, 3
    (spc,) = (m for m in predictions(recorded(u, y), steps, past).methods if m.name == "spc")
    windows = len(u) - past - steps
    # As documented: the output measured now ends the past, so that its window has one more of them.
    known = np.array(
        [
            [*u[i : i + past, 0], *y[i : i + past + 1, 0], *u[i + past : i + past + steps, 0]]
            for i in range(windows)
        ]
    )
    ahead = np.array([y[i + past + 1 : i + past + 1 + steps, 0] for i in range(windows)])
    tail = windows - round(0.25 * windows)
    head = tail - (past + 1 + steps) + 1
    solution = np.linalg.lstsq(known[:head], ahead[:head], rcond=None)[0]
    errors = np.sqrt(np.mean((ahead - known @ solution)[tail:] ** 2, axis=0)) / ahead[:, -1].std()
    assert spc.errors == pytest.approx(errors.tolist(), rel=1e-6)


def test_good_up_to_ends_where_the_error_passes_half_a_deviation_or_holding_is_as_good() -> None:
    tested = Predictions(hold=(0.3, 0.4, 0.6, 0.9), mean=(1.0,) * 4)
    assert tested.good_up_to(Method("a", (0.1, 0.2, 0.3, 0.4))) == 4
    assert tested.good_up_to(Method("b", (0.1, 0.2, 0.51, 0.4))) == 2
    assert tested.good_up_to(Method("c", (0.35, 0.45, 0.45, 0.5))) == 4
    assert tested.good_up_to(Method("d", (0.35, 0.45, 0.7, 0.7))) == 0


def test_a_method_that_fails_says_why_and_one_that_does_not_predict_is_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from ddpc_controllers import MFAPC, SPC, Policy

    class Broken(SPC):
        def prediction_errors(self, recording: Recording) -> FloatArray:
            raise ZeroDivisionError("no")

    found = [Plugin("broken", "", "", Broken), Plugin("mfapc", "", "", MFAPC), Plugin("spc", "", "", SPC)]
    # One whose predictions are those of a file that is not known.
    found += [Plugin("other", "", "", Falling), Plugin("policy", "", "", Policy)]
    monkeypatch.setattr(of_methods, "installed", lambda kind: found)
    tested = predictions(recorded(*simulated(0)), 5, 3)
    assert [(method.name, method.reason) for method in tested.methods] == [
        ("spc", ""),
        ("broken", "ZeroDivisionError: no"),
    ]


# --- the whole -------------------------------------------------------------------------------------------


def test_a_good_recording_is_good_and_says_how_far() -> None:
    summary = recorded(*simulated(4)).summary([Variable("valve", unit="%")], ["level"])
    assert summary.good
    assert summary.verdict.startswith("Good enough for predictive control with a horizon of up to")
    assert summary.evidence.good_up_to >= DEAD_TIME + 1
    assert summary.as_data()["closed_loop"] is False
    assert "valve" in repr(summary)
    assert "<table>" in summary._repr_html_()


def test_a_closed_loop_is_a_reservation_with_what_it_biases_and_what_to_do() -> None:
    summary = recorded(*simulated(104, feedback=0.5)).summary(["valve"], ["level"])
    (said,) = (text for text in summary.reservations if text.startswith("recorded in closed loop"))
    assert "DeePC" in said
    advice = " ".join(summary.advice)
    assert "random two-level signal" in advice
    assert "instrumental variables" in advice
    assert 'settings.instruments = "closed-loop"; where columns have what was added to the inputs' in advice
    known = recorded(*simulated(104, feedback=0.5))
    known = replace(known, excitation=known.u)
    assert 'settings.instruments = "excitation"' in " ".join(known.summary(["valve"], ["level"]).advice)


def test_a_number_that_loggers_write_for_a_missing_value_is_a_reservation() -> None:
    u, y = simulated(4)
    y[[100, 300]] = -999.0
    said = " ".join(recorded(u, y).summary(["valve"], ["level"]).reservations)
    assert 'the output "level" goes to -999, which loggers write where they have no value' in said
    assert "missing_values = [-999]" in said


def test_noise_without_effect_is_not_good_enough() -> None:
    u, y = np.repeat(noise(100), 10)[:, np.newaxis], noise(1000, seed=1)[:, np.newaxis]
    summary = recorded(u, y).summary(["valve"], ["level"])
    assert not summary.good
    assert 'no output answers the input "valve"' in summary.verdict
    assert 'move "valve" further or more often' in " ".join(summary.advice)


def test_an_input_that_stands_still_is_named() -> None:
    u, y = simulated(4)
    summary = recorded(np.hstack([u, np.ones_like(u)]), y).summary(["valve", "pump"], ["level"])
    assert not summary.good
    assert 'the input "pump" stands still' in summary.verdict
    assert 'move "pump"' in " ".join(summary.advice)
