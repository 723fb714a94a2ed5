"""``ddpc-cosim replay`` and ``replay``: what is read of a log, what is said of it, what is refused."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studies import study_text, write

from ddpc_cosim import ConfigError, DataError, Replay, Study, replay

PLANT = """
import numpy as np
from ddpc_cosim import Controller, Plant, Variable

class Mass(Plant):
    inputs = (Variable("force", "N", min=-2.0, max=2.0),)
    outputs = (Variable("place", "m"),)

    def reset(self, parameters=None, t0=0.0):
        self.x = np.zeros(1)
        return self.x.copy()

    def step(self, u, h):
        self.x = 0.9 * self.x + 0.1 * u
        return self.x.copy()

class Half(Controller):
    def start(self, loop):
        self.last = loop.past.u[-1] if loop.past else np.zeros(1)

    def step(self, sample):
        return self.last + sample.setpoint - sample.y

class Late(Half):
    past_length = 7
"""
HEADS = "time [s],force [N],place [m]"


@pytest.fixture
def study(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(PLANT, encoding="utf-8")
    text = study_text(
        plant={"name": "mine.py:Mass"},
        reference={"place": 1.0},
        controllers={"half": "mine.py:Half", "late": "mine.py:Late"},
    )
    return write(tmp_path, text)


LogOf = Callable[..., Path]


@pytest.fixture
def log(tmp_path: Path) -> LogOf:
    def make(heads: str = HEADS, rows: int = 6, step: float = 0.1, more: str = "") -> Path:
        lines = [f"{round(k * step, 6)},{0.1 * k:.6g},{0.05 * k:.6g}{more}" for k in range(rows)]
        path = tmp_path / "log.csv"
        path.write_text("\n".join([heads, *lines, ""]), encoding="utf-8")
        return path

    return make


def test_each_answer_starts_from_what_was_applied(study: Path, log: LogOf) -> None:
    result = replay(log(), study, "half")
    k = np.arange(1, 6)
    np.testing.assert_allclose(result.trace.time, 0.1 * k)
    np.testing.assert_allclose(result.trace.u[:, 0], 0.1 * (k - 1) + 1.0 - 0.05 * k)
    np.testing.assert_allclose(result.applied[:, 0], 0.1 * k)
    (part,) = result.differences()
    size = np.abs(0.1 * (k - 1) + 1.0 - 0.05 * k - 0.1 * k)
    assert part.median == pytest.approx(float(np.median(size)))
    assert (part.largest, part.time) == (pytest.approx(size.max()), pytest.approx(0.1))
    assert part.range == 4.0
    assert part.log_move == pytest.approx(0.1)
    assert part.same_way == 1.0
    assert "stable" in result.summary()[-1]


def test_references_and_limits_of_the_log_count(study: Path, log: LogOf) -> None:
    path = log(HEADS + ",reference place [cm],max force [N]", more=",300.0,0.7")
    result = replay(path, study, "half")
    np.testing.assert_allclose(result.trace.reference, 3.0)
    np.testing.assert_allclose(result.trace.u, 0.7)
    assert [*result.failures.values()] == [5]
    assert "first beyond its bounds at t = 0.1 s" in result.summary()[1]
    assert result.differences()[0].at_limit == 1.0


def test_a_study_in_python_is_taken_too(study: Path, log: LogOf) -> None:
    assert replay(log(), Study.read(study), "half").trace.completed


def test_columns_are_called_as_one_says(study: Path, log: LogOf) -> None:
    path = log("time,F1,place [m]")
    result = replay(path, study, "half", columns={"force": "F1"}, start=5.0)
    assert result.trace.time[0] == pytest.approx(5.1)


@pytest.mark.parametrize(
    ("heads", "how", "faults"),
    [
        ("time,froce,plaec", {}, ['no column "force"', "--column NAME=HEADER", 'no column "place"']),
        (HEADS, {"columns": {"forze": "force"}}, ['"forze" is not a signal of the study', "force"]),
        (HEADS, {"columns": {"force": "F"}}, ['no column "F"']),
    ],
)
def test_a_log_without_the_signals_is_refused(
    heads: str, how: dict[str, dict[str, str]], faults: list[str], study: Path, log: LogOf
) -> None:
    with pytest.raises((ConfigError, DataError)) as caught:
        replay(log(heads), study, "half", columns=how.get("columns", {}))
    assert all(fault in str(caught.value) for fault in faults)


def test_another_sampling_time_is_refused(study: Path, log: LogOf) -> None:
    with pytest.raises(DataError, match=r"rows are 0\.2 s apart.*needed: the sampling time 0\.1 s"):
        replay(log(step=0.2), study, "half")


def test_a_log_that_is_too_short_for_the_past_is_refused(study: Path, log: LogOf) -> None:
    with pytest.raises(DataError, match="8 rows are too few; needed: 7 as the past of late, and 2 to answer"):
        replay(log(rows=8), study, "late")
    assert len(replay(log(rows=9), study, "late").trace) == 2


def test_an_unknown_controller_is_told_with_what_may_be_meant(study: Path, log: LogOf) -> None:
    with pytest.raises(ConfigError, match=r'no controller "haf"; .*half'):
        replay(log(), study, "haf")


def test_dates_count_from_the_first_sample_of_the_study(study: Path, tmp_path: Path) -> None:
    rows = [f"2026-03-02T08:00:00.{k}00,{k},0" for k in range(4)]
    path = tmp_path / "dated.csv"
    path.write_text("\n".join(["time,force,place", *rows]), encoding="utf-8")
    result = replay(path, study, "half")
    assert result.trace.time[0] == pytest.approx(0.1)
    assert result.notes == ("the log's first row counts as t = 0 s of the study",)


def test_the_command_says_it_and_writes_what_is_asked_for(study: Path, log: LogOf, tmp_path: Path) -> None:
    outs = [tmp_path / f"out{suffix}" for suffix in (".csv", ".html", ".svg", ".json")]
    options = [word for out in outs for word in ("--out", str(out))]
    command = [str(Path(sys.executable).with_name("ddpc-cosim")), "replay", str(log()), str(study)]
    done = subprocess.run(
        [*command, "--controller", "half", *options], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "force: differs from the log by" in done.stdout
    assert "It does not show how well the controller would have controlled" in done.stdout
    table, page, picture, figures = (out.read_text(encoding="utf-8") for out in outs)
    assert "log force [N]" in table.splitlines()[0]
    assert len(table.splitlines()) == 6
    assert "half beside log.csv" in page
    assert "It does not show how well" in page
    assert picture.startswith("<svg")
    assert json.loads(figures)["inputs"]["force"]["unit"] == "N"
    assert json.loads(figures)["answers"] == 5


def test_the_result_is_told_in_rows(study: Path, log: LogOf) -> None:
    result = replay(log(), study, "half")
    assert isinstance(result, Replay)
    frame = result.frame()
    assert {"log force [N]", "force [N]", "place [m]", "status"} <= {*frame.columns}
    assert [row.header for row in result.table().rows] == ["force"]


SURROUNDED = """

