"""Edges of bands in C where nothing else is known ahead: bands with one edge, wrappers within, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from ddpc_controllers import (
    LQR,
    PID,
    SPC,
    SPSA,
    BandEdge,
    Decentralised,
    Group,
    OffsetFree,
    Scaled,
)
from ddpc_cosim import ConfigError, Controller, FloatArray, Loop, Sample

from .compiled import Beside
from .loops import COUPLED

PAIRS = [
    Group(inputs=["u0"], outputs=["x0"], controller=Scaled(controller=PID(proportional=1.0, integral=0.2))),
    Group(inputs=["u1"], outputs=["x1"], controller=SPC(horizon=4)),
]
INSIDE: dict[str, Controller] = {
    "PID": PID(proportional=[0.2, 0.3], integral=0.1),
    "LQR": LQR(horizon=4),
    "SPC": SPC(horizon=6),
    "decentralised": Decentralised(groups=PAIRS),
    "offset-free": OffsetFree(controller=SPC(horizon=6)),
}


def banded_loop() -> tuple[Loop, FloatArray]:
    loop, state = COUPLED.loop()
    return replace(loop, bands=("x0",)), state


def side_by_side(controller: Controller, open_end: int | None = None, steps: int = 60) -> Beside:
    """Close a loop in which the first output has a random band at every sample, some without an edge."""
    loop, state = banded_loop()
    beside, rng = Beside(controller=controller), np.random.default_rng(6)
    beside.start(loop)
    n, far = controller.horizon, (-np.inf, np.inf)
    for k in range(steps):
        lower = rng.uniform(8.0, 16.0, n + 1)
        band = np.stack([lower, lower + rng.uniform(0.0, 3.0, n + 1)], axis=-1)
        reference = np.stack([lower, rng.uniform(4.0, 8.0, n + 1)], axis=-1)
        if open_end is not None:
            band[rng.random(n + 1) < 0.5, open_end] = far[open_end]
        bands = np.stack([band, np.repeat(reference[:, 1:], 2, axis=1)], axis=1)
        rows = np.minimum(np.arange(1, n + 1), loop.preview)
        seen = Sample(k, 0.1 * k, state[:2], state[::-1], reference[rows], reference[0])
        u = beside.step(seen._replace(band_now=bands[0], band=bands[rows])).u
        state = COUPLED.advance(state, np.clip(u, loop.bounds.u_min, loop.bounds.u_max))
    return beside


@pytest.mark.parametrize("name", INSIDE)
def test_who_knows_no_bands_in_c_follows_an_edge(name: str) -> None:
    beside = side_by_side(BandEdge(controller=INSIDE[name], edge="upper", margin=[0.5, 9.0]))
    assert beside.difference <= 1e-8
    assert not beside.disagreements


@pytest.mark.parametrize(("edge", "open_end"), [("lower", 1), ("upper", 0), ("both", 0), ("both", 1)])
def test_bands_with_one_edge_alone_are_drawn_in_there(edge: str, open_end: int) -> None:
    controller = BandEdge(controller=SPC(horizon=6), edge=edge, margin=0.5)  # type: ignore[arg-type]
    beside = side_by_side(controller, open_end)
    assert beside.difference <= 1e-8
    assert not beside.disagreements
    assert beside.active > 0


@pytest.mark.parametrize(
    ("controller", "reason"),
    [
        (BandEdge(controller=SPSA()), "SPSA cannot be exported: it draws random perturbations"),
        (
            BandEdge(controller=OffsetFree(controller=LQR()), edge="both"),
            "OffsetFree cannot be exported with bands: its code in C does not know them",
        ),
    ],
    ids=["a method without code", "a wrapper that knows no bands"],
)
def test_who_inside_has_no_code_is_refused(controller: Controller, reason: str) -> None:
    loop, _ = banded_loop()
    controller.start(loop)
    with pytest.raises(ConfigError, match=reason):
        controller.c_code(loop)
