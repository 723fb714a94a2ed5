"""What is compiled in place of libraries of old Fortran compilers, which current systems do not have."""

import ctypes
import hashlib
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from fmus.builder import LAG, describe, model_library, write_fmu
from fmus.fortran import OF_GCC_7, OLD, USUAL, link
from hypothesis import given, strategies as st
from studies import PENDULUM, cases_in, study_text, write

from ddpc_cosim.errors import CosimWarning, FMUImportError
from ddpc_cosim.fmu.companions import missing_for_good
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.fmu.stand_ins import STAND_INS
from ddpc_cosim.inspection import inspect_fmu
from ddpc_cosim.study import plants
from ddpc_cosim.study.cases import Case, _code_and_files
from ddpc_cosim.study.plants import PlantSpec
from fmu_plants.export.binaries import WantedSymbol
from fmu_plants.export.compiler import find_compiler

from .test_tolerant_reading import value_after_a_second


def lag_fmu(folder: Path, library: bytes) -> Path:
    return write_fmu(folder / "lag.fmu", describe("2.0", "lag", LAG), library)


def places_of(path: Path, kind: str) -> str:
    return "; ".join(
        place for defect in inspect_fmu(path).defects if defect.kind.name == kind for place in defect.places
    )


def naming_case(folder: Path) -> Case:
    """Return a case whose plant is another one, and whose controller names the FMU of a folder."""
    held = "tests.ddpc_cosim.study.test_setting_files:Held"
    settings = {"source": {"path": "lag.fmu"}}
    controllers = {"held": {"type": held, "settings": settings}}
    text = study_text(
        plant=PENDULUM,
        reference={PENDULUM["outputs"][0]: 0.0},
        controllers=controllers,
        loop={"duration": 0.5},
    )
    (case,) = cases_in(write(folder, text))
    return case


def refusal_of(path: Path) -> str:
    with FMUPlant(path) as plant, pytest.raises(FMUImportError) as refusal:
        plant.reset()
    return str(refusal.value)


@pytest.mark.parametrize(("name", "versions"), [(OLD, USUAL), ("libgfortran.so.4", OF_GCC_7)])
@pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")
def test_an_fmu_that_takes_what_there_is_runs(
    tmp_path: Path, name: str, versions: dict[str, Sequence[str]]
) -> None:
    path = lag_fmu(tmp_path, link(tmp_path, versions, name))
    assert inspect_fmu(path).can_run
    assert places_of(path, "stand-in") == name
    assert value_after_a_second(path) == pytest.approx(0.6321206, abs=1e-5)
    with FMUPlant(path, inputs=["u"], outputs=["x"], isolated=True) as plant:
        assert plant.reset() == [0.0]
        assert plant.provenance()["fmu_libraries"] == f"{name}: stand-in {STAND_INS[name].digest}"
        assert f"needs {name}, which is neither" in plant.provenance()["fmu_warnings"]


def test_a_warning_tells_of_it(tmp_path: Path) -> None:
    path = lag_fmu(tmp_path, link(tmp_path, USUAL))
    with pytest.warns(CosimWarning, match=f"needs {OLD}, which is neither in the FMU nor .* a stand-in"):
        FMUPlant(path).close()


@pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")
def test_its_source_is_part_of_a_cases_id_where_it_is_used(tmp_path: Path) -> None:
    path = lag_fmu(tmp_path, link(tmp_path, USUAL))
    hashed = hashlib.sha256(path.read_bytes()).hexdigest()
    built = PlantSpec("", str(path)).built()
    assert built.content == f"{hashed} {OLD} stand-in {STAND_INS[OLD].digest}"
    assert built.files == (str(path),)


