"""Fourteen controllers in a browser: each has a panel that can be read, wide and narrow, light and dark."""

from pathlib import Path

import pytest
from selenium import webdriver

from ddpc_cosim import Trace
from ddpc_reports import write_report

from .synthetic import make_results_in, make_trace
from .test_accessibility import AXE, FAULTS
from .test_browser import open_page

pytestmark = pytest.mark.xdist_group("browser")

COUNT = 14


def trace_of(key: str, seed: int) -> Trace:
    """Return a run that is the slower the later its controller is declared."""
    return make_trace(0.2 + 0.1 * int(key[1:]), noise_seed=seed)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a report of many controllers."""
    folder = tmp_path_factory.mktemp("many")
    controllers = {f"k{n}": {"type": "a", "label": f"controller {n}, with a name"} for n in range(COUNT)}
    results = make_results_in(folder / "results", trace_of, controllers, seeds=[0, 1])
    return write_report([results], folder / "report.html").as_uri()


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (400, "dark")])
def test_every_controller_has_a_panel_that_can_be_read(
    chromium: webdriver.Chrome, page: str, width: int, scheme: str
) -> None:
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        open_page(chromium, page)
        chromium.execute_script("document.documentElement.dataset.theme = arguments[0]", scheme)
        panels = chromium.execute_script(
            """return [...document.querySelector(".smalls").children].map((panel) => {
              const box = panel.getBoundingClientRect();
              const picture = panel.querySelector("svg");
              const key = getComputedStyle(panel.querySelector(".key"));
              const scale = picture.getBoundingClientRect().width / picture.viewBox.baseVal.width;
              return { name: panel.dataset.controller, left: box.left, right: box.right, key: key.background,
                letters: scale * parseFloat(getComputedStyle(picture).fontSize) };
            })"""
        )
        assert [panel["name"] for panel in panels] == [f"k{n}" for n in range(COUNT)]
        assert len({panel["key"] for panel in panels}) == COUNT
        assert all(panel["letters"] >= 8.5 for panel in panels)
        assert all(0 <= panel["left"] < panel["right"] <= width for panel in panels)
        assert chromium.execute_script("return document.documentElement.scrollWidth") <= width
        chromium.execute_script(AXE.read_text(encoding="utf-8"))
        assert chromium.execute_async_script(FAULTS) == []
    finally:
        chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_rows_and_panels_say_whose_they_are_by_the_same_name(page: str) -> None:
    text = Path(page.removeprefix("file://")).read_text(encoding="utf-8")
    for number in range(COUNT):
        owner = f'data-controller="k{number}"'
        assert text.count(f"<tr {owner}>") > 8
        assert text.count(f"<li {owner}><p>") == 2, "small panels of two figures"
