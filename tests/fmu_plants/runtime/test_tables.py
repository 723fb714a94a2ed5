"""Tables that an FMU reads from its resources, against NumPy's interpolation."""

import locale
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import fmpy.fmi2 as fmi2
import fmpy.fmi3 as fmi3
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from fmu_plants import Equations, InputTable, ModelError, PlantModel, Symbols, Variable, build_fmu
from tests.fmu_plants.conftest import Instance, Instance3, Library

PERIOD = 100.0
TIMES = np.array([0.0, 10.0, 25.0, 60.0])
VALUES = np.array([1.0, 3.0, -1.0, 2.0])
KINDS = ("line", "hold", "cycle", "hold_cycle")


def equations(v: Symbols) -> Equations:
    return Equations({"total": v.line}, {f"{kind}_y": v[kind] for kind in KINDS})


def table(kind: str) -> InputTable:
    return InputTable(
        file=f"{kind}.csv",
        variables=(Variable(kind),),
        headers={kind: "Value[1]"},
        values=lambda: (TIMES, VALUES[:, None]),
        interpolation="hold" if "hold" in kind else "linear",
        period=PERIOD if "cycle" in kind else None,
    )


READER = PlantModel(
    name="reader",
    description="Shows its tables, and adds one up",
    states=(Variable("total"),),
    outputs=(Variable("total"), *(Variable(f"{kind}_y") for kind in KINDS)),
    tables=tuple(table(kind) for kind in KINDS),
    equations=equations,
)


@pytest.fixture(scope="session")
def libraries(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Library]:
    return {
        version: Library(build_fmu(READER, version), tmp_path_factory.mktemp("reader") / "an FMU with 100%")
        for version in ("2.0", "3.0")
    }


