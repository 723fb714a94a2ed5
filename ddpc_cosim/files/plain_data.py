"""Plain data as bytes and back: numbers, texts, bytes, arrays of numbers; tuples, lists and dicts of these.

What is read may come from anyone: reading it makes nothing else than that, and runs nothing.
"""

import base64
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ddpc_cosim.errors import ConfigError, CosimError

_NUMBERS = "biufc"
# What using data raises that are not what they should be.
_MISFITS = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


def to_bytes(value: object) -> bytes:
    """Return plain data as bytes.

    Raises
    ------
    ConfigError
        There is something else in it.
    """
    return json.dumps(_written(value), separators=(",", ":")).encode()


def from_bytes(content: bytes) -> Any:
    """Return what :func:`to_bytes` was given; ValueError: it is something else."""
    try:
        return json.loads(content, object_hook=_read)
    except _MISFITS as error:
        raise ValueError("it is not plain data") from error


@contextmanager
def understood(what: str) -> Iterator[None]:
    """Say of what is made of such data, where something of it does not fit, that it does not.

    Raises
    ------
    ConfigError
        It does not.
    """
    try:
        yield
    except CosimError:
        raise
    except _MISFITS as error:
        raise ConfigError(f"{what} is not one of this plant: {type(error).__name__}: {error}") from error


def _written(value: object) -> Any:
    kind = type(value)
    if isinstance(value, np.generic):
        return _written(value.item())
    if kind in (bool, int, float, str) or value is None:
        return value
    if isinstance(value, bytes):
        return {"bytes": base64.b64encode(value).decode()}
    if isinstance(value, np.ndarray) and value.dtype.kind in _NUMBERS:
        content = base64.b64encode(value.tobytes()).decode()
        return {"array": content, "type": value.dtype.str, "shape": value.shape}
    if kind is list or kind is tuple:
        items = list(map(_written, value))  # type: ignore[call-overload]
        return items if kind is list else {"tuple": items}
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {"dict": {f"_{key}": _written(item) for key, item in value.items()}}
    raise ConfigError(
        f"a state with an object of type {kind.__name__} is not plain data; allowed: numbers, texts, bytes, "
        "arrays of numbers, and tuples, lists and dicts (whose keys are texts) of these"
    )


def _read(tagged: dict[str, Any]) -> Any:
    """Return what an object of JSON stands for; the entries of a dict have their own objects read before."""
    if "bytes" in tagged:
        return base64.b64decode(tagged["bytes"], validate=True)
    if "array" in tagged:
        kind = np.dtype(tagged["type"])
        if kind.kind not in _NUMBERS:
            raise ValueError(f"an array of {kind}")
        numbers = np.frombuffer(base64.b64decode(tagged["array"], validate=True), kind)
        return numbers.reshape(tagged["shape"]).copy()
    if "tuple" in tagged:
        return tuple(tagged["tuple"])
    if "dict" in tagged:
        return tagged["dict"]
    return {key[1:]: item for key, item in tagged.items()}
