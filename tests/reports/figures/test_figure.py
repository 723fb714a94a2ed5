"""What the axes show: no run that falls over flattens the others, and every tick has its label."""

import json
import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import Bounds, Outcome, Trace
from ddpc_cosim.files.texts import clipped
from ddpc_reports.comparison import conditions, on_one_page
from ddpc_reports.embedding import _points, _steps, pack, simplified
from ddpc_reports.figures.charts import COLOURS, DASHES, colour, dash, log_ticks
from ddpc_reports.figures.figure import Figure, spread_figures
from ddpc_reports.figures.over_time import TimeFigures, time_figures
from ddpc_reports.figures.samples import band_ends, seen, settled_samples, trusted
from ddpc_reports.figures.time_charts import Mark, label_rows
from ddpc_reports.numbers import significant, with_unit

from ..synthetic import MakeResults, make_trace


def scaled(trace: Trace, factor: float, **limits: float) -> Trace:
    """Return a run with outputs of another size, and with output limits if given [rad]."""
    bounds = trace.bounds
    if limits:
        low, high = (np.full(1, limits[end]) for end in ("low", "high"))
        bounds = Bounds(bounds.u_min, bounds.u_max, low, high)
    return replace(trace, y=factor * trace.y, bounds=bounds)


def falls(key: str, seed: int) -> Trace:
    return scaled(make_trace(0.5), 50.0) if key == "falls" else make_trace(0.3 if key == "quick" else 1.0)


def every_figure(drawn: TimeFigures) -> list[Figure]:
    """Return all figures, none of which failed."""
    figures = [figure for of_kind in drawn.figures.values() for figure in of_kind]
    assert all(isinstance(figure, Figure) for figure in figures), figures
    return [figure for figure in figures if isinstance(figure, Figure)]


THREE: dict[str, dict[str, Any]] = {name: {"type": "a"} for name in ("quick", "slow", "falls")}


def test_a_run_that_falls_over_does_not_set_the_range(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results(falls, THREE))
    drawn = seen(condition, "x-")
    low, high = drawn.outputs[0].extent(["c0", "c1", "c2"])
    assert -5.0 < low < 0.0
    assert 20.0 < high < 25.0
    assert all(signal.scaled_by == ("c0", "c1") for signal in (*drawn.outputs, *drawn.inputs, *drawn.changes))


def test_the_caption_names_who_leaves_the_axis(make_results: MakeResults) -> None:
    (condition,) = conditions(make_results(falls, THREE))
    response, error, control, _ = every_figure(time_figures(condition, "x-"))
    beyond = r"Beyond the axis: falls \(angle .*1 011°\)\."
    assert re.search(beyond, response.caption.replace("\u202f", " "))
    assert "transients too: falls (error of angle up to" in error.caption
    assert "Beyond" not in control.caption


def test_what_swings_far_within_its_limits_sets_the_range_all_the_same() -> None:
    quiet, wild = make_trace(0.3), scaled(make_trace(0.3), 50.0)
    assert trusted({"a": quiet, "b": wild}) == ("a",)
    assert trusted({"a": quiet, "b": scaled(wild, 1.0, low=-100.0, high=100.0)}) == ("a", "b")


def test_one_that_tracks_among_others_that_rest_is_trusted() -> None:
    resting = scaled(make_trace(0.3), 0.001)
    assert trusted({"a": make_trace(0.3), "b": resting, "c": resting}) == ("a", "b", "c")


@pytest.mark.parametrize(
    ("count", "panels"),
    [
        (6, {"": 6}),
        (7, {"Leaders: the first 4": 4, "The rest": 3}),
        (14, {"Leaders: the first 5": 5, "The rest": 9}),
        (20, {"Leaders: the first 5": 5, "The rest, 1 of 2": 8, "The rest, 2 of 2": 7}),
    ],
)
def test_many_controllers_are_shared_out_by_rank(
    count: int, panels: dict[str, int], make_results: MakeResults
) -> None:
    """The later one is declared the quicker it is; each stands in one panel, and looks like no other."""
    many = {f"k{number:02}": {"type": "a"} for number in range(count)}
    (condition,) = conditions(make_results(by_number, many))
    (responses, _, _, _) = every_figure(time_figures(condition, "x-"))
    assert {view.title: len(view.names) for view in responses.views} == panels
    ranked = [f"c{number}" for number in reversed(range(count))]
    assert [name for view in responses.views for name in view.names] == ranked
    assert [entry.label for entry in responses.legend] == [*reversed(many)]
    assert len({(entry.colour, entry.dashes) for entry in responses.legend}) == count


