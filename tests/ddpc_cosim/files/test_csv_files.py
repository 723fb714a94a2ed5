"""CSV files: what is read, and what is said of files that cannot be."""

from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_cosim import ConfigError, DataError, DisplayUnit, Interpolated, Steps, Variable
from ddpc_cosim.files import csv_files
from ddpc_cosim.files.csv_files import Column, read_table, split_unit, write_table
from ddpc_cosim.study.reading import read_study

LEVEL = Variable("level", unit="m")
FLOW = Variable("flow", unit="m3/s")
COLUMNS = [Column(LEVEL, "level"), Column(FLOW, "flow")]


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def faults_of(path: Path, columns: list[Column] = COLUMNS, time_column: str = "time") -> list[str]:
    with pytest.raises(DataError) as raised:
        read_table(path, columns, time_column)
    return [fault.replace(str(path), "log.csv") for fault in raised.value.faults]


@pytest.mark.parametrize(
    "text",
    [
        "time,level,flow\n0,1.5,-2e-3\n0.5,2,0\n",
        "\ufefftime,level,flow\r\n0,1.5,-2e-3\r\n0.5,2,0\r\n",
        "time;level;flow\n0;1,5;-2e-3\n0,5;2;0\n",
        "time;level;flow\n0;1.5;-2e-3\n0.5;2;0\n",
        "time\tlevel\tflow\n0\t1.5\t-2e-3\n0.5\t2\t0\n",
        'flow , "level [m]",note,time [s]\n-2e-3,"1.5","a, b",0\n\n0,2,,0.5\n',
        "time [ms];level [cm];flow [l/s];x\n0;150;-2;a\n500;200;0;\n",
        "time [min],level[mm],flow [m3/h]\n0,1500,-7.2\n0.008333333333333333,2000,0",
        "time,level,flow\n2026-03-01T12:00:00Z,1.5,-2e-3\n2026-03-01 12:00:00.5+00:00,2,0\n",
        "time;level (cm);flow\n01.03.2026 12:00:00;150,0;-2e-3\n01.03.2026 12:00:00,5;200;0\n",
    ],
    ids=[
        "comma",
        "bom",
        "german",
        "semicolon",
        "tab",
        "quoted",
        "units",
        "touching-units",
        "dates",
        "german-dates",
    ],
)
def test_the_same_numbers_in_many_spellings(tmp_path: Path, text: str) -> None:
    time, values = read_table(written(tmp_path, text), COLUMNS, "time")
    assert time == pytest.approx([0.0, 0.5], abs=1e-15)
    assert values == pytest.approx(np.array([[1.5, -2e-3], [2.0, 0.0]]), rel=1e-14)


def test_an_index_is_not_a_unit(tmp_path: Path) -> None:
    assert split_unit("x[1]") == ("x[1]", "")
    assert split_unit("x[1] [kPa]") == ("x[1]", "kPa")
    assert split_unit("ratio [1]") == ("ratio", "1")
    path = written(tmp_path, "x,x[1],x[2] [bar],r [1]\n1,2,3,4\n")
    wanted = [Column(Variable("x[2]", unit="Pa"), "x[2]"), Column(Variable("x[1]"), "x[1]")]
    _, values = read_table(path, [*wanted, Column(Variable("r"), "r")], "")
    assert values.tolist() == [[3e5, 2.0, 4.0]]


def test_units_beyond_those_that_are_usual_and_those_that_an_fmu_defines(tmp_path: Path) -> None:
    path = written(tmp_path, "a [uV],b [turn],c\n1,2,300\n")
    turn = Variable("b", unit="rad", display_unit=DisplayUnit("turn", 0.25))
    columns = [Column(Variable("a", unit="V"), "a"), Column(turn, "b [turn]"), Column(LEVEL, "c", "cm")]
    _, values = read_table(path, columns, "")
    assert values[0] == pytest.approx([1e-6, 8.0, 3.0], rel=1e-14)


