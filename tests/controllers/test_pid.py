"""PID: the difference equations against python-control, anti-windup, and gains from a step test."""

from typing import Any

import control
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from ddpc_controllers import pid
from ddpc_controllers.pid import PID, SecondOrder, fit_second_order, simc
from ddpc_cosim import Action, ConfigError, DataError, FloatArray, Recording, Sample

from .loops import (
    ANGLE,
    DEGREE,
    LinearPlant,
    close_loop,
    experiment,
    make_loop,
    paper_reference,
    pendulum_experiment,
    pendulum_loop,
    quick_pendulum,
)

H = 0.1
TUNED: tuple[Any, ...] = ("step-test", "virtual-reference")
FREE = make_loop(None, np.full(1, np.inf), np.full(1, np.inf))


def inputs(controller: PID, outputs: FloatArray, reference: FloatArray) -> FloatArray:
    """Feed outputs to a controller and return its inputs."""
    answers = [
        controller.step(Sample(k, H * k, y, y, r[np.newaxis], r))
        for k, (y, r) in enumerate(zip(outputs, reference, strict=True))
    ]
    return np.array([a.u if isinstance(a, Action) else a for a in answers])


def step_test(samples: int = 80, delay: int = 0) -> Recording:
    """A step at the pendulum, after ten samples at rest."""
    u = np.zeros((samples, 1))
    u[10:] = 0.5
    recorded = experiment(quick_pendulum, u, 2, ANGLE)
    y = np.vstack([np.zeros((delay, 1)), recorded.y])[:samples]
    return Recording(u, y, y, H)


def test_the_transfer_function_is_that_of_python_control() -> None:
    rng = np.random.default_rng(0)
    y = np.vstack([np.zeros((1, 1)), rng.standard_normal((400, 1))])
    controller = PID(proportional=1.3, integral=0.7, derivative=0.4, filter_time=0.25)
    controller.start(FREE)
    u = inputs(controller, y, np.zeros_like(y))
    parts = [
        control.c2d(control.tf(*parts), H, "backward_diff")
        for parts in (([0.7], [1.0, 0.0]), ([0.4, 0.0], [0.25, 1.0]))
    ]
    time = H * np.arange(len(y))
    expected = -1.3 * y[:, 0] - sum(control.forced_response(part, time, y[:, 0]).outputs for part in parts)
    assert np.abs(u[:, 0] - expected).max() < 1e-9


def test_a_share_of_the_reference_enters_the_proportional_part() -> None:
    controller = PID(proportional=2.0, setpoint_share=0.25)
    controller.start(FREE)
    u = inputs(controller, np.zeros((3, 1)), np.ones((3, 1)))
    assert u[:, 0].tolist() == [0.5, 0.5, 0.5]


@pytest.mark.parametrize("method", ["back-calculation", "clamping"])
def test_a_limit_does_not_wind_it_up(method: Any) -> None:
    controller = PID(proportional=1.0, integral=1.0, anti_windup=method)
    controller.start(make_loop(None, np.ones(1), np.ones(1)))
    out_of_reach = inputs(controller, np.zeros((200, 1)), np.full((200, 1), 5.0))
    assert (out_of_reach == 1.0).all()
    back = inputs(controller, np.zeros((5, 1)), np.full((5, 1), -0.5))
    assert (back < 1.0).all()


def test_a_slower_back_calculation_leaves_the_limit_later() -> None:
    def integral_after(tracking_time: float) -> float:
        controller = PID(proportional=0.1, integral=1.0, tracking_time=tracking_time)
        controller.start(make_loop(None, np.ones(1), np.ones(1)))
        inputs(controller, np.zeros((50, 1)), np.full((50, 1), 5.0))
        assert controller._integral is not None
        return float(controller._integral[0])

    assert integral_after(0.0) < integral_after(0.5) < integral_after(2.0)


