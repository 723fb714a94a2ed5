"""Judge the built site: links inside it, and each page as axe-core does, in both themes, wide and narrow.

Run ``python docs/scripts/audit_site.py SITE [PAGE ...]`` with the folder that ``sphinx-build`` has written.
It prints what is at fault, and ends with 1 if anything is: a link that leads nowhere, and what axe-core finds
violated or cannot judge.
"""

import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import distribution
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import unquote, urlsplit

from lxml import html
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

AXE = Path(str(distribution("axe-playwright-python").locate_file("axe_playwright_python/axe.min.js")))
THEMES = ("light", "dark")
WIDTHS = (1280, 400)
# What another theme changes of a page is its colours alone.
COLOUR_RULES = ("color-contrast", "link-in-text-block")
# axe-core parses every colour of every element anew, a seventh of the time of a page.
_KNOWN_COLOURS = """
const { prototype } = axe.commons.color.Color, { parseString } = prototype, known = new Map();
prototype.parseString = function (text) {
  if (!known.has(text)) {
    const { r, g, b, alpha } = parseString.call(this, text);
    known.set(text, { r, g, b, alpha });
  }
  return Object.assign(this, known.get(text));
};
"""
_FAULTS = """
const done = arguments[arguments.length - 1];
document.querySelectorAll("details:not(aside *)").forEach((fold) => { fold.open = true; });
const options = { resultTypes: ["violations", "incomplete"] };
if (arguments[0].length) options.runOnly = arguments[0];
axe.run(document, options).then((said) => done(
  ["violations", "incomplete"].flatMap((kind) => said[kind].flatMap(({ id, nodes }) =>
    nodes.map(({ html }) => `${kind}, ${id}: ${html.slice(0, 150)}`)))
));
"""


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing of each request."""


def _pages(site: Path) -> list[Path]:
    """Return the pages of a site, without what its build keeps for itself."""
    pages = (path for path in site.rglob("*.html") if ".doctrees" not in path.parts)
    return sorted(pages)


def dead_links(site: Path) -> Iterator[str]:
    """Yield every link of a page of the site to a file or a place that the site does not have."""
    trees = {path: html.parse(path) for path in _pages(site)}
    places = {path: {*tree.xpath("//@id"), *tree.xpath("//a/@name")} for path, tree in trees.items()}
    for path, tree in trees.items():
        for link in dict.fromkeys(tree.xpath("//@href | //@src")):
            url = urlsplit(link)
            if url.scheme or url.netloc:
                continue
            target = (path.parent / unquote(url.path)).resolve() if url.path else path
            is_place = target not in places or unquote(url.fragment) in {"", *places[target]}
            if not target.exists() or not is_place:
                yield f"{path.relative_to(site)}: {link} leads nowhere"


def faults_of(pages: Sequence[str], address: str) -> list[str]:
    """Return what axe-core finds on pages, in a browser of their own."""
    options = webdriver.ChromeOptions()
    for option in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"):
        options.add_argument(option)
    options.binary_location = shutil.which("chromium") or ""
    browser = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    browser.set_script_timeout(300)
    faults = []
    try:
        for page in pages:
            browser.get(f"{address}/{page}")
            browser.execute_script(AXE.read_text(encoding="utf-8") + _KNOWN_COLOURS)
            for theme in THEMES:
                features = [{"name": "prefers-color-scheme", "value": theme}]
                browser.execute_cdp_cmd(
                    "Emulation.setEmulatedMedia", {"media": "screen", "features": features}
                )
                for width in WIDTHS:
                    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
                    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
                    rules = [] if theme == THEMES[0] else COLOUR_RULES
                    said = browser.execute_async_script(_FAULTS, rules)
                    faults += [f"{page}, {theme}, {width} wide: {fault}" for fault in said]
    finally:
        browser.quit()
    return faults


def main(site: Path, pages: Sequence[str]) -> int:
    """Print what is at fault with a site, and return 1 if anything is."""
    site = site.resolve()
    pages = pages or [path.relative_to(site).as_posix() for path in _pages(site)]
    browsers = os.cpu_count() or 1
    with (
        ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(site))) as server,
        ThreadPoolExecutor(browsers) as pool,
    ):
        Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        shares = [pages[number::browsers] for number in range(browsers)]
        faults = [fault for share in pool.map(partial(faults_of, address=address), shares) for fault in share]
        server.shutdown()
    faults = [*dead_links(site), *faults]
    print(*faults, f"{len(pages)} pages, {len(faults)} faults", sep="\n")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
