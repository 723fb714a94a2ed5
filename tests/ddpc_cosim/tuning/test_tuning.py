"""Tuning: a plant that follows its input, and a controller that commands gain x reference: 1 is best."""

import csv
import io
import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from studies import study_text, write

from ddpc_cosim import Choice, ConfigError, Factor, Integer, Linear, Log
from ddpc_cosim.cli.main import main
from ddpc_cosim.cli.progress import LineProgress
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.processes.worker import Worker
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.file_format.sections import ControllerSection
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection, run_missing
from ddpc_cosim.tuning import Request, Tuned, tune_study
from ddpc_cosim.tuning.objectives import Objective, Run
from ddpc_cosim.tuning.search import Figures, SettingsSearch, Trial, best, search_spaces

TOYS = """
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller, Linear, Plant, Variable, check_settings, setting

@dataclass(kw_only=True)
class Gain(Controller):
    gain: float = setting(3.0, low=0.0, high=10.0, doc="u = gain x reference", search=Linear(0.0, 4.0))
    rough: bool = setting(False, doc="changes nothing")
    def __post_init__(self):
        check_settings(self)
    def start(self, loop):
        self.errors = {"prediction_error": abs(self.gain - 2.0)}
    def diagnostics(self):
        return self.errors
    def step(self, sample):
        return self.gain * sample.setpoint

@dataclass(kw_only=True)
class Rest(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        return np.zeros(1)

class Follower(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        return np.zeros(1)
    def step(self, u, h):
        return u.copy()

class Half(Follower):
    def step(self, u, h):
        return 0.5 * u
"""
STUDY = """
seeds = [0]
plant = { name = "tuning_toys:Follower" }
loop = { sampling_time = 0.1, duration = 1.0 }
reference.y = { kind = "constant", value = 1.0 }
controllers.a = { type = "tuning_toys:Gain" }
controllers.rest = { type = "tuning_toys:Rest" }
[controllers.b]
type = "tuning_toys:Gain"
settings = { gain = 2.0 }
search = { gain = { factor = [0.1, 4.0] } }
"""
DEFAULT = Request(trials=8)


def tuned(folder: Path, text: str = STUDY, request: Request = DEFAULT, jobs: int = 2) -> Tuned:
    folder.mkdir(exist_ok=True)
    (folder / "tuning_toys.py").write_text(TOYS, encoding="utf-8")
    resolved = read_study(str(write(folder, text)))
    return tune_study(resolved, folder / "out", request, Selection(jobs), LineProgress(io.StringIO()))


def trials_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "out" / "trials.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_every_controller_has_as_many_trials_and_the_best_settings_are_in_the_tuned_study(
    tmp_path: Path,
) -> None:

    def rmse_of(gain: float) -> float:
        """At the first of the ten samples that count y = 0, and then the error is 1 - gain."""
        return float(np.sqrt((1.0 + 9 * (1.0 - gain) ** 2) / 10))

    tuning = tuned(tmp_path)
    assert tuning.kept == [("study", "rest")]
    rows = trials_of(tmp_path)
    assert [row["controller"] for row in rows] == ["a"] * 8 + ["b"] * 8
    for row in rows:
        rmse = rmse_of(json.loads(row["settings"])["gain"])
        figure = row["rmse, median over the seeds, mean over the scenarios"]
        assert row["pruned"] == "true" if not figure else float(figure) == pytest.approx(rmse, rel=1e-9)
        assert int(row["runs"]) < 3 if row["pruned"] == "true" else row["runs"] == "3"
    assert {row["pruned"] for row in rows} == {"true", "false"}
    study = read_study(str(tmp_path / "out" / "tuned.toml")).problem.study
    assert study.seeds == [0]
    for name, given in (("a", 3.0), ("b", 2.0)):
        gains = [json.loads(row["settings"])["gain"] for row in rows if row["controller"] == name]
        assert gains[0] == given
        closest = min(gains, key=lambda gain: abs(gain - 1.0))
        section = study.controllers[name]
        assert section.settings["gain"] == closest != given
        held_out = tuning.held_out["study", name]
        assert [trial.values[0] for trial in held_out] == pytest.approx([rmse_of(given), rmse_of(closest)])
        assert [trial.runs for trial in held_out] == [1, 1]
        how = section.tuned
        assert how is not None
        assert (how.settings, how.trials, how.seeds) == (["gain"], 8, [10_000, 10_001, 10_002])
    assert study.controllers["rest"].tuned is None
    compared = {case.controller: case for case in tuning.results.cases}
    assert list(compared) == ["a-as-given", "a", "rest", "b-as-given", "b"]
    assert {case.seed for case in tuning.results.cases} == {0}
    assert compared["a-as-given"].settings["gain"] == 3.0
    assert compared["a"].settings == study.controllers["a"].settings


