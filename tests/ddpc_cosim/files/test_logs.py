"""Logs as loggers and spreadsheets write them: read as told, or refused in few lines that name the mend."""

import re
from collections.abc import Mapping
from datetime import datetime
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from hypothesis import given, settings, strategies as st
from messy_logs import NAMES, SAMPLING_TIME, MessyLog, messy_logs

from ddpc_cosim import ConfigError, DataError, FloatArray, Recording, Variable
from ddpc_cosim.codec import read
from ddpc_cosim.files.csv_files import Column
from ddpc_cosim.files.log_dates import read_dates
from ddpc_cosim.files.logs import Log, LogFormat, read_log
from ddpc_cosim.inspection.log_files import time_column_of

SIGNALS = [
    *(Variable(name, unit="V") for name in NAMES[:2]),
    *(Variable(name, unit="m") for name in NAMES[2:]),
]
MESSY = {log.name: log for log in messy_logs()}


def recorded(paths: list[Path], columns: Mapping[str, str] = {}, **format: Any) -> Recording:
    return Recording.read_csv(
        *paths,
        sampling_time=SAMPLING_TIME,
        inputs=SIGNALS[:2],
        outputs=SIGNALS[2:],
        columns=columns,
        **format,
    )


@pytest.mark.parametrize("log", MESSY.values(), ids=list(MESSY))
def test_a_messy_log_is_read_as_told(log: MessyLog, tmp_path: Path) -> None:
    recording = recorded(log.write(tmp_path), log.columns, **log.keys)
    assert np.hstack([recording.u, 1000 * recording.y]) == pytest.approx(log.values, rel=1e-13)
    assert recording.seams == log.seams
    assert recording.treatments == log.treatments