def test_loops_are_paired_as_given() -> None:
    loop = make_loop(None, np.full(3, 9.0), np.full(2, 9.0))
    controller = PID(proportional=[1.0, -2.0], pairing=[2, 0])
    controller.start(loop)
    u = inputs(controller, np.zeros((1, 2)), np.array([[1.0, 1.0]]))
    assert u.tolist() == [[-2.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("pairing", "sizes"), [([], (1, 2)), ([0, 0], (2, 2)), ([0, 2], (2, 2)), ([0], (2, 2))]
)
def test_an_output_without_an_input_of_its_own_is_refused(pairing: list[int], sizes: tuple[int, int]) -> None:
    loop = make_loop(None, np.ones(sizes[0]), np.ones(sizes[1]))
    with pytest.raises(ConfigError, match="an input of its own"):
        PID(pairing=pairing).start(loop)


def test_every_gain_of_the_wrong_size_is_named() -> None:
    with pytest.raises(ConfigError) as caught:
        PID(proportional=[1.0, 2.0], integral=[1.0, 2.0, 3.0]).start(FREE)
    assert [fault.split()[1] for fault in caught.value.faults] == ["proportional", "integral"]


def test_a_reference_that_is_missing_holds_the_input_and_is_forgotten() -> None:
    controller = PID(proportional=1.0, integral=1.0)
    controller.start(FREE)
    y, reference = np.zeros((4, 1)), np.array([[1.0], [np.nan], [1.0], [1.0]])
    assert inputs(controller, y, reference)[:, 0] == pytest.approx([1.1, 1.1, 1.2, 1.3])
    missing = controller.step(Sample(4, 0.4, y[0], y[0], np.full((1, 1), np.nan), np.full(1, np.nan)))
    assert isinstance(missing, Action)
    assert missing.status == "a reference is not finite: inputs held"


def test_the_derivative_knows_how_long_the_output_was_missing() -> None:
    controller = PID(proportional=0.0, derivative=1.0)
    controller.start(FREE)
    ramp = 0.1 * np.arange(12.0)[:, np.newaxis]
    ramp[4:8] = np.nan
    u = inputs(controller, ramp, np.zeros((12, 1)))
    assert u[1:, 0] == pytest.approx(np.full(11, -1.0))


@pytest.mark.parametrize("method", ["back-calculation", "clamping"])
def test_without_integral_action_the_bias_stays_through_a_limit(method: Any) -> None:
    controller = PID(proportional=10.0, anti_windup=method)
    controller.start(make_loop(None, np.ones(1), np.ones(1)))
    u = inputs(controller, np.zeros((6, 1)), np.array([[1.0]] * 5 + [[0.0]]))
    assert u[:, 0].tolist() == [1.0] * 5 + [0.0]


@pytest.mark.parametrize("delay", [0, 3])
@pytest.mark.parametrize("source", ["step", "excitation"])
def test_the_second_order_model_of_the_pendulum_is_found(delay: int, source: str) -> None:
    recording = step_test(delay=delay)
    if source == "excitation":
        free = pendulum_experiment(3)
        small = experiment(quick_pendulum, 0.1 * free.u, 2, ANGLE)
        y = np.vstack([np.zeros((delay, 1)), small.y])[: len(small)]
        recording = Recording(small.u, y, y, H)
    model, _ = fit_second_order(recording, 0, 0)
    assert model.delay == pytest.approx(delay * H)
    assert abs(model.poles[0]) == pytest.approx(np.sqrt(9.81 / 0.2), rel=0.01)
    assert model.poles[0].real == pytest.approx(-1.0, rel=0.02)
    assert model.gain == pytest.approx(1.0 / 9.81, rel=0.01)


def test_the_rules_are_as_published() -> None:
    """Skogestad (2003), Table 1: a second-order and a first-order process, tau_c = theta."""
    lags = SecondOrder(gain=2.0, poles=(-1.0 / 8.0, -1.0 / 1.0), delay=0.5)
    kp, ki, kd, filter_time = simc(lags, sampling_time=0.0)
    series, integral_time, derivative_time = 8.0 / (2.0 * 1.0), min(8.0, 4.0), 1.0
    assert kp == pytest.approx(series * (1.0 + derivative_time / integral_time))
    assert ki == pytest.approx(series / integral_time)
    assert kd == pytest.approx(series * derivative_time)
    assert filter_time == pytest.approx(0.1 * kd / kp)


@pytest.mark.parametrize("poles", [(-0.5, -2.0), (-0.5 + 1j, -0.5 - 1j)])
def test_the_rules_take_many_times_at_once(poles: tuple[complex, complex]) -> None:
    model, times = SecondOrder(gain=-3.0, poles=poles, delay=0.2), np.array([0.1, 1.0, 30.0])
    each = [simc(model, H, time) for time in times.tolist()]
    np.testing.assert_array_equal(simc(model, H, times), np.transpose(each))


def test_the_tuned_loop_tracks_the_pendulum_without_offset() -> None:
    loop = pendulum_loop(step_test())
    controller = PID(tuning="step-test")
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference())
    error = (run.y - run.reference[:400])[[98, 198, 298, 398]] / DEGREE
    assert np.abs(error).max() < 0.1
    assert np.abs(run.u).max() <= 3.5
    assert controller.diagnostics()["integral[0]"] > 0.0


