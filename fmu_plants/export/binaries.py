"""Shared libraries as files: ELF, PE and Mach-O, 64 bit, little endian.

A library for another platform cannot be loaded here to see whether it has what it must, and loading one runs
its code: which functions it exports and which libraries it needs is read from its file.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import NamedTuple

_ELF_MAGIC, _PE_MAGIC, _MACHO_MAGIC = b"\x7fELF\x02\x01", b"MZ", b"\xcf\xfa\xed\xfe"

# Universal libraries of macOS, for several processors: a table in big-endian order, followed by the
# libraries, each at a multiple of the page size (Apple, Mach-O file format reference, `fat.h`).
_UNIVERSAL_MAGIC = 0xCAFEBABE
_UNIVERSAL_HEADER = struct.Struct(">2I")  # magic, number of libraries
_UNIVERSAL_ENTRY = struct.Struct(">5I")  # processor type, subtype, offset, size, log2(alignment)
_PROCESSOR = struct.Struct("<2I")  # of a single library, after its magic number
_MOST_VERSIONS, _LONGEST_NAME = 1 << 14, 255
_ALIGNMENT = 14  # the pages of arm64 have 16 KiB; those of x86-64 are smaller


def exported_symbols(library: bytes) -> frozenset[str]:
    """Return the names of the functions and data that a library exports.

    Raises
    ------
    ValueError
        The file is not a shared library of a known format, or is damaged.
    """
    readers = {_ELF_MAGIC: _elf_exports, _PE_MAGIC: _pe_exports, _MACHO_MAGIC: _macho_exports}
    for magic, reader in readers.items():
        if library.startswith(magic):
            with _damage_as_value_error():
                return frozenset(reader(library))
    raise ValueError("the library is neither ELF nor PE nor Mach-O of 64 bit")


def processor(library: bytes) -> str:
    """Return the processor that a library, or a program, is for; empty if its file does not say, or several.

    Sources: System V ABI, ELF header; Microsoft, PE format, COFF header; Apple, Mach-O header.
    """
    number, known = 0, dict[int, str]()
    with suppress(struct.error):
        if library.startswith(_ELF_MAGIC[:4]):
            (number,) = struct.unpack_from("<H", library, 18)
            known = {3: "x86", 40: "ARM", 62: "x86-64", 183: "AArch64", 243: "RISC-V"}
        elif library.startswith(_PE_MAGIC):
            (header,) = struct.unpack_from("<I", library, 0x3C)
            (number,) = struct.unpack_from("<H", library, header + 4)
            known = {0x14C: "x86", 0x8664: "x86-64", 0xAA64: "AArch64"}
        elif library.startswith(_MACHO_MAGIC):
            (number,) = struct.unpack_from("<I", library, 4)
            known = {0x1000007: "x86-64", 0x100000C: "AArch64"}
    return known.get(number, f"processor {number}" if number else "")


def is_cut_off(library: bytes) -> bool:
    """Whether an ELF library lacks a part of what the loader maps; of other formats it is not known."""
    loaded_segment = 1
    if not library.startswith(_ELF_MAGIC):
        return False
    try:
        segments = _elf_table(library, 0x20, 0x36, "<2I5Q")
    except (struct.error, OverflowError):
        return True
    return any(s[0] == loaded_segment and s[2] + s[5] > len(library) for s in segments)


@contextmanager
def _damage_as_value_error() -> Iterator[None]:
    try:
        yield
    except (struct.error, IndexError, OverflowError) as error:
        raise ValueError(f"the library is damaged: {error}") from error


def _text(content: bytes, offset: int) -> str:
    return content[offset : content.index(b"\0", offset)].decode("utf-8", errors="replace")


class Needs(NamedTuple):
    """What a library asks the loader of Linux for."""

    libraries: list[str]
    folders: list[str]


def needed_libraries(library: bytes) -> Needs:
    """Return the libraries that an ELF library needs, and the folders where it has them looked for.

    Those of other formats are not read. Source: System V ABI, dynamic section.

    Raises
    ------
    ValueError
        The file is damaged.
    """
    loaded_segment, dynamic_segment = 1, 2
    names_address, needed, run_paths = 5, 1, (15, 29)
    if not library.startswith(_ELF_MAGIC):
        return Needs([], [])
    with _damage_as_value_error():
        # type, flags, offset, virtual address, physical address, size in the file, size in memory
        segments = _elf_table(library, 0x20, 0x36, "<2I5Q")
        entries = [e for s in segments if s[0] == dynamic_segment for e in _dynamic_entries(library, s)]
        (address,) = [value for tag, value in entries if tag == names_address] or [0]
        loaded = [s for s in segments if s[0] == loaded_segment and 0 <= address - s[3] < s[5]]
        if not loaded:
            return Needs([], [])
        names = address - loaded[0][3] + loaded[0][2]
        libraries = [_text(library, names + value) for tag, value in entries if tag == needed]
        paths = [_text(library, names + value) for tag, value in entries if tag in run_paths]
    return Needs(libraries, [folder for path in paths for folder in path.split(":")])


class WantedSymbol(NamedTuple):
    """A function or variable that a library takes from others.

    Parameters
    ----------
    name : str
        Its name, of which the first 255 characters are read.
    library, version : str
        The library that must have it, and in which version of its interface; both are empty where the file
        does not say.
    """

    name: str
    library: str
    version: str


def wanted_symbols(library: bytes) -> frozenset[WantedSymbol]:
    """Return what an ELF library takes from others and cannot do without.

    Those of other formats, and of files without section headers, are not read. Source: System V ABI, symbol
    table; Linux Standard Base, symbol versioning.

    Raises
    ------
    ValueError
        The file is damaged.
    """
    dynamic_symbols, needed_versions, versions_of_symbols = 11, 0x6FFFFFFE, 0x6FFFFFFF
    if not library.startswith(_ELF_MAGIC):
        return frozenset()
    with _damage_as_value_error():
        # name, type, flags, address, offset, size, link
        sections = _elf_table(library, 0x28, 0x3A, "<2I4QI")
        of_kind = {section[1]: section for section in sections}
        if dynamic_symbols not in of_kind:
            return frozenset()
        versions = dict[int, tuple[str, str]]()
        if needed_versions in of_kind:
            offset, link = of_kind[needed_versions][4], of_kind[needed_versions][6]
            versions = dict(_needed_versions(library, offset, sections[link][4]))
        _, _, _, _, offset, length, link = of_kind[dynamic_symbols]
        numbers = of_kind[versions_of_symbols][4] if versions_of_symbols in of_kind else None
        return frozenset(_undefined(library, offset, length, sections[link][4], numbers, versions))


def _undefined(
    content: bytes,
    offset: int,
    length: int,
    names: int,
    numbers: int | None,
    versions: Mapping[int, tuple[str, str]],
) -> Iterator[WantedSymbol]:
    undefined, hidden, weak = 0, 0x8000, 2
    for index in range(1, length // 24):  # the first is none
        name, info, _, section = struct.unpack_from("<I2BH", content, offset + 24 * index)
        if section == undefined and name and info >> 4 != weak:
            number = 0 if numbers is None else struct.unpack_from("<H", content, numbers + 2 * index)[0]
            yield WantedSymbol(_short_text(content, names + name), *versions.get(number & ~hidden, ("", "")))


def _needed_versions(content: bytes, entry: int, names: int) -> Iterator[tuple[int, tuple[str, str]]]:
    """Yield library and version by the number that symbols have; each entry says where the next one is."""
    read = 0
    while True:
        _, count, file, first, following = struct.unpack_from("<2H3I", content, entry)
        version = entry + first
        for _ in range(count):
            _, _, number, name, next_version = struct.unpack_from("<I2H2I", content, version)
            yield number, (_short_text(content, names + file), _short_text(content, names + name))
            version += next_version
            read += 1
            if read > _MOST_VERSIONS:
                break
        read += 1
        if read > _MOST_VERSIONS:
            raise IndexError(f"more than {_MOST_VERSIONS} versions")
        if not following:
            return
        entry += following


def _short_text(content: bytes, offset: int) -> str:
    return content[offset : offset + _LONGEST_NAME].partition(b"\0")[0].decode("utf-8", errors="replace")


def _elf_table(content: bytes, place: int, sizes: int, entry: str) -> list[tuple[int, ...]]:
    """Read segments or sections; the header says at `place` where, at `sizes` how large and how many."""
    (table,) = struct.unpack_from("<Q", content, place)
    size, count = struct.unpack_from("<2H", content, sizes)
    return [struct.unpack_from(entry, content, table + index * size) for index in range(count)]


def _dynamic_entries(content: bytes, segment: Sequence[int]) -> Iterator[tuple[int, int]]:
    end = 0
    for tag, value in struct.iter_unpack("<qQ", content[segment[2] : segment[2] + segment[5]]):
        if tag == end:
            return
        yield tag, value


def _elf_exports(content: bytes) -> Iterator[str]:
    """Read the section of dynamic symbols (System V ABI, ELF-64 object file format)."""
    dynamic_symbols, undefined, local = 11, 0, 0
    # name, type, flags, address, offset, size, link
    sections = _elf_table(content, 0x28, 0x3A, "<2I4QI")
    for _, kind, _, _, offset, length, link in sections:
        if kind == dynamic_symbols:
            names = sections[link][4]
            for position in range(offset, offset + length, 24):
                name, info, _, section = struct.unpack_from("<I2BH", content, position)
                if section != undefined and info >> 4 != local:
                    yield _text(content, names + name)


def _pe_exports(content: bytes) -> Iterator[str]:
    """Read the export directory (Microsoft, PE format, sections "Optional header" and ".edata")."""
    (header,) = struct.unpack_from("<I", content, 0x3C)
    (n_sections,) = struct.unpack_from("<H", content, header + 6)
    (optional_size,) = struct.unpack_from("<H", content, header + 20)
    optional = header + 24
    sections: list[tuple[int, ...]] = [
        struct.unpack_from("<4I", content, optional + optional_size + 40 * index + 8)
        for index in range(n_sections)
    ]

    def offset_of(address: int) -> int:
        for virtual_size, start, raw_size, offset in sections:
            if start <= address < start + max(virtual_size, raw_size):
                return offset + address - start
        raise IndexError(f"no section holds the address {address:#x}")

    (directory,) = struct.unpack_from("<I", content, optional + 112)
    if not directory:
        return
    count, _, names = struct.unpack_from("<3I", content, offset_of(directory) + 24)
    table = offset_of(names) if count else 0
    for (address,) in struct.iter_unpack("<I", content[table : table + 4 * count]):
        yield _text(content, offset_of(address))


def _macho_exports(content: bytes) -> Iterator[str]:
    """Read the symbol table (Apple, Mach-O file format reference); C names have an underscore before them."""
    symbol_table, private, external, in_section, type_mask = 0x2, 0x10, 0x01, 0x0E, 0x0E
    (n_commands,) = struct.unpack_from("<I", content, 16)
    position = 32
    for _ in range(n_commands):
        command, size = struct.unpack_from("<2I", content, position)
        if command == symbol_table:
            symbols, count, names, _ = struct.unpack_from("<4I", content, position + 8)
            for index in range(count):
                name, kind = struct.unpack_from("<IB", content, symbols + 16 * index)
                if kind & external and not kind & private and kind & type_mask == in_section:
                    yield _text(content, names + name).removeprefix("_")
        position += size


def universal_binary(libraries: Sequence[bytes]) -> bytes:
    """Return one library that contains all of these 64-bit Mach-O libraries."""
    page = 1 << _ALIGNMENT
    table = _UNIVERSAL_HEADER.pack(_UNIVERSAL_MAGIC, len(libraries))
    content = bytearray(page)
    for library in libraries:
        content += bytes(-len(content) % page)
        processor = _PROCESSOR.unpack_from(library, 4)
        table += _UNIVERSAL_ENTRY.pack(*processor, len(content), len(library), _ALIGNMENT)
        content += library
    content[: len(table)] = table
    return bytes(content)
