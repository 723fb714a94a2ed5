"""Ending a run in good order when somebody asks for it."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_REQUESTS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """The process was asked to terminate (SIGTERM): by ``kill``, a batch system, or a service manager."""


@contextmanager
def orderly_end() -> Iterator[None]:
    """Make a request to terminate raise :class:`Terminated`, as Ctrl-C raises ``KeyboardInterrupt``.

    The second request of either kind ends the process at once. What is ignored, as in a background job of a
    shell, stays ignored. Only for the main thread.
    """
    before = {number: signal.getsignal(number) for number in _REQUESTS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, _end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _end(number: int, frame: FrameType | None) -> None:
    for request in _REQUESTS:
        if signal.getsignal(request) is _end:
            signal.signal(request, signal.SIG_DFL)
    raise KeyboardInterrupt if number == signal.SIGINT else Terminated
