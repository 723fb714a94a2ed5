"""Numbers and units as the report prints them."""

import math

import pytest
from hypothesis import given, strategies as st

from ddpc_reports.numbers import (
    align,
    as_given,
    column,
    duration,
    like,
    percent,
    significant,
    time_scale,
    unit_symbol,
    with_unit,
)

MINUS, TIMES, DASH, THIN = "\N{MINUS SIGN}", "\N{MULTIPLICATION SIGN}", "\N{EN DASH}", "\u202f"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (648.0710, "648.1"),
        (0.2464, "0.2464"),
        (-3.4353, f"{MINUS}3.435"),
        (1295.23, f"1{THIN}295"),
        (7.7326e-4, f"7.733{THIN}{TIMES}{THIN}10⁻⁴"),
        (1e7, f"1.000{THIN}{TIMES}{THIN}10⁷"),
        (0.0, "0"),
        (math.nan, DASH),
        (math.inf, "∞"),
        (-math.inf, f"{MINUS}∞"),
    ],
)
def test_four_significant_digits(value: float, text: str) -> None:
    assert significant(value) == text


@given(st.floats(min_value=1e-12, max_value=1e12), st.integers(min_value=2, max_value=7))
def test_a_printed_number_is_the_value_to_its_digits(value: float, digits: int) -> None:
    printed = significant(value, digits).replace(THIN, "").replace(TIMES + "10", "e")
    number = float(printed.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")))
    assert math.isclose(number, value, rel_tol=0.51 * 10.0 ** (1 - digits))


@pytest.mark.parametrize(
    ("unit", "symbol"),
    [
        ("N.m", "N·m"),
        ("deg", "°"),
        ("rad/s", "rad/s"),
        ("m/s2", "m/s²"),
        ("kg.m2", "kg·m²"),
        ("deg.s", "°·s"),
        ("s-1", "s⁻¹"),
        ("degC", "°C"),
        ("1", ""),
        ("%", "%"),
    ],
)
def test_units_of_an_fmu_read_as_in_print(unit: str, symbol: str) -> None:
    assert unit_symbol(unit) == symbol


def test_a_degree_sign_stands_close_and_other_units_do_not() -> None:
    assert with_unit("20", "°") == "20°"
    assert with_unit("3.5", "N·m") == "3.5\u00a0N·m"
    assert with_unit(DASH, "s") == DASH


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(6.55e-5, "65.5\u00a0µs"), (0.0111, "11.1\u00a0ms"), (4e-8, "40.0\u00a0ns"), (12.0, "12.0\u00a0s")],
)
def test_small_times_have_the_unit_that_suits_them(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_a_column_of_times_has_one_unit() -> None:
    assert time_scale([2e-5, 8e-5, 1.5e-3]).unit == "µs"
    assert time_scale([math.nan]).unit == "s"


def test_published_numbers_keep_their_digits() -> None:
    assert as_given(730.4181) == "730.4181"
    assert as_given(7.7326e-4) == f"7.7326{THIN}{TIMES}{THIN}10⁻⁴"
    assert as_given(1e7) == "10⁷"
    assert as_given(3.5) == "3.5"
    assert as_given(200.0) == "200"


def test_a_reproduced_number_has_the_decimals_of_the_published_one() -> None:
    assert like(711.251999, 730.4181) == "711.2520"
    assert like(3.0194e-4, 7.7326e-4) == f"3.0194{THIN}{TIMES}{THIN}10⁻⁴"
    assert like(0.00544, 11.1) == "0.00544"


def test_deviations_carry_their_sign() -> None:
    assert percent(0.069) == "+6.9\u00a0%"
    assert percent(-0.5) == f"{MINUS}50.0\u00a0%"
    assert percent(0.0001) == "0.0\u00a0%"
    assert percent(math.nan) == DASH


def test_decimal_points_of_a_column_stand_in_line() -> None:
    figure, point = "\u2007", "\u2008"
    assert align(["648.07", "3", "0.5"]) == ["648.07", f"3{point}{figure}{figure}", f"0.5{figure}"]


@given(st.lists(st.floats(min_value=-1e5, max_value=1e5), min_size=1, max_size=8))
def test_every_cell_of_a_column_reserves_the_same_room_after_the_point(values: list[float]) -> None:
    cells = [cell for cell in column(values) if TIMES not in cell]
    rooms = {len(cell) - len(cell.replace("\u2008", ".").partition(".")[0]) for cell in cells}
    assert len(rooms) <= 1


@pytest.mark.parametrize(
    ("values", "texts"),
    [
        ([0.5264, 0.566, 1.5740, 0.0313, 0.0050], ["0.5264", "0.5660", "1.5740", "0.0313", "0.0050"]),
        ([0.92, 18.17, 32.2, 0.0], ["0.92", "18.17", "32.20", "0.00"]),
        ([1234.5, 0.5, 2.0], ["1\u202f234.500", "0.500", "2.000"]),
        ([12.3456, 0.0000012], ["12.346", f"1.2{THIN}{TIMES}{THIN}10⁻⁶"]),
    ],
)
def test_a_column_has_one_number_of_decimals(values: list[float], texts: list[str]) -> None:
    assert [text.strip() for text in column(values)] == texts


@given(st.lists(st.floats(min_value=1e-4, max_value=9e5), min_size=1, max_size=8))
def test_all_numbers_of_a_column_have_the_same_decimals(values: list[float]) -> None:
    plain = [cell for cell in column(values) if TIMES not in cell]
    assert len({len(cell.strip().partition(".")[2]) for cell in plain}) <= 1
    assert all(float(cell.strip().replace("\u202f", "")) > 0 for cell in plain)


def test_counts_have_no_decimals() -> None:
    assert column([16.0, 200.0, 0.0]) == ["16", "200", "0"]
    # A median of an odd number of counts is a whole number, and one of an even number is not of that type.
    assert column([16, 200, 0.0]) == ["16", "200", "0"]
