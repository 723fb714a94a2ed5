"""What repeats itself is told from what drifts, and studies take whole periods of it."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given, strategies as st

from ddpc_cosim.signals.excitations import UniformRandom
from ddpc_cosim.suggestion import suggest_study, write_study
from ddpc_cosim.suggestion.periods import period_of, rounded_period
from fmu_plants import Equations, PlantModel, Variable, build_fmu

K = np.arange(400.0)


@given(period=st.floats(12.0, 120.0), phase=st.floats(0.0, 6.0), trend=st.floats(-0.01, 0.01))
def test_a_wave_on_a_slope_has_its_period(period: float, phase: float, trend: float) -> None:
    wave = np.sin(2 * np.pi * K / period + phase) + 0.3 * np.cos(4 * np.pi * K / period)
    assert period_of(wave + trend * K) == pytest.approx(period, rel=0.02)


@pytest.mark.parametrize(
    "values",
    [
        K,
        K**2,
        np.exp(-K / 50),
        np.exp(K / 60),
        np.exp(-K / 100) * np.sin(K / 5),
        np.sin(K / 300),
        np.random.default_rng(0).normal(size=400),
        np.cumsum(np.random.default_rng(1).normal(size=400)),
        np.zeros(400),
        np.full(400, np.nan),
    ],
    ids=["line", "parabola", "decay", "growth", "damped", "half a wave", "noise", "walk", "rest", "NaN"],
)
def test_what_does_not_repeat_has_no_period(values: np.ndarray) -> None:
    assert period_of(values) == 0.0


def test_days_are_days() -> None:
    assert [rounded_period(s) for s in (86311.0, 3605.0, 37.6991)] == [86400.0, 3600.0, 37.7]


INDOORS, COLD = Variable("indoors", "degC", start=18.0), Variable("indoors", "degC", start=-1.0)


def room(around: Callable[[Any], Any]) -> PlantModel:
    """2 h, 3 K/kW."""
    return PlantModel(
        name="stube",
        equations=lambda v: Equations({"indoors": (10 + around(v.time) + 3 * v.stove - v.indoors) / 7200}),
        states=(INDOORS,),
        inputs=(Variable("stove", "kW", min=0.0, max=10.0, start=3.0),),
        outputs=(INDOORS,),
        stop_time=5 * 86400.0,
    )


def test_a_study_takes_whole_days_of_a_house_in_the_weather(own_cache_folder: None, tmp_path: Path) -> None:
    """The mean of it is 19 degC, whatever the hour at which it begins."""
    fmu = build_fmu(room(lambda t: 8 * sympy.sin(2 * sympy.pi * t / 86400)))
    proposal = suggest_study(fmu, trial=False)
    text = write_study(proposal, fmu, tmp_path / "s.toml").read_text(encoding="utf-8").replace("\n# ", " ")
    assert "indoors repeats every 24 h while the inputs rest" in text
    assert "drifts" not in text
    study, sample = proposal.study, proposal.sampling_time
    assert math.isclose(86400 / sample, round(86400 / sample))
    assert 7200 / 30 <= sample <= 7200 / 3.3
    steps = proposal.setpoints["indoors"]
    assert [time % 86400 for time in (*steps.times, study.loop.duration)] == [0.0] * 3
    assert study.recording is not None
    assert study.recording.samples * sample % 86400 == pytest.approx(0.0)
    assert isinstance(study.recording.excitation["stove"], UniformRandom)
    assert np.mean(steps.values) == pytest.approx(19.0, abs=0.5)


def test_a_drift_is_a_drift(own_cache_folder: None, tmp_path: Path) -> None:
    """It gets warmer by 2 K a day, and does not come back."""
    fmu = build_fmu(room(lambda t: 2 * t / 86400))
    proposal = suggest_study(fmu, trial=False)
    text = write_study(proposal, fmu, tmp_path / "s.toml").read_text(encoding="utf-8")
    assert "indoors: drifts even while the inputs rest" in text
    assert "repeats" not in text


def test_what_only_takes_its_time_to_rest_does_not_drift(own_cache_folder: None) -> None:
    """It starts 20 K away from where it rests, and setpoints are about the latter: 10 + 3 * 3 degC."""
    cold = room(lambda t: 0)
    away = PlantModel(
        name="cold_stube",
        equations=cold.equations,
        states=(COLD,),
        inputs=cold.inputs,
        outputs=(COLD,),
        stop_time=16 * 3600.0,
    )
    proposal = suggest_study(build_fmu(away), trial=False)
    assert np.mean(proposal.setpoints["indoors"].values) == pytest.approx(19.0, abs=1.0)