def by_number(key: str, seed: int) -> Trace:
    """Return a run that is the quicker the larger the controller's number is."""
    return make_trace(1.0 / (1.0 + int(key[1:])), noise_seed=seed)


def test_each_of_many_controllers_has_a_panel_of_its_own_on_the_same_axes(make_results: MakeResults) -> None:
    many = {f"k{number}": {"type": "a"} for number in range(8)}
    (condition,) = conditions(make_results(by_number, many, seeds=[0, 1]))
    drawn = time_figures(condition, "x-")
    responses, errors, controls, _ = every_figure(drawn)
    assert not errors.small
    assert not any(name.endswith("-band") for name in drawn.samples)
    for figure in (responses, controls):
        assert [panel.label for panel in figure.small] == [*reversed(many)]
        assert [panel.colour for panel in figure.small] == [*reversed(range(8))]
        pictures = [str(picture) for panel in figure.small for picture in panel.pictures]
        # What stands behind is written once.
        assert ["<use " in picture for picture in pictures] == [False] + 7 * [True]
        assert ["<text" in picture for picture in pictures] == [True] + 7 * [False]
        assert len(set(pictures)) == len(pictures)
    assert "k7 faint behind" in responses.small_words
    assert [panel.note for panel in responses.small] == [
        with_unit(significant(condition.by_key[key].summed(condition.headline[0]), 3), "°")
        for key in reversed(many)
    ]
    few = conditions(make_results(by_number, {key: many[key] for key in [*many][:6]}))[0]
    assert not every_figure(time_figures(few, "x-"))[0].small


@given(st.sets(st.integers(0, COLOURS * len(DASHES) - 1), min_size=2))
def test_no_two_controllers_of_a_page_look_alike(numbers: set[int]) -> None:
    assert len({(colour(number), dash(number)) for number in numbers}) == len(numbers)
    first = min(numbers)
    neighbours = range(first, first + COLOURS)
    assert len({colour(number) for number in neighbours}) == len({dash(n) for n in neighbours}) == COLOURS


def test_a_controller_looks_the_same_on_the_whole_page(make_results: MakeResults) -> None:
    """Of two studies on one page one lacks a controller, and the other has them in another order."""
    few, many = (
        {key: THREE[key] for key in keys} for keys in (("slow", "falls"), ("falls", "quick", "slow"))
    )
    studies = on_one_page([make_results(falls, few), make_results(falls, many, seeds=[7, 8])])
    looks: dict[str, set[tuple[str, str, str]]] = {}
    for study in studies:
        (condition,) = conditions(study)
        for figure in every_figure(time_figures(condition, "x-")):
            for entry in figure.legend:
                looks.setdefault(entry.label, set()).add((entry.name, str(entry.colour), entry.dashes))
    assert {label: len(seen) for label, seen in looks.items()} == dict.fromkeys(many, 1)
    assert len(set.union(*looks.values())) == len(many)


