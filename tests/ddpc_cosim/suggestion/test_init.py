"""`init` writes studies that run at once, whatever the plant's time scale, gain and nature."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from click.testing import CliRunner, Result

from ddpc_cosim import ConfigError, CosimError, FMUImportError, Outcome, load_results
from ddpc_cosim.cli.main import main
from ddpc_cosim.description import describe
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.suggestion import check_identified, suggest_study, write_study
from ddpc_cosim.suggestion.choice import Choice, choose
from ddpc_cosim.suggestion.design import Range, setpoints
from ddpc_cosim.suggestion.operating_point import TriedPoint, _chosen
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.response_types import Response, ResponseType
from ddpc_cosim.suggestion.roles import Roles
from ddpc_cosim.suggestion.step_test import StepTest, Timing
from ddpc_cosim.suggestion.writing import study_text
from ddpc_cosim.variables import Variable, names


def ddpc(*arguments: object) -> Result:
    return CliRunner().invoke(main, [*map(str, arguments)])


@pytest.fixture
def study_of(model_fmu, tmp_path: Path):
    """Write the study of a model and read it as plain TOML."""

    def write(name: str) -> dict[str, Any]:
        path = write_study(
            suggest_study(model_fmu(name), trial=False), model_fmu(name), tmp_path / f"{name}.toml"
        )
        return tomllib.loads(path.read_text(encoding="utf-8"))

    return write


@pytest.mark.parametrize("name", ["two_by_two", "slow_tank", "fast_pendulum", "integrator"])
def test_the_study_runs_and_deepc_reaches_the_setpoints(name, study_of, tmp_path) -> None:
    study = study_of(name)
    folder = tmp_path / "results"
    result = ddpc("run", tmp_path / f"{name}.toml", "--out", folder, "--jobs", 1, "--no-report")
    assert result.exit_code == 0, result.output
    cases = load_results(folder).cases
    assert {case.controller for case in cases} == {"deepc", "mfapc", "mpc", "pid"}
    assert {case.outcome for case in cases} == {Outcome.COMPLETED}
    reached = next(case for case in cases if case.controller == "deepc").trace().y[-1]
    for y, reference in zip(reached, study["reference"].values(), strict=True):
        values = reference["values"]
        assert y == pytest.approx(values[-1], abs=0.03 * np.ptp(values))


@pytest.mark.parametrize(
    ("name", "sampling_time"),
    [
        ("two_by_two", 0.2),  # the slower time constant is 3 s, the faster one 1.5 s
        ("slow_tank", 200.0),  # T = 1.5 / (2e-3 / 2) = 1500 s
        ("fast_pendulum", 5e-4),  # 1000 rad/s
        ("integrator", 0.2),  # behind a lag of 0.5 s
        ("pendulum", 0.1),  # 7 rad/s; the paper's sampling time
    ],
)
def test_the_sampling_time_follows_the_plant(name, sampling_time, model_fmu) -> None:
    assert suggest_study(model_fmu(name), trial=False).sampling_time == pytest.approx(sampling_time, rel=1.01)


def test_only_what_can_be_held_is_controlled(model_fmu) -> None:
    """A pendulum's rate returns to zero whatever the torque is: it is measured, the angle is controlled."""
    proposal = suggest_study(model_fmu("fast_pendulum"), trial=False)
    assert [v.name for v in proposal.outputs] == ["angle"]
    assert [v.name for v in proposal.measurements] == ["angle", "rate"]


def test_not_more_outputs_than_inputs_are_controlled(model_fmu) -> None:
    proposal = suggest_study(model_fmu("two_by_two"), inputs=["u1"], trial=False)
    assert len(proposal.outputs) == 1
    assert len(suggest_study(model_fmu("two_by_two"), trial=False).outputs) == 2


def test_limits_are_the_declared_ones_or_called_a_guess(study_of, tmp_path) -> None:
    bounds = study_of("two_by_two")["bounds"]
    assert bounds == {"u1": {"min": -10.0, "max": 10.0}, "u2": {"min": 0.0, "max": 1.0}}
    assert study_of("pendulum")["bounds"] == {"torque": {"min": -1.0, "max": 1.0}}
    study_of("fast_pendulum")
    guess_by_nominal = (tmp_path / "fast_pendulum.toml").read_text(encoding="utf-8")
    declares_nothing = (tmp_path / "pendulum.toml").read_text(encoding="utf-8")
    assert "guessed: the FMU declares neither range nor nominal value" in declares_nothing
    assert "guessed: start value +- nominal value" in guess_by_nominal


