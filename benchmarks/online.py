"""DeePC on data that slide with every sample, against frozen data and against rebuilding from the data."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks import pendulum, tanks
from benchmarks.pendulum import PRINTED
from benchmarks.step import BenchmarkPlant, Row, Stepper, measure, print_header, print_rows
from ddpc_controllers import DeePC
from ddpc_cosim import Action, FloatArray, Loop, Sample

_DITHER = 0.2


class Rebuilder:
    """DeePC that is started anew on the newest samples, as a sliding window without updates would be.

    Only its condensing and its step are timed: it keeps the loop's past itself.
    """

    def __init__(self, settings: DeePC, loop: Loop) -> None:
        assert loop.recording is not None
        settings = replace(settings, online_data="frozen", dither=0.0)
        self._frozen, self._loop = settings, loop
        settings.start(loop)
        condenser = settings._write_down(loop).prepare("u", len(loop.inputs))
        self._condense = condenser.condense
        self._u = deque(loop.recording.u, len(loop.recording.u))
        self._y = deque(loop.recording.y, len(loop.recording.y))

    def __call__(self, sample: Sample) -> FloatArray:
        settings = self._frozen
        data = settings._layout.stack({"u": np.array(self._u), "y": np.array(self._y)})
        settings._solver.replace(self._condense(data))  # type: ignore[attr-defined]
        answer = settings.step(sample)
        u = answer.u if isinstance(answer, Action) else answer
        self._u.append(u)
        self._y.append(sample.y.copy())
        return u


def stepper(settings: DeePC, loop: Loop) -> Stepper:
    """Return a controller's step after its start."""
    settings.start(loop)

    def step(sample: Sample) -> FloatArray:
        answer = settings.step(sample)
        return answer.u if isinstance(answer, Action) else answer

    return step


def compare(
    label: str, settings: DeePC, loop: Loop, plant: Callable[[int], BenchmarkPlant], limit: float
) -> list[Row]:
    """Measure the sliding step against the frozen one and against rebuilding."""
    sliding = replace(settings, online_data="sliding-window", dither=_DITHER, excitation_floor=0.0)
    steppers: dict[str, Stepper] = {
        "frozen": stepper(settings, loop),
        "sliding": stepper(sliding, loop),
        "rebuilt": Rebuilder(settings, loop),
    }
    times = {name: float(np.median(t)) for name, t in measure(steppers, settings.horizon, plant).items()}
    slide, frozen, rebuilt = times["sliding"], times["frozen"], times["rebuilt"]
    return [
        Row(f"{label}: sliding window / frozen step", slide, frozen, slide / frozen, limit, at_most=True),
        Row(f"{label}: rebuilding from the data / sliding window", slide, rebuilt, rebuilt / slide, 1.0),
    ]


def main() -> bool:
    """Print the table; return whether every bound was held."""
    print_header()
    loop = pendulum.loop(pendulum.experiment(200), 3.5)
    tight = pendulum.loop(pendulum.experiment(200), 2.5)
    two = tanks.loop(400)
    wide = DeePC(
        regulariser="ridge",
        terminal_equality=True,
        initial_length=4,
        horizon=10,
        output_weight=10.0,
        setpoint_weight=30.0,
        input_weight=0.1,
        lambda_g=1.0,
        lambda_sigma=1e4,
    )
    return print_rows(
        [
            *compare(
                "DeePC, N = 5, T = 200",
                DeePC(**PRINTED),
                loop,
                pendulum.Pendulum,
                25.0,
            ),
            *compare(
                "DeePC, N = 5, T = 200, bounds active",
                DeePC(**PRINTED),
                tight,
                pendulum.Pendulum,
                25.0,
            ),
            *compare("DeePC, 2 x 2, N = 10, T = 400", wide, two, tanks.Tanks, 40.0),
        ]
    )
