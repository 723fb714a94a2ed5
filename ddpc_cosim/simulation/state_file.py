"""The state of a plant in a file: sealed, with what it is a state of; nothing in it is ever executed here."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.plugins import package_version
from ddpc_cosim.study.case_files import DAMAGED, read_sealed, sealed_json
from fmu_plants.files import write_atomically

_FORMAT = "ddpc-cosim plant state 1"
_LONGEST_FILE = 1 << 30


@dataclass(frozen=True, slots=True)
class PlantState:
    """A plant at the last sample of a simulation.

    Parameters
    ----------
    plant : str
        What it is called.
    content : str
        What decides its behaviour: the SHA-256 of an FMU, or a class with a hash of its source.
    platform : str
        What its FMUs run on; empty: there are none.
    reset_time : float
        When the plant was reset [s].
    start_time, sampling_time : float
        The samples that it is one of [s].
    samples : int
        Its number among them.
    parameters : mapping of str to float, int, bool or str
        What it was reset with.
    changed : mapping of str to float, int, bool or str
        What was changed since.
    inputs : mapping of str to float
        The inputs that were driven, as they were last, in their units.
    state : bytes
        What the plant made of itself.
    """

    plant: str
    content: str
    platform: str
    reset_time: float
    start_time: float
    sampling_time: float
    samples: int
    parameters: Mapping[str, ParameterValue]
    changed: Mapping[str, ParameterValue]
    inputs: Mapping[str, float]
    state: bytes

    @property
    def time(self) -> float:
        """When it was saved [s]."""
        return self.start_time + self.samples * self.sampling_time

    @property
    def values(self) -> dict[str, ParameterValue]:
        """The parameters as they are now, of which nothing is known where nothing was said."""
        return {**self.parameters, **self.changed}

    def faults(self, plant: str, content: str, platform: str) -> list[str]:
        """Return why it is not a state of a plant; empty if it is."""
        if self.content != content:
            whose = f"it is of {self.plant} ({self.content}), and this is {plant} ({content})"
            remedy = (
                "give the plant that it was saved of, unchanged and run as then, or save a state of this one"
            )
            return [f"the state is not one of this plant: {whose}; {remedy}"]
        if self.platform != platform:
            where = f"it was saved on {self.platform or 'any'}, and this is {platform or 'any'}"
            return [f"the state is of another platform: {where}; save a state of the plant here"]
        return []

    def write(self, path: Path) -> None:
        """Write it as a whole.

        Raises
        ------
        ConfigError
            It cannot be written.
        """
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__}
        content = {"format": _FORMAT, "version": package_version(), "time": self.time, **fields}
        content |= {name: dict(fields[name]) for name in ("parameters", "changed", "inputs")}
        content["state"] = base64.b64encode(self.state).decode()
        try:
            write_atomically(path, sealed_json(content))
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from error

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file.

        Raises
        ------
        ConfigError
            It is not there, not such a file, damaged, or one of another version.
        """
        remedy = "save the state again (simulate --save-state)"
        try:
            if path.stat().st_size > _LONGEST_FILE:
                raise ValueError(f"it has more than {_LONGEST_FILE} bytes")
            content = read_sealed(path)
            written = content.get("format")
            if written != _FORMAT:
                version = f'it is "{str(written)[:100]}", and this version reads "{_FORMAT}"'
                raise ConfigError(f"{path}: is not a state that can be read: {version}; {remedy}")
            return cls._of(content)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
        except (*DAMAGED, ArithmeticError) as error:
            raise ConfigError(f"{path}: is not a state, or is damaged: {error}; {remedy}") from error

    @classmethod
    def _of(cls, content: Mapping[str, Any]) -> Self:
        """Return what a file says; one of DAMAGED: it is not all there, or not what it should be."""
        state = cls(
            plant=str(content["plant"]),
            content=str(content["content"]),
            platform=str(content["platform"]),
            reset_time=float(content["reset_time"]),
            start_time=float(content["start_time"]),
            sampling_time=float(content["sampling_time"]),
            samples=int(content["samples"]),
            parameters=_values(content["parameters"]),
            changed=_values(content["changed"]),
            inputs={name: float(value) for name, value in content["inputs"].items()},
            state=base64.b64decode(content["state"], validate=True),
        )
        if not (state.sampling_time > 0 and state.samples >= 0 and abs(state.time) < float("inf")):
            raise ValueError(f"a state at {state.time:g} s")
        return state


def _values(content: Mapping[str, Any]) -> dict[str, ParameterValue]:
    wrong = [name for name, value in content.items() if not isinstance(value, float | int | str)]
    if wrong:
        raise ValueError(f"a value of {wrong[0]} that is neither a number nor a text")
    return dict(content)
