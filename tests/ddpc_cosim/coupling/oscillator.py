"""A two-mass oscillator: as one linear system, and cut in two in two ways.

m1 a1 = F - k1 x1 - c,    m2 a2 = c - k2 x2,    c = k (x1 - x2) + d (v1 - v2)
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from ddpc_cosim import Connection
from ddpc_cosim.variables import FloatArray
from fmu_plants import Equations, PlantModel, Variable

M1, M2, K1, K2, K, D = 1.0, 2.0, 10.0, 8.0, 20.0, 0.3
FORCE = Variable("force", "N")
X, V = Variable("x", "m", start=1.0), Variable("v", "m/s")
X2 = Variable("x", "m")
OTHER_X, OTHER_V = Variable("other_x", "m"), Variable("other_v", "m/s")
COUPLING = Variable("coupling", "N")

# Displacement and displacement: the spring between the masses is in both halves.
FRONT = PlantModel(
    name="front",
    states=(X, V),
    inputs=(FORCE, OTHER_X, OTHER_V),
    outputs=(X, V),
    equations=lambda v: Equations(
        {"x": v.v, "v": (v.force - K1 * v.x - K * (v.x - v.other_x) - D * (v.v - v.other_v)) / M1}
    ),
)
BACK = PlantModel(
    name="back",
    states=(X2, V),
    inputs=(OTHER_X, OTHER_V),
    outputs=(X2, V),
    equations=lambda v: Equations(
        {"x": v.v, "v": (K * (v.other_x - v.x) + D * (v.other_v - v.v) - K2 * v.x) / M2}
    ),
)
DISPLACEMENTS = (
    Connection("front.x", "back.other_x"),
    Connection("front.v", "back.other_v"),
    Connection("back.x", "front.other_x"),
    Connection("back.v", "front.other_v"),
)

# Displacement and force: the spring is in the second half, whose force follows the other one's place at once.
MASS = PlantModel(
    name="mass",
    states=(X, V),
    inputs=(FORCE, COUPLING),
    outputs=(X, V),
    equations=lambda v: Equations({"x": v.v, "v": (v.force - v.coupling - K1 * v.x) / M1}),
)


def _spring(v: object) -> Equations:
    force = K * (v.other_x - v.x) + D * (v.other_v - v.v)  # type: ignore[attr-defined]
    return Equations({"x": v.v, "v": (force - K2 * v.x) / M2}, {"coupling": force})  # type: ignore[attr-defined]


SPRING = PlantModel(
    name="spring",
    states=(X2, V),
    inputs=(OTHER_X, OTHER_V),
    outputs=(X2, V, COUPLING),
    equations=_spring,
)
FORCES = (
    Connection("front.x", "back.other_x"),
    Connection("front.v", "back.other_v"),
    Connection("back.coupling", "front.coupling"),
)

CUTS = {"displacements": ((FRONT, BACK), DISPLACEMENTS), "forces": ((MASS, SPRING), FORCES)}
OUTPUTS = ("front.x", "front.v", "back.x", "back.v")

MATRIX = np.array(
    [
        [0.0, 1.0, 0.0, 0.0],
        [-(K1 + K) / M1, -D / M1, K / M1, D / M1],
        [0.0, 0.0, 0.0, 1.0],
        [K / M2, D / M2, -(K2 + K) / M2, -D / M2],
    ]
)


def exact(forces: Sequence[float], sampling_time: float) -> FloatArray:
    """Return x1, v1, x2, v2, shape (n + 1, 4), with forces that are held over samples, shape (n,)."""
    augmented = np.zeros((5, 5))
    augmented[:4, :4], augmented[1, 4] = MATRIX, 1.0 / M1
    step = expm(sampling_time * augmented)
    rows = [np.array([1.0, 0.0, 0.0, 0.0])]
    for force in forces:
        rows.append(step[:4, :4] @ rows[-1] + step[:4, 4] * force)
    return np.array(rows)
