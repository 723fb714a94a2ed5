"""Studies whose controllers learn from files of logged data instead of an experiment."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studies import cases_in, write

from ddpc_controllers import PID
from ddpc_cosim import (
    ConfigError,
    Constant,
    DataError,
    FloatArray,
    GaussianNoise,
    Problem,
    Recording,
    Study,
    UniformRandom,
    Variable,
    record,
)
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.variables import names

CONTROLLERS: Mapping[str, str] = {
    "deepc": "",
    "deepc-published": "",
    "spc": "",
    "gamma-ddpc": "",
    "select-dpc": "",
    "wkpc": "",
    "wkpc-published": "",
    "koopman-mpc": "",
    "gpc": "",
    "mpc": "",
    "lqr": "",
    "pid": 'tuning = "step-test"',
    "scaled": 'controller = { type = "deepc" }',
    "offset-free": 'controller = { type = "spc" }',
}
HEAD = """
plant = { name = "pendulum", inputs = ["torque"], outputs = ["angle"], measurements = MEASURED }
loop = { sampling_time = 0.1, duration = 2.0 }
reference.angle = { kind = "constant", value = 10.0, unit = "deg" }
bounds.torque = { min = -3.5, max = 3.5 }
seeds = [3]
""".replace("MEASURED", '["angle", "angular_velocity"]')
METHODS = "".join(
    f'[controllers.{name}]\ntype = "{name}"\nsettings = {{ {settings} }}\n'
    for name, settings in CONTROLLERS.items()
)
EXPERIMENT = "recording = { samples = 150, excitation.torque = { low = -3.5, high = 3.5 } }\n"
ONE = 'controllers.deepc.type = "deepc"\n'


def cases(folder: Path, text: str) -> dict[str, Case]:
    return {case.controller: case for case in cases_in(write(folder, text))}


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, dict[str, Case]]:
    """The recording of the experiment's study, and its cases."""
    by_controller = cases(tmp_path_factory.mktemp("experiment"), HEAD + EXPERIMENT + METHODS)
    case = by_controller["deepc"]
    plant = case.plant.open(names(case.inputs), names(case.measurements))
    try:
        recording = record(
            plant,
            UniformRandom(-3.5, 3.5, 150, seed=3),
            sampling_time=0.1,
            outputs=["angle"],
            noise=GaussianNoise({}),
        )
    finally:
        plant.close()
    return recording, by_controller


def test_a_file_teaches_what_the_experiment_taught(
    tmp_path: Path, experiment: tuple[Recording, dict[str, Case]]
) -> None:
    recording, others = experiment
    signals = others["deepc"].inputs, others["deepc"].outputs, others["deepc"].measurements
    recording.write_csv(tmp_path / "log.csv", *signals)
    by_controller = cases(tmp_path, HEAD + 'recording.file = "log.csv"\n' + METHODS)
    assert by_controller.keys() == CONTROLLERS.keys()
    for name, case in by_controller.items():
        trace, other = run_case(case), run_case(others[name])
        assert trace.completed, trace.reason
        assert np.array_equal(trace.u, other.u), name
        assert np.array_equal(trace.y, other.y), name
        assert trace.diagnostics == other.diagnostics


def row(t: float, scale: float = 1.0) -> str:
    return f"{t:.1f};{scale * np.sin(31 * t * t):.6f};{np.cos(7 * t):.6f};{np.sin(3 * t):.6f}".replace(
        ".", ","
    )


def log(folder: Path, name: str = "log.csv", rows: int = 120, scale: float = 1.0) -> Path:
    path = folder / name
    header = "t [s];M [N.m];angle [deg];angular_velocity [rev/s]"
    path.write_text("\n".join([header, *(row(i / 10, scale) for i in range(rows))]), encoding="utf-8")
    return path


FROM_FILES = '[recording]\ncolumns = { torque = "M" }\ntime_column = "t"\n'


