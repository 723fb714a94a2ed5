"""Take the pictures of reports: the first screen of every built-in study, and parts that a page explains.

Run ``python docs/scripts/take_pictures.py RUNS``. RUNS has a folder of results for each study, as
``ddpc-cosim run STUDY --out RUNS/STUDY`` writes it.
"""

import base64
import io
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

from ddpc_cosim import load_results
from ddpc_cosim.plugins import plugin_names
from ddpc_reports import write_report

PICTURES = Path(__file__).parents[1] / "pictures" / "reports"
_COLOURS = 256
_WIDTH, _HEIGHT = 1280, 900
_AS_WIDE_AS_THE_WINDOW = "<style>.page { max-width: none; }</style>"
PARTS = {
    "benchmark": {"by-problem": ("#s1-by-problem-table", 1900)},
    "paper": {
        "responses": ("#s1-1-responses", _WIDTH),
        "errors": ("#s1-1-errors", _WIDTH),
        "spread": ("#s1-1-spread-0", _WIDTH),
    },
}


class Camera:
    """A browser that shows pages as they are without scripts, so that a picture is the same every time."""

    def __init__(self) -> None:
        options = webdriver.ChromeOptions()
        for option in ("--headless=new", "--no-sandbox", "--hide-scrollbars"):
            options.add_argument(option)
        options.binary_location = shutil.which("chromium") or ""
        self._browser = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
        self._ask("Emulation.setScriptExecutionDisabled", value=True)
        self.widen(_WIDTH)

    def widen(self, width: int) -> None:
        """Show pages as wide as that."""
        size = {"width": width, "height": _HEIGHT, "deviceScaleFactor": 1, "mobile": False}
        self._ask("Emulation.setDeviceMetricsOverride", **size)

    def open(self, page: Path) -> None:
        """Show a page from its top."""
        self._browser.get(page.as_uri())

    def take(self, picture: Path, part: str = "") -> None:
        """Write the first screen, or the element of a selector, as a PNG of few colours."""
        clip = self._box(part) if part else {"x": 0, "y": 0, "width": _WIDTH, "height": _HEIGHT}
        how = {"format": "png", "captureBeyondViewport": True, "clip": {**clip, "scale": 1}}
        data = base64.b64decode(self._ask("Page.captureScreenshot", **how)["data"])
        image = Image.open(io.BytesIO(data)).convert("RGB")
        image.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE).save(
            picture, optimize=True
        )
        print(picture, picture.stat().st_size, "bytes")

    def close(self) -> None:
        """End the browser."""
        self._browser.quit()

    def _box(self, selector: str) -> dict[str, float]:
        root = self._ask("DOM.getDocument")["root"]["nodeId"]
        node = self._ask("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        box = self._ask("DOM.getBoxModel", nodeId=node)["model"]
        x, y = box["border"][:2]
        return {"x": x, "y": y, "width": box["width"], "height": box["height"]}

    def _ask(self, command: str, **arguments: Any) -> dict[str, Any]:
        return self._browser.execute_cdp_cmd(command, arguments)


def main(runs: Path) -> None:
    """Take the pictures of all studies of which there are results."""
    camera = Camera()
    with tempfile.TemporaryDirectory() as folder:
        for study in plugin_names("studies"):
            if not (runs / study).is_dir():
                print(f"no results of {study}")
                continue
            page = write_report([load_results(runs / study)], Path(folder, f"{study}.html"))
            camera.open(page)
            camera.take(PICTURES / f"{study}.png")
            text = page.read_text(encoding="utf-8")
            page.write_text(text.replace("</head>", f"{_AS_WIDE_AS_THE_WINDOW}</head>", 1), encoding="utf-8")
            for name, (part, width) in PARTS.get(study, {}).items():
                camera.widen(width)
                camera.open(page)
                camera.take(PICTURES / f"{study}-{name}.png", part)
            camera.widen(_WIDTH)
    camera.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
