"""``inspect LOG.csv``: roles given and guessed, what is printed, the page, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from ddpc_cosim.cli.main import main
from ddpc_cosim.inspection import logs
from ddpc_cosim.suggestion import suggest_study

from .test_logs import simulated


@pytest.fixture(autouse=True)
def _without_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no method be fitted, which takes most of the time, and is tested elsewhere."""
    monkeypatch.setattr(logs, "predictions", lambda *_: logs.Predictions())


def written(path: Path, missing: int = -1) -> Path:
    u, y = simulated(1, samples=500)
    outdoor = 10.0 + np.sin(np.arange(500) / 50.0) + 0.01 * np.random.default_rng(0).normal(size=500)
    lines = ["time [s],valve [%],level [cm],T_outdoor [degC],setpoint [cm]"]
    for k in range(500):
        level = "" if k == missing else f"{y[k, 0]:.4f}"
        lines.append(f"{60 * k},{50.0 + 10.0 * u[k, 0]:.3f},{level},{outdoor[k]:.3f},{k // 250}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def inspected(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["inspect", *map(str, arguments)])


def test_roles_are_guessed_and_said_to_be(tmp_path: Path) -> None:
    data = json.loads(inspected(written(tmp_path / "log.csv"), "--json").stdout)
    roles = {column["name"]: column["role"] for column in data["columns"]}
    assert roles == {"valve": "input", "level": "output", "T_outdoor": "disturbance", "setpoint": ""}
    notes = " ".join(data["notes"])
    assert "guessed to be inputs (--input says otherwise): valve" in notes
    assert "taken for neither: setpoint: it is called a setpoint" in notes
    assert data["sampling"]["sampling_time"] == 60.0


def test_given_roles_count_and_nothing_is_guessed(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv")
    data = json.loads(inspected(path, "--input", "valve", "--output", "level", "--json").stdout)
    roles = {column["name"]: column["role"] for column in data["columns"]}
    assert roles == {"valve": "input", "level": "output", "T_outdoor": "", "setpoint": ""}
    assert not any("guessed" in note for note in data["notes"])
    (pair,) = data["relations"]["pairs"]
    assert pair["low"] <= 0.2 <= pair["high"]  # cm/%


def test_the_first_line_is_the_verdict_and_decides_the_exit_code(tmp_path: Path) -> None:
    result = inspected(written(tmp_path / "log.csv"))
    first = result.stdout.splitlines()[0].split("\t")
    assert first[0] == "not good"  # no method is fitted here
    assert "no method can be fitted" in first[1]
    assert result.exit_code == 1


def test_an_empty_cell_is_counted_and_costs_its_row_alone(tmp_path: Path) -> None:
    data = json.loads(inspected(written(tmp_path / "log.csv", missing=100), "--json").stdout)
    level = next(column for column in data["columns"] if column["name"] == "level")
    assert (level["missing"], level["first_missing"]) == (1, 100)
    assert data["relations"]["samples"] > 300


def test_what_is_no_table_of_samples_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,u,y\n", encoding="utf-8")
    result = inspected(path, "--input", "u", "--output", "y")
    assert (result.exit_code, result.stderr.splitlines()[-1]) == (
        2,
        "error: log.csv: has no rows; needed: a header and one row per sample",
    )
    rows = "\n".join(f"{k},{k % 7},{k % 5},{k % 3}" for k in range(50))
    path.write_text(f"time,u,y,y\n{rows}\n", encoding="utf-8")
    result = inspected(path, "--input", "u", "--output", "y")
    assert result.exit_code == 2
    assert 'log.csv: several columns are called "y"; rename all but one' in result.stderr


def test_times_that_run_backwards_are_the_reason(tmp_path: Path) -> None:
    lines = written(tmp_path / "log.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "log.csv").write_text("\n".join([lines[0], *lines[:0:-1]]) + "\n", encoding="utf-8")
    result = inspected(tmp_path / "log.csv", "--input", "valve", "--output", "level")
    assert "499 of its 500 rows are earlier than the row before" in result.stdout.splitlines()[0]
    assert "nan" not in result.stdout


def test_one_row_says_nothing_absurd(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time,u,y\n0,1,2\n", encoding="utf-8")
    result = inspected(tmp_path / "log.csv", "--input", "u", "--output", "y")
    assert result.exit_code == 1
    assert "nan" not in result.stdout
    assert "at least 0 samples" not in result.stdout


def test_the_page_says_the_verdict_and_needs_no_network(tmp_path: Path) -> None:
    page = tmp_path / "log.html"
    inspected(written(tmp_path / "<b>log.csv"), "--html", page)
    text = page.read_text(encoding="utf-8")
    assert "Not good enough for predictive control" in text
    assert "What answers what" in text
    assert "&lt;b&gt;log.csv" in text
    assert "<b>log.csv" not in text
    assert 'src="http' not in text


def test_all_that_is_wrong_with_the_options_is_said_at_once(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv")
    result = inspected(path, "--input", "valv", "--output", "level", "--disturbance", "level")
    assert result.exit_code == 2
    assert "--input valv" in result.stderr
    assert "valve" in result.stderr
    assert "--disturbance level: it is given as --output already" in result.stderr


def test_options_of_models_are_not_for_logs(tmp_path: Path) -> None:
    result = inspected(written(tmp_path / "log.csv"), "--strict")
    assert result.exit_code == 2
    assert "--strict: not for a log" in result.stderr


def test_a_spreadsheet_saved_as_cp1252_goes_through_inspect_identify_and_init(tmp_path: Path) -> None:
    """Title rows, semicolons, decimal commas, date and clock apart, and letters that are not ASCII."""
    u, y = simulated(1, samples=400)
    lines = ["Anlage;Tübingen", "", "Datum;Uhrzeit;Stellgröße [%];Vorlauf (°C)"]
    for k, (valve, level) in enumerate(zip(50.0 + 10.0 * u[:, 0], 40.0 + y[:, 0], strict=True)):
        clock = f"02.03.2026;{8 + k // 60:02d}:{k % 60:02d}:00"
        lines.append(f"{clock};{valve:.3f};{level:.4f}".replace(".", ",").replace("02,03,", "02.03."))
    path = tmp_path / "log.csv"
    path.write_bytes("\r\n".join(lines).encode("cp1252"))
    data = json.loads(inspected(path, "--json").stdout)
    columns = {column["name"]: (column["role"], column["unit"]) for column in data["columns"]}
    assert columns == {"Stellgröße": ("input", "%"), "Vorlauf": ("output", "°C")}
    assert (data["sampling"]["sampling_time"], data["sampling"]["rows"]) == (60.0, 400)
    assert any("not UTF-8 text" in note for note in data["notes"])
    how = ("--input", "Stellgröße", "--output", "Vorlauf", "--method", "arx", "--members", "2", "--json")
    done = CliRunner().invoke(main, ["identify", str(path), *how])
    assert "log.csv: not UTF-8 text, read as cp1252" in done.stderr
    gain = json.loads(done.stdout)["gains"]["Vorlauf"]["Stellgröße"]["value"]
    (pair,) = data["relations"]["pairs"]
    assert pair["low"] <= gain <= pair["high"]
    identified = suggest_study(path, trial=False).study.plant.identified
    assert identified is not None
    assert (identified.time_column, identified.encoding) == (["Datum", "Uhrzeit"], "cp1252")