def tuned_error(plant: LinearPlant) -> float:
    """Return the largest error of the last 100 of 6000 samples after a unit step of the reference."""
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 1))
    recording = experiment(plant.advance, u, 2, plant.c)
    loop = make_loop(recording, np.array([np.inf]), np.array([np.inf]))
    run = close_loop(PID(tuning="step-test"), loop, plant.advance, plant.c, np.ones((6002, 1)), steps=6000)
    return float(np.abs(run.y[-100:] - 1.0).max())


@pytest.mark.parametrize("damping", [0.3, 0.05, 0.01])
@pytest.mark.parametrize("frequency", [1.0, 3.0])
def test_a_lightly_damped_plant_is_tuned_to_a_stable_loop(damping: float, frequency: float) -> None:
    squared = frequency**2
    continuous = control.ss(
        [[0.0, 1.0], [-squared, -2.0 * damping * frequency]], [[0.0], [squared]], [[1.0, 0.0]], 0.0
    )
    sampled = control.c2d(continuous, H)
    assert tuned_error(LinearPlant(sampled.A, sampled.B, sampled.C)) < 1e-5


@pytest.mark.parametrize("zero", [1.05, 1.3, 3.0])
def test_an_inverse_response_counts_as_delay(zero: float) -> None:
    # (z - zero) / ((z - 0.7) (z - 0.5)), of gain one: a first-order factor 1 - T s has its zero at 1 / T.
    numerator = 0.15 * np.array([[-1.0, zero]]) / (zero - 1.0)
    plant = LinearPlant(np.array([[1.2, -0.35], [1.0, 0.0]]), np.array([[1.0], [0.0]]), numerator)
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 1))
    model, _ = fit_second_order(experiment(plant.advance, u, 2, plant.c), 0, 0)
    assert model.delay == pytest.approx(H / np.log(zero))
    assert tuned_error(plant) < 1e-6


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        (Recording(np.zeros((50, 1)), np.ones((50, 1)), np.ones((50, 1)), H), "does not follow input 0"),
        (Recording(np.ones((5, 1)), np.ones((5, 1)), np.ones((5, 1)), H), "a step test takes at least 9"),
    ],
)
def test_a_recording_without_a_step_is_refused(recording: Recording, message: str) -> None:
    with pytest.raises(DataError, match=message):
        PID(tuning="step-test").start(pendulum_loop(recording))


