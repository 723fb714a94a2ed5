"""A case on disk: written, read back, damaged."""

import errno
import json
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from ddpc_cosim import (
    ConfigError,
    CosimError,
    DisplayUnit,
    Outcome,
    StudyResults,
    Trace,
    Variable,
    load_results,
)
from ddpc_cosim.controller import Bounds
from ddpc_cosim.study import case_files
from ddpc_cosim.study.case_files import (
    load_case,
    read_run,
    read_trace,
    sealed_json,
    write_case,
)
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.results import write_results
from ddpc_cosim.study.runner import Selection

HEAD = {"id": "case", "controller": "a", "label": "A", "scenario": "nominal", "seed": 0}

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
FINITE = st.floats(-1e9, 1e9)
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]), min_size=1, max_size=8)
NAMES = TEXTS | st.sampled_from(
    ["time", "solve_time", "status", "der(x)", "a b", 'q"q', "a,b", "größe", "x[1]"]
)


@st.composite
def variables(draw: st.DrawFn, name: str) -> Variable:
    """Return a variable of a given name with anything else."""
    shown = draw(st.none() | st.builds(DisplayUnit, TEXTS, st.floats(0.1, 10.0), FINITE))
    low, high = draw(st.sampled_from([(-math.inf, math.inf), (-1.0, 2.0), (-math.inf, 0.0)]))
    unit = draw(st.sampled_from(["", "s", "rad", "N.m", "°C"]))
    return Variable(name, unit, low, high, 2.0, draw(FINITE), draw(TEXTS), shown)


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    """Return a trace of any shape with any numbers."""
    rows = draw(st.integers(0, 4))
    names = draw(st.lists(NAMES, min_size=2, max_size=6, unique=True))
    p = draw(st.integers(1, len(names) - 1))
    outputs = tuple(draw(variables(name)) for name in names[:p])
    inputs = tuple(draw(variables(name)) for name in names[p:])
    measurements = tuple(draw(st.lists(st.sampled_from(outputs), min_size=1, max_size=p, unique=True)))

    def table(columns: int) -> Any:
        return draw(arrays.arrays(float, (rows, columns), elements=NUMBERS))

    y = table(p)
    noisy = draw(st.booleans())
    measured = table(len(measurements)) if noisy else y[:, [outputs.index(v) for v in measurements]]
    limits = [draw(st.sampled_from([-math.inf, 0.0, math.inf])) for _ in range(2)]
    changed_inputs = tuple(draw(st.lists(st.sampled_from(inputs), unique=True)))
    return Trace(
        time=np.arange(rows, dtype=np.float64) * 0.1,
        reference=table(p),
        y=y,
        measured=measured,
        u=table(len(inputs)),
        status=tuple(draw(st.lists(TEXTS, min_size=rows, max_size=rows))),
        solve_time=table(1)[:, 0],
        inputs=inputs,
        outputs=outputs,
        measurements=measurements,
        bounds=Bounds(
            np.full(len(inputs), limits[0]),
            np.full(len(inputs), math.inf),
            np.zeros(p),
            np.full(p, limits[1]),
        ),
        sampling_time=0.1,
        planned_samples=draw(st.integers(0, 10)),
        preview=draw(st.integers(0, 10)),
        outcome=draw(st.sampled_from(list(Outcome))),
        reason=draw(st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), max_size=20)),
        settings={"horizon": 5, "weight": [[1.0, 0.0], [0.0, 2.0]], "on": True},
        diagnostics={"rank": draw(NUMBERS)},
        recorded_samples=draw(st.integers(0, 10)),
        knowledge={"measures": "größe"},
        provenance={"fmu": "größe.fmu"},
        changed_inputs=changed_inputs,
        applied=table(len(changed_inputs)),
        info={name: table(1)[:, 0] for name in draw(st.sets(st.sampled_from(["cost", "a, b", "größe"])))},
    )


def assert_same(a: Any, b: Any) -> None:
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert np.array_equal(a, b, equal_nan=True)
        assert np.array_equal(np.signbit(a)[~np.isnan(a)], np.signbit(b)[~np.isnan(b)])
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, float) and math.isnan(a):
        assert math.isnan(b)
    else:
        assert a == b


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(traces(), st.sampled_from(["csv", "parquet"]))
def test_a_trace_is_read_as_it_was_written_to_the_last_bit(
    tmp_path: Path, trace: Trace, storage: str
) -> None:
    write_case(tmp_path / "case", trace, HEAD | {"storage": storage})
    assert {path.name for path in (tmp_path / "case").iterdir()} == {"run.json", f"signals.{storage}"}
    again = read_trace(tmp_path / "case")
    for name in Trace.__slots__:
        if name == "bounds":
            for side in Bounds.__slots__:
                assert_same(getattr(trace.bounds, side), getattr(again.bounds, side))
        else:
            assert_same(getattr(trace, name), getattr(again, name))
    assert [path.name for path in tmp_path.iterdir()] == ["case"]


