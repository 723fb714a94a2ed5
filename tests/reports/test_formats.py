"""The page as Markdown and JSON: the tables of the page, numbers from metrics.csv, hostile texts as text."""

import json
import math
from dataclasses import replace
from typing import Any

import pandas as pd
import pytest
from lxml import html
from markdown_it import MarkdownIt

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.study.results import write_metrics, write_report

from .synthetic import make_results_in, make_trace

EVIL = "<script>alert(1)</script>|*x*_y_`z`[a](https://b.c) \\ $d$ \x1b[31m\u202e"
SHOWN = EVIL.replace("\x1b", "\\x1b").replace("\u202e", "\\u202e")
FOLDER = "/home/jo/secret"
SETTINGS = {"model": f"{FOLDER}/my model.fmu", EVIL: EVIL}


def trace_of(key: str, seed: int) -> Trace:
    crashes = key == "slow" and seed == 3
    trace = make_trace(
        {"quick": 0.3, "slow": 0.9}[key] + 0.01 * seed,
        noise_seed=seed,
        outcome=Outcome.CRASHED if crashes else Outcome.COMPLETED,
        reason=f"{FOLDER}/own.py: {EVIL}" if crashes else "",
        settings=SETTINGS,
        diagnostics={EVIL: 1.0},
    )
    return replace(trace, warnings=(f"in '{FOLDER}/data.csv' nothing moves",))


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    made = make_results_in(
        tmp_path_factory.mktemp("formats"),
        trace_of,
        {"quick": {"type": "x", "label": EVIL}, "slow": {"type": "x", "note": EVIL, "settings": SETTINGS}},
        provenance={
            "run again": f"ddpc-cosim run {FOLDER}/own.toml",
            "fmu": EVIL,
            "study file": f"{FOLDER}/own.toml",
        },
        title=EVIL,
        summary=f"# {EVIL}\n\n- {EVIL}",
        plant={"fmu": f"{FOLDER}/plant.fmu", "inputs": ["torque"], "outputs": ["angle"]},
        seeds=list(range(7)),
        scenarios={"calm": {"label": EVIL}, "windy": {}},
    )
    write_metrics(made)
    return made


@pytest.fixture(scope="module")
def reports(results: StudyResults) -> dict[str, str]:
    """Return the report in each format."""
    return {
        form: write_report([results], results.folder / f"report.{form}", form).read_text("utf-8")
        for form in ("html", "md", "json", "csv")
    }


@pytest.fixture(scope="module")
def data(reports: dict[str, str]) -> dict[str, Any]:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    read: dict[str, Any] = json.loads(reports["json"], parse_constant=refuse)
    return read


def tables(data: dict[str, Any]) -> list[dict[str, Any]]:
    (part,) = data["parts"]
    blocks = [*part["first"], *(block for section in part["sections"] for block in section["blocks"])]
    return [block for block in blocks if block["kind"] == "table"]


def words(text: str) -> str:
    return " ".join(text.split())


def cells_of(table: html.HtmlElement) -> list[list[str]]:
    rows = table.xpath('./tbody/tr[td][not(@class="group")]')
    return [
        [words(cell.text_content().replace(" (best)", "")) for cell in row.xpath('*[not(@class="drawn")]')]
        for row in rows
    ]


def test_the_tables_are_those_of_the_page(reports: dict[str, str], data: dict[str, Any]) -> None:
    page = html.document_fromstring(reports["html"])
    assert len(tables(data)) > 8
    for table in tables(data):
        (there,) = page.xpath(f'//table[@id="{table["id"]}-table"]')
        expected = [[row["header"], *(cell["text"] for cell in row["cells"])] for row in table["rows"]]
        for shown, texts in zip(cells_of(there), expected, strict=True):
            for full, text in zip(shown, texts, strict=True):
                assert full.startswith(words(text))
    titles = [section["title"] for section in data["parts"][0]["sections"]]
    assert [words(title) for title in page.xpath("//section//h2/text()")] == titles


def test_markdown_has_the_same_tables_and_shows_texts_as_they_are(
    reports: dict[str, str], data: dict[str, Any]
) -> None:
    """Read by another implementation, with HTML allowed."""
    page = html.document_fromstring(
        MarkdownIt("commonmark", {"html": True}).enable("table").render(reports["md"])
    )
    assert not page.xpath("//script | //a | //code | //img")
    shown_tables = page.xpath("//table")
    assert len(shown_tables) == len(tables(data))
    for there, table in zip(shown_tables, tables(data), strict=True):
        assert len(there.xpath("./thead/tr/th")) == len(table["columns"])
        rows = [row for row in cells_of(there) if any(row[1:])]
        for shown, row in zip(rows, table["rows"], strict=True):
            assert shown[0] == words(row["header"])
            assert [text.partition(";")[0] for text in shown[1:]] == [
                words(cell["text"]).partition(";")[0] for cell in row["cells"]
            ]
    titles = [section["title"] for section in data["parts"][0]["sections"]]
    assert [words(title) for title in page.xpath("//h3/text()")] == titles
    (heading,) = page.xpath("//h1")
    assert (
        heading.text_content()
        == "<script>alert(1)</script>|*x*_y_`z`[a](https://b.c) \\ $d$ \\x1b[31m\\u202e"
    )


def test_rankings_and_statistics_follow_from_the_cases(results: StudyResults, data: dict[str, Any]) -> None:
    assert data["schema_version"] == 2
    metrics = pd.read_csv(results.folder / "metrics.csv")
    key = "mean_abs_error.angle [deg]"
    (ranking,) = data["results"][0]["rankings"]
    assert (ranking["metrics"], ranking["seeds"]) == ([key], 7)
    assert [
        (standing["controller"], standing["rank"], standing["failed"]) for standing in ranking["order"]
    ] == [
        ("quick", 1, 0),
        ("slow", 2, 2),
    ]
    for standing in ranking["order"]:
        of_controller = metrics[(metrics["controller"] == standing["controller"]) & ~metrics["failed"]]
        by_seed = of_controller.groupby("seed")[key].median()
        assert standing["medians"] == [pytest.approx(by_seed.median(), rel=1e-12)]
    statistics = pd.DataFrame(data["statistics"]["rows"], columns=data["statistics"]["columns"])
    rows = statistics[(statistics["metric"] == "rmse") & (statistics["scenario"] == "windy")]
    for _, row in rows.iterrows():
        of_controller = metrics[
            (metrics["controller"] == row["controller"]) & (metrics["scenario"] == "windy")
        ]
        assert row["median"] == pytest.approx(
            of_controller.loc[~of_controller["failed"], "rmse.angle [deg]"].median(), rel=1e-12
        )
    assert not any(isinstance(value, float) and math.isinf(value) for row in rows.values for value in row)


def test_no_folder_and_nothing_that_acts_is_in_any_format(
    results: StudyResults, reports: dict[str, str]
) -> None:
    forbidden = ("jo/secret", str(results.folder), "\x1b", "\u202e")
    for form, text in reports.items():
        assert not [name for name in forbidden if name in text], form
    assert "own.py: " in reports["md"]
    assert "my model.fmu" in reports["json"]


def test_the_same_results_give_the_same_bytes(results: StudyResults, reports: dict[str, str]) -> None:
    for form in ("md", "json"):
        again = write_report([results], results.folder / f"again.{form}", form)
        assert again.read_bytes() == (results.folder / f"report.{form}").read_bytes()