def test_restless_lines_lie_behind_calm_ones(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        calm = make_trace(0.3)
        shaken = calm.u.copy()
        shaken[::2] *= -1.0
        return replace(calm, u=shaken) if key == "slow" else calm

    (condition,) = conditions(make_results(trace_of))
    (view,) = every_figure(time_figures(condition, "x-"))[2].views
    folds = re.findall(r'"fold": (\[.*?\])', json.dumps(view.spec))
    assert set(folds) == {'["c1", "c0"]'}
    assert view.names == ("c0", "c1")


def test_where_no_run_reaches_its_end_the_reference_is_seen_all_the_same(make_results: MakeResults) -> None:
    def diverges(key: str, seed: int) -> Trace:
        trace = make_trace(0.3, outcome=Outcome.DIVERGED, reason="it fell")
        return replace(trace, y=trace.y * np.geomspace(1.0, 1e12, len(trace))[:, np.newaxis])

    drawn = every_figure(time_figures(conditions(make_results(diverges))[0], "x-"))
    for figure, largest in zip(drawn[:2], (45.0, 20.0), strict=True):
        assert figure.views[0].fixed
        (low, high) = next(
            param["value"] for param in figure.views[0].spec["params"] if param["name"] == "extent"
        )
        assert -largest <= low < high <= largest
        assert "quick" in figure.caption


@given(st.floats(-300, 290), st.floats(8, 15))
def test_an_axis_of_many_decades_has_few_ticks(start: float, decades: float) -> None:
    assert 1 <= len(log_ticks(10.0**start, 10.0 ** (start + decades))) <= 10


@given(st.floats(-3, 5), st.floats(0.2, 8))
def test_ticks_of_a_logarithmic_axis_are_round_few_and_inside(start: float, decades: float) -> None:
    low, high = 10.0**start, 10.0 ** (start + decades)
    ticks = log_ticks(low, high)
    assert 1 <= len(ticks) <= 10
    assert all(low <= tick <= high and f"{tick:e}"[1:8] in (".000000", ".500000") for tick in ticks)
    assert all(before < after for before, after in pairwise(ticks))


@given(st.lists(st.one_of(st.none(), st.floats(-1e6, 1e6)), max_size=30))
def test_a_packed_column_keeps_its_values_to_a_hundred_thousandth_of_its_range(
    column: list[float | None],
) -> None:
    decimals, *changes = json.loads(json.dumps(pack(column)))
    known = [value for value in column if value is not None]
    size = (max(known) - min(known)) or max(map(abs, known)) if known else 0.0
    total = 0
    for value, change in zip(column, changes, strict=True):
        assert (value is None) == (change is None)
        if value is not None:
            total += change
            assert total * 10.0**-decimals == pytest.approx(value, abs=1.01e-5 * size, rel=1e-9)


POINTS = st.lists(st.tuples(*[st.integers(-9000, 9000)] * 2), min_size=1, max_size=12)


@given(POINTS)
def test_a_path_written_in_steps_visits_the_same_corners(points: list[tuple[int, int]]) -> None:
    corners = visited(_steps(_points("L".join(f"{x / 10},{y / 10}" for x, y in points))))
    assert corners[0] == points[0]
    assert corners[-1] == points[-1]
    turns = [b for a, b, c in zip(points, points[1:], points[2:], strict=False) if turning(a, b, c)]
    assert [point for point in turns if point not in corners] == []


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(-40, 40)), min_size=1, max_size=40))
def test_a_simplified_line_passes_all_its_points_closer_than_can_be_seen(
    moves: list[tuple[int, int]],
) -> None:
    points = [(sum(dx for dx, _ in moves[: i + 1]), moves[i][1]) for i in range(len(moves))]
    kept = simplified(points, 3)
    assert (kept[0], kept[-1]) == (points[0], points[-1])
    assert set(kept) <= set(points)
    for x, y in points:
        heights = [np.interp(x, [a, c], [b, d]) for (a, b), (c, d) in pairwise(kept) if a <= x <= c and a < c]
        uprights = [(b, d) for (a, b), (c, d) in pairwise(kept) if a == c == x]
        near = [abs(height - y) <= 3.001 for height in heights]
        near += [min(ends) - 3 <= y <= max(ends) + 3 for ends in uprights]
        assert any(near) or len(points) == 1


