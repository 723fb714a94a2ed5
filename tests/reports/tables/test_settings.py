"""The settings in the report: whatever a study sets, two studies that differ in it read differently."""

import math
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import is_dataclass, replace
from typing import Any, get_args

import pytest
from hypothesis import given, strategies as st
from markupsafe import Markup

from ddpc_cosim import ConfigError, Price, StudyResults, Trace
from ddpc_cosim.codec import Kinds, declared_fields, read, write
from ddpc_cosim.conditions import all_conditions
from ddpc_cosim.files.tables import Table
from ddpc_cosim.identification.identification import Identification
from ddpc_cosim.study.file_format.requirements import RequirementSection, RequirementsSection
from ddpc_cosim.study.file_format.sections import (
    ClaimSection,
    ReferencePoints,
    ReportSection,
    ScenarioSection,
    SearchSection,
    Study,
)
from ddpc_cosim.study.problems import WholeStudy
from ddpc_reports.comparison import conditions
from ddpc_reports.embedding import Drawing
from ddpc_reports.figures import figure, over_time
from ddpc_reports.page import render_page
from ddpc_reports.tables import settings as settings_module
from ddpc_reports.tables.settings import family_tables, scenario_effects, settings_tables, value_text

from ..synthetic import MakeResults, make_study, make_trace

