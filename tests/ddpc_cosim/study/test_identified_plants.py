"""Studies of a plant that is identified from logs."""

import subprocess
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from ddpc_cosim import ConfigError, Constant, Identification, Problem, Study
from ddpc_cosim.cli.summary import summary_table
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.reading import read_study
from tests.studies import cases_in, study_text, write

GAIN, POLE, NOISE = 2.0, 0.8, 0.05
RECORDED = {"samples": 60, "excitation": {"valve": {"kind": "uniform", "low": 0.0, "high": 1.0}}}


def log(folder: Path, name: str = "log.csv", *, seed: int = 1, samples: int = 400) -> Path:
    """Write y+ = 0.8 y + 0.4 u + 0.1 d + 0.05 eps, every second, about 20 degC."""
    rng = np.random.default_rng(seed)
    u, d = rng.uniform(0.0, 1.0, samples), rng.standard_normal(samples)
    y = np.full(samples, 21.0)
    for k in range(samples - 1):
        y[k + 1] = 20.0 + POLE * (y[k] - 20.0) + 0.4 * u[k] + 0.1 * d[k] + NOISE * rng.standard_normal()
    rows = [f"{k},{u[k]:.9f},{d[k]:.9f},{y[k]:.9f}" for k in range(samples)]
    path = folder / name
    path.write_text("\n".join(["time [s],valve [1],wind [m/s],room [degC]", *rows, ""]), encoding="utf-8")
    return path


def identified(folder: Path, *, plant: dict[str, Any] | None = None, **others: Any) -> Path:
    settings = {"file": str(log(folder)), "method": "arx", "order": 1, "members": 4, "disturbances": ["wind"]}
    section = {"identified": settings | (plant or {}), "inputs": ["valve"], "outputs": ["room"]}
    tables = {"loop": {"sampling_time": 1.0, "duration": 20.0}, "seeds": [0, 1, 2, 3, 4]}
    text = study_text(section, {"room": 21.2}, **({"controllers": ["idle"]} | tables | others))
    return write(folder, text)


def test_its_signals_are_the_columns_with_their_units(tmp_path: Path) -> None:
    problem = read_study(str(identified(tmp_path))).problem
    assert [(v.name, v.unit) for v in (*problem.inputs, *problem.outputs)] == [
        ("valve", "1"),
        ("room", "degC"),
    ]
    assert problem.inputs[0].start == pytest.approx(0.5, abs=0.05)


def test_seed_s_plays_model_s_and_counts_anew_from_the_last_model_on(tmp_path: Path) -> None:
    cases = cases_in(identified(tmp_path, plant={"noise": False}))
    rooms = {case.seed: run_case(case).y[0, 0] for case in cases}
    assert len({rooms[seed] for seed in range(4)}) == 4
    assert rooms[4] == rooms[0]


def test_every_controller_of_a_seed_meets_the_same_model_and_the_same_noise(tmp_path: Path) -> None:
    """Also one that recorded an experiment before, and one that did not."""
    path = identified(tmp_path, controllers={"a": "idle", "b": "idle"}, recording=RECORDED)
    cases = cases_in(path)
    by_seed: dict[int, list[Any]] = {}
    for case in cases:
        by_seed.setdefault(case.seed, []).append(run_case(case).y)
    without = {case.seed: run_case(case).y for case in cases_in(identified(tmp_path))}
    for seed, (first, other) in by_seed.items():
        np.testing.assert_array_equal(first, other)
        np.testing.assert_array_equal(first, without[seed])
    assert not np.array_equal(without[0], without[4])  # one model, other noise


def test_a_known_disturbance_drives_it(tmp_path: Path) -> None:
    windy = {"wind": {"signal": {"kind": "constant", "value": 1.0}}}
    plant = {"noise": False}
    calm = run_case(cases_in(identified(tmp_path, plant=plant))[0]).y[:, 0]
    moved = run_case(cases_in(identified(tmp_path, plant=plant, disturbances=windy))[0]).y[:, 0]
    assert moved[-1] - calm[-1] == pytest.approx(0.1 / (1.0 - POLE), rel=0.2)


def test_the_models_spread_about_the_plant_that_made_the_log(tmp_path: Path) -> None:
    path = identified(tmp_path, plant={"members": 20})
    plant = read_study(str(path)).problem.plant.built().identified
    assert plant is not None
    assert plant.ensemble is not None
    gains = [
        float((model.c @ np.linalg.solve(np.eye(model.order) - model.a, model.b))[0, 0])
        for model in plant.ensemble.models
    ]
    low, high = np.quantile(gains, [0.025, 0.975])
    assert low < GAIN < high
    assert high - low < 0.4


def test_ids_follow_from_the_content_of_the_logs_and_the_settings(tmp_path: Path) -> None:
    first = [case.id for case in cases_in(identified(tmp_path))]
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    assert [case.id for case in cases_in(identified(moved))] == first
    assert cases_in(identified(tmp_path, plant={"order": 2}))[0].id != first[0]
    path = identified(tmp_path)
    log(tmp_path, seed=2)
    assert cases_in(path)[0].id != first[0]


