"""Tables over time: units, zones, comments, a year that comes again, and everything that may be wrong."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import ConfigError, DataError, SignalFromResource, Variable
from ddpc_cosim.files.time_tables import TimeTable, read_time_table

DAY, YEAR = 86_400.0, 365 * 86_400.0


def table(text: str) -> TimeTable:
    return read_time_table("weather.csv", text.encode())


def test_a_table_has_its_columns_without_time_and_units_of_header_or_comment() -> None:
    read = table(
        "# anything, at all,,\n# TDryBul: outdoor temperature [K],,\n# LowerSetp: heating [degC]\r\n"
        "time,TDryBul,HGloHor [W/m2],LowerSetp[1],LowerSetp[nor]\r\n0,280,0,20,21\r\n3600,281,5,20,21\r\n"
    )
    assert read.columns == ("TDryBul", "HGloHor", "LowerSetp[1]", "LowerSetp[nor]")
    assert read.units == {
        "TDryBul": "K",
        "HGloHor": "W/m2",
        "LowerSetp[1]": "degC",
        "LowerSetp[nor]": "degC",
    }
    np.testing.assert_array_equal(read.time, [0.0, 3600.0])
    np.testing.assert_array_equal(read.values, [[280, 0, 20, 21], [281, 5, 20, 21]])
    assert not read.faults
    assert read.statistics("HGloHor") == (0.0, 2.5, 5.0)


def test_a_byte_order_mark_semicolons_decimal_commas_and_hours_are_understood() -> None:
    read = read_time_table("t.csv", "\ufefftime [h];x\n0;1,5\n1;2,5\n".encode())
    np.testing.assert_array_equal(read.time, [0.0, 3600.0])
    np.testing.assert_array_equal(read.values, [[1.5], [2.5]])


@pytest.mark.parametrize(
    ("times", "period"),
    [
        (np.arange(0, 8761) * 3600.0, YEAR),  # the last row is the first of the next year
        (np.arange(0, 8760) * 3600.0, YEAR),  # or the last of this one
        (np.arange(0, 365) * DAY, YEAR),
        (np.array([0.0, YEAR]), YEAR),
        (np.arange(0, 8784) * 3600.0, 366 * DAY),
        (np.arange(0, 8700) * 3600.0, 0.0),
        (np.array([0.0]), 0.0),
    ],
)
def test_a_table_over_a_year_comes_again(times: np.ndarray, period: float) -> None:
    read = table("time,x\n" + "".join(f"{t},{i}\n" for i, t in enumerate(times)))
    assert read.period == period
    own_times, _ = read.column("x")
    if period:
        assert own_times[-1] < period


def test_what_cannot_be_read_is_left_out_and_told_with_its_line() -> None:
    read = table("time,a,b,a\n0,1,2,3\n10,x,2,3\n5,1,2,3\n20,nan,2,3\n30,1,2\nzz,1,2,3\n40,1,2,3\n")
    np.testing.assert_array_equal(read.time, [0.0, 10.0, 20.0, 40.0])
    assert read.columns == ("a", "b")
    np.testing.assert_array_equal(read.values[:, 1], [2.0] * 4)
    assert np.isnan(read.values[1:3, 0]).all()
    told = "\n".join(read.faults)
    assert 'weather.csv, line 3, column "a": "x" is not a finite number (2 such cells)' in told
    assert "weather.csv, line 6: 3 cells, and 4 columns in the header" in told
    assert "2 of 6 rows are left out" in told
    assert "there more than once, of which the first counts: ['a']" in told
    with pytest.raises(DataError, match='column "a": 2 of 4 cells are not numbers'):
        read.column("a")
    with pytest.raises(DataError, match='no column "c"; there are: a, b'):
        read.column("c")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"# only: a comment [K]\n", "is empty"),
        (b"date,price\n2019-01-01,51\n", 'no column "time"'),
        (b"time,x\n", "no rows that can be read"),
        (b"time,x\nlater,1\n", "no rows that can be read"),
        (b"\x00\x01\x02", "no column"),
        (b"time\n" + b'"' * 100_000, "t.csv"),
    ],
)
def test_what_is_no_table_over_time_says_so(content: bytes, words: str) -> None:
    with pytest.raises(DataError, match=words):
        read_time_table("t.csv", content)


def test_letters_of_windows_are_read_and_told() -> None:
    read = read_time_table("t.csv", "time,Kühlung\n0,1\n".encode("cp1252"))
    assert read.columns == ("Kühlung",)
    assert "not UTF-8 text" in read.faults[0]


@given(st.binary(max_size=300))
def test_of_any_bytes_those_rows_are_read_whose_times_increase(content: bytes) -> None:
    with suppress(DataError):
        read = read_time_table("t.csv", b"time,x\n0,1\n" + content)
        assert (np.diff(read.time) > 0).all()
        assert read.values.shape == (len(read.time), len(read.columns))


HOURS = np.arange(8760) * 3600.0
COLD = 280 + 10 * np.sin(2 * np.pi * HOURS / YEAR)
A_YEAR = table(
    "time,T\n" + "".join(f"{t!r},{v!r}\n" for t, v in zip(HOURS.tolist(), COLD.tolist(), strict=True))
)


@given(st.floats(-1e8, 1e8))
def test_a_signal_is_the_line_between_two_rows_or_the_last_one_in_any_year(time: float) -> None:
    linear, hold = (
        SignalFromResource("weather.csv", "T", interpolation=how, table=A_YEAR).in_unit(Variable("T", "K"))
        for how in ("linear", "hold")
    )
    hour, rest = divmod(float(np.mod(time, YEAR)), 3600.0)
    before, after = COLD[int(hour) % 8760], COLD[(int(hour) + 1) % 8760]
    expected = before + rest / 3600.0 * (after - before)
    for when in (time, time + YEAR):
        np.testing.assert_allclose(linear.at(np.array([when])), expected, atol=1e-6)
    if 1.0 < rest < 3599.0:
        assert hold.at(np.array([time])) == before


def test_a_signal_is_in_the_unit_of_its_variable_and_says_where_it_is_from() -> None:
    degrees = SignalFromResource("weather.csv", "T", unit="degC", table=table("time,T\n0,20\n10,25\n"))
    signal = degrees.in_unit(Variable("T", "K"))
    np.testing.assert_allclose(
        signal.at(np.array([-5.0, 0.0, 9.0, 10.0, 99.0])), 273.15 + np.array([20, 20, 20, 25, 25])
    )
    assert repr(signal) == (
        "TabulatedSignal(file='weather.csv', column='T', unit='degC', interpolation='hold')"
    )
    assert repr(degrees) == (
        "SignalFromResource(unit='degC', file='weather.csv', column='T', interpolation='hold')"
    )
    assert degrees.gap(0.0, 20.0) == ""
    assert "needed: from 0 s to 21 s" in degrees.gap(0.0, 21.0)
    with pytest.raises(ConfigError, match="needed: a plant in a study"):
        SignalFromResource("weather.csv", "T").in_unit(Variable("T", "K"))
    said = SignalFromResource("w.csv", "T", unit="degC", table=table("time,T [K]\n0,280\n"))
    with pytest.raises(ConfigError, match="contradicts"):
        said.in_unit(Variable("T", "K"))
