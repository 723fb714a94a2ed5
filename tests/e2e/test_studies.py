"""The built-in studies show what their summaries say."""

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studies import folder_of_runs, run_file

from ddpc_cosim import CaseResult, FloatArray, Outcome, StudyResults
from ddpc_cosim.study.reading import read_study
from fmu_plants import cstr
from fmu_plants.linear import linearise

from .recomputed import figures_of, verdict

# What its fixtures run or build is run and built in one process.
pytestmark = pytest.mark.xdist_group("studies")

STUDIES = Path(__file__).parents[2] / "ddpc_cosim" / "studies"
COMPARATIVE = ("direction-change", "mimo", "noise", "reactor", "time-varying", "unstable")
# Those that have tests of their own.
ELSEWHERE = ("benchmark", "buildings", "forecast", "paper", "prices")
LONG = ("direction-change", "mimo", "noise", "time-varying", "tuning", "unstable")
BUILT_IN = [
    pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
    for name in sorted(path.stem for path in STUDIES.glob("*.toml"))
    if name not in ELSEWHERE
]

PREDICTIVE = ("deepc", "spc", "gamma-ddpc", "koopman-mpc", "mpc")


@pytest.fixture(scope="module")
def results_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], StudyResults]:
    """Run a study on some of its seeds, once."""
    done: dict[str, StudyResults] = {}

    def run(name: str) -> StudyResults:
        if name not in done:
            study, folder = STUDIES / f"{name}.toml", folder_of_runs(name, tmp_path_factory.mktemp(name))
            seeds = read_study(str(study)).problem.study.seeds[: 3 if name in COMPARATIVE else 1]
            done[name] = run_file(study, folder, jobs=2, seeds=seeds)
        return done[name]

    return run


Results = Callable[[str], StudyResults]


def cases_of(results: StudyResults, scenario: str, *controllers: str) -> list[CaseResult]:
    """Return the cases of controllers, by default of all, in a scenario; there are some of each."""
    cases = [case for case in results.cases if case.scenario == scenario]
    cases = [case for case in cases if not controllers or case.controller in controllers]
    assert {case.controller for case in cases} >= set(controllers)
    return cases


def medians(results: StudyResults, scenario: str, figure: Callable[[CaseResult], float]) -> dict[str, float]:
    """Return the median over the seeds of a figure of every controller."""
    by_controller: dict[str, list[float]] = {}
    for case in cases_of(results, scenario):
        by_controller.setdefault(case.controller, []).append(figure(case))
    return {controller: float(np.median(values)) for controller, values in by_controller.items()}


def rmse(case: CaseResult) -> float:
    """Return the RMSE in parts of the reference's span, mean over the outputs."""
    trace = case.trace()
    squared = np.mean((trace.reference - trace.y)[:-1] ** 2, axis=0)
    return float(np.mean(np.sqrt(squared) / np.ptp(trace.reference, axis=0)))


def travel(case: CaseResult) -> float:
    return metric(case, "total_variation")


def errors(case: CaseResult) -> FloatArray:
    """Return |reference - output| in display units, shape (samples, p)."""
    trace = case.trace()
    factors = [output.shown_in.factor for output in trace.outputs]
    return np.abs(trace.reference - trace.y) * np.array(factors)


def mean_error(case: CaseResult, since: float, until: float) -> float:
    """Return the mean error over a time in s."""
    time = case.trace().time
    return float(errors(case)[(time >= since) & (time < until)].mean())


def metric(case: CaseResult, name: str) -> float:
    return next(value for key, value in case.metrics.items() if key.startswith(f"{name}."))


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_case_ends_and_holds_its_input_bounds_exactly(name: str, results_of: Results) -> None:
    check_that_cases_end_within_bounds(results_of(name))


def check_that_cases_end_within_bounds(results: StudyResults) -> None:
    assert results.study.summary.strip().endswith(".")
    for case in results.cases:
        assert case.outcome is Outcome.COMPLETED, case.reason
        trace = case.trace()
        assert (trace.u >= trace.bounds.u_min).all()
        assert (trace.u <= trace.bounds.u_max).all()
        assert any(key.startswith("bound_violation_max.") for key in case.metrics)


@pytest.mark.parametrize("name", BUILT_IN)
def test_figures_of_the_response_are_those_of_the_samples(name: str, results_of: Results) -> None:
    check_figures(results_of(name))


