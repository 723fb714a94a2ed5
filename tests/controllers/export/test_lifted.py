"""Lifted states in C: every dictionary on its own, and in closed loops of WKPC and Koopman MPC."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ddpc_controllers import (
    WKPC,
    Combined,
    Constant,
    Delays,
    Dictionary,
    Gaussian,
    Identity,
    KoopmanMPC,
    OwnFunction,
    Polynomials,
    ThinPlate,
)
from ddpc_controllers.data.dictionaries import Lift, c_lift
from ddpc_controllers.export.code import Code, Exportable
from ddpc_controllers.published import PublishedWKPC
from ddpc_cosim import Bounds, ConfigError, FloatArray, Loop, Sample, Variable

from .compiled import CompiledController
from .loops import COUPLED, PENDULUM, Bench

DICTIONARIES: dict[str, Dictionary] = {
    "thin plates": ThinPlate(count=6, centres="data"),
    "Gaussians": Gaussian(count=4, width=0.7, centres="k-means"),
    "polynomials": Polynomials(degree=3),
    "identity": Identity(),
    "constant": Constant(),
    "delays": Delays(samples=2, dictionary=Gaussian(count=3, centres="data")),
    "combined": Combined(dictionaries=[Polynomials(), Delays(samples=1), Constant(), ThinPlate(count=3)]),
}
WIDTH = 3
"""Signals of a state."""

HELD, EXPECTED = 1, 2


@dataclass(kw_only=True)
class Lifting(Exportable):
    """Inputs that are the lifted states of what is measured."""

    lift: Lift

    def start(self, loop: Loop) -> None: ...

    def step(self, sample: Sample) -> FloatArray:
        return np.concatenate([sample.measured[:WIDTH], self.lift(sample.measured)])

    def c_step(self, code: Code, loop: Loop) -> str:
        members = c_lift(code, self.lift, WIDTH)
        return code.step(f"lift({members['terms']}, {members['term_count']}, sample->measured, u);")


@pytest.mark.parametrize("name", DICTIONARIES)
def test_each_dictionary_lifts_as_in_python(name: str) -> None:
    dictionary, rng = DICTIONARIES[name], np.random.default_rng(3)
    states = rng.normal(size=(60, WIDTH * (1 + getattr(dictionary, "memory", 0))))
    lifting = Lifting(lift=dictionary.draw(states, rng))
    sample = Sample(0, 0.0, np.zeros(2), states[0], np.zeros((1, 2)), np.zeros(2))
    inputs, free = lifting.step(sample).shape, np.full(2, np.inf)
    loop = replace(
        COUPLED.loop()[0],
        inputs=tuple(Variable(f"z{i}") for i in range(*inputs)),
        measurements=tuple(Variable(f"state{i}") for i in range(states.shape[1])),
        bounds=Bounds(np.full(inputs, -np.inf), np.full(inputs, np.inf), -free, free),
    )
    c = CompiledController(lifting, loop)
    # Recorded states are centres too; of far ones the exponential is zero.
    far = 10.0 ** rng.uniform(-3, 3, (60, 1)) * rng.normal(size=states.shape)
    for state in (*states, *far):
        seen = sample._replace(measured=state)
        np.testing.assert_allclose(c.step(seen), lifting.step(seen), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(
    ("bench", "name"), [*((PENDULUM, name) for name in DICTIONARIES), (COUPLED, "combined")]
)
def test_wkpc_in_c_is_wkpc_with_each_dictionary(bench: Bench, name: str) -> None:
    run = bench.close(WKPC(dictionary=DICTIONARIES[name], horizon=6), reach=2.0)
    assert run.difference < 1e-10
    assert not run.disagreements
    assert run.active > 0
    assert run.statuses & 3 == HELD | EXPECTED


@pytest.mark.parametrize(
    ("bench", "settings", "changes"),
    [
        (PENDULUM, {"regulariser": "ridge", "initial_length": 4}, {"continues_recording": True}),
        (COUPLED, {"scaling": "range", "output_weight": (1.0, 3.0)}, {"preview": 0}),
    ],
    ids=["ridge", "range"],
)
def test_wkpc_in_c_is_wkpc_with_other_settings(
    bench: Bench, settings: dict[str, Any], changes: dict[str, Any]
) -> None:
    run = bench.close(WKPC(horizon=8, **settings), reach=2.0, **changes)
    assert run.difference < 1e-10
    assert not run.disagreements
    assert run.active > 0


@pytest.mark.parametrize(
    ("bench", "settings", "changes"),
    [
        *((PENDULUM, {"dictionary": lift, "state": "measured"}, {}) for lift in DICTIONARIES.values()),
        (PENDULUM, {"dictionary": Gaussian(count=3, centres="data"), "delays": 3}, {"preview": 1}),
        (COUPLED, {"delays": 1, "rate_bounds": 2.0}, {"continues_recording": True}),
        (COUPLED, {"state": "measured", "scaling": "none", "disturbance_gain": 0.0}, {}),
    ],
    ids=[*DICTIONARIES, "delayed state", "rates", "no disturbance"],
)
def test_koopman_mpc_in_c_is_koopman_mpc(
    bench: Bench, settings: dict[str, Any], changes: dict[str, Any]
) -> None:
    run = bench.close(KoopmanMPC(**settings), reach=2.0, **changes)
    assert run.difference < 1e-10
    assert not run.disagreements
    assert run.active > 0
    assert run.statuses & 3 == HELD | EXPECTED


class Square:
    """A dictionary of a user's own."""

    def functions(self, size: int) -> int:
        return size

    def draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        return np.square


@pytest.mark.parametrize(
    ("controller", "reason"),
    [
        (
            WKPC(dictionary=OwnFunction(function="numpy:square")),
            r"Python function \(square\) .* say the same with",
        ),
        (KoopmanMPC(dictionary=Combined(dictionaries=[Identity(), Square()])), r"function \(square\)"),
        (PublishedWKPC(), "PublishedWKPC cannot be exported: .* use WKPC"),
        (WKPC(online_data="sliding-window"), "use online_data = 'frozen'"),
    ],
    ids=["own function", "own class", "published", "online"],
)
def test_what_cannot_be_exported_says_why_and_what_to_do(controller: Any, reason: str) -> None:
    loop, _ = PENDULUM.loop()
    controller.start(loop)
    with pytest.raises(ConfigError, match=reason):
        controller.c_code(loop)
