"""Times as people say them: what is said is what is meant, and what is written is read as the same number."""

import re
import tomllib
from datetime import date, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st
from studies import study_text

from ddpc_cosim import Drift, ParameterChange, Ramp, Steps
from ddpc_cosim.codec import read
from ddpc_cosim.files.durations import DURATION_SCHEMA, MOMENT_SCHEMA, in_words, moment_of, seconds_of
from ddpc_cosim.study.file_format.sections import CouplingSection, LoopSection, PartSection, RecordingSection
from ddpc_cosim.study.reading import read_study

from ..study.file_format.test_validation_errors import errors_of


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_what_is_written_is_read_as_the_same_number(seconds: float) -> None:
    assert seconds_of(in_words(seconds)) == seconds
    assert re.search(DURATION_SCHEMA["pattern"], in_words(seconds))


@given(st.integers(0, 400), st.integers(0, 23), st.integers(0, 59))
def test_days_hours_and_minutes_are_said_as_such(days: int, hours: int, minutes: int) -> None:
    words = " ".join(f"{n} {unit}" for n, unit in ((days, "d"), (hours, "h"), (minutes, "min")) if n)
    time = timedelta(days=days, hours=hours, minutes=minutes).total_seconds()
    assert in_words(time) == (words or "0 s")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("14 d", 1_209_600.0),
        ("15 min", 900.0),
        ("1 h 30 min", 5400.0),
        ("0.5 h", 1800.0),
        ("1.1 h", 3960.0),
        ("2h", 7200.0),
        ("-1 d", -86400.0),
        ("20 ms", 0.02),
        ("3 hours", 10800.0),
        ("1 day 1 second", 86401.0),
        (" 90 s ", 90.0),
        ("1e3 s", 1000.0),
    ],
)
def test_a_duration_is_what_it_says(text: str, seconds: float) -> None:
    assert seconds_of(text) == seconds
    assert re.search(DURATION_SCHEMA["pattern"], text)


@pytest.mark.parametrize(
    "text", ["", "long", "15", "min", "15 fortnights", "1 h 2 h", "1 h and 2 min", "--1 d", "nan s"]
)
def test_what_is_not_a_duration_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not a duration|no unit of time|is there twice"):
        seconds_of(text)


@given(st.datetimes(datetime(1900, 1, 1), datetime(2200, 1, 1)))
def test_a_date_counts_from_the_start_of_its_year(moment: datetime) -> None:
    seconds = (moment - datetime(moment.year, 1, 1)).total_seconds()
    assert moment_of(moment) == moment_of(moment.isoformat()) == pytest.approx(seconds)
    assert re.search(MOMENT_SCHEMA["pattern"], moment.isoformat())
    assert moment_of(moment.date()) == moment_of(f"day {moment.timetuple().tm_yday}")


def test_the_time_zone_of_a_date_is_that_of_its_year() -> None:
    assert moment_of(datetime(2026, 1, 1, 6, tzinfo=timezone(timedelta(hours=5)))) == 21600.0
    assert moment_of("day 1") == 0.0
    assert moment_of("2 h") == 7200.0
    assert moment_of(3.5) == 3.5


SAID: list[tuple[Any, dict[str, Any], dict[str, float]]] = [
    (
        LoopSection,
        {"sampling_time": "15 min", "duration": "14 d", "start_time": "day 23", "warm_up": "7 d"},
        {"sampling_time": 900.0, "duration": 1_209_600.0, "start_time": 22 * 86400.0, "warm_up": 7 * 86400.0},
    ),
    (
        LoopSection,
        {"sampling_time": 1.0, "duration": 2.0, "step_timeout": "1 min", "case_timeout": "1 h"},
        {"step_timeout": 60.0, "case_timeout": 3600.0},
    ),
    (
        LoopSection,
        tomllib.loads('sampling_time = "1 h"\nduration = "1 d"\nstart_time = 2026-01-23T06:00:00'),
        {"start_time": 22.25 * 86400.0},
    ),
    (
        LoopSection,
        tomllib.loads('sampling_time = "1 h"\nduration = "1 d"\nstart_time = 2024-03-01'),
        {"start_time": 60 * 86400.0},  # of a leap year
    ),
    (RecordingSection, {"samples": 3, "start_time": date(2026, 1, 2)}, {"start_time": 86400.0}),
    (RecordingSection, {"samples": 3, "start_time": "-1 d"}, {"start_time": -86400.0}),
    (Steps, {"kind": "steps", "times": [0, "6 h"], "values": [1, 2]}, {"times": (0.0, 21600.0)}),
    (
        Ramp,
        {"kind": "ramp", "from_value": 0, "to_value": 1, "from_time": "1 h", "to_time": "2 h"},
        {"start_time": 3600.0, "stop_time": 7200.0},
    ),
    (ParameterChange, {"time": "2 min", "parameters": {"mass": 1.0}}, {"time": 120.0}),
    (
        Drift,
        {"parameter": "m", "from_value": 0, "to_value": 1, "from_time": "1 min", "to_time": "2 min"},
        {"start_time": 60.0, "stop_time": 120.0},
    ),
    (PartSection, {"name": "a", "step": "100 ms"}, {"step": 0.1}),
    (CouplingSection, {"communication_step": "1 min"}, {"communication_step": 60.0}),
]


