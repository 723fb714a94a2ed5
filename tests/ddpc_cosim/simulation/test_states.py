"""States in files: a run that goes on from one is the rest of a run that was not divided."""

import hashlib
import pickle
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np
import pandas as pd
import pytest
from fmus.builder import keeping_fmu
from hypothesis import given, strategies as st

from ddpc_cosim import ConfigError, CosimError, CosimWarning, simulate
from ddpc_cosim.simulation.state_file import PlantState
from ddpc_cosim.study.case_files import read_sealed, sealed_json

TORQUE = pd.DataFrame({"time": [0.0, 1.0, 2.0, 3.0], "torque": [0.0, 2.0, 0.0, 1.0]})


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
def test_a_divided_run_is_the_same_to_the_last_bit(
    pendulum_fmu: Path, pendulum_fmi3: Path, tmp_path: Path, version: str, kind: Any
) -> None:
    """The steps are no binary fractions, and the inputs change at every sample."""
    fmu, state = pendulum_fmi3 if version == "3.0" else pendulum_fmu, tmp_path / "mid.state"
    how: dict[str, Any] = {"inputs": TORQUE, "step": 0.1, "fmi_type": kind}
    whole = simulate(fmu, stop=3, parameters={"angle": 0.1, "radius": 0.3}, **how)
    first = simulate(fmu, stop=0.7, parameters={"angle": 0.1, "radius": 0.3}, save_state=state, **how)
    second = simulate(fmu, stop=1.9, load_state=state, save_state=state, **how)
    third = simulate(fmu, stop=3, load_state=state, **how)
    parts = pd.concat((first, second.iloc[1:], third.iloc[1:]), ignore_index=True)
    pd.testing.assert_frame_equal(parts, whole, check_exact=True)
    pd.testing.assert_frame_equal(second.iloc[:1], first.iloc[-1:].reset_index(drop=True), check_exact=True)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_fmu_with_time_events_goes_on_at_another_season(tmp_path: Path, version: str) -> None:
    """It counts seconds from its start on, and ends the simulation at ten: the state knows both."""
    fmu, state = keeping_fmu(tmp_path, version, "stair"), tmp_path / "mid.state"
    whole = simulate(fmu, start="day 23", stop=22 * 86400 + 8, step=0.7)
    simulate(fmu, start="day 23", stop=22 * 86400 + 4, step=0.7, save_state=state)
    rest = simulate(fmu, stop=22 * 86400 + 8, load_state=state)
    assert rest.attrs["notes"][0] == "goes on at t = 1900803.5 s from a state"
    pd.testing.assert_frame_equal(rest, whole.iloc[5:].reset_index(drop=True), check_exact=True)
    with pytest.warns(CosimWarning, match="terminated"):
        ended = simulate(fmu, stop=22 * 86400 + 20, load_state=state, save_state=tmp_path / "never.state")
    assert ended["count [1]"].iloc[-1] in (9.0, 10.0)
    assert not (tmp_path / "never.state").exists()


def test_an_fmu_that_ends_at_the_last_sample_leaves_no_state(tmp_path: Path) -> None:
    """It has reached the end and counts to ten; there is no step from there."""
    fmu = keeping_fmu(tmp_path, "2.0", "stair")
    with pytest.warns(CosimWarning, match=r"terminated: 11 of 11 samples.*after the last sample"):
        frame = simulate(fmu, stop=10, step=1, save_state=tmp_path / "end.state")
    assert frame["count [1]"].iloc[-1] == 10.0
    assert not (tmp_path / "end.state").exists()


def test_other_steps_inputs_and_tunable_parameters_from_a_state_on(tmp_path: Path) -> None:
    """x' = rate (u - x): held at u = 2, then let go, then with another rate and other steps."""
    fmu, state = keeping_fmu(tmp_path, "2.0", "lag"), tmp_path / "mid.state"
    inputs = pd.DataFrame({"time": [0.0, 1.0], "u": [2.0, 2.0]})
    simulate(fmu, inputs=inputs, parameters={"x": 0.5}, stop=1, step=0.1, save_state=state)
    at_1 = 2 - 1.5 * np.exp(-1)
    held = simulate(fmu, stop=2, step=0.25, load_state=state)
    assert held["time [s]"].tolist() == [1.0, 1.25, 1.5, 1.75, 2.0]
    assert held["x [1]"].to_numpy() == pytest.approx(2 - (2 - at_1) * np.exp(1 - held["time [s]"]), abs=1e-9)
    assert held.attrs["notes"][1] == "not driven now, held as in the state: u = 2"
    faster = simulate(fmu, parameters={"rate": 3, "u": 0}, stop=1.5, load_state=state, save_state=state)
    expected = at_1 * np.exp(-3 * (faster["time [s]"] - 1))
    assert faster["x [1]"].to_numpy() == pytest.approx(expected.to_numpy(), abs=1e-9)
    again = simulate(fmu, parameters={"rate": 3}, stop=2, load_state=state)  # what it is already
    assert again["x [1]"].iloc[-1] == pytest.approx(at_1 * np.exp(-3.0), abs=1e-9)
    back = simulate(fmu, parameters={"rate": 1}, stop=2, load_state=state)  # what it was at first
    assert back["x [1]"].iloc[-1] == pytest.approx(at_1 * np.exp(-2.0), abs=1e-9)
    with pytest.raises(ConfigError) as caught:
        simulate(fmu, parameters={"name": "b", "x": 1}, start=3, stop=4, load_state=state)
    assert caught.match('parameter "name" cannot change during a run; tunable: rate')
    assert caught.match("start = 3 s is not possible: the state is that at 1.5 s")