@pytest.fixture
def resources(libraries: dict[str, Library], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the resources, whose files a test may exchange."""
    built = Path(libraries["2.0"].functions._name).parents[2] / "resources"
    return Path(shutil.copytree(built, tmp_path_factory.mktemp("weather of") / "a café, 100%"))


@contextmanager
def instance_of(library: Library, location: Path | str) -> Iterator[Instance]:
    instance = Instance(library, location=location.as_uri() if isinstance(location, Path) else location)
    try:
        yield instance
    finally:
        if instance.component:
            instance.free()


def write(path: Path, times: Sequence[float], values: Sequence[float]) -> None:
    rows = "".join(f"{t!r},{v!r}\n" for t, v in zip(map(float, times), map(float, values), strict=True))
    path.write_text("time,Value[1]\n" + rows, encoding="utf-8")


def expected(kind: str, times: np.ndarray, values: np.ndarray, t: float) -> float:
    """Return what NumPy has at a time: rows repeated where there is a period, the row before where held."""
    if "cycle" in kind:
        first = times[0] + np.floor((t - times[0]) / PERIOD) * PERIOD - times[0]
        open_end = times[-1] - times[0] < PERIOD
        times, values = (
            np.append(times, times[0] + PERIOD) if open_end else times,
            np.append(values, values[0]) if open_end else values,
        )
        t = t - first
    if "hold" in kind:
        return float(values[max(int(np.searchsorted(times, t, "right")) - 1, 0)])
    return float(np.interp(t, times, values))


def test_the_resources_have_the_tables_as_text(libraries, resources):
    assert (resources / "line.csv").read_text().splitlines()[:3] == ["time,Value[1]", "0.0,1.0", "10.0,3.0"]


@pytest.mark.parametrize("t", [-30.0, 0.0, 4.0, 10.0, 59.0, 60.0, 80.0, 99.0, 100.0, 110.0, 1e4 + 25.0])
def test_columns_follow_the_rows_before_between_and_after_them(libraries, resources, t):
    with instance_of(libraries["2.0"], resources) as plant:
        plant.start(start=t)
        shown = plant.get(*(f"{kind}_y" for kind in KINDS))
    wanted = [expected(kind, TIMES, VALUES, t) for kind in KINDS]
    np.testing.assert_allclose(shown, wanted, rtol=1e-13)
    np.testing.assert_allclose([table(kind).at(np.array([t]))[0, 0] for kind in KINDS], wanted, rtol=1e-13)


@settings(max_examples=40, deadline=None)
@given(
    gaps=st.lists(st.floats(0.1, 20.0), min_size=0, max_size=5),
    first=st.floats(-50.0, 50.0),
    values=st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=6),
    steps=st.lists(st.floats(0.3, 70.0), min_size=1, max_size=8),
)
def test_any_table_is_what_numpy_has(libraries, tmp_path_factory, gaps, first, values, steps):
    times = first + np.concatenate([[0.0], np.cumsum(gaps)])
    numbers = np.array(values[: len(times)])
    folder = tmp_path_factory.mktemp("any")
    for kind in KINDS:
        write(folder / f"{kind}.csv", times, numbers)
    points = np.concatenate([[0.0], np.cumsum(steps)])
    apart = np.abs((points[:, None] - times + PERIOD / 2) % PERIOD - PERIOD / 2).min(axis=1) > 1e-6
    with instance_of(libraries["2.0"], folder) as plant:
        plant.start()
        for k, t in enumerate(points):
            for kind in KINDS if apart[k] else ():  # where a row is, rounding decides what is held
                shown = plant.get(f"{kind}_y")[0]
                assert shown == pytest.approx(expected(kind, times, numbers, t), rel=1e-9, abs=1e-6)
            if k < len(steps):
                assert plant.step(t, points[k + 1] - t) == fmi2.fmi2OK


@pytest.mark.parametrize("size", [3.0, 10.0, 37.0, 200.0])
def test_a_state_integrates_a_column_exactly_whatever_the_step(libraries, resources, size):
    with instance_of(libraries["2.0"], resources) as plant:
        plant.start()
        for k in range(int(np.ceil(70.0 / size))):
            assert plant.step(k * size, size) == fmi2.fmi2OK
            end = (k + 1) * size
            fine = np.union1d(np.linspace(0.0, end, 2), TIMES[end > TIMES])
            area = np.trapezoid(np.interp(fine, TIMES, VALUES), fine)
            assert plant.get("total")[0] == pytest.approx(area, rel=1e-12, abs=1e-12)


def test_fmi3_gets_the_path_as_it_is(libraries, resources):
    for path in (str(resources), f"{resources}/"):
        plant = Instance3(libraries["3.0"], path=path)
        plant.start()
        assert plant.get("line_y") == [1.0]
        assert plant.step(0.0, 10.0) == fmi3.fmi3OK
        assert plant.get("line_y", "hold_y").tolist() == [3.0, 3.0]
        plant.free()


def test_two_instances_may_have_different_weather(libraries, resources, tmp_path):
    warmer = Path(shutil.copytree(resources, tmp_path / "warmer"))
    write(warmer / "line.csv", TIMES, VALUES + 5.0)
    with instance_of(libraries["2.0"], resources) as one, instance_of(libraries["2.0"], warmer) as other:
        for plant in (one, other):
            plant.start()
            assert plant.step(0.0, 12.0) == fmi2.fmi2OK
        np.testing.assert_allclose(other.get("line_y") - one.get("line_y"), 5.0, rtol=1e-13)


def test_other_columns_and_another_order_are_no_matter(libraries, resources):
    text = '﻿time, wind ,"Value[1]"\r\n0,7,1.5\r\n\r\n+1E1,x,.5e+0\r\n'
    (resources / "line.csv").write_text(text, encoding="utf-8", newline="")
    with instance_of(libraries["2.0"], resources) as plant:
        plant.start()
        assert plant.get("line_y") == [1.5]
        plant.step(0.0, 5.0)
        assert plant.get("line_y") == [1.0]


def test_numbers_are_the_nearest_ones_whatever_the_locale(libraries, resources):
    awkward = [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, 2.2250738585072011e-308, 123456789.12345679]
    before = locale.setlocale(locale.LC_NUMERIC)
    others = ("de_DE.UTF-8", "fr_FR.UTF-8")
    try:
        for name in others:
            try:
                locale.setlocale(locale.LC_NUMERIC, name)
                break
            except locale.Error:
                continue
        for number in awkward:
            write(resources / "line.csv", [0.0], [number])
            with instance_of(libraries["2.0"], resources) as plant:
                plant.start()
                assert plant.get("line_y") == [number]
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "the table "),
        ("", 'line 1: the first column is not "time": .'),
        ("t,Value[1]\n0,1\n", 'line 1: the first column is not "time": t,Value[1].'),
        ("time,Value\n0,1\n", "line 1: there is no column Value[1]: time,Value."),
        ("time,Value[1]\n", "resources/line.csv has no rows"),
        ("time,Value[1]\n0,1\n\n1,nan\n", 'line 4, column Value[1]: "nan" is not a finite number'),
        ("time,Value[1]\n0,1\n1,1e999\n", 'line 3, column Value[1]: "1e999" is not a finite number'),
        ("time,Value[1]\n0,0x10\n", 'line 2, column Value[1]: "0x10" is not a finite number'),
        ("time,Value[1]\n0,1e\n", 'line 2, column Value[1]: "1e" is not a finite number'),
        ("time,Value[1]\n,1\n", 'line 2, column time: "" is not a finite number'),
        ("time,Value[1]\n0,1\n0,2\n", "line 3: the time 0 does not come after 0"),
        ("time,Value[1],b\n0,1\n", "line 2: 2 values instead of 3"),
        ("time,Value[1]\n0,1,2\n", "line 2: more than 2 values"),
    ],
)
def test_a_malformed_table_fails_the_instantiation_and_says_where(libraries, resources, text, message):
    path = resources / "line.csv"
    path.unlink() if text is None else path.write_text(text, encoding="utf-8")
    with instance_of(libraries["2.0"], resources) as plant:
        assert plant.component is None
        ((status, category, said),) = plant.messages
        assert (status, category) == (fmi2.fmi2Error, "logStatusError")
        assert message in said
        assert "line.csv" in said


def test_rows_longer_than_their_period_are_refused(libraries, resources):
    write(resources / "cycle.csv", [0.0, PERIOD + 1.0], [0.0, 1.0])
    with instance_of(libraries["2.0"], resources) as plant:
        assert plant.component is None
        assert "its rows last 101 s, longer than the period of 100 s" in plant.messages[0][2]


def test_without_a_location_of_the_resources_there_is_no_instance(libraries):
    with instance_of(libraries["2.0"], "") as plant:
        assert plant.component is None
        assert "the location of the resources is missing" in plant.messages[0][2]


def test_it_is_for_co_simulation_only(libraries, resources):
    assert libraries["2.0"].description.modelExchange is None
    plant = Instance(libraries["2.0"], kind=fmi2.fmi2ModelExchange, location=resources.as_uri())
    assert plant.component is None
    assert "this FMU is for Co-Simulation only" in plant.messages[0][2]


def cooling(v: Symbols) -> Equations:
    return Equations({"x": (v.outdoors - v.x) / 1000})


def test_what_a_table_drives_is_what_another_integrator_has(open_fmu: Callable[..., Instance]):
    times = np.arange(0.0, 9000.0, 900.0)
    rows = 10 * np.sin(times[:, None])
    model = PlantModel(
        name="cooling",
        states=(Variable("x", start=3.0),),
        outputs=(Variable("x", start=3.0),),
        tables=(InputTable(file="t.csv", variables=(Variable("outdoors"),), values=lambda: (times, rows)),),
        equations=cooling,
    )
    fmu = build_fmu(model)
    folder = fmu.parent / "read"
    plant = open_fmu(fmu, location=_extracted(fmu, folder).as_uri())
    plant.start()
    seen = []
    for k in range(12):
        assert plant.step(k * 700.0, 700.0) == fmi2.fmi2OK
        seen.append(plant.get("x")[0])
    solved = solve_ivp(
        lambda t, x: (np.interp(t, times, rows[:, 0]) - x) / 1000,
        (0.0, 8400.0),
        [3.0],
        t_eval=700.0 * np.arange(1, 13),
        rtol=1e-11,
        atol=1e-11,
        max_step=50.0,
    )
    np.testing.assert_allclose(seen, solved.y[0], atol=1e-7)


def _extracted(fmu: Path, folder: Path) -> Path:
    shutil.unpack_archive(fmu, folder, "zip")
    return folder / "resources"


FAULTS = {
    "no file name": ({"file": "../x.csv"}, "the file name may have"),
    "no columns": ({"variables": ()}, "it has no columns"),
    "interpolation": ({"interpolation": "cubic"}, "interpolation must be 'linear' or 'hold'"),
    "period": ({"period": 0.0}, "period must be positive"),
    "unknown header": ({"headers": {"lines": "x"}}, "did you mean"),
    "head twice": ({"headers": {"line": "time"}}, "stands over more than one column"),
    "head with a comma": ({"headers": {"line": "a,b"}}, "commas"),
    "values": ({"values": 3}, "values must be a function"),
}


@pytest.mark.parametrize(("changes", "message"), FAULTS.values(), ids=FAULTS)
def test_a_table_that_contradicts_itself_is_refused(changes, message):
    given = {"file": "line.csv", "variables": (Variable("line"),), "values": lambda: (TIMES, VALUES)}
    with pytest.raises(ModelError, match=message):
        PlantModel(
            name="reader",
            states=(Variable("total"),),
            outputs=(Variable("total"),),
            tables=(InputTable(**(given | changes)),),
            equations=equations,
        )


@pytest.mark.parametrize(
    ("times", "rows", "period", "message"),
    [
        ([0.0, 1.0], [[1.0]], None, r"not \(2,\) and \(1, 1\)"),
        ([], np.zeros((0, 1)), None, "not"),
        ([0.0, 0.0], [[1.0], [2.0]], None, "times must increase strictly"),
        ([0.0, np.inf], [[1.0], [2.0]], None, "must be finite"),
        ([0.0, 2.0], [[1.0], [2.0]], 1.0, "its rows last 2 s, longer than its period of 1 s"),
    ],
)
def test_values_that_are_no_table_are_refused_at_export(times, rows, period, message):
    one = InputTable(
        file="line.csv",
        variables=(Variable("line"),),
        values=lambda: (np.array(times), np.array(rows)),
        period=period,
    )
    with pytest.raises(ModelError, match=message):
        one.text()


def test_a_file_of_a_table_is_not_given_twice():
    with pytest.raises(ModelError, match="there are 2 files of this name"):
        PlantModel(
            name="reader",
            states=(Variable("total"),),
            outputs=(Variable("total"),),
            tables=(table("line"),),
            resources={"line.csv": "x"},
            equations=equations,
        )