def check_figures(results: StudyResults) -> None:
    """Check the figures of the first seed: no figure is computed otherwise for another one."""
    preview = int(results.provenance["largest preview"].removesuffix(" samples"))
    with (results.folder / "metrics.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for case, row in zip(results.cases, rows, strict=True):
        if case.seed != results.cases[0].seed:
            continue
        figures = figures_of(case.folder, preview)
        actual = {key: float(row[key] or "nan") for key in figures}
        assert actual == pytest.approx(figures, rel=1e-9, abs=1e-9, nan_ok=True), case.id
        assert (case.failed, case.settles) == verdict(case.folder, preview), (case.id, case.failure)
        settles = {True: "true", False: "false", None: ""}[case.settles]
        assert (row["failed"], row["settles"]) == ("true" if case.failed else "false", settles)


@pytest.mark.slow
def test_of_the_sweeps_one_setting_fails(results_of: Results) -> None:
    failed = [case.controller for case in results_of("tuning").cases if case.failed]
    assert failed == ["mfapc-lambda_u-0.1-forecast_order-2"]


LEARNT_ONCE = ("deepc", "wkpc", "mpc", "pid")


@pytest.mark.slow
def test_what_was_learnt_or_given_once_fails_when_the_direction_turns(
    results_of: Results,
) -> None:
    results = results_of("direction-change")
    for scenario in results.study.scenarios:
        for case in cases_of(results, scenario, *LEARNT_ONCE):
            assert (mean_error(case, 10.0, 19.0) < 4.0) == (case.controller != "pid")
            assert mean_error(case, 20.0, 80.0) > 10.0
        assert all(case.failed for case in cases_of(results, scenario, *LEARNT_ONCE, "spsa"))


@pytest.mark.slow
def test_who_goes_on_learning_recovers_before_the_next_step(results_of: Results) -> None:
    results = results_of("direction-change")
    for scenario in results.study.scenarios:
        adaptive = cases_of(results, scenario, "mfapc", "mfapc-any-sign", "mfac-any-sign", "deepc-online")
        assert not any(case.failed for case in adaptive)
        assert all(mean_error(case, 27.0, 29.0) < 1.0 for case in adaptive)
        least = medians(results, scenario, lambda case: metric(case, "mean_abs_error"))
        assert min(least, key=least.__getitem__) == "deepc-online"
    assert results.study.controllers["mfapc"].settings["form"] == "ffdl"


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["deepc-online", "wkpc-online"])
def test_data_that_fade_recover(controller: str, results_of: Results) -> None:
    results = results_of("direction-change")
    for scenario in results.study.scenarios:
        assert not any(case.failed for case in cases_of(results, scenario, controller))
        assert medians(results, scenario, lambda case: mean_error(case, 50.0, 79.0))[controller] < 3.0


DRIFTS = [f"{drift}{preview}" for drift in ("slow", "fast") for preview in ("", "-no-preview")]


@pytest.mark.slow
@pytest.mark.parametrize("drift", DRIFTS)
def test_frozen_data_age_and_data_that_fade_do_not(drift: str, results_of: Results) -> None:
    results = results_of("time-varying")
    constant = medians(results, drift.replace("slow", "constant").replace("fast", "constant"), rmse)
    drifting = medians(results, drift, rmse)
    off = medians(results, drift, lambda case: metric(case, "settled_error"))
    frozen = ("deepc", "spc", "gamma-ddpc", "wkpc")
    still = medians(
        results,
        drift.replace("slow", "constant").replace("fast", "constant"),
        lambda case: metric(case, "settled_error"),
    )
    assert all(off[name] > 1.9 for name in frozen)
    assert all(off[name] > 2.0 * still[name] for name in ("spc", "gamma-ddpc", "wkpc"))
    assert all(off[name] < 1.0 for name in off if name not in (*frozen, "wkpc-online"))
    assert any(case.failed for case in cases_of(results, drift, "wkpc"))
    assert min(drifting, key=drifting.__getitem__) == "deepc-online"
    assert drifting["deepc-online"] < 1.2 * constant["deepc-online"]
    assert not any(case.failed for case in cases_of(results, drift) if case.controller not in frozen)


@pytest.mark.slow
@pytest.mark.parametrize("drift", DRIFTS)
def test_integrating_stands_the_drift_without_learning_on(drift: str, results_of: Results) -> None:
    results = results_of("time-varying")
    constant = medians(results, drift.replace("slow", "constant").replace("fast", "constant"), rmse)
    drifting = medians(results, drift, rmse)
    for name in ("mpc", "koopman-mpc", "lqr", "pid", "ipid", "mfapc", "mfac"):
        assert drifting[name] < 1.5 * constant[name]
    assert results.study.controllers["deepc-online"].settings["online_data"] == "forgetting"


