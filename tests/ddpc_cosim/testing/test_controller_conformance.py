"""The conformance kit passes a sound controller and catches each way of breaking the contract."""

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from click.testing import CliRunner, Result

from ddpc_cosim import Action, ConfigError, Controller, FloatArray, Loop, Sample, setting
from ddpc_cosim.cli.main import main
from ddpc_cosim.testing import CONTROLLER_CHECKS, CheckStatus, ControllerConformance, check_controller

_shared: dict[str, Any] = {"count": itertools.count(), "u": None}


@dataclass(kw_only=True)
class Proportional(Controller):
    """A controller as short as the contract admits."""

    gain: float = setting(1.0, low=0.0, doc="inputs per control error")

    def start(self, loop: Loop) -> None:
        self.bounds = loop.bounds

    def step(self, sample: Sample) -> FloatArray | Action:
        u = self.gain * (sample.reference[0] - sample.y)
        return np.asarray(np.clip(u, self.bounds.u_min, self.bounds.u_max))


class TestProportional(ControllerConformance):
    @pytest.fixture
    def make_controller(self) -> type[Controller]:
        return Proportional


def test_every_check_is_a_test_of_the_class() -> None:
    tests = {
        name.removeprefix("test_").replace("_", " ")
        for name in dir(ControllerConformance)
        if name.startswith("test_")
    }
    assert tests == set(CONTROLLER_CHECKS)


class Forgetful(Proportional):
    def settings(self) -> dict[str, Any]:
        return {"gain": 2.0 * self.gain}


class TakesAnything(Proportional):
    def __init__(self, **anything: Any) -> None:
        super().__init__(gain=anything.get("gain", 1.0))


class Unchecked(Proportional):
    def __post_init__(self) -> None:
        pass


class Flat(Proportional):
    def step(self, sample: Sample) -> Any:
        return float(super().step(sample)[0])


class OnlyOne(Proportional):
    def step(self, sample: Sample) -> Any:
        return np.asarray(super().step(sample))[:1]


class ShortRecording(Proportional):
    uses_recording: ClassVar[bool] = True

    def start(self, loop: Loop) -> None:
        super().start(loop)
        if loop.recording is None or len(loop.recording) < 10:
            raise ValueError("ten samples are needed")


class OwnRandomness(Proportional):
    def step(self, sample: Sample) -> Any:
        return np.clip(np.asarray(super().step(sample)) + 1e-3 * next(_shared["count"]) % 0.1, -1.0, 1.0)


class UsesUpItsSeed(Proportional):
    def start(self, loop: Loop) -> None:
        super().start(loop)
        self.rng = loop.rng

    def step(self, sample: Sample) -> Any:
        return np.clip(np.asarray(super().step(sample)) + self.rng.uniform(-0.01, 0.01, 1), -1.0, 1.0)


class Remembers(Proportional):
    seen = 0

    def step(self, sample: Sample) -> Any:
        self.seen += 1
        return np.asarray(super().step(sample)) / (1 + self.seen)


class HoldsAFunction(Proportional):
    def start(self, loop: Loop) -> None:
        super().start(loop)
        self.law = lambda error: self.gain * error


class SharesItsState(Proportional):
    def step(self, sample: Sample) -> Any:
        before = _shared["u"] if sample.k else None
        _shared["u"] = super().step(sample)
        return _shared["u"] if before is None else 0.5 * (before[: len(sample.y)] + _shared["u"])


class KeepsTheSample(Proportional):
    before: FloatArray | None = None

    def start(self, loop: Loop) -> None:
        super().start(loop)
        self.before = None

    def step(self, sample: Sample) -> Any:
        mean = sample.y if self.before is None else 0.5 * (sample.y + self.before)
        self.before = sample.y
        return super().step(sample._replace(y=mean))


class ChangesTheSample(Proportional):
    def step(self, sample: Sample) -> Any:
        sample.reference[:] *= 0.5
        return super().step(sample)


class Unlimited(Proportional):
    def step(self, sample: Sample) -> Any:
        return self.gain * (sample.reference[0] - sample.y)


class Gives(Proportional):
    def step(self, sample: Sample) -> Any:
        if np.abs(sample.y).max() > 2.0:
            raise ArithmeticError("no solution")
        return super().step(sample)


class PassesOverNaN(Proportional):
    def step(self, sample: Sample) -> Any:
        return super().step(sample._replace(y=np.nan_to_num(sample.y)))


class ClaimsToSurviveNaN(Proportional):
    accepts_missing: ClassVar[bool] = True


class Single(Proportional):
    def start(self, loop: Loop) -> None:
        super().start(loop)
        if len(loop.inputs) > 1:
            raise ConfigError("Single: one input only")


class WrongWay(Proportional):
    def step(self, sample: Sample) -> Any:
        return -np.asarray(super().step(sample))


class ChangesItsHorizon(Proportional):
    def start(self, loop: Loop) -> None:
        super().start(loop)
        self.horizon = 5


class LivesOnPreview(Proportional):
    def start(self, loop: Loop) -> None:
        super().start(loop)
        self.gain *= loop.preview


class SeesNoSeam(Proportional):
    uses_recording: ClassVar[bool] = True

    def start(self, loop: Loop) -> None:
        super().start(loop)
        assert loop.recording is not None
        u, y = loop.recording.u, loop.recording.y
        known = np.hstack([u[:-1], y[:-1]])
        self.gain *= float(np.linalg.lstsq(known, y[1:], rcond=None)[0][0, 0])


