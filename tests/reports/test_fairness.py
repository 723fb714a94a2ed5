"""The account of fairness in the page: each sentence against the study and its runs."""

import html
import re
from dataclasses import replace
from typing import Any

from ddpc_cosim import Bounds, Outcome, StudyResults, Trace
from ddpc_reports.page import render_page

from .synthetic import MakeResults, make_trace

LABELS = {"data": "Data-driven", "model": "Model-based", "own": "<b>Their</b> & own"}
KNOWN: dict[str, dict[str, Any]] = {
    "data": {
        "preview": 5,
        "recorded_samples": 200,
        "knowledge": {"measures": "angle, speed", "plant": "nothing"},
    },
    "model": {"preview": 1, "knowledge": {"measures": "angle", "plant": "a linear model, by FMUModel"}},
    "own": {"preview": 5, "recorded_samples": 200},
}
TUNED = {"settings": ["horizon", "weight"], "trials": 20, "seeds": ["100:103"], "by": "median rmse"}


def run(key: str, seed: int) -> Trace:
    return replace(make_trace(0.3, noise_seed=seed), **KNOWN[key])


def controllers(**tuned: Any) -> dict[str, dict[str, Any]]:
    return {
        key: {"type": key, "label": label, **({"tuned": tuned[key]} if key in tuned else {})}
        for key, label in LABELS.items()
    }


def fairness(results: StudyResults) -> dict[str, str]:
    """Return what the page says under Fairness, by topic, as a reader sees it."""
    page = render_page([results])
    section = re.search(r'<h2 id="s1-fairness">.*?</section>', page, re.DOTALL)
    assert section
    pairs = re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", section[0], re.DOTALL)
    assert "<b>" not in section[0]
    return {topic: html.unescape(re.sub("<[^>]*>", "", text)) for topic, text in pairs}


def test_plants_that_seeds_draw_are_the_same_for_all(make_results: MakeResults) -> None:
    results = make_results(run, controllers())
    drawn = {"mass [kg]": 1.1, "radius [m]": 0.2}
    spread = replace(results, cases=tuple(replace(case, drawn=drawn) for case in results.cases))
    said = "Each seed has a plant of its own (mass and radius), the same for all, and no controller is told"
    assert said in fairness(spread)["The same for all"]
    assert "plant of its own" not in "".join(fairness(results).values())


def test_a_crash_does_not_make_a_controller_one_without_preview_and_recording(
    make_results: MakeResults,
) -> None:
    """Of a run whose process died there are the samples alone."""

    def trace_of(key: str, seed: int) -> Trace:
        crashed = replace(make_trace(0.3, noise_seed=seed), outcome=Outcome.CRASHED, reason="SIGSEGV")
        return crashed if key == "data" else run(key, seed)

    said = fairness(make_results(trace_of, controllers()))
    assert "of Data-driven it is not known how far ahead the reference was seen" in said["Preview"]
    assert "of Data-driven it is not known whether a recording was learned from" in said["Recording"]


def test_each_fact_is_told_of_those_whom_it_holds_for(make_results: MakeResults) -> None:
    said = fairness(make_results(run, controllers(data=TUNED)))
    assert said == {
        "Preview": "Data-driven and <b>Their</b> & own see 5 samples of the future reference (0.5\xa0s); "
        "Model-based sees 1 sample of the future reference (0.1\xa0s).",
        "Measurements": "Measured for every controller: angle. Data-driven uses angle, speed; "
        "Model-based uses angle; of <b>Their</b> & own it is not known which of them are used.",
        "The same for all": "The limits of inputs and outputs are the same.",
        "Recording": "Data-driven and <b>Their</b> & own learn from a recording of 200 samples; "
        "Model-based asks for no recording.",
        "Prior knowledge": "Data-driven was told nothing of the plant beforehand; "
        "Model-based was told beforehand of the plant: a linear model, by FMUModel; "
        "of <b>Their</b> & own it is not known what was told beforehand of the plant.",
        "Tuning": "Data-driven has settings found in 20 trials on seeds 100\N{EN DASH}102, by median rmse; "
        "of Model-based and <b>Their</b> & own it is not known how settings were found. So the effort spent "
        "on tuning is not known to be equal.",
    }


def test_what_holds_for_all_is_told_once(make_results: MakeResults) -> None:
    alike = KNOWN["data"]
    said = fairness(
        make_results(
            lambda key, seed: replace(make_trace(0.3), **alike),
            controllers(**dict.fromkeys(LABELS, TUNED | {"trials": 1, "seeds": [3], "source": "a file"})),
            scenarios={"calm": {}, "noisy": {}},
        )
    )
    assert said == {
        "The same for all": "All controllers see 5 samples of the future reference (0.5\xa0s). "
        "Measured for every controller: angle. All controllers use angle, speed. "
        "The limits of inputs and outputs are the same. "
        "All controllers learn from a recording of 200 samples. "
        "All controllers were told nothing of the plant beforehand. "
        "All controllers have settings found in 1 trial on seed 3, by median rmse (a file)."
    }


def test_most_controllers_are_all_others_and_nobody_is_among_them_of_whom_nothing_is_known(
    make_results: MakeResults,
) -> None:
    keys = ["a", "b", "c", "d", "e"]

    def trace_of(key: str, seed: int) -> Trace:
        knowledge = {"d": {"measures": "speed"}, "e": {}}.get(key, {"measures": "angle"})
        return replace(make_trace(0.3), preview=5, knowledge=knowledge)

    said = fairness(make_results(trace_of, {key: {"type": key} for key in keys}))["Measurements"]
    assert said == (
        "Measured for every controller: angle. d uses speed; of e it is not known which of them are used; "
        "all others use angle."
    )


