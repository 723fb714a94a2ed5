"""One scenario and one problem at a time, one legend, and the address that says what is shown."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from ddpc_cosim import Outcome, StudyResults, Trace
from ddpc_cosim.study.file_format.sections import StudyHead
from ddpc_cosim.study.problems import WholeStudy
from ddpc_reports import write_report

from .synthetic import make_results_in, make_trace
from .test_browser import element, lines_drawn, make_live, open_page, wait

pytestmark = pytest.mark.xdist_group("browser")

LAGS = {"slow": 1.0, "quick": 0.3, "middle": 0.6, "broken": 0.4, "fair": 0.5}
"""By rank: quick, fair, middle, slow; broken fails in one scenario."""
CONTROLLERS: dict[str, dict[str, Any]] = {key: {"type": "a", "label": key.capitalize()} for key in LAGS}
SCENARIOS = {
    "calm": {"label": "All calm"},
    "worst-by-far": {"label": "Worst", "noise": {"angle": 0.02}},
    "other": {"label": "Other", "noise": {"angle": 0.01}},
}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a report of five controllers in three scenarios, one of which is the worst."""
    folder = tmp_path_factory.mktemp("switch")
    count = iter(range(100))

    def trace_of(key: str, seed: int) -> Trace:
        # Scenario by scenario: the second of a controller is that in which a run fails.
        if key == "broken" and next(count) % 6 in (2, 3):
            return make_trace(0.4, outcome=Outcome.DIVERGED, reason="angle is NaN")
        return make_trace(LAGS[key], noise_seed=seed)

    results = make_results_in(
        folder / "results", trace_of, CONTROLLERS, seeds=[7, 0], scenarios=SCENARIOS, title="Three"
    )
    return write_report([results], folder / "report.html").as_uri()


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a report of two studies, one of which has two scenarios."""
    folder = tmp_path_factory.mktemp("several")
    first = make_results_in(folder / "first", None, name="first", title="First study")
    second = make_results_in(
        folder / "second", None, name="second", title="Second study", scenarios={"calm": {}, "other": {}}
    )
    return write_report([first, second], folder / "report.html").as_uri()


@pytest.fixture(scope="module")
def problems(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a report of a study of two problems."""
    folder = tmp_path_factory.mktemp("problems")
    parts = [make_results_in(folder / name, name=name, title=name.capitalize()) for name in ("one", "two")]
    cases = tuple(replace(case, problem=part.study.name) for part in parts for case in part.cases)
    whole = WholeStudy(StudyHead(name="both"), {part.study.name: part.study for part in parts})
    return write_report([StudyResults(parts[0].folder, whole, cases, {})], folder / "report.html").as_uri()


@pytest.fixture
def browser(chromium: webdriver.Chrome) -> Iterator[webdriver.Chrome]:
    yield chromium
    chromium.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
    chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


def tab(browser: webdriver.Chrome, name: str) -> Any:
    return element(browser, f"[role=tab][data-name='{name}']")


def chosen(browser: webdriver.Chrome) -> list[str]:
    """Return the names of the tabs that are selected, of the lists that are shown."""
    tabs = browser.find_elements(By.CSS_SELECTOR, "[role=tab][aria-selected=true]")
    return [str(chosen.get_attribute("data-name")) for chosen in tabs if chosen.is_displayed()]


def panels(browser: webdriver.Chrome) -> set[str]:
    """Return the scenarios whose panels have a place on the page."""
    script = (
        "return [...document.querySelectorAll('.scenario')].filter((e) => e.checkVisibility())"
        ".map((e) => e.dataset.scenario)"
    )
    return set(browser.execute_script(script))


def shown(browser: webdriver.Chrome) -> list[str]:
    """Return the controllers that the legend shows."""
    pressed = browser.find_elements(By.CSS_SELECTOR, "button.entry[aria-pressed=true]")
    return [str(button.get_attribute("data-controller")) for button in pressed if button.is_displayed()]


