"""Linear models of FMUs: against the symbolic derivatives of their equations, formulas, and each other."""

import warnings
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import LAG, V, describe, model_fmu, model_library, telling_fmu, write_fmu

from ddpc_cosim import ConfigError, CosimWarning, FMUPlant, FMUStepError, LinearModel
from ddpc_cosim.cli.main import main
from ddpc_cosim.description import DescribedVariable
from ddpc_cosim.fmu.description import FMUDescription
from ddpc_cosim.fmu.linearisation import (
    contradicted,
    directional_derivatives,
    linearisation_faults,
    scalars,
)
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants import (
    Equations,
    PlantModel,
    Variable as PlantVariable,
    cart_pendulum,
    cstr,
    export_fmu,
    pendulum,
    quadruple_tank,
)
from fmu_plants.linear import linearise

PLANTS = {
    "pendulum": (pendulum.MODEL, [1.5]),
    "quadruple_tank": (quadruple_tank.MODEL, [3.2, 2.9]),
    "cart_pendulum": (cart_pendulum.MODEL, [0.4]),
    "cstr": (cstr.MODEL, [301.0]),
}
ONLY_ME = '<ModelExchange modelIdentifier="models"{}/>'
ONLY_CS = '<CoSimulation modelIdentifier="models" canHandleVariableCommunicationStepSize="true"/>'
KINK = PlantModel(
    name="kink",
    states=(PlantVariable("x"),),
    inputs=(PlantVariable("u"),),
    outputs=(PlantVariable("root"),),
    equations=lambda v: Equations({"x": v.u - v.x}, {"root": v.x ** (1 / 2)}),
)


