"""The benchmark: the same terms for every method, and shares that are those of the samples."""

from itertools import product
from statistics import fmean

import pytest
from studies import run_file

from ddpc_cosim import Outcome, StudyResults
from ddpc_cosim.study.reading import read_study

from .recomputed import read_case

# What its fixture runs is run once, in one process.
pytestmark = pytest.mark.xdist_group("benchmark")

POINTS, BY_MONEY = {"idle", "nmpc"}, "limit-that-pays"
SCENARIOS = ["nominal", "noise", "disturbance", "mismatch", "drift", "tight", "no-preview"]
EVERYWHERE = {"nominal", "noise", "drift", "no-preview"}


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    """Run every controller on every problem once, without noise or anything else that disturbs."""
    return run_file("benchmark", tmp_path_factory.mktemp("benchmark"), jobs=2, seeds=[0], only="nominal")


def test_every_method_meets_the_same_problems_with_the_same_budget_of_tuning() -> None:
    study = read_study("benchmark")
    assert study.head.seeds == [*range(20)]
    for number, problem in enumerate(study.problems.values()):
        scenarios = [*problem.study.scenarios]
        assert scenarios == [name for name in SCENARIOS if name in scenarios]
        assert {*scenarios} >= EVERYWHERE
        assert number >= 10 or scenarios == SCENARIOS
        assert set(problem.study.controllers) == set(study.problems["pendulum"].study.controllers)
        assert problem.study.source
        objectives = set()
        for name, section in problem.study.controllers.items():
            if name == "idle":
                assert section.tuned is None
                continue
            tuned = section.tuned
            assert tuned is not None, (problem.study.name, name)
            assert tuned.settings
            if name != "nmpc" or number < 10:
                assert (tuned.trials, *tuned.seeds) == (48, 100, 101), (problem.study.name, name)
            if name != "nmpc":
                objectives.add(tuned.by)
        assert len(objectives) == 1, problem.study.name


@pytest.mark.slow
def test_what_is_possible_is_reached_and_nothing_done_is_far_from_it(nominal: StudyResults) -> None:
    assert all(case.outcome is Outcome.COMPLETED for case in nominal.cases)
    assert not any(case.failed for case in nominal.cases if case.controller == "nmpc")
    shares = nominal.shares()
    errors = shares[shares["problem"] != BY_MONEY]
    assert (errors["full"] < 0.11 * errors["zero"]).all()
    money = shares[shares["metric"] == "money [EUR]"]
    assert (money["full"] < 0.9 * money["zero"]).all()
    assert len(money)


@pytest.mark.slow
def test_shares_are_those_of_the_samples(nominal: StudyResults) -> None:
    """By the mean of |reference - output| over the samples, from the files of the cases.

    But of the problem that is judged by money, which has no reference.
    """
    errors = {}
    followed = [case for case in nominal.cases if case.problem != BY_MONEY]
    for case in followed:
        run, columns = read_case(case.folder)
        for output in run["outputs"]:
            header = f"{output['name']} [{output['unit'] or '1'}]"
            pairs = zip(columns[f"reference {header}"][:-1], columns[header][:-1], strict=True)
            errors[case.problem, case.controller, output["name"]] = fmean(abs(r - y) for r, y in pairs)
    shares = nominal.shares()
    shares = shares[shares["problem"] != BY_MONEY]
    assert len(shares) == sum(controller not in POINTS for _, controller, _ in errors)
    for row in shares.itertuples():
        signal = row.metric.partition(".")[2].partition(" [")[0]
        zero, full, actual = (errors[row.problem, name, signal] for name in ("idle", "nmpc", row.controller))
        assert row.share == pytest.approx((zero - actual) / (zero - full), rel=1e-9) or row.failed


@pytest.mark.slow
def test_every_method_has_a_figure_for_every_problem(nominal: StudyResults) -> None:
    study = read_study("benchmark").problems
    asked = set(product(study, study["pendulum"].study.controllers))
    assert {(case.problem, case.controller) for case in nominal.cases} == asked


@pytest.mark.slow
def test_what_the_summary_says_holds_without_noise_too(nominal: StudyResults) -> None:
    """It says it of all scenarios and seeds; here are one of each."""
    shares = nominal.shares().groupby(["controller", "problem"])["share"].median().groupby("controller")
    medians = shares.median()
    for name in ("gpc", "mpc", "koopman-mpc", "spc", "gamma-ddpc", "deepc"):
        assert 0.98 < medians[name] < 1.02, name
    assert 0.94 < medians["lqr"] < 0.96
    without = {*medians.index} - {case.controller for case in nominal.cases if case.recorded_samples}
    assert without == {"ipid", "spsa", "mfapc", "mfac"}
    assert all(0.85 < medians[name] < 0.97 for name in (*without, "pid", "wkpc"))
    failed = {
        (case.controller, case.problem) for case in nominal.cases if case.failed and case.controller != "idle"
    }
    on_the_boiler = {(name, "boiler-turbine") for name in ("pid", "spsa", "mfac")}
    late = {(name, "late-reflux") for name in ("mfapc", "mfac")}
    assert failed == {*on_the_boiler, *late, ("mfapc", "van-der-pol"), ("spsa", "non-minimum-phase-tanks")}