def test_an_interrupted_tuning_goes_on_to_the_same_end_on_any_number_of_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = Request(trials=11, seeds=[5])
    tuned(tmp_path / "whole", request=request, jobs=2)
    rounds = 0

    def ends(*arguments: object, **how: object) -> None:
        nonlocal rounds
        rounds += 1
        if rounds > 7:
            raise KeyboardInterrupt
        run_missing(*arguments, **how)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr("ddpc_cosim.tuning.run_missing", ends)
        with pytest.raises(KeyboardInterrupt):
            tuned(tmp_path / "parts", request=request, jobs=1)
    there = {path: path.stat().st_mtime_ns for path in (tmp_path / "parts").glob("out/cases/*/run.json")}
    assert len(there) >= 7
    tuned(tmp_path / "parts", request=request, jobs=1)
    assert all(path.stat().st_mtime_ns == then for path, then in there.items())  # none is run again
    for file in ("trials.csv", "tuned.toml"):
        assert (tmp_path / "parts/out" / file).read_bytes() == (
            tmp_path / "whole/out" / file
        ).read_bytes().replace(bytes(tmp_path / "whole"), bytes(tmp_path / "parts"))


def test_each_problem_is_tuned_for_itself(tmp_path: Path) -> None:
    """Where the plant follows half the input, a gain of 2 is best."""
    write(tmp_path, STUDY, "full.toml")
    write(tmp_path, STUDY.replace(":Follower", ":Half"), "half.toml")
    several = """
problems = { full = { study = "full.toml" }, half = { study = "half.toml" } }
controllers.a = { type = "tuning_toys:Gain" }
controllers.rest = { type = "tuning_toys:Rest" }
"""
    tuning = tuned(tmp_path, several, Request(trials=6, seeds=[4]))
    assert {key: len(trials) for key, trials in tuning.trials.items()} == {("full", "a"): 6, ("half", "a"): 6}
    again = read_study(str(tmp_path / "out" / "tuned.toml"))
    for problem, ideal in (("full", 1.0), ("half", 2.0)):
        gains = [trial.settings["gain"] for trial in tuning.trials[problem, "a"]]
        section = again.problems[problem].study.controllers["a"]
        assert section.settings["gain"] == min(gains, key=lambda gain: abs(gain - ideal))
        assert section.tuned is not None
        assert section.tuned.trials == 6


def test_only_what_is_selected_is_tuned_and_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tuning_toys.py").write_text(TOYS, encoding="utf-8")
    write(tmp_path, STUDY)
    monkeypatch.chdir(tmp_path)
    said = ["tune", "study.toml", "--trials", "2", "--jobs", "2", "--no-report"]
    said += ["--only", "b", "--only", "b*"]
    done = CliRunner().invoke(main, said)
    assert done.exit_code == 0, done.output
    table = Path("runs/study-tuning/trials.csv").read_text(encoding="utf-8")
    assert {row["controller"] for row in csv.DictReader(io.StringIO(table))} == {"b"}
    study = read_study("runs/study-tuning/tuned.toml").problem.study
    assert [name for name, section in study.controllers.items() if section.tuned] == ["b"]
    how = study.controllers["b"].tuned
    assert how is not None
    assert how.source.endswith(" --only b --only 'b*'")
    assert study.summary.startswith("Tuned with 2 trials each on the seeds 10000, 10001, 10002, by rmse")
    assert study.summary.endswith(": b.")
    compared = read_study("runs/study-tuning/held-out/study.toml").problem.study.controllers
    assert set(compared) == {"b-as-given", "b"}
    nothing = CliRunner().invoke(main, ["tune", "study.toml", "--only", "c", "--out", "other"])
    assert nothing.exit_code == 2
    assert "--only c: no case matches" in nothing.stderr