def rows(browser: webdriver.Chrome, table: str) -> list[str]:
    """Return the controllers whose rows of a table are shown."""
    found = browser.find_elements(By.CSS_SELECTOR, f"{table} tr[data-controller]")
    return [str(row.get_attribute("data-controller")) for row in found if row.is_displayed()]


def place(browser: webdriver.Chrome) -> str:
    """Return what the address says after the file's name."""
    return str(browser.execute_script("return location.hash"))


def ends(browser: webdriver.Chrome) -> tuple[float, float]:
    """Return the first and the last label of the time axis of the first chart that is shown [s]."""
    script = (
        "const chart = [...document.querySelectorAll('.is-live')].find((e) => e.checkVisibility());"
        "const axis = chart.querySelector('.live .role-axis-label');"
        "return [...axis.querySelectorAll('text')].map((text) => parseFloat(text.textContent))"
    )
    times = browser.execute_script(script)
    return min(times), max(times)


def test_the_worst_scenario_is_shown_first_and_a_tab_shows_another(
    browser: webdriver.Chrome, page: str
) -> None:
    open_page(browser, page)
    assert chosen(browser) == ["worst-by-far"]
    assert panels(browser) == {"worst-by-far"}
    tab(browser, "calm").click()
    assert chosen(browser) == ["calm"]
    assert panels(browser) == {"calm"}
    assert place(browser) == "#scenario=calm"
    for panel in browser.find_elements(By.CSS_SELECTOR, "[role=tabpanel]"):
        label = element(browser, f"[id='{panel.get_attribute('aria-labelledby')}']")
        assert label.get_attribute("data-name") == panel.get_attribute("data-scenario")
        assert str(panel.get_attribute("id")) in str(label.get_attribute("aria-controls")).split()
    assert browser.get_log("browser") == []


def test_tabs_answer_keys_and_only_one_of_them_is_reached_by_the_tabulator(
    browser: webdriver.Chrome, page: str
) -> None:
    open_page(browser, page)
    reached = browser.find_elements(By.CSS_SELECTOR, "[role=tab][tabindex='0']")
    assert [found.get_attribute("data-name") for found in reached] == ["worst-by-far"]
    for key, name in (
        (Keys.ARROW_DOWN, "other"),
        (Keys.ARROW_RIGHT, "calm"),
        (Keys.ARROW_UP, "other"),
        (Keys.HOME, "calm"),
        (Keys.END, "other"),
    ):
        browser.execute_script("document.querySelector('[role=tab][aria-selected=true]').focus()")
        browser.switch_to.active_element.send_keys(key)
        assert browser.switch_to.active_element == tab(browser, name)
        assert chosen(browser) == [name]
        assert panels(browser) == {name}


def test_the_legend_hides_lines_and_rows_and_going_back_shows_them(
    browser: webdriver.Chrome, page: str
) -> None:
    open_page(browser, page)
    make_live(browser, ".scenario:not([hidden]) .chart")
    everyone = shown(browser)
    assert rows(browser, "#s1-matrix-table") == everyone
    element(browser, "button.entry[data-controller=quick]").send_keys(Keys.SPACE)
    left = [key for key in everyone if key != "quick"]
    assert shown(browser) == left
    assert rows(browser, "#s1-matrix-table") == left
    assert set(rows(browser, "#s1-2-response-table")) == {*left}
    assert set(place(browser).removeprefix("#show=").split(",")) == {*left}
    browser.back()
    wait(browser, lambda: shown(browser) == everyone)
    assert rows(browser, "#s1-matrix-table") == everyone
    assert place(browser) == ""
    browser.forward()
    wait(browser, lambda: shown(browser) == left)


def test_the_first_three_by_rank_and_all(browser: webdriver.Chrome, page: str) -> None:
    open_page(browser, page)
    everyone = shown(browser)
    assert everyone == rows(browser, "#s1-matrix-table")
    three, every = browser.find_elements(By.CSS_SELECTOR, ".choices button")
    three.click()
    assert shown(browser) == everyone[:3]
    assert [three.get_attribute("aria-pressed"), every.get_attribute("aria-pressed")] == ["true", "false"]
    every.click()
    assert shown(browser) == everyone
    assert [three.get_attribute("aria-pressed"), every.get_attribute("aria-pressed")] == ["false", "true"]