CLASS = '''
import numpy as np
from ddpc_cosim import Plant, Variable


class Counter(Plant):
    """Adds its inputs up, and says how often it was asked."""

    inputs = (Variable("u"), Variable("rest", start=0.5))
    outputs = (Variable("sum"), Variable("calls"))
    can_save_state = True
    state_is_data = True

    def reset(self, parameters=None, t0=0.0):
        self.sum, self.calls, self.gain = np.zeros(2), 0, 1.0
        self.set_parameters(parameters or {})
        return np.array([0.0, 0.0])

    def set_parameters(self, parameters):
        self.gain = parameters.get("gain", self.gain)

    def step(self, u, h):
        self.sum, self.calls = self.sum + self.gain * h * u, self.calls + 1
        return np.array([self.sum.sum(), self.calls])

    def save_state(self):
        return {"sum": self.sum, "calls": (self.calls,), "gain": self.gain}

    def restore_state(self, state):
        self.sum, (self.calls,), self.gain = state["sum"], state["calls"], state["gain"]
'''


def test_a_class_whose_state_is_data_goes_on(tmp_path: Path) -> None:
    file, state = tmp_path / "counter.py", tmp_path / "mid.state"
    file.write_text(CLASS, encoding="utf-8")
    inputs = pd.DataFrame({"time": [0.0, 2.0], "u": [0.0, 2.0]})
    how: dict[str, Any] = {"inputs": inputs, "step": 0.1}
    given = {"gain": 3.0, "rest": 0.25}
    whole = simulate(f"{file}:Counter", stop=2, parameters=given, **how)
    simulate(f"{file}:Counter", stop=0.7, parameters=given, save_state=state, **how)
    rest = simulate(f"{file}:Counter", stop=2, load_state=state, **how)
    pd.testing.assert_frame_equal(rest, whole.iloc[7:].reset_index(drop=True), check_exact=True)
    file.write_text(CLASS.replace("self.calls + 1", "self.calls + 2"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"not one of this plant: it is of .*counter.py:Counter"):
        simulate(f"{file}:Counter", stop=2, load_state=state, **how)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("state_is_data = True", "", "its state can be saved as bytes .state_is_data is false"),
        ("can_save_state = True", "", "its state can be saved as bytes .can_save_state is false"),
        ('"calls": (', '"kinds": {1}, "calls": (', "an object of type set is not plain data"),
    ],
)
def test_a_class_that_cannot_is_told_before_it_runs(tmp_path: Path, old: str, new: str, reason: str) -> None:
    file = tmp_path / "counter.py"
    file.write_text(CLASS.replace(old, new), encoding="utf-8")
    with pytest.raises(CosimError, match=reason):
        simulate(f"{file}:Counter", stop=2, save_state=tmp_path / "mid.state")
    assert not (tmp_path / "mid.state").exists()


@pytest.mark.parametrize(
    ("claims", "able", "reason"),
    [
        ([], True, "canGetAndSetFMUstate is false"),
        (["GetAndSet"], True, "canSerializeFMUstate is false"),
        (["GetAndSet", "Serialize"], False, "before the first sample: .*fmi2GetFMUstate"),
    ],
)
def test_an_fmu_that_cannot_is_told_before_it_runs(
    tmp_path: Path, claims: list[str], able: bool, reason: str
) -> None:
    fmu = keeping_fmu(tmp_path, "2.0", "lag", claims, able=able)
    with pytest.raises(CosimError, match=reason):
        simulate(fmu, stop=1, save_state=tmp_path / "mid.state")


# Files that are not what was written


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, PlantState]:
    """An FMU and a state of it, at 1 s."""
    folder = tmp_path_factory.mktemp("saved")
    fmu = keeping_fmu(folder, "2.0", "lag")
    simulate(fmu, parameters={"rate": 2}, stop=1, step=0.1, save_state=folder / "mid.state")
    return fmu, PlantState.read(folder / "mid.state")


