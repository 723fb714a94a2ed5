"""Requirements and baselines on the page: what is there without a script, and what the reader chooses."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.support.ui import Select

from ddpc_cosim import StudyResults, Trace
from ddpc_cosim.study.file_format.sections import StudyHead
from ddpc_cosim.study.problems import WholeStudy
from ddpc_reports import write_json, write_markdown, write_report
from ddpc_reports.requirements import overall_words
from ddpc_reports.sections import gather

from .synthetic import make_results_in, make_trace
from .test_accessibility import AXE, FAULTS
from .test_browser import element, open_page

pytestmark = pytest.mark.xdist_group("browser")

LAGS = {"quick": 0.3, "slow": 1.0, "slower": 1.3}
ROWS = """
const table = document.getElementById(arguments[0] + "-table");
const shown = (row) => [...row.cells].filter((cell) => !cell.hidden);
return [...table.tBodies[0].rows].map((row) => shown(row).map((cell) => cell.innerText));
"""
HEADS = """
const table = document.getElementById(arguments[0] + "-table");
return [...[...table.tHead.rows].at(-1).cells].filter((cell) => !cell.hidden).map((cell) => cell.innerText);
"""


def trace_of(key: str, seed: int) -> Trace:
    return make_trace(LAGS[key], noise_seed=seed)


def make(folder: Path, scenarios: dict[str, Any], **report: str) -> Any:
    controllers = {key: {"type": "a", "label": f"{key} one"} for key in LAGS}
    requirements = {"rmse": {"angle": {"max": 4.0, "share": 0.8}}, "overshoot": {"angle": {"max": 50.0}}}
    return make_results_in(
        *(folder / "results", trace_of, controllers),
        seeds=["0:6"],
        scenarios=scenarios,
        requirements=requirements,
        report=report,
    )


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the addresses of reports: of one scenario with a baseline, and of two without."""
    folder = tmp_path_factory.mktemp("against")
    one = make(folder / "one", {"calm": {}}, baseline="slow")
    two = make(folder / "two", {"calm": {}, "noisy": {"noise": {"angle": 0.01}}})
    return {
        "one": write_report([one], folder / "one.html").as_uri(),
        "two": write_report([two], folder / "two.html").as_uri(),
    }


@pytest.fixture
def browser(chromium: webdriver.Chrome) -> Iterator[webdriver.Chrome]:
    yield chromium
    chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


def test_formats_without_a_script_have_the_study_s_baseline(tmp_path: Path) -> None:
    results = make(tmp_path, {"calm": {}}, baseline="slow")
    text = write_markdown([results], tmp_path / "report.md").read_text(encoding="utf-8")
    assert "| Controller | rank | against slow one |" in text
    assert "6 beyond, as far as" in text
    html = write_report([results], tmp_path / "report.html").read_text(encoding="utf-8")
    (head,) = [line for line in html.splitlines() if "against slow one" in line and "<th" in line]
    assert 'scope="col"' in head
    assert "hidden>\n<label>Against <select>" in html
    data = write_json([results], tmp_path / "report.json").read_text(encoding="utf-8")
    assert '"requirements":{"passed":true,"controllers":[],"met_by":["quick"]' in data


def test_the_reader_chooses_whom_others_are_told_against(
    browser: webdriver.Chrome, pages: dict[str, str]
) -> None:
    open_page(browser, pages["one"])
    given = browser.execute_script(ROWS, "s1-ranking")
    assert browser.execute_script(HEADS, "s1-ranking")[3] == "against slow one"
    assert [row[3] for row in given][1] == "baseline"
    assert given[0][3].endswith("% better")
    assert given[0][3].startswith("\N{MINUS SIGN}")
    choose = Select(element(browser, ".against select"))
    choose.select_by_visible_text("quick one")
    rows = browser.execute_script(ROWS, "s1-ranking")
    assert browser.execute_script(HEADS, "s1-ranking")[3] == "against quick one"
    assert rows[0][3] == "baseline"
    assert [(row[3][:1], row[3].rpartition("\xa0")[2]) for row in rows[1:]] == [("+", "% worse")] * 2
    assert [row[4:] for row in rows] == [row[4:] for row in given]
    choose.select_by_index(0)
    assert browser.execute_script(HEADS, "s1-ranking")[3] != "against"
    choose.select_by_visible_text("slow one")
    assert browser.execute_script(ROWS, "s1-ranking") == given