def test_an_address_shows_these_three_zoomed_in_that_scenario(browser: webdriver.Chrome, page: str) -> None:
    open_page(browser, f"{page}#s1-3-responses&scenario=other&show=quick,fair,slow&zoom=1..2")
    assert chosen(browser) == ["other"]
    assert sorted(shown(browser)) == ["fair", "quick", "slow"]
    chart = make_live(browser, ".scenario:not([hidden]) .chart")
    assert ends(browser) == (1.0, 2.0)
    assert len(chart.find_elements(By.CSS_SELECTOR, ".live path[stroke^='var(--c'][stroke-width='1.6']")) == 3
    # Another scenario shows the same time and the same controllers.
    tab(browser, "calm").click()
    make_live(browser, ".scenario:not([hidden]) .chart")
    assert ends(browser) == (1.0, 2.0)
    assert place(browser) == "#scenario=calm&show=quick,fair,slow&zoom=1..2"
    element(browser, ".scenario:not([hidden]) .chart .live").send_keys(Keys.ESCAPE)
    assert place(browser) == "#scenario=calm&show=quick,fair,slow"
    wait(browser, lambda: ends(browser) == (0.0, 6.0))
    browser.back()
    wait(browser, lambda: ends(browser) == (1.0, 2.0))
    assert place(browser) == "#scenario=calm&show=quick,fair,slow&zoom=1..2"


@pytest.mark.parametrize(
    "said",
    [
        "scenario=gone",
        "show=nobody",
        "zoom=2..1",
        "zoom=a..b",
        "scenario=%E0%A4%A",
        "problem=x&zoom=9e9..9e10",
    ],
)
def test_what_an_address_says_of_things_that_are_not_there_counts_for_nothing(
    browser: webdriver.Chrome, page: str, said: str
) -> None:
    open_page(browser, f"{page}#{said}")
    assert chosen(browser) == ["worst-by-far"]
    assert len(shown(browser)) == len(LAGS)
    make_live(browser, ".scenario:not([hidden]) .chart")
    assert ends(browser) == (0.0, 6.0)
    assert browser.get_log("browser") == []


def test_a_link_to_another_scenario_shows_it_and_keeps_who_is_shown(
    browser: webdriver.Chrome, page: str
) -> None:
    open_page(browser, f"{page}#show=quick,fair")
    link = element(browser, "#s1-matrix-table a[href='#s1-3-responses']")
    link.click()
    wait(browser, lambda: chosen(browser) == ["other"])
    assert sorted(shown(browser)) == ["fair", "quick"]
    assert place(browser) == "#s1-3-responses&scenario=other&show=quick,fair"
    top = browser.execute_script(
        "return document.getElementById('s1-3-responses').getBoundingClientRect().top"
    )
    assert -2 <= top < 200
    browser.back()
    wait(browser, lambda: chosen(browser) == ["worst-by-far"])


def test_an_entry_that_has_the_focus_stands_out(browser: webdriver.Chrome, page: str) -> None:
    open_page(browser, page)
    make_live(browser, ".scenario:not([hidden]) .chart")
    faint = (
        "const chart = document.querySelector('.scenario:not([hidden]) .is-live .live');"
        "return [...chart.querySelectorAll('path[stroke^=\"var(--c\"]')]"
        ".map((line) => [line.getAttribute('stroke'), getComputedStyle(line).opacity])"
    )
    tab(browser, "worst-by-far").send_keys(Keys.TAB, Keys.TAB, Keys.TAB)
    entry = browser.switch_to.active_element
    line = f"var(--{entry.get_attribute('data-name')})"
    drawn = browser.execute_script(faint)
    assert {opacity for stroke, opacity in drawn if stroke != line} == {"0.15"}
    assert {opacity for stroke, opacity in drawn if stroke == line} != {"0.15"}
    lit = {row.get_attribute("data-controller") for row in browser.find_elements(By.CSS_SELECTOR, "tr.lit")}
    assert lit == {entry.get_attribute("data-controller")}
    entry.send_keys(Keys.TAB, Keys.SHIFT + Keys.TAB)
    browser.execute_script("document.activeElement.blur()")
    assert {opacity for _, opacity in browser.execute_script(faint)}.isdisjoint({"0.15"})
    assert not browser.find_elements(By.CSS_SELECTOR, "tr.lit")