def test_columns_and_units_are_those_of_the_file(tmp_path: Path) -> None:
    log(tmp_path)
    case = cases(tmp_path, HEAD + ONE + FROM_FILES + 'file = "log.csv"')["deepc"]
    recording = case.recording
    assert recording is not None
    t = np.arange(120) / 10
    assert recording.u[:, 0] == pytest.approx(np.sin(31 * t * t), abs=1e-6)
    assert recording.y[:, 0] == pytest.approx(np.radians(np.cos(7 * t)), abs=1e-6)
    assert recording.measured[:, 1] == pytest.approx(2 * np.pi * np.sin(3 * t), abs=1e-5)
    assert case.excitation is None
    trace = run_case(case)
    assert trace.completed
    trace.write_csv(tmp_path / "run.csv")
    again = Recording.read_csv(
        tmp_path / "run.csv",
        sampling_time=0.1,
        inputs=case.inputs,
        outputs=case.outputs,
        measurements=case.measurements,
    )
    assert np.array_equal(again.u, trace.u)
    assert np.array_equal(again.measured, trace.measured)


def test_columns_say_what_moved_the_inputs_from_outside(tmp_path: Path) -> None:
    """A case's recording has them, from a log as from a study in Python that is written."""
    log(tmp_path)
    text = HEAD + ONE + FROM_FILES + 'file = "log.csv"\n'
    with_it = cases(tmp_path, text + 'excitation_columns = ["angular_velocity"]')["deepc"]
    recording, without = with_it.recording, cases(tmp_path, text)["deepc"]
    assert recording is not None
    assert without.recording is not None
    assert recording.excitation[:, 0] == pytest.approx(np.sin(3 * np.arange(120) / 10), abs=1e-6)
    assert without.recording.excitation.shape == (120, 0)
    assert with_it.id != without.id
    (fault,) = faults(tmp_path, FROM_FILES + 'file = "log.csv"\nexcitation_columns = ["speed"]')
    assert "speed" in fault
    recording.write_csv(tmp_path / "copy.csv", ["torque"], ["angle"], ["a", "b"], [], ["w"])
    copy = Recording.read_csv(
        tmp_path / "copy.csv", sampling_time=0.1, inputs=["torque"], outputs=["angle"], excitation=["w"]
    )
    assert np.array_equal(copy.excitation, recording.excitation)
    assert copy.pieces[0].digest == copy.digest != replace(copy, excitation=copy.u).digest
    assert Recording.join([copy, copy]).excitation.shape == (240, 1)


def test_a_written_study_keeps_what_moved_the_inputs_from_outside(tmp_path: Path) -> None:
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 1))
    problem = Problem(
        plant="pendulum",
        outputs=["angle"],
        measurements=["angle"],
        sampling_time=0.1,
        duration=1.0,
        reference=Constant(0.0),
        recording=Recording(u, u, u, 0.1, excitation=0.5 * u),
    )
    Study(problem, {"a": PID()}, name="kept").write(tmp_path / "study.toml")
    (resolved,) = Study.read(tmp_path / "study.toml").resolved().problems.values()
    assert resolved.recording is not None
    assert np.array_equal(resolved.recording.excitation, 0.5 * u)


def test_several_files_are_a_mosaic_and_their_content_is_part_of_the_case(tmp_path: Path) -> None:
    log(tmp_path), log(tmp_path, "more.csv", 50)
    text = HEAD + ONE + FROM_FILES

    def identifier(*files: str) -> str:
        case = cases(tmp_path, text + f"file = {list(files)}".replace("'", '"'))["deepc"]
        assert case.recording is not None
        assert len(case.recording.pieces) == len(files)
        return case.id

    both = identifier("log.csv", "more.csv")
    assert identifier("log.csv") != both
    assert identifier("more.csv", "log.csv") != both
    log(tmp_path, "more.csv", 50, scale=1.001)
    changed = identifier("log.csv", "more.csv")
    assert changed != both
    moved = log(tmp_path, "moved.csv", 50)
    moved.write_text(moved.read_text().replace(";M", ";  M "), encoding="utf-8")
    assert identifier("log.csv", "moved.csv") == both


