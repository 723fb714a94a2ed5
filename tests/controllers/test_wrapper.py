"""Wrappers: decentralised control, scaled signals, offset-free tracking."""

import tomllib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ddpc_controllers import DeePC
from ddpc_controllers.cascade import Cascade
from ddpc_controllers.data.dictionaries import Combined, Delays, Gaussian, Polynomials
from ddpc_controllers.decentralised import Decentralised, Group
from ddpc_controllers.koopman_mpc import KoopmanMPC
from ddpc_controllers.models.identification import Identified
from ddpc_controllers.mpc import MPC
from ddpc_controllers.offset_free import OffsetFree
from ddpc_controllers.pid import PID
from ddpc_controllers.scaling import Scaled
from ddpc_cosim import (
    Action,
    ConfigError,
    Controller,
    FloatArray,
    Loop,
    Plant,
    Ramp,
    Recording,
    Sample,
    Trace,
    Variable,
    cosimulate,
    setting,
)
from ddpc_cosim.settings import from_plain

from .loops import (
    ANGLE,
    DEGREE,
    close_loop,
    make_loop,
    paper_reference,
    pendulum_loop,
    printed_deepc,
    printed_wkpc,
    quick_pendulum,
)


class Complaining(Controller):
    """Returns its number with a status and a value."""

    def __init__(self, number: float) -> None:
        self.number = number

    def start(self, loop: Loop) -> None:
        self.loop = loop

    def step(self, sample: Sample) -> Action:
        return Action(np.array([self.number]), f"complaint {self.number:g}", {"value": self.number})

    def diagnostics(self) -> dict[str, float]:
        return {"inputs": float(len(self.loop.inputs))}


@dataclass(kw_only=True)
class Witness(Controller):
    """Keeps what it is told."""

    horizon: int = setting(2, low=0, doc="references that it wants")

    def start(self, loop: Loop) -> None:
        self.loop, self.samples = loop, list[Sample]()

    def step(self, sample: Sample) -> FloatArray:
        self.samples.append(sample)
        return np.full(len(self.loop.inputs), 0.25)


def traced(controller: Controller, preview: int | None, outputs: int = 1) -> Trace:
    """Close the loop on one lag under a ramp of 1 per sample, or on two, the second ramp twice as steep."""
    plants = Lags(outputs)
    ramps = {f"y{i}": Ramp(0.0, 100.0 + 100.0 * i, 0.0, 100.0) for i in range(outputs)}
    return cosimulate(plants, controller, sampling_time=1.0, duration=6.0, reference=ramps, preview=preview)


class Lags(Plant):
    """y_k+1 = y_k / 2 + u_k, as often as is asked for."""

    def __init__(self, size: int) -> None:
        self.inputs = tuple(Variable(f"u{i}", min=-1.0, max=1.0) for i in range(size))
        self.outputs = tuple(Variable(f"y{i}", min=-1e3, max=1e3, nominal=10.0) for i in range(size))

    def reset(self, parameters: object = None, t0: float = 0.0) -> FloatArray:
        self.y = np.zeros(len(self.outputs))
        return self.y

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.y = 0.5 * self.y + u
        return self.y


def inside(wrapper: Any) -> list[Witness]:
    """Return the witnesses that ran."""
    return [inner.controller for inner in wrapper._running if isinstance(inner.controller, Witness)]


@pytest.mark.parametrize("preview", [None, 0, 1, 2, 5])
def test_each_of_a_group_is_told_its_own_part_of_what_may_be_known(preview: int | None) -> None:
    controller = grouped(Witness(horizon=1), Witness(horizon=4))
    assert traced(controller, preview, outputs=2).completed
    for output, (witness, horizon) in enumerate(zip(inside(controller), (1, 4), strict=True)):
        seen = min(horizon, 4 if preview is None else preview)
        assert witness.loop.preview == seen
        for sample in witness.samples:
            ahead = [sample.k + min(i, seen) for i in range(1, horizon + 1)]
            assert sample.setpoint == pytest.approx([(1 + output) * sample.k])
            assert sample.reference[:, 0] == pytest.approx([(1 + output) * k for k in ahead])


@pytest.mark.parametrize("preview", [None, 0, 1, 2])
@pytest.mark.parametrize("horizon", [0, 3])
def test_a_scaled_controller_is_told_the_same_in_its_units(preview: int | None, horizon: int) -> None:
    controller = Scaled(controller=Witness(horizon=horizon), scale_by="nominal")
    assert traced(controller, preview).completed
    (witness,) = inside(controller)
    seen = horizon if preview is None else min(horizon, preview)
    assert witness.loop.preview == seen
    for sample in witness.samples:
        assert sample.setpoint == pytest.approx([0.1 * sample.k])
        assert sample.reference[:, 0] == pytest.approx(
            [0.1 * (sample.k + min(i, seen)) for i in range(1, horizon + 1)]
        )


