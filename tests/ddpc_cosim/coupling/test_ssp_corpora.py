"""The systems of public SSP collections, their structures rebuilt of linear parts, against one linear system.

From the test suites and examples of OMSimulator, libcosim, ecos and the Open Simulation Platform: which
output of which part leads to which input, through which nested systems. Every output of a part follows the
sum of its inputs, z' = -a z + b sum(u), y = z, or y = z + d sum(u) where values go through at once; a, b, d
and z(0) come from a parameter set of the archive.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from ddpc_cosim.codec import read
from ddpc_cosim.study.file_format.sections import PlantSection
from ddpc_cosim.study.plants import PlantSpec
from fmu_plants import Equations, PlantModel, Symbols, Variable, tunable

from .ssp_files import binding, component, connection, ssd, ssv, system, write_ssp

INPUTS, OUTPUTS = 13, 12
SAMPLING_TIME, SAMPLES = 0.1, 5

# Elements are named with the numbers of their signals; "in" and "out" are connectors of the system itself.
Wires = dict[str, str]
CORPORA: dict[str, Wires] = {
    "LOC": {"": "System 1 > Control 1; Control 1 > System 1"},
    "ParkerSimPack": {
        "": "interface 1-11 > valve 1-11; valve 1-2 > interface 1-2; in 1 > interface 3; valve 3 > out 1; "
        "interface 12 > out 2"
    },
    "acvs": {
        "": "fuel 1-4 > valve 1-4; valve 1-2 > fuel 1-2; atmos 1-2 > ecs_hw 1-2; atmos 1-2 > consumer 1-2; "
        "atmos 1-2 > fuel 3-4; ecs_hw 1 > adaption 1; adaption 1-2 > ecs_sw 1-2; ecs_sw 1 > ecs_hw 3; "
        "consumer 1-5 > ecs_hw 4-8; ecs_hw 2-3 > consumer 3-4; fuel 5-9 > consumer 5-9; "
        "consumer 6-7 > fuel 5-6; ecs_hw 4-8 > fuel 7-11; fuel 10-11 > ecs_hw 9-10",
        "valve": "interface 1-7 > model 1-7; model 1-2 > interface 1-2; interface 3-4 > out 1-2; "
        "in 4 > interface 3; in 1 > model 8; in 1 > model 9; in 2-3 > model 10-11; model 3 > out 3",
    },
    "dcmotor": {
        "": "SuT 1-2 > out 1-2; stimuli 1 > out 3; SuT 3 > out 4; stimuli 2 > SuT 1; stimuli 1 > SuT 2; "
        "stimuli 2 > out 5",
        "SuT": "mass 1 > out 2; in 1 > mass 1; mass 2 > out 4; in 2 > machine 1; machine 1 > out 1; "
        "machine 2 > out 3; machine 1 > mass 2; mass 3-4 > machine 2-3",
    },
    "embrace": {
        "": "Consumer 1-10 > ECS_HW 1-10; ECS_HW 1-4 > Consumer 1-4; ECS_HW 5 > AdaptionUnit 1; "
        "AdaptionUnit 1-2 > ECS_SW 1-2; ECS_SW 1 > ECS_HW 11; Atmos 1-2 > Consumer 5-6; "
        "Atmos 1-2 > ECS_HW 12-13"
    },
    "import_export_parameters": {"": "in 1 > addP 1; addP 1 > out 1; P 1 > out 2; addI 1 > out 3"},
    "pwmtest": {"": "pulse 1 > SCSystem 1", "SCSystem": "in 1 > circuit 1"},
    "replaceSubmodel": {"": "A 1-2 > B 1-2"},
    "dp-ship": {
        "": "Thrust Allocation 1-3 > Ship 1-3; Observer 1-6 > DP Controller 1-6; Ship 1-3 > Observer 1-3; "
        "DP Controller 1-3 > Thrust Allocation 1-3; Thrust Allocation 4-6 > Observer 4-6; "
        "Thrust Allocation 7-8 > Ship 4-5; Reference Generator 1-6 > DP Controller 7-12"
    },
    "quarter-truck": {"": "chassis 1 > wheel 1; wheel 1 > chassis 1; wheel 2 > ground 1; ground 1 > wheel 2"},
    "crane": {"": "Controller 1-3 > Crane 1-3; Crane 1-6 > Controller 1-6"},
    "house": {
        "": "OuterWall1 1 > Room1 1; InnerWall 1 > Room1 2; Controller 1 > Room1 3; Room1 1 > OuterWall1 1; "
        "InnerWall 1 > Room2 1; OuterWall2 1 > Room2 2; Controller 2 > Room2 3; Room2 1 > Controller 1; "
        "Room1 1 > Controller 2; Clock 1 > Controller 3; Room1 1 > InnerWall 1; Room2 1 > InnerWall 2; "
        "Room2 1 > OuterWall2 1"
    },
    "linear_transformation": {"": "identity1 1 > identity2 1"},
}
# Where values go through at once, in circles too: forces of dampers, controllers without delay.
DIRECT = {"chassis", "wheel", "Controller", "DP Controller", "machine", "mass", "identity1", "identity2"}


def _equations(is_direct: bool) -> Any:
    def equations(v: Symbols) -> Equations:
        total = sum(v[f"u{i}"] for i in range(1, INPUTS + 1))
        rates = {f"z{j}": -v[f"a{j}"] * v[f"z{j}"] + v[f"b{j}"] * total for j in range(1, OUTPUTS + 1)}
        through = v.d * total if is_direct else 0
        return Equations(rates, {f"y{j}": v[f"z{j}"] + through for j in range(1, OUTPUTS + 1)})

    return equations


def _block(name: str, is_direct: bool) -> PlantModel:
    numbers = range(1, OUTPUTS + 1)
    return PlantModel(
        name=name,
        states=tuple(Variable(f"z{j}") for j in numbers),
        inputs=tuple(Variable(f"u{i}") for i in range(1, INPUTS + 1)),
        outputs=tuple(Variable(f"y{j}") for j in numbers),
        parameters=(
            *(tunable(f"{kind}{j}", start=1.0) for kind in "ab" for j in numbers),
            *([tunable("d")] if is_direct else []),
        ),
        equations=_equations(is_direct),
    )


STRICT, THROUGH = _block("strict", False), _block("through", True)


class Wired:
    """A structure: its parts by path, and the wires within each system."""

    def __init__(self, structure: Wires) -> None:
        self.wires = {name: list(_wires(text)) for name, text in structure.items()}
        self.parts = [path for name in structure for path in self.parts_of(name)]

    def elements(self, name: str) -> list[str]:
        ends = (end for wire in self.wires[name] for end in (wire[0][0], wire[1][0]))
        return [end for end in dict.fromkeys(ends) if end not in ("in", "out")]

    def parts_of(self, name: str) -> Iterator[str]:
        for element in self.elements(name):
            if element not in self.wires:
                yield f"{name}/{element}".lstrip("/")

    def description(self, parameters: dict[str, float]) -> str:
        outer = self._system("", binding(ssv({k.replace("/", "."): v for k, v in parameters.items()})))
        return ssd(outer, "2.0")

    def _system(self, name: str, bindings: str = "") -> str:
        used = {end for wire in self.wires[name] for end in wire}
        connectors = [f"input in{n}" for end, n in used if end == "in"] + [
            f"output out{n}" for end, n in used if end == "out"
        ]
        elements = [
            self._system(element) if element in self.wires else self._component(element)
            for element in self.elements(name)
        ]
        wires = "".join(
            connection(self._end(start, "y", "out"), self._end(end, "u", "in"))
            for start, end in self.wires[name]
        )
        return system(
            name or "root", *elements, connections=wires, connectors=",".join(connectors), bindings=bindings
        )

    @staticmethod
    def _component(name: str) -> str:
        connectors = [f"input u{i}" for i in range(1, INPUTS + 1)] + [
            f"output y{j}" for j in range(1, OUTPUTS + 1)
        ]
        source = "through" if name in DIRECT else "strict"
        return component(name, f"resources/{source}.fmu", ",".join(connectors))

    def _end(self, end: tuple[str, int], of_part: str, of_system: str) -> str:
        name, n = end
        if name in ("in", "out"):
            return f"{name}{n}"
        return f"{name}/{of_system if name in self.wires else of_part}{n}"

    def source(self, part: str, i: int) -> tuple[str, int] | None:
        """Return the output of a part, or the outer input, that an input of a part follows."""
        name, _, last = part.rpartition("/")
        return self._before(name, (last, i))

    def _before(self, name: str, end: tuple[str, int]) -> tuple[str, int] | None:
        start = next((start for start, target in self.wires[name] if target == end), None)
        if start is None or (start[0] == "in" and not name):
            return start
        if start[0] == "in":
            return self._before("", (name, start[1]))
        if start[0] in self.wires:
            return self._before(start[0], ("out", start[1]))
        return (f"{name}/{start[0]}".lstrip("/"), start[1])


def _wires(text: str) -> Iterator[tuple[tuple[str, int], tuple[str, int]]]:
    for wire in text.split(";"):
        ends = [re.fullmatch(r"(.+) (\d+)(?:-(\d+))?", end.strip()) for end in wire.split(">")]
        start, target = ([(m[1], n) for n in range(int(m[2]), int(m[3] or m[2]) + 1)] for m in ends if m)
        yield from zip(start, target, strict=True)


def whole(wired: Wired, values: dict[str, float]) -> np.ndarray[Any, Any]:
    """Return all parts' outputs at the samples, shape (SAMPLES + 1, parts x OUTPUTS)."""
    parts = wired.parts
    n, m = len(parts) * OUTPUTS, len(parts) * INPUTS
    follow, fixed = np.zeros((m, n)), np.zeros(m)
    for p, part in enumerate(parts):
        for i in range(1, INPUTS + 1):
            source = wired.source(part, i)
            if source is not None and source[0] == "in":
                fixed[p * INPUTS + i - 1] = values[f"in{source[1]}"]
            elif source is not None:
                follow[p * INPUTS + i - 1, parts.index(source[0]) * OUTPUTS + source[1] - 1] = 1.0
    each = np.kron(np.eye(len(parts)), np.ones((OUTPUTS, INPUTS)))

    def of(kind: str) -> np.ndarray[Any, Any]:
        return np.array(
            [values.get(f"{part}.{kind}{j}", 0.0) for part in parts for j in range(1, OUTPUTS + 1)]
        )

    d = np.repeat([values.get(f"{part}.d", 0.0) for part in parts], OUTPUTS)
    # y = z + d each (follow y + fixed), z' = -a z + b each (follow y + fixed)
    solved = np.linalg.inv(np.eye(n) - d[:, None] * (each @ follow))
    offset = solved @ (d * (each @ fixed))
    gain = of("b")[:, None] * each
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n] = -np.diag(of("a")) + gain @ follow @ solved
    augmented[:n, n] = gain @ (follow @ offset + fixed)
    step, z = expm(SAMPLING_TIME * augmented), [np.append(of("z"), 1.0)]
    for _ in range(SAMPLES):
        z.append(step @ z[-1])
    return np.array(z)[:, :n] @ solved.T + offset


