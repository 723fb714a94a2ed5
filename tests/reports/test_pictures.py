"""Pictures from Python are the page's own figures, in words and colours that stand for themselves."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from lxml import etree

from ddpc_cosim import ConfigError, Outcome, Picture, StudyResults, Trace
from ddpc_cosim.cli.main import main
from ddpc_cosim.study.results import write_report, write_results

from .synthetic import make_results_in, make_trace

EVIL = "<script>a & b</script> 50 % of $x_1$ \\input{y}~^#\x1b[31m"
TAUS = {"quick": 0.3, "slow": 0.9, "gone": 0.5}


def trace_of(key: str, seed: int) -> Trace:
    crashes = key == "gone"
    outcome, reason = (Outcome.CRASHED, "no licence") if crashes else (Outcome.COMPLETED, "")
    return make_trace(TAUS[key] + 0.01 * seed, noise_seed=seed, outcome=outcome, reason=reason)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    controllers = {key: {"type": "x", "label": f"{key.title()} one"} for key in TAUS}
    controllers["slow"]["label"] = EVIL
    return make_results_in(
        tmp_path_factory.mktemp("pictures"),
        trace_of,
        controllers,
        title="Two <b>scenarios</b>",
        seeds=list(range(7)),
        scenarios={"calm": {}, "windy": {"label": "Wind & rain"}},
    )


def texts(picture: Picture) -> str:
    """Return the words of a drawing, which is XML that asks for nothing else."""
    root = etree.fromstring(picture.svg.encode())
    assert not root.xpath("//*[local-name()='script']")
    assert "var(--" not in picture.svg, "a colour by the page's name means nothing elsewhere"
    assert not re.search(r'(href|src)="(?!#)', picture.svg)
    return " ".join(root.itertext())


def test_responses_and_inputs_of_a_scenario_with_a_legend(results: StudyResults) -> None:
    picture = results.plot(scenario="windy")
    words = texts(picture)
    for label in ("Quick one", "reference", "angle / °", "torque / N·m"):
        assert label in words
    assert "<script>a & b</script> 50 % of $x_1$" in words, "as text"
    trace = results.trace("quick", scenario="windy", seed=0)
    drawn = next(iter(picture.charts[0]["datasets"].values()))
    np.testing.assert_allclose([row["c0"] for row in drawn], np.degrees(trace.y[:, 0]), rtol=1e-5)
    np.testing.assert_allclose([row["t"] for row in drawn], trace.time)
    assert picture._repr_svg_() == picture.svg
    assert repr(picture).startswith("Picture('Two <b>scenarios</b>: Wind & rain, seed 0', ")


def test_a_controller_keeps_its_colour_where_others_are_left_out(results: StudyResults) -> None:
    everyone, single = (results.plot(*some, scenario="calm") for some in ((), ("slow",)))
    assert "Quick one" not in texts(single)

    def colour(picture: Picture) -> str:
        line = re.search(r'stroke="([^"]*)" stroke-width="2"[^>]*/><text[^>]*>&lt;script', picture.svg)
        assert line
        return line[1]

    assert colour(everyone) == colour(single)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({}, "several scenarios: calm, windy; say which: scenario = ..."),
        ({"scenario": "clam"}, 'no scenario "clam"; did you mean "calm"?'),
        ({"scenario": "calm", "problem": "other"}, 'no problem "other"'),
    ],
)
def test_what_is_not_said_or_not_there_is_told(results: StudyResults, asked: dict, words: str) -> None:
    for ask in (results.plot, results.plot_spread, results.ranking):
        with pytest.raises(ConfigError, match=re.escape(words)):
            ask(**asked)
    with pytest.raises(ConfigError) as caught:
        results.plot("quik", "solw", scenario="calm")
    assert [fault.partition(";")[0] for fault in caught.value.faults] == [
        'no controller "quik"',
        'no controller "solw"',
    ]


def test_a_metric_over_the_seeds(results: StudyResults) -> None:
    picture = results.plot_spread("rmse.angle", scenario="calm")
    assert "RMSE of angle / °" in texts(picture)
    rows = picture.charts[0]["data"]["values"]
    frame = results.frame()
    quick = frame[(frame["controller"] == "quick") & (frame["scenario"] == "calm")]
    drawn = [row["value"] for row in rows if row["label"] == "Quick one"]
    assert sorted(drawn) == pytest.approx(sorted(quick["rmse.angle [deg]"]), rel=1e-3)
    assert {row["label"] for row in rows} == {"Quick one", rows[-1]["label"]}, "runs that failed have no dot"
    with pytest.raises(ConfigError, match=r'no metric "rmes\.angle"; did you mean "rmse\.angle"'):
        results.plot_spread("rmes.angle", scenario="calm")
    with pytest.raises(ConfigError, match="no run that did not fail has a value"):
        results.plot_spread("", "gone", scenario="calm")


def test_the_ranking_is_that_of_the_first_screen(results: StudyResults, tmp_path: Path) -> None:
    table = results.ranking(scenario="calm")
    frame = table.frame()
    assert list(frame["rank"])[:2] == [1, 2]
    assert frame["Controller"][0] == "Quick one"
    assert "Ranked by mean absolute error" in table._repr_html_()
    assert "<script>" not in table._repr_html_()
    values = results.frame().query("controller == 'quick' and scenario == 'calm'")
    median = float(np.median(values["mean_abs_error.angle [deg]"]))
    assert frame["mean absolute error (°)"][0] == pytest.approx(median)


def test_runs_over_each_other(results: StudyResults) -> None:
    quick, slow = (results.trace(name, scenario="calm", seed=2) for name in ("quick", "slow"))
    picture = quick.plot(slow, labels=["now", "before & after"])
    assert "now before & after" in re.sub(r"\s+", " ", texts(picture))
    drawn = next(iter(picture.charts[0]["datasets"].values()))
    np.testing.assert_allclose([row["c1"] for row in drawn], np.degrees(slow.y[:, 0]), rtol=1e-5)
    assert "run 1, run 2" in texts(quick.plot(slow))
    with pytest.raises(ConfigError, match="labels: a, a; needed: 2 different ones"):
        quick.plot(slow, labels=["a", "a"])
    failed = results.trace("gone", scenario="calm", seed=2)
    assert "run 2: crashed: no licence" in texts(quick.plot(failed))


def test_files_of_every_kind(results: StudyResults, tmp_path: Path) -> None:
    picture = results.trace("quick", scenario="calm", seed=0).plot()
    begins = {".svg": b"<svg", ".pdf": b"%PDF", ".png": b"\x89PNG", ".json": b"["}
    for suffix, begin in begins.items():
        assert picture.save(tmp_path / f"a{suffix}").read_bytes().startswith(begin)
    with pytest.raises(ConfigError, match=r"a\.bmp: the name must end in \.svg, \.pdf, \.png or \.json"):
        picture.save(tmp_path / "a.bmp")
    charts = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert [chart["$schema"] for chart in charts] == ["https://vega.github.io/schema/vega-lite/v6.json"] * 2
    assert (tmp_path / "a.svg").read_bytes() == picture.save(tmp_path / "b.svg").read_bytes()


def test_figures_of_a_report_in_files(results: StudyResults, tmp_path: Path) -> None:
    folder, figures = str(write_results(results).folder), tmp_path / "figures"
    asked = ["--figures", str(figures), "--figure-format", "svg,json"]
    run = CliRunner().invoke(main, ["report", folder, *asked])
    assert run.exit_code == 0, run.output
    names = sorted(path.name for path in figures.iterdir())
    some = {"calm-responses.svg", "calm-responses.json", "windy-spread-0.svg", "calm-step-time.svg"}
    assert some <= {*names}
    count = len(names) // 2
    assert run.stdout.splitlines()[-1] == f"{figures}: {count} figures"
    wrong = CliRunner().invoke(main, ["report", folder, "--figures", str(figures), "--figure-format", "svgs"])
    assert wrong.stderr == 'error: --figure-format: "svgs"; did you mean "svg"?\n'
    (tmp_path / "file").write_text("", encoding="utf-8")
    taken = ["report", folder, "--figures", str(tmp_path / "file" / "below")]
    assert "cannot be written: Not a directory" in CliRunner().invoke(main, taken).stderr


def test_the_rankings_as_latex(results: StudyResults, tmp_path: Path) -> None:
    """Balanced, with as many cells in each row; nothing of a label acts."""
    text = write_report([results], tmp_path / "a.tex", "tex").read_text(encoding="utf-8")
    assert text.count(r"\begin{table}") == text.count(r"\end{table}") == 2
    label = r"\textless{}script\textgreater{}a \& b\textless{}/script\textgreater{} 50 \% of \$x\_1\$ "
    assert label + r"\textbackslash{}input\{y\}\textasciitilde{}\textasciicircum{}\#" in text
    rows = [line for line in text.splitlines() if line.endswith(r" \\")]
    cells = {len(re.findall(r"(?<!\\)&", row)) for row in rows[: len(rows) // 2]}
    assert len(cells) == 1
    assert r"$^\circ$" in text
    assert "\x1b" not in text
    body = re.sub(r"\\[\\{}$%&_#]", "", text)
    assert body.count("{") == body.count("}")


def test_a_comparison_prints_what_is_read_first(results: StudyResults) -> None:
    table = results.compare("rmse.angle", baseline="quick")
    title, head, *rows = repr(table).splitlines()
    assert title == "rmse.angle [deg], less that of quick: medians over the seeds"
    assert head.split() == ["controller", "median", "difference", "from", "(95", "%)", "to", "verdict"]
    assert [row.split()[0] for row in rows[:3]] == ["quick", "slow", "gone"]
    assert rows[0].endswith("baseline")
    assert rows[1].endswith("worse")
    assert rows[2].endswith("failed: no licence")
    slow = table.set_index("controller").loc["slow"]
    frame = results.frame().set_index(["controller", "scenario", "seed"])["rmse.angle [deg]"]
    by_seed = (frame["slow"] - frame["quick"]).groupby("seed").median()
    assert slow["difference"] == pytest.approx(float(by_seed.median()))
    assert math.isnan(table.set_index("controller").loc["gone", "difference"])
    assert type(table[["controller", "median"]]).__name__ == "DataFrame"
    assert "worse" in table._repr_html_()