def test_so_it_is_where_a_setting_of_a_controller_names_the_fmu(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lag_fmu(tmp_path, link(tmp_path, USUAL))
    stand_in = STAND_INS[OLD]
    other = replace(
        stand_in, functions={**stand_in.functions, "GFORTRAN_9": {"more": "void _gfortran_more(void) {}\n"}}
    )
    before = naming_case(tmp_path).id
    assert naming_case(tmp_path).id == before
    plants._stand_ins.cache_clear()
    monkeypatch.setitem(STAND_INS, OLD, other)
    after = _code_and_files(naming_case(tmp_path))
    assert after["stand_ins"] == [{OLD: f"stand-in {other.digest}"}]
    assert naming_case(tmp_path).id != before


def test_ids_of_cases_without_one_do_not_know_of_it(tmp_path: Path) -> None:
    write_fmu(tmp_path / "lag.fmu", describe("2.0", "lag", LAG), model_library("2.0"))
    assert _code_and_files(naming_case(tmp_path)).keys() == {
        "code",
        "files",
        "plants",
    }


@pytest.mark.parametrize(
    ("versions", "lacking"),
    [
        ({"GFORTRAN_1.0": ("concat_string", "st_read")}, "_gfortran_st_read (GFORTRAN_1.0)"),
        ({"GFORTRAN_1.0": ("matmul_r8",)}, "_gfortran_matmul_r8 (GFORTRAN_1.0)"),
        ({"GFORTRAN_9": ("concat_string",)}, "_gfortran_concat_string (GFORTRAN_9)"),
    ],
)
def test_one_that_takes_more_is_refused(
    tmp_path: Path, versions: dict[str, Sequence[str]], lacking: str
) -> None:
    path = lag_fmu(tmp_path, link(tmp_path, versions))
    assert places_of(path, "missing-library") == f"{OLD} (the stand-in for {OLD} does not have {lacking})"
    assert not inspect_fmu(path).can_run
    refusal = refusal_of(path)
    assert f"needs {OLD}, which is neither in the FMU nor on this machine" in refusal
    assert f"does not have {lacking}" in refusal


@pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")
def test_so_is_one_that_needs_another_missing_library(tmp_path: Path) -> None:
    (tmp_path / "other.c").write_text("int other(void) { return 0; }", encoding="utf-8")
    soname = "-Wl,-soname,libother.so.3"
    find_compiler().run(["-shared", "-fPIC", soname, "-o", "libother.so.3", "other.c"], tmp_path)
    path = lag_fmu(tmp_path, link(tmp_path, USUAL, OLD, "libother.so.3"))
    assert places_of(path, "missing-library") == "libother.so.3"
    assert places_of(path, "stand-in") == OLD
    assert "its library needs libother.so.3, which is neither" in refusal_of(path)


def test_nothing_stands_in_for_one_that_the_fmu_brings_along(tmp_path: Path) -> None:
    library = link(tmp_path, {"GFORTRAN_1.0": ("st_read",)})
    folder = tmp_path / "fmu" / "resources" / "lib"
    folder.mkdir(parents=True)
    (tmp_path / "fmu" / "main.so").write_bytes(library)
    assert missing_for_good(tmp_path / "fmu" / "main.so", folder.parent) != {}
    (folder / OLD).write_bytes((tmp_path / OLD).read_bytes())
    assert missing_for_good(tmp_path / "fmu" / "main.so", folder.parent) == {}


def test_nor_for_one_that_the_system_has(tmp_path: Path) -> None:
    library = link(tmp_path, USUAL)
    (tmp_path / "fmu").mkdir()
    (tmp_path / "fmu" / "main.so").write_bytes(library)
    code = (
        "import sys; from pathlib import Path; from ddpc_cosim.fmu.companions import missing_for_good; "
        "print(missing_for_good(Path(sys.argv[1], 'main.so'), Path(sys.argv[1], 'resources')))"
    )
    for folder, found in ((tmp_path, "{}"), (tmp_path / "fmu", f"{{'{OLD}': ''}}")):
        done = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "fmu")],
            env={"LD_LIBRARY_PATH": str(folder), "PATH": "/usr/bin:/bin"},
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.strip() == found


def test_without_a_compiler_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = lag_fmu(tmp_path, link(tmp_path, USUAL))
    monkeypatch.setenv("CC", "no-such-compiler")
    assert "would do, but the C compiler of the environment variable CC" in places_of(path, "missing-library")
    assert "would do, but the C compiler of the environment variable CC" in refusal_of(path)


def test_functions_without_a_version_are_known_by_their_names() -> None:
    stand_in = STAND_INS[OLD]
    known, unknown, other = (
        WantedSymbol(name, "", "") for name in ("_gfortran_string_trim", "_gfortran_sum_r8", "dgesv_")
    )
    assert stand_in.lacks([known, other]) == []
    assert stand_in.lacks([known, unknown]) == ["_gfortran_sum_r8"]