def maximum_sensitivity(controller: PID, plant: control.TransferFunction) -> float:
    """Return max |1 / (1 + P C)|, C measured by the controller's answer to one wrong measurement."""
    zero = np.zeros(1)
    answers = []
    for k in range(800):
        y = np.array([float(k == 2)])
        answers.append(float(np.ravel(controller.step(Sample(k, k * H, y, y, zero[np.newaxis], zero)))[0]))
    settled = answers[-1]
    transient = -(np.array(answers[2:]) - settled)
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 4000))
    # What stays, from the first answer on, is the integral part: settled z / (z - 1).
    c = np.polyval(transient[::-1], 1.0 / z) - settled * z / (z - 1.0)
    return float(np.abs(1.0 / (1.0 + plant(z) * c)).max())


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(st.floats(0.3, 0.99), st.floats(-0.3, 0.95)),
    st.floats(-0.8, 1.5),
    st.integers(0, 6),
    st.sampled_from([-3.0, 0.01, 1.0, 200.0]),
    st.sampled_from([0.0, 0.1, 2.0]),
)
def test_tuned_loops_keep_the_maximum_sensitivity(
    poles: tuple[float, float], zero: float, delay: int, gain: float, wanted: float
) -> None:
    assume(abs(zero - 1.0) > 0.2)
    a, b = np.poly(poles), np.array([1.0, -zero])
    b *= gain * a.sum() / b.sum()
    u, y = np.random.default_rng(1).uniform(-1.0, 1.0, (300, 1)), np.zeros((300, 1))
    for k in range(delay + 2, 300):
        y[k] = -a[1] * y[k - 1] - a[2] * y[k - 2] + b[0] * u[k - delay - 1] + b[1] * u[k - delay - 2]
    controller = PID(tuning="step-test", closed_loop_time=wanted)
    loop = make_loop(Recording(u, y, y, H), np.array([np.inf]), np.array([np.inf]))
    controller.start(loop)
    plant = control.tf(b, np.append(a, np.zeros(delay)), H)
    largest, diagnostics = maximum_sensitivity(controller, plant), controller.diagnostics()
    assert wanted or largest <= 1.7 * 1.001
    if np.isfinite(diagnostics["maximum_sensitivity[0]"]):
        assert diagnostics["maximum_sensitivity[0]"] == pytest.approx(largest, rel=1e-2)
    # To the digits that the warning shows.
    assert bool(controller.warnings()) == (round(diagnostics["maximum_sensitivity[0]"], 2) > 1.7)


def test_a_loop_that_is_asked_to_be_too_fast_says_so_and_what_would_do() -> None:
    loop = pendulum_loop(step_test())
    fast = PID(tuning="step-test", closed_loop_time=0.01)
    fast.start(loop)
    (warning,) = fast.warnings()
    assert "closed_loop_time = 0.01 s" in warning
    assert "; a maximum sensitivity of 1.7 takes closed_loop_time = " in warning
    enough = PID(tuning="step-test", closed_loop_time=1.001 * float(warning.split()[-2]))
    enough.start(loop)
    assert enough.warnings() == []


def test_a_time_that_was_asked_for_is_kept_where_no_other_keeps_the_margin(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pid, "sensitivity", lambda *_: 2.5)
    loop = pendulum_loop(step_test())
    asked = PID(tuning="step-test", closed_loop_time=0.5)
    asked.start(loop)
    (warning,) = asked.warnings()
    assert "closed_loop_time = 0.5 s gives loop 0 a maximum sensitivity of 2.5" in warning
    assert warning.endswith("a maximum sensitivity of 1.7 takes gains tuned by hand")
    with pytest.raises(DataError, match=r"no closed_loop_time up to .* s gives the loop of output 0"):
        PID(tuning="step-test").start(loop)


def test_an_unstable_plant_is_not_tuned() -> None:
    u = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 1))
    grows = experiment(lambda x, v: 1.3 * x + v, u, 1, np.eye(1))
    for tuning in TUNED:
        with pytest.raises(DataError, match=r"grows by itself, by up to 1\.3 a sample"):
            PID(tuning=tuning).start(make_loop(grows, np.ones(1), np.ones(1)))
    with pytest.raises(DataError, match=r"grows by itself, by up to 1\.3 a sample"):
        fit_second_order(grows, 0, 0)