def test_what_was_done_to_a_log_is_in_the_provenance_and_decides_by_what_comes_of_it(tmp_path: Path) -> None:
    path = log(tmp_path)
    as_it_is = cases(tmp_path, HEAD + ONE + FROM_FILES + 'file = "log.csv"')["deepc"]
    told = 'file = "log.csv"\ngaps = "split"\nmissing = 2\nduplicates = "first"'
    assert cases(tmp_path, HEAD + ONE + FROM_FILES + told)["deepc"].id == as_it_is.id
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[30:30] = [lines[29]]
    del lines[90:92]
    path.write_text("\n".join(lines), encoding="utf-8")
    case = cases(tmp_path, HEAD + ONE + FROM_FILES + told)["deepc"]
    assert case.id != as_it_is.id
    assert case.recording is not None
    assert case.recording.treatments == ("1 duplicate row dropped", "6 cells interpolated")
    assert run_case(case).provenance["logged data"] == "1 duplicate row dropped, 6 cells interpolated"
    assert "logged data" not in run_case(as_it_is).provenance


def faults(folder: Path, recording: str, controller: str = ONE, head: str = HEAD) -> list[str]:
    with pytest.raises(ConfigError) as raised:
        cases(folder, head + controller + recording)
    return [fault.replace(f"{folder}/", "") for fault in raised.value.faults]


def test_all_that_is_wrong_with_files_in_one_message(tmp_path: Path) -> None:
    log(tmp_path)
    lines = log(tmp_path, "bad.csv").read_text().splitlines()
    lines[0] = lines[0].replace("angle [deg]", "angle [bar]").replace("M [N.m]", "torque")
    lines[7] = lines[7].replace("0,6", "0,9")
    lines[9] = "0,8;x;nan;1"
    (tmp_path / "bad.csv").write_text("\n".join(lines))
    messages = faults(tmp_path, FROM_FILES + 'file = ["log.csv", "bad.csv", "absent.csv"]')
    assert [fault.removeprefix("study.toml:11: recording.file: ") for fault in messages] == [
        'bad.csv: no column "M"; there are: angle, angular_velocity, t, torque',
        'bad.csv, column "angle [bar]": unit "bar" does not fit angle; allowed: rad, deg, °, rev',
        'bad.csv, line 9, column "t [s]": 0.7 s is -0.2 s after the row before; times must increase; '
        'sort its rows, or write duplicates = "first", by which they are put in the order of time',
        'bad.csv, line 8, column "t [s]": 0.9 s is 0.4 s after the row before; needed: the sampling time '
        '0.1 s, within 1 %; write gaps = "split" to make pieces of it, or missing = 3 to interpolate',
        'bad.csv, line 10, column "angle [bar]": "nan" is not a finite number; write missing = 1 to '
        'interpolate up to 1 in a row, or gaps = "split" to leave out such samples',
        "absent.csv: no such file",
    ]


def test_what_does_not_go_with_files(tmp_path: Path) -> None:
    log(tmp_path)
    (message,) = faults(tmp_path, FROM_FILES + 'file = "log.csv"\nsamples = 100')
    assert message == (
        "study.toml:12: recording.samples: belongs to an experiment, and file to logged data; "
        "needed: one of them"
    )
    log(tmp_path, rows=15)
    (message,) = faults(tmp_path, FROM_FILES + 'file = "log.csv"')
    assert message.endswith("recording.file: the number of rows, 15 is too short for deepc, which needs 21")
    (message,) = faults(
        tmp_path, 'recording = { file = "log.csv", columns = { torqe = "M" }, time_column = "t" }'
    )[:1]
    assert message.endswith(
        'recording.columns: no input, output or measurement that takes part "torqe"; did you mean "torque"?'
    )
    missing = faults(tmp_path, "recording = { columns = { torque = 'M' } }")
    assert sorted(fault.split(": ", 1)[1] for fault in missing)[::-1] == [
        "recording.samples: required key is missing; or give the key file, for logged data",
        "recording.excitation: none for the input torque",
        "recording.columns: names columns of the key file, which is missing",
    ]
    assert any(
        fault.endswith("recording.excitation_columns: names columns of the key file, which is missing")
        for fault in faults(tmp_path, "recording = { excitation_columns = ['dither'] }")
    )
    (message,) = faults(tmp_path, EXPERIMENT.replace("samples", 'gaps = "split", samples'))
    assert message.endswith("recording.gaps: says how the files of the key file are read, which is missing")
    log(tmp_path)
    at_end = HEAD.replace("duration = 2.0", 'duration = 2.0, start = "recording-end"')
    (message,) = faults(tmp_path, FROM_FILES + 'file = "log.csv"', head=at_end)
    assert message.endswith('"recording-end" needs an experiment to go on from, not files')


