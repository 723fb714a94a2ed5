"""The types of variables of FMI 1.0, 2.0 and 3.0: what depends on a type stands here, and only here."""

import ctypes
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from ddpc_cosim.description import Values


class VariableType(NamedTuple):
    """A type of variables in one FMI version.

    Parameters
    ----------
    values : str
        What its values are.
    function : str
        What the getters and setters are called after, for example ``Int64`` for ``fmi3GetInt64``.
    c_type : Any
        The ctypes type of one value.
    min, max : float
        The range that a value can have.
    """

    values: Values
    function: str = ""
    c_type: Any = None
    min: float = -math.inf
    max: float = math.inf

    @property
    def is_number(self) -> bool:
        """Whether its values are numbers, so that they can be inputs and outputs of a plant."""
        return self.values in ("real", "integer", "boolean")


def _integer(name: str, bits: int, *, signed: bool) -> VariableType:
    low, high = (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1) if signed else (0.0, 2.0**bits - 1)
    return VariableType("integer", name, getattr(ctypes, f"c_{name.lower()}"), low, high)


_FMI_2 = {
    "Real": VariableType("real", "Real", ctypes.c_double),
    "Integer": VariableType("integer", "Integer", ctypes.c_int),
    "Enumeration": VariableType("integer", "Integer", ctypes.c_int),
    "Boolean": VariableType("boolean", "Boolean", ctypes.c_int, 0.0, 1.0),
    "String": VariableType("text", "String", ctypes.c_char_p),
}
# fmiBoolean is a char; a number is wanted here, and a byte there (see fmi1.py).
_FMI_1 = _FMI_2 | {"Boolean": VariableType("boolean", "Boolean", ctypes.c_int8, 0.0, 1.0)}
_FMI_3 = {
    "Float32": VariableType("real", "Float32", ctypes.c_float),
    "Float64": VariableType("real", "Float64", ctypes.c_double),
    **{f"Int{bits}": _integer(f"Int{bits}", bits, signed=True) for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": _integer(f"UInt{bits}", bits, signed=False) for bits in (8, 16, 32, 64)},
    "Enumeration": VariableType("integer", "Int64", ctypes.c_int64),
    "Boolean": VariableType("boolean", "Boolean", ctypes.c_bool, 0.0, 1.0),
    "String": VariableType("text", "String", ctypes.c_char_p),
    "Binary": VariableType("none"),
    "Clock": VariableType("none"),
}
TYPES: Mapping[int, Mapping[str, VariableType]] = {1: _FMI_1, 2: _FMI_2, 3: _FMI_3}
"""The types by FMI version and name, as in model descriptions."""

_VALUES: Mapping[str, VariableType] = {name: row for table in TYPES.values() for name, row in table.items()}


def integer_range(name: str) -> tuple[int, int]:
    """Return the smallest and largest number that an integer type can hold."""
    c_type = _VALUES[name].c_type
    signed, bits = c_type(-1).value < 0, 8 * ctypes.sizeof(c_type)
    return (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
