"""Files written as a whole, archives whose bytes depend on their content alone, and the cache folder."""

import hashlib
import os
import stat
import sys
import uuid
import zipfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path

from platformdirs import user_cache_dir

_FIXED_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest a zip archive can hold
_UNIX = 3
_SMALLEST = 9
_ANOTHER = "set DDPC_COSIM_CACHE to another folder"


def zip_bytes(files: Mapping[str, bytes]) -> bytes:
    """Return a zip archive of the files: sorted by name, without dates or owners."""
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, _FIXED_DATE)
            entry.create_system = _UNIX  # the default is the system that writes it
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, files[name], compresslevel=_SMALLEST)
    return buffer.getvalue()


def write_atomically(path: Path, content: bytes | Iterable[bytes]) -> None:
    """Write the file as a whole: a reader, or another writer of the same path, never meets a part of it.

    Nor does who reads it after a power cut.

    Parameters
    ----------
    path : Path
        The file.
    content : bytes or iterable of bytes
        What is in it; in parts where it is too long to be had at once.

    Raises
    ------
    OSError
        The folder does not exist or cannot be written to.
    """
    staged = path.with_name(temporary_name(path.name))
    try:
        if isinstance(content, bytes):
            staged.write_bytes(content)
        else:
            with staged.open("wb") as file:
                file.writelines(content)
        write_through(staged)
        staged.replace(path)
    except BaseException:
        with suppress(OSError):
            staged.unlink()
        raise


def temporary_name(name: str) -> str:
    """Return the name of a file that is to be called so when it is complete."""
    return f".{name}.{uuid.uuid4().hex}"


def write_through(path: Path) -> None:
    """Have a file's content on its disk before anything is renamed: a power cut would leave it empty.

    Raises
    ------
    OSError
        It cannot be written there.
    """
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def cache_dir() -> Path:
    """Return the folder for what can be rebuilt: ``$DDPC_COSIM_CACHE``, else the user's cache folder.

    What is in it is executed. So it is made for this user only, and another user's, or one that others may
    write to, is refused.

    Raises
    ------
    OSError
        It cannot be used, and how to choose another one.
    """
    path = Path(os.environ.get("DDPC_COSIM_CACHE") or user_cache_dir("ddpc-cosim", appauthor=False))
    try:
        if not path.is_dir():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.mkdir(mode=0o700, exist_ok=True)
        status = path.stat()
    except OSError as error:
        raise OSError(f"{path}: the cache cannot be made: {error}; {_ANOTHER}") from error
    if sys.platform != "win32":
        if status.st_uid != os.geteuid():
            raise PermissionError(f"{path}: the cache belongs to another user ({status.st_uid}); {_ANOTHER}")
        if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            what = f"the cache can be written to by others (mode {stat.S_IMODE(status.st_mode):o})"
            raise PermissionError(
                f"{path}: {what}; remove it, chmod go-w it if you trust them, or {_ANOTHER}"
            )
    return path


def cached(place: str, make: Callable[[], bytes]) -> Path:
    """Return a file of the cache, which is made if it is not there, or not what was written there.

    Parameters
    ----------
    place : str
        Where it is in the cache; it says all that decides the content. Several processes may make it at the
        same time.
    make : callable
        Makes the content.

    Raises
    ------
    OSError
        The cache cannot be used or written to; the message says how to choose another one.
    """
    root = cache_dir()
    path = root / place
    if _is_intact(path, root):
        return path
    content = make()
    try:
        for folder in reversed(path.relative_to(root).parents[:-1]):
            try:
                (root / folder).mkdir(mode=0o700)
            except FileExistsError:
                if not _is_own(root / folder, stat.S_IFDIR):
                    (root / folder).unlink()  # a link, or a file
                    (root / folder).mkdir(mode=0o700)
        write_atomically(path, content)
        write_atomically(_hash_file(path), hashlib.sha256(content).hexdigest().encode())
    except OSError as error:
        # Windows does not replace a file that is being read; then another process has written it.
        if not _is_intact(path, root):
            raise OSError(f"{path}: the cache cannot be written to: {error}; {_ANOTHER}") from error
    return path


def is_cached(place: str) -> bool:
    """Whether a file is in the cache, as it was written there.

    Raises
    ------
    OSError
        The cache cannot be used.
    """
    root = cache_dir()
    return _is_intact(root / place, root)


def _is_intact(path: Path, root: Path) -> bool:
    """Whether a file of the cache is what was written, by this user, and reached by no link."""
    folders = [root / folder for folder in path.relative_to(root).parents[:-1]]
    files = (path, _hash_file(path))
    if not all(_is_own(f, stat.S_IFDIR) for f in folders) or not all(_is_own(f, stat.S_IFREG) for f in files):
        return False
    return hashlib.sha256(path.read_bytes()).hexdigest().encode() == _hash_file(path).read_bytes()


def _is_own(path: Path, kind: int) -> bool:
    try:
        status = path.lstat()
    except OSError:
        return False
    is_own = sys.platform == "win32" or status.st_uid == os.geteuid()
    return is_own and stat.S_IFMT(status.st_mode) == kind


def _hash_file(path: Path) -> Path:
    return path.with_name(f"{path.name}.sha256")


def is_file(path: Path) -> bool:
    """Whether there is a file, also of a path that none can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