def test_the_legend_says_what_ended_early_in_the_scenario_that_is_shown(
    browser: webdriver.Chrome, page: str
) -> None:
    open_page(browser, page)
    assert "(diverged)" in element(browser, "button.entry[data-controller=broken]").text
    tab(browser, "calm").click()
    assert "(diverged)" not in element(browser, "button.entry[data-controller=broken]").text


def test_without_scripts_scenarios_are_folded_and_open_by_a_click(
    browser: webdriver.Chrome, page: str
) -> None:
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    browser.get("about:blank")
    browser.get(page)
    assert not element(browser, ".shown").is_displayed()
    responses = browser.find_elements(By.CSS_SELECTOR, "section:has(#s1-responses) .scenario > details")
    assert [fold.get_attribute("open") for fold in responses] == [None, "true", None]
    assert responses[1].find_element(By.CSS_SELECTOR, "svg.static").is_displayed()
    assert "Worst" in responses[1].find_element(By.CSS_SELECTOR, "summary").text
    assert "Quick" in responses[1].find_element(By.CSS_SELECTOR, ".legend").text
    assert not responses[0].find_element(By.CSS_SELECTOR, "svg.static").is_displayed()
    responses[0].find_element(By.CSS_SELECTOR, "summary").click()
    assert responses[0].find_element(By.CSS_SELECTOR, "svg.static").is_displayed()
    assert responses[0].find_element(By.CSS_SELECTOR, "svg.static").size["height"] > 100


def test_on_paper_the_scenario_that_is_shown_is_drawn_and_others_are_named(
    browser: webdriver.Chrome, page: str
) -> None:
    open_page(browser, f"{page}#scenario=calm&show=quick,fair")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": []})
    folds = browser.find_elements(By.CSS_SELECTOR, "section:has(#s1-responses) .scenario")
    texts = [fold.text for fold in folds]
    assert texts[0].startswith("All calm")
    assert "Figure" in texts[0]
    assert texts[1:] == ["Worst", "Other"]
    assert not element(browser, ".shown").is_displayed()
    assert "Quick" in folds[0].find_element(By.CSS_SELECTOR, ".legend").text
    assert "Slow" not in folds[0].find_element(By.CSS_SELECTOR, ".legend").text


