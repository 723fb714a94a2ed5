"""Files written so that the same content gives the same bytes, and nobody sees half of one."""

import os
import tempfile
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

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
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
        temporary.chmod(0o644)  # mkstemp makes it private
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
