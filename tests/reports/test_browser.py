"""The page in a real browser: what it draws, how it answers, and what it leaves alone."""

import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

from ddpc_cosim import Outcome, Simulation, Trace
from ddpc_reports import write_report, write_simulation

from .synthetic import make_results_in, make_trace

# What its fixtures run or build is run and built in one process.
pytestmark = pytest.mark.xdist_group("browser")


def trace_of(key: str, seed: int) -> Trace:
    if key == "diverged":
        return make_trace(0.6, outcome=Outcome.DIVERGED, reason="angle is NaN at 3 s")
    trace = make_trace(0.3 if key == "quick" else 1.0, noise_seed=seed, diagnostics={"data_rank": 9.0})
    return replace(trace, info={"cost": trace.u[:, 0] ** 2} if key == "quick" else {})


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a report of three controllers, one of which fails."""
    folder = tmp_path_factory.mktemp("browser")
    controllers = {"quick": {"type": "a", "label": "Quick"}, "slow": {"type": "b"}, "diverged": {"type": "b"}}
    results = make_results_in(folder / "results", trace_of, controllers, seeds=[7, 0, 1])
    return write_report([results], folder / "report.html").as_uri()


@pytest.fixture
def browser(chromium: webdriver.Chrome, page: str) -> Iterator[webdriver.Chrome]:
    """Return a browser that has opened the report and whose first figure is live."""
    open_page(chromium, page)
    make_live(chromium, ".chart")
    yield chromium
    chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


def open_page(browser: webdriver.Chrome, page: str) -> None:
    browser.get_log("browser")
    browser.get_log("performance")
    browser.get("about:blank")  # the same page again would be where it was scrolled to
    browser.get(page)
    wait(browser, lambda: browser.execute_script("return document.documentElement.dataset.ready === 'yes'"))


def make_live(browser: webdriver.Chrome, selector: str) -> WebElement:
    """Scroll to the first such chart and return it once it is live."""
    chart = element(browser, selector)
    script = "arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})"
    browser.execute_script(script, chart)
    wait(browser, lambda: "is-live" in str(chart.get_attribute("class")))
    return chart


def wait(browser: webdriver.Chrome, condition: Callable[[], Any]) -> Any:
    return WebDriverWait(browser, 20, poll_frequency=0.05).until(lambda _: condition())


def element(browser: webdriver.Chrome, selector: str) -> WebElement:
    return browser.find_element(By.CSS_SELECTOR, selector)


def lines_drawn(browser: webdriver.Chrome) -> int:
    """Return how many controllers the first chart draws."""
    lines = "path[stroke^='var(--c'][stroke-width='1.6']"  # medians are thinner
    return len(element(browser, ".chart .live svg").find_elements(By.CSS_SELECTOR, lines))


def time_labels(browser: webdriver.Chrome) -> set[str]:
    """Return the labels of the time axis of the first chart."""
    script = (
        "const axis = document.querySelector('.chart .live svg').querySelector('.role-axis-label');"
        "return [...axis.querySelectorAll('text')].map((text) => text.textContent)"
    )
    return set(browser.execute_script(script))


def test_what_is_folded_is_drawn_when_it_is_opened_and_hides_what_its_neighbours_hide(
    browser: webdriver.Chrome,
) -> None:
    fold = "#s1-1-what-controllers-said-of-their-steps details"
    assert not browser.find_elements(By.CSS_SELECTOR, "figure details .live")
    assert not element(browser, f"{fold} .static").is_displayed()
    element(browser, "button.entry").click()
    element(browser, f"{fold} summary").click()
    chart = make_live(browser, f"{fold} .chart").find_element(By.CSS_SELECTOR, ".live svg")
    assert chart.is_displayed()
    assert chart.size["width"] > 300
    quick = "path[stroke^='var(--c']"
    assert not chart.find_elements(By.CSS_SELECTOR, quick)
    element(browser, "button.entry").click()
    wait(browser, lambda: element(browser, f"{fold} .live svg").find_elements(By.CSS_SELECTOR, quick))


def test_it_opens_without_an_error_and_without_a_request(browser: webdriver.Chrome, page: str) -> None:
    assert browser.get_log("browser") == []
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    assert [url for url in asked if not url.startswith(("data:", page, "chrome:"))] == []


PLACES = """
return [...document.querySelectorAll('.chart:not(details .chart)')].map((box) => {
  const [drawing] = [...box.querySelectorAll('svg.static, .live svg')].filter((svg) => svg.checkVisibility());
  return [box.offsetTop, box.offsetHeight, drawing.clientWidth, drawing.clientHeight].map(Math.round);
})
"""


@pytest.mark.parametrize("width", [400, 1280])
def test_a_chart_becomes_live_in_view_and_takes_the_place_of_its_drawing(
    chromium: webdriver.Chrome, page: str, width: int
) -> None:
    size = {"width": width, "height": 600, "deviceScaleFactor": 1, "mobile": False}
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        open_page(chromium, page)
        drawings = chromium.execute_script(PLACES)
        charts = chromium.find_elements(By.CSS_SELECTOR, ".chart:not(details .chart)")
        assert "is-live" not in str(charts[-1].get_attribute("class"))
        for chart in charts:
            chromium.execute_script("arguments[0].scrollIntoView({behavior: 'instant'})", chart)
            wait(chromium, lambda chart=chart: "is-live" in str(chart.get_attribute("class")))
        live = chromium.execute_script(PLACES)
    finally:
        chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert len(live) == len(drawings) == 4
    assert [place[:3] for place in live] == [place[:3] for place in drawings]
    assert all(abs(place[1] - place[3]) <= 2 for place in live)


def test_on_a_narrow_screen_the_first_figures_of_the_ranking_are_in_view(
    chromium: webdriver.Chrome, page: str
) -> None:
    """They are the answer: nobody scrolls a table sideways for it."""
    size = {"width": 400, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        open_page(chromium, page)
        right = """
        const row = document.querySelector('.ranking tbody tr');
        const cells = [...row.children].filter((cell) => cell.checkVisibility() && cell.offsetWidth);
        const first = cells[cells.findIndex((cell) => cell.classList.contains('rank')) + 1];
        return first.getBoundingClientRect().right;
        """
        assert 300 < chromium.execute_script(right) <= 390
    finally:
        chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_live_chart_has_the_name_of_its_drawing(browser: webdriver.Chrome) -> None:
    live, drawing = (element(browser, f".chart {part}") for part in (".live", ".static"))
    assert live.get_attribute("aria-label") == drawing.get_attribute("aria-label") != ""
    assert live.get_attribute("role") == drawing.get_attribute("role") == "img"
    assert live.get_attribute("tabindex") == "0"


def test_a_browser_that_cannot_inflate_keeps_the_drawings(chromium: webdriver.Chrome, page: str) -> None:
    source = {"source": "delete window.DecompressionStream"}
    script = chromium.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", source)
    try:
        open_page(chromium, page)
        assert element(chromium, ".chart .static").is_displayed()
        assert not element(chromium, ".tools").is_displayed()
        assert not chromium.find_elements(By.CSS_SELECTOR, ".live")
        quick = "[data-view$=responses-1] .static [stroke='var(--c0)']"
        assert element(chromium, quick).is_displayed()
        element(chromium, "button.entry[data-name=c0]").click()
        assert not element(chromium, quick).is_displayed()
        assert chromium.get_log("browser") == []
    finally:
        chromium.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", script)


def test_a_click_on_a_legend_entry_hides_a_controller_and_a_second_shows_it(
    browser: webdriver.Chrome,
) -> None:
    before = lines_drawn(browser)
    entry = element(browser, "button.entry[data-name=c1]")
    entry.click()
    wait(browser, lambda: lines_drawn(browser) == before - 1)
    pressed = {
        button.get_attribute("aria-pressed")
        for button in browser.find_elements(By.CSS_SELECTOR, "[data-name=c1]")
    }
    assert pressed == {"false"}
    strip = make_live(browser, "[data-view$=spread-0-1]")
    dots = "path[fill='var(--c1)']"
    wait(browser, lambda: not strip.find_elements(By.CSS_SELECTOR, f".live {dots}"))
    assert strip.find_elements(By.CSS_SELECTOR, f".static {dots}")
    element(browser, "button.entry[data-name=c1]").send_keys(Keys.SPACE)
    make_live(browser, ".chart")
    wait(browser, lambda: lines_drawn(browser) == before)
    make_live(browser, "[data-view$=spread-0-1]")
    wait(browser, lambda: strip.find_elements(By.CSS_SELECTOR, f".live {dots}"))


def test_the_legend_says_which_run_did_not_complete(browser: webdriver.Chrome) -> None:
    assert "(diverged)" in element(browser, "button.entry[data-name=c2]").text
    assert "(diverged)" not in element(browser, "button.entry[data-name=c0]").text


def test_the_pointer_reads_all_controllers_at_the_nearest_sample(browser: webdriver.Chrome) -> None:
    chart = element(browser, ".chart .live")
    ActionChains(browser).move_to_element(chart).perform()
    reading = element(browser, ".chart .reading")
    wait(browser, reading.is_displayed)
    first, *lines = reading.text.split("\n")
    assert first.startswith("t = ")
    assert {"reference", "Quick", "slow", "diverged"} <= set(lines)
    assert "20°" in lines


def test_the_keyboard_reads_values_too(browser: webdriver.Chrome) -> None:
    chart = element(browser, ".chart .live")
    chart.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    wait(browser, lambda: "t = 0.2" in element(browser, ".chart .reading").text)
    said = element(browser, "[role=status]").get_property("textContent")
    assert str(said).startswith("t = 0.2")
    assert "Quick" in str(said)
    chart.send_keys(Keys.END)
    wait(browser, lambda: "t = 6" in element(browser, ".chart .reading").text)
    whole = time_labels(browser)
    chart.send_keys(Keys.HOME, "+", "+", "+")
    wait(browser, lambda: time_labels(browser) != whole)
    chart.send_keys(Keys.ESCAPE)
    wait(browser, lambda: time_labels(browser) == whole)
    assert not element(browser, ".chart .reading").is_displayed()


def test_the_keyboard_goes_from_mark_to_mark(browser: webdriver.Chrome) -> None:
    strip = make_live(browser, "[data-view$=spread-0-1]")
    strip.find_element(By.CSS_SELECTOR, ".live").send_keys(Keys.HOME, Keys.ARROW_RIGHT)
    wait(browser, lambda: "Quick, seed" in strip.find_element(By.CSS_SELECTOR, ".reading").text)
    assert "Quick, seed" in str(element(browser, "[role=status]").get_property("textContent"))


def value_labels(browser: webdriver.Chrome) -> list[float]:
    """Return the labels of the axis of values of the first chart."""
    script = (
        "const axis = document.querySelector('.chart .live svg').querySelectorAll('.role-axis-label')[1];"
        "return [...axis.querySelectorAll('text')].map((text) => text.textContent)"
    )
    return [
        float(text.replace("\u2212", "-").replace("\u202f", "")) for text in browser.execute_script(script)
    ]


def test_a_run_that_falls_over_sets_the_range_only_where_it_is_alone(
    chromium: webdriver.Chrome, tmp_path: Path
) -> None:
    def far(key: str, seed: int) -> Trace:
        trace = trace_of("quick" if key == "falls" else key, seed)
        return replace(trace, y=40.0 * trace.y) if key == "falls" else trace

    controllers: dict[str, dict[str, Any]] = {name: {"type": "a"} for name in ("quick", "falls", "slow")}
    results = make_results_in(tmp_path / "results", far, controllers)
    open_page(chromium, write_report([results], tmp_path / "report.html").as_uri())
    make_live(chromium, ".chart")
    assert max(value_labels(chromium)) <= 25.0
    for name in ("c0", "c2"):
        element(chromium, f"button.entry[data-name={name}]").click()
    wait(chromium, lambda: max(value_labels(chromium)) >= 600.0)


def drag(browser: webdriver.Chrome, chart: WebElement) -> None:
    actions = ActionChains(browser).move_to_element_with_offset(chart, -50, 0).click_and_hold()
    actions.move_by_offset(150, 0).release().perform()


def test_a_drag_zooms_and_a_button_or_a_double_click_resets(browser: webdriver.Chrome) -> None:
    whole = time_labels(browser)
    reset = element(browser, ".chart .reset")
    assert not reset.is_displayed()
    chart = element(browser, ".chart .live")
    drag(browser, chart)
    wait(browser, lambda: time_labels(browser) != whole)
    reset.click()
    wait(browser, lambda: time_labels(browser) == whole)
    assert not reset.is_displayed()
    assert browser.switch_to.active_element == chart
    drag(browser, chart)
    wait(browser, lambda: time_labels(browser) != whole)
    below = make_live(browser, "[data-view$=control-signals-1]")
    assert below.find_element(By.CSS_SELECTOR, ".reset").is_displayed()
    ActionChains(browser).double_click(below).perform()
    make_live(browser, ".chart")  # it follows when it comes into view
    wait(browser, lambda: time_labels(browser) == whole)


def test_zoomed_errors_are_not_flattened_by_the_transients(browser: webdriver.Chrome) -> None:
    chart = make_live(browser, "[data-view$=errors-1]")

    def labels() -> list[list[str]]:
        script = (
            "return [...arguments[0].querySelectorAll('.role-axis-label')]"
            ".map((axis) => [...axis.querySelectorAll('text')].map((text) => text.textContent))"
        )
        texts: list[list[str]] = browser.execute_script(script, chart)
        return texts

    def largest() -> float:
        return max(float(text.replace("\u2212", "-")) for text in labels()[1])

    times, most = labels()[0], largest()
    drag(browser, chart)
    wait(browser, lambda: labels()[0] != times)
    assert 0 < largest() <= most < 20.0  # what the step asks for


def touch(browser: webdriver.Chrome, kind: str, *points: tuple[float, float]) -> None:
    touched = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
    browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": touched})


def test_fingers_read_zoom_and_scroll(browser: webdriver.Chrome) -> None:
    whole = time_labels(browser)
    chart, reading = element(browser, ".chart .live"), element(browser, ".chart .reading")
    script = "const b = arguments[0].getBoundingClientRect(); return [b.left, b.top, b.width, b.height]"
    left, top, width, height = browser.execute_script(script, chart)
    middle = left + width / 2, top + height / 2
    touch(browser, "Start", middle)
    touch(browser, "End")
    wait(browser, reading.is_displayed)
    assert "Quick" in reading.text
    touch(browser, "Start", (middle[0] - 50, middle[1]), (middle[0] + 50, middle[1]))
    for apart in (80, 120, 160):
        touch(browser, "Move", (middle[0] - apart, middle[1]), (middle[0] + apart, middle[1]))
    touch(browser, "End")
    wait(browser, lambda: time_labels(browser) != whole)
    zoomed = time_labels(browser)
    listen = "window.rests = false; addEventListener('scrollend', () => { window.rests = true })"
    browser.execute_script(listen)
    before = browser.execute_script("return scrollY")
    touch(browser, "Start", middle)
    for up in range(20, 121, 20):
        touch(browser, "Move", (middle[0], middle[1] - up))
    touch(browser, "End")
    wait(browser, lambda: browser.execute_script(f"return window.rests && scrollY > {before}"))
    assert time_labels(browser) == zoomed
    still = "const y = scrollY; setTimeout(() => arguments[0](scrollY === y), 100)"
    wait(browser, lambda: browser.execute_async_script(still))  # a page that still glides cannot be clicked
    make_live(browser, ".chart")
    element(browser, ".chart .reset").click()
    wait(browser, lambda: time_labels(browser) == whole)
    entry = element(browser, "button.entry[data-name=c1]")
    lines = lines_drawn(browser)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", entry)
    left, top, width, height = browser.execute_script(script, entry)
    touch(browser, "Start", (left + width / 2, top + height / 2))
    touch(browser, "End")
    wait(browser, lambda: lines_drawn(browser) == lines - 1)


def test_the_page_of_a_simulation_answers_in_the_same_way(chromium: webdriver.Chrome, tmp_path: Path) -> None:
    trace = make_trace(0.5)
    rest = [trace.inputs, trace.y, trace.u, trace.sampling_time, len(trace), "completed", "", (), {}]
    simulation = Simulation("lag.fmu", trace.time, trace.outputs, *rest)
    open_page(chromium, write_simulation(simulation, tmp_path / "page.html").as_uri())
    chart = make_live(chromium, ".chart").find_element(By.CSS_SELECTOR, ".live")
    chart.send_keys(Keys.END)
    assert "lag.fmu" in element(chromium, ".chart .reading").text
    assert len(chromium.find_elements(By.CSS_SELECTOR, ".chart")) == 2
    whole = time_labels(chromium)
    drag(chromium, chart)
    wait(chromium, lambda: time_labels(chromium) != whole)
    assert chromium.get_log("browser") == []


def saved(browser: webdriver.Chrome, kind: str, folder: Path) -> bytes:
    """Return the first figure as the page saves it."""
    place = {"behavior": "allow", "downloadPath": str(folder)}
    browser.execute_cdp_cmd("Browser.setDownloadBehavior", place)
    element(browser, f"figure [data-save={kind}]").click()
    (path,) = wait(browser, lambda: list(folder.glob(f"*.{kind}")))
    assert path.name.endswith(f"-{element(browser, 'figure').get_attribute('id')}.{kind}")
    return bytes(path.read_bytes())


def test_a_figure_is_saved_as_a_file_that_stands_alone(browser: webdriver.Chrome, tmp_path: Path) -> None:
    element(browser, "button.entry[data-name=c1]").click()
    svg = saved(browser, "svg", tmp_path)
    root = ElementTree.fromstring(svg)
    names = "".join(root.itertext())
    assert b"var(" not in svg
    assert "Quick" in names
    assert "slow" not in names
    assert "Figure 1." in names
    quick = browser.execute_script(
        "return getComputedStyle(document.documentElement).getPropertyValue('--c0')"
    )
    red, green, blue = (int(quick.partition("#")[2][i : i + 2], 16) for i in (0, 2, 4))
    assert f"rgb({red}, {green}, {blue})".encode() in svg
    ground = root.find("{http://www.w3.org/2000/svg}rect")
    assert ground is not None
    assert ground.get("fill") == "#fff"
    png = saved(browser, "png", tmp_path)
    assert png.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", png[16:24])
    assert [width, height] == [2 * float(root.get(side, 0)) for side in ("width", "height")]
    assert browser.get_log("browser") == []


def test_pointing_at_a_dot_of_the_strip_names_its_seed(browser: webdriver.Chrome) -> None:
    strip = make_live(browser, "[data-view$=spread-0-1]")
    dot = strip.find_element(By.CSS_SELECTOR, ".live path[fill='var(--c0)']")
    ActionChains(browser).move_to_element(dot).perform()
    wait(browser, lambda: "Quick, seed" in element(browser, "[data-view$=spread-0-1] .reading").text)


def test_a_table_sorts_by_a_click_on_its_heading(browser: webdriver.Chrome) -> None:
    element(browser, "#s1-ranking-table th:nth-child(5) .sort").click()
    values = browser.execute_script(
        "return [...document.querySelectorAll('#s1-ranking-table tbody tr')]"
        ".map((row) => Number(row.cells[4].dataset.value))"
    )
    *known, missing = values  # of the run that failed there is no value: it stands last
    assert known == sorted(known)
    assert missing is None
    assert element(browser, "#s1-ranking-table th:nth-child(5)").get_attribute("aria-sort") == "ascending"


@pytest.mark.parametrize("width", [400, 1280])
def test_the_page_never_scrolls_sideways(browser: webdriver.Chrome, page: str, width: int) -> None:
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    open_page(browser, page)
    assert browser.execute_script("return document.scrollingElement.scrollWidth") <= width


def test_print_shows_the_static_figures_on_white(browser: webdriver.Chrome) -> None:
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": dark})
    shown = browser.execute_script(
        "const display = (e) => getComputedStyle(e).display;"
        "return [...document.querySelectorAll('.is-live')].map(c => "
        "[display(c.querySelector('.static')), display(c.querySelector('.live'))])"
    )
    assert shown == [["block", "none"]] * len(shown) != []
    # What is folded is left out, and says so where it is.
    fold = element(browser, "details.fold:has([id$=cases])")
    assert fold.text == "Every case (not printed here: in metrics.csv)"
    browser.execute_script("arguments[0].open = true", fold)
    assert fold.text == "Every case (not printed here: in metrics.csv)"
    assert (
        browser.execute_script("return getComputedStyle(document.body).backgroundColor")
        == "rgb(255, 255, 255)"
    )


CONTRASTS = """
const channels = (text) => text.match(/[\\d.]+/g).map(Number);
const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
const light = (colour) => colour.slice(0, 3).map((v) => linear(v / 255))
  .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