COST = "sum_abs_error.angle [deg]"
OBJECT = {"type": "module:Kernel", "count": 10, "widths": [0.5, 2.0], "centres": {"low": 0.0, "names": ["a"]}}
CONTENT: dict[str, Any] = {
    "name": "everything",
    "title": "Everything",
    "summary": "All that a study can set.",
    "source": "A book",
    "seeds": [7, 8],
    "plant": {
        "name": "pendulum",
        "inputs": ["torque"],
        "outputs": ["angle"],
        "measurements": ["angle", "speed"],
        "parameters": {
            "mass": 2.0,
            "mode": "soft",
            "stiff": True,
            "length": {"distribution": "normal", "mean": 1.0, "deviation": 0.1, "low": 0.5, "high": 2.0},
            "depth": {"distribution": "log-normal", "median": 1.0, "factor": 1.5, "low": 0.5, "high": 3.0},
            "width": {"distribution": "uniform", "low": 1.0, "high": 2.5},
            "height": {"distribution": "triangular", "low": 1.0, "mode": 1.5, "high": 2.5},
        },
        "sampling": "sobol",
        "start": {"torque": 0.25},
        "display_units": {"angle": "deg"},
        "nominal": {"angle": 0.5},
        "fmi_type": "co-simulation",
        "isolated": True,
        "switches": {"torque": "torque_on"},
        "parts": [
            {"name": "motor", "plant": "drive", "step": 0.01, "parameters": {"gain": 2.0}},
            {
                "name": "arm",
                "fmu": "arm.fmu",
                "start": {"torque": 1.0},
                "fmi_type": "model-exchange",
                "isolated": True,
            },
        ],
        "connections": [
            {"from": "motor.torque", "to": "arm.torque", "factor": 2.0, "offset": 0.5, "convert_units": False}
        ],
        "coupling": {
            "algorithm": "parallel",
            "communication_step": 0.02,
            "extrapolation": "linear",
            "loop_tolerance": 1e-6,
            "error_tolerance": 1e-4,
        },
    },
    "loop": {
        "sampling_time": 0.1,
        "communication_step": 0.025,
        "duration": 6.0,
        "start_time": 2.0,
        "start": "recording-end",
        "warm_up": 1.0,
        "warm_up_controller": {"type": "pid", "settings": {"proportional": 3.0}},
        "step_timeout": 5.0,
        "case_timeout": 60.0,
        "memory_limit": 1.5,
        "preview": 3,
        "engine": "compiled",
    },
    "reference": {
        "angle": {"kind": "steps", "times": [0.0, 3.0], "values": [10.0, 20.0], "unit": "deg"},
        "constant": {"kind": "constant", "value": 1.0, "unit": "m"},
        "points": {"kind": "interpolated", "times": [0.0, 3.0], "values": [1.0, 2.0], "unit": "m"},
        "ramp": {
            "kind": "ramp",
            "from_value": 0.0,
            "to_value": 1.0,
            "from_time": 1.0,
            "to_time": 2.0,
            "unit": "m",
        },
        "sine": {
            "kind": "sine",
            "amplitude": 1.0,
            "frequency": 2.0,
            "offset": 0.5,
            "phase": 0.25,
            "unit": "m",
        },
        "file": {
            "kind": "file",
            "file": "wanted.csv",
            "column": "Angle",
            "time_column": "t",
            "interpolation": "linear",
            "unit": "deg",
        },
        "band": {
            "band": {"lower": 20.0, "upper": {"kind": "constant", "value": 24.0, "unit": "degC"}},
            "unit": "degC",
        },
    },
    "bounds": {"torque": {"min": -3.0, "max": 3.5, "unit": "N.m"}, "angle": {"max": 70.0, "unit": "deg"}},
    "disturbances": {
        "wind": {
            "signal": {"kind": "constant", "value": 2.0, "unit": "N"},
            "known": "medium",
            "lag": 1,
            "forecast": {"file": "forecasts.csv", "time_column": "issued", "unit": "N"},
        }
    },
    "prices": {
        "electricity": {
            "signal": "torque",
            "price": 0.25,
            "unit": "EUR/kWh",
            "factor": 0.5,
            "known": False,
            "emissions": 0.1,
            "emissions_unit": "g/kWh",
        }
    },
    "recording": {
        "samples": 200,
        "excitation": {
            "torque": {"kind": "uniform", "low": -3.0, "high": 3.0, "unit": "N.m"},
            "prbs": {"kind": "prbs", "low": -3.0, "high": 3.0, "unit": "N.m", "clock_period": 3},
            "multisine": {
                "kind": "multisine",
                "low": -3.0,
                "high": 3.0,
                "unit": "N.m",
                "min_frequency": 0.5,
                "max_frequency": 2.0,
                "phases": "random",
            },
            "chirp": {
                "kind": "chirp",
                "low": -3.0,
                "high": 3.0,
                "unit": "N.m",
                "from_frequency": 0.5,
                "to_frequency": 2.0,
                "sweep": "logarithmic",
            },
            "steps": {"kind": "steps", "times": [0.0, 3.0], "values": [10.0, 20.0], "unit": "N.m"},
            "recorded": {
                "kind": "recorded",
                "file": "torque.csv",
                "column": "M",
                "time_column": "t",
                "unit": "N.m",
            },
        },
        "controller": {"type": "pid", "settings": {"gains": [1.0, 2.0]}},
        "inputs": {"wind": {"kind": "steps", "times": [0.0, 2.0], "values": [0.5, 1.5], "unit": "m/s"}},
        "disturbances": {"wind": {"kind": "constant", "value": 3.0, "unit": "m/s"}},
        "start_time": -20.0,
        "file": ["monday.csv", "tuesday.csv"],
        "columns": {"angle": "Angle"},
        "excitation_columns": ["added"],
        "time_column": "t",
        "time_tolerance": 0.25,
        "dates": "excel",
        "time_zone": "Europe/Berlin",
        "encoding": "cp1252",
        "gaps": "split",
        "missing": 2,
        "missing_values": [-999.0],
        "duplicates": "mean",
        "resample": "linear",
        "outliers": 5.0,
        "part": [0.0, 0.5],
    },
    "controllers": {
        "quick": {
            "type": "a",
            "label": "Quick",
            "note": "the first",
            "settings": {"horizon": 5, "kernel": OBJECT, "slack": True, "kind": "ridge"},
            "bounds": {"angle": {"min": -70.0, "max": 71.0, "unit": "deg"}},
            "sweep": [{"horizon": [5, 6]}],
            "tuned": {
                "settings": ["horizon"],
                "trials": 9,
                "seeds": [100],
                "by": "rmse",
                "source": "here",
                "sampler_seed": 3,
                "at_ends": ["horizon"],
            },
        },
        "quick-horizon-9": {
            "type": "a",
            "label": "Quick, horizon = 9",
            "settings": {"horizon": 9, "kernel": deepcopy(OBJECT), "slack": True, "kind": "ridge"},
            "variant_of": "quick",
            "varied": ["horizon"],
        },
        "slow": {"type": "b", "label": "Slow"},
    },
    "scenarios": {
        "calm": {
            "label": "Calm",
            "start_time": 0.5,
            "parameters": {"mass": 1.0},
            "noise": {"angle": 0.01},
            "events": [{"time": 1.0, "parameters": {"damping": 0.3}}],
            "drifts": [
                {
                    "parameter": "mass",
                    "from_value": 1.0,
                    "to_value": 0.5,
                    "from_time": 1.0,
                    "to_time": 5.0,
                }
            ],
            "disturbances": {
                "angle": [
                    {"kind": "noise", "standard_deviation": 0.1, "mean": 0.2, "unit": "deg"},
                    {
                        "kind": "file",
                        "file": "gusts.csv",
                        "column": "Gust",
                        "time_column": "t",
                        "interpolation": "linear",
                        "unit": "deg",
                    },
                    {
                        "kind": "resource",
                        "file": "tables.csv",
                        "column": "Wave",
                        "interpolation": "linear",
                        "unit": "deg",
                    },
                    {
                        "kind": "sum",
                        "unit": "deg",
                        "parts": [
                            {"kind": "steps", "times": [0.0, 2.0], "values": [1.0, 2.0], "period": 3.0},
                            {
                                "kind": "random",
                                "low": 1.0,
                                "high": 2.0,
                                "hold": 0.5,
                                "interpolation": "linear",
                                "unit": "deg",
                            },
                        ],
                    },
                    {
                        "kind": "product",
                        "unit": "deg",
                        "parts": [
                            {
                                "kind": "interpolated",
                                "times": [0.0, 2.0],
                                "values": [1.0, 1.0],
                                "period": 3.0,
                            },
                            {"kind": "constant", "value": 2.0},
                        ],
                    },
                ]
            },
            "inputs": {"wind": {"kind": "steps", "times": [0.0, 2.0], "values": [1.0, 2.0], "unit": "m/s"}},
            "known": {"wind": "perfect"},
            "prices": {"electricity": 0.375},
            "bounds": {"torque": {"min": -2.0, "max": 2.5, "unit": "N.m"}},
            "rate_limit": {"torque": 2.0},
            "backlash": {"torque": 0.25},
            "delay": {"torque": 0.2, "angle": 0.1},
            "quantum": {"angle": 0.01},
            "loss": {"angle": 0.05},
            "preview": 1,
            "recording": {
                "samples": 60,
                "excitation": {"torque": {"kind": "uniform", "low": -1.0, "high": 1.0, "unit": "N.m"}},
                "inputs": {"wind": {"kind": "constant", "value": 0.75, "unit": "m/s"}},
            },
        },
        "plain": {},
    },
    "metrics": {
        "cost": {"outputs": {"angle": 2.0}, "inputs": {"torque": 0.1}, "changes": {"torque": 0.2}},
        "relevant": {"absolute": 0.125, "percent": 3.5},
        "ranking": "pareto",
        "key_figures": {
            "set": "boptest",
            "area": 123.5,
            "sources": {"AirZoneTemperature[hall]": ["angle"]},
            "bands": {"angle": {"band": {"lower": -0.375, "upper": 0.625}, "unit": "rad"}},
        },
    },
    "report": {
        "panels": [{"title": "Both", "controllers": ["quick", "slow"]}],
        "limitations": ["One plant only."],
        "author": "Its author",
        "comment": "What its author says.",
        "logo": "logo.svg",
        "scenario": "windy",
        "reproduction": {
            "source": "Table 9",
            "metrics": {COST: "Absolute error"},
            "methods": [
                {
                    "label": "Method",
                    "printed": "quick",
                    "published_code": "slow",
                    "values": {COST: 150.0},
                    "rest_samples": 1,
                }
            ],
            "notes": ["As printed."],
            "parameters": "As run",
        },
    },
}
TEXTS = {"title", "summary", "source", "report"}
"""What the study says of itself stands in other parts of the page."""
Path = tuple[str | int, ...]


