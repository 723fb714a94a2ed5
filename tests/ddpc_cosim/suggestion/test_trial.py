"""`init` hands out what it has run: what fails is left out, what is never reached is moved or reported."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from time import monotonic

import pytest
from click.testing import CliRunner
from fmus.builder import (
    CO_SIMULATION,
    INTEGRATOR,
    Fault,
    describe,
    model_library,
    write_fmu,
)

from ddpc_cosim.cli.main import main
from ddpc_cosim.signals.signals import Steps
from ddpc_cosim.study.file_format.sections import ControllerSection
from ddpc_cosim.study.results import load_results
from ddpc_cosim.suggestion import suggest_study, write_study
from ddpc_cosim.suggestion.trial import tried_out
from ddpc_cosim.suggestion.writing import Proposal

pytestmark = pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")


def written(proposal: Proposal, fmu: Path, folder: Path) -> str:
    """Write a study and return its text."""
    return write_study(proposal, fmu, folder / "study.toml").read_text(encoding="utf-8")


def comments(text: str) -> str:
    """Return the comments of a study on one line."""
    return " ".join(line.removeprefix("# ") for line in text.splitlines() if line.startswith("# "))


def run(folder: Path) -> str:
    """Run the study as it was written and return what is printed; it must exit with 0."""
    arguments = ["run", folder / "study.toml", "--out", folder / "results", "--jobs", "1", "--no-report"]
    done = CliRunner().invoke(main, [*map(str, arguments)])
    assert done.exit_code == 0, done.output
    return done.stdout


def only(proposal: Proposal, *keys: str, **more: ControllerSection) -> Proposal:
    return proposal.changed(controllers={key: proposal.study.controllers[key] for key in keys} | more)


def with_steps(proposal: Proposal, steps: Steps, **loop: float) -> Proposal:
    """Return a proposal for one output with other setpoints, and with another loop."""
    (output,) = proposal.setpoints
    return proposal.changed(reference={output: steps}, loop=replace(proposal.study.loop, **loop))


def test_what_cannot_start_is_left_out_with_the_reason_and_the_best_is_named(model_fmu, tmp_path) -> None:
    """A setting that is not possible is found before any run, a recording that is too short by one."""
    fmu = model_fmu("slow_tank")
    proposal = suggest_study(fmu, trial=False)
    broken = ControllerSection(
        type="pid", label="Broken PID", settings={"tuning": "step-test", "pairing": [7]}
    )
    greedy = ControllerSection(type="deepc", label="Greedy DeePC", settings={"horizon": 150, "lambda_g": 1.0})
    proposal = only(proposal, "pid", broken=broken, greedy=greedy)
    text = written(tried_out(proposal, monotonic() + 1000.0, lambda _: None), fmu, tmp_path)
    assert text.startswith("# Tried once; best: PID, step test, ")
    assert set(tomllib.loads(text)["controllers"]) == {"pid"}
    assert "Broken PID is left out: " in comments(text)
    assert re.search("Greedy DeePC is left out: .*recording", comments(text))
    run(tmp_path)
    case = load_results(tmp_path / "results").cases[0]
    left = re.search(r"left of the step at worst: PID, step test ([\d.]+) %", text)
    assert left, text
    assert float(left[1]) == pytest.approx(case.left, rel=0.05)


def test_where_the_output_is_limited_setpoints_are_moved_to_what_was_reached(model_fmu, tmp_path) -> None:
    """The inputs could hold +-36, the parameter y_max = 12 does not let them."""
    fmu = model_fmu("saturating")
    proposal = only(suggest_study(fmu, trial=False), "pid")
    assert max(proposal.setpoints["y"].values) > 20.0
    proved = tried_out(proposal, monotonic() + 1000.0, lambda _: None)
    assert 5.0 < max(proved.setpoints["y"].values) < 12.0
    text = written(proved, fmu, tmp_path)
    assert text.startswith("# Tried once; best: PID, step test, ")
    assert "y does not go above 12 (parameter y_max = 12)" in comments(text)
    assert "No controller settles" not in run(tmp_path)


def test_where_every_controller_fails_the_file_begins_with_it_and_the_likely_reason(
    model_fmu, tmp_path
) -> None:
    """A mass of 1 kg that falls, pushed by at most 1 N against 9.81 N: no authority."""
    fmu = model_fmu("falling")
    proposal = suggest_study(fmu, trial=False)
    proved = tried_out(only(proposal, "pid"), monotonic() + 1000.0, lambda _: None)
    text = written(proved, fmu, tmp_path)
    assert text.startswith("# Every controller fails; in the best run, place ends ")
    assert re.search(r"Likely why: .*place: the inputs move it by .* while they rest", comments(text))
    shown = run(tmp_path).lstrip()
    assert shown.startswith("Every controller fails; in the best run, place ends ")
    assert "place: the inputs move it by" in " ".join(shown.split())


def test_an_output_that_goes_elsewhere_than_in_the_step_test_is_told_with_its_inputs(
    model_fmu, tmp_path
) -> None:
    """x' = u^2 - x: the step test finds 0.1 per unit, and at the limits it is ten times as much."""
    fmu = model_fmu("even")
    proposal = only(suggest_study(fmu, trial=False), "pid")
    proposal = with_steps(proposal, Steps((0.0, 60.0), (-0.05, -0.1)), duration=120.0)
    proved = tried_out(proposal, monotonic() + 1000.0, lambda _: None)
    text = comments(written(proved, fmu, tmp_path))
    match = re.search(r"Likely why: x ends .* test: at (\S+) with push (\S+), where .* say (\S+)\.", text)
    assert match is not None, text
    y, u, expected = map(float, match.groups())
    assert y == pytest.approx(u**2, abs=0.02)
    assert expected == pytest.approx(0.1 * u, abs=0.001)


