"""Built-in studies: one TOML file each, found by entry point like anyone's."""

from pathlib import Path

_FOLDER = Path(__file__).parent

benchmark = _FOLDER / "benchmark.toml"
buildings = _FOLDER / "buildings.toml"
claims = _FOLDER / "claims.toml"
direction_change = _FOLDER / "direction-change.toml"
excitation = _FOLDER / "excitation.toml"
forecast = _FOLDER / "forecast.toml"
mimo = _FOLDER / "mimo.toml"
monte_carlo = _FOLDER / "monte-carlo.toml"
noise = _FOLDER / "noise.toml"
paper = _FOLDER / "paper.toml"
prices = _FOLDER / "prices.toml"
reactor = _FOLDER / "reactor.toml"
time_varying = _FOLDER / "time-varying.toml"
tuning = _FOLDER / "tuning.toml"
unstable = _FOLDER / "unstable.toml"
