"""Temporary folders that do not outlive the next run, however the process ends.

A process that is killed, or brought down by an FMU, cannot tidy up. So each folder holds a file that is
locked as long as its process lives; whoever makes such a folder first removes those that no one holds.
"""

import os
import shutil
import stat
import subprocess
import sys
import tempfile
import uuid
import weakref
from contextlib import suppress
from functools import cache
from pathlib import Path

from ddpc_cosim.files.path_lengths import RANDOM
from ddpc_cosim.processes.requests import held

_LOCK = ".lock"


class ScratchFolder:
    """A folder that is removed by :meth:`remove`, with the object, with the process, or by the next one.

    Parameters
    ----------
    within : Path, optional
        Where it is made; default: the folder of temporary files.
    prefix : str
        What its name begins with; folders of this prefix that no one holds are removed.

    Raises
    ------
    OSError
        It cannot be made.
    """

    def __init__(self, within: Path | None = None, prefix: str = "ddpc-cosim-") -> None:
        parent = Path(within or tempfile.gettempdir()).resolve()
        _remove_left_behind_once(parent, prefix)
        with held():  # from the first moment on it is known who removes it
            self.path, lock = _locked_folder(parent, prefix)
            self._finalizer = weakref.finalize(self, _remove, self.path, lock, os.getpid())

    def remove_after_death(self) -> None:
        """Have the folder removed as soon as this process has gone, however it went (POSIX)."""
        if sys.platform != "win32":
            with suppress(OSError):  # without a shell, the next process removes it
                guard = subprocess.Popen(
                    ["/bin/sh", "-c", 'read -r _; exec rm -rf -- "$1"', "sh", str(self.path)],
                    stdin=subprocess.PIPE,
                    start_new_session=True,
                )
                weakref.finalize(self, _release, guard)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_: object) -> None:
        self.remove()

    def remove(self) -> None:
        """Remove the folder and all that is in it; nothing happens the second time."""
        self._finalizer()


def _locked_folder(parent: Path, prefix: str) -> tuple[Path, int]:
    """Make a folder, and return it with the lock that is held on it."""
    while True:
        path = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        try:
            lock = os.open(path / _LOCK, os.O_CREAT | os.O_RDWR)
        except FileNotFoundError:  # someone has taken it for one left behind
            continue
        except OSError:
            with suppress(OSError):
                path.rmdir()
            raise
        if _holds(lock) and (path / _LOCK).exists():  # no one has taken it for one left behind
            return path, lock
        os.close(lock)


def scratch_of_cases() -> Path:
    """Return a path as long as that of the folder in which a case has what it unpacks."""
    name = f"ddpc-cosim-{RANDOM}"
    return Path(tempfile.gettempdir()).resolve() / name / f"tmp{RANDOM}" / name


def remove_left_behind(parent: Path, prefix: str = "ddpc-cosim-") -> None:
    """Remove the folders of processes that have gone."""
    with os.scandir(parent) as entries:
        folders = [parent / entry.name for entry in entries if entry.name.startswith(prefix)]
    for folder in folders:
        if not _is_own_folder(folder):
            continue
        with suppress(OSError):  # just removed, or not empty
            if not (folder / _LOCK).exists():
                folder.rmdir()  # what was to be removed last could not be
                continue
            lock = os.open(folder / _LOCK, os.O_RDWR)
            try:
                if sys.platform != "win32" and _holds(lock):
                    _remove_folder(folder)
            finally:
                os.close(lock)
            if sys.platform == "win32":
                (folder / _LOCK).unlink()  # which cannot be done while a process has it open
                _remove_folder(folder)


def _is_own_folder(path: Path) -> bool:
    """Whether a folder is this user's and not a link, which anyone may put among temporary files."""
    try:
        status = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and (sys.platform == "win32" or status.st_uid == os.geteuid())


_remove_left_behind_once = cache(remove_left_behind)


def _holds(lock: int) -> bool:
    """Lock a file unless someone else has; return whether it is locked now."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _release(guard: "subprocess.Popen[bytes]") -> None:
    """Let a guard remove what is left, and end."""
    guard.communicate()


def _remove(path: Path, lock: int, owner: int) -> None:
    if os.getpid() == owner:  # not in a forked copy
        os.close(lock)  # an open file cannot be removed everywhere
        _remove_folder(path)


def _remove_folder(path: Path) -> None:
    """Remove a folder, its lock last: if this process is killed meanwhile, the next one goes on."""
    with suppress(OSError):  # another one removes it too
        for entry in path.iterdir():
            if entry.name != _LOCK:
                remove(entry)
    remove(path)


def remove(path: Path) -> None:
    """Remove a file, or a folder and all that is in it, if there is one and it can be removed."""
    with suppress(RecursionError):
        shutil.rmtree(path, ignore_errors=True)
    with suppress(OSError):
        path.unlink()
    with suppress(OSError):
        if path.is_dir() and not path.is_symlink():  # folders within folders, deeper than one can go
            _flatten(path)
            shutil.rmtree(path, ignore_errors=True)


def _flatten(folder: Path) -> None:
    """Leave a folder without folders in its folders, and the files of those removed."""
    while nested := [entry for entry in folder.iterdir() if entry.is_dir() and not entry.is_symlink()]:
        for path in nested:
            for entry in list(path.iterdir()):
                if entry.is_dir() and not entry.is_symlink():
                    entry.rename(folder / uuid.uuid4().hex)
                else:
                    entry.unlink()
            path.rmdir()


def list_shared_memory(path: Path) -> None:
    """List in a file the shared memory that Python makes in this process and its copies from now on (POSIX).

    Python's own tracker, which would remove it, does not outlive a process that is ended with all it started;
    and it takes for made by it what was only opened.
    """
    if sys.platform != "win32":
        import _posixshmem

        shm_open = _posixshmem.shm_open

        def listed(name: str, flags: int, mode: int = 0o777) -> int:
            descriptor: int = shm_open(name, flags, mode=mode)
            if flags & os.O_CREAT and flags & os.O_EXCL:  # else it may have been there
                with suppress(OSError), path.open("a", encoding="utf-8") as file:
                    file.write(f"{name}\0")
            return descriptor

        _posixshmem.shm_open = listed


def remove_shared_memory(path: Path) -> None:
    """Remove the shared memory that a file lists, as far as it is still there (POSIX)."""
    if sys.platform != "win32":
        import _posixshmem

        with suppress(OSError, UnicodeDecodeError):
            for name in path.read_text(encoding="utf-8").split("\0")[:-1]:
                with suppress(OSError):
                    _posixshmem.shm_unlink(name)
