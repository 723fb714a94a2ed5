"""Shards of a study: disjoint, together the whole, and put together by the next run."""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from ddpc_cosim import ConfigError, load_results
from ddpc_cosim.cli.main import main
from ddpc_cosim.study.runner import Selection

WriteStudy = Callable[..., Path]


def run(study: Path, *options: str, folder: str = "out") -> str:
    out = study.parent / folder
    done = CliRunner().invoke(main, ["run", str(study), "--out", str(out), "--jobs", "1", *options])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.parametrize("number", range(1, 12))
def test_shards_are_disjoint_and_together_the_whole(number: int) -> None:
    cases = list(range(7))  # of which only the order counts
    parts = [Selection(shard=f"{i}/{number}").part_of(cases) for i in range(1, number + 1)]  # type: ignore[arg-type]
    assert sorted(case for part in parts for case in part) == cases  # type: ignore[type-var]
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize("shard", ["0/3", "4/3", "x/3", "1/0", "3", "1/2/3", "-1/3", ""])
def test_a_shard_that_there_is_not_is_refused_with_the_remedy(shard: str) -> None:
    with pytest.raises(ConfigError, match=rf"^--shard {shard}: must be I/N, I from 1 to N, such as 1/2"):
        Selection(shard=shard)


def test_executor_and_scheduler_belong_together() -> None:
    for given, expected in [
        ({"executor": "dask"}, "no --scheduler; give one such as --scheduler tcp://host:8786"),
        ({"executor": "dask", "scheduler": "host:8786"}, "--scheduler host:8786: is not an address"),
        ({"scheduler": "tcp://host:8786"}, "needs --executor dask"),
        ({"executor": "slurm"}, "must be local or dask"),
        ({"storage": "hdf5"}, "--storage hdf5: must be csv or parquet"),
    ]:
        with pytest.raises(ConfigError) as caught:
            Selection(**given)  # type: ignore[arg-type]
        assert expected in str(caught.value)


def test_shards_in_one_folder_are_one_study(write_study: WriteStudy) -> None:
    study = write_study("mfapc", "mfac", seeds="[0, 1]")
    out = study.parent / "out"
    assert "shard 3/3: 1 case; metrics.csv and report" in run(study, "--shard", "3/3")
    assert len(load_results(out).cases) == 1
    assert "2 to run, 0 already there" in run(study, "--shard", "1/3", "--dry-run")
    run(study, "--shard", "1/3", "--storage", "parquet")
    run(study, "--shard", "2/3")
    assert not (out / "metrics.csv").exists()
    assert not (out / "report.html").exists()

    assert len(load_results(out).cases) == 4
    report = CliRunner().invoke(main, ["report", str(out)])
    assert report.exit_code == 0, report.output

    before = {path: path.stat().st_mtime_ns for path in out.glob("cases/*/*")}
    run(study)
    assert {path: path.stat().st_mtime_ns for path in out.glob("cases/*/*")} == before
    assert len((out / "metrics.csv").read_text().splitlines()) == 5


def test_shards_in_folders_of_their_own_are_put_together_by_copying_their_cases(
    write_study: WriteStudy,
) -> None:
    study = write_study("mfapc", seeds="[0, 1]")
    for part in ("1", "2"):
        run(study, "--shard", f"{part}/2", folder=part)
        shutil.copytree(study.parent / part / "cases", study.parent / "out/cases", dirs_exist_ok=True)
    run(study)
    run(study, folder="at-once")
    assert "2 cases and 2 runs of doing nothing: 0 to run, 4 already there" in run(study, "--dry-run")
    assert metrics_of(study.parent / "out") == metrics_of(study.parent / "at-once")


def metrics_of(folder: Path) -> tuple[list[str], list[list[str]]]:
    """Return metrics.csv, bar how long things took."""
    header, *rows = csv.reader((folder / "metrics.csv").read_text().splitlines())
    kept = [number for number, name in enumerate(header) if "solve_time" not in name]
    return [header[number] for number in kept], [[row[number] for number in kept] for row in rows]


def test_a_shard_without_cases_has_nothing_to_do(write_study: WriteStudy) -> None:
    assert "shard 3/3: 0 cases" in run(write_study("mfapc"), "--shard", "3/3")
