"""Texts of others in a real browser: whatever they hold, they stay text and leave room for the rest."""

from dataclasses import replace
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By

from ddpc_cosim import Outcome, Trace
from ddpc_reports import write_report

from .synthetic import ANGLE, TORQUE, make_results_in, make_trace
from .test_browser import make_live, open_page

pytestmark = pytest.mark.xdist_group("browser")

CORPUS = (
    "</script><script>alert(1)</script>",
    "</style><img src=x onerror=alert(2)>",
    "\"'><svg/onload=alert(3)>",
    "javascript:alert(4)//${alert(5)}`{{alert(6)}}",
    "]]><!--%3Cscript%3E&lt;b&gt;",
    "a.b[c]['d']\\e \"f\" datum.value+1; url(http://example.org/x.png)",
    "=cmd|'/c calc'!A1",
)
EVIL = " ".join(CORPUS)


def hostile_report(folder: Path, text: str, short: str) -> str:
    """Return the address of a report that has a text wherever a study, a plug-in or an FMU can set one."""
    angle, torque = replace(ANGLE, name=f"angle {short}"), replace(TORQUE, name=f"torque {short}", unit=text)

    def trace_of(key: str, seed: int) -> Trace:
        said = {
            "settings": {text: text, "horizon": 5 + (key == "good")},
            "diagnostics": {text: 1.0},
            "outputs": (angle,),
            "inputs": (torque,),
        }
        if key == "failing":
            return make_trace(0.5, outcome=Outcome.FMU_ERROR, reason=text, **said)
        trace = make_trace(0.5 if key == "evil" else 0.3, noise_seed=seed, **said)
        return replace(trace, info={short[:30]: trace.u[:, 0] ** 2})

    results = make_results_in(
        folder / "results",
        trace_of,
        {key: {"type": "x", "label": f"{key} {text}", "note": text} for key in ("evil", "good", "failing")},
        {text: text},
        title=text,
        summary=text,
        source=text,
        reference={angle.name: {"kind": "constant", "value": 20.0, "unit": "deg"}},
        plant={"name": text, "inputs": [torque.name], "outputs": [angle.name]},
        report={"panels": [{"title": text, "controllers": ["evil", "good"]}], "limitations": [text]},
        seeds=["0:6"],
        scenarios={"calm": {}, "other": {"label": text}},
    )
    return write_report([results], folder / "report.html").as_uri()


def test_nothing_that_others_write_acts_and_all_of_it_can_be_read(
    chromium: webdriver.Chrome, tmp_path: Path
) -> None:
    open_page(chromium, hostile_report(tmp_path, EVIL, EVIL))
    make_live(chromium, ".chart")
    chromium.execute_script("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    assert chromium.get_log("browser") == []  # an alert would have ended the session before
    assert not chromium.find_elements(By.CSS_SELECTOR, "main img, main script, svg[onload]")
    heads = chromium.find_elements(By.CSS_SELECTOR, "th[scope=row]")
    titles = {
        str(e.get_attribute("title")) for head in heads for e in head.find_elements(By.TAG_NAME, "span")
    }
    assert f"evil {EVIL}" in titles


@pytest.mark.parametrize("width", [400, 1280])
def test_a_text_of_ten_thousand_letters_is_cut_and_told_in_full_to_who_points_at_it(
    chromium: webdriver.Chrome, tmp_path: Path, width: int
) -> None:
    endless = "W" * 10_000
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        open_page(chromium, hostile_report(tmp_path, endless, endless))
        make_live(chromium, ".chart")
        assert chromium.execute_script("return document.scrollingElement.scrollWidth") <= width
        assert len(chromium.title) <= 120
        title = chromium.find_element(By.CSS_SELECTOR, "h1 span")
        assert len(title.text) <= 120
        assert title.get_attribute("title") == endless
        labels = chromium.execute_script(
            "return [...document.querySelectorAll('[aria-label]')].map((one) => one.ariaLabel.length)"
        )
        assert max(labels) < 2000
    finally:
        chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
