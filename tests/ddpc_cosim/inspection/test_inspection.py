"""What `inspect` finds out about sound FMUs, and in which form it says so."""

import cProfile
import json
import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from ddpc_cosim import CosimWarning, FMUPlant
from ddpc_cosim.cli.main import main
from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.inspection import as_data, inspect_fmu


def run_inspect(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["inspect", *map(str, arguments)])


@pytest.fixture(params=["2.0", "3.0"])
def either_pendulum(request: pytest.FixtureRequest, pendulum_fmu: Path, pendulum_fmi3: Path) -> Path:
    return pendulum_fmu if request.param == "2.0" else pendulum_fmi3


def test_a_sound_fmu_has_no_defects(either_pendulum: Path) -> None:
    inspection = inspect_fmu(either_pendulum, strict=True)
    assert inspection.defects == ()
    assert inspection.can_run
    assert inspection.binaries.route == "binary"


def test_it_lists_what_can_be_driven_measured_and_set(either_pendulum: Path) -> None:
    inspection = inspect_fmu(either_pendulum)
    assert [v.header for v in inspection.inputs] == ["torque [N.m]"]
    assert [v.header for v in inspection.outputs] == ["angle [rad]", "angular_velocity [rad/s]"]
    assert [v.name for v in inspection.states] == ["angle", "angular_velocity"]
    parameters = {p.name: (p.variable.start, p.is_tunable) for p in inspection.parameters}
    assert parameters["mass"] == (1.0, True)
    assert parameters["gravity"] == (9.81, False)


def test_direct_feedthrough_is_read_from_the_model_structure(model_fmu, mutate, pendulum_fmu) -> None:
    assert inspect_fmu(pendulum_fmu).feedthrough == {"angle": (), "angular_velocity": ()}
    assert inspect_fmu(model_fmu("static")).feedthrough == {"y": ("push",)}
    silent = mutate(pendulum_fmu, ('<Unknown index="2" dependencies="2" />', '<Unknown index="2" />'))
    assert inspect_fmu(silent).feedthrough["angle"] is None