@pytest.mark.slow
def test_no_noise_loses_the_pendulum_nor_costs_much_tracking(results_of: Results) -> None:
    results = results_of("noise")
    assert not any(case.failed for case in results.cases)
    for loud in ("loud", "loud-no-preview"):
        before, after = medians(results, loud.replace("loud", "quiet"), rmse), medians(results, loud, rmse)
        assert all(after[name] < 1.25 * before[name] for name in before if name != "ipid")
        assert 1.2 < after["ipid"] / before["ipid"] < 1.4


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "apart"), [("quiet", 1.02), ("faint", 1.05), ("loud", 1.2)])
def test_predictive_methods_come_out_alike_at_every_noise(
    noise: str, apart: float, results_of: Results
) -> None:
    results = results_of("noise")
    ahead, blind = (medians(results, scenario, rmse) for scenario in (noise, f"{noise}-no-preview"))
    alike = [ahead[name] for name in PREDICTIVE]
    assert max(alike) < apart * min(alike)
    assert all(0.65 < ahead[name] / blind[name] < 0.78 for name in PREDICTIVE)
    best = min(blind.values())
    assert max(blind[name] for name in PREDICTIVE) < 1.1 * best
    assert blind["wkpc"] < 1.05 * best
    assert all(1.05 * best < blind[name] < 1.6 * best for name in ("lqr", "ipid", "pid"))
    assert min(blind["mfapc"], blind["mfac"]) > 1.9 * best


@pytest.mark.slow
def test_noise_costs_travel_most_where_nothing_filters(results_of: Results) -> None:
    results = results_of("noise")
    for preview in ("", "-no-preview"):
        before, after = (medians(results, f"{noise}{preview}", travel) for noise in ("quiet", "loud"))
        growth = {name: after[name] / before[name] for name in before}
        assert growth["ipid"] == pytest.approx(7.0, rel=0.1)
        assert all(3.8 < growth[name] < 6.0 for name in ("spc", "koopman-mpc"))
        assert all(1.8 < growth[name] < 3.0 for name in ("deepc", "gamma-ddpc"))
        assert max(growth["mfapc"], growth["mfac"]) < 1.33
        assert {*sorted(after, key=after.__getitem__)[:2]} == {"mfac", "mfapc"}


@pytest.mark.slow
def test_knowing_of_the_coupling_shows_in_how_far_the_other_level_moves(results_of: Results) -> None:
    results = results_of("mimo")
    assert not any(case.failed for case in results.cases)
    for scenario in results.study.scenarios:
        most = medians(results, scenario, moved)
        assert max(most[name] for name in (*PREDICTIVE, "lqr")) < 0.07
        assert all(0.09 < most[name] < 0.2 for name in ("wkpc", "deepc-decentralised", "ipid", "mfapc"))
        assert all(0.2 < most[name] < 0.25 for name in ("pid", "mfac"))


def moved(case: CaseResult) -> float:
    """Return how far level 1 moves about the step of level 2, at 500 s [cm]."""
    time = case.trace().time
    return float(errors(case)[(time >= 400.0) & (time < 900.0), 0].max())


@pytest.mark.slow
def test_predictive_methods_come_out_alike_on_the_tanks_and_owe_a_quarter_to_preview(
    results_of: Results,
) -> None:
    results = results_of("mimo")
    ahead, blind = (medians(results, scenario, rmse) for scenario in results.study.scenarios)
    for figure in (ahead, blind):
        assert max(figure[name] for name in PREDICTIVE) < 1.02 * min(figure[name] for name in PREDICTIVE)
    assert all(0.7 < ahead[name] / blind[name] < 0.8 for name in PREDICTIVE)
    for level, least, most in (("level_1", 1.15, 1.25), ("level_2", 1.0, 1.04)):
        of_level = medians(results, "no-preview", lambda case, key=level: case.metrics[f"rmse.{key} [cm]"])
        best = min(of_level[name] for name in PREDICTIVE)
        for name in ("ipid", "deepc-decentralised"):
            assert least * best < of_level[name] < most * best
    assert ahead["wkpc"] > blind["wkpc"]