@pytest.fixture
def results(make_results: MakeResults, monkeypatch: pytest.MonkeyPatch) -> StudyResults:
    # Looking for the plug-ins of types that there are not takes most of the time.
    monkeypatch.setattr(settings_module, "_setting_docs", lambda family: {})
    return make_results(**{key: value for key, value in CONTENT.items() if key != "name"} | {"name": "every"})


def alternatives(value: Any) -> list[Any]:
    """Return other values of the same kind, some of which the study may refuse."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, float):
        return [value + 0.25, value + 0.025, math.nextafter(value, math.inf), 2 * value, value / 4]
    if isinstance(value, int):
        return [value + 1]
    if isinstance(value, list):
        return [value[:-1], [*value, *alternatives(value[-1])[:1]]] if value else []
    if isinstance(value, str):
        return [f"{value}x", *_WORDS]
    return []


_WORDS = ("model-exchange", "co-simulation", "rest", "hold", "schroeder", "linear", "sequential", "python")
_WORDS += ("low", "money", "refuse", "dd/mm/yyyy", "utf-16", "Europe/London", "independent")


def changes(content: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield paths into the content and what may stand there instead."""
    items = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in items:
        for other in alternatives(value):
            if other != value:
                yield (*path, key), other
        if isinstance(value, dict | list):
            yield from changes(value, (*path, key))


