"""What must answer at once does not import what takes long."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from studies import study_text, write

from ddpc_cosim.cli.main import main

HEAVY = {"pandas", "control", "scipy.signal", "sympy", "matplotlib", "vl_convert"}

Run = Callable[..., subprocess.CompletedProcess[str]]

SNOOPERS = """
import json, os, sys
from pathlib import Path
from ddpc_controllers import DeePC, MFAPC, MPC, WKPC

class Snooper:
    def diagnostics(self):  # the last thing that a run asks for
        Path(os.environ["SNOOPED"], type(self).__name__).write_text(json.dumps(list(sys.modules)))
        return super().diagnostics()

class SnoopingMFAPC(Snooper, MFAPC): pass
class SnoopingDeePC(Snooper, DeePC): pass
class SnoopingWKPC(Snooper, WKPC): pass
class SnoopingMPC(Snooper, MPC): pass
"""


def modules_after(code: str, tmp_path: Path) -> set[str]:
    """Return the modules that are loaded in a new process after some code."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport json, sys; print(json.dumps(list(sys.modules)))"],
        cwd=tmp_path,
        env=dict(os.environ),
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_the_package(tmp_path: Path) -> None:
    loaded = modules_after("import ddpc_cosim", tmp_path)
    assert not loaded & (HEAVY | {"numpy", "scipy", "fmpy"})


LIGHT = HEAVY | {"numpy", "scipy", "fmpy", "rich"}
SHOWN = """
import contextlib, io
from ddpc_cosim.cli.main import main
shown = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
    main({})
shown.seek(0)
assert "{}" in shown.read()
"""


def test_the_help_page(tmp_path: Path) -> None:
    assert not modules_after(SHOWN.format(["--help"], "export-controller"), tmp_path) & LIGHT


def test_the_help_page_of_every_command(tmp_path: Path) -> None:
    code = "".join(SHOWN.format([name, "--help"], f"Usage: -c {name}") for name in sorted(main.commands))
    assert not modules_after(code, tmp_path) & LIGHT


def test_a_command_imports_no_other(tmp_path: Path) -> None:
    loaded = modules_after(SHOWN.format(["diff", "--help"], "--rel"), tmp_path)
    commands = {module for module in loaded if module.startswith("ddpc_cosim.cli.commands.")}
    assert commands == {"ddpc_cosim.cli.commands.diff"}


@pytest.mark.parametrize(
    ("line", "completed"), [("ddpc-cosim ex", "export-controller"), ("ddpc-cosim run --o", "--out")]
)
def test_completion_in_a_shell(
    line: str, completed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(line.count(" ")))
    monkeypatch.setenv("_DDPC_COSIM_COMPLETE", "bash_complete")
    code = SHOWN.replace("main({})", 'main(prog_name="ddpc-cosim")').replace("{}", completed)
    assert not modules_after(code, tmp_path) & LIGHT


def test_what_runs_an_fmu(tmp_path: Path) -> None:
    """Every process that loads an FMU pays for it."""
    loaded = modules_after("import ddpc_cosim.fmu.session", tmp_path)
    assert not loaded & (HEAVY | {"scipy"})


def test_a_study_with_faults(tmp_path: Path, paper_text: str) -> None:
    faulty = paper_text.replace("horizon = 5", "horizon = 0").replace('"torque"', '"torqe"')
    (tmp_path / "faulty.toml").write_text(faulty, encoding="utf-8")
    code = "import contextlib\nfrom ddpc_cosim.cli.main import main\n"
    code += "with contextlib.suppress(SystemExit): main(['run', 'faulty.toml'])"
    loaded = modules_after(code, tmp_path)
    assert "ddpc_cosim.study.reading" in loaded
    assert not loaded & HEAVY


def test_writing_and_reading_parquet(tmp_path: Path) -> None:
    """Every worker pays for it."""
    code = "import numpy as np\nfrom pathlib import Path\nfrom ddpc_cosim.files.csv_files import *\n"
    code += "write_table(path := Path('a.parquet'), {'y [m]': np.ones(3)}, {'status': ['ok'] * 3})\n"
    code += "read_parquet(path.read_bytes())"
    loaded = modules_after(code, tmp_path)
    assert "pyarrow.parquet" in loaded
    assert not loaded & HEAVY