@pytest.mark.parametrize("preview", [None, 0, 1, 2])
@pytest.mark.parametrize("horizon", [0, 1, 3])
def test_setpoint_and_references_are_shifted_alike(preview: int | None, horizon: int) -> None:
    controller = OffsetFree(controller=Witness(horizon=horizon))
    assert traced(controller, preview).completed
    (witness,) = inside(controller)
    seen = horizon if preview is None else min(horizon, preview)
    assert witness.loop.preview == seen
    shifts = []
    for sample in witness.samples:
        ahead = np.array([sample.k + min(i, seen) for i in range(horizon + 1)], dtype=float)
        shift = np.array([*sample.setpoint, *sample.reference[:, 0]]) - ahead
        assert np.ptp(shift) == pytest.approx(0.0, abs=1e-9)
        shifts.append(float(shift[0]))
    assert np.ptp(shifts) > 0.0


@pytest.mark.parametrize(("period", "preview", "rows"), [(1, None, (1, 2)), (1, 1, (1, 1)), (1, 0, (0, 0))])
def test_a_cascade_passes_the_future_to_its_outer_controller_alone(
    period: int, preview: int | None, rows: tuple[int, int]
) -> None:
    cascade = Cascade(inner=Witness(horizon=3), outer=Witness(horizon=2), outer_period=period)
    assert traced(cascade, preview).completed
    inner, outer = inside(cascade)
    assert outer.loop.preview == (2 if preview is None else preview)
    for sample in outer.samples:
        assert sample.setpoint == pytest.approx([sample.k])
        assert sample.reference[:, 0] == pytest.approx([sample.k + i for i in rows])
    assert inner.loop.preview == 0  # what the outer controller will ask for is not known ahead
    for sample in inner.samples:
        assert [*sample.setpoint, *sample.reference[:, 0]] == [0.25] * 4


def test_a_slower_outer_controller_is_told_what_is_known_of_its_own_samples() -> None:
    cascade = Cascade(inner=Witness(), outer=Witness(horizon=3), outer_period=2)
    assert traced(cascade, preview=3).completed
    _, outer = inside(cascade)
    assert outer.loop.preview == 1
    assert [sample.setpoint.tolist() for sample in outer.samples] == [[0.0], [2.0], [4.0], [6.0]]
    # Of r_k+2, r_k+4 and r_k+6 the first is known; what is known last, r_k+3, stands for the others.
    assert [sample.reference[:, 0].tolist() for sample in outer.samples] == [
        [2, 3, 3],
        [4, 5, 5],
        [6, 7, 7],
        [8, 9, 9],
    ]


def loop_of_two(limit: float = 9.0) -> Loop:
    """A loop with inputs u0 and u1, outputs y0 and y1."""
    return make_loop(None, np.full(2, limit), np.full(2, limit))


def grouped(first: Controller, second: Controller) -> Decentralised:
    """The loops crossed: u1 holds y0, and u0 holds y1."""
    return Decentralised(
        groups=[
            Group(inputs=["u1"], outputs=["y0"], controller=first),
            Group(inputs=["u0"], outputs=["y1"], controller=second),
        ]
    )


def settled_errors(controller: Controller, loop: Loop) -> FloatArray:
    """Return the errors [deg] before the reference of the pendulum's loop is seen to step."""
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference())
    assert np.abs(run.u).max() <= 3.5
    before_the_next = np.array([100, 200, 300, 400]) - controller.horizon - 1
    return np.asarray((run.y - run.reference[:400])[before_the_next, 0] / DEGREE)


def test_each_group_gets_its_signals_and_keeps_to_its_inputs() -> None:
    shared = PID(proportional=1.0)
    controller = grouped(shared, shared)
    controller.start(loop_of_two())
    sample = Sample(0, 0.0, np.zeros(2), np.zeros(2), np.array([[1.0, 3.0]]), np.array([1.0, 3.0]))
    answer = controller.step(sample)
    assert (answer.u.tolist(), answer.status) == ([3.0, 1.0], "ok")
    assert controller.diagnostics()["y1.proportional[0]"] == 1.0