def test_of_numbers_of_128_bits_there_is_nothing() -> None:
    """FMUs are linked with their library and commonly take nothing from it."""
    stand_in = STAND_INS["libquadmath.so.0"]
    assert stand_in.lacks([WantedSymbol("_gfortran_st_write", OLD, "GFORTRAN_1.0")]) == []
    assert stand_in.lacks([WantedSymbol("expq", "libquadmath.so.0", "QUADMATH_1.0")]) == [
        "expq (QUADMATH_1.0)"
    ]


@pytest.fixture(scope="module")
def fortran() -> ctypes.CDLL:
    library = ctypes.CDLL(str(STAND_INS[OLD].compiled(print)))
    for name in ("string_len_trim", "string_index", "string_scan", "string_verify", "compare_string"):
        getattr(library, f"_gfortran_{name}").restype = ctypes.c_int32
    return library


TEXTS = st.binary(max_size=8).map(lambda text: text.replace(b"\0", b" "))
SHORT = st.text("ab ", max_size=6).map(str.encode)


@given(first=TEXTS, second=TEXTS, length=st.integers(0, 20))
def test_concatenation_pads_and_cuts(fortran: ctypes.CDLL, first: bytes, second: bytes, length: int) -> None:
    result = ctypes.create_string_buffer(b"#" * (length + 1))
    fortran._gfortran_concat_string(length, result, len(first), first, len(second), second)
    assert result.raw[:length] == (first + second).ljust(length)[:length]
    assert result.raw[length : length + 1] == b"#"


@given(first=TEXTS, second=TEXTS)
def test_comparison_is_that_of_texts_of_one_length(fortran: ctypes.CDLL, first: bytes, second: bytes) -> None:
    order = fortran._gfortran_compare_string(len(first), first, len(second), second)
    length = max(len(first), len(second))
    padded = first.ljust(length), second.ljust(length)
    assert (order > 0) - (order < 0) == (padded[0] > padded[1]) - (padded[0] < padded[1])


@given(text=SHORT, part=SHORT)
def test_trimming_and_searching(fortran: ctypes.CDLL, text: bytes, part: bytes) -> None:
    assert fortran._gfortran_string_len_trim(len(text), text) == len(text.rstrip(b" "))
    length, result = ctypes.c_int32(), ctypes.c_char_p()
    fortran._gfortran_string_trim(ctypes.byref(length), ctypes.byref(result), len(text), text)
    assert ctypes.string_at(result, length.value) == text.rstrip(b" ")
    places = (len(text), text, len(part), part)
    assert fortran._gfortran_string_index(*places, 0) == text.find(part) + 1
    assert fortran._gfortran_string_index(*places, 1) == text.rfind(part) + 1
    inside = [i + 1 for i, letter in enumerate(text) if letter in part]
    outside = [i + 1 for i, letter in enumerate(text) if letter not in part]
    for name, found in (("scan", inside), ("verify", outside)):
        search = getattr(fortran, f"_gfortran_string_{name}")
        assert search(*places, 0) == (found or [0])[0]
        assert search(*places, 1) == (found or [0])[-1]


@given(text=SHORT)
def test_adjusting(fortran: ctypes.CDLL, text: bytes) -> None:
    for side, adjusted in (("l", text.lstrip(b" ").ljust), ("r", text.rstrip(b" ").rjust)):
        result = ctypes.create_string_buffer(len(text) + 1)
        getattr(fortran, f"_gfortran_adjust{side}")(result, len(text), text)
        assert result.raw[:-1] == adjusted(len(text))