FMU_RUNTIME = {"ddpc_cosim.fmu.plant", "ddpc_cosim.fmu.session", "ddpc_cosim.fmu.instance", "fmpy"}


@pytest.mark.parametrize("study", ["paper", "mimo", "monte-carlo"])
def test_a_study_of_equations_is_read_without_anything_of_fmus(tmp_path: Path, study: str) -> None:
    loaded = modules_after(
        f"from ddpc_cosim.study.reading import read_study\nread_study('{study}')", tmp_path
    )
    assert not [module for module in loaded if module.startswith(("ddpc_cosim.fmu.", "fmpy"))]


def test_a_study_of_an_fmu_is_read_without_the_fmu_runtime(tmp_path: Path, pendulum_fmu: Path) -> None:
    write(tmp_path, study_text(plant={"fmu": str(pendulum_fmu), "outputs": ["angle"]}))
    code = "from ddpc_cosim.study.reading import read_study\nread_study('study.toml')"
    loaded = modules_after(code, tmp_path)
    assert "ddpc_cosim.fmu.description.reader" in loaded
    assert not loaded & FMU_RUNTIME


def test_a_simulation(tmp_path: Path, pendulum_fmu: Path) -> None:
    code = "import contextlib\nfrom ddpc_cosim.cli.main import main\n"
    command = ["simulate", pendulum_fmu.as_posix(), "--stop", "1", "--out", "y.csv"]
    code += f"with contextlib.suppress(SystemExit): main({command})"
    loaded = modules_after(code, tmp_path)
    assert (tmp_path / "y.csv").is_file()
    assert not loaded & (HEAVY | {"scipy", "jinja2"})


def test_a_proposal(tmp_path: Path, pendulum_fmu: Path) -> None:
    code = "import contextlib\nfrom ddpc_cosim.cli.main import main\n"
    command = ["init", pendulum_fmu.as_posix(), "--out", "study.toml"]
    code += f"with contextlib.suppress(SystemExit): main({command})"
    loaded = modules_after(code, tmp_path)
    assert (tmp_path / "study.toml").is_file()
    assert not loaded & (HEAVY | {"scipy.linalg", "scipy.special", "scipy.optimize", "jinja2"})


def test_a_command_that_runs_cases_leaves_computing_to_its_workers(
    tmp_path: Path, pendulum_fmu: Path
) -> None:
    write(tmp_path, study_text(plant={"fmu": str(pendulum_fmu), "outputs": ["angle"]}))
    code = "import contextlib\nfrom ddpc_cosim.cli.main import main\n"
    command = ["run", "study.toml", "--out", "runs", "--jobs", "1", "--no-report"]
    code += f"with contextlib.suppress(SystemExit): main({command})"
    loaded = modules_after(code, tmp_path)
    assert (tmp_path / "runs" / "metrics.csv").is_file()
    assert not loaded & (HEAVY | {"scipy.linalg", "scipy.special", "scipy.optimize", "jinja2"})


def test_a_worker_that_runs_cases_of_the_paper(tmp_path: Path, run_program: Run, paper_text: str) -> None:
    (tmp_path / "snoopers.py").write_text(SNOOPERS, encoding="utf-8")
    for name in ("MFAPC", "DeePC", "WKPC"):
        paper_text = paper_text.replace(
            f'"{name.lower()}"\nlabel = "{name}', f'"snoopers:Snooping{name}"\nlabel = "{name}'
        )
    paper_text += '\n[controllers.mpc]\ntype = "snoopers:SnoopingMPC"\n'  # on a model of the recording
    (tmp_path / "study.toml").write_text(paper_text, encoding="utf-8")
    arguments = ("run", "study.toml", "--seeds", "0", "--jobs", "1", "--no-report")
    done = run_program(*arguments, SNOOPED=str(tmp_path))
    assert done.returncode == 0, done.stderr
    for name in ("MFAPC", "DeePC", "WKPC", "MPC"):
        loaded = set(json.loads((tmp_path / f"Snooping{name}").read_text(encoding="utf-8")))
        assert "fmpy" in loaded
        assert not loaded & (HEAVY | {"rich", "click"})