def test_the_logs_may_be_named_alone_and_relative_to_the_study(tmp_path: Path) -> None:
    log(tmp_path)
    plant = {"identified": "log.csv", "inputs": ["valve"], "outputs": ["room"]}
    path = write(
        tmp_path, study_text(plant, {"room": 21.2}, ["idle"], {"sampling_time": 1.0, "duration": 9.0})
    )
    resolved = read_study(str(path)).problem.study.plant
    assert resolved.identified is not None
    assert resolved.identified.file == [str(tmp_path / "log.csv")]
    copied = Study.read(path).write(tmp_path / "other" / "copy.toml")
    assert read_study(str(copied)).problem.study.plant == resolved


def test_a_problem_in_python_is_that_of_the_file(tmp_path: Path) -> None:
    path = identified(tmp_path)
    file = [str(tmp_path / "log.csv")]
    plant = Identification(file=file, method="arx", order=1, members=4, disturbances=["wind"])
    problem = Problem(
        plant=plant,
        inputs=["valve"],
        outputs=["room"],
        sampling_time=1.0,
        duration=20.0,
        reference=Constant(21.2),
    )
    written = Study(problem, {"idle": "idle"}, seeds=range(5)).write(tmp_path / "python.toml")
    assert [case.id for case in cases_in(written)] == [case.id for case in cases_in(path)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inputs": []}, r"plant.identified: inputs: none are named"),
        ({"inputs": ["valve", "wind"]}, r'"wind" is among the inputs and the disturbances'),
    ],
)
def test_names_that_the_log_does_not_have_are_faults_with_its_columns(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    settings = {"file": str(log(tmp_path)), "disturbances": ["wind"]}
    plant = {"identified": settings, "inputs": ["valve"], "outputs": ["room"]} | changes
    loop = {"sampling_time": 1.0, "duration": 9.0}
    path = write(tmp_path, study_text(plant, {"room": 21.2}, ["idle"], loop))
    with pytest.raises(ConfigError, match=message) as raised:
        read_study(str(path))
    assert "has the columns valve, wind, room" in str(raised.value)


def test_a_column_that_is_not_there_is_a_fault(tmp_path: Path) -> None:
    settings = {"file": str(log(tmp_path)), "disturbances": ["wind"]}
    plant = {"identified": settings, "inputs": ["valve"], "outputs": ["rom"]}
    loop = {"sampling_time": 1.0, "duration": 9.0}
    path = write(tmp_path, study_text(plant, {"rom": 21.2}, ["idle"], loop))
    with pytest.raises(ConfigError, match=r'plant.identified: .*no column "rom".*room'):
        read_study(str(path))


def test_a_loop_between_the_samples_of_the_models_is_a_fault(tmp_path: Path) -> None:
    path = identified(tmp_path, loop={"sampling_time": 1.5, "duration": 30.0})
    with pytest.raises(ConfigError, match=r"loop.sampling_time: 1.5 s between samples, .* identified at 1 s"):
        read_study(str(path))


def test_an_input_that_never_moved_is_a_fault(tmp_path: Path) -> None:
    path = log(tmp_path)
    rows = path.read_text(encoding="utf-8").splitlines()
    still = [
        rows[0],
        *(",".join([cells[0], "0.5", *cells[2:]]) for cells in (row.split(",") for row in rows[1:])),
    ]
    path.write_text("\n".join(still), encoding="utf-8")
    plant = {"identified": str(path), "inputs": ["valve"], "outputs": ["room"]}
    study = study_text(plant, {"room": 21.2}, ["idle"], {"sampling_time": 1.0, "duration": 9.0})
    with pytest.raises(ConfigError, match="valve: never moved, so the data do not say what it does"):
        read_study(str(write(tmp_path, study)))


def test_reading_a_study_imports_nothing_that_is_heavy(tmp_path: Path) -> None:
    path = identified(tmp_path)
    program = (
        "import sys; from ddpc_cosim.study.reading import read_study; "
        f"read_study({str(path)!r}); "
        "print([name for name in ('fmpy', 'scipy.signal', 'pandas', 'sympy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_run_says_in_what_share_of_its_samples_it_was_beyond_the_log(tmp_path: Path) -> None:
    """Held at three times what the valve was ever given, the room warms beyond what was recorded."""
    quiet = {"noise": False}
    assert run_case(cases_in(identified(tmp_path, plant=quiet))[0]).beyond_log == {}
    path = identified(tmp_path, plant=quiet)
    text = path.read_text(encoding="utf-8").replace("[plant]\n", "[plant]\nstart = { valve = 3.0 }\n", 1)
    trace = run_case(cases_in(write(tmp_path, text))[0])
    highest = float(np.genfromtxt(tmp_path / "log.csv", delimiter=",", skip_header=1)[:, 3].max())
    assert trace.beyond_log == {"valve": 1.0, "room": float((trace.y[:, 0] > highest).mean())}


def test_terminal_and_report_say_who_left_the_log(tmp_path: Path) -> None:
    path = identified(tmp_path, plant={"noise": False})
    text = path.read_text(encoding="utf-8").replace("[plant]\n", "[plant]\nstart = { valve = 3.0 }\n", 1)
    study = Study.read(write(tmp_path, text))
    results = study.run(tmp_path / "results", jobs=1, progress=False)
    words = "eyond what the log recorded, where a model from it says nothing, went"
    printed = StringIO()
    console = Console(width=200, file=printed)
    console.print(summary_table(results, console))
    assert words in printed.getvalue()
    assert words in results.report().read_text(encoding="utf-8")