REFUSED = {
    "dots and commas": ['write encoding = "cp1252"'],
    "month first": ['write dates = "dd/mm/yyyy" (a day 03) or dates = "mm/dd/yyyy" (a day 02)'],
    "clocks put back": ['that is probably daylight saving: write time_zone = "Europe/Berlin"'],
    "gaps": ['write gaps = "split"'],
    "duplicates": ['write duplicates = "first", "last" or "mean"'],
    "empty cells": ["write missing = 2 to interpolate"],
    "two rates": ["write missing = 2 to interpolate"],
    "tags": ['write time_column = ["Date", "Time"]'],
    "TwinCAT Scope": ['write missing = 1 to interpolate up to 1 in a row, or gaps = "split"'],
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_messy_log_is_refused_in_few_lines_that_name_the_mend(name: str, tmp_path: Path) -> None:
    with pytest.raises(DataError) as raised:
        recorded(MESSY[name].write(tmp_path), MESSY[name].columns)
    assert len(raised.value.faults) <= 6
    for mend in REFUSED[name]:
        assert any(mend in fault for fault in raised.value.faults), raised.value.faults


@pytest.mark.parametrize("log", MESSY.values(), ids=list(MESSY))
def test_leniently_every_log_is_read_and_what_is_wrong_is_told(log: MessyLog, tmp_path: Path) -> None:
    read_leniently = read_log(log.write(tmp_path), lenient=True)
    assert read_leniently.sampling_time == SAMPLING_TIME
    assert len(read_leniently.values) >= len(log.values)
    assert {"V", "mm"} <= {*read_leniently.units}
    assert bool(read_leniently.faults) == (log.name in REFUSED)


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    rows = [f"02.03.2026 08:00:{5 * i:02d};{i},5" for i in range(11)]
    rows[2] = rows[2].replace("2,5", "")
    rows[4] = rows[4].replace("4,5", "oo4")
    rows[6] = rows[5]
    del rows[9]
    path = written(tmp_path, "time;x\n" + "\n".join(rows))
    where = f'{path}, line {{}}, column "{{}}": '
    with pytest.raises(DataError) as raised:
        Recording.read_csv(path, sampling_time=5.0, inputs=["x"], outputs=["x"])
    assert list(raised.value.faults) == [
        where.format(6, "x") + '"oo4" is not a finite number',
        where.format(8, "time") + "the row has the time of the one before; write duplicates = "
        '"first", "last" or "mean", or give the rows their own times',
        where.format(9, "time")
        + "2026-03-02 08:00:35 is 10 s after the row before (2 in all, then line 11); "
        'needed: the sampling time 5 s, within 1 %; write gaps = "split" to make pieces of it, or missing = '
        "1 to interpolate",
        where.format(4, "x") + "the cell is empty; write missing = 1 to interpolate up to 1 in a row, or "
        'gaps = "split" to leave out such samples',
    ]


def test_cells_with_units_are_in_that_of_their_column(tmp_path: Path) -> None:
    log = log_of(tmp_path, "time;x;y\n0 ms;21,5 degC;40%\n500 ms;;41 %\n1000 ms;22 \u00b0C;42 %\n", missing=1)
    assert log.units == ("degC", "%")
    assert log.time.tolist() == [0.0, 0.5, 1.0]
    assert log.values.tolist() == [[21.5, 40.0], [21.75, 41.0], [22.0, 42.0]]


@pytest.mark.parametrize(
    ("header", "cells", "faults"),
    [
        (
            "x",
            ["21 degC", "295 K", "22 degC"],
            ['line 3, column "x": the cell is in K, and the column in degC'],
        ),
        ("x", ["1 V", "2 V", "3"], ['line 4, column "x": the cell has no unit, and the column is in V']),
        ("x [V]", ["1 V", "2", "3 mV"], ['line 4, column "x [V]": the cell is in mV, and the column in V']),
    ],
)
def test_a_cell_with_another_unit_is_a_fault(
    tmp_path: Path, header: str, cells: list[str], faults: list[str]
) -> None:
    text = f"time;{header}\n" + "".join(f"{i};{cell}\n" for i, cell in enumerate(cells))
    with pytest.raises(DataError) as raised:
        log_of(tmp_path, text)
    path = tmp_path / "log.csv"
    assert list(raised.value.faults) == [f"{path}, {fault}; export a column in one unit" for fault in faults]


def test_a_unit_in_cells_is_that_of_the_signal(tmp_path: Path) -> None:
    path = written(tmp_path, "time;u;y\n0;1 V;250 mm\n1;2 V;500 mm\n")
    signals = {"inputs": [Variable("u", unit="V")], "outputs": [Variable("y", unit="m")]}
    assert Recording.read_csv(path, sampling_time=1.0, **signals).y.ravel() == pytest.approx([0.25, 0.5])
    with pytest.raises(DataError, match=r'column "y".*mm'):
        Recording.read_csv(path, sampling_time=1.0, inputs=["u"], outputs=[Variable("y", unit="V")])


@pytest.mark.parametrize(
    "text",
    [
        "# time x\n0 1.5\n1 2.5\n",
        "logger TX-4\n\n  time [s]   x\n  0,0   1,5\n  1,0   2,5\n",
        "time\t\tx\n0\t\t1.5\n1.0\t2.5\n",
        "time x [mm]\n2026-03-02 08:00:00 1.5\n2026-03-02 08:00:01 2.5\n",
    ],
)
def test_aligned_columns(tmp_path: Path, text: str) -> None:
    log = log_of(tmp_path, text)
    assert log.names == ("x",)
    assert log.time.tolist() == [0.0, 1.0]
    assert column(log.values) == [1.5, 2.5]


def test_a_cell_that_is_missing_of_aligned_columns_is_refused(tmp_path: Path) -> None:
    rows = "2026-03-02 08:00:00 1 2\n2026-03-02 08:00:01 1\n"
    with pytest.raises(
        DataError, match=r"line 3: 2 cells, and 3 columns .*export it with semicolons"
    ) as raised:
        log_of(tmp_path, f"time x y\n{rows}")
    assert len(raised.value.faults) == 1


_SCOPE = "Name,s\nFile,s.csv\nStarttime of export,132959733843760000,Monday,15:56:24.376\n\n"


def test_full_time_stamps_of_scope(tmp_path: Path) -> None:
    rows = "".join(f"{132959733843760000 + 10_000_000 * i},{i}.5\n" for i in range(3))
    log = log_of(tmp_path, f"{_SCOPE}Name,pump\nSampleTime[ms],1000\n\n{rows}")
    assert log.begin == datetime(2022, 5, 2, 13, 56, 24, 376000)
    assert log.time == pytest.approx([0.0, 1.0, 2.0], abs=1e-5)
    assert column(log.values) == [0.5, 1.5, 2.5]


@pytest.mark.parametrize("mark", [" ", ":"])
def test_an_export_of_scope_with_a_separator_that_names_have_is_refused(tmp_path: Path, mark: str) -> None:
    text = f"{_SCOPE}Name,my pump\nSampleTime[ms],1\n\n0,1\n1,2\n".replace(",", mark)
    with pytest.raises(DataError, match="export it with tabs or semicolons between its columns"):
        log_of(tmp_path, text)


def test_a_channel_of_scope_without_its_time_and_one_with_a_time_twice(tmp_path: Path) -> None:
    rows = "0,1,0,1\n1,2,,2\n2,3,2,3\n2,4,3,4\n"
    text = f"{_SCOPE}Name,pump,Name,level\nSampleTime[ms],1,SampleTime[ms],1\n\n{rows}"
    with pytest.raises(DataError) as raised:
        log_of(tmp_path, text)
    path = tmp_path / "log.csv"
    assert f'{path}, line 10, column "pump": it has the time of another' in raised.value.faults[0]
    assert f'{path}, line 9, column "level": no time stands before it' in raised.value.faults[1]


def written(folder: Path, text: str | bytes, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def log_of(folder: Path, text: str | bytes, sampling_time: float | None = None, **keys: Any) -> Log:
    return read_log(written(folder, text), sampling_time=sampling_time, format=read(LogFormat, keys))


def column(values: FloatArray) -> list[float]:
    return [*map(float, values[:, 0])]


@pytest.mark.parametrize(
    ("cells", "keys", "seconds"),
    [
        (["2.3.2026 8:00", "2.3.2026 8:01"], {}, [0, 60]),
        (["02.03.26 08:00:00,250", "02.03.26 08:00:01,5"], {}, [0, 1.25]),
        (["2026/03/02 23:59:59", "2026/03/03 00:00:00"], {}, [0, 1]),
        (["2026-03-02T08:00:00+01:00", "2026-03-02T07:00:30Z"], {}, [0, 30]),
        (["3/2/2026 11:59:30 AM", "3/2/2026 12:00:00 PM"], {"dates": "mm/dd/yyyy"}, [0, 30]),
        (["2/3/2026", "3/3/2026"], {"dates": "dd/mm/yyyy"}, [0, 86400]),
        (["46083.25", "46083.5"], {"dates": "excel"}, [0, 21600]),
        (["2026-03-29 01:59:00", "2026-03-29 03:00:00"], {"time_zone": "Europe/Berlin"}, [0, 60]),
        (["2026-10-25 02:59:00", "2026-10-25 02:00:00"], {"time_zone": "Europe/Berlin"}, [0, 60]),
    ],
)
def test_dates_of_loggers(
    tmp_path: Path, cells: list[str], keys: dict[str, Any], seconds: list[float]
) -> None:
    text = "time;x\n" + "".join(f"{cell};{i}\n" for i, cell in enumerate(cells))
    assert log_of(tmp_path, text, **keys).time.tolist() == seconds


@pytest.mark.parametrize(
    ("cell", "keys", "fault"),
    [
        ("13/03/2026", {}, 'write dates = "dd/mm/yyyy", as there is a day 13'),
        ("3/13/2026", {}, 'write dates = "mm/dd/yyyy", as there is a day 13'),
        ("31.02.2026 08:00", {}, '"31.02.2026 08:00" is not a date'),
        ("yesterday", {}, '"yesterday" is neither a number nor a date that is known'),
        ("2026-03-29 02:30:00", {"time_zone": "Europe/Berlin"}, "does not exist in Europe/Berlin"),
    ],
)
def test_dates_that_are_refused(tmp_path: Path, cell: str, keys: dict[str, Any], fault: str) -> None:
    with pytest.raises(DataError) as raised:
        log_of(tmp_path, f"time;x\n{cell};1\n", **keys)
    assert fault in raised.value.faults[0]


@settings(max_examples=30, deadline=None)
@given(
    moment=st.datetimes(),
    order=st.sampled_from([("dd/mm/yyyy", "{2}/{1}/{0}"), ("mm/dd/yyyy", "{1}/{2}/{0}")]),
)
def test_what_is_written_as_a_date_is_read_to_the_microsecond(moment: Any, order: tuple[str, str]) -> None:
    key, form = order
    text = form.format(f"{moment.year:04d}", f"{moment.month:02d}", f"{moment.day:02d}")
    dates = read_dates([f"{text} {moment.time().isoformat('microseconds')}"], key, "")
    assert dates.instants[0] == np.datetime64(moment, "us").astype(np.int64)


@pytest.mark.parametrize(
    ("key", "value", "hint"),
    [
        ("time_zone", "Europe/Berlim", 'must be the name of a time zone, got "Europe/Berlim"; did you mean'),
        ("gaps", "slit", "must be one of 'refuse' or 'split', got 'slit'"),
        ("missing", -1, "must be greater than or equal to 0"),
        ("duplicate", "first", 'did you mean "duplicates"?'),
    ],
)
def test_how_it_cannot_be_read(tmp_path: Path, key: str, value: Any, hint: str) -> None:
    with pytest.raises(ConfigError) as raised:
        recorded([tmp_path / "log.csv"], **{key: value})
    assert hint in raised.value.faults[0]


@pytest.mark.parametrize(
    ("row", "fault"),
    [
        ("0;1.234,5", '"1.234,5" is not a finite number; thousands are separated there'),
        ("0;1'234", '"1\'234" is not a finite number; thousands are separated there'),
        ("0;0,5\n1;0.5", 'two decimal marks, "," in line 2 and "." in line 3; needed: one of them'),
        ("0;1;2", "line 2: 3 cells, and 2 columns in the header"),
        ("0;a\n1;b", '"a" and the other cells are not numbers; columns says which column a signal is in'),
        ("0;\n1;", "all of its cells are empty"),
    ],
)
def test_numbers_that_are_none(tmp_path: Path, row: str, fault: str) -> None:
    path = written(tmp_path, f"time;x\n{row}\n")
    with pytest.raises(DataError) as raised:
        Recording.read_csv(path, sampling_time=1.0, inputs=["x"], outputs=["x"])
    assert fault in raised.value.faults[0]


@pytest.mark.parametrize(
    ("text", "seconds", "values"),
    [
        ("sep=;\nZeit;x\n02.03.26 08:00;1,5\n02.03.26 08:01;2\n", [0, 60], [1.5, 2]),
        ("Time,x\n02-Mar-26 08:00:00,1\n02-Mar-26 08:00:30,2\n", [0, 30], [1, 2]),
        ("time;x\n31-Okt-2026 23:59;1\n01-Nov-2026 00:00;2\n", [0, 60], [1, 2]),
        ("Time,x\n1772438400000,1\n1772438400500,2\n", [0, 0.5], [1, 2]),
        ("Time,x\n1772438400000000,1\n1772438400500000,2\n", [0, 0.5], [1, 2]),
        ("Time,x\n1772438400000000000,1\n1772438401000000000,2\n", [0, 1], [1, 2]),
        ("time,x\n2026-03-02T08:00:00.123456789Z,1\n2026-03-02T08:00:01.123456789Z,2\n", [0, 1], [1, 2]),
        ("time,x\n23:59:30,1\n00:00:00,2\n00:00:30.5,3\n", [0, 30, 60.5], [1, 2, 3]),
        ("time,x\n11:59:30 PM,1\n12:00:00 AM,2\n", [0, 30], [1, 2]),
        ("time,x\n0,ON\n1,OFF\n2,on\n", [0, 1, 2], [1, 0, 1]),
        ("time;x;\n0;1;\n1;2;\n", [0, 1], [1, 2]),
        ("time,x\n0,1\ntime,x\n1,2\n", [0, 1], [1, 2]),
        ("time|x\n0|1\n1|2\n", [0, 1], [1, 2]),
        (
            "LabVIEW Measurement\t\nTime\t08:00:00\n***End_of_Header***\t\n\t\nChannels\t1\nTime\t08:00\n"
            "***End_of_Header***\t\nX_Value\tx\tComment\n0.000000\t1\n0.100000\t2\n",
            [0, 0.1],
            [1, 2],
        ),
        ("time\tx\n0\t1\n1\t2\n".encode("utf-16-le"), [0, 1], [1, 2]),
        ("time\tx\n0\t1\n1\t2\n".encode("utf-16-be"), [0, 1], [1, 2]),
    ],
)
def test_what_loggers_write_otherwise(
    text: str | bytes, seconds: list[float], values: list[float], tmp_path: Path
) -> None:
    header = time_column_of(written(tmp_path, text))
    log = log_of(tmp_path, text, time_column=header)
    assert (log.time - log.time[0]).tolist() == pytest.approx(seconds)
    assert column(log.values) == values


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("time,x\n0,1\n1,2\nEnd of report\n", "line 4: 1 cells, .*delete what is not a row of the table"),
        ('time,x\n0,"1,234.5"\n1,"1,235.5"\n', "thousands are separated there: export numbers without that"),
        ("time,x\n0,1\n1,No Data\n2,3\n", '"No Data" is not a finite number; write missing = 1'),
        (
            "VarName;TimeString;VarValue\nu;02.03.2026 08:00:00;1\n",
            r"a column per signal: .*table\.pivot\(index",
        ),
        ("entity_id,state,last_changed\nu,1,2026-03-02\n", r'columns="entity_id", values="state"'),
        ("time,x\n23:59:30,1\n24:70:00,2\n", '"24:70:00" is not a time of the day'),
        ("time,x\n02-Foo-26,1\n02-Foo-26,1\n", '"02-Foo-26" is not a date'),
        ("time,x,y\n0,1,1\n1,OFF,2\n2,3,3\n", '"OFF" is not a finite number'),
    ],
)
def test_what_loggers_write_otherwise_and_is_refused(text: str, fault: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=fault) as raised:
        log_of(tmp_path, text)
    assert len(raised.value.faults) <= 6


