"""The clock that bounds a suggestion: it runs with what is computed, and slowly while others compute.

On a machine that is busy a step test is as long as on one that is not. The CPU time of this process and of
all that it has started is known on Linux; elsewhere the clock is the one on the wall.
"""

import os
import sys
import time
from pathlib import Path

from ddpc_cosim.processes.limits import children

_LOOKED_FOR = 0.1  # s: how often new processes are looked for
_WAITING = 0.1  # of the time on the wall: what counts where it is not known who waits for what
_LEAST = 0.02  # of it: what counts at least
_IS_KNOWN = sys.platform == "linux"


class ComputingClock:
    """Seconds of computing, those of processes that have been started since included."""

    def __init__(self) -> None:
        self._seconds, self._wall, self._cpu = 0.0, time.monotonic(), 0.0
        self._members: list[int] = []
        self._ended, self._looked = 0.0, -1.0
        self._delayed, self._waiting = 0.0, _WAITING

    def __call__(self) -> float:
        """Return the seconds since the first call."""
        wall = time.monotonic()
        passed, self._wall = wall - self._wall, wall
        if not _IS_KNOWN:
            self._seconds += passed
            return self._seconds
        if wall - self._looked > _LOOKED_FOR:
            self._look(wall)
        times = [*map(_cpu_time, self._members)]
        if None in times:  # one has ended
            self._look(wall)
            times = [*map(_cpu_time, self._members)]
        cpu = time.process_time() + self._ended + sum(filter(None, times))
        computed, self._cpu = cpu - self._cpu, cpu
        self._seconds += min(passed, max(computed, self._waiting * passed))
        return self._seconds

    def _look(self, wall: float) -> None:
        """Find the processes that there are, the CPU time of those that have ended, and who waits for what.

        What waits for a processor does not count; what waits for something else does.
        """
        members = [os.getpid()]
        for member in members:  # which grows
            members += children(member)
        delays = [*map(_delay, members)]
        delayed = None if None in delays else sum(filter(None, delays))
        passed = wall - self._looked
        if delayed is None or not 0.0 < passed < wall:
            self._waiting = _WAITING
        else:
            share = max(0.0, delayed - self._delayed) / passed
            self._waiting = max(_LEAST, 1.0 - share)
        self._delayed = delayed or 0.0
        self._ended, self._looked = sum(map(_cpu_time_of_ended, members)), wall
        self._members = members[1:]


def _cpu_time(pid: int) -> float | None:
    """Return the CPU time of a process [s]; None of one that has ended."""
    if sys.platform == "win32":
        return None
    try:
        return time.clock_gettime(~pid << 3 | 2)  # the kernel's CPUCLOCK_SCHED of a process
    except OSError:
        return None


def _delay(pid: int) -> float | None:
    """Return for how long a process has waited for a processor [s]; None where that is not known."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0 if not Path(f"/proc/{pid}").exists() else None
    except (IndexError, ValueError):
        return None


def _cpu_time_of_ended(pid: int) -> float:
    """Return the CPU time of the children of a process that have ended [s]."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[13]) + int(fields[14])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError):
        return 0.0


monotonic = ComputingClock()
"""Return seconds on that clock."""
