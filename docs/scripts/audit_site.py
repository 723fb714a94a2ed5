"""Judge the built site: links inside it, and each page as axe-core does, in both themes, wide and narrow.

Run ``python docs/scripts/audit_site.py SITE [PAGE ...]`` with the folder that ``sphinx-build`` has written.
It prints what is at fault, and ends with 1 if anything is: a link that leads nowhere, and what axe-core finds
violated or cannot judge.
Colours are judged once for each look of a text and its backgrounds, not anew on every page: the same
sidebar, code or table is told to be at fault on the first page that has it.
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
# Text that looks alike upon the same backgrounds has the same contrast on every page: one of each is judged.
_FAULTS = """
const [inColour, rules, judged, done] = arguments, looks = new Map([[null, ""]]), examples = new Map();
document.querySelectorAll("details:not(aside *)").forEach((fold) => { fold.open = true; });
const text = ["color", "fill", "fontSize", "fontWeight", "textShadow"];
const behind = { backgroundColor: "rgba(0, 0, 0, 0)", backgroundImage: "none", opacity: "1", filter: "none",
  position: "static", textDecorationLine: "none", borderBottomWidth: "0px", mixBlendMode: "normal" };
const look = (element) => {
  if (!looks.has(element)) {
    const style = getComputedStyle(element), around = look(element.parentElement);
    const painted = Object.keys(behind).filter((name) => style[name] !== behind[name]);
    const own = `${painted.map((name) => style[name])}/${text.map((name) => style[name])}`;
    looks.set(element, painted.length || !around.endsWith(own) ? `${around} ${own}` : around);
  }
  return looks.get(element);
};
document.body.querySelectorAll("*").forEach((element) => {
  const says = [...element.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.data.trim());
  const judgeable = !element.closest("[aria-hidden=true], [aria-disabled=true], :disabled, [inert]");
  if ((says || element.matches("input, select, textarea")) && judgeable && element.checkVisibility())
    if (!judged.includes(look(element))) examples.set(look(element), element.closest("a") ?? element);
});
const told = ({ violations, incomplete }) => Object.entries({ violations, incomplete }).flatMap(
  ([kind, found]) => found.flatMap(({ id, nodes }) =>
    nodes.map(({ html }) => `${kind}, ${id}: ${html.slice(0, 150)}`)));
const options = { resultTypes: ["violations", "incomplete"] };
(async () => {
  const faults = [];
  if (!inColour) {
    const others = Object.fromEntries(rules.map((rule) => [rule, { enabled: false }]));
    faults.push(...told(await axe.run(document, { ...options, rules: others })));
  }
  if (examples.size) {
    const include = [...examples.values()];
    faults.push(...told(await axe.run({ include }, { ...options, runOnly: rules })));
  }
  done([faults, [...examples.keys()]]);
})();
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
    judged: dict[int, list[str]] = {width: [] for width in WIDTHS}
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
                    said, looks = browser.execute_async_script(
                        _FAULTS, theme != THEMES[0], COLOUR_RULES, judged[width]
                    )
                    judged[width] += looks
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
