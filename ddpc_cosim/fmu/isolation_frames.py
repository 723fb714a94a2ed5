"""What goes through the pipes between a master and an isolated FMU.

Strictly one request, one reply. A step is a frame of fixed size, numbers only: tag, then step size and inputs
in a request, time and outputs in a reply. Everything else is a pickled object behind its length, which no
frame's tag can be.
"""

import pickle
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from ddpc_cosim.variables import FloatArray

STEP = -1
_LENGTH = struct.Struct("=q")

ReadInto = Callable[[memoryview], int]


class Frame:
    """Preallocated memory of a step's request or reply: seen as bytes, and as numbers.

    Parameters
    ----------
    count : int
        Number of inputs or outputs.
    """

    def __init__(self, count: int) -> None:
        self.size = 8 * (2 + count)
        self.memory = memoryview(bytearray(self.size))
        self._tag = self.memory.cast("q")
        self._scalars = self.memory.cast("d")
        self.values: FloatArray = np.frombuffer(self.memory, dtype=np.float64)[2:]

    @property
    def scalar(self) -> float:
        """Step size [s] in a request, time [s] in a reply."""
        return self._scalars[1]

    @scalar.setter
    def scalar(self, value: float) -> None:
        self._scalars[1] = value

    def mark(self) -> None:
        """Make it a step, after it held the beginning of a message."""
        self._tag[0] = STEP

    def is_step(self, received: int) -> bool:
        """Whether the bytes that were received are a step."""
        return self._tag[0] == STEP and received == self.size


def pack(message: object) -> bytes:
    """Return a message as bytes."""
    content = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    return _LENGTH.pack(len(content)) + content


def unpack(beginning: bytes, read_into: ReadInto) -> Any:
    """Return the message of which the beginning has been read.

    Raises
    ------
    EOFError
        The other side is gone.
    """
    head = beginning + _read(_LENGTH.size - len(beginning), read_into)
    (length,) = _LENGTH.unpack_from(head)
    content = head[_LENGTH.size :]
    return pickle.loads(content + _read(length - len(content), read_into))


def _read(count: int, read_into: ReadInto) -> bytes:
    buffer = bytearray(max(count, 0))
    rest = memoryview(buffer)
    while rest:
        received = read_into(rest)
        if not received:
            raise EOFError
        rest = rest[received:]
    return bytes(buffer)


def write_all(write: Callable[[memoryview], int | None], data: memoryview) -> None:
    """Write until everything is written."""
    while data:
        data = data[write(data) or 0 :]
