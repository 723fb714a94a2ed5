"""Known disturbances and their forecasts, bands, limits that move, prices and warm-up, sample by sample."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_cosim import (
    Band,
    Conditions,
    ConfigError,
    Constant,
    Controller,
    DataError,
    FloatArray,
    ForecastFile,
    GaussianNoise,
    KnownDisturbance,
    Loop,
    Plant,
    Price,
    Recording,
    Reference,
    Sample,
    SignalFromFile,
    Sine,
    Steps,
    Trace,
    UniformRandom,
    Variable,
    WhiteNoise,
    cosimulate,
    record,
)

H = 900.0
STEPS = 60
HORIZON = 8
DAY = 86400.0
START = 2 * DAY
TIME = START + H * np.arange(STEPS + 1)
AHEAD = START + H * np.arange(STEPS + 1 + HORIZON)
OUTDOORS = Sine(8.0, 1 / DAY, 5.0, 1.0)
SUN = Steps((0.0, START + 20 * H, START + 40 * H), (0.0, 400.0, 100.0))


class Room(Plant):
    """T+ = 0.9 T + 0.1 T_out + 0.002 heat + 0.001 sun from 20 degC; power is a third of the heat before."""

    inputs = (
        Variable("heat", "W", 0.0, 3000.0, start=700.0),
        Variable("outdoors", "degC", start=5.0),
        Variable("sun", "W/m2", 0.0, 1500.0),
    )
    outputs = (Variable("T", "degC"), Variable("power", "W"), Variable("station", "degC"))

    def reset(self, parameters: Mapping[str, object] | None = None, t0: float = 0.0) -> FloatArray:
        self.state, self.begun = np.array([20.0, 0.0, 5.0]), t0
        return self.state.copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        heat, outdoors, sun = u
        warmer = 0.9 * self.state[0] + 0.1 * outdoors + 0.002 * heat + 0.001 * sun
        self.state = np.array([warmer, heat / 3.0, outdoors])
        return self.state.copy()


@dataclass(kw_only=True)
class Keeper(Controller):
    """Heats by what is missing to the setpoint and keeps what it sees."""

    horizon: int = HORIZON
    accepts_missing: ClassVar[bool] = True
    seen: list[Sample] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        """Nothing to check."""

    def start(self, loop: Loop) -> None:
        self.loop = loop
        self.seen.clear()

    def step(self, sample: Sample) -> FloatArray:
        self.seen.append(sample)
        return np.array([700.0 + 300.0 * (sample.setpoint[0] - np.nan_to_num(sample.y[0], nan=20.0))])

    def column(self, name: str) -> FloatArray:
        """Return a field of all samples, shape (K, ...)."""
        return np.array([getattr(sample, name) for sample in self.seen])


def both(known: str = "measured", **more: Any) -> dict[str, KnownDisturbance]:
    signals = {"outdoors": OUTDOORS, "sun": SUN}
    return {name: KnownDisturbance(signal=s, known=known, **more) for name, s in signals.items()}  # type: ignore[arg-type]


def run(controller: Controller | None = None, **changes: Any) -> Trace:
    arguments: dict[str, Any] = {
        "sampling_time": H,
        "duration": STEPS * H,
        "reference": {"T": Constant(20.0)},
        "outputs": ["T"],
        "start_time": START,
        "disturbances": both(),
    }
    arguments |= changes
    return cosimulate(Room(), controller or Keeper(), **arguments)


def simulated(heat: FloatArray) -> FloatArray:
    """Return the temperature for what the heater gives, shape (K,)."""
    y = np.full(len(heat), 20.0)
    for k in range(len(heat) - 1):
        y[k + 1] = 0.9 * y[k] + 0.1 * OUTDOORS.at(TIME)[k] + 0.002 * heat[k] + 0.001 * SUN.at(TIME)[k]
    return y


def test_what_is_measured_acts_on_the_plant_and_is_held_as_forecast() -> None:
    keeper = Keeper()
    trace = run(keeper)
    truth = np.column_stack([OUTDOORS.at(TIME), SUN.at(TIME)])
    assert [variable.name for variable in keeper.loop.disturbances] == ["outdoors", "sun"]
    np.testing.assert_array_equal(keeper.column("disturbance"), truth)
    np.testing.assert_array_equal(keeper.column("forecast"), np.repeat(truth[:, np.newaxis], HORIZON, axis=1))
    np.testing.assert_array_equal(trace.d, truth)
    np.testing.assert_allclose(trace.y[:, 0], simulated(trace.u[:, 0]), rtol=1e-12)


def test_a_perfect_forecast_is_what_comes_beyond_the_end_of_the_run_too() -> None:
    keeper = Keeper()
    run(keeper, disturbances=both("perfect"))
    truth = np.column_stack([OUTDOORS.at(AHEAD), SUN.at(AHEAD)])
    for k, sample in enumerate(keeper.seen):
        np.testing.assert_array_equal(sample.forecast, truth[k + 1 : k + 1 + HORIZON])
        assert not sample.forecast.flags.writeable


def test_a_long_run_is_told_the_forecast_of_each_hour_at_all_its_samples() -> None:
    """Forecasts of temperatures and the sun change with the hour alone."""
    keeper, steps = Keeper(), 200
    run(keeper, disturbances=both("low"), duration=steps * H)
    forecasts, per_hour = keeper.column("forecast"), round(3600 / H)
    same = np.arange(steps) % per_hour < per_hour - 1
    np.testing.assert_array_equal(forecasts[:-1][same, 1:], forecasts[1:][same, :-1])
    assert (forecasts[:-1][~same, 1:, 0] != forecasts[1:][~same, :-1, 0]).all()
    perfect = Keeper()
    run(perfect, disturbances=both("perfect"), duration=steps * H)
    truth = OUTDOORS.at(START + np.arange(steps + HORIZON + 1) * H)
    ahead = np.arange(steps + 1)[:, np.newaxis] + np.arange(1, HORIZON + 1)
    np.testing.assert_array_equal(perfect.column("forecast")[:, :, 0], truth[ahead])


def test_what_is_not_known_acts_and_is_not_told() -> None:
    keeper = Keeper()
    trace = run(keeper, disturbances=both("unknown"))
    assert keeper.loop.disturbances == ()
    assert keeper.column("disturbance").shape == (STEPS + 1, 0)
    assert keeper.column("forecast").shape == (STEPS + 1, HORIZON, 0)
    np.testing.assert_array_equal(trace.y, run(Keeper()).y)  # who does not look decides the same


@settings(max_examples=20)
@given(st.integers(1, 20), st.sampled_from(["low", "medium", "high"]), st.integers(0, 5))
def test_all_controllers_of_a_study_get_the_same_forecasts(horizon: int, known: str, seed: int) -> None:
    shorter, longer = Keeper(horizon=horizon), Keeper(horizon=horizon + 7)
    load = {"sun": KnownDisturbance(signal=SUN, known=known), "outdoors": both(known)["outdoors"]}  # type: ignore[arg-type]
    for keeper in (shorter, longer):
        run(keeper, disturbances=load, forecast_horizon=40, seed=seed, duration=10 * H)
    np.testing.assert_array_equal(shorter.column("forecast"), longer.column("forecast")[:, :horizon])
    assert not np.array_equal(shorter.column("forecast")[:, :, 1], np.zeros(0))


def errors(known: str, unit: str, signal: Reference, steps: int = 4000, horizon: int = 24) -> FloatArray:
    """Return truth less forecast by sample and lead time, shape (K, horizon)."""

    class OneInput(Room):
        inputs = (Room.inputs[0], Variable("outdoors", unit), Room.inputs[2])

    keeper = Keeper(horizon=horizon)
    cosimulate(
        OneInput(),
        keeper,
        sampling_time=3600.0,
        duration=steps * 3600.0,
        reference={"T": Constant(20.0)},
        outputs=["T"],
        conditions=Conditions(inputs={"sun": Constant(0.0)}),
        disturbances={"outdoors": KnownDisturbance(signal=signal, known=known)},  # type: ignore[arg-type]
        seed=3,
    )
    truth = signal.at(3600.0 * np.arange(steps + 1 + horizon))
    rows = np.lib.stride_tricks.sliding_window_view(truth[1:], horizon)
    return np.asarray(rows - keeper.column("forecast")[:, :, 0])


@pytest.mark.parametrize(
    ("known", "f_0", "k_0", "f", "k", "mu"),
    [
        ("low", 0, 0.6, 0.92, 0.4, 0),
        ("medium", 0.15, 1.2, 0.93, 0.6, 0),
        ("high", -0.58, 1.5, 0.95, 0.7, -0.015),
    ],
)
def test_errors_of_temperatures_grow_with_the_lead_time(
    known: str, f_0: float, k_0: float, f: float, k: float, mu: float
) -> None:
    found = errors(known, "degC", Sine(8.0, 1 / DAY))
    mean, variance = f_0, k_0**2
    for hour in range(found.shape[1] + 1):
        if hour:
            assert found[:, hour - 1].mean() == pytest.approx(mean, abs=0.1)
            assert found[:, hour - 1].std() == pytest.approx(variance**0.5, rel=0.06)
        mean, variance = f * mean + mu, f**2 * variance + k**2
    # In another unit they are as large.
    celsius, fahrenheit = (errors(known, unit, Sine(8.0, 1 / DAY), steps=200) for unit in ("degC", "degF"))
    np.testing.assert_allclose(fahrenheit, 1.8 * celsius, rtol=1e-9, atol=1e-9)


def test_a_forecast_of_the_sun_is_neither_negative_nor_there_at_night() -> None:
    sun = Steps(tuple(np.arange(0, 200) * DAY / 2), (0.0, 500.0) * 100)
    forecast_error = errors("high", "W/m2", sun, steps=2000)
    truth = np.lib.stride_tricks.sliding_window_view(sun.at(3600.0 * np.arange(1, 2001 + 24)), 24)
    forecast = truth - forecast_error
    assert (forecast[truth == 0.0] == 0.0).all()
    by_day = forecast[truth > 0.0]
    assert by_day.min() >= 0.2 * 500.0
    assert by_day.max() <= 2.0 * 500.0
    assert by_day.std() > 50.0


@pytest.mark.parametrize(("known", "share"), [("low", 0.1), ("medium", 0.25), ("high", 0.5)])
def test_errors_of_other_signals_have_their_share_at_the_end_of_the_horizon(known: str, share: float) -> None:
    load = Sine(2.0, 1 / DAY)
    found = errors(known, "N.m", load)
    assert found[:, -1].std() == pytest.approx(share * 2.0 / 2**0.5, rel=0.06)
    assert found[:, 0].std() < 0.5 * found[:, -1].std()


def test_errors_are_seeded_and_independent_of_other_disturbances() -> None:
    forecasts = []
    for disturbances in (both("low"), both("low") | {"sun": KnownDisturbance(signal=SUN)}):
        for seed in (0, 0, 1):
            keeper = Keeper()
            run(keeper, disturbances=disturbances, seed=seed)
            forecasts.append(keeper.column("forecast")[:, :, 0])
    first, again, other = forecasts[:3]
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    np.testing.assert_array_equal(first, forecasts[3])


def test_a_lag_shows_the_interval_before_and_the_forecast_goes_on_from_it() -> None:
    keeper = Keeper()
    run(keeper, disturbances=both("perfect", lag=1))
    truth = np.column_stack([OUTDOORS.at(AHEAD), SUN.at(AHEAD)])
    np.testing.assert_array_equal(keeper.column("disturbance"), truth[[0, *range(STEPS)]])
    for k, sample in enumerate(keeper.seen):
        np.testing.assert_array_equal(sample.forecast, truth[k : k + HORIZON])


@pytest.mark.parametrize("horizon", [0, 1, 3, 8])
@pytest.mark.parametrize("lag", [1, 2, 5])
@pytest.mark.parametrize("warm_up", [0, 4, 7])
def test_any_lag_goes_with_any_horizon_and_warm_up(horizon: int, lag: int, warm_up: int) -> None:
    """What is measured at t_j is of t_j-lag, back to the first sample that was ever measured."""
    keeper, before = Keeper(horizon=horizon), Keeper(horizon=1)
    run(keeper, disturbances=both("perfect", lag=lag), warm_up=warm_up * H, warm_up_controller=before)
    run(Learner(horizon=horizon), disturbances=both("perfect", lag=lag), excitation=EXCITATION)
    times = START + np.arange(-warm_up, STEPS + horizon + 1) * H
    truth = np.column_stack([OUTDOORS.at(times), SUN.at(times)])
    for k, sample in enumerate(keeper.seen):
        rows = np.maximum(warm_up + k + np.arange(horizon + 1) - lag, 0)
        np.testing.assert_array_equal(np.vstack([sample.disturbance, sample.forecast]), truth[rows])


@pytest.mark.parametrize("wrong", [{"lag": -1}, {"lag": 0.5}, {"known": "guessed"}, {"signal": 3.0}])
def test_a_disturbance_in_python_that_cannot_be(wrong: dict[str, Any]) -> None:
    ((name, _),) = wrong.items()
    with pytest.raises(ConfigError, match=f"disturbance: {name} = .*; needed: "):
        KnownDisturbance(**wrong)


def test_a_measured_output_is_a_disturbance() -> None:
    station = KnownDisturbance(signal=OUTDOORS, known="perfect")
    conditions = Conditions(inputs={"outdoors": OUTDOORS, "sun": Constant(0.0)})
    keeper = Keeper()
    run(keeper, conditions=conditions, disturbances={"station": station})
    measured = np.concatenate([[5.0], OUTDOORS.at(TIME)[:-1]])
    np.testing.assert_array_equal(keeper.column("disturbance")[:, 0], measured)
    np.testing.assert_array_equal(keeper.seen[3].forecast[:, 0], OUTDOORS.at(AHEAD)[4 : 4 + HORIZON])


def test_sensors_of_disturbances_have_noise_delay_and_loss() -> None:
    truth = OUTDOORS.at(TIME)
    noisy, late, lossy = Keeper(), Keeper(), Keeper()
    run(noisy, noise=GaussianNoise({"outdoors": 0.5}))
    assert np.std(noisy.column("disturbance")[:, 0] - truth) == pytest.approx(0.5, rel=0.3)
    np.testing.assert_array_equal(noisy.column("disturbance")[:, 1], SUN.at(TIME))
    run(late, conditions=Conditions(delay={"outdoors": 2 * H}))
    np.testing.assert_array_equal(late.column("disturbance")[2:, 0], truth[:-2])
    run(lossy, conditions=Conditions(loss={"outdoors": 0.5}))
    seen = lossy.column("disturbance")[:, 0]
    assert np.isfinite(seen).all()
    assert 10 < np.count_nonzero(np.diff(seen) == 0.0) < 50
    assert np.isin(seen, truth).all()  # the last one that arrived stands in


def test_noise_of_a_disturbance_does_not_change_that_of_outputs() -> None:
    alone, together = Keeper(), Keeper()
    run(alone, noise=GaussianNoise({"T": 0.1}))
    run(together, noise=GaussianNoise({"T": 0.1}), disturbances=both("perfect"))
    np.testing.assert_array_equal(alone.column("y"), together.column("y"))


# The experiment

EXCITATION = UniformRandom(0.0, 1500.0, 30)


@dataclass(kw_only=True)
class Learner(Keeper):
    uses_recording: ClassVar[bool] = True


def test_by_default_the_experiment_ends_where_the_loop_begins() -> None:
    learner = Learner()
    run(learner, excitation=EXCITATION)
    before = START + H * np.arange(-30, 0)
    assert learner.loop.recording is not None
    np.testing.assert_array_equal(
        learner.loop.recording.d, np.column_stack([OUTDOORS.at(before), SUN.at(before)])
    )


def test_in_the_experiment_disturbances_have_their_own_time_and_signal() -> None:
    learner, moved = Learner(), WhiteNoise(2.0, 5.0)
    run(learner, excitation=EXCITATION, recording_start=DAY / 2, recorded_disturbances={"sun": moved})
    assert learner.loop.recording is not None
    d, time = learner.loop.recording.d, DAY / 2 + H * np.arange(30)
    np.testing.assert_array_equal(d[:, 0], OUTDOORS.at(time))
    assert d[:, 1].std() == pytest.approx(2.0, rel=0.4)


def test_noise_is_another_one_in_the_experiment() -> None:
    learner = Learner()
    sun = {"sun": KnownDisturbance(signal=WhiteNoise(50.0, 200.0))}
    calm = Conditions(inputs={"outdoors": Constant(5.0)})
    run(learner, excitation=EXCITATION, disturbances=sun, conditions=calm, recording_start=START)
    assert learner.loop.recording is not None
    assert not np.isin(learner.loop.recording.d, learner.column("disturbance")).any()


def test_a_recording_of_all_disturbances_serves_where_some_are_unknown() -> None:
    recording = record(Room(), EXCITATION, sampling_time=H, outputs=["T"], disturbances=both())
    assert recording.d.shape == (30, 2)
    learner = Learner()
    some = both() | {"outdoors": KnownDisturbance(signal=OUTDOORS, known="unknown")}
    run(learner, recording=recording, disturbances=some)
    assert learner.loop.recording is not None
    np.testing.assert_array_equal(learner.loop.recording.d, recording.d[:, 1:])
    blind = Recording(recording.u, recording.y, recording.measured, H)
    with pytest.raises(DataError, match="0 disturbances, the loop 2"):
        run(Learner(), recording=blind)


def test_the_runs_own_course_in_an_experiment_is_an_error() -> None:
    with pytest.raises(ConfigError) as caught:
        run(Learner(), excitation=EXCITATION, recording_start=START - 10 * H)
    assert [fault.partition(":")[2].partition(":")[0] for fault in caught.value.faults] == [
        " outdoors",
        " sun",
    ]
    assert "the experiment has the run's own course" in str(caught.value)
    run(Learner(), excitation=EXCITATION, recording_start=START - 30 * H)


@pytest.mark.parametrize(("longest", "moments"), [(None, range(0, 61, 13)), (20, range(0, 61, 21))])
def test_a_few_forecasts_are_kept_with_the_samples(longest: int | None, moments: range) -> None:
    keeper = Keeper()
    trace = run(keeper, disturbances=both("medium"), forecast_horizon=longest)
    expected = np.full((STEPS + 1, 2), np.nan)
    for k in moments:
        rows = expected[k + 1 : k + 1 + HORIZON]
        rows[:] = keeper.seen[k].forecast[: len(rows)]
    np.testing.assert_array_equal(trace.forecast, expected)
    np.testing.assert_array_equal(trace.columns()["forecast sun [W/m2]"], expected[:, 1])


def test_without_forecasts_none_are_kept() -> None:
    assert not [header for header in run(disturbances=both()).columns() if header.startswith("forecast")]


# Files


def test_a_signal_from_a_file_has_to_reach_over_run_and_horizon(tmp_path: Path) -> None:
    path = tmp_path / "weather.csv"

    def write(hours: int) -> dict[str, KnownDisturbance]:
        rows = [f"{START + 3600 * i},{i}" for i in range(hours)]
        path.write_text("\n".join(["time [s],outdoors [degC]", *rows]))
        return {"outdoors": KnownDisturbance(signal=SignalFromFile(str(path)), known="perfect")}

    enough = int((STEPS + HORIZON) * H / 3600) + 1
    conditions = Conditions(inputs={"sun": Constant(0.0)})
    run(disturbances=write(enough), conditions=conditions)
    with pytest.raises(ConfigError, match=r"disturbances: outdoors: .*weather.csv tells it from") as caught:
        run(disturbances=write(enough - 2), conditions=conditions)
    assert "needed: from 2 d to 2 d 17 h" in str(caught.value)


def test_a_file_that_is_of_the_experiment_alone_has_to_reach_over_that(tmp_path: Path) -> None:
    def file(first: float, last: float) -> SignalFromFile:
        path = tmp_path / f"{first:g}.csv"
        path.write_text(f"time [s],outdoors [degC]\n{first},5\n{last},6\n")
        return SignalFromFile(str(path))

    end = START + (STEPS + HORIZON) * H
    how = {
        "disturbances": {"outdoors": KnownDisturbance(signal=file(START, end + H), known="perfect")},
        "conditions": Conditions(inputs={"sun": Constant(0.0)}),
        "excitation": EXCITATION,
        "recording_start": -1e6,
    }
    run(recorded_disturbances={"outdoors": file(-1e6, START)}, **how)
    with pytest.raises(ConfigError, match=r"disturbances: outdoors: .*csv tells it from"):
        run(recorded_disturbances={"outdoors": file(-1e6 + 10 * H, START - H)}, **how)


def forecast_file(path: Path, issued: FloatArray, lead: FloatArray) -> ForecastFile:
    header = ",".join(["time [s]", *(f"{hours:g} h" for hours in lead / 3600)])
    rows = [",".join(map(str, [t, *(t / 3600 + 100 * lead)])) for t in issued]
    path.write_text("\n".join([header, *rows]))
    return ForecastFile(str(path))


def test_forecasts_from_a_file_are_those_issued_last(tmp_path: Path) -> None:
    hours = np.arange(5) * 3600.0
    file = forecast_file(tmp_path / "f.csv", START + 3600.0 * np.arange(16), hours)
    keeper = Keeper()
    run(keeper, disturbances=both() | {"outdoors": KnownDisturbance(signal=OUTDOORS, forecast=file)})
    for k, sample in enumerate(keeper.seen):
        issued = START + 3600.0 * (k // 4)
        lead = TIME[k] - issued + H * np.arange(1, HORIZON + 1)
        np.testing.assert_allclose(sample.forecast[:, 0], issued / 3600 + 100 * lead, rtol=1e-12)


@pytest.mark.parametrize("before", ["experiment", "warm-up"])
def test_a_file_of_forecasts_need_not_tell_what_was_before_the_run(tmp_path: Path, before: str) -> None:
    file = forecast_file(tmp_path / "f.csv", START + 3600.0 * np.arange(16), np.arange(5) * 3600.0)
    disturbances = both() | {"outdoors": KnownDisturbance(signal=OUTDOORS, forecast=file)}
    warmer, keeper = Keeper(), Keeper()
    if before == "experiment":
        run(keeper, disturbances=disturbances, excitation=EXCITATION, stabiliser=warmer)
    else:
        run(keeper, disturbances=disturbances, warm_up=4 * H, warm_up_controller=warmer)
    for sample in warmer.seen:
        np.testing.assert_array_equal(sample.forecast, np.tile(sample.disturbance, (HORIZON, 1)))
    assert keeper.seen[0].forecast[0, 0] == pytest.approx(START / 3600 + 100 * H)


@pytest.mark.parametrize(
    ("issued", "lead", "fault"),
    [
        (START + 3600.0 * np.arange(5), 3600.0 * np.arange(5), "ends at t = "),
        (START + 3600.0 * np.arange(16), 3600.0 * np.arange(2), "8 samples ahead"),
        (START + 3600.0 * np.array([0, 1, 1, 2]), 3600.0 * np.arange(40), "it must increase"),
        (
            START + 3600.0 * np.arange(16),
            np.array([0.0, 3600.0, 3600.0, 90000.0]),
            "lead times must increase",
        ),
        (START + 3600.0 * np.arange(1, 16), 3600.0 * np.arange(9), "the first forecast is issued at"),
    ],
)
def test_a_file_of_forecasts_that_cannot_serve(
    tmp_path: Path, issued: FloatArray, lead: FloatArray, fault: str
) -> None:
    file = forecast_file(tmp_path / "f.csv", issued, lead)
    with pytest.raises(DataError, match=r"f\.csv") as caught:
        run(disturbances=both() | {"outdoors": KnownDisturbance(signal=OUTDOORS, forecast=file)})
    assert fault in str(caught.value)


# Bands, limits and prices

NIGHT = Steps((0.0, START + 20 * H, START + 50 * H), (21.0, 18.0, 21.0))


def test_who_does_not_know_bands_gets_the_nearest_point() -> None:
    keeper = Keeper()
    trace = run(keeper, reference={"T": Band(NIGHT, 22.0)}, noise=GaussianNoise({"T": 0.5}))
    lower = NIGHT.at(AHEAD)
    assert keeper.loop.bands == ("T",)
    for k, sample in enumerate(keeper.seen):
        edges = np.column_stack([lower, np.full(len(lower), 22.0)])
        np.testing.assert_array_equal(sample.band_now[0], edges[k])
        np.testing.assert_array_equal(sample.band[:, 0], edges[k + 1 : k + 1 + HORIZON])
        assert sample.setpoint[0] == np.clip(sample.y[0], *edges[k])
        np.testing.assert_array_equal(sample.reference[:, 0], np.clip(sample.y[0], *edges[k + 1 : k + 9].T))
    np.testing.assert_array_equal(trace.band[:, 0, 0], NIGHT.at(TIME))
    np.testing.assert_array_equal(trace.reference, np.clip(trace.y, trace.band[..., 0], trace.band[..., 1]))


def test_a_line_is_a_band_without_width() -> None:
    keeper = Keeper()
    trace = run(keeper, reference={"T": NIGHT})
    sample = keeper.seen[18]
    np.testing.assert_array_equal(sample.band, np.repeat(sample.reference[..., np.newaxis], 2, axis=-1))
    assert keeper.loop.bands == ()
    assert trace.bands == ()
    assert not trace.band.size


def test_no_more_of_a_band_is_seen_than_of_a_reference() -> None:
    keeper = Keeper()
    run(keeper, reference={"T": Band(NIGHT, 24.0)}, bounds={"heat": (0.0, NIGHT)}, preview=2)
    sample = keeper.seen[15]
    np.testing.assert_array_equal(sample.band[2:, 0], np.repeat(sample.band[1:2, 0], HORIZON - 2, axis=0))
    assert sample.band[-1, 0, 0] == 21.0
    assert (sample.input_limits[:, 0, 1] == 21.0).all()


def test_a_band_in_another_unit_and_one_upside_down() -> None:
    kelvin = Band(Constant(293.15, unit="K"), 24.0, unit="degC")
    keeper = Keeper()
    run(keeper, reference={"T": kelvin})
    np.testing.assert_allclose(keeper.seen[0].band_now[0], [20.0, 24.0])
    with pytest.raises(ConfigError, match='unit "Pa" does not fit T'):
        run(reference={"T": Band(20.0, 24.0, "Pa")})
    with pytest.raises(ConfigError, match=r"band of T: lower 21 is above upper 20 at t = .* lower <= upper"):
        run(reference={"T": Band(NIGHT, 20.0)})


def test_limits_that_move_are_shown_and_held() -> None:
    keeper, most = Keeper(), Steps((0.0, START + 30 * H), (900.0, 650.0))
    trace = run(keeper, reference={"T": Constant(60.0)}, bounds={"heat": (100.0, most), "T": (NIGHT, 30.0)})
    assert keeper.loop.moving_limits == ("heat", "T")
    assert (keeper.loop.bounds.u_min[0], keeper.loop.bounds.u_max[0]) == (100.0, 900.0)
    assert (keeper.loop.bounds.y_min[0], keeper.loop.bounds.y_max[0]) == (18.0, 30.0)
    upper = most.at(AHEAD)
    for k, sample in enumerate(keeper.seen):
        np.testing.assert_array_equal(sample.input_limits[:, 0, 1], upper[k : k + 1 + HORIZON])
        np.testing.assert_array_equal(sample.output_limits[:, 0, 0], NIGHT.at(AHEAD)[k + 1 : k + 1 + HORIZON])
    np.testing.assert_array_equal(trace.u[:, 0], most.at(TIME))  # it is far too cold
    np.testing.assert_array_equal(trace.input_limits[:, 0, 1], most.at(TIME))
    with pytest.raises(ConfigError, match="bounds of heat: lower 700 is above upper 650"):
        run(bounds={"heat": (700.0, most)})


DEAR = Steps((0.0, START + 30 * H), (0.2, 0.4))


def test_what_is_paid_is_the_sum_of_price_times_amount() -> None:
    keeper = Keeper()
    prices = {
        "electricity": Price(
            signal="power", price=DEAR, unit="EUR/kWh", emissions=167.0, emissions_unit="g/kWh"
        ),
        "heat": Price(signal="heat", price=0.1, unit="EUR/MWh", factor=0.5, known=False),
    }
    trace = run(keeper, prices=prices, measurements=["T", "power"])
    by_hand = np.sum(DEAR.at(TIME)[:-1] * trace.measured[:-1, 1] * H / 3.6e6)
    charges = keeper.loop.charges
    assert [(charge.unit, charge.amount) for charge in charges] == [("EUR", "kWh"), ("EUR", "MWh")]
    money = trace.price * [charge.rate for charge in charges] * trace.charged * H
    assert money[:-1, 0].sum() == pytest.approx(by_hand, rel=1e-12)
    assert money[:-1, 1].sum() == pytest.approx(0.1 * 0.5 * trace.u[:-1, 0].sum() * H / 3.6e9, rel=1e-12)
    np.testing.assert_allclose(trace.emission, [[0.167, 0.0]] * (STEPS + 1), rtol=1e-12)
    np.testing.assert_array_equal(keeper.seen[28].price[:, 0], DEAR.at(AHEAD)[28 : 28 + HORIZON + 1])


def test_prices_that_are_not_known_ahead_are_held() -> None:
    keeper = Keeper()
    run(keeper, prices={"heat": Price(signal="heat", price=DEAR, unit="EUR/kWh", known=False)})
    assert (keeper.seen[28].price == 0.2).all()
    assert (keeper.seen[30].price == 0.4).all()


@pytest.mark.parametrize(
    ("price", "fault"),
    [
        (Price(signal="power", price=0.2, unit="EUR/kWh"), "power is not measured"),
        (Price(signal="hat", price=0.2, unit="EUR/kWh"), "hat is not a signal of the plant"),
        (Price(signal="heat", price=0.2, unit="EUR/kg"), "W over time is not an amount in kg"),
        (Price(signal="heat", price=0.2, unit="USD/kWh"), "needed: all in one money"),
    ],
)
def test_prices_that_cannot_be(price: Price, fault: str) -> None:
    euros = Price(signal="heat", price=0.2, unit="EUR/kWh")
    with pytest.raises(ConfigError, match="prices: ") as caught:
        run(prices={"first": euros, "second": price}, measurements=["T"])
    assert fault in str(caught.value)


# Warm-up


def test_a_warm_up_hands_over_a_running_plant() -> None:
    before, keeper = Keeper(), Keeper()
    reference = {"T": Band(NIGHT, 22.0)}
    trace = run(keeper, warm_up=12 * H, warm_up_controller=before, reference=reference)
    whole = run(Keeper(), start_time=START - 12 * H, duration=(STEPS + 12) * H, reference=reference)
    past = keeper.loop.past
    assert past is not None
    assert len(past) == 12
    np.testing.assert_array_equal(np.concatenate([past.u, trace.u]), whole.u)
    np.testing.assert_array_equal(np.concatenate([past.y, trace.y]), whole.y)
    np.testing.assert_array_equal(np.concatenate([past.d, trace.d]), whole.d)
    assert trace.time[0] == START
    assert keeper.seen[0].k == 0
    assert before.seen[-1].k == 11


def test_without_a_controller_inputs_rest_during_the_warm_up() -> None:
    keeper = Keeper()
    run(keeper, warm_up=5 * H)
    assert keeper.loop.past is not None
    np.testing.assert_array_equal(keeper.loop.past.u, np.full((5, 1), 700.0))
    assert run(Keeper()).y[0, 0] == 20.0 != keeper.seen[0].y[0]


def test_a_warm_up_that_cannot_be() -> None:
    with pytest.raises(ConfigError, match=r"warm_up = .* is longer than the run"):
        run(warm_up=(STEPS + 1) * H)
    with pytest.raises(ConfigError, match="warm_up does not go with continue_recording"):
        run(Learner(), excitation=EXCITATION, continue_recording=True, warm_up=H)
    with pytest.raises(ConfigError, match="warm_up_controller: Learner learns from a recording itself"):
        run(warm_up=H, warm_up_controller=Learner())


@pytest.mark.parametrize(
    ("disturbances", "fault"),
    [
        ({"wind": KnownDisturbance(signal=OUTDOORS)}, 'no signal "wind"'),
        ({"sun": KnownDisturbance()}, "sun has no signal"),
        ({"station": KnownDisturbance(known="low")}, "what it will be is needed for its forecasts"),
    ],
)
def test_disturbances_that_cannot_be(disturbances: Any, fault: str) -> None:
    with pytest.raises(ConfigError, match="disturbances") as caught:
        run(disturbances=disturbances)
    assert fault in str(caught.value)