def test_trials_in_compiled_loops_find_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path, study_text())
    tables, engines = [], []
    for engine in ("python", "compiled"):
        said = ["tune", "study.toml", "--trials", "4", "--no-comparison", "--engine", engine, "--out", engine]
        done = CliRunner().invoke(main, said)
        assert done.exit_code == 0, done.output
        table = Path(engine, "trials.csv").read_text(encoding="utf-8")
        tables.append(list(csv.DictReader(io.StringIO(table))))
        runs = [json.loads(path.read_text()) for path in Path(engine).glob("cases/*_mfapc_*/run.json")]
        engines.append({run.get("engine", "python") for run in runs})
    assert engines == [{"python"}, {"compiled"}]
    assert len(tables[0]) == 4
    figure = str(Objective.parse("rmse"))
    for trial, same in zip(*tables, strict=True):
        assert float(trial.pop(figure)) == pytest.approx(float(same.pop(figure)), rel=1e-9)
        assert trial == same


def test_a_worker_of_compiled_loops_goes_on_from_trial_to_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    class Counted(Worker):
        def __init__(self, *arguments: Any, **how: Any) -> None:
            made.append(self)
            super().__init__(*arguments, **how)

    monkeypatch.setattr("ddpc_cosim.study.runner.Worker", Counted)
    study = read_study(str(write(tmp_path, study_text())))
    request = Request(trials=5, seeds=[4, 5], compares=False)
    selection = Selection(1, engine="compiled")
    tuning = tune_study(study, tmp_path / "out", request, selection, LineProgress(io.StringIO()))
    ((_, trials),) = tuning.trials.items()
    assert sum(trial.runs for trial in trials) >= 6
    assert len(made) == 2  # of the runs at rest, and of all trials


def test_the_prediction_alone_can_be_searched_without_a_loop(tmp_path: Path) -> None:
    """Only what is declared to change the prediction is searched: the toy says that gain = 2 is best."""
    with pytest.raises(
        ConfigError, match="no controller has settings to search that the prediction depends on"
    ):
        tuned(tmp_path, request=Request((Objective.parse("prediction"),), trials=2))
    shutil.rmtree(tmp_path)
    tmp_path.mkdir()
    text = STUDY.replace("tuning_toys", "predicting_toys")
    (tmp_path / "predicting_toys.py").write_text(
        TOYS.replace("4.0))", "4.0), predicts=True)"), encoding="utf-8"
    )
    tuning = tuned(tmp_path, text, Request((Objective.parse("prediction"),), trials=4, seeds=[7]))
    for tried in tuning.trials.values():
        assert [trial.values[0] for trial in tried] == [abs(trial.settings["gain"] - 2.0) for trial in tried]
    assert best(tuning.trials["study", "b"]) == 0  # as given
    lengths = {
        case.name: len(case.read_text().splitlines()) for case in tmp_path.glob("out/cases/*/signals.csv")
    }
    assert set(lengths.values()) == {3}  # header and two samples


@pytest.mark.parametrize(("regulariser", "weights"), [("ridge", {"lambda_sigma"}), ("projection", set())])
def test_a_weight_is_searched_by_the_prediction_that_depends_on_it(
    regulariser: str, weights: set[str]
) -> None:
    settings = {"regulariser": regulariser, "slack": True, "initial_length": 3, "lambda_sigma": 1e7}
    section = ControllerSection(type="deepc", settings=settings)
    assert {name for name, _ in search_spaces(section, by_prediction=True)} == {"initial_length"} | weights