@pytest.fixture(scope="session")
def fmu_of(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Export a plant once for an FMI version."""
    folder = tmp_path_factory.mktemp("plants")

    @cache
    def export(model: PlantModel, version: str = "2.0") -> Path:
        return export_fmu(model, folder / f"{model.name}{version[0]}.fmu", version)

    return export


def open_model(path: Path, outputs: Sequence[str] | None = None, **settings: Any) -> FMUPlant:
    return FMUPlant(path, outputs=outputs, fmi_type="model-exchange", **settings)


def matrices(model: LinearModel) -> tuple[FloatArray, ...]:
    return model.a, model.b, model.c, model.d


def assert_same(actual: Sequence[FloatArray], expected: Sequence[FloatArray], tolerance: float) -> None:
    for mine, other in zip(actual, expected, strict=True):
        assert mine.shape == other.shape
        assert (np.abs(mine - other) <= tolerance * np.maximum(np.abs(other), 1.0)).all()


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", PLANTS)
def test_an_fmu_tells_the_derivatives_of_its_equations(fmu_of: Any, name: str, version: str) -> None:
    """At the initial state, and on the way from there under another input."""
    equations, u = PLANTS[name]
    outputs = [variable.name for variable in equations.outputs]
    with open_model(fmu_of(equations, version), outputs) as plant:
        plant.reset()
        for moved in (False, True):
            if moved:
                plant.step(u, equations.step_size)
            model = plant.linearise()
            differences = plant.linearise(derivatives="differences")
            exact = linearise(equations, model.x_0, model.u_0)
            assert (model.derivatives, differences.derivatives) == ("directional", "differences")
            assert_same(matrices(model), exact, 1e-9)
            assert_same(matrices(differences), exact, 1e-7)
            assert model.u_0.tolist() == (u if moved else [v.start for v in equations.inputs])
    assert model.states == tuple(state.name for state in equations.states)


def test_inputs_at_the_operating_point_may_be_given(fmu_of: Any) -> None:
    with open_model(fmu_of(pendulum.MODEL), ["angular_velocity"]) as plant:
        plant.reset({"angle": 0.3})
        model = plant.linearise([0.7])
    assert (model.x_0.tolist(), model.u_0.tolist(), model.y_0.tolist()) == ([0.3, 0.0], [0.7], [0.0])
    # (22): w' = -g / l sin(angle) - nu / (m l^2) w + u / (m l^2)
    assert model.rate == pytest.approx([0.0, -9.81 / 0.2 * np.sin(0.3) + 0.7 / 0.2], abs=1e-9)
    assert model.a == pytest.approx(np.array([[0.0, 1.0], [-9.81 / 0.2 * np.cos(0.3), -2.0]]), abs=1e-9)


def test_a_run_goes_on_as_if_nothing_had_been_asked(fmu_of: Any) -> None:
    with open_model(fmu_of(pendulum.MODEL)) as asked, open_model(fmu_of(pendulum.MODEL)) as left:
        for plant in (asked, left):
            plant.reset()
            plant.step(np.array([2.0]), 0.1)
        asked.linearise(derivatives="differences")
        for u in (2.0, -1.0):
            assert asked.step(np.array([u]), 0.1).tolist() == left.step(np.array([u]), 0.1).tolist()


@pytest.mark.parametrize("derivatives", ["directional", "differences"])
def test_an_isolated_fmu_gives_the_same_model(fmu_of: Any, derivatives: Any) -> None:
    models = []
    for isolated in (False, True):
        with open_model(fmu_of(pendulum.MODEL), isolated=isolated) as plant:
            plant.reset()
            models.append(matrices(plant.linearise([0.5], derivatives=derivatives)))
    assert_same(models[1], models[0], 0.0)


@pytest.mark.parametrize("version", ["1.0", "2.0", "3.0"])
def test_without_directional_derivatives_differences_do(tmp_path: Path, version: str) -> None:
    """x' = rate (u - x), from FMUs that have nothing but the states' derivatives."""
    path = model_fmu(tmp_path, version, "lag", interfaces=ONLY_ME.format(""))
    with open_model(path, ["x"]) as plant:
        plant.reset({"rate": 3.0})
        model = plant.linearise([2.0])
        with pytest.raises(ConfigError, match=r"lag.\.fmu: the FMU has no directional derivatives"):
            plant.linearise(derivatives="directional")
    assert model.derivatives == "differences"
    assert model.states == (() if version == "1.0" else ("x",))
    expected = (np.array([[v]]) for v in (-3.0, 3.0, 1.0, 0.0))
    assert_same(matrices(model), tuple(expected), 1e-9)


def test_a_library_without_the_function_that_the_description_claims_is_differentiated(tmp_path: Path) -> None:
    claim = ONLY_ME.format(' providesDirectionalDerivative="true"')
    with open_model(model_fmu(tmp_path, "2.0", "lag", interfaces=claim), ["x"]) as plant:
        plant.reset()
        assert plant.linearise().derivatives == "differences"


@pytest.mark.parametrize("isolated", [False, True])
def test_an_output_that_is_a_state_has_a_row_of_the_identity_whatever_the_fmu_tells(
    tmp_path: Path, isolated: bool
) -> None:
    with open_model(telling_fmu(tmp_path, "copy"), isolated=isolated) as plant:
        plant.reset({"rate": 3.0})
        model = plant.linearise([0.5])
        assert (model.derivatives, model.warnings, plant.warnings) == ("directional", (), ())
    assert_same(matrices(model), [np.array([[v]]) for v in (-3.0, 3.0, 1.0, 0.0)], 0.0)


@pytest.mark.parametrize("u", [0.5, 1.0, 0.0, 7.0])  # within the limits, at them, and beyond
@pytest.mark.parametrize("isolated", [False, True])
def test_derivatives_that_contradict_small_changes_are_not_used(
    tmp_path: Path, u: float, isolated: bool
) -> None:
    """An output with a reference of its own that repeats a state: 0 is told, 1 is true."""
    expected = [np.array(rows) for rows in ([[-1.0]], [[1.0]], [[1.0], [1.0]], [[0.0], [0.0]])]
    said = r"tells\.fmu: the FMU's directional derivatives of copy are not those of its values"
    with open_model(telling_fmu(tmp_path), isolated=isolated) as plant:
        plant.reset()
        with pytest.warns(CosimWarning, match=said):
            model = plant.linearise([u])
        assert plant.warnings == model.warnings
        assert "differences were taken" in plant.provenance()["fmu_warnings"]
    assert model.derivatives == "differences"
    assert_same(matrices(model), expected, 1e-9)


@pytest.mark.parametrize(("derivative", "derivatives"), [(1.0, "directional"), (1.01, "differences")])
def test_a_hundredth_is_a_contradiction(tmp_path: Path, derivative: float, derivatives: str) -> None:
    with open_model(telling_fmu(tmp_path, "copy")) as plant, warnings.catch_warnings():
        warnings.simplefilter("ignore", CosimWarning)
        plant.reset({"told": derivative, "rate": 3.0, "x": 0.3})
        model = plant.linearise([0.9])
    assert model.derivatives == derivatives
    assert model.a == pytest.approx(np.array([[-3.0]]), abs=1e-8)


def test_where_no_change_is_possible_the_fmu_is_believed(fmu_of: Any) -> None:
    """A root so near to zero that the FMU fails to its left."""
    with open_model(fmu_of(KINK)) as plant:
        plant.reset({"x": 1e-5})
        with pytest.warns(CosimWarning, match="could not be checked near the point: fmi2GetReal returned"):
            model = plant.linearise()
    assert model.derivatives == "directional"
    assert model.c == pytest.approx(np.array([[0.5 / np.sqrt(1e-5)]]), rel=1e-12)


def test_a_kink_is_no_contradiction() -> None:
    """At 0, the derivative of |x| is what it is to either side, or between; it is not 2."""

    class Around:
        x_0, u_0, rate, y_0 = np.zeros(1), np.zeros(0), np.zeros(1), np.zeros(0)
        scale, low, high = np.ones(1), np.array([-np.inf]), np.array([np.inf])

        def at(self, point: FloatArray) -> FloatArray:
            return np.abs(point)

    around: Any = Around()
    contradictions = [contradicted(around, np.array([[slope]])) for slope in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    assert contradictions == [[0], [], [], [], [0]]


@pytest.mark.parametrize("is_single", [False, True])
def test_rounding_to_single_precision_contradicts_nothing(is_single: bool) -> None:
    """y = 2 u and z = 300 + 2.5 u at 100 values of u; of slopes of 0, that of y is contradicted still."""

    class Around:
        low, high, scale = np.full(1, -np.inf), np.full(1, np.inf), np.ones(1)

        def __init__(self, u: float) -> None:
            self.x_0, self.u_0 = np.zeros(0), np.array([u])

        def at(self, point: FloatArray) -> FloatArray:
            u = float(np.float32(point[0]))
            return np.array([np.float32(2 * u), np.float32(300 + 2.5 * u)], dtype=float)

    around: list[Any] = [Around(u) for u in np.linspace(0.5, 1.5, 100)]
    right = [contradicted(point, np.array([[2.0], [2.5]]), is_single) for point in around]
    assert any(right) != is_single
    if is_single:
        assert all(contradicted(point, np.array([[0.0], [0.0]]), is_single) == [0] for point in around)


def test_any_variable_that_can_be_read_may_be_an_output(fmu_of: Any) -> None:
    """The standard tells no derivatives of variables that are not declared as outputs."""
    with open_model(fmu_of(pendulum.MODEL), ["der(angular_velocity)", "angle"]) as plant:
        plant.reset()
        model = plant.linearise()
    assert model.derivatives == "directional"
    assert model.c == pytest.approx(np.array([[-9.81 / 0.2, -2.0], [1.0, 0.0]]), abs=1e-7)
    assert model.d == pytest.approx(np.array([[5.0], [0.0]]), abs=1e-7)


def test_an_input_at_its_limit_is_changed_to_the_other_side(tmp_path: Path) -> None:
    limited = [V("u", 0, causality="input", start="0", more={"min": "0", "max": "1"}), *LAG[1:]]
    text = describe("2.0", "lag", limited, interfaces=ONLY_ME.format(""))
    path = write_fmu(tmp_path / "limited.fmu", text, model_library("2.0"))
    with open_model(path, ["x"]) as plant:
        plant.reset()
        for u in (0.0, 1.0, 7.0):  # and beyond its limits
            assert plant.linearise([u]).b == pytest.approx(np.array([[1.0]]), abs=1e-9)


def test_elements_of_arrays_are_directions_of_their_own() -> None:
    """z = K v, with v an array of 2 x 2 and a scalar, z an array of 3: FMI 3.0 numbers whole variables."""
    gain = np.arange(15.0).reshape(3, 5) + 1.0

    class Asked:
        def get_directional_derivative(self, unknowns: Any, known: Any, seed: Any, sensitivity: Any) -> None:
            assert list(unknowns) == [7]
            start = {1: 0, 2: 4}[known[0]]
            direction = np.zeros(5)
            direction[start : start + len(seed)] = seed
            sensitivity[:] = (gain @ direction).tolist()

    def array(name: str, reference: int, *shape: int) -> DescribedVariable:
        return DescribedVariable(
            Variable(name), reference, "Float64", "local", "continuous", "", shape, shape
        )

    variables = {v.name: v for v in (array("v", 1, 2, 2), array("w", 2), array("z", 7, 2))}
    description = FMUDescription("3.0", "", "arrays", variables, {})
    grown = {"z": (3,)}  # a structural parameter has made it longer
    unknowns = scalars(description, ["z"], grown)
    knowns = scalars(description, ["v", "w"], grown)
    model: Any = Asked()
    assert [signal.variable.name for signal in unknowns] == ["z[1]", "z[2]", "z[3]"]
    assert directional_derivatives(model, unknowns[::-1], knowns, grown).tolist() == gain[::-1].tolist()


def test_what_is_not_for_model_exchange_is_refused(tmp_path: Path, fmu_of: Any) -> None:
    with FMUPlant(model_fmu(tmp_path, "2.0", "lag", interfaces=ONLY_CS), outputs=["x"]) as plant:
        plant.reset()
        assert not plant.can_linearise
        with pytest.raises(ConfigError, match=r"lag2\.fmu: the FMU is not for Model Exchange"):
            plant.linearise()
    with FMUPlant(fmu_of(pendulum.MODEL)) as plant:
        assert plant.can_linearise
        with pytest.raises(ConfigError, match="linearise before reset"):
            plant.linearise()
        plant.reset()
        with pytest.raises(ConfigError, match='open it with fmi_type = "model-exchange"'):
            plant.linearise()


def test_everything_that_cannot_be_differentiated_is_named(tmp_path: Path) -> None:
    variables = [
        V("u", 0, causality="input", variability="discrete", start="0"),
        V("count", 5, "Integer", variability="discrete"),
    ]
    path = write_fmu(tmp_path / "s.fmu", describe("2.0", "stair", variables), model_library("2.0"))
    with open_model(path, ["count"]) as plant:
        plant.reset()
        with pytest.raises(ConfigError) as caught:
            plant.linearise(derivatives="magic")  # type: ignore[arg-type]
    assert [fault.partition(": ")[2] for fault in caught.value.faults] == [
        "the FMU has no continuous states",
        'the input "u" is discrete',
        'the output "count" is of type Integer, not a real number',
        'derivatives = "magic" is not possible; allowed: auto, directional, differences',
    ]
    assert linearisation_faults(plant.description, [], []) == ["the FMU has no continuous states"]


def test_inputs_of_another_number_are_refused(fmu_of: Any) -> None:
    with open_model(fmu_of(pendulum.MODEL)) as plant:
        plant.reset()
        with pytest.raises(ConfigError, match=r"u has shape \(2,\); needed: 1 numbers"):
            plant.linearise([1.0, 2.0])


@pytest.mark.parametrize("isolated", [False, True])
def test_an_fmu_that_fails_beside_the_point_is_reported(fmu_of: Any, isolated: bool) -> None:
    """The derivative of a square root at zero is infinite; to its left there is no square root."""
    with open_model(fmu_of(KINK), isolated=isolated) as plant:
        plant.reset({"x": 0.0})
        with pytest.raises(
            FMUStepError, match=r"fmi2GetDirectionalDerivative returned error at t = 0 s; .*root"
        ):
            plant.linearise()
        plant.reset({"x": 0.0})
        with pytest.raises(FMUStepError, match=r"kink2\.fmu: fmi2GetReal returned"):
            plant.linearise(derivatives="differences")
        plant.reset({"x": 4.0})
        assert plant.linearise().c == pytest.approx(np.array([[0.25]]), abs=1e-12)


def test_a_derivative_that_is_not_finite_is_named(tmp_path: Path) -> None:
    with open_model(model_fmu(tmp_path, "2.0", "lag"), ["x"]) as plant:
        plant.reset({"x": 1e308, "rate": 10.0})
        with pytest.raises(FMUStepError, match="the derivative of x by x is nan; choose another operating"):
            plant.linearise()


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_inspect_says_that_an_fmu_gives_derivatives(
    fmu_of: Any, version: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["inspect", str(fmu_of(pendulum.MODEL, version))])
    assert capsys.readouterr().out.count("give derivatives") == 2