def test_units_in_brackets_in_parentheses_or_below_the_header(tmp_path: Path) -> None:
    header = "time [min];a [\N{DEGREE SIGN}C];b (bar);flow;c (raw);q (m\N{SUPERSCRIPT THREE}/h)"
    log = log_of(tmp_path, f"{header}\nmin;;;l/min;;\n0;1;2;3;4;5\n1;1;2;3;4;5\n")
    assert log.names == ("a", "b", "flow", "c (raw)", "q")
    assert log.units == ("\N{DEGREE SIGN}C", "bar", "l/min", "", "m\N{SUPERSCRIPT THREE}/h")
    wanted = [Column(Variable("p", unit="Pa"), "b"), Column(Variable("q", unit="m3/s"), "flow")]
    values = read_log(tmp_path / "log.csv", columns=wanted).values
    assert values[0] == pytest.approx([2e5, 3e-3 / 60])
    second = written(tmp_path, "time [min];a [K];b [Pa]\n2;274.15;3e5\n", "second.csv")
    first = written(tmp_path, f"time [min];a [{chr(176)}C];b (bar)\n0;1;2\n", "first.csv")
    assert read_log([first, second]).values == pytest.approx(np.array([[1.0, 2.0], [1.0, 3.0]]))


def test_which_of_two_rows_counts(tmp_path: Path) -> None:
    text = "time,x\n0,1\n1,2\n1,4\n2,5\n"
    for how, expected in (("first", 2.0), ("last", 4.0), ("mean", 3.0)):
        assert column(log_of(tmp_path, text, 1.0, duplicates=how).values) == [1.0, expected, 5.0]
    swapped = log_of(tmp_path, "time,x\n0,1\n2,5\n1,2\n3,6\n", 1.0, duplicates="first")
    assert column(swapped.values) == [1.0, 2.0, 5.0, 6.0]
    assert [treatment.words for treatment in swapped.treatments] == ["1 row put in the order of time"]


