"""A report with bands, forecasts and prices in a real browser."""

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from ddpc_reports import write_report

from .figures.test_outside import CHANGES, trace_of
from .synthetic import make_results_in
from .test_accessibility import AXE, FAULTS
from .test_browser import element, make_live, open_page, wait

pytestmark = pytest.mark.xdist_group("browser")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("outside")
    results = make_results_in(folder / "results", trace_of, **CHANGES)
    return write_report([results], folder / "report.html").as_uri()


def test_what_acts_from_outside_is_live_and_read_out(chromium: webdriver.Chrome, page: str) -> None:
    open_page(chromium, page)
    for name, words in {
        "responses": ["t = 2.25 h", "lower edge", "upper edge"],
        "disturbances": ["t = 2.25 h", "what acts", "as measured"],
        "prices": ["price", "0.2 EUR/kWh"],
    }.items():
        chart = make_live(chromium, f"#s1-1-{name} .chart")
        live = chart.find_element(By.CSS_SELECTOR, ".live")
        chromium.execute_script("arguments[0].focus()", live)
        live.send_keys(Keys.HOME, Keys.ARROW_RIGHT)
        reading = chart.find_element(By.CSS_SELECTOR, ".reading")
        wait(chromium, lambda reading=reading: reading.is_displayed())
        assert all(word in reading.text for word in words), reading.text
    dots = make_live(chromium, "#s1-trade .chart").find_elements(By.CSS_SELECTOR, ".live svg path")
    assert len(dots) > 2
    assert chromium.get_log("browser") == []


@pytest.mark.parametrize("width", [400, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_to_fault(chromium: webdriver.Chrome, page: str, scheme: str, width: int) -> None:
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "screen", "features": features})
    try:
        open_page(chromium, page)
        make_live(chromium, "#s1-1-disturbances .chart")
        assert element(chromium, "html").size["width"] <= width
        chromium.execute_script(AXE.read_text(encoding="utf-8"))
        assert chromium.execute_async_script(FAULTS) == []
    finally:
        chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})
