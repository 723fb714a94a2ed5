"""Metrics of third parties: found by entry point, shown where the built-in ones are, and harmless."""

import csv
import importlib
import math
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from studies import study_text, write

from ddpc_cosim import CosimWarning, Trace, load_results, metrics

MODULE = """
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller, Metric, Plant, Trace, Variable, setting

@dataclass(kw_only=True)
class Proportional(Controller):
    gain: float = setting(1.0, low=0.0, doc="gain")
    def start(self, loop): pass
    def step(self, sample): return self.gain * (sample.reference[0] - sample.y)

class FarSighted(Proportional):
    horizon = 30

class Lag(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        self.y = np.zeros(1)
        return self.y
    def step(self, u, h):
        self.y = self.y + h * (u - self.y)
        return self.y

def energy_of(trace):
    return float((trace.u[: trace.held] ** 2).sum() * trace.sampling_time)

def failing_of(trace):
    trace.y[:] = 0.0
    raise ValueError("no such signal")

def leaving_of(trace):
    raise SystemExit(3)

energy = Metric(Trace, "Input energy", "integral of u^2", energy_of, unit="J", better="high")
failing = Metric(Trace, "Failing", "fails", failing_of, unit="1")
leaving = Metric(Trace, "Leaving", "leaves", leaving_of, unit="1")
no_metric = energy_of
of_an_output = Metric(float, "Wrong", "of something else", energy_of, unit="1")
without_unit = Metric(Trace, "No unit", "unit forgotten", energy_of)
"""

STUDY = study_text(
    plant={"name": "measures:Lag"},
    reference={"y": 1.0},
    controllers={
        "p": {"type": "measures:Proportional", "settings": {"gain": 4.0}},
        "q": {"type": "measures:Proportional", "settings": {"gain": 5.0}},
    },
    loop={"duration": 5.0},
)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages, with a third party's one."""
    (tmp_path / "measures.py").write_text(MODULE, encoding="utf-8")
    write(tmp_path, STUDY, "lag.toml")
    monkeypatch.delitem(sys.modules, "measures", raising=False)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    metrics._third_parties.cache_clear()


def install(site: Path, **targets: str) -> None:
    """Install a package with these metrics."""
    info = site / "measures-1.2.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: measures\nVersion: 1.2\n", encoding="utf-8")
    values = {name: target if ":" in target else f"measures:{target}" for name, target in targets.items()}
    lines = [f"{name} = {value}" for name, value in values.items()]
    (info / "entry_points.txt").write_text("\n".join(["[ddpc_cosim.metrics]", *lines, ""]), encoding="utf-8")
    importlib.invalidate_caches()
    metrics._third_parties.cache_clear()


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run(run_program: Run) -> Run:
    """Run the study, in a process of its own: which metrics are installed is looked up once."""

    def run_study(*options: str) -> subprocess.CompletedProcess[str]:
        done = run_program("run", "lag.toml", "--jobs", "1", "--out", "out", *options)
        assert done.returncode == 0, done.stderr
        return done

    return run_study


