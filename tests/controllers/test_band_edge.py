"""Following an edge of the band: what the controller inside is shown."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from ddpc_controllers import PID, BandEdge
from ddpc_cosim import Charge, ConfigError, Controller, FloatArray, Loop, Sample

from .loops import make_loop

LIMITS = np.full(2, 5.0), np.full(2, np.inf)


@dataclass(kw_only=True)
class Looks(Controller):
    """Keeps what it is shown."""

    horizon: int = 3
    seen: list[Sample] = field(default_factory=list)

    def start(self, loop: Loop) -> None:
        self.loop = loop

    def step(self, sample: Sample) -> FloatArray:
        self.seen.append(sample)
        return np.zeros(2)


def banded_loop() -> Loop:
    loop = make_loop(None, *LIMITS)
    charge = Charge("heat", loop.inputs[0].name, 1.0, "EUR", known=True)
    return replace(loop, bands=(loop.outputs[0].name,), charges=(charge,))


def sample() -> Sample:
    """The first output between 0 and 4, later 1 and 1.2; the second at 7."""
    band = np.array([[[0.0, 4.0], [7.0, 7.0]], [[1.0, 1.2], [7.0, 7.0]], [[1.0, 1.2], [7.0, 7.0]]])
    now = np.array([[0.0, 4.0], [7.0, 7.0]])
    reference = np.array([[2.0, 7.0], [1.2, 7.0], [1.2, 7.0]])
    y = np.array([2.0, 7.0])
    return Sample(0, 0.0, y, y, reference, y, band_now=now, band=band, price=np.ones((4, 1)))


def test_with_both_edges_the_band_stays_one_and_prices_are_told() -> None:
    controller = BandEdge(controller=Looks(), edge="both", margin=[0.5, 9.0])
    controller.start(banded_loop())
    controller.step(sample())
    inside = controller._inner.controller
    assert isinstance(inside, Looks)
    assert (inside.loop.bands, len(inside.loop.charges)) == (banded_loop().bands, 1)
    shown = inside.seen[0]
    np.testing.assert_allclose(shown.band_now, [[0.5, 3.5], [7.0, 7.0]])
    np.testing.assert_allclose(shown.band[0], [[0.5, 3.5], [7.0, 7.0]])
    np.testing.assert_allclose(shown.band[1:, 0], [[1.1, 1.1], [1.1, 1.1]])
    np.testing.assert_array_equal(shown.reference, sample().reference)
    assert shown.price.shape == (4, 1)


@pytest.mark.parametrize(
    ("edge", "margin", "line"),
    [
        ("lower", 0.5, (0.5, 1.1, 1.1)),
        ("upper", 0.5, (3.5, 1.1, 1.1)),
        ("lower", [0.05, 9.0], (0.05, 1.05, 1.05)),
    ],
)
def test_the_edge_drawn_in_by_the_margin_is_the_reference(
    edge: str, margin: object, line: tuple[float, ...]
) -> None:
    controller = BandEdge(controller=Looks(), edge=edge, margin=margin)  # type: ignore[arg-type]
    controller.start(banded_loop())
    controller.step(sample())
    inside = controller._inner.controller
    assert isinstance(inside, Looks)
    assert inside.loop.bands == ()
    assert inside.loop.charges == ()
    shown = inside.seen[0]
    np.testing.assert_allclose(shown.setpoint, [line[0], 7.0])
    np.testing.assert_allclose(shown.reference, [[line[0], 7.0], [line[1], 7.0], [line[2], 7.0]])
    np.testing.assert_allclose(shown.band, np.repeat(shown.reference[..., np.newaxis], 2, axis=-1))
    assert shown.price.shape == (4, 0)


def test_without_bands_it_changes_nothing() -> None:
    controller, alone = BandEdge(controller=PID(proportional=[2.0, 3.0])), PID(proportional=[2.0, 3.0])
    loop = make_loop(None, *LIMITS)
    controller.start(loop)
    alone.start(loop)
    bare = Sample(0, 0.0, *[np.array([2.0, 7.0])] * 2, np.ones((3, 2)), np.ones(2))
    np.testing.assert_array_equal(controller.step(bare).u, np.asarray(alone.step(bare)))


def test_margins_that_do_not_fit() -> None:
    with pytest.raises(ConfigError, match="margin"):
        BandEdge(controller=PID(), margin=[0.1, 0.2, 0.3]).start(banded_loop())
    with pytest.raises(ConfigError, match="edge"):
        BandEdge(controller=PID(), edge="left")  # type: ignore[arg-type]
