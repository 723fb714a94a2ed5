"""What is known of a study before its first case is said when it is read, or keeps it from being run."""

import platform
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import studies
from click.testing import CliRunner
from studies import study_text

from ddpc_controllers import PID
from ddpc_cosim import ConfigError, CosimWarning, FMUPlant, MissingLibraryError, Problem, Steps, Study
from ddpc_cosim.cli.main import main
from ddpc_cosim.processes import limits
from ddpc_cosim.study.reading import read_study

LACKING = """
from dataclasses import dataclass
from importlib import import_module
from ddpc_cosim import Controller, MissingLibraryError

@dataclass(kw_only=True)
class Lacking(Controller):
    def __post_init__(self):
        try:
            import_module("a_package_that_is_nowhere")
        except ImportError as error:
            raise MissingLibraryError.of("this", "A Package", "nowhere") from error

    def start(self, loop): ...

    def step(self, sample): ...

@dataclass(kw_only=True)
class Around(Controller):
    inner: object = None

    def start(self, loop): ...

    def step(self, sample): ...
"""
REMEDY = 'this needs A Package: `pip install ".[nowhere]"` or `uv sync --extra nowhere`'
ONE = '[controllers.one]\ntype = "lacking:Lacking"\n'
TWO = '[controllers.two]\ntype = "lacking:Around"\nsettings.inner = { type = "lacking:Lacking" }\n'


def study(seeds: str = "", lowest: float = -170.0, **loop: float) -> str:
    steps = {"kind": "steps", "times": [0.0, 0.2], "values": [20.0, -100.0], "unit": "deg"}
    bounds = {"angle": {"min": lowest, "max": 170.0, "unit": "deg"}}
    return f"{seeds}\n{study_text(reference={'angle': steps}, loop={'duration': 2.0} | loop, bounds=bounds)}"


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lacking.py").write_text(LACKING, encoding="utf-8")

    def write(text: str) -> str:
        return studies.write(tmp_path, text).name

    return write


def said(name: str) -> list[str]:
    """Return the warnings when a study is read."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_study(name)
    assert all(warning.category is CosimWarning for warning in caught)
    return [str(warning.message) for warning in caught]


def test_a_seed_that_may_be_meant_as_a_number_of_seeds_is_told(write: Callable[[str], str]) -> None:
    assert said(write(study("seeds = 3"))) == [
        'seeds = 3 is the one seed number 3; for 3 seeds write "0:3"',
    ]
    for clear in ("", "seeds = 0", "seeds = 1", "seeds = [3]", 'seeds = "3"', 'seeds = "0:3"'):
        assert not said(write(study(clear)))
    problem = Problem(plant="pendulum", sampling_time=0.1, duration=1.0, reference=Steps((0.0,), (1.0,)))
    with pytest.raises(ConfigError, match=r"seeds = 3: needed: a sequence, e\.g\. \[3\] or range\(3\)"):
        Study(problem, {"PID": PID()}, seeds=3)  # type: ignore[arg-type]


BEYOND = "the reference of angle goes down to -100 deg, its lower limit is -70 deg"
CANNOT = "; a controller that keeps to the limit cannot follow the reference there"


def test_a_reference_beyond_the_limit_of_its_output_is_told(write: Callable[[str], str]) -> None:
    assert said(write(study(lowest=-70.0))) == [BEYOND + CANNOT]
    assert not said(write(study(lowest=-100.0)))
    free = '[controllers.free]\ntype = "mfapc"\nbounds.angle = { min = -inf }\n'
    assert said(write(study(lowest=-70.0) + free)) == [f"{BEYOND} (mfapc, nominal){CANNOT}"]
    tight = "[scenarios.wide]\n[scenarios.tight]\nbounds.angle = { max = 10.0, unit = 'deg' }\n"
    assert said(write(study() + tight)) == [
        f"the reference of angle goes up to 20 deg, its upper limit is 10 deg (mfapc, tight){CANNOT}"
    ]


def test_a_reference_beyond_the_limit_is_a_limitation_in_the_report(write: Callable[[str], str]) -> None:
    result = CliRunner().invoke(main, ["run", write(study(lowest=-70.0)), "--out", "out"])
    assert f"warning: {BEYOND}{CANNOT}" in result.stderr
    page = CliRunner().invoke(main, ["report", "out", "--out", "-", "--format", "md"])
    assert f"{BEYOND[:1].upper()}{BEYOND[1:]}: {CANNOT[2:]}." in page.stdout


def test_a_package_that_is_missing_is_told_first_and_the_others_run(write: Callable[[str], str]) -> None:
    (message,) = said(write(study() + ONE + TWO))
    assert message.startswith(REMEDY)
    assert message.endswith("; without, all cases of the controllers one, two will fail, the others are run")
    result = CliRunner().invoke(main, ["run", "study.toml", "--out", "out", "--no-report"])
    assert result.exit_code == 1
    lines = result.stderr.splitlines()
    assert lines[0] == f"warning: {message}"
    # Doing nothing is a case of its own; those that fail before the first sample simulate nothing.
    assert any("4/4 cases, 4 s simulated" in line for line in lines)
    (failed,) = (line for line in lines if f"controller-error: before the first sample: {REMEDY}" in line)
    assert " and 1 more: " in failed


@pytest.mark.parametrize("chosen", [["one"], ["one", "two"]])
def test_where_nobody_can_run_without_it_nothing_is_run(
    write: Callable[[str], str], chosen: list[str]
) -> None:
    only = [word for name in chosen for word in ("--only", name)]
    for more in ([], ["--dry-run"]):
        result = CliRunner().invoke(main, ["run", write(study() + ONE + TWO), "--out", "out", *only, *more])
        assert result.exit_code == 2
        assert f"error: {REMEDY}" in result.stderr
        assert not Path("out").exists()


def test_a_limit_of_memory_that_is_not_looked_at_is_told(
    write: Callable[[str], str], pendulum_fmu: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limited = study(memory_limit=1.5)
    assert not said(write(limited))
    monkeypatch.setattr(limits, "_IS_LOOKED_AT", False)
    monkeypatch.setattr(platform, "system", lambda: "Darwin")
    message = "memory_limit = 1.5 GB does nothing on this system (Darwin): "
    message += "what a process has is looked at on Linux only"
    assert said(write(limited)) == [message]
    assert not said(write(study()))
    result = CliRunner().invoke(main, ["run", write(limited), "--out", "out", "--dry-run"])
    assert result.stderr.splitlines()[0] == f"warning: {message}"
    with pytest.warns(CosimWarning, match=rf"pendulum.*\.fmu: {re.escape(message)}"):
        FMUPlant(pendulum_fmu, isolated=True, memory_limit=1.5).close()


def test_a_stabiliser_that_lacks_a_package_is_an_error(write: Callable[[str], str]) -> None:
    recording = '[recording]\nsamples = 50\nexcitation.torque = { kind = "prbs", low = -1.0, high = 1.0 }\n'
    with pytest.raises(ConfigError, match=r"recording\.controller: this needs A Package"):
        read_study(write(study() + recording + '[recording.controller]\ntype = "lacking:Lacking"\n'))


def test_the_error_is_one_of_configuration() -> None:
    error = MissingLibraryError.of("NMPC", "CasADi", "nmpc")
    assert isinstance(error, ConfigError)
    assert 'NMPC needs CasADi: `pip install ".[nmpc]"`' in str(error)