def test_setpoints_are_within_reach_of_the_inputs(study_of) -> None:
    """The gains of the tank: level = (inflow / 2e-3)^2 in rest."""
    values = study_of("slow_tank")["reference"]["level"]["values"]
    assert max(values) < (4e-3 / 2e-3) ** 2
    assert 0.0 < min(values) < 1.0 < max(values)
    values = study_of("two_by_two")["reference"]
    # y1 = 5 + 2 u1 + 0.5 u2, y2 = 100 (0.4 u1 - 30 u2), with |u1| <= 10 and 0 <= u2 <= 1
    assert np.max(np.abs(np.array(values["y1"]["values"]) - 5.0)) < 20.0
    assert -3000.0 < min(values["y2"]["values"]) < max(values["y2"]["values"]) < 0.0


@pytest.mark.parametrize(
    ("low", "high", "rest", "lowest", "highest"),
    [
        (0.0, 2.0, 1.0, 0.5, 1.5),  # a tank of 2 m, half full, whose pump could empty or flood it
        (0.0, 2.0, 0.4, 0.2, 1.2),
        (0.0, np.inf, 1.0, 0.5, 7.0),  # 6: what the inputs can hold
        (-np.inf, np.inf, 1.0, -5.0, 7.0),
        (0.0, 2.0, 0.0, 0.05, 1.05),  # empty at first: 5 % are kept from the limit
    ],
)
def test_setpoints_leave_as_much_room_to_the_limits_as_they_take(
    low: float, high: float, rest: float, lowest: float, highest: float
) -> None:
    integrating = Response(ResponseType.INTEGRATING, effect=30.0, slope=1.0, rise_time=0.0, peak=30.0)
    tested = StepTest(
        time=np.arange(1.0, 31.0),
        rest=np.full((30, 1), rest),
        steps=np.ones(1),
        responses=((integrating,),),
    )
    choice = Choice((0,), (0,), np.ones((1, 1)), 10.0, False)
    working = Range(np.zeros(1), np.full(1, -10.0), np.full(1, 10.0))
    level = Variable("level", "m", min=low, max=high)
    references, _ = setpoints(tested, choice, [level], working, 1.0, Request())
    values = references["level"].values
    assert (min(values), max(values)) == pytest.approx((lowest, highest), abs=0.01 * (highest - lowest))


def test_an_unstable_plant_gets_no_open_loop_experiment(study_of, tmp_path) -> None:
    study = study_of("unstable")
    assert "recording" not in study
    assert set(study["controllers"]) == {"mfapc"}
    text = (tmp_path / "unstable.toml").read_text(encoding="utf-8")
    assert "doubling every 0.231 s (unstable)" in text  # log(2) / 3
    assert "has to be stabilised first" in text.replace("\n# ", " ")


def test_what_falls_over_is_taken_for_unstable_though_it_comes_to_rest_elsewhere(study_of) -> None:
    """The inverted pendulum falls and hangs: its response is bounded, but does not shrink with the step."""
    study = study_of("cart_pendulum")
    assert study["plant"]["outputs"] == ["angle"]
    first, then = study["reference"]["angle"]["values"]
    assert first == 0.0
    assert 0.0 < then < 0.5  # a small step, by which it can be judged whether any controller settles
    assert "recording" not in study
    assert study["loop"]["sampling_time"] < 0.1  # it doubles its angle in 0.13 s


@pytest.mark.parametrize("name", ["pure_integrator", "static"])
def test_a_plant_without_a_time_scale_gets_a_guess_that_says_so(name, study_of, tmp_path) -> None:
    study_of(name)
    text = (tmp_path / f"{name}.toml").read_text(encoding="utf-8").replace("\n# ", " ")
    assert "the sampling time is a guess" in text
    loop = read_study(str(tmp_path / f"{name}.toml")).problem.study.loop
    assert loop.sampling_time == pytest.approx(0.05, rel=2)


def test_an_fmu_that_does_not_respond_is_refused(model_fmu) -> None:
    with pytest.raises(
        CosimError, match=r"no output responds .*\(tried: push from 0 to 2\); --range tries more"
    ):
        suggest_study(model_fmu("deaf"))


def test_an_fmu_without_inputs_or_outputs_is_refused(model_fmu, mutate) -> None:
    fmu = mutate(model_fmu("deaf"), ('causality="input"', 'causality="local"'))
    with pytest.raises(ConfigError, match="no input that is a number: there is nothing to drive; `simulate`"):
        suggest_study(fmu)
    fmu = mutate(model_fmu("static"), ('causality="output"', 'causality="local"'))
    with pytest.raises(
        ConfigError, match=r"nothing to control; local variables may serve, with --output: .*y"
    ):
        suggest_study(fmu)


