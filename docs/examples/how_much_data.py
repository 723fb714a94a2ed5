"""
How much data does a method need?
=================================

How a study with several problems answers a question: the same loop, learned from 25 to 200 samples.
"""

# %%
# Recordings of different lengths are different problems. Everything else is the same, and so are the seeds:
# what is drawn is the experiment.

from ddpc_controllers import MPC, SPC, DeePC
from ddpc_cosim import Problem, Scenario, Steps, Study, UniformRandom

problems = {
    f"{samples}-samples": Problem(
        plant="pendulum",
        inputs=["torque"],
        outputs=["angle"],
        sampling_time=0.1,
        duration=10.0,
        reference=Steps([0, 5], [0.35, -0.17]),
        bounds={"torque": (-3.5, 3.5)},
        excitation=UniformRandom(-3.5, 3.5, samples=samples),
        scenarios={"noisy": Scenario(noise={"angle": 0.01})},
    )
    for samples in (25, 50, 100, 200)
}

# %%
# Three methods that learn a linear predictor, each in its own way, on five experiments.

study = Study(problems, {"DeePC": DeePC(), "SPC": SPC(), "MPC": MPC()}, name="data", seeds=range(5))
results = study.run("runs/data", jobs=2, progress=False)

# %%
# The median over the seeds of the error that is left after a step, in degrees, by what was recorded:

frame = results.frame()
table = frame.pivot_table("settled_error.angle [deg]", "problem", "controller", aggfunc="median")
table.loc[list(problems)].round(3)

# %%
# Some runs failed. How many:

frame.pivot_table("failed", "problem", "controller", aggfunc="sum").loc[list(problems)]

# %%
# One of the runs that had the fewest samples to learn from:

results.trace("SPC", problem="25-samples", seed=0).plot()