def changed(content: dict[str, Any], path: Path, value: Any) -> dict[str, Any]:
    copy = deepcopy(content)
    place: Any = copy
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return copy


def renamed(content: dict[str, Any], path: Path, name: str) -> dict[str, Any]:
    """Return the content with another name for the key at the end of the path, in its place."""
    place: Any = content
    for key in path[:-1]:
        place = place[key]
    value = {name if key == path[-1] else key: entry for key, entry in place.items()}
    return changed(content, path[:-1], value) if len(path) > 1 else value


def with_study(results: StudyResults, content: dict[str, Any]) -> StudyResults:
    """Return the results as if they were those of another study with as many controllers and scenarios."""
    study = read(Study, content)
    keys = dict(zip(results.study.controllers, study.controllers, strict=True))
    scenarios = dict(zip(results.study.scenarios, study.scenarios, strict=True))
    cases = tuple(
        replace(
            case,
            controller=keys[case.controller],
            scenario=scenarios[case.scenario],
            label=study.controllers[keys[case.controller]].label or keys[case.controller],
        )
        for case in results.cases
    )
    return replace(results, whole=WholeStudy.of(study), cases=cases)


def text(results: StudyResults) -> str:
    """Return all tables of settings in one text."""
    first = conditions(results)[0]
    return "\n".join(map(table_text, [*settings_tables(results, first, ""), *family_tables(first, "")]))


def table_text(table: Table) -> str:
    rows = [(row.group, row.header, *(cell.text for cell in row.cells)) for row in table.rows]
    return "\n".join(map(repr, [(table.caption, *(heading.words for heading in table.headings)), *rows]))


def sections_in(hint: Any) -> Iterator[type]:
    """Yield the classes of sections in a type, and in their own."""
    if is_dataclass(hint) and isinstance(hint, type):
        yield hint
        for field in declared_fields(hint).values():
            yield from sections_in(field.hint)
    for argument in get_args(hint):
        yield from sections_in(argument)
    for annotation in getattr(hint, "__metadata__", ()):
        if isinstance(annotation, Kinds):
            for kind in (*annotation.classes.values(), *annotation.marked.values()):
                yield from sections_in(kind)


