"""How a command that was asked to end says so, and what it exits with."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from ddpc_cosim.processes.requests import Terminated, made

_INTERRUPTED, _TERMINATED = 130, 143
_GOES_ON = "finished cases are kept; the same command goes on from there"


def exit_code(request: KeyboardInterrupt) -> int:
    """Return the exit code of a command after a request to end."""
    return _TERMINATED if isinstance(request, Terminated) else _INTERRUPTED


@contextmanager
def reporting_requests_to_end() -> Iterator[None]:
    """Exit with a message where a request to end is raised, or what it has led to."""
    try:
        yield
    except SystemExit:
        raise
    except BaseException as error:
        request = error if isinstance(error, KeyboardInterrupt) else made()
        if request is None:
            raise
        if sys.stderr is not None:  # closed by whoever started this process
            print(
                f"{'terminated' if isinstance(request, Terminated) else 'interrupted'}: {_GOES_ON}",
                file=sys.stderr,
            )
        sys.exit(exit_code(request))
