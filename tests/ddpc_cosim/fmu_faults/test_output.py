"""What FMUs print in this process stays out of the terminal; what this process prints does not."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import library_name

from ddpc_cosim import FMUPlant
from ddpc_cosim.fmu import output
from fmu_plants.export.compiler import compile_library, find_compiler

from .loop import H


def test_around_rare_calls(capfd: pytest.CaptureFixture[str]) -> None:
    """Whatever is written meanwhile is lost; everything before and after comes out, in its order."""
    print("before", flush=True)
    with output.quiet():
        os.write(1, b"lost")
        os.write(2, b"lost")
        with output.quiet():
            os.write(1, b"lost")
        os.write(1, b"lost")
    print("after", flush=True)
    assert capfd.readouterr() == ("before\nafter\n", "")


def test_an_error_does_not_mute_for_good(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ZeroDivisionError), output.quiet():
        raise ZeroDivisionError
    print("after", flush=True)
    assert capfd.readouterr().out == "after\n"


def test_this_process_may_print_between_steps(
    faulty_fmus: dict[int, Path], capfd: pytest.CaptureFixture[str]
) -> None:
    with FMUPlant(faulty_fmus[2]) as plant:
        plant.reset()
        print("one", flush=True)
        plant.step(np.ones(1), H)
        print("two", file=sys.stderr, flush=True)
    assert capfd.readouterr() == ("one\n", "two\n")


BY_STREAMS = """
#include <stdio.h>
void say(const char *text) { puts(text); fprintf(stderr, "%s %d", text, 1); fwrite(text, 1, 1, stdout); }
"""
BY_DESCRIPTORS = """
#include <stdio.h>
long write(int, const void *, unsigned long);
void say(const char *text) { write(1, text, 1); fwrite(text, 1, 1, stdout); }
"""


@pytest.mark.parametrize(("source", "streams_only"), [(BY_STREAMS, True), (BY_DESCRIPTORS, False)])
def test_the_cheapest_mute(source: str, streams_only: bool, tmp_path: Path) -> None:
    """A library that can write past C's streams makes steps dearer; nothing is assumed of unknown kinds."""
    library = compile_library(find_compiler(), {"say.c": source}, [], ["-fvisibility=default"])
    (tmp_path / "library").write_bytes(library)
    is_known = library.startswith(b"\x7fELF")
    expected = output.imported_symbols(library) & {b"write", b"puts"} if is_known else set()
    assert expected == ({b"puts"} if streams_only else {b"write"} if is_known else set())
    cheapest = output.step_mute(tmp_path)
    (tmp_path / "other").write_bytes(b"some other kind of file")
    assert (cheapest is not output.step_mute(tmp_path)) == (is_known and streams_only)


def test_a_damaged_library(files: Mapping[str, bytes], tmp_path: Path) -> None:
    """Nothing is assumed of it either."""
    library = files[library_name("2.0")]
    mutes = []
    for length in (0, 20, 70, len(library) // 2):
        (tmp_path / "library").write_bytes(library[:length])
        mutes.append(output.step_mute(tmp_path))
    (tmp_path / "library").write_bytes(b"another kind of file")
    assert all(mute is output.step_mute(tmp_path) for mute in mutes)