def test_a_state_says_what_it_is_of(saved: tuple[Path, PlantState]) -> None:
    fmu, state = saved
    assert (state.plant, state.time, state.parameters) == ("lag2.fmu", 1.0, {"rate": 2.0})
    assert state.content == hashlib.sha256(fmu.read_bytes()).hexdigest()
    assert state.platform == str(fmpy.platform_tuple)


def test_another_fmu_and_another_platform_are_refused(saved: tuple[Path, PlantState], tmp_path: Path) -> None:
    fmu, state = saved
    other = keeping_fmu(
        tmp_path, "2.0", "lag", head='<VendorAnnotations><Tool name="x"/></VendorAnnotations>'
    )
    state.write(tmp_path / "mid.state")
    with pytest.raises(ConfigError, match=f"not one of this plant: it is of lag2.fmu .{state.content}"):
        simulate(other, stop=2, load_state=tmp_path / "mid.state")
    replace(state, platform="riscv64-plan9").write(tmp_path / "far.state")
    with pytest.raises(ConfigError, match="another platform: it was saved on riscv64-plan9, and this is"):
        simulate(fmu, stop=2, load_state=tmp_path / "far.state")


@given(data=st.data())
def test_one_changed_byte_or_one_less_is_seen(data: st.DataObject, saved: tuple[Path, PlantState]) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "mid.state"
        saved[1].write(path)
        content = bytearray(path.read_bytes())
        place = data.draw(st.integers(0, len(content) - 1))
        if data.draw(st.booleans()):
            del content[place:]
        else:
            content[place] ^= data.draw(st.integers(1, 255))
        path.write_bytes(content)
        with pytest.raises(
            ConfigError, match=r"mid.state: is not a state, or is damaged: .*; save the state"
        ):
            PlantState.read(path)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"format": "ddpc-cosim plant state 7"}, 'it is "ddpc-cosim plant state 7", and this version reads'),
        ({"format": None}, "and this version reads"),
        ({"samples": -1}, "is damaged: a state at"),
        ({"samples": 10**400}, "is damaged"),
        ({"sampling_time": "nan"}, "is damaged: a state at nan s"),
        ({"start_time": "inf"}, "is damaged: a state at inf s"),
        ({"samples": "many"}, "is damaged"),
        ({"state": 3}, "is damaged"),
        ({"state": "%"}, "is damaged"),
        ({"parameters": {"rate": [1]}}, "a value of rate that is neither a number nor a text"),
        ({"parameters": [1]}, "is damaged"),
        ({"inputs": {"u": None}}, "is damaged"),
    ],
)
def test_sealed_files_with_other_content_are_refused(
    saved: tuple[Path, PlantState], tmp_path: Path, changed: dict[str, Any], reason: str
) -> None:
    path = tmp_path / "mid.state"
    saved[1].write(path)
    path.write_bytes(sealed_json({**read_sealed(path), **changed}))
    with pytest.raises(ConfigError, match=reason):
        PlantState.read(path)


@pytest.mark.parametrize("key", ["plant", "content", "reset_time", "samples", "changed", "state"])
def test_sealed_files_that_lack_something_are_refused(
    saved: tuple[Path, PlantState], tmp_path: Path, key: str
) -> None:
    path = tmp_path / "mid.state"
    saved[1].write(path)
    content = read_sealed(path)
    del content[key]
    path.write_bytes(sealed_json(content))
    with pytest.raises(ConfigError, match="is damaged"):
        PlantState.read(path)


def test_other_files_are_no_states(saved: tuple[Path, PlantState], tmp_path: Path) -> None:
    (tmp_path / "folder.state").mkdir()
    (tmp_path / "pickle.state").write_bytes(pickle.dumps(saved[1]))
    for path, reason in (
        (saved[0], "is not a state, or is damaged"),
        (tmp_path / "pickle.state", "is not a state, or is damaged"),
        (tmp_path / "folder.state", "cannot be read"),
        (tmp_path / "none.state", "cannot be read: No such file"),
    ):
        with pytest.raises(ConfigError, match=reason):
            PlantState.read(path)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (pickle.dumps([1]), "before the first sample: lag2.fmu: the state is not one of this plant"),
        (b"[]", "before the first sample: lag2.fmu: the state is not one of this plant"),
    ],
)
def test_a_sealed_file_of_something_else_ends_before_the_first_sample(
    saved: tuple[Path, PlantState], tmp_path: Path, content: bytes, reason: str
) -> None:
    replace(saved[1], state=content).write(tmp_path / "mid.state")
    with pytest.raises(CosimError, match=reason):
        simulate(saved[0], stop=2, load_state=tmp_path / "mid.state")


def test_a_file_is_not_written_where_there_is_no_folder(
    saved: tuple[Path, PlantState], tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="cannot be written: No such file"):
        saved[1].write(tmp_path / "nowhere" / "mid.state")