def test_the_command_says_what_was_found_and_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tuning_toys.py").write_text(TOYS, encoding="utf-8")
    write(tmp_path, STUDY)
    monkeypatch.chdir(tmp_path)
    run = partial(CliRunner().invoke, main)
    done = run(["tune", "study.toml", "--trials", "2", "--jobs", "2", "--seeds", "7", "--out", "out"])
    assert done.exit_code == 0, done.output
    assert "a: gain = " in done.stdout
    assert "rest: nothing to search, left as it is" in done.stdout
    assert (tmp_path / "out" / "held-out" / "report.html").is_file()
    how = read_study("out/tuned.toml").problem.study.controllers["a"].tuned
    assert how is not None
    assert how.source == "ddpc-cosim tune study.toml --trials 2 --objective rmse --seeds 7"
    assert run(["tune", "study.toml", "--trials", "0"]).exit_code == 2
    monkeypatch.setattr("ddpc_cosim.cli.commands.tune.find_spec", lambda name: None)
    lacking = run(["tune", "study.toml"])
    assert lacking.exit_code == 2
    assert 'tune needs Optuna: `pip install ".[tune]"` or `uv sync --extra tune`' in lacking.stderr


def result(scenario: str, seed: int, rmse: float, outcome: Outcome = Outcome.COMPLETED) -> CaseResult:
    metrics = {"rmse.y [1]": rmse, "rmse.z [K]": 3 * rmse}
    return CaseResult("", "a", "", scenario, seed, outcome, "", True, metrics, {}, {}, (), Path())


def test_runs_are_summed_up_over_seeds_and_scenarios() -> None:
    """Shares of the spans 2 and 3 are 0.5 r and r, whose mean is 0.75 r."""
    runs = [result("quiet", seed, r) for seed, r in enumerate((1.0, 2.0, 6.0))]
    runs += [result("loud", seed, r) for seed, r in enumerate((4.0, 5.0, 12.0))]
    spans = {"y": 2.0, "z": 3.0}
    expected = {"rmse": 3.5, "rmse:mean": 5.0, "rmse:worst": 12.0, "rmse:0.9": 9.0, "rmse:0": 2.5}

    def of(text: str, results: list[CaseResult]) -> float:
        objective = Objective.parse(text)
        return objective.of({Run(run.scenario, run.seed): objective.of_run(run, spans) for run in results})

    for text, r in expected.items():
        assert of(text, runs) == pytest.approx(0.75 * r), text
    assert of("rmse.z:mean", runs) == pytest.approx(15.0)
    broken = [*runs[:-1], result("loud", 2, 0.1, Outcome.DIVERGED)]
    assert of("rmse:worst", broken) == np.inf
    assert of("rmse", broken) == pytest.approx(0.75 * 3.5)


def test_whatever_loses_fewer_runs_is_better() -> None:
    values = [Trial(0, (1e9,), {}), Trial(0, (np.inf,), {}), Trial(1, (-1e9,), {}), Trial(2, (0.0,), {})]
    penalised = [trial.penalised[0] for trial in values]
    assert penalised == sorted(penalised)
    assert len(set(penalised)) == 4
    assert best(values[::-1]) == 3


def test_of_trials_that_differ_by_nothing_that_matters_the_first_is_chosen() -> None:
    values = [2.0, 1.0099, 1.0, 1.005]
    assert best([Trial(0, (value,), {}) for value in values]) == 1
    assert best([Trial(number == 1, (value,), {}) for number, value in enumerate(values)]) == 2
    assert best([Trial(0, (value,), {}) for value in (-0.98, -0.995, -1.0)]) == 1
    assert best([Trial(0, (np.inf,), {}), Trial(0, (np.inf,), {})]) == 0