class WindyMass(Mass):
    inputs = (*Mass.inputs, Variable("wind", "m/s"))

    def step(self, u, h):
        return super().step(u[:1], h)

class Watching(Controller):
    horizon = 2

    def start(self, loop):
        self.past = loop.past

    def step(self, sample):
        seen = {
            "wind": sample.disturbance[0],
            "wind_before": self.past.d[-1, 0] if self.past else np.nan,
            "wind_ahead": sample.forecast[0, 0],
            "low": sample.band_now[0, 0],
            "high": sample.band_now[0, 1],
            "high_ahead": sample.band[0, 0, 1],
            "price": sample.price[0, 0],
            "price_ahead": sample.price[1, 0],
        }
        return Action(np.zeros(1), info=seen)
"""


@pytest.mark.parametrize("from_log", [True, False])
def test_disturbances_bands_and_prices_are_those_of_the_log_or_else_of_the_study(
    from_log: bool, tmp_path: Path
) -> None:
    code = PLANT.replace("import Controller", "import Action, Controller") + SURROUNDED
    (tmp_path / "mine.py").write_text(code, encoding="utf-8")
    rising = {"kind": "steps", "times": [0.0, 0.25], "values": [1.0, 2.0]}
    study = study_text(
        plant={"name": "mine.py:WindyMass", "inputs": ["force"], "outputs": ["place"]},
        reference={"place": {"band": {"lower": 0.5, "upper": rising}}},
        controllers={"watching": "mine.py:Watching"},
        loop={"preview": 2},
        disturbances={"wind": {"signal": {"kind": "constant", "value": 9.0}, "known": "perfect"}},
        prices={"power": {"signal": "force", "price": rising, "unit": "EUR/N.s"}},
    )
    k = np.arange(6)
    heads = ["time", "force", "place", "wind [km/h]"]
    columns = [0.1 * k, 0.0 * k, 0.0 * k, 3.6 * k]
    if from_log:
        heads += ["lower place [cm]", "upper place", "price power"]
        columns += [10.0 * k, 1.0 + k, 3.0 + k]
    rows = [",".join(f"{value:.6g}" for value in row) for row in zip(*columns, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([",".join(heads), *rows]), encoding="utf-8")
    trace = replay(tmp_path / "log.csv", write(tmp_path, study), "watching").trace
    k = np.arange(1, 6)
    stepped = np.where(k >= 3, 2.0, 1.0)
    expected = {
        "wind": k,
        "wind_before": k - 1,
        "wind_ahead": k + 1,
        "low": 0.1 * k if from_log else 0.5,
        "high": 1.0 + k if from_log else stepped,
        "high_ahead": 2.0 + k if from_log else np.where(k >= 2, 2.0, 1.0),
        "price": 3.0 + k if from_log else stepped,
        "price_ahead": 4.0 + k if from_log else np.where(k >= 2, 2.0, 1.0),
    }
    for name, values in expected.items():
        wanted = np.broadcast_to(values, 5)[:4]  # beyond the log's end its last row holds
        np.testing.assert_allclose(trace.info[name][:4], wanted, err_msg=name)
