"""WKPC (10)-(12) against the full problem, and the published program's departures one by one."""

import numpy as np
import pytest

from ddpc_controllers import WKPC, ThinPlate
from ddpc_controllers.published import PublishedWKPC
from ddpc_cosim import ConfigError, DataError, FloatArray, Recording

from .full_problem import FullWKPC
from .loops import (
    ANGLE,
    LinearPlant,
    Run,
    before,
    close_loop,
    experiment,
    make_loop,
    paper_reference,
    pendulum_experiment,
    pendulum_loop,
    printed_wkpc,
    quick_pendulum,
)


def run(controller: WKPC, recording: Recording, torque: float = 3.5, seed: int = 0, steps: int = 400) -> Run:
    """Close the paper's loop on the pendulum."""
    loop = pendulum_loop(recording, torque, 170.0, seed)
    return close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), steps)


def lifted(states: FloatArray, centres: FloatArray, power: int = 1) -> FloatArray:
    """Return (x, psi(x)) for every row, (12) written out."""
    rows = []
    for x in states:
        distances = [float(np.linalg.norm(x - c)) for c in centres]
        rows.append([*x, *(d**power * np.log10(d) if d > 0 else 0.0 for d in distances)])
    return np.array(rows)


@pytest.mark.parametrize(("torque", "bounds_active"), [(3.5, False), (2.5, True)])
def test_the_printed_problem_has_the_same_optimum(
    state_recording: Recording, torque: float, bounds_active: bool
) -> None:
    here = run(printed_wkpc(), state_recording, torque, steps=60)
    centres = np.random.default_rng(0).uniform(0.0, 1.0, (10, 2))
    bounds = pendulum_loop(state_recording, torque, 170.0).bounds
    full = FullWKPC(printed_wkpc(), lifted(state_recording.measured, centres), state_recording, bounds)
    states = np.array([sample.measured for sample in here.samples])
    z = lifted(states, centres)
    for k, sample in enumerate(here.samples):
        past = before(z, z[0], k, 2), before(here.u, np.zeros(1), k, 2), before(here.y, here.y[0], k, 2)
        assert np.abs(full.solve(*past, sample.reference).u[0] - here.u[k]).max() < 1e-6
    assert set(here.status) == {"ok"}
    assert (np.abs(here.u).max() == torque) == bounds_active


def test_two_inputs_and_two_outputs() -> None:
    rng = np.random.default_rng(5)
    plant = LinearPlant.random(rng, 3, 2, 2)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (150, 2)), 3, plant.c)
    controller = printed_wkpc(dictionary=ThinPlate(count=3))
    loop = make_loop(recording, 0.5 * np.ones(2), np.full(2, np.inf))
    reference = np.repeat(rng.uniform(-1.0, 1.0, (4, 2)), 10, axis=0)
    here = close_loop(controller, loop, plant.advance, plant.c, reference, steps=25)

    centres = np.random.default_rng(0).uniform(0.0, 1.0, (3, 3))
    full = FullWKPC(controller, lifted(recording.measured, centres), recording, loop.bounds)
    z = lifted(np.array([sample.measured for sample in here.samples]), centres)
    for k, sample in enumerate(here.samples):
        past = before(z, z[0], k, 2), before(here.u, np.zeros(2), k, 2), before(here.y, here.y[0], k, 2)
        assert np.abs(full.solve(*past, sample.reference).u[0] - here.u[k]).max() < 1e-6
    assert set(here.status) == {"ok"}


def test_the_published_program_step_by_step(state_recording: Recording) -> None:
    """The memory of lifted samples kept by hand, with the same stream of centres."""
    here = run(PublishedWKPC(), state_recording, steps=30)
    stream = np.random.default_rng(0)

    def redrawn(state: FloatArray) -> FloatArray:
        return lifted(state[np.newaxis], np.tile(stream.uniform(0.0, 1.0, 2), (10, 1)), power=2)[0]

    memory = [redrawn(state) for state in state_recording.measured]
    bounds = pendulum_loop(state_recording, degrees=170.0).bounds
    states = [sample.measured for sample in here.samples]
    for k, sample in enumerate(here.samples):
        if k > 0:
            memory += [redrawn(states[k - 1]), redrawn(states[k])]
        z = np.array(memory[-200:])
        full = FullWKPC(PublishedWKPC(), z, state_recording, bounds)
        past = z[-2:], before(here.u, np.zeros(1), k, 2), before(here.y, here.y[0], k, 2)
        if k == 1:  # lifted and unlifted data happen to coincide there, their pasts do not: no solution
            assert "no combination of the recorded windows" in here.status[k]
            continue
        assert here.status[k] == "ok"
        assert np.abs(full.solve(*past, sample.reference).u[0] - here.u[k]).max() < 1e-6


