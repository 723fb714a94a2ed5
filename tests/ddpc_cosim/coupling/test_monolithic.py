"""Model Exchange FMUs that are one differential equation: exact solutions, with and without events."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import (
    BALL,
    CO_SIMULATION,
    LAG,
    RELAY,
    STAIR,
    Fault,
    V,
    describe,
    model_library,
    with_time,
    write_fmu,
)
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ddpc_cosim import ConfigError, Connection, CoupledPlant, FMUPlant, FMUStepError, StepStatus
from ddpc_cosim.coupling import monolith
from ddpc_cosim.fmu import integrators
from ddpc_cosim.testing import PlantConformance
from ddpc_cosim.variables import FloatArray
from fmu_plants import Equations, Parameter, PlantModel, Variable

from .conftest import Exported
from .linear import lag
from .oscillator import CUTS, OUTPUTS, exact

EXACT = 1e-6
VERSIONS = ("1.0", "2.0", "3.0")
EVENTFUL = {"lag": LAG, "ball": BALL, "stair": STAIR, "relay": RELAY}
Eventful = Callable[..., FMUPlant]


@pytest.fixture
def eventful(tmp_path: Path) -> Eventful:
    """Open one of the models with events, for Model Exchange only."""

    def opened(model: str, version: str = "2.0", fault: Fault = Fault.NO_FAULT, **options: Any) -> FMUPlant:
        wants_steps = ' needsCompletedIntegratorStep="true"' if version == "3.0" else ""
        interfaces = f'<ModelExchange modelIdentifier="models"{wants_steps}/>'
        token = f"{model}:{int(fault)}" if fault else model
        variables = with_time(version, EVENTFUL[model])
        text = describe(version, token, variables, interfaces=interfaces, indicators=int(model == "ball"))
        path = tmp_path / f"{token.replace(':', '_')}{version[0]}.fmu"
        write_fmu(path, text, model_library(version, complete=True))
        return FMUPlant(path, **options)

    return opened


@pytest.fixture(params=["cvode", "scipy"])
def integrator(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run with CVode, and as on a platform for which FMPy ships none."""
    if request.param == "scipy":
        monkeypatch.setattr(integrators, "has_cvode", lambda: False)
    return str(request.param)


def linear(name: str, a: float, b: float, d: float = 0.0, start: float = 1.0) -> PlantModel:
    """Return x' = a x + b u, y = x + d u."""
    return PlantModel(
        name=name,
        states=(Variable("x", start=start),),
        inputs=(Variable("u"),),
        outputs=(Variable("y"),),
        equations=lambda s: Equations({"x": a * s.x + b * s.u}, {"y": s.x + d * s.u}),
    )


def run(plant: CoupledPlant, inputs: Sequence[FloatArray], h: float) -> FloatArray:
    with plant:
        return np.array([plant.reset(), *(plant.step(np.array(u), h) for u in inputs)])


def monolithic(parts: Mapping[str, Any], links: Sequence[Connection], **options: Any) -> CoupledPlant:
    return CoupledPlant(dict(parts), links, algorithm="monolithic", **options)


# Ordinary differential equations


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_oscillator_in_two_fmus_is_the_whole_one(exported: Exported, cut: str, version: str) -> None:
    models, links = CUTS[cut]
    forces = np.random.default_rng(0).uniform(-5.0, 5.0, 30)
    parts = {n: FMUPlant(exported(m, version)) for n, m in zip(("front", "back"), models, strict=True)}
    plant = monolithic(parts, links, inputs=["front.force"], outputs=OUTPUTS)
    assert plant.provenance()["front.fmi_version"] == f"{version} Model Exchange"
    whole = exact(forces.tolist(), 0.1)
    np.testing.assert_allclose(run(plant, forces[:, None].tolist(), 0.1), whole, rtol=0.0, atol=EXACT)


