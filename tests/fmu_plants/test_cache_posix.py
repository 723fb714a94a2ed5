"""Who may put something into the cache: owners, permissions and links of POSIX."""

import os
from pathlib import Path

import pytest

from fmu_plants.files import cache_dir, cached


def test_folders_of_the_cache_are_for_their_owner_only(cache):
    cached("a/b/c", lambda: b"made")
    assert {(cache / f).stat().st_mode & 0o777 for f in (".", "a", "a/b")} == {0o700}


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def link(path: Path) -> None:
    elsewhere = Path(os.environ["DDPC_COSIM_CACHE"]).with_name("elsewhere")
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def link_folder(path: Path) -> None:
    link(path.parent)


@pytest.mark.parametrize("damage", [cut, Path.unlink, link, link_folder])
@pytest.mark.parametrize("suffix", ["", ".sha256"])
def test_a_file_of_the_cache_that_is_not_what_was_written_is_made_again(cache, damage, suffix):
    path = cached("folder/a", lambda: b"as it was")
    damage(path.with_name(f"a{suffix}"))
    assert cached("folder/a", lambda: b"made again") == path
    assert path.read_bytes() == b"made again"
    assert not path.is_symlink()
    assert not path.parent.is_symlink()
    assert cached("folder/a", lambda: b"a third time").read_bytes() == b"made again"


def test_a_cache_that_others_may_write_to_is_refused(cache):
    cache.mkdir()
    cache.chmod(0o770)
    with pytest.raises(
        PermissionError, match=r"cache: .* by others \(mode 770\); remove it, .* DDPC_COSIM_CACHE"
    ):
        cached("a", lambda: b"")


def test_a_cache_of_another_user_is_refused(cache, monkeypatch):
    cache.mkdir(mode=0o700)
    monkeypatch.setattr(os, "geteuid", lambda: cache.stat().st_uid + 1)
    with pytest.raises(
        PermissionError, match=r"cache: the cache belongs to another user .* DDPC_COSIM_CACHE"
    ):
        cache_dir()
