"""The paper's claims on other seeds, without preview and on other data, recomputed from signals.csv."""

import html
import math
import re
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from studies import run_file

from ddpc_cosim import CaseResult, StudyResults
from ddpc_cosim.study.controller_plugins import make_controller
from ddpc_reports.page import render_page

from .recomputed import figures_of, read_case, verdict
from .test_studies import STUDIES

# What its fixtures run is run in one process.
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("claims")]

METHODS = ("mfapc", "deepc", "wkpc")
HORIZON = 5


def run_all(name: str, folder: Path) -> StudyResults:
    return run_file(STUDIES / f"{name}.toml", folder, jobs=2)


@pytest.fixture(scope="module")
def claims(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return run_all("claims", tmp_path_factory.mktemp("claims"))


@pytest.fixture(scope="module")
def excitation(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return run_all("excitation", tmp_path_factory.mktemp("excitation"))


def figure(name: str) -> Callable[[CaseResult], float]:
    """Return what computes a figure of the response from the files of a case."""

    def of(case: CaseResult) -> float:
        figures = figures_of(case.folder, HORIZON)
        return next(value for key, value in figures.items() if key.startswith(f"{name}."))

    return of


def sum_of_errors(case: CaseResult) -> float:
    _, columns = read_case(case.folder)
    rows = zip(columns["reference angle [rad]"][:-1], columns["angle [rad]"][:-1], strict=True)
    return sum(abs(math.degrees(reference - angle)) for reference, angle in rows)


def rms_change(case: CaseResult) -> float:
    _, columns = read_case(case.folder)
    changes = [after - before for before, after in pairwise([0.0, *columns["torque [N.m]"][:-1]])]
    return math.sqrt(sum(change**2 for change in changes) / len(changes))


def by_seed(
    results: StudyResults, controller: str, scenario: str, figure: Callable[[CaseResult], float]
) -> dict[int, float]:
    cases = [case for case in results.cases if (case.controller, case.scenario) == (controller, scenario)]
    assert len(cases) == len(results.study.seeds)
    return {case.seed: figure(case) for case in cases}


Table = dict[str, dict[int, float]]


def of_each(results: StudyResults, scenario: str, figure: Callable[[CaseResult], float]) -> Table:
    return {controller: by_seed(results, controller, scenario, figure) for controller in METHODS}


def below(errors: dict[int, float], other: dict[int, float]) -> int:
    """Return on how many seeds one is below the other."""
    return sum(errors[seed] < other[seed] for seed in errors)


@pytest.mark.parametrize("scenario", ["preview", "no-preview"])
def test_on_every_seed_mfapc_changes_its_input_least_and_wkpc_most(
    claims: StudyResults, scenario: str
) -> None:
    changes = of_each(claims, scenario, rms_change)
    assert below(changes["mfapc"], changes["deepc"]) == 11
    assert below(changes["deepc"], changes["wkpc"]) == 11


@pytest.mark.parametrize("scenario", ["preview", "no-preview"])
def test_on_every_seed_wkpc_overshoots_most_and_rises_first(claims: StudyResults, scenario: str) -> None:
    beyond, risen = (
        of_each(claims, scenario, figure("overshoot")),
        of_each(claims, scenario, figure("rise_time")),
    )
    for other in ("mfapc", "deepc"):
        assert below(beyond[other], beyond["wkpc"]) == 11
        assert below(risen["wkpc"], risen[other]) == 11


@pytest.mark.parametrize("scenario", ["preview", "no-preview"])
def test_on_every_seed_the_error_of_mfapc_alone_vanishes(claims: StudyResults, scenario: str) -> None:
    errors = of_each(claims, scenario, figure("settled_error"))
    assert max(errors["mfapc"].values()) < 0.01
    assert min(*errors["deepc"].values(), *errors["wkpc"].values()) > 0.2


def test_the_figures_of_the_paper_s_data_are_those_of_the_summary(claims: StudyResults) -> None:
    changes, settled = (
        of_each(claims, "preview", rms_change),
        of_each(claims, "preview", figure("settled_error")),
    )
    summary = claims.study.summary
    rms = [f"{changes[name][5489]:.3f}" for name in METHODS]
    ends = [f"{settled[name][5489]:.2g}" for name in METHODS]
    assert f"is {rms[0]}, {rms[1]} and {rms[2]} N m with MFAPC, DeePC and WKPC" in summary
    assert f"settled error {ends[0]}, {ends[1]} and {ends[2]} degrees" in summary


def test_lambda_g_matters_as_much_as_the_summary_says(claims: StudyResults) -> None:
    for scenario in ("preview", "no-preview"):
        five, fifty, most = (
            by_seed(claims, name, scenario, sum_of_errors)
            for name in ("deepc-lambda_g-5", "deepc", "deepc-lambda_g-500")
        )
        assert below(five, fifty) == 10
        assert below(fifty, most) == 11
        if scenario == "preview":
            statement = f"to {five[5489]:.0f} degrees with 5, to {fifty[5489]:.0f} with the 50"
            assert statement in claims.study.summary
            assert f"and to {most[5489]:.0f} with 500" in claims.study.summary


def test_the_shortest_recordings_are_in_the_order_of_excitation(excitation: StudyResults) -> None:
    sections = {name: excitation.study.controllers[name] for name in METHODS}
    built = {name: make_controller(section.type, section.settings) for name, section in sections.items()}
    needed = {name: controller.recording_length(1, 1, 2) for name, controller in built.items()}
    assert needed == {"mfapc": 0, "deepc": 21, "wkpc": 37}
    assert not built["mfapc"].uses_recording


def test_with_little_data_the_order_shows_and_with_much_it_turns(excitation: StudyResults) -> None:
    few, many = (of_each(excitation, name, sum_of_errors) for name in ("n40", "n200"))
    assert below(few["deepc"], few["wkpc"]) == below(few["mfapc"], few["wkpc"]) == 10
    assert below(many["deepc"], many["mfapc"]) == below(many["wkpc"], many["mfapc"]) == 10


def test_a_faint_excitation_needs_another_ridge(excitation: StudyResults) -> None:
    share = figure("settled_share")
    far_off = {
        (name, scenario): sum(value > 50.0 for value in by_seed(excitation, name, scenario, share).values())
        for name in ("deepc", "wkpc", "deepc-lambda-5")
        for scenario in ("faint", "weak")
    }
    assert far_off["deepc", "faint"] == far_off["wkpc", "faint"] == 10
    assert far_off["deepc-lambda-5", "faint"] == 0
    assert far_off["deepc", "weak"] == far_off["wkpc", "weak"] == 0
    failed = by_seed(excitation, "deepc-lambda-5", "weak", lambda case: verdict(case.folder, HORIZON).failed)
    assert sum(failed.values()) == 1


def test_which_runs_failed_is_what_their_samples_say(excitation: StudyResults) -> None:
    for case in excitation.cases:
        assert (case.failed, case.settles) == verdict(case.folder, HORIZON), (case.id, case.failure)


def test_the_report_states_the_terms_of_the_comparison_as_the_study_sets_them(claims: StudyResults) -> None:
    """Each figure under Fairness is looked up in study.toml."""
    study = tomllib.loads((claims.folder / "study.toml").read_text(encoding="utf-8"))
    page = render_page([claims])
    section = page[page.index('id="s1-fairness"') :]
    section = section[: section.index("</section>")]
    pairs = re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", section, re.DOTALL)
    terms = [(topic, html.unescape(re.sub("<[^>]*>", "", text))) for topic, text in pairs]
    labels = {
        name: controller["label"] for name, controller in study["controllers"].items() if name in METHODS
    }
    horizons = {study["controllers"][name]["settings"]["horizon"] for name in METHODS}
    (horizon,) = horizons
    ahead = {"preview": horizon, "no-preview": study["scenarios"]["no-preview"]["preview"]}
    h = study["loop"]["sampling_time"]
    previews = [text for topic, text in terms if topic == "Preview"]
    assert previews == [
        f"In {study['scenarios'][name]['label']}: All controllers see {samples} of the future reference "
        f"({n * h:.1f}\N{NO-BREAK SPACE}s)."
        for (name, n), samples in zip(ahead.items(), ("5 samples", "1 sample"), strict=True)
    ]
    rest = {topic: text for topic, text in terms if topic != "Preview"}
    wide, narrow = study["controllers"]["wkpc"]["bounds"]["angle"], study["bounds"]["angle"]
    assert f"{labels['wkpc']} has \N{MINUS SIGN}{-wide['min']:.0f} … {wide['max']:.0f}°" in rest["Limits"]
    assert f"have \N{MINUS SIGN}{-narrow['min']:.0f} … {narrow['max']:.0f}°" in rest["Limits"]
    assert f"{labels['wkpc']} uses {', '.join(study['plant']['measurements'])}" in rest["Measurements"]
    learning = f"{labels['wkpc']} and {labels['deepc']} learn from a recording of"
    assert f"{learning} {study['recording']['samples']} samples" in rest["Recording"]
    sources = {name: study["controllers"][name]["tuned"]["source"] for name in METHODS}
    assert sources["deepc"] == sources["wkpc"]
    assert rest["Tuning"] == (
        f"{labels['wkpc']} and {labels['deepc']} have settings from {sources['wkpc']}; "
        f"{labels['mfapc']} has settings from {sources['mfapc']}."
    )
    assert "The same for all" not in rest
