"""How this process rounds and what it makes of denormal numbers, kept from what an FMU's library does to it.

Both are a state of the thread: a library that sets it, or that was linked with fast-math, sets it for all
that computes afterwards. It is read from what doubles do in this thread, which is the same on every
processor: a sum shows how it rounds (as IEEE 754's default, or not), a product whether denormal numbers
become zero. What doubles do not show is not seen: the precision of x87 registers, and which exceptions trap.
C's ``fegetenv`` and ``fesetenv`` save the whole state and put it back, these two included.
"""

import ctypes
import sys
from contextlib import suppress
from typing import Any

_SIZE = 256  # bytes; a state takes 8 to 32 of them


def _functions() -> tuple[Any, Any] | None:
    """Return C's functions that save the state and put it back; None where they are not found."""
    for name in ("ucrtbase",) if sys.platform == "win32" else (None, "libm.so.6"):
        with suppress(OSError, AttributeError):
            library = ctypes.PyDLL(name)  # other threads wait: no state is half of one and half of another
            return library.fegetenv, library.fesetenv
    return None


_FUNCTIONS = _functions()


def is_usual(
    unity: float = 1.0, little: float = 1e-17, denormal: float = 1.5e-323, quarter: float = 0.25
) -> bool:
    """Whether doubles are rounded to the nearest one, and denormal ones are what they are.

    The sum is larger where it is rounded up. Three times the smallest number is 1.5e-323; a quarter of that
    is that number, and 0 where it is rounded down or towards zero, or taken for zero.
    """
    return unity + little == unity and denormal * quarter != 0.0


def unusual_state() -> Any:
    """Return the state of this thread, to be put back, where it is an unusual one, and else None."""
    return None if is_usual() else _saved()


def departures(unity: float = 1.0, little: float = 1e-17, denormal: float = 1e-310, half: float = 0.5) -> str:
    """Return in words what differs from the defaults of IEEE 754 in this thread; empty for nothing."""
    up, down, inwards = unity + little != unity, -unity - little != -unity, unity - little != unity
    words = ["rounds up"] * up + ["rounds down"] * down + ["rounds towards zero"] * (inwards and not down)
    words += ["takes denormal numbers for zero"] * (denormal * half == 0.0)
    return " and ".join(words)


def _saved() -> Any:
    """Return the state of this thread, to be put back; it is empty where it cannot be read."""
    state = ctypes.create_string_buffer(_SIZE)
    if _FUNCTIONS is not None:
        _FUNCTIONS[0](state)
    return state


_USUAL = _saved() if is_usual() else None


class KeptArithmetic:
    """Within it a library may change the state, which is read before and afterwards and put back.

    Attributes
    ----------
    change : str
        What was changed first, in words; empty: nothing so far.
    """

    __slots__ = ("_before", "change")

    def __init__(self) -> None:
        self._before: Any = None
        self.change = ""

    def __enter__(self) -> None:
        self._before = unusual_state()

    def __exit__(self, *_: object) -> None:
        if self._before is not None or not is_usual():
            self.put_back(self._before)

    def put_back(self, before: Any) -> None:
        """Put back an unusual state, or the usual one for None, and say what has been changed."""
        changes, state = departures(), before or _USUAL
        if state is not None and _FUNCTIONS is not None:
            _FUNCTIONS[1](state)
        now = departures()
        if self.change or (changes == now and before is not None):
            return
        left = f"this process now {changes}" if changes else "this process now rounds to the nearest number"
        done = "it was put back, as it is after each call" if changes != now else "it cannot be put back here"
        self.change = f"its library changes how numbers are computed: {left}; {done}"
