"""Inputs at rest: what doing nothing costs, a reference point of comparisons."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import ClassVar

from ddpc_controllers.checks import prior_info, without_forecast
from ddpc_controllers.data.hankel import resting_input
from ddpc_controllers.export.code import ALL_AHEAD, Code, Exportable
from ddpc_cosim import FloatArray, Loop, Sample


@dataclass(kw_only=True)
class Idle(Exportable):
    """Inputs at rest, independent of measurements and references."""

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD
    _follows_in_c: ClassVar[bool] = True

    accepts_missing: ClassVar[bool] = True

    def start(self, loop: Loop) -> None:
        """Take the inputs' start values, within their limits."""
        self._u = resting_input(loop)

    def step(self, sample: Sample) -> FloatArray:
        """Return the inputs at rest, shape (m,)."""
        return self._u.copy()

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return that it uses no signals."""
        return without_forecast(prior_info("nothing"), loop)

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the inputs at rest."""
        return code.step(f"memcpy(u, {code.memory(self._u)}, {len(self._u)} * sizeof(double));")