def search_of(runs: list[list[float]], failing: frozenset[int] = frozenset()) -> SettingsSearch:
    """Return a search after trials with these values in three runs; in the first some lose the reference."""
    search = SettingsSearch(
        "p", "c", {"gain": 1.0}, {"gain": Linear(0.0, 4.0)}, (Objective.parse("rmse:mean"),)
    )
    for number, values in enumerate(runs):
        figures = [Figures(not seed and number in failing, (value,)) for seed, value in enumerate(values)]
        search.tell(
            search.next_settings(), {Run("quiet", seed): figure for seed, figure in enumerate(figures)}
        )
    return search


def begun(*values: float, failed: bool = False) -> dict[Run, Figures]:
    return {Run("quiet", seed): Figures(failed, (value,)) for seed, value in enumerate(values)}


def test_numbers_are_tried_with_four_digits_within_their_ends() -> None:
    spaces = {"a": Linear(0.123456, 0.123457), "b": Log(1e-3, 1e3), "c": Factor(0.1, 10.0)}
    given = {"a": 0.123456, "b": 1.0, "c": [3.0, 0.1]}
    search = SettingsSearch("p", "c", given, spaces, (Objective(),))
    for _ in range(4):
        settings = search.next_settings()
        search.tell(settings, begun(1.0))
        assert 0.123456 <= settings["a"] <= 0.123457
        assert all(float(f"{value:.4g}") == value for value in (settings["b"], *settings["c"]))


def test_a_trial_ends_when_it_would_not_be_the_best_even_if_the_rest_were_a_tenth_better_than_ever() -> None:
    """The best sum is 9; the best second and third run are 2 and 3, a tenth less is 1.8 and 2.7."""
    runs = [[3.0, 3.0, 3.0], [4.0, 2.0, 4.0], [4.0, 4.0, 3.0], [9.0, 9.0, 9.0], [np.inf, 9.0, 9.0]]
    search = search_of(runs)
    assert not search.is_hopeless(begun(4.49))
    assert search.is_hopeless(begun(4.51))
    assert not search.is_hopeless(begun(3.0, 3.29))
    assert search.is_hopeless(begun(3.0, 3.31))
    assert not search_of(runs[:4]).is_hopeless(begun(4.51))  # so few say little of what is possible
    search.tell(search.next_settings(), begun(4.51), pruned=True)
    assert best(search.trials) == 0
    assert (search.trials[-1].runs, search.trials[-1].pruned) == (1, True)


def nearest(number: int, *, pruning: bool) -> float:
    """Return how near 47 trials come, in decades, to a valley beside which the first trial lies."""
    valley = 10 ** np.random.default_rng(number).uniform(-3, 3, 4)
    given = {f"gain{i}": float(1.2 * at) for i, at in enumerate(valley)}
    spaces = dict.fromkeys(given, Log(1e-5, 1e5))
    search = SettingsSearch("p", f"c{number}", given, spaces, (Objective.parse("rmse:mean"),))
    distances = []
    for _ in range(48):
        settings = search.next_settings()
        tried = np.array([settings[name] for name in given])
        distances.append(float(np.sqrt(np.mean(np.log10(tried / valley) ** 2))))
        runs: dict[Run, Figures] = {}
        pruned = False
        for seed in range(3):
            runs[Run("quiet", seed)] = Figures(False, (0.01 + distances[-1] * (1 + seed / 2),))
            if pruned := pruning and seed < 2 and search.is_hopeless(runs):
                break
        search.tell(settings, runs, pruned=pruned)
    return min(distances[1:])


def test_a_search_that_prunes_comes_as_near_as_one_that_does_not() -> None:
    """The first trials are had in full, poor as they are; the search must not be drawn to them."""
    pruning, whole = ([nearest(number, pruning=prunes) for number in range(12)] for prunes in (True, False))
    assert np.mean(pruning) < 1.2 * np.mean(whole)


def test_a_trial_ends_when_it_has_more_failed_runs_than_the_best() -> None:
    assert search_of([[1.0, 1.0, 1.0]]).is_hopeless(begun(0.1, failed=True))
    assert not search_of([[1.0, 1.0, 1.0]], frozenset([0])).is_hopeless(begun(9.0, failed=True))
    assert search_of([[1.0, 1.0, 1.0]] * 6, frozenset([0])).is_hopeless(begun(9.0, failed=True))


