"""Many seeds: what is kept of them is what single runs give, and nothing of it is lost or taken on trust."""

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from studies import cases_in, run_file, study_text, write

from ddpc_cosim import CaseResult, ConfigError, CosimError, StudyResults, load_results
from ddpc_cosim.cli.main import main
from ddpc_cosim.study import batches, runner
from ddpc_cosim.study.batches import Batched, read_batch, stage_batch
from ddpc_cosim.study.case_columns import Numbers
from ddpc_cosim.study.case_files import checksum
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.objects import Silent
from ddpc_cosim.study.results import write_report
from ddpc_cosim.study.verdicts.reliability import extreme_runs

SEEDS = 12
STUDY: dict[str, Any] = {
    "plant": {
        "name": "pendulum",
        "inputs": ["torque"],
        "outputs": ["angle"],
        "parameters": {"mass": {"distribution": "normal", "mean": 1.0, "deviation": 0.1, "low": 0.5}},
    },
    "loop": {"sampling_time": 0.1, "duration": 2.0},
    "reference": {"angle": {"kind": "steps", "times": [0.0], "values": [0.3]}},
    "recording": {"samples": 60, "excitation": {"torque": {"kind": "uniform", "low": -3.5, "high": 3.5}}},
    "bounds": {"torque": {"min": -3.5, "max": 3.5}},
    "scenarios": {"noisy": {"noise": {"angle": 0.01}}},
    "controllers": {
        "deepc": {"type": "deepc", "settings": {"initial_length": 3, "horizon": 5}},
        "pid": {"type": "pid", "settings": {"proportional": 4.0, "integral": 3.0}},
    },
}
NOT_COMPARED = ("solve_time", "deadline")


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make eight seeds many."""
    for name, value in {"_MANY_SEEDS": 8, "_FIRST_SEEDS": 2, "_BATCH": 6}.items():
        monkeypatch.setattr(runner, name, value)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    return write(tmp_path, study_text(**STUDY, seeds=[f"0:{SEEDS}"]))


def run(study: Path, out: str = "out", **options: Any) -> StudyResults:
    return run_file(study, study.parent / out, **{"engine": "compiled", **options})


def batch_without_folders(folder: Path) -> Path:
    """Return the batch with the most cases that are there in it alone."""

    def alone(path: Path) -> int:
        return sum(not (folder / run["id"]).exists() for run in read_batch(path))

    return max(folder.glob("batch-*"), key=alone)


def figures(results: StudyResults) -> dict[str, Any]:
    """Return what results say of each case, without what nobody could repeat."""
    return {
        case.id: (
            case.outcome,
            case.failed,
            case.settles,
            case.left,
            case.tracking,
            dict(case.drawn),
            dict(case.diagnostics),
            case.warnings,
            case.engine,
            {key: value for key, value in case.metrics.items() if not key.startswith(NOT_COMPARED)},
        )
        for case in (*results.cases, *results.resting)
    }


def test_figures_are_those_of_single_runs(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = run(study, "alone")
    small.__wrapped__(monkeypatch)  # type: ignore[attr-defined]
    together = run(study)
    np.testing.assert_equal(figures(together), figures(alone))
    batched = [case for case in together.cases if case.batched]
    assert {case.seed for case in batched} == set(range(2, SEEDS))
    written = [path.name for path in (study.parent / "out/cases").iterdir()]
    # Two seeds at a time, a file for each controller and one for doing nothing.
    assert sum(name.startswith("batch-") for name in written) == 5 * 3
    csv = [(study.parent / out / "metrics.csv").read_text().splitlines() for out in ("out", "alone")]
    assert [len(lines) for lines in csv] == [1 + 2 * SEEDS] * 2
    frame, table = together.frame(), pd.read_parquet(study.parent / "out/metrics.parquet")
    for name in ("controller", "seed", "failed", "parameter mass [kg]", "mean_abs_error.angle [deg]"):
        assert table[name].tolist() == frame[name].tolist()
    assert not (study.parent / "alone/metrics.parquet").exists()
    said = CliRunner().invoke(main, ["diff", *(str(study.parent / out) for out in ("out", "alone"))])
    assert said.exit_code == 0, said.output


@pytest.mark.usefixtures("small")
def test_samples_are_kept_of_the_first_worst_middle_and_best(study: Path) -> None:
    results = run(study)
    for controller in ("deepc", "pid"):
        runs = [case for case in results.cases if case.controller == controller]
        by_error = sorted(runs, key=lambda case: -case.metrics["mean_abs_error.angle [deg]"])
        extremes = [*by_error[:3], by_error[len(runs) // 2], by_error[-1]]
        assert not any(case.failed for case in runs)
        assert {case.seed for case in extreme_runs(results.study, runs)} == {case.seed for case in extremes}
        kept = {case.seed for case in runs if case.has_samples}
        assert kept == {0, 1, *(case.seed for case in extremes)}
        other = next(case for case in runs if case.seed not in kept)
        with pytest.raises(ConfigError, match=rf"only its figures are kept.*--only {controller} --seeds"):
            other.trace()


@pytest.mark.usefixtures("small")
def test_any_other_run_is_made_again_to_the_last_bit(study: Path) -> None:
    results = run(study)
    lost = next(case for case in results.cases if not case.has_samples)
    [again] = run(study, only=[lost.controller], seeds=[lost.seed]).cases
    assert (again.id, again.batched) == (lost.id, False)
    np.testing.assert_equal(again.metrics, dict(lost.metrics))
    trace = lost.trace()
    [case] = [case for case in cases_in(study) if case.id == lost.id]
    np.testing.assert_array_equal(trace.u, again.trace().u)
    assert trace.engine == "compiled"
    assert case.drawn == lost.drawn
    np.testing.assert_equal(figures(run(study)), figures(results))


@pytest.mark.usefixtures("small")
def test_what_is_there_is_not_run_again_and_what_is_damaged_is(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = run(study)
    times = {path: path.stat().st_mtime_ns for path in (study.parent / "out/cases").iterdir()}
    assert run(study).runs[-1]["cases run"] == "0"
    assert {path: path.stat().st_mtime_ns for path in times} == times
    batch = batch_without_folders(study.parent / "out/cases")
    count, content = len(read_batch(batch)), bytearray(batch.read_bytes())
    content[len(content) // 2] ^= 1
    batch.write_bytes(content)
    damaged = load_results(study.parent / "out")
    assert len(damaged.damaged) + len(damaged.cases) + len(damaged.resting) == 3 * SEEDS
    again = run(study)
    assert int(again.runs[-1]["cases run"]) <= count
    assert not again.damaged
    np.testing.assert_equal(figures(again), figures(results))


class Stops(Silent):
    """Asks to stop as Ctrl-C does, when so many cases are done."""

    def __init__(self, most: int) -> None:
        self._left = most

    def finished(self, case: Case, result: CaseResult) -> None:
        self._left -= 1
        if not self._left:
            raise KeyboardInterrupt


@pytest.mark.usefixtures("small")
def test_what_was_done_before_ctrl_c_is_not_run_again(study: Path) -> None:
    alone_first = 2 * 3  # two seeds of three controllers, doing nothing among them
    with pytest.raises(KeyboardInterrupt):
        run(study, progress=Stops(alone_first + 4))
    there = {run["id"] for path in (study.parent / "out/cases").glob("batch-*") for run in read_batch(path)}
    assert len(there) >= 4
    results = run(study)
    assert results.runs[-1]["cases run"] == str(3 * SEEDS - alone_first - len(there))
    np.testing.assert_equal(figures(results), figures(run(study, "whole")))


@pytest.mark.usefixtures("small")
def test_shards_put_together_are_the_whole(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_MANY_SEEDS", 4)
    for shard in ("1/2", "2/2"):
        run(study, shard=shard)
    results = run(study)
    assert (results.runs[-1]["cases run"], results.damaged) == ("0", {})
    np.testing.assert_equal(figures(results), figures(run(study, "whole")))


@pytest.mark.usefixtures("small")
def test_other_settings_of_figures_run_cases_again(study: Path, tmp_path: Path) -> None:
    results = run(study)
    text = study_text(**STUDY, seeds=[f"0:{SEEDS}"], metrics={"cost": {"outputs": {"angle": 2.0}}})
    changed = run(write(tmp_path, text))
    assert {case.id for case in changed.cases} == {case.id for case in results.cases}
    alone = run(tmp_path / "study.toml", "alone", engine="python")
    assert len(alone.cases) == 2 * SEEDS
    [cost] = {key for case in changed.cases for key in case.metrics if key.startswith("cost")}
    for case, other in zip(changed.cases, alone.cases, strict=True):
        assert case.metrics[cost] == pytest.approx(other.metrics[cost], rel=1e-9)


@pytest.mark.usefixtures("small")
def test_cases_of_a_batch_that_takes_too_long_are_run_by_themselves(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner._Batch, "is_late", True)
    monkeypatch.setattr(runner, "_POLL_SECONDS", 0.0)
    results = run(study)
    assert len(results.cases) == 2 * SEEDS
    assert all(case.outcome == "completed" and not case.batched for case in results.cases)
    assert not [*(study.parent / "out/cases").glob("batch-*")]


@pytest.mark.usefixtures("small")
def test_a_tuning_on_many_seeds_is_judged_by_their_runs_of_doing_nothing(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(study.parent)
    options = ["--trials", "2", "--only", "pid", "--seeds", f"100:{100 + SEEDS}", "--engine", "compiled"]
    no_more = ["--no-comparison", "--no-report", "--jobs", "2"]
    result = CliRunner().invoke(main, ["tune", str(study), *options, *no_more, "--out", "tuned"])
    assert result.exit_code == 0, result.output
    resting = Batched(study.parent / "tuned/cases")
    assert {case.controller for case in resting.values()} == {"doing-nothing"}
    assert len(resting) == SEEDS - 2


@pytest.mark.usefixtures("small")
def test_a_batch_of_other_cases_is_refused(study: Path, tmp_path: Path) -> None:
    run(study)
    folder = tmp_path / "out/cases"
    runs = max(map(read_batch, folder.glob("batch-*")), key=len)
    heads = [{key: run[key] for key in ("id", "seed", "controller")} for run in runs]
    (tmp_path / "accepted").mkdir()
    staged = stage_batch(tmp_path, runs)
    for wrong in (heads[::-1], heads[:-1], [heads[0] | {"seed": 99}, *heads[1:]]):
        with pytest.raises(CosimError, match="a batch of cases cannot be kept"):
            Batched(tmp_path / "accepted").accept(staged, wrong)
    accepted = Batched(tmp_path / "accepted").accept(staged, heads)
    assert [case.id for case in accepted] == [run["id"] for run in runs]
    assert set(Batched(tmp_path / "accepted")) == {run["id"] for run in runs}


def test_a_small_file_of_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not unpacked: a folder of results may come from anyone."""
    path = stage_batch(tmp_path, [{"id": "a", "printed": 100_000 * "x"}, {"id": "b", "printed": ""}])
    assert [run["id"] for run in read_batch(path)] == ["a", "b"]
    monkeypatch.setattr(batches, "_LONGEST", 10_000)
    assert path.stat().st_size < 10_000
    with pytest.raises(ValueError, match="more than 10000 bytes"):
        read_batch(path)


