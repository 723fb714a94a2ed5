"""A record of every FMI call: arguments, status and results, one line for each, complete up to a crash.

A line is begun before the call and ended after it, each with one unbuffered write: the last line of an FMU
that has brought its process down is the call in which it did. ::

    fmi2SetReal(c=0x55d0, vr=[0], nvr=1, value=[1.0]) -> ok
    fmi2CompletedIntegratorStep(c=0x55d0, noSetFMUStatePriorToCurrentPoint=1) -> ok; enterEventMode=0; ...
    fmi2GetReal(c=0x55d0, vr=[1], nvr=1) -> ok; value=[0.095]
"""

import ctypes
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ddpc_cosim.fmu.status import status_word

_MOST_SHOWN, _LONGEST_TEXT = 20, 200
_POINTER: Any = type(ctypes.byref(ctypes.c_int()))


class TracedFunction:
    """A function of an FMU's library whose calls are written to a file.

    Parameters
    ----------
    name : str
        The name of the function.
    arguments : sequence of str
        The names of its arguments.
    function : Any
        The function, with its types.
    path : Path
        The file, which is appended to: several instances may share it.
    """

    def __init__(self, name: str, arguments: Sequence[str], function: Any, path: Path) -> None:
        self._name, self._arguments, self._function, self._path = name, arguments, function, path
        self.restype, self.argtypes = function.restype, function.argtypes

    def __call__(self, *values: Any) -> Any:
        """Call the function, and write what it is given before it and what it returns after it."""
        given, results = list[str](), list[tuple[str, Any]]()
        for i, (name, kind, value) in enumerate(zip(self._arguments, self.argtypes, values, strict=True)):
            item = _array(value, values[i + 1 :])
            if self._is_result(name, item):
                results.append((name, item))
            else:
                given.append(f"{name}={_shown(item, kind)}")
        file = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            os.write(file, f"{self._name}({', '.join(given)})".encode("utf-8", "replace"))
            returned = self._function(*values)
            shown = "".join(f"; {name}={_shown(value)}" for name, value in results)
            os.write(file, f"{self._returned(returned)}{shown}\n".encode("utf-8", "replace"))
        finally:
            os.close(file)
        return returned

    def _is_result(self, name: str, value: Any) -> bool:
        """Whether the function fills an argument; then its value before the call is meaningless."""
        if isinstance(value, _POINTER):
            return not isinstance(value._obj, ctypes.Structure) or "Instantiate" not in self._name
        is_vector = isinstance(value, ctypes.Array) and "Get" in self._name
        return is_vector and name not in ("vr", "vrKnown", "vrUnknown") and "eference" not in name

    def _returned(self, value: Any) -> str:
        if self.restype is None:
            return " -> returned"
        return f" -> {status_word(value) if self.restype is ctypes.c_int else _shown(value, self.restype)}"


def _array(value: Any, following: Sequence[Any]) -> Any:
    """Return the array that a pointer points to; its length is the argument behind it."""
    if isinstance(value, ctypes._Pointer) and value and following and isinstance(following[0], int):
        return (value._type_ * following[0]).from_address(ctypes.addressof(value.contents))
    return value


def _shown(value: Any, kind: Any = None) -> str:
    """Return a value of C in words."""
    if kind is ctypes.c_void_p and isinstance(value, int):
        return hex(value)
    if kind is ctypes.c_char and isinstance(value, bytes):  # a boolean of FMI 1.0
        return str(value != b"\0")
    if isinstance(value, _POINTER):
        return _shown(value._obj)
    if isinstance(value, ctypes.Structure):
        fields = ((name, getattr(value, name)) for name, *_ in value._fields_)
        return f"{{{', '.join(f'{name}={_shown(value)}' for name, value in fields)}}}"
    if isinstance(value, ctypes.Array):
        shown = [_shown(element) for element in value[:_MOST_SHOWN]]
        rest = [f"... {len(value)} in all"] if len(value) > _MOST_SHOWN else []
        return f"[{', '.join(shown + rest)}]"
    if isinstance(value, bytes):
        return repr(value[:_LONGEST_TEXT].decode("utf-8", "replace"))
    if isinstance(value, ctypes.c_void_p):
        return hex(value.value or 0)
    if isinstance(value, ctypes._SimpleCData):
        return _shown(value.value)
    return "function" if callable(value) else repr(value)
