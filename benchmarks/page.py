"""The report of the paper's study: its size, the CPU time of writing it, the main thread's of loading it.

The study is run with a few seeds, and its report written with an empty cache, again with the library of the
charts bundled, and again with the pictures drawn. The page is then loaded with scripts and without.
"""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from selenium import webdriver
from selenium.webdriver.chrome.service import Service

SEEDS = "0:6"
BYTES_AT_MOST = 1_000_000
AGAIN_AT_MOST = 0.75
"""CPU time of a report whose pictures are there, as a share of that of one that draws them."""
LOADED_AT_MOST, SCRIPTS_AT_MOST = 0.3, 1.5
"""Seconds of the main thread until the page is loaded, and as a multiple of what it takes without scripts."""
RUNS = 5


def main() -> bool:
    """Print what was measured and return whether it is within the bounds."""
    with tempfile.TemporaryDirectory() as folder:
        results, page, cache = (Path(folder, name) for name in ("results", "page.html", "cache"))
        os.environ["DDPC_COSIM_CACHE"] = str(cache)
        _cpu_seconds("run", "paper", "--seeds", SEEDS, "--out", str(results), "--no-report")
        write = ["report", str(results), "--out", str(page)]
        cold = _cpu_seconds(*write)
        shutil.rmtree(cache / "pictures")
        first, again = _cpu_seconds(*write), min(_cpu_seconds(*write) for _ in range(RUNS))
        size = page.stat().st_size
        live, still = _main_thread_seconds(page, scripts=True), _main_thread_seconds(page, scripts=False)
    print(f"size                      {size / 1e6:6.2f} MB (at most {BYTES_AT_MOST / 1e6:g})")
    print(f"CPU time, empty cache     {cold:6.2f} s")
    print(f"CPU time, library bundled {first:6.2f} s")
    print(f"CPU time, pictures drawn  {again:6.2f} s, ratio {again / first:.2f} (at most {AGAIN_AT_MOST})")
    print(f"main thread until loaded  {live:6.2f} s (at most {LOADED_AT_MOST})")
    print(f"the same without scripts  {still:6.2f} s, ratio {live / still:.2f} (at most {SCRIPTS_AT_MOST})")
    within = size <= BYTES_AT_MOST and again <= AGAIN_AT_MOST * first
    return within and live <= min(LOADED_AT_MOST, SCRIPTS_AT_MOST * still)


def _cpu_seconds(*arguments: str) -> float:
    """Run a command of ddpc-cosim and return what it and its own processes took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [Path(sys.executable).with_name("ddpc-cosim"), *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _main_thread_seconds(page: Path, *, scripts: bool) -> float:
    """Return what the tasks of the main thread take until the page is loaded, the least of some times."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome") or ""
    for option in ("--headless=new", "--no-sandbox", "--window-size=1280,900"):
        options.add_argument(option)
    browser = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        browser.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": not scripts})
        return min(_task_seconds(browser, page) for _ in range(RUNS))
    finally:
        browser.quit()


def _task_seconds(browser: webdriver.Chrome, page: Path) -> float:
    browser.get("about:blank")
    browser.get(page.as_uri())
    metrics = browser.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return next(float(metric["value"]) for metric in metrics if metric["name"] == "TaskDuration")