def test_every_fault_at_once_with_line_and_column(tmp_path: Path) -> None:
    path = written(tmp_path, "time,level\n0,1\n1,nan\n1,abc\n2,\n3,4,5\n4,1_0\n")
    assert faults_of(path) == [
        'log.csv: no column "flow"; there are: level, time',
        "log.csv, line 6: 3 cells, and 2 columns in the header; a decimal comma needs columns separated by "
        "semicolons",
        'log.csv, line 3, column "level": "nan" is not a finite number',
        'log.csv, line 4, column "level": "abc" is not a finite number',
        'log.csv, line 5, column "level": the cell is empty',
        'log.csv, line 7, column "level": "1_0" is not a finite number',
        'log.csv, line 4, column "time": 1 s is 0 s after the row before; it must increase',
    ]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "log.csv: is empty; needed: a header and one row per sample"),
        ("\n \n", "log.csv: is empty; needed: a header and one row per sample"),
        ("time,level\n", "log.csv: a header and no rows; needed: one row per sample"),
        (
            "time,level,level [cm]\n0,1,100\n",
            "",
        ),
        (
            "time,level [m],level [cm]\n0,1,100\n",
            'log.csv: column "level" is there more than once: "level [m]" (column 2), '
            '"level [cm]" (column 3)',
        ),
        (
            "level,time,level\n1,0,2\n",
            'log.csv: column "level" is there more than once: "level" (column 1), "level" (column 3)',
        ),
        (
            "time,level [bar]\n0,1\n",
            'log.csv, column "level [bar]": unit "bar" does not fit level; allowed: m, mm, cm, km',
        ),
        (
            "time [m],level\n0,1\n",
            'log.csv, column "time [m]": unit "m" does not fit time; allowed: s, ms, min, h, d',
        ),
        ("time,lvl\n0,1\n", 'log.csv: no column "level"; did you mean "lvl"?'),
        (b"time,level\n0,1\n1,\xe9\n", "log.csv, line 3: not UTF-8 text (byte 0xe9): save it as UTF-8"),
        ('time,level\n0,1\n1,"2\n', "log.csv, line 3: not a CSV file: unexpected end of data"),
        (
            "time;level\n0;1,5\n1;1.5\n",
            'log.csv: two decimal marks, "," in line 2 and "." in line 3; needed: one of them throughout',
        ),
        ("time,level\nyesterday,1\n", 'log.csv, line 2, column "time": "yesterday" is not a finite number'),
    ],
)
def test_a_file_that_cannot_be_read(tmp_path: Path, text: str | bytes, fault: str) -> None:
    path = written(tmp_path, text)
    if fault:
        assert faults_of(path, [Column(LEVEL, "level")])[0] == fault
    else:
        read_table(path, [Column(LEVEL, "level")], "time")


def test_of_dates_those_that_are_none_or_of_another_kind_are_told(tmp_path: Path) -> None:
    lines = ["time,level", "2024-03-01T00:00:00,1", "2024-13-01T00:00:05,2", "2024-03-01T00:00:10Z,3"]
    where = 'log.csv, line {}, column "time": '
    assert faults_of(written(tmp_path, "\n".join(lines)), [Column(LEVEL, "level")]) == [
        where.format(3) + '"2024-13-01T00:00:05" is not a date, as the first one is',
        where.format(4) + '"2024-03-01T00:00:10Z" has a time zone, and the first date has none',
    ]


def test_a_unit_that_contradicts_the_header_and_files_that_are_not_there(tmp_path: Path) -> None:
    path = written(tmp_path, "time,level [cm]\n0,1\n")
    (fault,) = faults_of(path, [Column(LEVEL, "level", "m")])
    assert fault == 'log.csv, column "level [cm]": unit = "m" contradicts its header'
    path.unlink()
    assert faults_of(path) == ["log.csv: no such file"]
    path.mkdir()
    assert faults_of(path) == ["log.csv: not a file"]


def test_of_many_faults_the_first_ones(tmp_path: Path) -> None:
    path = written(tmp_path, "time,level\n" + "".join(f"{i},x\n" for i in range(100)))
    faults = faults_of(path, [Column(LEVEL, "level")])
    assert len(faults) == 9
    assert faults[-1] == "log.csv: and 92 more faults"


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = written(tmp_path, "time,level\n")
    with path.open("r+b") as file:
        file.truncate(2_000_000_000)
    (fault,) = faults_of(path)
    assert (
        fault == "log.csv: 2000 MB are too many; allowed: 100 MB: keep the columns and rows that are needed"
    )


def test_rows_must_be_one_sampling_time_apart(tmp_path: Path) -> None:
    def faults(times: str, tolerance: float = 0.01) -> list[str]:
        path = written(tmp_path, "time\n\n" + times.replace(" ", "\n"))
        with pytest.raises(DataError) as raised:
            read_table(path, [], "time", 0.1, tolerance)
        return [fault.removeprefix(f"{path}, ") for fault in raised.value.faults]

    for good in ("5.0 5.1 5.2 5.3009", "7", "1e9 1000000000.1 1000000000.2"):
        read_table(written(tmp_path, "time\n" + good.replace(" ", "\n")), [], "time", 0.1, 0.01)
    read_table(written(tmp_path, "time\n0\n0.102\n0.198\n"), [], "time", 0.1, 0.05)
    needed = "needed: the sampling time 0.1 s, within 1 %"
    assert faults("0 0.1 0.2 0.4 0.5 0.5") == [
        f'line 6, column "time": 0.4 s is 0.2 s after the row before; {needed}',
        f'line 8, column "time": 0.5 s is 0 s after the row before; {needed}',
    ]
    assert faults("0 0.05 0.1 0.2") == [f'column "time": rows are 0.05 s apart, in the median; {needed}']
    assert "within 0 %" in faults("0 0.1 0.2 0.3001", 0.0)[0]


