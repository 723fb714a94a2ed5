"""Every figure derived again by its definition, on traces made by hand."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as arrays

from ddpc_cosim import DisplayUnit, FloatArray, Outcome, Trace, Variable
from ddpc_cosim.controller import Bounds
from ddpc_cosim.metrics import METRICS, MetricSettings, metric_name, split_key

DEGREES = DisplayUnit("deg", 180.0 / math.pi)
H = 0.5
NAN = math.nan


def trace_of(
    reference: Any,
    y: Any,
    u: Any = None,
    *,
    outcome: Outcome = Outcome.COMPLETED,
    output: Variable = Variable("y", "m"),  # noqa: B008 - immutable
    actuator: Variable = Variable("u", "N"),  # noqa: B008 - immutable
    y_limits: tuple[float, float] = (-math.inf, math.inf),
    u_limits: tuple[float, float] = (-math.inf, math.inf),
    solve_time: Any = None,
    status: tuple[str, ...] | None = None,
) -> Trace:
    """Return a trace of one loop; its last row was decided but not held if it completed."""
    reference, y = np.asarray(reference, dtype=float), np.asarray(y, dtype=float)
    n = len(y)
    u = np.zeros(n) if u is None else np.asarray(u, dtype=float)
    return Trace(
        time=np.arange(n, dtype=np.float64) * H,
        reference=reference.reshape(n, 1),
        y=y.reshape(n, 1),
        measured=y.reshape(n, 1),
        u=u.reshape(n, 1),
        status=("ok",) * n if status is None else status,
        solve_time=np.full(n, 1e-3) if solve_time is None else np.asarray(solve_time, dtype=float),
        inputs=(actuator,),
        outputs=(output,),
        measurements=(output,),
        bounds=Bounds(*(np.array([limit]) for limit in (*u_limits, *y_limits))),
        sampling_time=H,
        planned_samples=n,
        outcome=outcome,
    )


def figure(trace: Trace, name: str) -> float:
    (value,) = (value for key, value in trace.metrics().items() if split_key(key)[0] == name)
    return value


def test_keys_name_figure_signal_and_unit() -> None:
    trace = trace_of([0, 0], [0, 0], output=Variable("angle", "rad", display_unit=DEGREES))
    weighted = MetricSettings(cost={"outputs": {"angle": 1.0}})
    elsewhere = {"band_violation", "band_violation_time", "band_violation_max"}
    elsewhere |= {"money", "energy", "emissions", "peak"}
    elsewhere |= {name for name in METRICS if name.endswith(("_tot", "_rat"))}
    assert {split_key(key)[0] for key in trace.metrics(weighted)} == METRICS.keys() - elsewhere
    assert "cost [1]" in trace.metrics(weighted)
    assert trace.metrics().keys() == trace.metrics(weighted).keys() - {"cost [1]"}
    assert "sum_abs_error.angle [deg]" in trace.metrics()
    assert "iae.y [s]" in trace_of([0], [0], output=Variable("y")).metrics()
    assert split_key("iae.angle [deg.s]") == ("iae", "angle", "deg.s")
    assert split_key("solve_time_mean [s]") == ("solve_time_mean", "", "s")
    assert split_key("rmse.a.b[1] [1]") == ("rmse", "a.b[1]", "1")


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("mean_abs_error.angle [deg]", "mean absolute error"),
        ("rmse.a_b [1]", "RMSE"),
        ("iae", "IAE"),
        ("rms_change.torque [N.m]", "RMS input change"),
        ("solve_time_p95 [s]", "95th-percentile step time"),
        ("third-party [J]", "third-party"),
    ],
)
def test_the_name_in_print_is_the_label(key: str, name: str) -> None:
    assert metric_name(key) == name


def test_figures_of_the_error_leave_the_last_sample_out() -> None:
    trace = trace_of([1, 1, 1, 1], [0, 3, 1.5, 99])
    error = [1.0, -2.0, -0.5]
    assert figure(trace, "sum_abs_error") == pytest.approx(3.5)
    assert figure(trace, "iae") == pytest.approx(3.5 * H)
    assert figure(trace, "rmse") == pytest.approx(math.sqrt(sum(e * e for e in error) / 3))
    assert figure(trace, "min_abs_error") == 0.5
    assert figure(trace, "max_abs_error") == 2.0


def test_a_run_that_ended_early_counts_all_samples_that_were_held() -> None:
    """A plant that failed had held the last inputs; a controller that failed had decided none."""
    plant_failed = trace_of([1, 1, 1], [0, 3, 1.5], outcome=Outcome.FMU_ERROR)
    assert figure(plant_failed, "sum_abs_error") == pytest.approx(3.5)
    controller_failed = trace_of([1, 1, 1], [0, 3, 99], [0, 0, NAN], outcome=Outcome.CONTROLLER_ERROR)
    assert figure(controller_failed, "sum_abs_error") == pytest.approx(3.0)
    assert figure(controller_failed, "samples") == 3.0


def test_display_units_apply_to_values_and_not_to_times() -> None:
    trace = trace_of([0.1, 0.1], [0.0, 0.0], output=Variable("y", "rad", display_unit=DEGREES))
    assert trace.metrics()["sum_abs_error.y [deg]"] == pytest.approx(math.degrees(0.1))
    assert trace.metrics()["iae.y [deg.s]"] == pytest.approx(math.degrees(0.1) * H)


def test_an_offset_of_a_display_unit_cancels_in_differences() -> None:
    celsius = DisplayUnit("degC", 1.0, -273.15)
    trace = trace_of(
        [300, 300, 300],
        [299, 299, 299],
        [280, 290, 0],
        output=Variable("y", "K", display_unit=celsius),
        actuator=Variable("u", "K", start=280.0, display_unit=celsius),
    )
    assert trace.metrics()["max_abs_error.y [degC]"] == pytest.approx(1.0)
    assert trace.metrics()["max_abs_change.u [degC]"] == pytest.approx(10.0)
    assert trace.metrics()["max_abs_input.u [degC]"] == pytest.approx(16.85)


def test_a_step_response_by_hand() -> None:
    """From 0 to 10: at 90 % in row 3, 20 % too far in row 4, within 5 % from row 6."""
    y = [0, 2, 6, 9.5, 12, 9, 10.4, 9.6, 10, 10, 0]
    trace = trace_of([10] * 11, y)
    assert figure(trace, "overshoot") == pytest.approx(20.0)
    assert figure(trace, "rise_time") == pytest.approx(3 * H)
    assert figure(trace, "settling_time") == pytest.approx(6 * H)
    assert figure(trace, "settled_error") == pytest.approx(0.0)


def test_a_step_downwards_is_a_step() -> None:
    up, down = [0, 2, 6, 9.5, 12, 9, 10.4, 9.6, 10, 10, 0], [10]
    mirrored = trace_of([-value for value in down * 11], [-value for value in up])
    assert figure(mirrored, "overshoot") == pytest.approx(20.0)
    assert figure(mirrored, "rise_time") == pytest.approx(3 * H)


def test_of_several_steps_the_worst_counts_and_the_median_rise() -> None:
    reference = [1] * 5 + [3] * 5 + [0]
    y = [*(0, 1.1, 1, 1, 1), *(1, 2, 3, 3.8, 3), 0]
    trace = trace_of(reference, y)
    assert figure(trace, "overshoot") == pytest.approx(40.0)
    assert figure(trace, "rise_time") == pytest.approx(np.median([1, 2]) * H)
    assert figure(trace, "settling_time") == pytest.approx(4 * H)


def test_rise_and_settling_time_count_from_the_step() -> None:
    """A dead time belongs to both; who has left before the step has gone a part of the way when it comes."""
    late = np.array([*[0.0] * 20, *[0.0] * 4, 0.5, *[0.92] * 2, *[1.0] * 13])
    assert figure(stepping(0, 1, y=late), "rise_time") == pytest.approx(5 * H)
    assert figure(stepping(0, 1, y=late), "settling_time") == pytest.approx(7 * H)
    early = np.array([*[0.0] * 18, 0.4, 0.6, 0.8, *[0.92] * 2, *[1.0] * 17])
    assert figure(stepping(0, 1, y=early, preview=3), "rise_time") == pytest.approx(1 * H)
    assert figure(stepping(0, 1, y=early, preview=3), "settling_time") == pytest.approx(3 * H)
    assert figure(stepping(0, 1, y=early, preview=3), "anticipation") == pytest.approx(2 * H)


@given(arrays.arrays(np.float64, 20, elements=st.floats(-2.0, 3.0)), st.integers(0, 10))
def test_no_response_settles_before_it_has_risen(after: FloatArray, preview: int) -> None:
    response = stepping(0, 1, y=np.append(np.zeros(20), after), preview=preview)
    settling = figure(response, "settling_time")
    assert math.isnan(settling) or figure(response, "rise_time") <= settling


def test_a_response_that_does_not_arrive_has_no_times() -> None:
    trace = trace_of([1] * 6, [0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert math.isnan(figure(trace, "rise_time"))
    assert math.isnan(figure(trace, "settling_time"))
    assert figure(trace, "overshoot") == 0.0


def test_one_step_that_does_not_settle_is_not_hidden_by_others_that_do() -> None:
    trace = trace_of([1] * 4 + [2] * 4 + [0], [0, 1, 1, 1, 1, 1, 1, 1, 0])
    assert math.isnan(figure(trace, "settling_time"))


def test_a_moving_reference_has_no_steps() -> None:
    trace = trace_of([0, 1, 2, 3, 4], [0, 0, 1, 2, 3])
    for name in ("overshoot", "rise_time", "settling_time", "settled_error", "settled_share"):
        assert math.isnan(figure(trace, name))


def test_the_settled_error_is_the_mean_over_the_last_fifth_of_each_stretch() -> None:
    """Ten rows at 1 end with errors 0.2 and -0.1, ten rows at 2 with 0.3 and 0.5."""
    y = [*[1] * 8, 0.8, 1.1, *[2] * 8, 1.7, 1.5, 0]
    trace = trace_of([1] * 10 + [2] * 10 + [0], y)
    assert figure(trace, "settled_error") == pytest.approx(0.4)


def test_what_is_left_of_a_step_is_its_own_settled_error() -> None:
    """A small step that is missed by half counts more than a large one that is missed by more."""
    y = [0, *[9.0] * 9, *[10.5] * 10, 0]
    trace = trace_of([10] * 10 + [11] * 10 + [0], y)
    assert figure(trace, "settled_error") == pytest.approx(1.0)
    assert figure(trace, "settled_share") == pytest.approx(50.0)


def stepping(
    *levels: float, rows: int = 20, y: FloatArray | None = None, preview: int = 0, **options: Any
) -> Trace:
    """Return a run of steps between levels, which the output follows at once, or with other values."""
    reference = np.repeat(levels, rows)
    values = reference.copy() if y is None else y
    trace = trace_of([*reference, 0.0], [*values, 0.0], **options)
    return replace(trace, preview=preview)


def test_who_looks_ahead_is_not_judged_where_it_already_answers_the_next_step() -> None:
    """With a preview of 3, the first input that knows of the step acts on the last two samples before it."""
    y = np.repeat([0.0, 1.0, 3.0], 20)
    y[38:40] = 1.5, 2.5
    trace = stepping(0, 1, 3, y=y, preview=3)
    assert figure(trace, "settled_error") == 0.0
    assert figure(trace, "overshoot") == 0.0
    assert figure(trace, "settling_time") == 0.0
    assert figure(trace, "rise_time") == 0.0
    assert figure(trace, "anticipation") == pytest.approx(2 * H)
    assert figure(stepping(0, 1, 3, y=y, preview=1), "settled_error") == pytest.approx(0.5 / 4)


def test_the_preview_of_the_study_replaces_that_of_the_run() -> None:
    trace = stepping(0, 1, y=np.repeat([0.0, 1.0], 20))
    assert trace.metrics(MetricSettings(15)) == replace(trace, preview=15).metrics()
    assert math.isnan(replace(trace, preview=16).metrics()["settled_error.y [m]"])


def test_a_window_of_fewer_than_five_samples_is_not_judged() -> None:
    """Of stretches of 9 and 20 samples, a preview of 5 leaves the second alone."""
    reference = [1.0] * 9 + [2.0] * 20 + [0.0]
    y = [0.5] * 9 + [1.9] * 20 + [0.0]
    trace = trace_of(reference, y)
    assert trace.metrics(MetricSettings(4))["settled_error.y [m]"] == pytest.approx(0.5)
    assert trace.metrics(MetricSettings(5))["settled_error.y [m]"] == pytest.approx(0.1)


@pytest.mark.parametrize(("start", "counts"), [(0.021, False), (0.019, True)])
def test_the_first_stretch_is_a_step_from_one_percent_of_the_span_on(start: float, counts: bool) -> None:
    """The reference spans 2; the output begins 0.02 below it, or a little less."""
    y = np.repeat([0.0, 2.0], 20)
    y[0], y[1:4] = start - 0.04, 1.0
    trace = stepping(0, 2, y=np.where(np.arange(40) < 20, y, 2.0))
    first_is_wild = figure(trace, "overshoot") > 1000
    assert first_is_wild == counts


def test_an_output_that_begins_a_rounding_error_off_a_constant_reference_takes_no_step() -> None:
    for value in (12.4, 0.0):
        trace = trace_of([value] * 20, [value - 1e-9, *[value] * 9, *[value + 0.3] * 10])
        assert math.isnan(figure(trace, "overshoot"))
        assert figure(trace, "settled_error") == pytest.approx(0.3)


def test_a_step_is_sized_by_the_reference_and_not_by_where_the_output_is() -> None:
    """The output is at 0.9 of 1 when the reference steps to 2, and peaks at 2.2: 20 % of 1, not of 1.1."""
    y = np.repeat([0.9, 2.0], 20)
    y[25] = 2.2
    trace = stepping(1, 2, y=y)
    assert figure(trace, "overshoot") == pytest.approx(20.0)


def test_the_end_of_a_ramp_is_no_step() -> None:
    reference = [*np.zeros(20), *np.linspace(0, 1, 11)[1:], *np.ones(20), 0]
    y = [*np.zeros(20), *np.zeros(10), *np.linspace(0.2, 1.0, 20), 0]
    trace = trace_of(reference, y)
    assert math.isnan(figure(trace, "overshoot"))
    assert figure(trace, "settled_error") == pytest.approx(float(np.mean(1.0 - np.array(y)[46:50])))
    (end,) = [end for tracking in trace.tracking() for end in tracking.ends if end.error > 0.0]
    assert end.step == 0.0


def test_a_rounding_error_of_the_reference_is_no_step() -> None:
    reference = np.repeat([0.3, 0.1 + 0.2, 1.0, 0.7 + 0.3 - 1e-16], 20)
    trace = trace_of([*reference, 0.0], [*np.repeat([0.3, 0.3, 1.0, 1.0], 20), 0.0])
    assert figure(trace, "overshoot") == pytest.approx(0.0, abs=1e-9)
    assert [end.step for tracking in trace.tracking() for end in tracking.ends] == [0.0, pytest.approx(0.7)]


def test_values_of_any_size_do_not_warn() -> None:
    y = np.repeat([0.0, 1e308], 20)
    y[30:] *= -1
    (tracking,) = stepping(0, 1, y=y).tracking()
    assert tracking.deviation == 1e308


def test_an_output_whose_reference_stays_has_no_steps_of_the_other_one() -> None:
    still = stepping(1, 1, 1, y=np.ones(60))
    assert math.isnan(figure(still, "overshoot"))
    assert figure(still, "settled_error") == 0.0


def test_anticipation_of_an_output_that_had_not_come_to_rest_is_not_known() -> None:
    y = np.repeat([0.0, 0.5, 3.0], 20)
    assert figure(stepping(0, 1, 3, y=y, preview=3), "anticipation") == 0.0
    assert math.isnan(figure(stepping(1, 3, y=np.repeat([0.5, 3.0], 20), preview=3), "anticipation"))


def test_what_drifts_before_its_controller_knows_of_the_step_does_not_anticipate() -> None:
    """The output drifts from 0 to 0.15 before the step to 1; others know of it 15 rows ahead."""
    trace = stepping(0, 1, y=np.concatenate([np.linspace(0.0, 0.15, 20), np.ones(20)]))
    key = "anticipation.y [s]"
    assert math.isnan(trace.metrics(MetricSettings(15))[key])
    assert replace(trace, preview=15).metrics()[key] == pytest.approx(13 * H)


def test_what_a_run_is_judged_by_is_taken_at_the_end_of_each_stretch() -> None:
    """Of 20 rows the last 4; the first stretch begins where the output is: not a step to settle after."""
    y = np.repeat([0.0, 0.51, 2.0], 20)
    y[30] = 4.0
    (tracking,) = stepping(0, 1, 2, y=y).tracking()
    assert (tracking.output, tracking.travel, tracking.deviation) == ("y", 2.0, 4.0)
    assert [(end.rows, end.step, end.settling) for end in tracking.ends] == [
        (4, 0.0, False),
        (4, 1.0, True),
        (4, 1.0, True),
    ]
    assert [end.magnitude for end in tracking.ends] == pytest.approx([0.0, 0.49, 0.0])
    assert tracking.mean_abs_error == pytest.approx((19 * 0.49 + 3.0) / 60)


def test_an_output_that_is_not_a_number_is_infinitely_far() -> None:
    y = np.repeat([0.0, 2.0], 20)
    y[35:] = NAN
    (tracking,) = stepping(0, 2, y=y).tracking()
    assert math.isnan(tracking.ends[-1].magnitude)


def test_the_quadratic_cost_by_hand() -> None:
    """Held are errors 1 and 2, inputs 3 and 1 with rest 1: changes 2 and -2, in the signals' own units."""
    trace = trace_of(
        [1, 1, 9],
        [0, -1, 9],
        [3, 1, 99],
        output=Variable("y", "rad", display_unit=DEGREES),
        actuator=Variable("u", "N", start=1.0),
    )
    settings = MetricSettings(cost={"outputs": {"y": 2.0}, "inputs": {"u": 0.5}, "changes": {"u": 0.25}})
    assert trace.metrics(settings)["cost [1]"] == pytest.approx(2 * (1 + 4) + 0.5 * (4 + 0) + 0.25 * (4 + 4))