def turning(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    (p, q), (r, s) = ((v[0] - u[0], v[1] - u[1]) for u, v in ((a, b), (b, c)))
    return p * s != q * r or p * r + q * s < 0


def visited(path: str) -> list[tuple[int, int]]:
    """Return the points of a path of ``M``, ``l``, ``h`` and ``v``, in tenths."""
    points = [(0, 0)]
    for letter, text in re.findall(r"([Mlhv])([^Mlhv]*)", path):
        numbers = [round(10 * float(number)) for number in re.findall(r"-?(?:\d+\.\d+|\.\d+|\d+)", text)]
        x, y = {"h": (numbers[0], 0), "v": (0, numbers[0])}.get(letter) or (numbers[0], numbers[1])
        points.append((x, y) if letter == "M" else (points[-1][0] + x, points[-1][1] + y))
    return points[1:]


def test_a_page_of_one_sample_has_an_axis(make_results: MakeResults, tmp_path: Path) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        whole = make_trace(0.3)
        rows = {"time", "reference", "y", "measured", "u", "status", "solve_time"}
        samples = {name: getattr(whole, name)[:1] for name in rows}
        return replace(whole, **samples, planned_samples=1)

    (condition,) = conditions(make_results(trace_of))
    signal = seen(condition, "x-").outputs[0]
    assert signal.end == (-0.5, 0.5)
    assert signal.extent(["c0"])[0] < signal.extent(["c0"])[1]


ROUGH: dict[str, Any] = {
    "events": [{"time": 1.0, "parameters": {"mass": 0.5}}, {"time": 0.0, "parameters": {"mass": 0.7}}],
    "drifts": [
        {"parameter": name, "from_value": 1.0, "to_value": 0.5, "from_time": 1.0, "to_time": 2.0}
        for name in ("length", "damping")
    ],
    "disturbances": {
        "torque": [
            {"kind": "steps", "times": [0.5, 1.5], "values": [0.2, 0.0]},
            {"kind": "noise", "standard_deviation": 0.1},
        ],
        "angle": [
            {"kind": "ramp", "from_value": 0.0, "to_value": 1.0, "from_time": 2.5, "to_time": 99.0}
        ],
    },
    "inputs": {"wind": {"kind": "steps", "times": [0.0, 2.0], "values": [1.0, 2.0], "unit": "m/s"}},
    "delay": {"torque": 0.2},
    "loss": {"angle": 0.05},
}  # fmt: skip


def marked(spec: dict[str, Any]) -> tuple[set[tuple[float, str]], set[tuple[float, float]]]:
    """Return the labelled instants and the shaded spans of a chart."""
    inline = [(layer["mark"]["type"], layer["data"].get("values", [])) for layer in spec["layer"]]
    labels, words = (
        {(row["t"], row["label"]) for mark, rows in inline if mark == kind for row in rows if "t" in row}
        for kind in ("rule", "text")
    )
    assert labels == words
    return labels, {
        (row["t"], row["to"]) for mark, rows in inline if mark == "rect" for row in rows if "to" in row
    }


def test_what_a_scenario_does_is_marked_with_its_label_and_told_in_words(make_results: MakeResults) -> None:
    results = make_results(scenarios={"rough": ROUGH, "calm": {}})
    rough, calm = (every_figure(time_figures(condition, "x-")) for condition in conditions(results))
    for figure in rough:
        labels, spans = marked(figure.views[0].spec)
        assert labels == {
            (0.5, "disturbance of torque 0.2"),
            (1.0, "mass 0.7 → 0.5, length 1 → 0.5, damping 1 → 0.5"),
            (1.5, "disturbance of torque 0"),
            (2.0, "input wind 2"),
            (2.5, "disturbance of angle 0 → 1"),
        }
        assert spans == {(1.0, 2.0), (2.5, 99.0)}
    for words in (
        "takes a while: at 1\N{NO-BREAK SPACE}s: mass = 0.5;",
        "damping from 1 to 0.5 between 1\N{NO-BREAK SPACE}s and 2\N{NO-BREAK SPACE}s",
        "disturbance of torque: steps: times [0.5, 1.5], values [0.2, 0] (values in N·m, its own unit)",
        "input wind: steps: times [0, 2], values [1, 2] (values in m/s)",
        "Throughout: at 0\N{NO-BREAK SPACE}s: mass = 0.7; disturbance of torque: noise: standard deviation",
        "delay of torque 0.2\N{NO-BREAK SPACE}s; samples of angle lost with a probability of 0.05.",
    ):
        assert words in rough[0].caption
    assert marked(calm[0].views[0].spec) == (set(), set())
    assert "Marked" not in calm[0].caption


MARKS = st.lists(
    st.tuples(st.floats(0, 100), st.text("mass", min_size=1, max_size=80)), min_size=1, max_size=30
)


@given(MARKS, st.floats(200, 1000))
def test_labels_of_a_row_never_overlap_and_all_have_a_place(
    marks: list[tuple[float, str]], width: float
) -> None:
    labels, _ = label_rows([Mark(text, time, time) for time, text in marks], (0.0, 100.0), width)
    assert {label.t for label in labels} == {time for time, _ in marks}
    assert {label.row for label in labels} <= {0, 1, 2}
    for label in labels:
        assert 0 <= label.begin <= label.end <= 100
        assert label.t in (label.begin, label.end)
    for row in range(3):
        spans = sorted((label.begin, label.end) for label in labels if label.row == row)
        assert all(before[1] <= after[0] + 1e-9 for before, after in pairwise(spans))


def test_labels_that_fit_into_one_row_stand_in_one() -> None:
    labels, _ = label_rows([Mark("mass 1 → 2", t, t) for t in (10.0, 50.0, 95.0)], (0.0, 100.0), 480)
    assert [(label.row, label.leftwards) for label in labels] == [(0, False), (0, False), (0, True)]


def test_a_control_signal_that_the_plant_was_not_given_is_said_to_be_a_command(
    make_results: MakeResults,
) -> None:
    trace = make_trace(0.3)
    changed = replace(trace, changed_inputs=trace.inputs, applied=trace.u + 1.0)
    said = [
        every_figure(time_figures(conditions(make_results(lambda *_, ran=variant: ran))[0], "x-"))[2].caption
        for variant in (trace, changed)
    ]
    assert ["as commanded" in caption for caption in said] == [False, True]


def test_where_every_case_failed_there_is_no_spread_to_draw(make_results: MakeResults) -> None:
    def far_off(key: str, seed: int) -> Trace:
        return scaled(make_trace(0.5), 0.1)

    assert spread_figures(conditions(make_results(far_off, seeds=[7, 8]))[0], "") == []
    assert len(spread_figures(conditions(make_results(seeds=[7, 8]))[0], "")) == 1


@pytest.mark.parametrize("number", [59, 60, 61, 62, 200, 501])
def test_of_many_seeds_so_many_are_drawn_as_can_be_told_apart(make_results: MakeResults, number: int) -> None:
    """The first seed, the median and both ends are those of all."""
    results = make_results(seeds=[7])
    values = np.random.default_rng(3).permutation(np.geomspace(1.0, 5.0, number))
    cases = [
        replace(case, seed=seed, metrics=case.metrics | dict.fromkeys(case.metrics, value))
        for case in results.cases
        for seed, value in enumerate(values.tolist())
    ]
    (figure,) = spread_figures(conditions(replace(results, cases=tuple(cases)))[0], "")
    spec = json.loads(json.dumps(figure.views[0].spec))
    rows = [row for row in spec["data"]["values"] if row["key"] == "c0"]
    dots = [row["value"] for row in rows if not row.get("extra")]
    assert len(dots) == min(number, 60 - number % 2)
    assert [min(dots), max(dots)] == pytest.approx([1.0, 5.0])
    assert np.median(dots) == pytest.approx(np.median(values), rel=1e-5)
    assert [row["value"] for row in rows if row["first"]] == [pytest.approx(values[0], rel=1e-5)]
    assert ("60 dots at most" in figure.caption) == (number > 60)


def test_what_controllers_said_of_their_steps_is_folded_thinned_out_and_told(
    make_results: MakeResults,
) -> None:
    def says(key: str, seed: int) -> Trace:
        trace = make_trace(0.5)
        steps = np.arange(len(trace), dtype=np.float64)
        many = {name: steps * place for place, name in enumerate(("cost", "b", "c", "d", "e"), start=1)}
        many["cost"][0] = np.nan
        return replace(trace, info={"slow": many, "quick": {"b": -steps}}.get(key, {}))

    (condition,) = conditions(make_results(says, THREE))
    drawn = time_figures(condition, "x-")
    figures, data = every_figure(drawn), drawn.samples
    assert [figure.folded for figure in figures] == [False, False, False, True, True]
    figure = figures[-1]
    assert [f"{v.description.partition(', 0 to')[0]} of {', '.join(v.names)}" for v in figure.views] == [
        "b over time of c0, c1",
        "cost over time of c1",
        "c over time of c1",
        "d over time of c1",
    ]
    assert [entry.label for entry in figure.legend] == ["quick", "slow"]
    assert "1 more in signals.csv" in figure.caption
    trace = make_trace(0.5)
    every = -(-len(trace) // 200)
    assert ("One of" in figure.caption) == (every > 1)
    assert data["x-i1"]["c1"][:2] == [None, float(every)]
    assert data["x-i0"]["c0"] == [-float(k) for k in range(0, len(trace), every)]
    assert len(data["x-i0"]["t"]) == len(data["x-i0"]["c0"]) <= 200
    silent = every_figure(time_figures(conditions(make_results(falls, THREE))[0], "y-"))
    assert [figure.title for figure in silent if figure.folded] == ["Change of control signals"]


def shaken(key: str, seed: int) -> Trace:
    """A run that differs from seed to seed, but for one controller."""
    return make_trace(0.3 if key == "quick" else 0.3 + 0.1 * (seed % 7), noise_seed=0)


@pytest.mark.parametrize("count", [3, 9, 10, 23])
def test_bands_go_from_quantile_to_quantile_and_of_few_seeds_from_least_to_most(
    make_results: MakeResults, count: int
) -> None:
    """The oracle takes the seeds from the files, sorts, and interpolates between ranks itself."""
    results = make_results(shaken, seeds=[*range(count)])
    (condition,) = conditions(results)
    drawn = seen(condition, "x-")
    read = min(count, 20)
    runs = [results.trace("slow", seed=seed) for seed in range(read)]
    for signal, values_of in (
        (drawn.outputs[0], lambda trace: np.degrees(trace.y[:, 0])),
        (drawn.errors[0], lambda trace: np.degrees(trace.reference[:, 0] - trace.y[:, 0])),
        (drawn.inputs[0], lambda trace: trace.u[:, 0]),
    ):
        assert [*signal.band] == ["t", "c1", "c1l", "c1h"]  # nothing of the one that is always the same
        ordered = np.sort(np.stack([values_of(trace) for trace in runs]), axis=0)
        for name, share in {"c1": 0.5, "c1l": 0.1 * (count >= 10), "c1h": 1 - 0.1 * (count >= 10)}.items():
            rank = share * (read - 1)
            below = int(rank)
            above = min(below + 1, read - 1)
            expected = ordered[below] + (rank - below) * (ordered[above] - ordered[below])
            assert signal.band[name] == pytest.approx(expected.tolist(), rel=1e-3, abs=1e-3)
    words = "10\u00a0% to the 90\u00a0% quantile" if count >= 10 else "least to the most"
    figure = every_figure(time_figures(condition, "x-"))[0]
    areas = re.findall(
        r'<path[^>]*? d="M([^"]*)Z"[^>]*fill="var\(--c(\d)\)"', str(figure.views[0].drawing.svg)
    )
    assert [colour for path, colour in areas if len(path) > 100] == ["1"]
    caption = figure.caption
    assert f"Bands: from the {words} over {'the first ' * (read < count)}{read} seeds" in caption


def test_long_runs_are_thinned_out_to_bands_that_hold_all_that_they_were(make_results: MakeResults) -> None:
    values = np.random.default_rng(1).normal(size=(12, 50)).cumsum(axis=1)
    low, high = band_ends(values)
    assert (low >= values.min(axis=0)).all()
    assert (high <= values.max(axis=0)).all()
    assert ((values >= low) & (values <= high)).mean() == pytest.approx(8 / 12, abs=0.2)


def test_runs_that_failed_are_left_out_of_the_band_and_counted(make_results: MakeResults) -> None:
    def some_fall(key: str, seed: int) -> Trace:
        falls = key == "slow" and seed in (2, 3)
        return scaled(make_trace(0.5), 50.0) if falls else make_trace(0.3, noise_seed=seed)

    (condition,) = conditions(make_results(some_fall, seeds=[1, 2, 3, 4]))
    drawn = seen(condition, "x-")
    assert drawn.over.failed == {"c0": 0, "c1": 2}
    assert max(value for value in drawn.outputs[0].band["c1h"] if value is not None) < 25
    caption = every_figure(time_figures(condition, "x-"))[0].caption
    assert "without the runs that failed (slow 2)" in caption


def test_a_steady_error_of_a_hundredth_of_the_step_can_be_seen(make_results: MakeResults) -> None:
    """Whoever else is in the panel: it lies between a twentieth of the half height and the edge."""

    def trace_of(key: str, seed: int) -> Trace:
        gain = {"exact": 1.0, "near": 0.99, "far": 0.6}[key]
        return scaled(make_trace(0.1, noise_seed=seed), gain)

    keys = {name: {"type": "a"} for name in ("exact", "near", "far")}
    (condition,) = conditions(make_results(trace_of, keys))
    (signal,) = seen(condition, "x-").errors
    trace = trace_of("near", 7)
    expected = np.degrees(trace.reference[:, 0] - trace.y[:, 0])
    assert signal.columns["c1"] == pytest.approx(expected.tolist(), rel=1e-4)
    low, high = signal.extent(["c0", "c1", "c2"])
    assert low == -high
    assert 0.05 * high <= 0.01 * 20 <= high
    assert 0.05 * signal.extent(["c0", "c1"])[1] <= 0.2 <= signal.extent(["c0", "c1"])[1]
    error = every_figure(time_figures(condition, "x-"))[1]
    assert "transients too: far (error of angle up to" in error.caption
    assert error.views[0].fixed


def test_of_a_stretch_of_constant_reference_the_second_half_is_settled_until_its_end_is_seen() -> None:
    steps = np.repeat([1.0, 2.0, 0.0], 10)
    calm = np.flatnonzero(settled_samples(steps, 2)).tolist()
    assert calm == [*range(4, 8), *range(14, 18), *range(25, 30)]
    assert settled_samples(np.sin(np.arange(30.0)), 2).all()


def test_limits_are_named_where_they_are_drawn_and_told_where_they_are_not(make_results: MakeResults) -> None:
    """Both outputs end at 20°, a little above with the noise; the torque begins at 3 N·m."""
    high = math.radians(20.1)

    def limited(key: str, seed: int) -> Trace:
        return scaled(make_trace(0.3), 1.0, low=-1.0, high=high if key == "quick" else 0.36)

    response, _, control, _ = every_figure(time_figures(conditions(make_results(limited))[0], "x-"))
    words = [
        {(round(row["value"], 1), row["label"]) for row in layer["data"]["values"]}
        for figure in (response, control)
        for layer in figure.views[0].spec["layer"]
        if layer["mark"]["type"] == "text"
    ]
    assert words == [{(20.1, "limit of quick")}]
    low, top = response.views[0].spec["params"][-1]["value"]
    assert low > -3.0
    assert top < 22.5
    unreached = "Not drawn, as no run reaches them: limits of"
    assert f"{unreached} angle at \u221257.2958° and 20.6265°." in response.caption
    assert f"{unreached} torque at \u22123.5\u00a0N·m and 3.5\u00a0N·m." in control.caption
    assert "outside the picture" not in response.caption


def test_a_limit_that_only_a_run_off_the_axis_reaches_is_said_to_be_outside(
    make_results: MakeResults,
) -> None:
    response, *_ = every_figure(time_figures(conditions(make_results(falls, THREE))[0], "x-"))
    assert "Limits outside the picture: angle at 70.0000°." in response.caption.replace("70°", "70.0000°")


def test_who_does_not_see_a_chart_is_told_whose_lines_from_where_to_where(make_results: MakeResults) -> None:
    (view,) = every_figure(time_figures(conditions(make_results())[0], "x-"))[0].views
    said = r"angle / ° over time, 0 to 6 s: quick from .+ to 20\.\d, at the end (19|20)\.\d; slow from"
    assert re.match(said, view.description)
    assert f'role="img" aria-label="{view.description}"' in view.drawing.svg


def test_who_does_not_see_the_spread_is_told_its_ends_and_its_middle(make_results: MakeResults) -> None:
    results = make_results(lambda key, seed: make_trace(0.1 * seed), seeds=[5, 2, 3, 4, 8])
    (figure,) = spread_figures(conditions(results)[0], "x-")
    errors = {
        c.seed: c.metrics["mean_abs_error.angle [deg]"] for c in results.cases if c.controller == "slow"
    }
    readings = re.findall(r"slow, seed (\d): ([\d.]+)°", figure.views[0].description)
    assert [(int(seed), float(value)) for seed, value in readings] == [
        (seed, pytest.approx(errors[seed], rel=1e-3)) for seed in (2, 4, 8)
    ]


def test_a_long_label_is_clipped_in_a_drawing(make_results: MakeResults) -> None:
    long = "x" * 10_000
    (condition,) = conditions(make_results(controllers={"a": {"type": "a", "label": long}}, seeds=[7, 8]))
    figures = [*every_figure(time_figures(condition, "x-")), *spread_figures(condition, "x-")]
    for view in (view for figure in figures for view in figure.views):
        assert "x" * 100 not in json.dumps(view.spec)
        assert "x" * 100 not in view.drawing.svg
    assert clipped("a" * 60) == "a" * 60
    assert len(clipped("a" * 61)) == 60