def test_statuses_and_values_say_whose_they_are() -> None:
    controller = grouped(Complaining(1.0), Complaining(2.0))
    controller.start(loop_of_two())
    answer = controller.step(Sample(0, 0.0, np.zeros(2), np.zeros(2), np.zeros((1, 2)), np.zeros(2)))
    assert isinstance(answer, Action)
    assert answer.u.tolist() == [2.0, 1.0]
    assert answer.status == "y0: complaint 1; y1: complaint 2"
    assert answer.info == {"y0.value": 1.0, "y1.value": 2.0}
    assert controller.diagnostics() == {"y0.inputs": 1.0, "y1.inputs": 1.0}


def test_the_longest_horizon_and_recording_are_asked_for() -> None:
    controller = grouped(MPC(horizon=7), printed_deepc(horizon=11))
    assert controller.horizon == 11
    assert controller.uses_recording
    assert controller.recording_length(2, 2, 2) == printed_deepc(horizon=11).recording_length(1, 1, 2)
    assert not grouped(PID(), PID()).uses_recording


def test_groups_that_do_not_share_out_the_loop_are_named() -> None:
    controller = Decentralised(
        groups=[
            Group(inputs=["u0", "valve"], outputs=["y0"], controller=PID()),
            Group(inputs=["u0"], outputs=["y1"], controller=PID()),
        ]
    )
    with pytest.raises(ConfigError) as caught:
        controller.start(loop_of_two())
    assert [fault.removeprefix("Decentralised: ") for fault in caught.value.faults] == [
        'no input "valve"; the loop has u0, u1',
        'input "u0" is in 2 groups; needed: one',
        'input "u1" is in 0 groups; needed: one',
    ]


def test_a_scaled_controller_sees_parts_of_the_ranges() -> None:
    seen: list[Any] = []

    class Watching(Complaining):
        def step(self, sample: Sample) -> Action:
            seen.extend([self.loop, sample])
            return Action(np.array([0.5]))

    recording = Recording(np.ones((3, 1)), np.ones((3, 1)), np.ones((3, 2)), 0.1)
    loop = make_loop(recording, np.full(1, 4.0), np.full(1, 2.0))
    measurements = (Variable("y0"), Variable("speed", nominal=10.0))
    controller = Scaled(controller=Watching(0.0))
    controller.start(replace(loop, measurements=measurements))
    answer = controller.step(
        Sample(0, 0.0, np.ones(1), np.array([1.0, 5.0]), np.full((1, 1), 1.5), np.full(1, 1.5))
    )
    inner, sample = seen
    assert isinstance(answer, Action)
    assert answer.u.tolist() == [2.0]
    assert (inner.bounds.u_max.tolist(), inner.bounds.y_max.tolist()) == ([1.0], [1.0])
    assert (sample.y.tolist(), sample.measured.tolist(), sample.reference.tolist()) == (
        [0.5],
        [0.5, 0.5],
        [[0.75]],
    )
    assert inner.recording.measured[0].tolist() == [0.5, 0.1]


def test_scaling_changes_nothing_but_the_meaning_of_the_weights(state_recording: Recording) -> None:
    loop = pendulum_loop(state_recording, torque=2.5, degrees=70.0)
    degrees = 70.0 * DEGREE
    plain = printed_deepc(lambda_g=1e-6)
    scaled = Scaled(
        controller=printed_deepc(
            output_weight=100.0 * degrees**2,
            setpoint_weight=300.0 * degrees**2,
            input_weight=10.0 * 2.5**2,
            lambda_g=1e-6,
            lambda_sigma=1e7 * degrees**2,
        )
    )
    plain_run, other = (
        close_loop(c, loop, quick_pendulum, ANGLE, paper_reference(), 150) for c in (plain, scaled)
    )
    assert np.abs(plain_run.u - other.u).max() < 1e-6


def test_without_a_range_the_nominal_value_is_the_unit() -> None:
    loop = make_loop(None, np.full(1, np.inf), np.full(1, np.inf))
    loop = replace(loop, inputs=(Variable("u0", nominal=20.0),), outputs=(Variable("y0", nominal=0.5),))
    controller = Scaled(controller=PID(proportional=1.0))
    controller.start(loop)
    answer = controller.step(
        Sample(0, 0.0, np.zeros(1), np.zeros(1), np.full((1, 1), 0.25), np.full(1, 0.25))
    )
    assert answer.u == pytest.approx([10.0])
    unknown = replace(loop, inputs=(Variable("u0", nominal=0.0),))
    with pytest.raises(ConfigError, match='"u0" cannot be scaled: its nominal value is 0'):
        controller.start(unknown)