def test_samples_and_figures_are_in_the_same_units() -> None:
    trace = trace_of([0.2] * 3, [0.1] * 3, output=Variable("y", "rad", display_unit=DEGREES))
    frame = trace.frame()
    error = (frame["reference y [deg]"] - frame["y [deg]"])[:2]
    assert trace.metrics()["sum_abs_error.y [deg]"] == pytest.approx(float(error.sum()))
    assert list(trace.columns())[1:3] == ["reference y [rad]", "y [rad]"]


def test_bounds_of_the_output_are_measured_on_both_sides() -> None:
    trace = trace_of([0] * 5, [3, -4, 1, 2, 99], y_limits=(-1.0, 2.0))
    assert figure(trace, "bound_violation_max") == pytest.approx(3.0)
    assert figure(trace, "bound_violation_time") == pytest.approx(2 * H)
    assert figure(trace, "limits_kept") == 50.0


def test_without_limits_there_is_no_share_in_which_they_are_kept() -> None:
    assert math.isnan(figure(trace_of([0] * 5, [3, -4, 1, 2, 99]), "limits_kept"))
    one_sided = trace_of([0] * 5, [3, -4, 1, 2, 99], y_limits=(-math.inf, 2.0))
    assert figure(one_sided, "limits_kept") == 75.0