def rows(site: Path) -> list[dict[str, str]]:
    with (site / "out" / "metrics.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_it_stands_in_files_terminal_report_and_list(site: Path, run: Run, run_program: Run) -> None:
    install(site, energy="energy")
    result = run()
    traces = [case.trace() for case in load_results(site / "out").cases]
    expected = [float((trace.u[:-1] ** 2).sum() * 0.1) for trace in traces]
    assert [float(row["energy [J]"]) for row in rows(site)] == pytest.approx(expected, rel=1e-12)
    assert " energy " in result.stdout
    page = (site / "out" / "report.html").read_text(encoding="utf-8")
    assert "energy: integral of u^2." in page
    listed = run_program("list", "metrics", COLUMNS="200")
    assert listed.returncode == 0
    assert "integral of u^2; [J]; higher is better" in listed.stdout
    assert "measures 1.2 (measures:energy)" in listed.stdout
    assert "settled_error" in listed.stdout


def test_the_one_of_the_documentation(site: Path, run: Run) -> None:
    page = (Path(__file__).parents[2] / "docs" / "extend" / "write-a-metric.md").read_text(encoding="utf-8")
    files = dict(re.findall(r"^```\w+ (\S+)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL))
    (site / "ddpc_effort.py").write_text(files["ddpc_effort.py"], encoding="utf-8")
    ((name, target),) = tomllib.loads(files["pyproject.toml"])["project"]["entry-points"][
        "ddpc_cosim.metrics"
    ].items()
    install(site, **{name: target})
    run("--no-report")
    expected = [float((case.trace().u[:-1] ** 2).sum() * 0.1) for case in load_results(site / "out").cases]
    assert [float(row["effort [J]"]) for row in rows(site)] == pytest.approx(expected)


def test_those_that_fail_cost_their_values_and_are_told(site: Path, run: Run) -> None:
    install(site, energy="energy", mine="failing", other="leaving")
    result = run("--no-report")
    assert [(row["mine [1]"], row["other [1]"]) for row in rows(site)] == [("", "")] * 2
    assert all(float(row["energy [J]"]) > 0 for row in rows(site))
    messages = ("metric mine: ValueError: no such signal", "metric other: SystemExit: 3")
    assert [result.stderr.count(text) for text in messages] == [1, 1]
    for case in load_results(site / "out").cases:
        assert case.warnings == messages
        assert case.trace().y[-1, 0] > 0.7


WRONG = {
    "plain": ("no_metric", "needed: a ddpc_cosim.Metric, got an object of class function"),
    "output": ("of_an_output", "it is of <class 'float'>; needed: ddpc_cosim.Trace"),
    "unitless": ("without_unit", "unit = 'difference'; needed: a unit such as"),
    "lost": ("missing", "AttributeError"),
    "rmse": ("energy", "there is a built-in metric of this name"),
    "in.all": ("energy", "a name may have letters, digits, _ and - only"),
}


def test_what_is_no_metric_is_told_and_listed_as_broken(site: Path, run: Run, run_program: Run) -> None:
    install(site, **{name: target for name, (target, _) in WRONG.items()})
    stderr = run("--no-report").stderr
    listed = run_program("list", "metrics", COLUMNS="200")
    assert listed.returncode == 1
    for name, (_, reason) in WRONG.items():
        assert f"metric {name} (measures 1.2): {reason}" in stderr
        assert f"broken: {reason}" in listed.stdout


def test_one_that_is_installed_later_has_values_without_another_run(site: Path, run: Run) -> None:
    run("--no-report")
    assert "energy [J]" not in rows(site)[0]
    samples = [(case.folder / "signals.csv").stat().st_mtime_ns for case in load_results(site / "out").cases]
    install(site, energy="energy")
    assert "3 kept" in run("--no-report").stderr
    assert all(float(row["energy [J]"]) > 0 for row in rows(site))
    again = [(case.folder / "signals.csv").stat().st_mtime_ns for case in load_results(site / "out").cases]
    assert again == samples


def test_a_single_run_warns(site: Path, run: Run) -> None:
    run("--no-report")
    trace: Trace = load_results(site / "out").cases[0].trace()
    install(site, mine="failing")
    with pytest.warns(CosimWarning, match="metric mine: ValueError: no such signal"):
        assert math.isnan(trace.metrics()["mine [1]"])
    assert trace.y[-1, 0] > 0.7


def test_metrics_follow_what_the_study_says_of_them_and_no_case_runs_again(site: Path, run: Run) -> None:
    """A controller with a longer preview, or other weights, change figures and not samples."""
    run("--no-report")
    folder = load_results(site / "out").cases[0].folder
    before = (folder / "signals.csv").stat().st_mtime_ns
    text = (site / "lag.toml").read_text(encoding="utf-8")
    more = "[controllers.far]\ntype = 'measures:FarSighted'\n[metrics.cost]\noutputs.y = 2.0\n"
    (site / "lag.toml").write_text(text + more, encoding="utf-8")
    result = run("--no-report")
    assert "1 case to run, 3 kept" in result.stderr
    cases = load_results(site / "out").cases
    assert (cases[0].folder, (folder / "signals.csv").stat().st_mtime_ns) == (folder, before)
    for case in cases:
        trace = case.trace()
        error = (trace.reference - trace.y)[:-1, 0]
        assert case.metrics["cost [1]"] == pytest.approx(2.0 * float((error**2).sum()))
        settled = abs(float(error[16:20].mean()))  # the last fifth of 50 - 30 samples
        assert case.metrics["settled_error.y [1]"] == pytest.approx(settled, rel=1e-12)
