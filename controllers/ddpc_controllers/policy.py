"""A policy as a controller: a function of what is seen at a sample, trained elsewhere, in an ONNX file.

What it is given is the observation of the problem as an environment (:mod:`ddpc_cosim.gymnasium`), what it
returns are the inputs, in the plant's units.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from os import devnull
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ddpc_controllers.checks import fill_missing, prior_info
from ddpc_cosim import (
    OK,
    Action,
    ConfigError,
    Controller,
    ControllerError,
    Loop,
    MissingLibraryError,
    Observation,
    Sample,
    check_settings,
    setting,
)
from ddpc_cosim.conditions import HELD
from ddpc_cosim.files.texts import printable

_NUMBERS = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_LONGEST_REASON = 300
_AS_ONE_FILE = "needed: one file, as onnx.save_model(onnx.load(FILE), FILE) writes it"


def preload() -> None:
    """Import what takes a second, once for all workers of a study."""
    _runtime()


def _runtime() -> Any:
    """Return ONNX Runtime; MissingLibraryError: it is not installed."""
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingLibraryError.of("Policy", "ONNX Runtime", "gym") from error
    return onnxruntime


@dataclass(frozen=True, kw_only=True)
class Training:
    """How a policy was trained, which the report states."""

    steps: int = setting(low=1, doc="steps of environments in all episodes")
    seeds: str = setting(doc='seeds of these episodes, such as "100:132"')
    by: str = setting(doc="the method, such as PPO")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(kw_only=True)
class Policy(Controller):
    """A function of what is seen at a sample, in an ONNX file.

    Its one input is the observation, n numbers in the order and the units of :class:`ddpc_cosim.Observation`,
    its first output the m inputs of the plant, each of shape (n,) or (1, n) and of 32 or 64 bits. Inputs
    beyond their limits are clipped, as an environment clips actions. For a missing measurement the last one
    that has arrived stands in.
    """

    accepts_missing: ClassVar[bool] = True

    file: str = setting(file=True, doc="path of the ONNX file")
    horizon: int = setting(1, low=0, doc="samples ahead that it sees: `horizon` of the environment")
    training: Training | None = setting(
        None, kind=Training, doc="how it was trained, a table of `steps`, `seeds` and `by`; none: not known"
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if not isinstance(self.training, Training | None):
            needed = "needed: a Training, of steps, seeds and by"
            raise ConfigError(f"Policy: training = {self.training!r} is not possible; {needed}")
        self._open()

    def _open(self) -> None:
        """Load the file, and check all that can be checked without a loop."""
        runtime = _runtime()
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.use_deterministic_compute = True
        options.log_severity_level = 4  # what is wrong is raised, too
        # It cannot lead to other files, which no case's id would know: they are looked for where none can be.
        options.add_session_config_entry("session.model_external_initializers_file_folder_path", devnull)
        name = Path(self.file).name
        try:
            content = Path(self.file).read_bytes()
            session = runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except OSError as error:
            raise ConfigError(f"{self.file}: cannot be read: {error.strerror}") from error
        except Exception as error:  # its errors have no common base class
            reason = printable(str(error))[:_LONGEST_REASON]
            if "external data" in reason.lower():
                reason = f"some of its numbers lie in another file; {_AS_ONE_FILE}"
            raise ConfigError(f"{name}: ONNX Runtime cannot load it: {reason}") from error
        inputs, outputs = session.get_inputs(), session.get_outputs()
        faults = []
        if len(inputs) != 1:
            faults.append(f"it has {len(inputs)} inputs; needed: one, the observation")
        for what, tensor in (*(("input", i) for i in inputs), *(("output", o) for o in outputs[:1])):
            if tensor.type not in _NUMBERS:
                faults.append(f"{what} {printable(tensor.name)} is a {tensor.type}; needed: float or double")
            if len(tensor.shape) not in (1, 2) or (
                len(tensor.shape) == 2 and isinstance(tensor.shape[0], int) and tensor.shape[0] != 1
            ):
                shape = f"shape {_words(tensor.shape)}; needed: (n,) or (1, n)"
                faults.append(f"{what} {printable(tensor.name)}: {shape}")
        if faults:
            raise ConfigError([f"{name}: {fault}" for fault in faults])
        self._session, self._input, self._output = session, inputs[0], outputs[0]

    def start(self, loop: Loop) -> None:
        """Take the layout of the observation.

        Raises
        ------
        ConfigError
            The file takes or returns another number of signals, by name.
        """
        observation = Observation(loop, self.horizon)
        faults = []
        for what, tensor, variables in (
            ("takes", self._input, observation.variables),
            ("returns", self._output, loop.inputs),
        ):
            size = tensor.shape[-1]
            if isinstance(size, int) and size != len(variables):
                listed = ", ".join(variable.header for variable in variables)
                faults.append(f"it {what} {size} numbers; the loop has {len(variables)}: {listed}")
        if faults:
            hint = f"; what is seen ahead is up to horizon = {self.horizon}"
            raise ConfigError([f"{Path(self.file).name}: {fault}{hint}" for fault in faults])
        self._observation, self._loop = observation, loop
        self._shape = (1, -1) if len(self._input.shape) == 2 else (-1,)
        self._last = np.array([variable.start for variable in observation.variables])

    def step(self, sample: Sample) -> Action:
        """Return what the policy does, within the limits, shape (m,)."""
        seen = fill_missing(self._observation.of(sample), self._last)
        is_missing = not np.isfinite(sample.y).all() or not np.isfinite(sample.measured).all()
        self._last = seen
        given = seen.astype(_NUMBERS[self._input.type]).reshape(self._shape)
        try:
            u, *_ = self._session.run([self._output.name], {self._input.name: given})
        except Exception as error:  # its errors have no common base class
            reason = printable(str(error))[:_LONGEST_REASON]
            listed = ", ".join(variable.header for variable in self._observation.variables)
            what = f"{reason}; it was given {given.size} numbers: {listed}"
            raise ControllerError(f"{Path(self.file).name}: ONNX Runtime: {what}") from error
        u = u.ravel().astype(np.float64)
        if u.shape != (len(self._loop.inputs),) or not np.isfinite(u).all():
            what = f"the policy returned {u.tolist()[:10]}"
            needed = f"{len(self._loop.inputs)} finite numbers"
            raise ControllerError(f"{Path(self.file).name}: {what}; needed: {needed}")
        bounds = self._loop.bounds
        low, high = bounds.u_min, bounds.u_max
        if self._loop.moving_limits:
            low, high = sample.input_limits[0].T
        return Action(np.clip(u, low, high), HELD if is_missing else OK)

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return how it was trained."""
        prior = "what its file was trained with, which is not told"
        if (training := self.training) is not None:
            budget = f"{training.steps:,} steps on seeds {training.seeds}".replace(",", " ")
            prior = f"what its file was trained with: {budget}, by {training.by}"
        return prior_info(prior, loop.outputs, loop.measurements)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what ONNX Runtime holds, which can be loaded again."""
        return {name: value for name, value in vars(self).items() if name not in _OF_SESSION}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._open()


_OF_SESSION = ("_session", "_input", "_output")


def _words(shape: list[Any]) -> str:
    return f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
