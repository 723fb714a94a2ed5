"""Write tables of pages from the code: what controllers declare, and the parameters of classes.

Run ``python docs/scripts/generate_settings.py``. A table stands between ``<!-- settings: NAME -->`` and
``<!-- end -->``; NAME is a controller's entry point, or ``module:Class`` of anything that declares settings.
After ``<!-- parameters: module:Class -->`` it is what the class's docstring says of its parameters.
"""

import dataclasses
import inspect
import re
from pathlib import Path
from typing import Any

from ddpc_cosim import declared_settings
from ddpc_cosim.plugins import load_plugin

DOCS = Path(__file__).parents[1]
PAGES = ("methods.md", "extend/write-a-controller-plug-in.md")
_TABLE = re.compile(r"(<!-- (settings|parameters): (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
_PARAMETER = re.compile(r"^(\S.*?) : (.*)\n((?: {4}.*\n?)+)", re.MULTILINE)


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


def parameters_table(kind: type[Any]) -> str:
    """Return the table of a class's parameters in Markdown, from its docstring."""
    rows = ["| name | type | meaning |", "|---|---|---|"]
    section = inspect.cleandoc(kind.__doc__ or "").partition("Parameters\n----------\n")[2]
    for names, type_, meaning in _PARAMETER.findall(section.partition("\n\n")[0]):
        named = ", ".join(f"`{name}`" for name in names.split(", "))
        rows.append(f"| {named} | {type_} | {' '.join(meaning.split()).replace('``', '`')} |")
    return "\n".join(rows) + "\n"


def with_tables(text: str) -> str:
    """Return a page with its tables written anew."""
    tables = {"settings": settings_table, "parameters": parameters_table}
    return _TABLE.sub(
        lambda match: match[1] + tables[match[2]](load_plugin("controllers", match[3])) + match[4], text
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
    for page in PAGES:
        text = (DOCS / page).read_text(encoding="utf-8")
        (DOCS / page).write_text(with_tables(text), encoding="utf-8", newline="\n")
