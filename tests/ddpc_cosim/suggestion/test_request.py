"""What a user asks of `init` is checked against the FMU, written into the study, and kept to."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from fmus.builder import CO_SIMULATION, V, describe, model_library, write_fmu

from ddpc_cosim import ConfigError
from ddpc_cosim.cli.main import main
from ddpc_cosim.suggestion import suggest_study


@pytest.fixture
def gained_fmu(tmp_path: Path) -> Path:
    """y' = gain u from y = 0, with an array besides."""
    variables = (
        V("time", 15, causality="independent"),
        V("u", 0, causality="input", start="0", more={"min": "-10", "max": "10"}),
        V("y", 1, causality="output", more={"min": "-100", "max": "100"}),
        V("gain", 6, causality="parameter", variability="tunable", start="1", more={"max": "5"}),
        V("count", 0, "Integer", causality="parameter", variability="fixed", start="2"),
        V(
            "v",
            11,
            causality="parameter",
            variability="fixed",
            start="0 0",
            more={"nested": '<Dimension start="2"/>'},
        ),
    )
    text = describe("3.0", "integrator", variables, interfaces=CO_SIMULATION)
    return write_fmu(tmp_path / "gained.fmu", text, model_library("3.0"))


def init(fmu: Path, out: Path, *options: object) -> Result:
    return CliRunner().invoke(main, ["init", str(fmu), "--out", str(out), *map(str, options)])


def test_what_is_asked_for_is_written_and_kept_to(gained_fmu: Path, tmp_path: Path) -> None:
    """A gain of 3 and an input of 2 at first: y rises by 6 per second by itself, a step adds to that."""
    out = tmp_path / "study.toml"
    asked = ["--at", "gain=3", "--at", "u=2", "--range", "u=-1:4", "--range", "y=-5:20"]
    done = init(gained_fmu, out, *asked, "--sampling-time", 0.25, "--duration", 30)
    assert done.exit_code == 0, done.output
    study = tomllib.loads(out.read_text(encoding="utf-8"))
    assert study["plant"]["parameters"] == {"gain": 3.0}
    assert study["plant"]["start"] == {"u": 2.0}
    assert study["bounds"]["u"] == {"min": -1.0, "max": 4.0}
    assert study["loop"]["sampling_time"] == 0.25
    assert study["loop"]["duration"] == 30.0
    assert study["reference"]["y"]["values"] == [20.0, -5.0]
    assert study["reference"]["y"]["times"] == [0.0, 15.0]
    assert "y goes on changing by -0.9 per second" in out.read_text(
        encoding="utf-8"
    )  # a step of -0.3: 3 times


FAULTS: list[tuple[dict[str, Any], str]] = [
    (
        {"ranges": {"u": "5"}},
        r"range of u: '5' is not a range; needed: two finite numbers LO:HI with LO < HI",
    ),
    ({"ranges": {"u": (3.0, 3.0)}}, r"range of u: 3.0:3.0 is not a range"),
    ({"ranges": {"u": (0.0, float("nan"))}}, r"range of u: 0.0:nan is not a range"),
    ({"ranges": {"u": (0.0, float("inf"))}}, r"range of u: 0.0:inf is not a range"),
    ({"ranges": {"u": (0.0, 20.0)}}, r"range of u: 0:20 is not within \[-10, 10\], the limits that the FMU"),
    ({"ranges": {"uu": (0.0, 1.0)}}, r'range of uu: no input or output has this name; did you mean "u"'),
    ({"ranges": {"v": (0.0, 1.0)}}, r"range of v: it is an array; name its elements: v\[1\], v\[2\]"),
    ({"ranges": {"gain": (0.0, 1.0)}}, r"range of gain: it is neither an input nor an output"),
    ({"ranges": {"u": (0.0, 1.0)}, "at": {"u": 2.0}}, r"0:1 does not hold its operating point 2"),
    ({"ranges": {"y": (0.0, 1.0)}, "outputs": ["gain"]}, r"range of y: it is not used; add --output y"),
    ({"at": {"u": 11.0}}, r"u = 11 is outside \[-10, 10\]"),
    ({"at": {"gain": float("nan")}}, r"gain = nan is outside"),
    ({"at": {"gain": "fast"}}, r"gain = 'fast' must be a number"),
    ({"at": {"count": 1.5}}, r"count = 1.5 must be an integer"),
    ({"at": {"y": 1.0}}, r'"y": the FMU calculates it'),
    ({"at": {"gian": 1.0}}, r'"gian"; did you mean "gain"'),
    ({"at": {"v": 1.0}}, r'"v" is an array; set its elements: v\[1\], v\[2\]'),
    ({"sampling_time": 0.0}, r"sampling time = 0.0 is not possible; allowed: a finite number of seconds > 0"),
    ({"duration": float("inf")}, r"duration = inf is not possible"),
    (
        {"duration": 1.0, "sampling_time": 0.3},
        r"duration = 1 must be a whole multiple of sampling_time = 0.3",
    ),
    ({"duration": 0.1, "sampling_time": 0.1}, r"has 1 samples of 0.1 s; needed: at least 2"),
]


@pytest.mark.parametrize(("asked", "words"), FAULTS)
def test_what_the_fmu_does_not_have_or_allow_is_refused(
    asked: dict[str, Any], words: str, gained_fmu: Path
) -> None:
    with pytest.raises(ConfigError, match=words):
        suggest_study(gained_fmu, **asked)


def test_all_faults_are_told_at_once(gained_fmu: Path, tmp_path: Path) -> None:
    bad = ["--at", "gian=1", "--at", "u=11", "--range", "u=5", "--range", "z=0:1", "--duration", "-1"]
    refused = init(gained_fmu, tmp_path / "study.toml", *bad, "--input", "q")
    assert refused.exit_code == 2
    assert refused.stderr.count("error: ") == 6
    refused = init(gained_fmu, tmp_path / "study.toml", "--at", "gain", "--at", "u=1", "--at", "u=2")
    assert refused.exit_code == 2
    assert '--at "gain" is not possible; needed: NAME=VALUE' in refused.stderr
    assert "--at: u is given more than once" in refused.stderr
    assert not (tmp_path / "study.toml").exists()