def test_changes_of_the_input_start_from_its_value_at_rest() -> None:
    trace = trace_of([0] * 4, [0] * 4, [3, 1, -1, 99], actuator=Variable("u", "N", start=1.0))
    assert figure(trace, "max_abs_input") == 3.0
    assert figure(trace, "max_abs_change") == 2.0
    assert figure(trace, "total_variation") == 6.0
    assert figure(trace, "rms_change") == pytest.approx(2.0)


def test_time_at_the_input_limits() -> None:
    trace = trace_of([0] * 5, [0] * 5, [2, -2, 1.9, 2, 2], u_limits=(-2.0, 2.0))
    assert figure(trace, "time_at_bounds") == pytest.approx(3 * H)
    assert figure(trace_of([0] * 2, [0] * 2, [5, 5]), "time_at_bounds") == 0.0


def test_times_of_steps_count_every_row_that_has_one() -> None:
    times = [0.1, 0.2, 0.6, NAN]
    trace = trace_of([0] * 4, [0] * 4, solve_time=times, status=("ok", "late", "ok", "error"))
    assert figure(trace, "solve_time_mean") == pytest.approx(0.3)
    assert figure(trace, "solve_time_median") == pytest.approx(0.2)
    assert figure(trace, "solve_time_max") == pytest.approx(0.6)
    assert figure(trace, "solve_time_p95") == pytest.approx(0.56)
    assert figure(trace, "solve_time_p99") == pytest.approx(0.592)
    assert figure(trace, "deadline_misses") == 1.0
    assert figure(trace, "failures") == 2.0


