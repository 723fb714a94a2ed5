"""A cascade of two controllers: who sees which sample and which limits, and what it is good for."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from ddpc_controllers.cascade import Cascade
from ddpc_controllers.ipid import IPID
from ddpc_controllers.mfac import MFAC, MFAPC
from ddpc_cosim import Action, ConfigError, Controller, Loop, Recording, Sample, Variable, setting

from .loops import SAMPLING_TIME, LinearPlant, close_loop, make_loop, printed_deepc, together_and_alone

FREE = np.array([np.inf])


@dataclass(kw_only=True)
class Probe(Controller):
    """Says what it saw, and answers with its gain times the first reference."""

    gain: float = setting(1.0, doc="answer over reference")
    horizon: int = setting(1, low=1, doc="samples of reference")

    def start(self, loop: Loop) -> None:
        self.loop, self.samples = loop, []

    def step(self, sample: Sample) -> Action:
        self.samples.append(sample)
        return Action(self.gain * sample.reference[0], f"probe {self.gain:g}", {"seen": float(sample.k)})


def started(cascade: Cascade, loop: Loop) -> tuple[Probe, Probe]:
    """Start a cascade of probes and return its inner and outer one."""
    cascade.start(loop)
    inner, outer = cascade._inner.controller, cascade._outer.controller
    assert isinstance(inner, Probe)
    assert isinstance(outer, Probe)
    return inner, outer


def test_the_outer_controller_sets_the_inner_reference() -> None:
    cascade = Cascade(inner=Probe(gain=2.0, horizon=3), outer=Probe(gain=5.0))
    inner, outer = started(cascade, make_loop(None, np.ones(1), np.ones(1)))
    answer = cascade.step(Sample(0, 0.0, np.zeros(1), np.zeros(1), np.array([[0.1]]), np.array([0.1])))
    assert inner.samples[0].reference.tolist() == [[0.5]] * 3
    assert answer.u == pytest.approx([1.0])
    assert answer.status == "outer: probe 5; inner: probe 2"
    assert answer.info == {"outer.seen": 0.0, "inner.seen": 0.0}
    assert outer.loop.bounds.u_max == inner.loop.bounds.y_max == [1.0]


def test_the_outer_controller_may_be_slower() -> None:
    cascade = Cascade(inner=Probe(), outer=Probe(horizon=2), outer_period=3)
    assert cascade.horizon == 6
    inner, outer = started(cascade, make_loop(None, np.ones(1), np.ones(1)))
    assert outer.loop.sampling_time == pytest.approx(3 * inner.loop.sampling_time)
    reference = np.arange(1.0, 20.0)[:, np.newaxis]  # r_k = k
    for k in range(7):
        cascade.step(Sample(k, 0.1 * k, np.zeros(1), np.zeros(1), reference[k : k + 6], reference[k]))
    assert [sample.k for sample in outer.samples] == [0, 1, 2]
    assert [sample.reference.ravel().tolist() for sample in outer.samples] == [[3, 6], [6, 9], [9, 12]]
    assert [float(sample.reference[0, 0]) for sample in inner.samples] == [3, 3, 3, 6, 6, 6, 9]


def test_the_inner_loop_may_control_other_measurements() -> None:
    measurements = (Variable("position"), Variable("angle", min=-0.3, max=0.4))
    loop = replace(make_loop(None, np.ones(1), np.ones(1)), measurements=measurements)
    cascade = Cascade(inner=Probe(), outer=Probe(), inner_outputs=["angle"])
    inner, outer = started(cascade, loop)
    cascade.step(Sample(0, 0.0, np.array([7.0]), np.array([7.0, 0.1]), np.zeros((1, 1)), np.zeros(1)))
    assert inner.samples[0].y.tolist() == [0.1]
    assert outer.samples[0].y.tolist() == [7.0]
    assert (outer.loop.bounds.u_min, outer.loop.bounds.u_max) == ([-0.3], [0.4])
    assert [variable.name for variable in outer.loop.inputs] == ["angle"]


def test_unknown_inner_outputs_are_named() -> None:
    with pytest.raises(ConfigError, match=r'no measurement "angel"; there are x0'):
        Cascade(inner_outputs=["angel"]).start(make_loop(None, np.ones(1), np.ones(1)))


def test_a_controller_that_learns_from_a_recording_is_refused() -> None:
    with pytest.raises(ConfigError, match="outer: DeePC learns from a recording"):
        Cascade(outer=printed_deepc())


def test_what_is_not_a_controller_is_refused() -> None:
    with pytest.raises(ConfigError, match="inner = 7 is not a controller"):
        Cascade(inner=7)  # type: ignore[arg-type]


UNSTABLE = LinearPlant(np.array([[1.2, 0.1], [0.3, 1.1]]), np.array([[0.0], [0.5]]), np.array([[1.0, 0.0]]))
INNER = IPID(order=2, alpha=5.0, kp=4.0, kd=4.0, window=2)


@pytest.mark.parametrize("outer", [MFAPC(lambda_u=1.0), MFAC(lambda_u=0.1, step_factor=0.5)])
def test_an_unstable_plant_follows_its_reference_without_offset(outer: Controller) -> None:
    def last_error(controller: Controller) -> float:
        loop, reference = make_loop(None, 50.0 * np.ones(1), FREE), np.full((420, 1), 1.0)
        run = close_loop(controller, loop, UNSTABLE.advance, UNSTABLE.c, reference)
        return float(np.abs(run.y[-1] - reference[0])[0])

    assert np.abs(np.linalg.eigvals(UNSTABLE.a)).max() > 1.3
    assert last_error(outer) > 1.0
    assert last_error(INNER) > 0.1
    assert last_error(Cascade(inner=INNER, outer=outer)) < 1e-3


def test_two_pairs_are_two_cascades() -> None:
    def cascade(directions: list[float]) -> Cascade:
        inner = IPID(alpha=[direction / 0.1 for direction in directions])
        return Cascade(inner=inner, outer=MFAPC(structure="diagonal", initial_gradient=0.1))

    gains, plants = np.array([0.2, -0.4]), [LinearPlant.lag(1.05, 0.2), LinearPlant.lag(0.8, -0.4)]
    reference = np.tile([[1.0, -0.5]], (66, 1))
    both, alone = together_and_alone(
        lambda chosen: cascade(gains[chosen].tolist()), plants, 3.0, reference, 60
    )
    assert np.abs(both - alone).max() < 1e-9


@pytest.mark.parametrize("continues", [True, False])
def test_a_plant_at_rest_is_left_alone(continues: bool) -> None:
    # y+ = y + (u - y) / 10 rests at y = u = 2, the reference; the output's start value says 0.
    plant, rest = LinearPlant.lag(0.9, 0.1), np.full((50, 1), 2.0)
    loop = make_loop(Recording(rest, rest, rest, SAMPLING_TIME), np.array([10.0]), FREE)
    loop = replace(loop, inputs=(Variable("u0", start=2.0),), continues_recording=continues)
    cascade = Cascade(inner=IPID(kp=2.0), outer=MFAPC(initial_gradient=0.5))
    cascade.start(loop)
    y = np.array([2.0])
    for k in range(30):
        answer = cascade.step(Sample(k, 0.1 * k, y, y, rest[:5], rest[0]))
        y = plant.advance(y, answer.u)
        assert y == pytest.approx([2.0], abs=1e-9)
