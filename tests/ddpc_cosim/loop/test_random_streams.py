"""Whatever is random in a loop has numbers of its own: no two things the same, and none through another."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import (
    PRBS,
    Chirp,
    Conditions,
    Controller,
    FloatArray,
    GaussianNoise,
    Loop,
    MixedExcitation,
    Multisine,
    ParameterValue,
    Plant,
    Sample,
    Steps,
    Trace,
    Variable,
    WhiteNoise,
    cosimulate,
)

SEEDS = (0, 1, 2, 5489)
NOISE = GaussianNoise({"noisy": 1.0})
CONDITIONS = Conditions(
    disturbances={
        "u1": WhiteNoise(1.0),
        "u2": [WhiteNoise(1.0), WhiteNoise(1.0)],
        "disturbed": WhiteNoise(1.0),
    },
    inputs={"free": WhiteNoise(1.0)},
    loss={"lost": 0.5, "disturbed": 0.5},
)
EXCITATION = MixedExcitation(
    (
        (PRBS(-1.0, 1.0, 40), (0,)),
        (Multisine(-1.0, 1.0, 40, sampling_time=1.0, phases="random"), (1,)),
        (Chirp(-1.0, 1.0, 40, sampling_time=1.0, from_frequency=0.1, to_frequency=0.4), (2,)),
    )
)


class Clock(Plant):
    """Outputs that are the same whatever the inputs: what else is seen of them is what the loop adds."""

    inputs = tuple(Variable(name) for name in ("u1", "u2", "u3", "free"))
    outputs = tuple(Variable(name) for name in ("noisy", "lost", "disturbed"))

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        self.time = t0
        return np.full(3, np.sin(self.time))

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.time += h
        return np.full(3, np.sin(self.time))


@dataclass(kw_only=True)
class Drawing(Controller):
    """Drives the plant with its own random numbers, and learns from a recording if it is to."""

    learns: bool = False

    @property
    def uses_recording(self) -> bool:
        return self.learns

    @property
    def accepts_missing(self) -> bool:
        return True

    def start(self, loop: Loop) -> None:
        self.rng = loop.rng
        self.recording = loop.recording

    def step(self, sample: Sample) -> FloatArray:
        return self.rng.standard_normal(3)


def run(
    seed: int = 0,
    *,
    noise: GaussianNoise | None = NOISE,
    conditions: Conditions = CONDITIONS,
    learns: bool = True,
    stabilised: bool = True,
) -> tuple[Trace, Drawing]:
    controller = Drawing(learns=learns)
    return cosimulate(
        Clock(),
        controller,
        sampling_time=1.0,
        duration=30.0,
        reference={name: Steps((0.0,), (1.0,)) for name in ("noisy", "lost", "disturbed")},
        excitation=EXCITATION.with_seed(seed) if learns else None,
        stabiliser=Drawing() if learns and stabilised else None,
        noise=noise,
        conditions=conditions,
        seed=seed,
    ), controller


def test_no_two_things_that_are_random_have_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """For one seed and over several: every generator starts from a state of its own."""
    begun: list[str] = []
    generator = np.random.default_rng

    def noted(*seed: Any) -> np.random.Generator:
        made = generator(*seed)
        begun.append(str(made.bit_generator.state))
        return made

    monkeypatch.setattr(np.random, "default_rng", noted)
    for seed in SEEDS:
        run(seed)
    # Controller, stabiliser, noise, four disturbances, a loss for each output, three excitations, and the
    # signal of an input in the experiment and in the loop.
    assert len(begun) == 15 * len(SEEDS)
    assert len(set(begun)) == len(begun)


def random_parts(trace: Trace, controller: Drawing) -> dict[str, Any]:
    """Return what is seen of each thing that is random."""
    applied = dict(zip((variable.name for variable in trace.changed_inputs), trace.applied.T, strict=True))
    return {
        "controller": trace.u,
        "noise": trace.measured[:, 0] - trace.y[:, 0],
        "lost": np.isnan(trace.measured),
        "disturbed output": trace.y[:, 2],
        "disturbed input": applied.get("u2"),
        "free input": applied["free"],
        "experiment": None if controller.recording is None else controller.recording.u,
    }


WITHOUT: dict[str, tuple[dict[str, Any], set[str]]] = {
    "noise": ({"noise": None}, {"noise"}),
    "disturbances": (
        {"conditions": replace(CONDITIONS, disturbances={})},
        {"disturbed output", "disturbed input"},
    ),
    "a disturbance": (
        {"conditions": replace(CONDITIONS, disturbances={"u2": [WhiteNoise(1.0), WhiteNoise(1.0)]})},
        {"disturbed output"},
    ),
    "losses": ({"conditions": replace(CONDITIONS, loss={})}, {"lost"}),
    "experiment": ({"learns": False}, {"experiment", "noise"}),
    "stabiliser": ({"stabilised": False}, {"experiment"}),
}
"""What is left out of a run, and what of it differs then; noise goes on from the experiment to the loop."""


@pytest.mark.parametrize("what", WITHOUT)
def test_what_is_random_does_not_change_with_what_else_is(what: str) -> None:
    changes, differing = WITHOUT[what]
    whole, rest = random_parts(*run()), random_parts(*run(**changes))
    for name in whole.keys() - differing:
        np.testing.assert_array_equal(rest[name], whole[name], err_msg=name)
    assert not any(np.array_equal(rest[name], whole[name]) for name in differing)