@pytest.mark.parametrize("name", CORPORA)
def test_a_system_of_a_public_collection_is_the_monolithic_one(name: str, tmp_path: Path) -> None:
    wired, rng = Wired(CORPORA[name]), np.random.default_rng(1)
    values = {
        f"{part}.{kind}{j}": round(float(rng.uniform(*limits)), 3)
        for part in wired.parts
        for kind, limits in (("a", (0.5, 2.0)), ("b", (-0.3, 0.3)), ("z", (-1.0, 1.0)))
        for j in range(1, OUTPUTS + 1)
    }
    values |= {f"{part}.d": 0.05 for part in wired.parts if part.rpartition("/")[2] in DIRECT}
    values |= {f"in{n}": 0.5 for (end, n), _ in wired.wires[""] if end == "in"}
    files = {"resources/strict.fmu": STRICT, "resources/through.fmu": THROUGH}
    path = write_ssp(tmp_path / f"{name}.ssp", wired.description(values), files)
    coupling = {"communication_step": 1e-3, "extrapolation": "linear"}
    spec = PlantSpec.of(read(PlantSection, {"ssp": str(path), "coupling": coupling}), tmp_path).built()
    outputs = [f"{part}.y{j}" for part in wired.parts for j in range(1, OUTPUTS + 1)]
    inputs = [name for name in spec.variables().inputs if "." not in name]
    plant = spec.open(inputs, outputs)
    try:
        plant.plan(SAMPLING_TIME, SAMPLES * SAMPLING_TIME)
        rows = [plant.reset()]
        rows += [plant.step(np.full(len(inputs), 0.5), SAMPLING_TIME) for _ in range(SAMPLES)]
    finally:
        plant.close()
    np.testing.assert_allclose(rows, whole(wired, values), atol=1e-6)