def test_a_column_that_the_reader_asks_for_sorts_by_its_numbers(
    browser: webdriver.Chrome, pages: dict[str, str]
) -> None:
    open_page(browser, pages["two"])
    before = browser.execute_script(HEADS, "s1-matrix")
    Select(element(browser, ".against select")).select_by_visible_text("slower one")
    heads = browser.execute_script(HEADS, "s1-matrix")
    assert heads == [*before[:3], "against slower one", *before[3:]]
    button = "document.querySelectorAll('#s1-matrix-table thead th .sort')[2]"
    for _ in range(2):  # upwards, then downwards
        browser.execute_script(f"{button}.click()")
    first = [row[0] for row in browser.execute_script(ROWS, "s1-matrix")]
    assert first == ["slower one", "slow one", "quick one"]
    assert browser.get_log("browser") == []


@pytest.mark.parametrize("page", ["one", "two"])
@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 400)])
def test_axe_finds_nothing_to_fault(
    browser: webdriver.Chrome, pages: dict[str, str], page: str, scheme: str, width: int
) -> None:
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "screen", "features": features})
    open_page(browser, pages[page])
    Select(element(browser, ".against select")).select_by_visible_text("quick one")
    browser.execute_script(AXE.read_text(encoding="utf-8"))
    assert browser.execute_async_script(FAULTS) == []


def test_of_several_problems_the_first_screen_says_which_pass(tmp_path: Path) -> None:
    lower, higher = (
        make_results_in(
            tmp_path / name,
            trace_of,
            {key: {"type": "a"} for key in LAGS},
            seeds=["0:2"],
            name=name,
            title=name,
            requirements={"rmse": {"angle": {"max": most}}},
        )
        for name, most in (("strict", 1e-9), ("lenient", 1e9))
    )
    words = overall_words([lower, higher])
    assert words is not None
    assert "not passed in strict; passed in lenient." in words
    assert overall_words([make_results_in(tmp_path / "none", seeds=[0])]) is None


def test_the_baseline_is_part_of_the_address(browser: webdriver.Chrome, pages: dict[str, str]) -> None:
    script = "return [location.hash, document.querySelector('.against select').value]"
    open_page(browser, pages["one"])
    Select(element(browser, ".against select")).select_by_visible_text("quick one")
    assert browser.execute_script(script) == ["#against=quick", "quick"]
    Select(element(browser, ".against select")).select_by_index(0)
    assert browser.execute_script(script) == ["#against=", ""]
    browser.back()
    assert browser.execute_script(script) == ["#against=quick", "quick"]
    Select(element(browser, ".against select")).select_by_visible_text("slow one")
    assert browser.execute_script(script) == ["", "slow"]
    open_page(browser, f"{pages['two']}#against=slower&show=quick,slow")
    assert browser.execute_script(script)[1] == "slower"
    assert "against slower one" in browser.execute_script(HEADS, "s1-matrix")
    open_page(browser, f"{pages['one']}#against=nothing-like-it")
    assert browser.execute_script(script)[1] == "slow"


def test_over_all_problems_it_is_counted_where_others_are_better(
    browser: webdriver.Chrome, tmp_path: Path
) -> None:
    """Three problems, in the last of which the order is the reverse; the choice holds for all parts."""
    parts = [
        make_results_in(
            tmp_path / name,
            lambda key, seed, sign=sign: make_trace(LAGS[key] if sign else 1.6 - LAGS[key], noise_seed=seed),
            {key: {"type": "a", "label": f"{key} one"} for key in LAGS},
            seeds=["0:8"],
            name=name,
            report={"baseline": "slow"},
        )
        for name, sign in (("one", True), ("two", True), ("three", False))
    ]
    cases = tuple(replace(case, problem=part.study.name) for part in parts for case in part.cases)
    whole = WholeStudy(StudyHead(name="all"), {part.study.name: part.study for part in parts})
    results = StudyResults(parts[0].folder, whole, cases, {})
    table = gather([results]).parts[0].first[0][1]
    (place,) = [i for i, heading in enumerate(table.headings) if heading.title == "against slow one"]
    counts = {row.key: row.cells[place - 1].text for row in table.rows}
    assert counts == {"slow": "baseline", "quick": "2 better, 1 worse", "slower": "1 better, 2 worse"}
    open_page(browser, write_report([results], tmp_path / "report.html").as_uri())
    Select(element(browser, ".against select")).select_by_visible_text("quick one")
    said = {row[0]: row[3] for row in browser.execute_script(ROWS, "s1-matrix")}
    assert said == {
        "quick one": "baseline",
        "slow one": "1 better, 2 worse",
        "slower one": "1 better, 2 worse",
    }
    values = "return [...document.querySelectorAll('.against select')].map((select) => select.value)"
    assert browser.execute_script(values) == ["quick"] * 4
    assert "against quick one" in browser.execute_script(HEADS, "s3-ranking")
    assert browser.get_log("browser") == []
