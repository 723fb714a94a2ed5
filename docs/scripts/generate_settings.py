"""Write the settings tables of methods.md from what the controllers declare.

Run ``python docs/scripts/generate_settings.py``. A table stands between ``<!-- settings: NAME -->`` and
``<!-- end -->``; NAME is a controller's entry point, or ``module:Class`` of anything that declares settings.
"""

import dataclasses
import re
from pathlib import Path
from typing import Any

from ddpc_cosim import declared_settings
from ddpc_cosim.plugins import load_plugin

PAGE = Path(__file__).parents[1] / "methods.md"
_TABLE = re.compile(r"(<!-- settings: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def settings_table(plugin: type[Any]) -> str:
    """Return the table of a class's settings in Markdown."""
    declared = declared_settings(plugin)
    fields = {field.name: field for field in dataclasses.fields(plugin)}
    rows = ["| setting | default | allowed | meaning |", "|---|---|---|---|"]
    for name, info in declared.items():
        meaning = f"{info.doc} [{info.unit}]" if info.unit else info.doc
        cells = (f"`{name}`", _default(fields[name]), info.allowed, meaning)
        rows.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(rows) + "\n"


def with_tables(text: str) -> str:
    """Return a page with its tables written anew."""
    return _TABLE.sub(
        lambda found: found[1] + settings_table(load_plugin("controllers", found[2])) + found[3], text
    )


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default_factory is not dataclasses.MISSING:
        value: Any = field.default_factory()
    elif field.default is not dataclasses.MISSING:
        value = field.default
    else:
        return "required"
    if dataclasses.is_dataclass(value):
        return f"`{type(value).__name__}`"
    if value is None or (isinstance(value, tuple) and not value):
        return "none"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8", newline="\n")
