"""Write the log that a problem of the benchmark begins with: ``python docs/scripts/log_tanks.py``."""

from pathlib import Path

from ddpc_cosim import PRBS, FMUPlant, GaussianNoise, record
from fmu_plants import build_fmu
from fmu_plants.quadruple_tank import MODEL

STUDIES = Path(__file__).parents[2] / "ddpc_cosim" / "studies"
SAMPLING_TIME = 10.0  # s
PUMPS, LEVELS = ["pump_1", "pump_2"], ["level_1", "level_2"]


def lines() -> list[str]:
    """Return what a logger of the quadruple tank writes while both pumps are switched, to two digits."""
    with FMUPlant(build_fmu(MODEL), inputs=PUMPS, outputs=LEVELS) as plant:
        log = record(
            plant,
            PRBS(2.6, 3.4, samples=800, clock_period=4, seed=7),
            sampling_time=SAMPLING_TIME,
            noise=GaussianNoise(dict.fromkeys(LEVELS, 0.05)),
            seed=7,
        )
    rows = (
        [f"{k * SAMPLING_TIME:.0f}", *(f"{value:.2f}" for value in (*u, *y))]
        for k, (u, y) in enumerate(zip(log.u, log.y, strict=True))
    )
    return ["time [s];pump_1 [V];pump_2 [V];level_1 [cm];level_2 [cm]", *map(";".join, rows)]


if __name__ == "__main__":
    text = "\n".join([*lines(), ""])
    (STUDIES / "tanks-log.csv").write_text(text, encoding="utf-8", newline="\n")