@pytest.mark.parametrize(
    "content",
    [b"", b"no gzip", gzip.compress(b"{}")[:-12], gzip.compress(b"{")],
    ids=["nothing", "no gzip", "cut short", "no JSON"],  # gzip writes the time down
)
def test_a_file_of_the_right_name_that_holds_no_batch_is_no_case(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / f"batch-{checksum(content)[:24]}.json.gz"
    path.write_bytes(content)
    with pytest.raises((ValueError, KeyError)):
        read_batch(path)
    assert not Batched(tmp_path)


@pytest.mark.usefixtures("small")
def test_a_changed_figure_is_not_believed(study: Path) -> None:
    run(study)
    batch = batch_without_folders(study.parent / "out/cases")
    content = json.loads(gzip.decompress(batch.read_bytes()))
    metrics = content["runs"][0]["metrics"]
    content["runs"][0]["metrics"] = dict.fromkeys(metrics, 0.0)
    batch.write_bytes(gzip.compress(json.dumps(content).encode()))
    left = load_results(study.parent / "out")
    ids = {run["id"] for run in content["runs"]}
    assert set(left.damaged) | {case.id for case in left.cases if not case.batched} >= ids
    assert left.damaged


@pytest.mark.usefixtures("small")
def test_a_report_says_of_which_runs_there_are_samples(study: Path) -> None:
    results = run(study)
    path = write_report([results], study.parent / "report.md", "md")
    text = path.read_text(encoding="utf-8")
    kept = sum(case.has_samples for case in results.cases)
    assert f"kept of {kept} of {len(results.cases)} runs" in text
    for controller in ("deepc", "pid"):
        errors = {
            case.seed: case.metrics["mean_abs_error.angle [deg]"]
            for case in results.cases
            if case.controller == controller
        }
        first, second, third = sorted(errors, key=lambda seed: -errors[seed])[:3]
        assert f"with seeds {first}, {second} and {third}" in text
    assert "</html>" in write_report([results], study.parent / "report.html").read_text(encoding="utf-8")


def test_numbers_by_name_are_those_of_a_dict() -> None:
    stored = {"rmse [deg]": 1.5, "failures [1]": 0.0}
    numbers = Numbers({name: [0.0, number] for name, number in stored.items()}, 1)
    assert (dict(numbers), numbers == stored, repr(numbers), len(numbers)) == (stored, True, repr(stored), 2)
    assert (numbers.get("iae"), list(numbers)) == (None, list(stored))