def test_in_python_the_same_rules_hold(tmp_path: Path) -> None:
    path = log(tmp_path)
    angle = Variable("angle", unit="rad")
    keys = {"inputs": ["torque"], "outputs": [angle], "columns": {"torque": "M"}, "time_column": "t"}
    recording = Recording.read_csv(path, path, sampling_time=0.1, **keys)
    assert recording.seams == (120,)
    assert np.array_equal(recording.measured, recording.y)
    with pytest.raises(
        DataError, match=r"rows are 0.1 s apart, in the median; needed: the sampling time 0.2 s"
    ):
        Recording.read_csv(path, sampling_time=0.2, **keys)
    piece = recording.pieces[0]
    piece.write_csv(tmp_path / "copy.csv", ["torque"], [angle])
    copy = Recording.read_csv(tmp_path / "copy.csv", sampling_time=0.1, inputs=["torque"], outputs=["angle"])
    assert np.array_equal(copy.u, piece.u)
    assert np.array_equal(copy.y, piece.y)
    with pytest.raises(DataError, match="2 pieces do not go into one file"):
        recording.write_csv(tmp_path / "both.csv", ["torque"], [angle])
    with pytest.raises(DataError, match="2 signals for 1 columns"):
        piece.write_csv(tmp_path / "two.csv", ["torque", "force"], [angle])
    differing = replace(piece, measured=piece.y + 1.0)
    with pytest.raises(DataError, match=r'"angle \[rad\]" has different values'):
        differing.write_csv(tmp_path / "differing.csv", ["torque"], [angle])


TANKS = """
plant = { name = "quadruple-tank" }
loop = { sampling_time = 5.0, duration = 50.0 }
reference.level_1 = { kind = "constant", value = 12.4, unit = "cm" }
reference.level_2 = { kind = "constant", value = 12.7, unit = "cm" }
seeds = [3, 4]
controllers.mfapc.type = "mfapc"
"""


def excitation(folder: Path, text: str, seed: int = 3) -> FloatArray:
    case = next(case for case in cases_in(write(folder, TANKS + text)) if case.seed == seed)
    assert case.excitation is not None
    return case.excitation.with_seed(case.seed).draw(len(case.inputs))