def test_two_objectives_leave_a_front(tmp_path: Path) -> None:
    """rmse draws the gain to 1, the largest input to 0: from 0 to 1 neither is better than the other."""
    objectives = (Objective.parse("rmse"), Objective.parse("total_variation"))
    tuned(tmp_path, request=Request(objectives, trials=12, seeds=[1]))
    rows = trials_of(tmp_path)
    assert {row["not dominated"] for row in rows} == {"true", "false"}
    assert {row["pruned"] for row in rows} == {"false"}  # none of them could be told to be worse


NESTED = (
    TOYS.replace("tuning_toys", "nested_toys")
    + """
@dataclass(kw_only=True)
class Wide(Controller):
    gain: float = setting(9.0, low=0.0, high=10.0, doc="gain", search=Linear(8.0, 10.0))
    offset: float = setting(5.0, low=-9.0, high=9.0, doc="is added", search=Linear(4.0, 9.0))
    rough: bool = setting(True, doc="changes nothing")
    def start(self, loop):
        pass
    def step(self, sample):
        return self.gain * sample.setpoint + self.offset

def settings_as(self, other, inputs, outputs, samples):
    assert (inputs, outputs, samples) == (1, 1, 0)
    same = {"gain": self.gain, "offset": 0.0, "rough": self.rough}
    return same if issubclass(other, Wide) else None
Gain.settings_as = settings_as
"""
)


def test_a_method_tries_what_was_found_for_one_that_it_contains(tmp_path: Path) -> None:
    """Among its trials, as the last; the settings that are not searched come along."""
    (tmp_path / "nested_toys.py").write_text(NESTED, encoding="utf-8")
    text = STUDY.replace("tuning_toys", "nested_toys").replace(
        "controllers.rest", 'controllers.wide = { type = "nested_toys:Wide" }\ncontrollers.rest'
    )
    tuning = tuned(tmp_path, text, Request(trials=6, seeds=[4]))
    for other in ("a", "b"):
        last = [trial for trial in tuning.trials["study", "wide"] if trial.origin == f"as found for {other}"]
        theirs = tuning.trials["study", other][: 6 - 1]  # of which one is for the other of the same class
        assert [trial.settings["gain"] for trial in last] == [theirs[best(theirs)].settings["gain"]]
        assert last[0].settings["offset"] == 0.0
        assert last[0].settings["rough"] is False
    origins = [row["origin"] for row in trials_of(tmp_path) if row["controller"] == "wide"]
    assert origins == ["as given", "search", "search", "search", "as found for a", "as found for b"]
    assert {len(trials) for trials in tuning.trials.values()} == {6}
    assert best(tuning.trials["study", "wide"]) >= 4
    how = read_study(str(tmp_path / "out" / "tuned.toml")).problem.study.controllers["wide"].tuned
    assert how is not None
    assert set(how.settings) == {"gain", "offset", "rough"}
    assert how.at_ends == ["gain", "offset"]  # far beyond where was looked
    constant = '{"gain": 1.2, "offset": 0.0, "soft": 1.0}'
    broken = NESTED.replace("nested_toys", "broken_toys").replace("return same if", f"return {constant} if")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "broken_toys.py").write_text(broken, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"Gain\.settings_as\(Wide\): soft: unknown setting"):
        tuned(tmp_path / "b", text.replace("nested_toys", "broken_toys"), Request(trials=3, seeds=[4]))


def test_settings_that_the_study_asks_for_are_tried_first(tmp_path: Path) -> None:
    text = STUDY.replace("search = {", "first_trials = [{ gain = 1.25 }, { gain = 0.5 }]\nsearch = {")
    tuning = tuned(tmp_path, text, Request(trials=4, seeds=[4], compares=False))
    tried = tuning.trials["study", "b"]
    assert [trial.settings["gain"] for trial in tried[:3]] == [2.0, 1.25, 0.5]
    assert [trial.origin for trial in tried] == ["as given", "first trials", "first trials", "search"]
    for wrong, fault in (
        ("{ gein = 1.0 }", 'no setting "gein"'),
        ("{ gain = 11.0 }", "11.0 is not possible"),
    ):
        with pytest.raises(ConfigError, match=rf"controllers\.b\.first_trials.*{fault}"):
            tuned(tmp_path / "wrong", text.replace("{ gain = 1.25 }", wrong))


