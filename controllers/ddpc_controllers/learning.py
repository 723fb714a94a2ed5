"""How a predictive controller feeds its own loop's samples to its data (Remarks 1 and 2)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ddpc_controllers.condensing import Condenser
from ddpc_controllers.online_data import ONLINE_MODES, OnlineData, OnlineMode
from ddpc_controllers.scaling import ScaledSignals
from ddpc_controllers.validation import per_signal
from ddpc_controllers.windows import WindowBuffer, WindowLayout
from ddpc_cosim import FloatArray, Weight, setting


class Learner:
    """The newest window of the loop, and the data that learn it.

    Parameters
    ----------
    buffer : WindowBuffer
        The newest window.
    data : OnlineData
        What learns.
    amplitude : array, shape (m,)
        Amplitude of the dither.
    rng : numpy.random.Generator
        Where the dither comes from.
    """

    def __init__(
        self, buffer: WindowBuffer, data: OnlineData, amplitude: FloatArray, rng: np.random.Generator
    ) -> None:
        self.data = data
        self._buffer, self._amplitude, self._rng = buffer, amplitude, rng
        self._dithers = bool(amplitude.any())

    def learn(self, **samples: FloatArray) -> None:
        """Take the loop's samples of all signals, shape (width,) each; learn the window they complete."""
        self._buffer.append(samples)
        window = self._buffer.column()
        if window is not None:
            self.data.learn(window)

    def add_dither(self, plan: FloatArray) -> None:
        """Add the dither to inputs, shape (samples, m), in place."""
        if self._dithers:
            plan += self._amplitude * self._rng.uniform(-1.0, 1.0, plan.shape)


@dataclass(kw_only=True)
class OnlineLearning(ScaledSignals):
    """The settings of controllers whose data can follow the plant.

    ``"sliding-window"`` replaces the oldest window by the newest, ``"forgetting"`` weighs all windows down by
    ``forgetting_factor`` per sample. In a quiet loop both would end up with data that predict nothing. A
    window after which the inputs excited less than ``excitation_floor`` times what the recording's do, and
    less than before, is therefore refused: the data stay as they are until the loop moves again. What is
    kept may be out of date: after a change of the plant a sliding window can stick with it, in a loop that
    stands still at an input limit for example. ``dither``, a uniform random signal on the inputs, keeps the
    windows coming; with it a sliding window has replaced its recording after T samples.
    """

    online_data: OnlineMode = setting("frozen", choices=ONLINE_MODES, doc="how the data follow the plant")
    forgetting_factor: float = setting(
        0.99, above=0.0, high=1.0, doc="what remains per sample of a window's weight, with forgetting"
    )
    excitation_floor: float = setting(
        0.005, low=0.0, high=1.0, doc="share of the recording's excitation below which the data are kept"
    )
    dither: Weight = setting(
        0.0, low=0.0, doc="amplitude of the random signal added to each input, in its unit; online data only"
    )

    def _online_faults(self, who: str) -> list[str]:
        faults = []
        if self.online_data == "forgetting" and self.forgetting_factor == 1.0:
            faults.append(f"{who}: forgetting_factor = 1 forgets nothing; use 0.9 to 0.9999")
        if self.online_data == "frozen" and np.any(self.dither):
            faults.append(f"{who}: dither = {self.dither!r} excites for online_data, which is 'frozen'")
        return faults

    def _make_learner(
        self,
        condenser: Condenser,
        data: FloatArray,
        layout: WindowLayout,
        signals: Mapping[str, FloatArray],
        continues: bool,
        rng: np.random.Generator,
    ) -> Learner:
        """Return what learns, starting from a recording's stacked data M.

        Parameters
        ----------
        condenser, data
            The problem and the data that it meets first.
        layout, signals
            How the recorded signals, shape (T, width) each, make up these data.
        continues : bool
            The loop's first sample follows the recording's last.
        rng : numpy.random.Generator
            Where the dither comes from.

        Raises
        ------
        ConfigError
            ``dither`` does not fit the number of inputs.
        """
        widths = {name: values.shape[1] for name, values in signals.items()}
        amplitude = per_signal("dither", self.dither, widths["u"]) / self._scales.u
        keep = self.forgetting_factor if self.online_data == "forgetting" else 1.0
        rows = layout.rows_of("u", widths)
        online = OnlineData(data, condenser.regularisation, rows, keep, self.excitation_floor)
        return Learner(WindowBuffer(layout, signals, continues), online, amplitude, rng)
