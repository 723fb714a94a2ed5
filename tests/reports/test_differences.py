"""Two runs as a page: what ``diff --html`` writes, its exit codes, and what axe says of it."""

from dataclasses import replace
from pathlib import Path

import pytest
from selenium import webdriver

from ddpc_cosim import StudyResults, Trace
from ddpc_reports import write_differences

from .synthetic import make_results_in, make_trace
from .test_accessibility import AXE, FAULTS
from .test_browser import open_page

pytestmark = pytest.mark.xdist_group("browser")


def run(folder: Path, lags: dict[str, float], **changes: object) -> StudyResults:
    def trace_of(key: str, seed: int) -> Trace:
        return make_trace(lags[key], noise_seed=seed)

    controllers = {key: {"type": "a", "label": f"{key} one"} for key in lags}
    return make_results_in(folder, trace_of, controllers, seeds=["0:6"], **changes)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResults, StudyResults]:
    """Return two runs: of one controller that got better, one that got worse, one that is the same."""
    folder = tmp_path_factory.mktemp("differences")
    before = run(folder / "monday", {"better": 1.0, "worse": 0.5, "same": 0.7, "gone": 1.0})
    after = run(folder / "tuesday", {"better": 0.5, "worse": 1.0, "same": 0.7}, title="Other words")
    return before, after


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def test_the_page_says_who_changed_and_what_the_study_has_to_do_with_it(
    runs: tuple[StudyResults, StudyResults], tmp_path: Path
) -> None:
    page = write_differences(
        *runs, "18 of 24 cases agree", ["gone_0: only in <b>monday</b>"], tmp_path / "d.html"
    )
    text = text_of(page)
    assert "Other words: monday against tuesday" in text
    answer = text.partition('<p class="answer">')[2].partition("</p>")[0]
    assert answer.startswith("Better: <b>better one</b> \N{MINUS SIGN}")
    assert "; worse: <b>worse one</b> +" in answer
    assert "1 of 3 figures are the same." in answer
    table = text.partition('id="s1-changes-table"')[2].partition("</table>")[0]
    rows = {row.partition("one")[0].rpartition(">")[2].strip(): row for row in table.split("<tr>")[2:]}
    assert "versus met" in rows["better"]
    assert "versus missed" in rows["worse"]
    assert "the same" in rows["same"]
    assert "controllers.gone.type" in text
    assert "Only before: 6." in text
    assert "&lt;b&gt;monday" in text
    again = write_differences(
        *runs, "18 of 24 cases agree", ["gone_0: only in <b>monday</b>"], tmp_path / "e.html"
    )
    assert text_of(again) == text


def test_runs_without_a_case_in_common_are_said_to_have_none(
    runs: tuple[StudyResults, StudyResults], tmp_path: Path
) -> None:
    page = write_differences(
        runs[0], replace(runs[1], cases=()), "0 of 24 cases agree", [], tmp_path / "d.html"
    )
    assert "no case in common" in text_of(page)


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 400), ("light", 400)])
def test_axe_finds_nothing_to_fault(
    chromium: webdriver.Chrome,
    runs: tuple[StudyResults, StudyResults],
    tmp_path: Path,
    scheme: str,
    width: int,
) -> None:
    page = write_differences(*runs, "18 of 24 cases agree", ["gone_0: only in monday"], tmp_path / "d.html")
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "screen", "features": features})
    try:
        open_page(chromium, page.as_uri())
        chromium.execute_script(AXE.read_text(encoding="utf-8"))
        assert chromium.execute_async_script(FAULTS) == []
        assert chromium.get_log("browser") == []
    finally:
        chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


def test_a_page_without_charts_has_nothing_to_draw_them(
    chromium: webdriver.Chrome, runs: tuple[StudyResults, StudyResults], tmp_path: Path
) -> None:
    page = write_differences(*runs, "18 of 24 cases agree", [], tmp_path / "d.html")
    assert 'id="chart-library"' not in text_of(page)
    assert page.stat().st_size < 150_000
    open_page(chromium, page.as_uri())
    assert chromium.get_log("browser") == []
