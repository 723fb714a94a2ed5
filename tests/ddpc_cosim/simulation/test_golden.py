"""Comparing with a golden file: the tolerance, the times, and what is refused."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import ConfigError, DataError, Variable
from ddpc_cosim.files.csv_files import CSVFile
from ddpc_cosim.simulation.golden import Golden

H, V, X = Variable("h", unit="m"), Variable("v", unit="m/s"), Variable("x[2]")
KNOWN = {variable.name: variable for variable in (H, V, X)}


def golden(text: str, others: Mapping[str, str] | None = None) -> Golden:
    return Golden(CSVFile(Path("golden.csv"), text), KNOWN, {"x": (2,)}, others or {})


def refusal(text: str, others: Mapping[str, str] | None = None) -> str:
    with pytest.raises((ConfigError, DataError)) as caught:
        golden(text, others)
    return "\n".join(caught.value.faults)


@given(
    span=st.floats(1e-3, 1e6),
    offset=st.floats(-1e3, 1e3),
    rel=st.floats(1e-6, 0.1),
    share=st.floats(-3.0, 3.0),
    row=st.integers(0, 4),
)
def test_a_value_agrees_within_a_share_of_the_range_of_its_signal(
    span: float, offset: float, rel: float, share: float, row: int
) -> None:
    values = offset + span * np.linspace(0.0, 1.0, 5)
    rows = "".join(f"{time},{value!r}\n" for time, value in enumerate(values.tolist()))
    file = golden(f"time,h\n{rows}")
    file.check_times(0.0, 1.0, 4)
    shifted = values.copy()
    shifted[row] += share * rel * span
    floor = 2e-9 * np.abs(values).max() + 1e-12
    difference = file.compare({"h": shifted}, rel, "completed")
    if abs(share) * rel * span < rel * span - floor:
        assert difference.agrees
    if abs(share) * rel * span > rel * span + floor:
        assert not difference.agrees
        assert f"h at t = {row} s is " in difference.words


def test_constant_signals_agree_up_to_rounding_only() -> None:
    file = golden("time,h,v\n0,5,0\n1,5,0\n")
    file.check_times(0.0, 1.0, 1)
    zeros = np.zeros(2)
    assert file.compare({"h": np.array([5.0, 5.0 + 4e-9]), "v": zeros}, 0.1, "").agrees
    assert not file.compare({"h": np.array([5.0, 5.0 + 6e-9]), "v": zeros}, 0.1, "").agrees
    assert not file.compare({"h": np.full(2, 5.0), "v": zeros + 2e-12}, 0.1, "").agrees


def test_the_worst_value_is_told_with_its_time_and_both_values() -> None:
    file = golden("time,h [cm],v\n0,100,0\n0.5,50,-1\n1,0,-2\n")
    file.check_times(0.0, 0.25, 4)
    h, v = np.linspace(1.0, 0.0, 5), np.linspace(0.0, -2.0, 5)
    comparison = file.compare({"h": h, "v": v}, 1e-4, "completed")
    assert comparison.agrees
    assert comparison.words == "golden.csv: equal to the last bit at 3 of 5 samples: h, v"
    v[2] = -0.9
    comparison = file.compare({"h": h, "v": v}, 1e-4, "completed")
    assert comparison.words == (
        "golden.csv: differs: v at t = 0.5 s is -0.9, golden -1: difference 0.1, allowed 0.0002 "
        "(1 of 6 values, in v)"
    )


def test_what_is_not_a_number_never_agrees() -> None:
    file = golden("time,h\n0,1\n1,2\n")
    file.check_times(0.0, 1.0, 1)
    comparison = file.compare({"h": np.array([1.0, np.nan])}, 1.0, "completed")
    assert not comparison.agrees
    assert "h at t = 1 s is nan" in comparison.words
    assert '"nan" is not a finite number' in refusal("time,h\n0,1\n1,nan\n")
    assert "the cell is empty" in refusal("time,h\n0,1\n1,\n")


def test_a_run_that_ended_before_the_file_differs() -> None:
    file = golden("time,h\n0,1\n1,1\n2,1\n")
    file.check_times(0.0, 1.0, 2)
    comparison = file.compare({"h": np.ones(2)}, 1.0, "crashed: why")
    assert not comparison.agrees
    assert comparison.words == "golden.csv: differs: the run ended before its last time, 2 s (crashed: why)"


def test_arrays_and_booleans_are_numbers() -> None:
    file = golden("time,x,h\n0,1 2,true\n1,3 4,false\n", {"x[1]": "not recorded"})
    assert file.names == ["x[2]", "h"]
    assert file.values.tolist() == [[2.0, 1.0], [4.0, 0.0]]
    assert file.notes == ["not compared: x[1] (not recorded)"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,hh\n0,1\n1,1\n", 'no variable "hh"; did you mean "h"?'),
        ("time,text\n0,a\n", "no column in common: it has text; recorded are h, v, x[2]"),
        ("time\n0\n", "no column in common: it has none"),
        ("t,h\n0,1\n", 'no column "time"'),
        ("time,h,outcome\n0,1,crashed\n", "that of a run that ended early"),
        ("time,h [kg]\n0,1\n", 'unit "kg" does not fit h'),
        ("time,h\n0,1\n0,1\n", "it must increase"),
    ],
)
def test_files_that_cannot_be_compared_are_refused_with_the_names(text: str, words: str) -> None:
    assert words in refusal(text, {"text": "String is not a number"})


@pytest.mark.parametrize(
    ("count", "step", "words"),
    [
        (
            4,
            0.5,
            "its times, 0 s to 1 s, are not those of the run, 0 s to 2 s; choose start = 0 and stop = 1",
        ),
        (1, 0.5, "are not those of the run, 0 s to 0.5 s"),
        (5, 0.2, "1 of its 5 times are between two samples of the run, every 0.2 s: 0.25"),
    ],
)
def test_other_times_are_refused(count: int, step: float, words: str) -> None:
    file = golden("time,h\n0,1\n0.25,1\n0.6,1\n0.8,1\n1,1\n")
    assert file.step is None
    with pytest.raises(ConfigError) as caught:
        file.check_times(0.0, step, count)
    assert words in str(caught.value)
