"""Files that are written as a whole or not at all."""

import errno
from pathlib import Path

import pytest

from fmu_plants.files import cached, write_atomically


def no_space_left(path, _):
    path.touch()
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_file_replaces_an_older_one_whole(tmp_path, monkeypatch):
    path = tmp_path / "a"
    write_atomically(path, b"old")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", no_space_left)
        with pytest.raises(OSError, match="No space"):
            write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    write_atomically(path, b"new\n")
    assert path.read_bytes() == b"new\n"
    assert list(tmp_path.iterdir()) == [path]


def test_it_may_be_read_by_whoever_may_read_new_files(tmp_path):
    write_atomically(tmp_path / "a", b"")
    (tmp_path / "b").touch()
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_a_cache_that_cannot_be_written_to_can_be_elsewhere(cache, monkeypatch):
    monkeypatch.setattr(Path, "write_bytes", no_space_left)
    with pytest.raises(OSError, match=r"folder/a: .*No space left on device; set DDPC_COSIM_CACHE"):
        cached("folder/a", lambda: b"")


def test_a_file_of_the_cache_is_made_once(cache):
    path = cached("a/b/c", lambda: b"made")
    assert cached("a/b/c", lambda: b"again") == path == cache / "a" / "b" / "c"
    assert path.read_bytes() == b"made"
