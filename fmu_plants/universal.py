"""Universal libraries of macOS: one file for several processors.

The format is a table in big-endian order, followed by the libraries, each at a multiple of the page size
(Apple, Mach-O file format reference, `fat.h`).
"""

import struct
from collections.abc import Sequence

_MAGIC = 0xCAFEBABE
_HEADER = struct.Struct(">2I")  # magic, number of libraries
_ENTRY = struct.Struct(">5I")  # processor type and subtype, offset, size, alignment as a power of two
_PROCESSOR = struct.Struct("<2I")  # of a single library, after its magic number
_ALIGNMENT = 14  # the pages of arm64 have 16 KiB; those of x86-64 are smaller


def universal_binary(libraries: Sequence[bytes]) -> bytes:
    """Return one library that contains all of these 64-bit Mach-O libraries."""
    page = 1 << _ALIGNMENT
    table = _HEADER.pack(_MAGIC, len(libraries))
    content = bytearray(page)
    for library in libraries:
        content += bytes(-len(content) % page)
        table += _ENTRY.pack(*_PROCESSOR.unpack_from(library, 4), len(content), len(library), _ALIGNMENT)
        content += library
    content[: len(table)] = table
    return bytes(content)