def test_limits_that_differ_are_told_of_each_signal(make_results: MakeResults) -> None:
    def limited(key: str, seed: int) -> Trace:
        trace = run(key, seed)
        bounds = trace.bounds
        wide = Bounds(bounds.u_min, bounds.u_max, 2 * bounds.y_min, 2 * bounds.y_max)
        return replace(trace, bounds=wide) if key == "model" else trace

    assert fairness(make_results(limited, controllers()))["Limits"] == (
        "Limits of angle differ: Data-driven and <b>Their</b> & own have \N{MINUS SIGN}70 … 70°; "
        "Model-based has \N{MINUS SIGN}140 … 140°."
    )


def test_an_unlimited_view_of_nothing_is_told_as_such(make_results: MakeResults) -> None:
    said = fairness(make_results(lambda key, seed: replace(run(key, seed), preview=0), controllers()))
    assert said["The same for all"].startswith("All controllers see no future reference.")


def test_results_on_seeds_of_the_tuning_are_told(make_results: MakeResults) -> None:
    """With run --seeds a study can be reported on other seeds than its own."""
    said = fairness(make_results(run, controllers(data=TUNED), seeds=[5, 101, 102]))
    assert ", seeds of the tuning reported here: 101\N{EN DASH}102" in said["Tuning"]


def test_settings_that_name_the_plant_s_own_fmu_are_told(make_results: MakeResults) -> None:
    sections = controllers()
    for key in ("model", "own"):
        sections[key]["settings"] = {"model": {"type": "x", "files": ["{plant}"]}}
    said = fairness(make_results(run, sections))["Prior knowledge"]
    named = "its settings name the FMU of the plant itself"
    assert f"a linear model, by FMUModel; {named}" in said
    assert f"Their</b> & own was told beforehand of the plant: something not known; {named}" in said


def test_a_stabiliser_of_the_recording_is_told(make_results: MakeResults) -> None:
    stabiliser = {"type": "pid", "settings": {"kp": 2.0}}
    recording = {
        "samples": 200,
        "excitation": {"torque": {"low": -1.0, "high": 1.0}},
        "controller": stabiliser,
    }
    loop = {"sampling_time": 0.1, "duration": 6.0, "start": "recording-end"}
    said = fairness(make_results(run, controllers(), recording=recording, loop=loop))["Recording"]
    assert "kept by a stabilising controller that the study gives, pid with kp = 2: whoever" in said
    assert said.endswith(" Every loop starts where its recording ended.")


def test_of_runs_without_a_sample_nothing_is_known(make_results: MakeResults) -> None:
    def lost(key: str, seed: int) -> Trace:
        trace = run(key, seed)
        none = {name: getattr(trace, name)[:0] for name in ("time", "reference", "y", "measured", "u")}
        return replace(trace, **none, status=(), solve_time=trace.solve_time[:0])

    said = fairness(make_results(lost, controllers()))
    assert "The same for all" not in said
    assert said["Preview"] == "Of all controllers it is not known how far ahead the reference was seen."
    assert said["Limits"] == "No run tells the limits."
    assert said["Tuning"] == "Of all controllers it is not known how settings were found."


def test_settings_of_a_publication_are_told_by_their_source(make_results: MakeResults) -> None:
    table = {"source": "Table 1 of the paper"}
    everyone = fairness(make_results(run, controllers(**dict.fromkeys(LABELS, table))))
    assert "All controllers have settings from Table 1 of the paper." in everyone["The same for all"]
    assert "Tuning" not in everyone
    some = fairness(make_results(run, controllers(data=table, model=TUNED)))["Tuning"]
    assert some.startswith(
        "Data-driven has settings from Table 1 of the paper; Model-based has settings found"
    )
    assert some.endswith("So the effort spent on tuning is not known to be equal.")


def test_what_is_known_of_disturbances_and_prices_and_who_uses_it(make_results: MakeResults) -> None:
    forecasts = {"data": "sun, wind", "model": "measured only", "own": None}

    def trace_of(key: str, seed: int) -> Trace:
        told = forecasts[key]
        more = {"forecast": told, "prices": "electricity"} if key == "data" else {"forecast": told}
        knowledge = {"measures": "angle", "plant": "nothing", **more} if told else {}
        return replace(make_trace(0.3, noise_seed=seed), knowledge=knowledge)

    constant = {"kind": "constant", "value": 1.0}
    signals: dict[str, Any] = {
        "disturbances": {
            "sun": {"signal": constant, "known": "medium", "lag": 1},
            "wind": {"signal": constant, "known": "perfect"},
        },
        "prices": {"electricity": {"signal": "torque", "price": 0.2, "unit": "EUR/kWh"}},
    }
    blind = {"nominal": {}, "blind": {"known": {"sun": "unknown", "wind": "unknown"}}}
    said = fairness(make_results(trace_of, controllers(), **signals))
    assert said["Disturbances"] == (
        "Known of sun: what is measured, and forecasts with medium errors, 1 sample late; of wind: what is "
        "measured, and what it will be. Data-driven uses the forecast of sun, wind; Model-based uses what is "
        "measured of disturbances, and no forecast; of <b>Their</b> & own it is not known whether forecasts "
        "are used."
    )
    assert said["Prices"] == (
        "Known ahead: electricity. Data-driven uses the price of electricity; Model-based uses no price; "
        "of <b>Their</b> & own it is not known whether prices are used."
    )
    said = fairness(make_results(trace_of, controllers(), **signals, scenarios=blind))
    assert said["Disturbances"].startswith("In blind: Known of sun and wind: nothing."), "the last of two"
    assert "Disturbances" not in fairness(make_results(trace_of, controllers()))