def test_who_runs_with_the_first_seed_alone_is_said_to_have_been_tuned_on_it(tmp_path: Path) -> None:
    text = STUDY.replace("[controllers.b]", '[controllers.b]\nseeds = "first"')
    text += '[report]\nreference_points = { zero = "rest", full = "b" }\n'
    tuned(tmp_path, text, Request(trials=3, seeds=[4, 5], compares=False))
    controllers = read_study(str(tmp_path / "out" / "tuned.toml")).problem.study.controllers
    seeds = {name: section.tuned.seeds for name, section in controllers.items() if section.tuned}
    assert seeds == {"a": [4, 5], "b": [4]}
    assert {(row["controller"], row["runs"]) for row in trials_of(tmp_path)} >= {("a", "2"), ("b", "1")}


def test_without_a_comparison_there_are_trials_alone(tmp_path: Path) -> None:
    tuning = tuned(tmp_path, request=Request(trials=3, seeds=[4], compares=False))
    assert (tuning.results, tuning.held_out) == (None, {})
    assert not (tmp_path / "out" / "held-out").exists()
    assert {row["held out: runs failed"] for row in trials_of(tmp_path)} == {""}
    assert read_study(str(tmp_path / "out" / "tuned.toml")).problem.study.controllers["a"].tuned


def test_another_seed_of_the_sampler_has_other_settings_tried_and_is_told(tmp_path: Path) -> None:
    def gains(seed: int, folder: str) -> list[float]:
        request = Request(trials=4, seeds=[4], sampler_seed=seed, compares=False)
        tuning = tuned(tmp_path / folder, request=request)
        return [trial.settings["gain"] for trial in tuning.trials["study", "a"]]

    assert gains(0, "a") == gains(0, "b") != gains(1, "c")
    study = read_study(str(tmp_path / "c" / "out" / "tuned.toml")).problem.study
    assert study.controllers["a"].tuned is not None
    assert study.controllers["a"].tuned.sampler_seed == 1
    assert ", sampler seed 1, by rmse" in study.summary


def test_settings_near_an_end_of_where_was_looked_are_told() -> None:
    """Nearer than 3 % of the space's length, of its powers of ten where it is logarithmic."""
    spaces = {
        "a": Linear(0.0, 10.0),
        "b": Log(1e-4, 1e4),
        "c": Integer(1, 10),
        "d": Factor(0.1, 10.0),
        "e": Choice(("x", "y")),
    }
    given = {"a": 5.0, "b": 1.0, "c": 5, "d": [2.0, 0.0], "e": "x"}
    search = SettingsSearch("p", "c", given, spaces, (Objective(),))
    assert search.at_ends(given) == []
    near = {"a": 0.31, "b": 1.8e-4, "c": 2, "d": [17.0, 0.0], "e": "y"}
    assert search.at_ends(near) == []
    assert search.at_ends(near | {"a": 9.71, "b": 1.7e-4, "c": 1, "d": [17.5, 0.0]}) == ["a", "b", "c", "d"]
    assert search.at_ends(near | {"a": 12.0, "b": 0.0, "d": [1.0, 2.0]}) == ["a", "b"]


def test_the_runs_that_trials_have_lost_most_often_come_first(tmp_path: Path) -> None:
    (tmp_path / "tuning_toys.py").write_text(TOYS, encoding="utf-8")
    write(tmp_path, STUDY)
    resolved = read_study(str(tmp_path / "study.toml")).problem
    cases = cases_of(resolved, resolved.plant, [1, 2, 3], "a")
    search = search_of([])
    assert search.hardest_first(cases) == [*cases]
    for lost in ([3], [3, 2]):
        runs = {Run("nominal", seed): Figures(seed in lost, (1.0,)) for seed in (1, 2, 3)}
        search.tell(search.next_settings(), runs)
    assert [case.seed for case in search.hardest_first(cases)] == [3, 2, 1]