@pytest.mark.parametrize("isolated", [False, True], ids=["", "one isolated"])
def test_three_linear_fmus_in_a_ring_are_the_matrix_exponential(exported: Exported, isolated: bool) -> None:
    a, b = np.array([-1.0, -0.3, -2.0]), np.array([1.5, 2.0, -0.8])
    parts = {
        n: FMUPlant(exported(linear(n, a[i], b[i])), isolated=isolated and n == "q")
        for i, n in enumerate("pqr")
    }
    links = [
        Connection("p.y", "q.u"),
        Connection("q.y", "r.u"),
        Connection("r.y", "p.u", factor=0.5, offset=1.0),
    ]
    matrix = np.diag([*a, 0.0])
    matrix[0, [2, 3]], matrix[1, 0], matrix[2, 1] = [0.5 * b[0], b[0]], b[1], b[2]
    rows = run(monolithic(parts, links), [[]] * 4, 0.5)
    whole = [(expm(0.5 * k * matrix) @ np.ones(4))[:3] for k in range(5)]
    np.testing.assert_allclose(rows, whole, rtol=0.0, atol=EXACT)


def test_a_stiff_part_and_a_slow_one(exported: Exported) -> None:
    """Rates of 1e5 and 1 per second: explicit steps would have to be of 20 us."""
    parts = {
        "fast": FMUPlant(exported(linear("fast", -1e5, 1e5))),
        "slow": FMUPlant(exported(linear("slow", -1.0, -2.0))),
    }
    links = [Connection("slow.y", "fast.u"), Connection("fast.y", "slow.u")]
    matrix = np.array([[-1e5, 1e5], [-2.0, -1.0]])
    rows = run(monolithic(parts, links), [[]] * 3, 1.0)
    np.testing.assert_allclose(rows, [expm(k * matrix) @ np.ones(2) for k in range(4)], rtol=0.0, atol=EXACT)


@pytest.mark.parametrize("gain", [0.3, -0.9, -4.0, 20.0])
def test_an_algebraic_loop_is_solved_within_the_equation(exported: Exported, gain: float) -> None:
    """y1 = x1 + y2 and y2 = x2 + gain y1 are y = (I - K)^-1 x: x' = (A + B K (I - K)^-1) x."""
    parts = {
        "p": FMUPlant(exported(linear("p", -1.0, 0.5, 1.0))),
        "q": FMUPlant(exported(linear(f"q{abs(gain):g}".replace(".", "_"), -2.0, 0.25, gain))),
    }
    links = [Connection("q.y", "p.u"), Connection("p.y", "q.u")]
    k = np.array([[0.0, 1.0], [gain, 0.0]])
    outputs = np.linalg.inv(np.eye(2) - k)
    crossed = np.array([[0.0, 1.0], [1.0, 0.0]])
    matrix = np.diag([-1.0, -2.0]) + np.diag([0.5, 0.25]) @ crossed @ outputs
    plant = monolithic(parts, links)
    assert plant.loops == (("p.u", "p.y", "q.u", "q.y"),)
    rows = run(plant, [[]] * 3, 0.5)
    whole = np.array([outputs @ expm(0.5 * i * matrix) @ np.ones(2) for i in range(4)])
    np.testing.assert_allclose(rows, whole, rtol=0.0, atol=EXACT * np.abs(whole).max())


ANY = PlantModel(
    name="any",
    states=(Variable("x", start=1.0),),
    inputs=(Variable("u"), Variable("v")),
    outputs=(Variable("y"),),
    parameters=tuple(Parameter(name) for name in "abd"),
    equations=lambda s: Equations({"x": s.a * s.x + s.b * (s.u + s.v)}, {"y": s.x + s.d * (s.u + s.v)}),
)


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1))
def test_random_linear_fmus_are_the_linear_system_that_they_are(exported: Exported, seed: int) -> None:
    """Of x' = a x + b w, y = x + d w and w = G y: x' = (a + b G (I - d G)^-1) x, and y = (I - d G)^-1 x."""
    rng = np.random.default_rng(seed)
    a, b, d = rng.uniform(-3.0, 0.5, 3), rng.uniform(-1.0, 1.0, 3), rng.uniform(-0.8, 0.8, 3)
    gains = rng.uniform(-1.0, 1.0, (3, 3)) * (1.0 - np.eye(3))
    loop = np.eye(3) - np.diag(d) @ gains
    assume(np.linalg.cond(loop) < 20.0)
    whole = np.diag(a) + np.diag(b) @ gains @ np.linalg.inv(loop)
    links = [
        Connection(f"{'pqr'[j]}.y", f"{'pqr'[i]}.{'uv'[k]}", factor=gains[i, j])
        for i in range(3)
        for k, j in enumerate(j for j in range(3) if j != i)
    ]
    parameters = {
        f"{part}.{name}": float(values[i])
        for name, values in (("a", a), ("b", b), ("d", d))
        for i, part in enumerate("pqr")
    }
    parts = {name: FMUPlant(exported(ANY)) for name in "pqr"}
    rows = run(monolithic(parts, links, parameters=parameters), [[]] * 3, 0.4)
    y = np.array([np.linalg.solve(loop, expm(0.4 * k * whole) @ np.ones(3)) for k in range(4)])
    np.testing.assert_allclose(rows, y, rtol=0.0, atol=EXACT * max(1.0, np.abs(y).max()))


