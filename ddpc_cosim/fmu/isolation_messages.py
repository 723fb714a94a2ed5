"""What the master, the server and the isolated FMUs say to each other, apart from steps."""

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from ddpc_cosim.errors import CosimError
from ddpc_cosim.fmu.description import FMUDescription, Interface
from ddpc_cosim.variables import Variable

SAVE_STATE, RESTORE_STATE, FREE_STATES = "save_state", "restore_state", "free_states"

REQUEST = struct.Struct("=Bqq")
"""To the server: action, number of the request, process id."""

FORK, END = 1, 2


@dataclass(frozen=True, slots=True)
class Job:
    """What a child is started for: the session's arguments, and what the child takes over."""

    path: Path
    session: dict[str, Any]
    folder: Path
    working_directory: str
    environment: dict[str, str] = field(repr=False)


class Opened(NamedTuple):
    """What the master needs to know of a session that has been opened."""

    description: FMUDescription
    interface: Interface
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]


class Call(NamedTuple):
    """A method of the session to call."""

    method: str
    arguments: tuple[Any, ...]


class Reply(NamedTuple):
    """What a call returned or raised, and the session's time and warnings after it."""

    result: Any
    error: CosimError | None
    time: float = 0.0
    warnings: tuple[str, ...] = ()
