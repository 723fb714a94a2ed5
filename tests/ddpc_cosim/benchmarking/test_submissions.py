"""A submission is what its controller does, or is refused by the first thing in it that is not so."""

import csv
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from click.testing import CliRunner, Result

from ddpc_cosim import ConfigError, load_results
from ddpc_cosim.benchmarking.leaderboard import leaderboard
from ddpc_cosim.benchmarking.submission import ENTRY_FILE, SUBMISSION_FILE, seal
from ddpc_cosim.cli.main import main
from ddpc_cosim.loop.trace import Outcome, Trace
from ddpc_cosim.metrics import MetricSettings
from ddpc_cosim.study.case_files import (
    CaseResult,
    read_run,
    read_sealed,
    sealed_json,
    stage_case,
)
from ddpc_cosim.study.results import PROVENANCE_FILE, STUDY_FILE, checksum, write_metrics
from tests.studies import PENDULUM, study_text, write

pytestmark = pytest.mark.xdist_group("submissions")

MINE = """
from dataclasses import dataclass

import numpy as np

from ddpc_cosim import Controller, Log, Loop, Sample, setting


@dataclass(kw_only=True)
class MyGain(Controller):
    \"\"\"A gain.\"\"\"

    gain: float = setting(1.0, low=0.0, doc="torque by angle", search=Log(0.1, 10.0))

    def start(self, loop: Loop) -> None:
        self._bounds = loop.bounds

    def step(self, sample: Sample) -> np.ndarray:
        return np.clip(self.gain * (sample.setpoint - sample.y), self._bounds.u_min, self._bounds.u_max)
"""
HELD = {
    "settings": ["proportional"],
    "trials": 2,
    "seeds": ["100:101"],
    "by": "mean absolute error",
    "source": "a",
}
BASE = {
    "name": "small",
    "seeds": ["0:2"],
    "scenarios": {"nominal": {}, "noise": {"noise": {"angle": 0.01}}},
    "bounds": {"torque": {"min": -3.0, "max": 3.0}},
    "recording": {"samples": 20, "excitation": {"torque": {"low": -1.0, "high": 1.0}}},
    "report": {"reference_points": {"zero": "idle", "full": "known"}},
}
CONTROLLERS = {
    "idle": "idle",
    "known": {"type": "pid", "settings": {"proportional": 3.0, "integral": 1.0}},
    "pid": {"type": "pid", "settings": {"proportional": 2.0, "integral": 1.0}, "tuned": HELD},
}


def benchmark(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["benchmark", *map(str, words)])


