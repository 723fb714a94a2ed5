"""What an ELF library takes from others, as its file says it."""

import pytest
from hypothesis import given, strategies as st

from fmu_plants.export.binaries import WantedSymbol, needed_libraries, wanted_symbols
from fmu_plants.export.compiler import find_compiler
from fmu_plants.export.platforms import host_platform

HOST = host_platform()


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a library that takes functions of a versioned one, one that is nowhere, and a weak one."""
    folder = tmp_path_factory.mktemp("wanted")
    for name, text in {
        "old.map": "OLD_1.0 { global: first; }; OLD_1.4 { global: second; } OLD_1.0;",
        "old.c": "void first(void) {} void second(void) {}",
        "main.c": "void first(void); void second(void); void third(void);"
        "__attribute__((weak)) void fourth(void);"
        "void all(void) { first(); second(); third(); if (fourth) fourth(); }",
    }.items():
        (folder / name).write_text(text, encoding="utf-8")
    run, flags = find_compiler().run, ["-shared", "-fPIC"]
    run(
        [*flags, "-Wl,-soname,libold.so.3", "-Wl,--version-script=old.map", "-o", "libold.so", "old.c"],
        folder,
    )
    run([*flags, "-o", "main.so", "main.c", "libold.so"], folder)
    return (folder / "main.so").read_bytes()


def test_each_symbol_has_its_library_and_version(library: bytes) -> None:
    assert wanted_symbols(library) >= {
        WantedSymbol("first", "libold.so.3", "OLD_1.0"),
        WantedSymbol("second", "libold.so.3", "OLD_1.4"),
        WantedSymbol("third", "", ""),
    }
    assert {symbol.name for symbol in wanted_symbols(library)} == {"first", "second", "third"}


def test_other_formats_are_not_read() -> None:
    assert wanted_symbols(b"") == wanted_symbols(b"MZ") == frozenset()


def test_tables_beyond_every_file_are_damage(library: bytes) -> None:
    for place in (0x20, 0x28):  # where the header says that segments and sections are
        for offset in (2**62, 2**64 - 1):
            damaged = library[:place] + offset.to_bytes(8, "little") + library[place + 8 :]
            read = needed_libraries if place == 0x20 else wanted_symbols
            with pytest.raises(ValueError, match="damaged"):
                read(damaged)


@given(data=st.data())
def test_damage_is_an_error_of_its_own_and_takes_no_time(library: bytes, data: st.DataObject) -> None:
    """A loop of entries, or a table of a billion of them, ends."""
    damaged = bytearray(library)
    for _ in range(data.draw(st.integers(1, 8))):
        damaged[data.draw(st.integers(6, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        symbols = wanted_symbols(bytes(damaged[: data.draw(st.integers(0, len(damaged)))]))
    except ValueError:
        return
    assert all(len(symbol.name) <= 255 for symbol in symbols)