@pytest.mark.parametrize(
    ("inner", "degrees"),
    [
        (printed_deepc(), 70.0),
        (printed_wkpc(), 170.0),
        (MPC(disturbance="none"), 70.0),
        (KoopmanMPC(disturbance_gain=0.0), 70.0),
    ],
    ids=["deepc", "wkpc", "mpc", "koopman"],
)
def test_the_offset_on_the_pendulum_goes_below_a_tenth_of_a_degree(
    inner: Controller, degrees: float, state_recording: Recording
) -> None:
    loop = pendulum_loop(state_recording, degrees=degrees)
    assert np.abs(settled_errors(inner, loop)).max() > 0.1
    assert np.abs(settled_errors(OffsetFree(controller=inner), loop)).max() < 0.1


def test_the_estimate_is_held_while_an_input_is_at_its_limit(state_recording: Recording) -> None:
    reference = np.vstack([np.full((100, 1), 60.0 * DEGREE), np.full((120, 1), 5.0 * DEGREE)])
    loop = pendulum_loop(state_recording, torque=2.0)
    controller = OffsetFree(controller=MPC(disturbance="none"))
    run = close_loop(controller, loop, quick_pendulum, ANGLE, reference, 200)
    assert (run.u[40:90] == 2.0).all()
    assert abs(run.y[130, 0] - 5.0 * DEGREE) < 1.0 * DEGREE


def test_a_missing_measurement_does_not_stop_the_correction(state_recording: Recording) -> None:
    controller = OffsetFree(controller=MPC(disturbance="none"))
    controller.start(pendulum_loop(state_recording))
    for k, angle in enumerate([np.nan, 0.0, np.nan, 0.01]):
        answer = controller.step(
            Sample(k, 0.1 * k, np.array([angle]), np.zeros(2), np.full((5, 1), 0.2), np.full(1, 0.2))
        )
        assert np.isfinite(answer.u if isinstance(answer, Action) else answer).all()


STUDY_SETTINGS = """
[decentralised]
groups = [
    { inputs = ["u0"], outputs = ["y0"], controller = { type = "ddpc_controllers.pid:PID", proportional = 2.0 } },
    { inputs = ["u1"], outputs = ["y1"], controller = { type = "deepc", horizon = 9 } },
]

[scaled]
controller = { type = "ddpc_controllers.mpc:MPC", model = { lags = 7 } }

[koopman]
dictionary = { type = "ddpc_controllers.data.dictionaries:Combined", dictionaries = [
    { type = "ddpc_controllers.data.dictionaries:Polynomials", degree = 3 },
    { type = "ddpc_controllers.data.dictionaries:Delays", dictionary = { type = "ddpc_controllers.data.dictionaries:Gaussian" } },
] }
"""  # noqa: E501 - as a study file writes it


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (
            Decentralised,
            Decentralised(
                groups=[
                    Group(inputs=["u0"], outputs=["y0"], controller=PID(proportional=2.0)),
                    Group(inputs=["u1"], outputs=["y1"], controller=DeePC(horizon=9)),
                ]
            ),
        ),
        (Scaled, Scaled(controller=MPC(model=Identified(lags=7)))),
        (
            KoopmanMPC,
            KoopmanMPC(
                dictionary=Combined(dictionaries=[Polynomials(degree=3), Delays(dictionary=Gaussian())])
            ),
        ),
    ],
    ids=["decentralised", "scaled", "koopman"],
)
def test_a_study_file_can_say_it_and_says_it_again(kind: Any, expected: Any) -> None:
    section = {Decentralised: "decentralised", Scaled: "scaled", KoopmanMPC: "koopman"}[kind]
    written = tomllib.loads(STUDY_SETTINGS)[section]
    for settings in (written, expected.settings()):
        made = kind(**{name: from_plain(kind, name, value) for name, value in settings.items()})
        assert made.settings() == expected.settings()


def test_what_is_wrong_inside_a_wrapper_is_found() -> None:
    with pytest.raises(ConfigError, match=r"groups\[0\]\.input: unknown setting of Group; did you mean"):
        from_plain(Decentralised, "groups", [{"input": ["u"]}])
    with pytest.raises(ConfigError, match=r'controller\.type: no controller "depc"; did you mean "deepc"'):
        from_plain(Scaled, "controller", {"type": "depc"})


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        (Scaled, {"controller": 3}, "Scaled: controller = 3 is not a controller"),
        (OffsetFree, {"controller": None}, "OffsetFree: controller = None is not a controller"),
        (OffsetFree, {"controller": PID(), "gain": 1.5}, "gain = 1.5 is not possible"),
        (Decentralised, {"groups": []}, "groups is empty"),
        (Decentralised, {"groups": [PID()]}, r"groups\[0\] = PID\(.*\) is not a group"),
        (Group, {"inputs": [], "outputs": [], "controller": 1}, "Group: controller = 1 is not a controller"),
    ],
)
def test_impossible_wrappers_are_refused(kind: Any, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        kind(**settings)
