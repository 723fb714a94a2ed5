"""Following an edge of the band by any tracking controller: the usual way to spend little, with a margin."""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from ddpc_controllers.checks import per_signal
from ddpc_controllers.wrapper import SingleWrapper
from ddpc_cosim import Action, FloatArray, Loop, Sample, Weight, setting

Edge = Literal["lower", "upper"]
EDGES: tuple[str, ...] = get_args(Edge)


@dataclass(kw_only=True)
class BandEdge(SingleWrapper):
    """A controller that follows an edge of each band, drawn in by a margin, and is told no price.

    Where the band is narrower than the margin it follows the middle of the band. Outputs that are wanted at a
    reference are controlled as ever.
    """

    edge: Edge = setting("lower", choices=EDGES, doc="the edge: of a room that is heated the lower one")
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
        self._start_inside(replace(loop, bands=(), charges=()))

    def step(self, sample: Sample) -> Action:
        """Return the controller's inputs for references at the edges."""
        if not self._is_band.any():
            return self._inner.step(sample)
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
        lower, upper = band[..., 0], band[..., 1]
        inside = np.minimum(self._margin, (upper - lower) / 2)
        edge = lower + inside if self.edge == "lower" else upper - inside
        return np.where(self._is_band, edge, reference)