def test_missing_rows_and_cells_are_interpolated_up_to_a_number_and_split_beyond(tmp_path: Path) -> None:
    text = "time,x\n0,0\n1,1\n3,3\n4,\n5,5\n9,9\n10,\n11,\n12,12\n13,\n"
    log = log_of(tmp_path, text, 1.0, missing=1, gaps="split")
    assert column(log.values) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 9.0, 12.0]
    assert log.time.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 9.0, 12.0]
    assert log.seams == (6, 7)
    assert {treatment.kind: treatment.number for treatment in log.treatments} == {
        "interpolated": 2,
        "split": 2,
        "left out": 3,
    }
    assert read(LogFormat, {"missing": {"interpolate": 3}}).missing == 3


def test_a_part_of_the_samples_is_taken_after_all_else_is_done(tmp_path: Path) -> None:
    text = "time,x\n0,0\n1,1\n2,2\n4,4\n5,5\n9,9\n10,10\n11,11\n12,12\n"
    halves = [
        log_of(tmp_path, text, 1.0, missing=1, gaps="split", part=part) for part in ([0.0, 0.5], [0.5, 1.0])
    ]
    assert [column(half.values) for half in halves] == [
        [0.0, 1.0, 2.0, 3.0, 4.0],
        [5.0, 9.0, 10.0, 11.0, 12.0],
    ]
    assert [half.seams for half in halves] == [(), (1,)]
    words = [treatment.words for treatment in halves[0].treatments]
    assert "5 samples outside the part left out" in words


