"""
Compare controllers on many seeds
=================================

How a comparison is set up, run and read in Python: two data-driven controllers and a PID on a pendulum.
"""

# %%
# A problem is what is asked of every controller: a plant, what it may do, what it is to follow, and the
# experiment that data-driven methods learn from. ``plant`` may be the path of an FMU.

from ddpc_controllers import MFAPC, PID, DeePC
from ddpc_cosim import Problem, Scenario, Steps, Study, UniformRandom

pendulum = Problem(
    plant="pendulum",
    inputs=["torque"],
    outputs=["angle"],
    sampling_time=0.1,
    duration=20.0,
    reference=Steps([0, 10], [0.35, -0.17]),
    bounds={"torque": (-3.5, 3.5)},
    excitation=UniformRandom(-3.5, 3.5, samples=200),
    scenarios={"quiet": Scenario(), "noisy": Scenario(noise={"angle": 0.002})},
)

# %%
# A study sets controllers on it, over all scenarios and seeds. Each case runs in a process of its own, and
# its result is kept in the folder: run this again and nothing is computed twice.

controllers = {"DeePC": DeePC(), "MFAPC": MFAPC(), "PID": PID(tuning="step-test")}
study = Study({"pendulum": pendulum}, controllers, name="pendulum", seeds=range(8))
results = study.run("runs/pendulum", jobs=2, progress=False)

# %%
# Every case is a row, every metric a column.

frame = results.frame()
frame.groupby(["scenario", "controller"])["rmse.angle [deg]"].describe().round(3)

# %%
# Which differences are more than chance is decided seed by seed: the interval of the median difference, and a
# test that is corrected for the number of comparisons.

compared = results.compare("rmse.angle", baseline="PID")
compared[
    ["controller", "median", "difference", "difference_low", "difference_high", "corrected", "told_apart"]
]

# %%
# The samples of any run are there.

results.trace("DeePC", scenario="noisy", seed=3).plot()

# %%
# For others, ``results.report()`` writes the same as a page, and returns its path.
