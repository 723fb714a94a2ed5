"""Keeping a margin to the band: by following an edge of it, the usual way to spend little, or within both."""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from ddpc_controllers.checks import per_signal
from ddpc_controllers.wrapper import SingleWrapper
from ddpc_cosim import Action, FloatArray, Loop, Sample, Weight, setting

Edge = Literal["lower", "upper", "both"]
EDGES: tuple[str, ...] = get_args(Edge)


@dataclass(kw_only=True)
class BandEdge(SingleWrapper):
    """A controller that follows an edge of each band, drawn in by a margin, and is told no price.

    Where the band is narrower than the margin it follows the middle of the band. Outputs that are wanted at a
    reference are controlled as ever. With both edges the band stays one, drawn in, and prices are told: noise
    and errors of model and forecast take up the margin first.
    """

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
        told = loop if self.edge == "both" else replace(loop, bands=(), charges=())
        self._start_inside(told)

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

    def _line(self, reference: FloatArray, band: FloatArray) -> FloatArray:
        """Return references, shape (..., p): of a band its edge, drawn in, and at most its middle."""
        edge = self._drawn_in(band)[..., 0 if self.edge == "lower" else 1]
        return np.where(self._is_band, edge, reference)

    def _drawn_in(self, band: FloatArray) -> FloatArray:
        """Return bands, shape (..., p, 2), narrower by the margin on both sides, at least a line."""
        inside = np.minimum(self._margin, (band[..., 1] - band[..., 0]) / 2)
        return np.stack([band[..., 0] + inside, band[..., 1] - inside], axis=-1)
