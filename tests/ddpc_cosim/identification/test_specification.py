"""A plant from logs, before and after its models are found."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from ddpc_cosim import Identification
from ddpc_cosim.identification import specification
from ddpc_cosim.identification.specification import IdentifiedSpec
from ddpc_cosim.identification.summary import identified_data, identified_lines


def log(path: Path, seed: int = 0) -> Path:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, 40), 5)
    y = lfilter([0.0, 0.2], [1.0, -0.8], u) + 0.05 * rng.standard_normal(200)
    np.savetxt(path, np.column_stack([np.arange(200.0), u, y]), delimiter=",", header="time,u,y", comments="")
    return path


def spec(path: Path) -> IdentifiedSpec:
    return IdentifiedSpec(Identification(file=[str(path)], method="arx", order=1, members=4), ("u",), ("y",))


def gains_of(built: IdentifiedSpec) -> list[float]:
    assert built.ensemble is not None
    return [float(model.output(model.rest(np.ones(1), np.empty(0)))[0]) for model in built.ensemble.models]


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the settings that models have been searched for by, as of processes that begin anew."""
    counted, search = list[str](), specification._found

    def found(*key: str) -> specification.Ensemble:
        counted.append(key[1])
        return search(*key)

    monkeypatch.setattr(specification, "_found", found)
    return counted


def anew(path: Path) -> IdentifiedSpec:
    """Build a plant as a process does that has just begun."""
    specification._ensemble.cache_clear()
    return spec(path).built()


def test_models_are_found_once_for_all_processes_and_anew_for_another_log(
    tmp_path: Path, searches: list[str]
) -> None:
    first = anew(log(tmp_path / "log.csv"))
    again = anew(tmp_path / "log.csv")
    assert len(searches) == 1
    assert gains_of(again) == gains_of(first)
    other = anew(log(tmp_path / "log.csv", 1))
    assert len(searches) == 2
    assert gains_of(other) != gains_of(first)


def test_where_nothing_can_be_cached_models_are_found_all_the_same(
    tmp_path: Path, searches: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cache").write_text("a file", encoding="utf-8")
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
    first, again = (anew(log(tmp_path / "log.csv", 2)) for _ in range(2))
    assert len(searches) == 2
    assert gains_of(again) == gains_of(first)


def test_time_constants_and_periods_are_those_of_the_plants_poles(tmp_path: Path) -> None:
    h, slow, swings = 0.5, 0.97, 0.9 * np.exp(0.6j)
    rng = np.random.default_rng(5)
    u, e = rng.uniform(-1.0, 1.0, 3000), 0.01 * rng.standard_normal(3000)
    y = lfilter([1.0], np.poly([slow, swings, swings.conjugate()]).real, np.append(0.0, u[:-1]) + e)
    table = np.column_stack([h * np.arange(3000), u, y])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time,u,y", comments="")
    identification = Identification(file=[str(tmp_path / "log.csv")], method="arx", order=3, members=20)
    built = IdentifiedSpec(identification, ("u",), ("y",)).built()
    data = identified_data(built)
    first, second = data["poles"]
    assert first["period"] is None
    for found, true in (
        (first["time_constant"], -h / np.log(slow)),
        (second["time_constant"], -h / np.log(0.9)),
        (second["period"], 2.0 * np.pi * h / 0.6),
    ):
        assert found["value"] == pytest.approx(true, rel=0.02)
        assert found["low"] < found["value"] < found["high"] < 1.1 * found["low"]
    (line,) = (line for line in identified_lines(built, data) if line.startswith("further time constant"))
    assert ", period 5.2" in line