def test_the_json_says_everything_and_is_strict_json(either_pendulum: Path) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    result = run_inspect(either_pendulum, "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout, parse_constant=refuse)
    assert data == as_data(inspect_fmu(either_pendulum))
    assert data["can_run"] is True
    assert data["model"]["tool"].startswith("ddpc-cosim")
    assert data["inputs"][0]["name"] == "torque"
    assert data["inputs"][0]["max"] is None  # infinite
    assert set(data["interfaces"]) == {"co-simulation", "model-exchange"}


def test_plain_lines_can_be_searched_and_cut(pendulum_fmu: Path) -> None:
    lines = [line.split("\t") for line in run_inspect(pendulum_fmu).stdout.splitlines()]
    assert ["runs here", "yes"] in lines
    assert ["input", "torque", "[N.m]", "start 0", "Applied torque"] in lines
    assert {line[1] for line in lines if line[0] == "parameter"} >= {"mass", "radius", "damping", "gravity"}
    assert lines[-1][0].startswith(f"suggested study: ddpc-cosim init {pendulum_fmu}")
    assert ["experiment", "start 0 s, stop 40 s, step 0.1 s, tolerance 1e-10"] in lines


def test_what_cannot_be_controlled_is_simulated(mutate, pendulum_fmu: Path) -> None:
    autonomous = mutate(pendulum_fmu, ('causality="input"', 'causality="local"'))
    assert run_inspect(autonomous).stdout.splitlines()[-1] == f"open loop: ddpc-cosim simulate {autonomous}"


def test_names_steer_neither_a_terminal_nor_the_columns(mutate, pendulum_fmu: Path) -> None:
    foreign = mutate(pendulum_fmu, ("Applied torque", "one&#10;two&#9;&#x9b;31m&#x202e;three"))
    result = run_inspect(foreign)
    assert "\tone two \\x9b31m\\u202ethree\n" in result.stdout
    as_json = run_inspect(foreign, "--json").stdout
    assert as_json.isascii()
    assert json.loads(as_json)["inputs"][0]["description"] == "one\ntwo\t\x9b31m\u202ethree"


def parameters(count: int) -> str:
    """Return the description of many parameters, for the end of the pendulum's."""
    return "".join(
        f'<ScalarVariable name="p[{i}]" valueReference="{1000 + i}" causality="parameter" '
        f'variability="fixed"><Real start="{i}" unit="kg"/></ScalarVariable>'
        for i in range(count)
    )


END = "</ModelVariables>"


def test_a_terminal_gets_tables_in_which_long_lists_are_cut(pendulum_fmu, mutate) -> None:
    no_nominal = ('<Real unit="N.m" start="0.0" />', '<Real unit="N.m" nominal="0" start="0.0" />')
    fmu = mutate(pendulum_fmu, (END, parameters(30) + END), no_nominal)
    terminal = {"FORCE_COLOR": "1", "COLUMNS": "160", "TERM": "xterm"}
    cut = CliRunner().invoke(main, ["inspect", str(fmu)], env=terminal).stdout
    assert "Parameters (35)" in cut
    assert "and 15 more; --all shows them" in cut
    assert "p[29]" not in cut
    assert "nominal values of zero: torque (1 is used)" in cut
    full = CliRunner().invoke(main, ["inspect", str(fmu), "--all"], env=terminal).stdout
    assert "p[29]" in full
    assert "p[29]" in run_inspect(fmu).stdout  # what is read by programs is never cut


def test_a_narrow_terminal_breaks_no_name_and_no_number(pendulum_fmu) -> None:
    environment = {"FORCE_COLOR": "1", "COLUMNS": "60", "TERM": "xterm"}
    narrow = re.sub(
        r"\x1b\[[0-9;]*m",
        "",
        CliRunner().invoke(main, ["inspect", str(pendulum_fmu)], env=environment).stdout,
    )
    assert max(map(len, narrow.splitlines())) <= 60
    shown = set(narrow.split())
    for variable in inspect_fmu(pendulum_fmu).inputs + inspect_fmu(pendulum_fmu).outputs:
        assert {variable.name, f"{variable.start:g}"} <= shown
    assert "not shown: " in narrow
    assert "description; in a wider window, and with --json" in " ".join(narrow.split())


def test_the_work_is_linear_in_the_number_of_variables(pendulum_fmu, mutate) -> None:
    def calls(count: int) -> int:
        fmu = mutate(pendulum_fmu, (END, parameters(count) + END))
        profile = cProfile.Profile()
        profile.runcall(inspect_fmu, fmu)
        return sum(entry.callcount for entry in profile.getstats())

    small, middle, large = (calls(count) for count in (0, 500, 1000))
    assert large - small <= 2.1 * (middle - small)


PARSERS = (
    "lxml.etree.fromstring",
    "lxml.etree.parse",
    "lxml.etree.iterparse",
    "xml.etree.ElementTree.fromstring",
    "xml.etree.ElementTree.parse",
    "xml.etree.ElementTree.iterparse",
    "xml.parsers.expat.ParserCreate",
)


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The parsers that were asked, one after the other."""
    calls: list[str] = []

    def count(name: str, parse: Callable[..., Any]) -> Callable[..., Any]:
        def counting(*arguments: Any, **settings: Any) -> Any:
            calls.append(name)
            return parse(*arguments, **settings)

        return counting

    for name in PARSERS:
        module, _, function = name.rpartition(".")
        monkeypatch.setattr(name, count(name, getattr(import_module(module), function)))
    return calls


@pytest.mark.parametrize("form", [[], ["--json"]])
def test_a_description_is_parsed_once(pendulum_fmu: Path, parsed: list[str], form: list[str]) -> None:
    assert run_inspect(pendulum_fmu, *form).exit_code == 0
    assert parsed == ["lxml.etree.parse"]


def test_a_description_that_departs_from_the_standard_is_parsed_once_too(
    pendulum_fmu: Path, mutate: Callable[..., Path], parsed: list[str]
) -> None:
    fmu = mutate(pendulum_fmu, ('fmiVersion="2.0"', 'fmiVersion="2.0.1"'), ('causality="input"', ""))
    with pytest.warns(CosimWarning), FMUPlant(fmu):
        assert parsed == ["lxml.etree.parse"]


def test_exit_codes(pendulum_fmu: Path, tmp_path: Path) -> None:
    assert run_inspect(pendulum_fmu).exit_code == 0
    broken = tmp_path / "broken.fmu"
    broken.write_bytes(pendulum_fmu.read_bytes()[:1000])
    assert run_inspect(broken).exit_code == 1
    assert run_inspect(tmp_path / "missing.fmu").exit_code == 2


def test_a_missing_file_is_an_error_in_python(tmp_path: Path) -> None:
    with pytest.raises(FMUImportError, match="no such file"):
        inspect_fmu(tmp_path / "missing.fmu")


def test_nothing_is_left_behind(pendulum_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    inspect_fmu(pendulum_fmu)
    assert list(tmp_path.iterdir()) == []
