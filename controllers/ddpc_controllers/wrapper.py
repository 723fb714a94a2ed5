"""What the controllers about another controller share."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass

from ddpc_cosim import ConfigError, Controller, Loop, check_settings, setting


@dataclass(kw_only=True)
class Wrapper(Controller):
    """Base of the controllers that change what another one sees; what that needs, they need."""

    controller: Controller = setting(doc="the controller inside")

    def __post_init__(self) -> None:
        check_settings(self)
        if not isinstance(self.controller, Controller):
            raise ConfigError(
                f"{type(self).__name__}: controller = {self.controller!r} is no controller; "
                "an example is PID()"
            )
        self.horizon = self.controller.horizon

    @property
    def uses_recording(self) -> bool:  # type: ignore[override]  # its controller decides
        """Whether the controller needs a recording."""
        return self.controller.uses_recording

    @property
    def accepts_missing(self) -> bool:  # type: ignore[override]  # its controller decides
        """Whether the controller goes on when a measurement is lost."""
        return self.controller.accepts_missing

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return what the controller needs."""
        return self.controller.recording_length(inputs, outputs, measurements)

    def diagnostics(self) -> Mapping[str, float]:
        """Return the controller's figures."""
        return self._inner.diagnostics()

    def _start_inside(self, loop: Loop) -> None:
        """Start a copy of the controller: the setting stays as it was given."""
        self._inner = copy.deepcopy(self.controller)
        self._inner.start(loop)
