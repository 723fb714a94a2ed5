"""The page as axe-core judges it: nothing violated, nothing that it cannot judge."""

from dataclasses import replace
from importlib.metadata import distribution
from pathlib import Path

import pytest
from selenium import webdriver

from ddpc_cosim import Outcome, Trace
from ddpc_reports import write_report

from .synthetic import make_results_in, make_trace
from .test_browser import make_live, open_page

pytestmark = pytest.mark.xdist_group("browser")

AXE = Path(str(distribution("axe-playwright-python").locate_file("axe_playwright_python/axe.min.js")))
FAULTS = """
const done = arguments[arguments.length - 1];
document.querySelectorAll("details").forEach((fold) => { fold.open = true; });
axe.run(document, { resultTypes: ["violations", "incomplete"] }).then(({ violations, incomplete }) => done(
  [...violations, ...incomplete].flatMap(({ id, nodes }) =>
    nodes.map(({ html }) => id + ": " + html.slice(0, 150)))
));
"""


def trace_of(key: str, seed: int) -> Trace:
    """Return runs of every kind: one diverged, one with fallbacks, one that says something of its steps."""
    if key == "diverged":
        return make_trace(0.6, outcome=Outcome.DIVERGED, reason="angle is NaN at 3 s")
    diagnostics = {"data_rank": 9.0, "data_columns": 20.0 + seed}
    trace = make_trace(
        0.3 if key == "quick" else 1.0,
        noise_seed=seed,
        fallbacks=3 * (key == "slow"),
        diagnostics=diagnostics,
    )
    return replace(trace, info={"cost": trace.u[:, 0] ** 2} if key == "quick" else {})


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a report that has every kind of block."""
    folder = tmp_path_factory.mktemp("accessibility")
    controllers = {key: {"type": "a", "label": f"{key} one"} for key in ("quick", "slow", "diverged")}
    scenarios = {"calm": {}, "noisy": {"label": "noisy, and with a longer name", "noise": {"angle": 0.01}}}
    results = make_results_in(
        folder / "results", trace_of, controllers, seeds=["0:6"], scenarios=scenarios, source="A book."
    )
    return write_report([results], folder / "report.html").as_uri()


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a report of two studies, of which one is shown at a time."""
    folder = tmp_path_factory.mktemp("several")
    studies = [
        make_results_in(folder / name, None, name=name, title=f"{name} study", scenarios={"a": {}, "b": {}})
        for name in ("first", "second")
    ]
    return write_report(studies, folder / "report.html").as_uri()


@pytest.mark.parametrize("width", [400, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_to_fault_and_nothing_to_look_at(
    chromium: webdriver.Chrome, page: str, scheme: str, width: int
) -> None:
    assert faults(chromium, page, scheme, width) == []


@pytest.mark.parametrize(("scheme", "width"), [("light", 400), ("dark", 1280)])
def test_axe_finds_nothing_where_another_scenario_and_study_and_fewer_controllers_are_shown(
    chromium: webdriver.Chrome, page: str, several: str, scheme: str, width: int
) -> None:
    zoom = "&zoom=0.2..5.8" if width == 400 else ""
    assert faults(chromium, f"{page}#scenario=calm&show=quick,diverged{zoom}", scheme, width) == []
    assert faults(chromium, f"{several}#problem=second&scenario=b&show=slow", scheme, width) == []


def faults(chromium: webdriver.Chrome, page: str, scheme: str, width: int) -> list[str]:
    """Return what axe-core faults or cannot judge, with all that is folded open."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "screen", "features": features})
    try:
        open_page(chromium, page)
        make_live(chromium, ".scenario:not([hidden], .problem[hidden] *) .chart")
        chromium.execute_script(AXE.read_text(encoding="utf-8"))
        found: list[str] = chromium.execute_async_script(FAULTS)
        return found
    finally:
        chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})
