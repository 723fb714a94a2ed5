"""What is embedded in the page beside its text: style, scripts, data, and the policy that forbids more."""

import json
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


def _template(name: str) -> str:
    return (files("ddpc_reports") / "templates" / name).read_text(encoding="utf-8")
