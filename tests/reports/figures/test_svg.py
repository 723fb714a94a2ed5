"""Lines written as SVG: they pass by their samples, end with them, and stand on axes with round numbers."""

import itertools
import math
import re

from hypothesis import given, strategies as st

from ddpc_reports.figures.svg import Frame, area_path, bar, bars, line_path, picture, stroke, text, ticks

FRAME = Frame(100.0, 50.0, (0.0, 10.0), (-1.0, 1.0))


def corners(path: str) -> list[tuple[float, float]]:
    """Return the corners of a path of M, l, h and v in pixels, as a reader of SVG finds them."""
    points, x, y = list[tuple[float, float]](), 0.0, 0.0
    for letter, words in re.findall(r"([Mlhv])([^MlhvZ]*)", path):
        numbers = [float(number) / 2 for number in re.findall(r"-?\d+", words)]
        if letter == "M":
            x, y = numbers
        else:
            x += numbers[0] if letter in "lh" else 0.0
            y += numbers[-1] if letter in "lv" else 0.0
        points.append((x, y))
    return points


def test_a_line_goes_through_its_samples() -> None:
    assert corners(line_path(FRAME, [0.0, 5.0, 10.0], [0.0, 1.0, -1.0])) == [(0, 25), (50, 0), (100, 50)]


def test_what_is_held_has_a_step_at_the_next_sample() -> None:
    path = line_path(FRAME, [0.0, 5.0, 10.0], [0.0, 1.0, 1.0], held=True)
    assert corners(path) == [(0, 25), (50, 25), (50, 0), (100, 0)]


def test_a_line_is_interrupted_where_there_is_no_value() -> None:
    path = line_path(FRAME, [0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.0, None, 1.0, 1.0])
    assert path.count("M") == 2
    assert (20.0, 25.0) not in corners(path)


def test_a_run_that_ended_early_has_a_shorter_line() -> None:
    assert corners(line_path(FRAME, [0.0, 5.0, 10.0], [0.0, 1.0]))[-1] == (50, 0)


def test_what_leaves_the_picture_goes_a_little_beyond_its_edge() -> None:
    (_, top), (_, bottom) = corners(line_path(FRAME, [0.0, 10.0], [1e9, -1e9]))
    assert (top, bottom) == (-1.5, 51.5)


@given(st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=60))
def test_a_line_passes_its_samples_by_no_more_than_a_pixel(values: list[float]) -> None:
    times = [10.0 * k / (len(values) - 1) for k in range(len(values))]
    drawn = corners(line_path(FRAME, times, values))
    for time, value in zip(times, values, strict=True):
        x, y = 10.0 * time, 25.0 * (1.0 - value)
        heights = [
            b + (d - b) * min(max((x - a) / (c - a), 0.0), 1.0)
            if c > a
            else min((b, d), key=lambda end: abs(end - y))
            for (a, b), (c, d) in itertools.pairwise(drawn)
            if a - 0.5 <= x <= c + 0.5
        ]
        assert not heights or min(abs(height - y) for height in heights) <= 1.3


def test_an_area_goes_along_one_edge_and_back_along_the_other() -> None:
    path = area_path(FRAME, [0.0, 10.0], [-1.0, -1.0], [1.0, 1.0])
    assert path == "M0,100h200L200,0h-200Z"


@given(st.floats(-1e4, 1e4), st.floats(1e-2, 1e4), st.integers(2, 9))
def test_ticks_are_round_numbers_from_end_to_end(low: float, width: float, count: int) -> None:
    values, words = ticks(low, low + width, count)
    assert all(low - 1e-6 * width <= value <= low + 1.000001 * width for value in values)
    assert len(set(words)) == len(words) == len(values)
    steps = [b - a for a, b in itertools.pairwise(values)]
    for step in steps:
        mantissa = step / 10.0 ** math.floor(math.log10(step) + 1e-6)
        assert min(abs(mantissa - digit) for digit in (1, 2, 5)) < 1e-3
    assert len(values) <= 2.5 * count + 2


def test_ticks_of_nothing_are_the_value_itself() -> None:
    assert ticks(2.0, 2.0, 5).values == [2.0]
    assert ticks(0.0, 1.0, 5).words == ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]


def test_a_bar_is_as_long_as_its_share_and_never_longer_than_its_room() -> None:
    for share, length in ((0.25, "25"), (1.0, "100"), (7.0, "100"), (0.0, "0")):
        assert f'<rect width="{length}" height="5" fill="var(--c1)"/>' in bar(share, "a bar", "var(--c1)")


def test_a_place_without_a_value_has_a_red_stub() -> None:
    drawn = bars([0.5, math.nan], 1 / 3, "two places", "var(--c0)")
    assert '<path d="M3,22L3,11" stroke="var(--c0)" stroke-width="6"/>' in drawn
    assert '<path d="M11,22L11,20.5" stroke="var(--bad)" stroke-width="6"/>' in drawn


def test_words_in_a_drawing_act_on_nothing() -> None:
    hostile = '"><script>alert(1)</script>\u202e'
    drawn = picture([text(hostile, 0, 0), stroke("", "red")], (10, 10), hostile, "static")
    assert "<script" not in drawn
    assert "\u202e" not in drawn
    assert 'role="img"' in drawn