@given(st.lists(st.floats(1e-9, 10.0), min_size=1, max_size=40))
def test_percentiles_are_those_of_numpy_to_the_last_bit(times: list[float]) -> None:
    n = len(times)
    trace = trace_of([0] * n, [0] * n, solve_time=times)
    percentiles = {"solve_time_median": 50, "solve_time_p95": 95, "solve_time_p99": 99}
    for name, percent in percentiles.items():
        assert figure(trace, name) == np.percentile(times, percent)


@pytest.mark.parametrize("rows", [0, 1])
def test_without_held_samples_there_are_no_figures_of_the_response(rows: int) -> None:
    """A run that ended at once must not look like one without any error."""
    trace = trace_of([1] * rows, [0] * rows, [NAN] * rows, outcome=Outcome.CONTROLLER_ERROR)
    figures = {split_key(key)[0]: value for key, value in trace.metrics().items()}
    nonexistent = {"sum_abs_error", "iae", "rmse", "min_abs_error", "max_abs_error", "settled_error"}
    nonexistent |= {
        "overshoot",
        "rise_time",
        "settling_time",
        "max_abs_input",
        "max_abs_change",
        "rms_change",
    }
    assert all(math.isnan(figures[name]) for name in nonexistent)
    assert figures["samples"] == rows


