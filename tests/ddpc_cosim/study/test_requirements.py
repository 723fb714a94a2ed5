"""Requirements in a study: read, written, shared by problems, left out of what decides a result."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from ddpc_cosim import ConfigError, Problem, Steps, Study, load_results
from ddpc_cosim.cli.main import main
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.reading import read_study
from tests.studies import cases_in, run_file, study_text, write

ERROR = "mean_abs_error"


def test_all_faults_are_told_at_once_each_with_its_place(tmp_path: Path) -> None:
    text = """
extends = "paper"
[requirements]
share = 1.2
controllers = ["wkcp"]
overshoot.angel = { max = 5.0 }
overshoot.angle = { max = 5.0, min = 7.0, scenarios = ["x"] }
settling_time.angle = { max = 5.0, unit = "m" }
overshot.angle = { max = 5.0 }
band_violation.angle = { max = 5.0 }
rms_change.angle = { max = 1 }
money = { max = 1 }
cost = { max = 1 }
rmse.angle = {}
"max_abs_error.angle" = { max = 1 }
failures = { max = 1, share = -1 }
[report]
baseline = "deepC"
"""
    with pytest.raises(ConfigError) as caught:
        read_study(str(write(tmp_path, text)))
    told = [fault.partition(": ")[2] for fault in caught.value.faults]
    assert told == [
        "requirements.share: must be less than or equal to 1, got 1.2",
        'requirements.controllers: no controller "wkcp"; did you mean "wkpc"?',
        'requirements.overshoot.angel: no controlled output "angel"; did you mean "angle"?',
        "requirements.overshoot.angle: min (7) is above max (5)",
        'requirements.overshoot.angle.scenarios: no scenario "x"; there are: nominal',
        'requirements.settling_time.angle.unit: unit "m" does not fit settling_time.angle [s]; needed: '
        "one of the same quantity",
        'requirements.overshot: unknown key; did you mean "overshoot"?',
        "requirements.band_violation.angle: angle has a reference; band_violation is of an output with a "
        "band",
        'requirements.rms_change.angle: no input "angle"; there are: torque',
        "requirements.money: the study has no money; it needs prices",
        "requirements.cost: the study has no cost; it needs weights, metrics.cost",
        "requirements.rmse.angle: needs min or max",
        "requirements.max_abs_error.angle: unknown key; max_abs_error and the signal are two keys: "
        "max_abs_error.angle, without quotes around both",
        "requirements.failures.share: must be greater than or equal to 0, got -1",
        'report.baseline: no controller "deepC"; did you mean "deepc"?',
    ]


def test_what_is_paid_and_what_has_a_band_can_be_required(tmp_path: Path) -> None:
    price = {"signal": "torque", "unit": "EUR/N.m.s", "price": 1.0}
    limits = {"money": {"max": 1e9, "unit": "EUR"}, "energy": {"max": 1.0}, "emissions": {"max": 1.0}}
    text = study_text(prices={"wear": price}, requirements=limits)
    with pytest.raises(ConfigError) as caught:
        read_study(str(write(tmp_path, text)))
    assert [fault.partition(": ")[2] for fault in caught.value.faults] == [
        "requirements.energy: the study has no energy; it needs a price of energy",
        "requirements.emissions: the study has no emissions; it needs emissions of a price",
    ]
    text = """
extends = "prices"
[requirements]
money = { max = 1e9 }
energy = { max = 1, unit = "MJ" }
peak = { max = 1, unit = "W" }
emissions = { max = 1, unit = "g" }
band_violation.indoor_temperature = { max = 1, unit = "K.s" }
overshoot.indoor_temperature = { max = 1 }
"""
    with pytest.raises(ConfigError) as caught:
        read_study(str(write(tmp_path, text)))
    assert [fault.partition(": ")[2] for fault in caught.value.faults] == [
        "requirements.overshoot.indoor_temperature: indoor_temperature has a band; overshoot is of an output "
        "with a reference"
    ]


def test_requirements_decide_no_result(tmp_path: Path) -> None:
    plain = write(tmp_path, study_text(), "plain.toml")
    required = write(tmp_path, study_text(requirements={ERROR: {"angle": {"max": 1.0}}}), "required.toml")
    assert [case.id for case in cases_in(plain)] == [case.id for case in cases_in(required)]


@pytest.mark.parametrize(
    ("most", "controllers", "code"), [(1e-9, [], 1), (1e9, [], 0), (1e9, ["mfapc"], 0), (1e-9, ["mfapc"], 1)]
)
def test_a_run_fails_if_requirements_are_not_met_and_a_report_does_not(
    tmp_path: Path, most: float, controllers: list[str], code: int
) -> None:
    requirements = {"controllers": controllers, ERROR: {"angle": {"max": most}}}
    file = write(tmp_path, study_text(requirements=requirements, loop={"duration": 10.0}))
    out = tmp_path / "out"
    done = CliRunner().invoke(main, ["run", str(file), "--out", str(out), "--jobs", "1", "--no-report"])
    assert done.exit_code == code, done.output
    words = "Requirements: passed" if code == 0 else "Requirements: not passed"
    assert words in " ".join(done.output.split())
    made = CliRunner().invoke(main, ["report", str(out), "--format", "md"])
    assert made.exit_code == 0, made.output
    assert words in (out / "report.md").read_text(encoding="utf-8")
    frame = load_results(out).requirements()
    assert [*frame.is_met] == [code == 0]
    assert [*frame.metric] == ["mean_abs_error.angle [deg]"]


def test_a_folder_with_a_requirement_on_a_metric_that_is_gone_can_be_reported(tmp_path: Path) -> None:
    file = write(tmp_path, study_text(requirements={ERROR: {"angle": {"max": 1e9}}}))
    whole = run_file(file).whole
    tables = whole.tables()
    tables["requirements"]["metric_of_others"] = {"max": 1.0, "unit": "", "scenarios": []}
    (study,) = WholeStudy.of_tables(tables).problems.values()
    assert study.requirements is not None
    assert [entry.metric for entry in study.requirements.required] == [ERROR, "metric_of_others"]


def test_what_is_required_of_all_problems_is_replaced_signal_by_signal(tmp_path: Path) -> None:
    text = """
