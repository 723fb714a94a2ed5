"""What a worker may have: memory and processes, as the kernel of Linux tells them.

They are looked at now and then, together with all that a worker has started. Limits that the kernel enforces
itself are other ones: of address space, not memory; of each process alone; of all processes of a user.
"""

import os
import platform
import sys
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path

if sys.platform != "win32":  # here, so that it is there before workers are forked
    import resource

_MOST_TASKS = 500
_IS_LOOKED_AT = sys.platform == "linux"


def excess_of(pid: int, memory: int) -> str:
    """Return in words which limit a process and its descendants exceed; empty: none."""
    everyone = [pid]
    for member in everyone:  # which grows
        everyone += children(member) if len(everyone) <= _MOST_TASKS else ()
    if sum(len(_tasks(member)) for member in everyone) > _MOST_TASKS:
        return f"more than {_MOST_TASKS} processes and threads"
    if sum(map(_resident, everyone)) > memory and sum(map(_proportional, everyone)) > memory:
        return f"more than {memory / 1e9:.3g} GB of memory"
    return ""


def limit_tasks() -> None:
    """Limit the tasks of this process, and of those that it will start, to few more than there are now.

    This gives whoever enforces the limit the time to do so. The kernel counts all tasks of the user, so that
    it has to be generous; and root's not at all.
    """
    everyones = int(Path("/proc/loadavg").read_text().split()[3].partition("/")[2])
    hard = resource.getrlimit(resource.RLIMIT_NPROC)[1]
    most = everyones + 2 * _MOST_TASKS
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_NPROC, (most, most))


def children(pid: int) -> set[int]:
    """Return the children of a process, where the kernel lists them."""
    child_ids: set[int] = set()
    for task in _tasks(pid):
        with suppress(OSError):
            child_ids.update(map(int, Path(f"/proc/{pid}/task/{task}/children").read_text().split()))
    return child_ids


def _tasks(pid: int) -> list[str]:
    try:
        return os.listdir(f"/proc/{pid}/task")  # noqa: PTH208 - ten times a second
    except OSError:
        return []


def _resident(pid: int) -> int:
    """Return the memory of a process in bytes, with all that it shares with others."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def _proportional(pid: int) -> int:
    """Return the memory of a process in bytes, with its part of what it shares."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    except (OSError, StopIteration):  # not every kernel has it, nor of every process
        return _resident(pid)


def limits_warning(gigabytes: Iterable[float]) -> str:
    """Return a warning if limits of memory [GB] do nothing on this system; empty: they hold."""
    if _IS_LOOKED_AT or not (given := sorted(set(gigabytes))):
        return ""
    limits = ", ".join(f"{limit:g}" for limit in given)
    return (
        f"memory_limit = {limits} GB does nothing on this system ({platform.system()}): "
        "what a process has is looked at on Linux only"
    )


@cache  # of each case it would be read again
def default_memory(workers: int = 1) -> int:
    """Return how many bytes each of some workers may have: all have a share, and so has everything else.

    It is 0, for no limit, where the memory of a process is not known as on Linux.
    """
    if not _IS_LOOKED_AT:
        return 0
    sizes = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    for limit in ("memory.max", "memory/memory.limit_in_bytes"):  # of a container
        with suppress(OSError, ValueError):
            sizes.append(int(Path("/sys/fs/cgroup", limit).read_text()))
    return min(sizes) // (workers + 1)