def test_values_of_any_size_give_figures_without_a_warning() -> None:
    """Warnings are errors here: a run that diverges must not fill the terminal with them."""
    trace = trace_of([0] * 4, [0, 1e200, -1e250, 0], [0, 1e308, -1e308, 0], outcome=Outcome.DIVERGED)
    assert figure(trace, "max_abs_error") == 1e250
    assert figure(trace, "rmse") == math.inf


VALUES = st.floats(-1e6, 1e6)


@given(st.integers(2, 30).flatmap(lambda n: arrays.arrays(float, (3, n), elements=VALUES)))
def test_laws_of_all_traces(table: FloatArray) -> None:
    reference, y, u = table
    trace = trace_of(reference, y, u)
    held = len(y) - 1
    error = np.abs(reference - y)[:held]
    assert figure(trace, "sum_abs_error") == pytest.approx(float(error.sum()))
    assert figure(trace, "min_abs_error") <= figure(trace, "rmse") * (1 + 1e-12)
    assert figure(trace, "rmse") <= figure(trace, "max_abs_error") * (1 + 1e-12)
    assert figure(trace, "total_variation") >= figure(trace, "max_abs_change")
    assert figure(trace, "total_variation") >= abs(u[held - 1]) - 1e-6
    assert figure(trace, "rms_change") <= figure(trace, "max_abs_change") * (1 + 1e-12)


@given(st.lists(VALUES, min_size=4, max_size=30), st.floats(0.1, 10.0))
def test_figures_of_a_step_do_not_depend_on_the_unit(y: list[float], factor: float) -> None:
    plain = trace_of([1.0] * len(y), y)
    scaled = trace_of([1.0] * len(y), y, output=Variable("y", "m", display_unit=DisplayUnit("x", -factor)))
    for name in ("overshoot", "rise_time", "settling_time", "bound_violation_time"):
        assert figure(scaled, name) == pytest.approx(figure(plain, name), nan_ok=True)
    assert figure(scaled, "sum_abs_error") == pytest.approx(factor * figure(plain, "sum_abs_error"))
