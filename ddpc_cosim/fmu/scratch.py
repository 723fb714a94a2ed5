"""Temporary folders that do not outlive the process, however it ends.

A process that is killed, or brought down by an FMU, cannot tidy up. So each folder has a keeper: a tiny
process that waits for the other end of a pipe to close, and then removes the folder.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import weakref
from pathlib import Path

_SHELL_KEEPER = 'read -r _ && exit; rm -rf -- "$0" || { sleep 1; rm -rf -- "$0"; }'
_PYTHON_KEEPER = "import shutil, sys; sys.stdin.readline() or shutil.rmtree(sys.argv[1], ignore_errors=True)"
_SHELL = Path("/bin/sh")

_has_keepers = True


class Keeper:
    """A process that removes a folder when this one ends without dismissing it.

    Parameters
    ----------
    folder : Path
        What to remove.
    """

    def __init__(self, folder: Path) -> None:
        self._owner = os.getpid()
        self._process = _start(folder) if _has_keepers else None

    def dismiss(self) -> None:
        """Let the keeper go; the folder stays if it is there."""
        if self._process is not None and os.getpid() == self._owner:
            # A line instead of the end of file; the keeper may have been killed itself.
            self._process.communicate(b"\n")


class ScratchFolder:
    """A temporary folder, removed by :meth:`remove`, with the object, with the process, or with its death."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="ddpc-cosim-"))
        self._finalizer = weakref.finalize(self, _remove, self.path, Keeper(self.path), os.getpid())

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_: object) -> None:
        self.remove()

    def remove(self) -> None:
        """Remove the folder and all that is in it; nothing happens the second time."""
        self._finalizer()


def stay_within(folder: Path) -> None:
    """Make all temporary files and folders of this process in a folder that someone else looks after."""
    global _has_keepers
    _has_keepers = False
    tempfile.tempdir = str(folder)
    for name in ("TMPDIR", "TEMP", "TMP"):
        os.environ[name] = str(folder)


def _remove(path: Path, keeper: Keeper, owner: int) -> None:
    if os.getpid() == owner:  # not in a forked copy
        shutil.rmtree(path, ignore_errors=True)
        keeper.dismiss()


def _start(folder: Path) -> "subprocess.Popen[bytes] | None":
    """Start a keeper out of reach of the terminal's Ctrl-C; without one, nothing is lost but tidiness."""
    if sys.platform == "win32":
        command = [sys.executable, "-I", "-S", "-c", _PYTHON_KEEPER, str(folder)]
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    else:
        command, flags = [str(_SHELL), "-c", _SHELL_KEEPER, str(folder)], 0
    null = subprocess.DEVNULL
    try:
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=null,
            stderr=null,
            cwd=folder.parent,
            start_new_session=True,
            creationflags=flags,
        )
    except OSError:
        return None
