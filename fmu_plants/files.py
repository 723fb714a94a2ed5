"""Files written as a whole, archives whose bytes depend on their content alone, and the cache folder."""

import os
import uuid
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

from platformdirs import user_cache_dir

_FIXED_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest a zip archive can hold
_UNIX = 3
_SMALLEST = 9


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


def write_atomically(path: Path, content: bytes) -> None:
    """Write the file as a whole: a reader, or another writer of the same path, never meets a part of it.

    Raises
    ------
    OSError
        The folder does not exist or cannot be written to.
    """
    staged = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        staged.write_bytes(content)
        staged.replace(path)
    finally:
        staged.unlink(missing_ok=True)


def cache_dir() -> Path:
    """Return the folder for what can be rebuilt: ``$DDPC_COSIM_CACHE``, else the user's cache folder."""
    return Path(os.environ.get("DDPC_COSIM_CACHE") or user_cache_dir("ddpc-cosim", appauthor=False))


def write_to_cache(path: Path, content: bytes) -> None:
    """Write a file below the cache folder, which several processes may do at the same time.

    Raises
    ------
    OSError
        It cannot be written to; the message says how to choose another folder.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)
    except OSError as error:
        # Windows does not replace a file that is being read; then another process has written it.
        if not path.is_file():
            message = (
                f"{path}: the cache cannot be written to: {error}; set DDPC_COSIM_CACHE to another folder"
            )
            raise OSError(message) from error