def test_a_part_without_samples_is_refused_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"part = \[0.0, 0.1\] holds none of the 3 samples; write one that"):
        log_of(tmp_path, "time;x\n0;1\n1;2\n2;3\n", part=[0.0, 0.1])


@settings(deadline=None, max_examples=20)
@given(before=st.integers(1, 30), after=st.integers(1, 30))
def test_two_parts_are_the_whole(before: int, after: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    rows = before + after
    text = "time,x\n" + "".join(f"{i},{i}\n" for i in range(rows))
    folder, share = tmp_path_factory.mktemp("parts"), before / rows
    parts = [column(log_of(folder, text, 1.0, part=part).values) for part in ([0.0, share], [share, 1.0])]
    assert parts == [[*range(before)], [*range(before, rows)]]


def test_rows_that_are_uneven(tmp_path: Path) -> None:
    text = "time,x\n0,0\n1,1\n2.4,2.4\n3,3\n4,4\n5,5\n"
    with pytest.raises(DataError, match=r'line 4.*2 in all, then line 5.*resample = "linear"'):
        log_of(tmp_path, text, 1.0)
    assert column(log_of(tmp_path, text, 1.0, resample="linear").values) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    with pytest.raises(DataError, match=r'rows are 1 s apart, in the median.*or write resample = "mean"'):
        log_of(tmp_path, text, 2.0)


def test_resampled_by_holding_a_line_or_a_mean(tmp_path: Path) -> None:
    """Of a ramp sampled at 1 s the samples at 3 s; of a mean the input's is that after the sample."""
    path = written(tmp_path, "time,u,y\n" + "".join(f"{t},{t},{t}\n" for t in range(13)))

    def read_by(how: str, sampling_time: float = 3.0) -> FloatArray:
        format = read(LogFormat, {"resample": how})
        return read_log(path, sampling_time=sampling_time, format=format, held=["u"]).values

    assert read_by("hold")[:, 1].tolist() == [0.0, 3.0, 6.0, 9.0, 12.0]
    assert read_by("linear", 1.5)[:, 1].tolist() == [1.5 * k for k in range(9)]
    mean = read_by("mean")
    assert mean[:, 0].tolist() == [1.0, 4.0, 7.0, 10.0, 12.0]
    assert mean[:, 1].tolist() == [0.0, 2.0, 5.0, 8.0, 11.0]
    changes = log_of(tmp_path, "time,x,y\n0,1,1\n1,,1\n2,5,1\n3,,1\n4,,1\n", 1.0, resample="hold")
    assert column(changes.values) == [1.0, 1.0, 5.0, 5.0, 5.0]


def test_outliers_are_told_from_an_input_that_is_switched(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    x, u = rng.normal(size=300), rng.choice([0.0, 1.0], size=300)
    x[[50, 200]] = [40.0, -40.0]
    rows = "".join(f"{i},{a!r},{b}\n" for i, (a, b) in enumerate(zip(x.tolist(), u, strict=True)))
    log = log_of(tmp_path, "time,x,u\n" + rows, 1.0, outliers=10.0, missing=1)
    assert {treatment.kind: treatment.number for treatment in log.treatments} == {
        "outliers": 2,
        "interpolated": 2,
    }
    expected = x.copy()
    expected[[50, 200]] = [(x[49] + x[51]) / 2, (x[199] + x[201]) / 2]
    assert log.values == pytest.approx(np.column_stack([expected, u]))


def test_a_parquet_file_with_missing_values_and_dates(tmp_path: Path) -> None:
    begin = np.datetime64("2026-03-02T08:00:00", "ms")
    times = pyarrow.array(begin + np.arange(4) * np.timedelta64(500, "ms"))
    table = pyarrow.table(
        {"time": times, "x [V]": pyarrow.array([1.0, None, 3.0, 4.0]), "n": ["a", "b", "c", "d"]}
    )
    path = tmp_path / "log.parquet"
    pyarrow.parquet.write_table(table, path)
    log = read_log(path, format=LogFormat(missing=1))
    assert log.time.tolist() == [0.0, 0.5, 1.0, 1.5]
    assert column(log.values) == [1.0, 2.0, 3.0, 4.0]
    assert (log.names, log.units, log.texts) == (("x",), ("V",), ("n",))


ZONED = pyarrow.timestamp("ns", "Europe/Berlin")


@pytest.mark.parametrize(
    ("times", "keys"),
    [
        (pyarrow.array([0, 1, 2, 3], pyarrow.int32()), {}),
        (pyarrow.array([0.0, 1.0, 2.0, 3.0], pyarrow.float32()), {}),
        (pyarrow.array([10**18 + i * 10**9 for i in range(4)], ZONED), {}),
        (pyarrow.array([i * 10**3 for i in range(4)], pyarrow.timestamp("ms")), {"time_zone": "Asia/Tokyo"}),
        (pyarrow.array(["2026-03-02 08:00:00", "2026-03-02 08:00:01", None, "2026-03-02 08:00:03"]), {}),
        (pyarrow.array([0, 10**6, None, 3 * 10**6], pyarrow.timestamp("us")), {}),
    ],
    ids=["int", "float", "zoned", "local", "text", "null"],
)
def test_a_parquet_file_says_what_its_cells_say_as_text(
    times: Any, keys: dict[str, Any], tmp_path: Path
) -> None:
    columns = {
        "whole": pyarrow.array([1, 2, None, 4], pyarrow.int64()),
        "on": pyarrow.array([True, False, False, True]),
        "price": pyarrow.array([Decimal("1.25"), None, Decimal("2.50"), Decimal("3.75")]),
        "word": pyarrow.array(["1.5", "Bad", "2.5", "3.5"]),
        "limit": pyarrow.array([1.0, 2.0, np.inf, 3.0]),
        "peak": pyarrow.array([1.0, -1e300, 2.0, 3.0]),  # as little measured
    }
    table = pyarrow.table({"time": times, **columns})
    pyarrow.parquet.write_table(table, tmp_path / "log.parquet")
    cells = [["" if cell is None else str(cell) for cell in column.to_pylist()] for column in table.columns]
    rows = [table.column_names, *zip(*cells, strict=True)]
    written(tmp_path, "\n".join(",".join(row) for row in rows))
    format = read(LogFormat, {"gaps": "split", **keys})
    typed, text = (
        read_log(tmp_path / f"log{end}", format=format, lenient=True) for end in (".parquet", ".csv")
    )
    assert typed.values.tolist() == text.values.tolist()
    assert (typed.time.tolist(), typed.begin) == (text.time.tolist(), text.begin)
    with pytest.raises(DataError) as of_text:
        read_log(tmp_path / "log.csv", format=LogFormat())
    with pytest.raises(DataError) as of_types:
        read_log(tmp_path / "log.parquet", format=LogFormat())
    as_text = [re.sub(r"line (\d+)", lambda at: f"line {int(at[1]) - 1}", f) for f in of_text.value.faults]
    assert [*of_types.value.faults] == [fault.replace("log.csv", "log.parquet") for fault in as_text]


@settings(max_examples=80, deadline=None)
@given(
    content=st.binary(max_size=200)
    | st.text('time,level;\t[]m"\n\r0123456789.e-+:/ nan_', max_size=200).map(str.encode),
    keys=st.fixed_dictionaries(
        {},
        optional={
            "gaps": st.just("split"),
            "missing": st.just(2),
            "missing_values": st.just([0.0, -999.0]),
            "duplicates": st.sampled_from(["first", "last", "mean"]),
            "resample": st.sampled_from(["hold", "linear", "mean"]),
            "outliers": st.just(5.0),
        },
    ),
    lenient=st.booleans(),
)
def test_whatever_is_in_a_log_it_is_read_or_refused(
    content: bytes, keys: dict[str, Any], lenient: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    path.write_bytes(b"time,level\n" + content if len(content) % 2 else content)
    faults, log = tuple[str, ...](), None
    try:
        log = read_log(path, sampling_time=1.0, format=read(LogFormat, keys), lenient=lenient)
    except DataError as error:
        faults = error.faults
    assert all(str(path) in fault for fault in faults)
    assert log or faults
    if log:
        assert len(log.time) == len(log.values)
        assert lenient or np.isfinite(log.values).all()
        assert all(0 < seam < len(log.time) for seam in log.seams)
