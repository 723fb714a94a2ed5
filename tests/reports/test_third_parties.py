"""Sections of third parties: the documented one, installed; what they may return; those that fail."""

import importlib
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from ddpc_cosim import CosimWarning, PluginError, ReportSection, ReportTable
from ddpc_cosim.plugins import describe, installed
from ddpc_cosim.study.results import report_formats, write_metrics, write_report
from ddpc_reports.third_parties import own_blocks

from .synthetic import MakeResults, make_trace

PAGE = Path(__file__).parents[2] / "docs" / "extend" / "write-a-report-section.md"
OTHERS = """
from ddpc_cosim import ReportSection
def raising(results):
    raise ValueError("nothing in /home/jo/own/data.csv")
def leaving(results):
    raise SystemExit(3)
failing = ReportSection("<b>Failing</b>", raising)
quitting = ReportSection("Quitting", leaving)
nothing = ReportSection("Nothing", lambda results: [])
text = "<script>alert(1)</script> *a* \\x1b[31m"
hostile = ReportSection("Hostile", lambda results: [text], after="Responses")
wrong = 3
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    for name in ("ddpc_worst_seeds", "other_sections"):
        sys.modules.pop(name, None)


def install(site: Path, **targets: str) -> None:
    info = site / "sections-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: sections\nVersion: 1.0\n", encoding="utf-8")
    lines = [f"{name} = {target}" for name, target in targets.items()]
    (info / "entry_points.txt").write_text("\n".join(["[ddpc_cosim.reports]", *lines]), encoding="utf-8")
    importlib.invalidate_caches()


def test_the_section_of_the_documentation_is_in_every_format(
    site: Path, make_results: MakeResults, tmp_path: Path
) -> None:
    files = dict(re.findall(r"^```\w+ (\S+)\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL))
    (site / "ddpc_worst_seeds.py").write_text(files["ddpc_worst_seeds.py"], encoding="utf-8")
    install(site, **tomllib.loads(files["pyproject.toml"])["project"]["entry-points"]["ddpc_cosim.reports"])
    (plugin,) = (entry for entry in installed("reports") if entry.name == "worst-seeds")
    assert describe(plugin) == ("section of the report: Worst seeds", True)
    assert {"html", "md", "csv", "json"} <= {*report_formats()}
    assert "worst-seeds" not in report_formats()
    results = make_results(
        lambda key, seed: make_trace(0.5 if key == "slow" else 0.3 + (seed == 8) / 10, noise_seed=seed),
        seeds=[7, 8, 9],
    )
    write_metrics(results)
    metrics = pd.read_csv(results.folder / "metrics.csv")
    worst = metrics.loc[metrics.groupby("controller")["rmse.angle [deg]"].idxmax()]
    expected = {(row["controller"], row["seed"]) for _, row in worst.iterrows()}
    page = write_report([results], tmp_path / "report.html").read_text("utf-8")
    section = page[page.index('<h2 id="s1-own-worst-seeds">') :].partition("</section>")[0]
    titles = re.findall(r'aria-label="Link to this section: ([^"]*)"', page)
    assert titles[titles.index("Step response") + 1] == "Worst seeds"
    assert "A controller is as good as its worst run: where is that?" in section
    assert len(re.findall("<svg(?! class=.swatch)", section)) == 1
    assert "rmse.angle [deg] of every run" in section
    read = json.loads(write_report([results], tmp_path / "report.json", "json").read_text("utf-8"))
    (shown,) = (section for section in read["parts"][0]["sections"] if section["title"] == "Worst seeds")
    rows = shown["blocks"][1]["rows"]
    assert {(row["header"], int(row["cells"][1]["value"])) for row in rows} == expected
    said = write_report([results], tmp_path / "report.md", "md").read_text("utf-8")
    assert said.index("### Step response") < said.index("### Worst seeds") < said.index("### Limits and")
    assert all(f"| {label} | nominal | {seed} |" in said for label, seed in expected)


def test_sections_that_fail_cost_themselves_and_texts_act_on_nothing(
    site: Path, make_results: MakeResults, tmp_path: Path
) -> None:
    (site / "other_sections.py").write_text(OTHERS, encoding="utf-8")
    names = ("failing", "quitting", "nothing", "hostile", "wrong")
    install(site, missing="nowhere:section", **{name: f"other_sections:{name}" for name in names})
    with pytest.warns(CosimWarning) as warnings:
        page = write_report([make_results()], tmp_path / "report.html").read_text("utf-8")
    warned = [str(warning.message) for warning in warnings]
    assert "&lt;b&gt;Failing&lt;/b&gt;: cannot be shown: ValueError: nothing in data.csv" in page
    assert "Quitting: cannot be shown: PluginError: it has ended the program: SystemExit: 3" in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; *a* \\x1b[31m" in page
    assert ">Nothing" not in page
    assert "How to reproduce" in page
    titles = re.findall(r'aria-label="Link to this section: ([^"]*)"', page)
    assert titles.index("Hostile") == titles.index("Responses") + 1
    assert titles.index("Quitting") < titles.index("Fairness and known limitations")
    assert any("report missing (sections 1.0): ModuleNotFoundError" in message for message in warned)
    assert any(
        "report wrong (sections 1.0): it is a int; needed: a ddpc_cosim.ReportSection" in message
        for message in warned
    )


def chart(**changes: Any) -> dict[str, Any]:
    data = {"values": [{"url": "a", "y": 1.0}]}
    encoding = {"x": {"field": "url", "type": "nominal"}, "y": {"field": "y", "type": "quantitative"}}
    return {"data": data, "mark": "point", "encoding": encoding} | changes


@pytest.mark.parametrize(
    ("block", "fault"),
    [
        (chart(data={"url": "https://example.org/data.csv"}), '"url" in a chart: a report loads nothing'),
        (chart(mark={"type": "image", "url": "https://example.org/a.png"}), '"url" in a chart'),
        ({"layer": [chart(), chart(encoding={"href": {"field": "url"}})]}, '"href" in a chart'),
        (chart(data={"values": [], "y": float("nan")}), "nan in a chart: give null"),
        (ReportTable("Short", ["a", "b"], [("x",)]), 'table "Short": a row has 1 cells; needed: 2'),
        (7, "block 1 is a int; needed: a str, a ddpc_cosim.ReportTable, or a Vega-Lite specification"),
    ],
)
def test_what_a_section_may_not_return_is_named(block: Any, fault: str, make_results: MakeResults) -> None:
    make: Callable[..., list[Any]] = lambda results: [block]  # noqa: E731
    with pytest.raises(PluginError, match=re.escape(fault)):
        own_blocks(ReportSection("Own", make), make_results(), "x-")


def test_a_chart_with_its_data_is_drawn_and_stays_as_it_is(make_results: MakeResults) -> None:
    def make(results: object) -> list[dict[str, Any]]:
        return [chart(description="One <point>.")]

    ((kind, (figure, _)),) = own_blocks(ReportSection("Own", make), make_results(), "x-")
    (view,) = figure.views
    assert (kind, figure.caption) == ("figure", "One <point>.")
    assert 'aria-label="One &lt;point&gt;."' in view.drawing.svg
    assert view.drawing.vega == {}