def set_keys(section: Any, table: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield class and key of everything that a table and those in it set."""
    for key, field in declared_fields(type(section)).items():
        if key in table:
            yield type(section).__name__, key
            yield from set_in(field.of(section), table[key])


def set_in(value: Any, said: Any) -> Iterator[tuple[str, str]]:
    if is_dataclass(value) and isinstance(said, dict):
        yield from set_keys(value, said)
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from set_in(entry, said[key])
    elif isinstance(value, list | tuple):
        for entry, other in zip(value, said if isinstance(said, list) else [said], strict=False):
            yield from set_in(entry, other)


def test_the_study_of_these_tests_sets_every_field_there_is() -> None:
    """A field that is added to the study files has to be added to these tests."""
    known = {(section.__name__, name) for section in sections_in(Study) for name in declared_fields(section)}
    installed = {
        ("ScenarioSection", name)
        for name, kind in all_conditions().items()
        if not kind.__module__.startswith("ddpc_cosim.")
    }
    elsewhere = {
        *(("PlantSection", key) for key in ("fmu", "ssp")),  # in place of its name
        ("PlantSection", "library_path"),  # of FMUs
        ("PlantSection", "identified"),  # in tests of plants that are
        *(("Identification", key) for key in declared_fields(Identification)),
        *(("ControllerSection", key) for key in ("search", "first_trials")),  # of what is tuned, not run
        ("ControllerSection", "seeds"),  # in tests of shares, as reference points
        *(("SearchSection", key) for key in declared_fields(SearchSection)),
        ("ReportSection", "reference_points"),  # in tests of shares
        *(("ReferencePoints", key) for key in declared_fields(ReferencePoints)),
        ("ReportSection", "claims"),  # in tests of their table
        *(("ClaimSection", key) for key in declared_fields(ClaimSection)),
        ("ReportSection", "baseline"),  # in tests of the ranking against one
        ("Study", "requirements"),
        *(("RequirementsSection", key) for key in declared_fields(RequirementsSection)),
        *(("RequirementSection", key) for key in declared_fields(RequirementSection)),
        ("Study", "variant_of"),  # in the table of the study's sweep
        ("Study", "varied"),
        ("Study", "based_on"),  # whose settings it has
    }
    assert known - set(set_keys(read(Study, CONTENT), CONTENT)) == elsewhere | installed


def test_studies_that_differ_in_one_value_read_differently(results: StudyResults) -> None:
    content = CONTENT | {"name": "every"}
    seen = {text(with_study(results, content)): "the study itself"}
    tried, free = set(), set()
    settings = {key: value for key, value in content.items() if key not in TEXTS}
    for path, value in changes(settings):
        if path in free:
            continue
        try:
            other = with_study(results, changed(content, path, value))
        except ConfigError:
            continue
        place = f"{path} = {value!r}"
        assert seen.setdefault(text(other), place) == place
        tried.add(path)
        if isinstance(value, str) and value not in _WORDS:
            free.add(path)  # it may be any text: one other is enough
    fixed = {
        path
        for path, _ in changes(settings)
        if path[-1] in ("kind", "distribution") and path[0] != "controllers"
    }
    fixed |= {("metrics", "key_figures", "set"), ("recording", "part")}  # there is one; it has two ends
    assert {path for path, _ in changes(settings)} - tried == fixed


@pytest.mark.parametrize(
    "path",
    [
        ("plant", "parameters", "mass"),
        ("plant", "nominal", "angle"),
        ("plant", "display_units", "angle"),
        ("reference", "constant"),
        ("bounds", "angle"),
        ("recording", "excitation", "torque"),
        ("controllers", "slow"),
        ("controllers", "quick-horizon-9"),
        ("controllers", "quick", "settings", "horizon"),
        ("controllers", "quick", "settings", "kernel", "count"),
        ("controllers", "quick", "bounds", "angle"),
        ("controllers", "quick", "sweep", 0, "horizon"),
        ("scenarios", "calm"),
        ("scenarios", "calm", "noise", "angle"),
        ("scenarios", "calm", "events", 0, "parameters", "damping"),
    ],
    ids=lambda path: ".".join(map(str, path)),
)
def test_studies_that_differ_in_a_name_read_differently(results: StudyResults, path: Path) -> None:
    content = CONTENT | {"name": "every"}
    assert text(with_study(results, renamed(content, path, "another"))) != text(with_study(results, content))


def test_a_plant_and_an_fmu_of_the_same_name_read_differently(results: StudyResults) -> None:
    plant = CONTENT["plant"] | {"name": "", "fmu": "pendulum"}
    assert text(with_study(results, CONTENT | {"plant": plant})) != text(with_study(results, CONTENT))


def test_every_kind_of_reference_is_named(results: StudyResults) -> None:
    shown = text(results)
    assert all(f"'{kind}: " in shown for kind in ("constant", "steps", "ramp", "sine", "file", "uniform"))


def test_a_column_that_is_called_as_its_signal_has_no_empty_name(results: StudyResults) -> None:
    reference = CONTENT["reference"] | {"file": {"kind": "file", "file": "wanted.csv"}}
    shown = text(with_study(results, CONTENT | {"reference": reference}))
    assert "file: file wanted.csv, time column time, interpolation hold" in shown


def test_what_the_study_says_of_itself_is_in_the_page(
    make_results: MakeResults, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Drawing takes most of the time, and what is drawn does not follow from these texts.
    monkeypatch.setattr(over_time, "time_chart", lambda *given: {"mark": "point"})
    monkeypatch.setattr(figure, "drawing", lambda *given: Drawing(Markup("")))
    monkeypatch.setattr(over_time, "brought_to_life", lambda *given: Drawing(Markup("")))
    content = {key: CONTENT[key] for key in sorted(TEXTS)}
    results = make_results(**content)
    content = write(results.study)
    # A controller that is not there is not drawn: taking one from a panel is change enough.
    stated = {
        path: value
        for path, value in reversed([*changes(content)])
        if path[0] in TEXTS and path[-2:-1] != ("controllers",) and path[-1] not in ("logo", "scenario")
    }
    assert {path[1] for path in stated if path[0] == "report"} == {*declared_fields(ReportSection)} - {
        "baseline",
        "claims",
        "logo",  # whose file lies with the results
        "reference_points",
        "scenario",  # which of them is open
    }
    pages = {render_page([results]): "the study itself"}
    for path, value in stated.items():
        page = render_page([with_study(results, changed(content, path, value))])
        assert pages.setdefault(page, f"{path} = {value!r}") == f"{path} = {value!r}"


def test_a_scenario_that_only_drifts_says_so(make_results: MakeResults) -> None:
    drift = {"parameter": "mass", "from_value": 1.0, "to_value": 0.5, "from_time": 5.0, "to_time": 65.0}
    results = make_results(scenarios={"constant": {}, "slow": {"label": "Slow drift", "drifts": [drift]}})
    rows = loop_rows(results)
    assert rows["scenario constant"] == "nothing changed"
    assert (
        rows["scenario Slow drift (slow)"]
        == "mass from 1 to 0.5 between 5\N{NO-BREAK SPACE}s and 65\N{NO-BREAK SPACE}s"
    )


def test_scenarios_of_the_same_label_both_have_their_row(make_results: MakeResults) -> None:
    results = make_results(scenarios={"a": {"label": "Same"}, "b": {"label": "Same"}})
    assert {"scenario Same (a)", "scenario Same (b)"} <= loop_rows(results).keys()


def test_what_is_left_at_its_default_takes_no_room(make_results: MakeResults) -> None:
    rows = loop_rows(make_results())
    assert not any(name.startswith(("plant: ", "loop: ")) for name in rows)
    study = make_study({"quick": {"type": "a"}, "slow": {"type": "b"}}, bounds=CONTENT["bounds"])
    rows = loop_rows(replace(make_results(), whole=WholeStudy.of(study)))
    assert rows["limits of angle"] == "max 70 (values in °)"


def loop_rows(results: StudyResults) -> dict[str, str]:
    table = settings_tables(results, conditions(results)[0], "")[0]
    return {row.header: row.cells[0].text for row in table.rows}


def test_times_and_nominal_values_have_their_units(make_results: MakeResults) -> None:
    plant = {"name": "pendulum", "nominal": {"angle": 0.5, "torque": 2.0}}
    loop = {"sampling_time": 0.1, "duration": 6.0, "start_time": -2.5, "step_timeout": 5.0}
    rows = loop_rows(make_results(plant=plant, loop=loop))
    assert rows["nominal value of angle"] == "0.5\N{NO-BREAK SPACE}rad"
    assert rows["nominal value of torque"] == "2\N{NO-BREAK SPACE}N·m"
    assert rows["start time"] == "\N{MINUS SIGN}2.5\N{NO-BREAK SPACE}s"
    assert rows["longest time for a call"] == "5\N{NO-BREAK SPACE}s"


LEAVES = st.one_of(st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(max_size=4))
NAMES = st.text(max_size=3)
VALUES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3)
)


@given(VALUES, VALUES)
def test_different_values_read_differently(value: Any, other: Any) -> None:
    if value != other:
        assert value_text(value) != value_text(other)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (True, "yes"),
        ("yes", '"yes"'),
        (1e7, "10⁷"),
        (0.1 + 0.2, "0.30000000000000004"),
        ("5", '"5"'),
        ("none", "none"),
        ("module:Class", "module:Class"),
        ("{plant}", "{plant}"),
        ("./a.fmu", "./a.fmu"),
        ("a, b", '"a, b"'),
        (["a", "b"], "[a, b]"),
        ([], "[]"),
        ({}, "{}"),
        ({"a": 1, "b": {"c": 2}}, "a = 1, b = {c = 2}"),
    ],
)
def test_values_are_written_plainly_where_that_is_clear(value: Any, words: str) -> None:
    assert value_text(value) == words


def test_limits_of_their_own_are_not_called_the_same_for_all(make_results: MakeResults) -> None:
    limited = {
        "quick": {"type": "a"},
        "slow": {"type": "b", "bounds": {"angle": {"max": 3.0, "unit": "rad"}}},
    }

    def caption(controllers: dict[str, dict[str, Any]]) -> str:
        results = make_results(controllers=controllers)
        return settings_tables(results, conditions(results)[0], "")[0].caption

    assert caption(limited) == "The loop, the same for all controllers, but for limits of their own"
    assert caption({"quick": {"type": "a"}}) == "The loop, the same for all controllers"


def test_one_sample_is_a_sample(make_results: MakeResults) -> None:
    results = make_results(loop={"sampling_time": 0.1, "duration": 0.1})
    loop = settings_tables(results, conditions(results)[0], "")[0]
    assert next(row.cells[0].text for row in loop.rows if row.header == "duration") == "0.1\u00a0s, 1 sample"


def test_a_type_without_settings_has_no_table(make_results: MakeResults) -> None:
    def trace_of(key: str, seed: int) -> Trace:
        return replace(make_trace(0.5), settings={})

    controllers = {"quick": {"type": "a"}, "slow": {"type": "b", "settings": {"gain": 2.0}}}
    condition = conditions(make_results(trace_of, controllers))[0]
    assert [table.caption for table in family_tables(condition, "")] == ["Settings of type b"]


def test_a_price_of_a_scenario_has_the_unit_of_the_study_s() -> None:
    section = read(ScenarioSection, {"prices": {"power": 0.5, "gas": {"kind": "constant", "value": 2.0}}})
    prices = {
        name: Price(signal="u", price=0.2, unit=unit)
        for name, unit in (("power", "EUR/kWh"), ("gas", "EUR/kg"))
    }
    said = [effect.text for effect in scenario_effects(section, {}, prices)]
    assert said[0] == "price of power: 0.5\u00a0EUR/kWh"
    assert said[1].endswith("(values in EUR/kg)")
