"""What instruments are worth where the data were recorded in closed loop: settled errors with noise.

Five plants are recorded around a controller that holds them at a constant reference, the measured output
with noise in the recording and in the loop. To its inputs as little is added as an operator would allow, so
that most of what the recorded inputs do is the controller's answer to noise. That makes windows of several
samples wrong; where a stronger excitation is allowed it is hardly seen. DeePC without instruments and with
those of either kind for closed loop is tuned by the same random trials on two seeds, and by the figure that
it is judged by: the median of the settled error, of other seeds. Without instruments each trial is made with
two regularisers. The settled error is the size of the mean error at the end of a step, so that the noise,
which no controller can remove, averages out of it. Every seed has its own recording. The bound is for the
instruments that are made of the excitation.

    python -m benchmarks.closed_loop cart-pendulum two-mass-drive pendulum --trials 6 --seeds 10
"""

import argparse
import math
import tempfile
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from ddpc_controllers import PID, DeePC
from ddpc_controllers.data.instruments import Instruments
from ddpc_controllers.deepc import Regulariser
from ddpc_cosim import Constant, Controller, Problem, Steps, Study, UniformRandom
from ddpc_cosim.study.verdicts.statistics import compare

BOUND = 0.5
"""What instruments may leave of the settled error."""
METHODS: dict[str, Instruments] = {"DeePC": "none", "closed-loop": "closed-loop", "excitation": "excitation"}
DRAWN = (
    "horizon",
    "initial_length",
    "input_weight",
    "artificial_setpoint",
    "regulariser",
    "lambda_g",
)
REGULARISERS: tuple[Regulariser, ...] = ("ridge", "projection")
TUNED_ON = range(100, 102)

PROBLEMS = {
    "cart-pendulum": Problem(
        plant="cart-pendulum",
        inputs=["force"],
        outputs=["angle"],
        sampling_time=0.02,
        duration=6.0,
        reference={"angle": Steps([0.0, 0.5, 2.5, 4.5], [0.0, 3.0, -2.0, 0.0], unit="deg")},
        bounds={"force": (-10.0, 10.0)},
        excitation=UniformRandom(-0.3, 0.3, samples=10000),
        recording_start=6.0,
        stabiliser=PID(tuning="manual", proportional=20.0, integral=30.0, derivative=2.5, filter_time=0.02),
        noise={"angle": 0.005},
    ),
    "two-mass-drive": Problem(
        plant="two-mass-drive",
        inputs=["motor_torque"],
        outputs=["load_speed"],
        sampling_time=0.02,
        duration=6.2,
        reference={"load_speed": Steps([0.0, 0.2, 2.2, 4.2], [0.0, 10.0, 5.0, 0.0])},
        bounds={"motor_torque": (-5.0, 5.0)},
        excitation=UniformRandom(-0.05, 0.05, samples=8000),
        recording_start=6.2,
        stabiliser=PID(tuning="manual", proportional=0.08, integral=0.2),
        recorded_inputs={"load_torque": Constant(0.0)},
        noise={"load_speed": 0.5},
    ),
    "pendulum": Problem(
        plant="pendulum",
        inputs=["torque"],
        outputs=["angle"],
        sampling_time=0.1,
        duration=20.0,
        reference={"angle": Steps([0.0, 1.0, 7.0, 13.0], [0.0, 20.0, -10.0, 0.0], unit="deg")},
        bounds={"torque": (-3.5, 3.5)},
        excitation=UniformRandom(-0.1, 0.1, samples=8000),
        recording_start=20.0,
        stabiliser=PID(tuning="manual", proportional=8.0, derivative=0.4, integral=8.0),
        noise={"angle": 0.02},
    ),
    "van-der-pol": Problem(
        plant="van-der-pol",
        inputs=["force"],
        outputs=["position"],
        sampling_time=0.2,
        duration=20.0,
        reference={"position": Steps([0.0, 2.0, 8.0, 14.0], [0.0, 1.0, -0.5, 0.5])},
        bounds={"force": (-3.0, 3.0)},
        excitation=UniformRandom(-0.2, 0.2, samples=8000),
        recording_start=20.0,
        stabiliser=PID(tuning="manual", proportional=2.0, integral=0.5, derivative=2.0, filter_time=0.2),
        noise={"position": 0.02},
    ),
    "cstr": Problem(
        plant="cstr",
        inputs=["coolant_temperature"],
        outputs=["temperature"],
        sampling_time=10.0,
        duration=1000.0,
        reference={"temperature": Steps([0.0, 50.0, 350.0, 700.0], [324.475443, 330.0, 336.0, 326.0])},
        bounds={"coolant_temperature": (285.0, 310.0)},
        excitation=UniformRandom(-0.3, 0.3, samples=8000),
        recording_start=1000.0,
        stabiliser=PID(tuning="manual", proportional=1.0, integral=0.01),
        noise={"temperature": 0.3},
    ),
}