@pytest.fixture(scope="module")
def entered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A submission to a small benchmark, which stands beside it."""
    folder = tmp_path_factory.mktemp("entered")
    loop = {"duration": 2.0}
    reference = {"angle": {"kind": "steps", "times": [0.0, 0.5], "values": [0.0, 0.2]}}
    write(folder, study_text(PENDULUM, reference, CONTROLLERS, loop, **BASE), "small.toml")
    write(folder, MINE, "mine.py")
    words = ("--study", folder / "small.toml", "--out", folder / "entry", "--jobs", "1", "--no-report")
    done = benchmark("enter", f"{folder / 'mine.py'}:MyGain", *words)
    assert done.exit_code == 0, done.output
    return folder / "entry"


def test_each_problem_is_tuned_by_what_it_is_judged_by(tmp_path: Path) -> None:
    """Where there is a price and a band by money, elsewhere by the error; all is in one submission."""
    study = tomllib.loads(study_text(controllers=CONTROLLERS, loop={"duration": 2.0}, **BASE))
    shared = {key: study.pop(key) for key in ("plant", "loop", "bounds", "recording", "scenarios")}
    followed = {"reference": {"angle": {"kind": "steps", "times": [0.0, 0.5], "values": [0.0, 0.2]}}}
    paid = {
        "reference": {"angle": {"band": {"lower": -0.1, "upper": 0.3}}},
        "prices": {"work": {"signal": "torque", "price": 1.0, "unit": "EUR/N.m.s"}},
    }
    del study["reference"]
    study["problems"] = {"followed": shared | followed, "paid": shared | paid}
    write(tmp_path, tomli_w.dumps(study), "two.toml")
    write(tmp_path, MINE, "mine.py")
    words = ("--study", tmp_path / "two.toml", "--out", tmp_path / "entry", "--jobs", "1", "--no-report")
    done = benchmark("enter", f"{tmp_path / 'mine.py'}:MyGain", *words)
    assert done.exit_code in {0, 3}, done.output
    problems = load_results(tmp_path / "entry" / "results").whole.problems
    by = {name: problem.controllers["my-gain"].tuned for name, problem in problems.items()}
    assert {name: how.by.split(",")[0] for name, how in by.items() if how} == {
        "followed": "mean_abs_error",
        "paid": "money",
    }
    with (tmp_path / "entry" / "trials.csv").open(encoding="utf-8", newline="") as file:
        trials = [*csv.DictReader(file)]
    assert [row["problem"] for row in trials] == ["followed"] * 2 + ["paid"] * 2
    for metric, problem in (("mean_abs_error", "followed"), ("money", "paid"), ("band_violation", "paid")):
        columns = [name for name in trials[0] if name.startswith(metric)]
        assert columns
        assert all((row[name] != "") == (row["problem"] == problem) for row in trials for name in columns)


@pytest.fixture
def submission(entered: Path, tmp_path: Path) -> Path:
    """A copy, which a test may falsify."""
    return Path(shutil.copytree(entered, tmp_path / "entry"))


def verify(folder: Path, entered: Path, *words: str) -> Result:
    base = entered.parent / "small.toml"
    return benchmark(
        "verify", folder, "--study", base, "--seed", "0", "--jobs", "1", *(words or ("--share", "0"))
    )


def test_it_is_tuned_with_the_budget_of_the_benchmark_and_accepted_elsewhere(
    submission: Path, entered: Path
) -> None:
    trials = (submission / "trials.csv").read_text(encoding="utf-8").splitlines()
    assert len(trials) == 1 + HELD["trials"]
    tuned = load_results(submission / "results").whole.problems["small-my-gain"].controllers["my-gain"].tuned
    assert tuned is not None
    assert (tuned.trials, tuned.seeds) == (2, [100])
    done = verify(submission, entered)
    assert done.exit_code == 0, done.output
    # Of three controllers in two scenarios with two seeds, and of doing nothing: the latter all again.
    assert "of 16 runs" in done.output
    assert "7 were run again (--seed 0)" in done.output


def cases(folder: Path, controller: str = "my-gain", scenario: str = "noise") -> list[CaseResult]:
    every = load_results(folder / "results").cases
    return [case for case in every if (case.controller, case.scenario) == (controller, scenario)]


def sealed_again(folder: Path, **changes: Any) -> None:
    """Make all that is computed from the rest what it would be, as whoever falsifies with care would."""
    results = folder / "results"
    content = (results / STUDY_FILE).read_bytes()
    provenance = read_sealed(results / PROVENANCE_FILE) | {"study sha256": checksum(content)} | changes
    (results / PROVENANCE_FILE).write_bytes(sealed_json(provenance))
    write_metrics(load_results(results))
    seal(folder)


def rewritten(case: CaseResult, trace: Trace, **said: Any) -> None:
    """Write a case's files anew from other samples, figures and checksums computed from them."""
    run = read_run(case.folder)
    settings = MetricSettings(case.trace().preview)
    assert asdict(settings) == run["metric_settings"]
    shutil.rmtree(case.folder)
    head = {key: run[key] for key in ("id", "problem", "controller", "label", "scenario", "seed", "storage")}
    stage_case(case.folder, trace, head | said, settings)


def edit_run(case: CaseResult, change: Callable[[dict[str, Any]], None]) -> None:
    run = read_sealed(case.folder / "run.json")
    change(run)
    (case.folder / "run.json").write_bytes(sealed_json(run))


