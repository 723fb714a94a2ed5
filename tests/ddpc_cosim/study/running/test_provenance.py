"""Where results come from: the command to have them again, the files, commits and times."""

import hashlib
import json
import subprocess
from importlib import metadata
from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from studies import run_file, study_text, write

from ddpc_cosim import StudyResults, load_results
from ddpc_cosim.plugins import package_version
from ddpc_cosim.study.case_files import read_sealed, sealed_json
from ddpc_cosim.study.file_format.sections import expand_seeds
from ddpc_cosim.study.file_format.study_files import StudyFile
from ddpc_cosim.study.running.provenance import commit_of, facts_of_run, seed_ranges
from ddpc_cosim.study.verdicts.findings import findings_of
from ddpc_reports.tables.reproduce import reproduce_tables

STUDY = study_text(controllers={"mfapc": "mfapc", "other": "mfapc"})


@given(st.lists(st.integers(0, 50), unique=True, min_size=1))
def test_seeds_are_written_as_the_option_takes_them(seeds: list[int]) -> None:
    assert expand_seeds(seed_ranges(seeds).split(",")) == seeds


def test_a_run_records_how_to_have_it_again(tmp_path: Path) -> None:
    path = tmp_path / "my own.toml"
    path.write_text(STUDY, encoding="utf-8")

    def run() -> StudyResults:
        return run_file(path, seeds=[4, 5], only="mfapc*")

    results = run()
    facts = results.provenance
    assert facts["run again"] == "ddpc-cosim run 'my own.toml' --seeds 4:6 --only 'mfapc*'"
    assert facts["study file"] == str(path)
    assert facts["study file sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert "study file commit" not in facts
    assert facts["wall time"].endswith(" s for 4 cases, 0 kept from an earlier run")
    runs = [json.loads((case.folder / "run.json").read_text(encoding="utf-8")) for case in results.cases]
    assert (
        facts["time of all cases"]
        == f"{sum(run_facts['wall_time'] for run_facts in runs):.3g} s, one after another"
    )
    again = run().provenance
    assert again["wall time"].endswith(" s for 0 cases, 4 kept from an earlier run")
    assert again["time of all cases"] == facts["time of all cases"]


def test_every_run_over_a_folder_is_told(tmp_path: Path) -> None:
    """One that had nothing to do takes nothing away from those that the figures are of."""
    path = tmp_path / "own.toml"
    path.write_text(STUDY, encoding="utf-8")

    def run(only: str) -> StudyResults:
        return run_file(path, seeds=[4], only=only)

    first, *_ = recorded = [run(only).runs[-1] for only in ("mfapc*", "mfapc*", "other*")]
    results = load_results(tmp_path / "out")
    assert list(results.runs) == recorded
    assert [facts["cases run"] for facts in recorded] == ["2", "0", "1"]
    assert first["run again"] == "ddpc-cosim run own.toml --seeds 4 --only 'mfapc*'"

    run("mfapc*")
    results = load_results(tmp_path / "out")
    (table, runs) = reproduce_tables(results, "")
    shown = {row.header: row.cells[0].text for row in table.rows}
    assert shown["command"] == "ddpc-cosim run own.toml --seeds 4 --only 'other*'"
    assert shown["date"] == recorded[-1]["date"]
    assert [row.header for row in runs.rows] == [facts["date"] for facts in results.runs]


def test_cases_say_which_versions_they_ran_with_and_a_mixture_is_told(tmp_path: Path) -> None:
    results = run_file(write(tmp_path, STUDY), seeds=[4, 5, 6], only="mfapc*")
    here = metadata.version("numpy")
    for case in results.cases:
        assert case.versions["numpy"] == here
        assert case.versions["ddpc-cosim"] == package_version()
    assert not [
        remark for remark in findings_of(results.study, results.cases).remarks if "versions" in remark.text
    ]

    record = results.cases[0].folder / "run.json"
    older = read_sealed(record)
    older.pop("sha256", None)
    older["versions"] |= {"numpy": "1.0"}
    record.write_bytes(sealed_json(older))
    results = load_results(tmp_path / "out")
    message = f"Cases ran with different versions of numpy: {here} (2), 1.0 (1); a run with --fresh has one"
    assert message in [remark.text for remark in findings_of(results.study, results.cases).remarks]


def test_studies_without_a_file_of_their_own_are_run_by_name_or_from_the_results() -> None:
    built_in = facts_of_run([], StudyFile("paper.toml", Path(), {}, source="paper"), [], "1", "1 s")
    assert (built_in["run again"], built_in["study"]) == (
        "ddpc-cosim run paper",
        f"paper, of ddpc-cosim {package_version()}",
    )
    made = facts_of_run([], StudyFile("made", Path(), {}), ["--sandbox"], "1", "1 s")
    assert made["run again"] == "ddpc-cosim run study.toml --sandbox"
    assert not {"study", "study file"} & made.keys()


def git(folder: Path, *words: str) -> str:
    me = ("-c", "user.name=me", "-c", "user.email=me@example.org")
    done = subprocess.run(["git", *me, *words], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def test_the_commit_is_told_and_whether_anything_was_changed_since(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, other = tmp_path / "own.toml", tmp_path / "other.toml"
    git(tmp_path, "init", "-q")
    path.write_text("a = 1\n", encoding="utf-8")
    assert commit_of(path) == ""
    git(tmp_path, "add", "own.toml")
    git(tmp_path, "commit", "-q", "-m", "A study")
    commit = git(tmp_path, "rev-parse", "HEAD")
    monkeypatch.setenv("GIT_DIR", "/of/a/hook")
    assert commit_of(path) == f"{commit}, clean"
    other.write_text("", encoding="utf-8")
    assert commit_of(other) == ""
    path.write_text("a = 2\n", encoding="utf-8")
    assert commit_of(path) == f"{commit}, with changes that are not committed"
    monkeypatch.setenv("PATH", "")
    assert commit_of(path) == ""