def trials(count: int) -> dict[str, list[Controller]]:
    """Return the settings that both are tried with: the same windows and weights."""
    rng = np.random.default_rng(1)
    drawn: dict[str, list[Controller]] = {method: [] for method in METHODS}
    for _ in range(count):
        shared = DeePC(
            horizon=int(rng.integers(5, 25)),
            initial_length=int(rng.integers(4, 40)),
            input_weight=float(10 ** rng.uniform(-7.0, 0.0)),
            artificial_setpoint=bool(rng.integers(2)),
            use_current_output=True,
            regulariser="ridge",
            lambda_g=float(10 ** rng.uniform(-3.0, 5.0)),
        )
        for method, instruments in METHODS.items():
            regularisers = REGULARISERS[: None if instruments == "none" else 1]  # nothing is left unexplained
            drawn[method] += [
                replace(shared, regulariser=regulariser, instruments=instruments)
                for regulariser in regularisers
            ]
    return drawn


def settled_errors(
    problem: Problem, controllers: Mapping[str, Controller], seeds: Sequence[int], jobs: int
) -> dict[str, list[float]]:
    """Return each controller's settled error by seed; infinite where it fails."""
    study = Study(problem, dict(controllers), seeds=seeds, name="closed-loop")
    errors: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for case in study.run(Path(folder), jobs=jobs, progress=False).cases:
            (error,) = (value for key, value in case.metrics.items() if key.startswith("settled_error"))
            complete = case.outcome == "completed" and math.isfinite(error)
            errors.setdefault(case.label, []).append(error if complete else math.inf)
    return errors


def judged(name: str, count: int, seeds: int, jobs: int) -> bool:
    """Print what instruments leave of the settled error; return whether excitation keeps its bound."""
    problem, tried = PROBLEMS[name], dict[str, Controller]()
    for method, controllers in trials(count).items():
        tried |= {f"{method} {number}": controller for number, controller in enumerate(controllers)}
    tuning = settled_errors(problem, tried, TUNED_ON, jobs)
    chosen = {
        method: min(
            (label for label in tried if label.startswith(f"{method} ")), key=lambda of: median(tuning[of])
        )
        for method in METHODS
    }
    errors = settled_errors(
        problem, {method: tried[label] for method, label in chosen.items()}, range(seeds), jobs
    )

    def by_seed(values: Sequence[float]) -> dict[tuple[Hashable, int], float]:
        return {("", seed): value for seed, value in enumerate(values)}

    def told(label: str) -> str:
        return ", ".join(f"{setting} = {getattr(tried[label], setting)}" for setting in DRAWN)

    print(
        f"{name}: what instruments leave of the settled error, and the 95 % interval of what they take away"
    )
    kept = False
    for method in METHODS:
        gain, failed = (
            compare(by_seed(errors["DeePC"]), by_seed(errors[method])),
            sum(map(math.isinf, errors[method])),
        )
        ratio = median(errors[method]) / median(errors["DeePC"])
        taken = f"{ratio:.3f}, {gain.low:.4g} to {gain.high:.4g}, " if method != "DeePC" else ""
        figures = f"{median(errors[method]):8.4g}, {taken}{failed} of {seeds} failed"
        print(f"  {method:11s} {figures}: {told(chosen[method])}")
        kept = ratio <= BOUND and gain.low > 0.0  # of the last, which is excitation
    return kept


def main() -> bool:
    """Print the table; return whether all bounds are met."""
    parser = argparse.ArgumentParser()
    parser.add_argument("problems", nargs="*", default=[*PROBLEMS])
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    kept = [judged(name, given.trials, given.seeds, given.jobs) for name in given.problems]
    return all(kept)


if __name__ == "__main__":
    raise SystemExit(0 if main() else 1)
