"""Processes of other processes, and waiting for their end (POSIX)."""

import os
import select
import signal
import subprocess
import sys


def heed_interrupts() -> None:
    """Let a new process be interrupted, as one in the foreground of a shell: a background job ignores it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def descendants(pid: int) -> list[int]:
    """Return the processes that a process has started, and those that these have."""
    with subprocess.Popen(["ps", "-A", "-o", "pid=,ppid="], stdout=subprocess.PIPE, text=True) as ps:
        listed = [tuple(map(int, line.split())) for line in ps.communicate()[0].splitlines()]
    parents = [(child, parent) for child, parent in listed if child != ps.pid]
    children, family = [], {pid}
    grown = True
    while grown:
        grown = False
        for child, parent in parents:
            if parent in family and child not in family:
                family.add(child)
                children.append(child)
                grown = True
    return children


class Watch:
    """Watches processes that are not one's own children until they end."""

    def __init__(self, pids: list[int]) -> None:
        self.pids = pids
        self._handles = {pid: os.pidfd_open(pid) for pid in pids} if sys.platform == "linux" else {}

    def wait(self, seconds: float) -> list[int]:
        """Return the processes that have not ended after so long."""
        if sys.platform == "linux":
            return [
                pid
                for pid, handle in self._handles.items()
                if not select.select([handle], [], [], seconds)[0]
            ]
        queue = select.kqueue()
        left = []
        for pid in self.pids:
            event = select.kevent(pid, select.KQ_FILTER_PROC, select.KQ_EV_ADD, select.KQ_NOTE_EXIT)
            try:
                ended = queue.control([event], 1, seconds)
            except ProcessLookupError:
                continue
            if not ended:
                left.append(pid)
        return left
