"""Linear models from an FMU: by the derivatives of its equations, or by pulses at its inputs.

An FMU for Model Exchange has directional derivatives of its states' derivatives and its outputs, or can be
evaluated near the operating point. From any other, or where its inputs act through discrete states, pulses
make a sampled model.

They serve any :class:`~ddpc_cosim.Plant`, an FMU or one written in Python, of which only ``reset`` and
``step`` are used (and ``restore_state``, where it can return to the operating point). A pulse of one sample
at each input, up and down, gives the impulse response at an operating point by central differences. Its
balanced realisation is the model (J.-N. Juang, R. S. Pappa, J. Guidance 8(5), 1985, doi:10.2514/3.20031). A
controller gets it through :class:`FMUModel` or :class:`~ddpc_controllers.models.linear.ModelFunction`.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from ddpc_controllers.data.hankel import hankel_matrix, numerical_rank
from ddpc_controllers.models.control_api import realise
from ddpc_controllers.models.identification import reduced
from ddpc_controllers.models.linear import ModelSource, SampledModel, StateSpace
from ddpc_cosim import (
    ConfigError,
    CosimWarning,
    FloatArray,
    Loop,
    Plant,
    check_settings,
    setting,
)

if TYPE_CHECKING:
    from ddpc_cosim import FMUPlant

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


Derivatives = Literal["auto", "directional", "differences", "pulses"]
_CHOICES: tuple[str, ...] = get_args(Derivatives)


@dataclass(frozen=True, kw_only=True)
class FMUModel(ModelSource):
    """The linear model of an FMU about an operating point.

    The FMU may be the one that is controlled: it is opened for this, on its own, and closed again. Its inputs
    and outputs of the same names as the loop's are taken.
    """

    fmu: str = setting(
        "{plant}", file=True, doc='path of the FMU; in a study, "{plant}" is the FMU that the study controls'
    )
    derivatives: Derivatives = setting(
        "auto",
        choices=_CHOICES,
        doc="the FMU's directional ones, differences near the point, or pulses; auto: the first it can",
    )
    operating_input: Sequence[float] = setting((), doc="inputs there; empty: the FMU's start values")
    settling_time: float = setting(0.0, low=0.0, unit="s", doc="time for which they are held to get there")
    parameters: Mapping[str, Any] = setting(default_factory=dict, doc="parameters of the FMU, by name")
    order: int = setting(0, low=0, doc="states kept by balanced reduction; 0: all")
    isolated: bool = setting(True, doc="open the FMU in a process of its own")

    def __post_init__(self) -> None:
        check_settings(self)
        if not isinstance(self.fmu, str) or not self.fmu:
            raise ConfigError(f"FMUModel: fmu = {self.fmu!r} is not a path of an FMU")

    def model(self, loop: Loop) -> SampledModel:
        """Linearise the FMU; see :class:`~ddpc_controllers.models.linear.ModelSource`.

        Raises
        ------
        FMUImportError
            The FMU cannot be loaded.
        FMUStepError
            It fails at the operating point or near it.
        ConfigError
            It has no such inputs or outputs, or cannot be linearised as it is asked for.
        """
        model = self._pulsed(loop).model(loop) if self._by_pulses(loop) else self._differentiated(loop)
        return reduced(model, self.order)

    def _by_pulses(self, loop: Loop) -> bool:
        if self.derivatives != "auto":
            return self.derivatives == "pulses"
        with self._open(loop, "auto") as plant:
            return not plant.can_linearise

    def _pulsed(self, loop: Loop) -> StateSpace:
        with self._open(loop, "auto") as plant:
            return pulse_model(
                plant,
                loop.sampling_time,
                operating_input=self._inputs(plant, len(loop.inputs)).tolist(),
                settling_samples=math.ceil(self.settling_time / loop.sampling_time),
                parameters=self.parameters,
            )

    def _differentiated(self, loop: Loop) -> SampledModel:
        with self._open(loop, "model-exchange") as plant:
            u_0 = self._inputs(plant, len(loop.inputs))
            plant.reset(self.parameters)
            if self.settling_time > 0.0:
                plant.step(u_0, self.settling_time)
            kind: Any = self.derivatives
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", CosimWarning)  # it goes with the model
                linear = plant.linearise(u_0, derivatives=kind)
        return replace(StateSpace.about(linear).model(loop), warnings=linear.warnings)

    def _inputs(self, plant: Plant, driven: int) -> FloatArray:
        """Return the inputs at the operating point, and after those driven the known disturbances."""
        start = [variable.start for variable in plant.inputs]
        given = np.array(self.operating_input or start, dtype=np.float64)
        given = np.append(given, start[len(given) :] if len(given) == driven else [])
        if given.shape != (len(start),):
            raise ConfigError(
                f"FMUModel: operating_input has shape {given.shape}; needed: {len(start)} numbers"
            )
        return given

    def _open(self, loop: Loop, fmi_type: Any) -> "FMUPlant":
        from ddpc_cosim import FMUPlant

        if self.fmu == "{plant}":
            raise ConfigError('FMUModel: only studies know what fmu = "{plant}" is; give the path of an FMU')
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CosimWarning)  # whoever uses the FMU as a plant is told
            try:
                plant = FMUPlant(
                    self.fmu,
                    inputs=[variable.name for variable in (*loop.inputs, *loop.disturbances)],
                    outputs=[variable.name for variable in loop.outputs],
                    fmi_type=fmi_type,
                    isolated=self.isolated,
                )
            except ConfigError as error:
                if not loop.disturbances:
                    raise
                names = ", ".join(variable.name for variable in loop.disturbances)
                what = f"the FMU's inputs have to include the known disturbances ({names})"
                remedy = "a model identified from a recording knows measured ones, too"
                raise ConfigError([*error.faults, f"FMUModel: {what}; {remedy}"]) from error
        faults = _other_units(loop, plant)
        if faults:
            plant.close()
            raise ConfigError(faults)
        return plant


def _other_units(loop: Loop, plant: Plant) -> list[str]:
    """Return which signals of the loop are not in the FMU's units: its model would not be theirs."""
    seen = (*loop.inputs, *loop.disturbances, *loop.outputs)
    pairs = zip(seen, (*plant.inputs, *plant.outputs), strict=True)
    return [
        f'FMUModel: "{modelled.name}" is in {modelled.unit} in the FMU and in {seen.unit or "no unit"} '
        "in the loop, which is scaled or another plant's"
        for seen, modelled in pairs
        if modelled.unit and seen.unit != modelled.unit
    ]