def nearly_integrating(growth: float) -> Recording:
    """A plant that grows a little by itself, with so much noise that this cannot be seen."""
    rng = np.random.default_rng(0)
    u, y = rng.uniform(-1.0, 1.0, (150, 1)), np.zeros((150, 1))
    for k in range(1, 150):
        y[k] = growth * y[k - 1] + 0.1 * u[k - 1]
    y += 0.02 * rng.standard_normal(y.shape)
    return Recording(u, y, y, H)


@pytest.mark.parametrize("tuning", TUNED)
def test_an_estimate_that_grows_by_a_hair_is_tuned_as_an_integrator(tuning: Any) -> None:
    recording = nearly_integrating(1.008)
    model, _ = fit_second_order(recording, 0, 0)
    assert model.growth > 1.0 + 1.0 / 150  # beyond what counts as integrating whatever the noise
    controller = PID(tuning=tuning)
    loop = make_loop(recording, np.array([np.inf]), np.array([np.inf]))
    run = close_loop(
        controller, loop, lambda x, u: 1.008 * x + 0.1 * u, np.eye(1), np.ones((402, 1)), steps=400
    )
    assert np.abs(run.y[-50:] - 1.0).max() < 0.02
    assert any("cannot be told from an integrating plant" in warning for warning in controller.warnings())


def lag_recording() -> Recording:
    """Two lags, without noise."""
    u, y = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 1)), np.zeros((200, 1))
    for k in range(2, 200):
        y[k] = 1.5 * y[k - 1] - 0.56 * y[k - 2] + 0.05 * u[k - 1]
    return Recording(u, y, y, H)


@pytest.mark.parametrize(("structure", "parts"), [("pid", "111"), ("pi", "110"), ("i", "010")])
def test_a_virtual_reference_keeps_to_the_structure(structure: Any, parts: str) -> None:
    loop = make_loop(lag_recording(), np.array([np.inf]), np.array([np.inf]))
    controller = PID(tuning="virtual-reference", structure=structure, closed_loop_time=1.5)
    controller.start(loop)
    shown = controller.diagnostics()
    assert shown["by_virtual_reference[0]"] == 1.0
    gains = [shown[f"{name}[0]"] != 0.0 for name in ("proportional", "integral", "derivative")]
    assert gains == [part == "1" for part in parts]


def test_without_a_stable_loop_the_gains_are_those_of_the_step_test_which_is_said() -> None:
    """An integral part alone cannot stabilise an integrating plant."""
    rng = np.random.default_rng(3)
    recording = experiment(lambda x, v: x + 0.1 * v, rng.uniform(-1.0, 1.0, (120, 1)), 1, np.eye(1))
    loop = make_loop(recording, np.array([np.inf]), np.array([np.inf]))
    by_rule, by_reference = PID(tuning="step-test"), PID(tuning="virtual-reference", structure="i")
    for controller in (by_rule, by_reference):
        controller.start(loop)
    shown = dict(by_reference.diagnostics())
    assert shown.pop("by_virtual_reference[0]") == 0.0
    assert shown == by_rule.diagnostics()
    assert [warning.split(":")[1] for warning in by_reference.warnings()] == [
        " loop 0 has the gains of tuning = 'step-test'"
    ]


def test_a_recording_too_short_for_a_virtual_reference_is_tuned_as_a_step_test() -> None:
    recording = lag_recording()
    short = Recording(recording.u[:9], recording.y[:9], recording.y[:9], H)
    loop = make_loop(short, np.array([np.inf]), np.array([np.inf]))
    controller = PID(tuning="virtual-reference")
    controller.start(loop)
    assert controller.diagnostics()["by_virtual_reference[0]"] in (0.0, 1.0)
