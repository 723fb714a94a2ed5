"""Files beside a study, in the current folder or in a folder of results: what of them is executed."""

import json
import re
import subprocess
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import pytest
from click.testing import CliRunner

from ddpc_cosim.cli.main import main

WriteStudy = Callable[..., Path]

SHADOWS = ("json", "random", "numpy", "sitecustomize", "pyarrow", "ddpc_controllers/__init__", "late")
OWN = """
import helper
from ddpc_cosim import Controller

class Mine(Controller):
    def start(self, loop):
        pass

    def step(self, sample):
        import optional_part
        return [helper.GAIN]
"""


def trap(folder: Path) -> Path:
    """Lay out modules that say when they are executed, and metadata as of a package with plug-ins."""
    sprung = folder / "sprung"
    for name in SHADOWS:
        path = folder / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"open({str(sprung)!r}, 'a').write({name!r})\nclass Trap: pass\n", encoding="utf-8")
    metadata = folder / "late-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: late\nVersion: 1.0\n", encoding="utf-8")
    groups = "".join(f"[ddpc_cosim.{kind}]\nlate = late:Trap\n" for kind in ("metrics", "controllers"))
    (metadata / "entry_points.txt").write_text(groups, encoding="utf-8")
    return sprung


def reseal(results: Path, study: str) -> None:
    """Make checksums fit a changed study: they find damage, and no one who forges them."""
    path = results / "provenance.json"
    text = path.read_text(encoding="utf-8").rpartition(',\n "sha256"')[0]
    before = sha256((results / "study.toml").read_bytes()).hexdigest()
    text = text.replace(before, sha256(study.encode()).hexdigest())
    path.write_text(f'{text},\n "sha256": "{sha256(text.encode()).hexdigest()}"\n}}\n', encoding="utf-8")


def test_a_study_has_its_own_modules_and_shadows_nothing(
    program: str, write_study: WriteStudy, tmp_path: Path
) -> None:
    study, sprung = write_study("mfapc", "mine:Mine"), trap(tmp_path)
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    (tmp_path / "helper.py").write_text("GAIN = 0.5\n", encoding="utf-8")
    (tmp_path / "optional_part.py").touch()
    elsewhere = tmp_path / "empty"
    elsewhere.mkdir()
    command = [program, "run", str(study), "--out", str(tmp_path / "results"), "--jobs", "1", "--no-report"]
    for folder, said in ((tmp_path, "3 cases to run"), (elsewhere, "0 cases to run, 3 kept")):
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert said in done.stderr
    assert not sprung.exists()


def test_modules_of_the_current_folder_are_not_those_of_a_study(
    write_study: WriteStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = write_study("nowhere:Mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "nowhere.py").write_text("raise AssertionError", encoding="utf-8")
    monkeypatch.chdir(tmp_path / "other")
    result = CliRunner().invoke(main, ["run", str(study)])
    assert result.exit_code == 2
    assert f"No module named 'nowhere'; it is not installed, and not in {tmp_path}" in result.stderr


def test_a_module_that_is_called_as_an_installed_one_is_told(write_study: WriteStudy, tmp_path: Path) -> None:
    study = write_study("control:Mine")
    (tmp_path / "control.py").write_text("raise AssertionError", encoding="utf-8")
    result = CliRunner().invoke(main, ["run", str(study)])
    assert result.exit_code == 2
    assert f"is installed and comes first: give {tmp_path / 'control.py'} another name" in result.stderr


def test_a_report_executes_nothing_that_the_results_name(
    program: str, write_study: WriteStudy, tmp_path: Path
) -> None:
    study = write_study("mfapc")
    results = tmp_path / "results"
    arguments = ["run", str(study), "--out", str(results), "--jobs", "1", "--no-report"]
    assert CliRunner().invoke(main, arguments).exit_code == 0
    traps = [trap(results), trap(tmp_path)]  # with the results, and where the command is typed
    markup = "<script>alert(1)</script>\x1b[31m\u202e"
    named = (results / "study.toml").read_text(encoding="utf-8")
    named = named.replace('type = "mfapc"', 'type = "late:Trap"')
    named = re.sub('^name = ""\nfmu = .*$', 'name = "late:Trap"\nfmu = ""', named, flags=re.MULTILINE)
    named = named.replace('label = "mfapc"', f"label = {json.dumps(markup)}")
    reseal(results, named)
    (results / "study.toml").write_text(named, encoding="utf-8")
    done = subprocess.run([program, "report", "results"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not any(sprung.exists() for sprung in traps)
    page = (results / "report.html").read_text(encoding="utf-8")
    assert "late:Trap" in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;\\x1b[31m\\u202e" in page
    assert all(text not in page for text in ("<script>alert", "\x1b", "\u202e"))
