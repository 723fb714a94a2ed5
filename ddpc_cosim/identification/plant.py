"""A plant that plays an identified model, with the noise that the data left."""

from collections.abc import Mapping, Sequence
from typing import Literal, cast

import numpy as np

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.durations import in_words
from ddpc_cosim.identification.innovation import PlantModel
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.variables import FloatArray, Variable

_MULTIPLE = 1e-6
"""How far a sampling time may be from a multiple of the model's, in parts of that."""
_STREAMS = {"experiment": 1, "loop": 0}


class IdentifiedPlant(Plant):
    """A model from data as a plant.

    Its noise is drawn from the seed, the run and the number of the sample alone: whatever controls it, it is
    the same. What is recorded in an experiment has another noise than the loop that follows.

    Parameters
    ----------
    model : PlantModel
        The model.
    inputs, outputs : sequence of Variable
        Its inputs, disturbances after those that are driven, and outputs. It starts at rest at the start
        values of the inputs.
    seed : int, optional
        Of the noise; default: there is none.
    state : array, shape (n,), optional
        The state that it starts in, in place of that at rest.
    records : bool
        Whether its first run is an experiment, which is not the run that is judged.
    facts : mapping of str to str, optional
        What a report is to say of it.
    """

    state_is_data = True
    is_sampled = True

    def __init__(
        self,
        model: PlantModel,
        inputs: Sequence[Variable],
        outputs: Sequence[Variable],
        *,
        seed: int | None = None,
        state: FloatArray | None = None,
        records: bool = False,
        facts: Mapping[str, str] | None = None,
    ) -> None:
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        self._model, self._seed, self._start = model, seed, state
        self.is_noisy = seed is not None
        self._facts, self._driven = dict(facts or {}), len(model.u_0)
        self._run: Literal["experiment", "loop"] = "experiment" if records else "loop"
        self._next: Literal["experiment", "loop"] = self._run
        # eigh, as a covariance of few data can be singular.
        values, vectors = np.linalg.eigh(model.covariance)
        self._spread: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))
        self._x, self._k, self._noise = np.empty(0), 0, np.empty(0)

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Check that the sampling time is an integer multiple of the model's."""
        self._steps(sampling_time)

    def _steps(self, h: float) -> int:
        sampling_time = self._model.sampling_time
        if fault := sampling_fault(h, sampling_time):
            raise ConfigError(fault)
        return round(h / sampling_time)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Go to the initial state and return the outputs there, shape (p,); it has no parameters."""
        if parameters:
            raise ConfigError(
                f"a plant identified from data has no parameters ({', '.join(parameters)}); leave them out"
            )
        self._run, self._next = self._next, "loop"
        u, d = self._split(np.array([variable.start for variable in self.inputs]))
        self._x = self._model.rest(u, d) if self._start is None else self._start.copy()
        self._k = 0
        return self._output()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs, disturbances after them, over h [s] and return the outputs at its end."""
        driven, disturbances = self._split(u)
        for _ in range(self._steps(h)):
            self._x = self._model.next_state(self._x, driven, disturbances, self._noise)
            self._k += 1
            y = self._output()
        return y

    def _split(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        return inputs[: self._driven], inputs[self._driven :]

    def _output(self) -> FloatArray:
        """Draw the noise of this sample and return the outputs with it."""
        if self._seed is None:
            self._noise = np.zeros(len(self.outputs))
        else:
            rng = np.random.default_rng((self._seed, _STREAMS[self._run], self._k))
            self._noise = self._spread @ rng.standard_normal(len(self.outputs))
        return self._model.output(self._x) + self._noise

    @property
    def can_save_state(self) -> bool:
        """Whether its state can be saved: it can."""
        return True

    def save_state(self) -> object:
        """Return the state, the number of the sample and the run, from which the noise follows."""
        return self._x.copy(), self._k, self._run, self._noise.copy()

    def restore_state(self, state: object) -> None:
        """Go back to a state."""
        x, self._k, self._run, noise = cast(
            'tuple[FloatArray, int, Literal["experiment", "loop"], FloatArray]', state
        )
        self._x, self._noise = np.array(x), np.array(noise)

    def provenance(self) -> Mapping[str, str]:
        """Return what is to be said of the model."""
        return self._facts


def sampling_fault(sampling_time: float, own: float) -> str:
    """Return why a loop cannot be sampled so with a model of this sampling time; empty: it can."""
    ratio = sampling_time / own
    if round(ratio) >= 1 and abs(ratio - round(ratio)) <= _MULTIPLE:
        return ""
    remedy = (
        f"needed: {in_words(own)} or an integer multiple of it; or give the models another sampling time "
        "(plant.identified.sampling_time), as far as the files have samples so close"
    )
    what = f"{in_words(sampling_time)} between samples, and the plant is identified at {in_words(own)}"
    return f"{what}; {remedy}"