[problems.one]
study = "paper"
[problems.one.requirements]
overshoot.angle = { max = 1.0 }
controllers = []
[problems.two]
study = "paper"
[requirements]
controllers = ["pid"]
overshoot.angle = { max = 5.0 }
settling_time.angle = { max = 2.0 }
[controllers.pid]
type = "pid"
"""
    resolved = read_study(str(write(tmp_path, text)))
    one, two = (problem.study.requirements for problem in resolved.problems.values())
    assert one is not None
    assert two is not None
    limits = {(entry.metric, entry.section.max) for entry in one.required}
    assert limits == {("overshoot", 1.0), ("settling_time", 2.0)}
    assert (one.controllers, two.controllers) == ([], ["pid"])
    wrong = text.replace("settling_time.angle", "settling_time.angel")
    with pytest.raises(ConfigError, match=r"study.toml:\d+: requirements.settling_time.angel: no controlled"):
        read_study(str(write(tmp_path, wrong)))


def test_a_study_that_extends_another_replaces_a_signal_alone(tmp_path: Path) -> None:
    required = {"rmse": {"angle": {"max": 1.0}}, ERROR: {"angle": {"max": 2.0}}}
    write(tmp_path, study_text(requirements=required), "base.toml")
    changed = 'extends = "base.toml"\n[requirements]\nrmse.angle = { min = 0.5 }\n'
    study = read_study(str(write(tmp_path, changed))).problem.study
    assert study.requirements is not None
    limits = {entry.metric: (entry.section.min, entry.section.max) for entry in study.requirements.required}
    assert limits == {"rmse": (0.5, None), ERROR: (None, 2.0)}
    none = write(tmp_path, 'extends = "base.toml"\nrequirements = false\n')
    assert read_study(str(none)).problem.study.requirements is None


def test_variants_by_a_sweep_are_not_judged(tmp_path: Path) -> None:
    requirements = {"controllers": ["mfapc"], ERROR: {"angle": {"max": 1e-9}}}
    text = study_text(requirements=requirements, sweep={"loop.sampling_time": [0.05]})
    problems = read_study(str(write(tmp_path, text))).problems
    assert [problem.study.requirements is None for problem in problems.values()] == [False, True]


def test_python_says_the_same_as_a_file(tmp_path: Path) -> None:
    problem = Problem(
        plant="pendulum",
        inputs=["torque"],
        outputs=["angle"],
        sampling_time=0.1,
        duration=1.0,
        reference=Steps([0.0], [0.1]),
        requirements={"overshoot.angle": {"max": 5.0, "share": 0.5}, "failures": {"max": 3}},
    )
    study = Study(problem, {"MFAPC": "mfapc"}, requirements={"share": 0.9, "rmse.angle": {"max": 1.0}})
    written = read_study(str(study.write(tmp_path / "study.toml"))).problem
    section = written.study.requirements
    assert section is not None
    shares = {entry.metric: section.share_of(entry.section) for entry in section.required}
    assert shares == {"rmse": 0.9, "overshoot": 0.5, "failures": 0.9}
    assert cases_of(written, written.plant.built())
    problems = Study({"p": problem, "q": problem}, {"MFAPC": "mfapc"}, requirements={"share": 0.9})
    for resolved in read_study(str(problems.write(tmp_path / "two.toml"))).problems.values():
        assert resolved.study.requirements is not None
        assert resolved.study.requirements.share == 0.9