FINITE = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=50, deadline=None)
@given(rows=st.lists(st.tuples(FINITE, FINITE), min_size=1, max_size=20))
def test_what_is_written_is_read_to_the_last_bit(
    rows: list[tuple[float, float]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    values = np.array(rows)
    write_table(path, {"a [m]": values[:, 0], "b [m]": values[:, 1]}, {"status": ["a\nb"] * len(rows)})
    metres = [Column(Variable(name, unit="m"), name) for name in "ab"]
    _, read = read_table(path, metres, "")
    assert np.array_equal(read, values)


@settings(max_examples=300, deadline=None)
@given(
    content=st.binary(max_size=200)
    | st.text('time,level;\t[]m"\n\r0123456789.e-+ nan_', max_size=200).map(str.encode)
)
def test_whatever_is_in_a_file_it_is_read_or_refused(
    content: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    path.write_bytes(b"time,level\n" + content if len(content) % 2 else content)
    try:
        time, values = read_table(path, [Column(LEVEL, "level")], "time")
    except DataError as error:
        read, faults = False, error.faults
    else:
        read, faults = True, ()
    assert read or faults
    assert all(str(path) in fault for fault in faults)
    if read:
        assert np.isfinite(time).all()
        assert np.isfinite(values).all()
        assert len(time) == len(values) >= 1
        assert (np.diff(time) > 0).all()


STUDY = """
plant = {{ name = "pendulum", inputs = ["torque"], outputs = ["angle"] }}
loop = {{ sampling_time = 0.1, duration = 1.0 }}
reference.angle = {{ kind = "file", {} }}
controllers.mfapc.type = "mfapc"
"""


def test_a_file_is_parsed_once_for_all_its_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed = []
    text_of = csv_files._text
    monkeypatch.setattr(csv_files, "_text", lambda path: parsed.append(path) or text_of(path))
    path = tmp_path / "data.csv"
    for content, last in (("time,a,b\n0,1,2\n1,3,4\n", 4.0), ("time,a,b\n0,1,2\n1,3,40\n", 40.0)):
        path.write_text(content, encoding="utf-8")
        for header in ("a", "b"):
            _, values = read_table(path, [Column(None, header)], "time")
        assert values[-1] == last
    assert parsed == [path, path]


def test_a_reference_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "wanted.csv").write_text("time [ms];angle [deg];other\n0;0;10\n500;90;20,5\n")
    study = tmp_path / "study.toml"

    def reference(keys: str) -> object:
        study.write_text(STUDY.format(keys), encoding="utf-8")
        return read_study(str(study)).problem.reference["angle"]

    assert reference('file = "data/wanted.csv"') == Steps((0.0, 0.5), (0.0, np.pi / 2))
    linear = reference('file = "data/wanted.csv", interpolation = "linear", column = "other", unit = "deg"')
    assert isinstance(linear, Interpolated)
    assert linear.at(np.array([-1.0, 0.25, 9.0])) == pytest.approx(np.radians([10.0, 15.25, 20.5]))
    with pytest.raises(ConfigError) as raised:
        reference('file = "data/wanted.csv", column = "angel", time_column = "t"')
    first, second = raised.value.faults
    assert first.startswith("study.toml:4: reference.angle.file: ")
    assert first.endswith('wanted.csv: no column "angel"; did you mean "angle"?')
    assert second.endswith(
        'no column "t"; there are: angle, other, time (time_column says which column the time is)'
    )


def test_a_parquet_file_stands_for_a_csv_file(tmp_path: Path) -> None:
    """Of whatever program, with columns of any type."""
    times, levels = pyarrow.array([0, 1], pyarrow.int16()), pyarrow.array([150.0, 200.0], pyarrow.float32())
    table = pyarrow.table(
        {"time": times, "level [cm]": levels, "flow": [0.1, 0.2], "note": [None, "a,b"], "on": [True, False]}
    )
    path = tmp_path / "log.parquet"
    pyarrow.parquet.write_table(table, path)
    time, values = read_table(path, COLUMNS, "time")
    assert time.tolist() == [0.0, 1.0]
    assert values.tolist() == [[1.5, 0.1], [2.0, 0.2]]
    path.write_bytes(path.read_bytes()[:-1])
    (fault,) = faults_of(path)
    assert fault.startswith("log.csv: cannot be read: not a Parquet file: ")
