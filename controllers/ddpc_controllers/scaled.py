"""Scaled signals for any controller: a wrapper for those that do not scale them by themselves."""

from dataclasses import dataclass

from ddpc_controllers.qp import InputLimits
from ddpc_controllers.scaling import ScaleBy, Scales
from ddpc_controllers.wrapper import Wrapper
from ddpc_cosim import Action, FloatArray, Loop, Sample, setting


@dataclass(kw_only=True)
class Scaled(Wrapper):
    """A controller in scaled signals. The origin stays where it is: linear methods stay linear.

    For controllers whose gains are in the units of the plant (PID), and for those of others; the methods that
    weigh errors scale them by their own ``scaling``.
    """

    scale_by: ScaleBy = setting(
        "range",
        choices=("range", "nominal"),
        doc="unit of a signal: half its range where it has one, else its nominal value; or always the latter",
    )

    def start(self, loop: Loop) -> None:
        """Start the controller on the scaled loop.

        Raises
        ------
        ConfigError
            A signal has neither a range nor a nominal value.
        CosimError
            The controller does not start.
        """
        self._scales = Scales.of(loop, self.scale_by)
        self._limits = InputLimits(loop.bounds.u_min, loop.bounds.u_max)
        self._start_inside(self._scales.scaled_loop(loop))

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the controller's inputs in their own units."""
        return self._scales.in_units(self._inner.step(self._scales.scaled_sample(sample)), self._limits)