def test_the_deadline_ends_a_run_that_hangs_and_the_file_says_what_was_not_tried(tmp_path) -> None:
    fmu = write_fmu(
        tmp_path / "hangs.fmu",
        describe("2.0", f"integrator:{Fault.HANG_IN_STEP:d}", INTEGRATOR[:2], interfaces=CO_SIMULATION),
        model_library("2.0"),
    )
    proposal = suggest_study(fmu, step_timeout=0.2, trial=False)
    proved = tried_out(only(proposal, "pid", "mfapc"), monotonic() + 0.5, lambda _: None)
    text = written(proved, fmu, tmp_path)
    remarks = comments(text)
    assert "The time for trying was over before the end of " in remarks
    assert "MFAPC-CFDL (not begun)" in remarks
    # On a slow machine not even the first one begins in time: then none is known to be better than another.
    has_begun = re.search(r"PID[^;]* \(\d+ % of its run\)", remarks) is not None
    kept = {"pid"} if has_begun else {"pid", "mfapc"}
    assert set(tomllib.loads(text)["controllers"]) == kept


def test_where_every_run_fails_the_inputs_keep_to_the_side_that_works(model_fmu, tmp_path) -> None:
    """y is the root of what is in the tank: if more flows out than is there, it is not a number."""
    fmu = model_fmu("one_sided")
    proposal = only(suggest_study(fmu, trial=False), "pid")
    assert proposal.study.bounds["inflow"].min == -1.0
    proved = tried_out(proposal, monotonic() + 1000.0, lambda _: None)
    limits = proved.study.bounds["inflow"]
    assert (limits.min, limits.max) == (0.0, 1.0)
    assert "less, as every run failed" in written(proved, fmu, tmp_path)
    run(tmp_path)


def test_an_fmu_that_fails_after_a_while_is_run_for_as_long_as_it_works(tmp_path) -> None:
    """y' = u, which returns an error from 0.5 s on: recording and loop together have to be shorter."""
    fmu = write_fmu(
        tmp_path / "fails.fmu",
        describe("2.0", f"integrator:{Fault.RETURN_ERROR:d}", INTEGRATOR[:2], interfaces=CO_SIMULATION),
        model_library("2.0"),
    )
    proposal = suggest_study(fmu, trial=False)
    proposal = with_steps(proposal, Steps((0.0, 0.6), (0.01, -0.01)), sampling_time=0.01, duration=1.2)
    proved = tried_out(only(proposal, "pid"), monotonic() + 1000.0, lambda _: None)
    loop, recording = proved.study.loop, proved.study.recording
    assert recording.samples * loop.sampling_time + loop.duration < 0.5
    assert "All in 10 % of the time" in written(proved, fmu, tmp_path)
    run(tmp_path)
