"""Requests to end, by Ctrl-C or SIGTERM: raised where they are not lost.

Python has a signal's handler raise between any two instructions. What is raised in a finalizer is printed and
forgotten; between two steps of a commit it leaves half of it. There a request is remembered, and raised on
leaving. Little is imported here: a request may come while everything else is.
"""

import _weakrefset
import signal
import sys
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_REQUESTS = (signal.SIGINT, signal.SIGTERM)
# Everything that these call is a finalizer, and so is a method of this name.
_FINALIZING_FILES, _FINALIZER = (weakref.__file__, _weakrefset.__file__), "__del__"


class Terminated(KeyboardInterrupt):
    """The process was asked to terminate (SIGTERM): by ``kill``, a batch system, or a service manager."""


class _State:
    """Whether requests are waited for, the one that came, whether it is still to be raised; open commits."""

    is_entered = False
    request: KeyboardInterrupt | None = None
    is_held = False
    commits = 0


_state = _State()


@contextmanager
def orderly_end(*, process_ends: bool = False) -> Iterator[None]:
    """Make a request to terminate raise :class:`Terminated`, as Ctrl-C raises ``KeyboardInterrupt``.

    In a finalizer, and where requests are :func:`held`, it is raised on leaving. The second request of either
    kind ends the process at once. What is ignored, as in a background job of a shell, stays ignored. Within
    itself, and outside the main thread, it does nothing.

    Parameters
    ----------
    process_ends : bool
        Whether the process ends afterwards, which is all that is requested then; otherwise signals are
        handled as before.
    """
    if _state.is_entered or threading.current_thread() is not threading.main_thread():
        yield
        return
    before, hook = {number: signal.getsignal(number) for number in _REQUESTS}, sys.unraisablehook

    def not_raised(unraisable: Any) -> None:
        """Raise after all what was raised in a finalizer that could not be told from other code."""
        if _state.request is None:
            hook(unraisable)
        elif unraisable.exc_value is _state.request:
            _raise_in(_outside(sys._getframe().f_back))
        # Otherwise it belongs to something half made when the request was raised.

    try:
        with held():
            _state.is_entered, _state.request, sys.unraisablehook = True, None, not_raised
            _handle(_end)
        yield
    finally:
        _state.commits += 1  # no call before it, in which a request could be raised
        try:
            for number, handler in reversed(
                before.items()
            ):  # Python's own of Ctrl-C, which may raise here, last
                signal.signal(number, signal.SIG_DFL if handler is None else handler)
            if process_ends:
                _handle(_ends_anyway)
        finally:
            _state.is_entered = False
            _state.commits -= 1
            request, is_held, _state.is_held = _state.request, _state.is_held, False
            if not process_ends:
                _state.request = None  # and all that its traceback holds
            if not (process_ends and request):
                sys.unraisablehook = hook
            if is_held and request is not None:
                raise request


def made() -> KeyboardInterrupt | None:
    """Return the request, if there was one: what else is raised later, as by half an import, is due to it."""
    return _state.request


@contextmanager
def held() -> Iterator[None]:
    """Hold requests: what is done within is done as a whole."""
    if threading.current_thread() is not threading.main_thread():  # where none is raised
        yield
        return
    _state.commits += 1
    try:
        yield
    finally:
        _state.commits -= 1
        _raise_if_held()


def _raise_if_held() -> None:
    if _state.is_held and _state.request is not None and not _state.commits:
        _state.is_held = False
        raise _state.request


def _handle(handler: Any) -> None:
    """Install this handler for requests, except for those that are ignored."""
    for number in _REQUESTS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _ends_anyway(number: int, frame: FrameType | None) -> None:
    _handle(signal.SIG_DFL)


def _end(number: int, frame: FrameType | None) -> None:
    _handle(signal.SIG_DFL)
    _state.request = KeyboardInterrupt() if number == signal.SIGINT else Terminated()
    _state.is_held = _state.commits > 0
    if _state.is_held:
        return
    outside = _outside(frame)
    if outside is frame:
        raise _state.request
    _raise_in(outside)


def _outside(frame: FrameType | None) -> FrameType | None:
    """Return the frame in which the outermost finalizer was called; the given one if it is in none."""
    outside, caller = frame, frame
    while caller is not None:
        if caller.f_code.co_name == _FINALIZER or caller.f_code.co_filename in _FINALIZING_FILES:
            outside = caller.f_back
        caller = caller.f_back
    return outside


def _raise_in(frame: FrameType | None) -> None:
    """Raise the request as soon as a frame goes on, as what traces it can; without one nothing goes on."""

    def request(frame: FrameType, event: str, argument: Any) -> None:
        sys.settrace(None)
        frame.f_trace = None
        assert _state.request is not None
        raise _state.request

    if frame is not None:
        frame.f_trace, frame.f_trace_opcodes = request, True
        sys.settrace(lambda *_: None)  # other frames are not traced
