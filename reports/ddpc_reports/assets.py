"""What is embedded in the page beside its text: style, scripts, data, and the policy that forbids more."""

import json
import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from functools import cache
from hashlib import sha256
from importlib.resources import files
from typing import Any

import vl_convert


def stylesheet() -> str:
    """Return the style of the page."""
    return _template("style.css")


def page_script() -> str:
    """Return the page's own script."""
    return _template("report.js")


@cache
def chart_library() -> str:
    """Return Vega, Vega-Lite and Vega-Embed as one script, taken from the vl-convert package."""
    bundle: str = vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;")
    return f"(function () {{\n{bundle}\n}})();".replace("</script", "<\\/script").replace("<!--", "<\\!--")


def content_policy(scripts: Sequence[str]) -> str:
    """Return a content security policy: these scripts and no others, nothing fetched from anywhere."""
    rules = (
        "default-src 'none'",
        "img-src data:",
        "style-src 'unsafe-inline'",
        "script-src " + " ".join(map(_hash_source, scripts)),
        "base-uri 'none'",
        "form-action 'none'",
    )
    return "; ".join(rules)


def _hash_source(script: str) -> str:
    return f"'sha256-{b64encode(sha256(script.encode()).digest()).decode('ascii')}'"


def json_for_script(data: Mapping[str, Any]) -> str:
    """Return JSON that cannot end the script element it stands in, whatever the strings in it."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


def pack(column: Sequence[float | None]) -> list[int | None]:
    """Write a column as decimals, first value, and changes from value to value, all as whole numbers.

    Samples change little from one to the next, so this takes half the room. Six digits of the range are kept.
    """
    known = [value for value in column if value is not None]
    span = max(known, default=0.0) - min(known, default=0.0)
    largest = span or max(map(abs, known), default=0.0)
    decimals = 5 - math.floor(math.log10(largest)) if largest > 0 else 0
    packed: list[int | None] = [decimals]
    last = 0
    for value in column:
        whole = None if value is None else round(value * 10.0**decimals)
        packed.append(None if whole is None else whole - last)
        last = last if whole is None else whole
    return packed


def _template(name: str) -> str:
    return (files("ddpc_reports") / "templates" / name).read_text(encoding="utf-8")