@pytest.mark.slow
def test_upright_the_compact_form_of_mfapc_falls_and_the_others_hold(results_of: Results) -> None:
    results = results_of("unstable")
    for scenario in results.study.scenarios:
        assert all(case.failed for case in cases_of(results, scenario, "mfapc"))
        rest = [case for case in cases_of(results, scenario) if case.controller != "mfapc"]
        assert not any(case.failed for case in rest)
        assert max(mean_error(case, 5.0, 10.0) for case in rest if case.controller != "spsa") < 0.01


@pytest.mark.slow
def test_upright_the_force_limit_decides_without_preview(results_of: Results) -> None:
    results = results_of("unstable")
    ahead, blind = (medians(results, scenario, rmse) for scenario in results.study.scenarios)
    for figure in (ahead, blind):
        assert max(figure[name] for name in PREDICTIVE) < 1.02 * min(figure[name] for name in PREDICTIVE)
    assert all(0.4 < ahead[name] / blind[name] < 0.5 for name in PREDICTIVE)
    best = min(blind.values())
    assert max(blind[name] for name in ("ipid", "wkpc", "mfac-ffdl")) < 1.01 * best
    others = [blind[name] for name in ("lqr", "pid", "spsa", "cascade", "mfapc-ffdl")]
    assert min(others) > best * 8 / 7
    assert max(others) < 2.5 * best
    atop = medians(results, "no-preview", lambda case: metric(case, "max_abs_input"))
    assert all(atop[name] > 9.9 for name in (*PREDICTIVE, "ipid"))


def test_the_reactor_is_held_where_it_is_unstable(results_of: Results) -> None:
    results = results_of("reactor")
    assert not any(case.failed for case in results.cases)
    settled = [case for case in cases_of(results, "no-preview") if case.controller != "wkpc"]
    assert all(mean_error(case, 750.0, 850.0) < 1.0 for case in settled)


def test_without_preview_the_reactor_leaves_little_between_the_methods(results_of: Results) -> None:
    results = results_of("reactor")
    ahead, blind = (medians(results, scenario, rmse) for scenario in results.study.scenarios)
    best = min(blind.values())
    assert max(blind[name] for name in (*PREDICTIVE, "lqr", "mfac", "ipid")) < 1.05 * best
    assert max(blind["wkpc"], blind["mfapc"]) < 1.2 * best
    assert blind["pid"] > 1.5 * best
    assert all(0.55 < ahead[name] / blind[name] < 0.65 for name in PREDICTIVE)


@pytest.mark.slow
def test_tuning_maps_say_what_the_summary_says(results_of: Results) -> None:
    results = results_of("tuning")
    figure = {case.controller: metric(case, "sum_abs_error") for case in results.cases}

    def span(start: str, *ends: str) -> float:
        values = [figure[f"{start}{end}"] for end in ends]
        return max(values) / min(values)

    assert span("deepc-lambda_g-50-lambda_sigma-", "1000", "100000", "1e07", "1e09") < 1.2
    assert span("wkpc-dictionary-count", "2", "5", "10", "15", "20") < 1.2
    assert span("deepc-lambda_g-", "0.5-lambda_sigma-1e07", "5-lambda_sigma-1e07") < 1.1
    assert span("deepc-lambda_g-", "5-lambda_sigma-1e07", "500-lambda_sigma-1e07") > 4.0
    assert span("deepc-setpoint_weight-", "30-lambda_g-50", "3000-lambda_g-50") > 4.0
    assert span("deepc-input_weight-", "0.1-output_weight-100", "100-output_weight-100") > 4.0
    assert figure["mfapc-lambda_u-0.1-forecast_order-4"] > 4.0 * figure["mfapc"]
    assert 1.5 < figure["mfapc-lambda_u-0.7-forecast_order-4"] / figure["mfapc"] < 2.5
    assert figure["mfapc-lambda_u-0.25-forecast_order-4"] < figure["mfapc"]


def test_the_reactor_is_unstable_where_it_is_held() -> None:
    """An eigenvalue of the linearised equations at 340 K is in the right half-plane."""
    temperature = 340.0
    reaction = cstr.RATE * math.exp(-cstr.ACTIVATION / temperature)
    concentration = cstr.FLOW / (cstr.FLOW + cstr.VOLUME * reaction)  # what flows in reacts or flows out
    model = linearise(cstr.MODEL, [concentration, temperature])
    assert np.linalg.eigvals(model.A).real.max() > 0.0
    assert np.linalg.eigvals(linearise(cstr.MODEL).A).real.max() < 0.0