FACTOR = "{ factor = [0.1, 4.0] }"
FAULTS = [
    ("4.0]", "40.0]", "search.gain: 80.0 is not possible; allowed"),
    ("gain = 2.0", "gain = 0.0", "search.gain: 0.0 has no multiples; needed"),
    (FACTOR, "{ integer = [0, 11] }", "search.gain: 11 is not possible"),
    (FACTOR, "{ choices = [1.0, 'x'] }", "search.gain: 'x' is not possible"),
    (FACTOR, "{ log = [4.0, 0.1] }", "search.gain.log: from 4 to 0.1 is not a range"),
    (FACTOR, "{ log = [0.0, 1.0] }", "search.gain.log: from 0 to 1 is not a range; .*both above 0"),
    (FACTOR, "{ log = [1, 2], linear = [1, 2] }", "search.gain: needs exactly one"),
    ("gain = { factor", "gein = { factor", 'search: no setting "gein"; did you mean "gain"'),
    (
        "settings = { gain = 2.0 }",
        "sweep = { gain = [1.0] }",
        "sweep: a study is tuned without sweeps; remove it",
    ),
]


@pytest.mark.parametrize(("said", "instead", "fault"), FAULTS)
def test_what_cannot_be_searched_is_told_with_its_place(
    said: str, instead: str, fault: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=rf"controllers\.b\.{fault}"):
        tuned(tmp_path, STUDY.replace(said, instead))
    assert not (tmp_path / "out").exists()


def test_what_the_study_does_not_allow_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"--seeds: 0: seeds of the study.*such as 10000:10003"):
        tuned(tmp_path, request=Request(seeds=[0, 1]))
    with pytest.raises(ConfigError, match='rmse has no signal "x" in study'):
        tuned(tmp_path, request=Request((Objective.parse("rmse.x"),)))
    in_c = STUDY.replace("duration = 1.0", 'duration = 1.0, engine = "compiled"')
    with pytest.raises(ConfigError, match="solve_time_mean: a compiled loop has no times of steps; use"):
        tuned(tmp_path, in_c, Request((Objective.parse("solve_time_mean"),)))


@pytest.mark.parametrize(
    ("objectives", "fault"),
    [
        (("rmse", "rmse:median"), "--objective rmse: given twice"),
        (("prediction", "rmse"), "--objective prediction: closes no loop, which rmse is of"),
    ],
)
def test_objectives_that_do_not_go_together_are_told(objectives: tuple[str, ...], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        Request(tuple(map(Objective.parse, objectives)))


def test_a_setting_is_kept_where_the_study_says_so(tmp_path: Path) -> None:
    text = STUDY.replace("{ factor = [0.1, 4.0] }", "false").replace(
        'type = "tuning_toys:Gain" }', 'type = "tuning_toys:Gain", search = { gain = false } }'
    )
    with pytest.raises(ConfigError, match="no controller has settings to search; say so in the study"):
        tuned(tmp_path, text)


@pytest.mark.parametrize("text", ["rmsee", "rmse:best", "rmse:2", "iae:", "prediction:x"])
def test_objectives_that_are_none(text: str) -> None:
    if text == "iae:":
        assert Objective.parse(text).over == "median"
        return
    with pytest.raises(ConfigError, match=f"--objective {text}"):
        Objective.parse(text)


def test_spaces_are_ranges() -> None:
    assert (Linear(-1.0, 1.0).low, Integer(1, 2).high, Factor(0.1, 2.0).high) == (-1.0, 2, 2.0)
    assert Choice(("a", "b")).values == ("a", "b")
    for kind, low in ((Linear, 2.0), (Log, 0.0), (Factor, -1.0), (Linear, np.nan)):
        with pytest.raises(ConfigError, match="is not a range"):
            kind(low, 1.0)
