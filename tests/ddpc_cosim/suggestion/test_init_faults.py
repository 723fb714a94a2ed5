"""FMUs that misbehave in the step test: what was seen before is used, and the reason is told."""

from pathlib import Path

import pytest
from fmus.builder import CO_SIMULATION, INTEGRATOR, Fault, describe, model_library, write_fmu

from ddpc_cosim.suggestion import suggest_study, write_study


@pytest.mark.filterwarnings(
    "ignore::ddpc_cosim.CosimWarning"
)  # functions that a run does not need are missing
@pytest.mark.parametrize(
    ("fault", "word"), [(Fault.CALL_ABORT, "SIGABRT"), (Fault.HANG_IN_STEP, "0.5 s")], ids=["abort", "hang"]
)
def test_a_crash_or_a_hang_is_told_in_the_study(fault: Fault, word: str, tmp_path: Path) -> None:
    """The FMU, y' = u, works until t = 0.5 s; this process survives it."""
    text = describe("2.0", f"integrator:{fault:d}", INTEGRATOR[:2], interfaces=CO_SIMULATION)
    fmu = write_fmu(tmp_path / "fragile.fmu", text, model_library("2.0"))
    path = write_study(suggest_study(fmu, step_timeout=0.5, trial=False), fmu, tmp_path / "study.toml")
    text = path.read_text(encoding="utf-8").replace("\n# ", " ")
    assert "y goes on changing by +1 per second (it integrates)" in text
    assert "A run of the step test ended early: fragile.fmu" in text
    assert word in text