def set_in(*place: Any, value: Any) -> Callable[[Path], None]:
    """Return what sets a value in the ``run.json`` of a case, and makes the rest fit."""

    def forge(folder: Path) -> None:
        def change(run: dict[str, Any]) -> None:
            for key in place[:-1]:
                run = run[key]
            assert run[place[-1]] != value
            run[place[-1]] = value

        edit_run(cases(folder)[0], change)
        sealed_again(folder)

    return forge


def with_samples(change: Callable[[Trace], Trace]) -> Callable[[Path], None]:
    """Return what changes the samples of a case, and makes the rest fit."""

    def forge(folder: Path) -> None:
        case = cases(folder)[0]
        rewritten(case, change(case.trace()))
        sealed_again(folder)

    return forge


def nudged(name: str) -> Callable[[Trace], Trace]:
    def change(trace: Trace) -> Trace:
        values = getattr(trace, name).copy()
        values[7] += 1e-3
        return replace(trace, **{name: values})

    return change


def in_study(old: str, new: str) -> Callable[[Path], None]:
    def forge(folder: Path) -> None:
        path = folder / "results" / STUDY_FILE
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        sealed_again(folder)

    return forge


def in_file(name: str, old: str, new: str, *, fits: bool = True) -> Callable[[Path], None]:
    def forge(folder: Path) -> None:
        path = next(folder.glob(name))
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        if fits:
            seal(folder)

    return forge


def best_of(folder: Path) -> None:
    """Leave out a run."""
    case = cases(folder)[1]
    kept = [id for id in read_sealed(folder / "results" / PROVENANCE_FILE)["cases"] if id != case.id]
    shutil.rmtree(case.folder)
    sealed_again(folder, cases=kept)


def one_seed_for_another(folder: Path) -> None:
    first, second = cases(folder)
    rewritten(second, first.trace(), seed=second.seed, id=second.id)
    sealed_again(folder)


def another_scenario(folder: Path) -> None:
    easy, hard = cases(folder, scenario="nominal")[0], cases(folder)[0]
    rewritten(hard, easy.trace())
    sealed_again(folder)


def another_controller(folder: Path) -> None:
    """Say that what the reference point did was done by what is entered, in the run that is run again."""
    for case, known in zip(cases(folder), cases(folder, "known"), strict=True):
        rewritten(case, replace(known.trace(), settings=case.trace().settings))
    sealed_again(folder)


def labels_swapped(folder: Path) -> None:
    for case, other in zip(cases(folder), cases(folder, "known"), strict=True):
        mine, theirs = case.trace(), other.trace()
        rewritten(case, theirs)
        rewritten(other, mine)
    sealed_again(folder)


def worse_reference(folder: Path) -> None:
    case = cases(folder, "idle")[0]
    rewritten(case, nudged("y")(case.trace()))
    sealed_again(folder)


def worse_nothing(folder: Path) -> None:
    case = load_results(folder / "results").resting[0]
    rewritten(case, nudged("y")(case.trace()))
    sealed_again(folder)


def further_run(folder: Path) -> None:
    case = cases(folder)[0]
    there = read_sealed(folder / "results" / PROVENANCE_FILE)["cases"]
    twin = Path(shutil.copytree(case.folder, case.folder.with_name("my-gain_noise_seed9_0123456789")))
    edit_run(replace(case, folder=twin), lambda run: run.update(id=twin.name, seed=9))
    sealed_again(folder, cases=[*there, twin.name])


def shorter(trace: Trace) -> Trace:
    cut = {
        name: getattr(trace, name)[:12]
        for name in ("time", "reference", "y", "measured", "u", "status", "solve_time")
    }
    return replace(trace, **cut, applied=trace.applied[:12], planned_samples=12)


def completed_run_called_diverged(trace: Trace) -> Trace:
    return replace(trace, outcome=Outcome.DIVERGED, reason="it grew")


