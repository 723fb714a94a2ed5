"""Linear models from a plant itself, by finite differences of what it answers to pulses.

Any :class:`~ddpc_cosim.Plant` will do: an FMU, or one written in Python. Nothing but ``reset`` and ``step``
is asked of it (and where it can, ``restore_state`` to return to the operating point), and no state is seen:
a pulse of one sample at each input, up and down, gives the impulse response at an operating point by central
differences; its balanced realisation is the model (J.-N. Juang, R. S. Pappa, J. Guidance 8(5), 1985,
doi:10.2514/3.20031). A controller gets it through :class:`~ddpc_controllers.fmu_model.FMUModel` or
:class:`~ddpc_controllers.models.ModelFunction`.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from ddpc_controllers.behavioral import hankel_matrix, numerical_rank
from ddpc_controllers.control_api import realise
from ddpc_controllers.models import StateSpace
from ddpc_cosim import ConfigError, FloatArray, Plant

_VISIBLE = 1e-6


def pulse_model(
    plant: Plant,
    sampling_time: float,
    *,
    order: int = 0,
    samples: int = 40,
    pulse: float = 1e-3,
    operating_input: Sequence[float] = (),
    settling_samples: int = 0,
    parameters: Mapping[str, float] | None = None,
) -> StateSpace:
    """Return the linear model of a plant at an operating point.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset here, and stays open.
    sampling_time : float
        Time between samples [s].
    order : int
        Number of states; 0: as many as the response shows.
    samples : int
        Length of the response; at least twice the order and one.
    pulse : float
        Height of the pulses, in parts of the inputs' nominal values.
    operating_input : sequence of float
        Inputs at the operating point; empty: their start values.
    settling_samples : int
        Samples for which they are held before the pulse, so that the plant comes to rest.
    parameters : mapping of str to float, optional
        Parameters of the plant.

    Returns
    -------
    model : StateSpace
        Sampled, with the operating point.

    Raises
    ------
    ConfigError
        The outputs do not answer the pulses, or do not show as many states.
    """
    u_0 = np.array(operating_input or [variable.start for variable in plant.inputs], dtype=np.float64)
    if u_0.shape != (len(plant.inputs),):
        raise ConfigError(
            f"pulse_model: operating_input has shape {u_0.shape}; needed: {len(plant.inputs)} numbers"
        )

    def settle() -> None:
        plant.reset(parameters)
        for _ in range(settling_samples):
            plant.step(u_0, sampling_time)

    settled = None
    if plant.can_save_state:
        settle()
        settled = plant.save_state()

    def response(change: FloatArray) -> FloatArray:
        if settled is None:
            settle()
        else:
            plant.restore_state(settled)
        rows = [plant.step(u_0 + change, sampling_time)]
        rows += [plant.step(u_0, sampling_time) for _ in range(samples - 1)]
        return np.array(rows)

    heights = pulse * np.array([abs(variable.nominal) for variable in plant.inputs])
    changes = np.diag(heights)
    columns = [
        (response(change) - response(-change)) / (2.0 * height)
        for change, height in zip(changes, heights, strict=True)
    ]
    markov = np.stack(columns, axis=-1)  # time, output, input
    states = _states_shown(markov)
    if states < max(order, 1):
        raise ConfigError(
            f"pulse_model: the response of {samples} samples shows {states} states, {max(order, 1)} are "
            "wanted: take more samples, higher pulses or a lower order"
        )
    a, b, c = realise(markov, order or states)
    return StateSpace(
        a=a.tolist(),
        b=b.tolist(),
        c=c.tolist(),
        sampling_time=sampling_time,
        u_0=u_0.tolist(),
        y_0=response(np.zeros_like(u_0))[-1].tolist(),
    )


def _states_shown(markov: FloatArray) -> int:
    """Return the rank of the block Hankel matrix of an impulse response."""
    inputs, depth = markov.shape[2], len(markov) // 2
    columns = [hankel_matrix(markov[: 2 * depth - 1, :, i], depth) for i in range(inputs)]
    return numerical_rank(np.hstack(columns), _VISIBLE)
