"""Keeping a margin to the band: by following an edge of it, the usual way to spend little, or within both."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, get_args

import numpy as np

from ddpc_controllers.checks import per_signal
from ddpc_controllers.export.code import ALL_AHEAD, Ahead, Code, inner_step
from ddpc_controllers.wrapper import SingleWrapper
from ddpc_cosim import Action, FloatArray, Loop, Sample, Weight, setting

Edge = Literal["lower", "upper", "both"]
EDGES: tuple[str, ...] = get_args(Edge)
_NOT_TOLD = {name: Sample._field_defaults[name] for name in ("band_now", "band", "price")}


@dataclass(kw_only=True)
class BandEdge(SingleWrapper):
    """A controller that follows an edge of each band, drawn in by a margin, and is told no price.

    Where the band is narrower than the margin it follows the middle of the band. Outputs that are wanted at a
    reference are controlled as ever. With both edges the band stays one, drawn in, and prices are told: noise
    and errors of model and forecast take up the margin first.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

    edge: Edge = setting(
        "lower",
        choices=EDGES,
        doc="the edge that is followed: of a room that is heated the lower one; both: the band stays one, "
        "drawn in at both edges, and prices are told",
    )
    margin: Weight = setting(
        0.0, low=0.0, doc="how far within the band, in the outputs' units: a number, or one for each output"
    )

    def start(self, loop: Loop) -> None:
        """Start the controller on references in place of bands.

        Raises
        ------
        ConfigError
            Margins that are not one for each output, or what the controller says itself.
        """
        outputs = [variable.name for variable in loop.outputs]
        self._is_band = np.array([name in loop.bands for name in outputs], dtype=bool)
        self._margin = per_signal("margin", self.margin, len(outputs))
        self._start_inside(self._told(loop))

    def step(self, sample: Sample) -> Action:
        """Return the controller's inputs for references at the edges."""
        if not self._is_band.any():
            return self._inner.step(sample)
        if self.edge == "both":
            now, ahead = self._drawn_in(sample.band_now), self._drawn_in(sample.band)
            return self._inner.step(sample._replace(band_now=now, band=ahead))
        now = self._line(sample.setpoint, sample.band_now)
        ahead = self._line(sample.reference, sample.band)
        return self._inner.step(
            sample._replace(
                setpoint=now,
                reference=ahead,
                band_now=np.repeat(now[..., np.newaxis], 2, axis=-1),
                band=np.repeat(ahead[..., np.newaxis], 2, axis=-1),
                price=sample.price[:, :0],
            )
        )

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the controller, and what draws its bands in or makes references of them."""
        inside, inner_loop = self._inner.controller, self._told(loop)
        if code.ahead is None or not self._is_band.any():
            return inner_step(inside, code, inner_loop)
        outputs = np.flatnonzero(self._is_band)
        code.kernel("band_edge")
        margins = code.constant(
            "Margins",
            bands=len(outputs),
            samples=1 + inside.horizon,
            margin=code.doubles(self._margin[outputs]),
        )
        first = code.remembered
        bands = code.memory(np.zeros((1 + inside.horizon, len(outputs), 2)))
        draw_in = (
            f"{code.ahead.chosen(code, lambda sample: _bands(sample)[:, outputs], bands)}"
            f"draw_in(&{margins}, {bands});\n"
        )
        if self.edge == "both":
            with code.seeing(self._ahead_drawn_in(code.ahead, first)):
                step = inner_step(inside, code, inner_loop)
            return code.step(f"{draw_in}{step}(memory, sample, u, told);")
        with code.seeing(code.ahead.through(lambda sample: sample._replace(**_NOT_TOLD))):
            step = inner_step(inside, code, inner_loop)
        p = len(loop.outputs)
        edge = code.constant(
            "Edge",
            p=p,
            samples=1 + inside.horizon,
            bands=len(outputs),
            outputs=code.sizes(outputs),
            end=0 if self.edge == "lower" else 1,
        )
        line = code.memory(np.zeros((1 + inside.horizon, p)))
        return code.step(
            f"{draw_in}const Sample inside = follow_edge(&{edge}, {bands}, sample, {line});\n"
            f"{step}(memory, &inside, u, told);"
        )

    def _ahead_drawn_in(self, ahead: Ahead, first: int) -> Ahead:
        """Return what is ahead where bands that are drawn in stand in the memory, from a place on."""
        places, factors = _bands(ahead.places), _bands(ahead.factors)
        drawn_in = np.broadcast_to(self._is_band[:, np.newaxis], places.shape)
        places[drawn_in] = first + np.arange(np.count_nonzero(drawn_in))
        factors[drawn_in] = 1.0
        return ahead._replace(
            places=ahead.places._replace(band_now=places[0], band=places[1:]),
            factors=ahead.factors._replace(band_now=factors[0], band=factors[1:]),
        )

    def _told(self, loop: Loop) -> Loop:
        """Return the loop that the controller inside is told of."""
        return loop if self.edge == "both" else replace(loop, bands=(), charges=())

    def _line(self, reference: FloatArray, band: FloatArray) -> FloatArray:
        """Return references, shape (..., p): of a band its edge, drawn in, and at most its middle."""
        edge = self._drawn_in(band)[..., 0 if self.edge == "lower" else 1]
        return np.where(self._is_band, edge, reference)

    def _drawn_in(self, band: FloatArray) -> FloatArray:
        """Return bands, shape (..., p, 2), narrower by the margin on both sides, at least a line."""
        inside = np.minimum(self._margin, (band[..., 1] - band[..., 0]) / 2)
        return np.stack([band[..., 0] + inside, band[..., 1] - inside], axis=-1)


def _bands(sample: Sample) -> FloatArray:
    """Return the bands of a sample, now and ahead, shape (n + 1, p, 2)."""
    return np.concatenate([sample.band_now[np.newaxis], sample.band])