@pytest.fixture
def trace() -> Trace:
    signal = Variable("y", "m")
    return Trace(
        time=np.arange(2.0),
        reference=np.zeros((2, 1)),
        y=np.array([[0.1], [0.3]]),
        measured=np.array([[0.1], [0.3]]),
        u=np.array([[1.0], [2.0]]),
        status=("ok", "ok"),
        solve_time=np.full(2, 1e-3),
        inputs=(Variable("u", "N"),),
        outputs=(signal,),
        measurements=(signal,),
        bounds=Bounds(*(np.array([value]) for value in (-math.inf, math.inf, -1.0, 1.0))),
        sampling_time=1.0,
        planned_samples=2,
    )


def test_the_files_can_be_read_without_this_program(tmp_path: Path, trace: Trace) -> None:
    write_case(tmp_path / "case", trace, HEAD)
    assert (tmp_path / "case" / "signals.csv").read_bytes() == (
        b"time [s],reference y [m],y [m],u [N],solve_time [s],status\n"
        b"0.0,0.0,0.1,1.0,0.001,ok\n"
        b"1.0,0.0,0.3,2.0,0.001,ok\n"
    )
    run = json.loads((tmp_path / "case" / "run.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert run["controller"] == "a"
    assert run["outcome"] == "completed"
    assert run["bounds"]["u_max"] == ["inf"]
    assert run["metrics"]["sum_abs_error.y [m]"] == 0.1


def test_names_and_units_of_any_characters_cost_no_case(tmp_path: Path, trace: Trace) -> None:
    signal = Variable('y\r\n\u202e\x9b"', "m\r")
    trace = replace(trace, outputs=(signal,), measurements=(signal,))
    write_case(tmp_path / "case", trace, HEAD)
    again = read_trace(tmp_path / "case")
    assert again.outputs == (signal,)
    assert_same(again.y, trace.y)
    header = (tmp_path / "case" / "signals.csv").read_text(encoding="utf-8").splitlines()[0]
    assert '"y\\r\\n\\u202e\\x9b"" [m\\r]"' in header


def test_a_case_replaces_an_older_one_whole(tmp_path: Path, trace: Trace) -> None:
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "old").touch()
    write_case(tmp_path / "case", trace, HEAD)
    assert sorted(path.name for path in (tmp_path / "case").iterdir()) == ["run.json", "signals.csv"]


def test_a_case_that_cannot_be_written_leaves_the_older_one(
    tmp_path: Path, trace: Trace, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_case(tmp_path / "case", trace, HEAD)

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(case_files, "write_table", fail)
    words = r"case: cannot be written: No space left on device; finished cases are kept"
    with pytest.raises(CosimError, match=words):
        write_case(tmp_path / "case", trace, HEAD)
    assert len(read_trace(tmp_path / "case")) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["case"]


def test_a_case_that_another_run_wrote_meanwhile_is_kept(
    tmp_path: Path, trace: Trace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two runs may work in one folder; what decides the result of a case is in its name.

    Where folders cannot be locked, the other run comes between the two moves of one.
    """
    write_table = case_files.write_table

    def let_the_other_in(path: Path, *columns: Any) -> None:
        monkeypatch.setattr(case_files, "write_table", write_table)
        (tmp_path / "theirs").mkdir()
        for place in (tmp_path / "case", tmp_path / "theirs/case"):
            write_case(place, trace, HEAD | {"label": "theirs"}, tmp_path / "theirs")
        write_table(path, *columns)
        monkeypatch.setattr(Path, "replace", refuse_once)

    replace = Path.replace

    def refuse_once(path: Path, target: Path) -> Path:
        if target == tmp_path / "case":
            monkeypatch.setattr(Path, "replace", replace)
            (tmp_path / "theirs/case").replace(target)
            raise OSError(errno.ENOTEMPTY, "Directory not empty")
        return replace(path, target)

    monkeypatch.setattr(case_files, "write_table", let_the_other_in)
    write_case(tmp_path / "case", trace, HEAD | {"label": "ours"}, tmp_path)
    assert load_case(tmp_path / "case").label == "theirs"
    assert len(read_trace(tmp_path / "case")) == 2
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["case", "run.json", "signals.csv", "theirs"]


def test_figures_that_do_not_exist_are_nan_again(tmp_path: Path, trace: Trace) -> None:
    write_case(tmp_path / "case", trace, HEAD)
    assert math.isnan(read_run(tmp_path / "case")["metrics"]["overshoot.y [%]"])


DAMAGE: dict[str, Callable[[bytes], bytes | None]] = {
    "deleted": lambda content: None,
    "empty": lambda content: b"",
    "half the rows": lambda content: b"".join(content.splitlines(keepends=True)[:2]),
    "zeroed": lambda content: bytes(len(content)),
    "another value": lambda content: content.replace(b"0", b"1e300", 1),
    "another figure": lambda content: content.replace(b"0", b"7"),
    "a blank": lambda content: content + b" ",
    "another blank": lambda content: content.replace(b"\n", b"\r\n"),
    "null": lambda content: b"null",
    "a list": lambda content: b"[]",
    "nothing in it": lambda content: b"{}",
    "wrong types": lambda content: b'{"metrics": 3}',
    "not UTF-8": lambda content: b'{"a": "\xff"}',
    "nested": lambda content: b"[" * 100_000,
}


@pytest.mark.parametrize("file", ["run.json", "signals.csv"])
@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_case_is_named(
    tmp_path: Path, trace: Trace, file: str, damage: Callable[[bytes], bytes | None]
) -> None:
    write_case(tmp_path / "case", trace, HEAD)
    case, path = load_case(tmp_path / "case"), tmp_path / "case" / file
    content = damage(path.read_bytes())
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    words = rf"case: damaged: {file}.*; run the study again, which runs only what is damaged"
    for read in (lambda: load_case(tmp_path / "case"), case.trace):
        with pytest.raises(ConfigError, match=words):
            read()


def test_the_files_of_another_case_are_not_taken_for_this_one_s(tmp_path: Path, trace: Trace) -> None:
    write_case(tmp_path / "case", trace, HEAD)
    (tmp_path / "case").rename(tmp_path / "other")
    with pytest.raises(ConfigError, match=r"other: damaged: run\.json is of case case"):
        load_case(tmp_path / "other")


def test_any_byte_of_a_parquet_file_that_has_changed_is_noticed(tmp_path: Path, trace: Trace) -> None:
    write_case(tmp_path / "case", trace, HEAD | {"storage": "parquet"})
    path = tmp_path / "case" / "signals.parquet"
    content = path.read_bytes()
    words = r"signals\.parquet is not what was written: its checksum differs \(2 were written"
    for place in range(len(content)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with pytest.raises(ConfigError, match=words):
            load_case(tmp_path / "case")


def test_parquet_needs_its_extra_before_anything_runs(
    tmp_path: Path, trace: Trace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without it the results can be read, but for the samples."""
    write_case(tmp_path / "case", trace, HEAD | {"storage": "parquet"})
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    remedy = r'a Parquet file needs pyarrow: `pip install "\.\[parquet\]"`'
    with pytest.raises(ConfigError, match=rf"^--storage parquet: {remedy}"):
        Selection(storage="parquet")
    case = load_case(tmp_path / "case")
    with pytest.raises(ConfigError, match=f"^{remedy}"):
        case.trace()


def test_rows_that_are_missing_are_counted(tmp_path: Path, trace: Trace) -> None:
    write_case(tmp_path / "case", trace, HEAD)
    path = tmp_path / "case" / "signals.csv"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:2]))
    with pytest.raises(ConfigError, match=r"its checksum differs \(1 rows, 2 were written\)"):
        load_case(tmp_path / "case")


@pytest.mark.parametrize("content", [{"metrics": 3}, {"metrics": {}, "diagnostics": {}}, {"id": 1}])
def test_a_case_of_another_version_is_damaged(tmp_path: Path, content: dict[str, Any]) -> None:
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "run.json").write_bytes(sealed_json(content))
    with pytest.raises(ConfigError, match=r"case: damaged: "):
        load_case(tmp_path / "case")


def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no results: study\.toml is missing; give the folder that `run`"):
        load_results(tmp_path)


@pytest.mark.parametrize("file", ["study.toml", "provenance.json"])
@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_damaged_results_are_named(
    tmp_path: Path, paper_text: str, file: str, damage: Callable[[bytes], bytes | None]
) -> None:
    study = read_study("paper").whole
    write_results(StudyResults(tmp_path, study, (), {"date": "2020"}))
    assert load_results(tmp_path).whole == study
    path = tmp_path / file
    content = damage(path.read_bytes())
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"study\.toml is missing|damaged: .*; run the study again"):
        load_results(tmp_path)