@pytest.mark.parametrize(("kind", "table", "seconds"), SAID)
def test_whatever_is_in_seconds_may_be_said_so(
    kind: Any, table: dict[str, Any], seconds: dict[str, Any]
) -> None:
    section = read(kind, table)
    assert {name: getattr(section, name) for name in seconds} == seconds


EXPECTED = 'a number of seconds, or a duration such as "15 min", "1 h 30 min" or "14 d"'


@pytest.mark.parametrize(
    ("loop", "fault"),
    [
        ({"duration": "14 fortnights"}, f"loop.duration: must be {EXPECTED}, got '14 fortnights'"),
        ({"sampling_time": "-1 min"}, "loop.sampling_time: must be greater than 0, got -60.0"),
        (
            {"sampling_time": date(2026, 1, 1)},
            f"loop.sampling_time: must be {EXPECTED}, got datetime.date(2026, 1, 1)",
        ),
        (
            {"start_time": "noon"},
            f'loop.start_time: must be {EXPECTED}, or a date such as "2026-01-23" or "2026-01-23T06:00", or '
            "\"day 23\", got 'noon'",
        ),
        (
            {"start_time": "day 400"},
            'loop.start_time: must be "day 1", which is 1 January, to "day 366", got \'day 400\'',
        ),
        ({"case_timeout": "x"}, f"loop.case_timeout: must be {EXPECTED}, got 'x'"),
    ],
)
def test_errors_say_what_is_allowed(loop: dict[str, Any], fault: str, tmp_path: Path) -> None:
    assert errors_of(study_text(loop=loop), tmp_path) == [fault]


def test_a_resolved_study_is_written_in_seconds(tmp_path: Path) -> None:
    loop = {"sampling_time": "0.1 s", "duration": "1 s", "start_time": date(2026, 1, 2)}
    (tmp_path / "study.toml").write_text(study_text(loop=loop), "utf-8")
    tables = read_study(str(tmp_path / "study.toml")).whole.tables()
    assert (tables["loop"]["sampling_time"], tables["loop"]["start_time"]) == (0.1, 86400.0)


def test_a_sweep_may_say_durations(tmp_path: Path) -> None:
    sweep = {"loop.sampling_time": ["100 ms", "0.2 s"]}
    (tmp_path / "study.toml").write_text(study_text(sweep=sweep), "utf-8")
    problems = read_study(str(tmp_path / "study.toml")).problems
    assert [problem.study.loop.sampling_time for problem in problems.values()] == [0.1, 0.1, 0.2]


def test_the_settings_of_a_controller_may_be_said_so(tmp_path: Path) -> None:
    pid = {"type": "pid", "settings": {"proportional": 1.0, "filter_time": "2 min"}}
    (tmp_path / "study.toml").write_text(study_text(controllers={"pid": pid}), "utf-8")
    study = read_study(str(tmp_path / "study.toml")).problem.study
    assert study.controllers["pid"].settings["filter_time"] == 120.0
    pid["settings"] = {"filter_time": "soon"}
    (fault,) = errors_of(study_text(controllers={"pid": pid}), tmp_path)
    assert fault == f"controllers.pid.settings.filter_time: must be {EXPECTED}, got 'soon'"
