"""How a command that was asked to end says so, and what it exits with."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from ddpc_cosim.processes.requests import Terminated, made

INTERRUPTED, TERMINATED = 130, 143
_GOES_ON = "finished cases are kept; the same command goes on from there"


@contextmanager
def told_when_asked_to_end() -> Iterator[None]:
    """Exit with a message where a request to end is raised, or what it has led to."""
    try:
        yield
    except SystemExit:
        raise
    except BaseException as error:
        request = error if isinstance(error, KeyboardInterrupt) else made()
        if request is None:
            raise
        is_terminated = isinstance(request, Terminated)
        if sys.stderr is not None:  # closed by whoever started this process
            print(f"{'terminated' if is_terminated else 'interrupted'}: {_GOES_ON}", file=sys.stderr)
        sys.exit(TERMINATED if is_terminated else INTERRUPTED)