FORGERIES: dict[str, tuple[Callable[[Path], None], str]] = {
    "a figure in the table": (in_file("results/metrics.csv", "completed", "diverged"), "outcome of"),
    "a figure in the table, not sealed": (
        in_file("results/metrics.csv", "completed", "diverged", fits=False),
        "its checksum is",
    ),
    "a figure of a run": (set_in("metrics", "rmse.angle [deg]", value=0.1), "metrics.rmse"),
    "a figure that is left out": (lambda folder: _without_figure(folder), "not there"),
    "what a run is judged by": (set_in("tracking", 0, "mean_abs_error", value=0.0), "tracking[0]"),
    "where it ends": (set_in("tracking", 0, "ends", 0, "error", value=0.0), "tracking[0].ends"),
    "how figures are computed": (set_in("metric_settings", "preview", value=5), "metric_settings.preview"),
    "its scenario": (set_in("scenario", value="nominal"), "of the same run as"),
    "its seed": (set_in("seed", value=1), "of the same run as"),
    "its controller": (set_in("controller", value="known"), "of the same run as"),
    "its limits": (set_in("bounds", "u_max", value=[9.0]), "bounds.u_max"),
    "its preview": (set_in("preview", value=40), "preview is"),
    "its outcome": (set_in("outcome", value="timed-out"), "tracking[0]"),
    "how many samples were planned": (set_in("planned_samples", value=5), "planned_samples"),
    "a sample of an output": (with_samples(nudged("y")), "angle [rad] at t = 0.7 s"),
    "a sample of an input": (with_samples(nudged("u")), "under the inputs recorded"),
    "what was measured": (with_samples(nudged("measured")), "measured angle [rad] at t = 0.7 s"),
    "what was wanted": (with_samples(nudged("reference")), "reference angle [rad] at t = 0.7 s"),
    "the time": (with_samples(nudged("time")), "time [s] at t = 0.7"),
    "a run that is cut off": (with_samples(shorter), "12"),
    "a run that did not complete": (with_samples(completed_run_called_diverged), "diverged"),
    "the plant": (in_study('name = "pendulum"\n', 'name = "servo"\n'), "plant.name is servo"),
    "seeds": (in_study("seeds = [\n    0,\n    1,\n]", "seeds = [\n    0,\n]"), "seeds is [0]"),
    "noise": (in_study("angle = 0.01", "angle = 0.001"), "noise.noise.angle is 0.001"),
    "limits of the study": (in_study("max = 3.0", "max = 4.0"), "bounds.torque.max is 4.0"),
    "the duration": (in_study("duration = 2.0", "duration = 1.0"), "loop.duration is 1.0"),
    "settings of a reference point": (in_study("proportional = 3.0", "proportional = 0.1"), "proportional"),
    "a run that is left out": (best_of, "no run my-gain_noise_seed1"),
    "a run that nobody asked for": (further_run, "asks for no such run"),
    "the samples of another seed": (one_seed_for_another, "measured angle"),
    "the samples of an easier scenario": (another_scenario, "measured angle"),
    "the samples of a reference point": (another_controller, "run again"),
    "two controllers under each other's name": (labels_swapped, "run again"),
    "a worse reference point": (worse_reference, "angle [rad] at t = 0.7 s"),
    "a worse run of doing nothing": (worse_nothing, "run again"),
    "the plug-in": (in_file("mine.py", "self.gain *", "1.5 * self.gain *"), "run again"),
    "the plug-in, not sealed": (in_file("mine.py", "gain", "Gain", fits=False), "mine.py: its checksum is"),
    "settings": (in_file(ENTRY_FILE, "gain = ", "gain = 2"), "my-gain.settings.gain"),
    "limits of its own": (
        in_file(ENTRY_FILE, "[controller]", "[controller.bounds.torque]\nmax = 9.0\n[controller]"),
        "controller.bounds: not a method's to choose",
    ),
    "a file that is gone": (lambda folder: (folder / "trials.csv").unlink(), "trials.csv: missing"),
    "a file that is not sealed": (lambda folder: write(folder, "", "more.py") and None, "does not name it"),
}


