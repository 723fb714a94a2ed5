"""FMUs in the user's cache folder."""

import shlex
import stat
import subprocess
import sys

import pytest
from fmpy.validation import validate_fmu

import fmu_plants.files
from fmu_plants import ExportError, build_fmu
from fmu_plants.export.compiler import find_compiler
from fmu_plants.files import cached
from fmu_plants.pendulum import MODEL


def test_a_second_build_compiles_nothing(cache, no_compilation):
    path = build_fmu(MODEL)
    assert path.name == "pendulum.fmu"
    assert cache in path.parents
    content = path.read_bytes()
    assert build_fmu(MODEL) == path
    assert len(no_compilation) == 1
    assert path.read_bytes() == content


def test_what_changes_the_fmu_builds_it_anew(cache, no_compilation):
    paths = {build_fmu(MODEL), build_fmu(MODEL, relative_tolerance=1e-8)}
    assert len(paths) == len(no_compilation) == 2


def test_another_compiler_builds_it_anew(cache, no_compilation, monkeypatch):
    paths = {build_fmu(MODEL)}
    monkeypatch.setenv("CC", shlex.join([*find_compiler().command, "-DANOTHER"]))
    paths.add(build_fmu(MODEL))
    assert len(paths) == len(no_compilation) == 2


def test_concurrent_builds_give_one_whole_file(cache):
    program = (
        "from fmu_plants import build_fmu; from fmu_plants.pendulum import MODEL; print(build_fmu(MODEL))"
    )
    processes = [
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) for _ in range(2)
    ]
    paths = {process.communicate()[0].strip() for process in processes}
    assert [process.returncode for process in processes] == [0, 0]
    assert len(paths) == 1
    assert validate_fmu(paths.pop()) == []
    assert len([path for path in cache.rglob("*") if path.is_file()]) == 2  # and its hash


def test_a_file_that_another_process_wrote_first_is_used(cache, no_compilation, monkeypatch):
    path = build_fmu(MODEL)
    content = path.read_bytes()
    path.unlink()

    def slower(target, _):
        target.write_bytes(content)
        raise PermissionError("the file is being read")  # its hash has been written before

    monkeypatch.setattr(fmu_plants.files, "write_atomically", slower)
    assert build_fmu(MODEL) == path


def test_a_folder_that_another_process_makes_meanwhile_is_used(cache, monkeypatch):
    is_own = fmu_plants.files._is_own

    def slower(path, kind):
        was_there = is_own(path, kind)
        if kind == stat.S_IFDIR and not was_there:
            path.mkdir(mode=0o700)
        return was_there

    def made():
        monkeypatch.setattr(fmu_plants.files, "_is_own", slower)
        return b"content"

    assert cached("folder/file", made).read_bytes() == b"content"


def test_a_cache_folder_that_cannot_be_made_is_named(no_compilation, monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(blocked))
    with pytest.raises(ExportError, match="DDPC_COSIM_CACHE"):
        build_fmu(MODEL)