def test_parts_without_states_go_from_event_to_event(eventful: Eventful) -> None:
    parts = {"a": eventful("stair"), "b": eventful("stair")}
    link = [Connection("a.count", "b.u")]
    rows = run(monolithic(parts, link, inputs=[], outputs=["a.count", "b.count"]), [[]] * 7, 0.5)
    assert rows.tolist() == [[k // 2, k // 2] for k in range(8)]


def test_units_and_factors_of_connections_are_inside_the_equation(exported: Exported) -> None:
    heater = PlantModel(
        name="heater",
        states=(Variable("t", "degC", start=20.0),),
        inputs=(Variable("power", "kW"),),
        outputs=(Variable("t", "degC", start=20.0),),
        equations=lambda s: Equations({"t": s.power}),
    )
    room = PlantModel(
        name="room",
        states=(Variable("t", "K", start=280.0),),
        inputs=(Variable("air", "K"),),
        outputs=(Variable("t", "K", start=280.0),),
        equations=lambda s: Equations({"t": 2.0 * (s.air - s.t)}),
    )
    parts = {"heater": FMUPlant(exported(heater)), "room": FMUPlant(exported(room))}
    rows = run(monolithic(parts, [Connection("heater.t", "room.air")]), [[3.0]] * 2, 1.0)
    for t, row in enumerate(rows):
        # Of x' = 2 (a + 3 t - x) the solution is a + 3 t - 3/2 + c exp(-2 t).
        air = 293.15 - 1.5
        assert row == pytest.approx(
            [20.0 + 3.0 * t, air + 3.0 * t + (280.0 - air) * np.exp(-2.0 * t)], abs=EXACT
        )


# Events


def bounces(until: float) -> list[float]:
    """Return when a ball dropped from 1 m, which keeps 0.7 of its speed, hits the ground."""
    times, speed = [np.sqrt(2.0 / 9.81)], np.sqrt(2.0 * 9.81)
    while times[-1] < until:
        speed *= 0.7
        times.append(times[-1] + 2.0 * speed / 9.81)
    return times[:-1]


def piecewise(
    matrix: FloatArray, start: FloatArray, times: FloatArray, jumps: Mapping[float, FloatArray]
) -> FloatArray:
    """Return x at times, where x' = A x but for x -> J x at some of them: a product of exponentials."""
    rows, waiting, now, x = [], sorted(jumps), 0.0, start
    for t in times:
        while waiting and waiting[0] <= t:
            x, now = jumps[waiting[0]] @ expm((waiting[0] - now) * matrix) @ x, waiting[0]
            waiting.pop(0)
        rows.append(expm((t - now) * matrix) @ x)
    return np.array(rows)


@pytest.mark.parametrize("version", VERSIONS)
def test_state_events_of_one_part_reach_the_others(eventful: Eventful, version: str, integrator: str) -> None:
    """Two lags in a row follow the height of a ball that bounces."""
    parts = {
        "ball": eventful("ball", version),
        "first": eventful("lag", version),
        "second": eventful("lag", version),
    }
    links = [Connection("ball.h", "first.u"), Connection("first.x", "second.u")]
    matrix = np.zeros((5, 5))
    matrix[0, 1], matrix[1, 4] = 1.0, -9.81
    matrix[2, [0, 2]], matrix[3, [2, 3]] = [1.0, -1.0], [1.0, -1.0]
    jump = np.diag([0.0, -0.7, 1.0, 1.0, 1.0])
    times = np.arange(16) * 0.1
    whole = piecewise(matrix, np.array([1.0, 0.0, 0.0, 0.0, 1.0]), times, dict.fromkeys(bounces(1.5), jump))
    plant = monolithic(parts, links, inputs=[], outputs=["ball.h", "first.x", "second.x"])
    rows = run(plant, [[]] * 15, 0.1)
    np.testing.assert_allclose(
        rows, whole[:, [0, 2, 3]], rtol=0.0, atol=EXACT if integrator == "cvode" else 1e-4
    )


def test_what_an_event_changes_is_passed_on_at_once(eventful: Eventful) -> None:
    """A lag follows the number of bounces: x' = n - x, which jumps where the ball hits the ground."""
    parts = {"ball": eventful("ball", outputs=["bounces"]), "lag": eventful("lag")}
    plant = monolithic(parts, [Connection("ball.bounces", "lag.u")], outputs=["ball.bounces", "lag.x"])
    hits, times = bounces(2.0), np.arange(11) * 0.2
    rows = run(plant, [[0.0]] * 10, 0.2)
    # Each bounce adds a response to a step.
    x = [sum(1.0 - np.exp(hit - t) for hit in hits if hit <= t) for t in times]
    np.testing.assert_allclose(rows[:, 1], x, rtol=0.0, atol=EXACT)
    assert rows[:, 0].tolist() == [sum(hit <= t for hit in hits) for t in times]


@pytest.mark.parametrize("version", VERSIONS)
def test_time_events_of_one_part_reach_the_others(eventful: Eventful, version: str) -> None:
    """The stair counts seconds; the lags follow it; at 10 s it ends the run, after the last outputs."""
    parts = {n: eventful("stair" if n == "stair" else "lag", version) for n in ("second", "stair", "first")}
    links = [Connection("stair.count", "first.u"), Connection("first.x", "second.u")]
    matrix = np.array([[-1.0, 0.0, 1.0, 0.0], [1.0, -1.0, 0.0, 0.0], [0.0] * 4, [0.0] * 4])
    count = np.eye(4)
    count[2, 3] = 1.0
    times = np.arange(41) * 0.25
    whole = piecewise(
        matrix, np.array([0.0, 0.0, 0.0, 1.0]), times, dict.fromkeys(map(float, range(1, 11)), count)
    )
    plant = monolithic(parts, links, inputs=["stair.u"], outputs=["first.x", "second.x", "stair.count"])
    with plant:
        rows = [plant.reset(), *(plant.step(np.zeros(1), 0.25) for _ in range(40))]
        np.testing.assert_allclose(rows, whole[:, :3], rtol=0.0, atol=EXACT)
        with pytest.raises(
            FMUStepError, match=r'part "stair": an event ended the simulation at t = 10 s'
        ) as caught:
            plant.step(np.zeros(1), 0.25)
    assert caught.value.status is StepStatus.TERMINATED


@pytest.mark.parametrize("version", VERSIONS)
def test_step_events_of_one_part_keep_the_others_right(eventful: Eventful, version: str) -> None:
    """After a step that has passed 1 the relay takes 1 from its state, and counts: the sum is the time."""
    parts = {"relay": eventful("relay", version), "lag": eventful("lag", version)}
    with monolithic(
        parts, [Connection("relay.x", "lag.u")], outputs=["relay.x", "relay.count", "lag.x"]
    ) as plant:
        plant.reset()
        for k in range(1, 41):
            x, count, _ = plant.step(np.zeros(1), 0.1)
            assert x + count == pytest.approx(0.1 * k, abs=1e-9)
    assert count >= 2


def test_a_loop_with_events_is_what_another_solver_finds(eventful: Eventful) -> None:
    """The ball is lifted by a lag that follows its height: h'' = 4 x - g, x' = h - x."""
    parts = {"ball": eventful("ball"), "lag": eventful("lag")}
    links = [Connection("ball.h", "lag.u"), Connection("lag.x", "ball.u", factor=4.0)]

    def slope(_: float, s: FloatArray) -> list[float]:
        return [s[1], 4.0 * s[2] - 9.81, s[0] - s[2]]

    def ground(_: float, s: FloatArray) -> float:
        return float(s[0])

    ground.terminal, ground.direction = True, -1.0  # type: ignore[attr-defined]
    rows, now, state, hits = [], 0.0, np.array([1.0, 0.0, 0.0]), 0
    for t in np.arange(1, 16) * 0.1:
        while now < t:
            part = solve_ivp(slope, (now, t), state, method="DOP853", rtol=1e-12, atol=1e-13, events=ground)
            now, state = part.t[-1], part.y[:, -1].copy()
            if part.status == 1:
                state[:2], hits = [1e-300, -0.7 * state[1]], hits + 1
        rows.append(state[[0, 2]])
    assert hits == 2
    plant = monolithic(parts, links, outputs=["ball.h", "lag.x"])
    np.testing.assert_allclose(run(plant, [[]] * 15, 0.1)[1:], rows, rtol=0.0, atol=EXACT)


def test_discrete_inputs_follow_discrete_outputs_at_events(tmp_path: Path, eventful: Eventful) -> None:
    """A lag whose input changes at events only follows the stair's seconds; one that moves is refused."""
    variables = (V("u", 0, causality="input", variability="discrete", start="0"), *LAG[1:])
    interfaces = '<ModelExchange modelIdentifier="models"/>'
    path = tmp_path / "discrete.fmu"
    write_fmu(
        path, describe("2.0", "lag", variables, interfaces=interfaces), model_library("2.0", complete=True)
    )
    parts = {"lag": FMUPlant(path), "stair": eventful("stair")}
    with monolithic(parts, [Connection("stair.count", "lag.u")], outputs=["lag.x"]) as plant:
        plant.reset()
        rows = [float(plant.step(np.zeros(1), 0.5)[0]) for _ in range(7)]
    times = np.arange(1, 8) * 0.5
    x = [sum(1.0 - np.exp(k - t) for k in range(1, 4) if k <= t) for t in times]
    assert rows == pytest.approx(x, abs=EXACT)
    with pytest.raises(ConfigError, match=r'"lag.u" changes at events only, and follows "moves.x", which'):
        monolithic({"lag": FMUPlant(path), "moves": eventful("lag")}, [Connection("moves.x", "lag.u")])


@pytest.mark.parametrize("isolated", [False, True], ids=["", "isolated"])
def test_clocks_tick_with_the_inputs_of_their_instant(
    tmp_path: Path, eventful: Eventful, isolated: bool
) -> None:
    """A sample-and-hold of a lag that goes to 1, every 0.25 s, between the samples of the whole."""
    tick = V(
        "tick",
        14,
        "Clock",
        causality="input",
        variability="discrete",
        more={"intervalVariability": "constant", "intervalDecimal": "0.25"},
    )
    held = V("held", 1, causality="output", variability="discrete")
    interfaces = '<ModelExchange modelIdentifier="models"/>'
    text = describe("3.0", "clocked", with_time("3.0", [LAG[0], held, tick]), interfaces=interfaces)
    path = write_fmu(tmp_path / "hold.fmu", text, model_library("3.0"))
    parts = {"lag": eventful("lag", "3.0"), "hold": FMUPlant(path, isolated=isolated)}
    with monolithic(parts, [Connection("lag.x", "hold.u")], outputs=["hold.held"]) as plant:
        plant.reset()
        rows = [float(plant.step(np.ones(1), 0.1)[0]) for _ in range(10)]
    # A tick at a sample comes with the inputs that begin there.
    ticks = [0.25 * int((k - 1e-6) * 0.1 / 0.25) for k in range(1, 11)]
    assert rows == pytest.approx([1.0 - np.exp(-tick) for tick in ticks], abs=EXACT)


def test_events_that_do_not_settle_are_told(eventful: Eventful, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(monolith, "_MOST_ROUNDS", 1)
    parts = {"a": eventful("lag"), "b": eventful("stair")}
    with (
        monolithic(parts, []) as plant,
        pytest.raises(FMUStepError, match=r'^parts "a", "b": events change the inputs of each other'),
    ):
        plant.reset()


# A plant as any other


def test_parameters_and_inputs_that_rest_change_during_a_run(eventful: Eventful) -> None:
    """Of x' = r (u - x) and y' = 2 x - y, r and u change at t = 1: all as formulas have it."""
    parts = {"first": eventful("lag"), "second": eventful("lag")}
    link = [Connection("first.x", "second.u", factor=2.0)]
    with monolithic(parts, link, inputs=[], outputs=["first.x", "second.x"]) as plant:
        plant.reset({"first.u": 1.0})
        plant.step(np.empty(0), 1.0)
        plant.set_parameters({"first.rate": 3.0, "first.u": -1.5})
        y = plant.step(np.empty(0), 0.5)
    changing = [
        np.array([[-r, 0.0, r * u], [2.0, -1.0, 0.0], [0.0] * 3]) for r, u in ((1.0, 1.0), (3.0, -1.5))
    ]
    state = expm(0.5 * changing[1]) @ expm(changing[0]) @ np.array([0.0, 0.0, 1.0])
    assert y == pytest.approx(state[:2], abs=EXACT)


def test_outputs_at_other_inputs_are_those_of_all_parts(exported: Exported) -> None:
    parts = {
        "p": FMUPlant(exported(linear("p", -1.0, 0.5, 1.0))),
        "q": FMUPlant(exported(linear("s", -1.0, 0.0, 2.0))),
    }
    with monolithic(parts, [Connection("p.y", "q.u")]) as plant:
        plant.reset()
        assert plant.dependencies == {"p.y": {"p.u"}, "q.y": {"p.u"}}
        assert plant.outputs_at(np.array([3.0])) == pytest.approx([4.0, 9.0])
        y = plant.step(np.zeros(1), 1.0)
        assert y == pytest.approx([np.exp(-1.0), 3.0 * np.exp(-1.0)], abs=EXACT)


@pytest.mark.parametrize("isolated", [False, True], ids=["", "isolated"])
def test_a_state_is_that_of_all_parts_and_of_the_whole(exported: Exported, isolated: bool) -> None:
    models, links = CUTS["forces"]
    parts = {
        n: FMUPlant(exported(m), isolated=isolated) for n, m in zip(("front", "back"), models, strict=True)
    }
    forces = np.array([2.0, -1.0, 3.0, 0.0])
    whole = exact(forces.tolist(), 0.1)
    with monolithic(parts, links, inputs=["front.force"], outputs=OUTPUTS) as plant:
        assert plant.can_save_state
        plant.reset()
        plant.step(forces[:1], 0.1)
        state = plant.save_state()
        for _ in range(2):
            for k in range(1, 4):
                assert plant.step(forces[k : k + 1], 0.1) == pytest.approx(whole[k + 1], abs=EXACT)
            plant.restore_state(state)
            assert plant.time == 0.1
        old = plant.save_state()
        plant.reset()
        with pytest.raises(ConfigError, match="not one of this run"):
            plant.restore_state(old)
        assert not plant.can_serialise_state
        with pytest.raises(ConfigError, match=r'monolithic" cannot be saved as bytes; choose "sequential"'):
            plant.serialise_state()


class TestContract(PlantConformance):
    @pytest.fixture
    def make_plant(self, exported: Exported) -> Any:
        models, links = CUTS["forces"]

        def make() -> CoupledPlant:
            parts = {n: FMUPlant(exported(m)) for n, m in zip(("front", "back"), models, strict=True)}
            return monolithic(parts, links, inputs=["front.force"], outputs=OUTPUTS)

        return make


# Faults


@pytest.mark.parametrize(
    ("fault", "words", "status"),
    [
        (Fault.RETURN_ERROR, r"lag_.*fmi2GetDerivatives returned error .*division by zero", StepStatus.ERROR),
        (Fault.RETURN_FATAL, r"lag_.*fmi2GetDerivatives returned fatal", StepStatus.FATAL),
        (Fault.RETURN_DISCARD, r"lag_.*fmi2GetDerivatives returned discard", StepStatus.DISCARD),
        (Fault.RETURN_NAN, r"the derivative of x is nan at t = 0\.5", StepStatus.DISCARD),
        (Fault.ERROR_WHEN_READ, r"lag_.*fmi2GetReal returned error", StepStatus.ERROR),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_a_part_that_fails_ends_the_run_with_its_name(
    eventful: Eventful, fault: Fault, words: str, status: StepStatus
) -> None:
    parts = {"sound": eventful("lag"), "broken": eventful("lag", fault=fault)}
    with monolithic(parts, [Connection("sound.x", "broken.u")]) as plant:
        plant.reset()
        with pytest.raises(FMUStepError, match=rf'^part "broken": {words}') as caught:
            run_on(plant)
        assert caught.value.status is status
        assert caught.value.time == pytest.approx(0.55, abs=0.05 + 1e-9)


@pytest.mark.parametrize(
    ("fault", "options", "status"),
    [
        (Fault.SEGMENTATION_FAULT, {}, StepStatus.CRASHED),
        (Fault.HANG_IN_STEP, {"step_timeout": 1.0}, StepStatus.TIMED_OUT),
    ],
)
def test_a_part_in_another_process_may_crash_or_hang(
    eventful: Eventful, fault: Fault, options: dict[str, Any], status: StepStatus
) -> None:
    parts = {"sound": eventful("lag"), "broken": eventful("lag", fault=fault, isolated=True, **options)}
    with monolithic(parts, [Connection("sound.x", "broken.u")]) as plant:
        plant.reset()
        with pytest.raises(FMUStepError, match=r'^part "broken": lag_') as caught:
            run_on(plant)
        assert caught.value.status is status


def test_events_without_an_end_have_the_name_of_their_part(eventful: Eventful) -> None:
    parts = {"sound": eventful("lag"), "broken": eventful("stair", fault=Fault.EVENTS_WITHOUT_END)}
    with monolithic(parts, [Connection("broken.count", "sound.u")]) as plant:
        plant.reset()
        with pytest.raises(
            FMUStepError, match=r'^part "broken": more than 1000 events at one instant at t = 1 s'
        ):
            run_on(plant, 20)


def test_an_equation_that_cannot_be_integrated_is_told(exported: Exported) -> None:
    """Of x' = x y and y' = x y, with x = y = 1 / (1 - t), there is no value at t = 1."""
    model = PlantModel(
        name="explosion",
        states=(Variable("x", start=1.0),),
        inputs=(Variable("u"),),
        outputs=(Variable("x", start=1.0),),
        equations=lambda s: Equations({"x": s.x * s.u}),
    )
    parts = {n: FMUPlant(exported(model)) for n in "pq"}
    with monolithic(parts, [Connection("p.x", "q.u"), Connection("q.x", "p.u")]) as plant:
        plant.reset()
        with pytest.raises(FMUStepError, match=r'^parts "p", "q": more than 1000 steps of the int') as caught:
            run_on(plant, 20)
        assert caught.value.status is StepStatus.ERROR


def run_on(plant: CoupledPlant, steps: int = 10) -> None:
    for _ in range(steps):
        plant.step(np.zeros(len(plant.inputs)), 0.1)


# What cannot be


def test_parts_that_are_no_differential_equations_are_refused_all_at_once(
    exported: Exported, eventful: Eventful, tmp_path: Path
) -> None:
    only_steps = with_time("2.0", LAG)
    path = write_fmu(
        tmp_path / "steps.fmu",
        describe("2.0", "lag", only_steps, interfaces=CO_SIMULATION),
        model_library("2.0", complete=True),
    )
    parts = {
        "fine": eventful("lag"),
        "python": lag(),
        "steps": FMUPlant(path),
        "chosen": FMUPlant(exported(linear("chosen", -1.0, 1.0)), fmi_type="co-simulation"),
    }
    with pytest.raises(ConfigError) as caught:
        monolithic(parts, [])
    for fault, words in zip(
        caught.value.faults,
        (
            'part "python": it is not an FMU',
            'part "steps": steps.fmu is for Co-Simulation only',
            'part "chosen": chosen.fmu is opened with fmi_type = "co-simulation"',
        ),
        strict=True,
    ):
        assert fault.startswith(f'algorithm = "monolithic": {words}')
        assert "with a communication_step" in fault


def test_options_of_an_exchange_in_steps_are_refused(eventful: Eventful) -> None:
    with pytest.raises(ConfigError) as caught:
        monolithic(
            {"a": eventful("lag")}, [], communication_step=0.1, steps={"a": 0.1}, extrapolation="linear"
        )
    assert [fault.partition(":")[0] for fault in caught.value.faults] == [
        "communication_step",
        "steps",
        "extrapolation",
    ]