def test_on_a_phone_the_legend_is_a_line_at_the_top_that_unfolds(
    browser: webdriver.Chrome, page: str
) -> None:
    size = {"width": 400, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    open_page(browser, page)
    assert not element(browser, "button.entry").is_displayed()
    make_live(browser, ".scenario:not([hidden]) .chart")
    line = element(browser, ".shown summary")
    assert "Worst" in line.text
    assert "5 of 5" in line.text
    assert browser.execute_script("return arguments[0].getBoundingClientRect().top", line) < 20
    line.click()
    element(browser, "button.entry[data-controller=quick]").click()
    assert "4 of 5" in line.text
    assert browser.execute_script("return document.scrollingElement.scrollWidth") <= 400


def test_of_several_studies_one_is_shown_at_a_time(browser: webdriver.Chrome, several: str) -> None:
    open_page(browser, several)
    assert chosen(browser) == ["first"]
    assert element(browser, "#s1-ranking-table").is_displayed()
    assert not element(browser, "#s2-matrix-table").is_displayed()
    tab(browser, "second").click()
    assert chosen(browser)[0] == "second"
    assert not element(browser, "#s1-ranking-table").is_displayed()
    assert element(browser, "#s2-matrix-table").is_displayed()
    assert place(browser) == "#problem=second"
    browser.back()
    wait(browser, lambda: chosen(browser) == ["first"])
    open_page(browser, f"{several}#problem=second&scenario=other")
    assert chosen(browser)[0] == "second"
    assert "other" in [*chosen(browser), *panels(browser)]
    assert element(browser, "#s2-responses").is_displayed()


def test_whoever_hides_all_sees_empty_charts_and_no_error(browser: webdriver.Chrome, page: str) -> None:
    open_page(browser, f"{page}#show=")
    assert shown(browser) == []
    make_live(browser, ".scenario:not([hidden]) .chart")
    wait(
        browser,
        lambda: (
            lines_drawn(browser) == 0 if browser.find_elements(By.CSS_SELECTOR, ".chart .live svg") else True
        ),
    )
    assert browser.get_log("browser") == []


def test_over_all_problems_comes_first_and_its_matrix_leads_to_one_of_them(
    browser: webdriver.Chrome, problems: str
) -> None:
    open_page(browser, problems)
    tabs = browser.find_elements(By.CSS_SELECTOR, "[role=tab]")
    assert [tab.text for tab in tabs] == ["All problems", "One", "Two"]
    assert chosen(browser) == ["all"]
    assert not element(browser, "#s3-study").is_displayed()
    element(browser, "#s1-matrix-table a[href='#s3-1-responses']").click()
    wait(browser, lambda: chosen(browser) == ["two"])
    assert element(browser, "#s3-1-responses").is_displayed()
    assert not element(browser, "#s1-matrix-table").is_displayed()
    browser.back()
    wait(browser, lambda: chosen(browser) == ["all"])
    assert element(browser, "#s1-matrix-table").is_displayed()


def test_a_study_names_the_scenario_that_is_shown_first(browser: webdriver.Chrome, tmp_path: Path) -> None:
    results = make_results_in(tmp_path / "r", scenarios=SCENARIOS, report={"scenario": "calm"})
    open_page(browser, write_report([results], tmp_path / "report.html").as_uri())
    assert chosen(browser) == ["calm"]
    assert panels(browser) == {"calm"}


def test_a_long_table_that_is_folded_is_set_when_it_is_opened(
    browser: webdriver.Chrome, tmp_path: Path
) -> None:
    results = make_results_in(tmp_path / "r", seeds=["0:80"])
    page = write_report([results], tmp_path / "report.html")
    assert "s1-cases-table" not in page.read_text(encoding="utf-8")
    open_page(browser, f"{page.as_uri()}#show=slow")
    element(browser, "details:has(> summary #s1-cases) > summary").click()
    table = wait(browser, lambda: browser.find_elements(By.CSS_SELECTOR, "#s1-cases-table"))[0]
    script = (
        "return [...arguments[0].tBodies[0].rows].filter((r) => !r.hidden).map((r) => r.cells[3].textContent)"
    )
    assert len(browser.execute_script(script, table)) == 80
    table.find_element(By.CSS_SELECTOR, "thead th:nth-child(4) .sort").click()
    values = [float(text) for text in browser.execute_script(script, table)]
    assert values == sorted(values)


def test_the_legend_hides_columns_of_settings_too(
    browser: webdriver.Chrome, page: str, tmp_path: Path
) -> None:
    controllers = {key: {"type": "a", "settings": {"gain": 2.0}} for key in ("quick", "slow")}
    results = make_results_in(tmp_path / "results", None, controllers)
    report = write_report([results], tmp_path / "report.html").as_uri()
    open_page(browser, f"{report}#show=slow")
    element(browser, "#s1-settings").find_element(By.XPATH, "ancestor::summary").click()
    script = (
        "return [...document.getElementById('s1-settings-a-table').rows].map((row) =>"
        " [...row.cells].filter((cell) => cell.checkVisibility()).map((cell) => cell.textContent))"
    )
    assert browser.execute_script(script) == [["Setting", "slow", "meaning"], ["gain", "2", "\N{EN DASH}"]]
    element(browser, "button.entry[data-controller=quick]").click()
    assert browser.execute_script(script)[0] == ["Setting", "quick", "slow", "meaning"]
