"""Several plants as one: names, units, sizes, steps, states, and what happens when a part fails."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import Fault
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm

from ddpc_cosim import ConfigError, Connection, CoupledPlant, FMUPlant, FMUStepError, Plant, StepStatus
from ddpc_cosim.testing import PlantConformance
from ddpc_cosim.variables import FloatArray, Variable

from .conftest import Exported
from .linear import LinearPlant, gain, lag
from .oscillator import BACK, DISPLACEMENTS, FRONT, OUTPUTS, exact

CHAIN = [Connection("first.y", "second.u")]


def halves(exported: Exported, **isolated: bool) -> dict[str, Plant]:
    models = {"front": FRONT, "back": BACK}
    return {n: FMUPlant(exported(m), isolated=isolated.get(n, False)) for n, m in models.items()}


def oscillator(parts: dict[str, Plant], **options: Any) -> CoupledPlant:
    return CoupledPlant(parts, DISPLACEMENTS, inputs=["front.force"], outputs=OUTPUTS, **options)


def run(plant: CoupledPlant, forces: list[float], h: float = 0.1) -> FloatArray:
    with plant:
        rows = [plant.reset()]
        rows += [plant.step(np.array([force]), h) for force in forces]
    return np.array(rows)


# Names, units and sizes


def test_signals_of_the_whole_are_named_after_parts() -> None:
    with CoupledPlant({"first": lag(), "second": lag()}, CHAIN) as plant:
        assert [v.name for v in plant.inputs] == ["first.u"]
        assert [v.name for v in plant.outputs] == ["first.y", "second.y"]
        assert plant.order == ("first", "second")


def test_parts_stand_in_the_order_in_which_they_follow_each_other() -> None:
    parts = {"second": lag(), "first": lag()}
    assert CoupledPlant(parts, CHAIN).order == ("first", "second")


def test_connectors_of_the_system_have_names_and_units_of_their_own() -> None:
    parts = {"first": gain(2.0, inputs=[Variable("u", "K", start=300.0)]), "second": lag()}
    links = [*CHAIN, Connection("room", "first.u"), Connection("second.y", "level", factor=10.0, offset=1.0)]
    plant = CoupledPlant(parts, links, outputs=["level"], connectors=[Variable("room", "degC", start=20.0)])
    with plant:
        assert plant.inputs == (Variable("room", "degC", start=20.0),)
        assert plant.reset() == [1.0]
        plant.step(np.array([0.0]), 1.0)
        assert plant.outputs_at(np.array([0.0])) == pytest.approx(
            [1.0 + 10.0 * 2.0 * 273.15 * (1 - math.exp(-1))]
        )


def test_units_are_converted_before_factor_and_offset() -> None:
    parts = {
        "first": gain(1.0, outputs=[Variable("y", "bar")]),
        "second": gain(1.0, inputs=[Variable("u", "Pa")]),
    }
    with CoupledPlant(parts, [Connection("first.y", "second.u", factor=2.0, offset=5.0)]) as plant:
        plant.reset()
        assert plant.step(np.array([3.0]), 1.0) == pytest.approx([3.0, 600_005.0])


def test_arrays_are_connected_whole() -> None:
    def three(name: str) -> list[str | Variable]:
        return [f"{name}[{i}]" for i in (1, 2, 3)]

    parts = {
        "first": LinearPlant(d=np.diag([1.0, 2.0, 3.0]), inputs=three("u"), outputs=three("y")),
        "second": LinearPlant(d=[[1.0, 1.0, 1.0]], inputs=three("u")),
    }
    with CoupledPlant(parts, CHAIN) as plant:
        plant.reset()
        assert plant.step(np.ones(3), 1.0) == pytest.approx([1.0, 2.0, 3.0, 6.0])


FAULTS = {
    r'from "first.y" to "second.p": "first.y" is in m, "second.p" in Pa, units of': "first.y>second.p",
    r'no part "frist"; did you mean "first"': "frist.y>second.u",
    r'second has no input "uu"; did you mean "u"': "first.y>second.uu",
    r'"second.u" is an input, not an output; there are: y': "second.u>first.u",
    r"different sizes: a number and an array up to \[2\]": "second.y>second.w",
    r'"second.u" already follows "first.y"': "first.y>second.u first.x>second.u",
    r'the connector "c" is an input and an output at once': "c>second.u first.y>c",
}


@pytest.mark.parametrize(("message", "links"), FAULTS.items(), ids=FAULTS.values())
def test_a_connection_that_cannot_be_is_refused_with_both_ends(message: str, links: str) -> None:
    inputs: list[str | Variable] = ["u", Variable("p", "Pa"), "w[1]", "w[2]"]
    parts = {
        "first": LinearPlant(outputs=[Variable("y", "m"), "x"]),
        "second": LinearPlant(inputs=inputs),
    }
    ends = [link.split(">") for link in links.split()]
    with pytest.raises(ConfigError, match=message) as error:
        CoupledPlant(parts, [Connection(source, target) for source, target in ends])
    assert all(end in str(error.value) for end in ends[-1])


def test_all_faults_are_told_at_once() -> None:
    links = [Connection("first.z", "second.u"), Connection("first.y", "third.u")]
    with pytest.raises(ConfigError) as error:
        CoupledPlant({"first": lag(), "second": lag()}, links)
    assert len(error.value.faults) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"algorithm": "serial"}, 'algorithm = "serial" is not possible; allowed: sequential, parallel'),
        ({"extrapolation": "cubic"}, 'extrapolation = "cubic" is not possible; allowed: hold, linear'),
        ({"communication_step": -1.0}, "communication_step = -1.0 is not possible"),
        ({"steps": {"thrid": 0.1}}, 'steps: no part "thrid"'),
        ({"inputs": ["second.u"]}, 'input "second.u" follows "first.y"'),
        ({"outputs": ["first.w"]}, 'output "first.w" is no output of the system'),
        ({"outputs": [1]}, r"outputs = \[1\] is not possible; needed: a list of names"),
        ({"error_tolerance": 1e-3, "steps": {"first": 0.1}}, "it chooses the steps"),
    ],
)
def test_an_option_that_cannot_be_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CoupledPlant({"first": lag(), "second": lag()}, CHAIN, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"communication_step": 0.03},
            "communication_step = 0.03 s does not divide the sampling time of 0.1 s",
        ),
        ({"steps": {"first": 0.07}}, r'steps\["first"\] = 0.07 s fits neither'),
    ],
)
def test_steps_divide_the_sampling_time(options: dict[str, Any], message: str) -> None:
    plant = CoupledPlant({"first": lag(), "second": lag()}, CHAIN, **options)
    with pytest.raises(ConfigError, match=message):
        plant.plan(0.1, 1.0)


def test_parameters_go_to_their_part_and_inputs_that_rest_are_parameters_too() -> None:
    parts = {"first": lag(), "second": gain(1.0)}
    with CoupledPlant(parts, [], inputs=["first.u"]) as plant:
        assert plant.reset({"first.k": 2.0, "second.u": 5.0})[1] == 5.0
        assert parts["first"].parameters == {"k": 2.0}
        plant.set_parameters({"first.k": 3.0, "second.u": 6.0})
        assert parts["first"].parameters == {"k": 3.0}
        assert plant.step(np.array([0.0]), 0.1)[1] == 6.0
        with pytest.raises(
            ConfigError, match=r'no parameter "third.k": its part must be one of first, second'
        ):
            plant.set_parameters({"third.k": 1.0})


def test_others_see_at_once_what_a_parameter_changes() -> None:
    class Tuned(LinearPlant):
        def outputs_at(self, u: FloatArray) -> FloatArray:
            return np.array([float(self.parameters.get("k", 1.0))])

        def step(self, u: FloatArray, h: float) -> FloatArray:
            return self.outputs_at(u)

    parts = {"first": Tuned(inputs=[]), "second": lag()}
    with CoupledPlant(parts, CHAIN, algorithm="parallel") as plant:
        plant.reset()
        plant.set_parameters({"first.k": 2.0})
        assert plant.step(np.empty(0), 0.1)[1] == pytest.approx(2.0 * (1.0 - math.exp(-0.1)))


def test_a_dependency_on_what_is_no_input_is_refused() -> None:
    part = gain(1.0)
    part.dependencies = {"y": frozenset({"v"}), "z": frozenset()}
    with pytest.raises(ConfigError) as error:
        CoupledPlant({"first": part}, [])
    assert error.value.faults == (
        'part "first": dependencies: no input "v"; there are: u',
        'part "first": dependencies: no output "z"; there are: y',
    )


# Time


def test_instants_are_exact(exported: Exported) -> None:
    parts = halves(exported)
    with oscillator(parts, communication_step=0.1 / 3) as plant:
        plant.reset(t0=0.5)
        for _ in range(100):
            plant.step(np.zeros(1), 0.1)
        assert plant.time == 0.5 + 100 * 0.1
        assert parts["front"].time == pytest.approx(plant.time, rel=1e-15)  # type: ignore[attr-defined]


@pytest.mark.parametrize("algorithm", ["sequential", "parallel"])
@pytest.mark.parametrize(("extrapolation", "order"), [("hold", 1), ("linear", 2)])
@pytest.mark.parametrize("ratio", [4, 0.25])
def test_a_part_with_steps_of_its_own_keeps_the_order(
    algorithm: Any, extrapolation: Any, order: int, ratio: float
) -> None:
    errors = []
    for intervals in (16, 32, 64):
        step = 0.1 / intervals
        plant = oscillator(
            python_halves(),
            algorithm=algorithm,
            extrapolation=extrapolation,
            communication_step=step,
            steps={"back": step * ratio},
        )
        errors.append(np.abs(run(plant, [1.0] * 10) - exact([1.0] * 10, 0.1)).max())
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(order, abs=0.25)


def python_halves() -> dict[str, Plant]:
    """Return the halves of the oscillator as matrices."""
    from .oscillator import K1, K2, M1, M2, D, K

    front = LinearPlant(
        [[0, 1], [-(K1 + K) / M1, -D / M1]],
        [[0, 0, 0], [1 / M1, K / M1, D / M1]],
        np.eye(2),
        x0=[1.0, 0.0],
        inputs=["force", "other_x", "other_v"],
        outputs=["x", "v"],
    )
    back = LinearPlant(
        [[0, 1], [-(K2 + K) / M2, -D / M2]],
        [[0, 0], [K / M2, D / M2]],
        np.eye(2),
        x0=[0.0, 0.0],
        inputs=["other_x", "other_v"],
        outputs=["x", "v"],
    )
    return {"front": front, "back": back}


@pytest.mark.parametrize(("extrapolation", "tolerance"), [("hold", 1e-2), ("linear", 1e-5)])
def test_steps_are_repeated_until_the_error_is_kept(extrapolation: Any, tolerance: float) -> None:
    plant = oscillator(python_halves(), extrapolation=extrapolation, error_tolerance=tolerance)
    error = np.abs(run(plant, [1.0] * 10) - exact([1.0] * 10, 0.1)).max()
    assert 0.01 * tolerance < error < 10 * tolerance  # ten samples, each of which may add as much


def test_fmus_repeat_their_steps(exported: Exported) -> None:
    parts = halves(exported)
    plant = oscillator(parts, extrapolation="linear", error_tolerance=1e-4)
    error = np.abs(run(plant, [1.0] * 10) - exact([1.0] * 10, 0.1)).max()
    assert error < 1e-3


def test_a_part_that_cannot_save_its_state_keeps_steps_from_being_repeated() -> None:
    class Forgetful(LinearPlant):
        can_save_state = False

    with pytest.raises(ConfigError, match='part "first" cannot save its state'):
        CoupledPlant({"first": Forgetful(), "second": lag()}, CHAIN, error_tolerance=1e-3)


def test_a_jump_that_no_step_is_short_enough_for() -> None:
    class Jumping(LinearPlant):
        def step(self, u: FloatArray, h: float) -> FloatArray:
            return np.array([1.0 / h])

    parts = {"first": Jumping(), "second": lag()}
    plant = CoupledPlant(parts, CHAIN, error_tolerance=1e-3)
    plant.reset()
    with pytest.raises(FMUStepError, match=r"are too long for an error_tolerance of 0.001 at t = 0 s"):
        plant.step(np.zeros(1), 0.1)


# States


@pytest.mark.parametrize("extrapolation", ["hold", "linear"])
@pytest.mark.parametrize("isolated", [False, True])
def test_a_saved_state_is_the_whole_one(exported: Exported, extrapolation: Any, isolated: bool) -> None:
    parts = halves(exported, back=isolated)
    with oscillator(parts, extrapolation=extrapolation, communication_step=0.05) as plant:
        assert plant.can_save_state
        plant.reset()
        plant.step(np.ones(1), 0.1)
        state, rows = plant.save_state(), []
        for _ in range(2):
            plant.restore_state(state)
            rows.append([plant.step(np.array([2.0]), 0.1) for _ in range(3)])
            assert plant.time == pytest.approx(0.4)
        assert np.array_equal(rows[0], rows[1])


def test_coupled_plants_can_be_parts() -> None:
    inner = CoupledPlant({"a": gain(2.0), "b": gain(3.0)}, [Connection("a.y", "b.u")], outputs=["b.y"])
    links = [Connection("inner.b.y", "lag.u"), Connection("set", "inner.a.u")]
    with CoupledPlant({"inner": inner, "lag": lag()}, links) as plant:
        assert plant.dependencies["inner.b.y"] == {"set"}
        plant.reset()
        y = plant.step(np.ones(1), 0.3)
        assert y == pytest.approx([6.0, 6.0 * (1 - math.exp(-0.3))])


@pytest.mark.parametrize(
    "options",
    [{"algorithm": "parallel"}, {"extrapolation": "linear"}, {"error_tolerance": 1e-2}],
    ids=["parallel", "linear", "controlled"],
)
class TestContract(PlantConformance):
    tolerance = 0.1  # steps of another size exchange at other instants

    @pytest.fixture
    def make_plant(self, options: dict[str, Any]) -> Any:
        step = {} if "error_tolerance" in options else {"communication_step": 0.1 / 16}
        return lambda: oscillator(python_halves(), **step, **options)


# Laws


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["sequential", "parallel"]))
def test_random_linear_parts_become_the_linear_system_that_they_are(seed: int, algorithm: Any) -> None:
    """Without feedthrough: x' = (A + B L C) x + B_u u, for short communication steps."""
    rng = np.random.default_rng(seed)
    parts: dict[str, LinearPlant] = {}
    for name in "abc":
        a = rng.normal(size=(2, 2)) - 2.0 * np.eye(2)
        parts[name] = LinearPlant(
            a, rng.normal(size=(2, 3)), rng.normal(size=(1, 2)), x0=rng.normal(size=2), inputs=["u", "v", "w"]
        )
    gains = rng.normal(size=(3, 3))
    links = [
        Connection(f"{source}.y", f"{target}.{'vw'[k]}", factor=gains[i, j])
        for i, target in enumerate("abc")
        for k, (j, source) in enumerate((j, s) for j, s in enumerate("abc") if s != target)
    ]
    whole = np.zeros((9, 9))
    for i, target in enumerate("abc"):
        matrices = parts[target].matrices
        whole[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += matrices[0]
        whole[2 * i : 2 * i + 2, 6 + i] = matrices[1][:, 0]
        for k, j in enumerate(j for j in range(3) if j != i):
            c = parts["abc"[j]].matrices[2]
            whole[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] += gains[i, j] * np.outer(matrices[1][:, 1 + k], c)
    start = np.concatenate([*(parts[n].x0 for n in "abc"), [1.0, -1.0, 0.5]])
    end = expm(0.2 * whole) @ start
    y = np.array([parts[n].matrices[2] @ end[2 * i : 2 * i + 2] for i, n in enumerate("abc")]).ravel()
    errors = []
    for intervals in (32, 64):
        plant = CoupledPlant(
            parts,
            links,
            inputs=["a.u", "b.u", "c.u"],
            algorithm=algorithm,
            extrapolation="linear",
            communication_step=0.2 / intervals,
        )
        plant.reset()
        errors.append(np.abs(plant.step(np.array([1.0, -1.0, 0.5]), 0.2) - y).max())
    assert errors[1] < 1e-2 * max(1.0, np.abs(y).max())
    assert errors[1] < 0.5 * errors[0] + 1e-6


# Faults


def until_it_fails(plant: CoupledPlant) -> None:
    for _ in range(100):
        plant.step(np.zeros(len(plant.inputs)), 0.1)


@pytest.mark.parametrize(
    ("fault", "status"),
    [
        (Fault.RETURN_ERROR, StepStatus.ERROR),
        (Fault.RETURN_FATAL, StepStatus.FATAL),
        (Fault.RETURN_DISCARD, StepStatus.DISCARD),
        (Fault.DISCARD_AND_TERMINATE, StepStatus.TERMINATED),
    ],
)
def test_a_part_that_fails_ends_the_run_with_its_name(
    make_fmu: Any, fault: Fault, status: StepStatus
) -> None:
    parts = {"sound": lag(), "broken": FMUPlant(make_fmu(fault))}
    with CoupledPlant(parts, []) as plant:
        plant.reset()
        with pytest.raises(FMUStepError, match='part "broken": ') as error:
            until_it_fails(plant)
    assert error.value.status is status


@pytest.mark.parametrize("answer", [1.0, np.zeros((2, 1)), [1.0], "y", None, [1j, 0.0]], ids=repr)
@pytest.mark.parametrize("algorithm", ["sequential", "parallel"])
@pytest.mark.parametrize("extrapolation", ["hold", "linear"])
def test_what_is_no_output_is_not_taken_for_one(answer: Any, algorithm: Any, extrapolation: Any) -> None:
    class Odd(LinearPlant):
        def step(self, u: FloatArray, h: float) -> FloatArray:
            return answer  # type: ignore[no-any-return]

    plant = CoupledPlant(
        {"fine": lag(), "odd": Odd(outputs=["y", "z"])}, [], algorithm=algorithm, extrapolation=extrapolation
    )
    plant.reset()
    with pytest.raises(FMUStepError, match=r'part "odd": Odd.step r') as error:
        plant.step(np.zeros(2), 0.1)
    assert error.value.status is StepStatus.CRASHED


def test_a_part_in_another_process_may_crash(make_fmu: Any) -> None:
    parts = {"sound": lag(), "broken": FMUPlant(make_fmu(Fault.SEGMENTATION_FAULT), isolated=True)}
    with CoupledPlant(parts, []) as plant:
        plant.reset()
        with pytest.raises(FMUStepError, match='part "broken": ') as error:
            until_it_fails(plant)
        assert error.value.status is StepStatus.CRASHED


def test_all_parts_are_closed_also_if_one_raises() -> None:
    class Stuck(LinearPlant):
        def close(self) -> None:
            raise RuntimeError("stuck")

    parts = {"first": Stuck(), "second": lag(), "third": Stuck()}
    plant = CoupledPlant(parts, [])
    with pytest.raises(FMUStepError, match=r'part "first": Stuck.close raised RuntimeError: stuck') as error:
        plant.close()
    assert parts["second"].calls == ["close"]
    assert "third" in error.value.__notes__[0]
    with pytest.raises(ConfigError, match="after close"):
        plant.step(np.zeros(3), 0.1)


def test_provenance_names_parts_and_files(exported: Exported) -> None:
    with oscillator(halves(exported)) as plant:
        provenance = plant.provenance()
    assert provenance["coupling"] == "sequential, hold"
    assert provenance["parts"] == "front, back"
    assert Path(provenance["front.fmu"]).name == "front.fmu"
    assert len(provenance["back.fmu_sha256"]) == 64


# States as bytes


@pytest.mark.parametrize(
    "options", [{}, {"extrapolation": "linear"}, {"algorithm": "parallel"}, {"error_tolerance": 1e-4}]
)
def test_another_coupled_plant_goes_on_from_bytes(exported: Exported, options: dict[str, Any]) -> None:
    """Also one whose signals are others: what it has in common goes on."""
    forces = np.sin(np.arange(12.0))[:, np.newaxis]
    with (
        oscillator(halves(exported), **options) as first,
        oscillator(halves(exported, back=True), **options) as second,
        CoupledPlant(halves(exported), DISPLACEMENTS, inputs=[], **options) as third,
    ):
        first.reset()
        last = [first.step(u, 0.1) for u in forces[:5]][-1]
        content = first.serialise_state()
        second.reset()
        np.testing.assert_array_equal(second.deserialise_state(content), last)
        assert second.time == first.time
        third.reset()
        third.deserialise_state(content)
        held = third.step(np.empty(0), 0.1)
        after = [first.step(u, 0.1) for u in forces[5:]]
        np.testing.assert_array_equal([second.step(u, 0.1) for u in forces[5:]], after)
        first.reset()
        first.deserialise_state(content)
        named = dict(zip((v.name for v in third.outputs), held, strict=True))
        resting = first.step(forces[4], 0.1)
        assert [named[v.name] for v in first.outputs] == pytest.approx(resting.tolist(), abs=1e-12)


def test_parts_that_cannot_are_named_and_other_bytes_refused(exported: Exported) -> None:
    with CoupledPlant({"first": lag(), "second": lag()}, CHAIN) as plant:
        assert not plant.can_serialise_state
        with pytest.raises(ConfigError) as caught:
            plant.serialise_state()
        assert [fault[:13] for fault in caught.value.faults] == ['part "first":', 'part "second"']
    with oscillator(halves(exported)) as plant:
        with pytest.raises(ConfigError, match="serialise_state before reset"):
            plant.serialise_state()
        plant.reset()
        for content in (b"", b"[]", b'{"dict": {"_parts": 3}}'):
            with pytest.raises(ConfigError, match="the state of the coupled plant is not one of this plant"):
                plant.deserialise_state(content)