def test_inputs_can_be_excited_each_in_its_way(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(
        "time [min],pump_2 [V]\n" + "".join(f"{i / 12:.9f},{i / 10}\n" for i in range(50)), encoding="utf-8"
    )
    head = "[recording]\nsamples = 40\n[recording.excitation]\n"
    prbs = 'pump_1 = { kind = "prbs", low = 2500, high = 3.5e3, unit = "mV", clock_period = 2 }\n'
    u = excitation(tmp_path, head + prbs + 'pump_2 = { kind = "recorded", file = "log.csv" }')
    assert set(np.round(u[:, 0], 12)) == {2.5, 3.5}
    assert np.array_equal(u[::2, 0], u[1::2, 0])
    assert u[:, 1] == pytest.approx(np.arange(40) / 10)
    steps = 'pump_2 = { kind = "steps", times = [0, 50], values = [2, 3] }'
    u = excitation(tmp_path, head + prbs + steps)
    assert u[:, 1].tolist() == [2.0] * 10 + [3.0] * 30
    signal = 'pump_{} = {{ kind = "{}", low = 2.0, high = 4.0{} }}\n'
    for kind, keys in {
        "uniform": "",
        "prbs": "",
        "multisine": ', max_frequency = 0.08, phases = "random"',
        "chirp": ", from_frequency = 0.01, to_frequency = 0.1",
    }.items():
        both = head + signal.format(1, kind, keys) + signal.format(2, kind, keys)
        u = excitation(tmp_path, both)
        assert 2.0 - 1e-12 <= u.min() < u.max() <= 4.0 + 1e-12
        assert abs(np.corrcoef(u.T)[0, 1]) < 0.9
        assert not np.array_equal(u, excitation(tmp_path, both, seed=4))
    alike = signal.format(1, "uniform", "") + "pump_2 = { low = 2.0, high = 4.0 }\n"
    assert np.array_equal(excitation(tmp_path, head + alike), UniformRandom(2.0, 4.0, 40, 3).draw(2))


def test_all_that_is_wrong_with_an_excitation(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time,pump_2\n0,1\n5,x\n", encoding="utf-8")
    study = tmp_path / "study.toml"

    def faults_of(pump_1: str, pump_2: str) -> list[str]:
        text = f"[recording]\nsamples = 40\nexcitation.pump_1 = {pump_1}\nexcitation.pump_2 = {pump_2}\n"
        study.write_text(TANKS + text, encoding="utf-8")
        with pytest.raises(ConfigError) as raised:
            read_study(str(study))
        return [fault.replace(f"{tmp_path}/", "") for fault in raised.value.faults]

    assert faults_of(
        '{ kind = "chirp", low = 1, high = 2, from_frequency = 0.01, to_frequency = 1 }',
        '{ kind = "recorded", file = "log.csv" }',
    ) == [
        "study.toml:10: recording.excitation.pump_1: chirp excitation: to_frequency = 1 Hz is not possible; "
        "allowed: above 0, up to half the sampling frequency, 0.1 Hz",
        'study.toml:11: recording.excitation.pump_2.file: log.csv, line 3, column "pump_2": '
        '"x" is not a finite number',
    ]
    (tmp_path / "log.csv").write_text("time,pump_2\n0,1\n5,2\n", encoding="utf-8")
    assert faults_of('{ kind = "prbs", low = 1, high = 0 }', '{ kind = "recorded", file = "log.csv" }') == [
        "study.toml:10: recording.excitation.pump_1: PRBS excitation: low (1.0) must be below high (0.0)",
        "study.toml:11: recording.excitation.pump_2.file: log.csv: 2 rows; needed: samples = 40",
    ]
    (first, second) = faults_of(
        '{ kind = "square", low = 1, high = 2 }', '{ low = 1, high = 2, unit = "bar" }'
    )
    assert (
        "must be one of 'uniform', 'prbs', 'multisine', 'chirp', 'steps', 'recorded', got 'square'" in first
    )
    assert 'unit "bar" does not fit pump_2' in second


def test_a_scenario_can_excite_in_another_way(tmp_path: Path) -> None:
    text = (
        TANKS
        + """
[recording]
samples = 40
excitation.pump_1 = { low = 2.0, high = 4.0 }
excitation.pump_2 = { low = 2.0, high = 4.0 }
[scenarios.uniform]
[scenarios.binary]
recording.excitation.pump_2 = { kind = "prbs", low = 2.5, high = 3.5 }
"""
    )
    study = write(tmp_path, text)
    drawn = {
        case.scenario: case.excitation.with_seed(3).draw(2)
        for case in cases_in(study)
        if case.excitation is not None and case.seed == 3
    }
    assert np.array_equal(drawn["uniform"], UniformRandom(2.0, 4.0, 40, 3).draw(2))
    assert set(drawn["binary"][:, 1]) == {2.5, 3.5}
    study.write_text(
        text.replace('kind = "prbs"', 'kind = "multisine", min_frequency = 0.2'), encoding="utf-8"
    )
    with pytest.raises(
        ConfigError, match=r"scenarios\.binary\.recording\.excitation\.pump_2: multisine excitation: 0"
    ):
        read_study(str(study))