def _without_figure(folder: Path) -> None:
    edit_run(cases(folder)[0], lambda run: run["metrics"].pop("rmse.angle [deg]"))
    sealed_again(folder)


@pytest.mark.slow
@pytest.mark.parametrize("what", FORGERIES)
def test_a_falsification_is_refused_with_what_is_not_so(what: str, submission: Path, entered: Path) -> None:
    forge, words = FORGERIES[what]
    forge(submission)
    done = verify(submission, entered, *(("--share", "1") if words == "run again" else ()))
    assert done.exit_code in (1, 2), done.output
    assert words in done.output
    assert "refused: " in done.output or "error: " in done.output


def test_a_folder_that_is_no_submission_is_said_to_be_none(
    tmp_path: Path, submission: Path, entered: Path
) -> None:
    done = verify(tmp_path, entered)
    assert (done.exit_code, f"{SUBMISSION_FILE} is missing" in done.output) == (2, True)
    (submission / SUBMISSION_FILE).write_text("{}", encoding="utf-8")
    done = verify(submission, entered)
    assert (done.exit_code, "damaged" in done.output) == (2, True)


def test_the_leaderboard_has_all_submissions_as_controllers_of_one_study(
    entered: Path, tmp_path: Path
) -> None:
    base = entered.parent / "small.toml"
    words = ("--study", base, "--out", tmp_path / "known", "--jobs", "1", "--no-report")
    assert benchmark("enter", "pid", *words).exit_code == 0
    board = leaderboard([entered, tmp_path / "known"])
    assert [*board.study.controllers] == ["idle", "known", "my-gain", "pid"]
    assert len(board.cases) == 4 * 2 * 2
    alone = load_results(entered / "results")
    theirs, mine = (
        {case.id: repr(case.metrics) for case in results.cases if case.controller == "my-gain"}
        for results in (board, alone)
    )
    assert theirs == mine
    assert {*board.shares("mean_abs_error").controller} == {"my-gain", "pid"}
    done = benchmark("page", entered, tmp_path / "known", "--out", tmp_path / "board.html")
    assert done.exit_code == 0, done.output
    text = (tmp_path / "board.html").read_text(encoding="utf-8")
    assert "Leaderboard: small" in text
    assert "MyGain" in text


def test_submissions_to_two_benchmarks_have_no_leaderboard(submission: Path, entered: Path) -> None:
    in_study("max = 3.0", "max = 4.0")(submission)
    with pytest.raises(ConfigError, match=r"not of the benchmark of .*: bounds\.torque\.max"):
        leaderboard([entered, submission])


def test_what_has_nothing_to_tune_is_entered_as_it_is(entered: Path, tmp_path: Path) -> None:
    path = write(tmp_path, MINE.replace(", search=Log(0.1, 10.0)", ""), "plain.py")
    base = ("--study", entered.parent / "small.toml", "--jobs", "1", "--no-report")
    done = benchmark("enter", f"{path}:MyGain", *base, "--out", tmp_path / "entry")
    assert done.exit_code == 0, done.output
    assert not (tmp_path / "entry" / "trials.csv").exists()
    # The folder is this submission's: another one does not mix its runs with those.
    done = benchmark("enter", "pid", *base, "--out", tmp_path / "entry")
    assert done.exit_code == 2
    assert "entry is another submission, of my-gain on" in done.output


def test_what_cannot_be_entered_is_told(entered: Path, tmp_path: Path) -> None:
    base = ("--study", entered.parent / "small.toml", "--out", tmp_path / "entry")
    for target, words in (
        ("nowhere.py:Mine", "nowhere.py: No such file"),
        ("mine.py:not a class", "needed: FILE.py:CLASS"),
        ("idle", "is a reference point of small.toml"),
        ("pdi", 'did you mean "pid"'),
    ):
        done = benchmark("enter", target, *base)
        assert done.exit_code == 2, done.output
        assert words in done.output
        assert not (tmp_path / "entry").exists()
    done = benchmark("enter", "pid", "--problem", "x", *base)
    assert "--problem x: small.toml has no such one; it has one alone" in done.output
