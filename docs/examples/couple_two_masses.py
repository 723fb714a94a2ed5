"""
How exact are coupled FMUs?
===========================

An oscillator of two masses is cut in two FMUs; what is left of its accuracy is drawn against the step.
"""

# %%
# The first part is a mass on a spring to the wall, which takes the force of the cut. The second part is the
# other mass with the spring in between: it takes place and speed of the first, and tells the force.

from fmu_plants import Equations, PlantModel, Variable, build_fmu

x, v = Variable("x", "m", start=1.0), Variable("v", "m/s")
mass = PlantModel(
    name="mass",
    states=(x, v),
    inputs=(Variable("drive", "N"), Variable("pull", "N")),
    outputs=(x, v),
    equations=lambda s: Equations({"x": s.v, "v": s.drive - s.pull - 10 * s.x}),
)


def spring_force(s):
    return 20 * (s.near_x - s.x) + 0.3 * (s.near_v - s.v)


x2 = Variable("x", "m")
spring = PlantModel(
    name="spring",
    states=(x2, v),
    inputs=(Variable("near_x", "m"), Variable("near_v", "m/s")),
    outputs=(x2, v, Variable("pull", "N")),
    equations=lambda s: Equations(
        {"x": s.v, "v": (spring_force(s) - 8 * s.x) / 2}, {"pull": spring_force(s)}
    ),
)
files = {"mass": build_fmu(mass), "spring": build_fmu(spring)}

# %%
# Both together are one plant. The force depends on the place without delay: there is a direct way through the
# second part, but no algebraic loop, as the first one's place does not jump with the force.

import numpy as np

from ddpc_cosim import Connection, CoupledPlant, FMUPlant

connections = [
    Connection("mass.x", "spring.near_x"),
    Connection("mass.v", "spring.near_v"),
    Connection("spring.pull", "mass.pull"),
]


def coupled(**options):
    parts = {name: FMUPlant(path) for name, path in files.items()}
    outputs = ["mass.x", "mass.v", "spring.x", "spring.v"]
    return CoupledPlant(parts, connections, inputs=["mass.drive"], outputs=outputs, **options)


with coupled() as plant:
    print(plant.order, plant.loops, plant.dependencies["mass.x"])

# %%
# What is right, the matrix exponential of the whole oscillator knows: here with a drive that changes at every
# sample, every 0.1 s.

from scipy.linalg import expm

whole = np.array(
    [
        [0, 1, 0, 0, 0],
        [-30, -0.3, 20, 0.3, 1],
        [0, 0, 0, 1, 0],
        [10, 0.15, -14, -0.15, 0],
        [0, 0, 0, 0, 0],
    ]
)
drive = np.sin(np.arange(10))
state, exact = np.array([1.0, 0, 0, 0]), []
for force in drive:
    state = (expm(0.1 * whole) @ [*state, force])[:4]
    exact.append(state)

# %%
# The largest error of each way of exchange, over ever shorter communication steps:

import pandas as pd

ways = {
    f"{algorithm}, {extrapolation}": {"algorithm": algorithm, "extrapolation": extrapolation}
    for extrapolation in ("hold", "linear")
    for algorithm in ("parallel", "sequential")
}
rows = []
for way, options in ways.items():
    for step in 0.1 / 2.0 ** np.arange(7):
        with coupled(communication_step=step, **options) as plant:
            plant.reset()
            y = [plant.step([force], 0.1) for force in drive]
        rows.append({"way": way, "step": step, "error": np.abs(np.array(y) - exact).max()})
errors = pd.DataFrame(rows)
table = errors.pivot_table("error", "step", "way")
table.map("{:.1e}".format)

# %%
# Held values are of first order: half the step, half the error. Values on a line are of second order.

orders = np.log2(table.shift(-1) / table).dropna()
orders.round(2)