def test_an_fmu_that_cannot_run_is_refused_with_its_defects(pendulum_fmu, mutate) -> None:
    fmu = mutate(pendulum_fmu, ('fmiVersion="2.0"', 'fmiVersion="4.0"'))
    with pytest.raises(FMUImportError, match="the FMI version is not one that can run here"):
        suggest_study(fmu)


def test_an_unknown_signal_is_a_fault(pendulum_fmu) -> None:
    with pytest.raises(ConfigError, match='did you mean "torque"'):
        suggest_study(pendulum_fmu, inputs=["torqe"])


def test_a_file_that_is_there_is_kept(pendulum_fmu, tmp_path) -> None:
    out = tmp_path / "study.toml"
    out.write_text("precious", encoding="utf-8")
    refused = ddpc("init", pendulum_fmu, "--out", out)
    assert refused.exit_code == 2
    assert "--force" in refused.stderr
    assert out.read_text(encoding="utf-8") == "precious"
    assert ddpc("init", pendulum_fmu, "--out", out, "--force").exit_code == 0
    assert names(read_study(str(out)).problem.inputs) == ("torque",)


def test_the_fmu_is_named_relative_to_the_study(pendulum_fmu, tmp_path) -> None:
    (tmp_path / "plants").mkdir()
    fmu = tmp_path / "plants" / "my plant é.fmu"
    fmu.write_bytes(pendulum_fmu.read_bytes())
    done = ddpc("init", fmu, "--out", tmp_path / "studies" / "first.toml")
    assert done.exit_code == 0, done.output
    assert f"run it: ddpc-cosim run {tmp_path / 'studies' / 'first.toml'}" in done.stdout
    text = (tmp_path / "studies" / "first.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["plant"]["fmu"] == "../plants/my plant é.fmu"


def test_descriptions_cannot_break_out_of_their_comments(pendulum_fmu, mutate, tmp_path) -> None:
    fmu = mutate(pendulum_fmu, ('description="Applied torque"', 'description="a &#10;[bounds]&#10;x = 1"'))
    path = write_study(suggest_study(fmu, trial=False), fmu, tmp_path / "study.toml")
    assert set(tomllib.loads(path.read_text(encoding="utf-8"))["bounds"]) == {"torque"}


def test_an_output_of_which_nothing_lasts_can_be_asked_for(model_fmu) -> None:
    """A rate has no gain for good: its peak says how far it goes, where nothing was said of it: infinity."""
    proposal = suggest_study(model_fmu("fast_pendulum"), outputs=["rate", "angle"], trial=False)
    text = study_text(proposal, "plant.fmu")
    assert not re.search(r"\b(nan|inf)\b", "\n".join(line for line in text.splitlines() if line[:1] != "#"))
    assert 0.0 < proposal.study.plant.nominal["rate"] < np.inf


def test_a_meter_that_answers_before_the_room_is_no_setpoint_where_time_was_over() -> None:
    """Of what is read, one does not know in that case."""
    still, moved = Response(ResponseType.INSENSITIVE), Response(ResponseType.SETTLED, 1.0, peak=1.0)
    inputs, outputs = (Variable("u"),), (Variable("TRoom", "K"), Variable("energy", "J"))
    plant = cast(
        FMUPlant, SimpleNamespace(inputs=inputs, outputs=outputs, description=describe(inputs, outputs))
    )
    tested = StepTest(np.arange(24.0), np.zeros((24, 2)), np.ones(1), ((still,), (moved,)))
    rest = (np.ones(1), Timing(1e-4, longest=1.0), Request(), Roles(("u",)))
    chosen, _ = _chosen(plant, tested, *rest)
    assert chosen.outputs == (1,)
    chosen, _ = _chosen(plant, replace(tested, stopped=True), *rest)
    assert chosen.outputs == ()


@pytest.mark.parametrize(
    ("stopped", "words"),
    [(False, r"y to a step of an input; leave it out"), (True, "was identified in time.* raise --budget")],
)
def test_an_output_without_a_response_is_not_proposed(stopped: bool, words: str) -> None:
    responses = ((Response(ResponseType.INSENSITIVE),), (Response(ResponseType.SETTLED, 1.0, peak=1.0),))
    tested = StepTest(np.arange(24.0), np.zeros((24, 2)), np.ones(1), responses, stopped=stopped)
    point = TriedPoint(
        inputs=(Variable("u"),),
        outputs=(Variable("y"), Variable("z")),
        warnings=(),
        start={},
        bounds={},
        rest=np.zeros(1),
        room=np.ones(1),
        timing=Timing(1e-4, longest=1.0),
        request=Request(),
        tested=tested,
        choice=choose(tested, np.ones(1), 1.0, all_outputs=True),
    )
    with pytest.raises(CosimError, match=words):
        check_identified("plant.fmu", point)