def test_the_papers_figure_lies_within_the_spread_of_the_published_program() -> None:
    errors = [run(PublishedWKPC(), pendulum_experiment(seed), seed=seed).absolute_error for seed in range(4)]
    assert min(errors) < 456.3552 < max(errors)


@pytest.mark.parametrize("departure", ["_draw", "_stack", "_shift"])
def test_each_departure_of_the_published_program_has_its_effect(
    state_recording: Recording, departure: str
) -> None:
    printed = {"_draw": WKPC._draw, "_stack": WKPC._stack, "_shift": lambda self, state: None}
    without = type("Without", (PublishedWKPC,), {departure: printed[departure]})
    program, changed = (run(kind(), state_recording, steps=30) for kind in (PublishedWKPC, without))
    assert np.abs(changed.u - program.u).max() > 1e-3


def test_the_centres_come_from_the_loops_generator(state_recording: Recording) -> None:
    first, same, other = (run(printed_wkpc(), state_recording, seed=seed, steps=20).u for seed in (1, 1, 2))
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)


class Squares:
    """A dictionary of one's own."""

    def functions(self, size: int) -> int:
        return size

    def draw(self, size: int, rng: np.random.Generator) -> "Squares":
        return self

    def __call__(self, states: FloatArray) -> FloatArray:
        return np.square(states)


def test_a_dictionary_of_ones_own(state_recording: Recording) -> None:
    controller = printed_wkpc(dictionary=Squares())
    here = run(controller, state_recording, steps=30)
    bounds = pendulum_loop(state_recording, degrees=170.0).bounds
    states = np.array([sample.measured for sample in here.samples])
    recorded, z = (np.hstack([x, x**2]) for x in (state_recording.measured, states))
    full = FullWKPC(controller, recorded, state_recording, bounds)
    for k, sample in enumerate(here.samples):
        past = before(z, z[0], k, 2), before(here.u, np.zeros(1), k, 2), before(here.y, here.y[0], k, 2)
        assert np.abs(full.solve(*past, sample.reference).u[0] - here.u[k]).max() < 1e-6


def test_thin_plates_are_as_printed_and_vanish_at_their_centres() -> None:
    centres = np.random.default_rng(9).uniform(0.0, 1.0, (10, 2))
    lift = ThinPlate().draw(np.zeros((1, 2)), np.random.default_rng(9))
    states = np.array([[0.3, -2.0], [1.0, 0.5], centres[4]])
    assert lift(states) == pytest.approx(lifted(states, centres)[:, 2:], abs=1e-15)
    assert lift(states[2])[4] == 0.0


def test_centres_lie_in_the_box() -> None:
    functions = ThinPlate(count=200, low=-2.0, high=-1.0).draw(np.zeros((1, 3)), np.random.default_rng(0))
    assert ((functions.centres >= -2.0) & (functions.centres <= -1.0)).all()


def test_a_box_upside_down_is_refused() -> None:
    with pytest.raises(ConfigError, match="low = 2 is above high = 1"):
        ThinPlate(low=2.0)


def test_the_redundant_rows_of_a_lift_with_the_state_are_diagnosed(state_recording: Recording) -> None:
    controller = printed_wkpc()
    controller.start(pendulum_loop(state_recording, degrees=170.0))
    figures = controller.diagnostics()
    # The angle is measured and controlled: its two past rows stand there twice.
    assert (figures["data_rank"], figures["data_rows"], figures["data_columns"]) == (36, 38, 194)
    assert figures["pe_order_needed"] == 2 + 5 + 12


def test_data_that_excite_too_little_for_the_lifted_order_are_refused(state_recording: Recording) -> None:
    time = np.arange(200)[:, np.newaxis]
    u = sum(np.sin(f * time) for f in (0.3, 0.8, 1.3, 1.9, 2.4, 2.9))
    poor = Recording(np.asarray(u), state_recording.y, state_recording.measured, 0.1)
    with pytest.raises(DataError, match=r"order 12, needed 19 \(depth 7 \+ lifted order 12\)"):
        printed_wkpc().start(pendulum_loop(poor))