const ground = (e) => {
  for (; e; e = e.parentElement) {
    const colour = channels(getComputedStyle(e).backgroundColor);
    if (colour.length === 3 || colour[3] === 1) return colour;
  }
  return [255, 255, 255];
};
const faint = [];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const e = walker.currentNode.parentElement;
  if (!walker.currentNode.data.trim() || !e.getClientRects().length) continue;
  if (e.closest('script, .unseen, .anchor, .skip, [hidden]')) continue;
  const { color, fill } = getComputedStyle(e); // of texts in drawings the fill, which axe-core does not judge
  const [a, b] = [light(channels(e.ownerSVGElement ? fill : color)), light(ground(e))].sort((x, y) => y - x);
  const text = walker.currentNode.data.trim();
  if ((a + 0.05) / (b + 0.05) < 4.5) faint.push(e.tagName + ' ' + text.slice(0, 30));
}
return faint;
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_enough_contrast(browser: webdriver.Chrome, scheme: str) -> None:
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "screen", "features": features})
    assert browser.execute_script("return matchMedia('(prefers-color-scheme: dark)').matches") == (
        scheme == "dark"
    )
    assert browser.execute_script(CONTRASTS) == []


def test_the_theme_can_be_chosen(browser: webdriver.Chrome) -> None:
    button = element(browser, "button.theme")
    button.click()
    button.click()
    assert button.text == "Theme: dark"
    assert (
        browser.execute_script("return getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 27)"
    )


def test_without_javascript_the_static_figures_are_there(chromium: webdriver.Chrome, page: str) -> None:
    chromium.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        chromium.get(page)
        drawings = chromium.find_elements(By.CSS_SELECTOR, ".chart:not(details .chart) svg.static")
        assert len(drawings) == 4
        assert all(drawing.is_displayed() and drawing.size["height"] > 100 for drawing in drawings)
        assert not chromium.find_elements(By.CSS_SELECTOR, ".live, :disabled")
        assert not element(chromium, ".tools").is_displayed()
    finally:
        chromium.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