@pytest.mark.parametrize(
    ("controller", "check", "reason"),
    [
        (Forgetful, "stores its settings", "gain = 2.0 comes back as 4.0"),
        (TakesAnything, "refuses unknown settings", "accepts no_such_setting"),
        (Unchecked, "refuses impossible settings", "gain = -1.0 is accepted"),
        (Flat, "returns one input for one output", "step returned float"),
        (OnlyOne, "returns two inputs for two outputs", r"shape \(1,\); needed: .* shape \(2,\)"),
        (ShortRecording, "starts with the recording it asks for", "ten samples are needed"),
        (OwnRandomness, "is deterministic under its seed", "use loop.rng only"),
        (UsesUpItsSeed, "forgets a run when started again", "after a second start"),
        (Remembers, "forgets a run when started again", "after a second start"),
        (HoldsAFunction, "can be pickled", "lambda"),
        (SharesItsState, "two instances are independent", "beside another instance"),
        (KeepsTheSample, "keeps no array that it is given", "copy what you keep"),
        (ChangesTheSample, "returns one input for one output", "step changed sample.reference"),
        (Unlimited, "respects the input limits", r"where 0\.2 is allowed"),
        (Gives, "reports a failure as a status", "raised ArithmeticError .* an Action with a status"),
        (PassesOverNaN, "handles a missing measurement as declared", "without a status"),
        (ClaimsToSurviveNaN, "handles a missing measurement as declared", "are .nan"),
        (WrongWay, "stabilises the reference plant", r"begin \[0\.5\] off"),
        (ChangesItsHorizon, "knows its horizon before its start", "from 1 to 5; set it before"),
        (LivesOnPreview, "stabilises it without preview", r"begin \[0\.5\] off"),
        (SeesNoSeam, "learns from no window across a seam", r"recording\.seams: see recording\.pieces"),
    ],
)
def test_each_breach_is_caught_and_named(controller: Any, check: str, reason: str) -> None:
    failed = {r.name: r.reason for r in check_controller(controller) if r.status is CheckStatus.FAILED}
    assert check in failed
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(failed[check])


def test_what_does_not_apply_says_why() -> None:
    results = {result.name: result for result in check_controller(Proportional)}
    recorded = results["starts with the recording it asks for"]
    assert (recorded.status, recorded.reason) == (CheckStatus.NOT_APPLICABLE, "it does not use a recording")


def test_a_controller_of_one_loop_may_refuse_two() -> None:
    results = {result.name: result for result in check_controller(Single)}
    assert "one input only" in results["returns two inputs for two outputs"].reason
    assert all(result.status is not CheckStatus.FAILED for result in results.values())


def test_one_that_starts_nowhere_fails_with_both_reasons() -> None:
    class Never(Proportional):
        def start(self, loop: Loop) -> None:
            raise ConfigError("Never: it is too late")

    results = {result.name: result for result in check_controller(Never)}
    reason = results["stabilises the reference plant"].reason
    assert reason.count("it is too late") == 2


def check(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["check", *map(str, arguments)])


def test_the_command_checks_controllers_by_name_and_target() -> None:
    passed = check("mfapc")
    assert passed.exit_code == 0, passed.output
    assert [line.split("\t")[1] for line in passed.output.splitlines()] == list(CONTROLLER_CHECKS)
    assert check("ddpc_controllers:PID").exit_code == 0


def test_the_command_fails_with_a_breach(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = """
        from ddpc_cosim import Controller
        class Constant(Controller):
            def start(self, loop):
                pass
            def step(self, sample):
                return [0.0]
    """
    (tmp_path / "lists.py").write_text("\n".join(line[8:] for line in source.splitlines()), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    result = check("lists:Constant")
    assert result.exit_code == 1
    assert "failed\treturns one input for one output\tstep returned list" in result.output


def test_settings_on_the_command_line_are_those_of_a_study() -> None:
    missing = check("scaled")
    assert missing.exit_code == 2
    assert "scaled: controller: required setting is missing; give" in missing.stderr
    assert "--setting" in missing.stderr
    assert check("scaled", "--setting", 'controller = { type = "pid" }').exit_code == 0
    assert "not TOML" in check("pid", "--setting", "tuning = step-test").stderr
    assert "not TOML" in check("pid", "--setting", f"tuning = {5000 * '['}").stderr
    # The first would take a minute to read.
    for deep in (".".join(20_000 * "a"), f"[{'.'.join(60 * 'a')}]\n{'.'.join(60 * 'b')}"):
        refused = check("pid", "--setting", f"{deep} = 1")
        assert refused.exit_code == 2
        assert "error: --setting: tables within tables; allowed: 100 levels" in refused.stderr


def test_a_constructor_that_never_returns_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = """
        from ddpc_cosim import Controller
        class Endless(Controller):
            def __init__(self):
                while True:
                    pass
            def start(self, loop):
                pass
            def step(self, sample):
                return [0.0]
    """
    (tmp_path / "loops.py").write_text("\n".join(line[8:] for line in source.splitlines()), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    result = check("loops:Endless", "--timeout", "0.5")
    assert result.exit_code == 2
    assert "loops:Endless: timed out: no return within 0.5 s in constructor; raise --timeout" in result.stderr


def test_an_unknown_name_lists_what_there_is() -> None:
    result = check("mfapcc")
    assert result.exit_code == 2
    assert 'no plant or controller "mfapcc"; did you mean "mfapc"?' in result.stderr
