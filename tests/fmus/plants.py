"""Fixtures: plants of very different time scales, gains and responses as FMUs, and FMUs with defects."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from fmu_plants import Equations, Parameter, PlantModel, Symbols, Variable, build_fmu, export_fmu
from fmu_plants.cart_pendulum import MODEL as CART_PENDULUM
from fmu_plants.pendulum import MODEL as PENDULUM

ModelFMU = Callable[[str], Path]
Mutate = Callable[..., Path]


def _two_by_two(v: Symbols) -> Equations:
    """Return a coupled plant whose outputs differ by a factor of a hundred, and do not rest at zero."""
    return Equations(
        {"x1": (-v.x1 + 2 * v.u1 + 0.5 * v.u2) / 3, "x2": (-v.x2 + 0.4 * v.u1 - 30 * v.u2) / 1.5},
        {"y1": v.x1 + 5.0, "y2": v.x2 * 100},
    )


def _tank(v: Symbols) -> Equations:
    from sympy import Max, sqrt

    return Equations({"level": (v.inflow - 2e-3 * sqrt(Max(v.level, 1e-9))) / 1.5})


def _one_sided(v: Symbols) -> Equations:
    from sympy import sqrt

    return Equations({"x": v.inflow - v.x}, {"y": sqrt(v.x)})


def _saturating(v: Symbols) -> Equations:
    from sympy import Max, Min

    return Equations({"x": 10 * v.push - v.x}, {"y": Max(-v.y_max, Min(v.y_max, v.x))})


def _fast_pendulum(v: Symbols) -> Equations:
    from sympy import sin

    acceleration = -1e6 * sin(v.angle) - 400 * v.rate + 1e8 * v.torque
    return Equations({"angle": v.rate, "rate": acceleration})


def _integrator(v: Symbols) -> Equations:
    return Equations({"speed": (v.force - v.speed) / 0.5, "place": v.speed})


LEVEL = Variable("level", "m", min=0.0, max=4.0, start=1.0)
SPEED, PLACE, X = Variable("speed", "m/s"), Variable("place", "m"), Variable("x", "m")
ANGLE, RATE = Variable("angle", "rad"), Variable("rate", "rad/s", nominal=1000.0)
PUSH = Variable("push", "N", min=-2.0, max=2.0)

MODELS = {
    "two_by_two": PlantModel(
        name="two_by_two",
        equations=_two_by_two,
        states=(Variable("x1"), Variable("x2")),
        inputs=(Variable("u1", "V", min=-10.0, max=10.0), Variable("u2", "V", min=0.0, max=1.0, start=0.2)),
        outputs=(Variable("y1", "K"), Variable("y2", "Pa")),
        stop_time=20.0,
    ),
    "slow_tank": PlantModel(
        name="slow_tank",
        equations=_tank,
        states=(LEVEL,),
        inputs=(Variable("inflow", "m3/s", min=0.0, max=4e-3, start=2e-3),),
        outputs=(LEVEL,),
        stop_time=20_000.0,
        step_size=1.0,
    ),
    "fast_pendulum": PlantModel(
        name="fast_pendulum",
        equations=_fast_pendulum,
        states=(ANGLE, RATE),
        inputs=(Variable("torque", "N.m", nominal=2e-3),),
        outputs=(RATE, ANGLE),
        stop_time=0.05,
        step_size=1e-4,
    ),
    "integrator": PlantModel(
        name="integrator",
        equations=_integrator,
        states=(SPEED, PLACE),
        inputs=(Variable("force", "N", min=-2.0, max=2.0),),
        outputs=(PLACE,),
    ),
    "saturating": PlantModel(
        name="saturating",
        equations=_saturating,
        states=(X,),
        inputs=(Variable("push", "N", min=-10.0, max=10.0),),
        outputs=(Variable("y", "m"),),
        parameters=(Parameter("y_max", "m", start=12.0),),
    ),
    "one_sided": PlantModel(
        name="one_sided",
        equations=_one_sided,
        states=(X,),
        inputs=(Variable("inflow", "m3/s", min=-1.0, max=1.0),),
        outputs=(Variable("y", "m"),),
    ),
    "falling": PlantModel(
        name="falling",
        equations=lambda v: Equations({"speed": v.push - 9.81, "place": v.speed}),
        states=(SPEED, PLACE),
        inputs=(Variable("push", "N", min=-1.0, max=1.0),),
        outputs=(PLACE,),
    ),
    "even": PlantModel(
        name="even",
        equations=lambda v: Equations({"x": v.push**2 - v.x}),
        states=(X,),
        inputs=(Variable("push", "N", min=-1.0, max=1.0),),
        outputs=(X,),
    ),
    "pure_integrator": PlantModel(
        name="pure_integrator",
        equations=lambda v: Equations({"x": 3 * v.push}),
        states=(X,),
        inputs=(PUSH,),
        outputs=(X,),
    ),
    "unstable": PlantModel(
        name="unstable",
        equations=lambda v: Equations({"x": 3 * v.x + v.push}),
        states=(X,),
        inputs=(PUSH,),
        outputs=(X,),
    ),
    "cart_pendulum": CART_PENDULUM,
    "static": PlantModel(
        name="static",
        equations=lambda v: Equations({"x": -v.x}, {"y": 4 * v.push}),
        states=(X,),
        inputs=(PUSH,),
        outputs=(Variable("y", "m"),),
    ),
    "deaf": PlantModel(
        name="deaf",
        equations=lambda v: Equations({"x": -v.x}),
        states=(X,),
        inputs=(PUSH,),
        outputs=(X,),
    ),
    "pendulum": PENDULUM,
}


@pytest.fixture(scope="session")
def model_fmu(own_cache_folder: None) -> ModelFMU:
    """Build one of the models as an FMU for FMI 2.0."""
    return lambda name: build_fmu(MODELS[name])


@pytest.fixture(scope="session")
def pendulum_fmi3(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu(PENDULUM, tmp_path_factory.mktemp("fmi3") / "pendulum.fmu", "3.0")


@pytest.fixture
def mutate(tmp_path: Path) -> Mutate:
    """Copy an FMU with its description changed, and its entries renamed or (to None) left out."""

    def changed(
        fmu: Path, *replacements: tuple[str, str], renamed: dict[str, str | None] | None = None
    ) -> Path:
        path = tmp_path / f"mutated-{fmu.name}"
        with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(path, "w") as target:
            for name in source.namelist():
                content, new_name = source.read(name), (renamed or {}).get(name, name)
                if name == "modelDescription.xml":
                    text = content.decode("utf-8")
                    for old, new in replacements:
                        assert old in text, f"nothing to replace: {old}"
                        text = text.replace(old, new)
                    content = text.encode("utf-8")
                if new_name is not None:
                    target.writestr(new_name, content)
        return path

    return changed