@pytest.mark.parametrize("bits", [(32, 32), (32, 64), (64, 32), (64, 64)])
@given(data=st.data())
def test_powers_of_integers(fortran: ctypes.CDLL, bits: tuple[int, int], data: st.DataObject) -> None:
    limits = [(-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in bits]
    base = data.draw(st.one_of(st.integers(-3, 3), st.integers(*limits[0])))
    exponent = data.draw(st.one_of(st.integers(-3, 40), st.integers(*limits[1])))
    kinds = [getattr(ctypes, f"c_int{n}") for n in bits]
    power = getattr(fortran, f"_gfortran_pow_i{bits[0] // 8}_i{bits[1] // 8}")
    power.argtypes, power.restype = kinds, kinds[0]
    if exponent < 0:
        if base != 0:
            exact = base if base in (1, -1) and exponent % 2 else int(base in (1, -1))
            assert power(base, exponent) == exact
        return
    assert power(base, exponent) == kinds[0](pow(base, exponent, 2 ** bits[0])).value


@given(base=st.floats(-3, 3).filter(lambda base: abs(base) > 0.1), exponent=st.integers(-20, 20))
def test_powers_of_reals(fortran: ctypes.CDLL, base: float, exponent: int) -> None:
    power = fortran._gfortran_pow_r8_i8
    power.argtypes, power.restype = (ctypes.c_double, ctypes.c_int64), ctypes.c_double
    assert power(base, exponent) == pytest.approx(base**exponent, rel=1e-14)


STATEMENT = """
import ctypes, sys
class Statement(ctypes.Structure):
    _fields_ = [("flags", ctypes.c_int32), ("unit", ctypes.c_int32), ("file", ctypes.c_char_p),
                ("line", ctypes.c_int32), ("message_length", ctypes.c_int32), ("message", ctypes.c_char_p),
                ("status", ctypes.c_void_p), ("record", ctypes.c_int64), ("others", ctypes.c_void_p * 3),
                ("format", ctypes.c_char_p), ("format_length", ctypes.c_int32), ("rest", ctypes.c_byte * 500)]
f = ctypes.CDLL(sys.argv[1])
number, status = ctypes.c_int32(7), ctypes.c_int32(5)
"""


def run_fortran(code: str) -> subprocess.CompletedProcess[str]:
    library = str(STAND_INS[OLD].compiled(print))
    command = [sys.executable, "-c", STATEMENT + code, library]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_what_is_written_to_the_screen_goes_to_stderr() -> None:
    done = run_fortran(
        "s = Statement(1 << 12 | 1 << 5, 6, format=b'(A, I2)', format_length=7)\n"
        "s.status = ctypes.addressof(status)\n"
        "f._gfortran_st_write(ctypes.byref(s))\n"
        "f._gfortran_transfer_character_write(ctypes.byref(s), b'DGETRF', 6)\n"
        "f._gfortran_transfer_integer_write(ctypes.byref(s), ctypes.byref(number), 4)\n"
        "f._gfortran_st_write_done(ctypes.byref(s))\n"
        "print(status.value)"
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "0\n", "Fortran: (A, I2): DGETRF 7\n")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("f._gfortran_st_write(ctypes.byref(Statement(1 << 14, -1)))", "writes into a text by Fortran"),
        ("f._gfortran_st_write(ctypes.byref(Statement(1 << 12, 10)))", "writes to a file by Fortran"),
        ("f._gfortran_pow_i4_i4(0, -1)", "0 to a negative power"),
    ],
)
def test_what_it_cannot_do_ends_the_process(code: str, words: str) -> None:
    done = run_fortran(code)
    assert done.returncode < 0
    assert words in done.stderr


@pytest.mark.parametrize(
    ("code", "status", "words"),
    [
        ("f._gfortran_stop_string(b'no more', 4)", 0, "STOP no m\n"),
        ("f._gfortran_stop_numeric(3)", 3, "STOP 3\n"),
        ("f._gfortran_error_stop_string(b'out', 3)", 1, "ERROR STOP out\n"),
        ("f._gfortran_error_stop_numeric(4)", 4, "ERROR STOP 4\n"),
        ("f._gfortran_runtime_error(b'%d items', 7)", 2, "Fortran runtime error: 7 items\n"),
        ("f._gfortran_runtime_error_at(b'At line 1', b'bad')", 2, "At line 1\nFortran runtime error: bad\n"),
        ("f._gfortran_os_error(b'no memory')", 1, "Fortran, operating system error: no memory\n"),
    ],
)
def test_what_ends_a_program_ends_the_process(code: str, status: int, words: str) -> None:
    done = run_fortran(code)
    assert (done.returncode, done.stderr) == (status, words)
